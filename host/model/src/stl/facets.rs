//! Facets of STL, binary and as text: their triangles, and their normals.

use std::ops::Range;

use glam::DVec3;

use crate::{CHUNK_TRIANGLES, FACES_OF_A_BLOCK, FaceChunk, FaceMark, FaceReader, Result};

/// Byte at which the first facet begins.
pub(super) const START: u64 = 84;

/// Bytes of a facet.
pub(super) const FACET: u64 = 50;

/// Normal of a facet with these corners, on the side of the corners where the file's normal is on that of the
/// corners at rest. `None` where the file's normal is to be kept: it is zero or not finite, or the corners
/// span no plane.
pub(super) fn normal(old: DVec3, rest: [DVec3; 3], moved: [DVec3; 3]) -> Option<DVec3> {
    let of = |[a, b, c]: [DVec3; 3]| {
        let (u, v) = (b - a, c - a);
        // Scaled, so that neither large nor small triangles leave the numbers' range.
        u.try_normalize().zip(v.try_normalize()).and_then(|(u, v)| u.cross(v).try_normalize())
    };
    if !old.is_finite() || old == DVec3::ZERO {
        return None;
    }
    let side = of(rest).map_or(1.0, |rest| if rest.dot(old) < 0.0 { -1.0 } else { 1.0 });
    of(moved).map(|moved| moved * side)
}

/// Triangles of facets, for which nothing has to be read. The place of a facet is its byte in a binary file;
/// for a text, the byte that it would have there.
pub(super) struct Facets {
    /// The ranges that are still to come.
    ranges: std::vec::IntoIter<Range<u64>>,
    range: Range<u64>,
    with_marks: bool,
}

impl Facets {
    /// A reader of all facets.
    pub(super) fn new(facets: u64) -> Self {
        Self { ranges: Vec::new().into_iter(), range: 0..facets, with_marks: true }
    }

    /// The facets from a mark on.
    pub(super) fn from(facets: u64, mark: u64) -> Self {
        let first = (mark.saturating_sub(START) / FACET).min(facets);
        Self { range: first..facets, ..Self::new(facets) }
    }

    /// The facets between some marks.
    pub(super) fn between(facets: u64, ranges: Vec<Range<u64>>) -> Self {
        let facet = |offset: u64| (offset.saturating_sub(START) / FACET).min(facets);
        let of_marks: Vec<_> = ranges.into_iter().map(|r| facet(r.start)..facet(r.end)).collect();
        Self { ranges: of_marks.into_iter(), range: 0..0, with_marks: false }
    }

    /// The byte at which a facet begins.
    pub(super) fn start(facet: u64) -> u64 {
        START + FACET * facet
    }

    fn mark(&self, triangle: usize) -> FaceMark {
        FaceMark { triangle, offset: Self::start(self.range.start) }
    }
}

impl FaceReader for Facets {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        chunk.clear();
        while chunk.triangles.len() < CHUNK_TRIANGLES {
            if self.range.is_empty() {
                let Some(next) = self.ranges.next() else { break };
                self.range = next;
                continue;
            }
            if self.with_marks && self.range.start.is_multiple_of(FACES_OF_A_BLOCK) {
                chunk.marks.push(self.mark(chunk.triangles.len()));
            }
            let corner = |i| u32::try_from(3 * self.range.start + i).unwrap_or(u32::MAX);
            chunk.triangles.push([0, 1, 2].map(corner));
            self.range.start += 1;
        }
        if self.with_marks && self.range.is_empty() && !chunk.triangles.is_empty() {
            chunk.marks.push(self.mark(chunk.triangles.len()));
        }
        chunk.bytes = FACET * chunk.triangles.len() as u64;
        Ok(!chunk.triangles.is_empty())
    }
}
