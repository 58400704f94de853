//! Blocks of a text file: the places of its vertices, found in one pass when the file is opened, so that
//! reading begins anywhere near a vertex afterwards.
//!
//! A block is a run of whole vertices (of their lines, and of the lines before each) or a gap: many bytes
//! without any. The block that a byte belongs to depends on the file alone.

use std::ops::Range;

use super::lines::wrong_line;
use crate::source::SourceFile;
use crate::{CHUNK_VERTICES, Error, Result};

/// Number of bytes without a vertex from which on they are a gap.
pub(crate) const GAP: u64 = 1 << 18;

/// A block ends with the vertex that reaches this many bytes.
const BLOCK_BYTES: u64 = 1 << 20;

/// Bytes of consecutive blocks that are read at once, if there are several.
const CHUNK_BYTES: u64 = 4 << 20;

/// The blocks of a file.
///
/// Memory: 16 bytes for each; these are at most 65 536, or one for each 16 384 vertices, or for each 128 KiB
/// of the file on average.
#[derive(Debug, Default)]
pub(crate) struct TextBlocks {
    /// First vertex of each block and the byte at which the block begins, ascending; at last, the end of the
    /// last one.
    entries: Vec<(u64, u64)>,
}

impl TextBlocks {
    /// Number of vertices.
    pub(crate) fn vertices(&self) -> u64 {
        self.entries.last().map_or(0, |e| e.0)
    }

    /// Byte at which the last vertex ends, or the first one would begin.
    pub(crate) fn end(&self) -> u64 {
        self.entries.last().map_or(0, |e| e.1)
    }

    /// Bytes of blocks with vertices.
    pub(crate) fn vertex_bytes(&self) -> u64 {
        self.entries.windows(2).filter(|e| e[0].0 < e[1].0).map(|e| e[1].1 - e[0].1).sum()
    }

    /// The block that holds a vertex.
    fn of_vertex(&self, vertex: u64) -> usize {
        self.entries.partition_point(|e| e.0 <= vertex).saturating_sub(1)
    }

    /// The block that holds a byte: the number of vertices before it, and the byte at which it begins. `None`
    /// before the first one.
    pub(crate) fn of_byte(&self, offset: u64) -> Option<(u64, u64)> {
        let after = self.entries.partition_point(|e| e.1 <= offset);
        self.entries[..after].last().copied()
    }

    /// Ranges of the vertices and of the bytes of some blocks, spread over the file.
    pub(crate) fn spread(&self, most: usize) -> impl Iterator<Item = (Range<u64>, Range<u64>)> + '_ {
        let step = self.entries.len().div_ceil(most).max(1);
        let of = |e: &[(u64, u64)]| (e[0].0..e[1].0, e[0].1..e[1].1);
        self.entries.windows(2).filter(|e| e[0].0 < e[1].0).step_by(step).map(of)
    }
}

/// Notes vertices, in the file's order.
#[derive(Debug)]
pub(crate) struct TextBlocksBuilder {
    entries: Vec<(u64, u64)>,
    /// Vertices so far, and where the last one ends.
    vertices: u64,
    end: u64,
    /// Most vertices of a block.
    spacing: u64,
    /// A block ends where so many vertices are complete.
    unit: u64,
    /// Whether the bytes before the next vertex are a gap, however short.
    is_separate: bool,
}

impl TextBlocksBuilder {
    const MAX: usize = 1 << 16;
    const SPACING: u64 = 1 << 10;
    const LARGEST: u64 = 1 << 14;

    /// Blocks of vertices from `start` on, `unit` of which stay together.
    pub(crate) fn new(start: u64, unit: u64) -> Self {
        let spacing = Self::SPACING.next_multiple_of(unit);
        Self { entries: vec![(0, start)], vertices: 0, end: start, spacing, unit, is_separate: false }
    }

    pub(crate) fn vertices(&self) -> u64 {
        self.vertices
    }

    /// Byte at which the last vertex ends.
    pub(crate) fn end(&self) -> u64 {
        self.end
    }

    /// Makes the bytes between the last vertex and the next one a gap, however short.
    pub(crate) fn separate(&mut self) {
        self.is_separate = true;
    }

    /// The next vertex takes the bytes from `start` to `end`.
    #[inline]
    pub(crate) fn vertex(&mut self, start: u64, end: u64) {
        let (first, begin) = self.entries[self.entries.len() - 1];
        if std::mem::take(&mut self.is_separate) || start - self.end > GAP {
            self.close();
            self.entries.push((self.vertices, start));
        } else if (self.vertices - first >= self.spacing || self.end - begin >= BLOCK_BYTES)
            && self.vertices.is_multiple_of(self.unit)
        {
            self.close();
        }
        (self.vertices, self.end) = (self.vertices + 1, end);
    }

    /// Ends the current block, unless it is empty.
    fn close(&mut self) {
        if self.entries.last().is_some_and(|e| e.0 < self.vertices) {
            self.entries.push((self.vertices, self.end));
        }
        if self.entries.len() > Self::MAX && self.spacing < Self::LARGEST {
            self.spacing *= 2;
            self.merge();
        }
    }

    /// Joins neighbours that are one block together.
    fn merge(&mut self) {
        let mut kept: Vec<(u64, u64)> = Vec::with_capacity(self.entries.len());
        for i in 0..self.entries.len() {
            let entry = self.entries[i];
            let joins = kept.last().zip(self.entries.get(i + 1)).is_some_and(|(begin, end)| {
                begin.0 < entry.0
                    && entry.0 < end.0
                    && end.0 - begin.0 <= self.spacing
                    && end.1 - begin.1 <= BLOCK_BYTES
            });
            if !joins {
                kept.push(entry);
            }
        }
        self.entries = kept;
    }

    pub(crate) fn finish(mut self) -> TextBlocks {
        self.close();
        TextBlocks { entries: self.entries }
    }
}

/// Goes over the bytes of a range of vertices.
///
/// Memory: a block, where the block is read in parts.
pub(crate) struct BlockReader<'a> {
    source: &'a SourceFile,
    blocks: &'a TextBlocks,
    /// The vertices that are still to be read.
    range: Range<u64>,
    /// Most vertices of a chunk.
    chunk: usize,
    /// Bytes of the block that was read ahead, the number of those that were taken, and the vertex that comes
    /// next in it.
    ahead: Vec<u8>,
    ahead_at: usize,
    ahead_next: u64,
    ahead_of: Option<usize>,
}

impl<'a> BlockReader<'a> {
    pub(crate) fn new(source: &'a SourceFile, blocks: &'a TextBlocks, range: Range<u64>) -> Self {
        let end = range.end.min(blocks.vertices());
        let range = range.start.min(end)..end;
        let (ahead, chunk) = (Vec::new(), CHUNK_VERTICES);
        Self { source, blocks, range, chunk, ahead, ahead_at: 0, ahead_next: 0, ahead_of: None }
    }

    pub(crate) fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES);
    }

    /// Index of the next vertex.
    pub(crate) fn next_vertex(&self) -> u64 {
        self.range.start
    }

    /// Byte of the file at which the block with the next vertex begins, if there is one.
    pub(crate) fn next_start(&self) -> Option<u64> {
        let block = self.blocks.of_vertex(self.range.start);
        (!self.range.is_empty()).then(|| self.blocks.entries[block].1)
    }

    /// The end of the blocks from this one on that are read as a whole, of at most so many vertices; the
    /// block itself if it is not.
    fn last_whole(&self, block: usize, limit: u64) -> usize {
        let entries = &self.blocks.entries;
        let (first, begin) = entries[block];
        let mut last = block;
        while first == self.range.start
            && let Some(end) = entries.get(last + 1)
            && end.0 - first <= limit
            && (last == block || (entries[last].0 < end.0 && end.1 - begin <= CHUNK_BYTES))
        {
            last += 1;
        }
        last
    }

    /// Makes `raw` the bytes of the next vertices; returns how many, none at the end.
    ///
    /// `cut` finds where so many vertices end in bytes that begin with them.
    pub(crate) fn read(
        &mut self,
        raw: &mut Vec<u8>,
        cut: impl Fn(&[u8], u64) -> Option<usize>,
    ) -> Result<u64> {
        let limit = (self.range.end - self.range.start).min(self.chunk as u64);
        let entries = &self.blocks.entries;
        if limit == 0 {
            raw.clear();
            return Ok(0);
        }
        let mut block = self.blocks.of_vertex(self.range.start);
        let (first, begin) = entries[block];
        let last = self.last_whole(block, limit);
        if last > block {
            let (next, end) = entries[last];
            // Not cleared first: filling a buffer with zeros, only to overwrite it, takes time.
            raw.resize((end - begin) as usize, 0);
            self.source.read_at(raw, begin)?;
            self.range.start = next;
            return Ok(next - first);
        }
        // A part of a block.
        raw.clear();
        if self.ahead_of != Some(block) || self.ahead_next > self.range.start {
            self.ahead.clear();
            let bytes = (entries[block + 1].1 - begin) as usize;
            self.source.append_at(&mut self.ahead, begin, bytes)?;
            (self.ahead_at, self.ahead_next, self.ahead_of) = (0, first, Some(block));
        }
        block += 1;
        let count = limit.min(entries[block].0 - self.range.start);
        let skipped = self.range.start - self.ahead_next;
        let start = cut(&self.ahead[self.ahead_at..], skipped).ok_or_else(|| self.changed())? + self.ahead_at;
        let is_rest = self.range.start + count == entries[block].0;
        let end = if is_rest {
            self.ahead.len()
        } else {
            cut(&self.ahead[start..], count).ok_or_else(|| self.changed())? + start
        };
        raw.extend_from_slice(&self.ahead[start..end]);
        self.range.start += count;
        (self.ahead_at, self.ahead_next) = (end, self.range.start);
        Ok(count)
    }

    fn changed(&self) -> Error {
        changed(self.source)
    }
}

/// Bytes of a file in its order: vertices, and the bytes between and behind them.
pub(crate) struct BlockPieces<'a> {
    reader: BlockReader<'a>,
    /// Byte of the file at which the next piece begins.
    at: u64,
}

/// A piece of the file: vertices, or bytes between them.
pub(crate) enum BlockPiece {
    /// First vertex of the piece, and the number of its vertices.
    Vertices(u64, u64),
    /// Bytes to be copied.
    Bytes,
    /// The file is over.
    End,
}

impl<'a> BlockPieces<'a> {
    /// Pieces of the whole file, in chunks of at most so many vertices.
    pub(crate) fn new(source: &'a SourceFile, blocks: &'a TextBlocks, chunk: usize) -> Self {
        let mut reader = BlockReader::new(source, blocks, 0..u64::MAX);
        reader.set_chunk(chunk);
        Self { reader, at: 0 }
    }

    pub(crate) fn read(
        &mut self,
        raw: &mut Vec<u8>,
        cut: impl Fn(&[u8], u64) -> Option<usize>,
    ) -> Result<BlockPiece> {
        let BlockReader { source, .. } = self.reader;
        let next = self.reader.next_vertex();
        let vertices_at = self.reader.next_start().unwrap_or(source.len());
        if self.at < vertices_at {
            raw.clear();
            let wanted = (vertices_at - self.at).min(CHUNK_BYTES) as usize;
            self.at += source.append_at(raw, self.at, wanted)? as u64;
            return Ok(BlockPiece::Bytes);
        }
        let vertices = self.reader.read(raw, cut)?;
        if vertices == 0 {
            source.check_unchanged()?;
            return Ok(BlockPiece::End);
        }
        self.at += raw.len() as u64;
        Ok(BlockPiece::Vertices(next, vertices))
    }
}

/// Error of a file that has changed since it was opened.
pub(crate) fn changed(source: &SourceFile) -> Error {
    Error::changed_while_read(source.path())
}

/// An error where more bytes than a [`GAP`] stand between what belongs together, before `offset`.
pub(crate) fn too_far(source: &SourceFile, offset: u64) -> Error {
    let what =
        format!("more than {} KiB lie between this line and the one before that it belongs to", GAP >> 10);
    wrong_line(source, offset, what, super::DAMAGED)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use proptest::prelude::*;

    use super::super::lines::{LineEnds, lines};
    use super::*;

    /// A vertex is a line of `v`s.
    fn cut(bytes: &[u8], count: u64) -> Option<usize> {
        let mut ends =
            lines(bytes, LineEnds::Breaks).filter(|(start, _)| bytes[*start] == b'v').map(|(_, end)| end);
        if count == 0 { Some(0) } else { ends.nth(count as usize - 1) }
    }

    fn file(text: &[u8]) -> SourceFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text).unwrap();
        SourceFile::open(file.path(), None).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn every_vertex_is_read_once_and_every_byte(
            runs in prop::collection::vec((0usize..4000, prop_oneof![0usize..3, Just(300_000)], 0usize..40), 1..6),
            chunk in 1usize..5000,
            middle in 0.0..1.0f64,
        ) {
            let (mut text, mut ends) = (b"head\n".to_vec(), Vec::new());
            for (vertices, gap, length) in runs {
                for _ in 0..vertices {
                    ends.push((text.len() as u64, (text.len() + length + 2) as u64));
                    text.push(b'v');
                    text.extend(vec![b'v'; length]);
                    text.push(b'\n');
                }
                text.extend(vec![b'#'; gap]);
                text.push(b'\n');
            }
            let source = file(&text);
            let mut builder = TextBlocksBuilder::new(0, 1);
            builder.spacing = 64;
            ends.iter().for_each(|(start, end)| builder.vertex(*start, *end));
            let blocks = builder.finish();
            prop_assert_eq!(blocks.vertices(), ends.len() as u64);
            // The whole file is read, as pieces.
            let (mut pieces, mut raw) = (BlockPieces::new(&source, &blocks, chunk), Vec::new());
            let (mut all, mut seen, mut of_vertices) = (Vec::new(), 0, Vec::new());
            loop {
                match pieces.read(&mut raw, cut).unwrap() {
                    BlockPiece::End => break,
                    BlockPiece::Bytes => {}
                    BlockPiece::Vertices(first, count) => {
                        prop_assert_eq!(first, seen);
                        prop_assert!(count as usize <= chunk);
                        seen += count;
                        prop_assert_eq!(cut(&raw, count), Some(raw.len()));
                        prop_assert!((raw.len() as u64) <= CHUNK_BYTES + BLOCK_BYTES + GAP);
                        of_vertices.extend_from_slice(&raw);
                    }
                }
                all.extend_from_slice(&raw);
            }
            prop_assert!(all == text && seen == ends.len() as u64);
            // A part of the vertices is read, whose bytes do not depend on the chunks.
            let from = (middle * seen as f64) as u64;
            for range in [0..from, from..seen, from..seen.min(from + 7), 0..seen] {
                let mut reader = BlockReader::new(&source, &blocks, range.clone());
                reader.set_chunk(chunk % 100 + 1);
                let (mut read, mut bytes) = (0, Vec::new());
                loop {
                    let count = reader.read(&mut raw, cut).unwrap();
                    prop_assert_eq!(cut(&raw, count), Some(raw.len()));
                    if count == 0 { break }
                    read += count;
                    bytes.extend_from_slice(&raw);
                }
                prop_assert_eq!(read, range.end - range.start);
                if range == (0..seen) {
                    prop_assert!(bytes == of_vertices);
                }
            }
        }
    }

    #[test]
    fn blocks_stay_few_and_of_bounded_size() {
        let mut builder = TextBlocksBuilder::new(0, 1);
        for i in 0..100_000_000u64 {
            builder.vertex(10 * i, 10 * i + 10);
        }
        let blocks = builder.finish();
        assert_eq!(blocks.vertices(), 100_000_000);
        assert!(blocks.entries.len() <= TextBlocksBuilder::MAX + 1, "{}", blocks.entries.len());
        assert!(blocks.entries.windows(2).all(|e| e[1].0 - e[0].0 <= 4096 && e[1].1 == 10 * e[1].0));
    }
}
