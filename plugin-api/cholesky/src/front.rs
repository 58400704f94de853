//! A front: the dense matrix of what is eliminated at once and what comes after it.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::{matmul, triangular};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::reborrow::{Reborrow, ReborrowMut};
use faer::{Accum, MatMut, MatRef, Par, Spec};
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;

/// Fronts of so few rows are not worth calls to others.
const SMALL: usize = 48;
/// Rows, or columns, at once on one thread.
const TOGETHER: usize = 128;

/// The update of the unknowns after an elimination.
#[derive(Debug)]
pub struct Update {
    /// The unknowns that are updated.
    pub rows: Vec<u32>,
    /// The lower triangle of a square matrix, column by column; what is above it means nothing.
    pub values: Vec<f64>,
}

/// A front.
#[derive(Debug)]
pub struct Front {
    /// Number of unknowns that are eliminated.
    pub columns: usize,
    /// Later unknowns that share entries with those, ascending.
    pub rows: Vec<u32>,
    /// The columns that are eliminated, one by one, with a row for each unknown; nothing of what is above the
    /// diagonal.
    pub panel: Vec<f64>,
    update: Vec<f64>,
}

/// Rows of a front in which some of its unknowns are.
pub fn places(rows: &[u32], columns: &Range<usize>, after: &[u32]) -> Vec<usize> {
    let mut next = 0;
    let place = |row: &u32| {
        if (*row as usize) < columns.end {
            return *row as usize - columns.start;
        }
        while after[next] != *row {
            next += 1;
        }
        columns.len() + next
    };
    rows.iter().map(place).collect()
}

impl Front {
    /// A front of zeros.
    pub fn new(columns: usize, rows: Vec<u32>) -> Self {
        let panel = vec![0.0; columns * (columns + rows.len())];
        let update = vec![0.0; rows.len() * rows.len()];
        Self { columns, rows, panel, update }
    }

    fn height(&self) -> usize {
        self.columns + self.rows.len()
    }

    /// The place of one of the rows.
    pub fn row(&self, row: u32) -> usize {
        self.columns + self.rows.partition_point(|r| *r < row)
    }

    /// An entry of the columns that are eliminated.
    pub fn entry(&mut self, row: usize, column: usize) -> &mut f64 {
        let height = self.height();
        &mut self.panel[column * height + row]
    }

    /// Adds what another elimination does, whose unknowns are at these places.
    pub fn add(&mut self, update: &Update, places: &[usize], host: Option<&Host<'_>>) -> PluginResult<()> {
        let (height, size) = (self.height(), self.rows.len());
        let own = places.partition_point(|p| *p < self.columns);
        let column = |k: usize| (&update.values[k * places.len()..][..places.len()], k);
        let add = |to: &mut [f64], k: usize, shift: usize| {
            let (from, _) = column(k);
            for (place, value) in places.iter().zip(from).skip(k) {
                to[place - shift] += value;
            }
        };
        if self.columns > 0 {
            let mut k = 0;
            for (c, to) in self.panel.chunks_exact_mut(height).enumerate() {
                if k < own && places[k] == c {
                    add(to, k, 0);
                    k += 1;
                }
            }
        }
        if size == 0 {
            return Ok(());
        }
        let columns = self.columns;
        let block = |first: usize, block: &mut [f64]| {
            let first = first / size;
            let mut k = places.partition_point(|p| *p < columns + first);
            for (c, to) in (columns + first..).zip(block.chunks_exact_mut(size)) {
                if k < places.len() && places[k] == c {
                    add(to, k, columns);
                    k += 1;
                }
            }
        };
        match host {
            Some(host) => host.parallel_blocks(&mut self.update, size * TOGETHER, block),
            None => {
                block(0, &mut self.update);
                Ok(())
            }
        }
    }

    /// Eliminates the columns; `false` if the matrix is not positive definite.
    pub fn factorise(&mut self, host: Option<&Host<'_>>) -> PluginResult<bool> {
        if self.columns == 0 {
            return Ok(true);
        }
        if self.height() <= SMALL {
            return Ok(self.factorise_small());
        }
        let (height, columns, size) = (self.height(), self.columns, self.rows.len());
        let panel = MatMut::from_column_major_slice_mut(&mut self.panel, height, columns);
        let (mut own, mut below) = panel.split_at_row_mut(columns);
        let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(columns, Par::Seq, Spec::default()));
        let done = cholesky_in_place(
            own.rb_mut(),
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut memory),
            Spec::default(),
        );
        if done.is_err() {
            return Ok(false);
        }
        let own = own.rb();
        let solve = |rows: MatMut<'_, f64>| {
            solve_lower_triangular_in_place(own, rows.transpose_mut(), Par::Seq);
        };
        match host {
            Some(host) => host.parallel_blocks(&mut in_blocks(below.rb_mut()), 1, |_, blocks| {
                blocks.iter_mut().for_each(|block| solve(block.rb_mut()));
            })?,
            None => solve(below.rb_mut()),
        }
        let below = below.rb();
        let block = |first: usize, block: &mut [f64]| {
            let first = first / size.max(1);
            let count = block.len() / size;
            let block = MatMut::from_column_major_slice_mut(block, size, count);
            subtract_square(block, below, first);
        };
        match host {
            Some(host) if size > 0 => host.parallel_blocks(&mut self.update, size * TOGETHER, block)?,
            None if size > 0 => block(0, &mut self.update),
            _ => {}
        }
        Ok(self.panel.iter().all(|x| x.is_finite()))
    }

    fn factorise_small(&mut self) -> bool {
        let (height, columns, size) = (self.height(), self.columns, self.rows.len());
        for j in 0..columns {
            let (done, rest) = self.panel.split_at_mut((j + 1) * height);
            let column = &mut done[j * height..];
            let pivot = column[j].sqrt();
            if !(pivot > 0.0 && pivot.is_finite()) {
                return false;
            }
            column[j] = pivot;
            column[j + 1..].iter_mut().for_each(|x| *x /= pivot);
            for (k, to) in (j + 1..).zip(rest.chunks_exact_mut(height)) {
                let by = column[k];
                to[k..].iter_mut().zip(&column[k..]).for_each(|(x, y)| *x -= by * y);
            }
            let below = &column[columns..];
            for k in 0..size {
                let by = below[k];
                let to = &mut self.update[k * size..][..size];
                to[k..].iter_mut().zip(&below[k..]).for_each(|(x, y)| *x -= by * y);
            }
        }
        true
    }

    /// Returns the panel, and the update that is passed on to the front's parent.
    pub fn into_parts(self) -> (Vec<f64>, Update) {
        (self.panel, Update { rows: self.rows, values: self.update })
    }
}

/// Takes `B Bᵀ` off the lower triangle of its columns from `first` on.
fn subtract_square(block: MatMut<'_, f64>, below: MatRef<'_, f64>, first: usize) {
    let end = first + block.ncols();
    let (_, block) = block.split_at_row_mut(first);
    let (diagonal, rest) = block.split_at_row_mut(end - first);
    let own = below.subrows(first, end - first);
    let after = below.subrows(end, below.nrows() - end);
    use triangular::BlockStructure::{Rectangular, TriangularLower};
    triangular::matmul(
        diagonal,
        TriangularLower,
        Accum::Add,
        own,
        Rectangular,
        own.transpose(),
        Rectangular,
        -1.0,
        Par::Seq,
    );
    matmul(rest, Accum::Add, after, own.transpose(), -1.0, Par::Seq);
}

/// A matrix as blocks of [`TOGETHER`] rows, the last one of what is left.
fn in_blocks(mut rest: MatMut<'_, f64>) -> Vec<MatMut<'_, f64>> {
    let mut blocks = Vec::new();
    while rest.nrows() > 0 {
        let count = TOGETHER.min(rest.nrows());
        let (block, after) = rest.split_at_row_mut(count);
        blocks.push(block);
        rest = after;
    }
    blocks
}
