//! Reconstruction: the deformation P_S → P_S* is transferred to every vertex of P_L, in one stream (paper §5).
//!
//! P_S and P_S* sample an unknown map D of space. Before streaming, `sheets` finds which samples belong together,
//! `local_frames` fits D's gradient at each, and `blended_jets` expands D about it to second order. While streaming,
//! `homes` finds the sample around which a vertex lies, by following the stream; `blend` carries whole blocks of
//! vertices over by the expansions around their homes, or `projected_barycentric` each vertex in the paper's way;
//! `stream` does so for the whole file. [`transfer_error`] compares a result with the exact map.

mod blend;
mod blended_jets;
mod block;
mod expansion;
mod homes;
mod lanes;
mod limiter;
mod local_frames;
mod neighbourhood;
mod projected_barycentric;
mod sheets;
mod stream;
#[cfg(test)]
mod tests;
pub mod transfer_error;

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;

use crate::frame::Frame;
use crate::sampling::SampleSet;
use blend::Supports;
use blended_jets::Expanded;
use block::{BLOCK, Workspaces};
use expansion::Expansion;
use homes::Homes;
use limiter::Limiter;
use local_frames::LocalFrames;
use neighbourhood::Neighbourhood;
use sheets::Sheets;
pub use stream::{Reconstructed, reconstruct};

/// What happens to one vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transport {
    /// From its old position to its new one, in local coordinates.
    pub displacement: Vec3,
    /// The gradient of the deformation there; normals go with its inverse transpose.
    pub gradient: Mat3,
}

impl Transport {
    /// A vertex that stays, as every sample around it does.
    pub const STILL: Self = Self { displacement: Vec3::ZERO, gradient: Mat3::IDENTITY };

    /// The normal after the deformation, of the same length as before.
    pub fn normal(&self, n: Vec3) -> Vec3 {
        if self.gradient == Mat3::IDENTITY || !n.is_finite() {
            return n;
        }
        // F⁻ᵀ up to a positive factor: the cofactors, which exist for a singular F too. Their sign is that of the
        // determinant, which would turn normals inside out under a reflection.
        let [a, b, c] = [self.gradient.x_axis, self.gradient.y_axis, self.gradient.z_axis];
        let cofactors = Mat3::from_cols(b.cross(c), c.cross(a), a.cross(b));
        let turned = (cofactors * n) * self.gradient.determinant().signum();
        turned.try_normalize().map_or(n, |t| t * n.length())
    }
}

/// The unit normals of the deformed samples: those at rest, turned as their neighbourhoods are.
pub fn deformed_normals(samples: &SampleSet, deformed: &[Vec3]) -> Vec<Vec3> {
    samples.prepare();
    LocalFrames::fit(samples, &Sheets::of(samples), deformed).normal
}

/// How a vertex is carried over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// The paper's (§5), guarded: an offset along the normal of an average plane, over a projected triangle.
    ProjectedBarycentric,
    /// A blend of second-order expansions around the nearest samples.
    #[default]
    BlendedJets,
}

/// The deformation that P_S and P_S* sample, ready to be evaluated anywhere near P_S.
///
/// Memory: about 900 bytes per sample.
pub struct DeformationField<'a> {
    samples: &'a SampleSet,
    deformed: &'a [Vec3],
    method: Method,
    sheets: Sheets,
    frames: LocalFrames,
    supports: Supports,
    expansions: Vec<Expansion>,
    limiter: Limiter,
    /// Whether anything moves around the sample as a home.
    active: Vec<bool>,
    workspaces: Workspaces,
}

impl<'a> DeformationField<'a> {
    /// Prepares the field. `deformed` holds the finite local position of each sample after the deformation.
    ///
    /// # Panics
    /// The number of deformed positions is not that of the samples.
    pub fn new(samples: &'a SampleSet, deformed: &'a [Vec3], method: Method) -> Self {
        assert_eq!(samples.len(), deformed.len(), "P_S* corresponds to P_S one to one");
        samples.prepare();
        let sheets = Sheets::of(samples);
        let frames = LocalFrames::fit(samples, &sheets, deformed);
        let supports = Supports::of(samples, &sheets);
        let Expanded { mut expansions, doubtful } = blended_jets::expand(samples, &sheets, deformed, &frames);
        for (e, radius) in expansions.iter_mut().zip(&supports.radius) {
            e.inverse_square = (1.0 / (radius * radius)).min(Expansion::NO_SUPPORT);
        }
        let moves: Vec<bool> = expansions.par_iter().map(|e| !e.is_still()).collect();
        let around = |home| supports.samples_of_home(home).any(|j| moves[j]);
        let active = (0..samples.len()).into_par_iter().map(|home| moves[home] || around(home)).collect();
        let limiter = Limiter::new(&supports, &expansions, &doubtful);
        let workspaces = Workspaces::default();
        Self { samples, deformed, method, sheets, frames, supports, expansions, limiter, active, workspaces }
    }

    /// Carries consecutive vertices of the model over, on all cores: `positions`, in the model's coordinates, and
    /// `normals`, as many or none, become what they are after the deformation. Returns how many vertices have no finite
    /// position, and are left as they are.
    ///
    /// The result depends on how the vertices are divided into calls, but not on the number of threads.
    pub fn carry(&self, frame: &Frame, positions: &mut [DVec3], normals: &mut [Vec3]) -> u64 {
        let carry_block = |positions: &mut [DVec3], normals: &mut [Vec3]| {
            self.workspaces.with(|workspace| workspace.carry_block(self, frame, positions, normals))
        };
        if normals.is_empty() {
            return positions.par_chunks_mut(BLOCK).map(|p| carry_block(p, &mut [])).sum();
        }
        let blocks = positions.par_chunks_mut(BLOCK).zip(normals.par_chunks_mut(BLOCK));
        blocks.map(|(p, n)| carry_block(p, n)).sum()
    }

    fn homes(&self) -> Homes<'_> {
        Homes::new(self.samples, &self.sheets, &self.supports)
    }

    /// Carries a vertex over that no support reaches, as one that lies far off the samples.
    fn beyond(&self, home: usize, p: Vec3) -> Transport {
        let around = Neighbourhood::gather(self.samples, &self.sheets, home, blended_jets::BLENDED, p);
        let (mut displacement, mut gradient, mut sum) = (Vec3::ZERO, Mat3::ZERO, 0.0);
        for &(i, w) in around.weighted() {
            let i = i as usize;
            let (u, slope) = self.expansions[i].beyond(p, self.limiter.doubt(i));
            displacement += w * u;
            gradient += w * slope;
            sum += w;
        }
        Transport { displacement: displacement / sum, gradient: Mat3::IDENTITY + gradient * (1.0 / sum) }
    }
}
