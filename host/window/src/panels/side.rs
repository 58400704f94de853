//! The panel at the right: the list of steps, and the parts of the chosen one.

use super::{parameters, refinement, regions, steps, strokes};
use crate::window::{Commands, Window};
use eframe::egui::{Frame, Margin, Panel, ScrollArea, Ui};

/// The panel.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let frame =
        Frame::side_top_panel(ui.style()).inner_margin(Margin { left: 12, right: 0, top: 10, bottom: 6 });
    Panel::right("side").frame(frame).default_size(360.0).size_range(300.0..=560.0).show(ui, |ui| {
        ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            Frame::NONE.inner_margin(Margin { left: 0, right: 12, top: 0, bottom: 8 }).show(ui, |ui| {
                steps::show(ui, window, commands);
                parameters::show(ui, window, commands);
                refinement::show(ui, window, commands);
                regions::show(ui, window, commands);
                strokes::show(ui, window, commands);
            });
        });
    });
}
