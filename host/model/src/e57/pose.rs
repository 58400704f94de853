//! Pose of a scan: the rotation and translation from its own frame to the one that all scans share.

use glam::{DMat3, DVec3, Mat3};

/// A rotation, and then a translation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScanPose {
    /// Images of the axes.
    axes: [DVec3; 3],
    pub translation: DVec3,
}

impl Default for ScanPose {
    fn default() -> Self {
        Self { axes: DVec3::AXES, translation: DVec3::ZERO }
    }
}

impl ScanPose {
    /// Pose with the rotation of a quaternion `[w, x, y, z]`; `None` where that is no rotation.
    pub fn new(rotation: [f64; 4], translation: DVec3) -> Option<Self> {
        // Scaled, so that squares neither overflow nor vanish.
        let largest = rotation.iter().fold(0.0, |all: f64, one| all.max(one.abs()));
        let scaled = rotation.map(|one| one / largest);
        let length = scaled.iter().map(|one| one * one).sum::<f64>().sqrt();
        let [w, x, y, z] = scaled.map(|one| one / length);
        if !(w + x + y + z).is_finite() || !translation.is_finite() {
            return None;
        }
        let axes = [
            DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
            DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
            DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
        ];
        Some(Self { axes, translation })
    }

    /// A vector of the scan's frame in the common one.
    #[inline]
    pub fn turned(&self, v: DVec3) -> DVec3 {
        self.axes[0] * v.x + self.axes[1] * v.y + self.axes[2] * v.z
    }

    /// A vector of the common frame in that of the scan.
    #[inline]
    pub fn turned_back(&self, v: DVec3) -> DVec3 {
        DVec3::from(self.axes.map(|axis| axis.dot(v)))
    }

    /// A gradient of the common frame in that of the scan.
    pub fn gradient_in_scan(&self, gradient: &Mat3) -> Mat3 {
        let [x, y, z] = self.axes;
        let axes = DMat3::from_cols(x, y, z);
        (axes.transpose() * gradient.as_dmat3() * axes).as_mat3()
    }

    /// A position of the scan's frame in the common one.
    #[inline]
    pub fn position(&self, p: DVec3) -> DVec3 {
        self.turned(p) + self.translation
    }

    /// Whether the scan's frame is the shared one.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// The axis of the rotation and its angle in degrees; none if there is no rotation.
    pub fn rotation(&self) -> Option<(DVec3, f64)> {
        let [x, y, z] = self.axes;
        let axis = DVec3::new(y.z - z.y, z.x - x.z, x.y - y.x);
        let cosine = f64::midpoint(x.x + y.y + z.z, -1.0);
        let angle = axis.length().mul_add(0.5, 0.0).atan2(cosine).to_degrees();
        (angle > 0.0).then(|| (axis.try_normalize().unwrap_or(DVec3::ZERO), angle))
    }
}

/// The place of spherical coordinates: range, azimuth, elevation.
#[inline]
pub(super) fn cartesian([range, azimuth, elevation]: [f64; 3]) -> DVec3 {
    let ((sin_a, cos_a), (sin_e, cos_e)) = (azimuth.sin_cos(), elevation.sin_cos());
    range * DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e)
}

/// The spherical coordinates of a place: range, azimuth, elevation.
#[inline]
pub(super) fn spherical(p: DVec3) -> [f64; 3] {
    let flat = p.x.hypot(p.y);
    [flat.hypot(p.z), p.y.atan2(p.x), p.z.atan2(flat)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_quarter_turn_about_z() {
        let half = 0.5f64.sqrt();
        let pose = ScanPose::new([half, 0.0, 0.0, half], DVec3::new(10.0, 0.0, 0.0)).unwrap();
        assert!((pose.position(DVec3::X) - DVec3::new(10.0, 1.0, 0.0)).length() < 1e-15);
        // A vector along the axis of the turn keeps all its bits.
        assert_eq!(pose.turned_back(DVec3::new(0.0, 0.0, 0.1)), DVec3::new(0.0, 0.0, 0.1));
        let (axis, angle) = pose.rotation().unwrap();
        assert!((axis - DVec3::Z).length() < 1e-12 && (angle - 90.0).abs() < 1e-12);
        assert_eq!(ScanPose::new([0.0; 4], DVec3::ZERO), None);
        assert_eq!(ScanPose::new([f64::NAN, 1.0, 0.0, 0.0], DVec3::ZERO), None);
        assert!(ScanPose::new([2.0, 0.0, 0.0, 0.0], DVec3::ZERO).unwrap().is_identity());
    }

    proptest! {
        #[test]
        fn frames_and_coordinates_come_back(
            rotation in prop::array::uniform4(-1.0..1.0f64),
            p in prop::array::uniform3(-100.0..100.0f64),
        ) {
            let p = DVec3::from(p);
            prop_assume!(rotation.iter().any(|c| c.abs() > 1e-3));
            let pose = ScanPose::new(rotation, DVec3::ZERO).unwrap();
            prop_assert!((pose.turned_back(pose.turned(p)) - p).length() < 1e-12);
            prop_assert!((pose.turned(p).length() - p.length()).abs() < 1e-12);
            prop_assert!((cartesian(spherical(p)) - p).length() < 1e-12);
        }
    }
}
