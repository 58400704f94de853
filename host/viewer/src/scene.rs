//! The scene that is shown: the samples, their positions after the steps, and the handles that plugins
//! placed.

use crate::shading::{EllipseAxes, Rings, Shading};
use glam::{DVec3, Vec3};
use simod_core::reconstruction::{DeformationField, Method, RestGeometry};
use simod_core::sampled_model::SampledModel;
use simod_model::frame::Frame;
use simod_plugin_api::Effort;
use simod_session::OwnHandles;
use simod_session::edit::{Evaluated, Evaluation, Status, StepId};
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// The samples after the steps. All arrays have one entry for each sample; all coordinates are local.
pub struct ViewerScene {
    /// The model with its samples at rest: their normals, spacing, neighbours, and the triangles between
    /// them.
    pub sampled: Arc<SampledModel>,
    /// The samples' positions.
    pub positions: Arc<[Vec3]>,
    /// Outcome of each step, in their order.
    pub statuses: Vec<(StepId, Status)>,
    /// Positions with which each step began: see [`Evaluated::before`].
    pub before: Vec<Arc<[Vec3]>>,
    /// The handles that the steps' plugins placed, at rest.
    pub handles: HashMap<StepId, Arc<OwnHandles>>,
    /// Posed handles of the plugins of steps with joints: see [`Evaluated::posed`].
    pub posed: Vec<(StepId, Arc<[DVec3]>)>,
    /// Effort of the evaluation: a draft may differ a little from the result.
    pub effort: Effort,
    /// The transfer error to be expected around each sample, local units, if it was asked for.
    pub expected_error: Option<Vec<f32>>,
    /// Number of the scene, which counts up with every scene that is shown.
    pub revision: u64,
    /// Normals and stretches of the surface, once they are computed.
    shading: OnceLock<Shading>,
    bounds: OnceLock<[Vec3; 2]>,
    /// Whether somebody has asked for the shading of all samples of a draft.
    asked: Arc<AtomicBool>,
}

impl ViewerScene {
    /// Scene of samples that the steps have moved. The shading of a draft is computed when somebody asks,
    /// as most of its samples may not be drawn; unless the shading of all was `asked` for in the draft
    /// before.
    pub(crate) fn new(
        evaluated: Evaluated,
        evaluation: &Evaluation,
        effort: Effort,
        revision: u64,
        asked: &Arc<AtomicBool>,
    ) -> Self {
        let Evaluated { sampled, positions, statuses, posed, before, .. } = evaluated;
        let handles = |(id, _): &(StepId, Status)| {
            let handles = evaluation.handles(*id).filter(|handles| !handles.descs.is_empty());
            handles.map(|handles| (*id, handles.clone()))
        };
        let handles = statuses.iter().filter_map(handles).collect();
        let shading = OnceLock::new();
        if asked.swap(false, Ordering::Relaxed) || effort != Effort::DRAFT {
            shading.get_or_init(|| Shading::new(&sampled, &positions));
        }
        Self {
            sampled,
            positions,
            statuses,
            before,
            handles,
            posed,
            effort,
            expected_error: None,
            revision,
            shading,
            bounds: OnceLock::new(),
            asked: asked.clone(),
        }
    }

    /// Whether the scene is a draft, from which the result may differ a little.
    pub fn is_draft(&self) -> bool {
        self.effort == Effort::DRAFT
    }

    /// Normals and stretches of the surface at all samples.
    pub fn shading(&self) -> &Shading {
        if self.is_draft() {
            self.asked.store(true, Ordering::Relaxed);
        }
        self.shading.get_or_init(|| Shading::new(&self.sampled, &self.positions))
    }

    /// Normals and stretches at some of the samples, in their order. The part of the computation that
    /// depends on the rest shape is `kept` from one call to the next.
    pub fn shading_of(&self, some: &Arc<[u32]>, kept: &mut Option<Rings>) -> Shading {
        if let Some(all) = self.shading.get() {
            return all.taken(some);
        }
        Rings::keep(kept, &self.sampled, some).shading(&self.positions)
    }

    /// Unit normals at the samples' positions.
    pub fn normals(&self) -> &Arc<[Vec3]> {
        &self.shading().normals
    }

    /// Ellipses that circles of radius 1 around the samples at rest become: see [`Shading::axes`].
    pub fn axes(&self) -> &Arc<[EllipseAxes]> {
        &self.shading().axes
    }

    /// The same scene with the error to be expected, whose computation takes as long as preparing to write.
    pub(crate) fn measured(self) -> Self {
        let still = *self.positions == *self.sampled.samples.positions;
        let expected = if still {
            vec![0.0; self.len()]
        } else {
            let around = RestGeometry::new(&self.sampled.samples);
            DeformationField::new(&around, &self.positions, Method::default()).expected_error()
        };
        Self { expected_error: Some(expected), ..self }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are no samples: never, as a model has at least one.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The map between local coordinates and the model's.
    pub fn frame(&self) -> Frame {
        self.sampled.frame
    }

    /// Smallest and largest local coordinates of the samples' present positions.
    pub fn bounds(&self) -> [Vec3; 2] {
        let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        let found = || self.positions.iter().fold(start, |[min, max], p| [min.min(*p), max.max(*p)]);
        *self.bounds.get_or_init(found)
    }
}

/// Number of first samples that are the same in two samplings of a model: all but those that refinements
/// appended to one of both.
pub fn common(a: &SampledModel, b: &SampledModel) -> usize {
    let (p, q) = (&a.samples.positions, &b.samples.positions);
    if std::ptr::eq(a, b) { p.len() } else { p.iter().zip(q).take_while(|(p, q)| p == q).count() }
}
