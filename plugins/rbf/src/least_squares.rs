//! Least squares whose unknowns come one after the other: a QR factorisation that grows by columns, as in
//! §4 of Botsch and Kobbelt 2005, panel by panel, so that all cores take part and a user can stop it.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::householder::{
    apply_block_householder_sequence_transpose_on_the_left_in_place_scratch as memory,
    apply_block_householder_sequence_transpose_on_the_left_in_place_with_conj as apply,
};
use faer::linalg::solvers::Qr;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Conj, Mat, MatMut, Par};
use simod_plugin_api::{Host, PluginResult};

/// Number of columns of a panel.
const PANEL: usize = 48;

/// Minimises `|A x - b|² + |ridge x|²` for many right-hand sides `b`.
pub struct RidgeRegression {
    /// Ridge, which determines unknowns that the equations leave open.
    ridge: f64,
    /// Number of equations; below them there is a row of the ridge for each unknown.
    equations: usize,
    panels: Vec<ColumnPanel>,
    /// Right-hand sides, as far as factorised.
    right: Mat<f64>,
}

/// Some columns of the factorisation.
struct ColumnPanel {
    /// Number of columns before the panel, which is also the first of its own rows.
    first: usize,
    /// The rows of R before.
    above: Mat<f64>,
    /// The decomposition of all rows after.
    own: Qr<f64>,
}

impl ColumnPanel {
    /// Factorises columns that all panels before have reflected.
    fn new(first: usize, columns: &Mat<f64>) -> Self {
        let (above, own) = columns.split_at_row(first);
        Self { first, above: above.to_owned(), own: own.qr() }
    }

    fn len(&self) -> usize {
        self.above.ncols()
    }

    /// Multiplies a matrix with the transpose of the panel's orthogonal matrix.
    fn reflect(&self, matrix: MatMut<'_, f64>) {
        let (basis, coefficients) = (self.own.Q_basis(), self.own.Q_coeff());
        let needed = memory::<f64>(basis.nrows(), coefficients.nrows(), matrix.ncols());
        let (_, rows) = matrix.split_at_row_mut(self.first);
        let mut buffer = MemBuffer::new(needed);
        apply(basis, coefficients, Conj::No, rows, Par::Seq, MemStack::new(&mut buffer));
    }
}

impl RidgeRegression {
    /// Least squares without unknowns yet, of which there will be at most `most`; `right` is equations x
    /// right-hand sides.
    pub fn new(right: &Mat<f64>, most: usize, ridge: f64) -> Self {
        let mut below = Mat::zeros(right.nrows() + most, right.ncols());
        below.subrows_mut(0, right.nrows()).copy_from(right);
        Self { ridge, equations: right.nrows(), panels: Vec::new(), right: below }
    }

    /// Number of unknowns so far.
    fn unknowns(&self) -> usize {
        self.panels.last().map_or(0, |p| p.first + p.len())
    }

    /// Adds unknowns, with their columns of A: equations x unknowns.
    pub fn append(&mut self, columns: &Mat<f64>, host: &Host<'_>) -> PluginResult<()> {
        // Panels are factorised on one thread: a result that depends on the number of cores would not be
        // the same elsewhere.
        faer::set_global_parallelism(Par::Seq);
        let (before, equations) = (self.unknowns(), self.equations);
        let part = |from: usize| {
            let some = columns.subcols(from, PANEL.min(columns.ncols() - from));
            let mut part = Mat::zeros(self.right.nrows(), some.ncols());
            part.subrows_mut(0, equations).copy_from(some);
            (0..some.ncols()).for_each(|j| part[(equations + before + from + j, j)] = self.ridge);
            part
        };
        let mut parts: Vec<Mat<f64>> = (0..columns.ncols()).step_by(PANEL).map(part).collect();
        host.parallel_blocks(&mut parts, 1, |_, part| {
            self.panels.iter().for_each(|panel| panel.reflect(part[0].as_mut()));
        })?;
        for i in 0..parts.len() {
            host.progress(0.0)?;
            let panel = ColumnPanel::new(self.unknowns(), &parts[i]);
            host.parallel_blocks(&mut parts[i + 1..], 1, |_, part| panel.reflect(part[0].as_mut()))?;
            panel.reflect(self.right.as_mut());
            self.panels.push(panel);
        }
        Ok(())
    }

    /// The unknowns for all right-hand sides, by back substitution.
    pub fn solve(&self) -> Mat<f64> {
        let mut x = self.right.subrows(0, self.unknowns()).to_owned();
        for panel in self.panels.iter().rev() {
            let (mut before, after) = x.as_mut().split_at_row_mut(panel.first);
            let mut own = after.subrows_mut(0, panel.len());
            solve_upper_triangular_in_place(panel.own.thin_R(), own.as_mut(), Par::Seq);
            before -= &panel.above * own;
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::linalg::solvers::SolveLstsq;

    #[test]
    fn columns_by_and_by_are_as_good_as_all_at_once() {
        let entry = |i: usize, j: usize| ((i * 37 + j * 101) as f64).sin() + f64::from(u8::from(i == j));
        let (matrix, right) = (Mat::from_fn(300, 170, entry), Mat::from_fn(300, 3, |i, k| entry(i, 500 + k)));
        let mut squares = RidgeRegression::new(&right, 200, 0.0);
        for (from, to) in [(0, 4), (4, 60), (60, 61), (61, 170)] {
            squares.append(&matrix.subcols(from, to - from).to_owned(), &Host::new(&())).unwrap();
        }
        let at_once = matrix.qr().solve_lstsq(&right);
        let difference = squares.solve() - at_once.subrows(0, 170);
        assert!(difference.norm_max() < 1e-9, "{}", difference.norm_max());
    }

    #[test]
    fn a_ridge_holds_what_is_open() {
        // The matrix has the same column twice.
        let matrix = Mat::from_fn(20, 2, |i, _| i as f64);
        let mut squares = RidgeRegression::new(&Mat::from_fn(20, 1, |i, _| i as f64), 2, 1e-9);
        squares.append(&matrix, &Host::new(&())).unwrap();
        let x = squares.solve();
        assert!((x[(0, 0)] + x[(1, 0)] - 1.0).abs() < 1e-6 && x.norm_max() < 10.0, "{x:?}");
    }
}
