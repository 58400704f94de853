//! Ranges of the stream with each cell's vertices, or its faces, which a refinement has to read again (paper
//! §6).
//!
//! A stream may come back to a cell any number of times; only so many ranges are kept, and those that have
//! the least between them become one. In files whose rows go around the model, the stream comes back with
//! each row.

use std::ops::Range;

use crate::varint::{self, VarintNumbers};

/// Largest number of bytes of all cells together, but for the least of each: 4 MiB.
const MOST: usize = 4 << 20;

/// Bytes of a cell at most, and at least: some 60 000 ranges, or 4.
const OF_A_CELL: Range<usize> = 16..1 << 18;

/// The ranges of all cells, or of a part of them.
///
/// Memory: 64 bytes per cell and twice [`MOST`] for all.
pub struct Ranges {
    cells: Vec<PackedRanges>,
    /// Bytes of a cell at most.
    most: usize,
}

/// Jumps of a stream from cell to cell.
#[derive(Clone, Copy, Default)]
pub struct Jumps {
    /// Cells in which the stream begins and ends.
    pub ends: Option<[u32; 2]>,
    /// Number of times that the stream comes from one cell into another.
    pub count: u64,
}

impl Jumps {
    /// The stream is in a cell next.
    pub fn visit(&mut self, cell: u32) {
        self.follow(&Self { ends: Some([cell; 2]), count: 0 });
    }

    /// The part of the stream that comes next.
    pub fn follow(&mut self, next: &Self) {
        let Some([first, last]) = next.ends else { return };
        let former = self.ends.unwrap_or([first; 2]);
        self.count += next.count + u64::from(former[1] != first);
        self.ends = Some([former[0], last]);
    }
}

/// The ranges of a cell. All but the last are packed: each as its distance from the end of the one before,
/// and its length.
#[derive(Clone, Default)]
pub struct PackedRanges {
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

    /// All ranges of a cell, ascending and not empty.
    pub fn all(&self) -> Vec<Range<u64>> {
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
    /// Empty ranges of `cells` cells.
    pub fn new(cells: usize) -> Self {
        Self::of_part(cells, cells)
    }

    /// Empty ranges of a part of `cells` cells.
    pub fn of_part(part: usize, cells: usize) -> Self {
        let most = (MOST / cells.max(1)).clamp(OF_A_CELL.start, OF_A_CELL.end);
        Self { cells: vec![PackedRanges::default(); part], most }
    }

    /// The ranges of each cell.
    pub fn into_cells(self) -> Vec<PackedRanges> {
        self.cells
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

/// Joins ranges until `keep` are left, where the gaps are the least. Of gaps of about the same length every
/// other one goes first, so that they do not all become one range.
fn halve(ranges: &mut Vec<Range<u64>>, keep: usize) {
    // Counted by their lengths' digits, as a stream in no order comes here again and again.
    let class = |i: usize| {
        let digits = (ranges[i + 1].start - ranges[i].end).checked_ilog2().map_or(0, |log| log as usize + 1);
        2 * digits + i % 2
    };
    let classes: Vec<usize> = (0..ranges.len() - 1).map(class).collect();
    let mut counts = [0; 2 * 65];
    classes.iter().for_each(|class| counts[*class] += 1);
    // Number of ranges of each class that go: the first.
    let mut left = ranges.len() - keep;
    counts.iter_mut().for_each(|count| {
        *count = left.min(*count);
        left -= *count;
    });
    let mut kept = 0;
    for (i, class) in classes.into_iter().enumerate() {
        let range = ranges[i + 1].clone();
        if counts[class] > 0 {
            counts[class] -= 1;
            ranges[kept].end = range.end;
        } else {
            kept += 1;
            ranges[kept] = range;
        }
    }
    ranges.truncate(kept + 1);
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
                ranges.add(cell, first..first + length);
                visits.push((cell, first..first + length));
                first += length;
            }
            let cells: Vec<_> = ranges.into_cells().iter().map(PackedRanges::all).collect();
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

    proptest! {
        /// The least gaps go first, every other one of about the same length, and those that come first, as
        /// by sorting.
        #[test]
        fn the_least_gaps_are_joined(
            lengths in proptest::collection::vec((1u64..4, prop_oneof![1u64..20, 1u64..1 << 40]), 1..300),
            part in 0.0..1.0f64,
        ) {
            let mut end = 0;
            let ranges: Vec<Range<u64>> = lengths
                .iter()
                .map(|(length, gap)| {
                    let start = end + gap;
                    end = start + length;
                    start..end
                })
                .collect();
            let keep = 1 + (part * (ranges.len() - 1) as f64) as usize;
            let mut order: Vec<usize> = (0..ranges.len() - 1).collect();
            order.sort_by_key(|i| ((ranges[i + 1].start - ranges[*i].end).checked_ilog2(), i % 2));
            let gone = &order[..ranges.len() - keep];
            let mut wanted: Vec<Range<u64>> = vec![ranges[0].clone()];
            for (i, range) in ranges.iter().enumerate().skip(1) {
                match wanted.last_mut() {
                    Some(last) if gone.contains(&(i - 1)) => last.end = range.end,
                    _ => wanted.push(range.clone()),
                }
            }
            let mut found = ranges;
            halve(&mut found, keep);
            prop_assert_eq!(found, wanted);
        }

        /// Jumps of the pieces of a stream add up to those of the whole.
        #[test]
        fn jumps_of_pieces_add_up(
            cells in proptest::collection::vec(0u32..3, 0..60), cut in proptest::collection::vec(0usize..60, 0..5),
        ) {
            let jumps = |cells: &[u32]| {
                let mut jumps = Jumps::default();
                cells.iter().for_each(|cell| jumps.visit(*cell));
                jumps
            };
            let mut cut: Vec<usize> = cut.into_iter().map(|at| at.min(cells.len())).collect();
            cut.extend([0, cells.len()]);
            cut.sort_unstable();
            let mut joined = Jumps::default();
            cut.windows(2).for_each(|ends| joined.follow(&jumps(&cells[ends[0]..ends[1]])));
            prop_assert_eq!(joined.count, cells.windows(2).filter(|two| two[0] != two[1]).count() as u64);
            prop_assert_eq!(joined.ends, cells.first().zip(cells.last()).map(|(first, last)| [*first, *last]));
        }
    }

    #[test]
    fn what_is_near_is_merged_first() {
        let mut ranges = with_most(2, 1024);
        // Two visits are close together, the others are as far apart as each other.
        let visits: Vec<u64> =
            (0..=18).map(|i| i * 1000).chain([18_010]).chain((19..400).map(|i| i * 1000)).collect();
        for start in &visits {
            ranges.add(0, *start..start + 5);
        }
        let cells: Vec<_> = ranges.into_cells().iter().map(PackedRanges::all).collect();
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
