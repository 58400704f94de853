//! Controls that all dialogs for saved pictures share: size, background, place of the file or folder.

use crate::screenshot::{LARGEST, ScreenshotFormat};
use crate::theme;
use eframe::egui::{self, Button, Color32, DragValue, RichText, TextEdit, Ui};

/// Sizes that have a name.
const SIZES: [(&str, [u32; 2]); 3] =
    [("Full HD", [1920, 1080]), ("4K", [3840, 2160]), ("Square", [2048, 2048])];

/// Fields for width, height and background.
pub fn fields(ui: &mut Ui, format: &mut ScreenshotFormat, shown: [u32; 2]) {
    ui.horizontal(|ui| {
        ui.label("Size");
        let [width, height] = &mut format.size;
        side(ui, width, "Width in pixels");
        ui.label("\u{d7}");
        side(ui, height, "Height in pixels");
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

/// Field for a side of the picture, in pixels, with a name for those who do not see the field.
fn side(ui: &mut Ui, pixels: &mut u32, name: &str) {
    let field = ui.add(DragValue::new(pixels).range(16..=LARGEST).speed(8.0));
    field.ctx.accesskit_node_builder(field.id, |node| node.set_label(name));
}

/// The user's answer.
pub enum RenderAnswer {
    /// The picture shall be made.
    Do,
    /// The picture's file shall be chosen.
    Browse,
    /// No picture shall be made.
    Cancel,
}

/// Field for the path of the file or folder, with a button to choose it.
pub fn place(
    ui: &mut Ui,
    [label, hint, name]: [&str; 3],
    path: &mut String,
    answer: &mut Option<RenderAnswer>,
) {
    ui.horizontal(|ui| {
        ui.label(label);
        if ui.button("Browse\u{2026}").clicked() {
            *answer = Some(RenderAnswer::Browse);
        }
        let field = ui.add(TextEdit::singleline(path).desired_width(f32::INFINITY).hint_text(hint));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label(name));
    });
}

/// The buttons below, of which the first one `does` the job, enabled where the path is known.
pub fn buttons(ui: &mut Ui, does: &str, path: &str, answer: &mut Option<RenderAnswer>) {
    ui.add_space(10.0);
    ui.horizontal(|ui| {
        let button = Button::new(RichText::new(does).color(Color32::WHITE)).fill(theme::ACCENT);
        let is_named = !path.trim().is_empty();
        if ui.add_enabled(is_named, button.min_size(egui::vec2(80.0, 0.0))).clicked() {
            *answer = Some(RenderAnswer::Do);
        }
        if ui.button("Cancel").clicked() {
            *answer = Some(RenderAnswer::Cancel);
        }
    });
}
