//! P_S*, the deformed samples, so that they keep their digits far from where they were.

use glam::{BVec3, DVec3, Vec3};
use simod_model::frame::Frame;

/// Step of the shift in local units: the shift is a whole number of steps along each axis, and zero unless
/// samples go further than the model's diagonal in the mean.
const STEP: f64 = 4.0;

/// Positions of the deformed samples, in local coordinates less a shift that all samples have in common.
///
/// Single precision tells places far off the local origin but coarsely: samples that all go a thousand times
/// the model's size away would lose three digits of their differences. So most of the way that they go
/// together is kept by itself, in double precision.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DeformedPositions {
    /// Local positions, one per sample, less the shift.
    pub local: Vec<Vec3>,
    /// Shift in the model's unit; mostly zero.
    pub shift: DVec3,
}

impl DeformedPositions {
    /// Samples of a model with this frame that went from `rest` (local coordinates) to finite places (the
    /// model's coordinates).
    pub fn new(frame: &Frame, rest: &[Vec3], places: &[DVec3]) -> Self {
        let ways = rest.iter().zip(places).map(|(from, to)| frame.to_local_exact(*to) - from.as_dvec3());
        let mean = ways.sum::<DVec3>() / rest.len().max(1) as f64;
        let shift = (mean / STEP).round() * STEP * frame.scale;
        let shifted = shifted(frame, shift);
        let local = |(place, own): (&DVec3, &Vec3)| {
            // A sample at its rest position keeps the bits of that position.
            let stays = place.cmpeq(frame.to_model(*own)) & BVec3::splat(shift == DVec3::ZERO);
            Vec3::select(stays, *own, shifted.to_local(*place))
        };
        Self { local: places.iter().zip(rest).map(local).collect(), shift }
    }

    /// Frame of the local positions; `rest` is the frame of the model at rest.
    pub fn frame(&self, rest: &Frame) -> Frame {
        shifted(rest, self.shift)
    }

    /// The places, in the model's coordinates; `rest` is the frame of the model at rest.
    pub fn places(&self, rest: &Frame) -> impl ExactSizeIterator<Item = DVec3> {
        let frame = self.frame(rest);
        self.local.iter().map(move |p| frame.to_model(*p))
    }

    /// Positions in local coordinates with the shift added, as precise as single precision is there.
    pub fn into_unshifted(self, rest: &Frame) -> Vec<Vec3> {
        if self.is_unshifted() { self.local } else { self.places(rest).map(|p| rest.to_local(p)).collect() }
    }

    /// Whether the shift is zero, so that local positions are in the frame of the model at rest.
    pub fn is_unshifted(&self) -> bool {
        self.shift == DVec3::ZERO
    }

    /// Whether all samples are at their rest positions, to the bit.
    pub fn are_still(&self, rest: &[Vec3]) -> bool {
        are_still(&self.local, self.shift, rest)
    }
}

/// Whether all samples, with these local positions less a shift, are at their rest positions, to the bit.
pub(crate) fn are_still(local: &[Vec3], shift: DVec3, rest: &[Vec3]) -> bool {
    let bits = |p: &Vec3| p.to_array().map(f32::to_bits);
    shift == DVec3::ZERO && local.iter().map(bits).eq(rest.iter().map(bits))
}

impl From<Vec<Vec3>> for DeformedPositions {
    fn from(local: Vec<Vec3>) -> Self {
        Self { local, shift: DVec3::ZERO }
    }
}

/// Frame of positions that were shifted; without a shift the same one, to the signs of zeros.
fn shifted(frame: &Frame, shift: DVec3) -> Frame {
    let origin = if shift == DVec3::ZERO { frame.origin } else { frame.origin + shift };
    Frame { origin, ..*frame }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Samples of a model of two local units.
    fn rest() -> Vec<Vec3> {
        (0..60).map(|i| Vec3::new((i as f32).sin(), (2.0 * i as f32).cos(), i as f32 / 60.0)).collect()
    }

    proptest! {
        #[test]
        fn what_goes_far_keeps_its_digits(
            way in prop::array::uniform3(-1e7..1e7), origin in -1e6..1e6, scale in -8..8i32,
        ) {
            let frame = Frame { origin: DVec3::splat(origin), scale: 2f64.powi(scale) };
            let (way, rest) = (DVec3::from(way), rest());
            let places: Vec<DVec3> = rest.iter().map(|p| frame.to_model(*p) + way).collect();
            let far = DeformedPositions::new(&frame, &rest, &places);
            // Rounding of double-precision numbers of that size, and of the single-precision local positions.
            let rounding = 1e-15 * (way.length() + origin.abs()) + 3e-7 * frame.scale;
            for ((back, place), local) in far.places(&frame).zip(&places).zip(&far.local) {
                prop_assert!(back.distance(*place) <= rounding, "{back} {place}");
                prop_assert!(local.abs().max_element() <= 3.5);
            }
            // Positions that are written and read again stay the same.
            let written: Vec<DVec3> = far.places(&frame).collect();
            let read = DeformedPositions::new(&frame, &rest, &written);
            prop_assert_eq!(read.shift, far.shift);
            prop_assert!(read.places(&frame).eq(written));
        }
    }

    #[test]
    fn what_stays_near_is_local_as_it_was() {
        let (rest, frame) = (rest(), Frame { origin: DVec3::new(5e5, -0.0, 3.0), scale: 0.5 });
        for way in [DVec3::ZERO, DVec3::new(0.9, -0.9, 0.3)] {
            let places: Vec<DVec3> = rest.iter().map(|p| frame.to_model(*p) + way).collect();
            let near = DeformedPositions::new(&frame, &rest, &places);
            let local: Vec<Vec3> = places.iter().map(|p| frame.to_local(*p)).collect();
            assert!(near.is_unshifted());
            assert_eq!(near.are_still(&rest), way == DVec3::ZERO && local == rest);
            assert_eq!(near.into_unshifted(&frame), local);
        }
        assert!(!DeformedPositions { local: rest.clone(), shift: DVec3::X }.are_still(&rest));
    }
}
