//! Ways from samples to their neighbours, of as many samples at once as the processor's vector registers
//! take, and the scatter of these ways.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use glam::Vec3;
use pulp::Simd;

use crate::double_lanes::{DoubleLanes, MOST_LANES, Triple};

/// Neighbours that are looked at: they span the tangent plane.
pub const NEIGHBOURS: usize = 12;

/// The ways from each sample of a packet to its neighbours, of which all have as many.
pub struct Ways {
    numbers: [[[f64; MOST_LANES]; 3]; NEIGHBOURS],
    count: usize,
}

impl Ways {
    /// Ways without numbers yet, to `count` neighbours of each sample, [`NEIGHBOURS`] at most.
    pub fn new(count: usize) -> Self {
        Self { numbers: [[[0.0; MOST_LANES]; 3]; NEIGHBOURS], count: count.min(NEIGHBOURS) }
    }

    /// Takes the ways of one sample of the packet.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, positions: &[Vec3], sample: usize, neighbours: &[u32]) {
        for (way, j) in self.numbers.iter_mut().zip(&neighbours[..self.count]) {
            let d = positions[*j as usize] - positions[sample];
            for axis in 0..3 {
                way[axis][lane] = f64::from(d[axis]);
            }
        }
    }

    /// All ways as vectors, one for each neighbour.
    #[inline(always)]
    pub fn load<'a, S: Simd>(&self, simd: S, room: &'a mut [Triple<S>; NEIGHBOURS]) -> &'a mut [Triple<S>] {
        for i in 0..self.count {
            let [x, y, z] = &self.numbers[i];
            room[i] = [DoubleLanes::load(simd, x), DoubleLanes::load(simd, y), DoubleLanes::load(simd, z)];
        }
        &mut room[..self.count]
    }
}

/// The scatter of each sample and its neighbours about their mean, by the ways from it to them: xx, yy, zz,
/// and xy, xz, yz.
#[inline(always)]
pub fn scatter<S: Simd>(simd: S, around: &[Triple<S>]) -> (Triple<S>, Triple<S>) {
    let zero = DoubleLanes::splat(simd, 0.0);
    let mean = mean(simd, around);
    let mut sums = ([zero; 3], [zero; 3]);
    add_products(&mut sums, mean);
    for i in 0..around.len() {
        let d = around[i];
        add_products(&mut sums, [d[0] - mean[0], d[1] - mean[1], d[2] - mean[2]]);
    }
    sums
}

/// Adds the products of a vector's coordinates.
#[inline(always)]
fn add_products<S: Simd>((diagonal, off): &mut (Triple<S>, Triple<S>), d: Triple<S>) {
    for (at, [a, b]) in [[0, 1], [0, 2], [1, 2]].into_iter().enumerate() {
        diagonal[at] += d[at] * d[at];
        off[at] += d[a] * d[b];
    }
}

/// The mean of each sample and its neighbours, from the sample.
#[inline(always)]
pub fn mean<S: Simd>(simd: S, around: &[Triple<S>]) -> Triple<S> {
    let mut sum = [DoubleLanes::splat(simd, 0.0); 3];
    for i in 0..around.len() {
        for axis in 0..3 {
            sum[axis] += around[i][axis];
        }
    }
    let count = DoubleLanes::splat(simd, around.len() as f64 + 1.0);
    [sum[0] / count, sum[1] / count, sum[2] / count]
}
