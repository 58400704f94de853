//! Frames of panels over the picture, and of windows over all.

use eframe::egui::{self, Color32, Frame, Margin, Ui};

/// A panel over the picture.
pub fn card(ui: &Ui) -> Frame {
    let fill = ui.visuals().panel_fill;
    Frame::NONE
        .fill(Color32::from_rgba_unmultiplied(fill.r(), fill.g(), fill.b(), 236))
        .corner_radius(6.0)
        .inner_margin(Margin::symmetric(10, 6))
        .shadow(eframe::egui::Shadow {
            offset: [0, 2],
            blur: 8,
            spread: 0,
            color: Color32::from_black_alpha(60),
        })
}

/// Frame of windows that have to be answered.
pub fn modal(ctx: &egui::Context) -> egui::Frame {
    egui::Frame::popup(&ctx.global_style()).inner_margin(egui::Margin::same(20)).corner_radius(8.0)
}
