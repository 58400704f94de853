//! The choice of vertices where there are too many of them: of each few that follow each other in a cell, one
//! by chance.
//!
//! So the number is exact, the choice is the same each time, and no regular pattern of the model's order
//! meets one of the choice's (jittered sampling: R. L. Cook, *Stochastic Sampling in Computer Graphics*,
//! 1986).

use crate::sampling::random::mix;

/// The least stride at which these numbers of vertices give at most `most` in all; or one each, where these
/// are more.
pub fn stride(vertices: &[u64], most: u64) -> u64 {
    let taken = |stride: u64| vertices.iter().map(|n| n.div_ceil(stride)).sum::<u64>();
    let (mut low, mut high) = (1, vertices.iter().copied().max().unwrap_or(1).max(1));
    while low < high {
        let middle = low + (high - low) / 2;
        if taken(middle) <= most { high = middle } else { low = middle + 1 }
    }
    low
}

/// The choice.
#[derive(Clone, Copy)]
pub struct Thinning {
    stride: u64,
}

impl Thinning {
    /// Choice of one vertex out of each `stride` ones.
    pub fn new(stride: u64) -> Self {
        Self { stride: stride.max(1) }
    }

    /// Whether the vertex at `place` among the `all` vertices of its cell is taken.
    #[inline]
    pub fn takes(&self, cell: u32, place: u64, all: u64) -> bool {
        if self.stride == 1 {
            return true;
        }
        let stratum = place / self.stride;
        let first = stratum * self.stride;
        let size = self.stride.min(all - first);
        mix(u64::from(cell), stratum) % size == place - first
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn one_of_each_few_is_taken(cell in 0..100u32, all in 1..500u64, stride in 1..60u64) {
            let thinning = Thinning::new(stride);
            let taken: Vec<u64> = (0..all).filter(|place| thinning.takes(cell, *place, all)).collect();
            let strata: Vec<u64> = taken.iter().map(|place| place / stride).collect();
            prop_assert_eq!(strata, (0..all.div_ceil(stride)).collect::<Vec<_>>());
        }

        #[test]
        fn the_stride_is_the_least(vertices in proptest::collection::vec(1..1000u64, 1..50), most in 0..20_000u64) {
            let found = stride(&vertices, most);
            let taken = |stride: u64| vertices.iter().map(|n| n.div_ceil(stride)).sum::<u64>();
            prop_assert!(taken(found) <= most.max(vertices.len() as u64));
            prop_assert!(found == 1 || taken(found - 1) > most);
        }
    }

    /// Along and across rows of any length, no place is preferred.
    #[test]
    fn rows_of_a_lattice_show_no_pattern() {
        let (stride, all) = (8, 1 << 16);
        let thinning = Thinning::new(stride);
        for row in [8, 16, 55, 89, 100] {
            let mut columns = vec![0u64; row as usize];
            (0..all)
                .filter(|place| thinning.takes(1, *place, all))
                .for_each(|place| columns[(place % row) as usize] += 1);
            let due = (all / stride) as f64 / row as f64;
            let off = columns.iter().map(|n| (*n as f64 - due).abs()).fold(0.0, f64::max);
            assert!(off < 5.0 * due.sqrt(), "rows of {row}: {off} off {due}");
        }
    }
}
