//! The rotation that is nearest to a matrix: of any matrix by B. Horn, *Closed-form Solution of Absolute
//! Orientation Using Unit Quaternions*, 1987; of one that does not mirror by N. J. Higham, *Computing the
//! Polar Decomposition, with Applications*, SIAM J. Sci. Stat. Comput. 7, 1986.

use crate::jacobi_eigen;
use glam::{DMat3, DQuat, DVec3};

/// The rotation R that is nearest to a matrix M, for which the trace of RᵀM is greatest; and the singular
/// values of M, descending, the last one negative where M mirrors. R is determined where the second singular
/// value is above zero and the sum of the last two is.
///
/// With M = Σ w target sourceᵀ of points about their weighted means, R takes the sources to the targets best.
pub fn nearest_rotation(matrix: DMat3) -> (DMat3, DVec3) {
    let (values, vectors) = jacobi_eigen(horn_matrix(matrix));
    let mut order = [0, 1, 2, 3];
    order.sort_by(|i, j| values[*j].total_cmp(&values[*i]));
    let [greatest, others @ ..] = order;
    let [w, x, y, z] = vectors[greatest];
    // The eigenvalues are s₁ + s₂ + s₃ and, with two of the signs turned, the others.
    let singular = others.map(|other| 0.5 * (values[greatest] + values[other]));
    (DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()), DVec3::from_array(singular))
}

/// Horn's symmetric matrix, of which the eigenvector of the greatest eigenvalue is the nearest rotation as a
/// quaternion w, x, y, z.
pub fn horn_matrix(matrix: DMat3) -> [[f64; 4]; 4] {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = matrix.to_cols_array_2d();
    [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
}

/// The rotation of the polar decomposition of a matrix with a positive determinant, by Newton's method: the
/// average of the matrix and its inverse transpose, until no entry changes by more than `settled`, or `steps`
/// times.
///
/// It converges in less steps the nearer the singular values are to 1.
pub fn polar_rotation(matrix: DMat3, steps: usize, settled: f64) -> DMat3 {
    let mut rotation = matrix;
    for _ in 0..steps {
        let next = (rotation + rotation.inverse().transpose()) * 0.5;
        let is_settled = next.abs_diff_eq(rotation, settled);
        rotation = next;
        if is_settled {
            break;
        }
    }
    rotation
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rotation() -> impl Strategy<Value = DMat3> {
        proptest::array::uniform4(-1.0..1.0_f64)
            .prop_filter("not a direction", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
            .prop_map(|q| DMat3::from_quat(DQuat::from_array(q).normalize()))
    }

    fn differs(a: DMat3, b: DMat3) -> f64 {
        (a - b).to_cols_array().iter().map(|x| x.abs()).fold(0.0, f64::max)
    }

    proptest! {
        #[test]
        fn rotations_and_singular_values_are_those_the_matrix_is_made_of(
            turn in rotation(),
            across in rotation(),
            values in proptest::array::uniform3(0.1..1.0_f64),
            scale in -200..200_i32,
            mirrors: bool,
        ) {
            let mut values = values.map(|x| x * 10.0_f64.powi(scale / 2));
            values.sort_by(|a, b| b.total_cmp(a));
            // Where a mirror's last two are alike, any turn about the first is as near.
            prop_assume!(!mirrors || values[1] > 1.01 * values[2]);
            if mirrors {
                values[2] = -values[2];
            }
            let values = DVec3::from_array(values);
            let (found, singular) =
                nearest_rotation(turn * across * DMat3::from_diagonal(values) * across.transpose());
            prop_assert!((singular - values).abs().max_element() < 1e-13 * values.x, "{singular} for {values}");
            prop_assert!(differs(found, turn) < 1e-11, "{found} for {turn}");
            if !mirrors {
                let unit = turn * across * DMat3::from_diagonal(values / values.x) * across.transpose();
                let polar = polar_rotation(unit, 60, 1e-15);
                prop_assert!(differs(polar, turn) < 1e-11, "{polar} for {turn}");
            }
        }
    }

    #[test]
    fn a_plane_determines_the_rotation_and_a_line_does_not() {
        let turn = DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1);
        let (found, singular) = nearest_rotation(turn * DMat3::from_diagonal(DVec3::new(3.0, 2.0, 0.0)));
        assert!(differs(found, turn) < 1e-14);
        assert!((singular - DVec3::new(3.0, 2.0, 0.0)).abs().max_element() < 1e-14);
        let (_, singular) = nearest_rotation(turn * DMat3::from_diagonal(DVec3::new(3.0, 0.0, 0.0)));
        assert!(singular.y.abs() < 1e-14);
        let (_, singular) = nearest_rotation(DMat3::NAN);
        assert!(singular.is_nan());
    }
}
