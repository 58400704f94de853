//! Reads consecutive vertices, a chunk at a time, from any vertex on; compressed ones a few blocks ahead.

use std::collections::VecDeque;
use std::ops::Range;
use std::thread;

use super::blocks::LasBlocks;
use super::file::LasModel;
use super::header::{CUT_OFF, DAMAGED};
use super::kept::Compressed;
use super::laszip::{Laszip, LayerChoice};
use super::points;
use crate::memory;
use crate::model::CompressedBlock;
use crate::{CHUNK_VERTICES, Result, VertexChunk, VertexReader};

/// A chunk ends with the vertex that reaches this many bytes, however few vertices that are.
const CHUNK_BYTES: usize = 4 << 20;

/// Reads the vertices of a range.
pub(super) struct LasReader<'a> {
    model: &'a LasModel,
    /// The vertices that are still to be read.
    range: Range<u64>,
    /// Most vertices of a chunk.
    chunk: usize,
    /// Parts of compressed vertices that are read.
    what: LayerChoice,
    /// Blocks that were read ahead, from the one with the next vertex on.
    ahead: VecDeque<BlockGroup>,
}

/// Blocks of compressed vertices that are read at a time.
#[derive(Default)]
pub(super) struct BlockGroup {
    /// The blocks' first vertex.
    first: u64,
    /// Bytes of the blocks in the file, until a chunk takes them, and each block's share.
    raw: Vec<u8>,
    blocks: Vec<CompressedBlock>,
    /// The records of the points, unpacked.
    records: Vec<u8>,
}

impl<'a> LasReader<'a> {
    pub fn new(model: &'a LasModel, range: Range<u64>) -> Self {
        let end = range.end.min(model.info.vertices);
        let range = range.start.min(end)..end;
        Self { model, range, chunk: CHUNK_VERTICES, what: LayerChoice::All, ahead: VecDeque::new() }
    }

    /// Vertices of a whole chunk of a file that is not compressed.
    pub fn plain_chunk(record: usize) -> u64 {
        CHUNK_VERTICES.min((CHUNK_BYTES / record).max(1)) as u64
    }

    /// Reads the bytes of the next vertices of a file that is not compressed; returns how many, none at the
    /// end.
    pub fn read_plain(&mut self, chunk: &mut VertexChunk) -> Result<usize> {
        let LasModel { header, source, .. } = self.model;
        let left = self.range.end - self.range.start;
        let count = left.min(self.chunk as u64).min((CHUNK_BYTES / header.record).max(1) as u64) as usize;
        chunk.first = self.range.start;
        memory::resize(&mut chunk.raw, count * header.record);
        let at = header.points + self.range.start * header.record as u64;
        if source.read_at(&mut chunk.raw, at)? < chunk.raw.len() {
            let what = format!("the file ends within vertex {} of {}", self.range.start, header.count);
            return Err(source.malformed(what, CUT_OFF));
        }
        self.range.start += count as u64;
        Ok(count)
    }

    /// Fills a chunk with the next vertices of blocks that were read ahead.
    fn read_compressed(
        &mut self,
        chunk: &mut VertexChunk,
        laszip: &Laszip,
        blocks: &LasBlocks,
    ) -> Result<usize> {
        let record = self.model.header.record;
        chunk.first = self.range.start;
        chunk.raw.clear();
        chunk.records.clear();
        let behind = |group: &BlockGroup| group.first + (group.records.len() / record) as u64;
        while self.ahead.front().is_some_and(|group| behind(group) <= self.range.start) {
            self.ahead.pop_front();
        }
        if self.range.is_empty() {
            return Ok(0);
        }
        if self.ahead.is_empty() {
            self.read_ahead(laszip, blocks)?;
        }
        let Some(group) = self.ahead.front_mut() else { return Ok(0) };
        let end = behind(group).min(self.range.end).min(self.range.start + self.chunk as u64);
        let part = |vertex: u64| (vertex - group.first) as usize * record;
        chunk.records.extend_from_slice(&group.records[part(self.range.start)..part(end)]);
        std::mem::swap(&mut chunk.raw, &mut group.raw);
        let count = (end - self.range.start) as usize;
        self.range.start = end;
        Ok(count)
    }

    /// Reads the next blocks: on as many threads as the pool has, unless this is one of them, beside which
    /// the others have their own to do.
    fn read_ahead(&mut self, laszip: &Laszip, blocks: &LasBlocks) -> Result<()> {
        let threads = if rayon::current_thread_index().is_some() { 1 } else { rayon::current_num_threads() };
        let mut next = blocks.of_vertex(self.range.start);
        let mut groups = Vec::new();
        while groups.len() < threads && next < blocks.len() && blocks.start(next).0 < self.range.end {
            let group = blocks.group(next);
            next = group.end;
            groups.push(group);
        }
        let (model, what) = (self.model, self.what);
        let read = |group: Range<usize>| {
            let mut read = BlockGroup::default();
            model.read_group(blocks, group.clone(), &mut read.raw, &mut read.blocks)?;
            read.first = blocks.start(group.start).0;
            let of = (group.start, &read.blocks[..]);
            model.decompress(laszip, of, &read.raw, &mut read.records, what)?;
            Ok(read)
        };
        let read = thread::scope(|scope| {
            let (first, others) = groups.split_first()?;
            let others: Vec<_> = others.iter().map(|group| scope.spawn(|| read(group.clone()))).collect();
            let first = read(first.clone());
            let others = others
                .into_iter()
                .map(|other| other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            Some([first].into_iter().chain(others).collect::<Result<Vec<_>>>())
        });
        self.ahead.extend(read.transpose()?.unwrap_or_default());
        Ok(())
    }
}

impl LasModel {
    /// Reads the bytes of some blocks.
    pub(super) fn read_group(
        &self,
        blocks: &LasBlocks,
        group: Range<usize>,
        raw: &mut Vec<u8>,
        of: &mut Vec<CompressedBlock>,
    ) -> Result<()> {
        of.clear();
        of.extend(group.clone().map(|number| blocks.block(number)));
        let bytes = of.iter().map(|block| block.bytes).sum::<u64>() as usize;
        raw.clear();
        if self.source.append_at(raw, blocks.start(group.start).1, bytes)? < bytes {
            let what = format!("the file ends within compressed block {}", group.start);
            return Err(self.source.malformed(what, CUT_OFF));
        }
        Ok(())
    }

    /// The records of blocks from `first` on.
    pub(super) fn decompress(
        &self,
        laszip: &Laszip,
        (first, of): (usize, &[CompressedBlock]),
        raw: &[u8],
        records: &mut Vec<u8>,
        what: LayerChoice,
    ) -> Result<()> {
        let record = self.header.record;
        let vertices: u64 = of.iter().map(|block| block.vertices).sum();
        records.clear();
        records.resize(vertices as usize * record, 0);
        let kept = if what == LayerChoice::All { None } else { self.kept() };
        let (mut raw, mut records) = (raw, &mut records[..]);
        for (number, block) in (first..).zip(of) {
            let (bytes, others) = raw.split_at(block.bytes as usize);
            let (now, later) = records.split_at_mut(block.vertices as usize * record);
            (raw, records) = (others, later);
            let block = Compressed { number, bytes };
            if kept.as_ref().is_some_and(|kept| kept.get(block, now)) {
                continue;
            }
            laszip.decompress(bytes, now, what).map_err(|what| {
                self.source.malformed(format!("compressed block {number} cannot be read: {what}"), DAMAGED)
            })?;
            if let Some(kept) = &kept {
                kept.put(block, now);
            }
        }
        Ok(())
    }

    /// Fills a chunk's positions from its records.
    pub(super) fn decode_positions(&self, chunk: &mut VertexChunk) {
        let VertexChunk { positions, normals, raw, records, spans, .. } = chunk;
        let records = if self.compressed.is_some() { &*records } else { &*raw };
        points::decode(&self.header.integers, records, self.header.record, positions);
        normals.clear();
        spans.clear();
    }
}

impl VertexReader for LasReader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES);
    }

    fn skip_attributes(&mut self) {
        self.what = LayerChoice::Positions;
    }

    fn skip_all_but_colors(&mut self) {
        // Extra bytes are called so, too.
        let is_layered = self.model.compressed.as_ref().is_some_and(|(laszip, _)| laszip.is_layered);
        let any_name = self.model.parts().iter().any(|part| part.end > self.model.places.standard_bytes);
        self.what = if is_layered && any_name { LayerChoice::All } else { LayerChoice::Colors };
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let model = self.model;
        let count = match &model.compressed {
            Some((laszip, blocks)) => self.read_compressed(chunk, laszip, blocks)?,
            None => self.read_plain(chunk)?,
        };
        model.decode_positions(chunk);
        Ok(count > 0)
    }
}
