//! Shading of the deformed samples: their normals, and the ellipse that a circle around each becomes.
//! Quick, and for the eye alone.

use glam::{Vec3, Vec3A};
use pulp::Arch;
use rayon::prelude::*;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::NeighbourGraph;
use std::iter::repeat_n;
use std::sync::Arc;

/// Number of neighbours by which a sample's normal is turned.
const RING: usize = 6;
/// Least and greatest stretch of a disc ...
const STRETCHES: [f32; 2] = [0.3, 20.0];
/// ... and greatest ratio of its length to its width.
const THINNEST: f32 = 8.0;

/// Number of samples side by side: compilers make vectors of loops over so many. Nothing is fused, so that
/// all widths of vectors give the same bits.
const LANES: usize = 16;
/// Number of groups of samples that a thread computes at a time.
const RINGS_TOGETHER: usize = 64;

/// The axes of an ellipse: half of each, the longer one first, at right angles to each other.
pub type EllipseAxes = [Vec3; 2];

/// The normals and stretches of all samples, or of those of a list.
#[derive(Debug, Clone, Default)]
pub struct Shading {
    /// Unit normals.
    pub normals: Arc<[Vec3]>,
    /// Ellipse that a circle of radius 1 around each sample at rest becomes, in the tangent plane. Empty
    /// where nothing has moved.
    pub axes: Arc<[EllipseAxes]>,
}

impl Shading {
    /// The shading of all samples, which have moved to these positions.
    pub fn new(sampled: &SampledModel, positions: &[Vec3]) -> Self {
        let samples = &sampled.samples;
        samples.prepare();
        if is_still(sampled, positions) {
            return Self { normals: samples.normals().into(), axes: Arc::default() };
        }
        let (surface, count, arch) = (RestSurface::new(sampled), samples.len(), Arch::new());
        made(count, |k, normals, axes| {
            let of = |lane: usize| (LANES * k + lane).min(count - 1);
            let alone = |lane| surface.turned(positions, of(lane));
            LaneRing::new(&surface, of).shade(positions, arch, (normals, axes), alone);
        })
    }

    /// The shading of some of the samples, in their order.
    pub fn taken(&self, some: &[u32]) -> Self {
        let normals = some.iter().map(|i| self.normals[*i as usize]).collect();
        let axes = some.iter().filter_map(|i| self.axes.get(*i as usize).copied()).collect();
        Self { normals, axes }
    }
}

/// Part of the shading of some samples that follows from the rest shape alone: kept from picture to
/// picture, as long as these samples are drawn.
///
/// Memory: 101 bytes for each sample.
pub struct Rings {
    sampled: Arc<SampledModel>,
    some: Arc<[u32]>,
    rings: Vec<LaneRing>,
}

impl Rings {
    /// The rings of some of the samples.
    fn new(sampled: Arc<SampledModel>, some: Arc<[u32]>) -> Self {
        sampled.samples.prepare();
        let surface = RestSurface::new(&sampled);
        let ring =
            |k: usize| LaneRing::new(&surface, |lane| some[(LANES * k + lane).min(some.len() - 1)] as usize);
        let rings = (0..some.len().div_ceil(LANES)).into_par_iter().with_min_len(RINGS_TOGETHER).map(ring);
        Self { rings: rings.collect(), sampled, some }
    }

    /// Rings of these samples, kept from the last call where that was about the same samples.
    pub fn keep<'a>(kept: &'a mut Option<Self>, sampled: &Arc<SampledModel>, some: &Arc<[u32]>) -> &'a Self {
        kept.take_if(|rings| !rings.are_of(sampled, some));
        kept.get_or_insert_with(|| Self::new(sampled.clone(), some.clone()))
    }

    /// Whether the rings are those of these samples of this model.
    fn are_of(&self, sampled: &Arc<SampledModel>, some: &Arc<[u32]>) -> bool {
        Arc::ptr_eq(&self.sampled, sampled) && (Arc::ptr_eq(&self.some, some) || self.some == *some)
    }

    /// Shading of these samples, in their order, once all samples have moved to these positions: the same
    /// to the last digit as that of [`Shading::new`].
    pub fn shading(&self, positions: &[Vec3]) -> Shading {
        let (surface, arch) = (RestSurface::new(&self.sampled), Arch::new());
        if is_still(&self.sampled, positions) {
            let normals = self.some.iter().map(|i| surface.normals[*i as usize]).collect();
            return Shading { normals, axes: Arc::default() };
        }
        made(self.some.len(), |k, normals, axes| {
            let alone = |lane: usize| surface.turned(positions, self.some[LANES * k + lane] as usize);
            self.rings[k].shade(positions, arch, (normals, axes), alone);
        })
    }
}

fn is_still(sampled: &SampledModel, positions: &[Vec3]) -> bool {
    *positions == *sampled.samples.positions
}

/// Shading of `count` samples, made by `shade` for as many at a time as there are lanes: it gets the number
/// of their group, and the places for the results. These are made in place, as a million samples have 36 MB
/// of them.
fn made(count: usize, shade: impl Fn(usize, &mut [Vec3], &mut [EllipseAxes]) + Sync) -> Shading {
    let mut normals: Arc<[Vec3]> = repeat_n(Vec3::ZERO, count).collect();
    let mut axes: Arc<[EllipseAxes]> = repeat_n([Vec3::ZERO; 2], count).collect();
    if let (Some(normals), Some(axes)) = (Arc::get_mut(&mut normals), Arc::get_mut(&mut axes)) {
        let rings = normals.par_chunks_mut(LANES).zip(axes.par_chunks_mut(LANES)).enumerate();
        rings.with_min_len(RINGS_TOGETHER).for_each(|(k, (normals, axes))| shade(k, normals, axes));
    }
    Shading { normals, axes }
}

/// The samples at rest.
struct RestSurface<'a> {
    positions: &'a [Vec3],
    normals: &'a [Vec3],
    neighbours: &'a NeighbourGraph,
}

impl<'a> RestSurface<'a> {
    fn new(sampled: &'a SampledModel) -> Self {
        let samples = &sampled.samples;
        Self { positions: &samples.positions, normals: samples.normals(), neighbours: samples.neighbours() }
    }

    fn ring(&self, i: usize) -> &[u32] {
        &self.neighbours.nearest_to(i)[..RING.min(self.neighbours.k())]
    }

    /// Normal of a sample, turned as the triangles between it and its nearest neighbours are: `Σ (r₁ × r₂ ·
    /// n) d₁ × d₂` over pairs of neighbours, where `r` are the vectors to them at rest and `d` those now.
    /// With tangents `s × t = n` that is `(Σ (r·s) d) × (Σ (r·t) d)`. And the ellipse of the linear map
    /// that carries these vectors over best. A [`LaneRing`] does the same of many samples at a time, unless
    /// their neighbours lie on a line.
    fn turned(&self, now: &[Vec3], i: usize) -> (Vec3, EllipseAxes) {
        let (rest, n) = (self.positions, self.normals[i]);
        let (s, t) = n.any_orthonormal_pair();
        let (mut along_s, mut along_t) = (Vec3::ZERO, Vec3::ZERO);
        let (mut ss, mut st, mut tt) = (0.0, 0.0, 0.0);
        let (mut more_s, mut more_t) = (Vec3::ZERO, Vec3::ZERO);
        for &j in self.ring(i) {
            let (r, d) = (rest[j as usize] - rest[i], now[j as usize] - now[i]);
            let (x, y) = (r.dot(s), r.dot(t));
            along_s += x * d;
            along_t += y * d;
            (ss, st, tt) = (ss + x * x, st + x * y, tt + y * y);
            // The sums are of displacements: a motion of all neighbours as one has no share in them,
            // however the surface is curved.
            more_s += x * (d - r);
            more_t += y * (d - r);
        }
        // Each tangent is scaled to unit size: its length may be that of a small length's square.
        let unit = |v: Vec3| v / v.abs().max_element();
        let normal = unit(along_s).cross(unit(along_t)).try_normalize().unwrap_or(n);
        let determinant = ss * tt - st * st;
        let map = if determinant > FLATTEST * ss * tt {
            [s + (tt * more_s - st * more_t) / determinant, t + (ss * more_t - st * more_s) / determinant]
        } else {
            [s, t]
        };
        (normal, ellipse(map, normal))
    }
}

/// Part of its greatest value below which the determinant of the neighbours' second moments counts as that
/// of neighbours on a line.
const FLATTEST: f32 = 1e-3;

type ShadingLanes = [f32; LANES];
type Lanes3 = [ShadingLanes; 3];

/// Shading of some samples, side by side.
struct Lying {
    /// The unit normal, and the square of its former length.
    normal: Lanes3,
    square: ShadingLanes,
    /// The direction of the longer axis, and the lengths of both.
    along: Lanes3,
    most: ShadingLanes,
    least: ShadingLanes,
}

/// Part of the shading of some samples that follows from the rest shape alone, side by side. The sums of
/// [`RestSurface::turned`] are linear in the present vectors to the neighbours; so their coefficients are
/// known beforehand.
struct LaneRing {
    /// The samples, and their neighbours; the sample itself in the place of neighbours that are missing.
    near: [[u32; 1 + RING]; LANES],
    /// Coefficient of the vector to each neighbour in either deformed tangent ...
    shares: [[[f32; 2]; RING]; LANES],
    /// ... and the part of the tangents that the vectors at rest do not determine: a motion of all as one
    /// has no share in it, however the surface is curved.
    left: [Lanes3; 2],
    /// Samples whose neighbours lie on a line, a bit for each.
    odd: u16,
}

impl LaneRing {
    /// The ring of the samples that `of` names, lane by lane.
    fn new(surface: &RestSurface<'_>, of: impl Fn(usize) -> usize) -> Self {
        let zero = [0.0; LANES];
        let mut this = Self {
            near: [[0; 1 + RING]; LANES],
            shares: [[[0.0; 2]; RING]; LANES],
            left: [[zero; 3]; 2],
            odd: 0,
        };
        (0..LANES).for_each(|lane| this.set(lane, surface, of(lane)));
        this
    }

    fn set(&mut self, lane: usize, surface: &RestSurface<'_>, i: usize) {
        self.near[lane] = [i as u32; 1 + RING];
        let ring = surface.ring(i);
        let rest = surface.positions;
        let (s, t) = surface.normals[i].any_orthonormal_pair();
        let mut ways = [Vec3::ZERO; RING];
        for (j, (way, &near)) in ways.iter_mut().zip(ring).enumerate() {
            *way = rest[near as usize] - rest[i];
            self.near[lane][1 + j] = near;
        }
        // Vectors are divided by the largest of their coordinates, so that no square is too small.
        let size = ways.iter().fold(0.0_f32, |size, way| size.max(way.abs().max_element()));
        let (mut flat, [mut ss, mut st, mut tt]) = ([[0.0; 2]; RING], [0.0; 3]);
        for ([x, y], way) in flat.iter_mut().zip(&ways) {
            (*x, *y) = (way.dot(s) / size, way.dot(t) / size);
            (ss, st, tt) = (ss + *x * *x, st + *x * *y, tt + *y * *y);
        }
        let determinant = ss * tt - st * st;
        // Samples are odd, too, where one of the numbers is not a number.
        if !(determinant > FLATTEST * ss * tt && size.is_normal()) {
            self.odd |= 1 << lane;
            return;
        }
        let unit = (determinant * size).recip();
        let mut left = [s, t];
        for (j, ([x, y], way)) in flat.iter().zip(&ways).enumerate() {
            let shares = [(tt * x - st * y) * unit, (ss * y - st * x) * unit];
            for (k, share) in shares.into_iter().enumerate() {
                left[k] -= share * *way;
                self.shares[lane][j][k] = share;
            }
        }
        for (k, left) in left.iter().enumerate() {
            (0..3).for_each(|axis| self.left[k][axis][lane] = left[axis]);
        }
    }

    /// Shading of these samples, as far as they are wanted; `alone` computes that of one sample, by its
    /// lane.
    fn shade(
        &self,
        now: &[Vec3],
        arch: Arch,
        (normals, axes): (&mut [Vec3], &mut [EllipseAxes]),
        alone: impl Fn(usize) -> (Vec3, EllipseAxes),
    ) {
        let Lying { normal, square, along, most, least } = arch.dispatch(|| self.lying(now));
        let at = |lanes: &Lanes3, i: usize| Vec3::new(lanes[0][i], lanes[1][i], lanes[2][i]);
        for (i, (out, ellipse)) in normals.iter_mut().zip(axes).enumerate() {
            let (n, along) = (at(&normal, i), at(&along, i));
            // A surface that is flattened to a line, or to a point, is left to `alone`.
            let is_sound = square[i].is_normal() && along.is_finite() && (most[i] + least[i]).is_finite();
            (*out, *ellipse) = if is_sound && self.odd & 1 << i == 0 {
                (n, [most[i] * along, least[i] * n.cross(along)])
            } else {
                alone(i)
            };
        }
    }

    #[inline(always)]
    fn lying(&self, now: &[Vec3]) -> Lying {
        let tangents = self.tangents(now);
        let [u, v] = &tangents;
        let (mut normal, mut square) = ([[0.0; LANES]; 3], [0.0; LANES]);
        for i in 0..LANES {
            let x = u[1][i] * v[2][i] - u[2][i] * v[1][i];
            let y = u[2][i] * v[0][i] - u[0][i] * v[2][i];
            let z = u[0][i] * v[1][i] - u[1][i] * v[0][i];
            square[i] = x * x + y * y + z * z;
            let unit = 1.0 / square[i].sqrt();
            (normal[0][i], normal[1][i], normal[2][i]) = (x * unit, y * unit, z * unit);
        }
        let radii = self.radii(tangents, &normal);
        let (along, [most, least]) = axes_of(&radii);
        Lying { normal, square, along, most, least }
    }

    /// Deformed tangents, from the present vectors to the neighbours.
    #[inline(always)]
    fn tangents(&self, now: &[Vec3]) -> [Lanes3; 2] {
        let mut tangents = [[[0.0; LANES]; 3]; 2];
        for (i, ([own, near @ ..], shares)) in self.near.iter().zip(&self.shares).enumerate() {
            let at = |near: u32| Vec3A::from(now[near as usize]);
            let here = at(*own);
            let (mut u, mut v) = (Vec3A::ZERO, Vec3A::ZERO);
            for (near, [of_u, of_v]) in near.iter().zip(shares) {
                let way = at(*near) - here;
                u += way * *of_u;
                v += way * *of_v;
            }
            for (tangent, sum) in tangents.iter_mut().zip([u, v]) {
                (0..3).for_each(|axis| tangent[axis][i] = sum[axis]);
            }
        }
        tangents
    }

    /// The images of two radii at right angles, in the plane of the normal.
    #[inline(always)]
    fn radii(&self, tangents: [Lanes3; 2], normal: &Lanes3) -> [Lanes3; 2] {
        let mut radii = tangents;
        for (radius, left) in radii.iter_mut().zip(&self.left) {
            for axis in 0..3 {
                (0..LANES).for_each(|i| radius[axis][i] += left[axis][i]);
            }
            for i in 0..LANES {
                let off =
                    radius[0][i] * normal[0][i] + radius[1][i] * normal[1][i] + radius[2][i] * normal[2][i];
                (0..3).for_each(|axis| radius[axis][i] -= off * normal[axis][i]);
            }
        }
        radii
    }
}

/// Direction of the longer axis, and the lengths of both axes, computed as [`ellipse`] does, of radii in
/// the plane of the normal.
#[inline(always)]
fn axes_of([u, v]: &[Lanes3; 2]) -> (Lanes3, [ShadingLanes; 2]) {
    let (mut along, mut lengths) = ([[0.0; LANES]; 3], [[0.0; LANES]; 2]);
    for i in 0..LANES {
        let dot = |a: &Lanes3, b: &Lanes3| a[0][i] * b[0][i] + a[1][i] * b[1][i] + a[2][i] * b[2][i];
        let (sin, cos) = half_angle(2.0 * dot(u, v), dot(u, u) - dot(v, v));
        let (mut long, mut short) = (0.0, 0.0);
        for axis in 0..3 {
            let (a, b) = (cos * u[axis][i] + sin * v[axis][i], cos * v[axis][i] - sin * u[axis][i]);
            (long, short) = (long + a * a, short + b * b);
            along[axis][i] = a;
        }
        let (long, short) = (long.sqrt(), short.sqrt());
        (0..3).for_each(|axis| along[axis][i] /= long);
        let within = |length: f32| length.clamp(STRETCHES[0], STRETCHES[1]);
        lengths[0][i] = within(long);
        lengths[1][i] = within(short).max(within(long) / THINNEST);
    }
    (along, lengths)
}

/// Half axes of the ellipse that a circle of radius 1 becomes, from the images of two of its radii at right
/// angles by a linear map; in the plane of a normal, and within bounds that can be drawn.
fn ellipse(radii: [Vec3; 2], normal: Vec3) -> EllipseAxes {
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

/// Sine and cosine of half the angle of a point, which is between a quarter turn to either side. There is
/// one for each sample in each picture, and arc tangents take long.
#[inline(always)]
fn half_angle(y: f32, x: f32) -> (f32, f32) {
    let far = (y * y + x * x).sqrt();
    // The larger of sine and cosine comes first, by a sum in which nothing cancels out.
    let large = if far > 0.0 { (0.5 * (1.0 + x.abs() / far)).sqrt() } else { 1.0 };
    let small = if far > 0.0 { 0.5 * y.abs() / (far * large) } else { 0.0 };
    let (sin, cos) = if x >= 0.0 { (small, large) } else { (large, small) };
    (sin.copysign(y), cos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_core::sampling::{Sampling, Target, sample};
    use simod_model::progress::Silent;

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

    /// Many samples at a time have the shading of each by itself, whatever the neighbours are, and in
    /// whatever list they stand.
    #[test]
    fn many_at_a_time_lie_as_each_does() {
        let on = |i: u32| {
            let (y, x) = (0.13 * i as f32).sin_cos();
            match i % 50 {
                // Some samples lie on a line, and some at one place.
                49 => Vec3::new(3.0, 1e-3 * i as f32, 0.0),
                48 => Vec3::splat(-4.0),
                _ => Vec3::new(x, y, 0.004 * i as f32),
            }
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.xyz");
        let lines: Vec<String> = (0..3000).map(on).map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
        simod_model::output::write_file(&path, lines.concat().as_bytes()).unwrap();
        let model = simod_model::open(&path).unwrap();
        let sampling = Sampling { target: Target::Samples(5000), ..Sampling::default() };
        let sampled = Arc::new(sample(model.as_ref(), &sampling, folder.path(), &Silent).unwrap());
        sampled.samples.prepare();
        let bent = |p: &Vec3| Vec3::new(p.x + 0.3 * p.z * p.z, 0.4 * p.y, p.z - 0.2 * p.x);
        let mut now: Vec<Vec3> = sampled.samples.positions.iter().map(bent).collect();
        // A part is flattened to a line.
        let flat = 500..600;
        now[flat.clone()].iter_mut().for_each(|p| *p = Vec3::X * p.x);
        let all = Shading::new(&sampled, &now);
        let surface = RestSurface::new(&sampled);
        let close = |a: Vec3, b: Vec3| (a - b).length() < 2e-3 * b.length();
        for i in 0..sampled.samples.len() {
            let (normal, [long, short]) = surface.turned(&now, i);
            let (n, axes) = (all.normals[i], all.axes[i]);
            assert!((n.length() - 1.0).abs() < 1e-5 && axes.iter().all(|axis| axis.is_finite()), "{i}");
            // The shading of nearly flattened samples is decided by rounding.
            if surface.ring(i).iter().chain(&[i as u32]).any(|j| flat.contains(&(*j as usize))) {
                continue;
            }
            assert!(close(n, normal), "{i}: {n} {normal}");
            let lengths = |[a, b]: [Vec3; 2]| Vec3::new(a.length(), b.length(), 0.0);
            assert!(close(lengths(axes), lengths([long, short])), "{i}: {axes:?} {long} {short}");
            // Axes of one length may have any direction.
            let is_round = long.length() < 1.05 * short.length();
            assert!(is_round || axes[0].dot(long).abs() > 0.999 * long.length_squared(), "{i}");
        }
        let some: Arc<[u32]> = (0..777).map(|k| 3 * k + 1).collect();
        let rings = Rings::new(sampled.clone(), some.clone());
        let (part, taken) = (rings.shading(&now), all.taken(&some));
        assert!(part.normals == taken.normals && part.axes == taken.axes);
        assert!(rings.are_of(&sampled, &some.iter().copied().collect()));
        assert!(!rings.are_of(&sampled, &some[1..].into()));
        let rest = rings.shading(&sampled.samples.positions);
        assert!(rest.axes.is_empty() && rest.normals[7] == sampled.samples.normals()[22]);
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
        // An ellipse can be drawn however much it is stretched.
        let [long, short] = ellipse([1e6 * Vec3::X, 1e-6 * Vec3::Y], Vec3::Z);
        assert!(long.length() <= STRETCHES[1] * 1.001 && short.length() >= long.length() / THINNEST * 0.999);
        assert!(ellipse([Vec3::NAN; 2], Vec3::Z).iter().all(|axis| (axis.length() - 1.0).abs() < 1e-5));
    }
}
