//! Eigenvalues and eigenvectors of several symmetric matrices at once, found by the steps by which
//! [`symmetric_eigen`](crate::geometry::symmetric_eigen) finds those of one.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use pulp::Simd;

use crate::double_lanes::{DoubleLanes, DoubleMask, Triple, square};

/// Steps of Newton's method from 2 to a root between √3 and 2: the error is about squared in each, from 0.27.
const STEPS: usize = 6;

/// The eigenvalues of each matrix, ascending, and their eigenvectors, of unit length. `diagonal` is xx, yy,
/// zz of each, `off` is xy, xz, yz. Multiples of the identity, and matrices with numbers that are none, have
/// xx three times, with the axes.
#[inline(always)]
pub fn symmetric_eigen<S: Simd>(simd: S, diagonal: Triple<S>, off: Triple<S>) -> (Triple<S>, [Triple<S>; 3]) {
    let splat = |x| DoubleLanes::splat(simd, x);
    let (zero, one) = (splat(0.0), splat(1.0));
    // Shifted and scaled, so that the eigenvalues are the roots of t³ − 3t − det, which are in [−2, 2].
    let mut scale = zero;
    for i in 0..3 {
        scale = scale.max(diagonal[i].abs()).max(off[i].abs());
    }
    let (mut d, mut o) = ([zero; 3], [zero; 3]);
    for i in 0..3 {
        (d[i], o[i]) = (diagonal[i] / scale, off[i] / scale);
    }
    let mean = (d[0] + d[1] + d[2]) / splat(3.0);
    for i in 0..3 {
        d[i] = d[i] - mean;
    }
    let size = ((square(d) + splat(2.0) * square(o)) / splat(6.0)).sqrt();
    let is_parted = zero.less(size).and(size.less(splat(f64::INFINITY)));
    for i in 0..3 {
        (d[i], o[i]) = (d[i] / size, o[i] / size);
    }
    let shifted = [[d[0], o[0], o[1]], [o[0], d[1], o[2]], [o[1], o[2], d[2]]];
    let (is_least, axis) = far_axis(simd, shifted);
    let far = (dot(axis, times(shifted, axis)), axis);
    let [first, second] = pair_across(simd, shifted, axis);
    let is_second = second.0.less(first.0);
    let (low, high) = (either(is_second, second, first), either(is_second, first, second));
    let ordered = [either(is_least, far, low), either(is_least, low, high), either(is_least, high, far)];
    let (mut values, mut vectors) = ([zero; 3], [[zero; 3]; 3]);
    for i in 0..3 {
        values[i] = is_parted.select((ordered[i].0 * size + mean) * scale, diagonal[0]);
        for j in 0..3 {
            vectors[i][j] = is_parted.select(ordered[i].1[j], if i == j { one } else { zero });
        }
    }
    (values, vectors)
}

/// The eigenvector of the eigenvalue that is farthest from zero, of shifted and scaled matrices, and where
/// that is the least eigenvalue.
#[inline(always)]
fn far_axis<S: Simd>(simd: S, shifted: [Triple<S>; 3]) -> (DoubleMask<S>, Triple<S>) {
    let splat = |x| DoubleLanes::splat(simd, x);
    let (zero, one) = (splat(0.0), splat(1.0));
    let determinant = dot(shifted[0], cross(shifted[1], shifted[2]));
    // The root comes from above.
    let mut root = splat(2.0);
    for _ in 0..STEPS {
        let squared = root * root;
        let value = (squared - splat(3.0)) * root - determinant.abs();
        root = root - value / (splat(3.0) * squared - splat(3.0));
    }
    let is_least = determinant.less(zero);
    let root = is_least.select(zero - root, root);
    let mut columns = shifted;
    for i in 0..3 {
        columns[i][i] = columns[i][i] - root;
    }
    // All are multiples of its eigenvector.
    let [a, b, c] = columns;
    let (p, q, r) = (cross(a, b), cross(b, c), cross(c, a));
    let longest = longer(longer(p, q), r);
    let length = square(longest).sqrt();
    let is_long = zero.less(length);
    let mut axis = [zero; 3];
    for i in 0..3 {
        axis[i] = is_long.select(longest[i] / length, if i == 0 { one } else { zero });
    }
    (is_least, axis)
}

/// The two other eigenvalues with their eigenvectors, in the plane across an eigenvector: by one of Jacobi's
/// rotations (Golub and Van Loan, *Matrix Computations*, 8.5).
#[inline(always)]
fn pair_across<S: Simd>(
    simd: S,
    shifted: [Triple<S>; 3],
    axis: Triple<S>,
) -> [(DoubleLanes<S>, Triple<S>); 2] {
    let splat = |x| DoubleLanes::splat(simd, x);
    let (zero, one) = (splat(0.0), splat(1.0));
    let (u, v) = across(simd, axis);
    let (along_u, along_v) = (times(shifted, u), times(shifted, v));
    let (uu, uv, vv) = (dot(u, along_u), dot(u, along_v), dot(v, along_v));
    let theta = (vv - uu) / (splat(2.0) * uv);
    let tangent = one / (theta.abs() + (theta * theta + one).sqrt());
    let tangent = theta.less(zero).select(zero - tangent, tangent);
    let t = zero.less(uv.abs()).select(tangent, zero);
    let cosine = one / (t * t + one).sqrt();
    let sine = t * cosine;
    let (mut first, mut second) = ([zero; 3], [zero; 3]);
    for i in 0..3 {
        (first[i], second[i]) = (u[i] * cosine - v[i] * sine, u[i] * sine + v[i] * cosine);
    }
    [(uu - t * uv, first), (vv + t * uv, second)]
}

/// The product of a symmetric matrix and a vector.
#[inline(always)]
fn times<S: Simd>(matrix: [Triple<S>; 3], v: Triple<S>) -> Triple<S> {
    [dot(matrix[0], v), dot(matrix[1], v), dot(matrix[2], v)]
}

/// Scalar products.
#[inline(always)]
pub fn dot<S: Simd>(a: Triple<S>, b: Triple<S>) -> DoubleLanes<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector products.
#[inline(always)]
pub fn cross<S: Simd>(a: Triple<S>, b: Triple<S>) -> Triple<S> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The longer vector of each pair.
#[inline(always)]
fn longer<S: Simd>(p: Triple<S>, q: Triple<S>) -> Triple<S> {
    let is_second = square(p).less(square(q));
    [is_second.select(q[0], p[0]), is_second.select(q[1], p[1]), is_second.select(q[2], p[2])]
}

/// Numbers with their vectors: `then` where something holds, and `or` elsewhere.
#[inline(always)]
fn either<S: Simd>(
    holds: DoubleMask<S>,
    then: (DoubleLanes<S>, Triple<S>),
    or: (DoubleLanes<S>, Triple<S>),
) -> (DoubleLanes<S>, Triple<S>) {
    let mut vector = or.1;
    for i in 0..3 {
        vector[i] = holds.select(then.1[i], or.1[i]);
    }
    (holds.select(then.0, or.0), vector)
}

/// Two unit vectors that are perpendicular to each of these and to each other (T. Duff and others, *Building
/// an Orthonormal Basis, Revisited*, 2017).
#[inline(always)]
fn across<S: Simd>(simd: S, n: Triple<S>) -> (Triple<S>, Triple<S>) {
    let splat = |x| DoubleLanes::splat(simd, x);
    let (zero, one) = (splat(0.0), splat(1.0));
    let sign = n[2].less(zero).select(splat(-1.0), one);
    let a = zero - one / (sign + n[2]);
    let b = n[0] * n[1] * a;
    let u = [one + sign * n[0] * n[0] * a, sign * b, zero - sign * n[0]];
    (u, [b, sign + n[1] * n[1] * a, zero - n[1]])
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};
    use proptest::prelude::*;
    use pulp::WithSimd;

    use super::*;
    use crate::double_lanes::MOST_LANES;
    use crate::geometry;

    /// The eigenvalues and eigenvectors of the first lane, which is the same matrix as all others.
    struct OfOne(DMat3);

    impl WithSimd for OfOne {
        type Output = (DVec3, DMat3);

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let [[xx, ..], [xy, yy, _], [xz, yz, zz]] = self.0.to_cols_array_2d();
            let load = |x: f64| DoubleLanes::load(simd, &[x; MOST_LANES]);
            let (values, vectors) =
                symmetric_eigen(simd, [load(xx), load(yy), load(zz)], [load(xy), load(xz), load(yz)]);
            let first = |x: DoubleLanes<S>| x.store()[0];
            let vector = |i: usize| DVec3::from_array([0, 1, 2].map(|j| first(vectors[i][j])));
            let values = DVec3::from_array([0, 1, 2].map(|i| first(values[i])));
            (values, DMat3::from_cols(vector(0), vector(1), vector(2)))
        }
    }

    fn matrix() -> impl Strategy<Value = DMat3> {
        let v = || {
            let x = prop_oneof![6 => -1.0..1.0f64, 1 => Just(0.0), 1 => Just(1e-9)];
            (x.clone(), x.clone(), x).prop_map(|(x, y, z)| DVec3::new(x, y, z))
        };
        let outer = |a: DVec3, by: f64| DMat3::from_cols(a * a.x, a * a.y, a * a.z) * by;
        (v(), v(), v(), prop_oneof![Just(1.0), Just(1e-12), Just(1e25)])
            .prop_map(move |(a, b, c, size)| (outer(a, 1.0) + outer(b, 0.01) + outer(c, 1e-6)) * size)
    }

    proptest! {
        #[test]
        fn several_have_what_each_has(m in matrix()) {
            let (values, vectors) = pulp::Arch::new().dispatch(OfOne(m));
            let (known, _) = geometry::symmetric_eigen(m);
            let size = known.abs().max_element();
            prop_assert!((values - known).abs().max_element() <= 1e-13 * size, "{values} {known}");
            for i in 0..3 {
                let off = m * vectors.col(i) - vectors.col(i) * values[i];
                prop_assert!(off.length() <= 1e-8 * size, "{i}: {}", off.length() / size);
            }
            let identity = vectors.transpose() * vectors;
            prop_assert!(identity.abs_diff_eq(DMat3::IDENTITY, 1e-12), "{identity}");
            prop_assert_eq!(OfOne(m).with_simd(pulp::Scalar::new()), (values, vectors));
        }
    }

    #[test]
    fn nothing_and_no_numbers_have_the_axes() {
        for m in [DMat3::ZERO, DMat3::IDENTITY * 3.0, DMat3::IDENTITY * f64::NAN] {
            let (values, vectors) = pulp::Arch::new().dispatch(OfOne(m));
            assert!(values.to_array().map(f64::to_bits) == [m.x_axis.x.to_bits(); 3], "{values}");
            assert_eq!(vectors, DMat3::IDENTITY);
        }
    }
}
