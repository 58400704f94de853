//! How many frames a turntable has, and where they go.

use super::frames::modal;
use super::render;
use crate::dialogs::Purpose;
use crate::screenshot::shown_size;
use crate::theme;
use crate::turntable::{RATE, begin};
use crate::window::Window;
use eframe::egui::{self, Button, Color32, DragValue, Id, Modal, RichText, TextEdit};
use simod_picture::FrameFolder;
use std::path::Path;

/// Shows it while it is asked.
pub fn show(ctx: &egui::Context, window: &mut Window) {
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
        ui.horizontal(|ui| {
            ui.label("Folder");
            if ui.button("Browse\u{2026}").clicked() {
                done = Some(Answer::Browse);
            }
            let field = TextEdit::singleline(&mut turntable.folder).desired_width(f32::INFINITY);
            let field = ui.add(field.hint_text("A new folder"));
            field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Folder of the frames"));
        });
        ui.add_space(10.0);
        ui.horizontal(|ui| {
            let render = Button::new(RichText::new("Render").color(Color32::WHITE)).fill(theme::ACCENT);
            let named = !turntable.folder.trim().is_empty();
            if ui.add_enabled(named, render.min_size(egui::vec2(80.0, 0.0))).clicked() {
                done = Some(Answer::Render);
            }
            if ui.button("Cancel").clicked() {
                done = Some(Answer::Cancel);
            }
        });
    });
    if modal.should_close() && window.prompt.is_none() {
        done = done.or(Some(Answer::Cancel));
    }
    match done {
        Some(Answer::Render) => {
            window.turntable = None;
            begin(window, Path::new(turntable.folder.trim()), turntable.frames, turntable.format);
        }
        Some(Answer::Cancel) => window.turntable = None,
        Some(Answer::Browse) => {
            window.turntable = Some(turntable);
            window.ask(Purpose::Turntable);
        }
        None => window.turntable = Some(turntable),
    }
}

enum Answer {
    Render,
    Browse,
    Cancel,
}
