//! Writing a model's file anew, with other positions and normals, or without normals.

use super::binary::Rest;
use super::file::PlyModel;
use super::header::{DAMAGED, Encoding};
use super::reader::{CHUNK_BYTES, PlyReader};
use super::walk::{CUT_OFF, Walker};
use super::{ascii, binary};
use crate::pipeline::{Piece, PieceVersion, Pieces, Rewritable, Skipped};
use crate::source::SourceFile;
use crate::{Division, Error, Normals, Result, VertexChunk};

impl Rewritable for PlyModel {
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(PlyPieces {
            model: self,
            drop_normals: normals == Normals::Drop && self.layout.has_normals(),
            at: 0,
            vertices: PlyReader::new(self, 0..self.info.vertices)?,
            walker: None,
        }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = !self.following.is_empty();
        PlyModel::decode(self, chunk)
    }

    fn encode(&self, chunk: &mut VertexChunk, mut version: PieceVersion<'_>) -> Result<()> {
        let (first, edited) = (chunk.first, version.edited);
        let drop_normals = version.normals == Normals::Drop && self.layout.has_normals();
        if self.header.encoding == Encoding::Ascii {
            version.bytes.clear();
            return ascii::splice(&self.layout, &self.following, chunk, edited, drop_normals, version.bytes)
                .map_err(|unfit| unfit.in_floats(&self.source, first));
        }
        let VertexChunk { positions, normals, raw, spans, .. } = chunk;
        let rest = Rest { positions, normals, spans };
        let bytes = version.begin_with(raw);
        binary::patch(&self.layout, rest, edited, bytes)
            .map_err(|unfit| unfit.in_floats(&self.source, first))?;
        if !edited.gradients.is_empty() {
            binary::turn(&self.layout, &self.following, rest, edited, bytes);
        }
        if drop_normals {
            binary::cut_normals(&self.layout, spans, bytes);
        }
        Ok(())
    }

    fn division(&self, normals: Normals) -> Option<Division> {
        let before = self.pieces_before(normals);
        let per_piece = PlyReader::fixed_chunk(self.layout.stride?);
        let vertices = before..before + self.info.vertices.div_ceil(per_piece);
        let behind = self.source.len().saturating_sub(self.vertices_end()?);
        let in_place = !(normals == Normals::Drop && self.layout.has_normals());
        let pieces = vertices.end + behind.div_ceil(CHUNK_BYTES as u64);
        Some(Division { pieces, vertices, in_place })
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

/// Pieces of a PLY file: the header, if it becomes another one without normals, the bytes before the
/// vertices, the vertices, and the bytes behind them.
struct PlyPieces<'a> {
    model: &'a PlyModel,
    /// The header is to be read, and goes out without normals.
    drop_normals: bool,
    /// Byte of the file at which the next bytes without vertices begin.
    at: u64,
    vertices: PlyReader<'a>,
    /// Check, once the vertices are read, that all is there that the header announces behind them.
    walker: Option<Walker>,
}

impl Pieces for PlyPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        Ok(self.read_several(chunk, 1)?.0)
    }

    fn read_several(&mut self, chunk: &mut VertexChunk, most: u64) -> Result<(Piece, u64)> {
        let PlyModel { header, vertices_start, source, .. } = self.model;
        if std::mem::take(&mut self.drop_normals) {
            self.at = self.model.read_bytes(chunk, 0, header.len as usize)?;
            chunk.raw = (self.model.without_normals)(&chunk.raw);
            return Ok((Piece::Bytes, 1));
        }
        if self.at < *vertices_start {
            let wanted = (vertices_start - self.at).min(CHUNK_BYTES as u64) as usize;
            self.at += self.model.read_bytes(chunk, self.at, wanted)?;
            return Ok((Piece::Bytes, 1));
        }
        let walker = match &mut self.walker {
            Some(walker) => walker,
            None => {
                let (vertices, pieces) = self.vertices.read_pieces(chunk, most)?;
                if vertices > 0 {
                    return Ok((Piece::Vertices(vertices), pieces));
                }
                self.at = self.vertices.offset();
                let after = &header.elements[self.model.vertex + 1..];
                self.walker.insert(Walker::new(after, header.encoding))
            }
        };
        if self.at < source.len() {
            self.at += self.model.read_bytes(chunk, self.at, CHUNK_BYTES)?;
            // A walker that is done takes nothing: further bytes are copied without being checked.
            walker.feed(&chunk.raw).map_err(|what| source.malformed(what, DAMAGED))?;
            return Ok((Piece::Bytes, 1));
        }
        walker.finish().map_err(|what| source.malformed(what, CUT_OFF))?;
        source.check_unchanged()?;
        Ok((Piece::End, 1))
    }

    fn skip(&mut self, pieces: u64) -> Result<Skipped> {
        let model = self.model;
        let normals = if self.drop_normals { Normals::Drop } else { Normals::Keep };
        let (Some(Division { vertices, .. }), Some(stride)) = (model.division(normals), model.layout.stride)
        else {
            return Err(Error::internal("a PLY file that cannot be divided was divided"));
        };
        if pieces < vertices.start {
            for _ in 0..pieces {
                self.read(&mut VertexChunk::default())?;
            }
            return Ok(Skipped { bytes: self.at, vertex_bytes: 0 });
        }
        self.drop_normals = false;
        self.at = model.vertices_start;
        let first = (pieces.min(vertices.end) - vertices.start) * PlyReader::fixed_chunk(stride);
        let first = first.min(model.info.vertices);
        self.vertices = PlyReader::new(model, first..model.info.vertices)?;
        if pieces >= vertices.end {
            self.at = self.vertices.offset() + (pieces - vertices.end) * CHUNK_BYTES as u64;
            self.at = self.at.min(model.source.len());
            // Nothing that is behind it is looked at: it cannot be known where elements begin.
            self.walker = Some(Walker::new(&[], model.header.encoding));
        }
        let bytes = if pieces >= vertices.end { self.at } else { self.vertices.offset() };
        Ok(Skipped { bytes, vertex_bytes: first * stride as u64 })
    }
}

impl PlyModel {
    /// Number of pieces before the vertices.
    fn pieces_before(&self, normals: Normals) -> u64 {
        let cut = normals == Normals::Drop && self.layout.has_normals();
        let (header, from) = if cut { (1, self.header.len) } else { (0, 0) };
        header + (self.vertices_start - from).div_ceil(CHUNK_BYTES as u64)
    }

    /// Byte at which the vertices end, if all are of one length.
    fn vertices_end(&self) -> Option<u64> {
        let bytes = self.info.vertices.checked_mul(self.layout.stride? as u64)?;
        self.vertices_start.checked_add(bytes)
    }

    /// Makes `piece` up to `count` bytes of the file without vertices; returns how many it holds.
    fn read_bytes(&self, piece: &mut VertexChunk, at: u64, count: usize) -> Result<u64> {
        let VertexChunk { positions, normals, raw, spans, .. } = piece;
        positions.clear();
        normals.clear();
        spans.clear();
        raw.clear();
        Ok(self.source.append_at(raw, at, count)? as u64)
    }
}
