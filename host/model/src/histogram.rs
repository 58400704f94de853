//! Quantiles of numbers that are streamed.

/// Counts of positive values from 1e-12 to 1e3 and a little beyond, 32 bins of equal width for each factor of
/// two: which one it is follows from the bits of a number, without a logarithm.
#[derive(Debug, Clone)]
pub struct Histogram {
    bins: Vec<u64>,
}

/// Bits of a number behind those that determine the bin: 5 of the mantissa's are enough.
const SHIFT: u32 = 52 - 5;
/// First bin, for numbers below 2⁻⁴⁰, which is 9.1e-13.
const FIRST: u64 = (1023 - 40) << 5;
/// Number of bins, up to 2¹⁰.
const BINS: usize = 50 << 5;

impl Default for Histogram {
    fn default() -> Self {
        Self { bins: vec![0; BINS] }
    }
}

impl Histogram {
    /// Counts a value.
    #[inline]
    pub fn add(&mut self, x: f64) {
        self.add_many(x, 1);
    }

    /// Counts a value so many times.
    #[inline]
    pub fn add_many(&mut self, x: f64, count: u64) {
        // A number that is not positive, or NaN, counts as below the scale.
        let bits = if x > 0.0 { x.to_bits() >> SHIFT } else { 0 };
        let bin = (bits.saturating_sub(FIRST) as usize).min(BINS - 1);
        self.bins[bin] += count;
    }

    /// Counts all that another one has.
    pub fn merge(&mut self, other: &Self) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(bin, n)| *bin += n);
    }

    /// The middle of the bin that holds the quantile; 0 for anything below the scale.
    pub fn quantile(&self, q: f64) -> f64 {
        let wanted = (self.bins.iter().sum::<u64>() as f64 * q).ceil() as u64;
        let mut seen = 0;
        for (bin, n) in self.bins.iter().enumerate() {
            seen += n;
            if seen >= wanted && seen > 0 {
                let end = |bin: u64| f64::from_bits((FIRST + bin) << SHIFT);
                return if bin == 0 { 0.0 } else { 0.5 * (end(bin as u64) + end(bin as u64 + 1)) };
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_within_a_bin() {
        let mut h = Histogram::default();
        (1..=10_000).for_each(|i| h.add(f64::from(i) * 1e-6));
        assert!((h.quantile(0.999) / 9.99e-3 - 1.0).abs() < 0.02);
        assert!((h.quantile(0.5) / 5e-3 - 1.0).abs() < 0.02);
        assert_eq!(Histogram::default().quantile(0.999), 0.0);
    }

    #[test]
    fn what_is_off_the_scale_is_at_its_ends() {
        let mut h = Histogram::default();
        [0.0, -1.0, f64::NAN, 1e-300, 5e-13].into_iter().for_each(|x| h.add(x));
        assert_eq!(h.quantile(1.0), 0.0);
        let mut more = Histogram::default();
        [1e9, f64::INFINITY].into_iter().for_each(|x| more.add(x));
        h.merge(&more);
        assert_eq!(h.quantile(0.5), 0.0);
        assert!((1000.0..1024.0).contains(&h.quantile(1.0)), "{}", h.quantile(1.0));
        assert!((1e-12..2e-12).contains(&{
            let mut h = Histogram::default();
            h.add(1.2e-12);
            h.quantile(1.0)
        }));
    }
}
