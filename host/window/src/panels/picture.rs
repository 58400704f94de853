//! The question before a picture is saved: its size, its background, its file.

use super::frames::modal;
use super::render::{self, RenderAnswer};
use crate::dialogs::Purpose;
use crate::rendering::{begin_picture, shown_size};
use crate::window::{Commands, Window};
use eframe::egui::{self, Id, Modal, RichText};
use std::path::Path;

/// Shows the question while it is asked.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let Some(mut picture) = window.picture.clone() else { return };
    let shown = shown_size(window);
    let mut done = None;
    let modal = Modal::new(Id::unique("picture")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(460.0);
        ui.heading("Save a picture");
        let what = "The model as it is seen now, without selection, handles and what is measured.";
        ui.label(RichText::new(what).weak());
        ui.add_space(8.0);
        render::fields(ui, &mut picture.format, shown);
        ui.add_space(4.0);
        render::place(ui, ["File", "A PNG file", "File of the picture"], &mut picture.file, &mut done);
        if Path::new(picture.file.trim()).is_file() {
            ui.label(RichText::new("This file is there: it is replaced.").color(ui.visuals().warn_fg_color));
        }
        render::buttons(ui, "Save", &picture.file, &mut done);
    });
    if modal.should_close() && window.prompt.is_none() {
        done = done.or(Some(RenderAnswer::Cancel));
    }
    match done {
        Some(RenderAnswer::Do) => {
            commands.then(|window| window.picture = None);
            let path = Path::new(picture.file.trim());
            let path = if path.extension().is_some() { path.to_owned() } else { path.with_extension("png") };
            begin_picture(window, commands, &path, picture.format);
        }
        Some(RenderAnswer::Cancel) => commands.then(|window| window.picture = None),
        Some(RenderAnswer::Browse) => commands.then(move |window| {
            window.picture = Some(picture);
            window.ask(Purpose::Picture);
        }),
        None => commands.then(move |window| window.picture = Some(picture)),
    }
}
