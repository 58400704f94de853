//! Parts that all rows of the list of steps share, be the rows of steps or of groups: a box, a name that is
//! typed, and the dragging of rows.

use crate::window::{Commands, Renaming, Window};
use eframe::egui::{
    self, Align2, CursorIcon, FontId, Key, LayerId, Order, Pos2, Response, TextEdit, Ui, vec2,
};
use simod_session::edit::{self, StepId, group_at};
use simod_viewer::Command;

/// Row that is dragged to another place.
pub enum Dragged {
    /// A step.
    Step(StepId),
    /// The group that begins with a step.
    Group(StepId),
}

impl Dragged {
    /// Present place of the step, or of the group's first step.
    pub fn place(&self, window: &Window) -> Option<usize> {
        let (Self::Step(id) | Self::Group(id)) = self;
        window.steps().iter().position(|entry| entry.id == *id)
    }

    /// Puts the dragged row into the gap before the step that is at place `gap` now.
    pub fn put(&self, window: &Window, commands: &mut Commands, gap: usize) {
        let Some(from) = self.place(window) else { return };
        let steps = window.steps();
        let length = match self {
            Self::Step(_) => 1,
            Self::Group(_) => group_at(&steps, from).map_or(1, |group| group.len()),
        };
        if (from..=from + length).contains(&gap) {
            return;
        }
        // The gap's place is counted after the row has left its own.
        let to = if gap > from { gap - length } else { gap };
        commands.apply(Command::Edit(match self {
            Self::Step(_) => edit::EditCommand::Move { from, to },
            Self::Group(_) => edit::EditCommand::MoveGroup { at: from, to },
        }));
    }
}

/// Draws the name of the dragged row beside the pointer.
pub fn carried(ui: &Ui, row: &Response, name: &str, pointer: Pos2) {
    ui.set_cursor_icon(CursorIcon::Grabbing);
    let layer = LayerId::new(Order::Tooltip, row.id);
    let (font, color) = (FontId::proportional(13.0), ui.visuals().strong_text_color());
    ui.layer_painter(layer).text(pointer + vec2(14.0, 2.0), Align2::LEFT_TOP, name, font, color);
}

/// Box that says whether steps are done: returns its new state, if the box was clicked.
pub fn switch(ui: &mut Ui, name: &str, is_on: bool, hint: &str) -> Option<bool> {
    let mut enabled = is_on;
    let check = ui.checkbox(&mut enabled, "");
    let text = format!("Enable {name}");
    check.widget_info(|| egui::WidgetInfo::selected(egui::Role::CheckBox, true, is_on, text.clone()));
    check.on_hover_text(hint).changed().then_some(enabled)
}

/// Field of a name that is typed: returns whether the name is wanted, once Enter, Escape or a click
/// elsewhere ends the typing.
pub fn name_field(ui: &mut Ui, renaming: &mut Renaming, hint: &str, label: &str) -> Option<bool> {
    let edit = TextEdit::singleline(&mut renaming.text).desired_width(f32::INFINITY);
    let response = ui.add(edit.hint_text(hint));
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(label));
    if std::mem::take(&mut renaming.begins) {
        response.request_focus();
    }
    response.lost_focus().then(|| !ui.input(|i| i.key_pressed(Key::Escape)))
}

/// Keeps the state of a name that is typed, if the typing goes on, or else lets go of it; another name
/// whose typing was asked for meanwhile stays.
pub fn put_back(commands: &mut Commands, renaming: Renaming, goes_on: bool) {
    commands.then(move |window| {
        let is_it = |other: &mut Renaming| other.id == renaming.id && other.of_group == renaming.of_group;
        if window.renaming.take_if(is_it).is_some() && goes_on {
            window.renaming = Some(renaming);
        }
    });
}
