//! What the left button does in the picture.

pub mod gizmo;
pub mod hand;
mod joint;
pub mod measure;
mod place;
mod select;
mod stroke;
pub mod transform;
mod transforming;

use crate::viewport::ModelArea;
use crate::window::Window;
use eframe::egui::{CursorIcon, Key};
pub use hand::{Tool, Tools};
pub use place::MovedPart;

/// Whether the chosen step has any use for a tool.
pub fn is_of_use(tool: Tool, window: &Window) -> bool {
    let consumes = || window.chosen().and_then(|(_, _, _, plugin)| plugin).map(|plugin| plugin.consumes());
    match tool {
        Tool::Stroke => consumes().is_some_and(|c| c.strokes),
        Tool::Joint => consumes().is_some_and(|c| c.joints),
        _ => true,
    }
}

/// The tool in the hand does its work and draws itself. Whether the pointer is its own, and not the camera's.
pub fn update(canvas: &ModelArea<'_>, window: &mut Window) -> bool {
    let ctx = canvas.ctx();
    if canvas.is_hovered() && !ctx.egui_wants_keyboard_input() {
        let size = |key| i32::from(ctx.input(|i| i.key_pressed(key)));
        let steps = size(Key::CloseBracket) - size(Key::OpenBracket);
        window.tools.radius = (window.tools.radius * 1.2_f32.powi(steps)).clamp(2.0, 400.0);
        window.tools.stroke_radius = (window.tools.stroke_radius * 1.2_f64.powi(steps)).clamp(1e-3, 1.0);
    }
    if let Some(tool) = window.tools.begins.take().filter(|_| canvas.is_hovered()) {
        transform::begin(canvas, window, tool);
    }
    if window.tools.transforming.is_some() && transform::update(canvas, window) {
        return true;
    }
    match window.tools.tool {
        Tool::Orbit => false,
        Tool::Move | Tool::Rotate | Tool::Scale => gizmo::update(canvas, window),
        Tool::Brush | Tool::Lasso | Tool::Box | Tool::Connected => {
            if canvas.is_hovered() {
                ctx.set_cursor_icon(CursorIcon::Crosshair);
            }
            select::update(canvas, window)
        }
        Tool::Stroke => stroke::update(canvas, window),
        Tool::Joint => joint::update(canvas, window),
        Tool::Measure => measure::update(canvas, window),
    }
}
