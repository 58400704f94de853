//! The deformation: P_S goes through the steps to P_S*.

use crate::deformer::Message;
use crate::edit::{Document, Evaluated, Evaluation, Refinements, messages};
use crate::plugins::PluginRegistry;
use crate::stack::PreparedStack;
use crate::step::Step;
use glam::Vec3;
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::deformed_normals;
use simod_core::sampled_model::SampledModel;
use simod_model::{Progress, Result};
use simod_plugin_api::Effort;
use std::sync::Arc;

/// P_S*: the samples of a model after the steps of a session.
pub struct DeformedSamples {
    /// The model with its samples at rest, with those that steps appended.
    pub sampled: Arc<SampledModel>,
    /// Positions, one per sample, rounded as a file of samples holds them.
    pub positions: DeformedPositions,
    /// Unit normals, derived from the positions.
    pub normals: Vec<Vec3>,
    /// The exact map, where all plugins know it.
    pub stack: PreparedStack,
    /// Messages of the plugins.
    pub messages: Vec<Message>,
}

/// Does steps on a sampled model, which [holds its cells](SampledModel::hold_cells) if any of them refines.
///
/// # Errors
/// A step cannot be done, or the user cancelled.
pub fn deform(
    sampled: impl Into<Arc<SampledModel>>,
    steps: &[Step],
    plugins: &PluginRegistry,
    how: Refinements,
    progress: &dyn Progress,
) -> Result<DeformedSamples> {
    let document = Document::new(steps.iter().cloned());
    let mut evaluation = Evaluation::new(sampled.into(), how);
    let mut done = evaluation.update(document.steps(), plugins, Effort::FULL, progress)?;
    let messages = messages(std::mem::take(&mut done.statuses))?;
    let positions = done.rounded(progress)?;
    let Evaluated { sampled, stack, .. } = done;
    let normals = deformed_normals(&sampled.samples, &positions.local);
    Ok(DeformedSamples { sampled, positions, normals, stack, messages })
}
