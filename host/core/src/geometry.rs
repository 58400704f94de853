//! Small dense geometry: bounds, symmetric eigenproblems and definite systems, the kernel.

use glam::{DMat3, DVec3};

/// An axis-aligned box in the model's coordinates, empty at first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Corner of least coordinates; +∞ while empty.
    pub min: DVec3,
    /// Corner of greatest coordinates; −∞ while empty.
    pub max: DVec3,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY }
    }
}

impl Bounds {
    /// The smallest box that holds the points.
    pub fn of(points: impl IntoIterator<Item = DVec3>) -> Self {
        let mut bounds = Self::default();
        points.into_iter().for_each(|p| bounds.include(p));
        bounds
    }

    /// Grows the box to hold `p`.
    pub fn include(&mut self, p: DVec3) {
        self.min = self.min.min(p);
        self.max = self.max.max(p);
    }

    /// Whether the point lies in the box or on its faces; no point with a NaN does.
    #[inline]
    pub fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// Whether no point was included yet.
    pub fn is_empty(&self) -> bool {
        self.min.x > self.max.x
    }

    /// The middle of the box.
    pub fn center(&self) -> DVec3 {
        // Halved before they are added: the sum of two corners near the largest double overflows.
        self.min * 0.5 + self.max * 0.5
    }

    /// Length of the diagonal, the unit of every error bound; 0 for a single point.
    pub fn diagonal(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let extent = self.max - self.min;
        // Scaled, so that squares neither overflow nor vanish.
        let largest = extent.max_element();
        if largest > 0.0 { largest * (extent / largest).length() } else { 0.0 }
    }
}

/// Eigenvalues, ascending, and the unit eigenvectors (as columns) of a symmetric matrix.
///
/// Cyclic Jacobi rotations (Golub and Van Loan, *Matrix Computations*, 8.5): slower than the closed form, but
/// accurate for the nearly flat covariances that surfaces give. The lower triangle is not read.
pub fn symmetric_eigen(matrix: DMat3) -> (DVec3, DMat3) {
    let mut a = matrix.to_cols_array_2d();
    let mut v = DVec3::AXES;
    let scale = a.iter().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
    for _ in 0..32 {
        let off = a[1][0].abs() + a[2][0].abs() + a[2][1].abs();
        if off <= scale * 1e-18 || !off.is_finite() {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            // Column-major: a[q][p] is the entry of row p, column q, in the upper triangle.
            let apq = a[q][p];
            if apq == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * apq);
            // A θ too large to be squared gives t = 0, which is right.
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            let r = 3 - p - q;
            let (arp, arq) = (a[p.max(r)][p.min(r)], a[q.max(r)][q.min(r)]);
            a[p][p] -= t * apq;
            a[q][q] += t * apq;
            a[q][p] = 0.0;
            a[p.max(r)][p.min(r)] = c * arp - s * arq;
            a[q.max(r)][q.min(r)] = s * arp + c * arq;
            let (vp, vq) = (v[p], v[q]);
            v[p] = vp * c - vq * s;
            v[q] = vp * s + vq * c;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    let value = |i: usize| a[order[i]][order[i]];
    let vectors = DMat3::from_cols(v[order[0]], v[order[1]], v[order[2]]);
    (DVec3::new(value(0), value(1), value(2)), vectors)
}

/// The least eigenvalue of a symmetric positive semidefinite matrix, to about 1e-8 of the greatest.
///
/// Newton's method on the characteristic polynomial, which rises to its least root from zero without overshooting.
pub fn least_eigenvalue(a: DMat3) -> f64 {
    let trace = a.x_axis.x + a.y_axis.y + a.z_axis.z;
    if !(trace.is_normal() && trace > 0.0) {
        return 0.0;
    }
    // Of unit trace, so that nothing overflows.
    let a = a * (1.0 / trace);
    let (x, y, z) = (a.x_axis, a.y_axis, a.z_axis);
    let minors = x.x * y.y - x.y * x.y + x.x * z.z - x.z * x.z + y.y * z.z - y.z * y.z;
    let determinant = a.determinant();
    let mut root = 0.0;
    for _ in 0..40 {
        let value = ((root - 1.0) * root + minors) * root - determinant;
        let slope = (3.0 * root - 2.0) * root + minors;
        if value >= 0.0 || slope <= 0.0 {
            break;
        }
        let step = value / slope;
        root -= step;
        if -step < 1e-10 * root {
            break;
        }
    }
    // No more than what the sum of three products of eigenvalues allows: where two are zero, rounding may.
    root.min((minors.max(0.0) / 3.0).sqrt()) * trace
}

/// Solves A x = b for a symmetric positive definite A, of which the lower triangle is read, and vectors as
/// unknowns, by Cholesky's decomposition. `None` if A is not positive definite.
pub fn solve_positive_definite<const N: usize>(
    mut a: [[f64; N]; N],
    mut b: [DVec3; N],
) -> Option<[DVec3; N]> {
    for j in 0..N {
        for k in 0..j {
            let ljk = a[j][k];
            for row in &mut a[j..] {
                row[j] -= row[k] * ljk;
            }
        }
        let pivot = a[j][j].sqrt();
        // Written so that NaN is refused.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        for row in &mut a[j..] {
            row[j] /= pivot;
        }
    }
    for i in 0..N {
        for k in 0..i {
            b[i] -= b[k] * a[i][k];
        }
        b[i] /= a[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            b[i] -= b[k] * a[k][i];
        }
        b[i] /= a[i][i];
    }
    Some(b)
}

/// The kernel of the paper's §5, h(t) = 1 − 3t² + 2t³ on [0, 1], and 0 beyond.
#[inline]
pub fn hermite(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    1.0 + t * t * (2.0 * t - 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn component() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), -1e3..1e3f64, -1e-9..1e-9f64]
    }

    proptest! {
        #[test]
        fn eigenvectors_diagonalise(e in proptest::array::uniform6(component())) {
            let m = DMat3::from_cols_array(&[e[0], e[1], e[2], e[1], e[3], e[4], e[2], e[4], e[5]]);
            let (values, vectors) = symmetric_eigen(m);
            let scale = e.iter().fold(1e-300f64, |s, x| s.max(x.abs()));
            let rebuilt = vectors * DMat3::from_diagonal(values) * vectors.transpose();
            prop_assert!((rebuilt - m).abs_diff_eq(DMat3::ZERO, 1e-12 * scale));
            prop_assert!((vectors * vectors.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-12));
            prop_assert!(values.x <= values.y && values.y <= values.z);
        }

        #[test]
        fn the_least_eigenvalue_is_that_of_the_decomposition(e in proptest::array::uniform9(component())) {
            let root = DMat3::from_cols_array(&e);
            let m = root.transpose() * root;
            let (values, _) = symmetric_eigen(m);
            prop_assert!((least_eigenvalue(m) - values.x).abs() <= 1e-7 * values.z, "{values}");
        }
    }

    #[test]
    fn positive_definite_systems_are_solved_and_others_refused() {
        let a = [[4.0, 0.0, 0.0], [2.0, 5.0, 0.0], [-1.0, 0.5, 3.0]];
        let x = [DVec3::new(1.0, -2.0, 0.5), DVec3::new(3.0, 0.0, 1.0), DVec3::new(-1.0, 4.0, 2.0)];
        let full = |i: usize, k: usize| if k <= i { a[i][k] } else { a[k][i] };
        let b = std::array::from_fn(|i| (0..3).map(|k| x[k] * full(i, k)).sum());
        let found = solve_positive_definite(a, b).expect("positive definite");
        assert!(found.iter().zip(x).all(|(f, x)| f.distance(x) < 1e-12));
        assert!(solve_positive_definite([[1.0, 0.0], [2.0, 1.0]], [DVec3::ONE; 2]).is_none());
        assert!(solve_positive_definite([[f64::NAN]], [DVec3::ONE]).is_none());
    }

    #[test]
    fn kernel_is_one_at_the_centre_and_flat_at_both_ends() {
        assert_eq!((hermite(0.0), hermite(0.5), hermite(1.0), hermite(3.0)), (1.0, 0.5, 0.0, 0.0));
        assert!((hermite(1e-3) - 1.0).abs() < 1e-5 && hermite(1.0 - 1e-3) < 1e-5);
    }

    #[test]
    fn diagonal_holds_at_extreme_scales() {
        for scale in [1e-300, 1e-30, 1.0, 1e30, 1e300] {
            let b = Bounds::of([DVec3::ZERO, DVec3::new(2.0, 3.0, 6.0) * scale]);
            assert!((b.diagonal() / scale - 7.0).abs() < 1e-12);
        }
        assert_eq!(Bounds::of([DVec3::ONE]).diagonal(), 0.0);
        assert_eq!(Bounds::default().diagonal(), 0.0);
    }
}
