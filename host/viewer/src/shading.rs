//! How the surface lies where the samples went: their normals, and what becomes of a circle around each.
//! Quick, and for the eye alone.

use glam::Vec3;
use rayon::prelude::*;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::NeighbourGraph;
use std::iter::repeat_n;
use std::sync::Arc;

/// Neighbours of a sample that its normal is turned with.
const RING: usize = 6;
/// The least and most that discs are stretched ...
const STRETCHES: [f32; 2] = [0.3, 20.0];
/// ... and how much longer than wide they get.
const THINNEST: f32 = 8.0;

/// Samples that a thread takes at once, at least.
const LEAST_TOGETHER: usize = 1024;

/// The axes of an ellipse: half of each, the longer one first, at right angles to each other.
pub type Ellipse = [Vec3; 2];

/// Of all samples, or of those of a list.
#[derive(Debug, Clone, Default)]
pub struct Shading {
    /// Unit normals.
    pub normals: Arc<[Vec3]>,
    /// What a circle of radius 1 around each at rest becomes, in the tangent plane. Empty where nothing has
    /// moved.
    pub axes: Arc<[Ellipse]>,
}

impl Shading {
    /// Of all samples, which have moved to these positions.
    pub fn new(sampled: &SampledModel, positions: &[Vec3]) -> Self {
        let samples = &sampled.samples;
        samples.prepare();
        if is_still(sampled, positions) {
            return Self { normals: samples.normals().into(), axes: Arc::default() };
        }
        let turned = Turned::new(sampled, positions);
        made(samples.len(), |i| turned.of(i))
    }

    /// Of some of the samples, in their order.
    pub fn of(sampled: &SampledModel, positions: &[Vec3], some: &[u32]) -> Self {
        let samples = &sampled.samples;
        samples.prepare();
        if is_still(sampled, positions) {
            let normals = some.iter().map(|i| samples.normals()[*i as usize]).collect();
            return Self { normals, axes: Arc::default() };
        }
        let turned = Turned::new(sampled, positions);
        made(some.len(), |k| turned.of(some[k] as usize))
    }

    /// That of some of the samples, in their order.
    pub fn taken(&self, some: &[u32]) -> Self {
        let normals = some.iter().map(|i| self.normals[*i as usize]).collect();
        let axes = some.iter().filter_map(|i| self.axes.get(*i as usize).copied()).collect();
        Self { normals, axes }
    }
}

fn is_still(sampled: &SampledModel, positions: &[Vec3]) -> bool {
    *positions == *sampled.samples.positions
}

/// So many, one by one. They are written where they stay: a million samples have 36 MB of them.
fn made(count: usize, of: impl Fn(usize) -> (Vec3, Ellipse) + Sync) -> Shading {
    let mut normals: Arc<[Vec3]> = repeat_n(Vec3::ZERO, count).collect();
    let mut axes: Arc<[Ellipse]> = repeat_n([Vec3::ZERO; 2], count).collect();
    if let (Some(normals), Some(axes)) = (Arc::get_mut(&mut normals), Arc::get_mut(&mut axes)) {
        let all = normals.par_iter_mut().zip(axes).enumerate().with_min_len(LEAST_TOGETHER);
        all.for_each(|(i, (normal, axes))| (*normal, *axes) = of(i));
    }
    Shading { normals, axes }
}

/// The samples at rest and where they are now.
struct Turned<'a> {
    rest: &'a [Vec3],
    now: &'a [Vec3],
    normals: &'a [Vec3],
    neighbours: &'a NeighbourGraph,
}

impl<'a> Turned<'a> {
    fn new(sampled: &'a SampledModel, now: &'a [Vec3]) -> Self {
        let samples = &sampled.samples;
        Self { rest: &samples.positions, now, normals: samples.normals(), neighbours: samples.neighbours() }
    }

    /// A sample's normal, turned as the triangles between it and its nearest neighbours are:
    /// `Σ (r₁ × r₂ · n) d₁ × d₂` over pairs of neighbours, where `r` are the ways to them at rest and `d`
    /// those now. With tangents `s × t = n` that is `(Σ (r·s) d) × (Σ (r·t) d)`. And the ellipse of the
    /// linear map that carries these ways over best.
    fn of(&self, i: usize) -> (Vec3, Ellipse) {
        let (rest, positions, n) = (self.rest, self.now, self.normals[i]);
        let (s, t) = n.any_orthonormal_pair();
        let (mut along_s, mut along_t) = (Vec3::ZERO, Vec3::ZERO);
        let (mut ss, mut st, mut tt) = (0.0, 0.0, 0.0);
        let (mut more_s, mut more_t) = (Vec3::ZERO, Vec3::ZERO);
        for &j in &self.neighbours.nearest_to(i)[..RING.min(self.neighbours.k())] {
            let (r, d) = (rest[j as usize] - rest[i], positions[j as usize] - positions[i]);
            let (x, y) = (r.dot(s), r.dot(t));
            along_s += x * d;
            along_t += y * d;
            (ss, st, tt) = (ss + x * x, st + x * y, tt + y * y);
            // What moves as one has no share in this, however the surface is curved.
            more_s += x * (d - r);
            more_t += y * (d - r);
        }
        // Each of the size of a small length's square.
        let unit = |v: Vec3| v / v.abs().max_element();
        let normal = unit(along_s).cross(unit(along_t)).try_normalize().unwrap_or(n);
        let determinant = ss * tt - st * st;
        let map = if determinant > 1e-3 * ss * tt {
            [s + (tt * more_s - st * more_t) / determinant, t + (ss * more_t - st * more_s) / determinant]
        } else {
            [s, t]
        };
        (normal, ellipse(map, normal))
    }
}

/// Half axes of what a circle of radius 1 becomes, by where a linear map takes two of its radii at right
/// angles; in the plane of a normal, and within bounds that can be drawn.
fn ellipse(radii: [Vec3; 2], normal: Vec3) -> Ellipse {
    let [u, v] = radii.map(|radius| radius - radius.dot(normal) * normal);
    let (uu, uv, vv) = (u.dot(u), u.dot(v), v.dot(v));
    let (sin, cos) = half_angle(2.0 * uv, uu - vv);
    let (long, short) = (cos * u + sin * v, cos * v - sin * u);
    let round = || <[Vec3; 2]>::from(normal.any_orthonormal_pair());
    let Some(along) = long.try_normalize() else { return round() };
    let [most, least] = [long, short].map(|axis| axis.length().clamp(STRETCHES[0], STRETCHES[1]));
    let least = least.max(most / THINNEST);
    if !(most.is_finite() && least.is_finite()) {
        return round();
    }
    [most * along, least * normal.cross(along)]
}

/// Sine and cosine of half the angle of a point, which is between a quarter turn to either side: there is one
/// for each sample in each picture, and arc tangents take long.
fn half_angle(y: f32, x: f32) -> (f32, f32) {
    let far = (y * y + x * x).sqrt();
    if far == 0.0 {
        return (0.0, 1.0);
    }
    // Where nothing cancels out.
    let large = (0.5 * (1.0 + x.abs() / far)).sqrt();
    let small = 0.5 * y.abs() / (far * large);
    let (sin, cos) = if x >= 0.0 { (small, large) } else { (large, small) };
    (sin.copysign(y), cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_halved() {
        for k in -1000..=1000 {
            let angle = 0.001 * k as f32 * std::f32::consts::PI;
            for far in [1e-18, 1.0, 3e18] {
                let (sin, cos) = half_angle(far * angle.sin(), far * angle.cos());
                let (y, x) = (0.5 * f32::atan2(angle.sin(), angle.cos())).sin_cos();
                assert!((sin - y).abs() < 1e-6 && (cos - x).abs() < 1e-6, "{angle}: {sin} {cos}");
            }
        }
        assert_eq!(half_angle(0.0, 0.0), (0.0, 1.0));
    }

    #[test]
    fn a_circle_becomes_the_ellipse_of_a_map() {
        let map = |p: Vec3| Vec3::new(3.0 * p.x + 0.4 * p.y, 0.5 * p.y, 0.0);
        let [long, short] = ellipse([map(Vec3::X), map(Vec3::Y)], Vec3::Z);
        assert!(long.dot(short).abs() < 1e-5 && long.length() > short.length());
        // Points of the circle lie on it.
        for k in 0..32 {
            let (y, x) = (0.2 * k as f32).sin_cos();
            let p = map(Vec3::new(x, y, 0.0));
            let on = (p.dot(long) / long.length_squared()).powi(2)
                + (p.dot(short) / short.length_squared()).powi(2);
            assert!((on - 1.0).abs() < 1e-4, "{on}");
        }
        // However much it is stretched, it can be drawn.
        let [long, short] = ellipse([1e6 * Vec3::X, 1e-6 * Vec3::Y], Vec3::Z);
        assert!(long.length() <= STRETCHES[1] * 1.001 && short.length() >= long.length() / THINNEST * 0.999);
        assert!(ellipse([Vec3::NAN; 2], Vec3::Z).iter().all(|axis| (axis.length() - 1.0).abs() < 1e-5));
    }
}
