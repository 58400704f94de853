//! Spread of amounts over a mesh: mean, percentile and maximum.

use serde::Serialize;

/// Spread of some amount over a mesh; all 0 for a mesh without any.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Spread {
    /// Root of the mean square.
    pub rms: f64,
    /// 99 of 100 are at most this.
    pub p99: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// The spread of amounts that are not negative.
    pub fn from_amounts(mut amounts: Vec<f64>) -> Self {
        let Some(last) = amounts.len().checked_sub(1) else { return Self::default() };
        let squares: f64 = amounts.iter().map(|x| x * x).sum();
        let (_, p99, above) = amounts.select_nth_unstable_by(last * 99 / 100, f64::total_cmp);
        let max = above.iter().copied().max_by(f64::total_cmp);
        Self { rms: (squares / (last + 1) as f64).sqrt(), p99: *p99, max: max.unwrap_or(*p99) }
    }
}

/// Median: the number in the middle, or the mean of both there; nothing of no numbers.
pub fn median(mut numbers: Vec<f64>) -> Option<f64> {
    numbers.sort_by(f64::total_cmp);
    let last = numbers.len().checked_sub(1)?;
    Some(0.5 * (numbers[last / 2] + numbers[numbers.len() / 2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_median_is_in_the_middle() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0]), Some(2.5));
        assert_eq!(median(Vec::new()), None);
    }
}
