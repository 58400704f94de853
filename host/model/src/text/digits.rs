//! Numbers written with as many digits as a file has.
//!
//! A number that moved gets as many decimals as the one that it replaces, and as the most that some numbers
//! spread over the file have; so no number is less precise than the file's own digits. Numbers in scientific
//! notation stay in it, with as many digits before the exponent, and seven at least. Where the file's
//! decimals are coarser than a thousandth of its extent, as in a cube of zeros and ones, they say nothing of
//! the precision that is wanted: numbers get decimals down to a ten-millionth of it.

use std::io::Write;

use crate::text;

/// The digits of a sort of numbers in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Digits {
    /// Digits behind the point, without and with an exponent.
    pub(crate) decimals: usize,
    pub(crate) mantissa: usize,
}

/// Looks at numbers.
#[derive(Debug)]
pub(crate) struct Survey {
    decimals: usize,
    mantissa: usize,
    /// The least and the largest number for each coordinate.
    ranges: [(f64, f64); 3],
    /// The largest magnitude of the numbers.
    largest: f64,
}

impl Default for Survey {
    fn default() -> Self {
        Self { decimals: 0, mantissa: 6, ranges: [(f64::INFINITY, f64::NEG_INFINITY); 3], largest: 0.0 }
    }
}

impl Survey {
    /// Includes a number of the coordinate that has this index.
    pub(crate) fn take(&mut self, coordinate: usize, word: &[u8]) {
        let Some(value) = text::parse(crate::Scalar::F64, word).filter(|v| v.is_finite()) else { return };
        let range = &mut self.ranges[coordinate % 3];
        *range = (range.0.min(value), range.1.max(value));
        self.largest = self.largest.max(value.abs());
        match decimals_of(word) {
            (decimals, None) => self.decimals = self.decimals.max(decimals),
            (decimals, Some(_)) => self.mantissa = self.mantissa.max(decimals),
        }
    }

    /// Largest magnitude of the numbers.
    pub(crate) fn largest(&self) -> f64 {
        self.largest
    }

    /// The digits, where the extent may be known.
    pub(crate) fn digits(&self, extent: Option<f64>) -> Digits {
        let extent = extent.unwrap_or_else(|| {
            let square = self.ranges.iter().filter(|r| r.0 < r.1).map(|r| (r.1 - r.0) * (r.1 - r.0));
            square.sum::<f64>().sqrt()
        });
        let finest = |share: f64| (-(extent * share).log10().floor()).clamp(0.0, 15.0) as usize;
        let mut decimals = self.decimals.min(Digits::MOST);
        if extent > 0.0 && extent.is_finite() && 10f64.powi(-(decimals as i32)) > extent * 1e-3 {
            decimals = decimals.max(finest(1e-7));
        }
        Digits { decimals, mantissa: self.mantissa.min(Digits::MOST) }
    }
}

/// Digits behind the point, and the exponent's letter if there is one.
fn decimals_of(word: &[u8]) -> (usize, Option<u8>) {
    let exponent = word.iter().position(|b| matches!(b, b'e' | b'E'));
    let number = &word[..exponent.unwrap_or(word.len())];
    let decimals = number.iter().position(|b| *b == b'.').map_or(0, |point| number.len() - point - 1);
    (decimals, exponent.map(|at| word[at]))
}

impl Digits {
    /// Most digits: further ones add nothing to a double.
    const MOST: usize = 17;

    /// The most that some words have.
    pub(crate) fn most_of<'w>(words: impl Iterator<Item = &'w [u8]>) -> Self {
        let mut survey = Survey::default();
        words.for_each(|word| survey.take(0, word));
        survey.digits(Some(0.0))
    }

    /// Appends a number that replaces `old`.
    #[inline]
    pub(crate) fn write(&self, to: &mut Vec<u8>, old: &[u8], value: f64) {
        let (decimals, exponent) = decimals_of(old);
        if !value.is_finite() {
            text::write_number(to, crate::Scalar::F64, value);
        } else if let Some(letter) = exponent {
            write_scientific(to, value, decimals.max(self.mantissa).min(Self::MOST), letter);
        } else {
            write_fixed(to, value, decimals.max(self.decimals).min(Self::MOST));
        }
    }
}

/// Writes a number as C does: with a sign and two digits at least in the exponent.
fn write_scientific(to: &mut Vec<u8>, value: f64, decimals: usize, letter: u8) {
    let start = to.len();
    // Writing to a vector cannot fail.
    let _ = write!(to, "{value:.decimals$e}");
    let Some(at) = to[start..].iter().position(|b| *b == b'e').map(|at| start + at) else { return };
    let exponent: i32 = std::str::from_utf8(&to[at + 1..]).ok().and_then(|e| e.parse().ok()).unwrap_or(0);
    to.truncate(at);
    to.push(letter);
    let sign = if exponent < 0 { '-' } else { '+' };
    let _ = write!(to, "{sign}{:02}", exponent.abs());
}

const POWERS: [f64; 18] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17];

fn write_fixed(to: &mut Vec<u8>, value: f64, decimals: usize) {
    let scaled = value.abs() * POWERS[decimals];
    if scaled >= 9e15 {
        if value.abs() >= 1e16 {
            return text::write_number(to, crate::Scalar::F64, value);
        }
        let _ = write!(to, "{value:.decimals$}");
        return;
    }
    // Whole numbers below 2⁵³: exact.
    let mut rest = scaled.round_ties_even() as u64;
    let mut buffer = [b'0'; 40];
    let (mut at, mut digits, is_zero) = (buffer.len(), 0, rest == 0);
    while rest > 0 || digits <= decimals {
        if digits == decimals && decimals > 0 {
            at -= 1;
            buffer[at] = b'.';
        }
        at -= 1;
        buffer[at] = b'0' + (rest % 10) as u8;
        rest /= 10;
        digits += 1;
    }
    if value < 0.0 && !is_zero {
        at -= 1;
        buffer[at] = b'-';
    }
    to.extend_from_slice(&buffer[at..]);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn surveyed(words: &[&str]) -> Digits {
        let mut survey = Survey::default();
        words.iter().enumerate().for_each(|(i, word)| survey.take(i, word.as_bytes()));
        survey.digits(None)
    }

    fn written(digits: Digits, old: &str, value: f64) -> String {
        let mut text = Vec::new();
        digits.write(&mut text, old.as_bytes(), value);
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn digits_are_as_many_as_the_file_has() {
        let metres = surveyed(&["0.000000", "1.5", "-3.250000", "7.125000", "0.25", "1.0"]);
        assert_eq!(written(metres, "1.5", 2.0 / 3.0), "0.666667");
        assert_eq!(written(metres, "-1.00000000", -2.0), "-2.00000000");
        assert_eq!(written(metres, "0.1", -1e-9), "0.000000");
        let utm = surveyed(&["512345.67", "5412345.60", "101.2", "512999.00", "5412000.01", "99"]);
        assert_eq!(written(utm, "512345.6", 512_345.123_456), "512345.12");
        assert_eq!(written(utm, "99", 99.999), "100.00");
    }

    #[test]
    fn what_is_too_coarse_for_the_extent_is_refined() {
        let cube = surveyed(&["0", "0", "0", "1", "1", "1"]);
        assert_eq!(written(cube, "1", 1.0 / 3.0), "0.3333333");
        let none = surveyed(&["7", "7", "7"]);
        assert_eq!(written(none, "7", 8.0), "8");
        // Whole numbers over a long extent are a grid, and stay one.
        let grid = surveyed(&["0", "0", "0", "4000", "4000", "30"]);
        assert_eq!(written(grid, "0", 17.3), "17");
    }

    #[test]
    fn scientific_notation_stays_as_c_writes_it() {
        let digits = surveyed(&["1.234567e+00", "-2.5e-03", "0.000000e+00"]);
        assert_eq!(written(digits, "1.234567e+00", -12.345_678_9), "-1.234568e+01");
        assert_eq!(written(digits, "1E5", 1.0 / 3.0), "3.333333E-01");
        assert_eq!(written(digits, "1.23456789e5", 1e-120), "1.00000000e-120");
    }

    proptest! {
        #[test]
        fn a_number_is_off_by_half_a_digit_at_most(value in -1e12..1e12f64, shift in -14i32..=0, decimals in 0usize..=15) {
            let value = value * 10f64.powi(shift);
            let mut text = Vec::new();
            write_fixed(&mut text, value, decimals);
            let word = String::from_utf8(text).unwrap();
            let (point, _) = decimals_of(word.as_bytes());
            prop_assert_eq!(point, decimals);
            let back: f64 = word.parse().unwrap();
            let bound = 0.5 * 10f64.powi(-(decimals as i32)) * (1.0 + 1e-9) + 4.0 * value.abs() * f64::EPSILON;
            prop_assert!((back - value).abs() <= bound, "{} {}", word, value);
        }
    }
}
