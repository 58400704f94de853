//! Transport of one vertex: its displacement, the gradient there, and the method by which both are found.

use glam::{Mat3, Vec3};
use simod_model::follow;

/// Displacement of one vertex, and the gradient of the deformation there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transport {
    /// Way from the vertex's old position to its new one, in local coordinates.
    pub displacement: Vec3,
    /// The gradient of the deformation there; normals go with its inverse transpose.
    pub gradient: Mat3,
}

impl Transport {
    /// Transport of a vertex that stays.
    pub const NONE: Self = Self { displacement: Vec3::ZERO, gradient: Mat3::IDENTITY };

    /// The [normal](follow::normal) after the deformation.
    pub fn normal(&self, n: Vec3, mirrored: bool) -> Vec3 {
        follow::normal(&self.gradient, n, mirrored)
    }
}

/// Method by which a vertex is carried over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// The paper's (§5), guarded: an offset along the normal of an average plane, over a projected triangle.
    ProjectedBarycentric,
    /// A blend of second-order expansions around the nearest samples.
    #[default]
    BlendedJets,
}
