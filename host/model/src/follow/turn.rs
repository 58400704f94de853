//! Rules by which vectors, normals, quaternions and covariances turn under a deformation of a known gradient.

use glam::{DMat3, DQuat, DVec3, Mat3, Vec3, Vec4};

use super::rules::TensorKind;

/// Largest cosine between columns that count as orthogonal.
const ORTHOGONAL: f64 = 1e-14;

/// Most sweeps of rotations, after which columns are as orthogonal as they get; three or four do.
const SWEEPS: usize = 24;

/// Normal after a deformation of this gradient, of the same length as before. `mirrored` tells that the
/// deformation as a whole turns left into right, where the outside stays outside.
pub fn normal(gradient: &Mat3, n: Vec3, mirrored: bool) -> Vec3 {
    if *gradient == Mat3::IDENTITY || !n.is_finite() {
        return n;
    }
    // F⁻ᵀ up to a factor: the cofactors, which exist for a singular F too. The sign of the determinant
    // here, which a flat surface hardly tells, would turn single normals round.
    let [a, b, c] = [gradient.x_axis, gradient.y_axis, gradient.z_axis];
    let cofactors = Mat3::from_cols(b.cross(c), c.cross(a), a.cross(b));
    let turned = cofactors * n;
    turned.try_normalize().map_or(n, |t| t * if mirrored { -n.length() } else { n.length() })
}

/// The tangent after a deformation of this gradient: its direction goes with the gradient, as a line on the
/// surface does, and is of the same length as before. Its last number is the side on which normal × direction
/// has the bitangent, which is the other one where the deformation as a whole is `mirrored`.
pub fn tangent(gradient: &Mat3, t: Vec4, mirrored: bool) -> Vec4 {
    if *gradient == Mat3::IDENTITY || !t.is_finite() {
        return t;
    }
    let side = if mirrored { -t.w } else { t.w };
    let turned = (*gradient * t.truncate()).try_normalize();
    turned.map_or(t, |turned| (turned * t.truncate().length()).extend(side))
}

/// Gradient at a vertex, with its derived matrices, for all numbers of the vertex.
pub(super) struct VertexTurn {
    /// J.
    pub(super) gradient: DMat3,
    /// The orthogonal matrix next to J, which turns left into right where J does; none where J leaves no more
    /// than a line.
    pub(super) polar: Option<DMat3>,
    mirrored: bool,
}

impl VertexTurn {
    pub(super) fn new(gradient: DMat3, mirrored: bool) -> Self {
        Self { gradient, polar: polar(&gradient), mirrored }
    }

    /// Turns declared numbers; numbers that are not finite stay as they are.
    pub(super) fn declared(&self, kind: TensorKind, numbers: &mut [f64]) {
        if !numbers.iter().all(|x| x.is_finite()) {
            return;
        }
        match kind {
            TensorKind::Vector => set(numbers, self.gradient * vector(numbers)),
            TensorKind::Direction => {
                let v = vector(numbers);
                let turned = (self.gradient * v).try_normalize();
                set(numbers, turned.map_or(v, |turned| turned * v.length()));
            }
            TensorKind::Normal => {
                let n = vector(numbers);
                let side = if self.mirrored { -n.length() } else { n.length() };
                let turned = (cofactors(&self.gradient) * n).try_normalize();
                set(numbers, turned.map_or(n, |turned| turned * side));
            }
            TensorKind::QuaternionWxyz => {
                let [w, x, y, z] = [0, 1, 2, 3].map(|i| numbers[i]);
                if let Some(q) = self.quaternion(DQuat::from_xyzw(x, y, z, w)) {
                    numbers.copy_from_slice(&[q.w, q.x, q.y, q.z]);
                }
            }
            TensorKind::QuaternionXyzw => {
                let [x, y, z, w] = [0, 1, 2, 3].map(|i| numbers[i]);
                if let Some(q) = self.quaternion(DQuat::from_xyzw(x, y, z, w)) {
                    numbers.copy_from_slice(&q.to_array());
                }
            }
            TensorKind::Covariance => {
                let [xx, xy, xz, yy, yz, zz] = [0, 1, 2, 3, 4, 5].map(|i| numbers[i]);
                let sigma = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
                let m = self.gradient * sigma * self.gradient.transpose();
                let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
                numbers.copy_from_slice(&[x.x, x.y, x.z, y.y, y.z, z.z]);
            }
        }
    }

    /// The quaternion that turns as the rotation of the gradient does, of the same length and on the same
    /// side as before. Of a frame that is mirrored, the third axis is turned round: no quaternion is a
    /// mirror.
    fn quaternion(&self, q: DQuat) -> Option<DQuat> {
        let (polar, length) = (self.polar?, q.length());
        let unit = (length > 0.0 && length.is_finite()).then(|| q * (1.0 / length))?;
        let mut frame = polar * DMat3::from_quat(unit);
        if frame.determinant() < 0.0 {
            frame.z_axis = -frame.z_axis;
        }
        Some(on_side_of(DQuat::from_mat3(&frame), self.turned(unit)) * length)
    }

    /// Quaternion turned by the smallest rotation that the gradient contains, by which signs are told.
    pub(super) fn turned(&self, q: DQuat) -> DQuat {
        let Some(mut rotation) = self.polar else { return q };
        if rotation.determinant() < 0.0 {
            rotation *= -1.0;
        }
        on_side_of(DQuat::from_mat3(&rotation), DQuat::IDENTITY) * q
    }
}

/// The one of both quaternions of a rotation that is nearer to another.
pub(super) fn on_side_of(q: DQuat, other: DQuat) -> DQuat {
    if q.dot(other) < 0.0 { -q } else { q }
}

fn vector(numbers: &[f64]) -> DVec3 {
    DVec3::new(numbers[0], numbers[1], numbers[2])
}

fn set(numbers: &mut [f64], v: DVec3) {
    numbers.copy_from_slice(&v.to_array());
}

fn cofactors(m: &DMat3) -> DMat3 {
    let [a, b, c] = [m.x_axis, m.y_axis, m.z_axis];
    DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b))
}

/// The lengths of a matrix' columns.
pub(super) fn lengths(m: &DMat3) -> [f64; 3] {
    [m.x_axis.length(), m.y_axis.length(), m.z_axis.length()]
}

/// Numbers from the largest to the smallest.
pub(super) fn sorted(mut numbers: [f64; 3]) -> [f64; 3] {
    numbers.sort_by(|a, b| b.total_cmp(a));
    numbers
}

/// M·V with orthogonal columns, of some rotation V, and the columns of N·V: one-sided Jacobi rotations
/// (M. R. Hestenes, *Inversion of Matrices by Biorthogonalization and Related Results*, 1958), the smallest
/// each time, so that columns which are nearly orthogonal stay what they are, in their order. Columns are
/// orthogonal where the cosine between them is below `enough`.
fn orthogonal_with<const N: usize>(
    m: &DMat3,
    mut others: [[DVec3; 3]; N],
    enough: f64,
) -> (DMat3, [[DVec3; 3]; N]) {
    let mut columns = [m.x_axis, m.y_axis, m.z_axis];
    for _ in 0..SWEEPS {
        let mut is_done = true;
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (columns[i], columns[j]);
            let (aa, bb, ab) = (a.length_squared(), b.length_squared(), a.dot(b));
            if ab * ab <= (enough * enough) * (aa * bb) {
                continue;
            }
            is_done = false;
            let zeta = (bb - aa) / (2.0 * ab);
            let t = 1.0f64.copysign(zeta) / (zeta.abs() + (zeta * zeta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = c * t;
            for of in [&mut columns].into_iter().chain(&mut others) {
                (of[i], of[j]) = (c * of[i] - s * of[j], s * of[i] + c * of[j]);
            }
        }
        if is_done {
            break;
        }
    }
    (DMat3::from_cols(columns[0], columns[1], columns[2]), others)
}

/// M·V with orthogonal columns, of some rotation V.
pub(super) fn orthogonal(m: &DMat3, enough: f64) -> DMat3 {
    orthogonal_with::<0>(m, [], enough).0
}

/// The orthogonal factor Q of J = Q·S with S symmetric and positive. Where J leaves a plane only, Q is the
/// one that is no mirror.
fn polar(j: &DMat3) -> Option<DMat3> {
    polar_by_averages(j).or_else(|| polar_by_axes(j))
}

/// The [orthogonal factor](polar) by the average of the matrix and its inverse transpose, again and again (N.
/// J. Higham, *Computing the Polar Decomposition, with Applications*, 1986), which is quicker; nothing where
/// the matrix is nearly singular.
fn polar_by_averages(j: &DMat3) -> Option<DMat3> {
    // Errors after each average are about half the square of those before.
    const FEW: usize = 12;
    let mut q = *j;
    for _ in 0..FEW {
        let cofactors = cofactors(&q);
        let determinant = q.x_axis.dot(cofactors.x_axis);
        let (square, inverse_square) = (squares(&q), squares(&cofactors) / (determinant * determinant));
        (inverse_square * square < 1e12).then_some(())?;
        // The matrix gets the size of its inverse, so that averages go straight to their limit.
        let scale = (inverse_square / square).sqrt().sqrt();
        let next = q * (0.5 * scale) + cofactors * (0.5 / (scale * determinant));
        let off = squares(&(next - q));
        q = next;
        if off < 1e-16 {
            return Some(q);
        }
    }
    None
}

/// The sum of a matrix' squared entries.
fn squares(m: &DMat3) -> f64 {
    m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()
}

/// The [orthogonal factor](polar) by the axes along which the matrix stretches.
fn polar_by_axes(j: &DMat3) -> Option<DMat3> {
    let itself = DMat3::IDENTITY.to_cols_array_2d().map(DVec3::from_array);
    let (us, [v]) = orthogonal_with(j, [itself], ORTHOGONAL);
    let v = DMat3::from_cols(v[0], v[1], v[2]);
    let lengths = lengths(&us);
    let largest = sorted(lengths)[0];
    let columns = [us.x_axis, us.y_axis, us.z_axis];
    // Less than rounding leaves is nothing.
    let unit = |i: usize| (lengths[i] > 1e-12 * largest).then(|| columns[i] / lengths[i]);
    let [a, b, c] = match [unit(0), unit(1), unit(2)] {
        [Some(a), Some(b), Some(c)] => [a, b, c],
        [None, Some(b), Some(c)] => [b.cross(c), b, c],
        [Some(a), None, Some(c)] => [a, c.cross(a), c],
        [Some(a), Some(b), None] => [a, b, a.cross(b)],
        _ => return None,
    };
    Some(DMat3::from_cols(a, b, c) * v.transpose())
}

/// Anisotropy of a round splat after a deformation of this gradient: the ratio of its two largest singular
/// values.
pub fn anisotropy(gradient: &Mat3) -> f32 {
    if *gradient == Mat3::IDENTITY {
        return 1.0;
    }
    let [a, b, _] = sorted(lengths(&orthogonal(&gradient.as_dmat3(), 1e-9)));
    (a / b) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some_gradient() -> DMat3 {
        DMat3::from_cols_array(&[1.1, 0.2, -0.3, -0.1, 0.8, 0.4, 0.2, -0.5, 1.3])
    }

    fn rotation() -> DMat3 {
        DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.7, -1.1, 2.0))
    }

    #[test]
    fn the_polar_factor_is_the_rotation() {
        let stretch = DMat3::from_cols_array(&[2.0, 0.3, 0.1, 0.3, 1.0, -0.2, 0.1, -0.2, 0.5]);
        for side in [1.0, -1.0] {
            for polar in [polar_by_averages, polar_by_axes] {
                let polar = polar(&(rotation() * side * stretch)).unwrap();
                assert!(polar.abs_diff_eq(rotation() * side, 1e-13));
            }
        }
        assert!(polar(&rotation()).unwrap().abs_diff_eq(rotation(), 1e-14));
        // A plane is left, and a line.
        let flat = rotation() * DMat3::from_diagonal(DVec3::new(2.0, 0.0, 1.0));
        assert!(polar(&flat).unwrap().abs_diff_eq(rotation(), 1e-13));
        assert!(polar(&DMat3::from_diagonal(DVec3::X)).is_none() && polar(&DMat3::ZERO).is_none());
    }

    #[test]
    fn declared_numbers_turn_by_their_rules() {
        let j = some_gradient();
        let turn = VertexTurn::new(j, false);
        let turned = |kind, numbers: &[f64]| {
            let mut numbers = numbers.to_vec();
            turn.declared(kind, &mut numbers);
            numbers
        };
        let v = DVec3::new(0.3, -2.0, 0.7);
        assert_eq!(turned(TensorKind::Vector, &v.to_array()), (j * v).to_array());
        let direction = vector(&turned(TensorKind::Direction, &v.to_array()));
        assert!((direction - (j * v) * (v.length() / (j * v).length())).length() < 1e-14);
        // A normal stays at right angles to the vectors that it was at right angles to.
        let normal = vector(&turned(TensorKind::Normal, &v.to_array()));
        let (s, t) = v.normalize_or(DVec3::X).any_orthonormal_pair();
        assert!(normal.dot(j * s).abs() < 1e-14 && normal.dot(j * t).abs() < 1e-14);
        assert!((normal.length() - v.length()).abs() < 1e-14);
        // A covariance of a point set is that of its image.
        let points = [v, DVec3::new(1.0, 0.2, 0.0), DVec3::new(-0.5, 0.1, 2.0)];
        let of = |points: &[DVec3]| {
            let mut sum = [0.0; 6];
            for p in points {
                let products = [p.x * p.x, p.x * p.y, p.x * p.z, p.y * p.y, p.y * p.z, p.z * p.z];
                (0..6).for_each(|i| sum[i] += products[i]);
            }
            sum
        };
        let expected = of(&points.map(|p| j * p));
        let found = turned(TensorKind::Covariance, &of(&points));
        assert!((0..6).all(|i| (found[i] - expected[i]).abs() < 1e-13));
        // A vector with a NaN, and a quaternion of zero, stay as they are.
        assert!(turned(TensorKind::Vector, &[1.0, f64::NAN, 2.0])[1].is_nan());
        assert_eq!(turned(TensorKind::QuaternionWxyz, &[0.0; 4]), [0.0; 4]);
    }

    #[test]
    fn quaternions_turn_by_the_rotation_and_keep_side_and_length() {
        let small = DMat3::from_quat(DQuat::from_rotation_z(0.01));
        for q in [[1.0, 0.0, 0.0, 0.0], [-0.5, 1.5, 0.5, -0.1], [0.0, 0.0, -3.0, 0.0]] {
            let mut wxyz = q;
            VertexTurn::new(small, false).declared(TensorKind::QuaternionWxyz, &mut wxyz);
            assert!((0..4).all(|i| (wxyz[i] - q[i]).abs() < 0.02), "{wxyz:?} is not near {q:?}");
            let mut xyzw = [q[1], q[2], q[3], q[0]];
            VertexTurn::new(small, false).declared(TensorKind::QuaternionXyzw, &mut xyzw);
            assert_eq!(xyzw, [wxyz[1], wxyz[2], wxyz[3], wxyz[0]]);
            let length = |q: [f64; 4]| q.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((length(wxyz) - length(q)).abs() < 1e-14);
        }
        // The first two axes of a mirrored frame.
        let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        let q = DQuat::from_rotation_y(0.4);
        let found = VertexTurn::new(mirror, true).quaternion(q).unwrap();
        for axis in [DVec3::X, DVec3::Y] {
            assert!((found * axis - mirror * (q * axis)).length() < 1e-14);
        }
    }
}
