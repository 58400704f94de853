//! Selecting by brush, lasso, box, and click.

use super::{Tool, ToolContext};
use crate::theme;
use crate::viewport::{ModelArea, handles};
use crate::window::{Commands, Window};
use eframe::egui::{Color32, Pos2, Rect, Shape, Stroke, StrokeKind};
use simod_viewer::Command;
use simod_viewer::command::Area;
use simod_viewer::selection::Combine;
use std::collections::BTreeSet;

/// Least distance between points of a lasso, in pixels.
const SPACING: f64 = 3.0;

pub fn update(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let tool = window.tools.tool;
    let combine = window.tools.combine_with(canvas.modifiers());
    let drawing = !context.gesture.path.is_empty();
    if canvas.is_pressed()
        && let Some(at) = canvas.press()
    {
        if tool == Tool::Connected {
            context.commands.apply(Command::Select {
                area: Area::Connected { at },
                combine,
                visible: false,
                goes_on: false,
            });
            return true;
        }
        context.gesture.path = vec![at];
        if tool == Tool::Brush {
            paint(context, vec![at], combine, false);
        }
    }
    if !context.gesture.path.is_empty() {
        follow(context, combine);
        if !canvas.is_down() {
            let path = std::mem::take(&mut context.gesture.path);
            if window.tools.picks_handles() {
                choose(context, &path, combine);
            } else {
                finish(window, context.commands, path, combine);
            }
        }
    }
    draw(canvas, window, &context.gesture.path);
    drawing || canvas.is_pressed()
}

/// Continues a selection after the pointer went on.
fn follow(context: &mut ToolContext<'_>, combine: Combine) {
    let (canvas, window, path) = (context.canvas, context.window, &mut context.gesture.path);
    let from = path.len() - 1;
    for at in canvas.trail().into_iter().map(|p| [p.x, p.y]) {
        let last = path.last().copied().unwrap_or(at);
        if window.tools.tool == Tool::Box {
            path.truncate(1);
            path.push(at);
        } else if (at[0] - last[0]).hypot(at[1] - last[1]) >= SPACING {
            path.push(at);
        }
    }
    let new = path[from.min(path.len() - 1)..].to_vec();
    if window.tools.tool == Tool::Brush && new.len() > 1 {
        // The first dab has replaced the selection; later ones add to it.
        let combine = if combine == Combine::Replace { Combine::Add } else { combine };
        paint(context, new, combine, true);
    }
}

fn paint(context: &mut ToolContext<'_>, path: Vec<[f64; 2]>, combine: Combine, goes_on: bool) {
    let tools = &context.window.tools;
    let (radius, visible) = (context.canvas.pixels(tools.radius), tools.visible);
    context.commands.apply(Command::Select { area: Area::Brush { path, radius }, combine, visible, goes_on });
}

/// Chooses the handles in the box, to be moved.
fn choose(context: &mut ToolContext<'_>, path: &[[f64; 2]], combine: Combine) {
    let (canvas, window) = (context.canvas, context.window);
    let Some((_, step, ..)) = window.chosen() else { return };
    let before = window.tools.handles(step);
    let there: BTreeSet<String> = match path {
        [from, to] => {
            let [from, to] = [from, to].map(|p| canvas.in_points((*p).into()));
            handles::within(canvas, window, Rect::from_two_pos(from, to))
        }
        _ => BTreeSet::new(),
    };
    let chosen = match combine {
        Combine::Replace => there,
        Combine::Add => &before | &there,
        Combine::Subtract => &before - &there,
    };
    context.commands.then(move |window| window.tools.take_handles(step, None, chosen));
}

fn finish(window: &Window, commands: &mut Commands, path: Vec<[f64; 2]>, combine: Combine) {
    let area = match (window.tools.tool, path.as_slice()) {
        (Tool::Lasso, [_, _, _, ..]) => Area::Lasso { path },
        (Tool::Box, [from, to]) => Area::Box { from: *from, to: *to },
        // A click on nothing in particular.
        (Tool::Lasso | Tool::Box, _) if combine == Combine::Replace => Area::None,
        _ => return,
    };
    let visible = window.tools.visible;
    commands.apply(Command::Select { area, combine, visible, goes_on: false });
}

fn draw(canvas: &ModelArea<'_>, window: &Window, path: &[[f64; 2]]) {
    let painter = canvas.painter();
    let stroke = Stroke::new(1.5, theme::color(theme::SELECTED));
    let points: Vec<Pos2> = path.iter().map(|p| canvas.in_points((*p).into())).collect();
    match (window.tools.tool, points.as_slice()) {
        (Tool::Brush, _) if canvas.is_hovered() => {
            if let Some(at) = canvas.pointer_pos() {
                let radius = window.tools.radius;
                painter.circle_stroke(at, radius + 0.5, Stroke::new(2.5, Color32::from_black_alpha(90)));
                painter.circle_stroke(at, radius, Stroke::new(1.2, Color32::WHITE));
            }
        }
        (Tool::Lasso, [first, .., last]) => {
            painter.add(Shape::line(points.clone(), stroke));
            painter.add(Shape::dashed_line(&[*last, *first], stroke, 5.0, 4.0));
        }
        (Tool::Box, [from, to]) => {
            let rect = Rect::from_two_pos(*from, *to);
            painter.rect(
                rect,
                0.0,
                theme::color(theme::SELECTED).gamma_multiply(0.12),
                stroke,
                StrokeKind::Inside,
            );
        }
        _ => {}
    }
}
