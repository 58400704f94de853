//! Error of expansions where their neighbours tell little of the gradient across the surface, or nothing: all
//! samples guess it alike there, and so do not disagree.
//!
//! With x = (A + λ W)⁻¹ e, where e is the slope across and A the matrix of the fit's squares, an expansion
//! whose gradient across has the error δ has the error δ x·t(d) / x·e at d from the sample, t(d) being the
//! terms of the fit; at the neighbours themselves it has none. δ has two parts. The part of the gradient that
//! the fit leaves to the prior, λ W x·e, has an error as large as the map's strain and bending. And terms
//! that the fit leaves out are taken for a gradient as far as little relief makes the two look alike (the
//! alias of G. E. P. Box, K. B. Wilson, *On the Experimental Attainment of Optimum Conditions*, 1951). For
//! the third order that is Σ w x·t(d) c(d), where the difference of the second order at a neighbour tells the
//! cubic terms, c(d) = (Qₖ − Q)(d, d) / 3. For all orders, and chance, a fit to fewer neighbours tells it, as
//! that takes less of these terms for a gradient: two orders of one method tell its error, as in an embedded
//! pair of Runge and Kutta. Either estimate is too large where the other fit hardly tells a gradient, or
//! second orders are wrong; then samples agree better on the gradient than the estimates say. Where
//! neighbours are wrong together, the disagreement is too little.
//!
//! Over a dozen spacings the error shows: expansions of fourth order there tell δ itself, as far as they can
//! be fitted and agree with each other ([`told_across`]). The rest is as above.

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::across::told_across;
use super::blended_jets::{FIT_NEIGHBOURS, FitInput, TOGETHER, packet_of, strain};
use super::expansion::Expansion;
use super::expectation::hypot;
use super::least_squares::{LeastSquares, TERMS};
use super::packets::{Neighbours, triple};
use crate::double_lanes::{DoubleLanes, MOST_LANES, square};
use crate::geometry::hermite;

/// The part of the strain by which the gradient across a surface is expected to differ from its prior.
const STRAINED: f64 = 0.4;

/// Part of the gradient's error due to the third order that counts.
const OF_THIRD: f32 = 0.8;

/// Bound of the third order's part, as a multiple of the sample's own. Where the third order makes little of
/// a sample's gradient by chance, its ring tells: no less than the sample's own counts.
const OF_OWN: f32 = 2.0;

/// Number of neighbours of the smaller fit, and the factor of its gradient's distance from that of the whole
/// fit. The error of a gradient goes with the square of the radius, as the number of neighbours does: a fit
/// to so many has two thirds of it ...
const FEWER_NEIGHBOURS: usize = 18;
const OF_FEWER: f32 = 1.5;

/// ... and the most that both count together with the third order, as a multiple of the disagreement of the
/// sample and its ring on the gradient across.
const OF_DISAGREED: f32 = 2.5;

/// Error of an expansion around its sample, as the coefficients of a fit's terms: local units.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unresolved([f32; TERMS]);

impl Unresolved {
    /// Length of the error at `d` from the sample.
    pub fn length(&self, d: Vec3) -> f32 {
        self.signed_length(d).abs()
    }

    /// Coefficient of a term, in the order of a fit's terms.
    #[inline(always)]
    pub fn term(&self, at: usize) -> f32 {
        self.0[at]
    }

    fn signed_length(&self, d: Vec3) -> f32 {
        let Vec3 { x, y, z } = d;
        let [a, b, c, xx, xy, xz, yy, yz, zz] = self.0;
        (a + xx * x + xy * y + xz * z) * x + (b + yy * y + yz * z) * y + (c + zz * z) * z
    }
}

/// Error at each sample that the neighbours leave unresolved, of which these are the expansions.
///
/// Memory: 36 bytes per sample, and some 100 more meanwhile, with 4 for each thread.
pub fn find(fitted: FitInput<'_>, expansions: &[Expansion]) -> Vec<Unresolved> {
    let told = told_across(fitted, expansions);
    let mut across = vec![Across::default(); expansions.len()];
    across.par_chunks_mut(TOGETHER).enumerate().for_each(|(chunk, across)| {
        Arch::new().dispatch(AcrossFits { fitted, first: chunk * TOGETHER, across });
    });
    let third = |i: usize| across[i].of_third_order(fitted, expansions, i);
    let third: Vec<f32> = (0..across.len()).into_par_iter().map(third).collect();
    let unresolved = |(i, across): (usize, &Across)| {
        let ring = fitted.stencils.ring(i);
        let sum = third[i].powi(2) + ring.iter().map(|j| third[*j as usize].powi(2)).sum::<f32>();
        let around = (sum / (ring.len() + 1) as f32).sqrt();
        let third = around.min(OF_OWN * third[i]).max(third[i]);
        let left_out = hypot([OF_THIRD * third, OF_FEWER * across.by_fewer]);
        let left_out = left_out.min(OF_DISAGREED * disagreement(fitted, expansions, i));
        let off = told[i].expected(hypot([left_out, across.prior]));
        Unresolved(across.response.0.map(|term| term * off))
    };
    across.par_iter().enumerate().map(unresolved).collect()
}

/// Disagreement of sample `i` and its ring on the gradient across, as the root of the mean square: the
/// difference that the second order halfway between two of them does not explain.
fn disagreement(fitted: FitInput<'_>, expansions: &[Expansion], i: usize) -> f32 {
    let (own, across) = (&expansions[i], fitted.samples.normals()[i]);
    let ring = fitted.stencils.ring(i);
    let square = |j: &u32| {
        let other = &expansions[*j as usize];
        let d = fitted.samples.positions[*j as usize] - fitted.samples.positions[i];
        let bent = product(own.second(), d, across) + product(other.second(), d, across);
        ((other.slope() - own.slope()) * across - bent).length_squared()
    };
    (ring.iter().map(square).sum::<f32>() / ring.len().max(1) as f32).sqrt()
}

/// Response of the fit at a sample to the gradient across the surface, and the errors of this gradient.
#[derive(Debug, Clone, Copy, Default)]
struct Across {
    /// x·t(d) / x·e, for each unit by which the gradient is off.
    response: Unresolved,
    /// x·e, over the square of the radius.
    weight: f32,
    /// Error of the gradient due to the prior.
    prior: f32,
    /// Difference of the gradient of a fit to fewer neighbours from that of the whole fit.
    by_fewer: f32,
    /// Most of the error due to the third order: by the map's strain, and by the data to be explained.
    most: f32,
}

impl Across {
    /// Error of the gradient due to the third order, at sample `i`.
    fn of_third_order(&self, fitted: FitInput<'_>, expansions: &[Expansion], i: usize) -> f32 {
        let positions = &fitted.samples.positions;
        let (near, radius) = fitted.stencils.around(positions, i, FIT_NEIGHBOURS);
        let own = expansions[i].second();
        let alias = |j: &u32| {
            let (d, second) = (positions[*j as usize] - positions[i], expansions[*j as usize].second());
            let difference = std::array::from_fn(|term| second[term] - own[term]);
            hermite(d.length() / radius) * self.response.signed_length(d) * product(difference, d, d) / 3.0
        };
        let sum: Vec3 = near.iter().map(alias).sum();
        (self.weight * sum.length()).min(self.most)
    }
}

/// Q(a, b), of the terms xx, xy, xz, yy, yz, zz.
fn product([xx, xy, xz, yy, yz, zz]: [Vec3; 6], a: Vec3, b: Vec3) -> Vec3 {
    let mixed = xy * (a.x * b.y + a.y * b.x) + xz * (a.x * b.z + a.z * b.x) + yz * (a.y * b.z + a.z * b.y);
    xx * (a.x * b.x) + yy * (a.y * b.y) + zz * (a.z * b.z) + 0.5 * mixed
}

/// Finds the responses of samples that follow each other from the first; zero where nothing is fitted.
struct AcrossFits<'a> {
    fitted: FitInput<'a>,
    first: usize,
    across: &'a mut [Across],
}

impl WithSimd for AcrossFits<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (mut neighbours, mut nearest) = (Neighbours::default(), Neighbours::default());
        for (at, across) in self.across.chunks_mut(S::F64_LANES).enumerate() {
            let packet = packet_of(self.first + at * S::F64_LANES, across.len());
            let gradient = self.fitted.gather::<S>(&mut neighbours, &packet, FIT_NEIGHBOURS);
            self.fitted.gather::<S>(&mut nearest, &packet, FEWER_NEIGHBOURS);
            let normals = self.fitted.samples.normals();
            let mut normal = [[0.0; MOST_LANES]; 3];
            for lane in 0..S::F64_LANES {
                for axis in 0..3 {
                    normal[axis][lane] = f64::from(normals[packet[lane]][axis]);
                }
            }
            fit(simd, [&neighbours, &nearest], &gradient, &normal, across);
        }
    }
}

/// Fits the samples of a packet to their neighbours, and to the nearest of these alone.
#[inline(always)]
fn fit<S: Simd>(
    simd: S,
    [neighbours, nearest]: [&Neighbours; 2],
    gradient: &[[f64; MOST_LANES]; 9],
    normal: &[[f64; MOST_LANES]; 3],
    across: &mut [Across],
) {
    let squares = LeastSquares::accumulate(simd, neighbours, gradient);
    let is_needed = squares.is_needed();
    if !is_needed.any() {
        return;
    }
    let splat = |x| DoubleLanes::splat(simd, x);
    let strain = strain(simd, gradient);
    let (terms, _, ridge, is_solved) = squares.solve(strain);
    let normal = triple(simd, normal);
    let (response, along, is_found) = squares.response(normal, ridge);
    // Change of the gradient at the radius: of a square it is twice the term, of a product each of two
    // coordinates has it.
    let mut bent = splat(0.0);
    for (term, times) in terms[3..].iter().zip([4.0, 2.0, 2.0, 4.0, 2.0, 4.0]) {
        bent = splat(times).mul_add(square(*term), bent);
    }
    let (strained, scale) = (splat(STRAINED) * strain, squares.scale);
    let off = strained.mul_add(strained, bent * scale * scale).sqrt();
    let prior = (ridge * squares.weights * along * off).store();
    let fewer = LeastSquares::accumulate(simd, nearest, gradient);
    let (by_fewer, _, _, is_told) = fewer.solve(strain);
    let mut apart = [splat(0.0); 3];
    for ((by_fewer, term), e) in by_fewer.iter().zip(&terms).zip(normal) {
        for (axis, apart) in apart.iter_mut().enumerate() {
            *apart = e.mul_add(by_fewer[axis] * fewer.scale - term[axis] * scale, *apart);
        }
    }
    let by_fewer = is_told.select(square(apart).sqrt(), splat(0.0)).store();
    let weight = (along * scale * scale).store();
    let most = ((squares.signal(strain) / squares.weights).sqrt() * scale).store();
    let mut stored = [[0.0; MOST_LANES]; TERMS];
    for a in 0..TERMS {
        let term = response[a] / along;
        stored[a] = if a < 3 { term } else { term * scale }.store();
    }
    let is_fitted = is_needed.and(is_solved).and(is_found).store();
    for (lane, across) in across.iter_mut().enumerate().filter(|(lane, _)| is_fitted[*lane]) {
        let response = stored.map(|term| term[lane] as f32);
        if response.iter().all(|term| term.is_finite()) {
            let [weight, prior, by_fewer, most] = [weight, prior, by_fewer, most].map(|x| x[lane] as f32);
            *across = Across { response: Unresolved(response), weight, prior, by_fewer, most };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::RestGeometry;
    use super::super::blended_jets::tests::stepped_patch;
    use super::super::gradients::Gradients;
    use super::*;

    #[test]
    fn fits_have_the_same_bits_with_any_vectors() {
        let (samples, deformed) = stepped_patch();
        let around = RestGeometry::new(&samples);
        let (gradients, stencils) = Gradients::fit(&samples, &around.sheets, &deformed);
        let fitted = FitInput {
            samples: &samples,
            stencils: &stencils,
            deformed: &deformed,
            gradient: &gradients.gradient,
        };
        let fit = |by: &dyn Fn(AcrossFits<'_>)| {
            let mut all = vec![Across::default(); samples.len()];
            by(AcrossFits { fitted, first: 0, across: &mut all });
            let numbers = |a: &Across| (a.response.0, [a.weight, a.prior, a.by_fewer, a.most]);
            let bits = |(response, others): ([f32; 9], [f32; 4])| {
                (response.map(f32::to_bits), others.map(f32::to_bits))
            };
            all.iter().map(numbers).map(bits).collect::<Vec<_>>()
        };
        let one_by_one = fit(&|fits| fits.with_simd(pulp::Scalar::new()));
        assert!(fit(&|fits| Arch::new().dispatch(fits)) == one_by_one);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert!(fit(&|fits| Simd::vectorize(simd, fits)) == one_by_one);
        }
        let told = one_by_one.iter().filter(|(_, [weight, ..])| f32::from_bits(*weight) > 0.0).count();
        assert!(told > 900, "{told}");
    }
}
