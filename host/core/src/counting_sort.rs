//! Few numbers put in order by counting, for each, those that are less: without a branch that the processor
//! would have to foretell, and many at once.

use pulp::{Arch, Simd, WithSimd};

/// Largest number of numbers that are sorted by counting; more of them are sorted by the standard library.
const MOST: usize = 64;

/// Sorts numbers whose upper halves mostly differ.
pub fn sort(numbers: &mut [u64]) {
    if numbers.len() > MOST || !Arch::new().dispatch(CountingSort(numbers)) {
        numbers.sort_unstable();
    }
}

/// Sorts numbers by their upper halves, or leaves them as they are and says so, if some of these are the
/// same.
struct CountingSort<'a>(&'a mut [u64]);

impl WithSimd for CountingSort<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let numbers = self.0;
        let mut keys = [u32::MAX; MOST];
        for (key, number) in keys.iter_mut().zip(&*numbers) {
            *key = (number >> 32) as u32;
        }
        let mut less = [0; MOST];
        let (one, none) = (simd.splat_u32s(1), simd.splat_u32s(0));
        let places = S::as_simd_u32s(&keys).0.iter().zip(S::as_mut_simd_u32s(&mut less).0);
        for (own, less) in places.take(numbers.len().div_ceil(S::U32_LANES)) {
            let mut count = none;
            for key in &keys[..numbers.len()] {
                let is_less = simd.less_than_u32s(simd.splat_u32s(*key), *own);
                count = simd.add_u32s(count, simd.select_u32s(is_less, one, none));
            }
            *less = count;
        }
        // Equal numbers have the same count, so one of their places stays free.
        let (mut sorted, mut taken) = ([0; MOST], 0u64);
        for (number, less) in numbers.iter().zip(less) {
            sorted[less as usize % MOST] = *number;
            taken |= 1 << (less as usize % MOST);
        }
        let is_sorted = taken.count_ones() as usize == numbers.len();
        if is_sorted {
            numbers.copy_from_slice(&sorted[..numbers.len()]);
        }
        is_sorted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_in_order(
            numbers in proptest::collection::vec((0..200u32, 0..4u32), 0..90),
            top in prop_oneof![Just(0), Just(u32::MAX - 200)],
        ) {
            let numbers: Vec<u64> =
                numbers.iter().map(|(upper, lower)| u64::from(top + upper) << 32 | u64::from(*lower)).collect();
            let (mut sorted, mut expected) = (numbers.clone(), numbers);
            sort(&mut sorted);
            expected.sort_unstable();
            prop_assert_eq!(sorted, expected);
        }
    }

    #[test]
    fn the_largest_number_is_one_as_others_are() {
        let mut numbers = [u64::MAX, 5, u64::MAX - 1, 1 << 40];
        sort(&mut numbers);
        assert_eq!(numbers, [5, 1 << 40, u64::MAX - 1, u64::MAX]);
    }
}
