//! All commands by name: looked for by typing.

use crate::actions::ALL;
use crate::steps::added;
use crate::window::{Commands, Window};
use eframe::egui::{self, Align2, Button, Id, Key, Modal, RichText, ScrollArea, TextEdit, vec2};
use simod_session::Plugin;
use std::path::PathBuf;
use std::sync::Arc;

const MOST: usize = 60;

/// Something that is found.
enum PaletteEntry {
    Action(&'static crate::actions::NamedAction),
    Add(Arc<Plugin>),
    Open(PathBuf),
}

impl PaletteEntry {
    fn name(&self) -> String {
        match self {
            Self::Action(action) => action.name.to_owned(),
            Self::Add(plugin) => format!("Add Step: {}", plugin.name()),
            Self::Open(path) => format!("Open {}", path.display()),
        }
    }

    /// Text by which the entry is found: its name, and of a plugin also the id, by which documents call it.
    fn sought(&self) -> String {
        match self {
            Self::Add(plugin) => format!("{} {}", self.name(), plugin.id()),
            _ => self.name(),
        }
    }

    fn run(self, window: &Window, commands: &mut Commands) {
        match self {
            Self::Action(action) => (action.run)(window, commands),
            Self::Add(plugin) => added(commands, &plugin, None),
            Self::Open(path) => commands.then(|window| window.ask_to_open(path)),
        }
    }
}

/// Cost at which a name fits the typed text, where less is better: the typed letters occur in the name in
/// their order, best at beginnings of words, else near each other; nothing where they do not occur.
fn fit(name: &str, typed: &str) -> Option<usize> {
    let name: Vec<char> = name.to_lowercase().chars().collect();
    let (mut at, mut cost) = (0, 0);
    for letter in typed.to_lowercase().chars().filter(|c| !c.is_whitespace()) {
        let next = at + name[at..].iter().position(|c| *c == letter)?;
        let begins = next == 0 || name[next - 1] == ' ';
        cost += if begins { 0 } else { 1 + next - at };
        at = next + 1;
    }
    Some(cost)
}

fn found(window: &Window, typed: &str) -> Vec<PaletteEntry> {
    let mut entries: Vec<PaletteEntry> = Vec::new();
    entries.extend(ALL.iter().filter(|action| (action.can)(window)).map(PaletteEntry::Action));
    if window.state().scene().is_some() {
        entries.extend(window.state().plugins().plugins().iter().cloned().map(PaletteEntry::Add));
    }
    entries.extend(window.settings.recent.iter().cloned().map(PaletteEntry::Open));
    let mut found: Vec<(usize, PaletteEntry)> =
        entries.into_iter().filter_map(|entry| Some((fit(&entry.sought(), typed)?, entry))).collect();
    found.sort_by_key(|(cost, _)| *cost);
    found.into_iter().map(|(_, entry)| entry).take(MOST).collect()
}

/// Shows the palette while it is open.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let Some(mut palette) = window.palette.clone() else { return };
    let area = Modal::default_area(Id::unique("palette")).anchor(Align2::CENTER_TOP, vec2(0.0, 90.0));
    let mut done = None;
    let modal = Modal::new(Id::unique("palette")).area(area).show(ctx, |ui| {
        ui.set_width(460.0);
        let (up, down, enter) = ui.input_mut(|i| {
            let mut take = |key| i.consume_key(egui::Modifiers::NONE, key);
            (take(Key::ArrowUp), take(Key::ArrowDown), take(Key::Enter))
        });
        let field =
            TextEdit::singleline(&mut palette.text).hint_text("Search commands").desired_width(f32::INFINITY);
        let field = ui.add(field.margin(egui::Margin::symmetric(8, 6)));
        field.request_focus();
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Search commands"));
        if field.changed() {
            palette.at = 0;
        }
        let entries = found(window, &palette.text);
        let last = entries.len().saturating_sub(1);
        palette.at = (palette.at + usize::from(down)).saturating_sub(usize::from(up)).min(last);
        ui.add_space(4.0);
        ScrollArea::vertical().max_height(360.0).show(ui, |ui| {
            for (i, entry) in entries.into_iter().enumerate() {
                let keys = match &entry {
                    PaletteEntry::Action(action) => action.keys_text(ui.ctx()),
                    PaletteEntry::Add(plugin) => plugin.id().to_owned(),
                    PaletteEntry::Open(_) => String::new(),
                };
                let button = Button::selectable(i == palette.at, entry.name())
                    .right_text(RichText::new(keys).weak().small())
                    .min_size(vec2(ui.available_width(), 24.0));
                let response = ui.add(button);
                if i == palette.at && (up || down) {
                    response.scroll_to_me(None);
                }
                if response.clicked() || enter && i == palette.at {
                    done = Some(entry);
                }
            }
        });
    });
    let palette = Some(palette).filter(|_| done.is_none() && !modal.should_close());
    commands.then(|window| window.palette = palette);
    if let Some(entry) = done {
        entry.run(window, commands);
    }
}

#[cfg(test)]
mod tests {
    use super::fit;

    #[test]
    fn beginnings_of_words_fit_best() {
        assert!(fit("Grow Selection", "gs") < fit("Orthographic", "gs").or(Some(99)));
        assert!(fit("Frame All", "fa") < fit("Surface Only", "fa"));
        assert_eq!(fit("Undo", "x"), None);
        assert_eq!(fit("Undo", ""), Some(0));
    }
}
