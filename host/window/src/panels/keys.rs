//! The sheet of keys and of the mouse, in groups.

use super::frames::modal;
use crate::actions::{ALL, Menu, NamedAction};
use crate::window::{Commands, Window};
use eframe::egui::{self, Grid, Id, Key, Modal, Modifiers, RichText, ScrollArea, Ui};
use simod_viewer::Navigation;
use simod_viewer::navigation::{Button, Drag};

/// Effects of the pointer that are the same in all presets.
const POINTER: [(&str, &str); 8] = [
    ("Left drag beside a handle, or with Alt", "look around"),
    ("Shift + left drag, right drag", "move the picture"),
    ("Wheel, pinch", "zoom to the pointer"),
    ("Two fingers; with Shift; with Ctrl", "look around; move; zoom"),
    ("Arrow keys", "look around in steps"),
    ("[ and ]", "size of the brush"),
    ("Ctrl while a handle is dragged", "in steps"),
    ("X, held", "the pinned version in place"),
];

/// The groups, in columns.
const COLUMNS: [&[(&str, Menu)]; 2] = [
    &[("File", Menu::File), ("Edit", Menu::Edit), ("Tools", Menu::Tool), ("Select", Menu::Select)],
    &[("View", Menu::View), ("Overlay", Menu::Overlay), ("Compare", Menu::Compare), ("Help", Menu::Help)],
];

/// The drags by which a preset moves the camera: the keys and the button, as "Alt + left drag", and what the
/// camera does.
fn camera_drags(navigation: &Navigation) -> impl Iterator<Item = (String, &'static str)> {
    navigation.bindings().iter().map(|(button, held, drag)| {
        let keys = [(held.shift, "Shift + "), (held.control, "Ctrl + "), (held.alt, "Alt + ")];
        let keys: String = keys.iter().filter(|(is_held, _)| *is_held).map(|(_, name)| *name).collect();
        let button = match button {
            Button::Left => "left",
            Button::Middle => "middle",
            Button::Right => "right",
        };
        let what = match drag {
            Drag::Orbit => "look around",
            Drag::Pan => "move",
            Drag::Zoom => "zoom",
        };
        let mut text = format!("{keys}{button} drag");
        text[..1].make_ascii_uppercase();
        (text, what)
    })
}

/// Shows the sheet until it is closed: by its button, Escape, the key that opened it, or a click beside it.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    if !window.shows_keys {
        return;
    }
    let others = POINTER.iter().map(|(keys, what)| ((*keys).to_owned(), *what));
    let pointer: Vec<(String, &str)> = camera_drags(window.settings.navigation()).chain(others).collect();
    let mut close = ctx.input_mut(|i| i.consume_key(Modifiers::NONE, Key::F1));
    let height = (ctx.content_rect().height() - 140.0).max(160.0);
    let modal = Modal::new(Id::unique("keys")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(760.0_f32.min(ctx.content_rect().width() - 60.0));
        ui.horizontal(|ui| {
            ui.heading("Keys and Mouse");
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                close |= ui.button("Close").clicked();
            });
        });
        ui.add_space(6.0);
        ScrollArea::vertical()
            .max_height(height)
            .min_scrolled_height(height)
            .auto_shrink([false, true])
            .show(ui, |ui| {
                group(ui, "Mouse and trackpad", &pointer);
                action_groups(ui, ctx);
            });
    });
    if close || modal.should_close() {
        commands.then(|window| window.shows_keys = false);
    }
}

/// The keys of all actions, by their menus, in two columns.
fn action_groups(ui: &mut Ui, ctx: &egui::Context) {
    let row = |action: &NamedAction| (action.all_keys_text(ctx), action.name);
    ui.columns(2, |columns| {
        for (ui, groups) in columns.iter_mut().zip(COLUMNS) {
            for (name, menu) in groups {
                let of_menu = ALL.iter().filter(|action| action.menu == *menu && !action.keys.is_empty());
                group(ui, name, &of_menu.map(row).collect::<Vec<_>>());
            }
        }
    });
}

fn group(ui: &mut Ui, name: &str, rows: &[(String, &str)]) {
    if rows.is_empty() {
        return;
    }
    ui.label(RichText::new(name).strong().size(15.0));
    Grid::new(("keys", name)).num_columns(2).spacing([20.0, 4.0]).min_col_width(120.0).show(ui, |ui| {
        for (keys, what) in rows {
            ui.label(RichText::new(keys).monospace());
            ui.label(*what);
            ui.end_row();
        }
    });
    ui.add_space(12.0);
}
