//! Parts of motions: half a turn of a half turn is a quarter turn.
//!
//! An affine map is a stretch (symmetric, of volume 1, about the handle's centre) and then a similarity,
//! which turns, scales and moves. A similarity is the exponential of a twist, so that a part of it is the
//! exponential of that part of the twist: the screw motion of a rigid one, a logarithmic spiral where it
//! scales. Twists of several handles are added: M. Alexa, *Linear combination of transformations*,
//! SIGGRAPH 2002. A turn of more than half a turn is one of less the other way round: the map does not tell
//! which it was.

use glam::{DMat3, DQuat, DVec3};
use simod_geometry::symmetric_eigen;
use simod_plugin_api::Affine;

/// Stretch below which it is rounding.
const ROUNDING: f64 = 1e-12;

/// A handle's motion, of which parts can be taken.
#[derive(Debug, Clone, Copy)]
pub struct HandleMotion {
    /// The whole motion.
    whole: Affine,
    parts: PartialMotion,
}

#[derive(Debug, Clone, Copy)]
enum PartialMotion {
    /// The motion moves nothing.
    None,
    /// A stretch, if there is one, and a similarity.
    Twist(Option<Stretch>, Twist),
    /// Displacements are scaled, as the motion is not continuously connected with none, as mirrors are not.
    Straight,
}

/// A symmetric map of volume 1 about a centre, as the logarithms of its principal stretches.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    center: DVec3,
    axes: DMat3,
    logarithms: DVec3,
}

/// The logarithm of a similarity.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Twist {
    /// Axis times angle.
    turn: DVec3,
    /// Logarithm of the scale.
    growth: f64,
    /// The velocity of the origin.
    shift: DVec3,
}

impl HandleMotion {
    /// The motion of a handle, which stretches about the handle's centre.
    pub fn new(whole: &Affine, center: DVec3) -> Self {
        let parts =
            if *whole == Affine::IDENTITY { Some(PartialMotion::None) } else { Self::split(whole, center) };
        Self { whole: *whole, parts: parts.unwrap_or(PartialMotion::Straight) }
    }

    fn split(whole: &Affine, center: DVec3) -> Option<PartialMotion> {
        let row = |i: usize| DVec3::from_slice(&whole.rows[i][..3]);
        let matrix = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let offset = DVec3::from(whole.rows.map(|r| r[3]));
        let volume = matrix.determinant();
        let scale = volume.cbrt();
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        // The polar decomposition is of A / scale: its stretch is the square root of the symmetric AᵀA.
        let shape = matrix * scale.recip();
        let (squares, axes) = symmetric_eigen(shape.transpose() * shape);
        if squares.min_element() <= f64::EPSILON * squares.max_element() {
            return None;
        }
        let logarithms = 0.5 * squares.map(f64::ln);
        let stretch = Some(Stretch { center, axes, logarithms });
        let stretch = stretch.filter(|s| s.logarithms.abs().max_element() > ROUNDING);
        let unstretched = match &stretch {
            Some(s) => shape * s.matrix(-1.0),
            None => shape,
        };
        let turn = DQuat::from_mat3(&unstretched).normalize();
        let turn = if turn.w < 0.0 { -turn } else { turn };
        // The similarity has to make the rest of the map, as the stretch leaves the centre in place.
        let rigid = DMat3::from_quat(turn) * scale;
        let offset = match &stretch {
            Some(_) => matrix * center + offset - rigid * center,
            None => offset,
        };
        let (turn, growth) = (turn.to_scaled_axis(), scale.ln());
        let twist = Twist { turn, growth, shift: DVec3::ZERO };
        let shift = twist.integral().divide(offset);
        Some(PartialMotion::Twist(stretch, Twist { shift, ..twist })).filter(|_| shift.is_finite())
    }

    /// Whether the motion moves nothing.
    pub fn is_none(&self) -> bool {
        matches!(self.parts, PartialMotion::None)
    }

    /// Image of a point under the whole motion.
    pub fn all(&self, p: DVec3) -> DVec3 {
        self.whole.apply(p.into()).into()
    }
}

/// Image of a point under a part of each motion.
pub fn blend<'a>(p: DVec3, parts: impl Iterator<Item = (&'a HandleMotion, f64)>) -> DVec3 {
    let (mut stretched, mut straight, mut sum) = (p, DVec3::ZERO, Twist::default());
    for (motion, t) in parts {
        match &motion.parts {
            PartialMotion::None => {}
            PartialMotion::Straight => straight += t * (motion.all(p) - p),
            PartialMotion::Twist(stretch, twist) => {
                if let Some(s) = stretch {
                    let from = p - s.center;
                    stretched += s.matrix(t) * from - from;
                }
                sum.turn += t * twist.turn;
                sum.growth += t * twist.growth;
                sum.shift += t * twist.shift;
            }
        }
    }
    sum.apply(stretched) + straight
}

impl Stretch {
    /// The part `t` of the stretch, as a matrix.
    fn matrix(&self, t: f64) -> DMat3 {
        let stretches = (t * self.logarithms).map(f64::exp);
        self.axes * DMat3::from_diagonal(stretches) * self.axes.transpose()
    }
}

impl Twist {
    fn apply(&self, p: DVec3) -> DVec3 {
        if *self == Self::default() {
            return p;
        }
        let turned = DQuat::from_scaled_axis(self.turn) * p;
        self.growth.exp() * turned + self.integral().multiply(self.shift)
    }

    /// Integral of a velocity that turns and grows: ∫ exp(s (growth + turn ×)) ds from 0 to 1.
    fn integral(&self) -> Integral {
        let angle = self.turn.length();
        let axis = self.turn.try_normalize().unwrap_or(DVec3::ZERO);
        let (along, _) = integral_of_exp(self.growth, 0.0);
        let (across, sideways) = integral_of_exp(self.growth, angle);
        Integral { axis, along, across, sideways }
    }
}

/// A map that scales along an axis, and scales and turns across it.
struct Integral {
    axis: DVec3,
    along: f64,
    across: f64,
    sideways: f64,
}

impl Integral {
    fn multiply(&self, v: DVec3) -> DVec3 {
        let along = self.axis * self.axis.dot(v);
        self.along * along + self.across * (v - along) + self.sideways * self.axis.cross(v)
    }

    fn divide(&self, v: DVec3) -> DVec3 {
        let along = self.axis * self.axis.dot(v);
        let square = self.across * self.across + self.sideways * self.sideways;
        along / self.along + (self.across * (v - along) - self.sideways * self.axis.cross(v)) / square
    }
}

/// (exp(z) - 1) / z of a complex number z.
fn integral_of_exp(re: f64, im: f64) -> (f64, f64) {
    let square = re * re + im * im;
    if square < 1e-6 {
        // 1 + z/2 + z²/6 + z³/24 + z⁴/120: the rest is below rounding.
        let series = [1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0];
        return series.iter().fold((1.0 / 120.0, 0.0), |(a, b), c| (c + a * re - b * im, a * im + b * re));
    }
    let size = re.exp();
    let (a, b) = (size * im.cos() - 1.0, size * im.sin());
    ((a * re + b * im) / square, (b * re - a * im) / square)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Affine map of a matrix and an offset.
    pub(crate) fn affine(matrix: DMat3, offset: DVec3) -> Affine {
        let m = matrix.transpose();
        let row = |v: DVec3, t: f64| [v.x, v.y, v.z, t];
        Affine { rows: [row(m.x_axis, offset.x), row(m.y_axis, offset.y), row(m.z_axis, offset.z)] }
    }

    fn part(motion: &HandleMotion, t: f64, p: DVec3) -> DVec3 {
        blend(p, std::iter::once((motion, t)))
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from)
    }

    proptest! {
        #[test]
        fn the_whole_part_is_the_motion_and_halves_of_rigid_ones_make_it(
            turn in vector(), scale in 0.3..3.0_f64, shear in prop::array::uniform9(-0.2..0.2_f64),
            offset in vector(), center in vector(), p in vector(), is_similarity in any::<bool>(),
        ) {
            let rest = DMat3::from_cols_array(&shear) * if is_similarity { 0.0 } else { 1.0 };
            let matrix = scale * (DMat3::from_quat(DQuat::from_scaled_axis(1.7 * turn)) + rest);
            let motion = HandleMotion::new(&affine(matrix, offset), center);
            prop_assert!(matches!(motion.parts, PartialMotion::Twist(..)));
            let whole = part(&motion, 1.0, p);
            prop_assert!(whole.distance(motion.all(p)) < 1e-9, "{whole} {}", motion.all(p));
            if is_similarity {
                let halves = part(&motion, 0.5, part(&motion, 0.5, p));
                prop_assert!(halves.distance(whole) < 1e-9, "{halves} {whole}");
            }
            // The motion is continuous where it begins.
            prop_assert!(part(&motion, 1e-9, p).distance(p) < 1e-7);
            // Two handles with the same motion make it together.
            let two = blend(p, [(&motion, 0.3), (&motion, 0.7)].into_iter());
            prop_assert!(!is_similarity || two.distance(whole) < 1e-9);
        }
    }

    #[test]
    fn turns_turn_about_their_own_axis() {
        let pivot = DVec3::new(2.0, 1.0, 0.0);
        let turn = DMat3::from_rotation_z(2.0);
        let motion = HandleMotion::new(&affine(turn, pivot - turn * pivot), DVec3::ZERO);
        let p = DVec3::new(5.0, 1.0, 3.0);
        let expected = pivot + DMat3::from_rotation_z(0.5) * (p - pivot);
        assert!(part(&motion, 0.25, p).distance(expected) < 1e-12);
        // Half a turn has two halves that lead to the same end.
        let half = DMat3::from_rotation_z(std::f64::consts::PI);
        let motion = HandleMotion::new(&affine(half, pivot - half * pivot), DVec3::ZERO);
        assert!((part(&motion, 0.5, p).distance(pivot) - p.distance(pivot)).abs() < 1e-12);
        let shift = HandleMotion::new(&affine(DMat3::IDENTITY, pivot), DVec3::ZERO);
        assert!(part(&shift, 0.25, p).distance(p + 0.25 * pivot) < 1e-15);
    }

    #[test]
    fn mirrors_and_flat_maps_go_straight() {
        for matrix in [DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)), DMat3::ZERO] {
            let motion = HandleMotion::new(&affine(matrix, DVec3::X), DVec3::ZERO);
            let p = DVec3::new(0.3, 0.2, 0.1);
            let expected = p.lerp(matrix * p + DVec3::X, 0.5);
            assert!(part(&motion, 0.5, p).distance(expected) < 1e-15);
        }
    }

    #[test]
    fn nothing_is_exactly_nothing() {
        let motion = HandleMotion::new(&Affine::IDENTITY, DVec3::ONE);
        let p = DVec3::new(0.1, 0.2, 0.3);
        assert!(motion.is_none() && part(&motion, 0.7, p) == p);
    }
}
