//! The field for a path that is typed, where the system has no dialogs for files.

use super::frames::modal;
use crate::dialogs::Purpose;
use crate::theme;
use crate::window::{Commands, Prompt, Window, common};
use eframe::egui::text::{CCursor, CCursorRange};
use eframe::egui::text_edit::TextEditState;
use eframe::egui::{self, Button, Color32, Id, Key, Modal, Modifiers, RichText, ScrollArea, TextEdit, Ui};

/// Message about what is wrong with the typed path, or a warning that it names a file which is replaced.
fn warning(ui: &mut Ui, typed: &Prompt) {
    if let Some(wrong) = &typed.wrong {
        ui.label(RichText::new(wrong).color(ui.visuals().error_fg_color));
    } else if matches!(typed.purpose, Purpose::Save | Purpose::Write | Purpose::Picture)
        && typed.path().is_file()
    {
        ui.label(RichText::new("This file is there: it is replaced.").color(ui.visuals().warn_fg_color));
    }
}

/// Shows the field in which a path is typed, while it is open.
pub fn show(ctx: &egui::Context, commands: &mut Commands, prompt: &mut Option<Prompt>) {
    let Some(typed) = prompt else { return };
    let mut done = None;
    let modal = Modal::new(Id::unique("prompt")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(560.0);
        ui.heading(typed.purpose.title());
        if !typed.why.is_empty() {
            let why = format!("The system shows no dialog for files: {}. Type the path.", typed.why);
            ui.label(RichText::new(why).small().weak());
        }
        ui.add_space(8.0);
        let names = typed.completions();
        if ui.input_mut(|i| i.consume_key(Modifiers::NONE, Key::Tab))
            && let Some(name) = common(&names)
        {
            typed.complete(&name);
        }
        let enter = field(ui, typed);
        offered(ui, typed, &names);
        warning(ui, typed);
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
        Some(true) => match typed.defect() {
            None => {
                let (purpose, path) = (typed.purpose.clone(), typed.path());
                *prompt = None;
                commands.then(move |window| window.answered(purpose, path));
            }
            wrong => typed.wrong = wrong,
        },
        None if !modal.should_close() => {}
        Some(false) | None => {
            *prompt = None;
            commands.then(Window::not_answered);
        }
    }
}

/// Shows the field of the text. Returns whether the user confirms the text.
fn field(ui: &mut Ui, prompt: &mut Prompt) -> bool {
    let id = Id::unique("path that is typed");
    // Tab completes the path, and does not leave the field for the next control.
    let field = TextEdit::singleline(&mut prompt.text).id(id).lock_focus(true);
    let field = field.hint_text("Path of the file").desired_width(f32::INFINITY);
    let field = ui.add(field.margin(egui::Margin::symmetric(8, 6)));
    field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Path of the file"));
    if field.changed() {
        prompt.wrong = None;
    }
    let enter = field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
    if !field.has_focus() {
        field.request_focus();
    } else if let Some([from, to]) = prompt.select.take() {
        // The field chooses a place of its own when it gets the focus.
        let mut state = TextEditState::load(ui.ctx(), id).unwrap_or_default();
        let range = CCursorRange::two(CCursor::new(from), CCursor::new(to));
        state.cursor.set_char_range(Some(range));
        state.store(ui.ctx(), id);
        ui.ctx().request_repaint();
    }
    enter
}

/// List of names by which the typed path can be completed.
fn offered(ui: &mut Ui, prompt: &mut Prompt, names: &[String]) {
    if names.is_empty() {
        return;
    }
    ui.label(RichText::new("Tab goes on with what these have in common").small().weak());
    ScrollArea::vertical().max_height(180.0).auto_shrink([false, true]).show(ui, |ui| {
        for name in names {
            if ui.selectable_label(false, name).clicked() {
                prompt.complete(name);
            }
        }
    });
}
