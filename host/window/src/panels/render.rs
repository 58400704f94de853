//! What pictures that are saved have in common: how large they are, and whether their background is seen through.

use crate::screenshot::{Format, LARGEST};
use eframe::egui::{Button, DragValue, RichText, Ui};

/// Sizes that have a name.
const SIZES: [(&str, [u32; 2]); 3] =
    [("Full HD", [1920, 1080]), ("4K", [3840, 2160]), ("Square", [2048, 2048])];

/// Fields for width, height and background.
pub fn fields(ui: &mut Ui, format: &mut Format, shown: [u32; 2]) {
    ui.horizontal(|ui| {
        ui.label("Size");
        for (side, name) in format.size.iter_mut().zip(["Width", "Height"]) {
            let field = ui.add(DragValue::new(side).range(16..=LARGEST).speed(8.0));
            field.ctx.accesskit_node_builder(field.id, |node| node.set_label(format!("{name} in pixels")));
            if name == "Width" {
                ui.label("\u{d7}");
            }
        }
        ui.label(RichText::new("pixels").weak());
    });
    ui.horizontal(|ui| {
        for (name, size) in [("As Shown", shown)].into_iter().chain(SIZES) {
            if ui.add(Button::selectable(format.size == size, name)).clicked() {
                format.size = size;
            }
        }
    });
    ui.add_space(2.0);
    ui.checkbox(&mut format.transparent, "Transparent background");
}
