//! Joints, placed by clicks.

use super::Target;
use crate::viewport::{Canvas, handles};
use crate::window::Window;
use eframe::egui::CursorIcon;
use simod_viewer::Command;

pub fn update(canvas: &Canvas<'_>, window: &mut Window) -> bool {
    let Some((step, _, deformation, plugin)) = window.chosen() else { return false };
    if !plugin.is_some_and(|plugin| plugin.consumes().joints) {
        return false;
    }
    if canvas.is_hovered() {
        canvas.ctx().set_cursor_icon(CursorIcon::Crosshair);
    }
    if !canvas.is_clicked() || handles::take(canvas, window) {
        return false;
    }
    let Some(pixel) = canvas.pointer() else { return false };
    // Bones lie in the middle of what they carry; with Shift, on the surface.
    let at = if canvas.modifiers().shift {
        let hit = window.state_mut().pick(pixel);
        hit.and_then(|hit| window.state().in_step(step, &hit))
    } else {
        window.state_mut().pick_middle(step, pixel)
    };
    let Some(at) = at else { return false };
    let is_joint = |id: &String| deformation.joints.iter().any(|joint| joint.id == *id);
    let parent = match &window.tools.target {
        Some(Target::Handle(id)) if is_joint(id) => Some(id.clone()),
        _ => deformation.joints.last().map(|joint| joint.id.clone()),
    };
    let id = (1..).map(|i| format!("joint-{i}")).find(|id| !is_joint(id));
    if let Some(id) = id
        && window.apply(Command::PlaceJoint { step, id: id.clone(), at, parent })
    {
        window.tools.target = Some(Target::Handle(id));
    }
    false
}
