//! The brush strokes of the chosen step, as a list.

use super::{count, parts};
use crate::widgets::parameter;
use crate::widgets::values::ListRequest;
use crate::window::{Commands, Window};
use eframe::egui::{self, Button, DragValue, RichText, ScrollArea, Ui};
use simod_plugin_api::{ParamDesc, ParamKind};
use simod_session::edit::Change;
use simod_session::step::Stroke;
use std::sync::Arc;

/// Height of the list, beyond which it scrolls.
const HEIGHT: f32 = 240.0;

/// Shows the list, if the step has strokes.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let Some((step, _, deformation, plugin)) = window.chosen() else { return };
    let strokes = &deformation.strokes;
    if strokes.is_empty() {
        return;
    }
    parts::part(ui);
    let heading = match strokes.len() {
        1 => "1 Brush Stroke".to_owned(),
        n => format!("{} Brush Strokes", count(n as u64)),
    };
    parts::heading(ui, &heading, |_| ());
    // Strokes can differ in one more respect: the plugin's choice from a list, as of a kind of brush.
    let brush = plugin.as_ref().and_then(|p| p.params().iter().find(|d| d.kind == ParamKind::CHOICE));
    let height = ui.spacing().interact_size.y;
    ScrollArea::vertical().id_salt("strokes").max_height(HEIGHT).auto_shrink([false, true]).show_rows(
        ui,
        height,
        strokes.len(),
        |ui, rows| {
            for (i, stroke) in rows.clone().zip(&strokes[rows]) {
                ui.push_id(i, |ui| {
                    ui.horizontal(|ui| {
                        if let Some(change) = row(ui, i, stroke, &deformation.params, brush) {
                            commands.change(step, change, false);
                        }
                    });
                });
            }
        },
    );
}

/// Row of one stroke; returns the change that the user makes.
fn row(
    ui: &mut Ui,
    i: usize,
    stroke: &Arc<Stroke>,
    params: &toml::Table,
    brush: Option<&ParamDesc>,
) -> Option<Change> {
    let mut change = None;
    let mut to = |stroke: Stroke| change = Some(Change::SetStroke { stroke: i, to: Arc::new(stroke) });
    ui.add_sized(
        [22.0, ui.spacing().interact_size.y],
        egui::Label::new(RichText::new((i + 1).to_string()).weak()),
    );
    if let Some(desc) = brush {
        let id = desc.id.as_str();
        let value = stroke.params.get(id).or_else(|| params.get(id));
        let name = format!("{} of stroke {}", desc.name, i + 1);
        let asked = ui.scope(|ui| {
            ui.set_max_width(104.0);
            parameter::choice(ui, desc, &name, value)
        });
        if let Some(ListRequest::Set(Some(value))) = asked.inner {
            let mut params = stroke.params.clone();
            params.insert(id.to_owned(), value);
            to(Stroke { params, ..(**stroke).clone() });
        }
    }
    let id = ui.scope_id();
    let name = format!("Radius of stroke {}", i + 1);
    let (response, radius) = parts::held(ui, id.with("radius"), &name, stroke.radius, |x| {
        let (least, speed) = (1e-6 * stroke.radius, 0.01 * stroke.radius);
        DragValue::new(x).range(least..=f64::MAX).speed(speed).max_decimals(4).prefix("r ")
    });
    response.on_hover_text("Radius of the brush, in the model's unit");
    let name = format!("Strength of stroke {}", i + 1);
    let (response, strength) = parts::held(ui, id.with("strength"), &name, stroke.strength, |x| {
        DragValue::new(x).speed(0.01).max_decimals(2).prefix("\u{d7} ")
    });
    response.on_hover_text("Strength of the stroke: 1 is full, negative ones do the opposite");
    if radius.is_some() || strength.is_some() {
        let (radius, strength) = (radius.unwrap_or(stroke.radius), strength.unwrap_or(stroke.strength));
        to(Stroke { radius, strength, ..(**stroke).clone() });
    }
    let remove = ui.add(Button::new("\u{d7}").small()).on_hover_text("Remove it");
    let name = format!("Remove stroke {}", i + 1);
    remove.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, &name));
    if remove.clicked() { Some(Change::RemoveStroke { stroke: i }) } else { change }
}
