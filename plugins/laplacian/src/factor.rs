//! Sparse Cholesky factorisation of symmetric positive definite matrices, and solutions by it.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
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

    /// The number of unknowns.
    pub fn len(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Replaces right-hand sides by solutions, one after the other in `columns`.
    pub fn solve(&self, columns: &mut [f64]) -> PluginResult<()> {
        let n = self.len();
        if n == 0 {
            return Ok(());
        }
        let k = columns.len() / n;
        let need = self.symbolic.solve_in_place_scratch::<f64>(k, Par::Seq);
        let mut memory = MemBuffer::try_new(need).map_err(|_| out_of_memory())?;
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(columns, n, k),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        Ok(())
    }
}

fn out_of_memory() -> PluginError {
    PluginError::new(ErrorCode::INVALID_INPUT, "there is not enough memory for the factorisation")
        .hint("take fewer samples")
}
