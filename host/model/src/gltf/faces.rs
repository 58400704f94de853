//! The triangles of all primitives, one behind the other.

use std::ops::Range;

use super::file::GltfModel;
use super::layout::{DrawnPrimitive, FACE, PrimitiveMode};
use crate::{CHUNK_TRIANGLES, FACES_OF_A_BLOCK, FaceChunk, FaceMark, FaceReader, Result};

/// Reads some of the triangles.
pub(super) struct GltfFaces<'a> {
    model: &'a GltfModel,
    /// The ranges that are still to come.
    ranges: std::vec::IntoIter<Range<u64>>,
    range: Range<u64>,
    with_marks: bool,
    /// Bytes of indices, and indices.
    raw: Vec<u8>,
    corners: Vec<u32>,
}

impl<'a> GltfFaces<'a> {
    /// A reader of all faces.
    pub(super) fn new(model: &'a GltfModel) -> Self {
        let (ranges, range) = (Vec::new().into_iter(), 0..model.layout.triangles);
        Self { model, ranges, range, with_marks: true, raw: Vec::new(), corners: Vec::new() }
    }

    /// The faces between some marks.
    pub(super) fn between(model: &'a GltfModel, ranges: Vec<Range<u64>>) -> Self {
        let face = |offset: u64| (offset / FACE).min(model.layout.triangles);
        let of_marks: Vec<_> = ranges.into_iter().map(|r| face(r.start)..face(r.end)).collect();
        Self { ranges: of_marks.into_iter(), range: 0..0, with_marks: false, ..Self::new(model) }
    }

    /// Adds the next triangles of one primitive.
    fn add(&mut self, triangles: &mut Vec<[u32; 3]>) -> Result<()> {
        let model = self.model;
        let drawn = &model.layout.drawn;
        let index = drawn.partition_point(|drawn| drawn.first + drawn.triangles <= self.range.start);
        let Some(of) = drawn.get(index) else {
            self.range.start = self.range.end;
            return Ok(());
        };
        let room = (CHUNK_TRIANGLES - triangles.len()) as u64;
        let start = self.range.start - of.first;
        let end = (self.range.end - of.first).min(of.triangles).min(start + room);
        self.range.start = of.first + end;
        let count = (end - start) as usize;
        let corners = match of.mode {
            PrimitiveMode::Triangles => 3 * start..3 * end,
            PrimitiveMode::Strip => start..end + 2,
            // The first one has a place of its own.
            PrimitiveMode::Fan => start + 1..end + 2,
            PrimitiveMode::Other => return Ok(()),
        };
        self.corners.clear();
        if of.mode == PrimitiveMode::Fan {
            self.read(of, 0..1)?;
        }
        self.read(of, corners)?;
        let at = |i: usize| self.corners.get(i).copied().unwrap_or(u32::MAX);
        triangles.extend((0..count).map(|i| {
            let [a, b, c] = match of.mode {
                PrimitiveMode::Strip if (start as usize + i) % 2 == 1 => [i, i + 2, i + 1],
                PrimitiveMode::Strip => [i, i + 1, i + 2],
                PrimitiveMode::Fan => [i + 1, i + 2, 0],
                _ => [3 * i, 3 * i + 1, 3 * i + 2],
            };
            // Seen in a mirror, they go round the other way.
            if of.is_mirrored { [at(a), at(c), at(b)] } else { [at(a), at(b), at(c)] }
        }));
        Ok(())
    }

    /// Adds the vertices of some corners of a primitive.
    fn read(&mut self, of: &DrawnPrimitive, corners: Range<u64>) -> Result<()> {
        let model = self.model;
        let set = &model.layout.sets[of.set];
        let vertex = |index: u64| {
            let vertex = if index < set.place.count { set.first + index } else { u64::MAX };
            u32::try_from(vertex).unwrap_or(u32::MAX)
        };
        let Some(place) = of.indices else {
            self.corners.extend(corners.map(vertex));
            return Ok(());
        };
        self.model.container.read(&mut self.raw, place.bytes(corners))?;
        let [stride, size] = [place.stride, place.size].map(|n| n as usize);
        self.corners.extend(self.raw.chunks(stride).map(|bytes| {
            let mut index = [0; 8];
            let bytes = &bytes[..size.min(bytes.len())];
            index[..bytes.len()].copy_from_slice(bytes);
            vertex(u64::from_le_bytes(index))
        }));
        Ok(())
    }

    fn mark(&self, triangle: usize) -> FaceMark {
        FaceMark { triangle, offset: FACE * self.range.start }
    }
}

impl FaceReader for GltfFaces<'_> {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        chunk.clear();
        let FaceChunk { triangles, marks, bytes, .. } = chunk;
        while triangles.len() < CHUNK_TRIANGLES {
            if self.range.is_empty() {
                let Some(next) = self.ranges.next() else { break };
                self.range = next;
                continue;
            }
            let (first, before) = (self.range.start, triangles.len());
            self.add(triangles)?;
            if self.with_marks {
                let of_blocks =
                    (first..self.range.start).filter(|face| face.is_multiple_of(FACES_OF_A_BLOCK));
                marks.extend(of_blocks.map(|face| FaceMark {
                    triangle: before + (face - first) as usize,
                    offset: FACE * face,
                }));
            }
        }
        if self.with_marks && self.range.is_empty() && !triangles.is_empty() {
            marks.push(self.mark(triangles.len()));
        }
        *bytes = FACE * triangles.len() as u64;
        Ok(!triangles.is_empty())
    }
}
