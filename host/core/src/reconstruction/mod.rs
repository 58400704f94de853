//! Reconstruction: the deformation P_S → P_S* is transferred to every vertex of P_L, in one stream (paper
//! §5).
//!
//! P_S and P_S* sample an unknown map D of space. Before streaming, `sheets` finds which samples belong
//! together, `gradients` fits D's gradient at each, and `blended_jets` expands D about it to second order.
//! While streaming, `homes` finds the sample around which a vertex lies, by its position alone; `blend`
//! carries whole blocks of vertices over by the expansions around their homes, or `projected_barycentric`
//! each vertex in the paper's way; `stream` does so for the whole file. `diagnostics` tells the stretch and
//! folds of the surface, `expected_error` the probable error, and `judging` the vertices at which that is
//! beyond a tolerance. Where the map of space itself is known, `exact` evaluates it at each vertex instead,
//! and [`transfer_error`] compares results with it.

mod across;
mod binding;
mod blend;
mod blended_jets;
mod block;
mod bound;
#[cfg(test)]
mod bound_tests;
mod diagnostics;
mod exact;
mod expansion;
mod expectation;
mod expected_error;
#[cfg(test)]
mod expected_error_tests;
mod field;
mod gradients;
mod home_cells;
mod homes;
mod hull;
mod judging;
mod kept_geometry;
#[cfg(test)]
mod kept_geometry_tests;
mod lanes;
mod least_squares;
mod limiter;
mod near_lists;
mod neighbourhood;
mod overlaps;
mod packet_errors;
mod packets;
mod part_file;
mod parts;
mod projected_barycentric;
mod range;
mod reach;
mod repeated;
mod rest_geometry;
mod scattered;
mod sheets;
mod stencils;
mod stream;
#[cfg(test)]
mod tests;
mod transfer;
pub mod transfer_error;
mod transport;
mod unresolved;
mod within_range;
mod workspace;

use glam::Vec3;

use crate::sampling::SampleSet;
pub(crate) use binding::MAGIC as BINDING_MAGIC;
pub use binding::bind;
pub(crate) use block::homes;
pub use block::{Moved, carry, carry_positions};
pub use diagnostics::{Folds, VertexDiagnostics, principal_stretches};
pub use exact::{EVALUATIONS_WITH_GRADIENT, ExactMap, known_gradients, needs_gradient, write_exact};
pub use expectation::{ErrorExcess, ExpectedError};
pub use field::DeformationField;
use gradients::Gradients;
pub(crate) use homes::RING as TANGENT_RING;
pub use judging::{BeyondTolerance, ExactSample, JudgedVertices, judge};
pub use kept_geometry::keep_geometry;
pub use parts::{Part, SharedTarget, abort_object, begin_object, join_parts, write_part};
pub use reach::choose_offset;
pub use rest_geometry::RestGeometry;
pub(crate) use sheets::{CROWDED_NEIGHBOURS, SHEET_NEIGHBOURS};
pub use simod_model::Normals;
pub use stream::{Folding, PART_BYTES, Reconstructed, Reconstruction, Version, reconstruct};
pub use transport::{Method, Transport};

/// The unit normals of the deformed samples: those at rest, turned as their neighbourhoods are.
pub fn deformed_normals(samples: &SampleSet, deformed: &[Vec3]) -> Vec<Vec3> {
    Gradients::fit(samples, &rest_geometry::sheets(samples), deformed).0.normal
}
