//! A Gaussian splat under a deformation: its covariance Σ becomes J·Σ·Jᵀ, written back as quaternion and
//! logarithms of scales, and its colours turn by the rotation in J.

use std::fmt;

use glam::{DMat3, DQuat};

use super::harmonics::BandRotation;
use super::rules::Opacity;
use super::turn::{VertexTurn, lengths, on_side_of, orthogonal, sorted};

/// Cosine between axes below which they count as at right angles: a gradient in single precision cannot tell
/// such axes from right angles, and so does not turn the axes of round splats.
const RIGHT_ANGLE: f64 = 1e-7;

/// Changes of scales below this are none, likewise.
const UNSTRETCHED: f64 = 1e-6;

/// Numbers of a splat: the quaternion (real part first), logarithms of scales, coefficients of bands 1 up to
/// the degree, those of a channel after the other, and the opacity before the sigmoid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SplatNumbers {
    /// Three, or two of a disc.
    pub(super) scales: usize,
    /// Degree of the harmonics, 0 to 3.
    pub(super) degree: usize,
}

impl fmt::Display for SplatNumbers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.scales == 2 { "2D Gaussian splats" } else { "Gaussian splats" };
        write!(f, "{kind} with harmonics of degree {}", self.degree)
    }
}

/// Ellipsoid of a splat: its quaternion and scales, as long as these are meaningful.
struct Ellipsoid {
    quaternion: DQuat,
    length: f64,
    /// Scales as parts of the largest one; 0 across a disc.
    scales: [f64; 3],
}

impl SplatNumbers {
    /// Coefficients of a channel.
    pub(super) fn coefficients(self) -> usize {
        (self.degree + 1).pow(2) - 1
    }

    /// Turns a splat; returns the ratios of its longest axis to its second before and after. None where its
    /// numbers are meaningless, or the deformation leaves nothing of the splat, which keeps its numbers then.
    pub(super) fn turn(
        self,
        turn: &VertexTurn,
        opacity: Opacity,
        most: Option<f64>,
        numbers: &mut [f64],
    ) -> Option<[f64; 2]> {
        let (shape, colours) = numbers.split_at_mut(4 + self.scales);
        let (harmonics, transparency) = colours.split_at_mut(3 * self.coefficients());
        let polar = turn.polar?;
        let rest = Ellipsoid::from_shape(shape)?;

        let frame = DMat3::from_quat(rest.quaternion);
        let [a, b, c] = rest.scales;
        let columns = turn.gradient * DMat3::from_cols(frame.x_axis * a, frame.y_axis * b, frame.z_axis * c);
        let axes = orthogonal(&columns, RIGHT_ANGLE);
        let mut lengths = lengths(&axes);
        if !lengths[..self.scales].iter().all(|length| *length > 0.0 && length.is_finite()) {
            return None;
        }
        let turned = oriented(&axes, lengths, &(polar * frame))?;
        let before = ratio(rest.scales);
        if let Some(most) = most {
            shorten(&mut lengths, most.max(before));
        }
        let q = on_side_of(DQuat::from_mat3(&turned), turn.turned(rest.quaternion)) * rest.length;
        shape[..4].copy_from_slice(&[q.w, q.x, q.y, q.z]);
        for (i, log) in shape[4..].iter_mut().enumerate() {
            let change = (lengths[i] / rest.scales[i]).ln();
            *log += if change.abs() < UNSTRETCHED { 0.0 } else { change };
        }

        if self.degree > 0 && harmonics.iter().all(|c| c.is_finite()) {
            let rotation = BandRotation::new(&polar, self.degree);
            harmonics.chunks_exact_mut(self.coefficients()).for_each(|channel| rotation.apply(channel));
        }
        if let (Opacity::Conserve, [before]) = (opacity, transparency) {
            *before = conserved(*before, area(lengths) / area(rest.scales));
        }
        Some([before, ratio(lengths)])
    }
}

impl Ellipsoid {
    /// Reads the ellipsoid from a quaternion and logarithms of scales.
    fn from_shape(shape: &[f64]) -> Option<Self> {
        let q = DQuat::from_xyzw(shape[1], shape[2], shape[3], shape[0]);
        let length = q.length();
        let logs = &shape[4..];
        if !(length > 0.0 && length.is_finite() && logs.iter().all(|log| log.is_finite())) {
            return None;
        }
        // Nothing overflows or vanishes, but for lengths in thin splats that are nothing beside the others.
        let unit = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let scale = |i: usize| logs.get(i).map_or(0.0, |log| (log - unit).exp());
        let scales = [scale(0), scale(1), scale(2)];
        scales[..logs.len()].iter().all(|s| *s > 0.0).then_some(Self {
            quaternion: q * (1.0 / length),
            length,
            scales,
        })
    }
}

/// Rotation whose axes lie along orthogonal ones, each on the side to which the former axis goes. The
/// shortest axis, or the one across a disc, is turned round where the axes would be a mirror.
fn oriented(axes: &DMat3, lengths: [f64; 3], before: &DMat3) -> Option<DMat3> {
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| lengths[*b].total_cmp(&lengths[*a]));
    let [first, second, third] = order;
    let side = |i: usize| {
        let unit = axes.col(i) / lengths[i];
        if unit.dot(before.col(i)) < 0.0 { -unit } else { unit }
    };
    let (a, b) = (side(first), side(second));
    // Rounding, and what counted as a right angle.
    let b = (b - b.dot(a) * a).try_normalize()?;
    let is_even = (first + 1) % 3 == second;
    let mut turned = DMat3::ZERO;
    *turned.col_mut(first) = a;
    *turned.col_mut(second) = b;
    *turned.col_mut(third) = if is_even { a.cross(b) } else { b.cross(a) };
    Some(turned)
}

/// Ratio of the longest axis to the second.
fn ratio(scales: [f64; 3]) -> f64 {
    let [first, second, _] = sorted(scales);
    first / second
}

/// Area of the section through the two largest axes, up to a factor.
fn area(scales: [f64; 3]) -> f64 {
    let [first, second, _] = sorted(scales);
    first * second
}

/// Makes the longest axis at most so many times as long as the second one.
fn shorten(lengths: &mut [f64; 3], most: f64) {
    let [first, second, _] = sorted(*lengths);
    if first > most * second
        && let Some(longest) = lengths.iter_mut().find(|length| **length == first)
    {
        *longest = most * second;
    }
}

/// Opacity before the sigmoid of a splat whose matter is spread over so many times the area: the light that
/// it absorbs, −ln(1 − α), is as many times less.
fn conserved(before: f64, area: f64) -> f64 {
    // ln(1 + eˣ), and the inverse of this function.
    let swallowed = before.max(0.0) + (-before.abs()).exp().ln_1p();
    let left = swallowed / area;
    let after = if left > 30.0 { left } else { left.exp_m1().ln() };
    if after.is_finite() && area.ln().abs() > UNSTRETCHED { after } else { before }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, EulerRot};
    use proptest::prelude::*;

    const SOLID: SplatNumbers = SplatNumbers { scales: 3, degree: 0 };

    fn some_gradient() -> DMat3 {
        DMat3::from_cols_array(&[1.1, 0.2, -0.3, -0.1, 0.8, 0.4, 0.2, -0.5, 1.3])
    }

    fn covariance(numbers: &[f64]) -> DMat3 {
        let q = DQuat::from_xyzw(numbers[1], numbers[2], numbers[3], numbers[0]);
        let frame = DMat3::from_quat(q * (1.0 / q.length()));
        let scale = |i: usize| numbers.get(4 + i).map_or(0.0, |log| log.exp());
        let half = frame * DMat3::from_diagonal(DVec3::new(scale(0), scale(1), scale(2)));
        half * half.transpose()
    }

    fn turned(splat: SplatNumbers, j: DMat3, numbers: &[f64]) -> Option<Vec<f64>> {
        let mut numbers = numbers.to_vec();
        splat.turn(&VertexTurn::new(j, false), Opacity::Keep, None, &mut numbers).map(|_| numbers)
    }

    fn rotation() -> impl Strategy<Value = DMat3> {
        prop::array::uniform3(-3.0f64..3.0)
            .prop_map(|[a, b, c]| DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, a, b, c)))
    }

    fn shape() -> impl Strategy<Value = Vec<f64>> {
        (prop::array::uniform4(-2.0f64..2.0), prop::array::uniform3(-9.0f64..1.0))
            .prop_filter("a length", |(q, _)| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
            .prop_map(|(q, s)| [&q[..], &s].concat())
    }

    proptest! {
        #[test]
        fn covariances_become_those_of_the_images(
            numbers in shape(),
            turn in rotation(),
            back in rotation(),
            stretch in prop::array::uniform3(0.2f64..4.0),
            side in prop::sample::select(vec![1.0, -1.0]),
        ) {
            let j = turn * DMat3::from_diagonal(DVec3::from_array(stretch)) * back * side;
            let expected = j * covariance(&numbers) * j.transpose();
            let found = turned(SOLID, j, &numbers).unwrap();
            let error = (covariance(&found) - expected).to_cols_array().map(f64::abs);
            let size = expected.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
            prop_assert!(error.iter().all(|e| *e < 1e-5 * size), "{error:?} of {size}");
            let length = |n: &[f64]| n[..4].iter().map(|x| x * x).sum::<f64>().sqrt();
            prop_assert!((length(&found) / length(&numbers) - 1.0).abs() < 1e-12);
        }

        #[test]
        fn rotations_keep_scales_and_their_order(numbers in shape(), turn in rotation()) {
            let found = turned(SOLID, turn, &numbers).unwrap();
            prop_assert_eq!(&found[4..], &numbers[4..]);
            let q = |n: &[f64]| DQuat::from_xyzw(n[1], n[2], n[3], n[0]);
            let expected = DMat3::from_quat(q(&numbers) * (1.0 / q(&numbers).length()));
            let found = DMat3::from_quat(q(&found) * (1.0 / q(&found).length()));
            prop_assert!(found.abs_diff_eq(turn * expected, 1e-9));
        }

        #[test]
        fn small_deformations_change_little(numbers in shape(), d in prop::array::uniform9(-1.0f64..1.0)) {
            // Axes of much different lengths, as round ones have none.
            let mut numbers = numbers;
            (numbers[4], numbers[5], numbers[6]) = (numbers[4] - 8.0, numbers[4] - 5.0, numbers[4] - 2.0);
            let found = turned(SOLID, DMat3::IDENTITY + DMat3::from_cols_array(&d) * 1e-4, &numbers).unwrap();
            let length = numbers[..4].iter().map(|x| x * x).sum::<f64>().sqrt();
            for i in 0..4 {
                prop_assert!((found[i] - numbers[i]).abs() < 1e-3 * length, "{found:?} of {numbers:?}");
            }
            for i in 4..7 {
                prop_assert!((found[i] - numbers[i]).abs() < 1e-3);
            }
        }

        #[test]
        fn nothing_panics(
            numbers in prop::collection::vec(prop::num::f64::ANY, 8 + 45),
            j in prop::array::uniform9(prop::num::f64::ANY),
            most in prop::option::of(1.0f64..100.0),
        ) {
            let splat = SplatNumbers { scales: 3, degree: 3 };
            let mut numbers = numbers;
            let turn = VertexTurn::new(DMat3::from_cols_array(&j), true);
            splat.turn(&turn, Opacity::Conserve, most, &mut numbers);
        }
    }

    #[test]
    fn what_means_nothing_is_kept() {
        let j = some_gradient();
        for broken in [
            [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
            [1.0, 0.0, 0.0, f64::NAN, 1.0, 1.0, 1.0],
            [1.0, 0.0, 0.0, 0.0, 1.0, f64::INFINITY, 1.0],
            [1.0, 0.0, 0.0, 0.0, 1.0, 1.0, f64::NEG_INFINITY],
        ] {
            assert!(turned(SOLID, j, &broken).is_none());
        }
        assert!(turned(SOLID, DMat3::ZERO, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).is_none());
        // Harmonics that are not finite are kept, and the shape turns.
        let splat = SplatNumbers { degree: 1, ..SOLID };
        let mut numbers = vec![1.0, 0.0, 0.0, 0.0, 0.0, -1.0, -2.0];
        numbers.extend([1.0, 2.0, 3.0, f64::NAN, 5.0, 6.0, 7.0, 8.0, 9.0]);
        let found = turned(splat, j, &numbers).unwrap();
        assert!(found[0] != 1.0 && found[7] == 1.0 && found[10].is_nan() && found[15] == 9.0);
    }

    #[test]
    fn discs_lie_in_the_images_of_their_planes() {
        let splat = SplatNumbers { scales: 2, ..SOLID };
        let numbers = [0.3, -0.4, 1.0, 0.2, -1.0, -2.5];
        for j in [some_gradient(), some_gradient() * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))] {
            let found = turned(splat, j, &numbers).unwrap();
            let expected = j * covariance(&numbers) * j.transpose();
            assert!(covariance(&found).abs_diff_eq(expected, 1e-7));
        }
    }

    #[test]
    fn needles_are_shortened_and_matter_is_conserved() {
        let j = DMat3::from_diagonal(DVec3::new(50.0, 1.0, 1.0));
        let mut numbers = [1.0, 0.0, 0.0, 0.0, -2.0, -2.0, -9.0, 0.3];
        let ratios =
            SOLID.turn(&VertexTurn::new(j, false), Opacity::Conserve, Some(10.0), &mut numbers).unwrap();
        assert!((ratios[0] - 1.0).abs() < 1e-12 && (ratios[1] - 10.0).abs() < 1e-12);
        assert!((numbers[4] - (10f64.ln() - 2.0)).abs() < 1e-12 && numbers[5] == -2.0);
        let swallowed = |x: f64| -(1.0 - 1.0 / (1.0 + (-x).exp())).ln();
        assert!((swallowed(numbers[7]) - swallowed(0.3) / 10.0).abs() < 1e-12);
        // One that was a needle before stays one.
        let mut needle = [1.0, 0.0, 0.0, 0.0, 2.0, -2.0, -9.0];
        SOLID
            .turn(&VertexTurn::new(DMat3::IDENTITY * 2.0, false), Opacity::Keep, Some(10.0), &mut needle)
            .unwrap();
        assert!((needle[4] - (2.0 + 2f64.ln())).abs() < 1e-12);
        assert!(conserved(800.0, 2.0) == 400.0 && conserved(f64::INFINITY, 2.0).is_infinite());
        assert!(conserved(f64::NAN, 2.0).is_nan() && conserved(-800.0, 2.0) == -800.0);
    }
}
