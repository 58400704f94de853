//! Where in the file the faces of each cell's vertices are: what a refinement has to read of them (paper §6).
//!
//! Faces are looked at in blocks between two marks of their reader, so that what is kept are bytes of the
//! file, whatever its format. A block is in the ranges of each cell that one of its faces has a corner in.

use std::ops::Range;

use super::kept_cells::CutTree;
use super::ranges::Ranges;

/// The ranges of all cells, while the faces stream.
///
/// Memory: that of [`Ranges`], and 4 bytes per sample.
pub struct FaceRanges {
    /// For each sample its cell, or the first of those that share it.
    cell_of: Vec<u32>,
    ranges: Ranges,
    /// Where the block began that the stream is in, and the cells met in it.
    open: Option<u64>,
    met: Vec<u32>,
}

impl FaceRanges {
    /// Ranges without faces yet. `trees` are those of all cells, of so many samples.
    pub fn new(trees: &[CutTree], samples: usize) -> Self {
        let mut cell_of = vec![0; samples];
        for (cell, tree) in trees.iter().enumerate().rev() {
            tree.samples.iter().for_each(|sample| cell_of[*sample as usize] = cell as u32);
        }
        Self { cell_of, ranges: Ranges::new(trees.len()), open: None, met: Vec::new() }
    }

    /// A block begins at this byte of the file, and the one before ends.
    pub fn mark(&mut self, offset: u64) {
        if let Some(start) = self.open.replace(offset).filter(|start| *start < offset) {
            self.met.iter().for_each(|cell| self.ranges.add(*cell, start..offset));
        }
        self.met.clear();
    }

    /// A face of the block has a corner in a sample's cluster.
    #[inline]
    pub fn meet(&mut self, sample: u32) {
        let cell = self.cell_of[sample as usize];
        if !self.met.contains(&cell) {
            self.met.push(cell);
        }
    }

    /// The ranges of each cell, ascending; `None` if there were no marks.
    pub fn into_cells(self, trees: &[CutTree]) -> Option<Vec<Vec<Range<u64>>>> {
        self.open?;
        let mut cells: Vec<_> = self.ranges.into_cells().collect();
        // Cells that share a sample have what was noted for the first of them.
        for (cell, tree) in trees.iter().enumerate() {
            let first = tree.samples.first().map_or(cell, |sample| self.cell_of[*sample as usize] as usize);
            if first != cell {
                cells[cell] = cells[first].clone();
            }
        }
        Some(cells)
    }
}
