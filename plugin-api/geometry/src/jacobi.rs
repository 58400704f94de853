//! Eigenvectors of small symmetric matrices, by cyclic Jacobi rotations (G. Golub, C. Van Loan, *Matrix
//! Computations*, §8.5): slow, and right for any matrix.

/// Sweeps after which every matrix of this size has long converged.
const SWEEPS: usize = 30;

/// Eigenvalues in no order, and the unit eigenvector of each.
pub fn jacobi_eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut v: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    let scale: f64 = a.as_flattened().iter().map(|x| x.abs()).fold(0.0, f64::max);
    for _ in 0..SWEEPS {
        let off =
            (0..N).flat_map(|p| (0..p).map(move |q| (p, q))).map(|(p, q)| a[p][q].abs()).fold(0.0, f64::max);
        if off <= 1e-15 * scale {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for row in &mut a {
                    let (x, y) = (row[p], row[q]);
                    (row[p], row[q]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..N {
                    let (x, y) = (a[p][k], a[q][k]);
                    (a[p][k], a[q][k]) = (c * x - s * y, s * x + c * y);
                    let (x, y) = (v[p][k], v[q][k]);
                    (v[p][k], v[q][k]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
    }
    (std::array::from_fn(|i| a[i][i]), v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn eigenvectors_diagonalise(entries in proptest::array::uniform10(-5.0..5.0_f64)) {
            let at = |i: usize, j: usize| entries[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
            let a: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| at(i, j)));
            let (values, vectors) = jacobi_eigen(a);
            for (value, v) in values.iter().zip(vectors) {
                let norm: f64 = v.iter().map(|x| x * x).sum();
                prop_assert!((norm - 1.0).abs() < 1e-12);
                for i in 0..4 {
                    let image: f64 = (0..4).map(|j| a[i][j] * v[j]).sum();
                    prop_assert!((image - value * v[i]).abs() < 1e-10);
                }
            }
        }
    }
}
