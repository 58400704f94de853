//! The gesture that the pointer has begun with a tool, and has not ended yet.

use super::place::Several;
use super::transforming::Transforming;

/// Gestures that the pointer has begun, of each tool. The tool that works has its gesture for itself
/// meanwhile.
#[derive(Default)]
pub struct Gesture {
    /// A motion by keys.
    pub transforming: Option<Transforming>,
    /// Pixels that the pointer went along, while a selection or a stroke is drawn.
    pub path: Vec<[f64; 2]>,
    /// Whether the button is held that paints, wherever the button was pressed.
    pub painting: bool,
    /// Beginning of the drag of a chain of joints, in pixels.
    pub chain_from: Option<[f64; 2]>,
    /// Place among the measured points of the one that is held.
    pub measured_point: Option<usize>,
    /// The plane of a step's axis that is held, and whether it was moved.
    pub plane: Option<usize>,
    pub drags_plane: bool,
    /// The gizmo, whether it moves something just now, and the handles that move along.
    pub gizmo: transform_gizmo::Gizmo,
    pub dragging: bool,
    pub several: Option<Several>,
}

impl Gesture {
    /// Whether something is being dragged.
    pub fn is_dragging(&self) -> bool {
        self.transforming.is_some()
            || self.dragging
            || self.painting
            || self.plane.is_some()
            || self.measured_point.is_some()
            || !self.path.is_empty()
    }

    /// Lets go of all that is held; the gizmo stays as it was drawn last.
    pub fn reset(&mut self) {
        *self = Self { gizmo: std::mem::take(&mut self.gizmo), ..Self::default() };
    }
}
