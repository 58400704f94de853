//! The camera, and the numbers or colours that are shown on the surface.

use super::State;
use crate::camera::Camera;
use crate::clip::Clip;
use crate::command::CameraMove;
use crate::measured::{MeasuredPoint, at_rest, carried};
use crate::overlay::Overlay;
use crate::pick::Hit;
use crate::tint::Tint;
use glam::{DVec2, DVec3};
use simod_model::{Attribute, Colors, Error, Result};
use simod_plugin_api::Effort;

/// Points that are measured along, at most.
const MOST_MEASURED: usize = 1000;

impl State {
    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The picture's width and height in pixels.
    pub fn size(&self) -> [f64; 2] {
        self.size
    }

    /// Numbers or colours that are shown on the surface.
    pub fn overlay(&self) -> Overlay {
        self.overlay
    }

    pub(super) fn show(&mut self, overlay: Overlay) -> Result<()> {
        self.overlay = overlay;
        let is_there = self.scene().is_none_or(|scene| match overlay {
            Overlay::TransferError => scene.expected_error.is_some(),
            Overlay::Attribute(_) => scene.sampled.held_attributes().is_some(),
            _ => true,
        });
        if !is_there {
            self.request(Effort::FULL);
        }
        self.compare();
        self.tint_detail();
        Ok(())
    }

    /// Whether the surface has the model's own colours, where it has any and no numbers are shown.
    pub fn has_own_colors(&self) -> bool {
        self.own_colors
    }

    pub(super) fn show_own_colors(&mut self, own: bool) -> Result<()> {
        self.own_colors = own;
        self.tint_detail();
        Ok(())
    }

    /// The plane that cuts the model open.
    pub fn clipped(&self) -> Option<Clip> {
        self.clip
    }

    /// The plane that cuts the model open, as unit normal and distance, in local coordinates.
    pub fn local_clip(&self) -> Option<(DVec3, f64)> {
        Some(self.clip?.local(&self.scene()?.frame()))
    }

    pub(super) fn clip(&mut self, clip: Option<Clip>) -> Result<()> {
        self.open()?;
        if clip.is_some_and(|clip| !clip.is_plane()) {
            return Err(Error::argument(
                "that is no plane to cut by",
                "give finite numbers, and a normal with a length",
            ));
        }
        self.clip = clip;
        Ok(())
    }

    /// Points along which is measured, with their places after the present steps.
    pub fn measured(&self) -> Vec<MeasuredPoint> {
        let Some(scene) = self.scene() else { return Vec::new() };
        self.measured.iter().map(|rest| carried(scene, *rest)).collect()
    }

    /// Place before all steps of a point that is shown, in model coordinates.
    pub fn at_rest(&self, hit: &Hit) -> Option<DVec3> {
        Some(at_rest(self.scene()?, hit))
    }

    pub(super) fn measure(&mut self, points: Vec<DVec3>) -> Result<()> {
        self.open()?;
        if points.len() > MOST_MEASURED || !points.iter().all(|p| p.is_finite()) {
            let what = "these points cannot be measured along";
            return Err(Error::argument(
                what,
                format!("give finite numbers, of {MOST_MEASURED} points at most"),
            ));
        }
        self.measured = points;
        Ok(())
    }

    /// Numbers that each vertex of the model has besides its position, which can be
    /// [shown](Overlay::Attribute).
    pub fn attributes(&self) -> &[Attribute] {
        self.scene().map_or(&[], |scene| &scene.sampled.source.attributes)
    }

    /// Source of the colours of vertices that are shown in full.
    pub fn tint(&self) -> Tint {
        match self.overlay {
            Overlay::Attribute(place) if place < self.attributes().len() => Tint::Attribute(place),
            Overlay::None if self.own_colors && Colors::seen(self.attributes()).is_some() => Tint::Own,
            _ => Tint::Samples,
        }
    }

    pub(super) fn resize(&mut self, size: [f64; 2]) -> Result<()> {
        if !size.iter().all(|x| (1.0..=65536.0).contains(x)) {
            return Err(Error::argument("a picture cannot be of that size", "give 1 to 65536 pixels"));
        }
        self.size = size;
        Ok(())
    }

    pub(super) fn move_camera(&mut self, step: CameraMove) -> Result<()> {
        let (mut camera, size) = (self.camera, self.size);
        match step {
            CameraMove::Orbit { yaw, pitch } => camera.orbit(yaw, pitch),
            CameraMove::Pan { by } => camera.pan(by.into(), size),
            CameraMove::Zoom { factor, at } => {
                if factor.is_nan() || factor <= 0.0 {
                    return Err(Error::argument("the camera cannot zoom by that factor", "give one above 0"));
                }
                let pixel = DVec2::from(at);
                let hit = self.pick(pixel).map(|hit| hit.local);
                camera.zoom(factor, hit.unwrap_or_else(|| camera.at_target_depth(pixel, size)));
            }
            CameraMove::FrameAll => self.frame(&mut camera, |_| true),
            CameraMove::FrameSelection => self.frame(&mut camera, |i| self.selection.contains(i)),
            CameraMove::Look(from) => camera.look(from),
            CameraMove::Project(projection) => camera.projection = projection,
            CameraMove::Up(up) => camera.up = up,
            CameraMove::Set(other) => camera = other,
        }
        if !camera.is_valid() {
            return Err(Error::argument("the camera cannot be there", "give finite numbers"));
        }
        self.camera = camera;
        Ok(())
    }

    /// Frames some samples, if there are any.
    fn frame(&self, camera: &mut Camera, of: impl Fn(u32) -> bool) {
        let Some(scene) = self.scene() else { return };
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (p, _) in scene.positions.iter().zip(0..).filter(|(_, i)| of(*i)) {
            (min, max) = (min.min(p.as_dvec3()), max.max(p.as_dvec3()));
        }
        camera.frame([min, max], self.size);
    }
}
