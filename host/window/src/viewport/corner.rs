//! The axes in the corner: they show the model's orientation; a click on one looks along it.

use crate::window::{Commands, Window};
use eframe::egui::{self, Align2, Color32, FontId, Id, Pos2, Rect, Sense, Stroke, Ui, Vec2, vec2};
use glam::DVec3;
use simod_viewer::Command;
use simod_viewer::camera::{Standard, Up};
use simod_viewer::command::CameraMove;

const RADIUS: f32 = 38.0;
const MARGIN: f32 = 14.0;
const BALL: f32 = 9.5;

fn middle(rect: Rect) -> Pos2 {
    rect.right_top() + vec2(-RADIUS - MARGIN, RADIUS + MARGIN)
}

/// Whether the pointer is over the axes.
pub fn contains(rect: Rect, ctx: &egui::Context) -> bool {
    ctx.input(|i| i.pointer.latest_pos()).is_some_and(|p| p.distance(middle(rect)) < RADIUS + BALL)
        && !ctx.input(|i| i.pointer.any_down() && !i.pointer.any_pressed())
}

/// Ends of the axes: their directions, names, colours, and the view along each.
fn ends(up: Up) -> [(DVec3, &'static str, Color32, Standard); 6] {
    let [plus_y, minus_y, plus_z, minus_z] = match up {
        Up::Y => [Standard::Top, Standard::Bottom, Standard::Front, Standard::Back],
        Up::Z => [Standard::Back, Standard::Front, Standard::Top, Standard::Bottom],
    };
    [
        (DVec3::X, "X", Color32::from_rgb(226, 62, 68), Standard::Right),
        (DVec3::NEG_X, "-X", Color32::from_rgb(226, 62, 68), Standard::Left),
        (DVec3::Y, "Y", Color32::from_rgb(106, 176, 46), plus_y),
        (DVec3::NEG_Y, "-Y", Color32::from_rgb(106, 176, 46), minus_y),
        (DVec3::Z, "Z", Color32::from_rgb(62, 128, 236), plus_z),
        (DVec3::NEG_Z, "-Z", Color32::from_rgb(62, 128, 236), minus_z),
    ]
}

/// Draws the axes, and looks along the one that is clicked.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    let center = middle(rect);
    let area = Rect::from_center_size(center, Vec2::splat(2.0 * RADIUS));
    if rect.width() < 400.0 {
        return;
    }
    let camera = *window.state().camera();
    let [right, up, back] = camera.axes();
    let of = |axis: DVec3| {
        let at = center + vec2(axis.dot(right) as f32, -axis.dot(up) as f32) * (RADIUS - BALL);
        (at, axis.dot(back))
    };
    let mut ends = ends(camera.up);
    ends.sort_by(|a, b| of(a.0).1.total_cmp(&of(b.0).1));
    let response = ui.interact(area, Id::unique("axes"), Sense::hover());
    if response.hovered() {
        ui.painter().circle_filled(center, RADIUS + 4.0, Color32::from_white_alpha(24));
    }
    for (axis, name, color, standard) in ends {
        let (at, _) = of(axis);
        let positive = name.len() == 1;
        let ball = Rect::from_center_size(at, Vec2::splat(2.0 * BALL));
        let click = ui.interact(ball, Id::unique(("axis", name)), Sense::click());
        click.widget_info(|| {
            egui::WidgetInfo::labeled(egui::Role::Button, true, format!("Look along {name}"))
        });
        let painter = ui.painter();
        let fill = if click.hovered() { Color32::WHITE } else { color };
        if positive {
            painter.line_segment([center, at], Stroke::new(2.5, color));
            painter.circle_filled(at, BALL, fill);
            let text = Color32::from_rgb(24, 24, 28);
            painter.text(at, Align2::CENTER_CENTER, name, FontId::proportional(12.5), text);
        } else {
            painter.circle(at, BALL - 2.0, color.gamma_multiply(0.25), Stroke::new(1.5, fill));
        }
        if click.clicked() {
            commands.apply(Command::Camera(CameraMove::Look(standard)));
        }
    }
}
