//! Where in the stream each cell's vertices are, or its faces: what a refinement has to read again (paper §6).
//!
//! A stream may come back to a cell any number of times; only so many ranges are kept, and those that have the least
//! between them become one. In files whose rows go around the model, it comes back with each row.

use std::ops::Range;

/// Most ranges of all cells together, but for one each: 1 MiB.
const MOST: usize = 1 << 16;

/// Most ranges of a cell: one less than a list has room for.
const MOST_OF_A_CELL: usize = 255;

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
        if let Some((cell, start)) = self.open.take() {
            self.add(cell, start..end);
        }
    }

    /// A range of a cell, none of whose others ends behind its beginning.
    pub fn add(&mut self, cell: u32, range: Range<u64>) {
        let ranges = &mut self.cells[cell as usize];
        match ranges.last_mut() {
            Some(last) if last.end == range.start => last.end = range.end,
            _ => ranges.push(range),
        }
        if ranges.len() > self.most {
            halve(ranges, self.most.div_ceil(2));
        }
    }
}

/// Joins ranges until there are so many, where the gaps are the least. Of gaps of about the same length every other one
/// goes first, so that they do not all become one range.
fn halve(ranges: &mut Vec<Range<u64>>, keep: usize) {
    let gap = |i: usize| (ranges[i + 1].start - ranges[i].end).checked_ilog2();
    let mut order: Vec<usize> = (0..ranges.len() - 1).collect();
    order.sort_by_key(|i| (gap(*i), i % 2));
    order.truncate(ranges.len() - keep);
    order.sort_unstable();
    let mut joined = order.into_iter().peekable();
    let mut kept: Vec<Range<u64>> = Vec::with_capacity(ranges.len());
    for (i, range) in ranges.drain(..).enumerate() {
        // With the one before it.
        match kept.last_mut() {
            Some(last) if joined.next_if(|before| before + 1 == i).is_some() => last.end = range.end,
            _ => kept.push(range),
        }
    }
    *ranges = kept;
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
        // Two visits are close together, the others are as far apart as each other.
        let visits: Vec<u64> =
            (0..=18).map(|i| i * 1000).chain([18_010]).chain((19..400).map(|i| i * 1000)).collect();
        for start in &visits {
            ranges.enter(0, *start);
            ranges.enter(1, start + 5);
        }
        ranges.finish(400_000);
        let cells = ranges.into_cells();
        assert!((MOST_OF_A_CELL / 2..=MOST_OF_A_CELL).contains(&cells[0].len()), "{}", cells[0].len());
        assert!(cells[0].iter().any(|r| r.start <= 18_000 && r.end >= 18_015));
        assert!(cells[0].iter().all(|r| r.end - r.start < 10_000), "{:?}", cells[0]);
    }

    #[test]
    fn many_cells_have_few_ranges_each() {
        assert_eq!(Ranges::new(1 << 20).most, 1);
        assert_eq!(Ranges::new(1 << 15).most, 2);
        assert_eq!(Ranges::new(1).most, MOST_OF_A_CELL);
    }
}
