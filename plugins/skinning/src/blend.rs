//! Blend of the motions of several joints at a place that follows them.
//!
//! *Linear*: the mean of the images under each joint's motion. *Dual quaternions*: L. Kavan, S. Collins, J.
//! Žára, C. O'Sullivan, *Geometric skinning with approximate dual quaternion blending*, ACM TOG 27, 2008: the
//! mean of the joints' rigid motions as a rigid motion, which keeps volume. A joint's motion that scales is
//! split, as there, into two phases: the scaling about the joint is blended linearly, and then the rigid rest
//! by dual quaternions.
//!
//! A dual quaternion and its negative are the same motion, but not in a mean. Signs are chosen once for a
//! pose, each joint's such that it turns by less than half a turn against the one that it hangs on: choosing
//! them place by place, against the largest weight, tears the surface apart where the largest weight changes
//! and joints are half a turn from each other. Where no joint hangs on another, nothing else tells them: then
//! they are chosen so.

use crate::skeleton::Skeleton;
use glam::{DAffine3, DMat3, DQuat, DVec3, DVec4};
use simod_geometry::polar_rotation;
use simod_plugin_api::{PluginError, PluginResult};

/// Scales and shears below this are of rounding.
const RIGID: f64 = 1e-9;
/// Newton's method for rotations converges in less steps, or not at all.
const STEPS: usize = 60;
/// Change of an entry of a rotation at which the method has settled.
const SETTLED: f64 = 1e-15;

/// The blend of the joints' motions.
pub struct Blend {
    joints: Joints,
    /// Whether each joint moves at all.
    is_moved: Vec<bool>,
}

enum Joints {
    Linear(Vec<DAffine3>),
    Dual {
        motions: Vec<Dual>,
        /// Whether signs are chosen place by place.
        is_by_place: bool,
    },
}

/// Advice on a motion that mirrors or flattens.
pub const CANNOT: &str = "dual quaternions cannot do that: set `method` to \"linear\", or scale it less";

/// Whether a motion is one that dual quaternions cannot do.
pub fn mirrors(motion: &DAffine3) -> bool {
    rotation(motion.matrix3).is_none()
}

/// A joint's motion for dual quaternions.
struct Dual {
    /// The rigid part.
    real: DVec4,
    dual: DVec4,
    /// Stretch before the rigid part, less the identity, and the joint's place at rest, about which it is;
    /// `None` if the motion is rigid.
    stretch: Option<(DMat3, DVec3)>,
}

impl Blend {
    /// The mean of the images.
    pub fn linear(motions: Vec<DAffine3>) -> Self {
        Self { is_moved: moved(&motions), joints: Joints::Linear(motions) }
    }

    /// Dual quaternions.
    ///
    /// # Errors
    /// A motion mirrors, or flattens.
    pub fn dual_quaternion(motions: &[DAffine3], skeleton: &Skeleton) -> PluginResult<Self> {
        let mut duals: Vec<Dual> = Vec::with_capacity(motions.len());
        for (motion, joint) in motions.iter().zip(&skeleton.joints) {
            let Some(rotation) = rotation(motion.matrix3) else {
                let message = format!("the motion of the joint `{}` mirrors or flattens", joint.id);
                return Err(PluginError::input(message).hint(CANNOT));
            };
            let stretch = rotation.transpose() * motion.matrix3 - DMat3::IDENTITY;
            let is_rigid = stretch.to_cols_array().iter().all(|x| x.abs() <= RIGID);
            // The joint's own displacement is the same in both phases, as the first one leaves the joint in
            // its place.
            let turn = DQuat::from_mat3(&rotation);
            let real = DVec4::from(turn);
            let reference = joint.parent.map_or(DVec4::W, |p| duals[p].real);
            let real = if real.dot(reference) < 0.0 { -real } else { real };
            let shift = if is_rigid {
                motion.translation
            } else {
                motion.transform_point3(joint.at) - rotation * joint.at
            };
            let dual = DVec4::from(DQuat::from_vec4(shift.extend(0.0)) * DQuat::from_vec4(real)) * 0.5;
            duals.push(Dual { real, dual, stretch: (!is_rigid).then_some((stretch, joint.at)) });
        }
        Ok(Self {
            is_moved: moved(motions),
            joints: Joints::Dual { motions: duals, is_by_place: !skeleton.is_hierarchy() },
        })
    }

    /// Whether no joint moves.
    pub fn is_identity(&self) -> bool {
        !self.is_moved.contains(&true)
    }

    /// Image of a place that follows joints with these weights; exactly the place itself if none of them
    /// moves.
    pub fn apply(&self, p: DVec3, influences: impl Iterator<Item = (usize, f64)> + Clone) -> DVec3 {
        if influences.clone().all(|(joint, _)| !self.is_moved[joint]) {
            return p;
        }
        match &self.joints {
            // In displacements, as the weights' sum is rounded.
            Joints::Linear(motions) => influences
                .filter(|(joint, _)| self.is_moved[*joint])
                .fold(p, |q, (joint, weight)| q + weight * (motions[joint].transform_point3(p) - p)),
            Joints::Dual { motions, is_by_place } => dual_blend(motions, *is_by_place, p, influences),
        }
    }
}

fn moved(motions: &[DAffine3]) -> Vec<bool> {
    motions.iter().map(|m| *m != DAffine3::IDENTITY).collect()
}

fn dual_blend(
    duals: &[Dual],
    is_by_place: bool,
    p: DVec3,
    influences: impl Iterator<Item = (usize, f64)>,
) -> DVec3 {
    let (mut real, mut dual, mut stretched) = (DVec4::ZERO, DVec4::ZERO, p);
    let mut first = None;
    for (joint, weight) in influences {
        let Dual { real: r, dual: d, stretch } = &duals[joint];
        // The joint of the largest weight comes first.
        let first = *first.get_or_insert(joint);
        let sign = if is_by_place && r.dot(duals[first].real) < 0.0 { -1.0 } else { 1.0 };
        real += sign * weight * *r;
        dual += sign * weight * *d;
        if let Some((stretch, about)) = stretch {
            stretched += weight * (*stretch * (p - about));
        }
    }
    let length = real.length();
    // Opposite motions may cancel: then the motion is the first joint's, whose weight is the largest.
    if length < 1e-6
        && let Some(joint) = first
    {
        return rigid(duals[joint].real, duals[joint].dual, stretched);
    }
    rigid(real / length, dual / length, stretched)
}

/// A place moved by a dual quaternion.
fn rigid(real: DVec4, dual: DVec4, p: DVec3) -> DVec3 {
    let (r, d) = (real.truncate(), dual.truncate());
    let turned = p + 2.0 * r.cross(r.cross(p) + real.w * p);
    turned + 2.0 * (real.w * d - dual.w * r + r.cross(d))
}

/// The nearest rotation of a matrix; nothing if it mirrors or flattens.
fn rotation(matrix: DMat3) -> Option<DMat3> {
    let size = matrix.to_cols_array().iter().fold(0.0_f64, |a, x| a.max(x.abs()));
    let unit = matrix * size.recip();
    if !(size.is_finite() && unit.is_finite() && unit.determinant() > 1e-12) {
        return None;
    }
    Some(polar_rotation(unit, STEPS, SETTLED)).filter(DMat3::is_finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn two_joints() -> Skeleton {
        use simod_plugin_api::Joint;
        let joints = [Joint::new("a", [0.0; 3], Joint::ROOT), Joint::new("b", [1.0, 0.0, 0.0], 0)];
        Skeleton::new(&[&joints[..], &[Joint::new("tip", [2.0, 0.0, 0.0], 1)]].concat()).unwrap()
    }

    fn dual(a: DAffine3, b: DAffine3) -> Blend {
        Blend::dual_quaternion(&[a, b], &two_joints()).unwrap()
    }

    fn turn(axis: DVec3, degrees: f64, about: DVec3) -> DAffine3 {
        DAffine3::from_translation(about)
            * DAffine3::from_axis_angle(axis.normalize_or(DVec3::X), degrees.to_radians())
            * DAffine3::from_translation(-about)
    }

    #[test]
    fn a_twist_keeps_the_radius_and_a_linear_one_does_not() {
        let p = DVec3::new(0.5, 0.2, 0.0);
        let both = [(0, 0.5), (1, 0.5)];
        let b = turn(DVec3::X, 170.0, DVec3::ZERO);
        let q = dual(DAffine3::IDENTITY, b).apply(p, both.into_iter());
        let half = turn(DVec3::X, 85.0, DVec3::ZERO).transform_point3(p);
        assert!(q.distance(half) < 1e-12, "{q} is not {half}");
        let q = Blend::linear(vec![DAffine3::IDENTITY, b]).apply(p, both.into_iter());
        assert!(q.y.hypot(q.z) < 0.02, "the candy wrapper: {q}");
    }

    /// Two turns by 100° each: the whole is less the other way round, but the limb was not turned so.
    #[test]
    fn signs_follow_the_skeleton() {
        let chain = [turn(DVec3::X, 100.0, DVec3::ZERO), turn(DVec3::X, 200.0, DVec3::ZERO)];
        let q = dual(chain[0], chain[1]).apply(DVec3::Y, [(0, 0.5), (1, 0.5)].into_iter());
        assert!(q.distance(turn(DVec3::X, 150.0, DVec3::ZERO).transform_point3(DVec3::Y)) < 1e-12, "{q}");
    }

    /// By -100° and 100°: without a hierarchy, they meet on the shorter way.
    #[test]
    fn signs_are_chosen_by_place_without_a_hierarchy() {
        let motions = [-100.0, 100.0].map(|degrees| turn(DVec3::X, degrees, DVec3::ZERO));
        let apart = two_joints().taken_apart();
        assert!(!apart.is_hierarchy());
        let lone = Skeleton::new(&[
            simod_plugin_api::Joint::new("a", [0.0; 3], simod_plugin_api::Joint::ROOT),
            simod_plugin_api::Joint::new("b", [1.0, 0.0, 0.0], simod_plugin_api::Joint::ROOT),
        ])
        .unwrap();
        let blend = Blend::dual_quaternion(&motions, &lone).unwrap();
        let q = blend.apply(DVec3::Y, [(0, 0.5), (1, 0.5)].into_iter());
        assert!(q.distance(-DVec3::Y) < 1e-12, "{q}");
    }

    #[test]
    fn what_mirrors_or_flattens_is_refused() {
        for scale in [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(1.0, 0.0, 1.0), DVec3::ZERO] {
            let motions = [DAffine3::IDENTITY, DAffine3::from_scale(scale)];
            let error = Blend::dual_quaternion(&motions, &two_joints()).err().unwrap();
            assert!(
                error.message.contains("`b` mirrors or flattens") && error.hint.contains("linear"),
                "{error}"
            );
        }
    }

    proptest! {
        /// Places move as all joints do, where these do the same: also if it scales and shears.
        #[test]
        fn common_motions_are_met(
            m in prop::array::uniform9(-0.3..0.3_f64), t in prop::array::uniform3(-2.0..2.0_f64),
            axis in prop::array::uniform3(-1.0..1.0_f64), degrees in -180.0..180.0_f64,
            p in prop::array::uniform3(-1.0..1.0_f64), w in 0.0..1.0_f64,
        ) {
            let scale = DMat3::IDENTITY + DMat3::from_cols_array(&m);
            let motion = DAffine3::from_translation(t.into())
                * turn(DVec3::from(axis) + 1e-3, degrees, DVec3::ZERO)
                * DAffine3::from_mat3(scale);
            prop_assume!(scale.determinant() > 0.05);
            let p = DVec3::from(p);
            let q = dual(motion, motion).apply(p, [(0, w), (1, 1.0 - w)].into_iter());
            prop_assert!(q.distance(motion.transform_point3(p)) < 1e-9, "{}", q);
        }
    }
}
