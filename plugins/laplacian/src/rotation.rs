//! The rotation nearest to a matrix, in the sense of least squares.
//!
//! Newton's method on the rotations, as in T. Kugelstadt et al., *Fast Corotated FEM using Operator
//! Splitting*, SCA 2018, from the rotation of the step before, which is near; and B. Horn's *Closed-form
//! Solution of Absolute Orientation Using Unit Quaternions*, 1987, where that does not settle.

use glam::{DMat3, DQuat, DVec3};
use simod_geometry::nearest_rotation;

/// Steps of Newton's method; two or three are usual.
const STEPS: usize = 12;
/// Length of a step, in radians, below which it is the last one: the error is then its square.
const SETTLED: f64 = 1e-6;
/// Weight by which the former rotation holds what the matrix leaves open, relative to the matrix.
const HOLD: f64 = 1e-9;

/// The rotation `R` with the largest `tr(Rᵀ S)`; `start` where `S` says nothing, and as near to it as `S`
/// allows where it leaves an axis open, as for samples on a line.
pub fn nearest(s: DMat3, start: DMat3) -> DMat3 {
    let size = s.to_cols_array().iter().map(|x| x.abs()).fold(0.0, f64::max);
    if !(size > 0.0 && size.is_finite()) {
        return start;
    }
    let s = s * size.recip() + start * HOLD;
    newton(s, start).unwrap_or_else(|| nearest_rotation(s).0)
}

fn newton(s: DMat3, start: DMat3) -> Option<DMat3> {
    let mut turn = DQuat::from_mat3(&start);
    let mut r = start;
    for _ in 0..STEPS {
        let p = r.transpose() * s;
        // Of tr(exp(w)ᵀ P): the gradient, and minus the second derivative.
        let gradient = DVec3::new(p.y_axis.z - p.z_axis.y, p.z_axis.x - p.x_axis.z, p.x_axis.y - p.y_axis.x);
        let symmetric = (p + p.transpose()) * 0.5;
        let trace = p.x_axis.x + p.y_axis.y + p.z_axis.z;
        let hessian = DMat3::from_diagonal(DVec3::splat(trace)) - symmetric;
        if !is_positive(&hessian) {
            return None;
        }
        let step = hessian.inverse() * gradient;
        let angle = step.length();
        // So far, the quadratic model means nothing.
        if angle.is_nan() || angle > 1.0 {
            return None;
        }
        // Cayley's map: the same as the exponential to third order, and a rotation all the same.
        let [x, y, z] = (step * 0.5).to_array();
        turn = (turn * DQuat::from_xyzw(x, y, z, 1.0)).normalize();
        r = DMat3::from_quat(turn);
        if angle < SETTLED {
            return Some(r);
        }
    }
    None
}

fn is_positive(m: &DMat3) -> bool {
    let minor = m.x_axis.x * m.y_axis.y - m.x_axis.y * m.y_axis.x;
    // Relative to a matrix of about 1, and well above what the hold alone gives.
    m.x_axis.x > 0.0 && minor > 0.0 && m.determinant() > 1e-30
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn overlap(r: DMat3, s: DMat3) -> f64 {
        (0..3).map(|c| r.col(c).dot(s.col(c))).sum()
    }

    fn quat() -> impl Strategy<Value = DQuat> {
        proptest::array::uniform4(-1.0..1.0_f64)
            .prop_filter("a length", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
            .prop_map(|q| DQuat::from_array(q).normalize())
    }

    proptest! {
        #[test]
        fn it_is_the_best_of_all(
            s in proptest::array::uniform9(-1.0..1.0_f64), start in quat(), other in quat(), flat in any::<bool>(),
        ) {
            let mut s = DMat3::from_cols_array(&s);
            if flat {
                s.z_axis = s.x_axis - 2.0 * s.y_axis;
            }
            let r = nearest(s, DMat3::from_quat(start));
            prop_assert!((r.determinant() - 1.0).abs() < 1e-12);
            prop_assert!((r * r.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|x| x.abs() < 1e-12));
            prop_assert!(overlap(r, s) >= overlap(nearest_rotation(s).0, s) - 1e-7);
            prop_assert!(overlap(r, s) >= overlap(DMat3::from_quat(other), s) - 1e-7);
        }

        #[test]
        fn a_rotation_is_its_own(q in quat(), start in quat(), scale in 1e-6..1e6_f64) {
            let r = DMat3::from_quat(q);
            let found = nearest(r * scale, DMat3::from_quat(start));
            prop_assert!((found - r).to_cols_array().iter().all(|x| x.abs() < 1e-8), "{found} {r}");
        }
    }

    #[test]
    fn what_is_open_stays() {
        let start = DMat3::from_rotation_x(0.4);
        assert_eq!(nearest(DMat3::ZERO, start), start);
        // Samples on the x axis, not turned: turns about it are open.
        let line = nearest(DMat3::from_diagonal(DVec3::X), start);
        assert!((line - start).to_cols_array().iter().all(|x| x.abs() < 1e-6), "{line}");
    }
}
