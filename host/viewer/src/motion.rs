//! Motions of handles as a gizmo has them: a matrix that turns, scales and places the gizmo about the
//! handle's pivot.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use simod_model::frame::Frame;
use simod_plugin_api::HandleDesc;
use simod_session::Motion;
use simod_session::step::HandleMove;

/// Gizmo of a handle region, in model coordinates: moved, turned and scaled as the region is, from this
/// pivot, whatever the motion's own pivot is.
pub fn handle_matrix(motion: &Motion, pivot: DVec3) -> DAffine3 {
    let map = motion.to_affine(DVec3::ZERO);
    DAffine3 { matrix3: map.matrix3, translation: map.transform_point3(pivot) }
}

/// Motion of a handle whose gizmo was at the pivot, unturned and of size 1, and has this matrix now. Scales
/// along axes become their mean: a motion scales all directions alike.
///
/// Nothing where the matrix is no motion: the matrix mirrors, flattens, or has numbers that are not finite.
pub fn motion_of(matrix: DAffine3, pivot: DVec3) -> Option<Motion> {
    let determinant = matrix.matrix3.determinant();
    if !(determinant.is_normal() && determinant > 0.0 && matrix.translation.is_finite()) {
        return None;
    }
    let scale = determinant.cbrt();
    let turn = DQuat::from_mat3(&orthonormal(matrix.matrix3)?).normalize();
    let (axis, angle) = turn.to_axis_angle();
    // The turn is at most half a turn, as a person would say it.
    let (axis, angle) =
        if angle > std::f64::consts::PI { (-axis, std::f64::consts::TAU - angle) } else { (axis, angle) };
    let still = angle.abs() < 1e-12;
    let none = Motion::default();
    let motion = Motion {
        translate: matrix.translation - pivot,
        axis: if still { none.axis } else { axis },
        degrees: if still { 0.0 } else { angle.to_degrees() },
        pivot: Some(pivot),
        scale: if (scale - 1.0).abs() < 1e-12 { 1.0 } else { scale },
    };
    motion.defect().is_none().then_some(motion)
}

/// The axes of a matrix, made of length 1 and at right angles.
fn orthonormal(m: DMat3) -> Option<DMat3> {
    let x = m.x_axis.try_normalize()?;
    let z = x.cross(m.y_axis).try_normalize()?;
    Some(DMat3::from_cols(x, z.cross(x), z))
}

/// Places of the handles that a plugin placed, in model coordinates and the plugin's order: each is moved
/// by its own motion, and by those of its ancestors.
pub fn placed_handles(handles: &[HandleDesc], moves: &[HandleMove], frame: &Frame) -> Vec<PlacedHandle> {
    let mut placed: Vec<PlacedHandle> = Vec::with_capacity(handles.len());
    for handle in handles {
        let rest = frame.to_model_exact(DVec3::from(handle.position));
        let parent = placed.get(handle.parent as usize).map_or(DAffine3::IDENTITY, |p| p.map);
        let own = moves.iter().find(|m| handle.id == m.id.as_str()).map(|m| m.motion.to_affine(rest));
        placed.push(PlacedHandle { rest, parent, map: own.map_or(parent, |own| parent * own) });
    }
    placed
}

/// A handle that a plugin placed, at its place in the model's coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedHandle {
    /// The handle's place at rest.
    pub rest: DVec3,
    /// Map of the handle's ancestors.
    pub parent: DAffine3,
    /// Map from the rest pose to the present one.
    pub map: DAffine3,
}

impl PlacedHandle {
    /// The handle's place now.
    pub fn position(&self) -> DVec3 {
        self.map.transform_point3(self.rest)
    }

    /// Matrix of the handle's gizmo: its place and orientation.
    pub fn matrix(&self) -> DAffine3 {
        DAffine3 { matrix3: self.map.matrix3, translation: self.position() }
    }

    /// The handle's own motion, if its gizmo has this matrix now; see [`motion_of`].
    pub fn motion_to(&self, matrix: DAffine3) -> Option<Motion> {
        let motion = motion_of(self.parent.inverse() * matrix, self.rest)?;
        // The pivot is the place at rest, as in a session that names none.
        Some(Motion { pivot: None, ..motion })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-10.0..10.0_f64).prop_map(DVec3::from)
    }

    fn motion() -> impl Strategy<Value = Motion> {
        (vector(), vector(), -179.0..179.0_f64, vector(), 0.1..10.0_f64).prop_map(
            |(translate, axis, degrees, pivot, scale)| Motion {
                translate,
                axis: axis.try_normalize().unwrap_or(DVec3::X),
                degrees,
                pivot: Some(pivot),
                scale,
            },
        )
    }

    proptest! {
        #[test]
        fn a_gizmo_gives_the_motion_that_it_was_made_of(motion in motion(), p in vector()) {
            let pivot = motion.pivot.unwrap();
            let back = motion_of(handle_matrix(&motion, pivot), pivot).unwrap();
            let (a, b) = (motion.to_affine(pivot), back.to_affine(pivot));
            prop_assert!(a.transform_point3(p).abs_diff_eq(b.transform_point3(p), 1e-9));
            prop_assert!((back.scale - motion.scale).abs() < 1e-12 * motion.scale.max(1.0));
            prop_assert!((back.degrees.abs() - motion.degrees.abs()).abs() < 1e-6);
        }
    }

    #[test]
    fn single_changes_are_exact() {
        let pivot = DVec3::new(1e6, -3.0, 0.5);
        let rest = handle_matrix(&Motion::default(), pivot);
        let still = motion_of(rest, pivot).unwrap();
        assert_eq!(still, Motion { pivot: Some(pivot), ..Motion::default() });
        let moved = DAffine3 { translation: rest.translation + DVec3::X, ..rest };
        assert_eq!(motion_of(moved, pivot).unwrap(), Motion { translate: DVec3::X, ..still });
        let scaled = DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(8.0)), ..rest };
        assert_eq!(motion_of(scaled, pivot).unwrap(), Motion { scale: 8.0, ..still });
        let quarter = DAffine3 { matrix3: DMat3::from_rotation_z(std::f64::consts::FRAC_PI_2), ..rest };
        let turned = motion_of(quarter, pivot).unwrap();
        assert!((turned.degrees - 90.0).abs() < 1e-12 && turned.axis.abs_diff_eq(DVec3::Z, 1e-12));
    }

    #[test]
    fn what_is_no_motion_gives_none() {
        for scale in [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(0.0, 1.0, 1.0), DVec3::NAN] {
            let matrix3 = DMat3::from_diagonal(scale);
            assert!(motion_of(DAffine3 { matrix3, translation: DVec3::ZERO }, DVec3::ZERO).is_none());
        }
    }

    #[test]
    fn handles_follow_what_they_hang_on() {
        let frame = Frame { origin: DVec3::Y, scale: 2.0 };
        let handles = [HandleDesc::new("arm", [0.0; 3]), HandleDesc::new("hand", [1.0, 0.0, 0.0]).parent(0)];
        let turn = Motion { axis: DVec3::Z, degrees: 90.0, ..Motion::default() };
        let moves = [HandleMove { id: "arm".into(), motion: turn }];
        let placed = placed_handles(&handles, &moves, &frame);
        assert!(placed[1].position().abs_diff_eq(DVec3::new(0.0, 3.0, 0.0), 1e-12));
        // The hand is dragged back to its former place: its own motion undoes the arm's.
        let back = DAffine3 { translation: DVec3::new(2.0, 1.0, 0.0), ..placed[1].matrix() };
        let motion = placed[1].motion_to(back).unwrap();
        let moves = [moves[0].clone(), HandleMove { id: "hand".into(), motion }];
        let again = placed_handles(&handles, &moves, &frame);
        assert!(again[1].position().abs_diff_eq(back.translation, 1e-12));
        assert!(again[1].matrix().abs_diff_eq(back, 1e-12));
    }
}
