//! One number in double precision for each of several samples, in a vector register.

use std::ops::{Add, AddAssign, Div, Mul, Sub};

use pulp::Simd;

/// Largest number of samples that any processor takes at once.
pub const MOST_LANES: usize = 8;

/// One number for each sample of a packet.
#[derive(Clone, Copy)]
pub struct DoubleLanes<S: Simd>(pub S, pub S::f64s);

impl<S: Simd> DoubleLanes<S> {
    /// One number in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, x: f64) -> Self {
        Self(simd, simd.splat_f64s(x))
    }

    /// The first of these numbers, one for each.
    #[inline(always)]
    pub fn load(simd: S, numbers: &[f64; MOST_LANES]) -> Self {
        Self(simd, S::as_simd_f64s(numbers).0[0])
    }

    /// The number of each, and of no meaning behind them.
    #[inline(always)]
    pub fn store(self) -> [f64; MOST_LANES] {
        let mut numbers = [0.0; MOST_LANES];
        S::as_mut_simd_f64s(&mut numbers).0[0] = self.1;
        numbers
    }

    /// self · by + to, rounded once.
    #[inline(always)]
    pub fn mul_add(self, by: Self, to: Self) -> Self {
        Self(self.0, self.0.mul_add_f64s(self.1, by.1, to.1))
    }

    /// from - self · by, rounded once.
    #[inline(always)]
    pub fn negate_mul_add(self, by: Self, from: Self) -> Self {
        Self(self.0, self.0.negate_mul_add_f64s(self.1, by.1, from.1))
    }

    /// The absolute value of each lane.
    #[inline(always)]
    pub fn abs(self) -> Self {
        Self(self.0, self.0.abs_f64s(self.1))
    }

    /// The square root of each lane.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0, self.0.sqrt_f64s(self.1))
    }

    /// The larger of each pair; the other one where this is no number.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        other.less(self).select(self, other)
    }

    /// The smaller of each pair; the other one where this is no number.
    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        self.less(other).select(self, other)
    }

    /// The largest of all.
    #[inline(always)]
    pub fn largest(self) -> f64 {
        self.0.reduce_max_f64s(self.1)
    }

    /// Mask of the lanes in which this number is less than that of `than`.
    #[inline(always)]
    pub fn less(self, than: Self) -> DoubleMask<S> {
        DoubleMask(self.0, self.0.less_than_f64s(self.1, than.1))
    }
}

/// One number for each sample and coordinate.
pub type Triple<S> = [DoubleLanes<S>; 3];

/// The kernel 1 - 3t² + 2t³ of distances as parts of its radius, nothing beyond.
#[inline(always)]
pub fn kernel<S: Simd>(simd: S, t: DoubleLanes<S>) -> DoubleLanes<S> {
    let one = DoubleLanes::splat(simd, 1.0);
    let t = t.min(one);
    let rest = t.mul_add(DoubleLanes::splat(simd, 2.0), DoubleLanes::splat(simd, -3.0));
    (t * t).mul_add(rest, one)
}

/// The squares of lengths.
#[inline(always)]
pub fn square<S: Simd>(d: Triple<S>) -> DoubleLanes<S> {
    d[0].mul_add(d[0], d[1].mul_add(d[1], d[2] * d[2]))
}

/// Mask: a truth value for each sample of a packet.
#[derive(Clone, Copy)]
pub struct DoubleMask<S: Simd>(S, S::m64s);

impl<S: Simd> DoubleMask<S> {
    /// The lanes in which both masks hold.
    #[inline(always)]
    pub fn and(self, other: Self) -> Self {
        Self(self.0, self.0.and_m64s(self.1, other.1))
    }

    /// The lanes in which either mask holds.
    #[inline(always)]
    pub fn or(self, other: Self) -> Self {
        Self(self.0, self.0.or_m64s(self.1, other.1))
    }

    /// `then` where it holds, and `or` elsewhere.
    #[inline(always)]
    pub fn select(self, then: DoubleLanes<S>, or: DoubleLanes<S>) -> DoubleLanes<S> {
        DoubleLanes(self.0, self.0.select_f64s(self.1, then.1, or.1))
    }

    /// Whether the mask is true for any sample.
    #[inline(always)]
    pub fn any(self) -> bool {
        let (one, zero) = (DoubleLanes::splat(self.0, 1.0), DoubleLanes::splat(self.0, 0.0));
        self.select(one, zero).largest() > 0.0
    }

    /// Truth values, sample by sample; the entries behind the vector's lanes have no meaning.
    #[inline(always)]
    pub fn store(self) -> [bool; MOST_LANES] {
        let (one, zero) = (DoubleLanes::splat(self.0, 1.0), DoubleLanes::splat(self.0, 0.0));
        let numbers = self.select(one, zero).store();
        let mut holds = [false; MOST_LANES];
        for i in 0..MOST_LANES {
            holds[i] = numbers[i] != 0.0;
        }
        holds
    }
}

impl<S: Simd> Add for DoubleLanes<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0, self.0.add_f64s(self.1, other.1))
    }
}

impl<S: Simd> AddAssign for DoubleLanes<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<S: Simd> Sub for DoubleLanes<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0, self.0.sub_f64s(self.1, other.1))
    }
}

impl<S: Simd> Mul for DoubleLanes<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0, self.0.mul_f64s(self.1, other.1))
    }
}

impl<S: Simd> Div for DoubleLanes<S> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(self.0, self.0.div_f64s(self.1, other.1))
    }
}
