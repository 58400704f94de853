//! The part of a step that the gizmo moves, and the changes that bring it elsewhere.

use glam::{DAffine3, DVec3};
use simod_session::edit::{Change, StepId};
use simod_viewer::held::GrabbedHandles;
use simod_viewer::motion::{PlacedHandle, motion_of};

/// Part of the chosen step that the gizmo moves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MovedPart {
    /// A handle region, by its place among the regions.
    Region(usize),
    /// A handle that the plugin placed, by its id.
    Handle(String),
}

/// Part that the gizmo moves, with its place.
#[derive(Clone)]
pub struct GizmoTarget {
    /// Place and id of the part's step.
    pub step: usize,
    pub id: StepId,
    pub target: MovedPart,
    /// Place of the part, from its own coordinates to model coordinates.
    pub matrix: DAffine3,
    pub kind: MovedKind,
    /// Motions that the part allows.
    pub can: simod_plugin_api::Gizmo,
}

/// The kind of thing that the gizmo moves.
#[derive(Clone)]
pub enum MovedKind {
    /// A region, which turns about its pivot: model coordinates.
    Region { pivot: DVec3 },
    /// A handle that the plugin placed.
    Handle(PlacedHandle),
}

/// Several handles, as they were when the hand took them, and the gizmo's place then.
pub struct Several {
    pub held: GrabbedHandles,
    pub from: DAffine3,
}

impl Several {
    /// Change that moves the handles along with the gizmo to this place.
    pub fn change_to(&self, matrix: DAffine3) -> Option<Change> {
        let map = matrix * self.from.inverse();
        let pivot = self.held.pivot();
        let there = DAffine3 { translation: map.transform_point3(pivot), ..map };
        self.held.moved(&motion_of(there, pivot)?).map(Change::MoveHandles)
    }
}

impl GizmoTarget {
    /// Change that brings the part to the place of its gizmo.
    pub fn change_to(&self, matrix: DAffine3) -> Option<Change> {
        Some(match (&self.kind, &self.target) {
            (MovedKind::Region { pivot }, MovedPart::Region(region)) => {
                Change::MoveRegion { region: *region, motion: motion_of(matrix, *pivot)? }
            }
            (MovedKind::Handle(placed), MovedPart::Handle(id)) => {
                Change::MoveHandle { id: id.clone(), motion: placed.motion_to(matrix)? }
            }
            _ => return None,
        })
    }
}
