//! Another version of the edit, made to be compared with the one that is shown.

use super::requests::{CarriedSamples, ComparisonRequest, Event};
use crate::scene::{ViewerScene, common};
use glam::Vec3;
use simod_core::reconstruction::{DeformationField, Method, RestGeometry};
use simod_core::refinement::appended_deformed;
use simod_core::sampled_model::SampledModel;
use simod_model::{Progress, Result};
use simod_plugin_api::Effort;
use simod_session::PluginRegistry;
use simod_session::edit::Evaluation;
use std::sync::Arc;

impl ComparisonRequest {
    /// Makes the parts of the comparison that are missing. `revision` counts up with every scene.
    pub(super) fn done(
        self,
        open: &Evaluation,
        plugins: &PluginRegistry,
        revision: &mut u64,
        progress: &dyn Progress,
    ) -> Result<Event> {
        let known = self.scene.filter(|scene| !self.measure || scene.expected_error.is_some());
        let scene = match known {
            Some(scene) => scene,
            None => {
                let mut evaluation = open.another();
                let evaluated = evaluation.update(&self.steps, plugins, Effort::FULL, progress)?;
                *revision += 1;
                if self.whole
                    && let Some((_, error)) = evaluated.failure()
                {
                    return Err(error.clone());
                }
                let scene =
                    ViewerScene::new(evaluated, &evaluation, Effort::FULL, *revision, &Arc::default());
                Arc::new(if self.measure { scene.measured() } else { scene })
            }
        };
        progress.check()?;
        let carried = self.onto.map(|sampled| {
            let positions = carry(&scene, &sampled);
            CarriedSamples { sampled, positions }
        });
        Ok(Event::Compared { number: self.number, scene, carried })
    }
}

/// Positions that a version gives to the samples of `onto`: the samples of both samplings have them
/// already, the others are carried by the reconstruction.
fn carry(scene: &ViewerScene, onto: &SampledModel) -> Arc<[Vec3]> {
    let (rest, both) = (&onto.samples.positions, common(&scene.sampled, onto));
    if *scene.positions == *scene.sampled.samples.positions {
        return rest.as_slice().into();
    }
    let around = RestGeometry::new(&scene.sampled.samples);
    let field = DeformationField::new(&around, &scene.positions, Method::default());
    let moved = appended_deformed(onto, both, &field);
    let moved = moved.iter().map(|p| onto.frame.to_local(*p));
    scene.positions[..both].iter().copied().chain(moved).collect()
}
