//! Motion by keys: G, R and S begin it at once; X, Y and Z choose the axis, digits the amount. Enter or a
//! click ends the motion, Escape or the right button takes it back.

use super::gizmo;
use super::transforming::{TransformOutcome, Transformed, Transforming};
use super::{MovedPart, Tool, ToolContext};
use crate::viewport::ModelArea;
use crate::window::{Commands, Window};
use eframe::egui::CursorIcon;
use simod_viewer::Command;
use simod_viewer::transform::{ScreenView, Transform, TransformKind};

/// Begins a motion, if there is anything in the hand and the pointer is over the picture.
pub fn begin(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands, tool: Tool) {
    let kind = match tool {
        Tool::Rotate => TransformKind::Turn,
        Tool::Scale => TransformKind::Scale,
        _ => TransformKind::Move,
    };
    let Some((step, id, ..)) = window.chosen() else { return };
    let (Some(place), Some(pointer)) = (gizmo::place(window, commands), canvas.pointer()) else { return };
    let of = match &place.target {
        MovedPart::Region(_) => Transformed::Region(Box::new(place.clone()), place.matrix),
        MovedPart::Handle(_) => match gizmo::held(window, step, id) {
            Some(held) => Transformed::Handles(held),
            None => return,
        },
    };
    let Some(frame) = window.state().scene().map(|scene| scene.frame()) else { return };
    let middle = match &of {
        Transformed::Handles(held) => held.pivot(),
        Transformed::Region(_, from) => from.translation,
    };
    let middle = frame.to_local_exact(middle);
    let transform = Transform::new(kind, middle, frame.scale, pointer);
    let begun = Transforming { transform, step: id, of, middle, last: None, pressed: false };
    commands.then(|window| window.tools.gesture.transforming = Some(begun));
}

/// Continues a motion, if there is one. Returns whether the pointer belongs to the motion, as long as it
/// lasts.
pub fn update(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let Some(mut going) = context.gesture.transforming.take() else { return false };
    if window.chosen().is_none_or(|(_, id, ..)| id != going.step) {
        return false;
    }
    let (camera, size) = (*window.state().camera(), window.state().size());
    let seen = ScreenView { camera: &camera, size };
    for pixel in canvas.trail().into_iter().chain(canvas.pointer()) {
        going.transform.follow(pixel, seen);
    }
    let next = going.next(canvas.ctx());
    if matches!(next, TransformOutcome::Back) {
        if going.last.is_some() {
            context.commands.apply(Command::Undo);
        }
        return true;
    }
    let motion = going.transform.motion(seen, canvas.modifiers().command);
    if let (Some(motion), Some((step, ..))) = (motion, window.chosen())
        && going.last.unwrap_or_default() != motion
        && let Some(change) = going.of.change(&motion)
    {
        going.last = Some(motion);
        context.commands.change(step, change, true);
    }
    canvas.ctx().set_cursor_icon(CursorIcon::Move);
    going.draw(canvas, seen);
    if matches!(next, TransformOutcome::Done) {
        if going.last.is_some() {
            context.commands.apply(Command::Rest);
        }
    } else {
        context.gesture.transforming = Some(going);
    }
    true
}
