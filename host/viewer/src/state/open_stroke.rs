//! A stroke that is being drawn.

use simod_session::edit::{Entry, StepId};
use simod_session::step::{Action, Stroke};
use std::sync::Arc;

/// A stroke that is being drawn.
pub(super) struct OpenStroke {
    pub step: StepId,
    pub stroke: Stroke,
}

impl OpenStroke {
    /// The steps with the stroke as far as it is drawn.
    pub fn preview(&self, steps: &Arc<[Entry]>) -> Option<Arc<[Entry]>> {
        if self.stroke.defect().is_some() {
            return None;
        }
        let mut steps = steps.to_vec();
        let entry = steps.iter_mut().find(|entry| entry.id == self.step)?;
        let Action::Deform(deformation) = &mut Arc::make_mut(&mut entry.step).action else { return None };
        deformation.strokes.push(Arc::new(self.stroke.clone()));
        Some(steps.into())
    }
}
