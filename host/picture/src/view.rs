//! The view of a picture: the part of the model that it shows, and from where.

use glam::{DVec3, swizzles::Vec3Swizzles};
use serde::Deserialize;
use simod_model::bounds::Bounds;

use super::{PictureCamera, Renderer, Style};

/// The view of a picture: from where, and how large it is.
#[derive(Debug, Clone, Copy)]
pub struct PictureView {
    /// The box that fills the picture.
    pub bounds: Bounds,
    /// Turned to the right about +y from +z, in degrees.
    pub yaw: f64,
    /// Looking down, in degrees.
    pub pitch: f64,
    /// Picture size in pixels.
    pub size: [u32; 2],
    /// The axis of the model that points up.
    pub up: UpAxis,
    /// Part of the view that is shown.
    pub crop: Crop,
}

/// A part of a picture, from the same place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crop {
    /// The model's point in the middle; that of the bounds where it is not given.
    pub around: Option<DVec3>,
    /// The part's width over that of the whole: above 0.
    pub part: f64,
}

impl Default for Crop {
    /// The whole.
    fn default() -> Self {
        Self { around: None, part: 1.0 }
    }
}

/// The model's axis that points up in the picture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpAxis {
    /// The first.
    X,
    /// The second.
    #[default]
    Y,
    /// The third.
    Z,
}

impl UpAxis {
    /// Turns the model's axes, in their order, so that the axis that points up becomes y.
    pub(super) fn turned(self, p: DVec3) -> DVec3 {
        match self {
            Self::X => p.zxy(),
            Self::Y => p,
            Self::Z => p.yzx(),
        }
    }
}

impl PictureView {
    pub(super) fn camera(&self) -> PictureCamera {
        self.cropped(self.whole())
    }

    fn cropped(&self, camera: PictureCamera) -> PictureCamera {
        camera.crop(self.crop.around.map(|p| self.up.turned(p)), self.crop.part)
    }

    /// The camera that shows everything.
    fn whole(&self) -> PictureCamera {
        let [w, h] = self.size;
        let bounds = [self.up.turned(self.bounds.min), self.up.turned(self.bounds.max)];
        let aspect = f64::from(w) / f64::from(h.max(1));
        PictureCamera::frame(bounds, self.yaw.to_radians(), self.pitch.to_radians(), aspect)
    }

    /// The cameras of a full turn, evenly spaced. All are as far away as the farthest of those that just show
    /// everything: nothing is cut, and the model does not seem to grow and shrink.
    pub(super) fn turn(&self, frames: u32) -> Vec<PictureCamera> {
        let yaw = |k| self.yaw + 360.0 * f64::from(k) / f64::from(frames);
        let cameras: Vec<PictureCamera> =
            (0..frames).map(|k| Self { yaw: yaw(k), ..*self }.whole()).collect();
        let farthest = cameras.iter().map(PictureCamera::distance).fold(0.0, f64::max);
        cameras.into_iter().map(|camera| self.cropped(camera.at_least(farthest))).collect()
    }

    pub(super) fn renderer(&self, camera: PictureCamera, own_colors: bool) -> Renderer {
        let [w, h] = self.size;
        let ground = Some(self.up.turned(self.bounds.min).y);
        Renderer::new(w, h, camera, Style { own_colors, ground })
    }
}
