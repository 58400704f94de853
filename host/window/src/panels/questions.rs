//! What has to be answered before something goes on.

use crate::theme;
use crate::window::{Leaving, Question, Window};
use eframe::egui::{self, Button, Color32, Id, Modal, RichText, Ui};

fn first(ui: &mut Ui, text: &str) -> bool {
    let text = RichText::new(text).color(Color32::WHITE);
    ui.add(Button::new(text).fill(theme::ACCENT)).clicked()
}

/// Asks, if there is something to ask.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let Some(question) = window.question.take() else { return };
    let mut again = true;
    let modal = Modal::new(Id::unique("question")).frame(super::modal(ctx)).show(ctx, |ui| {
        ui.set_width(380.0);
        match &question {
            Question::Unsaved(leaving) => again = unsaved(ui, window, leaving),
            Question::Recover(path, sampling) => {
                ui.heading("Recover the edit?");
                ui.add_space(6.0);
                ui.label(format!("{} was edited, and not saved before the program ended.", path.display()));
                ui.add_space(10.0);
                ui.horizontal(|ui| {
                    for (text, recover) in [("Recover", true), ("Open without It", false)] {
                        let clicked = if recover { first(ui, text) } else { ui.button(text).clicked() };
                        if clicked {
                            again = false;
                            window.open_now(path.clone(), *sampling, recover);
                        }
                    }
                    again &= !ui.button("Cancel").clicked();
                });
            }
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
            window.leave(leaving.clone());
        }
        again &= !ui.button("Cancel").clicked();
    });
    again
}
