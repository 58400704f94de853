//! Writing a model's file anew, with other positions and normals.

use std::io;

use super::PlyModel;
use super::header::{DAMAGED, Encoding};
use super::reader::{CHUNK_BYTES, Reader};
use super::walk::{CUT_OFF, Walker};
use super::{ascii, binary};
use crate::model::pipeline::{Belt, Rewritable};
use crate::model::{VertexChunk, VertexReader};
use crate::{Error, ErrorKind, Result};

/// A vertex of a chunk whose edited position the file cannot hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unfit {
    pub(super) vertex: usize,
    pub(super) value: f64,
}

/// Whether a coordinate of a normal was left as it was. Any NaN is as good as another: keep the file's.
#[inline(always)]
pub(super) fn same_normal(old: f32, new: f32) -> bool {
    old.to_bits() == new.to_bits() || (old.is_nan() && new.is_nan())
}

impl Rewritable for PlyModel {
    fn read_pieces(&self, belt: &Belt) -> Result<()> {
        let mut at = 0;
        while at < self.vertices_start {
            let Some(mut piece) = belt.take() else { return Ok(()) };
            let wanted = (self.vertices_start - at).min(CHUNK_BYTES as u64) as usize;
            at += self.read_bytes(&mut piece, at, wanted)?;
            belt.give(piece);
        }

        let mut vertices = Reader::new(self, 0..self.info.vertices)?;
        loop {
            let Some(mut chunk) = belt.take() else { return Ok(()) };
            if !vertices.read(&mut chunk)? {
                break;
            }
            belt.give(chunk);
        }

        at = vertices.offset();
        let mut walker = Walker::new(&self.header.elements[self.vertex + 1..], self.header.encoding);
        while at < self.source.len() {
            let Some(mut piece) = belt.take() else { return Ok(()) };
            at += self.read_bytes(&mut piece, at, CHUNK_BYTES)?;
            // Once it is done, it takes nothing: what follows is copied without being looked at.
            walker.feed(&piece.raw).map_err(|what| self.source.malformed(what, DAMAGED))?;
            belt.give(piece);
        }
        walker.finish().map_err(|what| self.source.malformed(what, CUT_OFF))?;
        self.source.check_unchanged()
    }

    fn encode<'b>(&self, chunk: &'b mut VertexChunk, text: &'b mut Vec<u8>) -> Result<&'b [u8]> {
        let first = chunk.first;
        match self.header.encoding {
            Encoding::Ascii => {
                ascii::splice(&self.layout, chunk, text).map_err(|e| self.unfit(first, e))?;
                Ok(text)
            }
            Encoding::Little | Encoding::Big => {
                binary::patch(&self.layout, chunk).map_err(|e| self.unfit(first, e))?;
                Ok(&chunk.raw)
            }
        }
    }

    fn write_error(&self, error: &io::Error) -> Error {
        Error::io("write the new version of", self.source.path(), error)
    }
}

impl PlyModel {
    /// Makes `piece` up to `count` bytes of the file without vertices; returns how many it holds.
    fn read_bytes(&self, piece: &mut VertexChunk, at: u64, count: usize) -> Result<u64> {
        let VertexChunk { positions, normals, raw, spans, .. } = piece;
        positions.clear();
        normals.clear();
        spans.clear();
        raw.clear();
        Ok(self.source.append_at(raw, at, count)? as u64)
    }

    fn unfit(&self, first: u64, unfit: Unfit) -> Error {
        let (vertex, value) = (first + unfit.vertex as u64, unfit.value);
        let path = self.source.path().display();
        if value.is_finite() {
            let what =
                format!("{path}: vertex {vertex} moves to {value:e}, too far for the type float of the file");
            Error::new(
                ErrorKind::Degenerate,
                what,
                "move it less, or export the model with positions of type double",
            )
        } else {
            let what = format!("{path}: the deformation moves vertex {vertex} to {value}");
            Error::new(
                ErrorKind::Degenerate,
                what,
                "check the deformation: its steps have to give finite positions",
            )
        }
    }
}
