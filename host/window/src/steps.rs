//! Actions on steps, for their rows, keys and names.

use crate::axis;
use crate::tools::Tool;
use crate::window::{Commands, Renaming, Window};
use eframe::egui::ViewportCommand;
use simod_model::Result;
use simod_session::Plugin;
use simod_session::edit::{Change, EditCommand, free_name, group_at};
use simod_viewer::Command;

/// Adds a step, and takes the tool that it needs.
pub fn added(commands: &mut Commands, plugin: &Plugin, at: Option<usize>) {
    let consumes = plugin.consumes();
    commands.apply_then(Command::AddStep { plugin: plugin.id().to_owned(), at }, move |window| {
        window.tools.target = None;
        if consumes.strokes {
            window.tools.take(Tool::Stroke);
        } else if consumes.joints {
            window.tools.take(Tool::Joint);
        } else if consumes.handle_regions && window.state().selection().is_empty() {
            window.tools.take(Tool::Brush);
        } else if !window.tools.tool.grabs() {
            window.tools.take(Tool::Move);
        }
        window.draw(axis::frame_new);
    });
}

/// Begins the typing of a step's name.
pub fn rename(window: &Window, commands: &mut Commands, at: usize) {
    let Some(entry) = window.steps().get(at).cloned() else { return };
    let text = entry.step.title.clone().unwrap_or_default();
    let renaming = Renaming { id: entry.id, of_group: false, text, begins: true };
    commands.then(|window| window.renaming = Some(renaming));
}

/// Begins the typing of the name of the group that a step begins.
pub fn rename_group(window: &Window, commands: &mut Commands, at: usize) {
    let Some(entry) = window.steps().get(at).cloned() else { return };
    let text = entry.step.group.clone().unwrap_or_default();
    let renaming = Renaming { id: entry.id, of_group: true, text, begins: true };
    commands.then(|window| window.renaming = Some(renaming));
}

/// Puts a step into the group of the one above, or makes a group of both.
pub fn group(window: &Window, commands: &mut Commands, at: usize) {
    let (Some(above), all) = (at.checked_sub(1), window.steps()) else { return };
    let same = group_at(&all, above).is_some_and(|group| group.contains(&at));
    if same || at >= all.len() {
        return;
    }
    let command = match all[above].step.group {
        Some(_) => EditCommand::JoinGroup { from: at, at: above },
        None => EditCommand::Group { steps: above..at + 1, name: Some(free_name(&all, "Group")) },
    };
    commands.apply(Command::Edit(command));
}

/// Takes a step out of its group.
pub fn ungroup(_: &Window, commands: &mut Commands, at: usize) {
    commands.apply(Command::Edit(EditCommand::Group { steps: at..at + 1, name: None }));
}

/// Puts all steps of a group on the clipboard, as the text of a session.
pub fn copy_group(window: &Window, commands: &mut Commands, at: usize) {
    let text = window.state().copied_group(at);
    put_on_clipboard(window, commands, text, "The group is copied");
}

/// Adds a step that is like another one, behind that one.
pub fn duplicate(window: &Window, commands: &mut Commands, at: usize) {
    let Some(entry) = window.steps().get(at).cloned() else { return };
    let add = EditCommand::Add { at: at + 1, step: Box::new((*entry.step).clone()) };
    commands.apply_then(Command::Edit(add), move |window| {
        window.apply(Command::Choose { step: Some(at + 1) });
        window.tools.target = None;
    });
}

/// Puts a step on the clipboard, as the text of a session.
pub fn copy(window: &Window, commands: &mut Commands, at: usize) {
    let text = window.state().copied(at);
    put_on_clipboard(window, commands, text, "The step is copied");
}

fn put_on_clipboard(window: &Window, commands: &mut Commands, text: Result<String>, done: &'static str) {
    match text {
        Ok(text) => {
            window.ctx().copy_text(text);
            let then = "paste it into this edit, another one, or a session\u{2019}s file.";
            commands.then(move |window| window.toasts.note(format!("{done}: {then}")));
        }
        Err(error) => commands.then(move |window| window.toasts.error(&error)),
    }
}

/// Asks the system for the text on the clipboard, which becomes steps behind this one.
pub fn ask_to_paste(window: &Window, commands: &mut Commands, at: usize) {
    commands.apply(Command::Choose { step: Some(at) });
    window.ctx().send_viewport_cmd(ViewportCommand::RequestPaste);
}

/// Adds the steps of a text behind the chosen one.
pub fn paste(commands: &mut Commands, text: String) {
    commands.apply_then(Command::Paste { text, at: None }, |window| window.tools.target = None);
}

/// Name of the action that [`solo`] does with a step.
pub fn solo_name(window: &Window, at: usize) -> &'static str {
    if is_alone(window, at) { "With the Others Again" } else { "Only This Step" }
}

/// Whether all other deformations are switched off.
pub fn is_alone(window: &Window, at: usize) -> bool {
    window.state().document().is_some_and(|document| document.is_alone(at))
}

/// Switches all other deformations off, or on again.
pub fn solo(_: &Window, commands: &mut Commands, at: usize) {
    commands.apply(Command::Edit(EditCommand::Solo { at }));
}

/// Changes the amount of the chosen step, in steps of a tenth.
pub fn change_amount(window: &Window, commands: &mut Commands, by: f64) {
    let Some((at, _, deformation, _)) = window.chosen() else { return };
    let amount = (10.0 * (deformation.amount + by)).round() / 10.0;
    commands.change(at, Change::SetAmount(amount.clamp(0.0, 1.0)), false);
}
