//! Least squares for the terms of second-order expansions, fitted to a sample's neighbours.
//!
//! The residual of the affine map of [`gradients`](super::gradients) at the neighbours is explained by nine
//! terms for each coordinate, with a ridge that follows from the residual of these in their turn (N. Wiener,
//! *Extrapolation, Interpolation, and Smoothing of Stationary Time Series*, 1949).
//!
//! As many samples are fitted at once as the processor's vector registers take, each by the same operations
//! in the same order on any processor.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use pulp::Simd;

use super::expansion::ROUNDING;
use super::packets::{NeighbourPacket, Neighbours, triple};
use crate::double_lanes::{DoubleLanes, DoubleMask, MOST_LANES, Triple, kernel, square};

/// The largest ridge, relative to terms of the size of the neighbourhood ...
const RIDGE: f64 = 1e-7;

/// ... and the least one, which keeps rounding from being followed.
const LEAST_RIDGE: f64 = 1e-11;

/// Expected square of the terms of a fit, as a multiple of the squares of the strain and of the residual of
/// the affine map.
const EXPECTED: f64 = 4.0;

/// Terms of a second-order expansion without its constant: x, y, z, xx, xy, xz, yy, yz, zz.
pub const TERMS: usize = 9;

/// The factors of its second-order terms.
const FACTORS: [[usize; 2]; 6] = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

/// A fit that leaves over more than this part of the displacement's variation makes its sample a troubled one
/// …
const TROUBLED: f64 = 0.1;

/// … and one that leaves over more than this is not to be believed.
const USELESS: f64 = 0.3;

/// The terms of the three coordinates.
pub type Terms<S> = [Triple<S>; TERMS];

/// Sums of the squares of the affine map's residual at the neighbours of each sample, which is to be
/// explained by the terms in units of the neighbourhood's radius.
pub struct LeastSquares<S: Simd> {
    simd: S,
    /// One over the radius; 1 where the radius is zero, and nothing is gathered.
    pub scale: DoubleLanes<S>,
    /// Lower triangle of the products of terms, and the products of the terms with the residual.
    matrix: [[DoubleLanes<S>; TERMS]; TERMS],
    right: Terms<S>,
    /// The sums of the weights, and of their squares.
    pub weights: DoubleLanes<S>,
    squared_weights: DoubleLanes<S>,
    /// Weighted sum of the residual's squares.
    squares: DoubleLanes<S>,
    /// The largest of that, as the square of a length.
    largest: DoubleLanes<S>,
    /// The weighted sum of squares of the displacements, less the sample's own.
    variation: DoubleLanes<S>,
}

impl<S: Simd> LeastSquares<S> {
    /// The sums over the neighbours of as many samples as there are lanes, and the gradients there, column by
    /// column.
    #[inline(always)]
    pub fn accumulate(simd: S, neighbours: &Neighbours, gradient: &[[f64; MOST_LANES]; 9]) -> Self {
        let zero = DoubleLanes::splat(simd, 0.0);
        let mut slope = [zero; 9];
        for i in 0..9 {
            slope[i] = DoubleLanes::load(simd, &gradient[i]);
        }
        let mut sums = Self {
            simd,
            scale: DoubleLanes::load(simd, &neighbours.scale),
            matrix: [[zero; TERMS]; TERMS],
            right: [[zero; 3]; TERMS],
            weights: zero,
            squared_weights: zero,
            squares: zero,
            largest: zero,
            variation: zero,
        };
        let mut moments = ProductSums { second: [zero; 6], third: [zero; 10], fourth: [zero; 15] };
        for place in 0..neighbours.longest {
            sums.include(&slope, &neighbours.places[place], &mut moments);
        }
        sums.matrix = moments.products(zero);
        sums
    }

    #[inline(always)]
    fn include(
        &mut self,
        slope: &[DoubleLanes<S>; 9],
        place: &NeighbourPacket,
        moments: &mut ProductSums<S>,
    ) {
        let simd = self.simd;
        let (d, moved) = (triple(simd, &place.way), triple(simd, &place.moved));
        let mut left = moved;
        for axis in 0..3 {
            for column in 0..3 {
                left[axis] = slope[3 * column + axis].negate_mul_add(d[column], left[axis]);
            }
        }
        let x = [d[0] * self.scale, d[1] * self.scale, d[2] * self.scale];
        let w = DoubleLanes::load(simd, &place.is_there) * kernel(simd, square(x).sqrt());

        let mut second = [w; 6];
        for (to, [a, b]) in second.iter_mut().zip(FACTORS) {
            *to = x[a] * x[b];
        }
        let weighted = moments.include(w, x, second);
        for a in 0..3 {
            let first = w * x[a];
            for axis in 0..3 {
                self.right[a][axis] = first.mul_add(left[axis], self.right[a][axis]);
            }
        }
        for a in 0..6 {
            for axis in 0..3 {
                self.right[3 + a][axis] = weighted[a].mul_add(left[axis], self.right[3 + a][axis]);
            }
        }
        self.weights += w;
        self.squared_weights = w.mul_add(w, self.squared_weights);
        let displaced = [moved[0] - d[0], moved[1] - d[1], moved[2] - d[2]];
        self.variation = w.mul_add(square(displaced), self.variation);
        let left = square(left);
        self.squares = w.mul_add(left, self.squares);
        self.largest = self.largest.max(left);
    }

    /// Mask of the samples with a larger residual of the affine map than rounding makes.
    #[inline(always)]
    pub fn is_needed(&self) -> DoubleMask<S> {
        DoubleLanes::splat(self.simd, ROUNDING * ROUNDING).less(self.largest)
    }

    /// The terms that explain most with this ridge, the part of the squares that they leave over, and where
    /// they could be found.
    #[inline(always)]
    pub fn ridged(&self, ridge: DoubleLanes<S>) -> (Terms<S>, DoubleLanes<S>, DoubleMask<S>) {
        let (factor, is_found) = DenseFactor::factorize(self.simd, &self.matrix, ridge * self.weights);
        let terms = factor.solve(self.right);
        // For the least squares c, the residual is Σ w|r|² − c·b, up to the ridge.
        let mut explained = DoubleLanes::splat(self.simd, 0.0);
        for (term, right) in terms.iter().zip(&self.right) {
            for axis in 0..3 {
                explained = term[axis].mul_add(right[axis], explained);
            }
        }
        let (zero, one) = (DoubleLanes::splat(self.simd, 0.0), DoubleLanes::splat(self.simd, 1.0));
        (terms, (one - explained / self.squares).max(zero), is_found)
    }

    /// Terms with the ridge of a Wiener filter for this strain: the residual of a fit almost without a ridge
    /// is noise, beside the size that terms may have.
    #[inline(always)]
    pub fn solve(&self, strain: DoubleLanes<S>) -> (Terms<S>, DoubleLanes<S>, DoubleLanes<S>, DoubleMask<S>) {
        let splat = |x| DoubleLanes::splat(self.simd, x);
        let (_, left, is_found) = self.ridged(splat(LEAST_RIDGE));
        // The residual of nine terms fitted to few neighbours is less than the noise of these.
        let noise = left * self.squares / (splat(EXPECTED) * self.free() * self.signal(strain));
        let ridge = (splat(LEAST_RIDGE) + noise).min(splat(RIDGE));
        let (terms, left, is_solved) = self.ridged(ridge);
        (terms, left, ridge, is_found.and(is_solved))
    }

    /// Distrust of a fit that leaves this part of the squares over, from 0 to 1.
    #[inline(always)]
    pub fn trouble(&self, part: DoubleLanes<S>) -> DoubleLanes<S> {
        let splat = |x| DoubleLanes::splat(self.simd, x);
        let left = part * self.squares;
        let is_more = (splat(ROUNDING * ROUNDING) * self.weights).less(left);
        // A little residual matters little beside a displacement that varies much.
        let part = (left / self.squares.max(self.variation)).sqrt();
        let t = (part - splat(TROUBLED)) / splat(USELESS - TROUBLED);
        let t = t.max(splat(0.0)).min(splat(1.0));
        is_more.select(t * t * splat(-2.0).mul_add(t, splat(3.0)), splat(0.0))
    }

    /// Response of a fit with this ridge to the slope e in a direction: x = (A + λ W)⁻¹ e, and x·e; and a
    /// mask of the samples for which both could be found. Data r at the neighbours make a slope of Σ w r
    /// x·t(d), t(d) the terms there. λ W x·e is the part of a slope that is left to the prior.
    #[inline(always)]
    pub fn response(
        &self,
        direction: Triple<S>,
        ridge: DoubleLanes<S>,
    ) -> ([DoubleLanes<S>; TERMS], DoubleLanes<S>, DoubleMask<S>) {
        let zero = DoubleLanes::splat(self.simd, 0.0);
        let (factor, is_found) = DenseFactor::factorize(self.simd, &self.matrix, ridge * self.weights);
        let mut right = [[zero; 1]; TERMS];
        for axis in 0..3 {
            right[axis][0] = direction[axis];
        }
        let response = factor.solve(right).map(|[x]| x);
        let mut along = zero;
        for axis in 0..3 {
            along = direction[axis].mul_add(response[axis], along);
        }
        (response, along, is_found)
    }

    /// Weighted squares that terms may have, where the map has this strain.
    #[inline(always)]
    pub fn signal(&self, strain: DoubleLanes<S>) -> DoubleLanes<S> {
        let extent = strain / self.scale;
        self.weights.mul_add(extent * extent, self.squares)
    }

    /// The part of the neighbours that nine terms leave free.
    #[inline(always)]
    fn free(&self) -> DoubleLanes<S> {
        let splat = |x| DoubleLanes::splat(self.simd, x);
        let used = self.squared_weights / (self.weights * self.weights);
        splat(TERMS as f64).negate_mul_add(used, splat(1.0)).max(splat(0.0))
    }
}

/// Weighted sums of products of two, three and four coordinates: xx, xy, xz, yy, yz, zz; xxx, xxy, xxz, xyy,
/// xyz, xzz, yyy, yyz, yzz, zzz; and so on.
struct ProductSums<S: Simd> {
    second: [DoubleLanes<S>; 6],
    third: [DoubleLanes<S>; 10],
    fourth: [DoubleLanes<S>; 15],
}

/// The place of each third moment: of a product of two, and a coordinate.
const THIRD: [[usize; 3]; 6] = [[0, 1, 2], [1, 3, 4], [2, 4, 5], [3, 6, 7], [4, 7, 8], [5, 8, 9]];

/// The place of each fourth moment: of two products of two.
const FOURTH: [[usize; 6]; 6] = [
    [0, 1, 2, 3, 4, 5],
    [1, 3, 4, 6, 7, 8],
    [2, 4, 5, 7, 8, 9],
    [3, 6, 7, 10, 11, 12],
    [4, 7, 8, 11, 12, 13],
    [5, 8, 9, 12, 13, 14],
];

/// Two factors for each third and fourth moment.
const OF_THIRD: [[usize; 2]; 10] =
    [[0, 0], [0, 1], [0, 2], [3, 0], [4, 0], [5, 0], [3, 1], [3, 2], [5, 1], [5, 2]];
const OF_FOURTH: [[usize; 2]; 15] = [
    [0, 0],
    [0, 1],
    [0, 2],
    [0, 3],
    [0, 4],
    [0, 5],
    [1, 3],
    [1, 4],
    [1, 5],
    [2, 5],
    [3, 3],
    [3, 4],
    [3, 5],
    [4, 5],
    [5, 5],
];

impl<S: Simd> ProductSums<S> {
    /// Adds a term's products at a place, of which the products of two coordinates are `second`; returns
    /// these, weighted.
    #[inline(always)]
    fn include(
        &mut self,
        w: DoubleLanes<S>,
        x: Triple<S>,
        second: [DoubleLanes<S>; 6],
    ) -> [DoubleLanes<S>; 6] {
        let mut weighted = second;
        for a in 0..6 {
            weighted[a] = w * second[a];
            self.second[a] += weighted[a];
        }
        for (to, [a, b]) in self.third.iter_mut().zip(OF_THIRD) {
            *to = weighted[a].mul_add(x[b], *to);
        }
        for (to, [a, b]) in self.fourth.iter_mut().zip(OF_FOURTH) {
            *to = weighted[a].mul_add(second[b], *to);
        }
        weighted
    }

    /// The lower triangle of the products of terms.
    #[inline(always)]
    fn products(&self, zero: DoubleLanes<S>) -> [[DoubleLanes<S>; TERMS]; TERMS] {
        let mut matrix = [[zero; TERMS]; TERMS];
        for (second, [a, b]) in self.second.iter().zip(FACTORS) {
            matrix[b][a] = *second;
        }
        for a in 0..6 {
            for b in 0..3 {
                matrix[3 + a][b] = self.third[THIRD[a][b]];
            }
            for b in 0..=a {
                matrix[3 + a][3 + b] = self.fourth[FOURTH[a][b]];
            }
        }
        matrix
    }
}

/// Cholesky's decomposition of symmetric positive definite matrices.
struct DenseFactor<S: Simd> {
    /// The lower triangle, with one over the diagonal's numbers in their place.
    rows: [[DoubleLanes<S>; TERMS]; TERMS],
}

impl<S: Simd> DenseFactor<S> {
    /// Factors of matrices, of which the lower triangle is given, with `ridge` added along the diagonal; and
    /// a mask of those that are positive definite.
    #[inline(always)]
    fn factorize(
        simd: S,
        matrix: &[[DoubleLanes<S>; TERMS]; TERMS],
        ridge: DoubleLanes<S>,
    ) -> (Self, DoubleMask<S>) {
        let (zero, one) = (DoubleLanes::splat(simd, 0.0), DoubleLanes::splat(simd, 1.0));
        let most = DoubleLanes::splat(simd, f64::MAX);
        let (mut rows, mut is_definite) = (*matrix, zero.less(one));
        for j in 0..TERMS {
            for i in j..TERMS {
                let mut sum = if i == j { rows[i][j] + ridge } else { rows[i][j] };
                for k in 0..j {
                    sum = rows[i][k].negate_mul_add(rows[j][k], sum);
                }
                rows[i][j] = sum;
            }
            let pivot = rows[j][j];
            // A pivot that is no number is not positive either.
            let is_positive = zero.less(pivot).and(pivot.less(most));
            is_definite = is_definite.and(is_positive);
            let inverse = one / is_positive.select(pivot, one).sqrt();
            rows[j][j] = inverse;
            for i in j + 1..TERMS {
                rows[i][j] = rows[i][j] * inverse;
            }
        }
        (Self { rows }, is_definite)
    }

    /// Solves for right sides.
    #[inline(always)]
    fn solve<const N: usize>(&self, mut right: [[DoubleLanes<S>; N]; TERMS]) -> [[DoubleLanes<S>; N]; TERMS] {
        for i in 0..TERMS {
            for n in 0..N {
                let mut sum = right[i][n];
                for k in 0..i {
                    sum = self.rows[i][k].negate_mul_add(right[k][n], sum);
                }
                right[i][n] = sum * self.rows[i][i];
            }
        }
        for i in (0..TERMS).rev() {
            for n in 0..N {
                let mut sum = right[i][n];
                for k in i + 1..TERMS {
                    sum = self.rows[k][i].negate_mul_add(right[k][n], sum);
                }
                right[i][n] = sum * self.rows[i][i];
            }
        }
        right
    }
}
