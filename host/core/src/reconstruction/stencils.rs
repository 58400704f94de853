//! Stencils: the samples that the fits at a sample are of. These are of its own sheet, and where parts of the
//! model touch, of other parts that go one way with it.
//!
//! Faces tell that two parts are not connected, but not that they move apart; mostly they do not. A small
//! part has few samples of its own, and beside a contact they lie on one side. So samples of other sheets are
//! borrowed where the deformation is smooth across: on a smooth map the displacements at both ends of d
//! differ by ½ (∇uᵢ + ∇uⱼ) d up to third derivatives (the trapezoidal rule), and the difference that the
//! gradients leave open is of the size of the strain and of the gradients' difference from each other. Where
//! parts move apart, whatever little way, as rigid bodies, both are zero, and no sample is borrowed.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::expansion::ROUNDING;
use super::sheets::{SHEET_NEIGHBOURS, Sheets, nearest_of};
use crate::sampling::SampleSet;

/// Largest deviation of a displacement from the one that the gradients at both ends foretell, as a part of
/// the distance times the strain, or times the difference of the gradients.
const OFF: f32 = 0.2;

/// Number of strangers of which more than one has to go one way with a sample, or none is borrowed: some go
/// one way by chance, as beside a hinge.
const ONE_OF: usize = 2;

/// Neighbours of a sample that its word is compared with: its ring.
pub const RING: usize = 8;

/// The samples that fits are of.
pub struct Stencils<'a> {
    sheets: &'a Sheets,
    /// The samples that borrow, ascending, each with its neighbours, nearest first: at most
    /// [`SHEET_NEIGHBOURS`].
    mixed: Vec<(u32, Vec<u32>)>,
    /// Whether each sample borrows; empty where none does.
    borrows: Vec<bool>,
}

impl<'a> Stencils<'a> {
    /// Stencils of each sample's own sheet alone.
    pub fn own(sheets: &'a Sheets) -> Self {
        Self { sheets, mixed: Vec::new(), borrows: Vec::new() }
    }

    /// Stencils with the strangers that go one way with each sample, by the `gradients` that the samples' own
    /// sheets tell.
    ///
    /// Memory: at most 170 bytes for each sample near which parts touch, and one for each sample if any do.
    pub fn borrowing(
        samples: &SampleSet,
        sheets: &'a Sheets,
        deformed: &[Vec3],
        gradient: impl Fn(usize) -> Mat3 + Sync,
    ) -> Self {
        let goes_along = |i: usize, j: usize| {
            let [at_i, at_j] = [i, j].map(|k| samples.positions[k]);
            let (f, g) = (gradient(i), gradient(j));
            let apart = (deformed[j] - at_j) - (deformed[i] - at_i);
            let foretold = (0.5 * (f + g) - Mat3::IDENTITY) * (at_j - at_i);
            let open = 0.5 * (strain(f) + strain(g)) + norm(f - g);
            apart.distance(foretold) <= OFF * open * at_i.distance(at_j) + ROUNDING as f32
        };
        let mixed = |i: usize| -> Option<(u32, Vec<u32>)> {
            let strangers = sheets.strangers(i);
            let along = strangers.iter().copied().filter(|j| goes_along(i, *j as usize));
            let mut all: Vec<u32> = along.collect();
            if ONE_OF * all.len() <= strangers.len() {
                return None;
            }
            all.extend(sheets.of_sample(i));
            let distance = |j: u32| samples.positions[j as usize].distance_squared(samples.positions[i]);
            all.sort_unstable_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(a.cmp(b)));
            all.truncate(SHEET_NEIGHBOURS);
            Some((i as u32, all))
        };
        let mixed: Vec<(u32, Vec<u32>)> = (0..samples.len()).into_par_iter().filter_map(mixed).collect();
        let mut borrows = vec![false; if mixed.is_empty() { 0 } else { samples.len() }];
        mixed.iter().for_each(|(i, _)| borrows[*i as usize] = true);
        Self { sheets, mixed, borrows }
    }

    /// Bytes of the lists of so many samples, about.
    pub fn bytes_of(&self, samples: usize) -> usize {
        self.sheets.bytes_of(samples)
    }

    /// The samples that borrow, ascending.
    pub fn borrowers(&self) -> Vec<u32> {
        self.mixed.iter().map(|(i, _)| *i).collect()
    }

    /// The samples that may be in fits at sample `i`, nearest first, without itself.
    #[inline]
    pub fn of_sample(&self, i: usize) -> &[u32] {
        if !self.borrows.get(i).is_some_and(|borrows| *borrows) {
            return self.sheets.of_sample(i);
        }
        let at = self.mixed.partition_point(|(borrower, _)| (*borrower as usize) < i);
        &self.mixed[at].1
    }

    /// Nearest samples of a stencil: the sample's ring.
    pub fn ring(&self, i: usize) -> &[u32] {
        let near = self.of_sample(i);
        &near[..near.len().min(RING)]
    }

    /// At most `count` samples of a stencil, and the radius of a kernel over these: see [`Sheets::around`].
    pub fn around(&self, positions: &[Vec3], i: usize, count: usize) -> (&[u32], f32) {
        nearest_of(self.of_sample(i), positions, i, count)
    }
}

/// The size of Green's strain of a gradient.
fn strain(f: Mat3) -> f32 {
    0.5 * norm(f.transpose() * f - Mat3::IDENTITY)
}

fn norm(f: Mat3) -> f32 {
    f.to_cols_array().iter().map(|e| e * e).sum::<f32>().sqrt()
}
