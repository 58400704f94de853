//! Models whose normals do not stand beside their vertices: the same number of them in the same order, but
//! elsewhere in the file.
//!
//! A chunk's bytes are those of its vertices. Where normals are written, the positions that go with them are
//! read once more.

use std::ops::Range;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::grammar::Obj;
use super::lines::{ENDS, Statement, values};
use crate::cache::Cache;
use crate::pipeline::{Piece, PieceVersion, Pieces, Rewritable};
use crate::source::SourceFile;
use crate::text::blocks::{BlockReader, TextBlocks, changed};
use crate::text::digits::{Digits, Survey};
use crate::text::lines::{lines, wrong_line};
use crate::text::model::{Grammar, TextModel, splice_normal};
use crate::text::{DAMAGED, coordinate, no_normal};
use crate::{CHUNK_VERTICES, Error, Model, Normals, Result, Scalar, VertexChunk, VertexReader};

/// Bytes that are copied at once.
const COPIED: u64 = 4 << 20;

/// Data needed to find out which vertices use which normal.
#[derive(Debug)]
pub(super) struct Sharing {
    /// Corners that may name a normal, at most.
    pub corners: u64,
    pub cache: Arc<Cache>,
}

/// Model, with its normals if they stand apart from the vertices.
pub(super) struct ApartModel {
    pub(super) model: TextModel<Obj>,
    pub(super) normals: Option<TextBlocks>,
    pub(super) digits: Digits,
    /// Data to resolve the normals of corners, which share them.
    pub(super) sharing: Option<Sharing>,
    /// Normals of corners, which are not read.
    pub(super) of_corners: u64,
}

/// Byte behind the first `count` normals, if there are as many.
fn cut(bytes: &[u8], count: u64) -> Option<usize> {
    if count == 0 {
        return Some(0);
    }
    let is_normal = |line: &(usize, usize)| Statement::parse(&bytes[line.0..line.1]) == Statement::Normal;
    lines(bytes, ENDS).filter(is_normal).nth(count as usize - 1).map(|(_, end)| end)
}

impl ApartModel {
    /// Model without normals apart from the vertices, and with so many normals of corners, which are not
    /// read.
    pub(super) fn without(model: TextModel<Obj>, of_corners: u64) -> Self {
        Self { model, normals: None, digits: Digits::default(), sharing: None, of_corners }
    }

    pub(super) fn new(
        mut model: TextModel<Obj>,
        normals: TextBlocks,
        sharing: Option<Sharing>,
    ) -> Result<Self> {
        const OF_A_BLOCK: u64 = 64;
        let (mut survey, mut raw) = (Survey::default(), Vec::new());
        for (_, bytes) in normals.spread(32) {
            raw.clear();
            model.source.append_at(&mut raw, bytes.start, (bytes.end - bytes.start) as usize)?;
            let end = cut(&raw, OF_A_BLOCK).unwrap_or(raw.len());
            let of_normals = lines(&raw[..end], ENDS).map(|(a, b)| &raw[a..b]);
            for line in of_normals.filter(|line| Statement::parse(line) == Statement::Normal) {
                values(line).take(3).enumerate().for_each(|(c, (a, b))| survey.take(c, &line[a..b]));
            }
        }
        model.info.has_normals = sharing.is_none();
        Ok(Self { model, normals: Some(normals), digits: survey.digits(Some(1.0)), sharing, of_corners: 0 })
    }

    /// A reader of some vertices, with their normals.
    pub(super) fn reader(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        let vertices = self.model.vertices(range.clone())?;
        let Some(blocks) = self.normals.as_ref().filter(|_| self.sharing.is_none()) else {
            return Ok(vertices);
        };
        let normals = BlockReader::new(&self.model.source, blocks, range);
        let (raw, spans, ahead, some) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Ok(Box::new(ObjReader { model: self, vertices, normals, raw, spans, ahead, some }))
    }

    /// Reads the normals in some bytes, which hold so many, and their places.
    pub(super) fn decode_normals(
        &self,
        raw: &[u8],
        first: u64,
        wanted: usize,
        normals: &mut Vec<Vec3>,
        spans: &mut Vec<[u32; 2]>,
    ) -> Result<()> {
        normals.clear();
        spans.clear();
        for (start, end) in lines(raw, ENDS) {
            let line = &raw[start..end];
            if Statement::parse(line) != Statement::Normal {
                continue;
            }
            let (mut normal, mut words) = (DVec3::ZERO, values(line));
            for c in 0..3 {
                let (a, b) = words.next().unwrap_or_default();
                let Some(value) = coordinate(Scalar::F64, &line[a..b]) else {
                    return Err(self.wrong_normal(first + normals.len() as u64, &line[a..b]));
                };
                normal[c] = value;
                spans.push([start + a, start + b].map(|at| at as u32));
            }
            normals.push(normal.as_vec3());
        }
        if normals.len() == wanted { Ok(()) } else { Err(changed(&self.model.source)) }
    }

    fn wrong_normal(&self, normal: u64, word: &[u8]) -> Error {
        let (what, hint) = if word.is_empty() {
            (format!("normal {normal} has fewer than 3 numbers"), DAMAGED)
        } else {
            let (what, hint) = no_normal(Scalar::F64, word);
            (format!("normal {normal}: {what}"), hint)
        };
        let source = &self.model.source;
        let Some(blocks) = &self.normals else { return source.malformed(what, hint) };
        let Some((of_block, bytes)) = blocks.spread(usize::MAX).find(|(of, _)| of.contains(&normal)) else {
            return source.malformed(what, hint);
        };
        let mut raw = Vec::new();
        if let Err(error) = source.append_at(&mut raw, bytes.start, (bytes.end - bytes.start) as usize) {
            return error;
        }
        let end = cut(&raw, normal - of_block.start + 1).unwrap_or(raw.len());
        let in_line = raw[..end].trim_ascii_end().len().saturating_sub(1) as u64;
        wrong_line(source, bytes.start + in_line, what, hint)
    }
}

/// Reads vertices, and beside them their normals.
struct ObjReader<'a> {
    model: &'a ApartModel,
    vertices: Box<dyn VertexReader + 'a>,
    normals: BlockReader<'a>,
    raw: Vec<u8>,
    spans: Vec<[u32; 2]>,
    /// The normals that were read and are not given yet, and some of a chunk.
    ahead: Vec<Vec3>,
    some: Vec<Vec3>,
}

impl VertexReader for ObjReader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.vertices.set_chunk(vertices);
        self.normals.set_chunk(vertices);
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let is_more = self.vertices.read(chunk)?;
        while self.ahead.len() < chunk.len() {
            let first = self.normals.next_vertex();
            let read = self.normals.read(&mut self.raw, cut)?;
            if read == 0 {
                return Err(changed(&self.model.model.source));
            }
            self.model.decode_normals(&self.raw, first, read as usize, &mut self.some, &mut self.spans)?;
            self.ahead.append(&mut self.some);
        }
        chunk.normals.clear();
        chunk.normals.extend(self.ahead.drain(..chunk.positions.len()));
        Ok(is_more)
    }
}

impl Rewritable for ApartModel {
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(ApartPieces::new(self, normals, CHUNK_VERTICES)))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        let count = chunk.spans.len();
        if !chunk.of_normals {
            return self.model.decode(chunk, count);
        }
        let first = chunk.first;
        let mut reader = self.model.vertices(first..first + count as u64)?;
        let mut of_vertices = VertexChunk::default();
        chunk.positions.clear();
        while reader.read(&mut of_vertices)? {
            chunk.positions.extend_from_slice(&of_vertices.positions);
        }
        let VertexChunk { raw, normals, spans, .. } = chunk;
        self.decode_normals(raw, first, count, normals, spans)
    }

    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()> {
        if !chunk.of_normals {
            return self.model.encode(chunk, version);
        }
        let PieceVersion { edited, bytes, .. } = version;
        let VertexChunk { positions, normals, raw, spans, .. } = chunk;
        let mut copied = 0;
        bytes.clear();
        let vertices = positions.iter().zip(normals).zip(&edited.normals).zip(spans.chunks_exact(3));
        for (((position, old), new), spans) in vertices {
            if position.is_finite() {
                splice_normal(raw, spans, (*old, *new), &self.digits, &mut copied, bytes);
            }
        }
        bytes.extend_from_slice(&raw[copied..]);
        Ok(())
    }

    fn source(&self) -> &SourceFile {
        self.model.source()
    }
}

/// The file in its order: vertices, normals, and what is between them.
pub(super) struct ApartPieces<'a> {
    model: &'a ApartModel,
    at: u64,
    vertices: BlockReader<'a>,
    /// Reader of the normals; none if they are copied.
    normals: Option<BlockReader<'a>>,
}

impl<'a> ApartPieces<'a> {
    /// Pieces with at most so many normals in a chunk.
    pub(super) fn new(model: &'a ApartModel, normals: Normals, chunk: usize) -> Self {
        let of = |blocks| BlockReader::new(&model.model.source, blocks, 0..u64::MAX);
        let mut of_normals = model.normals.as_ref().filter(|_| normals == Normals::Transform).map(of);
        of_normals.iter_mut().for_each(|reader| reader.set_chunk(chunk));
        Self { model, at: 0, vertices: of(&model.model.blocks), normals: of_normals }
    }
}

impl Pieces for ApartPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let TextModel { source, grammar, .. } = &self.model.model;
        let vertices_at = self.vertices.next_start().unwrap_or(source.len());
        let normals_at = self.normals.as_ref().and_then(BlockReader::next_start).unwrap_or(source.len());
        let next = vertices_at.min(normals_at);
        chunk.spans.clear();
        if self.at < next {
            chunk.raw.clear();
            let wanted = (next - self.at).min(COPIED) as usize;
            self.at += source.append_at(&mut chunk.raw, self.at, wanted)? as u64;
            return Ok(Piece::Bytes);
        }
        if next == source.len() {
            source.check_unchanged()?;
            return Ok(Piece::End);
        }
        chunk.of_normals = normals_at == next;
        let reader = if chunk.of_normals { self.normals.as_mut() } else { None };
        let count = match reader {
            Some(reader) => {
                chunk.first = reader.next_vertex();
                reader.read(&mut chunk.raw, cut)?
            }
            None => {
                chunk.first = self.vertices.next_vertex();
                self.vertices.read(&mut chunk.raw, |bytes, n| grammar.cut(bytes, n))?
            }
        };
        self.at += chunk.raw.len() as u64;
        chunk.spans.resize(count as usize, [0; 2]);
        Ok(if chunk.of_normals { Piece::Normals } else { Piece::Vertices(count as usize) })
    }
}
