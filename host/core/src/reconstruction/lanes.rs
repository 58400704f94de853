//! As many numbers as the processor takes at once, with the operators of numbers.

use std::ops::{Add, AddAssign, Mul, Sub};

use pulp::Simd;

/// One number for each vertex of a packet.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd>(pub S, pub S::f32s);

impl<S: Simd> Lanes<S> {
    /// The same number for all.
    #[inline(always)]
    pub fn splat(simd: S, x: f32) -> Self {
        Self(simd, simd.splat_f32s(x))
    }

    /// The larger of each pair.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self(self.0, self.0.max_f32s(self.1, other.1))
    }

    /// The largest of all.
    #[inline(always)]
    pub fn largest(self) -> f32 {
        self.0.reduce_max_f32s(self.1)
    }

    /// Its square root.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0, self.0.sqrt_f32s(self.1))
    }

    /// `positive` where it is more than zero, and `other` elsewhere.
    #[inline(always)]
    pub fn where_positive(self, positive: Self, other: Self) -> Self {
        let simd = self.0;
        let mask = simd.greater_than_f32s(self.1, simd.splat_f32s(0.0));
        Self(simd, simd.select_f32s(mask, positive.1, other.1))
    }

    /// 1 / x, but 1 where x is not positive.
    #[inline(always)]
    pub fn inverse_or_one(self) -> Self {
        let one = Self::splat(self.0, 1.0);
        Self(self.0, self.0.div_f32s(one.1, self.where_positive(self, one).1))
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0, self.0.add_f32s(self.1, other.1))
    }
}

impl<S: Simd> AddAssign for Lanes<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0, self.0.sub_f32s(self.1, other.1))
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0, self.0.mul_f32s(self.1, other.1))
    }
}
