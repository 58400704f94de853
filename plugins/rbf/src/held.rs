//! The residuals of the fit in the regions, taken away: samples of regions have exactly their regions'
//! motions.
//!
//! The residuals, of which none is above the tolerance, are added to the solutions as another map of space:
//! at a sample of a region its own residual, around it a mean of the nearest ones, which fades with the
//! distance from the regions. The weights are those of R. Franke and G. Nielson, *Smooth interpolation of
//! large sets of scattered data*, IJNME 1980: they interpolate, and vanish at the farthest of the samples
//! that count, so that the map is continuous.

use crate::TOGETHER;
use crate::constraints::RegionSamples;
use crate::fit::SplineFit;
use crate::kernel::{BLOCK, Point};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use simod_plugin_api::{Host, PluginError, PluginResult};
use std::num::NonZero;

/// Number of samples of regions that count at a point.
const NEAREST: NonZero<usize> = NonZero::new(12).expect("more than none");

/// The residuals of all samples in regions.
pub struct RegionResiduals {
    tree: ImmutableKdTree<f64, 3>,
    /// Residuals sample by sample, of all right-hand sides.
    residuals: Vec<f32>,
    functions: usize,
    /// Distance from the regions from which on no residual is added, in the unit box.
    reach: f64,
}

impl RegionResiduals {
    /// Residuals of the samples in the regions; the tables' values there are the targets.
    pub fn new(
        constraints: &RegionSamples,
        fit: &SplineFit,
        reach: f64,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let functions = constraints.functions();
        let points = &constraints.points[..constraints.samples.len()];
        let mut residuals = vec![0.0; points.len() * functions];
        let entries = BLOCK * functions;
        host.parallel_blocks(&mut residuals, TOGETHER * entries, |first, residuals| {
            for (block, residuals) in residuals.chunks_mut(entries).enumerate() {
                let first = first / functions + block * BLOCK;
                let points = &points[first..first + residuals.len() / functions];
                let sums = fit.functions.sums(points, fit.weights.as_ref());
                for (i, residuals) in residuals.chunks_exact_mut(functions).enumerate() {
                    for (f, residual) in residuals.iter_mut().enumerate() {
                        *residual = (constraints.target(first + i, f) - sums[f][i]) as f32;
                    }
                }
            }
        })?;
        let tree = ImmutableKdTree::new_from_slice(points)
            .map_err(|_| PluginError::internal("the samples in the regions cannot be searched"))?;
        Ok(Self { tree, residuals, functions, reach })
    }

    /// Adds the residuals around a point of the unit box to the solutions' values there.
    pub fn add(&self, p: &Point, values: &mut [f64]) {
        let near = self
            .tree
            .query(p)
            .nearest_n::<SquaredEuclidean<f64>>(NEAREST)
            .within(self.reach * self.reach)
            .execute();
        let Some(nearest) = near.first().map(|n| n.distance.sqrt()) else { return };
        let is_full = near.len() == NEAREST.get();
        let rim = near.last().filter(|_| is_full).map_or(self.reach, |n| n.distance.sqrt());
        // Weights are relative to the nearest sample's, so that nothing overflows.
        let weight = |square: f64| match square.sqrt() {
            0.0 => 1.0,
            distance => ((1.0 - distance / rim).max(0.0) * nearest / distance).powi(2),
        };
        let sum: f64 = near.iter().map(|n| weight(n.distance)).sum();
        let t = (nearest / self.reach).min(1.0);
        let fade = (1.0 - t * t) * (1.0 - t * t);
        for n in &near {
            // Samples that are all equally far have equal weights.
            let share = if sum > 0.0 { weight(n.distance) / sum } else { (near.len() as f64).recip() };
            let residuals = &self.residuals[n.item as usize * self.functions..][..self.functions];
            values.iter_mut().zip(residuals).for_each(|(v, r)| *v += fade * share * f64::from(*r));
        }
    }
}
