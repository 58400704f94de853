//! Sizes that clusters may have, place by place: small inside a selection, or as a deformation needs them.

use super::needs::Needs;
use super::selection::{LeafEstimate, Selected};
use crate::sampled_model::SampledModel;
use crate::sampling::kept_cells::KeptCells;
use glam::Vec3;

/// Sizes that clusters may have, place by place.
pub(super) enum Sizing<'a> {
    /// Small inside a selection, and larger away from it.
    Selected(Selected<'a>),
    /// Sizes that a deformation needs.
    Needed(Needs<'a>),
}

impl Sizing<'_> {
    /// Amount by which the bound of a cluster inside this ball is above the least one; local units.
    pub fn slack(&self, center: Vec3, radius: f32) -> f32 {
        match self {
            Self::Selected(selected) => selected.slack(center, radius),
            Self::Needed(needs) => needs.slack(center, radius),
        }
    }

    /// Estimates of each leaf of each cell, without the model: a bound for the slack, and whether a leaf may
    /// reach to where the bound is the least.
    pub fn leaves(&self, sampled: &SampledModel, kept: &KeptCells) -> Vec<Vec<LeafEstimate>> {
        match self {
            Self::Selected(selected) => selected.leaves(sampled, kept),
            Self::Needed(needs) => needs.leaves(kept),
        }
    }
}
