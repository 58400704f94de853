//! Fineness of P_S that a sampling is asked for.

use serde::{Deserialize, Serialize};

/// Fineness of P_S.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// Number of samples, at most; there are fewer only where the model has no more to tell apart.
    Samples(u64),
    /// Largest error of a cluster (see [`super::cluster::Moments::representative`]), as a fraction of the
    /// diagonal. So every vertex has a sample within this / [`super::cluster::REACH_WEIGHT`].
    Error(f64),
}

impl Default for Target {
    fn default() -> Self {
        Self::Samples(100_000)
    }
}
