//! Gaussian splats in layouts of their own, of few bytes each: they are read as the same numbers, by the same
//! names, as PLY files of 3D Gaussian splatting have, and are written back in as many bits as there are.
//!
//! | module | |
//! |---|---|
//! | `records` | `.splat`: 32 bytes a splat, in any order |
//! | `chunks` | compressed PLY: chunks of 256 splats, packed between bounds |
//! | `spz` | SPZ: arrays, compressed by gzip |
//! | `packing` | numbers in few bits |

pub(crate) mod chunks;
mod packing;
pub(crate) mod records;
pub(crate) mod spz;

use std::ops::Range;

use glam::Mat3;

use crate::follow::Following;
use crate::pipeline::Rewritable;
use crate::source::SourceFile;
use crate::{
    Attribute, CHUNK_VERTICES, Edited, Model, ModelInfo, Result, Scalar, Type, VertexChunk, VertexReader,
};

/// Attributes of a splat with so many harmonics beyond the first three.
fn attributes(harmonics: usize) -> Vec<Attribute> {
    let groups = [("f_dc_", 3), ("f_rest_", harmonics), ("opacity", 1), ("scale_", 3), ("rot_", 4)];
    let names = groups.into_iter().flat_map(|(name, count)| {
        (0..count).map(move |i| if name == "opacity" { name.to_owned() } else { format!("{name}{i}") })
    });
    names.map(|name| Attribute { name, kind: Type::F32 }).collect()
}

/// Indices among these attributes at which the groups begin.
#[derive(Debug, Clone, Copy)]
struct GroupOffsets {
    opacity: usize,
    scale: usize,
    rotation: usize,
    /// The number of all properties.
    all: usize,
}

/// The first coefficient of the harmonics beyond the first three.
const HARMONICS: usize = 3;

impl GroupOffsets {
    fn new(harmonics: usize) -> Self {
        let opacity = HARMONICS + harmonics;
        Self { opacity, scale: opacity + 1, rotation: opacity + 4, all: opacity + 8 }
    }
}

/// Info on a file of splats.
fn info(
    format: String,
    source: &SourceFile,
    vertices: u64,
    bytes_of_a_splat: u64,
    harmonics: usize,
) -> ModelInfo {
    let attributes = attributes(harmonics);
    ModelInfo {
        format,
        vertices,
        position_type: Scalar::F32,
        other_properties: attributes.iter().map(|a| format!("float {}", a.name)).collect(),
        attributes,
        bytes: source.len(),
        vertex_bytes: vertices * bytes_of_a_splat,
        ..ModelInfo::default()
    }
}

/// A layout of which any splats can be read.
trait SplatLayout: Model + Rewritable {
    /// Fills a chunk with the bytes of some splats.
    fn read(&self, chunk: &mut VertexChunk, splats: Range<u64>) -> Result<()>;
}

/// Reads splats chunk by chunk.
struct SplatReader<'a, L> {
    model: &'a L,
    range: Range<u64>,
    chunk: u64,
}

impl<'a, L: SplatLayout> SplatReader<'a, L> {
    fn new(model: &'a L, range: Range<u64>) -> Self {
        let end = range.end.min(model.info().vertices);
        Self { model, range: range.start.min(end)..end, chunk: CHUNK_VERTICES as u64 }
    }
}

impl<L: SplatLayout> VertexReader for SplatReader<'_, L> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES) as u64;
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let end = self.range.end.min(self.range.start + self.chunk);
        self.model.read(chunk, self.range.start..end)?;
        self.range.start = end;
        self.model.decode(chunk)?;
        Ok(!chunk.is_empty())
    }
}

/// The gradient by which a splat of a chunk turns, if it does.
fn gradient(edited: &Edited, splat: usize) -> Option<&Mat3> {
    edited.gradients.get(splat).filter(|gradient| **gradient != Mat3::IDENTITY)
}

/// Turns the numbers of a splat; `some` is used for those that follow.
fn turn(following: &Following, gradient: &Mat3, mirrored: bool, numbers: &mut [f64], some: &mut Vec<f64>) {
    some.clear();
    some.extend(following.places().iter().map(|place| numbers[*place]));
    following.turn(gradient, mirrored, some);
    following.places().iter().zip(some).for_each(|(place, new)| numbers[*place] = *new);
}
