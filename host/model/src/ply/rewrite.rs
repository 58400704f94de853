//! Writing a model's file anew, with other positions and normals, or without normals.

use std::io;

use super::file::PlyModel;
use super::header::{DAMAGED, Encoding};
use super::patch::{Rest, Unfit};
use super::reader::{CHUNK_BYTES, Reader};
use super::walk::{CUT_OFF, Walker};
use super::{ascii, binary};
use crate::pipeline::{Piece, Pieces, Rewritable};
use crate::{Edited, Error, ErrorKind, Normals, Result, Summary, VertexChunk};

impl Rewritable for PlyModel {
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(PlyPieces {
            model: self,
            drop_normals: normals == Normals::Drop && self.layout.has_normals(),
            at: 0,
            vertices: Reader::new(self, 0..self.info.vertices)?,
            walker: None,
        }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        PlyModel::decode(self, chunk)
    }

    fn encode(
        &self,
        chunk: &mut VertexChunk,
        edited: &Edited,
        normals: Normals,
        last: bool,
        buffer: &mut Vec<u8>,
        _summary: &mut Summary,
    ) -> Result<bool> {
        let first = chunk.first;
        let drop_normals = normals == Normals::Drop && self.layout.has_normals();
        if self.header.encoding == Encoding::Ascii {
            buffer.clear();
            ascii::splice(&self.layout, chunk, edited, drop_normals, buffer)
                .map_err(|e| self.unfit(first, e))?;
            return Ok(true);
        }
        let VertexChunk { positions, normals, raw, spans, .. } = chunk;
        let rest = Rest { positions, normals, spans };
        let bytes = if last {
            raw
        } else {
            buffer.clone_from(raw);
            buffer
        };
        binary::patch(&self.layout, rest, edited, bytes).map_err(|e| self.unfit(first, e))?;
        if drop_normals {
            binary::cut_normals(&self.layout, spans, bytes);
        }
        Ok(!last)
    }

    fn write_error(&self, error: &io::Error) -> Error {
        Error::io("write the new version of", self.source.path(), error)
    }
}

/// The pieces of a PLY file: the header, if it is another one without normals, what comes before the
/// vertices, the vertices, and what comes after them.
struct PlyPieces<'a> {
    model: &'a PlyModel,
    /// The header is to be read, and goes out without normals.
    drop_normals: bool,
    /// Where the next bytes without vertices are.
    at: u64,
    vertices: Reader<'a>,
    /// What looks whether all is there that the header speaks of after the vertices, once these are read.
    walker: Option<Walker>,
}

impl Pieces for PlyPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let PlyModel { header, vertices_start, source, .. } = self.model;
        if std::mem::take(&mut self.drop_normals) {
            self.at = self.model.read_bytes(chunk, 0, header.len as usize)?;
            chunk.raw = (self.model.without_normals)(&chunk.raw);
            return Ok(Piece::Bytes);
        }
        if self.at < *vertices_start {
            let wanted = (vertices_start - self.at).min(CHUNK_BYTES as u64) as usize;
            self.at += self.model.read_bytes(chunk, self.at, wanted)?;
            return Ok(Piece::Bytes);
        }
        let walker = match &mut self.walker {
            Some(walker) => walker,
            None => {
                let vertices = self.vertices.read_bytes(chunk)?;
                if vertices > 0 {
                    return Ok(Piece::Vertices(vertices));
                }
                self.at = self.vertices.offset();
                let after = &header.elements[self.model.vertex + 1..];
                self.walker.insert(Walker::new(after, header.encoding))
            }
        };
        if self.at < source.len() {
            self.at += self.model.read_bytes(chunk, self.at, CHUNK_BYTES)?;
            // Once it is done, it takes nothing: what follows is copied without being looked at.
            walker.feed(&chunk.raw).map_err(|what| source.malformed(what, DAMAGED))?;
            return Ok(Piece::Bytes);
        }
        walker.finish().map_err(|what| source.malformed(what, CUT_OFF))?;
        source.check_unchanged()?;
        Ok(Piece::End)
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
