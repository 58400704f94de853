//! Sparse Cholesky factorisation of symmetric positive definite matrices, and solutions by it.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::supernodal::{SupernodalLltRef, SupernodeRef};
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Mat, Par, Side};
use glam::DVec3;
use simod_plugin_api::{ErrorCode, Host, PluginError, PluginResult};

/// What is added to the diagonal, relative to it, until rounding leaves the matrix positive definite.
const RIDGES: [f64; 5] = [0.0, 1e-14, 1e-12, 1e-10, 1e-8];

/// One triangle of a symmetric matrix, by rows: columns up to the diagonal, ascending.
#[derive(Debug)]
pub struct Symmetric {
    starts: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
}

impl Default for Symmetric {
    fn default() -> Self {
        Self { starts: vec![0], columns: Vec::new(), values: Vec::new() }
    }
}

impl Symmetric {
    /// Adds a row; the last entry is the diagonal.
    pub fn push_row(&mut self, entries: impl IntoIterator<Item = (usize, f64)>) {
        for (column, value) in entries {
            self.columns.push(column);
            self.values.push(value);
        }
        self.starts.push(self.columns.len());
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }
}

/// A factorised matrix. All is done on one thread, so that results do not depend on their number.
#[derive(Debug)]
pub struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
}

impl Factor {
    /// Factorises.
    pub fn new(mut matrix: Symmetric, host: &Host<'_>) -> PluginResult<Self> {
        let n = matrix.len();
        let diagonal: Vec<f64> = matrix.starts[1..].iter().map(|end| matrix.values[end - 1]).collect();
        // Rows of the lower triangle are columns of the upper one.
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &matrix.starts, None, &matrix.columns);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..CholeskySymbolicParams::default()
        };
        let symbolic = factorize_symbolic_cholesky(pattern, Side::Upper, SymmetricOrdering::Amd, params)
            .map_err(|e| PluginError::internal(format!("the factorisation cannot be planned: {e:?}")))?;
        let need = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, faer::Spec::default());
        let mut memory = MemBuffer::try_new(need).map_err(|_| out_of_memory())?;
        let mut values = vec![0.0; symbolic.len_val()];
        for ridge in RIDGES {
            host.progress(0.0)?;
            for (end, d) in matrix.starts[1..].iter().zip(&diagonal) {
                matrix.values[end - 1] = d * (1.0 + ridge);
            }
            let pattern = SymbolicSparseColMatRef::new_checked(n, n, &matrix.starts, None, &matrix.columns);
            let done = symbolic.factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(pattern, &matrix.values),
                Side::Upper,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                faer::Spec::default(),
            );
            let positive = match done {
                Ok(_) => true,
                Err(LltError::NonPositivePivot { .. }) => false,
            };
            if positive && values.iter().all(|x| x.is_finite()) {
                return Ok(Self { symbolic, values });
            }
        }
        Err(PluginError::new(ErrorCode::NOT_CONVERGED, "the surface's equations are singular")
            .hint("add a fixed region, or sample the model anew"))
    }

    /// Replaces three right-hand sides by solutions, all in one pass over the factor: that is what takes the time.
    pub fn solve(&self, sides: &mut [DVec3]) -> PluginResult<()> {
        let (SymbolicCholeskyRaw::Supernodal(symbolic), Some(order)) =
            (self.symbolic.raw(), self.symbolic.perm().map(|p| p.arrays().0))
        else {
            // A diagonal matrix has none.
            return self.solve_without_supernodes(sides);
        };
        let lower = SupernodalLltRef::new(symbolic, &self.values);
        let mut x: Vec<DVec3> = order.iter().map(|i| sides[*i]).collect();
        let mut front = Front::default();
        for s in 0..symbolic.n_supernodes() {
            front.forward(lower.supernode(s), &mut x);
        }
        for s in (0..symbolic.n_supernodes()).rev() {
            front.backward(lower.supernode(s), &mut x);
        }
        order.iter().zip(x).for_each(|(i, x)| sides[*i] = x);
        Ok(())
    }
}

impl Factor {
    fn solve_without_supernodes(&self, sides: &mut [DVec3]) -> PluginResult<()> {
        let need = self.symbolic.solve_in_place_scratch::<f64>(3, Par::Seq);
        let mut memory = MemBuffer::try_new(need).map_err(|_| out_of_memory())?;
        let mut columns = Mat::from_fn(sides.len(), 3, |i, k| sides[i][k]);
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            columns.as_mut(),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        for (i, side) in sides.iter_mut().enumerate() {
            *side = DVec3::new(columns[(i, 0)], columns[(i, 1)], columns[(i, 2)]);
        }
        Ok(())
    }
}

/// Values at the rows of a supernode, coordinate by coordinate.
#[derive(Default)]
struct Front([Vec<f64>; 3]);

impl Front {
    fn clear(&mut self, rows: usize) {
        for side in &mut self.0 {
            side.clear();
            side.resize(rows, 0.0);
        }
    }

    fn at(&self, row: usize) -> DVec3 {
        DVec3::new(self.0[0][row], self.0[1][row], self.0[2][row])
    }

    fn set(&mut self, row: usize, value: DVec3) {
        self.0.iter_mut().zip(value.to_array()).for_each(|(side, v)| side[row] = v);
    }

    /// `L x = b` for the supernode's columns; takes what they do to the rows below off these.
    fn forward(&mut self, supernode: SupernodeRef<'_, usize, f64>, x: &mut [DVec3]) {
        let lower = supernode.val();
        let (rows, columns) = (lower.nrows(), lower.ncols());
        self.clear(rows);
        for j in 0..columns {
            let Some(column) = lower.col(j).try_as_col_major().map(|c| c.as_slice()) else { return };
            let value = (x[supernode.start() + j] - self.at(j)) / column[j];
            x[supernode.start() + j] = value;
            for (side, v) in self.0.iter_mut().zip(value.to_array()) {
                side[j + 1..].iter_mut().zip(&column[j + 1..]).for_each(|(sum, l)| *sum += l * v);
            }
        }
        for (k, row) in supernode.pattern().iter().enumerate() {
            x[*row] -= self.at(columns + k);
        }
    }

    /// `Lᵀ x = b` for the supernode's columns, when all rows below are known.
    fn backward(&mut self, supernode: SupernodeRef<'_, usize, f64>, x: &mut [DVec3]) {
        let lower = supernode.val();
        let (rows, columns) = (lower.nrows(), lower.ncols());
        self.clear(rows);
        for (k, row) in supernode.pattern().iter().enumerate() {
            self.set(columns + k, x[*row]);
        }
        for j in (0..columns).rev() {
            let Some(column) = lower.col(j).try_as_col_major().map(|c| c.as_slice()) else { return };
            let below = |side: &Vec<f64>| dot(&column[j + 1..], &side[j + 1..]);
            let sum = DVec3::new(below(&self.0[0]), below(&self.0[1]), below(&self.0[2]));
            let value = (x[supernode.start() + j] - sum) / column[j];
            x[supernode.start() + j] = value;
            self.set(j, value);
        }
    }
}

/// A scalar product in one order, several sums side by side.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 4;
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

fn out_of_memory() -> PluginError {
    PluginError::new(ErrorCode::INVALID_INPUT, "there is not enough memory for the factorisation")
        .hint("take fewer samples")
}
