//! Points between which lengths and angles are measured. The points are kept at rest, and go along with the
//! surface around them.

use crate::gradients::around;
use crate::pick::Hit;
use crate::scene::ViewerScene;
use glam::{DMat3, DVec3, Mat3};

/// Number of neighbours of the nearest sample by which a point is carried.
const RING: usize = 8;
/// Greatest number of Newton steps to the point that is carried to another one.
const MOST_STEPS: usize = 12;

/// Point of the surface between which and others is measured, in model coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredPoint {
    /// The place before all steps.
    pub rest: DVec3,
    /// The place after all steps.
    pub now: DVec3,
}

/// A length or an angle that is measured, after the steps and before them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// The number after the steps.
    pub now: f64,
    /// Number before the steps.
    pub rest: f64,
}

impl Measure {
    fn compute(of: impl Fn(&dyn Fn(&MeasuredPoint) -> DVec3) -> f64) -> Self {
        Self { now: of(&|point| point.now), rest: of(&|point| point.rest) }
    }

    /// Whether the steps have changed the measure by more than rounding.
    pub fn is_changed(&self) -> bool {
        (self.now - self.rest).abs() > 1e-5 * self.now.abs().max(self.rest.abs())
    }
}

/// The distance of two points, in the model's unit.
pub fn distance(a: &MeasuredPoint, b: &MeasuredPoint) -> Measure {
    Measure::compute(|at| at(a).distance(at(b)))
}

/// The angle at the second of three points, in degrees; 0 where two of them are one.
pub fn angle(a: &MeasuredPoint, b: &MeasuredPoint, c: &MeasuredPoint) -> Measure {
    Measure::compute(|at| {
        let (u, v) = (at(a) - at(b), at(c) - at(b));
        // The angle by its tangent is exact for small angles, too, where the cosine alone is not.
        f64::atan2(u.cross(v).length(), u.dot(v)).to_degrees()
    })
}

/// Linear map of the surface around a sample, and along its normal.
fn map(scene: &ViewerScene, sample: usize) -> DMat3 {
    let normal = scene.sampled.samples.normals()[sample];
    let Some(along) = around(scene, sample) else { return DMat3::IDENTITY };
    // The neighbours do not determine the map along the normal: there it turns as the normal does.
    let change = scene.normals()[sample] - along * normal;
    let across = Mat3::from_cols(change * normal.x, change * normal.y, change * normal.z);
    let map = (along + across).as_dmat3();
    if map.is_finite() && map.determinant().abs() > 1e-6 { map } else { DMat3::IDENTITY }
}

/// Deformed position of a point, in local coordinates: the mean of the positions by the samples around it,
/// which count the less the farther they are; and the linear map of the nearest sample.
fn carry(scene: &ViewerScene, rest: DVec3) -> (DVec3, DMat3) {
    let samples = &scene.sampled.samples;
    let nearest = samples.nearest(rest.as_vec3()) as usize;
    let neighbours = samples.neighbours();
    let around = &neighbours.nearest_to(nearest)[..RING.min(neighbours.k())];
    let all = || std::iter::once(nearest).chain(around.iter().map(|i| *i as usize));
    let way = |i: usize| rest - samples.positions[i].as_dvec3();
    let reach = all().map(|i| way(i).length_squared()).fold(0.0, f64::max);
    let (mut sum, mut to) = (0.0, DVec3::ZERO);
    for i in all() {
        let share = 1.0 - way(i).length_squared() / reach;
        // The nearest sample counts, also where there is no other.
        let weight = if reach > 0.0 { share * share } else { 0.0 } + if i == nearest { 1e-9 } else { 0.0 };
        let displacement = scene.positions[i].as_dvec3() - samples.positions[i].as_dvec3();
        to += weight * (displacement + map(scene, i) * way(i) - way(i));
        sum += weight;
    }
    (rest + to / sum, map(scene, nearest))
}

/// Place before all steps of a point that is seen, in model coordinates: the point that is [carried](carry)
/// to the seen one, by Newton steps from the place by its own sample.
pub(crate) fn at_rest(scene: &ViewerScene, hit: &Hit) -> DVec3 {
    let sample = hit.sample as usize;
    let way = hit.local - scene.positions[sample].as_dvec3();
    let mut rest = scene.sampled.samples.positions[sample].as_dvec3() + map(scene, sample).inverse() * way;
    let mut best = (f64::INFINITY, rest);
    for _ in 0..MOST_STEPS {
        let (to, map) = carry(scene, rest);
        let off = hit.local - to;
        if off.length() < best.0 {
            best = (off.length(), rest);
        }
        if off.length() < 1e-9 {
            break;
        }
        rest += map.inverse() * off;
    }
    scene.frame().to_model_exact(best.1)
}

/// Point at rest with its place after the steps.
pub(crate) fn carried(scene: &ViewerScene, rest: DVec3) -> MeasuredPoint {
    let (to, _) = carry(scene, scene.frame().to_local_exact(rest));
    MeasuredPoint { rest, now: scene.frame().to_model_exact(to) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_angles_are_those_of_both_shapes() {
        let point = |rest: [f64; 3], now: [f64; 3]| MeasuredPoint { rest: rest.into(), now: now.into() };
        let a = point([3.0, 0.0, 0.0], [6.0, 0.0, 0.0]);
        let b = point([0.0; 3], [0.0; 3]);
        let c = point([0.0, 4.0, 0.0], [4.0, 4.0, 0.0]);
        assert_eq!(distance(&a, &c).rest, 5.0);
        assert_eq!(distance(&a, &b), Measure { now: 6.0, rest: 3.0 });
        let corner = angle(&a, &b, &c);
        assert!((corner.rest - 90.0).abs() < 1e-12 && (corner.now - 45.0).abs() < 1e-12);
        assert!(corner.is_changed() && !distance(&b, &b).is_changed());
        assert_eq!(angle(&b, &b, &c).rest, 0.0);
        // The three points lie nearly on a line.
        let near = point([1e9, 1e-3, 0.0], [0.0; 3]);
        assert!((angle(&near, &b, &a).rest.to_radians() * 1e12 - 1.0).abs() < 1e-9);
    }
}
