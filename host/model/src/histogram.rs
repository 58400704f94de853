//! Quantiles of numbers that are streamed.

/// Counts of positive values on a logarithmic scale from 1e-12 to 1e3, 64 bins per factor of ten.
pub struct Histogram {
    bins: Vec<u64>,
}

const BINS_PER_DECADE: f64 = 64.0;
const LEAST_EXPONENT: f64 = -12.0;

impl Default for Histogram {
    fn default() -> Self {
        Self { bins: vec![0; 15 * BINS_PER_DECADE as usize] }
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
        let bin = ((x.log10() - LEAST_EXPONENT) * BINS_PER_DECADE).max(0.0) as usize;
        let last = self.bins.len() - 1;
        self.bins[bin.min(last)] += count;
    }

    /// The middle of the bin that holds the quantile; 0 for anything below the scale.
    pub fn quantile(&self, q: f64) -> f64 {
        let wanted = (self.bins.iter().sum::<u64>() as f64 * q).ceil() as u64;
        let mut seen = 0;
        for (bin, n) in self.bins.iter().enumerate() {
            seen += n;
            if seen >= wanted && seen > 0 {
                return if bin == 0 {
                    0.0
                } else {
                    10f64.powf((bin as f64 + 0.5) / BINS_PER_DECADE + LEAST_EXPONENT)
                };
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
}
