//! The question before a turntable is drawn: the number of its frames, their size and background, their
//! folder.

use super::frames::modal;
use super::render::{self, RenderAnswer};
use crate::dialogs::Purpose;
use crate::rendering::{begin, shown_size};
use crate::turntable::RATE;
use crate::window::{Commands, Window};
use eframe::egui::{self, DragValue, Id, Modal, RichText};
use simod_picture::FrameFolder;
use std::path::Path;

/// Shows the question while it is asked.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let Some(mut turntable) = window.turntable.clone() else { return };
    let shown = shown_size(window);
    let mut done = None;
    let modal = Modal::new(Id::unique("turntable")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(460.0);
        ui.heading("Render a turntable");
        ui.label(RichText::new("PNG pictures of a full turn, as the model is seen now.").weak());
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            ui.label("Frames");
            let frames = DragValue::new(&mut turntable.frames).range(2..=FrameFolder::MOST);
            let frames = ui.add(frames);
            frames.ctx.accesskit_node_builder(frames.id, |node| node.set_label("Frames"));
            let seconds = f64::from(turntable.frames) / f64::from(RATE);
            ui.label(RichText::new(format!("{seconds:.1} s at 30 frames a second")).weak());
        });
        ui.add_space(4.0);
        render::fields(ui, &mut turntable.format, shown);
        ui.add_space(4.0);
        render::place(
            ui,
            ["Folder", "A new folder", "Folder of the frames"],
            &mut turntable.folder,
            &mut done,
        );
        render::buttons(ui, "Render", &turntable.folder, &mut done);
    });
    if modal.should_close() && window.prompt.is_none() {
        done = done.or(Some(RenderAnswer::Cancel));
    }
    match done {
        Some(RenderAnswer::Do) => {
            commands.then(|window| window.turntable = None);
            begin(window, commands, Path::new(turntable.folder.trim()), turntable.frames, turntable.format);
        }
        Some(RenderAnswer::Cancel) => commands.then(|window| window.turntable = None),
        Some(RenderAnswer::Browse) => commands.then(move |window| {
            window.turntable = Some(turntable);
            window.ask(Purpose::Turntable);
        }),
        None => commands.then(move |window| window.turntable = Some(turntable)),
    }
}
