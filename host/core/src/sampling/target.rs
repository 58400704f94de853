//! How fine P_S shall be: what a sampling is asked for.

use serde::{Deserialize, Serialize};

/// How fine P_S shall be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// This many samples, at most, and only less where the model has no more to tell apart.
    Samples(u64),
    /// No cluster has a larger error (see [`super::cluster::Moments::representative`]); a fraction of the
    /// diagonal. So every vertex has a sample within this / [`super::cluster::REACH_WEIGHT`].
    Error(f64),
}

impl Default for Target {
    fn default() -> Self {
        Self::Samples(100_000)
    }
}
