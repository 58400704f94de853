//! Where in the stream each cell's vertices are, or its faces: what a refinement has to read again (paper
//! §6).
//!
//! A stream may come back to a cell any number of times; only so many ranges are kept, and those that have
//! the least between them become one. In files whose rows go around the model, it comes back with each row.

use std::ops::Range;

use crate::varint::{self, VarintNumbers};

/// Most bytes of all cells together, but for the least of each: 4 MiB.
const MOST: usize = 4 << 20;

/// Bytes of a cell at most, and at least: some 60 000 ranges, or 4.
const OF_A_CELL: Range<usize> = 16..1 << 18;

/// The ranges of all cells.
///
/// Memory: 64 bytes per cell and twice [`MOST`].
pub struct Ranges {
    cells: Vec<PackedRanges>,
    /// Bytes of a cell at most.
    most: usize,
    /// The cell that the stream came into last.
    last: Option<u32>,
    /// How often it came into another one.
    jumps: u64,
}

/// The ranges of a cell. All but the last are packed: each as its distance from the end of the one before,
/// and its length.
#[derive(Clone, Default)]
struct PackedRanges {
    bytes: Vec<u8>,
    /// The end of the last one that is packed.
    end: u64,
    last: Range<u64>,
}

impl PackedRanges {
    /// A range behind the others.
    fn add(&mut self, range: Range<u64>) {
        if self.last.end == range.start && !self.last.is_empty() {
            self.last.end = range.end;
            return;
        }
        let last = std::mem::replace(&mut self.last, range);
        if !last.is_empty() {
            varint::push(last.start - self.end, &mut self.bytes);
            varint::push(last.end - last.start, &mut self.bytes);
            self.end = last.end;
        }
    }

    /// All of them, ascending and not empty.
    fn all(&self) -> Vec<Range<u64>> {
        let (mut ranges, mut end, mut numbers) = (Vec::new(), 0, VarintNumbers(&self.bytes));
        while let (Some(gap), Some(length)) = (numbers.next(), numbers.next()) {
            ranges.push(end + gap..end + gap + length);
            end += gap + length;
        }
        ranges.extend((!self.last.is_empty()).then(|| self.last.clone()));
        ranges
    }

    /// Joins ranges, so that about half of the bytes are left.
    fn halve(&mut self) {
        let mut ranges = self.all();
        let keep = ranges.len().div_ceil(2);
        halve(&mut ranges, keep);
        let mut halved = Self { bytes: Vec::with_capacity(self.bytes.capacity()), ..Self::default() };
        ranges.into_iter().for_each(|range| halved.add(range));
        *self = halved;
    }
}

impl Ranges {
    /// No range, of so many cells.
    pub fn new(cells: usize) -> Self {
        let most = (MOST / cells.max(1)).clamp(OF_A_CELL.start, OF_A_CELL.end);
        Self { cells: vec![PackedRanges::default(); cells], most, last: None, jumps: 0 }
    }

    /// From the first of these vertices on, up to before the end, the stream is in a cell, whose ranges are
    /// kept or not. What comes before the first visit of a piece of the stream is of no cell, so that ranges
    /// follow from the pieces, whoever reads which of them.
    pub fn visit(&mut self, cell: u32, vertices: Range<u64>, is_kept: bool) {
        let former = self.last.replace(cell);
        self.jumps += u64::from(former.is_some_and(|former| former != cell));
        if is_kept {
            self.add(cell, vertices);
        }
    }

    /// How often the stream came from one cell into another.
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    /// The ranges of each cell: ascending, and not empty.
    pub fn into_cells(self) -> impl Iterator<Item = Vec<Range<u64>>> {
        self.cells.into_iter().map(|cell| cell.all())
    }

    /// A range of a cell, none of whose others ends behind its beginning.
    pub fn add(&mut self, cell: u32, range: Range<u64>) {
        let cell = &mut self.cells[cell as usize];
        cell.add(range);
        if cell.bytes.len() > self.most {
            cell.halve();
        }
    }
}

/// Joins ranges until there are so many, where the gaps are the least. Of gaps of about the same length every
/// other one goes first, so that they do not all become one range.
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

/// All of these ranges, ascending; those that overlap, or have no more than `near` between them, are one.
pub(crate) fn joined(ranges: impl Iterator<Item = Range<u64>>, near: u64) -> Vec<Range<u64>> {
    let mut all: Vec<_> = ranges.collect();
    all.sort_unstable_by_key(|range| range.start);
    let mut joined: Vec<Range<u64>> = Vec::new();
    for range in all {
        match joined.last_mut() {
            Some(last) if range.start.saturating_sub(last.end) <= near => last.end = last.end.max(range.end),
            _ => joined.push(range),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn with_most(cells: usize, most: usize) -> Ranges {
        Ranges { most, ..Ranges::new(cells) }
    }

    proptest! {
        #[test]
        fn ranges_hold_every_vertex_of_their_cell(
            stream in proptest::collection::vec((0u32..5, 1u64..1_000_000), 1..2000), most in 16usize..2000,
        ) {
            let mut ranges = with_most(5, most);
            // Visits of any length.
            let mut visits = Vec::new();
            let mut first = 0;
            for (cell, length) in stream {
                ranges.visit(cell, first..first + length, true);
                visits.push((cell, first..first + length));
                first += length;
            }
            let cells: Vec<_> = ranges.into_cells().collect();
            for (cell, visit) in visits {
                let within = |r: &Range<u64>| r.start <= visit.start && visit.end <= r.end;
                prop_assert!(cells[cell as usize].iter().any(within));
            }
            for ranges in cells {
                // Each takes two bytes at least.
                prop_assert!(ranges.len() <= most / 2 + 1);
                prop_assert!(ranges.iter().all(|r| r.start < r.end));
                prop_assert!(ranges.windows(2).all(|w| w[0].end < w[1].start));
            }
        }
    }

    #[test]
    fn what_is_near_is_merged_first() {
        let mut ranges = with_most(2, 1024);
        // Two visits are close together, the others are as far apart as each other.
        let visits: Vec<u64> =
            (0..=18).map(|i| i * 1000).chain([18_010]).chain((19..400).map(|i| i * 1000)).collect();
        for start in &visits {
            ranges.visit(0, *start..start + 5, true);
        }
        let cells: Vec<_> = ranges.into_cells().collect();
        assert!((100..400).contains(&cells[0].len()), "{}", cells[0].len());
        assert!(cells[0].iter().any(|r| r.start <= 18_000 && r.end >= 18_015));
        assert!(cells[0].iter().all(|r| r.end - r.start < 10_000), "{:?}", cells[0]);
    }

    #[test]
    fn many_cells_have_little_each() {
        assert_eq!(Ranges::new(1 << 20).most, 16);
        assert_eq!(Ranges::new(1 << 15).most, 128);
        assert_eq!(Ranges::new(1).most, 1 << 18);
    }
}
