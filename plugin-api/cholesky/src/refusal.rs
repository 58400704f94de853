//! Reasons for which there is no factor.

use simod_plugin_api::PluginError;

/// Reason for which there is no factor.
#[derive(Debug)]
pub enum Refusal {
    /// The matrix is not positive definite, even with a little added to its diagonal.
    Indefinite,
    /// The factor would take more memory than is allowed.
    TooLarge,
    /// The host has stopped it.
    Stopped(PluginError),
}

impl From<PluginError> for Refusal {
    fn from(error: PluginError) -> Self {
        Self::Stopped(error)
    }
}
