//! Numbers of vertices beside their positions and normals.

use serde::{Deserialize, Serialize};

use crate::Type;

/// A number that each vertex has, beside its position and its normal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attribute {
    /// What the file calls it, as `red`.
    pub name: String,
    /// The type of its numbers.
    pub kind: Type,
}

impl Attribute {
    /// Longest name, in bytes.
    const LONGEST_NAME: usize = 255;

    /// Whether its numbers are names of classes, as they are in LAS: a mean of them is none.
    pub fn is_of_classes(&self) -> bool {
        self.name == "classification" && !self.kind.is_float()
    }

    /// Whether something can be asked for by this name: it is short, and nothing in it needs care when it is
    /// shown.
    pub fn is_name(name: &str) -> bool {
        (1..=Self::LONGEST_NAME).contains(&name.len()) && !name.chars().any(char::is_control)
    }
}
