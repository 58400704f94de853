//! As many numbers as the processor takes at once, with the operators of numbers.
//!
//! Code that uses them is compiled for the processor only where it is inlined: no iterator and no `map` of an
//! array may stand between (a closure that these call is not), and a test looks that the program holds no
//! function of a single instruction.

use std::ops::{Add, AddAssign, Div, Mul, Sub};

use pulp::Simd;

/// Largest number of vertices that any processor takes at once.
pub const PACKET: usize = 16;

/// One number for each vertex of a packet.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd>(pub S, pub S::f32s);

impl<S: Simd> Lanes<S> {
    /// One number in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, x: f32) -> Self {
        Self(simd, simd.splat_f32s(x))
    }

    /// The larger of each pair.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self(self.0, self.0.max_f32s(self.1, other.1))
    }

    /// The smaller of each pair.
    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self(self.0, self.0.min_f32s(self.1, other.1))
    }

    /// Mask of the lanes in which this number is less than that of `than`.
    #[inline(always)]
    pub fn less(self, than: Self) -> Mask<S> {
        Mask(self.0, self.0.less_than_f32s(self.1, than.1))
    }

    /// Mask of the lanes in which this number is less than that of `than`, or equal.
    #[inline(always)]
    pub fn less_or_equal(self, than: Self) -> Mask<S> {
        Mask(self.0, self.0.less_than_or_equal_f32s(self.1, than.1))
    }

    /// Mask of the lanes in which this number is between those of `low` and `high`, or equal to one of them.
    #[inline(always)]
    pub fn within(self, low: Self, high: Self) -> Mask<S> {
        low.less_or_equal(self).and(self.less_or_equal(high))
    }

    /// The largest of all.
    #[inline(always)]
    pub fn largest(self) -> f32 {
        self.0.reduce_max_f32s(self.1)
    }

    /// The numbers one by one; of no meaning behind them.
    #[inline(always)]
    pub fn store(self) -> [f32; PACKET] {
        let mut numbers = [0.0; PACKET];
        S::as_mut_simd_f32s(&mut numbers).0[0] = self.1;
        numbers
    }

    /// self · by + to, rounded once.
    #[inline(always)]
    pub fn mul_add(self, by: Self, to: Self) -> Self {
        Self(self.0, self.0.mul_add_f32s(self.1, by.1, to.1))
    }

    /// The square root of each lane.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0, self.0.sqrt_f32s(self.1))
    }

    /// Lanes of `positive` where this number is more than zero, and of `other` elsewhere.
    #[inline(always)]
    pub fn where_positive(self, positive: Self, other: Self) -> Self {
        Self::splat(self.0, 0.0).less(self).select(positive, other)
    }

    /// 1 / x, but 1 where x is not positive.
    #[inline(always)]
    pub fn inverse_or_one(self) -> Self {
        let one = Self::splat(self.0, 1.0);
        Self(self.0, self.0.div_f32s(one.1, self.where_positive(self, one).1))
    }
}

/// Mask: a truth value for each vertex of a packet.
#[derive(Clone, Copy)]
pub struct Mask<S: Simd>(S, S::m32s);

impl<S: Simd> Mask<S> {
    /// Mask of the lanes in which both are true.
    #[inline(always)]
    pub fn and(self, other: Self) -> Self {
        Self(self.0, self.0.and_m32s(self.1, other.1))
    }

    /// Whether the mask is true for any vertex.
    #[inline(always)]
    pub fn any(self) -> bool {
        // Bits of a number are looked at all at once, and numbers of a vector by their largest.
        if const { size_of::<S::m32s>() <= size_of::<u16>() } {
            self.0.first_true_m32s(self.1) < S::F32_LANES
        } else {
            let (one, zero) = (Lanes::splat(self.0, 1.0), Lanes::splat(self.0, 0.0));
            self.select(one, zero).largest() > 0.0
        }
    }

    /// `then` where it holds, and `or` elsewhere.
    #[inline(always)]
    pub fn select(self, then: Lanes<S>, or: Lanes<S>) -> Lanes<S> {
        Lanes(self.0, self.0.select_f32s(self.1, then.1, or.1))
    }

    /// Whole numbers, lane by lane from the one or the other.
    #[inline(always)]
    pub fn select_whole(self, then: S::u32s, or: S::u32s) -> S::u32s {
        self.0.select_u32s(self.1, then, or)
    }
}

/// Entries of three lists at place `at`.
#[inline(always)]
pub fn triple<S: Simd>(simd: S, of: &[&[S::f32s]; 3], at: usize) -> [Lanes<S>; 3] {
    [Lanes(simd, of[0][at]), Lanes(simd, of[1][at]), Lanes(simd, of[2][at])]
}

/// Entries of three lists from place `at` on, which need not be the start of a packet.
#[inline(always)]
pub fn triple_from<S: Simd>(simd: S, of: [&[f32]; 3], at: usize) -> [Lanes<S>; 3] {
    let x = S::as_simd_f32s(&of[0][at..at + S::F32_LANES]).0[0];
    let y = S::as_simd_f32s(&of[1][at..at + S::F32_LANES]).0[0];
    let z = S::as_simd_f32s(&of[2][at..at + S::F32_LANES]).0[0];
    [Lanes(simd, x), Lanes(simd, y), Lanes(simd, z)]
}

/// The ways from one place to many.
#[inline(always)]
pub fn from<S: Simd>(simd: S, p: [Lanes<S>; 3], q: [f32; 3]) -> [Lanes<S>; 3] {
    [p[0] - Lanes::splat(simd, q[0]), p[1] - Lanes::splat(simd, q[1]), p[2] - Lanes::splat(simd, q[2])]
}

/// The squares of lengths.
#[inline(always)]
pub fn length_squared<S: Simd>(d: [Lanes<S>; 3]) -> Lanes<S> {
    d[0].mul_add(d[0], d[1].mul_add(d[1], d[2] * d[2]))
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

impl<S: Simd> Div for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(self.0, self.0.div_f32s(self.1, other.1))
    }
}
