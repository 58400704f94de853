//! The plane that cuts the model open: along what, and where.

use super::card;
use crate::window::Window;
use eframe::egui::{Align2, Area, Button, Id, Order, Rect, RichText, Slider, Ui, vec2};
use glam::DVec3;
use simod_viewer::{Clip, Command};

const MARGIN: f32 = 12.0;
/// How much of the picture's height it takes.
pub const HEIGHT: f32 = 46.0;

/// Opens the model by a plane through its middle that faces the eye, or closes it.
pub fn switch(window: &mut Window) {
    let clip = match window.state().clipped() {
        Some(_) => None,
        None => across(window, window.state().camera().axes()[2]),
    };
    window.apply(Command::Clip(clip));
}

/// A plane through the model's middle.
fn across(window: &Window, normal: DVec3) -> Option<Clip> {
    let [from, to] = reach(window, normal)?;
    let scene = window.state().scene()?;
    let [min, max] = scene.bounds();
    let middle = scene.frame().to_model(0.5 * (min + max));
    let normal = normal.normalize_or(DVec3::X);
    // In the middle of what it can cut.
    let through = middle + normal * (0.5 * (from + to) - normal.dot(middle));
    Some(Clip { normal, through })
}

/// From where to where a plane of this normal meets the model's box, along the normal, in the model's unit.
fn reach(window: &Window, normal: DVec3) -> Option<[f64; 2]> {
    let scene = window.state().scene()?;
    let corners = scene.bounds().map(|corner| scene.frame().to_model(corner));
    let normal = normal.normalize_or(DVec3::X);
    let ends = |pick: fn(f64, f64) -> f64| {
        (0..3).map(|i| pick(normal[i] * corners[0][i], normal[i] * corners[1][i])).sum()
    };
    Some([ends(f64::min), ends(f64::max)])
}

/// At the lower left, while the model is cut open.
pub fn show(ui: &mut Ui, rect: Rect, window: &mut Window) {
    let Some(clip) = window.state().clipped() else { return };
    let area = Area::new(Id::unique("clip")).order(Order::Middle).movable(false);
    let area = area.pivot(Align2::LEFT_BOTTOM).fixed_pos(rect.left_bottom() + vec2(MARGIN, -MARGIN));
    area.show(ui.ctx(), |ui| {
        card(ui).show(ui, |ui| ui.horizontal(|ui| content(ui, window, clip)));
    });
}

fn content(ui: &mut Ui, window: &mut Window, clip: Clip) {
    let normal = clip.normal.normalize_or(DVec3::X);
    ui.label(RichText::new("Cut").strong());
    for (name, axis) in [("X", DVec3::X), ("Y", DVec3::Y), ("Z", DVec3::Z)] {
        let on = normal.dot(axis).abs() > 1.0 - 1e-9;
        let response = ui.add(Button::selectable(on, name)).on_hover_text("Across this axis of the model");
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(format!("Cut across {name}")));
        if response.clicked() {
            let clip = across(window, axis);
            window.apply(Command::Clip(clip));
        }
    }
    let facing = ui.button("View").on_hover_text("Across the way that is looked along now");
    if facing.clicked() {
        let clip = across(window, window.state().camera().axes()[2]);
        window.apply(Command::Clip(clip));
    }
    ui.separator();
    if let Some([from, to]) = reach(window, normal) {
        let mut place = (normal.dot(clip.through) - from) / (to - from).max(f64::MIN_POSITIVE);
        ui.spacing_mut().slider_width = 150.0;
        let slider = Slider::new(&mut place, 0.0..=1.0).show_value(false);
        let response = ui.add(slider).on_hover_text("Where the plane is between the ends of the model");
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Place of the cut"));
        if response.changed() {
            let way = from + place * (to - from) - normal.dot(clip.through);
            window.apply(Command::Clip(Some(Clip { normal, through: clip.through + normal * way })));
        }
    }
    if ui.button("Flip").on_hover_text("Cuts the other side away").clicked() {
        window.apply(Command::Clip(Some(clip.flipped())));
    }
    let close = ui.button("Close").on_hover_text("Shows the whole model again (Alt+B)");
    close.ctx.accesskit_node_builder(close.id, |node| node.set_label("Close the cut"));
    if close.clicked() {
        window.apply(Command::Clip(None));
    }
}
