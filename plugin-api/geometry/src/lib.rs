//! simod-geometry: small dense geometry that plugins and the host share: symmetric eigenproblems, rotations,
//! definite systems, the kernel, smooth steps, outer products, affine maps, the sheet metric.

mod jacobi;
mod rotation;
mod sheet;

use glam::{DAffine3, DMat3, DVec3};
pub use jacobi::jacobi_eigen;
pub use rotation::{horn_matrix, nearest_rotation, polar_rotation};
pub use sheet::{STACKED, STEEPEST, chord_length, sheet_distance};

/// Eigenvalues, ascending, and the unit eigenvectors (as columns) of a symmetric matrix. The lower triangle
/// is not read.
///
/// First the eigenvalue that is farthest from the others, then these in the plane across its eigenvector: so
/// the vectors are orthonormal, and exact to rounding where the eigenvalues tell them apart (D. Eberly, *A
/// Robust Eigensolver for 3 × 3 Symmetric Matrices*, 2014).
pub fn symmetric_eigen(matrix: DMat3) -> (DVec3, DMat3) {
    let [[xx, ..], [xy, yy, _], [xz, yz, zz]] = matrix.to_cols_array_2d();
    let (diagonal, off) = (DVec3::new(xx, yy, zz), DVec3::new(xy, xz, yz));
    // Shifted and scaled, so that the eigenvalues are the roots of t³ − 3t − det, which are in [−2, 2].
    let scale = diagonal.abs().max(off.abs()).max_element();
    let (diagonal, off) = (diagonal / scale, off / scale);
    let mean = diagonal.element_sum() / 3.0;
    let deviation = diagonal - mean;
    let size = ((deviation.length_squared() + 2.0 * off.length_squared()) / 6.0).sqrt();
    if !(size > 0.0 && size.is_finite()) {
        return (DVec3::splat(xx), DMat3::IDENTITY);
    }
    let (d, o) = (deviation / size, off / size);
    let shifted = DMat3::from_cols_array(&[d.x, o.x, o.y, o.x, d.y, o.z, o.y, o.z, d.z]);
    let determinant = shifted.determinant();

    // The root that is farthest from zero, by Newton's method from above: it is at least √3 in size.
    let mut root: f64 = 2.0;
    for _ in 0..8 {
        let step = ((root * root - 3.0) * root - determinant.abs()) / (3.0 * root * root - 3.0);
        root -= step;
        if step < 1e-9 {
            break;
        }
    }
    let is_least = determinant < 0.0;
    let root = if is_least { -root } else { root };
    let [a, b, c] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| shifted * axis - axis * root);
    // All are multiples of its eigenvector.
    let [p, q, r] = [a.cross(b), b.cross(c), c.cross(a)];
    let longer = |p: DVec3, q: DVec3| if p.length_squared() < q.length_squared() { q } else { p };
    let axis = longer(longer(p, q), r).normalize_or(DVec3::X);

    // In the plane across it, one of Jacobi's rotations (Golub and Van Loan, *Matrix Computations*, 8.5).
    let (u, v) = axis.any_orthonormal_pair();
    let (uu, uv, vv) = (u.dot(shifted * u), u.dot(shifted * v), v.dot(shifted * v));
    let theta = (vv - uu) / (2.0 * uv);
    let t = if uv == 0.0 { 0.0 } else { theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt()) };
    let cosine = 1.0 / (t * t + 1.0).sqrt();
    let sine = t * cosine;
    let one = (uu - t * uv, u * cosine - v * sine);
    let other = (vv + t * uv, u * sine + v * cosine);
    let (low, high) = if other.0 < one.0 { (other, one) } else { (one, other) };
    let far = (axis.dot(shifted * axis), axis);
    let [low, middle, high] = if is_least { [far, low, high] } else { [low, high, far] };
    let values = DVec3::new(low.0, middle.0, high.0);
    ((values * size + mean) * scale, DMat3::from_cols(low.1, middle.1, high.1))
}

/// The least eigenvalue of a symmetric positive semidefinite matrix, to about 1e-8 of the greatest.
///
/// Newton's method on the characteristic polynomial, which rises to its least root from zero without
/// overshooting.
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

/// Outer product a bᵀ.
#[inline]
pub fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Affine map of the rows `[M | t]`, as plugins are given it.
#[inline]
pub fn affine_map(rows: &[[f64; 4]; 3]) -> DAffine3 {
    let column = |k: usize| DVec3::new(rows[0][k], rows[1][k], rows[2][k]);
    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
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

/// Value 0 below 0 and 1 above 1, and between them 3t² − 2t³, which is flat at both ends.
#[inline]
pub fn smoothstep(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
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
    fn rows_become_the_map_that_they_describe() {
        let map = affine_map(&[[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0], [9.0, 10.0, 11.0, 12.0]]);
        assert_eq!(map.transform_point3(DVec3::new(1.0, -1.0, 2.0)), DVec3::new(9.0, 21.0, 33.0));
        let (a, b) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.5, 4.0));
        assert_eq!(outer(a, b) * DVec3::new(2.0, 2.0, 1.0), a * b.dot(DVec3::new(2.0, 2.0, 1.0)));
    }

    #[test]
    fn kernel_is_one_at_the_centre_and_flat_at_both_ends() {
        assert_eq!((hermite(0.0), hermite(0.5), hermite(1.0), hermite(3.0)), (1.0, 0.5, 0.0, 0.0));
        assert_eq!([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0].map(smoothstep), [0.0, 0.0, 0.15625, 0.5, 1.0, 1.0]);
        assert!((hermite(1e-3) - 1.0).abs() < 1e-5 && hermite(1.0 - 1e-3) < 1e-5);
    }
}
