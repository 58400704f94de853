//! Vertices whose edited position a file cannot hold.

use crate::Error;
use crate::source::SourceFile;

/// A coordinate that the file cannot hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unfit {
    /// The vertex that has it, counted from the first of the chunk.
    pub(crate) vertex: usize,
    pub(crate) axis: usize,
    pub(crate) value: f64,
}

impl Unfit {
    /// What is wrong where each finite number could be held; `first` is the first vertex of the chunk.
    pub(crate) fn error(&self, source: &SourceFile, first: u64) -> Error {
        let (vertex, value, path) = (first + self.vertex as u64, self.value, source.path().display());
        Error::degenerate(
            format!("{path}: the deformation moves vertex {vertex} to {value}"),
            "check the deformation: its steps have to give finite positions",
        )
    }

    /// What is wrong where the file keeps floats.
    pub(crate) fn in_floats(&self, source: &SourceFile, first: u64) -> Error {
        let (vertex, value, path) = (first + self.vertex as u64, self.value, source.path().display());
        if !value.is_finite() {
            return self.error(source, first);
        }
        Error::degenerate(
            format!("{path}: vertex {vertex} moves to {value:e}, too far for the type float of the file"),
            "move it less, or export the model with positions of type double",
        )
    }
}
