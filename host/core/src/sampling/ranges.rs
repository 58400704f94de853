//! Where in the stream each cell's vertices are: what a refinement has to read again (paper §6).
//!
//! A stream may come back to a cell any number of times; only so many ranges are kept, and those that have the least
//! between them become one.

use std::ops::Range;

/// Most ranges of all cells together, but for one each: 2 MiB.
const MOST: usize = 1 << 17;

/// Most ranges of a cell.
const MOST_OF_A_CELL: usize = 16;

/// The ranges of all cells.
///
/// Memory: 40 bytes per cell and those of [`MOST`] ranges.
pub struct Ranges {
    cells: Vec<Vec<Range<u64>>>,
    most: usize,
    /// The cell that the stream is in, and since which vertex.
    open: Option<(u32, u64)>,
}

impl Ranges {
    /// No range, of so many cells.
    pub fn new(cells: usize) -> Self {
        let most = (MOST / cells.max(1)).clamp(1, MOST_OF_A_CELL);
        Self { cells: vec![Vec::new(); cells], most, open: None }
    }

    /// From this vertex on the stream is in a cell.
    pub fn enter(&mut self, cell: u32, vertex: u64) {
        match self.open {
            Some((open, _)) if open == cell => {}
            _ => {
                self.close(vertex);
                self.open = Some((cell, vertex));
            }
        }
    }

    /// The stream ends before this vertex.
    pub fn finish(&mut self, vertex: u64) {
        self.close(vertex);
    }

    /// The ranges of each cell: ascending, and not empty.
    pub fn into_cells(self) -> Vec<Vec<Range<u64>>> {
        self.cells
    }

    fn close(&mut self, end: u64) {
        let Some((cell, start)) = self.open.take() else { return };
        let ranges = &mut self.cells[cell as usize];
        ranges.push(start..end);
        if ranges.len() > self.most {
            let gap = |i: &usize| ranges[i + 1].start - ranges[*i].end;
            if let Some(i) = (0..ranges.len() - 1).min_by_key(gap) {
                ranges[i].end = ranges[i + 1].end;
                ranges.remove(i + 1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranges_hold_every_vertex_of_their_cell(stream in proptest::collection::vec(0u32..5, 1..2000)) {
            let mut ranges = Ranges::new(5);
            (0..).zip(&stream).for_each(|(i, cell)| ranges.enter(*cell, i));
            ranges.finish(stream.len() as u64);
            let cells = ranges.into_cells();
            for (i, cell) in (0u64..).zip(&stream) {
                prop_assert!(cells[*cell as usize].iter().any(|range| range.contains(&i)));
            }
            for ranges in cells {
                prop_assert!(ranges.len() <= MOST_OF_A_CELL);
                prop_assert!(ranges.iter().all(|r| r.start < r.end));
                prop_assert!(ranges.windows(2).all(|w| w[0].end <= w[1].start));
            }
        }
    }

    #[test]
    fn what_is_near_is_merged_first() {
        let mut ranges = Ranges::new(2);
        // Twenty visits, of which the last two are close together.
        let visits: Vec<u64> = (0..19).map(|i| i * 1000).chain([18_010]).collect();
        for start in &visits {
            ranges.enter(0, *start);
            ranges.enter(1, start + 5);
        }
        ranges.finish(20_000);
        let cells = ranges.into_cells();
        assert_eq!(cells[0].len(), MOST_OF_A_CELL);
        assert!(cells[0].contains(&(18_000..18_015)));
    }

    #[test]
    fn many_cells_have_few_ranges_each() {
        assert_eq!(Ranges::new(1 << 20).most, 1);
        assert_eq!(Ranges::new(1 << 15).most, 4);
    }
}
