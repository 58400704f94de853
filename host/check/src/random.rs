//! Random numbers that are the same everywhere.
//!
//! G. L. Steele, D. Lea, C. H. Flood, *Fast Splittable Pseudorandom Number Generators*, OOPSLA 2014:
//! SplitMix64.

/// A sequence of random numbers.
pub(crate) struct Random(u64);

impl Random {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Random number from 0 to 1, without 1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Random number within a finite range.
    pub fn within(&mut self, [min, max]: [f64; 2]) -> f64 {
        // The difference of the ends may be more than a number holds.
        let t = self.unit();
        ((1.0 - t) * min + t * max).clamp(min, max)
    }

    /// Random whole number below a count, which is not 0.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::Random;

    #[test]
    fn numbers_are_those_of_the_reference() {
        assert_eq!(Random::new(1_234_567).next(), 6_457_827_717_110_365_317);
        let mut random = Random::new(7);
        assert!((0..1000).map(|_| random.within([-2.0, 3.0])).all(|x| (-2.0..=3.0).contains(&x)));
        assert!((0..1000).all(|_| random.below(3) < 3));
    }
}
