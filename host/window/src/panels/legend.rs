//! What the colours mean.

use super::over::card;
use crate::theme;
use crate::window::Window;
use eframe::egui::{Align, Color32, Layout, Mesh, Rect, RichText, Sense, Shape, Ui, UiBuilder, pos2, vec2};
use simod_session::session_file::Role;
use simod_viewer::Overlay;
use simod_viewer::overlay::{Field, class_color, class_name, scale_color};

const HEIGHT: f32 = 150.0;
const MARGIN: f32 = 12.0;

/// What it is called, and its unit.
fn title(window: &Window) -> Option<(String, &'static str)> {
    Some(match window.state().overlay() {
        Overlay::None => return None,
        Overlay::Selection => ("Selection".to_owned(), ""),
        Overlay::Region(i) => (format!("Weight of region {}", i + 1), ""),
        Overlay::Displacement => ("Displacement".to_owned(), "model units"),
        Overlay::Stretch => ("Stretch".to_owned(), "times"),
        Overlay::Density => ("Sample distance".to_owned(), "model units"),
        Overlay::Difference => ("Difference".to_owned(), "model units"),
        Overlay::Attribute(place) => (window.state().attributes().get(place)?.name.clone(), ""),
        Overlay::TransferError => ("Expected transfer error".to_owned(), "model units"),
    })
}

/// The scale of an overlay, or the colours of regions.
pub fn show(ui: &mut Ui, rect: Rect, window: &mut Window) {
    match title(window) {
        Some((title, unit)) => {
            let Some(field) = window.state_mut().field() else { return };
            if field.are_classes {
                classes(ui, rect, &title, &classes_of(field));
            } else {
                let range = field.range;
                scale(ui, rect, &title, unit, range);
            }
        }
        None => roles(ui, rect, window),
    }
}

fn at_the_lower_left(ui: &mut Ui, rect: Rect, height: f32, content: impl FnOnce(&mut Ui)) {
    let area = Rect::from_min_max(
        pos2(rect.left() + MARGIN, rect.bottom() - height - MARGIN),
        rect.right_bottom() - vec2(MARGIN, MARGIN),
    );
    let builder = UiBuilder::new().max_rect(area).layout(Layout::left_to_right(Align::Min));
    ui.scope_builder(builder, |ui| card(ui).show(ui, |ui| ui.vertical(content)));
}

/// Which classes there are, ascending.
fn classes_of(field: &Field) -> Vec<u8> {
    let mut there = [false; 256];
    field.values.iter().for_each(|class| there[usize::from(class.round() as u8)] = true);
    (0..=u8::MAX).filter(|class| there[usize::from(*class)]).collect()
}

/// The first of the classes that there are, with their colours.
fn classes(ui: &mut Ui, rect: Rect, title: &str, classes: &[u8]) {
    const MOST: usize = 12;
    let shown = &classes[..classes.len().min(MOST)];
    at_the_lower_left(ui, rect, 36.0 + 21.0 * shown.len() as f32, |ui| {
        ui.label(RichText::new(title).strong());
        for class in shown {
            ui.horizontal(|ui| {
                let (dot, _) = ui.allocate_exact_size(vec2(12.0, 14.0), Sense::hover());
                ui.painter().circle_filled(dot.center(), 5.0, theme::color(class_color(*class)));
                let name = class_name(*class).map_or(String::new(), |name| format!(" {name}"));
                ui.label(RichText::new(format!("{class}{name}")).small());
            });
        }
    });
}

fn scale(ui: &mut Ui, rect: Rect, title: &str, unit: &str, [from, to]: [f32; 2]) {
    at_the_lower_left(ui, rect, HEIGHT + 52.0, |ui| {
        ui.label(RichText::new(title).strong());
        if !unit.is_empty() {
            ui.label(RichText::new(unit).small().weak());
        }
        let (area, _) = ui.allocate_exact_size(vec2(110.0, HEIGHT), Sense::hover());
        let bar = Rect::from_min_size(area.min + vec2(0.0, 6.0), vec2(16.0, HEIGHT - 12.0));
        let mut mesh = Mesh::default();
        let steps = 32;
        for i in 0..=steps {
            let t = i as f32 / steps as f32;
            let [r, g, b] = scale_color(1.0 - t);
            let color = Color32::from_rgb(r, g, b);
            let y = bar.top() + t * bar.height();
            mesh.colored_vertex(pos2(bar.left(), y), color);
            mesh.colored_vertex(pos2(bar.right(), y), color);
            if i > 0 {
                let k = 2 * i as u32;
                mesh.add_triangle(k - 2, k - 1, k);
                mesh.add_triangle(k - 1, k, k + 1);
            }
        }
        ui.painter().add(Shape::mesh(mesh));
        for i in 0..=4 {
            let t = i as f32 / 4.0;
            let value = to + (from - to) * t;
            let y = bar.top() + t * bar.height();
            let at = pos2(bar.right() + 8.0, y);
            let color = ui.visuals().text_color();
            ui.painter().hline(bar.right()..=bar.right() + 4.0, y, (1.0, color));
            let font = eframe::egui::FontId::proportional(11.5);
            ui.painter().text(at, eframe::egui::Align2::LEFT_CENTER, number(value), font, color);
        }
    });
}

/// With three digits that matter.
fn number(x: f32) -> String {
    match x.abs() {
        0.0 => "0".to_owned(),
        a if !(1e-3..1e5).contains(&a) => format!("{x:.2e}"),
        a => {
            let decimals = (2.0 - a.log10().floor()).clamp(0.0, 5.0) as usize;
            format!("{x:.decimals$}")
        }
    }
}

fn roles(ui: &mut Ui, rect: Rect, window: &Window) {
    if !window.looks.regions {
        return;
    }
    let Some((_, _, deformation, _)) = window.chosen() else { return };
    let shown: Vec<Role> = [Role::Fixed, Role::Handle, Role::Mask]
        .into_iter()
        .filter(|role| deformation.regions.iter().any(|r| r.role == *role))
        .collect();
    let selected = !window.state().selection().is_empty();
    if shown.is_empty() {
        return;
    }
    let rows = shown.len() + usize::from(selected);
    at_the_lower_left(ui, rect, 12.0 + 21.0 * rows as f32, |ui| {
        let mut row = |color: [u8; 3], name: &str| {
            ui.horizontal(|ui| {
                let (dot, _) = ui.allocate_exact_size(vec2(12.0, 14.0), Sense::hover());
                ui.painter().circle_filled(dot.center(), 5.0, theme::color(color));
                ui.label(RichText::new(name).small());
            });
        };
        shown.iter().for_each(|role| row(theme::role_color(*role), theme::role_name(*role)));
        if selected {
            row(theme::SELECTED, "Selected");
        }
    });
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!(number(0.0), "0");
        assert_eq!(number(1.234), "1.23");
        assert_eq!(number(0.01234), "0.0123");
        assert_eq!(number(1234.5), "1234");
        assert_eq!(number(1.2e-6), "1.20e-6");
    }
}
