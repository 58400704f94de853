//! The side conditions of kernels with an affine part: sums `Σ w_j q(c_j)` over all affine functions `q`
//! are 0.

use crate::kernel::{Point, RadialKernel};
use faer::{Mat, MatMut, MatRef};

/// Part of the largest affine function below which a function at the centres is none of its own: centres on
/// a plane.
const FLAT: f64 = 1e-6;

/// An orthonormal basis of the affine functions at some centres.
#[derive(Debug)]
pub struct SideConditions {
    /// Basis, centres x functions; no column for kernels that have no affine part.
    basis: Mat<f64>,
    /// Coefficients of the basis in terms of 1, x, y and z: 4 x functions.
    made_of: Mat<f64>,
}

impl SideConditions {
    /// Basis at these centres, by Gram and Schmidt, each twice against rounding.
    pub fn new(kernel: RadialKernel, centers: &[Point]) -> Self {
        let affine = kernel.affine();
        let (mut basis, mut made_of): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        for function in 0..affine {
            let value = |c: &Point| if function == 0 { 1.0 } else { c[function - 1] };
            let mut values: Vec<f64> = centers.iter().map(value).collect();
            let mut made: Vec<f64> = (0..affine).map(|f| f64::from(u8::from(f == function))).collect();
            let whole = length(&values);
            for _ in 0..2 {
                for (other, how) in basis.iter().zip(&made_of) {
                    let share: f64 = other.iter().zip(&values).map(|(a, b)| a * b).sum();
                    values.iter_mut().zip(other).for_each(|(v, o)| *v -= share * o);
                    made.iter_mut().zip(how).for_each(|(m, h)| *m -= share * h);
                }
            }
            let left = length(&values);
            if left > FLAT * whole {
                values.iter_mut().for_each(|v| *v /= left);
                made.iter_mut().for_each(|m| *m /= left);
                basis.push(values);
                made_of.push(made);
            }
        }
        let matrix = |rows: usize, of: &[Vec<f64>]| Mat::from_fn(rows, of.len(), |i, j| of[j][i]);
        Self { basis: matrix(centers.len(), &basis), made_of: matrix(affine, &made_of) }
    }

    /// Takes the affine functions out of the columns of a matrix.
    pub fn take_out(&self, mut columns: MatMut<'_, f64>) {
        if self.basis.ncols() > 0 {
            let shares = self.basis.transpose() * columns.as_ref();
            columns -= &self.basis * shares;
        }
    }

    /// Affine functions that are nearest to columns: coefficients of 1, x, y and z.
    pub fn nearest(&self, columns: MatRef<'_, f64>) -> Mat<f64> {
        &self.made_of * (self.basis.transpose() * columns)
    }

    /// Makes a symmetric matrix one that has the affine functions for eigenvectors, with the mean of the
    /// others' eigenvalues, and is otherwise the same. Returns that mean.
    pub fn complete(&self, matrix: &mut Mat<f64>) -> f64 {
        self.take_out(matrix.as_mut());
        let mut turned = matrix.transpose().to_owned();
        self.take_out(turned.as_mut());
        let count = turned.nrows().saturating_sub(self.basis.ncols()).max(1);
        let mean = (0..turned.nrows()).map(|i| turned[(i, i)]).sum::<f64>().abs() / count as f64;
        turned += mean * &self.basis * self.basis.transpose();
        *matrix = turned;
        mean
    }
}

fn length(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_of_a_plane_have_three() {
        let centers: Vec<Point> = (0..40).map(|i| [f64::from(i).sin(), f64::from(i).cos(), 0.25]).collect();
        let side = SideConditions::new(RadialKernel::Triharmonic, &centers);
        assert_eq!(side.basis.ncols(), 3);
        let columns = Mat::from_fn(40, 1, |i, _| 2.0 - centers[i][0] + 3.0 * centers[i][1]);
        let found = side.nearest(columns.as_ref());
        for (i, c) in centers.iter().enumerate() {
            let value = found[(0, 0)] + (0..3).map(|k| found[(k + 1, 0)] * c[k]).sum::<f64>();
            assert!((value - columns[(i, 0)]).abs() < 1e-12);
        }
        let mut left = columns.clone();
        side.take_out(left.as_mut());
        assert!(left.norm_max() < 1e-12);
        assert_eq!(SideConditions::new(RadialKernel::CompactC2, &centers).basis.ncols(), 0);
    }
}
