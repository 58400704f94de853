//! Where the samples that a refinement appended go while something before it is dragged: by the deformation
//! of those around them alone, which is nearly that of all samples, and found many times as fast.

use glam::Vec3;
use simod_core::reconstruction::{DeformationField, Method, RestGeometry};
use simod_core::refinement::appended_deformed;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::SampleSet;
use simod_model::Result;

/// So many rings of neighbours around the samples that are nearest to those appended: as far as their words
/// reach, and theirs who tell how the outermost of them turn.
const RINGS: u32 = 3;

/// The samples around those that a refinement appended.
///
/// Memory: what a [`SampleSet`] takes, for the part of the samples that was refined.
pub struct Around {
    /// Which, ascending.
    of: Vec<u32>,
    samples: SampleSet,
}

impl Around {
    /// The samples of `before` around what `after` has more.
    ///
    /// # Errors
    /// There are none.
    pub fn new(before: &SampledModel, after: &SampledModel) -> Result<Self> {
        let samples = &before.samples;
        let neighbours = samples.neighbours();
        let mut is_near = vec![false; samples.len()];
        let appended = &after.samples.positions[samples.len()..];
        let mut ring: Vec<u32> = appended.iter().map(|p| samples.nearest(*p)).collect();
        for left in (0..=RINGS).rev() {
            ring.retain(|i| !std::mem::replace(&mut is_near[*i as usize], true));
            if left > 0 {
                ring = ring.iter().flat_map(|i| neighbours.nearest_to(*i as usize)).copied().collect();
            }
        }
        let of: Vec<u32> = (0..samples.len() as u32).filter(|i| is_near[*i as usize]).collect();
        let pick = |from: &[Vec3]| of.iter().map(|i| from[*i as usize]).collect();
        let samples = SampleSet::new(pick(&samples.positions), pick(samples.normals()))?;
        Ok(Self { of, samples })
    }

    /// Number of samples.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.of.len()
    }

    /// Where all samples of `after` go about, by the deformed positions of those that were there before.
    pub fn draft(&self, after: &SampledModel, deformed: &[Vec3]) -> Vec<Vec3> {
        let near: Vec<Vec3> = self.of.iter().map(|i| deformed[*i as usize]).collect();
        let around = RestGeometry::new(&self.samples);
        let field = DeformationField::new(&around, &near, Method::default());
        let more = appended_deformed(after, deformed.len(), &field);
        deformed.iter().copied().chain(more.iter().map(|p| after.frame.to_local(*p))).collect()
    }
}
