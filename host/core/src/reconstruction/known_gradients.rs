//! Gradients at the samples that are known exactly, where the map of space is. Samples on a surface tell nothing
//! of how the map goes on across it: what turns with the surface needs that, positions do not.

use glam::{Mat3, Vec3};
use rayon::prelude::*;
use simod_model::Result;

use super::exact::{ExactMap, gradients};
use super::projected_barycentric;
use super::{DeformationField, Method};
use crate::sampled_model::SampledModel;

/// The gradient of a map at each sample.
///
/// Memory: about 200 bytes per sample while it runs.
///
/// # Errors
/// The map fails.
pub fn known_gradients(sampled: &SampledModel, map: &ExactMap<'_>) -> Result<Vec<Mat3>> {
    let frame = &sampled.frame;
    let positions: Vec<_> = sampled.samples.positions.iter().map(|p| frame.to_model(*p)).collect();
    Ok(gradients(map, frame, &positions)?.iter().map(|gradient| gradient.as_mat3()).collect())
}

impl DeformationField<'_> {
    /// The same, with the gradients at the samples known; none if they are not.
    ///
    /// Memory: 36 bytes per sample.
    pub(super) fn knowing(mut self, known: &[Mat3]) -> Self {
        let missing = |(i, known): (usize, &Mat3)| {
            let missing = *known - self.gradient_of_samples(i, self.around.samples.positions[i]);
            if missing.is_finite() { missing } else { Mat3::ZERO }
        };
        let missing = known.par_iter().enumerate().map(missing).collect();
        self.missing = missing;
        self
    }

    /// The gradient at a place, as the samples tell it.
    fn gradient_of_samples(&self, home: usize, p: Vec3) -> Mat3 {
        match self.method {
            Method::BlendedJets => self.blended(self.around.reaching(home), p).1.gradient,
            Method::ProjectedBarycentric => projected_barycentric::carry(self, home, p).gradient,
        }
    }

    /// A gradient as the samples tell it at a place around a home, with what they do not tell, if that is known:
    /// by the weights of the blend.
    pub(super) fn completed(&self, home: usize, p: Vec3, gradient: Mat3) -> Mat3 {
        if self.missing.is_empty() {
            return gradient;
        }
        let (mut missing, mut sum) = (Mat3::ZERO, 0.0);
        for i in self.around.reaching(home) {
            let s = self.expansions[i].within(p).max(0.0);
            let w = s * s * s;
            missing += self.missing[i] * w;
            sum += w;
        }
        gradient + if sum > 0.0 { missing * (1.0 / sum) } else { self.missing[home] }
    }
}
