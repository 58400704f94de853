//! The panel of the pinned version: its name, and buttons for what can be done with it.

use super::card;
use crate::actions::{ALL, Menu, NamedAction};
use crate::window::{Commands, Window};
use eframe::egui::{Align2, Area, Button, Id, Label, Order, Rect, RichText, Ui, vec2};
use simod_viewer::ComparedVersion;

const MARGIN: f32 = 12.0;
/// Longest name, in characters.
const LONGEST: usize = 36;

/// Shows the panel at the lower right, while a version is pinned.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    let holds = window.state().pinned().is_some_and(|name| shown(ui, rect, window, commands, name));
    if holds != window.holds_pinned {
        ui.ctx().request_repaint();
        commands.then(move |window| window.holds_pinned = holds);
    }
}

/// Shows the panel. Returns whether the button is held that shows the pinned version in the picture.
fn shown(ui: &Ui, rect: Rect, window: &Window, commands: &mut Commands, name: &str) -> bool {
    let area = Area::new(Id::unique("pinned")).order(Order::Middle).movable(false);
    let area = area.pivot(Align2::RIGHT_BOTTOM).fixed_pos(rect.right_bottom() - vec2(MARGIN, MARGIN));
    let content = |ui: &mut Ui| content(ui, window, commands, name);
    area.show(ui.ctx(), |ui| card(ui).show(ui, |ui| ui.horizontal(content).inner).inner).inner
}

fn content(ui: &mut Ui, window: &Window, commands: &mut Commands, name: &str) -> bool {
    if window.state().scene_of(ComparedVersion::Pinned).is_none() {
        ui.spinner();
    }
    // Side by side, the name is written over the version's picture.
    if !window.looks.side_by_side {
        let mut short: String = name.chars().take(LONGEST).collect();
        if short.len() < name.len() {
            short.push('\u{2026}');
        }
        let label = Label::new(RichText::new(format!("Pinned: {short}")).strong()).extend();
        ui.add(label).on_hover_text(name);
    }
    button(ui, window, commands, "Side by Side", "Side by Side");
    let hold =
        ui.button("Hold to See").on_hover_text("Shows the pinned version while it is held, as the key X");
    button(ui, window, commands, "Go On with the Pinned Version", "Swap");
    button(ui, window, commands, "Unpin", "Unpin");
    hold.is_pointer_button_down_on()
}

/// A button for an action of the menu.
fn button(ui: &mut Ui, window: &Window, commands: &mut Commands, name: &str, text: &str) {
    let is_it = |action: &&NamedAction| action.menu == Menu::Compare && action.name == name;
    let Some(action) = ALL.iter().find(is_it) else { return };
    let is_on = action.is_on.is_some_and(|is_on| is_on(window));
    let hint = format!("{name} ({})", action.keys_text(ui.ctx()));
    if ui.add(Button::new(text).selected(is_on)).on_hover_text(hint).clicked() {
        (action.run)(window, commands);
    }
}
