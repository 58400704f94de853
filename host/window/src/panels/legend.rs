//! The legend of the colours.

use super::{detail, diagonal, number};
use crate::theme;
use crate::window::{Commands, Window};
use eframe::egui::{
    Align, Align2, Color32, FontId, Frame, Layout, Margin, Mesh, Panel, Rect, RichText, Sense, Shape, Ui,
    pos2, vec2,
};
use simod_session::step::Role;
use simod_viewer::Overlay;
use simod_viewer::overlay::{ScalarField, class_color, class_name, scale_color};

/// The scale's size.
const SIZE: [f32; 2] = [320.0, 12.0];
/// Height of the numbers below the scale.
const NUMBERS: f32 = 16.0;

/// Unit of an overlay's numbers.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ScaleUnit {
    /// Numbers without a unit.
    None,
    /// Ratios.
    Times,
    /// Lengths in the model's unit.
    Length,
}

/// Title and unit of the overlay that is shown.
fn title(window: &Window) -> Option<(String, ScaleUnit)> {
    let state = window.state();
    let (title, unit) = match state.overlay() {
        Overlay::None => return None,
        Overlay::Selection => ("Selection", ScaleUnit::None),
        Overlay::Region(i) => return Some((format!("Weight of region {}", i + 1), ScaleUnit::None)),
        Overlay::Displacement => ("Displacement", ScaleUnit::Length),
        Overlay::Stretch => ("Stretch", ScaleUnit::Times),
        Overlay::Density => ("Sample distance", ScaleUnit::Length),
        Overlay::Difference => ("Difference", ScaleUnit::Length),
        Overlay::Attribute(place) => (state.attributes().get(place)?.name.as_str(), ScaleUnit::None),
        Overlay::TransferError => ("Expected transfer error", ScaleUnit::Length),
    };
    Some((title.to_owned(), unit))
}

impl ScaleUnit {
    fn in_words(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Times => "times",
            Self::Length => "model units",
        }
    }
}

/// Ends of a scale of lengths as fractions of the model's diagonal, in words.
fn beside_diagonal(unit: ScaleUnit, range: [f32; 2], diagonal: Option<f64>) -> Option<String> {
    let diagonal = diagonal.filter(|d| unit == ScaleUnit::Length && *d > 0.0)?;
    let [from, to] = range.map(|end| f64::from(end) / diagonal);
    Some(format!("From {from:.1e} to {to:.1e} of the model's diagonal"))
}

/// Shows the legend below the picture, so that nothing of the model is covered: the scale of an overlay, or
/// the colours of regions, and the share that is shown in full; nothing where all is of one colour.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands, legend: Option<Legend>) {
    let has_detail = window.state().detail().is_some();
    if legend.is_none() && !has_detail {
        return;
    }
    let frame = Frame::side_top_panel(ui.style()).inner_margin(Margin::symmetric(12, 6));
    Panel::bottom("legend").frame(frame).resizable(false).show(ui, |ui| {
        if let Some(legend) = legend {
            ui.horizontal_wrapped(|ui| match legend {
                Legend::Scale(title, unit, range) => {
                    scale(ui, (&title, unit), range, diagonal(window));
                }
                Legend::Classes(title, classes) => class_dots(ui, &title, &classes),
                Legend::Roles(roles) => roles.iter().for_each(|(color, name)| dot(ui, *color, name)),
            });
        }
        if has_detail {
            let line = |ui: &mut Ui| detail::show(ui, window, commands);
            ui.allocate_ui_with_layout(
                vec2(ui.available_width(), 24.0),
                Layout::right_to_left(Align::Center),
                line,
            );
        }
    });
}

/// Meaning of the colours of a picture.
pub enum Legend {
    /// Numbers: their title, their unit, and the ends of the scale.
    Scale(String, ScaleUnit, [f32; 2]),
    /// Classes of points.
    Classes(String, Vec<u8>),
    /// Roles that samples have in the chosen step, each with its colour.
    Roles(Vec<([u8; 3], &'static str)>),
}

impl Legend {
    /// Legend of the picture that is shown now; nothing where all is of one colour.
    pub fn find(window: &Window) -> Option<Self> {
        let Some((title, unit)) = title(window) else { return roles(window).map(Self::Roles) };
        let field = window.state().field()?;
        Some(match field.are_classes {
            true => Self::Classes(title, classes_of(&field)),
            false => Self::Scale(title, unit, field.range),
        })
    }
}

/// A colour with its name.
fn dot(ui: &mut Ui, color: [u8; 3], name: &str) {
    let (dot, _) = ui.allocate_exact_size(vec2(12.0, 16.0), Sense::hover());
    ui.painter().circle_filled(dot.center(), 5.0, theme::color(color));
    ui.label(RichText::new(name).small());
    ui.add_space(8.0);
}

/// The classes that a field has, ascending.
fn classes_of(field: &ScalarField) -> Vec<u8> {
    let mut there = [false; 256];
    field.values.iter().for_each(|class| there[usize::from(class.round() as u8)] = true);
    (0..=u8::MAX).filter(|class| there[usize::from(*class)]).collect()
}

/// The classes that there are, with their colours.
fn class_dots(ui: &mut Ui, title: &str, classes: &[u8]) {
    ui.label(RichText::new(title).strong());
    ui.add_space(8.0);
    for class in classes {
        let name = class_name(*class).map_or(String::new(), |name| format!(" {name}"));
        dot(ui, class_color(*class), &format!("{class}{name}"));
    }
}

fn scale(ui: &mut Ui, (title, unit): (&str, ScaleUnit), [from, to]: [f32; 2], diagonal: Option<f64>) {
    ui.label(RichText::new(title).strong());
    if unit != ScaleUnit::None {
        let label = ui.label(RichText::new(unit.in_words()).small().weak());
        if let Some(text) = beside_diagonal(unit, [from, to], diagonal) {
            label.on_hover_text(text);
        }
    }
    ui.add_space(12.0);
    let [width, height] = SIZE;
    let (area, _) = ui.allocate_exact_size(vec2(width + 60.0, height + NUMBERS), Sense::hover());
    let bar = Rect::from_min_size(area.min + vec2(30.0, 1.0), vec2(width, height));
    let mut mesh = Mesh::default();
    let steps = 32;
    for i in 0..=steps {
        let t = i as f32 / steps as f32;
        let [r, g, b] = scale_color(t);
        let color = Color32::from_rgb(r, g, b);
        let x = bar.left() + t * bar.width();
        mesh.colored_vertex(pos2(x, bar.top()), color);
        mesh.colored_vertex(pos2(x, bar.bottom()), color);
        if i > 0 {
            let k = 2 * i as u32;
            mesh.add_triangle(k - 2, k - 1, k);
            mesh.add_triangle(k - 1, k, k + 1);
        }
    }
    ui.painter().add(Shape::mesh(mesh));
    let color = ui.visuals().text_color();
    for i in 0..=4 {
        let t = i as f32 / 4.0;
        let x = bar.left() + t * bar.width();
        ui.painter().vline(x, bar.bottom()..=bar.bottom() + 3.0, (1.0, color));
        let text = number(f64::from(from + (to - from) * t));
        let at = pos2(x, bar.bottom() + 3.0);
        ui.painter().text(at, Align2::CENTER_TOP, text, FontId::proportional(11.5), color);
    }
}

/// Roles that samples have in the chosen step, each with its colour, as far as these colours are shown.
fn roles(window: &Window) -> Option<Vec<([u8; 3], &'static str)>> {
    let (_, _, deformation, _) = window.chosen().filter(|_| window.looks.regions)?;
    let is_there = |role: &Role| deformation.regions.iter().any(|region| region.role == *role);
    let named = |role| (theme::role_color(role), theme::role_name(role));
    let mut shown: Vec<_> =
        [Role::Fixed, Role::Handle, Role::Mask].into_iter().filter(is_there).map(named).collect();
    if !shown.is_empty() && !window.state().selection().is_empty() {
        shown.push((theme::SELECTED, "Selected"));
    }
    (!shown.is_empty()).then_some(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_of_lengths_are_told_beside_the_diagonal() {
        let told = |unit, diagonal| beside_diagonal(unit, [0.0, 0.25], diagonal);
        let text = "From 0.0e0 to 5.0e-2 of the model's diagonal";
        assert_eq!(told(ScaleUnit::Length, Some(5.0)).as_deref(), Some(text));
        assert_eq!(told(ScaleUnit::Times, Some(5.0)), None);
        assert_eq!(told(ScaleUnit::Length, Some(0.0)), None);
        assert_eq!(told(ScaleUnit::Length, None), None);
    }
}
