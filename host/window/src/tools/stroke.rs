//! Brush strokes on the surface, for plugins that take them.

use crate::viewport::ModelArea;
use crate::window::Window;
use eframe::egui::{Color32, Event, Key, Pos2, Shape, Stroke};
use glam::DVec2;
use simod_viewer::{Command, Hit};

/// Points of a stroke are so far apart at least, in radii of the brush.
const SPACING: f64 = 0.15;
/// Corners of the circle that shows the brush.
const CORNERS: usize = 48;

pub fn update(canvas: &ModelArea<'_>, window: &mut Window) -> bool {
    let Some((step, _, _, plugin)) = window.chosen() else { return false };
    if !plugin.is_some_and(|plugin| plugin.consumes().strokes) {
        return false;
    }
    let drawing = window.state().is_drawing();
    if drawing && canvas.ctx().input(|i| i.key_pressed(Key::Escape)) {
        window.apply(Command::DropStroke);
        window.tools.painting = false;
        window.tools.path.clear();
        return true;
    }
    let hit = match canvas.pointer() {
        Some(pixel) if canvas.is_hovered() || drawing => window.state_mut().pick(pixel),
        _ => None,
    };
    if let Some(hit) = &hit {
        draw(canvas, window, hit);
    }
    if canvas.is_pressed() {
        window.tools.painting = true;
    }
    if window.tools.painting {
        // A stroke that begins beside the surface begins where the hand gets to it.
        for pixel in canvas.trail() {
            paint(canvas, window, step, pixel);
        }
        if !canvas.is_down() {
            window.tools.painting = false;
            window.tools.path.clear();
            if window.state().is_drawing() {
                window.apply(Command::EndStroke);
            }
            return true;
        }
    }
    drawing || window.tools.painting
}

/// The brush is on a pixel.
fn paint(canvas: &ModelArea<'_>, window: &mut Window, step: usize, pixel: DVec2) {
    let Some(hit) = window.state_mut().pick(pixel) else { return };
    let Some(at) = window.state().in_step(step, &hit) else { return };
    let (camera, size) = (window.state().camera(), window.state().size());
    let depth = camera.project(hit.local, size).map_or(1.0, |p| p.1);
    let spacing = (SPACING * window.tools.stroke_radius / camera.pixel_length(depth, size)).max(2.0);
    if !window.state().is_drawing() {
        let Some(scale) = window.state().scene().map(|scene| scene.frame().scale) else { return };
        let invert = if canvas.modifiers().command { -1.0 } else { 1.0 };
        let (radius, strength) = (window.tools.stroke_radius * scale, invert * window.tools.strength);
        window.tools.path.clear();
        if !window.apply(Command::BeginStroke { step, radius, strength, params: Default::default() }) {
            window.tools.painting = false;
            return;
        }
    } else if window.tools.path.last().is_some_and(|last| pixel.distance((*last).into()) < spacing) {
        return;
    }
    let force = canvas.ctx().input(|i| {
        i.events.iter().rev().find_map(|event| match event {
            Event::Touch { force, .. } => *force,
            _ => None,
        })
    });
    window.tools.path.push(pixel.to_array());
    window.apply(Command::StrokePoint { at, pressure: force.map(|force| force.clamp(0.0, 1.0)) });
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
