//! The parts of the panel at the side.

use eframe::egui::{Align, DragValue, Id, Layout, Response, RichText, Ui};

/// The heading of a part of the panel.
pub fn heading(ui: &mut Ui, text: &str, right: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(text).strong().size(14.0));
        ui.with_layout(Layout::right_to_left(Align::Center), right);
    });
    ui.add_space(2.0);
}

/// Space and a line between two parts.
pub fn part(ui: &mut Ui) {
    ui.add_space(8.0);
    ui.separator();
    ui.add_space(4.0);
}

/// Field of a number that changes once the hand rests, as the result takes its time: while the number is
/// dragged it is the panel's own. Returns the control, and the number once it has changed; `name` is read
/// by those who do not see the control.
pub fn held(
    ui: &mut Ui,
    id: Id,
    name: &str,
    value: f64,
    drag: impl FnOnce(&mut f64) -> DragValue<'_>,
) -> (Response, Option<f64>) {
    let held = ui.data(|data| data.get_temp::<f64>(id));
    let mut now = held.unwrap_or(value);
    let response = ui.add(drag(&mut now));
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(name));
    if response.dragged() {
        ui.data_mut(|data| data.insert_temp(id, now));
        return (response, None);
    }
    let changed = held.is_some() || response.changed();
    if changed {
        ui.data_mut(|data| data.remove::<f64>(id));
    }
    (response, changed.then_some(now))
}
