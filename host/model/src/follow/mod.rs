//! Attributes that turn with the surface: vectors, normals, quaternions and covariances that are numbers of
//! each vertex, and Gaussian splats (B. Kerbl, G. Kopanas, T. Leimkühler, G. Drettakis, *3D Gaussian
//! Splatting for Real-Time Radiance Field Rendering*, 2023), which are ellipsoids with colours that depend on
//! the direction they are seen from.
//!
//! All follow from the gradient of the deformation at the vertex. `rules` has the rules that users ask for,
//! `names` finds the numbers by their names, and `following` holds the result; vectors and the like turn in
//! `turn`, splats in `splat` and their colours in `harmonics`. The place of the numbers in the file is known
//! by the format alone.

mod following;
mod harmonics;
mod names;
mod rules;
mod splat;
mod turn;

pub use following::Following;
pub use names::opacity;
pub use rules::{Follow, Opacity, TensorKind};
pub use turn::{anisotropy, normal, tangent};
