//! A motion by keys that is going on: the handles or region, the keys so far, and the drawing.

use super::place::GizmoTarget;
use crate::numbers::number;
use crate::viewport::ModelArea;
use eframe::egui::{self, Align2, Color32, Event, FontId, Key, PointerButton, Stroke};
use glam::{DAffine3, DVec3};
use simod_session::Motion;
use simod_session::edit::{Change, StepId};
use simod_viewer::held::GrabbedHandles;
use simod_viewer::transform::{ScreenView, Transform, TransformKind};

/// Colours of the axes, as the gizmo has them.
const COLORS: [Color32; 3] =
    [Color32::from_rgb(226, 62, 68), Color32::from_rgb(96, 172, 40), Color32::from_rgb(52, 120, 232)];
const KEYS: [(Key, usize); 3] = [(Key::X, 0), (Key::Y, 1), (Key::Z, 2)];
const NAMES: [&str; 3] = ["X", "Y", "Z"];

/// A motion that is going on.
pub struct Transforming {
    /// Motion that the pointer and the keys have given so far, the step, and the parts that move.
    pub transform: Transform,
    pub step: StepId,
    pub of: Transformed,
    /// Middle of the parts, in local coordinates.
    pub middle: DVec3,
    /// The motion that was done last.
    pub last: Option<Motion>,
    /// Whether the button is held that ends the motion.
    pub pressed: bool,
}

/// The things that move.
pub enum Transformed {
    /// Handles that the plugin placed.
    Handles(GrabbedHandles),
    /// A handle region, from its gizmo's place.
    Region(Box<GizmoTarget>, DAffine3),
}

impl Transformed {
    /// Change that moves the parts by a motion, from their places at its beginning.
    pub fn change(&self, motion: &Motion) -> Option<Change> {
        match self {
            Self::Handles(held) => held.moved(motion).map(Change::MoveHandles),
            Self::Region(place, from) => place.change_to(motion.to_affine(from.translation) * *from),
        }
    }
}

/// The outcome of a motion by keys.
pub enum TransformOutcome {
    GoesOn,
    Done,
    Back,
}

impl Transforming {
    /// Outcome of the keys and buttons since the last picture.
    pub fn next(&mut self, ctx: &egui::Context) -> TransformOutcome {
        let events = ctx.input_mut(|i| std::mem::take(&mut i.events));
        let mut next = TransformOutcome::GoesOn;
        for event in events {
            match event {
                Event::Key { key: Key::Enter, pressed: true, .. } => next = TransformOutcome::Done,
                Event::Key { key: Key::Escape, pressed: true, .. }
                | Event::PointerButton { button: PointerButton::Secondary, pressed: false, .. } => {
                    next = TransformOutcome::Back;
                }
                Event::PointerButton { button: PointerButton::Primary, pressed: true, .. } => {
                    self.pressed = true
                }
                Event::PointerButton { button: PointerButton::Primary, pressed: false, .. }
                    if self.pressed =>
                {
                    next = TransformOutcome::Done;
                }
                Event::Key { key: Key::Backspace, pressed: true, .. } => self.transform.erase(),
                Event::Key { key, pressed: true, repeat: false, .. } => {
                    let axis = KEYS.iter().find(|(known, _)| *known == key);
                    axis.iter().for_each(|(_, axis)| self.transform.toggle_axis(*axis));
                }
                Event::Text(text) => text.chars().for_each(|c| self.transform.type_in(c)),
                _ => {}
            }
        }
        next
    }

    /// Draws the axis, and the motion in numbers.
    pub fn draw(&self, canvas: &ModelArea<'_>, seen: ScreenView<'_>) {
        let painter = canvas.painter();
        if let Some(axis) = self.transform.axis() {
            let end = |far: f64| {
                let pixel = seen.camera.project(self.middle + far * DVec3::AXES[axis], seen.size)?.0;
                Some(canvas.in_points(pixel))
            };
            // The line is drawn in short pieces, as it may go behind the eye.
            let ends: Vec<_> = (-40..=40).map(|i| end(f64::from(i) * 0.1)).collect();
            for pair in ends.windows(2) {
                if let [Some(a), Some(b)] = pair {
                    painter.line_segment([*a, *b], Stroke::new(1.5, COLORS[axis]));
                }
            }
        }
        let text = self.text();
        let at = canvas.rect().left_bottom() + egui::vec2(16.0, -18.0);
        let galley = painter.layout_no_wrap(text, FontId::proportional(15.0), Color32::WHITE);
        let rect = Align2::LEFT_BOTTOM.anchor_size(at, galley.size());
        painter.rect_filled(rect.expand(7.0), 5.0, Color32::from_black_alpha(190));
        painter.galley(rect.min, galley, Color32::WHITE);
    }

    fn text(&self) -> String {
        let motion = self.last.unwrap_or_default();
        let axis = self.transform.axis();
        let typed = self.transform.typed();
        let value = |shown: String| if typed.is_empty() { shown } else { format!("{typed}|") };
        let text = match (self.transform.kind(), axis) {
            (TransformKind::Move, Some(axis)) => {
                format!("Move along {}: {}", NAMES[axis], value(number(motion.translate[axis])))
            }
            (TransformKind::Move, None) => {
                let all = motion.translate.to_array().map(number).join(", ");
                format!("Move: {}", value(all))
            }
            (TransformKind::Turn, axis) => {
                let about = axis.map_or_else(String::new, |axis| format!(" about {}", NAMES[axis]));
                format!("Turn{about}: {}\u{b0}", value(format!("{:.1}", motion.degrees)))
            }
            (TransformKind::Scale, _) => format!("Scale: {}", value(number(motion.scale))),
        };
        format!(
            "{text}     X, Y, Z: axis \u{b7} digits: how far \u{b7} Enter, click: done \u{b7} Escape: back"
        )
    }
}
