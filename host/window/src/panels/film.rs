//! The command that makes a film of the frames of a turntable, once they are there.

use super::frames::modal;
use crate::turntable::{Film, film};
use crate::window::{Commands, Window};
use eframe::egui::{self, DragValue, Id, Modal, RichText, TextEdit};

/// Shows the command until it is closed.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let Some(Film { folder, frames, transparent, mut rate }) = window.film.clone() else { return };
    let mut close = false;
    let modal = Modal::new(Id::unique("film")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(520.0);
        ui.heading("The turntable is there");
        ui.label(RichText::new(format!("{frames} frames in {}", folder.display())).weak());
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            ui.label("A film of");
            let field = ui.add(DragValue::new(&mut rate).range(1..=240));
            field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Frames a second"));
            let seconds = f64::from(frames) / f64::from(rate);
            ui.label(format!("frames a second, {seconds:.1} s long, is made by this command line:"));
        });
        ui.add_space(4.0);
        let mut text = film(&folder, rate, transparent);
        let field = TextEdit::multiline(&mut text).code_editor().desired_rows(3).desired_width(f32::INFINITY);
        let field = ui.add(field);
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Command line for a film"));
        ui.add_space(10.0);
        ui.horizontal(|ui| {
            if ui.button("Copy the Command Line").clicked() {
                ui.ctx().copy_text(film(&folder, rate, transparent));
                commands.then(|window| window.toasts.note("The command line is on the clipboard."));
            }
            close = ui.button("Close").clicked();
        });
    });
    let closed = close || modal.should_close();
    let film = (!closed).then_some(Film { folder, frames, transparent, rate });
    commands.then(move |window| window.film = film);
}
