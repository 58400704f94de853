//! What is there to be seen: the samples, where the steps have moved them, and what the plugins placed.

use glam::Vec3;
use rayon::prelude::*;
use simod_core::reconstruction::{DeformationField, Method, RestGeometry};
use simod_core::sampled_model::SampledModel;
use simod_model::frame::Frame;
use simod_plugin_api::Effort;
use simod_session::OwnHandles;
use simod_session::edit::{Evaluated, Evaluation, Status, StepId};
use std::collections::HashMap;
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

/// The samples after the steps. All arrays have one entry for each sample; all coordinates are local.
pub struct Scene {
    /// The model with its samples at rest: their normals, spacing, neighbours, and the triangles between
    /// them.
    pub sampled: Arc<SampledModel>,
    /// Where the samples are.
    pub positions: Arc<[Vec3]>,
    /// Unit normals there.
    pub normals: Arc<[Vec3]>,
    /// What a circle of radius 1 around each sample at rest becomes, in the tangent plane there: half axes of an
    /// ellipse, the longer one first. Empty where nothing has moved.
    pub axes: Arc<[[Vec3; 2]]>,
    /// How each step fared, in their order.
    pub statuses: Vec<(StepId, Status)>,
    /// What each step began with: see [`Evaluated::before`].
    pub before: Vec<Arc<[Vec3]>>,
    /// The handles that the steps' plugins placed, at rest.
    pub handles: HashMap<StepId, Arc<OwnHandles>>,
    /// What it was worth: a draft may differ a little from the result.
    pub effort: Effort,
    /// The transfer error to be expected around each sample, local units, if it was asked for.
    pub expected_error: Option<Vec<f32>>,
    /// Counts up with every scene that is shown.
    pub revision: u64,
}

impl Scene {
    /// Of samples that the steps have moved.
    pub(crate) fn new(evaluated: Evaluated, evaluation: &Evaluation, effort: Effort, revision: u64) -> Self {
        let Evaluated { sampled, positions, statuses, before, .. } = evaluated;
        let handles = |(id, _): &(StepId, Status)| {
            let handles = evaluation.handles(*id).filter(|handles| !handles.descs.is_empty());
            handles.map(|handles| (*id, handles.clone()))
        };
        let handles = statuses.iter().filter_map(handles).collect();
        let (normals, axes) = turned(&sampled, &positions);
        Self {
            sampled,
            positions,
            normals,
            axes,
            statuses,
            before,
            handles,
            effort,
            expected_error: None,
            revision,
        }
    }

    /// The same, with the error to be expected, which takes as long as preparing to write.
    pub(crate) fn measured(self) -> Self {
        let still = *self.positions == *self.sampled.samples.positions;
        let expected = if still {
            vec![0.0; self.len()]
        } else {
            let around = RestGeometry::new(&self.sampled.samples);
            DeformationField::new(&around, &self.positions, Method::default()).expected_error()
        };
        Self { expected_error: Some(expected), ..self }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Never: a model has at least one sample.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The map between local coordinates and the model's.
    pub fn frame(&self) -> Frame {
        self.sampled.frame
    }

    /// Smallest and largest local coordinates of the samples as they are.
    pub fn bounds(&self) -> [Vec3; 2] {
        let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        self.positions.iter().fold(start, |[min, max], p| [min.min(*p), max.max(*p)])
    }
}

/// How many of the first samples are the same in two samplings of a model: all but those that refinements
/// appended to one of both.
pub fn common(a: &SampledModel, b: &SampledModel) -> usize {
    let (p, q) = (&a.samples.positions, &b.samples.positions);
    if std::ptr::eq(a, b) { p.len() } else { p.iter().zip(q).take_while(|(p, q)| p == q).count() }
}

/// The samples' normals, turned as the triangles between each and its nearest neighbours are: `Σ (r₁ × r₂ ·
/// n) d₁ × d₂` over pairs of neighbours, where `r` are the ways to them at rest and `d` those now. With
/// tangents `s × t = n` that is `(Σ (r·s) d) × (Σ (r·t) d)`. And what becomes of a circle around each: the ellipse
/// of the linear map that carries these ways over best. Quick, and for the eye alone.
fn turned(sampled: &SampledModel, positions: &[Vec3]) -> (Arc<[Vec3]>, Arc<[[Vec3; 2]]>) {
    let (samples, rest) = (&sampled.samples, &sampled.samples.positions);
    samples.prepare();
    if *positions == **rest {
        return (samples.normals().into(), Arc::default());
    }
    let (neighbours, normals) = (samples.neighbours(), samples.normals());
    let of = |(i, n): (usize, &Vec3)| {
        let (s, t) = n.any_orthonormal_pair();
        let (mut along_s, mut along_t) = (Vec3::ZERO, Vec3::ZERO);
        let (mut ss, mut st, mut tt) = (0.0, 0.0, 0.0);
        let (mut more_s, mut more_t) = (Vec3::ZERO, Vec3::ZERO);
        for &j in &neighbours.nearest_to(i)[..RING.min(neighbours.k())] {
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
        let normal = unit(along_s).cross(unit(along_t)).try_normalize().unwrap_or(*n);
        let determinant = ss * tt - st * st;
        let map = if determinant > 1e-3 * ss * tt {
            [s + (tt * more_s - st * more_t) / determinant, t + (ss * more_t - st * more_s) / determinant]
        } else {
            [s, t]
        };
        (normal, ellipse(map, normal))
    };
    // Written where they stay: a million samples have 36 MB of them, in each picture of a drag.
    let mut turned: Arc<[Vec3]> = repeat_n(Vec3::ZERO, normals.len()).collect();
    let mut axes: Arc<[[Vec3; 2]]> = repeat_n([Vec3::ZERO; 2], normals.len()).collect();
    if let (Some(turned), Some(axes)) = (Arc::get_mut(&mut turned), Arc::get_mut(&mut axes)) {
        let all = turned.par_iter_mut().zip(axes).enumerate().with_min_len(LEAST_TOGETHER);
        all.for_each(|(i, (normal, axes))| (*normal, *axes) = of((i, &normals[i])));
    }
    (turned, axes)
}

/// Half axes of what a circle of radius 1 becomes, by where a linear map takes two of its radii at right angles;
/// in the plane of a normal, and within bounds that can be drawn.
fn ellipse(radii: [Vec3; 2], normal: Vec3) -> [Vec3; 2] {
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

/// Sine and cosine of half the angle of a point, which is between a quarter turn to either side: there is one for
/// each sample in each picture, and arc tangents take long.
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
