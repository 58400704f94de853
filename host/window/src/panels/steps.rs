//! The list of steps, with the state of each.

use super::rows::{Dragged, carried, name_field, put_back, switch};
use super::{count, groups, menu, number, parts};
use crate::regions;
use crate::steps;
use crate::theme;
use crate::window::{Commands, Renaming, Window};
use crate::wording::{in_window, remedies};
use eframe::egui::{
    self, Align, Button, Color32, CornerRadius, Frame, Layout, Margin, Response, RichText, Sense, Spinner,
    Stroke, Ui, UiBuilder,
};
use simod_core::refinement::Finer;
use simod_session::edit::{self, Change, Entry, Status, StepId, group_at};
use simod_session::step::Action;
use simod_viewer::Command;

/// The list.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    parts::heading(ui, "Steps", |ui| {
        ui.menu_button("+ Add Step", |ui| {
            ui.set_min_width(240.0);
            menu::add_step(ui, window, commands, None);
        });
    });
    let steps = window.steps();
    if steps.is_empty() {
        ui.label(
            RichText::new("A step deforms the model, or refines its samples. Add the first one.").weak(),
        );
    }
    let mut at = 0;
    while let Some(entry) = steps.get(at) {
        let Some(group) = group_at(&steps, at) else {
            row(ui, window, commands, at, entry, &steps);
            at += 1;
            continue;
        };
        if groups::show(ui, window, commands, group.clone(), &steps) {
            ui.indent(("steps of a group", entry.id), |ui| {
                group.clone().for_each(|at| row(ui, window, commands, at, &steps[at], &steps));
            });
        }
        at = group.end;
    }
}

fn row(ui: &mut Ui, window: &Window, commands: &mut Commands, at: usize, entry: &Entry, steps: &[Entry]) {
    let chosen = window.state().chosen() == Some(at);
    let visuals = ui.visuals();
    let (fill, stroke) = if chosen {
        (visuals.selection.bg_fill.gamma_multiply(0.28), Stroke::new(1.0, visuals.selection.bg_fill))
    } else {
        (visuals.widgets.inactive.bg_fill.gamma_multiply(0.5), Stroke::new(1.0, Color32::TRANSPARENT))
    };
    let frame = Frame::NONE
        .fill(fill)
        .stroke(stroke)
        .corner_radius(CornerRadius::same(5))
        .inner_margin(Margin::symmetric(8, 5));
    let name = title(window, entry);
    // The controls in the row are laid over the row, so that they take their clicks first.
    let builder = UiBuilder::new().id_salt(entry.id).sense(Sense::click_and_drag());
    let whole = ui.scope_builder(builder, |ui| {
        frame.show(ui, |ui| content(ui, window, commands, at, entry, steps, &name));
    });
    if whole.response.clicked() {
        choose(commands, at, chosen);
    }
    reorder(ui, window, commands, at, entry.id, &name, &whole.response);
    ui.add_space(1.0);
}

/// Moves steps by dragging: the row can be dragged between others, and others beside it.
fn reorder(
    ui: &Ui,
    window: &Window,
    commands: &mut Commands,
    at: usize,
    id: StepId,
    name: &str,
    row: &Response,
) {
    row.dnd_set_drag_payload(Dragged::Step(id));
    let Some(pointer) = ui.input(|i| i.pointer.latest_pos()) else { return };
    if row.dragged() {
        carried(ui, row, name, pointer);
    }
    let Some(dragged) = row.dnd_hover_payload::<Dragged>() else { return };
    let below = pointer.y > row.rect.center().y;
    let y = if below { row.rect.bottom() } else { row.rect.top() };
    ui.painter().hline(row.rect.x_range(), y, Stroke::new(2.0, theme::ACCENT));
    if row.dnd_release_payload::<Dragged>().is_some() {
        dragged.put(window, commands, at + usize::from(below));
    }
}

fn content(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    at: usize,
    entry: &Entry,
    steps: &[Entry],
    name: &str,
) {
    let chosen = window.state().chosen() == Some(at);
    ui.set_min_width(ui.available_width());
    ui.horizontal(|ui| {
        if let Some(enabled) = switch(ui, name, entry.step.enabled, "Do this step, or leave it out") {
            commands.change(at, Change::Enable(enabled), false);
        }
        let text = RichText::new(name);
        let text = if entry.step.enabled { text.strong() } else { text.weak() };
        let label = Button::new(text).frame(false).truncate();
        let renamed =
            window.renaming.as_ref().filter(|renaming| !renaming.of_group && renaming.id == entry.id);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            more(ui, window, commands, at, entry, steps);
            state(ui, window, at);
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                if let Some(renaming) = renamed {
                    rename(ui, commands, at, renaming.clone());
                    return;
                }
                let label = ui.add(label);
                if label.double_clicked() {
                    steps::rename(window, commands, at);
                } else if label.clicked() {
                    choose(commands, at, chosen);
                }
            });
        });
    });
    messages(ui, window, entry);
    mend(ui, window, commands, at, entry);
}

fn rename(ui: &mut Ui, commands: &mut Commands, at: usize, mut renaming: Renaming) {
    let wanted = name_field(ui, &mut renaming, "as its plugin", &format!("Name of step {}", at + 1));
    let title = Some(renaming.text.trim().to_owned()).filter(|title| !title.is_empty());
    put_back(commands, renaming, wanted.is_none());
    if wanted == Some(true) {
        commands.change(at, Change::SetTitle(title), false);
    }
}

fn choose(commands: &mut Commands, at: usize, chosen: bool) {
    if chosen {
        return;
    }
    commands.apply_then(Command::Choose { step: Some(at) }, |window| window.tools.target = None);
}

/// Title of a step: the user's, or else the plugin's name or that of a refinement.
fn title(window: &Window, entry: &Entry) -> String {
    if let Some(title) = &entry.step.title {
        return title.clone();
    }
    match &entry.step.action {
        Action::Deform(d) => {
            window.state().plugins().get(&d.deform).map_or_else(|_| d.deform.clone(), |p| p.name().to_owned())
        }
        Action::Refine(refine) => match refine.finer {
            Finer::Factor(factor) => format!("Refine, {} times", number(factor)),
            Finer::Error(error) => format!("Refine to {}", number(error)),
            Finer::Samples(samples) => format!("Refine by {}", count(samples)),
            Finer::Auto { .. } => "Refine where needed".to_owned(),
        },
    }
}

fn state(ui: &mut Ui, window: &Window, at: usize) {
    if window.state().busy_step() == Some(at) {
        ui.add(Spinner::new().size(13.0));
    }
}

/// Menu of the step's further commands.
fn more(ui: &mut Ui, window: &Window, commands: &mut Commands, at: usize, entry: &Entry, all: &[Entry]) {
    let menu = ui.menu_button("\u{2026}", |ui| {
        let moves =
            [("Move Up", at.checked_sub(1)), ("Move Down", Some(at + 1).filter(|to| *to < all.len()))];
        for (name, to) in moves {
            if ui.add_enabled(to.is_some(), Button::new(name)).clicked()
                && let Some(to) = to
            {
                commands.apply(Command::Edit(edit::EditCommand::Move { from: at, to }));
                ui.close();
            }
        }
        ui.separator();
        type Done = fn(&Window, &mut Commands, usize);
        let others: [(&str, bool, Done); 5] = [
            ("Rename\u{2026}", true, steps::rename),
            ("Duplicate", true, steps::duplicate),
            ("Copy", true, steps::copy),
            ("Paste Behind", true, steps::ask_to_paste),
            (steps::solo_name(window, at), entry.step.deformation().is_some(), steps::solo),
        ];
        for (name, can, run) in others {
            if ui.add_enabled(can, Button::new(name)).clicked() {
                run(window, commands, at);
                ui.close();
            }
        }
        ui.separator();
        let others: [(&str, bool, Done); 2] = [
            ("Group with the Step Above", at > 0, steps::group),
            ("Take Out of Its Group", entry.step.group.is_some(), steps::ungroup),
        ];
        for (name, can, run) in others {
            if ui.add_enabled(can, Button::new(name)).clicked() {
                run(window, commands, at);
                ui.close();
            }
        }
        ui.separator();
        if ui.button("Remove").clicked() {
            commands.apply(Command::Edit(edit::EditCommand::Remove { at }));
            ui.close();
        }
    });
    let name = format!("More on step {}", at + 1);
    menu.response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, &name));
}

/// Buttons for the remedies that the step's plugin advises.
fn mend(ui: &mut Ui, window: &Window, commands: &mut Commands, at: usize, entry: &Entry) {
    let Some(deformation) = entry.step.deformation() else { return };
    let Ok(plugin) = window.state().plugins().get(&deformation.deform) else { return };
    let Some(scene) = window.state().scene() else { return };
    let texts: Vec<&str> = match scene.statuses.iter().find(|(id, _)| *id == entry.id) {
        Some((_, Status::Done(messages))) => {
            messages.iter().filter(|m| m.is_warning()).take(3).map(|m| m.text.as_str()).collect()
        }
        Some((_, Status::Failed(error))) => vec![error.hint()],
        _ => return,
    };
    for text in texts {
        for remedy in remedies(text, plugin.params(), &deformation.params) {
            if ui.small_button(&remedy.text).clicked() {
                commands.change(at, Change::SetParam { id: remedy.id, value: Some(remedy.value) }, false);
            }
        }
    }
}

fn messages(ui: &mut Ui, window: &Window, entry: &Entry) {
    let Some(scene) = window.state().scene() else { return };
    let Some((_, status)) = scene.statuses.iter().find(|(id, _)| *id == entry.id) else { return };
    let known = entry.step.deformation().and_then(|d| window.state().plugins().get(&d.deform).ok());
    let plugin = known.map(|plugin| &**plugin);
    match status {
        Status::Failed(_) if regions::missing(window, entry).is_some() => {
            let what = regions::missing(window, entry).unwrap_or_default();
            ui.label(RichText::new(what).small().color(ui.visuals().warn_fg_color));
        }
        Status::Failed(error) => {
            // Errors of a file's steps begin with the step's place in the file.
            let text = error.to_string();
            let text = in_window(text.strip_prefix(": ").unwrap_or(&text), plugin);
            ui.label(RichText::new(text).small().color(ui.visuals().error_fg_color));
            if !error.hint().is_empty() {
                ui.label(RichText::new(in_window(error.hint(), plugin)).small());
            }
        }
        Status::Done(messages) => {
            for message in messages.iter().filter(|m| !m.is_debug()).take(3) {
                let text = RichText::new(in_window(&message.text, plugin)).small();
                let text =
                    if message.is_warning() { text.color(ui.visuals().warn_fg_color) } else { text.weak() };
                ui.label(text);
            }
        }
        Status::Waiting => {
            ui.label(RichText::new("waits for the step before").small().weak());
        }
        Status::Off => {}
    }
}
