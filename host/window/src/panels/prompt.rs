//! A path that is typed, where the system has no dialogs for files.

use crate::dialogs::Purpose;
use crate::theme;
use crate::window::Window;
use eframe::egui::{self, Button, Color32, Id, Key, Modal, RichText, TextEdit};
use std::path::PathBuf;

/// A path that is being typed.
pub struct Prompt {
    /// What for.
    pub purpose: Purpose,
    /// So far.
    pub text: String,
}

/// Shows it while it is open.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let Some(mut prompt) = window.prompt.take() else { return };
    let mut done = None;
    let modal = Modal::new(Id::unique("prompt")).frame(super::modal(ctx)).show(ctx, |ui| {
        ui.set_width(460.0);
        ui.heading(prompt.purpose.title());
        ui.add_space(8.0);
        let field =
            TextEdit::singleline(&mut prompt.text).hint_text("Path of the file").desired_width(f32::INFINITY);
        let field = ui.add(field.margin(egui::Margin::symmetric(8, 6)));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Path of the file"));
        if !field.lost_focus() {
            field.request_focus();
        }
        let enter = field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            let ok = Button::new(RichText::new("OK").color(Color32::WHITE)).fill(theme::ACCENT);
            if ui.add(ok.min_size(egui::vec2(80.0, 0.0))).clicked() || enter {
                done = Some(true);
            }
            if ui.button("Cancel").clicked() {
                done = Some(false);
            }
        });
    });
    match done {
        Some(true) if !prompt.text.trim().is_empty() => {
            window.answered(prompt.purpose, PathBuf::from(prompt.text.trim()));
        }
        Some(_) => {}
        None if modal.should_close() => {}
        None => window.prompt = Some(prompt),
    }
}
