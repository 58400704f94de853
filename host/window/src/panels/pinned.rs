//! The pinned version: what it is, and what can be done with it.

use super::card;
use crate::actions::{ALL, Action, Menu};
use crate::window::Window;
use eframe::egui::{Align2, Area, Button, Id, Label, Order, Rect, RichText, Ui, vec2};
use simod_viewer::Version;

const MARGIN: f32 = 12.0;
/// Longest name, in characters.
const LONGEST: usize = 36;

/// At the lower right, while something is pinned.
pub fn show(ui: &mut Ui, rect: Rect, window: &mut Window) {
    let held = std::mem::take(&mut window.holds_pinned);
    let Some(name) = window.state().pinned().map(str::to_owned) else { return };
    let area = Area::new(Id::unique("pinned")).order(Order::Middle).movable(false);
    let area = area.pivot(Align2::RIGHT_BOTTOM).fixed_pos(rect.right_bottom() - vec2(MARGIN, MARGIN));
    area.show(ui.ctx(), |ui| {
        card(ui).show(ui, |ui| ui.horizontal(|ui| content(ui, window, &name, held)));
    });
}

fn content(ui: &mut Ui, window: &mut Window, name: &str, held: bool) {
    if window.state().scene_of(Version::Pinned).is_none() {
        ui.spinner();
    }
    // Side by side, it is written over its picture.
    if !window.looks.side_by_side {
        let mut short: String = name.chars().take(LONGEST).collect();
        if short.len() < name.len() {
            short.push('\u{2026}');
        }
        let label = Label::new(RichText::new(format!("Pinned: {short}")).strong()).extend();
        ui.add(label).on_hover_text(name);
    }
    button(ui, window, "Side by Side", "Side by Side");
    let hold =
        ui.button("Hold to See").on_hover_text("Shows the pinned version while it is held, as the key X");
    window.holds_pinned = hold.is_pointer_button_down_on();
    if window.holds_pinned != held {
        ui.ctx().request_repaint();
    }
    button(ui, window, "Go On with the Pinned Version", "Swap");
    button(ui, window, "Unpin", "Unpin");
}

/// A button for an action of the menu.
fn button(ui: &mut Ui, window: &mut Window, name: &str, text: &str) {
    let is_it = |action: &&Action| action.menu == Menu::Compare && action.name == name;
    let Some(action) = ALL.iter().find(is_it) else { return };
    let is_on = action.is_on.is_some_and(|is_on| is_on(window));
    let hint = format!("{name} ({})", action.keys_text(ui.ctx()));
    if ui.add(Button::new(text).selected(is_on)).on_hover_text(hint).clicked() {
        (action.run)(window);
    }
}
