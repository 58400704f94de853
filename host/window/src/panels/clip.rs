//! The panel of the plane that cuts the model open: its axis and its place.

use super::card;
use crate::clip::{across, reach};
use crate::window::{Commands, Window};
use eframe::egui::{Align2, Area, Button, Id, Order, Rect, RichText, Slider, Ui, vec2};
use glam::DVec3;
use simod_viewer::{Clip, Command};

const MARGIN: f32 = 12.0;
/// Height of the panel, in points.
pub const HEIGHT: f32 = 46.0;

/// Shows the panel at the lower left, while the model is cut open.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    let Some(clip) = window.state().clipped() else { return };
    let area = Area::new(Id::unique("clip")).order(Order::Middle).movable(false);
    let area = area.pivot(Align2::LEFT_BOTTOM).fixed_pos(rect.left_bottom() + vec2(MARGIN, -MARGIN));
    area.show(ui.ctx(), |ui| {
        card(ui).show(ui, |ui| ui.horizontal(|ui| content(ui, window, commands, clip)));
    });
}

fn content(ui: &mut Ui, window: &Window, commands: &mut Commands, clip: Clip) {
    let normal = clip.normal.normalize_or(DVec3::X);
    ui.label(RichText::new("Cut").strong());
    for (name, axis) in [("X", DVec3::X), ("Y", DVec3::Y), ("Z", DVec3::Z)] {
        let on = normal.dot(axis).abs() > 1.0 - 1e-9;
        let response =
            ui.add(Button::selectable(on, name)).on_hover_text("Cuts across this axis of the model");
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(format!("Cut across {name}")));
        if response.clicked() {
            let clip = across(window, axis);
            commands.apply(Command::Clip(clip));
        }
    }
    let facing = ui.button("View").on_hover_text("Cuts across the direction of view");
    if facing.clicked() {
        let clip = across(window, window.state().camera().axes()[2]);
        commands.apply(Command::Clip(clip));
    }
    ui.separator();
    if let Some([from, to]) = reach(window, normal) {
        let mut place = (normal.dot(clip.through) - from) / (to - from).max(f64::MIN_POSITIVE);
        ui.spacing_mut().slider_width = 150.0;
        let slider = Slider::new(&mut place, 0.0..=1.0).show_value(false);
        let response = ui.add(slider).on_hover_text("Place of the plane between the ends of the model");
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Place of the cut"));
        if response.changed() {
            let way = from + place * (to - from) - normal.dot(clip.through);
            commands.apply(Command::Clip(Some(Clip { normal, through: clip.through + normal * way })));
        }
    }
    if ui.button("Flip").on_hover_text("Cuts the other side away").clicked() {
        commands.apply(Command::Clip(Some(clip.flipped())));
    }
    let close = ui.button("Close").on_hover_text("Shows the whole model again (Alt+B)");
    close.ctx.accesskit_node_builder(close.id, |node| node.set_label("Close the cut"));
    if close.clicked() {
        commands.apply(Command::Clip(None));
    }
}
