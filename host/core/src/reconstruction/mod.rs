//! Reconstruction: the deformation P_S → P_S* is transferred to every vertex of P_L, in one stream (paper §5).
//!
//! P_S and P_S* sample an unknown map D of space. Its gradient is fitted at each sample once (`local_frames`);
//! the samples around a vertex are found by following the stream (`neighbours`); the vertex is carried over by
//! `blended_jets` or `projected_barycentric`; `stream` does so for the whole file. [`transfer_error`] compares a result with
//! the exact map.

mod blended_jets;
mod local_frames;
mod neighbours;
mod projected_barycentric;
mod stream;
pub mod transfer_error;

use glam::{Mat3, Vec3};

pub use crate::model::Normals;
use crate::sampling::SampleSet;
use blended_jets::Jet;
use local_frames::LocalFrames;
use neighbours::Neighbourhood;
pub use neighbours::Walk;
pub use stream::{PART_BYTES, Reconstructed, Reconstruction, Version, reconstruct};

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
    LocalFrames::fit(samples, deformed).normal
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
/// Memory: about 170 bytes per sample.
pub struct DeformationField<'a> {
    samples: &'a SampleSet,
    deformed: &'a [Vec3],
    method: Method,
    frames: LocalFrames,
    jets: Vec<Jet>,
    /// Whether any jet moves that a vertex nearest to this sample may blend.
    active: Vec<bool>,
}

impl<'a> DeformationField<'a> {
    /// Prepares the field. `deformed` holds the finite local position of each sample after the deformation.
    ///
    /// # Panics
    /// The number of deformed positions is not that of the samples.
    pub fn new(samples: &'a SampleSet, deformed: &'a [Vec3], method: Method) -> Self {
        assert_eq!(samples.len(), deformed.len(), "P_S* corresponds to P_S one to one");
        let moved: Vec<bool> = samples.positions.iter().zip(deformed).map(|(p, q)| p != q).collect();
        // A jet is fitted to moved samples one step away, and blended by vertices nearest to samples another step away.
        let active = beside(samples, &beside(samples, &moved));
        let frames = LocalFrames::fit(samples, deformed);
        let jets = blended_jets::expand(samples, deformed, &frames);
        Self { samples, deformed, method, frames, jets, active }
    }

    /// Carries a vertex over. `p` is finite, `n` its normal where the model has one; `walk` remembers where the
    /// last vertex was.
    pub fn transport(&self, p: Vec3, n: Option<Vec3>, walk: &mut Walk) -> Transport {
        let nearest = walk.nearest(self.samples, p) as usize;
        if !self.active[nearest] {
            return Transport::STILL;
        }
        let gather = |k| Neighbourhood::gather(self.samples, nearest, k, p, n);
        let by_triangle = match self.method {
            Method::ProjectedBarycentric => {
                projected_barycentric::transport(self, &gather(projected_barycentric::NEIGHBOURS), p)
            }
            Method::BlendedJets => None,
        };
        // Jets also stand in where no triangle of samples is fit to be used.
        by_triangle.unwrap_or_else(|| blended_jets::transport(self, &gather(blended_jets::BLENDED), p))
    }
}

/// The samples that are marked, or have a neighbour that is.
fn beside(samples: &SampleSet, marked: &[bool]) -> Vec<bool> {
    let near = |i: usize| samples.neighbours().of(i).iter().any(|j| marked[*j as usize]);
    (0..samples.len()).map(|i| marked[i] || near(i)).collect()
}
