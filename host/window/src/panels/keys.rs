//! What keys and the mouse do.

use crate::actions::ALL;
use crate::window::Window;
use eframe::egui::{self, Grid, RichText, ScrollArea};

/// What the pointer does, whatever the preset.
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

/// The middle button, or Alt with buttons, by preset.
fn preset(name: &str) -> [(&'static str, &'static str); 3] {
    if name.starts_with("Maya") {
        [("Alt + left drag", "look around"), ("Alt + middle drag", "move"), ("Alt + right drag", "zoom")]
    } else {
        [("Middle drag", "look around"), ("Shift + middle drag", "move"), ("Ctrl + middle drag", "zoom")]
    }
}

/// Shows them until they are closed.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let mut open = window.shows_keys;
    let preset = preset(window.settings.navigation().name);
    egui::Window::new("Keys and Mouse").open(&mut open).default_width(420.0).collapsible(false).show(
        ctx,
        |ui| {
            ScrollArea::vertical().max_height(480.0).show(ui, |ui| {
                Grid::new("keys").num_columns(2).spacing([24.0, 4.0]).striped(true).show(ui, |ui| {
                    let mut row = |keys: &str, what: &str| {
                        ui.label(RichText::new(keys).strong());
                        ui.label(what);
                        ui.end_row();
                    };
                    preset.iter().chain(&POINTER).for_each(|(keys, what)| row(keys, what));
                    for action in ALL.iter().filter(|action| !action.keys.is_empty()) {
                        row(&action.keys_text(ctx), action.name);
                    }
                });
            });
        },
    );
    window.shows_keys = open;
}
