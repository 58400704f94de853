//! Messages that go away, with their advice.

use crate::window::{Commands, Toast, Window};
use eframe::egui::{self, Align2, Area, Color32, Frame, Id, Margin, Order, RichText, Stroke, Ui, vec2};

/// Shows the messages at the lower right of the picture.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let (toasts, Some(next)) = window.toasts.shown() else { return };
    ctx.request_repaint_after(next);
    let mut closed = None;
    let area = Area::new(Id::unique("toasts")).order(Order::Foreground);
    area.anchor(Align2::CENTER_BOTTOM, vec2(-80.0, -38.0)).show(ctx, |ui| {
        for (i, toast) in toasts.iter().enumerate() {
            let visuals = ui.visuals();
            let color = if toast.is_error { visuals.error_fg_color } else { visuals.selection.bg_fill };
            let frame = Frame::window(ui.style())
                .stroke(Stroke::new(1.0, color.gamma_multiply(0.7)))
                .inner_margin(Margin::symmetric(12, 8));
            let shown = frame.show(ui, |ui| {
                ui.set_max_width(460.0);
                ui.horizontal_top(|ui| content(ui, toast, color)).inner
            });
            if shown.inner {
                closed = Some(i);
            }
        }
    });
    if let Some(i) = closed {
        commands.then(move |window| window.toasts.close(i));
    }
}

/// Button that closes a message, and beside it its text and advice. Returns whether the message shall be
/// closed.
fn content(ui: &mut Ui, toast: &Toast, color: Color32) -> bool {
    let close = ui.add(egui::Button::new("\u{d7}").frame(false).fill(Color32::TRANSPARENT));
    close.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, "Close the message"));
    ui.vertical(|ui| {
        let text = RichText::new(&toast.text);
        ui.label(if toast.is_error { text.color(color) } else { text });
        if !toast.hint.is_empty() {
            ui.label(RichText::new(&toast.hint).weak());
        }
    });
    close.clicked()
}
