//! Numbers sorted by hashes, more of them than memory holds: sorted runs in a temporary file, which are
//! merged.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::collections::binary_heap::PeekMut;
use std::path::Path;

use bytemuck::{cast_slice, cast_slice_mut};
use glam::DVec3;
use rayon::prelude::*;
use simod_model::Result;
use simod_model::scratch::Scratch;
use xxhash_rust::xxh3::xxh3_64;

use super::ADVICE;

/// A hash, its upper half first, and a number: ordered by the one and then the other.
pub type HashedNumber = [u32; 3];

/// Entries of a run.
const RUN: usize = 1 << 20;

/// Entries of each run that are read at a time while runs are merged.
const READ: usize = 1 << 12;

/// The hash of a position: the same for the same place.
pub fn hash_of(p: DVec3) -> u64 {
    // Zero has two signs.
    xxh3_64(cast_slice(&(p + 0.0).to_array()))
}

/// An entry of a hash and a number.
pub fn entry(hash: u64, number: u32) -> HashedNumber {
    [(hash >> 32) as u32, hash as u32, number]
}

/// Takes entries in any order, and gives them back in theirs.
///
/// Memory: 12 MiB, and 48 KiB for each run of a million entries; the rest in a file of 12 bytes per entry.
pub struct Sorter<'a> {
    folder: &'a Path,
    held: Vec<HashedNumber>,
    file: Option<Scratch>,
    /// Number of entries in the file: whole runs.
    written: u64,
}

/// A run that is being merged.
struct MergedRun {
    buffer: Vec<HashedNumber>,
    at: usize,
    next: u64,
    end: u64,
}

impl<'a> Sorter<'a> {
    /// A sorter without entries yet. A temporary file, should it be needed, is made in `folder`.
    pub fn new(folder: &'a Path) -> Self {
        Self { folder, held: Vec::new(), file: None, written: 0 }
    }

    /// Takes an entry.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn push(&mut self, entry: HashedNumber) -> Result<()> {
        if self.held.len() == RUN {
            self.held.par_sort_unstable();
            if self.file.is_none() {
                self.file = Some(Scratch::new(self.folder, ADVICE)?);
            }
            if let Some(file) = &self.file {
                file.write_at(cast_slice(&self.held), self.written * size_of::<HashedNumber>() as u64)?;
            }
            self.written += RUN as u64;
            self.held.clear();
        }
        self.held.push(entry);
        Ok(())
    }

    /// Calls `visit` with all entries in their order.
    ///
    /// # Errors
    /// The temporary file cannot be read, or `visit` failed.
    pub fn finish(mut self, mut visit: impl FnMut(HashedNumber) -> Result<()>) -> Result<()> {
        self.held.par_sort_unstable();
        let Some(file) = self.file else { return self.held.into_iter().try_for_each(visit) };
        let starts = (0..self.written).step_by(RUN);
        let mut runs: Vec<MergedRun> = starts
            .map(|next| MergedRun { buffer: Vec::new(), at: 0, next, end: next + RUN as u64 })
            .collect();
        runs.push(MergedRun { buffer: self.held, at: 0, next: 0, end: 0 });
        let mut heap = BinaryHeap::new();
        for (i, run) in runs.iter_mut().enumerate() {
            heap.extend(run.pop(&file)?.map(|entry| Reverse((entry, i))));
        }
        while let Some(mut least) = heap.peek_mut() {
            let Reverse((entry, i)) = *least;
            match runs[i].pop(&file)? {
                Some(next) => *least = Reverse((next, i)),
                None => _ = PeekMut::pop(least),
            }
            visit(entry)?;
        }
        Ok(())
    }
}

impl MergedRun {
    fn pop(&mut self, file: &Scratch) -> Result<Option<HashedNumber>> {
        if self.at == self.buffer.len() {
            if self.next == self.end {
                return Ok(None);
            }
            let count = READ.min((self.end - self.next) as usize);
            self.buffer.resize(count, [0; 3]);
            file.read_at(cast_slice_mut(&mut self.buffer), self.next * size_of::<HashedNumber>() as u64)?;
            (self.at, self.next) = (0, self.next + count as u64);
        }
        self.at += 1;
        Ok(self.buffer.get(self.at - 1).copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_come_back_sorted_from_memory_and_from_the_file() {
        for count in [0, 1, 1000, RUN, RUN + 1, 2 * RUN + 17] {
            let numbers = || (0..count as u64).map(|i| i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20);
            let mut expected: Vec<HashedNumber> = numbers().map(|n| entry(n, n as u32 & 7)).collect();
            let folder = std::env::temp_dir();
            let mut sorter = Sorter::new(&folder).filled(&expected);
            expected.sort_unstable();
            let mut found = Vec::new();
            let visit = |entry| {
                found.push(entry);
                Ok(())
            };
            sorter.held.reverse();
            sorter.finish(visit).expect("readable");
            assert!(found == expected, "{count} entries");
        }
    }

    impl Sorter<'_> {
        fn filled(mut self, entries: &[HashedNumber]) -> Self {
            entries.iter().for_each(|entry| self.push(*entry).expect("room"));
            self
        }
    }

    #[test]
    fn zero_is_one_place_whatever_its_sign() {
        assert_eq!(hash_of(DVec3::new(-0.0, 1.0, 0.0)), hash_of(DVec3::new(0.0, 1.0, -0.0)));
        assert_ne!(hash_of(DVec3::X), hash_of(DVec3::Y));
    }
}
