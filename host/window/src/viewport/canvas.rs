//! The part of the window that shows the model, and the pointer over it.

use eframe::egui::{self, Event, Painter, PointerButton, Pos2, Rect, Response};
use glam::DVec2;

/// The part of the window that shows the model.
pub struct ModelArea<'a> {
    /// State of the pointer over the area, as egui knows it.
    pub response: &'a Response,
    /// Painter that draws over the picture.
    pub painter: Painter,
    /// Place of the area, in points of the screen.
    pub rect: Rect,
    /// Pixels of the picture in a point of the screen.
    pub pixels_per_point: f32,
    /// Whether something else lies over the area under the pointer.
    pub blocked: bool,
}

impl ModelArea<'_> {
    /// Context of egui.
    pub fn ctx(&self) -> &egui::Context {
        &self.response.ctx
    }

    /// Place of the area, in points of the screen.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Draws over the picture.
    pub fn painter(&self) -> &Painter {
        &self.painter
    }

    /// Whether the pointer is over the area, and nothing else lies over it.
    pub fn is_hovered(&self) -> bool {
        self.response.contains_pointer() && !self.blocked
    }

    /// Place of the pointer, in points of the screen.
    pub fn pointer_pos(&self) -> Option<Pos2> {
        self.ctx().input(|i| i.pointer.latest_pos())
    }

    /// Pixel of the picture under the pointer; may be outside of the picture.
    pub fn pointer(&self) -> Option<DVec2> {
        let p = (self.pointer_pos()? - self.rect.min) * self.pixels_per_point;
        Some(DVec2::new(f64::from(p.x), f64::from(p.y)))
    }

    /// Pixel where the left button was pressed last: of a quick click, the button is up again by now.
    pub fn press(&self) -> Option<[f64; 2]> {
        let pressed = |event: &Event| match event {
            Event::PointerButton { pos, button: PointerButton::Primary, pressed: true, .. } => Some(*pos),
            _ => None,
        };
        let at = self.ctx().input(|i| i.events.iter().find_map(pressed).or(i.pointer.press_origin()))?;
        let p = (at - self.rect.min) * self.pixels_per_point;
        Some([f64::from(p.x), f64::from(p.y)])
    }

    /// Pixels that the pointer went through since the last picture: from that of the press, if the button
    /// was pressed, to the present one or that of the release.
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

    /// Place of a pixel of the picture, in points of the screen.
    pub fn in_points(&self, pixel: DVec2) -> Pos2 {
        let p = pixel.as_vec2() / self.pixels_per_point;
        self.rect.min + egui::vec2(p.x, p.y)
    }

    /// Length in pixels of a length in points of the screen.
    pub fn pixels(&self, points: f32) -> f64 {
        f64::from(points * self.pixels_per_point)
    }

    /// Whether the left button has just been pressed over the area.
    pub fn is_pressed(&self) -> bool {
        let modifiers = self.modifiers();
        self.is_hovered() && self.ctx().input(|i| i.pointer.primary_pressed()) && !modifiers.alt
    }

    /// Whether the left button is held.
    pub fn is_down(&self) -> bool {
        self.ctx().input(|i| i.pointer.primary_down())
    }

    /// Whether the area was clicked with the left button.
    pub fn is_clicked(&self) -> bool {
        self.response.clicked_by(PointerButton::Primary) && !self.blocked
    }

    /// Keys that are held.
    pub fn modifiers(&self) -> egui::Modifiers {
        self.ctx().input(|i| i.modifiers)
    }
}
