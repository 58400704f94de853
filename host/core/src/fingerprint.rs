//! The hash of the bytes of all vertices, which tells whether a model is the one that was sampled.
//!
//! The hash is that of the hashes of blocks of 256 KiB, so that readers of a part each find the blocks of
//! theirs. Former versions hashed all bytes as they came: where such a hash is known, it is compared with one
//! of its kind.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::{Xxh3Default, xxh3_128};

/// Bytes of a block.
const BLOCK: u64 = 1 << 18;

/// First letters of a fingerprint that is a hash over blocks.
const BLOCKS: &str = "xxh3-128-blocks:";

/// A hash of former kinds, or of anything but vertices, as it stands in files.
pub(crate) fn fingerprint(hash: u128) -> String {
    format!("xxh3-128:{hash:032x}")
}

/// Whether two fingerprints are of the same vertices; `None` where the two are of different kinds.
pub fn are_same(a: &str, b: &str) -> Option<bool> {
    (a.starts_with(BLOCKS) == b.starts_with(BLOCKS)).then_some(a == b)
}

/// Hashes the bytes of all vertices, in their order.
pub(crate) enum VertexHash {
    Blocks(Box<BlockHash>),
    /// The hash of the whole stream, as former versions had it.
    Stream(Box<Xxh3Default>),
}

impl Default for VertexHash {
    fn default() -> Self {
        Self::Blocks(Box::default())
    }
}

impl VertexHash {
    /// A hash of the same kind as a known fingerprint.
    pub fn like(known: &str) -> Self {
        if known.starts_with(BLOCKS) { Self::default() } else { Self::Stream(Box::default()) }
    }

    /// Takes the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        match self {
            Self::Blocks(blocks) => blocks.update(bytes),
            Self::Stream(hash) => hash.update(bytes),
        }
    }

    /// The fingerprint of all bytes, as it stands in files.
    pub fn fingerprint(&self) -> String {
        match self {
            Self::Blocks(blocks) => blocks.fingerprint(),
            Self::Stream(hash) => fingerprint(hash.digest128()),
        }
    }
}

/// A hash over blocks.
#[derive(Default)]
pub(crate) struct BlockHash {
    /// The hash of the hashes of full blocks.
    hash: Xxh3Default,
    /// The hash of the last block, which is not full yet.
    block: Xxh3Default,
    /// The number of bytes so far.
    bytes: u64,
}

impl BlockHash {
    fn update(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let room = (BLOCK - self.bytes % BLOCK) as usize;
            let (now, later) = bytes.split_at(room.min(bytes.len()));
            self.block.update(now);
            self.bytes += now.len() as u64;
            if now.len() == room {
                self.hash.update(&self.block.digest128().to_le_bytes());
                self.block.reset();
            }
            bytes = later;
        }
    }

    /// Takes the next bytes, of which the hashes of blocks are known; `false` if `part` does not begin where
    /// the bytes so far end.
    pub fn append(&mut self, part: &HashedPart) -> bool {
        if part.start != self.bytes || (!part.blocks.is_empty() && !part.after_head().is_multiple_of(BLOCK)) {
            return false;
        }
        self.update(&part.head);
        part.blocks.iter().for_each(|block| self.hash.update(&block.to_le_bytes()));
        self.bytes += BLOCK * part.blocks.len() as u64;
        self.update(&part.tail);
        true
    }

    /// The fingerprint of all bytes, as it stands in files.
    pub fn fingerprint(&self) -> String {
        let mut hash = self.hash.clone();
        if !self.bytes.is_multiple_of(BLOCK) {
            hash.update(&self.block.digest128().to_le_bytes());
        }
        format!("{BLOCKS}{:032x}", hash.digest128())
    }
}

/// Contribution of one range of the vertices' bytes to the hash of all bytes.
///
/// Memory: two blocks, and 16 bytes for each block of the part.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct HashedPart {
    /// Number of bytes before the range.
    start: u64,
    /// Bytes of a block that began before the range.
    head: Vec<u8>,
    /// The hashes of whole blocks.
    blocks: Vec<u128>,
    /// Bytes of a block that goes on behind the range.
    tail: Vec<u8>,
}

impl HashedPart {
    /// A part without bytes so far.
    pub fn new(start: u64) -> Self {
        Self { start, ..Self::default() }
    }

    fn after_head(&self) -> u64 {
        self.start + self.head.len() as u64
    }

    /// Takes the next bytes.
    pub fn update(&mut self, mut bytes: &[u8]) {
        if self.blocks.is_empty() && self.tail.is_empty() {
            let room = (self.after_head().next_multiple_of(BLOCK) - self.after_head()) as usize;
            let (head, rest) = bytes.split_at(room.min(bytes.len()));
            self.head.extend_from_slice(head);
            bytes = rest;
        }
        if !self.tail.is_empty() {
            let (tail, rest) = bytes.split_at((BLOCK as usize - self.tail.len()).min(bytes.len()));
            self.tail.extend_from_slice(tail);
            bytes = rest;
            if self.tail.len() as u64 == BLOCK {
                self.blocks.push(xxh3_128(&self.tail));
                self.tail.clear();
            }
        }
        let blocks = bytes.chunks_exact(BLOCK as usize);
        self.tail.extend_from_slice(blocks.remainder());
        self.blocks.extend(blocks.map(xxh3_128));
    }
}

/// Hasher of the bytes of a range of vertices, of those that are read of the model: more, where the range
/// begins or ends within a compressed block.
pub(crate) struct PartHasher {
    part: HashedPart,
    /// Bytes before and of the range that are still to come.
    skip: u64,
    left: u64,
}

impl PartHasher {
    /// Hasher for these bytes, counted among those of all vertices, where reading begins `skip` bytes before
    /// them.
    pub fn new(bytes: Range<u64>, skip: u64) -> Self {
        Self { part: HashedPart::new(bytes.start), skip, left: bytes.end.saturating_sub(bytes.start) }
    }

    /// Takes the next bytes that are read.
    pub fn update(&mut self, bytes: &[u8]) {
        let skip = self.skip.min(bytes.len() as u64) as usize;
        let bytes = &bytes[skip..];
        let bytes = &bytes[..self.left.min(bytes.len() as u64) as usize];
        self.skip -= skip as u64;
        self.left -= bytes.len() as u64;
        self.part.update(bytes);
    }

    /// Contribution of the bytes that were read to the hash of all; `None` unless the whole range was read.
    pub fn finish(self) -> Option<HashedPart> {
        (self.left == 0).then_some(self.part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bytes that are nowhere the same.
    fn bytes(count: usize) -> Vec<u8> {
        (0..count as u64).map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as u8).collect()
    }

    proptest! {
        #[test]
        fn parts_add_up_to_the_hash_of_all(
            count in prop_oneof![0..10usize, 0..3 * BLOCK as usize, Just(BLOCK as usize), Just(2 * BLOCK as usize)],
            cuts in proptest::collection::vec((0.0..1.0f64, any::<bool>()), 0..6),
            chunk in prop_oneof![1..70_000usize, Just(BLOCK as usize), Just(1usize << 20)],
        ) {
            let all = bytes(count);
            let chunk = chunk.max(count / 200);
            let mut whole = VertexHash::default();
            all.chunks(chunk).for_each(|some| whole.update(some));
            let mut once = VertexHash::default();
            once.update(&all);
            prop_assert_eq!(whole.fingerprint(), once.fingerprint());

            let near = |cut: f64| ((cut * count as f64) as u64).next_multiple_of(BLOCK).min(count as u64) as usize;
            let cuts = cuts.into_iter().map(|(cut, block)| if block { near(cut) } else { (cut * count as f64) as usize });
            let mut ends: Vec<usize> = cuts.chain([0, count]).collect();
            ends.sort_unstable();
            let mut joined = BlockHash::default();
            for pair in ends.windows(2) {
                let mut part = HashedPart::new(pair[0] as u64);
                all[pair[0]..pair[1]].chunks(chunk).for_each(|some| part.update(some));
                prop_assert!(part.head.len() < BLOCK as usize && part.tail.len() < BLOCK as usize);
                let sealed = postcard::to_allocvec(&part).unwrap();
                prop_assert!(joined.append(&postcard::from_bytes(&sealed).unwrap()));
            }
            prop_assert_eq!(joined.fingerprint(), once.fingerprint());
            prop_assert!(!joined.append(&HashedPart::new(count as u64 + 1)));
        }
    }

    #[test]
    fn other_bytes_have_another_hash_of_either_kind() {
        let of = |known: &str, bytes: &[u8]| {
            let mut hash = VertexHash::like(known);
            hash.update(bytes);
            hash.fingerprint()
        };
        let mut all = bytes(600_000);
        for known in ["xxh3-128:0", "xxh3-128-blocks:0"] {
            let before = of(known, &all);
            assert!(before.starts_with(known.trim_end_matches('0')), "{before}");
            assert_eq!(of(&before, &all), before);
            for at in [0, 300_000, 599_999] {
                all[at] ^= 1;
                assert_ne!(of(known, &all), before);
                all[at] ^= 1;
            }
            assert_ne!(of(known, &all[1..]), before);
        }
        assert_eq!(are_same("xxh3-128:0", "xxh3-128-blocks:0"), None);
        assert_eq!(are_same("xxh3-128-blocks:0", "xxh3-128-blocks:1"), Some(false));
        assert_eq!(are_same("xxh3-128:1", "xxh3-128:1"), Some(true));
    }
}
