//! Brush strokes on the surface, for plugins that take them.

use super::{Gesture, ToolContext};
use crate::viewport::ModelArea;
use crate::window::Window;
use eframe::egui::{Color32, Event, Key, Pos2, Shape, Stroke};
use simod_viewer::{Command, Hit};

/// Least distance between points of a stroke, in radii of the brush.
const SPACING: f64 = 0.15;
/// Corners of the circle that shows the brush.
const CORNERS: usize = 48;

pub fn update(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let Some((step, _, _, plugin)) = window.chosen() else { return false };
    if !plugin.is_some_and(|plugin| plugin.consumes().strokes) {
        return false;
    }
    let drawing = window.state().is_drawing();
    if drawing && canvas.ctx().input(|i| i.key_pressed(Key::Escape)) {
        context.commands.apply(Command::DropStroke);
        context.gesture.painting = false;
        context.gesture.path.clear();
        return true;
    }
    let hit = match canvas.pointer() {
        Some(pixel) if canvas.is_hovered() || drawing => window.state().pick(pixel),
        _ => None,
    };
    if let Some(hit) = &hit {
        draw(canvas, window, hit);
    }
    if canvas.is_pressed() {
        context.gesture.painting = true;
    }
    if context.gesture.painting {
        let painted = paint(canvas, window, context.gesture, step);
        let ends = !canvas.is_down();
        context.commands.then(move |window| stroke_on(window, painted, ends));
        if ends {
            context.gesture.painting = false;
            context.gesture.path.clear();
            return true;
        }
    }
    drawing || context.gesture.painting
}

/// The painting since the last picture: the beginning of a stroke, if none is drawn, and its points.
type Painted = (Option<Command>, Vec<Command>);

/// Paints where the pointer went. A stroke that begins beside the surface begins at its first point on it.
fn paint(canvas: &ModelArea<'_>, window: &Window, gesture: &mut Gesture, step: usize) -> Painted {
    let (mut begin, mut points) = (None, Vec::new());
    for pixel in canvas.trail() {
        let Some(hit) = window.state().pick(pixel) else { continue };
        let Some(at) = window.state().in_step(step, &hit) else { continue };
        if !window.state().is_drawing() && begin.is_none() {
            begin = begin_stroke(canvas, window, step);
            gesture.path.clear();
        } else if gesture
            .path
            .last()
            .is_some_and(|last| pixel.distance((*last).into()) < spacing(window, &hit))
        {
            continue;
        }
        gesture.path.push(pixel.to_array());
        points.push(Command::StrokePoint { at, pressure: pressure(canvas) });
    }
    (begin, points)
}

fn begin_stroke(canvas: &ModelArea<'_>, window: &Window, step: usize) -> Option<Command> {
    let scale = window.state().scene()?.frame().scale;
    let invert = if canvas.modifiers().command { -1.0 } else { 1.0 };
    let (radius, strength) = (window.tools.stroke_radius * scale, invert * window.tools.strength);
    Some(Command::BeginStroke { step, radius, strength, params: Default::default() })
}

/// Distance between points of a stroke at a place of the surface, in pixels.
fn spacing(window: &Window, hit: &Hit) -> f64 {
    let (camera, size) = (window.state().camera(), window.state().size());
    let depth = camera.project(hit.local, size).map_or(1.0, |p| p.1);
    (SPACING * window.tools.stroke_radius / camera.pixel_length(depth, size)).max(2.0)
}

/// Pressure of a pen, from 0 to 1, if there is one.
fn pressure(canvas: &ModelArea<'_>) -> Option<f32> {
    let force = canvas.ctx().input(|i| {
        i.events.iter().rev().find_map(|event| match event {
            Event::Touch { force, .. } => *force,
            _ => None,
        })
    });
    force.map(|force| force.clamp(0.0, 1.0))
}

/// Paints, and ends the stroke if the hand does.
fn stroke_on(window: &mut Window, (begin, points): Painted, ends: bool) {
    if begin.is_some_and(|begin| !window.apply(begin)) {
        window.tools.gesture.painting = false;
        return;
    }
    for point in points {
        window.apply(point);
    }
    if ends && window.state().is_drawing() {
        window.apply(Command::EndStroke);
    }
}

/// The brush, lying on the surface.
fn draw(canvas: &ModelArea<'_>, window: &Window, hit: &Hit) {
    let (camera, size) = (window.state().camera(), window.state().size());
    let (x, y) = hit.normal.any_orthonormal_pair();
    let radius = window.tools.stroke_radius;
    let point = |i: usize| {
        let (sin, cos) = (i as f64 / CORNERS as f64 * std::f64::consts::TAU).sin_cos();
        let pixel = camera.project(hit.local + radius * (x * cos + y * sin), size)?.0;
        Some(canvas.in_points(pixel))
    };
    let points: Vec<Pos2> = (0..CORNERS).filter_map(point).collect();
    let painter = canvas.painter();
    painter.add(Shape::closed_line(points.clone(), Stroke::new(3.0, Color32::from_black_alpha(90))));
    painter.add(Shape::closed_line(points, Stroke::new(1.4, Color32::WHITE)));
    if let Some((middle, _)) = camera.project(hit.local, size) {
        painter.circle_filled(canvas.in_points(middle), 2.0, Color32::WHITE);
    }
}
