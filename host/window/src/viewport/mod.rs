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

use crate::panels;
use crate::tools::{self, Tool, ToolContext};
use crate::window::Window;
pub use canvas::ModelArea;
use eframe::egui::{self, CentralPanel, Sense, Ui};
pub use picture::Viewport;
use simod_viewer::{Command, ComparedVersion};
use versions::VersionRects;

/// Gives the picture as many pixels as its place in the window has.
fn resize(window: &mut Window, pixels: egui::Vec2) {
    let size = [pixels.x, pixels.y].map(|side| f64::from(side.round().max(1.0)));
    if window.state().size() != size {
        window.apply(Command::Resize { size });
    }
}

/// Shows the picture in the part of the window that the panels left.
pub fn show(ui: &mut Ui, window: &mut Window, viewport: &mut Viewport) {
    CentralPanel::no_frame().show(ui, |ui| {
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "Model"));
        let places = VersionRects::divide(rect, window);
        let main = places.main().unwrap_or(rect);
        let pixels_per_point = ui.pixels_per_point();
        resize(window, main.size() * pixels_per_point);
        viewport.tidy(window);
        let painter = ui.painter_at(main);
        // The part is drawn first, and filled once the pointer has moved the camera.
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
            navigate(&canvas(main, false), window, window.tools.tool);
            whole.set(picture, emerging);
            window.draw(|window, commands| panels::progress::show(ui, rect, window, commands));
            return;
        }
        if window.state().scene().is_none() {
            viewport.clear(ui, rect, window);
            window.draw(|window, commands| panels::welcome::show(ui, rect, window, commands));
            return;
        }
        // The pinned version is looked at only.
        let looks = places.under(ui) == Some(ComparedVersion::Pinned) && !window.tools.gesture.is_dragging();
        let taken = places.now.is_some() && work(&canvas(main, looks), looks, window);
        if looks {
            navigate(&canvas(places.pinned.unwrap_or(main), false), window, Tool::Orbit);
        } else if !taken {
            navigate(&canvas(main, false), window, window.tools.tool);
        }
        if places.now.is_some() {
            tools::measure::draw(&canvas(main, false), window);
        }
        let pictures = window.draw(|window, commands| places.pictures(viewport, window, commands));
        whole.set(picture, egui::Shape::Vec(pictures));
        versions::captions(ui, rect, &places, window);
        window.draw(|window, commands| corner::show(ui, main, window, commands));
        window.draw(|window, commands| panels::over::show(ui, rect, window, commands));
    });
}

fn navigate(canvas: &ModelArea<'_>, window: &mut Window, tool: Tool) {
    window.draw(|window, commands| navigate::update(canvas, window, commands, tool));
}

/// Lets handles and tools follow the pointer, unless it only `looks`, and draw themselves. Returns whether
/// the pointer belongs to them, and not to the camera.
fn work(canvas: &ModelArea<'_>, looks: bool, window: &mut Window) -> bool {
    let mut taken = false;
    if window.looks.handles {
        handles::draw(canvas, window);
        handles::draw_axis(canvas, window);
        taken = window.draw_with(
            |window| &mut window.tools.gesture,
            |window, commands, gesture| {
                handles::drag_planes(&mut ToolContext { canvas, window, commands, gesture })
            },
        );
    }
    taken = taken || tools::update(canvas, window);
    if !taken && !looks && canvas.is_clicked() && window.tools.tool.grabs() {
        window.draw(|window, commands| handles::take(canvas, window, commands));
    }
    taken
}
