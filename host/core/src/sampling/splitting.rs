//! Options for the splitting of clusters.

use serde::{Deserialize, Serialize};
use simod_model::ModelInfo;

/// The way in which clusters are split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Splitting {
    /// Splitting in space first, and in the plane of the cluster once it is flat enough; sheets that lie one
    /// above the other are parted first of all. Where a model has faces, these part the sheets, and clusters
    /// are split as without layers.
    #[default]
    Layered,
    /// A Volume-Surface Tree that parts no layers.
    VolumeSurface,
    /// Splitting in space alone, with which the paper compares the VS-Tree.
    Octree,
}

impl Splitting {
    /// Splitting for a model: where there are faces, these tell layers apart.
    pub(super) fn resolve(self, info: &ModelInfo) -> Self {
        if self == Self::Layered && info.faces > 0 { Self::VolumeSurface } else { self }
    }
}
