//! Motions of handles.

use crate::vector::maybe_three;
use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};
use simod_model::frame::Frame;

/// A similarity of space: scaled and turned about a pivot, then translated. Model coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "MotionTable", into = "MotionTable")]
pub struct Motion {
    /// The translation, in the model's unit.
    pub translate: DVec3,
    /// Axis of the rotation; of any length but zero where there is a rotation.
    pub axis: DVec3,
    /// The angle, right-handed.
    pub degrees: f64,
    /// Point that rotation and scaling leave in place. Unless given, it is the model's own zero for a region,
    /// and the place at rest for a handle that a plugin placed.
    pub pivot: Option<DVec3>,
    /// Size after over size before; positive.
    pub scale: f64,
}

/// Motion as files have it: only what differs from no motion.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct MotionTable {
    #[serde(default, deserialize_with = "maybe_three", skip_serializing_if = "Option::is_none")]
    translate: Option<DVec3>,
    #[serde(default, deserialize_with = "maybe_three", skip_serializing_if = "Option::is_none")]
    axis: Option<DVec3>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    degrees: Option<f64>,
    #[serde(default, deserialize_with = "maybe_three", skip_serializing_if = "Option::is_none")]
    pivot: Option<DVec3>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
}

impl From<MotionTable> for Motion {
    fn from(table: MotionTable) -> Self {
        let none = Self::default();
        Self {
            translate: table.translate.unwrap_or(none.translate),
            axis: table.axis.unwrap_or(none.axis),
            degrees: table.degrees.unwrap_or(none.degrees),
            pivot: table.pivot,
            scale: table.scale.unwrap_or(none.scale),
        }
    }
}

impl From<Motion> for MotionTable {
    fn from(motion: Motion) -> Self {
        let none = Motion::default();
        let Motion { translate, axis, degrees, pivot, scale } = motion;
        let turns = degrees != none.degrees || axis != none.axis;
        Self {
            translate: Some(translate).filter(|translate| *translate != none.translate),
            axis: Some(axis).filter(|_| turns),
            degrees: Some(degrees).filter(|_| turns),
            pivot,
            scale: Some(scale).filter(|scale| *scale != none.scale),
        }
    }
}

impl Default for Motion {
    fn default() -> Self {
        Self { translate: DVec3::ZERO, axis: DVec3::Y, degrees: 0.0, pivot: None, scale: 1.0 }
    }
}

impl Motion {
    /// Defect of the motion, if it has one.
    pub fn defect(&self) -> Option<&'static str> {
        let Self { translate, axis, degrees, pivot, scale } = *self;
        if !(translate.is_finite() && axis.is_finite() && pivot.is_none_or(DVec3::is_finite)) {
            Some("a move has a coordinate that is no finite number")
        } else if !(degrees.is_finite() && scale.is_finite()) {
            Some("the degrees or the scale of a move are no finite number")
        } else if scale <= 0.0 {
            Some("the scale of a move is not positive")
        } else if degrees != 0.0 && axis.try_normalize().is_none() {
            Some("the axis of a move is zero")
        } else {
            None
        }
    }

    /// The map, in model coordinates, about `pivot` where the motion does not say which. Exactly the identity
    /// where nothing moves.
    pub fn to_affine(&self, pivot: DVec3) -> DAffine3 {
        let turn = match self.axis.try_normalize() {
            Some(axis) if self.degrees != 0.0 => DMat3::from_axis_angle(axis, self.degrees.to_radians()),
            _ => DMat3::IDENTITY,
        };
        let matrix3 = turn * self.scale;
        DAffine3 { matrix3, translation: about(matrix3, self.pivot.unwrap_or(pivot)) + self.translate }
    }
}

/// A map of model coordinates as one of local coordinates.
pub fn to_local(map: DAffine3, frame: &Frame) -> DAffine3 {
    let translation = (map.translation - about(map.matrix3, frame.origin)) / frame.scale;
    DAffine3 { translation, ..map }
}

/// The translation that makes `point` a fixed point of the matrix.
fn about(matrix: DMat3, point: DVec3) -> DVec3 {
    // Not `point - matrix * point`, which loses digits for points far away and matrices near the identity.
    (DMat3::IDENTITY - matrix) * point
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_and_scales_about_the_pivot_and_then_moves() {
        let motion = Motion {
            translate: DVec3::X,
            axis: DVec3::new(0.0, 0.0, 7.0),
            degrees: 90.0,
            pivot: Some(DVec3::new(1.0, 1.0, 0.0)),
            scale: 2.0,
        };
        let image = motion.to_affine(DVec3::ZERO).transform_point3(DVec3::new(2.0, 1.0, 5.0));
        assert!(image.abs_diff_eq(DVec3::new(2.0, 3.0, 10.0), 1e-12), "{image}");
        let origin = DVec3::new(1e6, -2e6, 3e5);
        let p = DVec3::new(1e6 + 3.0, -2e6, 3e5 + 1.0);
        let frame = Frame { origin, scale: 4.0 };
        let local = to_local(motion.to_affine(DVec3::ZERO), &frame).transform_point3(frame.to_local_exact(p));
        assert!(
            local.abs_diff_eq(frame.to_local_exact(motion.to_affine(DVec3::ZERO).transform_point3(p)), 1e-8)
        );
    }

    #[test]
    fn nothing_is_exactly_nothing() {
        let frame = Frame { origin: DVec3::ONE * 1e7, scale: 0.25 };
        let map = to_local(Motion::default().to_affine(DVec3::ONE), &frame);
        assert_eq!(map, DAffine3::IDENTITY);
    }

    #[test]
    fn defects_are_found() {
        let m = Motion::default();
        assert!(m.defect().is_none());
        assert!(Motion { axis: DVec3::ZERO, ..m }.defect().is_none());
        assert!(Motion { axis: DVec3::ZERO, degrees: 1.0, ..m }.defect().is_some());
        assert!(Motion { scale: 0.0, ..m }.defect().is_some());
        assert!(Motion { translate: DVec3::NAN, ..m }.defect().is_some());
    }
}
