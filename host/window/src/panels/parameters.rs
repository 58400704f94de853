//! The chosen step's parameters, made of their descriptions alone.

use super::parts;
use crate::dialogs::Purpose;
use crate::widgets::parameter;
use crate::widgets::values::{ListRequest, number_of};
use crate::window::{Commands, Window};
use eframe::egui::{CollapsingHeader, RichText, Ui};
use simod_plugin_api::{ParamDesc, ParamKind};
use simod_session::edit::Change;
use simod_session::step::Deformation;
use simod_viewer::Command;

/// The parameters.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let Some((step, _, deformation, plugin)) = window.chosen() else { return };
    parts::part(ui);
    let Some(plugin) = plugin else {
        parts::heading(ui, &deformation.deform, |_| ());
        ui.label(format!("The plugin `{}` is not there; the step stays as it is.", deformation.deform));
        return;
    };
    parts::heading(ui, plugin.name(), |ui| {
        let can_reset = !deformation.params.is_empty();
        let reset = ui.add_enabled(can_reset, eframe::egui::Button::new("Reset All").small());
        if reset.on_hover_text("Resets all parameters to their defaults").clicked() {
            for id in deformation.params.keys() {
                commands.change(step, Change::SetParam { id: id.clone(), value: None }, false);
            }
        }
    });
    if !plugin.summary().is_empty() {
        ui.label(RichText::new(plugin.summary()).weak().small()).on_hover_text(super::menu::about(&plugin));
        ui.add_space(4.0);
    }
    amount(ui, window, commands, step, &deformation);
    if plugin.params().is_empty() {
        ui.label(RichText::new("It has no parameters.").weak());
    }
    let mut groups: Vec<(&str, Vec<&ParamDesc>)> = Vec::new();
    for desc in plugin.params() {
        match groups.iter_mut().find(|(group, _)| *group == desc.group.as_str()) {
            Some((_, of)) => of.push(desc),
            None => groups.push((desc.group.as_str(), vec![desc])),
        }
    }
    // Parameters without a group come first.
    groups.sort_by_key(|(group, _)| !group.is_empty());
    for (group, params) in groups {
        let show = |ui: &mut Ui| {
            for desc in params {
                one(ui, window, commands, step, desc, deformation.params.get(desc.id.as_str()));
            }
        };
        if group.is_empty() {
            show(ui);
        } else {
            CollapsingHeader::new(RichText::new(group)).default_open(true).show_unindented(ui, show);
        }
    }
}

/// Control of the step's amount: 0 leaves all at rest, 1 is the whole deformation.
fn amount(ui: &mut Ui, window: &Window, commands: &mut Commands, step: usize, deformation: &Deformation) {
    let Some(scene) = window.state().scene() else { return };
    let desc = ParamDesc::float("step-amount", "Amount", 1.0)
        .hint("Amount of the step that is done: 0 leaves all at rest, 1 is the whole deformation")
        .hard(0.0, 1.0)
        .soft(0.0, 1.0);
    let value = Some(toml::Value::Float(deformation.amount)).filter(|_| deformation.amount != 1.0);
    let to = |value: Option<toml::Value>| {
        let amount = value.as_ref().map_or(1.0, |value| number_of(&desc, Some(value)));
        Change::SetAmount(amount.clamp(0.0, 1.0))
    };
    match parameter::show(ui, &desc, value.as_ref(), &scene.sampled.bounds) {
        Some(ListRequest::Set(value)) => commands.change(step, to(value), false),
        Some(ListRequest::Drag(value)) => commands.change(step, to(Some(value)), true),
        Some(ListRequest::Rest(last)) => {
            if last.is_some() {
                commands.change(step, to(last), true);
            }
            commands.apply(Command::Rest);
        }
        Some(ListRequest::File) | None => {}
    }
}

fn one(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    step: usize,
    desc: &ParamDesc,
    value: Option<&toml::Value>,
) {
    let Some(scene) = window.state().scene() else { return };
    let id = desc.id.to_string();
    match parameter::show(ui, desc, value, &scene.sampled.bounds) {
        None => {}
        Some(ListRequest::Set(value)) => {
            commands.change(step, Change::SetParam { id, value }, false);
        }
        Some(ListRequest::Drag(value)) => {
            commands.change(step, Change::SetParam { id, value: Some(value) }, true);
        }
        Some(ListRequest::Rest(last)) => {
            if last.is_some() {
                commands.change(step, Change::SetParam { id, value: last }, true);
            }
            commands.apply(Command::Rest);
        }
        Some(ListRequest::File) => {
            let extensions = match desc.kind {
                // A sampled model by the file that describes it.
                ParamKind::MODEL => simod_model::extensions().chain(["toml"]).map(str::to_owned).collect(),
                _ => desc.choices.iter().map(|choice| choice.id.to_string()).collect(),
            };
            commands.then(move |window| window.ask(Purpose::Parameter { step, id, extensions }));
        }
    }
}
