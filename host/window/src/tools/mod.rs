//! The tools of the left button in the picture.

mod context;
mod gesture;
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
use crate::window::{Commands, Window};
pub use context::ToolContext;
use eframe::egui::{CursorIcon, Key};
pub use gesture::Gesture;
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

/// Lets the tool in the hand do its work and draw itself. Returns whether the pointer belongs to the tool,
/// and not to the camera.
pub fn update(canvas: &ModelArea<'_>, window: &mut Window) -> bool {
    window.draw(|window, commands| follow_keys(canvas, window, commands));
    window.draw_with(
        |window| &mut window.tools.gesture,
        |window, commands, gesture| {
            let mut context = ToolContext { canvas, window, commands, gesture };
            transform::update(&mut context) || go_on(&mut context)
        },
    )
}

/// Follows the keys before the pointer does something.
fn follow_keys(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands) {
    let ctx = canvas.ctx();
    if canvas.is_hovered() && !ctx.egui_wants_keyboard_input() {
        let size = |key| i32::from(ctx.input(|i| i.key_pressed(key)));
        let presses = size(Key::CloseBracket) - size(Key::OpenBracket);
        commands.then(move |window| window.tools.size_brushes(presses));
    }
    if let Some(tool) = window.tools.begins {
        commands.then(|window| window.tools.begins = None);
        if canvas.is_hovered() {
            transform::begin(canvas, window, commands, tool);
        }
    }
    if window.tools.tool == Tool::Measure {
        measure::follow_keys(canvas, window, commands);
    }
}

/// The tool in the hand follows the pointer.
fn go_on(context: &mut ToolContext<'_>) -> bool {
    let tool = context.window.tools.tool;
    if tool.selects() && context.canvas.is_hovered() {
        context.canvas.ctx().set_cursor_icon(CursorIcon::Crosshair);
    }
    match tool {
        Tool::Orbit => false,
        Tool::Move | Tool::Rotate | Tool::Scale => gizmo::update(context),
        Tool::Brush | Tool::Lasso | Tool::Box | Tool::Connected => select::update(context),
        Tool::Stroke => stroke::update(context),
        Tool::Joint => joint::update(context),
        Tool::Measure => measure::update(context),
    }
}
