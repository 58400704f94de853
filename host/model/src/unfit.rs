//! Numbers of vertices that were edited, and those that a file cannot hold.

use crate::source::SourceFile;
use crate::{Edited, Error, Scalar, VertexChunk};

/// A coordinate that the file cannot hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unfit {
    /// Vertex that has the coordinate, counted from the first of the chunk.
    pub(crate) vertex: usize,
    pub(crate) axis: usize,
    pub(crate) value: f64,
}

impl Unfit {
    /// Error where the file could hold each finite number; `first` is the first vertex of the chunk.
    pub(crate) fn error(&self, source: &SourceFile, first: u64) -> Error {
        let (vertex, value, path) = (first + self.vertex as u64, self.value, source.path().display());
        Error::degenerate(
            format!("{path}: the deformation moves vertex {vertex} to {value}"),
            "check the deformation: its steps have to give finite positions",
        )
    }

    /// Error where the file stores floats.
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

/// Whether a coordinate of a normal was left as it was. Any NaN is as good as another: the file keeps its
/// own.
#[inline(always)]
pub(crate) fn same_normal(old: f32, new: f32) -> bool {
    old.to_bits() == new.to_bits() || (old.is_nan() && new.is_nan())
}

/// New coordinate of the position (0 to 2) or the normal (3 to 5) of a vertex of a chunk, of type `scalar` in
/// the file, if it was edited.
#[inline(always)]
pub(crate) fn new_component(
    chunk: &VertexChunk,
    edited: &Edited,
    (vertex, component): (usize, usize),
    scalar: Scalar,
) -> Result<Option<f64>, Unfit> {
    if component < 3 {
        let (old, new) = (chunk.positions[vertex][component], edited.positions[vertex][component]);
        let value = scalar.round(new);
        if !value.is_finite() {
            return Err(Unfit { vertex, axis: component, value: new });
        }
        return Ok((value.to_bits() != old.to_bits()).then_some(value));
    }
    // Normals are edited all or none.
    let old = chunk.normals[vertex][component - 3];
    let new = edited.normals.get(vertex).map_or(old, |normal| normal[component - 3]);
    Ok((!same_normal(old, new)).then_some(f64::from(new)))
}
