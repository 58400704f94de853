//! Positions and colours of compressed points, kept for those that are read again: before LASzip's third
//! version all numbers of a point are compressed together, so that reading a part of them takes as long as
//! reading all.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use xxhash_rust::xxh3::xxh3_64;

use super::blocks::LasBlocks;
use crate::output::available_space;
use crate::scratch::Scratch;

/// Most bytes of the file: vertices for which there is no room are decompressed each time.
const MOST: u64 = 8 << 30;

/// Parts of the records of some blocks.
///
/// Memory: 16 bytes for each block. A temporary file has as many bytes for each vertex as the parts, 12 or 18
/// as a rule, and [`MOST`] at most.
#[derive(Debug)]
pub(super) struct KeptFields {
    file: Scratch,
    /// The bytes of a record that are kept.
    parts: Vec<Range<usize>>,
    /// Bytes of a record.
    record: usize,
    blocks: Vec<KeptBlock>,
}

#[derive(Debug)]
struct KeptBlock {
    /// The block's first vertex.
    first: u64,
    /// Hash of the block as it was in the model, which may change meanwhile; zero if the block is not kept.
    hash: AtomicU64,
}

/// A block of compressed points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Compressed<'a> {
    pub number: usize,
    pub bytes: &'a [u8],
}

impl Compressed<'_> {
    /// Hash that tells the block from others; never zero.
    fn hash(&self) -> u64 {
        xxh3_64(self.bytes).max(1)
    }
}

impl KeptFields {
    /// Empty storage. `None` if the folder has no room to spare, which is no error.
    pub fn new(folder: &Path, blocks: &LasBlocks, parts: Vec<Range<usize>>, record: usize) -> Option<Self> {
        let of_vertex: usize = parts.iter().map(Range::len).sum();
        let needed = blocks.vertices().saturating_mul(of_vertex as u64).min(MOST);
        if available_space(folder)? / 2 < needed {
            return None;
        }
        let file = Scratch::new(folder, "free some space").ok()?;
        let block = |number| KeptBlock { first: blocks.start(number).0, hash: AtomicU64::new(0) };
        let blocks = (0..blocks.len()).map(block).collect();
        Some(Self { file, parts, record, blocks })
    }

    /// Bytes of a vertex.
    fn stride(&self) -> usize {
        self.parts.iter().map(Range::len).sum()
    }

    /// Keeps the parts of a block's records, unless there is no room for them.
    pub fn put(&self, block: Compressed<'_>, records: &[u8]) {
        let Some(KeptBlock { first, hash }) = self.blocks.get(block.number) else { return };
        let stride = self.stride();
        let (at, bytes) = (first.saturating_mul(stride as u64), records.len() / self.record * stride);
        if at.saturating_add(bytes as u64) > MOST {
            return;
        }
        let mut packed = Vec::with_capacity(bytes);
        for record in records.chunks_exact(self.record) {
            self.parts.iter().for_each(|part| packed.extend_from_slice(&record[part.clone()]));
        }
        if self.file.write_at(&packed, at).is_ok() {
            hash.store(block.hash(), Ordering::Release);
        }
    }

    /// Fills in the kept parts of the records of a block; `false` if these are not there.
    pub fn get(&self, block: Compressed<'_>, records: &mut [u8]) -> bool {
        let Some(KeptBlock { first, hash }) = self.blocks.get(block.number) else { return false };
        let hash = hash.load(Ordering::Acquire);
        if hash == 0 || hash != block.hash() {
            return false;
        }
        let stride = self.stride();
        let mut packed = vec![0; records.len() / self.record * stride];
        if self.file.read_at(&mut packed, first * stride as u64).is_err() {
            return false;
        }
        for (mut packed, record) in packed.chunks_exact(stride).zip(records.chunks_exact_mut(self.record)) {
            for part in &self.parts {
                let (here, rest) = packed.split_at(part.len());
                record[part.clone()].copy_from_slice(here);
                packed = rest;
            }
        }
        true
    }
}
