//! What has to be answered before something goes on.

use super::frames::modal;
use crate::dialogs::Purpose;
use crate::numbers::ago;
use crate::theme;
use crate::window::{Ask, Asks, KeptEdit, Leaving, Question, Window};
use eframe::egui::{self, Button, Color32, Id, Modal, RichText, Ui};
use std::path::Path;

fn first(ui: &mut Ui, text: &str) -> bool {
    let text = RichText::new(text).color(Color32::WHITE);
    ui.add(Button::new(text).fill(theme::ACCENT)).clicked()
}

/// What comes of the question being taken back: nothing.
fn nothing() -> Ask {
    Box::new(|_| ())
}

/// Asks, if there is something to ask.
pub fn show(ctx: &egui::Context, window: &Window, asks: &mut Asks) {
    let Some(question) = &window.question else { return };
    let modal = Modal::new(Id::unique("question")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(380.0);
        match question {
            Question::Unsaved(leaving) => unsaved(ui, leaving),
            Question::Recover(kept) => recover(ui, kept),
            Question::Moved { path, model, is_open } => moved(ui, path, model, *is_open),
        }
    });
    let closed = modal.should_close();
    if let Some(then) = modal.inner.or_else(|| closed.then(nothing)) {
        asks.then(|window| {
            // What comes of it may ask another one.
            window.question = None;
            then(window);
        });
    }
}

/// What to do, once it is known.
fn unsaved(ui: &mut Ui, leaving: &Leaving) -> Option<Ask> {
    ui.heading("Save the edit?");
    ui.add_space(6.0);
    ui.label("There are changes that are not saved yet.");
    ui.add_space(10.0);
    let mut then: Option<Ask> = None;
    ui.horizontal(|ui| {
        if first(ui, "Save") {
            let leaving = leaving.clone();
            then = Some(Box::new(|window| window.save_and_leave(leaving)));
        }
        if ui.button("Discard").clicked() {
            let leaving = leaving.clone();
            then = Some(Box::new(|window| window.discard(leaving)));
        }
        if ui.button("Cancel").clicked() {
            then = Some(nothing());
        }
    });
    then
}

/// What to do, once it is known.
fn recover(ui: &mut Ui, kept: &KeptEdit) -> Option<Ask> {
    ui.heading("Recover the edit?");
    ui.add_space(6.0);
    ui.label(format!("{} was edited, and not saved before the program ended.", kept.path.display()));
    let steps = if kept.steps == 1 { "1 step".to_owned() } else { format!("{} steps", kept.steps) };
    ui.label(RichText::new(format!("Kept {}: {steps}", ago(kept.made))).strong());
    ui.add_space(10.0);
    let mut then: Option<Ask> = None;
    ui.horizontal(|ui| {
        if first(ui, "Recover") {
            let (path, sampling) = (kept.path.clone(), kept.sampling);
            then = Some(Box::new(move |window| window.open_now(path, sampling, true)));
        }
        let discard =
            ui.button("Discard It").on_hover_text("Open it as it was saved; what was kept goes away");
        if discard.clicked() {
            let kept = kept.clone();
            then = Some(Box::new(move |window| window.open_without(&kept)));
        }
        if ui.button("Cancel").clicked() {
            then = Some(nothing());
        }
    });
    then
}

/// What to do, once it is known.
fn moved(ui: &mut Ui, path: &Path, model: &Path, is_open: bool) -> Option<Ask> {
    ui.heading("Where is the model?");
    ui.add_space(6.0);
    ui.label(format!("{} is not there any more.", model.display()));
    let without = "Its samples can be edited without it; full detail, refinement and writing need it.";
    ui.label(RichText::new(if is_open { without } else { "It is needed to open the session." }).weak());
    ui.add_space(10.0);
    let mut then: Option<Ask> = None;
    ui.horizontal(|ui| {
        if first(ui, "Locate\u{2026}") {
            let purpose = Purpose::Locate { path: path.to_owned(), model: model.to_owned() };
            then = Some(Box::new(|window| window.ask(purpose)));
        }
        if ui.button(if is_open { "Go On without It" } else { "Cancel" }).clicked() {
            then = Some(nothing());
        }
    });
    then
}
