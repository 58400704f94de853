//! Cells that are not complete yet, held in bounded memory for any order of the stream.
//!
//! A stream in spatial order has few open cells at a time. A shuffled one opens all of them, and would hold
//! the model: when the limit is reached, the fullest cells go to a temporary file and wait there. The file
//! has no name (or loses it at once), so nothing is left of it however the process ends.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytemuck::Pod;
use simod_model::Result;
use simod_model::scratch::Scratch;

/// Items (vertices, or groups of them) in a block of memory: a cell's last block is half empty in the mean.
pub const BLOCK: usize = 32;

/// Blocks that memory is taken in.
const SLAB: usize = 256;

/// End of a chain of blocks.
const NONE: u32 = u32::MAX;

/// End of the chain of a cell's pieces in the file.
const NO_PIECE: u64 = u64::MAX;

/// Bytes that are collected to be written at once.
const AT_ONCE: usize = 256 << 10;

/// Bytes of a piece's header: the offset of the cell's former piece, and the number of items of this one.
const HEADER: usize = 16;

/// All open cells.
///
/// Memory: `limit` bytes of blocks, 32 bytes per occupied cell of the grid, and room of as much as 512 KiB
/// for the bytes that are written at once.
pub struct OpenCells<T> {
    cells: Vec<OpenCell>,
    pool: ItemPool<T>,
    spill: Spill,
}

#[derive(Clone, Copy)]
struct OpenCell {
    /// First and last block.
    head: u32,
    tail: u32,
    /// Items in memory.
    held: u32,
    /// Items in the file, and their last piece there.
    spilled: u64,
    piece: u64,
}

/// Blocks of items, chained.
struct ItemPool<T> {
    slabs: Vec<Box<[[T; BLOCK]]>>,
    next: Vec<u32>,
    free: u32,
    limit: usize,
}

/// The temporary file: pieces of cells, each with a pointer to the cell's former piece.
struct Spill {
    folder: PathBuf,
    file: Option<Arc<Scratch>>,
    /// Offset in the file at which the collected bytes will be written.
    end: u64,
    collected: Vec<u8>,
}

impl<T: Pod> OpenCells<T> {
    /// Empty cells, `cells` of them. At most `limit` bytes of items stay in memory (but at least a slab);
    /// further items go to a temporary file in `folder`.
    pub fn new(cells: usize, limit: u64, folder: &Path) -> Self {
        let cell = OpenCell { head: NONE, tail: NONE, held: 0, spilled: 0, piece: NO_PIECE };
        let blocks = limit / (BLOCK * size_of::<T>()) as u64;
        Self {
            cells: vec![cell; cells],
            pool: ItemPool {
                slabs: Vec::new(),
                next: Vec::new(),
                free: NONE,
                // Places are counted in 32 bits.
                limit: usize::try_from(blocks).unwrap_or(usize::MAX).clamp(SLAB, u32::MAX as usize / BLOCK),
            },
            spill: Spill { folder: folder.to_owned(), file: None, end: 0, collected: Vec::new() },
        }
    }

    /// Adds an item to a cell; returns the item's place, which holds until other items are moved to the file.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    #[inline]
    pub fn push(&mut self, cell: u32, item: T) -> Result<u32> {
        let at = self.cells[cell as usize].held as usize % BLOCK;
        if at == 0 {
            self.append_block(cell as usize)?;
        }
        let cell = &mut self.cells[cell as usize];
        self.pool.block_mut(cell.tail)[at] = item;
        cell.held += 1;
        Ok(cell.tail * BLOCK as u32 + at as u32)
    }

    /// The item at a place.
    #[inline]
    pub fn at_mut(&mut self, place: u32) -> &mut T {
        &mut self.pool.block_mut(place / BLOCK as u32)[place as usize % BLOCK]
    }

    /// Whether one more item of a cell finds room in memory.
    #[inline]
    pub fn has_room(&self, cell: u32) -> bool {
        !(self.cells[cell as usize].held as usize).is_multiple_of(BLOCK) || !self.pool.is_full()
    }

    /// Blocks that cells can hold in memory at a time.
    pub fn blocks(&self) -> u64 {
        (self.pool.limit / SLAB * SLAB) as u64
    }

    /// Number of a cell's items.
    #[inline]
    pub fn count(&self, cell: u32) -> u64 {
        let cell = &self.cells[cell as usize];
        cell.spilled + u64::from(cell.held)
    }

    /// Memory that all of a cell's items take, also those that are in the file.
    pub fn bytes(&self, cell: u32) -> usize {
        bytes_of::<T>(self.count(cell))
    }

    fn append_block(&mut self, cell: usize) -> Result<()> {
        if self.pool.is_full() {
            self.spill()?;
        }
        let block = self.pool.take();
        let cell = &mut self.cells[cell];
        if cell.head == NONE {
            cell.head = block;
        } else {
            self.pool.next[cell.tail as usize] = block;
        }
        cell.tail = block;
        Ok(())
    }

    /// Moves the fullest cells to the file until half of the memory is free.
    fn spill(&mut self) -> Result<()> {
        let mut fullest: Vec<u32> =
            (0..self.cells.len() as u32).filter(|c| self.cells[*c as usize].held > 0).collect();
        fullest.sort_by_key(|c| std::cmp::Reverse(self.cells[*c as usize].held));
        let mut freed = 0;
        for c in fullest {
            let cell = &mut self.cells[c as usize];
            let (spill, mut written) = (&mut self.spill, Ok(()));
            cell.piece = spill.begin(cell.piece, cell.held);
            self.pool.drain(cell, |items| {
                if written.is_ok() {
                    written = spill.append(bytemuck::cast_slice(items));
                }
            });
            written?;
            cell.spilled += u64::from(cell.held);
            freed += (cell.held as usize).div_ceil(BLOCK);
            cell.held = 0;
            if freed * 2 >= self.pool.limit {
                break;
            }
        }
        self.spill.write()
    }

    /// Removes all items of a cell.
    pub fn take(&mut self, cell: u32) -> CellItems<T> {
        let cell = &mut self.cells[cell as usize];
        let mut held = Vec::with_capacity(cell.held as usize);
        self.pool.drain(cell, |vertices| held.extend_from_slice(vertices));
        cell.held = 0;
        let piece = std::mem::replace(&mut cell.piece, NO_PIECE);
        let file = self.spill.file.clone().filter(|_| piece != NO_PIECE);
        CellItems { held, spilled: std::mem::take(&mut cell.spilled), pieces: file.map(|file| (file, piece)) }
    }
}

impl<T: Pod> ItemPool<T> {
    fn is_full(&self) -> bool {
        self.free == NONE && self.next.len() + SLAB > self.limit
    }

    fn take(&mut self) -> u32 {
        if self.free == NONE {
            let first = self.next.len() as u32;
            self.slabs.push(vec![[T::zeroed(); BLOCK]; SLAB].into_boxed_slice());
            self.next.extend((first + 1..first + SLAB as u32).chain([NONE]));
            self.free = first;
        }
        let block = self.free;
        self.free = std::mem::replace(&mut self.next[block as usize], NONE);
        block
    }

    #[inline]
    fn block_mut(&mut self, block: u32) -> &mut [T; BLOCK] {
        &mut self.slabs[block as usize / SLAB][block as usize % SLAB]
    }

    /// Hands out a cell's items, in their order, and takes its blocks back.
    fn drain(&mut self, cell: &mut OpenCell, mut visit: impl FnMut(&[T])) {
        let mut left = cell.held as usize;
        let mut block = cell.head;
        while block != NONE {
            let count = left.min(BLOCK);
            visit(&self.block_mut(block)[..count]);
            left -= count;
            let next = std::mem::replace(&mut self.next[block as usize], self.free);
            self.free = block;
            block = next;
        }
        (cell.head, cell.tail) = (NONE, NONE);
    }
}

impl Spill {
    /// Begins a piece of `items` items behind all others, with a pointer to the cell's former piece; returns
    /// the piece's offset.
    fn begin(&mut self, former: u64, items: u32) -> u64 {
        let piece = self.end + self.collected.len() as u64;
        let header = [former, items.into()].map(u64::to_le);
        self.collected.extend_from_slice(bytemuck::cast_slice(&header));
        piece
    }

    /// Appends the bytes of the next items of the piece.
    fn append(&mut self, items: &[u8]) -> Result<()> {
        self.collected.extend_from_slice(items);
        if self.collected.len() >= AT_ONCE { self.write() } else { Ok(()) }
    }

    /// Writes the collected bytes: of many cells at once, as a call of the system for each took as long as
    /// all else.
    fn write(&mut self) -> Result<()> {
        let file = match &self.file {
            Some(file) => file,
            None => self.file.insert(Arc::new(Scratch::new(&self.folder, "raise --memory-limit")?)),
        };
        file.write_at(&self.collected, self.end)?;
        self.end += self.collected.len() as u64;
        self.collected.clear();
        Ok(())
    }
}

/// Memory that `count` items take; less than a sum of several could overflow by.
fn bytes_of<T>(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX).saturating_mul(size_of::<T>()).min(usize::MAX / 2)
}

/// All items of a complete cell: those in memory, and the place of the others in the file.
pub struct CellItems<T> {
    held: Vec<T>,
    spilled: u64,
    pieces: Option<(Arc<Scratch>, u64)>,
}

impl<T: Pod> CellItems<T> {
    /// The number of items.
    pub fn count(&self) -> u64 {
        self.spilled + self.held.len() as u64
    }

    /// Memory that all items take, also those that are in the file.
    pub fn bytes(&self) -> usize {
        bytes_of::<T>(self.count())
    }

    /// Hands out the items in the order of the stream, in the least number of parts of which none has more
    /// than `limit` items, read from the file where they are there.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub fn in_parts(mut self, limit: usize, mut visit: impl FnMut(&mut [T]) -> Result<()>) -> Result<()> {
        let limit = limit.max(1);
        let Some((file, last)) = &self.pieces else {
            return self.held.chunks_mut(limit).try_for_each(visit);
        };
        // The chain leads from the last piece to the first.
        let mut pieces = Vec::new();
        let mut at = *last;
        while at != NO_PIECE {
            let mut header = [0u64; HEADER / 8];
            file.read_at(bytemuck::cast_slice_mut(&mut header), at)?;
            let [former, count] = header.map(u64::from_le);
            pieces.push((at + HEADER as u64, count));
            at = former;
        }
        let total = self.spilled + self.held.len() as u64;
        let mut part: Vec<T> = Vec::with_capacity(usize::try_from(total).map_or(limit, |n| n.min(limit)));
        for (mut at, mut count) in pieces.into_iter().rev() {
            while count > 0 {
                let n = ((limit - part.len()) as u64).min(count) as usize;
                let old = part.len();
                part.resize(old + n, T::zeroed());
                file.read_at(bytemuck::cast_slice_mut(&mut part[old..]), at)?;
                at += (n * size_of::<T>()) as u64;
                count -= n as u64;
                if part.len() == limit {
                    visit(&mut part)?;
                    part.clear();
                }
            }
        }
        let mut held = &self.held[..];
        while !held.is_empty() {
            let (now, later) = held.split_at(held.len().min(limit - part.len()));
            part.extend_from_slice(now);
            held = later;
            if part.len() == limit {
                visit(&mut part)?;
                part.clear();
            }
        }
        if !part.is_empty() {
            visit(&mut part)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Item = [u64; 4];

    proptest! {
        #[test]
        fn every_cell_gets_its_vertices_back_in_their_order(
            cells in proptest::collection::vec(0u32..40, 1..30_000), part in 1usize..500, blocks in 0u64..600,
        ) {
            let folder = tempfile::tempdir().expect("a folder");
            let mut open = OpenCells::<Item>::new(40, blocks * (BLOCK * size_of::<Item>()) as u64, folder.path());
            for (i, c) in cells.iter().enumerate() {
                let place = open.push(*c, [i as u64; 4]).expect("space");
                prop_assert_eq!(open.at_mut(place)[0], i as u64);
            }
            // The temporary file has no name.
            prop_assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
            let limit = open.pool.limit;
            prop_assert!(open.pool.next.len() <= limit);
            for c in 0..40 {
                let mut found = Vec::new();
                let vertices = open.take(c);
                vertices
                    .in_parts(part, |s| {
                        assert!(s.len() <= part);
                        found.extend(s.iter().map(|s| s[0] as usize));
                        Ok(())
                    })
                    .expect("readable");
                let wanted: Vec<usize> = (0..cells.len()).filter(|i| cells[*i] == c).collect();
                prop_assert_eq!(found, wanted);
            }
        }
    }

    #[test]
    fn a_cell_can_be_filled_again() {
        let mut open = OpenCells::<Item>::new(1, 0, std::env::temp_dir().as_path());
        for round in 0..3 {
            (0..100_000).for_each(|i| {
                open.push(0, [i; 4]).expect("space");
            });
            let mut count = 0;
            let visit = |s: &mut [Item]| {
                count += s.len();
                Ok(())
            };
            open.take(0).in_parts(usize::MAX, visit).expect("readable");
            assert_eq!(count, 100_000, "round {round}");
        }
    }
}
