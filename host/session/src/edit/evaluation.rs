//! The steps of an edit, done on the samples: each as far as it, or what comes before it, has changed.

use super::document::{Entry, StepId};
use crate::deformer::Message;
use crate::plugins::PluginRegistry;
use crate::session_file::Step;
use crate::stack::{self, Kept, Layer, Rest, RestShape};
use glam::Vec3;
use simod_core::{Error, ErrorKind, Progress, Result};
use simod_plugin_api::{Effort, HandleDesc};
use std::collections::HashMap;
use std::sync::Arc;

/// How a step fared.
#[derive(Debug)]
pub enum Status {
    /// It is switched off.
    Off,
    /// It was done; what the plugin had to say.
    Done(Vec<Message>),
    /// It could not be done. What the steps before it made still holds.
    Failed(Error),
    /// One before it could not be done.
    Waiting,
}

/// What became of the samples.
#[derive(Debug)]
pub struct Evaluated {
    /// Local positions after the last step that was done, one for each sample.
    pub positions: Arc<[Vec3]>,
    /// How each step fared, in their order.
    pub statuses: Vec<(StepId, Status)>,
}

impl Evaluated {
    /// The first step that could not be done, if any.
    pub fn failure(&self) -> Option<(StepId, &Error)> {
        self.statuses.iter().find_map(|(id, status)| match status {
            Status::Failed(error) => Some((*id, error)),
            _ => None,
        })
    }
}

/// Does steps again and again, and keeps of each what the next time may need: what the plugin prepared, and the positions.
///
/// Memory: what the plugins hold, and 12 bytes a sample and step; what is of steps that are gone, or switched off, is let go.
#[derive(Debug, Default)]
pub struct Evaluation {
    layers: HashMap<StepId, Known>,
}

/// What is known of a step.
#[derive(Debug)]
struct Known {
    step: Arc<Step>,
    layer: Layer,
    kept: Kept,
}

impl Evaluation {
    /// Does the steps on these samples. `key` stands for them: another one for others. With [`Effort::DRAFT`], plugins that
    /// know a quicker way take it.
    ///
    /// # Errors
    /// The user cancelled, or the shape cannot be deformed at all. What fails in a step is in its status.
    pub fn update(
        &mut self,
        steps: &[Entry],
        (shape, key): (&RestShape<'_>, u64),
        registry: &PluginRegistry,
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<Evaluated> {
        let mut rest = Arc::new(shape.rest(key)?);
        let mut statuses = Vec::with_capacity(steps.len());
        let mut failed = false;
        self.layers.retain(|id, _| steps.iter().any(|e| e.id == *id && e.step.enabled));
        for Entry { id, step } in steps {
            let status = if !step.enabled {
                Status::Off
            } else if failed {
                Status::Waiting
            } else {
                match self.step(*id, step, &rest, shape, registry, effort, progress) {
                    Ok((next, messages)) => {
                        rest = next;
                        Status::Done(messages)
                    }
                    Err(e) if e.kind() == ErrorKind::Cancelled => return Err(e),
                    Err(e) => {
                        failed = true;
                        Status::Failed(stack::at(&step.place, e))
                    }
                }
            };
            statuses.push((*id, status));
        }
        Ok(Evaluated { positions: rest.positions.clone(), statuses })
    }

    /// The handles that a step's plugin placed the last time, local coordinates; none where it was not done yet.
    pub fn handles(&self, id: StepId) -> &[HandleDesc] {
        self.layers.get(&id).map_or(&[], |known| known.kept.handles())
    }

    /// Does one step; gives the next one's rest shape.
    #[expect(clippy::too_many_arguments, reason = "what a step depends on")]
    fn step(
        &mut self,
        id: StepId,
        step: &Arc<Step>,
        rest: &Arc<Rest>,
        shape: &RestShape<'_>,
        registry: &PluginRegistry,
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<(Arc<Rest>, Vec<Message>)> {
        // A plugin that was loaded anew is another one.
        let is_current = |known: &Known| {
            Arc::ptr_eq(&known.step, step)
                && registry.get(&step.deform).is_ok_and(|plugin| Arc::ptr_eq(plugin, &known.layer.plugin))
        };
        let known = match self.layers.remove(&id) {
            Some(known) if is_current(&known) => known,
            before => match Layer::build(step, registry, before.as_ref().map(|known| &known.layer)) {
                Ok(layer) => {
                    let kept = before.map(|known| known.kept).unwrap_or_default();
                    Known { layer, step: step.clone(), kept }
                }
                Err(e) => {
                    // What is wrong may be corrected.
                    self.layers.extend(before.map(|known| (id, known)));
                    return Err(e);
                }
            },
        };
        let Known { layer, kept, .. } = self.layers.entry(id).or_insert(known);
        let (next, done) = layer.update(rest, shape, kept, effort, progress)?;
        Ok((next, done.messages.clone()))
    }
}
