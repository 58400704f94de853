//! Two versions: side by side, or one in the other's place.

use super::Viewport;
use crate::window::{Commands, Window};
use eframe::egui::{Align2, Color32, FontId, Key, Modifiers, Pos2, Rect, Shape, Stroke, Ui, pos2, vec2};
use simod_viewer::ComparedVersion;

/// Gap between two pictures, in points of the screen.
const GAP: f32 = 2.0;
const MARGIN: f32 = 12.0;
/// Key that shows the pinned version while it is held.
const HOLD: Key = Key::X;

/// Place of each version's picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VersionRects {
    /// Place of the version that is worked on.
    pub now: Option<Rect>,
    /// Place of the version that is pinned.
    pub pinned: Option<Rect>,
}

impl VersionRects {
    /// Divides the part of the window that shows the model.
    pub fn divide(rect: Rect, window: &Window) -> Self {
        let state = window.state();
        // While another model is opened, that model is shown.
        if state.is_opening() || state.scene_of(ComparedVersion::Pinned).is_none() {
            return Self { now: Some(rect), pinned: None };
        }
        if (window.looks.pinned_in_place || is_held(window)) && !window.tools.gesture.is_dragging() {
            return Self { now: None, pinned: Some(rect) };
        }
        if !window.looks.side_by_side {
            return Self { now: Some(rect), pinned: None };
        }
        // Both pictures have as many pixels.
        let pixel = 1.0 / window.ctx().pixels_per_point();
        let width = (0.5 * (rect.width() - GAP) / pixel).floor() * pixel;
        let size = vec2(width, rect.height());
        let right = pos2(rect.right() - width, rect.top());
        Self {
            now: Some(Rect::from_min_size(right, size)),
            pinned: Some(Rect::from_min_size(rect.min, size)),
        }
    }

    /// Place of the picture whose size the camera has.
    pub fn main(&self) -> Option<Rect> {
        self.now.or(self.pinned)
    }

    /// Version whose picture is under the pointer, or under the place of the press while a button is held.
    pub fn under(&self, ui: &Ui) -> Option<ComparedVersion> {
        let at: Pos2 = ui.input(|i| {
            let pressed = i.pointer.press_origin().filter(|_| i.pointer.any_down());
            pressed.or(i.pointer.latest_pos())
        })?;
        let holds = |place: Option<Rect>| place.is_some_and(|rect| rect.contains(at));
        match (holds(self.now), holds(self.pinned)) {
            (true, _) => Some(ComparedVersion::Now),
            (_, true) => Some(ComparedVersion::Pinned),
            _ => None,
        }
    }

    /// Pictures of the versions.
    pub fn pictures(&self, viewport: &mut Viewport, window: &Window, commands: &mut Commands) -> Vec<Shape> {
        let both = [(ComparedVersion::Pinned, self.pinned), (ComparedVersion::Now, self.now)];
        let shown: Vec<_> = both.into_iter().filter_map(|(version, rect)| Some((version, rect?))).collect();
        let share = shown.len() as u32;
        let draw = |(version, rect)| viewport.picture(rect, version, share, window, commands);
        shown.into_iter().map(draw).collect()
    }
}

/// Whether the key for the pinned version is held, and nobody else wants that key; or its button is held.
fn is_held(window: &Window) -> bool {
    let ctx = window.ctx();
    let held = ctx.input(|i| i.key_down(HOLD) && i.modifiers.matches_exact(Modifiers::NONE));
    let held = held && window.tools.gesture.transforming.is_none();
    window.holds_pinned || held && !ctx.egui_wants_keyboard_input() && !window.is_asking()
}

/// Draws the line between two pictures, and the caption of each.
pub fn captions(ui: &Ui, rect: Rect, places: &VersionRects, window: &Window) {
    let Some(name) = window.state().pinned() else { return };
    let pinned = format!("Pinned: {name}");
    let top = rect.top() + if window.tools.has_options() { 58.0 } else { MARGIN };
    match *places {
        VersionRects { now: Some(now), pinned: Some(then) } => {
            let middle = 0.5 * (then.right() + now.left());
            let line = Stroke::new(now.left() - then.right(), Color32::from_gray(12));
            ui.painter().vline(middle, rect.y_range(), line);
            caption(ui, pos2(then.right() - MARGIN, top), Align2::RIGHT_TOP, &pinned, false);
            caption(ui, pos2(now.left() + MARGIN, top), Align2::LEFT_TOP, "Now", false);
        }
        VersionRects { now: None, .. } => {
            caption(ui, pos2(rect.center().x, top), Align2::CENTER_TOP, &pinned, true);
        }
        _ => {}
    }
}

fn caption(ui: &Ui, at: Pos2, align: Align2, text: &str, strong: bool) {
    let visuals = ui.visuals();
    let (fill, color) = match strong {
        true => (visuals.selection.bg_fill, Color32::WHITE),
        false => (visuals.panel_fill.gamma_multiply(0.9), visuals.strong_text_color()),
    };
    let galley = ui.painter().layout_no_wrap(text.to_owned(), FontId::proportional(12.5), color);
    let rect = align.anchor_size(at, galley.size() + vec2(16.0, 8.0));
    ui.painter().rect_filled(rect, 5.0, fill);
    ui.painter().galley(rect.min + vec2(8.0, 4.0), galley, color);
}
