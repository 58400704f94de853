//! A control for a parameter, whatever it holds.

use super::values::{ListRequest, as_number, list, numbers, points, vector_of};
use super::{curve, icons};
use eframe::egui::{
    self, Button, ComboBox, DragValue, Response, RichText, Role, Slider, Ui, WidgetInfo, color_picker,
};
use simod_model::bounds::Bounds;
use simod_plugin_api::{ParamDesc, ParamKind, Unit};
use toml::Value;

/// A row with the parameter's name and a control. `value` is what the user gave, if anything.
pub fn show(ui: &mut Ui, desc: &ParamDesc, value: Option<&Value>, bounds: &Bounds) -> Option<ListRequest> {
    let mut asked = None;
    let wide = desc.kind == ParamKind::CURVE;
    ui.push_id(desc.id.as_str(), |ui| {
        ui.horizontal(|ui| {
            let width = 0.36 * ui.available_width();
            name(ui, desc, width);
            if wide {
                ui.add_space(ui.available_width() - 24.0);
            } else {
                let rest = ui.available_width() - 24.0;
                ui.allocate_ui_with_layout(
                    egui::vec2(rest, ui.spacing().interact_size.y),
                    egui::Layout::left_to_right(egui::Align::Center),
                    |ui| {
                        ui.set_min_width(rest);
                        asked = control(ui, desc, value, bounds);
                    },
                );
            }
            if value.is_some() && reset(ui, desc).clicked() {
                asked = Some(ListRequest::Set(None));
            }
        });
        if wide {
            let points =
                value.and_then(points).unwrap_or_else(|| desc.default_numbers.as_chunks().0.to_vec());
            asked = asked.take().or_else(|| curve::show(ui, &desc.name, points));
        }
    });
    asked
}

fn name(ui: &mut Ui, desc: &ParamDesc, width: f32) {
    let label = egui::Label::new(desc.name.as_str()).wrap();
    let response = ui.allocate_ui_with_layout(
        egui::vec2(width, ui.spacing().interact_size.y),
        egui::Layout::left_to_right(egui::Align::Center),
        |ui| {
            ui.set_min_width(width);
            ui.add(label)
        },
    );
    if !desc.hint.is_empty() {
        response.inner.on_hover_text(desc.hint.as_str());
    }
}

fn reset(ui: &mut Ui, desc: &ParamDesc) -> Response {
    let (rect, response) = ui.allocate_exact_size(egui::Vec2::splat(16.0), egui::Sense::click());
    let color =
        if response.hovered() { ui.visuals().strong_text_color() } else { ui.visuals().weak_text_color() };
    icons::back(ui.painter(), rect.shrink(2.0), color);
    response.widget_info(|| WidgetInfo::labeled(Role::Button, true, format!("Reset {}", desc.name)));
    response.on_hover_text("Back to the default")
}

/// Gives a control the parameter's name, for those who do not see it, and its hint.
fn named(response: Response, desc: &ParamDesc) -> Response {
    let (ctx, id) = (response.ctx.clone(), response.id);
    ctx.accesskit_node_builder(id, |node| node.set_label(desc.name.as_str()));
    if desc.hint.is_empty() { response } else { response.on_hover_text(desc.hint.as_str()) }
}

fn control(ui: &mut Ui, desc: &ParamDesc, value: Option<&Value>, bounds: &Bounds) -> Option<ListRequest> {
    match desc.kind {
        ParamKind::FLOAT | ParamKind::INT => number(ui, desc, value, bounds),
        ParamKind::BOOL => {
            let default = desc.default_numbers.first().is_some_and(|x| *x != 0.0);
            let mut on = value.and_then(Value::as_bool).unwrap_or(default);
            let changed = named(ui.checkbox(&mut on, ""), desc).changed();
            changed.then(|| ListRequest::Set(Some(on.into())))
        }
        ParamKind::CHOICE => choice(ui, desc, &desc.name, value),
        ParamKind::DIRECTION | ParamKind::POINT => vector(ui, desc, value, bounds),
        ParamKind::COLOUR => color(ui, desc, value),
        ParamKind::FILE | ParamKind::MODEL => file(ui, desc, value),
        _ => {
            ui.label(RichText::new("of a kind unknown here").weak());
            None
        }
    }
}

/// A drag becomes one change, whatever it is that is dragged.
fn asked(response: &Response, value: impl FnOnce() -> Value) -> Option<ListRequest> {
    if response.drag_stopped() {
        return Some(ListRequest::Rest(response.changed().then(value)));
    }
    match response.changed() {
        true if response.dragged() => Some(ListRequest::Drag(value())),
        true => Some(ListRequest::Set(Some(value()))),
        false => None,
    }
}

fn suffix(unit: Unit) -> &'static str {
    match unit {
        Unit::DEGREES => "\u{b0}",
        Unit::RATIO => "\u{d7}",
        _ => "",
    }
}

fn number(ui: &mut Ui, desc: &ParamDesc, value: Option<&Value>, bounds: &Bounds) -> Option<ListRequest> {
    let whole = desc.kind == ParamKind::INT;
    let default = desc.default_numbers.first().copied().unwrap_or(0.0);
    let mut x = value.and_then(as_number).unwrap_or(default);
    let [hard_min, hard_max] = desc.hard_range;
    let [soft_min, soft_max] = desc.soft_range;
    let decimals = if whole { 0 } else { 4 };
    let response = if soft_min.is_finite() && soft_max.is_finite() && soft_max > soft_min {
        // The slider covers the soft range; other values are typed.
        let width = ui.available_width() - 68.0;
        ui.spacing_mut().slider_width = width.max(40.0);
        ui.spacing_mut().interact_size.x = 58.0;
        let mut slider = Slider::new(&mut x, soft_min..=soft_max)
            .clamping(egui::SliderClamping::Never)
            .max_decimals(decimals)
            .suffix(suffix(desc.unit));
        if whole {
            slider = slider.integer();
        } else {
            slider = slider.logarithmic(soft_min > 0.0 && soft_max / soft_min >= 1000.0);
        }
        ui.add(slider)
    } else {
        let size = (bounds.max - bounds.min).length();
        let speed = match desc.unit {
            _ if whole => 0.2,
            Unit::MODEL_LENGTH if size.is_finite() => 0.002 * size,
            Unit::DEGREES => 0.5,
            _ => 0.01 * x.abs().max(0.1),
        };
        let width = ui.available_width();
        let drag = DragValue::new(&mut x).speed(speed).max_decimals(decimals).suffix(suffix(desc.unit));
        ui.add_sized([width.min(110.0), ui.spacing().interact_size.y], drag)
    };
    let x = x.clamp(hard_min.max(f64::MIN), hard_max.min(f64::MAX));
    let response = named(response, desc);
    asked(&response, || if whole { Value::Integer(x.round() as i64) } else { Value::Float(x) })
}

/// One of a list, under a name for those who do not see it.
pub fn choice(ui: &mut Ui, desc: &ParamDesc, name: &str, value: Option<&Value>) -> Option<ListRequest> {
    let chosen = value.and_then(Value::as_str).unwrap_or(&desc.default_text);
    let label = |id: &str| desc.choices.iter().find(|c| c.id == id).map_or("", |c| c.label.as_str());
    let mut asked = None;
    let combo = ComboBox::from_id_salt("choice").width(ui.available_width() - 4.0).truncate();
    let combo = combo.selected_text(label(chosen)).show_ui(ui, |ui| {
        for choice in &desc.choices {
            if ui.selectable_label(choice.id == chosen, choice.label.as_str()).clicked() {
                asked = Some(ListRequest::Set(Some(choice.id.to_string().into())));
            }
        }
    });
    combo.response.ctx.accesskit_node_builder(combo.response.id, |node| node.set_label(name));
    if !desc.hint.is_empty() {
        combo.response.on_hover_text(desc.hint.as_str());
    }
    asked
}

/// Number with three decimals; minus zero is written as zero.
fn short(x: f64) -> String {
    let text = format!("{x:.3}");
    if text == "-0.000" { "0.000".to_owned() } else { text }
}

fn vector(ui: &mut Ui, desc: &ParamDesc, value: Option<&Value>, bounds: &Bounds) -> Option<ListRequest> {
    let is_point = desc.kind == ParamKind::POINT;
    let size = bounds.max - bounds.min;
    let mut v = vector_of(desc, value, bounds);
    let speed = if is_point { 0.002 * size.length() } else { 0.01 };
    let width = (ui.available_width() - 12.0) / 3.0;
    ui.spacing_mut().item_spacing.x = 3.0;
    let mut all: Option<ListRequest> = None;
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let drag = DragValue::new(&mut v[i]).speed(speed).custom_formatter(|x, _| short(x));
        let response = ui.add_sized([width, ui.spacing().interact_size.y], drag);
        let name = format!("{} {axis}", desc.name);
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(name.as_str()));
        let response = response.on_hover_text(format!("{axis}: {}", desc.hint));
        all = all.or_else(|| asked(&response, || list(&v)));
    }
    all
}

fn color(ui: &mut Ui, desc: &ParamDesc, value: Option<&Value>) -> Option<ListRequest> {
    let opaque = |[r, g, b]: [f64; 3]| [r, g, b, 1.0];
    let given = value.and_then(|value| numbers::<4>(value).or_else(|| numbers::<3>(value).map(opaque)));
    let [r, g, b, a]: [f32; 4] = std::array::from_fn(|i| {
        given.map_or_else(|| desc.default_numbers.get(i).copied().unwrap_or(1.0), |c| c[i]) as f32
    });
    // Parameters are linear, as egui's are, but not premultiplied.
    let mut rgba = egui::Rgba::from_rgba_unmultiplied(r, g, b, a);
    let response = color_picker::color_edit_button_rgba(ui, &mut rgba, color_picker::Alpha::BlendOrAdditive);
    let response = named(response, desc);
    // The picker is a window of its own, which does not tell when a drag in it is over.
    let id = response.id.with("drag");
    if response.changed() {
        ui.data_mut(|data| data.insert_temp(id, true));
        let [r, g, b, a] = rgba.to_rgba_unmultiplied().map(|x| f64::from(x).clamp(0.0, 1.0));
        return Some(ListRequest::Drag(list(&[r, g, b, a])));
    }
    let is_over = ui.data(|data| data.get_temp::<bool>(id).is_some()) && !ui.input(|i| i.pointer.any_down());
    is_over.then(|| {
        ui.data_mut(|data| data.remove::<bool>(id));
        ListRequest::Rest(None)
    })
}

fn file(ui: &mut Ui, desc: &ParamDesc, value: Option<&Value>) -> Option<ListRequest> {
    let path = value.and_then(Value::as_str).unwrap_or_default();
    let name = std::path::Path::new(path).file_name().map(|n| n.to_string_lossy().into_owned());
    let text = name.unwrap_or_else(|| "Choose a file\u{2026}".to_owned());
    let response = ui.add(Button::new(text).truncate());
    let response = if path.is_empty() { response } else { response.on_hover_text(path) };
    named(response, desc).clicked().then_some(ListRequest::File)
}
