//! Plane that cuts the model open: the part beyond the plane is not shown, and cannot be pointed at.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::frame::Frame;

/// Plane in model coordinates; the side to which its normal points is cut away.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Clip {
    /// The plane's normal, of any length but 0.
    pub normal: DVec3,
    /// A point of the plane.
    pub through: DVec3,
}

impl Clip {
    /// Whether the numbers make a plane.
    pub fn is_plane(&self) -> bool {
        self.through.is_finite() && self.normal.try_normalize().is_some()
    }

    /// Plane in local coordinates: points with `n · p > d` are cut away, for the unit normal n.
    pub fn local(&self, frame: &Frame) -> (DVec3, f64) {
        let normal = self.normal.normalize_or(DVec3::X);
        let through = frame.to_local_exact(self.through);
        (normal, normal.dot(through))
    }

    /// Plane with the other side cut away.
    pub fn flipped(self) -> Self {
        Self { normal: -self.normal, ..self }
    }
}

/// Whether a point is cut away by a plane; both in local coordinates.
pub fn cuts(plane: Option<(DVec3, f64)>, p: Vec3) -> bool {
    plane.is_some_and(|(normal, distance)| normal.dot(p.as_dvec3()) > distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_cuts_the_side_of_its_normal() {
        let frame = Frame { origin: DVec3::new(1e6, 0.0, 0.0), scale: 4.0 };
        let clip = Clip { normal: DVec3::X * 3.0, through: DVec3::new(1e6 + 2.0, 5.0, 5.0) };
        assert!(clip.is_plane() && !Clip { normal: DVec3::ZERO, ..clip }.is_plane());
        let plane = Some(clip.local(&frame));
        assert!(!cuts(plane, Vec3::X * 0.49) && cuts(plane, Vec3::X * 0.51));
        let other = Some(clip.flipped().local(&frame));
        assert!(cuts(other, Vec3::X * 0.49) && !cuts(other, Vec3::X * 0.51));
        assert!(!cuts(None, Vec3::X));
    }
}
