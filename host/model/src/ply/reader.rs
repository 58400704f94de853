//! Reads consecutive vertices, a chunk at a time, from any vertex on.

use std::ops::Range;

use super::file::PlyModel;
use super::header::{DAMAGED, Encoding};
use super::walk::CUT_OFF;
use super::{ascii, binary};
use crate::{CHUNK_VERTICES, Error, Result, VertexChunk, VertexReader, memory};

/// A chunk ends with the vertex that reaches this many bytes, however few vertices that are.
pub(super) const CHUNK_BYTES: usize = 4 << 20;

/// Most bytes of several chunks that are read as one.
const SEVERAL_BYTES: u64 = 8 << 20;

/// Longest vertex record. Only a list, or a word without end, makes a longer one.
const MAX_RECORD: usize = 16 << 20;

/// Bytes that are read at a time where the length of records is not known.
const BLOCK: usize = 1 << 18;

/// Reads the vertices of a range.
pub(super) struct PlyReader<'a> {
    model: &'a PlyModel,
    /// The vertices that are still to be read.
    range: Range<u64>,
    /// Most vertices of a chunk.
    chunk: usize,
    /// Byte of the file at which the next vertex begins.
    offset: u64,
    /// Bytes of the file from `offset` on that were read ahead, where records differ in length: at most
    /// `BLOCK` bytes, or about a record if that is more.
    ahead: Vec<u8>,
}

impl<'a> PlyReader<'a> {
    pub(super) fn new(model: &'a PlyModel, range: Range<u64>) -> Result<Self> {
        let end = range.end.min(model.info.vertices);
        let range = range.start.min(end)..end;
        if let Some(stride) = model.layout.stride {
            let offset = model.vertices_start + range.start * stride as u64;
            return Ok(Self { model, range, chunk: CHUNK_VERTICES, offset, ahead: Vec::new() });
        }
        let (vertex, offset) = model.offsets.before(range.start).unwrap_or((0, model.vertices_start));
        let chunk = CHUNK_VERTICES;
        let mut reader = Self { model, range: vertex..end, chunk, offset, ahead: Vec::new() };
        let mut skipped = VertexChunk::default();
        while reader.range.start < range.start {
            reader.scan(&mut skipped, range.start - reader.range.start)?;
        }
        Ok(reader)
    }

    /// Number of vertices of a whole chunk, where all have a length of `stride`.
    pub(super) fn fixed_chunk(stride: usize) -> u64 {
        CHUNK_VERTICES.min((CHUNK_BYTES / stride).max(1)) as u64
    }

    /// Byte of the file at which the next vertex begins; after the last vertex, the end of the vertices.
    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    /// Reads the bytes of the next `limit` vertices, which all have a length of `stride`.
    fn read_fixed(&mut self, chunk: &mut VertexChunk, stride: usize, limit: u64) -> Result<()> {
        let bytes = limit as usize * stride;
        memory::resize(&mut chunk.raw, bytes);
        if self.model.source.read_at(&mut chunk.raw, self.offset)? < bytes {
            return Err(self.ends_early(self.range.start));
        }
        self.range.start += limit;
        self.offset += bytes as u64;
        Ok(())
    }

    /// Reads the bytes of the next vertices, at most `limit`, and finds the numbers in them.
    fn scan(&mut self, chunk: &mut VertexChunk, limit: u64) -> Result<()> {
        let model = self.model;
        let components = model.layout.components.len();
        let limit = limit.min(CHUNK_VERTICES as u64) as usize;
        // A record has a byte at least for each of its properties.
        let limit = limit.min(CHUNK_BYTES / model.layout.slots.len().max(1) + 1);
        let VertexChunk { raw, spans, .. } = chunk;
        raw.clear();
        raw.append(&mut self.ahead);
        spans.resize(limit * components, [0; 2]);
        let (mut count, mut parsed) = (0, 0);
        let mut whole_file = self.offset + raw.len() as u64 == model.source.len();
        while count < limit && parsed < CHUNK_BYTES {
            let (bytes, spans) = (&raw[parsed..], &mut spans[count * components..]);
            let length = match model.layout.encoding {
                Encoding::Ascii => ascii::scan(&model.layout, bytes, parsed, whole_file, spans),
                Encoding::Little | Encoding::Big => binary::scan(&model.layout, bytes, parsed, spans),
            };
            let vertex = self.range.start + count as u64;
            match length {
                Ok(Some(length)) => {
                    parsed += length;
                    count += 1;
                }
                Ok(None) if whole_file => return Err(self.ends_early(vertex)),
                Ok(None) if bytes.len() >= MAX_RECORD => {
                    let what = format!("vertex {vertex} takes more than {} MiB", MAX_RECORD >> 20);
                    return Err(model.source.malformed(what, DAMAGED));
                }
                Ok(None) => {
                    // Twice as much each time, so that a long record is not gone over too often.
                    let more = bytes.len().max(BLOCK);
                    model.source.append_at(raw, self.offset + raw.len() as u64, more)?;
                    whole_file = self.offset + raw.len() as u64 == model.source.len();
                }
                Err(length) => {
                    let what = format!("vertex {vertex}: a list of length {length}");
                    return Err(model.source.malformed(what, DAMAGED));
                }
            }
        }
        self.ahead.extend_from_slice(&raw[parsed..]);
        raw.truncate(parsed);
        spans.truncate(count * components);
        self.range.start += count as u64;
        self.offset += parsed as u64;
        model.offsets.note(self.range.start, self.offset);
        Ok(())
    }

    /// Reads the bytes of the next vertices into `chunk`, and the places of their numbers; returns the number
    /// of these vertices, 0 at the end. The rest of the chunk is meaningless until it is
    /// [decoded](PlyModel::decode).
    pub(super) fn read_bytes(&mut self, chunk: &mut VertexChunk) -> Result<usize> {
        chunk.first = self.range.start;
        let limit = (self.range.end - self.range.start).min(self.chunk as u64);
        match self.model.layout.stride {
            _ if limit == 0 => {
                chunk.raw.clear();
                chunk.spans.clear();
            }
            Some(stride) => {
                chunk.spans.clear();
                self.read_fixed(chunk, stride, limit.min((CHUNK_BYTES / stride).max(1) as u64))?;
            }
            None => self.scan(chunk, limit)?,
        }
        Ok((self.range.start - chunk.first) as usize)
    }

    /// Reads the bytes of up to `most` whole chunks as one, where all vertices have the same length: how many
    /// vertices these are, and how many chunks they would be. At most [`SEVERAL_BYTES`], or one chunk.
    pub(super) fn read_pieces(&mut self, chunk: &mut VertexChunk, most: u64) -> Result<(usize, u64)> {
        let Some(stride) = self.model.layout.stride.filter(|_| most > 1) else {
            return Ok((self.read_bytes(chunk)?, 1));
        };
        let of_piece = Self::fixed_chunk(stride);
        let most = most.min(SEVERAL_BYTES / (of_piece * stride as u64)).max(1);
        let vertices = (self.range.end - self.range.start).min(most * of_piece);
        chunk.first = self.range.start;
        chunk.spans.clear();
        self.read_fixed(chunk, stride, vertices)?;
        Ok((vertices as usize, vertices.div_ceil(of_piece).max(1)))
    }

    fn ends_early(&self, vertex: u64) -> Error {
        let what = format!("the file ends within vertex {vertex} of {}", self.model.info.vertices);
        self.model.source.malformed(what, CUT_OFF)
    }
}

impl PlyModel {
    /// Fills a chunk's positions and normals from its bytes.
    pub(super) fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        match self.layout.encoding {
            Encoding::Little | Encoding::Big => binary::decode(&self.layout, chunk),
            Encoding::Ascii => ascii::decode(&self.layout, chunk).map_err(|e| {
                let vertex = chunk.first + e.vertex as u64;
                let what = format!("vertex {vertex}: {} {}", e.property, e.what);
                self.source.malformed(what, e.hint)
            })?,
        }
        Ok(())
    }
}

impl VertexReader for PlyReader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES);
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let is_more = self.read_bytes(chunk)? > 0;
        self.model.decode(chunk)?;
        Ok(is_more)
    }
}
