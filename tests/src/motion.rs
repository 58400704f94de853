//! Motions that are known exactly.

use glam::{DMat3, DVec3};

/// A similarity: scaled and turned about a pivot, then shifted.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    /// The rotation.
    pub turn: DMat3,
    /// Size after over size before.
    pub scale: f64,
    /// Point that turning and scaling leave in place.
    pub pivot: DVec3,
    /// Vector that is added at last.
    pub shift: DVec3,
}

impl Motion {
    /// A turn about an odd axis through `pivot`, and a shift by about `far`.
    pub fn rigid(pivot: DVec3, far: f64) -> Self {
        let axis = DVec3::new(2.0, -1.0, 0.5).normalize_or(DVec3::X);
        let shift = DVec3::new(0.7, 0.1, -0.6) * far;
        Self { turn: DMat3::from_axis_angle(axis, 2.1), scale: 1.0, pivot, shift }
    }

    /// The same, and larger by `scale`.
    pub fn similarity(pivot: DVec3, far: f64, scale: f64) -> Self {
        Self { scale, ..Self::rigid(pivot, far) }
    }

    /// Image of a point.
    pub fn image_of(&self, p: DVec3) -> DVec3 {
        self.pivot + self.turn * (p - self.pivot) * self.scale + self.shift
    }
}
