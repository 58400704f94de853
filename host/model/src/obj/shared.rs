//! Normals that corners share: one for several vertices, or several for one.
//!
//! Where a normal is used is found by one pass over the faces: pairs of normal and vertex, sorted in
//! temporary files. When the file is written, each normal is turned at every place that uses it. It becomes
//! their mean where all are within five degrees of it, and keeps its bytes elsewhere.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use memmap2::Mmap;

use super::apart::{ApartModel, ApartPieces};
use super::grammar::Obj;
use super::lines::{Statement, absolute, leading_integer, values};
use crate::pipeline::{Pieces, Rewritable, Version};
use crate::scratch::Scratch;
use crate::shared_normal::mean;
use crate::source::Source;
use crate::text::lines::Lines;
use crate::text::model::{TextModel, splice_normal};
use crate::{CHUNK_VERTICES, Model, Normals, Progress, Result, SMALL_CHUNK, VertexChunk};

/// Pairs that are sorted at once.
const RUN: usize = 1 << 22;

/// Pairs that are read ahead of each sorted run.
const AHEAD: usize = 1 << 12;

const ADVICE: &str = "set TMPDIR to a folder on a disk with more room";

/// Bytes of a pair, and of a position.
const PAIR: usize = 8;
const POSITION: usize = 24;

/// A model that is rewritten with its shared normals.
///
/// Disk: 24 bytes for each vertex, and 8 to 16 for each pair of a vertex and a normal, in nameless temporary
/// files, which are mapped. Memory: 32 MiB while they are sorted; beside the chunks, nothing after that.
pub(super) struct SharedNormals<'a> {
    model: &'a ApartModel,
    /// The normal in the upper half, the vertex in the lower: ascending, none twice.
    pairs: Option<Mmap>,
    positions: Option<Mmap>,
    /// Normals that keep their bytes as their places disagree, of all versions.
    kept: AtomicU64,
}

impl<'a> SharedNormals<'a> {
    /// Finds out who uses which normal.
    pub(super) fn new(model: &'a ApartModel, progress: &dyn Progress) -> Result<Self> {
        let pairs = pairs(&model.model, progress)?;
        let positions = positions(model, progress)?;
        Ok(Self { model, pairs, positions, kept: AtomicU64::new(0) })
    }

    /// Says what was kept.
    pub(super) fn tell(&self, progress: &dyn Progress) {
        let kept = self.kept.load(Ordering::Relaxed);
        if kept > 0 {
            progress.note(&format!(
                "{}: {kept} normals (vn) are kept as they are: corners share them that turn apart by more than 5\u{b0}",
                self.model.path().display()
            ));
        }
    }

    fn pair(&self, index: usize) -> Option<u64> {
        let bytes = self.pairs.as_ref()?.get(PAIR * index..PAIR * (index + 1))?;
        Some(u64::from_le_bytes(bytes.try_into().ok()?))
    }

    /// Index of the first pair of a normal, or of a later one.
    fn first_pair(&self, normal: u64) -> usize {
        let (mut low, mut high) = (0, self.pairs.as_ref().map_or(0, |map| map.len() / PAIR));
        while low < high {
            let middle = low.midpoint(high);
            if self.pair(middle).is_some_and(|pair| pair >> 32 < normal) {
                low = middle + 1
            } else {
                high = middle
            }
        }
        low
    }

    fn position(&self, vertex: u64) -> Option<DVec3> {
        let at = POSITION * usize::try_from(vertex).ok()?;
        let bytes = self.positions.as_ref()?.get(at..at + POSITION)?;
        let mut position = DVec3::ZERO;
        for (c, bytes) in bytes.chunks_exact(8).enumerate() {
            position[c] = f64::from_le_bytes(bytes.try_into().ok()?);
        }
        Some(position)
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
        let mut next = self.first_pair(first);
        let end = self.first_pair(first + count as u64);
        // Where there are too many places, each normal is looked at in some of them, evenly spread.
        let most = if end - next > CHUNK_VERTICES { CHUNK_VERTICES / count.max(1) } else { CHUNK_VERTICES };
        for (normal, value) in (first..).zip(own) {
            let start = positions.len() as u32;
            let after = self.first_pair_from(next, end, normal + 1);
            for index in (next..after).step_by((after - next).div_ceil(most.max(1)).max(1)) {
                let vertex = self.pair(index).map_or(0, |pair| pair & u64::from(u32::MAX));
                if let Some(position) = self.position(vertex).filter(|p| p.is_finite()) {
                    positions.push(position);
                    normals.push(value);
                }
            }
            next = after;
            spans.push([start, positions.len() as u32]);
        }
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, version: Version<'_>) -> Result<()> {
        if !chunk.of_normals {
            return Rewritable::encode(self.model, chunk, version);
        }
        let Version { edited, bytes, .. } = version;
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

    fn source(&self) -> &Source {
        Rewritable::source(self.model)
    }
}

impl SharedNormals<'_> {
    /// As [`first_pair`](Self::first_pair), which is among those from `next` on and probably one of the first.
    fn first_pair_from(&self, next: usize, end: usize, normal: u64) -> usize {
        const NEAR: usize = 16;
        let is_before = |index: &usize| self.pair(*index).is_some_and(|pair| pair >> 32 < normal);
        let near = (next..end.min(next + NEAR)).take_while(is_before).count();
        if near < NEAR { next + near } else { self.first_pair(normal) }
    }
}

/// The positions of all vertices.
fn positions(model: &ApartModel, progress: &dyn Progress) -> Result<Option<Mmap>> {
    if model.info().vertices == 0 {
        return Ok(None);
    }
    let scratch = Scratch::new(&std::env::temp_dir(), ADVICE)?;
    let mut reader = model.vertices(0..u64::MAX)?;
    let (mut chunk, mut bytes) = (VertexChunk::default(), Vec::new());
    while reader.read(&mut chunk)? {
        progress.check()?;
        bytes.clear();
        bytes.extend(chunk.positions.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes));
        scratch.write_at(&bytes, POSITION as u64 * chunk.first)?;
    }
    Ok(Some(scratch.map()?))
}

/// Pairs of normals and vertices, sorted; `None` if there are none.
fn pairs(model: &TextModel<Obj>, progress: &dyn Progress) -> Result<Option<Mmap>> {
    let mut runs = Runs::new()?;
    let mut lines = Lines::new(&model.source, 0, u64::MAX, true);
    let (mut vertices, mut normals, mut faces) = (0, 0, 0u64);
    while let Some((_, line)) = lines.next()? {
        match Statement::of(line) {
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
    runs.merge(progress)
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
    /// Where each run ends, in pairs.
    ends: Vec<u64>,
    buffer: Vec<u64>,
}

impl Runs {
    fn new() -> Result<Self> {
        let scratch = Scratch::new(&std::env::temp_dir(), ADVICE)?;
        Ok(Self { scratch, ends: Vec::new(), buffer: Vec::new() })
    }

    fn add(&mut self, pair: u64) -> Result<()> {
        self.buffer.push(pair);
        if self.buffer.len() == RUN { self.end_run() } else { Ok(()) }
    }

    fn end_run(&mut self) -> Result<()> {
        self.buffer.sort_unstable();
        self.buffer.dedup();
        let start = self.ends.last().copied().unwrap_or(0);
        write(&self.scratch, &self.buffer, start)?;
        self.ends.push(start + self.buffer.len() as u64);
        self.buffer.clear();
        Ok(())
    }

    /// All of them in order, none twice.
    fn merge(mut self, progress: &dyn Progress) -> Result<Option<Mmap>> {
        if !self.buffer.is_empty() {
            self.end_run()?;
        }
        self.buffer = Vec::new();
        match self.ends.len() {
            0 => return Ok(None),
            1 => return self.scratch.map().map(Some),
            _ => {}
        }
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        let mut runs: Vec<Run> =
            starts.zip(&self.ends).map(|(next, end)| Run { next, end: *end, ahead: Vec::new() }).collect();
        let mut heap = BinaryHeap::new();
        for (i, run) in runs.iter_mut().enumerate() {
            heap.extend(run.next(&self.scratch)?.map(|pair| Reverse((pair, i))));
        }
        let sorted = Scratch::new(&std::env::temp_dir(), ADVICE)?;
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
                write(&sorted, &merged, written)?;
                written += merged.len() as u64;
                merged.clear();
            }
        }
        write(&sorted, &merged, written)?;
        sorted.map().map(Some)
    }
}

/// What is left of a run.
struct Run {
    next: u64,
    end: u64,
    /// The next ones, backwards.
    ahead: Vec<u64>,
}

impl Run {
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
    to.write_at(&bytes, PAIR as u64 * at)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::progress::Silent;

    proptest! {
        #[test]
        fn runs_are_merged_in_order(runs in prop::collection::vec(prop::collection::vec(0u64..5000, 0..9000), 0..4)) {
            let mut sorter = Runs::new().unwrap();
            for run in &runs {
                run.iter().for_each(|pair| sorter.add(*pair).unwrap());
                if !sorter.buffer.is_empty() {
                    sorter.end_run().unwrap();
                }
            }
            let mut expected = runs.concat();
            expected.sort_unstable();
            expected.dedup();
            let merged = sorter.merge(&Silent).unwrap();
            let bytes = merged.as_deref().unwrap_or_default();
            let found: Vec<u64> = bytes.chunks(8).map(|b| u64::from_le_bytes(b.try_into().unwrap())).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
