//! Solutions by a factor: forward from the leaves of the tree to its root, and back.

use crate::front::{Front, Update};
use crate::kernels::{Below, FrontTriangle, KernelLanes, Sides, Stored, WIDTH, clear, gather, lanes, row_of};
use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;

/// Rows of a front that one thread works on at once, in lanes.
const TOGETHER: usize = 64;

/// Fronts one after another, as far as solutions need them, in entries of a type.
#[derive(Debug)]
pub struct FrontRun<T> {
    /// The unknowns that they eliminate.
    pub columns: Range<usize>,
    /// Other unknowns that these have to do with, relative to those of the last run, whose they are.
    pub beyond: Vec<u32>,
    fronts: Vec<FrontShape>,
    /// The fronts' rows below their columns: unknowns relative to the run's; beyond, places in `beyond`.
    rows: Vec<u32>,
    /// The fronts' triangles: columns from the diagonal on.
    triangles: Vec<T>,
    /// The fronts' entries below their triangles, column by column.
    below: Vec<KernelLanes<T>>,
}

/// Shape of a front: its unknowns, and the places of its entries in the run's lists.
#[derive(Debug, Clone, Copy)]
struct FrontShape {
    /// The first that it eliminates, relative to the run's.
    start: usize,
    columns: usize,
    /// Number of its rows that are the run's, and of those beyond.
    inside: usize,
    beyond: usize,
    /// First index of its rows, of its triangle, and of its entries below that.
    at: [usize; 3],
}

/// A front with its entries.
struct FrontEntries<'a, T> {
    /// The unknowns that it eliminates, relative to the run's.
    columns: Range<usize>,
    inside: &'a [u32],
    beyond: &'a [u32],
    triangle: FrontTriangle<'a, T>,
    below: Below<'a, T>,
}

impl<T: Stored> FrontRun<T> {
    /// Without fronts yet.
    pub fn new(columns: Range<usize>) -> Self {
        let (fronts, rows, triangles, below) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { columns, beyond: Vec::new(), fronts, rows, triangles, below }
    }

    /// Adds a front that is factorised; gives what it passes on.
    pub fn push(&mut self, columns: Range<usize>, front: Front) -> Update {
        let (panel, update) = front.into_parts();
        let (count, height) = (columns.len(), columns.len() + update.rows.len());
        let inside = update.rows.partition_point(|r| (*r as usize) < self.columns.end);
        self.fronts.push(FrontShape {
            start: columns.start - self.columns.start,
            columns: count,
            inside,
            beyond: update.rows.len() - inside,
            at: [self.rows.len(), self.triangles.len(), self.below.len()],
        });
        let relative = |r: &u32| r - self.columns.start as u32;
        self.rows.extend(update.rows[..inside].iter().map(relative));
        self.rows.extend_from_slice(&update.rows[inside..]);
        for (j, column) in panel.chunks_exact(height.max(1)).enumerate() {
            self.triangles.extend(column[j..count].iter().map(|l| T::nearest(*l)));
            self.below.extend(lanes(&column[count..]));
        }
        update
    }

    /// Completes the run once all fronts are there: `beyond` are the rows of the last one, and `first` the
    /// first unknown of the last run.
    pub fn end(&mut self, beyond: &[u32], first: usize) {
        for shape in &self.fronts {
            for row in &mut self.rows[shape.at[0] + shape.inside..][..shape.beyond] {
                *row = beyond.partition_point(|b| b < row) as u32;
            }
        }
        self.beyond = beyond.iter().map(|r| r - first as u32).collect();
        self.rows.shrink_to_fit();
        self.triangles.shrink_to_fit();
        self.below.shrink_to_fit();
    }

    fn parts(&self) -> impl DoubleEndedIterator<Item = FrontEntries<'_, T>> {
        self.fronts.iter().map(|shape| {
            let &FrontShape { start, columns, inside, beyond, at: [row, triangle, below] } = shape;
            let (inside, beyond) = self.rows[row..][..inside + beyond].split_at(inside);
            let height = (inside.len() + beyond.len()).div_ceil(WIDTH);
            FrontEntries {
                columns: start..start + columns,
                inside,
                beyond,
                triangle: FrontTriangle {
                    values: &self.triangles[triangle..][..columns * (columns + 1) / 2],
                },
                below: Below::new(&self.below[below..][..columns * height], height, columns),
            }
        })
    }

    /// `L x = b` for the run's unknowns; takes what they do to those beyond off these.
    pub fn forward(&self, own: &mut [DVec3], beyond: &mut [DVec3]) {
        Arch::new().dispatch(Forward { run: self, own, beyond });
    }

    /// `Lᵀ x = b` for the run's unknowns, when those beyond are known.
    pub fn backward(&self, own: &mut [DVec3], beyond: &[DVec3]) {
        Arch::new().dispatch(Backward { run: self, own, beyond });
    }

    /// `L x = b` for a run that has nothing beyond, whose fronts are large: several threads share each of
    /// them.
    pub fn forward_together(&self, own: &mut [DVec3], host: &Host<'_>) -> PluginResult<()> {
        let mut known = Sides::default();
        for part in self.parts() {
            part.solve_forward(own, &mut known);
            let mut blocks: Vec<(Below<'_, T>, Sides)> =
                part.below.blocks(TOGETHER).map(|below| (below, Sides::default())).collect();
            host.parallel_blocks(&mut blocks, 1, |_, blocks| {
                for (below, sums) in blocks {
                    clear(sums, below.height());
                    Arch::new().dispatch(Times { below, known: &known, sums });
                }
            })?;
            for (rows, (_, sums)) in part.inside.chunks(TOGETHER * WIDTH).zip(&blocks) {
                rows.iter().enumerate().for_each(|(k, row)| own[*row as usize] -= row_of(sums, k));
            }
        }
        Ok(())
    }

    /// `Lᵀ x = b` likewise.
    pub fn backward_together(&self, own: &mut [DVec3], host: &Host<'_>) -> PluginResult<()> {
        for part in self.parts().rev() {
            let height = part.columns.len().div_ceil(WIDTH);
            let mut blocks: Vec<(Below<'_, T>, Sides)> =
                part.below.blocks(TOGETHER).map(|below| (below, Sides::default())).collect();
            host.parallel_blocks(&mut blocks, 1, |first, blocks| {
                let rows = part.inside.chunks(TOGETHER * WIDTH).skip(first);
                for ((below, sums), rows) in blocks.iter_mut().zip(rows) {
                    let mut known = Sides::default();
                    gather(&mut known, rows.len(), rows.iter().map(|r| own[*r as usize]));
                    clear(sums, height);
                    Arch::new().dispatch(TransposedTimes { below, known: &known, sums });
                }
            })?;
            let mut sums = Sides::default();
            clear(&mut sums, height);
            for (_, block) in &blocks {
                for (sum, part) in sums.iter_mut().zip(block) {
                    let parts = part.as_flattened();
                    sum.as_flattened_mut().iter_mut().zip(parts).for_each(|(s, p)| *s += p);
                }
            }
            part.solve_backward(own, &mut sums);
        }
        Ok(())
    }
}

/// Forward substitution through a run, compiled for several kinds of processors.
struct Forward<'a, T> {
    run: &'a FrontRun<T>,
    own: &'a mut [DVec3],
    beyond: &'a mut [DVec3],
}

struct Backward<'a, T> {
    run: &'a FrontRun<T>,
    own: &'a mut [DVec3],
    beyond: &'a [DVec3],
}

struct Times<'a, T> {
    below: &'a Below<'a, T>,
    known: &'a Sides,
    sums: &'a mut Sides,
}

struct TransposedTimes<'a, T> {
    below: &'a Below<'a, T>,
    known: &'a Sides,
    sums: &'a mut Sides,
}

impl<T: Stored> WithSimd for Forward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { run, own, beyond } = self;
        let (mut known, mut sums) = (Sides::default(), Sides::default());
        for part in run.parts() {
            part.solve_forward(own, &mut known);
            clear(&mut sums, part.below.height());
            part.below.times(&known, &mut sums);
            for (k, row) in part.inside.iter().enumerate() {
                own[*row as usize] -= row_of(&sums, k);
            }
            for (k, row) in (part.inside.len()..).zip(part.beyond) {
                beyond[*row as usize] -= row_of(&sums, k);
            }
        }
    }
}

impl<T: Stored> WithSimd for Backward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { run, own, beyond } = self;
        let (mut known, mut sums) = (Sides::default(), Sides::default());
        for part in run.parts().rev() {
            let inside = part.inside.iter().map(|r| own[*r as usize]);
            let outside = part.beyond.iter().map(|r| beyond[*r as usize]);
            gather(&mut known, part.inside.len() + part.beyond.len(), inside.chain(outside));
            clear(&mut sums, part.columns.len().div_ceil(WIDTH));
            part.below.transposed_times(&known, &mut sums);
            part.solve_backward(own, &mut sums);
        }
    }
}

impl<T: Stored> WithSimd for Times<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.below.times(self.known, self.sums);
    }
}

impl<T: Stored> WithSimd for TransposedTimes<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.below.transposed_times(self.known, self.sums);
    }
}

impl<T: Stored> FrontEntries<'_, T> {
    /// Solves for the columns, and leaves the solution in `known` as well.
    #[inline(always)]
    fn solve_forward(&self, own: &mut [DVec3], known: &mut Sides) {
        let own = &mut own[self.columns.clone()];
        gather(known, own.len(), own.iter().copied());
        self.triangle.solve(known, own.len());
        own.iter_mut().enumerate().for_each(|(j, x)| *x = row_of(known, j));
    }

    /// Solves for the columns; `sums` are what the rows below take off, and mean nothing afterwards.
    #[inline(always)]
    fn solve_backward(&self, own: &mut [DVec3], sums: &mut Sides) {
        let own = &mut own[self.columns.clone()];
        self.triangle.solve_transposed(own, sums);
    }
}
