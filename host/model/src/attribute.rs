//! Numbers of vertices beside their positions and normals.

use serde::{Deserialize, Serialize};

use crate::Type;

/// A number that each vertex has, beside its position and its normal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attribute {
    /// Name of the attribute in the file, as `red`.
    pub name: String,
    /// Type of the attribute's numbers.
    pub kind: Type,
}

impl Attribute {
    /// Longest name, in bytes.
    const LONGEST_NAME: usize = 255;

    /// Whether the attribute's numbers are names of classes, as they are in LAS: a mean of classes is no
    /// class.
    pub fn is_of_classes(&self) -> bool {
        self.name == "classification" && !self.kind.is_float()
    }

    /// Whether a text can be the name of an attribute: it is short, and has no control characters, so that it
    /// can be shown as it is.
    pub fn is_name(name: &str) -> bool {
        (1..=Self::LONGEST_NAME).contains(&name.len()) && !name.chars().any(char::is_control)
    }
}
