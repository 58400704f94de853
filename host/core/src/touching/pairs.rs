//! Pairs of vertices that come in no order, put into about the vertices' order: their entries in a file are
//! near each other then, and little of a large file has to be in memory at a time.

use std::path::Path;

use bytemuck::{cast_slice, cast_slice_mut};
use simod_model::Result;
use simod_model::scratch::Scratch;

use super::ADVICE;

/// Ranges of vertices at most.
const RANGES: u64 = 64;

/// Vertices of a range at least.
const LEAST: u64 = 1 << 20;

/// Pairs of a range that are written at a time.
const BLOCK: usize = 1 << 13;

const BLOCK_BYTES: u64 = (BLOCK * size_of::<[u32; 2]>()) as u64;

/// Pairs by the range of their second vertex.
///
/// Memory: 4 MiB, and a byte for each 64 KiB of a temporary file of 8 bytes per pair.
pub struct Pairs<'a> {
    folder: &'a Path,
    /// Vertices of a range.
    width: u64,
    /// Pairs of each range that are not written yet.
    held: Vec<Vec<[u32; 2]>>,
    file: Option<Scratch>,
    /// The range of each block of the file.
    blocks: Vec<u8>,
}

impl<'a> Pairs<'a> {
    /// Empty list, for a model of `vertices` vertices. The file goes to `folder`.
    pub fn new(vertices: u64, folder: &'a Path) -> Self {
        let width = vertices.div_ceil(RANGES).max(LEAST);
        let held = vec![Vec::new(); vertices.div_ceil(width) as usize];
        Self { folder, width, held, file: None, blocks: Vec::new() }
    }

    /// Takes a pair.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn push(&mut self, pair: [u32; 2]) -> Result<()> {
        let range = (u64::from(pair[1]) / self.width) as usize;
        let held = &mut self.held[range];
        held.push(pair);
        if held.len() < BLOCK {
            return Ok(());
        }
        let file = match &self.file {
            Some(file) => file,
            None => self.file.insert(Scratch::new(self.folder, ADVICE)?),
        };
        file.write_at(cast_slice(held), self.blocks.len() as u64 * BLOCK_BYTES)?;
        self.blocks.push(range as u8);
        held.clear();
        Ok(())
    }

    /// Visits all pairs, range by range of their vertices.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub fn each(self, mut visit: impl FnMut(&[[u32; 2]])) -> Result<()> {
        let mut block = vec![[0; 2]; BLOCK];
        for (range, held) in self.held.iter().enumerate() {
            let own = (0..).zip(&self.blocks).filter(|(_, of)| usize::from(**of) == range);
            for (at, _) in own {
                if let Some(file) = &self.file {
                    file.read_at(cast_slice_mut(&mut block), at * BLOCK_BYTES)?;
                    visit(&block);
                }
            }
            visit(held);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_pairs_come_back_range_by_range() {
        let vertices = 3 * LEAST + 5;
        let random = |i: u64| i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20;
        for count in [0, 1, 1000, 5 * BLOCK as u64] {
            let pair = |i: u64| [i, random(i)].map(|i| (i % vertices) as u32);
            let mut expected: Vec<[u32; 2]> = (0..count).map(pair).collect();
            let folder = std::env::temp_dir();
            let mut pairs = Pairs::new(vertices, &folder);
            expected.iter().for_each(|pair| pairs.push(*pair).expect("room"));
            assert_eq!(pairs.file.is_some(), count > 4 * BLOCK as u64);
            let mut found = Vec::new();
            pairs.each(|some| found.extend_from_slice(some)).expect("readable");
            assert!(found.is_sorted_by_key(|pair| u64::from(pair[1]) / LEAST));
            found.sort_unstable();
            expected.sort_unstable();
            assert!(found == expected, "{count} pairs");
        }
    }
}
