//! The tool in the hand, its options, and the things that it moves.

use super::gesture::Gesture;
use super::place::MovedPart;
use eframe::egui::Modifiers;
use glam::DVec3;
use simod_session::edit::StepId;
use simod_viewer::selection::Combine;
use std::collections::BTreeSet;

/// Tool in the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "they say it")]
pub enum Tool {
    Orbit,
    Move,
    Rotate,
    Scale,
    Brush,
    Lasso,
    Box,
    Connected,
    Stroke,
    Joint,
    Measure,
}

impl Tool {
    /// The name that the user reads.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Orbit => "Look Around",
            Self::Move => "Move",
            Self::Rotate => "Rotate",
            Self::Scale => "Scale",
            Self::Brush => "Select by Brush",
            Self::Lasso => "Select by Lasso",
            Self::Box => "Select by Box",
            Self::Connected => "Select Connected",
            Self::Stroke => "Brush Stroke",
            Self::Joint => "Place Joints",
            Self::Measure => "Measure",
        }
    }

    /// Instruction for the tool's use.
    pub fn hint(self) -> &'static str {
        match self {
            Self::Orbit => "Drag to look around; click a handle to grab it.",
            Self::Move => "Click a handle, and drag its arrows.",
            Self::Rotate => "Click a handle, and drag its rings.",
            Self::Scale => "Click a handle, and drag its ring.",
            Self::Brush => "Paint over samples. Shift adds, Ctrl takes away. [ and ] change the size.",
            Self::Lasso => "Draw a line round samples. Shift adds, Ctrl takes away.",
            Self::Box => "Draw a box round samples. Shift adds, Ctrl takes away.",
            Self::Connected => "Click a part. Shift adds, Ctrl takes away.",
            Self::Stroke => "Paint on the surface. [ and ] change the size.",
            Self::Joint => {
                "Click to place a joint, drag to place a chain; it hangs on the one that is chosen."
            }
            Self::Measure => {
                "Click points on the surface to measure distances and angles. Drag one to move it."
            }
        }
    }

    /// Whether the tool moves handles.
    pub fn is_gizmo(self) -> bool {
        matches!(self, Self::Move | Self::Rotate | Self::Scale)
    }

    /// Whether the tool selects samples.
    pub fn selects(self) -> bool {
        matches!(self, Self::Brush | Self::Lasso | Self::Box | Self::Connected)
    }

    /// Whether a click with the tool takes a handle, and a drag moves the camera.
    pub fn grabs(self) -> bool {
        self.is_gizmo() || self == Self::Orbit
    }
}

/// The tools with their options, and the gesture that is going on.
pub struct Tools {
    /// Tool in the hand.
    pub tool: Tool,
    /// The part that the gizmo moves.
    pub target: Option<MovedPart>,
    /// Other handles of a step that are chosen besides a target; without meaning once the target is another
    /// one.
    pub others: Option<(StepId, MovedPart, BTreeSet<String>)>,
    /// Distance within which other handles go along with those that are moved, as a part of the model's
    /// diagonal; no handles go along at 0.
    pub reach: f64,
    /// Whether a box chooses handles instead of samples.
    pub boxes_handles: bool,
    /// A motion by keys that shall begin with the next picture.
    pub begins: Option<Tool>,
    /// Effect of a selection on the former one, if no key says otherwise.
    pub combine: Combine,
    /// Whether only visible samples are selected.
    pub visible: bool,
    /// Radius of the selecting brush, in points of the screen.
    pub radius: f32,
    /// Radius of strokes, as a part of the model's size.
    pub stroke_radius: f64,
    /// Strength of strokes.
    pub strength: f64,
    /// Whether clicks place pins instead of joints, and whether the body is held where a skeleton is of a
    /// limb alone.
    pub places_pins: bool,
    pub holds_body: bool,
    /// Number of joints of a chain that is dragged.
    pub chain: usize,
    /// A joint whose name is typed, and the name so far.
    pub naming: Option<(String, String)>,
    /// Width of the band around a new handle that bends, as a part of the model's diagonal.
    pub band: f64,
    /// The kind of measurement.
    pub measuring: Measuring,
    /// Point about which the gizmo's region turns.
    pub pivot: Option<(StepId, usize, DVec3)>,
    /// Gesture that the pointer has begun.
    pub gesture: Gesture,
}

impl Default for Tools {
    fn default() -> Self {
        Self {
            tool: Tool::Orbit,
            target: None,
            others: None,
            reach: 0.0,
            boxes_handles: false,
            begins: None,
            combine: Combine::Replace,
            visible: true,
            radius: 30.0,
            stroke_radius: 0.06,
            strength: 1.0,
            places_pins: false,
            holds_body: true,
            chain: 4,
            naming: None,
            band: 0.1,
            measuring: Measuring::Distance,
            pivot: None,
            gesture: Gesture::default(),
        }
    }
}

impl Tools {
    /// Takes a tool.
    pub fn take(&mut self, tool: Tool) {
        self.tool = tool;
        self.gesture.path.clear();
    }

    /// Lets go of all that is held, as another model comes.
    pub fn reset(&mut self) {
        (self.target, self.others, self.pivot) = (None, None, None);
        (self.begins, self.naming) = (None, None);
        self.gesture.reset();
    }

    /// Makes the brushes larger by so many presses of a key.
    pub fn size_brushes(&mut self, presses: i32) {
        self.radius = (self.radius * 1.2_f32.powi(presses)).clamp(2.0, 400.0);
        self.stroke_radius = (self.stroke_radius * 1.2_f64.powi(presses)).clamp(1e-3, 1.0);
    }

    /// Whether options of the tool are shown over the picture.
    pub fn has_options(&self) -> bool {
        let moves = self.tool.is_gizmo() && matches!(self.target, Some(MovedPart::Handle(_)));
        self.tool.selects() || matches!(self.tool, Tool::Stroke | Tool::Measure | Tool::Joint) || moves
    }

    /// The handles of the chosen step that its plugin placed and that are in the hand.
    pub fn handles(&self, step: StepId) -> BTreeSet<String> {
        let Some(MovedPart::Handle(id)) = &self.target else { return BTreeSet::new() };
        let known = self
            .others
            .as_ref()
            .filter(|(of, target, _)| *of == step && self.target.as_ref() == Some(target));
        let others = known.map(|(.., others)| others.clone()).unwrap_or_default();
        others.into_iter().chain([id.clone()]).collect()
    }

    /// Takes handles into the hand, the gizmo at the `first` of them.
    pub fn take_handles(&mut self, step: StepId, first: Option<String>, mut all: BTreeSet<String>) {
        let first = first.or_else(|| all.first().cloned());
        self.target = first.map(MovedPart::Handle);
        if let Some(MovedPart::Handle(id)) = &self.target {
            all.remove(id);
        }
        self.others = self.target.clone().map(|target| (step, target, all));
    }

    /// Whether a box chooses handles just now.
    pub fn picks_handles(&self) -> bool {
        self.tool == Tool::Box && self.boxes_handles
    }

    /// Effect of a selection on the former one with these keys held.
    pub fn combine_with(&self, modifiers: Modifiers) -> Combine {
        match (modifiers.shift, modifiers.command) {
            (true, _) => Combine::Add,
            (_, true) => Combine::Subtract,
            _ => self.combine,
        }
    }
}

/// The kind of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measuring {
    /// Distance between two points; a third one begins anew.
    Distance,
    /// Angle at the second of three points; a fourth one begins anew.
    Angle,
    /// Length along all points.
    Path,
}

impl Measuring {
    /// Number of points that the measurement takes at most.
    pub fn points(self) -> usize {
        match self {
            Self::Distance => 2,
            Self::Angle => 3,
            Self::Path => usize::MAX,
        }
    }
}
