//! Positions that are stored as whole numbers.

use glam::{DVec3, IVec3};

use crate::bounds::Bounds;

/// The storage of positions as integers of 32 bits: a position is number · scale + offset, axis by axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledIntegers {
    /// Step from one number to the next, in the model's unit; finite, and not zero.
    pub scale: DVec3,
    /// The position of number zero.
    pub offset: DVec3,
}

impl ScaledIntegers {
    /// The position that a number stands for.
    #[inline]
    pub fn position(&self, numbers: IVec3) -> DVec3 {
        numbers.as_dvec3() * self.scale + self.offset
    }

    /// The number of an axis that is nearest to a coordinate, if there is one so far out.
    #[inline]
    pub fn nearest_of_axis(&self, axis: usize, coordinate: f64) -> Option<i32> {
        let number = (coordinate - self.offset[axis]) / self.scale[axis];
        if number <= f64::from(i32::MIN) - 1.0 || number >= f64::from(i32::MAX) + 1.0 || number.is_nan() {
            return None;
        }
        // Rounding as `round` does, which is a call on processors that have no instruction for it.
        let whole = number as i64;
        let part = number - whole as f64;
        i32::try_from(whole + i64::from(part >= 0.5) - i64::from(part <= -0.5)).ok()
    }

    /// Numbers that are nearest to a position: the same as for each axis, where none is at the end of the
    /// range of numbers.
    #[inline(always)]
    pub fn nearest_within(&self, p: DVec3) -> Option<IVec3> {
        let number = (p - self.offset) / self.scale;
        let (low, high) = (f64::from(i32::MIN) + 1.0, f64::from(i32::MAX) - 1.0);
        // The test is written so that NaN fails.
        if !(number.min_element() > low && number.max_element() < high && !number.is_nan()) {
            return None;
        }
        let whole = number.as_ivec3();
        let part = number - whole.as_dvec3();
        let up = |axis: usize| i32::from(part[axis] >= 0.5) - i32::from(part[axis] <= -0.5);
        Some(whole + IVec3::from_array([0, 1, 2].map(up)))
    }

    /// The numbers that are nearest to a position, if there are any so far out.
    pub fn nearest(&self, p: DVec3) -> Option<IVec3> {
        let [x, y, z] = [0, 1, 2].map(|axis| self.nearest_of_axis(axis, p[axis]));
        Some(IVec3::new(x?, y?, z?))
    }

    /// The box of all positions that have numbers.
    pub fn range(&self) -> Bounds {
        Bounds::from_points([IVec3::MIN, IVec3::MAX].map(|numbers| self.position(numbers)))
    }

    /// Numbers of steps by which the offset has to move, if it has to, so that all positions within some
    /// bounds and a margin around them have integers; an error with the axis along which no offset will do.
    pub(crate) fn steps_to(&self, bounds: &Bounds, margin: f64) -> Result<Option<[i64; 3]>, usize> {
        if bounds.is_empty() {
            return Ok(None);
        }
        let range = self.range();
        let (min, max) = (bounds.min - margin, bounds.max + margin);
        let mut steps = [0; 3];
        for (axis, steps) in steps.iter_mut().enumerate() {
            if (range.max - range.min)[axis] <= (max - min)[axis] {
                return Err(axis);
            }
            if min[axis] < range.min[axis] || max[axis] > range.max[axis] {
                *steps = ((bounds.center() - self.offset)[axis] / self.scale[axis]).round() as i64;
            }
        }
        Ok((steps != [0; 3]).then_some(steps))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_back(
            numbers in prop::array::uniform3(any::<i32>()),
            digits in prop::array::uniform3(0..9),
            offset in prop::array::uniform3(-1e7..1e7),
        ) {
            let scale = DVec3::from(digits.map(|n: i32| 10f64.powi(-n)));
            let integers = ScaledIntegers { scale, offset: DVec3::from(offset) };
            let numbers = IVec3::from(numbers);
            let there = integers.position(numbers);
            // Distances within the precision of doubles count as none.
            let far = (integers.offset.abs() + there.abs()) * f64::EPSILON / scale;
            let back = integers.nearest(there);
            if far.max_element() < 0.4 && numbers.abs().max_element() < i32::MAX {
                prop_assert_eq!(back, Some(numbers));
            }
        }
    }

    proptest! {
        #[test]
        fn numbers_are_rounded_as_others_are(
            whole in prop_oneof![-9..9i64, Just(i64::from(i32::MIN)), Just(i64::from(i32::MAX)), any::<i32>().prop_map(i64::from), any::<i64>()],
            part in prop_oneof![Just(0.5f64), Just(-0.5), Just(0.49999999999999994), Just(f64::NAN), -1.0..1.0],
        ) {
            let coordinate = whole as f64 + part;
            let integers = ScaledIntegers { scale: DVec3::ONE, offset: DVec3::ZERO };
            let rounded = coordinate.round();
            let fits = rounded >= f64::from(i32::MIN) && rounded <= f64::from(i32::MAX);
            prop_assert_eq!(integers.nearest_of_axis(0, coordinate), fits.then_some(rounded as i32));
        }
    }

    #[test]
    fn an_offset_moves_by_whole_steps_and_only_where_it_has_to() {
        let integers =
            ScaledIntegers { scale: DVec3::new(0.01, -0.01, 1e-9), offset: DVec3::new(5.0, 0.0, 1.0) };
        let steps_to = |bounds: &Bounds| integers.steps_to(bounds, 0.05 * bounds.diagonal());
        let near = Bounds::from_points([DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.1, 0.1, 1.5)]);
        assert_eq!(steps_to(&near), Ok(None));
        let far = Bounds::from_points([DVec3::new(1e8, 1e8, 0.5), DVec3::new(1e8 + 2.0, 1e8 + 2.0, 1.5)]);
        assert_eq!(steps_to(&far), Ok(Some([9_999_999_600, -10_000_000_100, 0])));
        let wide = Bounds::from_points([DVec3::ZERO, DVec3::new(0.0, 0.0, 4.3)]);
        assert_eq!(steps_to(&wide), Err(2));
    }

    #[test]
    fn what_is_beyond_the_range_has_no_number() {
        let integers = ScaledIntegers { scale: DVec3::splat(0.5), offset: DVec3::splat(10.0) };
        let range = integers.range();
        assert_eq!(integers.nearest(range.max), Some(IVec3::MAX));
        assert_eq!(integers.nearest(range.min), Some(IVec3::MIN));
        assert_eq!(integers.nearest(range.max + DVec3::X), None);
        assert_eq!(integers.nearest(range.min - DVec3::Z), None);
        assert_eq!(integers.nearest(DVec3::NAN), None);
        assert!(range.contains(DVec3::splat(10.0)));
    }
}
