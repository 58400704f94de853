//! Second-order Taylor expansions of the deformation about samples, which are blended.

use bytemuck::{Pod, Zeroable};
use glam::{Mat3, Vec3, Vec4};

/// Residual that rounding to single precision may leave, in local units.
pub const ROUNDING: f64 = 5e-7;

/// Displacement about a sample, u(q + d) = u₀ + S·d + Q(d, d), and the support in which it has a weight.
///
/// The ten terms of each coordinate are u₀, the three slopes, and the six second-order terms xx, xy, xz, yy,
/// yz, zz, in the order in which Horner's rule takes them. Displacements rather than places, as those of
/// samples that do not move are exactly nothing.
///
/// Memory: 144 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Expansion {
    /// q, in local coordinates.
    pub center: [f32; 3],
    /// One over the square of the support's radius, at most [`NO_SUPPORT`](Self::NO_SUPPORT).
    pub inverse_square: f32,
    /// Term by term, the three coordinates of each side by side; and two numbers more, so that four can be
    /// read from where any term begins.
    terms: [f32; 32],
}

/// Terms of each coordinate.
const TERMS: usize = 10;

impl Expansion {
    /// So small a support holds the sample alone.
    pub const NO_SUPPORT: f32 = 1e30;

    /// An expansion from a displacement, its gradient S, and the second-order terms.
    pub fn new(center: Vec3, displacement: Vec3, slope: Mat3, second: [Vec3; 6]) -> Self {
        let nothing = Self { center: center.to_array(), inverse_square: Self::NO_SUPPORT, terms: [0.0; 32] };
        nothing.with(0, [displacement]).with_slope(slope).with_second(second)
    }

    /// Term `k` of coordinate `o`.
    #[inline(always)]
    pub fn term(&self, k: usize, o: usize) -> f32 {
        self.terms[3 * k + o]
    }

    /// Term `k` of the three coordinates, and a number of no meaning.
    #[inline(always)]
    pub fn four(&self, k: usize) -> [f32; 4] {
        [self.terms[3 * k], self.terms[3 * k + 1], self.terms[3 * k + 2], self.terms[3 * k + 3]]
    }

    /// The terms of each coordinate.
    pub fn rows(&self) -> [[f32; TERMS]; 3] {
        std::array::from_fn(|o| std::array::from_fn(|k| self.term(k, o)))
    }

    /// Depth of a place in the expansion's support: from 1 at the sample down to 0 at the border, and below
    /// outside.
    #[inline]
    pub fn within(&self, p: Vec3) -> f32 {
        1.0 - p.distance_squared(Vec3::from_array(self.center)) * self.inverse_square
    }

    /// The displacement of the sample itself.
    pub fn displacement(&self) -> Vec3 {
        self.vector(0)
    }

    /// The gradient of the displacement at the sample.
    pub fn slope(&self) -> Mat3 {
        Mat3::from_cols(self.vector(1), self.vector(2), self.vector(3))
    }

    /// Copy of this expansion with another gradient of the displacement.
    pub fn with_slope(self, slope: Mat3) -> Self {
        self.with(1, [slope.x_axis, slope.y_axis, slope.z_axis])
    }

    /// Copy of this expansion with other second-order terms: xx, xy, xz, yy, yz, zz.
    pub fn with_second(self, second: [Vec3; 6]) -> Self {
        self.with(4, second)
    }

    /// The second-order terms xx, xy, xz, yy, yz, zz.
    pub fn second(&self) -> [Vec3; 6] {
        std::array::from_fn(|term| self.vector(4 + term))
    }

    /// Term `k` of the three coordinates.
    fn vector(&self, k: usize) -> Vec3 {
        Vec3::new(self.term(k, 0), self.term(k, 1), self.term(k, 2))
    }

    /// Copy of this expansion with other terms from the `k`-th on.
    fn with<const N: usize>(mut self, k: usize, terms: [Vec3; N]) -> Self {
        for (to, term) in self.terms[3 * k..].chunks_exact_mut(3).zip(terms) {
            to.copy_from_slice(&term.to_array());
        }
        self
    }

    /// Whether the expansion is zero, so that it moves nothing anywhere.
    pub fn is_still(&self) -> bool {
        self.terms.iter().all(|x| *x == 0.0)
    }

    /// The displacement at `d` from the sample, and its gradient.
    pub fn evaluate(&self, d: Vec3) -> (Vec3, Mat3) {
        let parts = self.rows().map(|[u, sx, sy, sz, xx, xy, xz, yy, yz, zz]| {
            let a = sx + xx * d.x + xy * d.y + xz * d.z;
            let b = sy + yy * d.y + yz * d.z;
            let c = sz + zz * d.z;
            let slope = Vec3::new(a + xx * d.x, b + xy * d.x + yy * d.y, c + xz * d.x + yz * d.y + zz * d.z);
            (u + a * d.x + b * d.y + c * d.z, slope)
        });
        let slopes = parts.map(|(_, slope)| slope);
        let gradient = Mat3::from_cols(slopes[0], slopes[1], slopes[2]).transpose();
        (Vec3::from_array(parts.map(|(u, _)| u)), gradient)
    }

    /// The displacement at `d` from the sample: as [`evaluate`](Self::evaluate) has it, to the bit, the three
    /// coordinates side by side.
    #[inline]
    pub fn displacement_at(&self, d: Vec3) -> Vec3 {
        let [u, sx, sy, sz, xx, xy, xz, yy, yz, zz]: [Vec4; TERMS] =
            std::array::from_fn(|k| Vec4::from_array(self.four(k)));
        let a = sx + xx * d.x + xy * d.y + xz * d.z;
        let b = sy + yy * d.y + yz * d.z;
        let c = sz + zz * d.z;
        (u + a * d.x + b * d.y + c * d.z).truncate()
    }

    /// Displacement of a point at `d`, beyond the support, and its gradient: the second order is that at the
    /// margin, as no neighbour told what it is farther out.
    pub fn beyond(&self, d: Vec3) -> (Vec3, Mat3) {
        let margin = (1.0 / (d.length_squared() * self.inverse_square)).min(1.0);
        let mut inner = *self;
        inner.terms[3 * 4..].iter_mut().for_each(|x| *x *= margin);
        inner.evaluate(d)
    }
}

/// A support that reaches the vertices of a home.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct ReachingSupport {
    /// Vertices nearer to the home's sample than this are not reached.
    pub from: f32,
    /// The sample.
    pub sample: u32,
}

impl ReachingSupport {
    /// Number by which supports are ordered: a nearer one's is less, and of those that are equally far that
    /// of the first sample.
    pub fn to_ordered(self) -> u64 {
        let bits = self.from.to_bits();
        let bits = if bits >> 31 == 1 { !bits } else { bits | 1 << 31 };
        u64::from(bits) << 32 | u64::from(self.sample)
    }

    /// The support of such a number.
    pub fn from_ordered(number: u64) -> Self {
        let bits = (number >> 32) as u32;
        let bits = if bits >> 31 == 1 { bits & !(1 << 31) } else { !bits };
        Self { from: f32::from_bits(bits), sample: number as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn three_coordinates_at_once_are_each_by_itself(
            terms in prop::array::uniform30(-1.0..1.0f32), d in prop::array::uniform3(-1.0..1.0f32),
        ) {
            let vector = |k: usize| Vec3::from_slice(&terms[3 * k..]);
            let slope = Mat3::from_cols(vector(1), vector(2), vector(3));
            let second = std::array::from_fn(|term| vector(4 + term));
            let (expansion, d) = (Expansion::new(Vec3::ZERO, vector(0), slope, second), Vec3::from_array(d));
            let (at_once, by_itself) = (expansion.displacement_at(d), expansion.evaluate(d).0);
            prop_assert_eq!(at_once.to_array().map(f32::to_bits), by_itself.to_array().map(f32::to_bits));
        }
    }
}
