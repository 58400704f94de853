//! The axis along which a step works, with the planes between which it does; and the camera that sees them.

use crate::widgets::values::{number_of, vector_of};
use crate::window::{Commands, Window};
use glam::{DVec2, DVec3};
use simod_plugin_api::{ParamDesc, ParamKind, Unit};
use simod_viewer::Command;
use simod_viewer::command::CameraMove;

/// The ids of the planes' places.
pub const PLANES: [&str; 2] = ["from", "to"];
/// Least distance of a knob from the picture's edge, in pixels, so that hands find the knob.
const MARGIN: f64 = 22.0;

/// The axis along which a step works, with the planes between which it does, in local coordinates.
///
/// A plugin works along an axis if it has these parameters: `center`, a point; `axis`, a direction; and
/// `from` and `to`, numbers in the model's diagonal, signed, along the axis from that point.
pub struct Axis {
    /// The step's place.
    pub step: usize,
    center: DVec3,
    /// Direction of the axis, of length 1.
    pub direction: DVec3,
    /// Places of the planes, along the axis.
    pub places: [f64; 2],
    /// The model's diagonal.
    pub diagonal: f64,
}

impl Axis {
    /// The axis of the chosen step, if it works along one.
    pub fn find(window: &Window) -> Option<Self> {
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

    /// The knobs.
    fn knobs(&self) -> [DVec3; 2] {
        self.places.map(|place| self.point(place))
    }

    /// Point of the axis at a place, in local coordinates.
    pub fn point(&self, place: f64) -> DVec3 {
        self.center + self.direction * place
    }

    /// Place along the axis that is nearest to what is under a pixel.
    pub fn place_under(&self, window: &Window, pixel: DVec2) -> Option<f64> {
        let ray = window.state().camera().ray(pixel, window.state().size());
        let between = self.center - ray.origin;
        let cosine = self.direction.dot(ray.direction);
        let place =
            (cosine * ray.direction.dot(between) - self.direction.dot(between)) / (1.0 - cosine * cosine);
        place.is_finite().then_some(place)
    }
}

/// Box around the samples and, if handles are shown, the knobs of the chosen step's axis: its two corners, in
/// local coordinates.
fn bounds(window: &Window) -> Option<[DVec3; 2]> {
    let shown = window.state().scene()?.bounds().map(|corner| corner.as_dvec3());
    let knobs = Axis::find(window).filter(|_| window.looks.handles).map(|axis| axis.knobs());
    let all = knobs.into_iter().flatten();
    Some(all.fold(shown, |[min, max], knob| [min.min(knob), max.max(knob)]))
}

/// Shows all of the samples, and of the axis along which the chosen step works.
pub fn frame_all(window: &Window, commands: &mut Commands) {
    let Some(bounds) = bounds(window) else { return };
    let mut camera = *window.state().camera();
    camera.frame(bounds, window.state().size());
    commands.apply(Command::Camera(CameraMove::Set(camera)));
}

/// Shows all where all samples are seen already, but not the knobs of the step that was just added.
pub fn frame_new(window: &Window, commands: &mut Commands) {
    let (Some(axis), Some(scene)) = (Axis::find(window), window.state().scene()) else { return };
    let (camera, size) = (window.state().camera(), window.state().size());
    let is_seen = |p: DVec3, margin: f64| {
        camera.project(p, size).is_some_and(|(pixel, _)| {
            let within = |x: f64, size: f64| (margin..=size - margin).contains(&x);
            within(pixel.x, size[0]) && within(pixel.y, size[1])
        })
    };
    let [min, max] = scene.bounds().map(|corner| corner.as_dvec3());
    let corner =
        |i: usize| DVec3::from([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] }));
    if (0..8).all(|i| is_seen(corner(i), 0.0)) && !axis.knobs().iter().all(|knob| is_seen(*knob, MARGIN)) {
        frame_all(window, commands);
    }
}
