//! The pinned version: what it is, and what can be done with it.

use super::over::card;
use crate::actions::{ALL, Action, Menu};
use crate::window::Window;
use eframe::egui::{Align, Button, Layout, Rect, RichText, Ui, UiBuilder};
use simod_viewer::Version;

const MARGIN: f32 = 12.0;
/// Longest name, in characters.
const LONGEST: usize = 36;

/// At the lower right, while something is pinned.
pub fn show(ui: &mut Ui, rect: Rect, window: &mut Window) {
    let held = std::mem::take(&mut window.holds_pinned);
    let Some(name) = window.state().pinned().map(str::to_owned) else { return };
    let builder = UiBuilder::new().max_rect(rect.shrink(MARGIN)).layout(Layout::right_to_left(Align::Max));
    ui.scope_builder(builder, |ui| {
        card(ui).show(ui, |ui| {
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                if window.state().scene_of(Version::Pinned).is_none() {
                    ui.spinner();
                }
                let mut short: String = name.chars().take(LONGEST).collect();
                if short.len() < name.len() {
                    short.push('\u{2026}');
                }
                ui.label(RichText::new(format!("Pinned: {short}")).strong()).on_hover_text(&name);
                toggle(ui, window, "Side by Side", "Side by Side");
                let hold = ui.button("Hold to See").on_hover_text("While it is held, as the key X");
                window.holds_pinned = hold.is_pointer_button_down_on();
                if window.holds_pinned != held {
                    ui.ctx().request_repaint();
                }
                toggle(ui, window, "Go On with the Pinned Version", "Swap");
                toggle(ui, window, "Unpin", "Unpin");
            });
        });
    });
}

/// A button for an action of the menu.
fn toggle(ui: &mut Ui, window: &mut Window, name: &str, text: &str) {
    let is_it = |action: &&Action| action.menu == Menu::Compare && action.name == name;
    let Some(action) = ALL.iter().find(is_it) else { return };
    let is_on = action.is_on.is_some_and(|is_on| is_on(window));
    let hint = format!("{name} ({})", action.keys_text(ui.ctx()));
    if ui.add(Button::selectable(is_on, text).frame(true)).on_hover_text(hint).clicked() {
        (action.run)(window);
    }
}
