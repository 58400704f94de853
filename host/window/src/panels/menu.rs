//! The menus.

use crate::actions::{ALL, Menu, NamedAction};
use crate::lessons::{ALL as ALL_LESSONS, begin};
use crate::settings::WindowSettings;
use crate::steps;
use crate::window::{CommandPalette, Commands, Window};
use crate::wording::purpose;
use eframe::egui::{self, Button, Frame, Margin, MenuBar, Panel, RichText, Ui};
use simod_session::Plugin;
use simod_viewer::{Command, Navigation, Overlay};

const MENUS: [(&str, Menu); 8] = [
    ("File", Menu::File),
    ("Edit", Menu::Edit),
    ("Select", Menu::Select),
    ("View", Menu::View),
    ("Compare", Menu::Compare),
    ("Overlay", Menu::Overlay),
    ("Tool", Menu::Tool),
    ("Help", Menu::Help),
];

/// The bar at the top.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let frame = Frame::side_top_panel(ui.style()).inner_margin(Margin::symmetric(8, 4));
    Panel::top("menu").frame(frame).show(ui, |ui| {
        MenuBar::new().ui(ui, |ui| {
            for (name, menu) in MENUS {
                if menu == Menu::Tool {
                    ui.menu_button("Step", |ui| add_step(ui, window, commands, None));
                }
                ui.menu_button(name, |ui| entries(ui, window, commands, menu));
            }
            title(ui, window);
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                let text = RichText::new("Search commands   Ctrl+P").weak();
                if ui.add(Button::new(text).min_size(egui::vec2(190.0, 0.0))).clicked() {
                    commands.then(|window| window.palette = Some(CommandPalette::default()));
                }
            });
        });
    });
}

/// Name of the open session or model, in the middle.
fn title(ui: &mut Ui, window: &Window) {
    let Some(editor) = window.state().editor() else { return };
    let path = editor.path().or(editor.model()).or(window.opened());
    let name =
        path.and_then(|p| p.file_name()).map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let changed = !editor.is_saved() && !editor.document().steps().is_empty();
    ui.add_space(16.0);
    let hover = path.map_or_else(String::new, |p| p.display().to_string());
    let text = if changed { format!("{name} \u{2022} not saved") } else { name };
    ui.label(RichText::new(text).weak()).on_hover_text(hover);
}

fn entries(ui: &mut Ui, window: &Window, commands: &mut Commands, menu: Menu) {
    for action in ALL.iter().filter(|action| action.menu == menu) {
        if action.begins {
            ui.separator();
        }
        entry(ui, window, commands, action);
        if action.precedes_recent {
            recent(ui, window, commands);
        }
    }
    if menu == Menu::Overlay {
        ui.separator();
        ui.menu_button("Attribute", |ui| attributes(ui, window, commands));
    }
    if menu == Menu::Help {
        ui.separator();
        ui.menu_button("Lessons", |ui| lessons(ui, commands));
    }
    if menu == Menu::View {
        ui.separator();
        ui.menu_button("Light", |ui| entries(ui, window, commands, Menu::Light));
        ui.menu_button("Navigation", |ui| navigation(ui, window, commands));
    }
}

/// One action, with its keys.
fn entry(ui: &mut Ui, window: &Window, commands: &mut Commands, action: &NamedAction) {
    let is_on = action.is_on.is_some_and(|is_on| is_on(window));
    let button = Button::selectable(is_on, action.name).shortcut_text(action.keys_text(ui.ctx()));
    if ui.add_enabled((action.can)(window), button).clicked() {
        (action.run)(window, commands);
        ui.close();
    }
}

fn recent(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let WindowSettings { recent, .. } = &window.settings;
    ui.add_enabled_ui(!recent.is_empty(), |ui| {
        ui.menu_button("Open Recent", |ui| {
            for path in recent {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                if ui.button(name).on_hover_text(path.display().to_string()).clicked() {
                    let path = path.clone();
                    commands.then(move |window| window.ask_to_open(path));
                    ui.close();
                }
            }
        });
    });
}

/// The numbers that the model's vertices have, to be shown on the surface.
fn attributes(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let attributes = window.state().attributes();
    if attributes.is_empty() {
        ui.label("Its vertices have no numbers beside positions and normals.");
    }
    for (place, attribute) in attributes.iter().enumerate() {
        let overlay = Overlay::Attribute(place);
        let is_on = window.state().overlay() == overlay;
        if ui.add(Button::selectable(is_on, attribute.name.as_str())).clicked() {
            commands.apply(Command::Show(if is_on { Overlay::None } else { overlay }));
            ui.close();
        }
    }
}

fn lessons(ui: &mut Ui, commands: &mut Commands) {
    for (i, lesson) in ALL_LESSONS.iter().enumerate() {
        if ui.button(lesson.title).on_hover_text(lesson.about).clicked() {
            begin(commands, i);
            ui.close();
        }
    }
}

fn navigation(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    for preset in Navigation::ALL {
        let chosen = window.settings.navigation().name == preset.name;
        if ui.add(Button::selectable(chosen, preset.name)).clicked() {
            commands.set(move |settings| settings.navigation = preset.name.to_owned());
            ui.close();
        }
    }
}

/// Entries for all plugins, each of which adds a step.
pub fn add_step(ui: &mut Ui, window: &Window, commands: &mut Commands, at: Option<usize>) {
    let plugins = window.state().plugins().plugins();
    let enabled = window.state().scene().is_some();
    if plugins.is_empty() {
        ui.label("No plugins were found.");
    }
    for plugin in plugins {
        let button = Button::new(plugin.name()).right_text(RichText::new(plugin.id()).weak().small());
        if ui.add_enabled(enabled, button).on_hover_text(about(plugin)).clicked() {
            steps::added(commands, plugin, at);
            ui.close();
        }
    }
}

/// Description of a plugin, line by line: summary, purpose, citation, author.
pub fn about(plugin: &Plugin) -> String {
    let lines = [plugin.summary(), purpose(plugin.id()), plugin.citation(), plugin.author()];
    lines.into_iter().filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n")
}
