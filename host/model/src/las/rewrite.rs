//! Writing a LAS file anew, with other positions.

use std::collections::VecDeque;
use std::ops::Range;

use super::blocks::PLACE;
use super::file::LasModel;
use super::header::at;
use super::laszip::LayerChoice;
use super::points;
use super::reader::LasReader;
use crate::bounds::Bounds;
use crate::pipeline::{Piece, PieceVersion, Pieces, Rewritable, Skipped};
use crate::source::SourceFile;
use crate::unfit::Unfit;
use crate::{Division, Error, Normals, Result, ScaledIntegers, Summary, VertexChunk};

/// Bytes that are copied at a time.
const CHUNK_BYTES: usize = 4 << 20;

impl Rewritable for LasModel {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        let mut next = VecDeque::from([LasSection::Header]);
        next.extend(self.copied_before().into_iter().map(LasSection::Copy));
        next.push_back(LasSection::Points);
        let copy = |range: Range<u64>, next: &mut VecDeque<LasSection>| {
            next.extend(self.without_copc(range).into_iter().map(LasSection::Copy));
        };
        match &self.compressed {
            None => copy(self.header.points + self.info.vertex_bytes..self.source.len(), &mut next),
            Some((_, blocks)) => match &blocks.table {
                Some(table) => {
                    copy(blocks.end()..table.start, &mut next);
                    next.push_back(LasSection::Table(table.clone()));
                    copy(table.end..self.source.len(), &mut next);
                }
                None => copy(blocks.end()..self.source.len(), &mut next),
            },
        }
        let plain = LasReader::new(self, 0..self.info.vertices);
        Ok(Box::new(LasPieces { model: self, next, plain, block: 0 }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = !self.following.is_empty();
        if let Some((laszip, blocks)) = &self.compressed {
            let first = blocks.of_vertex(chunk.first);
            let VertexChunk { raw, records, blocks, .. } = chunk;
            self.decompress(laszip, (first, blocks), raw, records, LayerChoice::All)?;
        }
        self.decode_positions(chunk);
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, mut version: PieceVersion<'_>) -> Result<()> {
        let (first, edited) = (chunk.first, version.edited);
        let unfit = |unfit| self.unfit(first, unfit);
        let VertexChunk { positions, raw, records, blocks, .. } = chunk;
        let record = self.header.record;
        let grid = (self.written(), self.shift);
        let Some((laszip, _)) = &self.compressed else {
            version.begin_with(raw);
            let moved = (&positions[..], &edited.positions[..]);
            points::patch(grid, version.bytes, record, moved, version.summary).map_err(unfit)?;
            self.turn((edited, 0..positions.len()), positions, version.bytes, version.summary);
            return Ok(());
        };
        let PieceVersion { is_last, bytes: buffer, summary, .. } = version;
        let mut copy;
        let records = if is_last {
            records
        } else {
            copy = records.clone();
            &mut copy
        };
        buffer.clear();
        let (mut vertex, mut byte) = (0, 0);
        for block in &*blocks {
            let vertices = vertex..vertex + block.vertices as usize;
            let bytes = byte..byte + block.bytes as usize;
            (vertex, byte) = (vertices.end, bytes.end);
            let records = &mut records[vertices.start * record..vertices.end * record];
            let moved = (&positions[vertices.clone()], &edited.positions[vertices.clone()]);
            let changed = points::patch(grid, records, record, moved, summary)
                .map_err(|e| unfit(Unfit { vertex: vertices.start + e.vertex, ..e }))?;
            let changed = self.turn((edited, vertices), positions, records, summary) || changed;
            let before = buffer.len();
            if changed {
                let block =
                    laszip.compress(records).map_err(|e| Error::unwritable("compressed points", e))?;
                buffer.extend_from_slice(&block);
            } else {
                buffer.extend_from_slice(&raw[bytes]);
            }
            summary.lengths.push((buffer.len() - before) as u32);
        }
        Ok(())
    }

    fn make(&self, before: &Summary, _is_still: bool) -> Result<Vec<u8>> {
        let Some((_, blocks)) = &self.compressed else { return Ok(Vec::new()) };
        blocks.table(&before.lengths).map_err(|e| self.source.write_error(&e))
    }

    fn patches(&self, all: &Summary, is_still: bool) -> Result<Vec<(u64, Vec<u8>)>> {
        let mut patches = self.bounds(all);
        let descriptions = self.descriptions();
        let Some((_, blocks)) = &self.compressed else {
            patches.extend(descriptions.into_iter().flat_map(|at| self.limits(all, self.moved(at))));
            return Ok(patches);
        };
        let points = self.moved(blocks.start(0).1);
        let mut end = points + all.lengths.iter().map(|length| u64::from(*length)).sum::<u64>();
        let mut old_end = blocks.end();
        if let Some(table) = &blocks.table {
            end += table.start - blocks.end();
            let place = end.to_le_bytes().to_vec();
            let (told_at, told) = if blocks.is_told_at_end {
                let last = self.source.len() - PLACE;
                (None, Some(last))
            } else {
                (Some(points - PLACE), None)
            };
            end += self.make(all, is_still)?.len() as u64;
            old_end = table.end;
            patches.extend(told_at.map(|at| (at, place.clone())));
            patches.extend(told.map(|at| (self.moved(at) - self.moved(old_end) + end, place)));
        }
        // New place of a byte behind the points.
        let gone = |at: u64| self.moved(at) - self.moved(old_end) + end;
        if let Some(at) = descriptions {
            patches.extend(self.limits(all, if at < old_end { self.moved(at) } else { gone(at) }));
        }
        if let Some(start) = self.header.waveforms.filter(|start| *start >= old_end) {
            patches.push((at::WAVEFORMS, gone(start).to_le_bytes().to_vec()));
        }
        if let Some((start, count)) = self.header.evlrs.filter(|(start, _)| *start >= old_end) {
            let left = u64::from(count) - self.dropped(true);
            let place = if left > 0 { gone(start) } else { 0 };
            patches.push((at::EVLRS_START, place.to_le_bytes().to_vec()));
        }
        Ok(patches)
    }

    fn division(&self, _normals: Normals) -> Option<Division> {
        let copied = self.copied_before().into_iter().map(|range| copies(&range));
        let first = 1 + copied.sum::<u64>();
        let points = match &self.compressed {
            None => self.info.vertices.div_ceil(LasReader::plain_chunk(self.header.record)),
            Some((_, blocks)) => {
                let mut starts = std::iter::successors(Some(0), |at| Some(blocks.group(*at).end));
                starts.position(|at| at >= blocks.len()).unwrap_or(0) as u64
            }
        };
        let in_place = self.compressed.is_none() && self.records.of_copc().next().is_none();
        Some(Division { pieces: first + points, vertices: first..first + points, in_place })
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

/// Section of the file that comes next.
enum LasSection {
    Header,
    Copy(Range<u64>),
    Points,
    /// The table of compressed blocks.
    Table(Range<u64>),
}

/// The pieces of a LAS file, in its order.
struct LasPieces<'a> {
    model: &'a LasModel,
    next: VecDeque<LasSection>,
    /// Reader of points that are not compressed.
    plain: LasReader<'a>,
    /// The first compressed block that was not read.
    block: usize,
}

impl Pieces for LasPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let model = self.model;
        loop {
            let Some(part) = self.next.front_mut() else {
                model.source.check_unchanged()?;
                return Ok(Piece::End);
            };
            match part {
                LasSection::Header => {
                    chunk.raw.clear();
                    model.source.append_at(&mut chunk.raw, 0, model.header.len as usize)?;
                    model.correct_header(&mut chunk.raw);
                    self.next.pop_front();
                    return Ok(Piece::Bytes);
                }
                LasSection::Copy(range) if !range.is_empty() => {
                    chunk.raw.clear();
                    let wanted = (range.end - range.start).min(CHUNK_BYTES as u64) as usize;
                    range.start += model.source.append_at(&mut chunk.raw, range.start, wanted)? as u64;
                    return Ok(Piece::Bytes);
                }
                LasSection::Points => {
                    if let Some(vertices) = self.read_points(chunk)? {
                        return Ok(Piece::Vertices(vertices));
                    }
                }
                LasSection::Table(range) => {
                    chunk.raw.clear();
                    let length = (range.end - range.start) as usize;
                    model.source.append_at(&mut chunk.raw, range.start, length)?;
                    self.next.pop_front();
                    return Ok(Piece::Made);
                }
                LasSection::Copy(_) => {}
            }
            self.next.pop_front();
        }
    }

    fn skip(&mut self, mut pieces: u64) -> Result<Skipped> {
        let model = self.model;
        let mut skipped = Skipped { bytes: 0, vertex_bytes: 0 };
        while let (1.., Some(part)) = (pieces, self.next.front_mut()) {
            match part {
                LasSection::Copy(range) => {
                    let passed = copies(range).min(pieces);
                    pieces -= passed;
                    range.start = range.end.min(range.start + passed * CHUNK_BYTES as u64);
                    skipped.bytes = range.start;
                }
                LasSection::Points => {
                    let passed;
                    (passed, skipped) = self.skip_points(pieces);
                    pieces -= passed;
                }
                LasSection::Header => {
                    pieces -= 1;
                    skipped.bytes = model.header.len;
                }
                LasSection::Table(range) => {
                    pieces -= 1;
                    skipped.bytes = range.end;
                }
            }
            if pieces > 0 || matches!(self.next.front(), Some(LasSection::Header | LasSection::Table(_))) {
                self.next.pop_front();
            }
        }
        model.source.check_unchanged()?;
        Ok(skipped)
    }
}

/// Number of pieces that a range is copied in.
fn copies(range: &Range<u64>) -> u64 {
    range.end.saturating_sub(range.start).div_ceil(CHUNK_BYTES as u64)
}

impl LasPieces<'_> {
    /// The bytes of the next points; their number, unless there are no more.
    fn read_points(&mut self, chunk: &mut VertexChunk) -> Result<Option<usize>> {
        let Some((_, blocks)) = &self.model.compressed else {
            let vertices = self.plain.read_plain(chunk)?;
            return Ok((vertices > 0).then_some(vertices));
        };
        if self.block == blocks.len() {
            return Ok(None);
        }
        let group = blocks.group(self.block);
        self.block = group.end;
        chunk.first = blocks.start(group.start).0;
        self.model.read_group(blocks, group, &mut chunk.raw, &mut chunk.blocks)?;
        Ok(Some(chunk.blocks.iter().map(|block| block.vertices).sum::<u64>() as usize))
    }
}

impl LasPieces<'_> {
    /// Passes over so many pieces of points, or all: how many these are, and all that lies before their end.
    fn skip_points(&mut self, pieces: u64) -> (u64, Skipped) {
        let model = self.model;
        let Some((_, blocks)) = &model.compressed else {
            let chunk = LasReader::plain_chunk(model.header.record);
            let passed = model.info.vertices.div_ceil(chunk).min(pieces);
            let first = (passed * chunk).min(model.info.vertices);
            self.plain = LasReader::new(model, first..model.info.vertices);
            let vertex_bytes = first * model.header.record as u64;
            return (passed, Skipped { bytes: model.header.points + vertex_bytes, vertex_bytes });
        };
        let mut passed = 0;
        while passed < pieces && self.block < blocks.len() {
            self.block = blocks.group(self.block).end;
            passed += 1;
        }
        let bytes = blocks.start(self.block).1;
        (passed, Skipped { bytes, vertex_bytes: bytes - blocks.start(0).1 })
    }
}

impl LasModel {
    /// Ranges of the file that are copied between its header and its points.
    fn copied_before(&self) -> Vec<Range<u64>> {
        let points = match &self.compressed {
            None => self.header.points,
            Some((_, blocks)) => blocks.start(0).1,
        };
        self.without_copc(self.header.len..points)
    }

    /// Parts of a range of the file that go into the new one: all but the octree of COPC.
    fn without_copc(&self, range: Range<u64>) -> Vec<Range<u64>> {
        let (mut ranges, mut start) = (Vec::new(), range.start);
        let within = |at: u64| at.clamp(range.start, range.end);
        for record in self.records.of_copc() {
            ranges.push(start..within(record.all.start).max(start));
            start = within(record.all.end).max(start);
        }
        ranges.push(start..range.end);
        ranges
    }

    /// Place in the new file of a byte of the old one, as far as only the octree of COPC is left out.
    pub(super) fn moved(&self, at: u64) -> u64 {
        let before = self.records.of_copc().filter(|record| record.all.end <= at);
        at - before.map(|record| record.all.end - record.all.start).sum::<u64>()
    }

    /// Number of EVLRs that are left out, or of VLRs.
    pub(super) fn dropped(&self, extended: bool) -> u64 {
        self.records.of_copc().filter(|record| record.is_extended == extended).count() as u64
    }

    /// Corrects those numbers of the header that are known beforehand.
    pub(super) fn correct_header(&self, bytes: &mut [u8]) {
        let mut put = |at: u64, new: &[u8]| bytes[at as usize..at as usize + new.len()].copy_from_slice(new);
        for (axis, _) in self.shift.iter().enumerate().filter(|(_, steps)| **steps != 0) {
            put(at::OFFSETS + 8 * axis as u64, &self.written().offset[axis].to_le_bytes());
        }
        let [vlrs, evlrs] = [false, true].map(|extended| self.dropped(extended) as u32);
        if vlrs > 0 {
            put(at::VLRS, &(self.header.vlrs - vlrs).to_le_bytes());
            put(at::POINTS, &(self.moved(self.header.points) as u32).to_le_bytes());
        }
        if let Some((_, count)) = self.header.evlrs.filter(|_| evlrs > 0) {
            put(at::EVLRS, &(count - evlrs).to_le_bytes());
        }
    }

    /// The bounds in the header, as far as they change.
    pub(super) fn bounds(&self, all: &Summary) -> Vec<(u64, Vec<u8>)> {
        let Summary { before, after, .. } = all;
        if after.is_empty() {
            return Vec::new();
        }
        // The scale may be negative.
        let of = |bounds: &Bounds, integers: &ScaledIntegers| {
            let corners = [bounds.min, bounds.max];
            Bounds::from_points(corners.map(|numbers| numbers * integers.scale + integers.offset))
        };
        let (before, after) = (of(before, &self.header.integers), of(after, self.written()));
        let mut patches = Vec::new();
        for axis in 0..3 {
            let sides = [(before.max, after.max), (before.min, after.min)];
            for (side, (before, after)) in (0..).zip(sides) {
                if before[axis] != after[axis] {
                    let place = at::BOUNDS + 16 * axis as u64 + 8 * side;
                    patches.push((place, after[axis].to_le_bytes().to_vec()));
                }
            }
        }
        patches
    }

    pub(super) fn unfit(&self, first: u64, unfit: Unfit) -> Error {
        let Unfit { vertex, axis, value } = unfit;
        if !value.is_finite() {
            return unfit.error(&self.source, first);
        }
        let (vertex, path) = (first + vertex as u64, self.source.path().display());
        let range = self.written().range();
        let what = format!(
            "{path}: vertex {vertex} moves to {} = {value}, but with its scale and offset the file holds {} to {} alone",
            ["x", "y", "z"][axis],
            range.min[axis],
            range.max[axis]
        );
        Error::degenerate(what, "move it less, or give --offset auto, which chooses another offset")
    }
}
