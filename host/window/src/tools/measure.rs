//! Lengths and angles, between points on the surface that are clicked and dragged; the points go along with
//! the surface.

use super::ToolContext;
use super::hand::Measuring;
use crate::viewport::ModelArea;
use crate::window::{Commands, Window};
use eframe::egui::{Align2, Color32, CursorIcon, FontId, Key, Pos2, Shape, Stroke, pos2, vec2};
use glam::DVec3;
use simod_viewer::Command;
use simod_viewer::measured::{Measure, MeasuredPoint, angle, distance};

/// Distance from a point within which the pointer takes it, in points of the screen.
const NEAR: f32 = 9.0;
/// The colour of the lines.
const COLOR: Color32 = Color32::from_rgb(255, 226, 120);
/// Length of lines on the screen below which they have no number, in points of the screen.
const SHORT: f32 = 50.0;
/// Part of the shorter side that an angle's arc is away from its corner, and lines of an arc.
const ARC: f64 = 0.28;
const ARC_LINES: usize = 24;

/// A length or an angle with five digits that matter.
pub fn exact(x: f64) -> String {
    let magnitude = if x == 0.0 { 0.0 } else { x.abs().log10().floor() };
    if !(-4.0..6.0).contains(&magnitude) {
        return format!("{x:.4e}");
    }
    let decimals = (4.0 - magnitude).clamp(0.0, 6.0) as usize;
    format!("{x:.decimals$}")
}

/// Text of a measure: its present value, and that at rest where it was another one.
pub fn told(measure: &Measure, unit: &str) -> String {
    let now = format!("{}{unit}", exact(measure.now));
    if measure.is_changed() { format!("{now} (at rest {}{unit})", exact(measure.rest)) } else { now }
}

/// The measured points' places before all steps.
fn points(window: &Window) -> Vec<DVec3> {
    window.state().measured().iter().map(|point| point.rest).collect()
}

/// Takes the last point away.
pub fn remove_last(window: &Window, commands: &mut Commands) {
    let mut points = points(window);
    if points.pop().is_some() {
        commands.apply(Command::Measure { points });
    }
}

/// Measures nothing any more.
pub fn clear(window: &Window, commands: &mut Commands) {
    commands.then(|window| window.tools.gesture.measured_point = None);
    if !points(window).is_empty() {
        commands.apply(Command::Measure { points: Vec::new() });
    }
}

/// Place of a point of local coordinates on the screen.
fn seen(canvas: &ModelArea<'_>, window: &Window, local: DVec3) -> Option<Pos2> {
    let (camera, size) = (window.state().camera(), window.state().size());
    camera.project(local, size).map(|(pixel, _)| canvas.in_points(pixel))
}

/// Escape takes all points away, Backspace and Delete the last one.
pub fn follow_keys(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands) {
    let ctx = canvas.ctx();
    if ctx.egui_wants_keyboard_input() || window.is_asking() {
        return;
    }
    if ctx.input(|i| i.key_pressed(Key::Escape)) {
        clear(window, commands);
    } else if ctx.input(|i| i.key_pressed(Key::Backspace) || i.key_pressed(Key::Delete)) {
        remove_last(window, commands);
    }
}

pub fn update(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let ctx = canvas.ctx();
    let Some(frame) = window.state().scene().map(|scene| scene.frame()) else { return false };
    let places: Vec<Option<Pos2>> = window
        .state()
        .measured()
        .iter()
        .map(|point| seen(canvas, window, frame.to_local_exact(point.now)))
        .collect();
    let under = |at: Pos2| places.iter().position(|p| p.is_some_and(|p| p.distance(at) < NEAR));
    let over = canvas.pointer_pos().filter(|_| canvas.is_hovered()).and_then(under);
    if canvas.is_hovered() {
        ctx.set_cursor_icon(if over.is_some() { CursorIcon::Grab } else { CursorIcon::Crosshair });
    }
    if canvas.is_pressed() {
        let pressed = ctx.input(|i| i.pointer.press_origin()).or(canvas.pointer_pos());
        context.gesture.measured_point = pressed.and_then(under);
    }
    if let Some(held) = context.gesture.measured_point {
        if !canvas.is_down() {
            context.gesture.measured_point = None;
        } else if ctx.input(|i| i.pointer.is_decidedly_dragging()) {
            drag(context, held);
        }
        return true;
    }
    if canvas.is_clicked() && over.is_none() {
        add(context);
    }
    false
}

/// Place at rest of the surface's point under the pointer.
fn hit(canvas: &ModelArea<'_>, window: &Window) -> Option<DVec3> {
    window.state().at_rest(&window.state().pick(canvas.pointer()?)?)
}

/// Moves a point to the place of the pointer.
fn drag(context: &mut ToolContext<'_>, held: usize) {
    let Some(at) = hit(context.canvas, context.window) else { return };
    let mut points = points(context.window);
    if let Some(point) = points.get_mut(held).filter(|point| **point != at) {
        *point = at;
        context.commands.apply(Command::Measure { points });
    }
}

/// Adds a point at the place of the pointer, or begins anew where there are enough.
fn add(context: &mut ToolContext<'_>) {
    let Some(at) = hit(context.canvas, context.window) else { return };
    let mut points = points(context.window);
    if points.len() >= context.window.tools.measuring.points() {
        points.clear();
    }
    points.push(at);
    context.commands.apply(Command::Measure { points });
}

/// Draws the measured points and lines, whatever the tool.
pub fn draw(canvas: &ModelArea<'_>, window: &Window) {
    let Some(frame) = window.state().scene().map(|scene| scene.frame()) else { return };
    let measured = window.state().measured();
    let place = |p: DVec3| seen(canvas, window, frame.to_local_exact(p));
    let line = |points: Vec<Pos2>| {
        canvas.painter().add(Shape::line(points.clone(), Stroke::new(3.6, Color32::from_black_alpha(130))));
        canvas.painter().add(Shape::line(points, Stroke::new(1.7, COLOR)));
    };
    for pair in measured.windows(2) {
        if let (Some(a), Some(b)) = (place(pair[0].now), place(pair[1].now)) {
            line(vec![a, b]);
        }
    }
    for corner in measured.windows(3) {
        let arc: Vec<Pos2> = arc(corner).into_iter().filter_map(place).collect();
        if arc.len() > 1 {
            line(arc);
        }
    }
    for point in &measured {
        if let Some(at) = place(point.now) {
            canvas.painter().circle(at, 4.5, COLOR, Stroke::new(1.4, Color32::from_black_alpha(200)));
        }
    }
    for pair in measured.windows(2) {
        let ends = (place(pair[0].now), place(pair[1].now));
        let is_short = matches!(ends, (Some(a), Some(b)) if a.distance(b) < SHORT);
        if let Some(at) = place(0.5 * (pair[0].now + pair[1].now)).filter(|_| !is_short) {
            label(canvas, at, &exact(distance(&pair[0], &pair[1]).now));
        }
    }
    for corner in measured.windows(3) {
        let arc = arc(corner);
        if let Some(at) = arc.get(ARC_LINES / 2).copied().and_then(place) {
            label(canvas, at, &format!("{}\u{b0}", exact(angle(&corner[0], &corner[1], &corner[2]).now)));
        }
    }
}

/// Points of an arc around the middle one of three points, from the direction of the first to that of the
/// last.
fn arc(corner: &[MeasuredPoint]) -> Vec<DVec3> {
    let [a, b, c] = [0, 1, 2].map(|i| corner[i].now);
    let (u, v) = (a - b, c - b);
    let radius = ARC * u.length().min(v.length());
    let (Some(u), Some(v)) = (u.try_normalize(), v.try_normalize()) else { return Vec::new() };
    let angle = u.dot(v).clamp(-1.0, 1.0).acos();
    let Some(across) = (v - u * u.dot(v)).try_normalize() else { return Vec::new() };
    let at = |i: usize| {
        let (sin, cos) = (angle * i as f64 / ARC_LINES as f64).sin_cos();
        b + radius * (u * cos + across * sin)
    };
    (0..=ARC_LINES).map(at).collect()
}

fn label(canvas: &ModelArea<'_>, at: Pos2, text: &str) {
    let galley = canvas.painter().layout_no_wrap(text.to_owned(), FontId::proportional(12.5), Color32::WHITE);
    let at = pos2(at.x, at.y - 14.0);
    let rect = Align2::CENTER_CENTER.anchor_size(at, galley.size() + vec2(12.0, 5.0));
    canvas.painter().rect_filled(rect, 5.0, Color32::from_black_alpha(205));
    canvas.painter().galley(rect.min + vec2(6.0, 2.5), galley, Color32::WHITE);
}

/// Results of the measurement, in words; nothing where there are no points.
pub fn summary(window: &Window) -> Option<String> {
    let measured = window.state().measured();
    let sides: Vec<Measure> = measured.windows(2).map(|pair| distance(&pair[0], &pair[1])).collect();
    Some(match (&measured[..], window.tools.measuring) {
        ([], _) => return None,
        ([_], _) => "Click the next point.".to_owned(),
        ([a, b], _) => format!("Distance {}", told(&distance(a, b), "")),
        ([a, b, c], Measuring::Angle) => format!("Angle {}", told(&angle(a, b, c), "\u{b0}")),
        _ => {
            let sum = |of: fn(&Measure) -> f64| sides.iter().map(of).sum();
            let all = Measure { now: sum(|m| m.now), rest: sum(|m| m.rest) };
            format!("Length {} in {} parts", told(&all, ""), sides.len())
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measures_have_five_digits_and_tell_what_changed() {
        let texts = [0.0, 1.0, 12.345678, 123456.0, 0.0012345678, 1.5e9, 2e-7].map(exact);
        assert_eq!(texts, ["0.0000", "1.0000", "12.346", "123456", "0.001235", "1.5000e9", "2.0000e-7"]);
        assert_eq!(told(&Measure { now: 2.0, rest: 2.0 }, ""), "2.0000");
        assert_eq!(told(&Measure { now: 45.0, rest: 90.0 }, "\u{b0}"), "45.000\u{b0} (at rest 90.000\u{b0})");
    }
}
