//! The axis along which a step works, with the planes between which it does, and knobs that move these.
//!
//! A plugin has one if it has these parameters: `center`, a point; `axis`, a direction; and `from` and `to`, numbers
//! in the model's diagonal, signed, along the axis from that point.

use super::Canvas;
use crate::theme;
use crate::tools::Tool;
use crate::widgets::parameter::{number_of, vector_of};
use crate::window::Window;
use eframe::egui::{Color32, CursorIcon, Pos2, Shape, Stroke};
use glam::DVec3;
use simod_plugin_api::{ParamDesc, ParamKind, Unit};
use simod_session::edit::Change;
use simod_viewer::Command;

/// The ids of the planes' places.
pub const PLANES: [&str; 2] = ["from", "to"];
/// How near the pointer has to be to a knob, in points.
const REACH: f32 = 11.0;
/// Half a side of a plane, as a part of the model's diagonal.
const SIDE: f64 = 0.22;
const COLOR: Color32 = Color32::from_rgb(90, 160, 235);
/// Segments of a line, as a line may go behind the eye.
const SEGMENTS: usize = 16;

/// The axis of the chosen step, in local coordinates.
pub struct Axis {
    step: usize,
    center: DVec3,
    /// Of length 1.
    direction: DVec3,
    /// Of the planes, along the axis.
    places: [f64; 2],
    /// The model's diagonal.
    diagonal: f64,
}

impl Axis {
    /// That of the chosen step, if it works along one.
    pub fn of(window: &Window) -> Option<Self> {
        let (step, _, deformation, plugin) = window.chosen()?;
        let (plugin, scene) = (plugin?, window.state().scene()?);
        let param = |id: &str, kind: ParamKind| plugin.params().iter().find(|d| d.id == id && d.kind == kind);
        let value = |desc: &ParamDesc| deformation.params.get(desc.id.as_str());
        let (frame, bounds) = (scene.frame(), scene.sampled.bounds);
        let center = param("center", ParamKind::POINT)?;
        let direction = param("axis", ParamKind::DIRECTION)?;
        let place = |id: &str| {
            let desc = param(id, ParamKind::FLOAT).filter(|d| d.unit == Unit::DIAGONAL)?;
            Some(number_of(desc, value(desc)))
        };
        let [from, to] = PLANES.map(place);
        let diagonal = (bounds.max - bounds.min).length() / frame.scale;
        let center = DVec3::from(vector_of(center, value(center), &bounds));
        let axis = DVec3::from(vector_of(direction, value(direction), &bounds)).try_normalize()?;
        Some(Self {
            step,
            center: frame.to_local_exact(center),
            direction: axis,
            places: [from? * diagonal, to? * diagonal],
            diagonal,
        })
    }

    fn at(&self, place: f64) -> DVec3 {
        self.center + self.direction * place
    }

    /// The place along it that is nearest to what is under a pixel.
    fn place_under(&self, window: &Window, pixel: glam::DVec2) -> Option<f64> {
        let ray = window.state().camera().ray(pixel, window.state().size());
        let between = self.center - ray.origin;
        let cosine = self.direction.dot(ray.direction);
        let place =
            (cosine * ray.direction.dot(between) - self.direction.dot(between)) / (1.0 - cosine * cosine);
        place.is_finite().then_some(place)
    }
}

/// Draws it.
pub fn draw(canvas: &Canvas<'_>, window: &Window) {
    let Some(axis) = Axis::of(window).filter(|_| is_shown(window.tools.tool)) else { return };
    let (camera, size) = (window.state().camera(), window.state().size());
    let project = |p: DVec3| camera.project(p, size).map(|(pixel, _)| canvas.at(pixel));
    let painter = canvas.painter();
    let line = |from: f64, to: f64, stroke: Stroke| {
        let place = |i: usize| axis.at(from + (to - from) * i as f64 / SEGMENTS as f64);
        let points: Vec<Option<Pos2>> = (0..=SEGMENTS).map(|i| project(place(i))).collect();
        for pair in points.windows(2) {
            if let [Some(a), Some(b)] = pair {
                painter.line_segment([*a, *b], stroke);
            }
        }
    };
    let [from, to] = axis.places;
    let beyond = 0.12 * axis.diagonal;
    line(from - beyond, to + beyond, Stroke::new(1.0, COLOR.gamma_multiply(0.5)));
    line(from, to, Stroke::new(2.5, COLOR));
    let (u, v) = axis.direction.any_orthonormal_pair();
    let side = SIDE * axis.diagonal;
    let hovered = canvas.pointer_pos().filter(|_| canvas.is_hovered());
    for (k, place) in axis.places.into_iter().enumerate() {
        let middle = axis.at(place);
        let corners = [u + v, v - u, -u - v, u - v].map(|way| project(middle + way * side));
        let corners: Vec<Pos2> = corners.into_iter().flatten().collect();
        if corners.len() == 4 {
            painter.add(Shape::convex_polygon(
                corners,
                COLOR.gamma_multiply(0.12),
                Stroke::new(1.2, COLOR.gamma_multiply(0.8)),
            ));
        }
        if let Some(at) = project(middle) {
            let held = window.tools.plane == Some(k);
            let near = hovered.is_some_and(|p| p.distance(at) < REACH);
            let (color, radius) = match (held, near) {
                (true, _) => (theme::color(theme::SELECTED), 6.0),
                (_, true) => (Color32::WHITE, 6.5),
                _ => (COLOR, 5.0),
            };
            painter.circle(at, radius, color, Stroke::new(1.2, Color32::from_black_alpha(160)));
        }
    }
}

fn is_shown(tool: Tool) -> bool {
    !tool.selects() && tool != Tool::Stroke
}

/// The knobs follow the hand. Whether the pointer is theirs.
pub fn update(canvas: &Canvas<'_>, window: &mut Window) -> bool {
    let Some(axis) = Axis::of(window).filter(|_| is_shown(window.tools.tool)) else {
        window.tools.plane = None;
        return false;
    };
    let (camera, size) = (*window.state().camera(), window.state().size());
    let under = |p: Pos2| {
        let near = |place: f64| {
            let at = canvas.at(camera.project(axis.at(place), size)?.0);
            Some(at.distance(p)).filter(|distance| *distance < REACH)
        };
        let [a, b] = axis.places.map(near);
        match (a, b) {
            (Some(a), Some(b)) => Some(usize::from(b < a)),
            (Some(_), None) => Some(0),
            (None, Some(_)) => Some(1),
            (None, None) => None,
        }
    };
    if canvas.is_pressed()
        && let Some(at) = canvas.ctx().input(|i| i.pointer.press_origin()).or(canvas.pointer_pos())
    {
        window.tools.plane = under(at);
    }
    let Some(plane) = window.tools.plane else {
        if canvas.is_hovered() && canvas.pointer_pos().and_then(under).is_some() {
            canvas.ctx().set_cursor_icon(CursorIcon::Grab);
        }
        return false;
    };
    let moved = canvas.trail().last().copied();
    if let Some(place) = moved.and_then(|pixel| axis.place_under(window, pixel)) {
        // One stays before the other: what lies between them is what happens.
        let least = 1e-3 * axis.diagonal;
        let place =
            if plane == 0 { place.min(axis.places[1] - least) } else { place.max(axis.places[0] + least) };
        let value = Some((place / axis.diagonal).into());
        window.change(axis.step, Change::SetParam { id: PLANES[plane].to_owned(), value }, true);
        window.tools.drags_plane = true;
    }
    if !canvas.is_down() {
        window.tools.plane = None;
        if std::mem::take(&mut window.tools.drags_plane) {
            window.apply(Command::Rest);
        }
    }
    true
}
