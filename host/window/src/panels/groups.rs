//! The heading of a group of steps: folded or not, switched, named and moved as one.

use super::rows::{Dragged, carried, name_field, put_back, switch};
use crate::steps;
use crate::theme;
use crate::window::{Commands, Renaming, Window};
use eframe::egui::{
    self, Align, Button, Layout, Response, RichText, Sense, Stroke, StrokeKind, Ui, UiBuilder, Vec2,
    collapsing_header::paint_default_icon,
};
use simod_session::edit::{EditCommand, Entry, StepId, group_at};
use simod_viewer::Command;
use std::ops::Range;

/// Shows the heading of the group that has these steps. Returns whether the steps are shown.
pub fn show(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    group: Range<usize>,
    entries: &[Entry],
) -> bool {
    let first = &entries[group.start];
    let Some(name) = first.step.group.clone() else { return true };
    let folded = window.folded.contains(&name);
    let builder = UiBuilder::new().id_salt(("group", first.id)).sense(Sense::click_and_drag());
    let whole = ui.scope_builder(builder, |ui| {
        ui.horizontal(|ui| {
            fold(ui, commands, &name, folded);
            let any = entries[group.clone()].iter().any(|entry| entry.step.enabled);
            if let Some(enabled) = switch(ui, &name, any, "Do these steps, or leave them out") {
                commands.apply(Command::Edit(EditCommand::EnableGroup { at: group.start, enabled }));
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                more(ui, window, commands, &group, entries, &name);
                ui.label(RichText::new(format!("{}", group.len())).weak()).on_hover_text("Steps in it");
                ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                    label(ui, window, commands, &group, first.id, &name);
                });
            });
        });
    });
    if whole.response.clicked() {
        let name = name.clone();
        commands.then(move |window| window.fold(&name, !folded));
    }
    reorder(ui, window, commands, &group, first, (&name, folded), &whole.response);
    !folded
}

fn fold(ui: &mut Ui, commands: &mut Commands, name: &str, folded: bool) {
    let (_, arrow) = ui.allocate_exact_size(Vec2::splat(14.0), Sense::click());
    paint_default_icon(ui, if folded { 0.0 } else { 1.0 }, &arrow);
    let does = if folded { "Unfold" } else { "Fold" };
    arrow.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, format!("{does} {name}")));
    if arrow.clicked() {
        let name = name.to_owned();
        commands.then(move |window| window.fold(&name, !folded));
    }
}

/// The group's name, or the field in which it gets another one.
fn label(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    group: &Range<usize>,
    id: StepId,
    name: &str,
) {
    let is_meant = |renaming: &&Renaming| renaming.of_group && renaming.id == id;
    if let Some(renaming) = window.renaming.as_ref().filter(is_meant) {
        rename(ui, commands, group.clone(), name, renaming.clone());
        return;
    }
    let label = Button::new(RichText::new(name).strong()).frame(false).truncate();
    if ui.add(label).double_clicked() {
        steps::rename_group(window, commands, group.start);
    }
}

fn rename(ui: &mut Ui, commands: &mut Commands, group: Range<usize>, name: &str, mut renaming: Renaming) {
    let wanted = name_field(ui, &mut renaming, "a few words", &format!("Name of the group {name}"));
    let (name, to) = (name.to_owned(), renaming.text.trim().to_owned());
    put_back(commands, renaming, wanted.is_none());
    if wanted == Some(true) && !to.is_empty() {
        commands.then(move |window| {
            let folded = window.folded.contains(&name);
            if window.apply(Command::Edit(EditCommand::Group { steps: group, name: Some(to.clone()) })) {
                window.fold(&to, folded);
            }
        });
    }
}

/// Menu of the group's further commands.
fn more(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    group: &Range<usize>,
    entries: &[Entry],
    name: &str,
) {
    let menu = ui.menu_button("\u{2026}", |ui| {
        let at = group.start;
        // Places of the group, or the step, before this group and behind it.
        let above = at.checked_sub(1).map(|above| group_at(entries, above).map_or(above, |g| g.start));
        let below = (group.end < entries.len())
            .then(|| at + group_at(entries, group.end).map_or(1, |below| below.len()));
        for (name, to) in [("Move Up", above), ("Move Down", below)] {
            if ui.add_enabled(to.is_some(), Button::new(name)).clicked()
                && let Some(to) = to
            {
                commands.apply(Command::Edit(EditCommand::MoveGroup { at, to }));
                ui.close();
            }
        }
        ui.separator();
        type Done = fn(&Window, &mut Commands, usize);
        let others: [(&str, Done); 2] =
            [("Rename\u{2026}", steps::rename_group), ("Copy", steps::copy_group)];
        for (name, run) in others {
            if ui.button(name).clicked() {
                run(window, commands, at);
                ui.close();
            }
        }
        ui.separator();
        let ends = [
            ("Ungroup", EditCommand::Group { steps: group.clone(), name: None }),
            ("Remove All", EditCommand::RemoveGroup { at }),
        ];
        for (name, command) in ends {
            if ui.button(name).clicked() {
                commands.apply(Command::Edit(command));
                ui.close();
            }
        }
    });
    let name = format!("More on the group {name}");
    menu.response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, &name));
}

/// Moves groups and steps by dragging: the group can be dragged between others; a step that is dropped on
/// the group joins it, and another group comes before or behind this one.
fn reorder(
    ui: &Ui,
    window: &Window,
    commands: &mut Commands,
    group: &Range<usize>,
    first: &Entry,
    (name, folded): (&str, bool),
    row: &Response,
) {
    row.dnd_set_drag_payload(Dragged::Group(first.id));
    let Some(pointer) = ui.input(|i| i.pointer.latest_pos()) else { return };
    if row.dragged() {
        carried(ui, row, name, pointer);
    }
    let Some(dragged) = row.dnd_hover_payload::<Dragged>() else { return };
    let gap = match *dragged {
        Dragged::Step(_) => None,
        Dragged::Group(_) if pointer.y > row.rect.center().y && folded => Some(group.end),
        Dragged::Group(_) => Some(group.start),
    };
    match gap {
        None => ui.painter().rect_stroke(row.rect, 4.0, Stroke::new(1.5, theme::ACCENT), StrokeKind::Inside),
        Some(gap) => {
            let y = if gap == group.start { row.rect.top() } else { row.rect.bottom() };
            ui.painter().hline(row.rect.x_range(), y, Stroke::new(2.0, theme::ACCENT))
        }
    };
    if row.dnd_release_payload::<Dragged>().is_none() {
        return;
    }
    match (gap, &*dragged) {
        (Some(gap), dragged) => dragged.put(window, commands, gap),
        (None, dragged) => {
            if let Some(from) = dragged.place(window).filter(|from| !group.contains(from)) {
                commands.apply(Command::Edit(EditCommand::JoinGroup { from, at: group.start }));
            }
        }
    }
}
