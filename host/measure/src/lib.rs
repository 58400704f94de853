//! simod-measure: measures of a deformed mesh: changes of volume, lengths and areas, and the rotation of
//! details; and distances between the results of several deformations.
//!
//! For meshes that are held in memory, `P_S` or a model that is small enough; [`beside`] alone is for models
//! of any size. Positions are in any unit; triangles are indices into them, counter-clockwise as seen from
//! outside. A triangle with an index that is out of range, or with a corner that is not finite, is left out.
//!
//! ```
//! use glam::DVec3;
//! use simod_measure::{Edges, edge_distortion, volume};
//!
//! let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
//! let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
//! let doubled = corners.map(|p| p * 2.0);
//! assert!((volume(&corners, &triangles) - 1.0 / 6.0).abs() < 1e-15);
//! assert!((edge_distortion(&corners, &doubled, &Edges::from_triangles(&corners, &triangles)).rms - 1.0).abs() < 1e-15);
//! ```

mod details;
mod distance;
mod energy;
mod size;
mod spread;
mod tree;
mod triangle;
mod vertexwise;

pub use details::{DetailRotation, Details};
pub use distance::{DistanceSurface, Distances, OnSurface};
pub use energy::{Bins, Energies, Histograms};
pub use size::{OpenMesh, area, area_distortion, edge_distortion, is_closed, volume};
pub use spread::{Spread, median};
pub use triangle::Edges;
pub use vertexwise::{Also, Angles, Difference, VersionsBeside, beside};
