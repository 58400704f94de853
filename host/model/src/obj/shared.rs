//! Normals that corners share: one for several vertices, or several for one.
//!
//! The places that use a normal are found by one pass over the faces: pairs of normal and vertex, sorted, in
//! the cache. When the file is written, each normal is turned at every place that uses it. It becomes the
//! mean of the turned normals where all are within five degrees of the mean, and keeps its bytes elsewhere.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;

use super::apart::{ApartModel, ApartPieces, Sharing};
use super::grammar::Obj;
use super::lines::{ENDS, Statement, absolute, leading_integer, values};
use crate::cache::CachedContent;
use crate::form::counted;
use crate::pipeline::{PieceVersion, Pieces, Rewritable};
use crate::scratch::Scratch;
use crate::shared_normal::mean;
use crate::source::SourceFile;
use crate::text::blocks::changed;
use crate::text::lines::{Lines, text_start};
use crate::text::model::{TextModel, splice_normal};
use crate::{CHUNK_VERTICES, Model, Normals, Progress, Result, SMALL_CHUNK, VertexChunk};

/// Pairs that are sorted at once.
const RUN: usize = 1 << 22;

/// Pairs that are read ahead of each sorted run.
const AHEAD: usize = 1 << 12;

/// Bytes of a pair, and of a position.
const PAIR: usize = 8;
const POSITION: usize = 24;

/// A model that is rewritten with its shared normals.
///
/// Disk, in the cache: 24 bytes for each vertex, and 8 for each pair of a vertex and a normal; while it is
/// filled 8 to 16 besides for each. Memory: 32 MiB while they are sorted; beside the chunks 1 MiB for each
/// thread after that.
pub(super) struct SharedNormals<'a> {
    model: &'a ApartModel,
    /// The positions of all vertices, and behind them the pairs: the normal in the upper half, the vertex in
    /// the lower; ascending, none twice.
    file: SourceFile,
    /// Number of pairs.
    pairs: u64,
    /// Number of normals, in all versions, that keep their bytes as their places disagree.
    kept: AtomicU64,
}

impl<'a> SharedNormals<'a> {
    /// Finds out who uses which normal.
    pub(super) fn new(model: &'a ApartModel, sharing: &Sharing, progress: &dyn Progress) -> Result<Self> {
        let positions = POSITION as u64 * model.info().vertices;
        let of_pairs = (PAIR as u64).saturating_mul(sharing.corners);
        let need = CachedContent {
            what: "which corners share which normal is written",
            bytes: positions..=positions.saturating_add(of_pairs),
            meanwhile: of_pairs,
        };
        let source = &model.model.source;
        let file = sharing.cache.get(source, &need, progress, |to| {
            write_positions(model, to, progress)?;
            write_pairs(&model.model, to, positions, progress)
        })?;
        let pairs = file.len().saturating_sub(positions) / PAIR as u64;
        Ok(Self { model, file, pairs, kept: AtomicU64::new(0) })
    }

    /// Notes the number of normals that were kept.
    pub(super) fn tell(&self, progress: &dyn Progress) {
        let kept = self.kept.load(Ordering::Relaxed);
        if kept > 0 {
            progress.note(&format!(
                "{}: corners that share a normal (vn) turn apart by more than 5\u{b0}: {} kept",
                self.model.path().display(),
                counted(kept, "normal")
            ));
        }
    }

    /// Readers of the pairs, each of 8 bytes, and of the positions, each of 24.
    fn records(&self) -> (RecordFile<'_, PAIR>, RecordFile<'_, POSITION>) {
        let positions = POSITION as u64 * self.model.info().vertices;
        (RecordFile::new(&self.file, positions..self.file.len()), RecordFile::new(&self.file, 0..positions))
    }

    /// Index of the first pair of a normal, or of a later one.
    fn first_pair(&self, pairs: &mut RecordFile<'_, PAIR>, normal: u64) -> Result<u64> {
        let (mut low, mut high) = (0, self.pairs);
        while low < high {
            let middle = low.midpoint(high);
            if pair_of(pairs.get(middle)?) >> 32 < normal { low = middle + 1 } else { high = middle }
        }
        Ok(low)
    }

    /// Index of the first pair of a normal, where it is not before `next` and probably one of the first from
    /// there on.
    fn first_pair_from(
        &self,
        pairs: &mut RecordFile<'_, PAIR>,
        (next, end): (u64, u64),
        normal: u64,
    ) -> Result<u64> {
        const NEAR: u64 = 16;
        for index in next..end.min(next + NEAR) {
            if pair_of(pairs.get(index)?) >> 32 >= normal {
                return Ok(index);
            }
        }
        if next + NEAR >= end { Ok(end) } else { self.first_pair(pairs, normal) }
    }
}

fn pair_of(bytes: [u8; PAIR]) -> u64 {
    u64::from_le_bytes(bytes)
}

fn position_of(bytes: [u8; POSITION]) -> DVec3 {
    let coordinate = |axis: usize| {
        let mut eight = [0; 8];
        eight.copy_from_slice(&bytes[8 * axis..8 * (axis + 1)]);
        f64::from_le_bytes(eight)
    };
    DVec3::new(coordinate(0), coordinate(1), coordinate(2))
}

/// Records of `N` bytes in a part of a file, of which the last blocks that were asked for are held.
struct RecordFile<'a, const N: usize> {
    file: &'a SourceFile,
    range: Range<u64>,
    /// Block that is held for each reading position: its number and bytes, or none.
    blocks: Vec<(u64, Vec<u8>)>,
}

impl<'a, const N: usize> RecordFile<'a, N> {
    /// Records of a block, and how many blocks are held: half a MiB.
    const OF_A_BLOCK: u64 = 256;
    const BLOCKS: u64 = 64;

    fn new(file: &'a SourceFile, range: Range<u64>) -> Self {
        Self { file, range, blocks: vec![(u64::MAX, Vec::new()); Self::BLOCKS as usize] }
    }

    fn get(&mut self, index: u64) -> Result<[u8; N]> {
        let block = index / Self::OF_A_BLOCK;
        let (held, bytes) = &mut self.blocks[(block % Self::BLOCKS) as usize];
        if *held != block {
            *held = u64::MAX;
            let length = N as u64 * Self::OF_A_BLOCK;
            let at = self.range.start + block * length;
            bytes.clear();
            self.file.append_at(bytes, at, length.min(self.range.end.saturating_sub(at)) as usize)?;
            *held = block;
        }
        let at = (index % Self::OF_A_BLOCK) as usize * N;
        let mut record = [0; N];
        let Some(there) = bytes.get(at..at + N) else { return Err(changed(self.file)) };
        record.copy_from_slice(there);
        Ok(record)
    }
}

impl Rewritable for SharedNormals<'_> {
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        // Few normals may have many places.
        Ok(Box::new(ApartPieces::new(self.model, normals, SMALL_CHUNK)))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        if !chunk.of_normals {
            return Rewritable::decode(self.model, chunk);
        }
        let (count, first) = (chunk.spans.len(), chunk.first);
        let VertexChunk { positions, normals, raw, spans, .. } = chunk;
        let mut own = Vec::new();
        self.model.decode_normals(raw, first, count, &mut own, spans)?;
        positions.clear();
        normals.clear();
        let (mut pairs, mut places) = self.records();
        let mut next = self.first_pair(&mut pairs, first)?;
        let end = self.first_pair(&mut pairs, first + count as u64)?;
        // Too many places for a chunk: each normal is turned at some of its places, evenly spread.
        let most =
            if end - next > CHUNK_VERTICES as u64 { CHUNK_VERTICES / count.max(1) } else { CHUNK_VERTICES };
        let most = most.max(1) as u64;
        for (normal, value) in (first..).zip(own) {
            let start = positions.len() as u32;
            let after = self.first_pair_from(&mut pairs, (next, end), normal + 1)?;
            for index in (next..after).step_by((after - next).div_ceil(most).max(1) as usize) {
                let vertex = pair_of(pairs.get(index)?) & u64::from(u32::MAX);
                if vertex >= self.model.info().vertices {
                    continue;
                }
                let position = position_of(places.get(vertex)?);
                if position.is_finite() {
                    positions.push(position);
                    normals.push(value);
                }
            }
            next = after;
            spans.push([start, positions.len() as u32]);
        }
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()> {
        if !chunk.of_normals {
            return Rewritable::encode(self.model, chunk, version);
        }
        let PieceVersion { edited, bytes, .. } = version;
        let VertexChunk { normals, raw, spans, .. } = chunk;
        // Three words for each normal, and then its places.
        let (words, places) = spans.split_at(spans.len() / 4 * 3);
        let (mut copied, mut kept) = (0, 0);
        bytes.clear();
        for (words, [start, end]) in words.chunks_exact(3).zip(places) {
            let places = *start as usize..*end as usize;
            let Some(old) = normals.get(places.start).filter(|_| !places.is_empty()) else { continue };
            match mean(*old, &edited.normals[places]) {
                Some(new) => splice_normal(raw, words, (*old, new), &self.model.digits, &mut copied, bytes),
                None => kept += 1,
            }
        }
        bytes.extend_from_slice(&raw[copied..]);
        self.kept.fetch_add(kept, Ordering::Relaxed);
        Ok(())
    }

    fn source(&self) -> &SourceFile {
        Rewritable::source(self.model)
    }
}

/// Writes the positions of all vertices.
fn write_positions(model: &ApartModel, to: &Scratch, progress: &dyn Progress) -> Result<()> {
    let mut reader = model.vertices(0..u64::MAX)?;
    let (mut chunk, mut bytes) = (VertexChunk::default(), Vec::new());
    while reader.read(&mut chunk)? {
        progress.check()?;
        bytes.clear();
        bytes.extend(chunk.positions.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes));
        to.write_at(&bytes, POSITION as u64 * chunk.first)?;
    }
    Ok(())
}

/// Writes pairs of normals and vertices, sorted, from `start` on; returns the byte at which they end.
fn write_pairs(model: &TextModel<Obj>, to: &Scratch, start: u64, progress: &dyn Progress) -> Result<u64> {
    let mut runs = Runs::new(to)?;
    let mut lines = Lines::new(&model.source, text_start(&model.source)?, u64::MAX, ENDS);
    let (mut vertices, mut normals, mut faces) = (0, 0, 0u64);
    while let Some((_, line)) = lines.next()? {
        match Statement::parse(line) {
            Statement::Vertex => vertices += 1,
            Statement::Normal => normals += 1,
            Statement::Face => {
                faces += 1;
                if faces.is_multiple_of(1 << 16) {
                    progress.check()?;
                }
                for (start, end) in values(line) {
                    if let Some(pair) = pair(&line[start..end], vertices, normals) {
                        runs.add(pair)?;
                    }
                }
            }
            Statement::Other => {}
        }
    }
    Ok(start + PAIR as u64 * runs.merge(to, start, progress)?)
}

/// The normal and the vertex of a corner that has both.
fn pair(word: &[u8], vertices: u64, normals: u64) -> Option<u64> {
    let (vertex, at) = leading_integer(word)?;
    let second = at + 1 + memchr::memchr(b'/', word.get(at + 1..)?)?;
    let (normal, _) = leading_integer(&word[second + 1..])?;
    let vertex = u32::try_from(absolute(vertex, vertices)).ok()?;
    let normal = u32::try_from(absolute(normal, normals)).ok()?;
    Some(u64::from(normal) << 32 | u64::from(vertex))
}

/// Pairs in sorted runs in a file.
struct Runs {
    scratch: Scratch,
    /// End of each run, counted in pairs.
    ends: Vec<u64>,
    buffer: Vec<u64>,
}

impl Runs {
    /// Runs in a file beside the one that they go to in the end.
    fn new(beside: &Scratch) -> Result<Self> {
        Ok(Self { scratch: beside.beside()?, ends: Vec::new(), buffer: Vec::new() })
    }

    fn add(&mut self, pair: u64) -> Result<()> {
        self.buffer.push(pair);
        if self.buffer.len() == RUN { self.end_run() } else { Ok(()) }
    }

    fn end_run(&mut self) -> Result<()> {
        self.buffer.sort_unstable();
        self.buffer.dedup();
        let start = self.ends.last().copied().unwrap_or(0);
        write(&self.scratch, &self.buffer, PAIR as u64 * start)?;
        self.ends.push(start + self.buffer.len() as u64);
        self.buffer.clear();
        Ok(())
    }

    /// Writes the pairs of all runs in order, none twice, from `start` on; returns their number.
    fn merge(mut self, to: &Scratch, start: u64, progress: &dyn Progress) -> Result<u64> {
        if !self.buffer.is_empty() {
            self.end_run()?;
        }
        self.buffer = Vec::new();
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        let mut runs: Vec<RestOfRun> = starts
            .zip(&self.ends)
            .map(|(next, end)| RestOfRun { next, end: *end, ahead: Vec::new() })
            .collect();
        let mut heap = BinaryHeap::new();
        for (i, run) in runs.iter_mut().enumerate() {
            heap.extend(run.next(&self.scratch)?.map(|pair| Reverse((pair, i))));
        }
        let (mut merged, mut written) = (Vec::new(), 0);
        let mut last = None;
        while let Some(Reverse((pair, i))) = heap.pop() {
            heap.extend(runs[i].next(&self.scratch)?.map(|pair| Reverse((pair, i))));
            if last.replace(pair) == Some(pair) {
                continue;
            }
            merged.push(pair);
            if merged.len() == AHEAD {
                progress.check()?;
                write(to, &merged, start + PAIR as u64 * written)?;
                written += merged.len() as u64;
                merged.clear();
            }
        }
        write(to, &merged, start + PAIR as u64 * written)?;
        Ok(written + merged.len() as u64)
    }
}

/// Rest of a run that is not merged yet.
struct RestOfRun {
    next: u64,
    end: u64,
    /// The next ones, backwards.
    ahead: Vec<u64>,
}

impl RestOfRun {
    fn next(&mut self, from: &Scratch) -> Result<Option<u64>> {
        if self.ahead.is_empty() && self.next < self.end {
            let count = (self.end - self.next).min(AHEAD as u64);
            let mut bytes = vec![0; PAIR * count as usize];
            from.read_at(&mut bytes, PAIR as u64 * self.next)?;
            let pairs = bytes.chunks_exact(PAIR).rev();
            self.ahead.extend(pairs.filter_map(|b| Some(u64::from_le_bytes(b.try_into().ok()?))));
            self.next += count;
        }
        Ok(self.ahead.pop())
    }
}

fn write(to: &Scratch, pairs: &[u64], at: u64) -> Result<()> {
    let bytes: Vec<u8> = pairs.iter().flat_map(|pair| pair.to_le_bytes()).collect();
    to.write_at(&bytes, at)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::progress::Silent;

    proptest! {
        #[test]
        fn runs_are_merged_in_order(runs in prop::collection::vec(prop::collection::vec(0u64..5000, 0..9000), 0..4)) {
            let file = Scratch::new(&std::env::temp_dir(), "").unwrap();
            let mut sorter = Runs::new(&file).unwrap();
            for run in &runs {
                run.iter().for_each(|pair| sorter.add(*pair).unwrap());
                if !sorter.buffer.is_empty() {
                    sorter.end_run().unwrap();
                }
            }
            let mut expected = runs.concat();
            expected.sort_unstable();
            expected.dedup();
            let count = sorter.merge(&file, 80, &Silent).unwrap();
            let mut bytes = vec![0; PAIR * count as usize];
            file.read_at(&mut bytes, 80).unwrap();
            let found: Vec<u64> = bytes.chunks(8).map(|b| u64::from_le_bytes(b.try_into().unwrap())).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
