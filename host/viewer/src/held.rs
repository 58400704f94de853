//! Handles that a hand holds: several that a plugin placed, moved together, and those around them that go
//! along.

use crate::motion::{PlacedHandle, motion_of};
use crate::skeleton::is_pin;
use glam::{DAffine3, DVec3};
use simod_plugin_api::{Gizmo, HandleDesc};
use simod_session::Motion;
use simod_session::step::HandleMove;
use std::collections::BTreeSet;

/// Handles as they were when a hand took them.
#[derive(Debug, Clone, PartialEq)]
pub struct GrabbedHandles {
    handles: Vec<HeldHandle>,
    pivot: DVec3,
}

#[derive(Debug, Clone, PartialEq)]
struct HeldHandle {
    id: String,
    placed: PlacedHandle,
    can: Gizmo,
    /// Weight of the hand's motion: 1 for the handles that are held, less for those around them.
    weight: f64,
}

impl GrabbedHandles {
    /// Takes the handles that were `chosen`, by their ids; other handles that are nearer to one of them
    /// than `reach` go along, the less the farther they are. A chosen handle below another chosen one goes
    /// with that, and is not held itself; of the others, pins and handles with a parent do not go along by
    /// themselves. Nothing where none of the chosen ones is there. Lengths are of the model.
    pub fn new(all: &[(HandleDesc, PlacedHandle)], chosen: &BTreeSet<String>, reach: f64) -> Option<Self> {
        let is_chosen = |(desc, _): &(HandleDesc, PlacedHandle)| chosen.contains(desc.id.as_str());
        let places: Vec<DVec3> = all.iter().filter(|h| is_chosen(h)).map(|(_, h)| h.position()).collect();
        if places.is_empty() {
            return None;
        }
        let pivot = places.iter().sum::<DVec3>() / places.len() as f64;
        let mut handles = Vec::new();
        for (i, handle) in all.iter().enumerate() {
            let weight = if is_chosen(handle) {
                if above(all, i).any(is_chosen) { 0.0 } else { 1.0 }
            } else if above(all, i).next().is_some() || is_pin(&handle.0.id) {
                0.0
            } else {
                falloff(&places, handle.1.position(), reach)
            };
            if weight > 0.0 {
                let (desc, placed) = handle;
                handles.push(HeldHandle {
                    id: desc.id.to_string(),
                    placed: *placed,
                    can: desc.gizmo,
                    weight,
                });
            }
        }
        Some(Self { handles, pivot })
    }

    /// Middle of the chosen handles.
    pub fn pivot(&self) -> DVec3 {
        self.pivot
    }

    /// Motions of the handles where the hand moves so from where it took them, about [the
    /// middle](Self::pivot) unless the motion says otherwise. Nothing where the result is no motion for one
    /// of the handles.
    pub fn moved(&self, motion: &Motion) -> Option<Vec<HandleMove>> {
        let moved = |handle: &HeldHandle| {
            let map = part_of(motion, handle.weight).to_affine(self.pivot);
            let from = handle.placed.matrix();
            let mut to = map * from;
            // A turn or scale that a handle does not allow is left out of its own motion: the handle goes
            // where the others take it, as it is.
            let turned = motion_of(DAffine3 { translation: DVec3::ZERO, ..map }, DVec3::ZERO)?;
            let keeps_turn = !handle.can.contains(Gizmo::ROTATE);
            let keeps_size = !handle.can.contains(Gizmo::SCALE);
            let own = Motion {
                degrees: if keeps_turn { 0.0 } else { turned.degrees },
                scale: if keeps_size { 1.0 } else { turned.scale },
                pivot: None,
                ..turned
            };
            to.matrix3 = own.to_affine(DVec3::ZERO).matrix3 * from.matrix3;
            Some(HandleMove { id: handle.id.clone(), motion: handle.placed.motion_to(to)? })
        };
        self.handles.iter().map(moved).collect()
    }
}

/// Ancestors of a handle, one after the other.
fn above(
    all: &[(HandleDesc, PlacedHandle)],
    from: usize,
) -> impl Iterator<Item = &(HandleDesc, PlacedHandle)> {
    // Each handle's parent comes before it.
    let next = |at: usize| Some(all[at].0.parent as usize).filter(|parent| *parent < at);
    std::iter::successors(next(from), move |at| next(*at)).map(|at| &all[at])
}

/// Weight of a point: 1 at the nearest of some places, 0 from `reach` on, smooth at both ends.
fn falloff(places: &[DVec3], p: DVec3, reach: f64) -> f64 {
    let nearest = places.iter().map(|place| place.distance(p)).fold(f64::INFINITY, f64::min);
    if nearest >= reach {
        return 0.0;
    }
    let x = nearest / reach;
    (1.0 - x * x) * (1.0 - x * x)
}

/// A part of a motion: none of it at 0, all of it at 1.
fn part_of(motion: &Motion, weight: f64) -> Motion {
    Motion {
        translate: motion.translate * weight,
        degrees: motion.degrees * weight,
        scale: motion.scale.powf(weight),
        ..*motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::placed_handles;
    use simod_model::frame::Frame;

    const FRAME: Frame = Frame { origin: DVec3::ZERO, scale: 1.0 };

    fn chosen(ids: &[&str]) -> BTreeSet<String> {
        ids.iter().map(|id| (*id).to_owned()).collect()
    }

    fn with_places(handles: &[HandleDesc], moves: &[HandleMove]) -> Vec<(HandleDesc, PlacedHandle)> {
        handles.iter().cloned().zip(placed_handles(handles, moves, &FRAME)).collect()
    }

    fn positions(handles: &[HandleDesc], moves: &[HandleMove]) -> Vec<DVec3> {
        placed_handles(handles, moves, &FRAME).iter().map(PlacedHandle::position).collect()
    }

    /// A row of points, a unit from each other.
    fn row(count: usize, can: Gizmo) -> Vec<HandleDesc> {
        let one =
            |i: usize| HandleDesc { gizmo: can, ..HandleDesc::new(&i.to_string(), [i as f64, 0.0, 0.0]) };
        (0..count).map(one).collect()
    }

    #[test]
    fn several_turn_about_their_middle() {
        for can in [Gizmo::TRANSLATE, Gizmo(!0)] {
            let handles = row(4, can);
            let held = GrabbedHandles::new(&with_places(&handles, &[]), &chosen(&["0", "2"]), 0.0).unwrap();
            assert_eq!(held.pivot(), DVec3::X);
            let turn = Motion { axis: DVec3::Z, degrees: 90.0, ..Motion::default() };
            let moves = held.moved(&turn).unwrap();
            let to = positions(&handles, &moves);
            let expected = [DVec3::new(1.0, -1.0, 0.0), DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::X * 3.0];
            assert!(to.iter().zip(expected).all(|(a, b)| a.abs_diff_eq(b, 1e-12)), "{to:?}");
            let turned = if can == Gizmo::TRANSLATE { 0.0 } else { 90.0 };
            assert!(moves.iter().all(|m| (m.motion.degrees - turned).abs() < 1e-9), "{moves:?}");
            // The handles go on from there, as a hand takes them again.
            let again =
                GrabbedHandles::new(&with_places(&handles, &moves), &chosen(&["0", "2"]), 0.0).unwrap();
            let size = Motion { scale: 2.0, ..Motion::default() };
            let to = positions(&handles, &again.moved(&size).unwrap());
            assert!(to[0].abs_diff_eq(DVec3::new(1.0, -2.0, 0.0), 1e-9), "{to:?}");
        }
    }

    #[test]
    fn those_around_go_along_the_less_the_farther_they_are() {
        let handles = row(6, Gizmo::TRANSLATE);
        let held = GrabbedHandles::new(&with_places(&handles, &[]), &chosen(&["0"]), 3.0).unwrap();
        let up = Motion { translate: DVec3::Y, ..Motion::default() };
        let moves = held.moved(&up).unwrap();
        let heights: Vec<f64> = positions(&handles, &moves).iter().map(|p| p.y).collect();
        assert_eq!((heights[0], &heights[3..]), (1.0, &[0.0; 3][..]));
        assert!(heights[0] > heights[1] && heights[1] > heights[2] && heights[2] > 0.0, "{heights:?}");
        assert_eq!(moves.len(), 3, "what does not move is not told");
        let pinned: Vec<HandleDesc> = handles
            .iter()
            .enumerate()
            .map(|(i, handle)| HandleDesc {
                id: if i == 1 { "pin-1".into() } else { handle.id.clone() },
                ..handle.clone()
            })
            .collect();
        let held = GrabbedHandles::new(&with_places(&pinned, &[]), &chosen(&["0"]), 3.0).unwrap();
        assert_eq!(held.moved(&up).unwrap().len(), 2, "a pin stays");
    }

    #[test]
    fn what_hangs_on_another_goes_with_it_once() {
        let arm = HandleDesc { gizmo: Gizmo(!0), ..HandleDesc::new("arm", [0.0; 3]) };
        let hand = HandleDesc { gizmo: Gizmo(!0), ..HandleDesc::new("hand", [1.0, 0.0, 0.0]) }.parent(0);
        let handles = [arm, hand];
        let held = GrabbedHandles::new(&with_places(&handles, &[]), &chosen(&["arm", "hand"]), 10.0).unwrap();
        let moves = held.moved(&Motion { translate: DVec3::Y, ..Motion::default() }).unwrap();
        assert_eq!(moves.iter().map(|m| &*m.id).collect::<Vec<_>>(), ["arm"]);
        assert_eq!(positions(&handles, &moves), [DVec3::Y, DVec3::new(1.0, 1.0, 0.0)]);
        assert!(GrabbedHandles::new(&with_places(&handles, &[]), &chosen(&["leg"]), 1.0).is_none());
    }
}
