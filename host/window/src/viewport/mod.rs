//! The picture of the model, and what is drawn over it.

pub mod colors;
mod corner;
pub mod detail;
mod emerging;
pub mod handles;
mod navigate;
mod picture;
mod texture;
mod versions;

use crate::window::Window;
use crate::{panels, tools};
use eframe::egui::{self, CentralPanel, Event, Painter, PointerButton, Pos2, Rect, Response, Sense, Ui};
use glam::DVec2;
pub use picture::Viewport;
use simod_viewer::{Command, Version};
use versions::Places;

/// The part of the window that shows the model.
pub struct Canvas<'a> {
    response: &'a Response,
    painter: Painter,
    rect: Rect,
    pixels_per_point: f32,
    blocked: bool,
}

impl Canvas<'_> {
    /// egui's.
    pub fn ctx(&self) -> &egui::Context {
        &self.response.ctx
    }

    /// Where it is, in points.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Draws over the picture.
    pub fn painter(&self) -> &Painter {
        &self.painter
    }

    /// Whether the pointer is over it, and nothing else is before it.
    pub fn is_hovered(&self) -> bool {
        self.response.contains_pointer() && !self.blocked
    }

    /// Where the pointer is, in points.
    pub fn pointer_pos(&self) -> Option<Pos2> {
        self.ctx().input(|i| i.pointer.latest_pos())
    }

    /// The pixel of the picture under the pointer; may be outside of it.
    pub fn pointer(&self) -> Option<DVec2> {
        let p = (self.pointer_pos()? - self.rect.min) * self.pixels_per_point;
        Some(DVec2::new(f64::from(p.x), f64::from(p.y)))
    }

    /// The pixel where the left button was pressed last: of a quick click, it is up again by now.
    pub fn press(&self) -> Option<[f64; 2]> {
        let pressed = |event: &Event| match event {
            Event::PointerButton { pos, button: PointerButton::Primary, pressed: true, .. } => Some(*pos),
            _ => None,
        };
        let at = self.ctx().input(|i| i.events.iter().find_map(pressed).or(i.pointer.press_origin()))?;
        let p = (at - self.rect.min) * self.pixels_per_point;
        Some([f64::from(p.x), f64::from(p.y)])
    }

    /// The pixels that the pointer went through since the last picture, from where it was pressed, if it was, to
    /// where it is or was let go.
    pub fn trail(&self) -> Vec<DVec2> {
        let pixel = |p: Pos2| {
            let p = (p - self.rect.min) * self.pixels_per_point;
            DVec2::new(f64::from(p.x), f64::from(p.y))
        };
        let of = |event: &Event| match event {
            Event::PointerMoved(p) => Some(pixel(*p)),
            Event::PointerButton { pos, button: PointerButton::Primary, .. } => Some(pixel(*pos)),
            _ => None,
        };
        let is_release = |event: &Event| {
            matches!(event, Event::PointerButton { button: PointerButton::Primary, pressed: false, .. })
        };
        let is_press = |event: &Event| {
            matches!(event, Event::PointerButton { button: PointerButton::Primary, pressed: true, .. })
        };
        self.ctx().input(|i| {
            let end = i.events.iter().position(is_release).map_or(i.events.len(), |at| at + 1);
            let begin = i.events[..end].iter().rposition(is_press).unwrap_or(0);
            i.events[begin..end].iter().filter_map(of).collect()
        })
    }

    /// Where a pixel is, in points.
    pub fn at(&self, pixel: DVec2) -> Pos2 {
        let p = pixel.as_vec2() / self.pixels_per_point;
        self.rect.min + egui::vec2(p.x, p.y)
    }

    /// A length in pixels.
    pub fn pixels(&self, points: f32) -> f64 {
        f64::from(points * self.pixels_per_point)
    }

    /// Whether the left button has just been pressed over it.
    pub fn is_pressed(&self) -> bool {
        let modifiers = self.modifiers();
        self.is_hovered() && self.ctx().input(|i| i.pointer.primary_pressed()) && !modifiers.alt
    }

    /// Whether the left button is held.
    pub fn is_down(&self) -> bool {
        self.ctx().input(|i| i.pointer.primary_down())
    }

    /// Whether it was clicked with the left button.
    pub fn is_clicked(&self) -> bool {
        self.response.clicked_by(PointerButton::Primary) && !self.blocked
    }

    /// Keys that are held.
    pub fn modifiers(&self) -> egui::Modifiers {
        self.ctx().input(|i| i.modifiers)
    }
}

/// Shows it in what the panels left.
pub fn show(ui: &mut Ui, window: &mut Window, viewport: &mut Viewport) {
    CentralPanel::no_frame().show(ui, |ui| {
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "Model"));
        let places = Places::of(rect, window);
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
            Canvas { response: &response, painter, rect, pixels_per_point, blocked: blocked || over_corner }
        };
        if let Some(emerging) = viewport.emerging(&canvas(main, false), window) {
            navigate::update(&canvas(main, false), window, window.tools.tool);
            whole.set(picture, emerging);
            panels::progress::show(ui, rect, window);
            return;
        }
        if window.state().scene().is_none() {
            viewport.clear(ui, rect, window);
            panels::welcome::show(ui, rect, window);
            return;
        }
        // The pinned version is looked at only.
        let looks = places.under(ui) == Some(Version::Pinned) && !window.tools.is_dragging();
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
        corner::show(ui, main, window);
        panels::over::show(ui, rect, window);
    });
}
