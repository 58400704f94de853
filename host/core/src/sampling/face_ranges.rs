//! Ranges of the file with the faces of each cell's vertices, of which a refinement reads what it needs
//! (paper §6).
//!
//! Faces are looked at in blocks between two marks of their reader, so that ranges of bytes of the file are
//! kept, whatever its format. A block is in the ranges of each cell that one of its faces has a corner in.

use std::ops::Range;

use super::kept_cells::CutTree;
use super::ranges::{PackedRanges, Ranges};

/// The ranges of all cells, while the faces stream.
///
/// Memory: that of [`Ranges`], or 16 bytes per cell and the ranges that are not [taken](Self::take_listed)
/// yet; and 4 bytes per sample.
pub struct FaceRanges {
    /// Cell of each sample, or the first of those that share it.
    cell_of: Vec<u32>,
    ranges: KeptRanges,
    /// Offset at which the block of the stream began, and the cells met in it.
    open: Option<u64>,
    met: Vec<u32>,
}

/// The ranges that are kept, or why none are.
enum KeptRanges {
    /// Ranges are kept, as far as there is room.
    Joined(Ranges),
    /// Ranges are listed for who [joins](FaceRanges::join) them; the last one of each cell may go on.
    Listed { last: Vec<Range<u64>>, list: Vec<(u32, Range<u64>)> },
}

impl KeptRanges {
    fn add(&mut self, cell: u32, range: Range<u64>) {
        match self {
            Self::Joined(ranges) => ranges.add(cell, range),
            Self::Listed { last, list } => {
                let last = &mut last[cell as usize];
                if last.end == range.start {
                    last.end = range.end;
                    return;
                }
                let former = std::mem::replace(last, range);
                list.extend((!former.is_empty()).then_some((cell, former)));
            }
        }
    }
}

impl FaceRanges {
    /// Ranges without faces yet, of a part of the faces: to be [taken](Self::take_listed).
    pub fn listed(trees: &[CutTree], samples: usize) -> Self {
        let ranges = KeptRanges::Listed { last: vec![0..0; trees.len()], list: Vec::new() };
        Self { ranges, ..Self::new(trees, samples) }
    }

    /// Ranges of cells, those of each one in the order of the file, that were listed and cannot go on any
    /// more; at the end all that are left.
    pub fn take_listed(&mut self, is_end: bool) -> Vec<(u32, Range<u64>)> {
        let KeptRanges::Listed { last, list } = &mut self.ranges else { return Vec::new() };
        let mut taken = std::mem::take(list);
        if is_end {
            let lasts = (0..).zip(last.iter_mut()).map(|(cell, last)| (cell, std::mem::take(last)));
            taken.extend(lasts.filter(|(_, last)| !last.is_empty()));
        }
        taken
    }

    /// Takes a listed range, those of each cell in the order of the file.
    pub fn join(&mut self, cell: u32, range: Range<u64>) {
        self.open.get_or_insert(range.start);
        self.ranges.add(cell, range);
    }

    /// Ranges without faces yet. `trees` are those of all cells, of `samples` samples.
    pub fn new(trees: &[CutTree], samples: usize) -> Self {
        let mut cell_of = vec![0; samples];
        for (cell, tree) in trees.iter().enumerate().rev() {
            tree.samples.iter().for_each(|sample| cell_of[*sample as usize] = cell as u32);
        }
        Self { cell_of, ranges: KeptRanges::Joined(Ranges::new(trees.len())), open: None, met: Vec::new() }
    }

    /// The cell of a sample, or the first of those that share it.
    #[inline]
    pub fn cell_of(&self, sample: u32) -> u32 {
        self.cell_of[sample as usize]
    }

    /// A block begins at this byte of the file, and the one before ends.
    pub fn mark(&mut self, offset: u64) {
        if let Some(start) = self.open.replace(offset).filter(|start| *start < offset) {
            self.met.iter().for_each(|cell| self.ranges.add(*cell, start..offset));
        }
        self.met.clear();
    }

    /// Takes the cells met in the faces that come next.
    pub fn take(&mut self, met: &MetCells) {
        let MetCells { cells, marks, .. } = met;
        let mut at = 0;
        for (offset, before) in marks {
            self.meet(&cells[at..*before]);
            self.mark(*offset);
            at = *before;
        }
        self.meet(&cells[at..]);
    }

    fn meet(&mut self, cells: &[u32]) {
        for cell in cells {
            if !self.met.contains(cell) {
                self.met.push(*cell);
            }
        }
    }

    /// The ranges of each cell, ascending; `None` if there were no marks.
    pub fn into_cells(self, trees: &[CutTree]) -> Option<Vec<Vec<Range<u64>>>> {
        let KeptRanges::Joined(ranges) = self.ranges else { return None };
        self.open?;
        let mut cells: Vec<_> = ranges.into_cells().iter().map(PackedRanges::all).collect();
        // Cells that share a sample have the ranges noted for the first of them.
        for (cell, tree) in trees.iter().enumerate() {
            let first = tree.samples.first().map_or(cell, |sample| self.cell_of[*sample as usize] as usize);
            if first != cell {
                cells[cell] = cells[first].clone();
            }
        }
        Some(cells)
    }
}

/// The cells met in faces that follow each other, each once in a block.
///
/// Memory: 4 bytes for each cell of each block, and 16 for each mark.
#[derive(Debug, Default)]
pub struct MetCells {
    cells: Vec<u32>,
    /// Place in `cells` of the first one of the block.
    block: usize,
    /// Offset of each block in the file, and the number of cells before the block's.
    marks: Vec<(u64, usize)>,
}

impl MetCells {
    /// A block begins at this byte of the file.
    pub fn mark(&mut self, offset: u64) {
        self.block = self.cells.len();
        self.marks.push((offset, self.block));
    }

    /// A face of the block has a corner in a cell.
    #[inline]
    pub fn meet(&mut self, cell: u32) {
        // The cell is mostly the one that was met last.
        if !self.cells[self.block..].iter().rev().any(|met| *met == cell) {
            self.cells.push(cell);
        }
    }
}
