//! Measure by which samples are spread: the weight of a cluster's error, where vertices are dense or the
//! surface is flat.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::cluster::{Moments, REACH_WEIGHT};
use super::splitting::Splitting;

/// Measure by which samples are spread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// The error of their clusters: more where the surface bends.
    #[default]
    Error,
    /// The reach of their clusters alone: as far apart everywhere.
    Area,
    /// The error of their clusters, beside the distance between vertices: where the model has more vertices
    /// for an area than in the mean, errors count for more by as much as vertices are nearer to each other.
    /// So a detail that was scanned a thousand times as finely as the rest gets samples a thousand times as
    /// fine.
    Vertices,
}

impl By {
    /// The choices that there are.
    pub const ALL: [Self; 3] = [Self::Error, Self::Area, Self::Vertices];

    /// Whether the measure is the default, which files do not mention.
    pub(crate) fn is_error(&self) -> bool {
        *self == Self::Error
    }

    /// The name of this choice in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Area => "area",
            Self::Vertices => "vertices",
        }
    }
}

/// Rule by which clusters are split, and in which order.
#[derive(Debug, Clone, Copy)]
pub struct SplitRule {
    pub splitting: Splitting,
    pub by: By,
    /// Vertices for each unit of area in the mean, local units.
    pub density: f64,
}

impl From<Splitting> for SplitRule {
    fn from(splitting: Splitting) -> Self {
        Self { splitting, by: By::Error, density: f64::INFINITY }
    }
}

/// Cells that a surface meets, for as many as its area has.
const CELLS: f64 = 2.0;

/// Largest factor by which an error counts for more.
const MOST: f64 = 1e4;

/// Area of a square over the mean square distance to its middle.
const AREA: f64 = 6.0;

impl SplitRule {
    /// Rule for a model of `vertices` finite vertices in `cells` cells of this edge (local units).
    pub fn new(splitting: Splitting, by: By, vertices: u64, cells: u64, edge: f64) -> Self {
        let area = cells as f64 * edge * edge / CELLS;
        Self { splitting, by, density: vertices as f64 / area.max(f64::MIN_POSITIVE) }
    }

    /// Key by which a cluster is split, given its representative and error: its weighted error, no less than
    /// [`REACH_WEIGHT`] times its reach.
    pub fn key(&self, moments: &Moments, position: Vec3, error: f32) -> f64 {
        let error = f64::from(error);
        match self.by {
            By::Error => error,
            By::Area if error > 0.0 => REACH_WEIGHT * moments.reach(position),
            By::Vertices if error > 0.0 => {
                let area = AREA * moments.spread().powi(2);
                let nearer = (moments.count() / (area * self.density)).sqrt();
                // A cluster without an area has vertices as near as can be.
                error * nearer.clamp(1.0, MOST)
            }
            _ => 0.0,
        }
    }
}
