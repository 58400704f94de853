//! How far the reconstruction is probably off around each sample, without knowing the exact map.
//!
//! Halfway between two neighbours the expansions about both have a say. Each takes what it leaves out, the third order, for
//! nothing; so the distance between what they say is of the size of what both leave out there. Where the deformation has
//! details that the samples do not tell, as at a step, they differ by those.

use glam::Vec3;
use rayon::prelude::*;

use super::DeformationField;
use super::local_frames::ROUNDING;

/// Neighbours of a sample that its word is compared with: its ring.
const RING: usize = 8;

/// Differences below so many times the rounding of positions tell nothing.
const TELLING: f64 = 4.0;

impl DeformationField<'_> {
    /// The transfer error to be expected around each sample, local units: the largest difference between its expansion
    /// and those of its neighbours, halfway. Nothing for what rounding explains, as of a rigid motion.
    ///
    /// It is an estimate of the size, not a bound: `docs/refinement.md` says how it compares with the error.
    pub fn expected_error(&self) -> Vec<f32> {
        let positions = &self.around.samples.positions;
        let says = |i: usize, p: Vec3| self.expansions[i].at(p - positions[i]).0;
        let off = |i: usize, j: usize| {
            let halfway = 0.5 * (positions[i] + positions[j]);
            says(i, halfway).distance(says(j, halfway))
        };
        let largest = |i: usize| {
            let near = self.around.sheets.of_sample(i).iter().take(RING);
            let largest = near.map(|j| off(i, *j as usize)).fold(0.0, f32::max);
            if f64::from(largest) < TELLING * ROUNDING { 0.0 } else { largest }
        };
        (0..positions.len()).into_par_iter().map(largest).collect()
    }
}
