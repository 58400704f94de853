//! Small drawings for buttons, as lines, so that they are as sharp as the screen.

use crate::tools::Tool;
use eframe::egui::{Color32, Painter, Pos2, Rect, Shape, Stroke, StrokeKind, pos2};
use std::f32::consts::TAU;

const WIDTH: f32 = 1.6;

/// Back to the default: an arrow that goes round.
pub fn back(painter: &Painter, rect: Rect, color: Color32) {
    let stroke = Stroke::new(1.4, color);
    let radius = 0.42 * rect.width();
    let point = |i: i32| {
        let (sin, cos) = (TAU * (0.62 + 0.72 * i as f32 / 20.0)).sin_cos();
        rect.center() + radius * eframe::egui::vec2(cos, sin)
    };
    painter.add(Shape::line((0..=20).map(point).collect(), stroke));
    let tip = point(0);
    painter.line_segment([tip, tip + eframe::egui::vec2(0.5 * radius, -0.95 * radius)], stroke);
    painter.line_segment([tip, tip + eframe::egui::vec2(1.0 * radius, 0.12 * radius)], stroke);
}

/// A tool's icon.
pub fn tool(painter: &Painter, rect: Rect, tool: Tool, color: Color32) {
    let stroke = Stroke::new(WIDTH, color);
    let at = |x: f32, y: f32| pos2(rect.left() + x * rect.width(), rect.top() + y * rect.height());
    let line = |points: &[(f32, f32)]| {
        let points: Vec<Pos2> = points.iter().map(|(x, y)| at(*x, *y)).collect();
        painter.add(Shape::line(points, stroke));
    };
    let radius = 0.5 * rect.width();
    let arc = |center: (f32, f32), r: (f32, f32), from: f32, to: f32| {
        let point = |i: i32| {
            let angle = TAU * (from + (to - from) * i as f32 / 28.0);
            at(center.0 + r.0 * angle.cos(), center.1 + r.1 * angle.sin())
        };
        painter.add(Shape::line((0..=28).map(point).collect(), stroke));
    };
    match tool {
        Tool::Orbit => {
            painter.circle_filled(at(0.5, 0.5), 0.26 * radius, color);
            arc((0.5, 0.5), (0.5, 0.2), 0.0, 1.0);
            arc((0.5, 0.5), (0.2, 0.5), 0.0, 1.0);
        }
        Tool::Move => {
            for (dx, dy) in [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)] {
                line(&[(0.5, 0.5), (0.5 + dx, 0.5 + dy)]);
                let (sx, sy) = (0.3 * dy, 0.3 * dx);
                line(&[
                    (0.5 + 0.68 * dx + sx, 0.5 + 0.68 * dy + sy),
                    (0.5 + dx, 0.5 + dy),
                    (0.5 + 0.68 * dx - sx, 0.5 + 0.68 * dy - sy),
                ]);
            }
        }
        Tool::Rotate => {
            arc((0.5, 0.5), (0.46, 0.46), 0.02, 0.82);
            line(&[(0.50, 0.20), (0.72, 0.10), (0.68, 0.34)]);
            painter.circle_filled(at(0.5, 0.5), 1.8, color);
        }
        Tool::Scale => {
            let small = Rect::from_min_max(at(0.0, 0.55), at(0.45, 1.0));
            painter.rect_stroke(small, 1.0, stroke, StrokeKind::Middle);
            line(&[(0.5, 0.5), (0.98, 0.02)]);
            line(&[(0.62, 0.02), (0.98, 0.02), (0.98, 0.38)]);
        }
        Tool::Brush => {
            painter.circle_stroke(at(0.42, 0.42), 0.84 * radius, stroke);
            for (x, y) in [(0.3, 0.4), (0.52, 0.34), (0.45, 0.56)] {
                painter.circle_filled(at(x, y), 1.5, color);
            }
            line(&[(0.78, 0.98), (0.98, 0.98)]);
            line(&[(0.88, 0.88), (0.88, 1.08)]);
        }
        Tool::Lasso => {
            arc((0.5, 0.38), (0.5, 0.34), 0.25, 1.2);
            arc((0.34, 0.72), (0.1, 0.1), 0.0, 1.0);
            line(&[(0.3, 0.82), (0.2, 0.94), (0.28, 1.04)]);
        }
        Tool::Box => {
            let box_ = rect.shrink(1.0);
            let corners =
                [box_.left_top(), box_.right_top(), box_.right_bottom(), box_.left_bottom(), box_.left_top()];
            painter.extend(Shape::dashed_line(&corners, stroke, 3.5, 2.8));
        }
        Tool::Connected => {
            for (a, b) in [((0.15, 0.8), (0.5, 0.2)), ((0.5, 0.2), (0.85, 0.8)), ((0.15, 0.8), (0.85, 0.8))] {
                line(&[a, b]);
                painter.circle_filled(at(a.0, a.1), 2.6, color);
                painter.circle_filled(at(b.0, b.1), 2.6, color);
            }
        }
        Tool::Stroke => {
            line(&[(0.98, 0.02), (0.52, 0.5)]);
            line(&[(0.86, 0.0), (0.42, 0.42), (0.58, 0.58), (1.0, 0.14)]);
            arc((0.3, 0.76), (0.22, 0.2), 0.0, 1.0);
        }
        Tool::Measure => {
            line(&[(0.02, 0.68), (0.68, 0.02), (0.98, 0.32), (0.32, 0.98), (0.02, 0.68)]);
            for (x, y) in [(0.24, 0.46), (0.46, 0.24)] {
                line(&[(x, y), (x + 0.14, y + 0.14)]);
            }
        }
        Tool::Joint => {
            line(&[(0.18, 0.82), (0.42, 0.38), (0.86, 0.2)]);
            for (x, y) in [(0.18, 0.82), (0.42, 0.38), (0.86, 0.2)] {
                painter.circle(at(x, y), 3.2, Color32::TRANSPARENT, stroke);
            }
        }
    }
}
