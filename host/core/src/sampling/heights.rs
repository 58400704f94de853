//! Heights of samples over their neighbours, for [`deconvolution`](super::deconvolution): of as many at once
//! as the processor's vector registers take, each by the same operations in the same order on any processor.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use glam::{DVec3, Vec3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::neighbour_graph::NeighbourGraph;
use super::normals::direction;
use super::ways::{NEIGHBOURS, Ways, mean, scatter};
use crate::double_lanes::{DoubleLanes, DoubleMask, Triple};
use crate::eigen_lanes::{dot, symmetric_eigen};

/// Neighbours whose mean distance is the distance of samples: as many as in a hexagonal packing.
pub(super) const RING: usize = 6;

/// Neighbours that are farther than this many times as much do not count.
const REACH: f64 = 2.0;

/// Least moment of the neighbours' weights, as a part of that where these surround a sample.
const LEAST_SURROUNDED: f64 = 0.5;

/// Largest thickness of a sample and its neighbours, as a part of their lesser width, for which they are a
/// surface.
const MOST_THICKNESS: f64 = 0.3;

/// Least thickness, likewise, from which on the neighbours may be of two sheets, and the part of the variance
/// of heights that parting these explains then: their means stay where they are.
const LEAST_THICKNESS: f64 = 1.0 / 64.0;
const TWO_SHEETS: f64 = 0.95;

/// Part of the variance below which neighbours need not be parted again: of heights that are spread evenly,
/// parting explains 3/4.
const AS_OF_ONE: f64 = 0.75;

/// Largest number of partings of neighbours, each across the sheets that the former one has found.
const PARTINGS: usize = 5;

/// Samples that are looked at by one job.
const TOGETHER: usize = 256;

/// Height of a sample over its neighbours.
#[derive(Clone, Copy, Default)]
pub(super) struct Height {
    /// The direction of least variance.
    pub across: Vec3,
    /// Height over the plane of the neighbours, along that; 0 where these do not surround the sample, or are
    /// no surface, or two of them.
    pub height: f64,
    /// The variance of that height, for one of 1 of each sample; nothing where there is none.
    pub variance: f64,
    /// Whether sample and neighbours are of two sheets, one above the other.
    pub is_of_two: bool,
}

/// The heights of all samples over their neighbours, of which each has [`RING`] or more, and [`NEIGHBOURS`]
/// at most.
pub(super) fn heights(positions: &[Vec3], graph: &NeighbourGraph) -> Vec<Height> {
    let mut heights = vec![Height::default(); positions.len()];
    heights.par_chunks_mut(TOGETHER).enumerate().for_each(|(job, heights)| {
        Arch::new().dispatch(Heights { positions, graph, first: job * TOGETHER, heights });
    });
    heights
}

/// Finds the heights of some samples that follow each other from the first.
struct Heights<'a> {
    positions: &'a [Vec3],
    graph: &'a NeighbourGraph,
    first: usize,
    heights: &'a mut [Height],
}

impl WithSimd for Heights<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { positions, graph, first, heights } = self;
        let mut ways = Ways::new(graph.k());
        for at in (0..heights.len()).step_by(S::F64_LANES) {
            let count = S::F64_LANES.min(heights.len() - at);
            for lane in 0..count {
                let sample = first + at + lane;
                ways.set(lane, positions, sample, graph.nearest_to(sample));
            }
            height(simd, &ways, &mut heights[at..at + count]);
        }
    }
}

/// The heights of the samples of a packet, from which these are the ways to their neighbours.
#[inline(always)]
fn height<S: Simd>(simd: S, ways: &Ways, heights: &mut [Height]) {
    let splat = |x| DoubleLanes::splat(simd, x);
    let mut around = [[splat(0.0); 3]; NEIGHBOURS];
    let around = ways.load(simd, &mut around);
    let (diagonal, off) = scatter(simd, around);
    let (variances, axes) = symmetric_eigen(simd, diagonal, off);
    let is_thin = variances[0].less(splat(MOST_THICKNESS * MOST_THICKNESS) * variances[1]);

    // Along the axes: x is across the surface.
    for i in 0..around.len() {
        let d = around[i];
        around[i] = [dot(axes[0], d), dot(axes[1], d), dot(axes[2], d)];
    }
    let is_thick = (splat(LEAST_THICKNESS * LEAST_THICKNESS) * variances[1]).less(variances[0]);
    let is_of_two = are_two_sheets(simd, around, variances, is_thin.and(is_thick));

    let [height, variance, moment] = over_plane(simd, around).map(DoubleLanes::store);
    let (is_thin, is_of_two) = (is_thin.store(), is_of_two.store());
    let across = [axes[0][0].store(), axes[0][1].store(), axes[0][2].store()];
    for (lane, to) in heights.iter_mut().enumerate() {
        let across = direction(DVec3::new(across[0][lane], across[1][lane], across[2][lane]));
        *to = Height { across, is_of_two: is_of_two[lane], ..Height::default() };
        let is_one = is_thin[lane] && !is_of_two[lane];
        if is_one && moment[lane] >= LEAST_SURROUNDED && height[lane].is_finite() {
            (to.height, to.variance) = (height[lane], variance[lane]);
        }
    }
}

/// Height over the plane of weighted least squares of the neighbours, to which `around` are the ways along
/// the axes of their scatter; its variance; and the moment of the neighbours' weights. The ways are in units
/// of the samples' distance afterwards.
#[inline(always)]
fn over_plane<S: Simd>(simd: S, around: &mut [Triple<S>]) -> [DoubleLanes<S>; 3] {
    let splat = |x| DoubleLanes::splat(simd, x);
    let (zero, one) = (splat(0.0), splat(1.0));
    let mut ring = zero;
    for i in 0..RING.min(around.len()) {
        ring += along(around[i]);
    }
    let scale = (splat(RING as f64) / ring).sqrt();
    let mut weights = [zero; NEIGHBOURS];
    // Weight of each neighbour's height in the height that the plane of weighted least squares has at the
    // sample: the first column of the inverse of the products of 1 and both coordinates.
    let [mut s, mut y, mut z, mut yy, mut yz, mut zz] = [zero; 6];
    for i in 0..around.len() {
        let d = [around[i][0] * scale, around[i][1] * scale, around[i][2] * scale];
        around[i] = d;
        let rest = (one - along(d) / splat(REACH * REACH)).max(zero);
        let w = rest * rest;
        weights[i] = w;
        let (wy, wz) = (w * d[1], w * d[2]);
        s += w;
        y += wy;
        z += wz;
        yy += wy * d[1];
        yz += wy * d[2];
        zz += wz * d[2];
    }
    let column = [yy * zz - yz * yz, z * yz - y * zz, y * yz - z * yy];
    let determinant = s * column[0] + y * column[1] + z * column[2];
    let plane = [column[0] / determinant, column[1] / determinant, column[2] / determinant];
    let (mut height, mut moment, mut squares) = (zero, zero, one);
    for i in 0..around.len() {
        let d = around[i];
        let part = weights[i] * (plane[0] + plane[1] * d[1] + plane[2] * d[2]);
        height = height - part * d[0];
        moment += part * along(d);
        squares += part * part;
    }
    [height / (moment * scale), squares / (moment * moment), moment]
}

/// The squared distance of a way along the surface.
#[inline(always)]
fn along<S: Simd>(d: Triple<S>) -> DoubleLanes<S> {
    d[1] * d[1] + d[2] * d[2]
}

/// Number of those among each sample and its neighbours that are higher than the middle, and the sum of the
/// ways to them.
#[inline(always)]
fn sum_above<S: Simd>(
    simd: S,
    around: &[Triple<S>],
    across: Triple<S>,
    middle: DoubleLanes<S>,
) -> (DoubleLanes<S>, Triple<S>) {
    let (zero, one) = (DoubleLanes::splat(simd, 0.0), DoubleLanes::splat(simd, 1.0));
    let mut upper = middle.less(zero).select(one, zero);
    let mut sum = [zero; 3];
    for i in 0..around.len() {
        let d = around[i];
        let is_upper = middle.less(dot(across, d));
        upper += is_upper.select(one, zero);
        for axis in 0..3 {
            sum[axis] += is_upper.select(d[axis], zero);
        }
    }
    (upper, sum)
}

/// Mask of the samples among those that are `asked` for that lie on two sheets, one above the other, with
/// their neighbours, to which `around` has the ways along the axes of their scatter. Heights are at first
/// along x, and then across both sheets as found so far: with all in one, their plane leans from one sheet to
/// the other.
#[inline(always)]
fn are_two_sheets<S: Simd>(
    simd: S,
    around: &[Triple<S>],
    scatter: Triple<S>,
    asked: DoubleMask<S>,
) -> DoubleMask<S> {
    let splat = |x| DoubleLanes::splat(simd, x);
    let (zero, one, count) = (splat(0.0), splat(1.0), splat(around.len() as f64 + 1.0));
    let (mut across, mut asked) = ([one, zero, zero], asked);
    let mean = mean(simd, around);
    let all = [mean[0] * count, mean[1] * count, mean[2] * count];
    let mut are_two = one.less(zero);
    for _ in 0..PARTINGS {
        if !asked.any() {
            break;
        }
        let (upper, sum) = sum_above(simd, around, across, dot(across, mean));
        let lower = count - upper;
        let weight = upper * lower / count;
        let mut apart = sum;
        for axis in 0..3 {
            apart[axis] = sum[axis] / upper - (all[axis] - sum[axis]) / lower;
        }
        let between = dot(across, apart);
        let mut spread = zero;
        for axis in 0..3 {
            spread += scatter[axis] * across[axis] * across[axis];
        }
        let part = weight * between * between / spread;
        asked = asked.and(one.less(upper)).and(one.less(lower)).and(splat(AS_OF_ONE).less(part));
        let found = asked.and(splat(TWO_SHEETS).less(part));
        are_two = are_two.or(found);
        asked = asked.and(part.less(splat(TWO_SHEETS)));
        // Scatter that is left when the sheets' distance is taken off.
        let (mut diagonal, mut off) = (scatter, [zero; 3]);
        for (at, [a, b]) in [[0, 1], [0, 2], [1, 2]].into_iter().enumerate() {
            diagonal[at] = scatter[at] - weight * apart[at] * apart[at];
            off[at] = zero - weight * apart[a] * apart[b];
        }
        across = symmetric_eigen(simd, diagonal, off).1[0];
    }
    are_two
}
