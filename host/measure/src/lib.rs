//! simod-measure: what a deformation does to a mesh: changes of volume, lengths and areas, and how details turn; and how far
//! the results of several are from each other.
//!
//! For meshes that are held in memory, `P_S` or a model that is small enough; [`beside`] alone is for models
//! of any size. Positions are in any unit; triangles are indices into them, counter-clockwise as seen from
//! outside. A triangle with an index that is out of range, or with a corner that is not finite, is left out.
//!
//! ```
//! use glam::DVec3;
//! use crate::{edge_distortion, volume};
//!
//! let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
//! let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
//! let doubled = corners.map(|p| p * 2.0);
//! assert!((volume(&corners, &triangles) - 1.0 / 6.0).abs() < 1e-15);
//! assert!((edge_distortion(&corners, &doubled, &triangles).rms - 1.0).abs() < 1e-15);
//! ```

mod details;
mod distance;
mod size;
mod vertexwise;

pub use details::{Details, Rotation};
pub use distance::{Distances, OnSurface, Surface};
pub use size::{area, area_distortion, edge_distortion, is_closed, volume};
pub use vertexwise::{Angles, Beside, Difference, beside};

use glam::DVec3;
use serde::Serialize;

/// A corner of a triangle.
type Corners = [DVec3; 3];

/// How some amount is spread over a mesh; all 0 for a mesh without any.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Spread {
    /// Root of the mean square.
    pub rms: f64,
    /// 99 of 100 are at most this.
    pub p99: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// Of amounts that are not negative.
    pub fn of(mut amounts: Vec<f64>) -> Self {
        let Some(last) = amounts.len().checked_sub(1) else { return Self::default() };
        amounts.sort_by(f64::total_cmp);
        let squares: f64 = amounts.iter().map(|x| x * x).sum();
        Self {
            rms: (squares / amounts.len() as f64).sqrt(),
            p99: amounts[last * 99 / 100],
            max: amounts[last],
        }
    }
}

/// The corners of a triangle in one shape; nothing where it has none.
fn corners(positions: &[DVec3], triangle: [u32; 3]) -> Option<Corners> {
    let [a, b, c] = triangle.map(|i| positions.get(i as usize).copied().filter(|p| p.is_finite()));
    Some([a?, b?, c?])
}

/// Twice the area of a triangle, along its normal.
fn cross([a, b, c]: Corners) -> DVec3 {
    (b - a).cross(c - a)
}
