//! The record of a refinement, as it is kept.

use serde::{Deserialize, Serialize};

/// A refinement that a sampled model has gone through.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Refinement {
    /// The shapes of the selection.
    pub shapes: Vec<toml::Table>,
    /// The bound that it came to inside, as a fraction of the diagonal.
    pub error: f64,
    /// Number of samples that it appended.
    pub added: u64,
    /// The transfer error that it allowed, as a fraction of the diagonal, if it was where a deformation
    /// needed it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer_error: Option<f64>,
}

impl Refinement {
    /// Selected shapes as text, on one line.
    pub fn places(&self) -> String {
        let shape = |table: &toml::Table| toml::Value::from(table.clone()).to_string();
        if self.shapes.is_empty() {
            return "wherever it was needed".to_owned();
        }
        self.shapes.iter().map(shape).collect::<Vec<_>>().join(", ")
    }
}
