//! What has to be answered before something goes on.

use super::frames::modal;
use crate::dialogs::Purpose;
use crate::numbers::ago;
use crate::theme;
use crate::window::{Kept, Leaving, Question, Window};
use eframe::egui::{self, Button, Color32, Id, Modal, RichText, Ui};
use std::path::Path;

fn first(ui: &mut Ui, text: &str) -> bool {
    let text = RichText::new(text).color(Color32::WHITE);
    ui.add(Button::new(text).fill(theme::ACCENT)).clicked()
}

/// Asks, if there is something to ask.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let Some(question) = window.question.take() else { return };
    let mut again = true;
    let modal = Modal::new(Id::unique("question")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(380.0);
        match &question {
            Question::Unsaved(leaving) => again = unsaved(ui, window, leaving),
            Question::Recover(kept) => again = recover(ui, window, kept),
            Question::Moved { path, model, is_open } => again = moved(ui, window, path, model, *is_open),
        }
    });
    if again && !modal.should_close() && window.question.is_none() {
        window.question = Some(question);
    }
}

/// Whether to ask again.
fn unsaved(ui: &mut Ui, window: &mut Window, leaving: &Leaving) -> bool {
    ui.heading("Save the edit?");
    ui.add_space(6.0);
    ui.label("There are changes that are not saved yet.");
    ui.add_space(10.0);
    let mut again = true;
    ui.horizontal(|ui| {
        if first(ui, "Save") {
            again = false;
            window.save_and_leave(leaving.clone());
        }
        if ui.button("Discard").clicked() {
            again = false;
            window.discard(leaving.clone());
        }
        again &= !ui.button("Cancel").clicked();
    });
    again
}

/// Whether to ask again.
fn recover(ui: &mut Ui, window: &mut Window, kept: &Kept) -> bool {
    ui.heading("Recover the edit?");
    ui.add_space(6.0);
    ui.label(format!("{} was edited, and not saved before the program ended.", kept.path.display()));
    let steps = if kept.steps == 1 { "1 step".to_owned() } else { format!("{} steps", kept.steps) };
    ui.label(RichText::new(format!("Kept {}: {steps}", ago(kept.made))).strong());
    ui.add_space(10.0);
    let mut again = true;
    ui.horizontal(|ui| {
        if first(ui, "Recover") {
            again = false;
            window.open_now(kept.path.clone(), kept.sampling, true);
        }
        let discard =
            ui.button("Discard It").on_hover_text("Open it as it was saved; what was kept goes away");
        if discard.clicked() {
            again = false;
            window.open_without(kept);
        }
        again &= !ui.button("Cancel").clicked();
    });
    again
}

/// Whether to ask again.
fn moved(ui: &mut Ui, window: &mut Window, path: &Path, model: &Path, is_open: bool) -> bool {
    ui.heading("Where is the model?");
    ui.add_space(6.0);
    ui.label(format!("{} is not there any more.", model.display()));
    let without = "Its samples can be edited without it; full detail, refinement and writing need it.";
    ui.label(RichText::new(if is_open { without } else { "It is needed to open the session." }).weak());
    ui.add_space(10.0);
    let mut again = true;
    ui.horizontal(|ui| {
        if first(ui, "Locate\u{2026}") {
            again = false;
            window.ask(Purpose::Locate { path: path.to_owned(), model: model.to_owned() });
        }
        again &= !ui.button(if is_open { "Go On without It" } else { "Cancel" }).clicked();
    });
    again
}
