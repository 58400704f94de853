//! Local coordinates: single precision about the model's middle, at unit size.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;

/// The map between the model's coordinates (double) and local ones (single).
///
/// local = (model − origin) / scale. The origin is the middle of the bounding box, so that georeferenced
/// models keep their precision; the scale is a power of two, so that nothing is rounded by it, and makes the
/// diagonal lie between 1 and 2, so that squares of lengths neither overflow nor vanish.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// The local origin, in the model's coordinates.
    pub origin: DVec3,
    /// Length of a local unit, in the model's unit.
    pub scale: f64,
}

impl Frame {
    /// The frame of a model with this bounding box. A single point gets a scale of 1.
    pub fn from_bounds(bounds: &Bounds) -> Self {
        let diagonal = bounds.diagonal();
        // Kept off the ends of the exponent's range, so that the inverse is a normal number too.
        let scale =
            if diagonal > 0.0 { 2f64.powf(diagonal.log2().floor().clamp(-1000.0, 1000.0)) } else { 1.0 };
        Self { origin: bounds.center(), scale }
    }

    /// Whether origin and scale make sense: a frame read from a file may hold anything.
    pub fn is_valid(&self) -> bool {
        self.origin.is_finite() && self.scale.is_normal() && self.scale > 0.0
    }

    /// Local coordinates of a position in the model's coordinates.
    #[inline]
    pub fn to_local(&self, p: DVec3) -> Vec3 {
        self.to_local_exact(p).as_vec3()
    }

    /// Position in the model's coordinates of one in local coordinates.
    #[inline]
    pub fn to_model(&self, p: Vec3) -> DVec3 {
        self.to_model_exact(p.as_dvec3())
    }

    /// Local coordinates as of [`to_local`](Self::to_local), in double precision.
    #[inline]
    pub fn to_local_exact(&self, p: DVec3) -> DVec3 {
        // The inverse of a power of two is exact.
        (p - self.origin) * (1.0 / self.scale)
    }

    /// Position as of [`to_model`](Self::to_model), in double precision.
    #[inline]
    pub fn to_model_exact(&self, p: DVec3) -> DVec3 {
        p * self.scale + self.origin
    }
}

/// Whether all coordinates are finite, as [`DVec3::is_finite`] tells, but without a branch for each: the
/// product with zero of a number that is not finite is NaN.
#[inline]
pub fn is_finite(p: DVec3) -> bool {
    (p * 0.0).element_sum() == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_that_are_not_finite_are_found_at_any_place() {
        for x in [0.0, -0.0, 1.0, f64::MAX, f64::MIN_POSITIVE, f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
            for other in [0.0, f64::MIN, f64::INFINITY] {
                for p in [DVec3::new(x, 1.0, other), DVec3::new(other, x, 1.0), DVec3::new(1.0, other, x)] {
                    assert_eq!(is_finite(p), p.is_finite(), "{p}");
                }
            }
        }
    }

    #[test]
    fn round_trip_is_exact_to_single_precision() {
        for (at, size) in [(0.0, 1.0), (4.2e6, 800.0), (0.0, 1e-30), (-3e29, 1e30), (1e300, 1e299)] {
            let bounds = Bounds::from_points([DVec3::splat(at), DVec3::splat(at + size)]);
            let frame = Frame::from_bounds(&bounds);
            let diagonal = bounds.diagonal() / frame.scale;
            assert!((1.0..=2.0).contains(&diagonal), "{diagonal}");
            for t in [0.0, 0.3, 1.0] {
                let p = DVec3::splat(at + t * size);
                let error = (frame.to_model(frame.to_local(p)) - p).abs().max_element();
                assert!(error <= 6e-8 * size + 3e-16 * at.abs(), "{at} {size} {t}: {error}");
            }
        }
    }
}
