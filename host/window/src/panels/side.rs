//! The panel at the right: the steps, and what the chosen one is made of.

use super::{parameters, regions, steps};
use crate::window::Window;
use eframe::egui::{Frame, Margin, Panel, RichText, ScrollArea, Ui};

/// The panel.
pub fn show(ui: &mut Ui, window: &mut Window) {
    let frame =
        Frame::side_top_panel(ui.style()).inner_margin(Margin { left: 12, right: 0, top: 10, bottom: 6 });
    Panel::right("side").frame(frame).default_size(360.0).size_range(300.0..=560.0).show(ui, |ui| {
        ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            Frame::NONE.inner_margin(Margin { left: 0, right: 12, top: 0, bottom: 8 }).show(ui, |ui| {
                steps::show(ui, window);
                parameters::show(ui, window);
                regions::show(ui, window);
            });
        });
    });
}

/// The heading of a part of the panel.
pub fn heading(ui: &mut Ui, text: &str, right: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(text).strong().size(14.0));
        ui.with_layout(eframe::egui::Layout::right_to_left(eframe::egui::Align::Center), right);
    });
    ui.add_space(2.0);
}

/// Space and a line between two parts.
pub fn part(ui: &mut Ui) {
    ui.add_space(8.0);
    ui.separator();
    ui.add_space(4.0);
}
