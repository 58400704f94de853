//! Refinements (paper §6), of steps and of commands: more samples where shapes select the model.

use crate::step::Refine;
use glam::DVec3;
use simod_core::reconstruction::DeformationField;
use simod_core::refinement::{Refined, Refining, SpaceSelection, refine};
use simod_core::sampled_model::SampledModel;
use simod_model::{Model, Progress, Result};
use std::path::Path;

/// Resources that a refinement may take.
#[derive(Clone, Copy)]
pub struct Room<'a> {
    /// Bytes of memory to stay below; as for sampling where not given.
    pub memory_limit: Option<u64>,
    /// Folder in which temporary files without a name are made.
    pub folder: &'a Path,
}

/// The pose of the model in which the shapes are meant.
#[derive(Clone, Copy)]
pub enum ShapePose<'a> {
    /// The shape as the deformation so far, if there is one, has left it.
    Deformed(Option<&'a DeformationField<'a>>),
    /// The shape at rest, whatever the deformation so far.
    Rest(Option<&'a DeformationField<'a>>),
}

impl Refine {
    /// Refines a sampled model, which holds its cells, where the shapes select it; without shapes,
    /// everywhere.
    ///
    /// # Errors
    /// As of [`refine`].
    pub fn refine(
        &self,
        sampled: &SampledModel,
        model: &dyn Model,
        pose: ShapePose<'_>,
        room: Room<'_>,
        progress: &dyn Progress,
    ) -> Result<Refined> {
        let everywhere = self.shapes.shapes.is_empty();
        let distance = |p: DVec3| if everywhere { -1.0 } else { self.shapes.signed_distance(p) };
        let (so_far, at_rest) = match pose {
            ShapePose::Deformed(so_far) => (so_far, false),
            ShapePose::Rest(so_far) => (so_far, true),
        };
        let selection = SpaceSelection { distance: &distance, so_far, at_rest };
        let Room { memory_limit, folder } = room;
        let how = Refining { finer: self.finer, memory_limit, shapes: self.shapes.tables() };
        refine(sampled, model, selection, &how, folder, progress)
    }
}
