//! The order in which samples are drawn: every beginning of the order is well spread over the surface.
//!
//! Samples are put along a curve that fills space (Morton's order), and visited there by van der Corput's
//! sequence, which halves the gaps again and again; its digits are scrambled (A. B. Owen, 1995; by the hash
//! of S. Laine and T. Karras, *Stratified Sampling for Stochastic Transparency*, EGSR 2011), so that no
//! regular pattern of the samples meets one of the sequence.

use glam::{UVec3, Vec3};
use rayon::prelude::*;

/// An order of drawing.
pub(crate) struct Order {
    /// The samples' indices.
    pub samples: Vec<u32>,
    /// Number of first samples of each level: one sample for each part of the curve, twice as many parts
    /// from level to level. Numbers in between would give two samples to some parts.
    levels: Vec<usize>,
}

impl Order {
    pub fn new(positions: &[Vec3]) -> Self {
        let curve = along_curve(positions);
        let places = positions.len().next_power_of_two();
        let bits = places.trailing_zeros();
        let mut order = Self { samples: Vec::with_capacity(curve.len()), levels: Vec::new() };
        for i in 0..places as u32 {
            order.samples.extend(curve.get(scrambled(i, bits) as usize));
            if (i + 1).is_power_of_two() {
                order.levels.push(order.samples.len());
            }
        }
        order
    }

    /// Number of samples of the largest level with at most `most`, or of the smallest level.
    pub fn part(&self, most: usize) -> usize {
        let within = self.levels.partition_point(|level| *level <= most.max(1));
        self.levels[within.saturating_sub(1)]
    }

    /// Number of samples of the level with about one of 2^`times` of all.
    pub fn halved(&self, times: usize) -> usize {
        self.levels[(self.levels.len() - 1).saturating_sub(times)]
    }
}

/// The samples' indices in Morton's order.
fn along_curve(positions: &[Vec3]) -> Vec<u32> {
    let finite = || positions.iter().filter(|p| p.is_finite());
    let low = finite().fold(Vec3::INFINITY, |low, p| low.min(*p));
    let high = finite().fold(Vec3::NEG_INFINITY, |high, p| high.max(*p));
    const CELLS: f32 = 1023.0;
    let scale = CELLS / (high - low).max_element().max(f32::MIN_POSITIVE);
    let mut keyed: Vec<(u32, u32)> = positions
        .par_iter()
        .zip(0..positions.len() as u32)
        .map(|(p, i)| {
            // Casts saturate, and take what is not a number as 0.
            let cell = ((*p - low) * scale).clamp(Vec3::ZERO, Vec3::splat(CELLS)).as_uvec3();
            (interleaved(cell), i)
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// The lowest 10 bits of three numbers, by turns.
fn interleaved(cell: UVec3) -> u32 {
    let apart = |mut x: u32| {
        x = (x | x << 16) & 0x0300_00ff;
        x = (x | x << 8) & 0x0300_f00f;
        x = (x | x << 4) & 0x030c_30c3;
        (x | x << 2) & 0x0924_9249
    };
    apart(cell.x) | apart(cell.y) << 1 | apart(cell.z) << 2
}

/// Van der Corput's sequence over so many bits, scrambled: a permutation of its places.
fn scrambled(i: u32, bits: u32) -> u32 {
    if bits == 0 {
        return 0;
    }
    // A hash whose low bits do not depend on the higher ones; turned round, the low ones decide the coarsest
    // halves.
    let mut x = i;
    x = x.wrapping_add(0x9e37_79b9);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^= x.wrapping_mul(0x8d22_f6e6);
    x.reverse_bits() >> (32 - bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_has_its_turn() {
        for n in [0, 1, 2, 3, 100, 1000, 4097] {
            let z = |i| if i == 5 { f32::NAN } else { 0.0 };
            let at = |i: u32| Vec3::new((i % 37) as f32, (i / 37) as f32, z(i));
            let order = Order::new(&(0..n).map(at).collect::<Vec<_>>());
            assert_eq!(order.part(usize::MAX), n as usize);
            let part = order.part(n as usize / 2);
            assert!(n < 2 || (n as usize / 5..=n as usize / 2).contains(&part), "{part} of {n}");
            let mut samples = order.samples;
            samples.sort_unstable();
            assert_eq!(samples, (0..n).collect::<Vec<u32>>());
        }
    }

    /// In every beginning of the order, the longest stretch of the curve without a sample is hardly longer
    /// than the part that is due to each sample.
    #[test]
    fn beginnings_leave_no_gaps() {
        for bits in [1, 8, 12] {
            let places = 1u32 << bits;
            for taken in (0..=bits).map(|b| 1usize << b) {
                let mut seen: Vec<u32> = (0..taken as u32).map(|i| scrambled(i, bits)).collect();
                seen.sort_unstable();
                let due = places / taken as u32;
                assert!(seen.iter().zip(0..).all(|(place, k)| place / due == k), "{taken} of {places}");
            }
        }
    }
}
