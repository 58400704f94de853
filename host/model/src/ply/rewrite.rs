//! Writing a model's file anew, with other positions and normals, or without normals.

use std::io;

use super::file::PlyModel;
use super::header::{self, DAMAGED, Encoding};
use super::patch::{Rest, Unfit};
use super::reader::{CHUNK_BYTES, Reader};
use super::walk::{CUT_OFF, Walker};
use super::{ascii, binary};
use crate::pipeline::{Belt, Rewritable};
use crate::{Edited, Error, ErrorKind, Normals, Result, VertexChunk, VertexReader};

impl Rewritable for PlyModel {
    fn read_pieces(&self, belt: &Belt, normals: Normals) -> Result<()> {
        let mut at = 0;
        if normals == Normals::Drop && self.layout.has_normals() {
            let Some(mut piece) = belt.take() else { return Ok(()) };
            at = self.read_bytes(&mut piece.chunk, 0, self.header.len as usize)?;
            piece.chunk.raw = header::without_normals(&piece.chunk.raw);
            belt.give(piece);
        }
        while at < self.vertices_start {
            let Some(mut piece) = belt.take() else { return Ok(()) };
            let wanted = (self.vertices_start - at).min(CHUNK_BYTES as u64) as usize;
            at += self.read_bytes(&mut piece.chunk, at, wanted)?;
            belt.give(piece);
        }

        let mut vertices = Reader::new(self, 0..self.info.vertices)?;
        loop {
            let Some(mut piece) = belt.take() else { return Ok(()) };
            if !vertices.read(&mut piece.chunk)? {
                break;
            }
            belt.give(piece);
        }

        at = vertices.offset();
        let mut walker = Walker::new(&self.header.elements[self.vertex + 1..], self.header.encoding);
        while at < self.source.len() {
            let Some(mut piece) = belt.take() else { return Ok(()) };
            at += self.read_bytes(&mut piece.chunk, at, CHUNK_BYTES)?;
            // Once it is done, it takes nothing: what follows is copied without being looked at.
            walker.feed(&piece.chunk.raw).map_err(|what| self.source.malformed(what, DAMAGED))?;
            belt.give(piece);
        }
        walker.finish().map_err(|what| self.source.malformed(what, CUT_OFF))?;
        self.source.check_unchanged()
    }

    fn encode<'b>(
        &self,
        chunk: &'b mut VertexChunk,
        edited: &Edited,
        normals: Normals,
        last: bool,
        buffer: &'b mut Vec<u8>,
    ) -> Result<&'b [u8]> {
        let first = chunk.first;
        let drop_normals = normals == Normals::Drop && self.layout.has_normals();
        if self.header.encoding == Encoding::Ascii {
            ascii::splice(&self.layout, chunk, edited, drop_normals, buffer)
                .map_err(|e| self.unfit(first, e))?;
            return Ok(buffer);
        }
        let VertexChunk { positions, normals, raw, spans, .. } = chunk;
        let rest = Rest { positions, normals, spans };
        let bytes = if last {
            raw
        } else {
            buffer.extend_from_slice(raw);
            buffer
        };
        binary::patch(&self.layout, rest, edited, bytes).map_err(|e| self.unfit(first, e))?;
        if drop_normals {
            binary::cut_normals(&self.layout, spans, bytes);
        }
        Ok(bytes)
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
