//! What is there to be seen: the samples, where the steps have moved them, and what the plugins placed.

use glam::Vec3;
use rayon::prelude::*;
use simod_core::reconstruction::{DeformationField, Method, Surroundings};
use simod_core::sampled_model::SampledModel;
use simod_model::frame::Frame;
use simod_plugin_api::{Effort, HandleDesc};
use simod_session::edit::{Evaluated, Evaluation, Status, StepId};
use std::collections::HashMap;
use std::sync::Arc;

/// Neighbours of a sample that its normal is turned with.
const RING: usize = 6;

/// The samples after the steps. All arrays have one entry for each sample; all coordinates are local.
pub struct Scene {
    /// The model with its samples at rest: their normals, spacing, neighbours, and the triangles between
    /// them.
    pub sampled: Arc<SampledModel>,
    /// Where the samples are.
    pub positions: Arc<[Vec3]>,
    /// Unit normals there.
    pub normals: Arc<[Vec3]>,
    /// How each step fared, in their order.
    pub statuses: Vec<(StepId, Status)>,
    /// What each step began with: see [`Evaluated::before`].
    pub before: Vec<Arc<[Vec3]>>,
    /// The handles that the steps' plugins placed, at rest.
    pub handles: HashMap<StepId, Vec<HandleDesc>>,
    /// What it was worth: a draft may differ a little from the result.
    pub effort: Effort,
    /// The transfer error to be expected around each sample, local units, if it was asked for.
    pub expected_error: Option<Vec<f32>>,
    /// Counts up with every scene that is shown.
    pub revision: u64,
}

impl Scene {
    /// Of samples that the steps have moved.
    pub(crate) fn new(evaluated: Evaluated, evaluation: &Evaluation, effort: Effort, revision: u64) -> Self {
        let Evaluated { sampled, positions, statuses, before, .. } = evaluated;
        let handles = |(id, _): &(StepId, Status)| {
            let handles = evaluation.handles(*id);
            (!handles.is_empty()).then(|| (*id, handles.to_vec()))
        };
        let handles = statuses.iter().filter_map(handles).collect();
        let normals = turned_normals(&sampled, &positions).into();
        Self {
            sampled,
            positions,
            normals,
            statuses,
            before,
            handles,
            effort,
            expected_error: None,
            revision,
        }
    }

    /// The same, with the error to be expected, which takes as long as preparing to write.
    pub(crate) fn measured(self) -> Self {
        let still = *self.positions == *self.sampled.samples.positions;
        let expected = if still {
            vec![0.0; self.len()]
        } else {
            let around = Surroundings::of(&self.sampled.samples);
            DeformationField::new(&around, &self.positions, Method::default()).expected_error()
        };
        Self { expected_error: Some(expected), ..self }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Never: a model has at least one sample.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The map between local coordinates and the model's.
    pub fn frame(&self) -> Frame {
        self.sampled.frame
    }

    /// Smallest and largest local coordinates of the samples as they are.
    pub fn bounds(&self) -> [Vec3; 2] {
        let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        self.positions.iter().fold(start, |[min, max], p| [min.min(*p), max.max(*p)])
    }
}

/// How many of the first samples are the same in two samplings of a model: all but those that refinements
/// appended to one of both.
pub fn common(a: &SampledModel, b: &SampledModel) -> usize {
    let (p, q) = (&a.samples.positions, &b.samples.positions);
    if std::ptr::eq(a, b) { p.len() } else { p.iter().zip(q).take_while(|(p, q)| p == q).count() }
}

/// The samples' normals, turned as the triangles between each and its nearest neighbours are: `Σ (r₁ × r₂ ·
/// n) d₁ × d₂` over pairs of neighbours, where `r` are the ways to them at rest and `d` those now. With
/// tangents `s × t = n` that is `(Σ (r·s) d) × (Σ (r·t) d)`. Quick, and for the eye alone.
fn turned_normals(sampled: &SampledModel, positions: &[Vec3]) -> Vec<Vec3> {
    let (samples, rest) = (&sampled.samples, &sampled.samples.positions);
    samples.prepare();
    if *positions == **rest {
        return samples.normals().to_vec();
    }
    let (neighbours, normals) = (samples.neighbours(), samples.normals());
    let turned = |(i, n): (usize, &Vec3)| {
        let (s, t) = n.any_orthonormal_pair();
        let (mut along_s, mut along_t) = (Vec3::ZERO, Vec3::ZERO);
        for &j in &neighbours.of(i)[..RING.min(neighbours.k())] {
            let (r, d) = (rest[j as usize] - rest[i], positions[j as usize] - positions[i]);
            along_s += r.dot(s) * d;
            along_t += r.dot(t) * d;
        }
        // Each of the size of a small length's square.
        let unit = |v: Vec3| v / v.abs().max_element();
        unit(along_s).cross(unit(along_t)).try_normalize().unwrap_or(*n)
    };
    normals.par_iter().enumerate().map(turned).collect()
}
