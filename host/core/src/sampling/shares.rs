//! The division of clustering among units of work: each range of the stream has the cells that lie wholly
//! within, and the others, which ranges share, are divided into groups.

use std::ops::Range;

use super::grid::{CellRecord, Grid};

/// Vertices that are gathered as one piece of the stream, from each multiple of this number on: of soups,
/// whole facets. A constant, so that sums depend neither on the number of threads nor on how the model is
/// read.
pub const PIECE: u64 = 3 << 11;

/// The unit that clusters a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// The range of this number.
    Range(u32),
    /// The group of this number.
    Group(u32),
}

/// The owners of all cells.
///
/// Memory: 8 bytes per cell.
pub struct Shares {
    ranges: Vec<Range<u64>>,
    groups: u32,
    owners: Vec<Owner>,
}

/// Ranges of the `vertices` of a model, of about the same length, each of whole pieces of the stream: at most
/// `count`, and none of them empty.
pub fn ranges(vertices: u64, count: u64) -> Vec<Range<u64>> {
    let pieces = vertices.div_ceil(PIECE);
    let count = count.clamp(1, pieces.max(1));
    let at = |share: u64| {
        let piece = (u128::from(pieces) * u128::from(share) / u128::from(count)) as u64;
        (piece * PIECE).min(vertices)
    };
    (0..count).map(|share| at(share)..at(share + 1)).collect()
}

impl Shares {
    /// Shares of the cells of a model whose vertices are in such [`ranges`], and of `groups` groups: of cells
    /// that the stream meets one after another, with about as many vertices in each.
    pub fn new(grid: &Grid, ranges: Vec<Range<u64>>, groups: u32) -> Self {
        let within = |first: u64, last: u64| {
            let at = ranges.partition_point(|range| range.end <= first);
            ranges.get(at).filter(|range| last < range.end).map(|_| at as u32)
        };
        let alone: Vec<Option<u32>> = grid.records.iter().map(|r| within(r.first, r.last)).collect();
        let shared = || grid.records.iter().zip(&alone).filter(|(_, alone)| alone.is_none());
        let all: u64 = shared().map(|(record, _)| record.count).sum();
        let (groups, mut before) = (groups.max(1), 0u64);
        let owner = |(record, alone): (&CellRecord, &Option<u32>)| match alone {
            Some(range) => Owner::Range(*range),
            None => {
                let group = u128::from(before) * u128::from(groups) / u128::from(all.max(1));
                before += record.count;
                Owner::Group(group as u32)
            }
        };
        let owners = grid.records.iter().zip(&alone).map(owner).collect();
        Self { ranges, groups, owners }
    }

    /// The unit that clusters a cell.
    #[inline]
    pub fn owner(&self, cell: u32) -> Owner {
        self.owners[cell as usize]
    }

    /// The vertices of each range.
    pub fn ranges(&self) -> &[Range<u64>] {
        &self.ranges
    }

    /// The range that a vertex is in.
    pub fn range_of(&self, vertex: u64) -> u32 {
        self.ranges.partition_point(|range| range.end <= vertex) as u32
    }

    /// Number of vertices in the cells of a group.
    pub fn vertices_of_group(&self, grid: &Grid, group: u32) -> u64 {
        let is_of_group = |(_, owner): &(_, &Owner)| **owner == Owner::Group(group);
        grid.records.iter().zip(&self.owners).filter(is_of_group).map(|(record, _)| record.count).sum()
    }

    /// Number of groups.
    pub fn groups(&self) -> u32 {
        self.groups
    }

    /// Number of vertices in cells that ranges share.
    pub fn shared_vertices(&self, grid: &Grid) -> u64 {
        let is_shared = |(_, owner): &(_, &Owner)| matches!(owner, Owner::Group(_));
        grid.records.iter().zip(&self.owners).filter(is_shared).map(|(record, _)| record.count).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::grid::GridCounter;
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranges_are_all_of_it_in_whole_pieces(vertices in 0u64..1 << 40, count in 0u64..3000) {
            let ranges = ranges(vertices, count);
            let mut next = 0;
            for range in &ranges {
                prop_assert_eq!(range.start, next);
                prop_assert!(range.start % PIECE == 0 && (range.end > range.start || vertices == 0));
                next = range.end;
            }
            prop_assert_eq!(next, vertices);
            prop_assert!(ranges.len() as u64 <= count.max(1));
        }

        #[test]
        fn each_cell_is_of_the_one_who_has_all_of_it(
            steps in proptest::collection::vec(0u32..40, 1..60), count in 1u64..6, groups in 1u32..5,
        ) {
            let mut counter = GridCounter::new(64);
            // Each step is half of a piece in a cell.
            let (mut visits, mut vertex) = (Vec::new(), 0);
            for step in &steps {
                visits.push((*step, vertex, vertex + PIECE / 2));
                for index in [vertex, vertex + PIECE / 2 - 1] {
                    counter.add(DVec3::new(f64::from(*step) + 0.5, 0.0, 0.0), index);
                }
                vertex += PIECE / 2;
            }
            counter.add(DVec3::new(-20.0, 0.0, 0.0), vertex);
            let grid = counter.finish();
            let shares = Shares::new(&grid, ranges(vertex + 1, count), groups);
            let mut shared = 0;
            for (cell, record) in (0..).zip(&grid.records) {
                let of = |vertex| shares.ranges().iter().position(|range| range.contains(&vertex));
                match shares.owner(cell) {
                    Owner::Range(range) => {
                        prop_assert_eq!(of(record.first), Some(range as usize));
                        prop_assert_eq!(of(record.last), Some(range as usize));
                    }
                    Owner::Group(group) => {
                        prop_assert!(group < groups && of(record.first) != of(record.last));
                        shared += record.count;
                    }
                }
            }
            prop_assert_eq!(shares.shared_vertices(&grid), shared);
        }
    }
}
