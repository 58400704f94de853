//! Precision of a file's coordinates, by the numbers themselves: those of a program that has single
//! precision, or writes few digits, are coarser than the type that the file says.

use std::fmt::Write;

use glam::DVec3;

/// Number of digits that tell singles from each other, and of those that tell doubles, for all that matters
/// here: a program that writes fewer rounds to decimal digits.
const OF_SINGLES: i32 = 8;
const OF_DOUBLES: i32 = 12;

/// Least number of digits that tell that numbers are rounded: numbers of fewer may be whole.
const LEAST: i32 = 5;

/// The numbers of positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StoredPrecision {
    /// Whether all numbers along each axis are exact in single precision.
    is_single: [bool; 3],
    /// Whether numbers along such an axis have all digits of singles, and no decimal ones.
    has_all_digits: [bool; 3],
    /// Decimal digits of any number of the other axes, and decimals behind the point, at most; nothing where
    /// these are many.
    decimal: Option<(i32, i32)>,
    /// The largest coordinates, without their sign.
    largest: DVec3,
}

/// Digits, and decimals behind the point, of the shortest text that tells a number from others of its type.
fn digits_of(x: f64, is_single: bool, text: &mut String) -> (i32, i32) {
    text.clear();
    // Writing to memory does not fail.
    let _ = if is_single { write!(text, "{:e}", x as f32) } else { write!(text, "{x:e}") };
    let (mantissa, exponent) = text.split_once('e').unwrap_or((text, "0"));
    let digits = mantissa.bytes().filter(u8::is_ascii_digit).count() as i32;
    (digits, digits - 1 - exponent.parse::<i32>().unwrap_or(0))
}

impl StoredPrecision {
    /// The precision of positions in the coordinates of their file.
    pub fn measure(positions: &[DVec3]) -> Self {
        let along =
            |axis: usize| positions.iter().map(move |p| p[axis]).filter(|x| x.is_finite() && *x != 0.0);
        let is_single = [0, 1, 2].map(|axis| along(axis).all(|x| f64::from(x as f32) == x));
        let (mut text, mut most, mut are_many, mut has_all_digits) =
            (String::new(), (0, i32::MIN), false, [false; 3]);
        for (axis, is_single) in is_single.into_iter().enumerate() {
            let enough = if is_single { OF_SINGLES } else { OF_DOUBLES };
            let mut of_axis = (0, i32::MIN);
            for x in along(axis).take_while(|_| !are_many) {
                let (digits, decimals) = digits_of(x, is_single, &mut text);
                of_axis = (of_axis.0.max(digits), of_axis.1.max(decimals));
                if digits >= enough {
                    (has_all_digits[axis], are_many) = (is_single, !is_single);
                    break;
                }
            }
            if !has_all_digits[axis] {
                most = (most.0.max(of_axis.0), most.1.max(of_axis.1));
            }
        }
        let decimal = (!are_many && most.0 >= LEAST).then_some(most);
        let largest = [0, 1, 2].map(|axis| along(axis).fold(0.0, |largest: f64, x| largest.max(x.abs())));
        Self { is_single, has_all_digits, decimal, largest: largest.into() }
    }

    /// Distance from a coordinate along an axis to the next one that the file tells from it: zero where these
    /// are doubles.
    fn step(&self, axis: usize, at: f64) -> f64 {
        let single = if self.is_single[axis] { single_step(at) } else { 0.0 };
        single.max(self.decimal_step(axis, at))
    }

    fn decimal_step(&self, axis: usize, at: f64) -> f64 {
        let decimal = self.decimal.filter(|_| at != 0.0 && !self.has_all_digits[axis]);
        let Some((digits, decimals)) = decimal else { return 0.0 };
        let place = at.abs().log10().floor() as i32 + 1 - digits;
        10f64.powi(place.max(-decimals))
    }

    /// The largest step between coordinates.
    pub fn coarsest(&self) -> f64 {
        (0..3).map(|axis| self.step(axis, self.largest[axis])).fold(0.0, f64::max)
    }

    /// Largest difference of a coordinate along an axis from the number that was rounded to the file's
    /// decimals; 0 if the file has none. Where other axes have singles, the number was rounded to a single
    /// before.
    fn decimal_bound(&self, axis: usize, at: f64) -> f64 {
        let step = self.decimal_step(axis, at);
        let single = if self.is_single.contains(&true) { single_step(at) } else { 0.0 };
        // The bound is a little larger, as numbers that are read are rounded once more.
        if step > 0.0 { 0.5 * (1.0 + 1e-6) * step + 0.5 * single } else { 0.0 }
    }

    /// Whether a coordinate along an axis, `found` in the file, may be `from` as the file rounds it.
    pub fn is_rounded(&self, axis: usize, found: f64, from: f64) -> bool {
        let is_single = self.is_single[axis] && f64::from(from as f32) == found;
        is_single || (found - from).abs() <= self.decimal_bound(axis, found)
    }
}

/// Distance from a number to the next one in single precision.
fn single_step(at: f64) -> f64 {
    f64::from((at.abs() as f32).next_up()) - f64::from(at.abs() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places as far from the origin as in surveys.
    fn places() -> Vec<DVec3> {
        let at = |i: u32| f64::from(i.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
        (0..300)
            .map(|i| DVec3::new(4e5 + 100.0 * at(i), 5e6 + 100.0 * at(i + 999), 50.0 * at(i + 77)))
            .collect()
    }

    fn check(write: impl Fn(f64) -> f64, coarsest: f64) {
        let places = places();
        let written: Vec<DVec3> = places.iter().map(|p| DVec3::from(p.to_array().map(&write))).collect();
        let precision = StoredPrecision::measure(&written);
        let found = precision.coarsest();
        assert!((found - coarsest).abs() <= 1e-9 * coarsest, "{found} for {coarsest}");
        for (places, written) in places.iter().zip(&written) {
            for axis in 0..3 {
                let (from, found) = (places[axis], written[axis]);
                let is_rounded = |from: f64| precision.is_rounded(axis, found, from);
                assert!(found == from || is_rounded(from), "{from} is {found}");
                // A coordinate that moves by more than a step, or by more than two roundings, is not taken
                // for rounded.
                let far =
                    precision.step(axis, found).max(2.0 * precision.decimal_bound(axis, found)).max(1e-9);
                assert!(!is_rounded(from + 1.6 * far) && !is_rounded(from - 1.6 * far), "{from} is {found}");
            }
        }
    }

    #[test]
    fn numbers_tell_how_far_they_are_apart() {
        check(|x| x, 0.0);
        check(|x| f64::from(x as f32), 0.5);
        // Of few digits, or of few decimals; as singles, too.
        let digits = |x: f64| format!("{x:.5e}").parse::<f64>().unwrap();
        check(digits, 10.0);
        check(|x| f64::from(digits(x) as f32), 10.0);
        check(|x| (x * 1e3).round() / 1e3, 1e-3);
        // Singles of which few decimals were written: far from the origin these are all.
        check(|x| (f64::from(x as f32) * 1e6).round() / 1e6, 0.5);
    }

    #[test]
    fn whole_numbers_are_meant() {
        let whole: Vec<DVec3> = places().iter().map(|p| (p - DVec3::new(4e5, 5e6, 0.0)).round()).collect();
        let precision = StoredPrecision::measure(&whole);
        assert!(!precision.is_rounded(0, 3.0, 3.2) && precision.coarsest() < 1e-4);
        assert_eq!(
            StoredPrecision::measure(&[DVec3::ZERO, DVec3::NAN]).coarsest(),
            f64::from(f32::from_bits(1))
        );
    }
}
