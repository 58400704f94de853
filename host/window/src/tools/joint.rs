//! Joints and pins, placed by clicks, and chains of joints by drags.

use super::{MovedPart, ToolContext};
use crate::viewport::{ModelArea, handles};
use crate::window::{Commands, Window};
use eframe::egui::{Color32, CursorIcon, Pos2, Shape, Stroke};
use glam::{DVec2, DVec3};
use simod_session::edit::{Change, EditCommand};
use simod_session::step::{Deformation, Joint};
use simod_viewer::Command;
use simod_viewer::skeleton::{chained, free_id, is_pin, with_body_held};

/// Points of the screen from which on a press that moves is a drag.
const LEAST: f32 = 14.0;

pub fn update(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let Some((step, _, deformation, plugin)) = window.chosen() else { return false };
    if !plugin.is_some_and(|plugin| plugin.consumes().joints) {
        return false;
    }
    if canvas.is_hovered() {
        canvas.ctx().set_cursor_icon(CursorIcon::Crosshair);
    }
    if canvas.is_pressed() {
        context.gesture.chain_from = canvas.press();
    }
    if let Some(from) = context.gesture.chain_from.map(DVec2::from)
        && let Some(to) = canvas.pointer()
    {
        let is_drag =
            !window.tools.places_pins && canvas.in_points(from).distance(canvas.in_points(to)) > LEAST;
        if canvas.is_down() {
            if is_drag {
                draw(canvas, from, to, window.tools.chain);
            }
            return is_drag;
        }
        context.gesture.chain_from = None;
        if is_drag {
            chain(context, step, &deformation, [from, to]);
            return true;
        }
    }
    if !canvas.is_clicked() || handles::take(canvas, window, context.commands) {
        return false;
    }
    let Some(pixel) = canvas.pointer() else { return false };
    let Some(at) = place(canvas, window, step, pixel) else { return false };
    if window.tools.places_pins {
        let id = free_id(&deformation.joints, true);
        context.commands.apply(Command::PlaceJoint { step, id, at, parent: None });
    } else {
        let parent = parent(window, &deformation);
        put(window, context.commands, step, chained(&deformation.joints, &[at], parent));
    }
    false
}

/// Gives the step other joints, the last of which was placed now; the body is held by pins, if that is
/// wanted.
fn put(window: &Window, commands: &mut Commands, step: usize, joints: Vec<Joint>) {
    let last = joints.last().map(|joint| joint.id.clone());
    let joints =
        if window.tools.holds_body { with_body_held(joints, &window.state().body(step)) } else { joints };
    let change = EditCommand::Change { at: step, change: Change::SetJoints(joints) };
    commands.apply_then(Command::Edit(change), |window| window.tools.target = last.map(MovedPart::Handle));
}

/// Place of a new joint under a pixel: in the middle of the body that the bone carries; with Shift, on the
/// surface.
fn place(canvas: &ModelArea<'_>, window: &Window, step: usize, pixel: DVec2) -> Option<DVec3> {
    if canvas.modifiers().shift {
        let hit = window.state().pick(pixel);
        hit.and_then(|hit| window.state().in_step(step, &hit))
    } else {
        window.state().pick_middle(step, pixel)
    }
}

/// Parent of a new joint: the joint in the hand, or the last one.
fn parent(window: &Window, deformation: &Deformation) -> Option<String> {
    match &window.tools.target {
        Some(MovedPart::Handle(id)) if deformation.joints.iter().any(|joint| joint.id == *id) => {
            Some(id.clone())
        }
        _ => {
            let last = deformation.joints.iter().rev().find(|joint| !is_pin(&joint.id));
            last.map(|joint| joint.id.clone())
        }
    }
}

/// Pixels of a chain's joints, evenly between the ends of a drag.
fn pixels(from: DVec2, to: DVec2, count: usize) -> impl Iterator<Item = DVec2> {
    (0..count).map(move |i| from.lerp(to, i as f64 / (count - 1).max(1) as f64))
}

fn chain(context: &mut ToolContext<'_>, step: usize, deformation: &Deformation, [from, to]: [DVec2; 2]) {
    let (canvas, window) = (context.canvas, context.window);
    // A chain that begins at a joint goes on from there.
    let begins = handles::joint_at(canvas, window, from);
    let skipped = usize::from(begins.is_some());
    let parent = begins.or_else(|| parent(window, deformation));
    let places: Vec<DVec3> = pixels(from, to, window.tools.chain + skipped)
        .skip(skipped)
        .filter_map(|pixel| place(canvas, window, step, pixel))
        .collect();
    if places.is_empty() {
        return;
    }
    put(window, context.commands, step, chained(&deformation.joints, &places, parent));
}

/// The chain that would be placed.
fn draw(canvas: &ModelArea<'_>, from: DVec2, to: DVec2, count: usize) {
    let points: Vec<Pos2> = pixels(from, to, count).map(|pixel| canvas.in_points(pixel)).collect();
    let painter = canvas.painter();
    painter.add(Shape::line(points.clone(), Stroke::new(2.0, Color32::WHITE)));
    for at in points {
        painter.circle(at, 4.5, Color32::WHITE, Stroke::new(1.4, Color32::from_black_alpha(200)));
    }
}
