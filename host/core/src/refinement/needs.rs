//! Needs of a deformation: more samples around those where the reconstruction is expected to be off by more
//! than is allowed.
//!
//! The error of the expansions is taken to fall with a power of the size of clusters, which tells how much
//! smaller the clusters of each sample have to be. If there are more new samples than allowed, the error that
//! is allowed rises until there are not: the worst places come first.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::Vec3;

use super::selection::{GRADING, LeafEstimate};
use crate::sampled_model::SampledModel;
use crate::sampling::SampleSet;
use crate::sampling::cluster::REACH_WEIGHT;
use crate::sampling::kept_cells::KeptCells;
use crate::touching::Contacts;

/// Power of the clusters' size with which the error falls, where the deformation is smooth: that of the terms
/// which expansions of second order leave out. Beside a step it falls more slowly.
const ORDER: f32 = 3.0;

/// Halvings of the logarithm of the error that is allowed.
const HALVINGS: usize = 16;

/// Neighbours whose wishes are looked at for a place near a sample.
const RING: usize = 8;

/// Largest rise of the bound of a cluster's error per unit of distance.
const RISE: f32 = (REACH_WEIGHT * GRADING) as f32;

/// The error that clusters may have around each sample.
pub(super) struct Needs<'a> {
    samples: &'a SampleSet,
    /// Infinite where nothing is needed; local units.
    wanted: Vec<f32>,
    /// The least error that is wanted anywhere.
    pub least: f32,
    /// Transfer error that these cluster errors allow, at least that which was asked for; local units.
    pub allowed: f32,
    /// Number of samples around which more is expected.
    pub needy: usize,
}

impl<'a> Needs<'a> {
    /// The needs of the samples that are selected and around which more than `allowed` is expected, for about
    /// `budget` new ones, as the [errors](SampledModel::cluster_errors) of their clusters are; `None` if
    /// there are none that could get more.
    pub fn new(
        sampled: &'a SampledModel,
        errors: &[f32],
        expected: &[f32],
        allowed: f32,
        budget: usize,
    ) -> Option<Self> {
        let at = |allowed: f32| Self::allowing(&sampled.samples, errors, expected, allowed);
        let most = expected.iter().copied().fold(0.0, f32::max);
        let (needs, count) = at(allowed);
        if needs.needy == 0 || most <= allowed {
            return None;
        }
        if count <= budget as f64 {
            return Some(needs);
        }
        let (mut low, mut high) = (allowed.ln(), most.ln());
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if at(middle.exp()).1 > budget as f64 { low = middle } else { high = middle }
        }
        let (needs, _) = at(high.exp());
        Some(if needs.needy > 0 { needs } else { at(low.exp()).0 })
    }

    /// Needs by which the expected error is at most `allowed` everywhere, and about the number of new samples
    /// for them.
    fn allowing(samples: &'a SampleSet, errors: &[f32], expected: &[f32], allowed: f32) -> (Self, f64) {
        let (mut wanted, mut open) = (vec![f32::INFINITY; errors.len()], OpenSamples::new());
        let needy = want(samples, (errors, expected), allowed, &mut wanted, &mut open);
        let least = wanted.iter().copied().fold(f32::INFINITY, f32::min);
        grade(samples, errors, &mut wanted, open);
        // Halving the size of clusters makes four of one.
        let more = |(error, wanted): (&f32, &f32)| f64::from((error / wanted).powi(2) - 1.0).max(0.0);
        let count = errors.iter().zip(&wanted).map(more).sum();
        (Self { samples, wanted, least, allowed, needy }, count)
    }

    /// Amount by which the bound of a cluster inside this ball is above the least one; local units.
    pub fn slack(&self, center: Vec3, radius: f32) -> f32 {
        self.around(self.samples.nearest(center) as usize, center, radius)
    }

    fn around(&self, i: usize, center: Vec3, radius: f32) -> f32 {
        let (positions, spacing) = (&self.samples.positions, self.samples.spacing());
        let near = self.samples.neighbours().nearest_to(i).iter().take(RING).map(|j| *j as usize);
        let reaches = |j: usize| (center.distance(positions[j]) - spacing[j] - radius).max(0.0);
        let bound = near.map(|j| self.wanted[j] + RISE * reaches(j)).fold(self.wanted[i], f32::min);
        bound - self.least
    }

    /// Estimates of each leaf of each cell, from the samples alone, without the model.
    pub fn leaves(&self, kept: &KeptCells) -> Vec<Vec<LeafEstimate>> {
        let of_cell = |tree: &crate::sampling::kept_cells::CutTree| {
            let errors = tree.children.iter().zip(&tree.errors).filter(|(children, _)| **children == 0);
            let leaf = |((_, error), sample): ((&u8, &f32), &u32)| {
                let i = *sample as usize;
                let reach = 2.0 * error / REACH_WEIGHT as f32;
                let slack = self.around(i, self.samples.positions[i], reach);
                LeafEstimate { error: *error, slack, inside: self.wanted[i].is_finite() }
            };
            errors.zip(&tree.samples).map(leaf).collect()
        };
        kept.cells.iter().map(|cell| of_cell(&cell.tree)).collect()
    }
}

/// Samples whose wanted error was lowered, the lowest first: non-negative numbers are in the order of their
/// bits.
type OpenSamples = BinaryHeap<Reverse<(u32, u32)>>;

/// Lowers the `wanted` error of the clusters around each sample that is expected to be off by more than
/// `allowed`; `open` gets these clusters. Returns the number of such samples around which a cluster can be
/// split.
fn want(
    samples: &SampleSet,
    (errors, expected): (&[f32], &[f32]),
    allowed: f32,
    wanted: &mut [f32],
    open: &mut OpenSamples,
) -> usize {
    let graph = samples.neighbours();
    let mut needy = 0;
    for (i, expected) in expected.iter().enumerate().filter(|(_, expected)| **expected > allowed) {
        let smaller = (allowed / expected).powf(1.0 / ORDER);
        // A cluster that is a single place cannot be split: the error of its expansion is due to the clusters
        // around.
        let is_several = |k: &usize| errors[*k] > 0.0;
        let near = graph.nearest_to(i).iter().map(|j| *j as usize);
        let mut helping: Vec<usize> =
            if is_several(&i) { vec![i] } else { near.clone().take(RING).filter(is_several).collect() };
        if helping.is_empty() {
            helping.extend(near.filter(is_several));
        }
        needy += usize::from(!helping.is_empty());
        for k in helping {
            let bound = smaller * errors[k];
            if bound < wanted[k] {
                wanted[k] = bound;
                open.push(Reverse((bound.to_bits(), k as u32)));
            }
        }
    }
    // A tree has one of the samples of several sheets for all.
    for [sample, of] in samples.contacts().map_or(&[][..], Contacts::parted) {
        let bound = wanted[*sample as usize];
        if bound < wanted[*of as usize] {
            wanted[*of as usize] = bound;
            open.push(Reverse((bound.to_bits(), *of)));
        }
    }
    needy
}

/// Limits the wanted errors of the samples around those that are `open`: errors rise with the distance from
/// these by no more than [`RISE`].
fn grade(samples: &SampleSet, errors: &[f32], wanted: &mut [f32], mut open: OpenSamples) {
    let graph = samples.neighbours();
    while let Some(Reverse((bits, i))) = open.pop() {
        let from = f32::from_bits(bits);
        if from > wanted[i as usize] {
            continue;
        }
        for j in graph.nearest_to(i as usize).iter().take(RING) {
            let (i, j) = (i as usize, *j as usize);
            let bound = from + RISE * samples.positions[i].distance(samples.positions[j]);
            // Farther samples' errors are no larger than this bound, so it changes nothing there.
            if bound < wanted[j].min(errors[j]) {
                wanted[j] = bound;
                open.push(Reverse((bound.to_bits(), j as u32)));
            }
        }
    }
}
