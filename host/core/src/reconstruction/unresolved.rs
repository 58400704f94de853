//! How far expansions are off where their neighbours tell little of the gradient across the surface, or
//! nothing: all samples guess it alike there, and so do not disagree.
//!
//! With x = (A + λ W)⁻¹ e, e across and A of the fit's squares, an expansion whose gradient across is off by
//! δ is off by δ x·t(d) / x·e at d from the sample, t(d) the terms of the fit; nothing at the neighbours
//! themselves. δ has two parts. What the fit leaves to the prior, λ W x·e of it, is off by as much as the map
//! strains and bends. And the third order, which the fit leaves out, is taken for a gradient as far as little
//! relief makes them look alike: Σ w x·t(d) c(d) of the cubic terms c (the alias of G. E. P. Box, K. B.
//! Wilson, *On the Experimental Attainment of Optimum Conditions*, 1951). How much the second order differs
//! at a neighbour tells these, c(d) = (Qₖ − Q)(d, d) / 3.

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::blended_jets::{FIT_NEIGHBOURS, FitInput, TOGETHER, packet_of, strain};
use super::expansion::Expansion;
use super::expectation::hypot;
use super::least_squares::{LeastSquares, TERMS};
use super::packets::{Neighbours, triple};
use crate::double_lanes::{DoubleLanes, MOST_LANES, square};
use crate::geometry::hermite;

/// The part of the strain by which the gradient across a surface is expected to differ from its prior.
const STRAINED: f64 = 0.4;

/// So much of what the third order makes of the gradient counts, as second order tells it somewhat damped.
const OF_THIRD: f32 = 1.1;

/// Where the third order makes little of a sample's gradient by chance, its ring tells: no less than the
/// sample's own counts, and no more than so many times that.
const OF_OWN: f32 = 2.0;

/// How far an expansion is off around its sample, by its terms along each of a fit's: local units.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unresolved([f32; TERMS]);

impl Unresolved {
    /// The length of what is left at `d` from the sample.
    pub fn length(&self, d: Vec3) -> f32 {
        self.at(d).abs()
    }

    fn at(&self, d: Vec3) -> f32 {
        let Vec3 { x, y, z } = d;
        let [a, b, c, xx, xy, xz, yy, yz, zz] = self.0;
        (a + xx * x + xy * y + xz * z) * x + (b + yy * y + yz * z) * y + (c + zz * z) * z
    }
}

/// What is unresolved at each sample, of which these are the expansions.
///
/// Memory: 36 bytes per sample, and 52 more meanwhile.
pub fn find(fitted: FitInput<'_>, expansions: &[Expansion]) -> Vec<Unresolved> {
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
        let off = hypot([OF_THIRD * around.min(OF_OWN * third[i]).max(third[i]), across.prior]);
        Unresolved(across.response.0.map(|term| term * off))
    };
    across.par_iter().enumerate().map(unresolved).collect()
}

/// How the fit at a sample hears of the gradient across the surface.
#[derive(Debug, Clone, Copy, Default)]
struct Across {
    /// x·t(d) / x·e, for each unit by which the gradient is off.
    response: Unresolved,
    /// x·e, over the square of the radius.
    weight: f32,
    /// How far the gradient is off by the prior.
    prior: f32,
    /// The most by which the third order makes it off: by how much the map strains, and by what there is to
    /// explain.
    most: f32,
}

impl Across {
    /// How far the gradient is off by the third order, at sample `i`.
    fn of_third_order(&self, fitted: FitInput<'_>, expansions: &[Expansion], i: usize) -> f32 {
        let positions = &fitted.samples.positions;
        let (near, radius) = fitted.stencils.around(positions, i, FIT_NEIGHBOURS);
        let own = expansions[i].second();
        let alias = |j: &u32| {
            let (d, second) = (positions[*j as usize] - positions[i], expansions[*j as usize].second());
            let difference = std::array::from_fn(|term| second[term] - own[term]);
            hermite(d.length() / radius) * self.response.at(d) * squared(difference, d) / 3.0
        };
        let sum: Vec3 = near.iter().map(alias).sum();
        (self.weight * sum.length()).min(self.most)
    }
}

/// Q(d, d), of the terms xx, xy, xz, yy, yz, zz.
fn squared([xx, xy, xz, yy, yz, zz]: [Vec3; 6], d: Vec3) -> Vec3 {
    (xx * d.x + xy * d.y + xz * d.z) * d.x + (yy * d.y + yz * d.z) * d.y + zz * d.z * d.z
}

/// Finds that of samples that follow each other from the first; nothing where nothing is fitted.
struct AcrossFits<'a> {
    fitted: FitInput<'a>,
    first: usize,
    across: &'a mut [Across],
}

impl WithSimd for AcrossFits<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let mut neighbours = Neighbours::default();
        for (at, across) in self.across.chunks_mut(S::F64_LANES).enumerate() {
            let packet = packet_of(self.first + at * S::F64_LANES, across.len());
            let gradient = self.fitted.gather::<S>(&mut neighbours, &packet);
            let normals = self.fitted.samples.normals();
            let mut normal = [[0.0; MOST_LANES]; 3];
            for lane in 0..S::F64_LANES {
                for axis in 0..3 {
                    normal[axis][lane] = f64::from(normals[packet[lane]][axis]);
                }
            }
            fit(simd, &neighbours, &gradient, &normal, across);
        }
    }
}

/// Fits the samples of a packet.
#[inline(always)]
fn fit<S: Simd>(
    simd: S,
    neighbours: &Neighbours,
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
    let (response, along, is_found) = squares.response(triple(simd, normal), ridge);
    // How much the gradient differs at the radius: of a square it is twice the term, of a product each of two
    // coordinates has it.
    let mut bent = splat(0.0);
    for (term, times) in terms[3..].iter().zip([4.0, 2.0, 2.0, 4.0, 2.0, 4.0]) {
        bent = splat(times).mul_add(square(*term), bent);
    }
    let (strained, scale) = (splat(STRAINED) * strain, squares.scale);
    let off = strained.mul_add(strained, bent * scale * scale).sqrt();
    let prior = (ridge * squares.weights * along * off).store();
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
            let [weight, prior, most] = [weight, prior, most].map(|x| x[lane] as f32);
            *across = Across { response: Unresolved(response), weight, prior, most };
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
            let numbers = |a: &Across| (a.response.0, [a.weight, a.prior, a.most]);
            let bits = |(response, others): ([f32; 9], [f32; 3])| {
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
