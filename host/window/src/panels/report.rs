//! The report on a model that was written.

use super::frames::modal;
use crate::numbers::count;
use crate::window::{Commands, Window, WriteReport};
use eframe::egui::{self, Grid, Id, Modal, RichText};
use simod_model::size::human_size;

/// Shows the report until it is closed.
pub fn show(ctx: &egui::Context, window: &Window, commands: &mut Commands) {
    let Some(WriteReport { output, report, seconds }) = &window.report else { return };
    let mut done = false;
    let modal = Modal::new(Id::unique("report")).frame(modal(ctx)).show(ctx, |ui| {
        ui.set_width(420.0);
        ui.heading("The deformed model is written");
        ui.add_space(6.0);
        ui.label(RichText::new(output.display().to_string()).weak());
        ui.add_space(8.0);
        Grid::new("report").num_columns(2).spacing([24.0, 6.0]).show(ui, |ui| {
            let mut row = |name: &str, value: String| {
                ui.label(name);
                ui.label(RichText::new(value).strong());
                ui.end_row();
            };
            row("Vertices", count(report.vertices));
            row("Time", format!("{seconds:.1} s"));
            let rate = report.vertices as f64 / seconds.max(1e-3);
            row("Vertices a second", count(rate as u64));
            if let Ok(file) = std::fs::metadata(output) {
                row("Size", human_size(file.len()));
            }
            if report.non_finite > 0 {
                row("Left as they are: no finite position", count(report.non_finite));
            }
        });
        ui.add_space(10.0);
        done = ui.button("Close").clicked();
    });
    if done || modal.should_close() {
        commands.then(|window| window.report = None);
    }
}
