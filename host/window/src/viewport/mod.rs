//! The picture of the model, and what is drawn over it.

mod canvas;
mod colors;
mod corner;
pub mod detail;
mod emerging;
pub mod handles;
mod navigate;
mod picture;
pub mod seen;
mod texture;
mod versions;
pub mod vertex_colors;

use crate::window::Window;
use crate::{panels, tools};
pub use canvas::ModelArea;
use eframe::egui::{self, CentralPanel, Sense, Ui};
pub use picture::Viewport;
use simod_viewer::{Command, ComparedVersion};
use versions::VersionRects;

/// Shows it in what the panels left.
pub fn show(ui: &mut Ui, window: &mut Window, viewport: &mut Viewport) {
    CentralPanel::no_frame().show(ui, |ui| {
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "Model"));
        let places = VersionRects::divide(rect, window);
        let main = places.main().unwrap_or(rect);
        let pixels_per_point = ui.pixels_per_point();
        let size = main.size() * pixels_per_point;
        let size = [f64::from(size.x.round().max(1.0)), f64::from(size.y.round().max(1.0))];
        if window.state().size() != size {
            window.apply(Command::Resize { size });
        }
        viewport.tidy(window);
        let painter = ui.painter_at(main);
        // Drawn first, and filled once the pointer has moved the camera.
        let whole = ui.painter_at(rect);
        let picture = whole.add(egui::Shape::Noop);
        let over_corner = corner::contains(main, ui.ctx());
        let canvas = |rect, blocked| {
            let painter = painter.clone();
            ModelArea {
                response: &response,
                painter,
                rect,
                pixels_per_point,
                blocked: blocked || over_corner,
            }
        };
        if let Some(emerging) = viewport.emerging(&canvas(main, false), window) {
            navigate::update(&canvas(main, false), window, window.tools.tool);
            whole.set(picture, emerging);
            window.draw(|window, asks| panels::progress::show(ui, rect, window, asks));
            return;
        }
        if window.state().scene().is_none() {
            viewport.clear(ui, rect, window);
            window.draw(|window, asks| panels::welcome::show(ui, rect, window, asks));
            return;
        }
        // The pinned version is looked at only.
        let looks = places.under(ui) == Some(ComparedVersion::Pinned) && !window.tools.is_dragging();
        let mut taken = false;
        if places.now.is_some() {
            let canvas = canvas(main, looks);
            if window.looks.handles {
                handles::draw(&canvas, window);
                handles::draw_axis(&canvas, window);
                taken = handles::drag_planes(&canvas, window);
            }
            taken = taken || tools::update(&canvas, window);
            if !taken && !looks && canvas.is_clicked() && window.tools.tool.grabs() {
                handles::take(&canvas, window);
            }
        }
        if looks {
            navigate::update(&canvas(places.pinned.unwrap_or(main), false), window, tools::Tool::Orbit);
        } else if !taken {
            navigate::update(&canvas(main, false), window, window.tools.tool);
        }
        if places.now.is_some() {
            tools::measure::draw(&canvas(main, false), window);
        }
        let pictures = places.pictures(viewport, window);
        whole.set(picture, egui::Shape::Vec(pictures));
        versions::captions(ui, rect, &places, window);
        window.draw(|window, asks| corner::show(ui, main, window, asks));
        window.draw(|window, asks| panels::over::show(ui, rect, window, asks));
    });
}
