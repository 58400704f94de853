//! Questions that have to be answered before something goes on.

use super::frames::modal;
use crate::dialogs::Purpose;
use crate::numbers::ago;
use crate::theme;
use crate::window::{Commands, KeptEdit, Leaving, Question, Window};
use eframe::egui::{self, Button, Color32, Id, Modal, RichText, Ui};
use std::path::Path;

fn first(ui: &mut Ui, text: &str) -> bool {
    let text = RichText::new(text).color(Color32::WHITE);
    ui.add(Button::new(text).fill(theme::ACCENT)).clicked()
}

/// Asks, if there is something to ask.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let Some(question) = &window.question else { return };
    let mut answer = Commands::default();
    let modal = Modal::new(Id::unique("question")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(380.0);
        match question {
            Question::Unsaved(leaving) => unsaved(ui, &mut answer, leaving),
            Question::Recover(kept) => recover(ui, &mut answer, kept),
            Question::Moved { path, model, is_open } => moved(ui, &mut answer, path, model, *is_open),
        }
    });
    if modal.inner || modal.should_close() {
        // The commands of an answer may ask another question, so this one goes first.
        commands.then(|window| window.question = None);
        commands.append(answer);
    }
}

/// Asks whether to save the edit. Returns whether there is an answer: the edit is saved, discarded, or
/// stays open.
fn unsaved(ui: &mut Ui, answer: &mut Commands, leaving: &Leaving) -> bool {
    ui.heading("Save the edit?");
    ui.add_space(6.0);
    ui.label("There are changes that are not saved yet.");
    ui.add_space(10.0);
    let mut answered = false;
    ui.horizontal(|ui| {
        if first(ui, "Save") {
            let leaving = leaving.clone();
            answer.then(|window| window.save_and_leave(leaving));
            answered = true;
        }
        if ui.button("Discard").clicked() {
            let leaving = leaving.clone();
            answer.then(|window| window.discard(leaving));
            answered = true;
        }
        if ui.button("Cancel").clicked() {
            answered = true;
        }
    });
    answered
}

/// Asks whether to recover an edit. Returns whether there is an answer: the edit that was kept is opened,
/// discarded, or left alone.
fn recover(ui: &mut Ui, answer: &mut Commands, kept: &KeptEdit) -> bool {
    ui.heading("Recover the edit?");
    ui.add_space(6.0);
    ui.label(format!("{} was edited, and not saved before the program ended.", kept.path.display()));
    let steps = if kept.steps == 1 { "1 step".to_owned() } else { format!("{} steps", kept.steps) };
    ui.label(RichText::new(format!("Kept {}: {steps}", ago(kept.made))).strong());
    ui.add_space(10.0);
    let mut answered = false;
    ui.horizontal(|ui| {
        if first(ui, "Recover") {
            let (path, sampling) = (kept.path.clone(), kept.sampling);
            answer.then(move |window| window.open_now(path, sampling, true));
            answered = true;
        }
        let discard =
            ui.button("Discard It").on_hover_text("Opens it as it was saved; the kept edit is lost");
        if discard.clicked() {
            let kept = kept.clone();
            answer.then(move |window| window.open_without(&kept));
            answered = true;
        }
        if ui.button("Cancel").clicked() {
            answered = true;
        }
    });
    answered
}

/// Asks for a model that is not at its place. Returns whether there is an answer: the model is looked for,
/// or not.
fn moved(ui: &mut Ui, answer: &mut Commands, path: &Path, model: &Path, is_open: bool) -> bool {
    ui.heading("Where is the model?");
    ui.add_space(6.0);
    ui.label(format!("{} is not there any more.", model.display()));
    let without = "Its samples can be edited without it; full detail, refinement and writing need it.";
    ui.label(RichText::new(if is_open { without } else { "It is needed to open the session." }).weak());
    ui.add_space(10.0);
    let mut answered = false;
    ui.horizontal(|ui| {
        if first(ui, "Locate\u{2026}") {
            let purpose = Purpose::Locate { path: path.to_owned(), model: model.to_owned() };
            answer.then(|window| window.ask(purpose));
            answered = true;
        }
        if ui.button(if is_open { "Go On without It" } else { "Cancel" }).clicked() {
            answered = true;
        }
    });
    answered
}
