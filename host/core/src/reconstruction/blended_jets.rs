//! Transfer by a partition of unity of local Taylor expansions ("jets").
//!
//! Around each sample the deformation is expanded to second order in all three directions, by least squares
//! over the sample's neighbours at rest and deformed. A vertex goes where the [`blend`](super::blend) of the
//! expansions around it takes it. The first-order case is the form of embedded deformation (R. Sumner, J.
//! Schmid, M. Pauly, *Embedded Deformation for Shape Manipulation*, 2007).
//!
//! The fit is of the residual of the affine maps of [`gradients`](super::gradients), with a small ridge
//! towards zero: where the neighbours do not tell, as across a flat neighbourhood, those maps stand. They
//! reproduce similarities exactly, and so do the expansions.

use std::ops::Range;

use glam::{Mat3, Vec3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::long_list::LongList;

use super::expansion::Expansion;
use super::gradients::Gradients;
use super::least_squares::{LeastSquares, TERMS};
use super::packets::{MOST_NEIGHBOURS, Neighbours};
use super::stencils::Stencils;
use crate::double_lanes::{DoubleLanes, MOST_LANES};
use crate::geometry::hermite;
use crate::sampling::SampleSet;

/// Samples that are blended at a vertex which no support reaches.
pub const BLENDED: usize = 6;

/// Neighbours in a fit: three times its terms.
pub(super) const FIT_NEIGHBOURS: usize = MOST_NEIGHBOURS;

/// Samples that are fitted by one job.
pub(super) const TOGETHER: usize = 64;

/// Ridge for each unit of a fit's residual, both relative to the data's square: the residual counts as noise
/// of the data, and the ridge shows what the fit explains by terms that the noise leaves undetermined (as
/// Wiener's filter would).
const NOISE: f64 = 0.3;

/// Largest residual of a fit to a smooth map, as a part of the data's square.
const SMOOTH: f64 = 0.01;

/// The power of the ratio of costs by which an expansion is preferred to another.
const CHOICE: i32 = 8;

/// Rings of troubled samples, of about three spacings each, through which the gradient around them is handed
/// on.
const ROUNDS: usize = 3;

/// Least cost of an expansion, due to rounding: the root of about 1e-7, for each neighbour.
const LEAST_COST: f32 = 1e-2;

/// A map around a sample.
#[derive(Debug, Clone, Copy)]
struct Jet {
    /// Gradient of the deformation.
    slope: Mat3,
    /// The second-order terms xx, xy, xz, yy, yz, zz.
    second: [Vec3; 6],
}

impl Jet {
    /// The jet of an expansion.
    fn from_expansion(expansion: &Expansion) -> Self {
        Self { slope: expansion.slope() + Mat3::IDENTITY, second: expansion.second() }
    }

    /// The image of a point at `d` from the sample, relative to the sample's image, and the gradient there.
    fn evaluate(&self, d: Vec3) -> (Vec3, Mat3) {
        let [xx, xy, xz, yy, yz, zz] = self.second;
        let half = Mat3::from_cols(xx * d.x + xy * d.y + xz * d.z, yy * d.y + yz * d.z, zz * d.z);
        let other = Mat3::from_cols(xx * d.x, xy * d.x + yy * d.y, xz * d.x + yz * d.y + zz * d.z);
        ((self.slope + half) * d, self.slope + half + other)
    }
}

/// Expansions of all samples, and the trouble of those whose neighbours disagree with them.
pub struct Expanded {
    /// The expansion at each sample.
    pub expansions: LongList<Expansion>,
    /// The troubled samples, ascending.
    pub troubled: Vec<(u32, TroubledSample)>,
}

/// Measure of trouble at a sample beside a step, a crease, or noise, and the gradient that prevails there.
#[derive(Debug, Clone, Copy)]
pub struct TroubledSample {
    /// Distrust of the sample's expansion, from 0 to 1: fully believed, or not at all.
    pub amount: f32,
    /// Gradient of the displacement that prevails around the sample.
    pub prevailing: Mat3,
}

/// Expands the deformation at all samples.
pub fn expand(
    samples: &SampleSet,
    stencils: &Stencils<'_>,
    deformed: &[Vec3],
    gradients: &Gradients,
) -> Expanded {
    let fitted = FitInput { samples, stencils, deformed, gradient: &gradients.gradient };
    let affine = |i: usize| {
        let (q, slope) = (samples.positions[i], gradients.gradient[i] - Mat3::IDENTITY);
        Expansion::new(q, deformed[i] - q, slope, [Vec3::ZERO; 6])
    };
    // The system's own zeros: the threads that fit touch them first.
    let storage = samples.storage();
    let mut expansions = LongList::<Expansion>::zeros(samples.len(), storage);
    let mut trouble = vec![0.0; samples.len()];
    let jobs = expansions.par_chunks_mut(TOGETHER).zip(trouble.par_chunks_mut(TOGETHER));
    jobs.enumerate().for_each(|(chunk, (expansions, trouble))| {
        let first = chunk * TOGETHER;
        storage.gone_through(size_of_val(expansions) + stencils.bytes_of(expansions.len()));
        expansions.iter_mut().zip(first..).for_each(|(e, i)| *e = affine(i));
        Arch::new().dispatch(ExpansionFits { fitted, first, expansions, trouble });
    });
    let in_trouble: Vec<u32> =
        (0..).zip(&trouble).filter(|(_, trouble)| **trouble > 0.0).map(|(i, _)| i).collect();
    let prevailing = prevailing(samples, stencils, &expansions, &trouble, &in_trouble);
    let mended: Vec<(u32, Jet, TroubledSample)> = in_trouble
        .par_iter()
        .zip(prevailing)
        .map(|(i, slope)| {
            let amount = trouble[*i as usize];
            let one_sided = one_sided(samples, stencils, deformed, &expansions, *i as usize);
            let mixed = Jet::from_expansion(&expansions[*i as usize]).mixed(&one_sided, amount);
            (*i, mixed, TroubledSample { amount, prevailing: slope - Mat3::IDENTITY })
        })
        .collect();
    for (i, jet, _) in &mended {
        let expansion = &mut expansions[*i as usize];
        *expansion = expansion.with_slope(jet.slope - Mat3::IDENTITY).with_second(jet.second);
    }
    let troubled = mended.into_iter().map(|(i, _, trouble)| (i, trouble)).collect();
    Expanded { expansions, troubled }
}

/// Gradient around each troubled sample: that of its neighbours which are not troubled, or in their turn of
/// theirs.
fn prevailing(
    samples: &SampleSet,
    stencils: &Stencils<'_>,
    expansions: &[Expansion],
    trouble: &[f32],
    in_trouble: &[u32],
) -> Vec<Mat3> {
    if in_trouble.is_empty() {
        return Vec::new();
    }
    // Gradient at each sample, as far as it is known, and a measure of how well: from 0 to 1.
    let mut known: Vec<(Mat3, f32)> = expansions
        .iter()
        .zip(trouble)
        .map(|(e, trouble)| (e.slope() + Mat3::IDENTITY, (1.0 - trouble).powi(2)))
        .collect();
    let mut slopes = Vec::new();
    for _ in 0..ROUNDS {
        slopes = in_trouble
            .par_iter()
            .map(|i| {
                let i = *i as usize;
                let (near, _) = stencils.around(&samples.positions, i, FIT_NEIGHBOURS);
                let (mut slope, mut sum) = (known[i].0 * known[i].1, known[i].1);
                for j in near.iter().map(|j| *j as usize) {
                    let w = known[j].1;
                    slope += known[j].0 * w;
                    sum += w;
                }
                if sum > 0.0 {
                    (slope * (1.0 / sum), sum.min(1.0))
                } else {
                    (expansions[i].slope() + Mat3::IDENTITY, 0.0)
                }
            })
            .collect::<Vec<_>>();
        in_trouble.iter().zip(&slopes).for_each(|(i, slope)| known[*i as usize] = *slope);
    }
    slopes.into_iter().map(|(slope, _)| slope).collect()
}

/// The expansion at a sample whose neighbours do not agree, as beside a step: of those of the neighbours,
/// moved to the sample, the ones that explain the neighbours best.
///
/// The choice is that of the smoothest stencil in essentially non-oscillatory schemes (ENO; with weights as
/// in X.-D. Liu, S. Osher, T. Chan, *Weighted Essentially Non-oscillatory Schemes*, 1994). Best is the least
/// sum of square roots of distances: a few neighbours that are far off matter little.
fn one_sided(
    samples: &SampleSet,
    stencils: &Stencils<'_>,
    deformed: &[Vec3],
    expansions: &[Expansion],
    i: usize,
) -> Jet {
    let (near, radius) = stencils.around(&samples.positions, i, FIT_NEIGHBOURS);
    let positions = &samples.positions;
    let neighbours: Vec<(Vec3, Vec3, f32)> = near
        .iter()
        .map(|j| {
            let j = *j as usize;
            let d = positions[j] - positions[i];
            (d, deformed[j] - deformed[i], hermite(d.length() / radius))
        })
        .collect();
    let cost = |jet: &Jet| {
        let costs = neighbours.iter().map(|(d, image, w)| w * (jet.evaluate(*d).0 - image).length().sqrt());
        costs.sum::<f32>() + LEAST_COST
    };
    let others = near.iter().map(|j| {
        let jet = Jet::from_expansion(&expansions[*j as usize]);
        Jet { slope: jet.evaluate(positions[i] - positions[*j as usize]).1, ..jet }
    });
    let own = Jet::from_expansion(&expansions[i]);
    let own = [own, Jet { second: [Vec3::ZERO; 6], ..own }];
    let candidates: Vec<(Jet, f32)> = others.chain(own).map(|jet| (jet, cost(&jet))).collect();

    let least = candidates.iter().map(|(_, cost)| *cost).fold(f32::INFINITY, f32::min);
    let mut chosen = Jet { slope: Mat3::ZERO, second: [Vec3::ZERO; 6] };
    let mut sum = 0.0;
    for (jet, cost) in &candidates {
        let w = (least / cost).powi(CHOICE);
        chosen.slope += jet.slope * w;
        chosen.second.iter_mut().zip(jet.second).for_each(|(total, h)| *total += h * w);
        sum += w;
    }
    chosen.slope *= 1.0 / sum;
    chosen.second.iter_mut().for_each(|h| *h /= sum);
    chosen
}

impl Jet {
    fn mixed(&self, other: &Self, t: f32) -> Self {
        let slope = self.slope * (1.0 - t) + other.slope * t;
        let second = std::array::from_fn(|a| self.second[a].lerp(other.second[a], t));
        Self { slope, second }
    }
}

/// Inputs of a fit: samples, their stencils and deformed positions, and the affine map's gradient at each,
/// beyond which the fit goes.
#[derive(Clone, Copy)]
pub(super) struct FitInput<'a> {
    pub samples: &'a SampleSet,
    pub stencils: &'a Stencils<'a>,
    pub deformed: &'a [Vec3],
    pub gradient: &'a [Mat3],
}

impl FitInput<'_> {
    /// Gathers the `count` nearest neighbours of a packet's samples; returns the gradients of the samples,
    /// column by column.
    #[inline(always)]
    pub fn gather<S: Simd>(
        &self,
        neighbours: &mut Neighbours,
        packet: &[usize; MOST_LANES],
        count: usize,
    ) -> [[f64; MOST_LANES]; 9] {
        let around = |i: usize| self.stencils.around(&self.samples.positions, i, count);
        neighbours.gather::<S>(&self.samples.positions, self.deformed, packet, around);
        let mut gradient = [[0.0; MOST_LANES]; 9];
        for lane in 0..S::F64_LANES {
            let columns = self.gradient[packet[lane]].to_cols_array();
            for i in 0..9 {
                gradient[i][lane] = f64::from(columns[i]);
            }
        }
        gradient
    }
}

/// Samples of a packet: `count` ones from `first` on; further lanes are filled with the first one.
#[inline(always)]
pub(super) fn packet_of(first: usize, count: usize) -> [usize; MOST_LANES] {
    std::array::from_fn(|lane| if lane < count { first + lane } else { first })
}

/// Fits samples that follow each other from the first: the affine map is left where nothing more is to be
/// explained, or cannot be.
struct ExpansionFits<'a> {
    fitted: FitInput<'a>,
    first: usize,
    expansions: &'a mut [Expansion],
    /// Distrust of each fit's expansion, from 0 to 1.
    trouble: &'a mut [f32],
}

impl WithSimd for ExpansionFits<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let mut neighbours = Neighbours::default();
        for at in (0..self.expansions.len()).step_by(S::F64_LANES) {
            let count = S::F64_LANES.min(self.expansions.len() - at);
            let packet = packet_of(self.first + at, count);
            let gradient = self.fitted.gather::<S>(&mut neighbours, &packet, FIT_NEIGHBOURS);
            self.fit(simd, &neighbours, &gradient, at..at + count);
        }
    }
}

impl ExpansionFits<'_> {
    /// Fits the samples of a packet.
    #[inline(always)]
    fn fit<S: Simd>(
        &mut self,
        simd: S,
        neighbours: &Neighbours,
        gradient: &[[f64; MOST_LANES]; 9],
        places: Range<usize>,
    ) {
        let squares = LeastSquares::accumulate(simd, neighbours, gradient);
        let is_needed = squares.is_needed();
        if !is_needed.any() {
            return;
        }
        let splat = |x| DoubleLanes::splat(simd, x);
        let (terms, left, ridge, is_solved) = squares.solve(strain(simd, gradient));
        // A fit is not relied on for what it explains by terms that noise of this size leaves undetermined.
        let (mut relied_on, mut is_solved) = (left, is_solved);
        let is_noisy = splat(SMOOTH).less(left);
        if is_noisy.any() {
            let noise = splat(NOISE) * (left - splat(SMOOTH)).max(splat(0.0));
            let (_, ridged, is_found) = squares.ridged(ridge + noise);
            relied_on = is_noisy.select(ridged, left);
            is_solved = is_solved.and(is_found);
        }
        let trouble = squares.trouble(relied_on).store();
        let is_fitted = is_needed.and(is_solved).store();
        let mut stored = [[[0.0; MOST_LANES]; 3]; TERMS];
        for a in 0..TERMS {
            for axis in 0..3 {
                let scaled = terms[a][axis] * squares.scale;
                stored[a][axis] = if a < 3 { scaled } else { scaled * squares.scale }.store();
            }
        }
        for (lane, place) in places.enumerate().filter(|(lane, _)| is_fitted[*lane]) {
            let term = |a: usize| Vec3::from_array(stored[a].map(|numbers| numbers[lane] as f32));
            let slope = self.fitted.gradient[self.first + place] + Mat3::from_cols(term(0), term(1), term(2));
            let second = [3, 4, 5, 6, 7, 8].map(term);
            if slope.is_finite() && second.iter().all(|h| h.is_finite()) {
                let expansion = &mut self.expansions[place];
                *expansion = expansion.with_slope(slope - Mat3::IDENTITY).with_second(second);
                self.trouble[place] = trouble[lane] as f32;
            }
        }
    }
}

/// Size of Green's strain of gradients, given column by column: their distance from rotations.
#[inline(always)]
pub(super) fn strain<S: Simd>(simd: S, gradient: &[[f64; MOST_LANES]; 9]) -> DoubleLanes<S> {
    let splat = |x| DoubleLanes::splat(simd, x);
    let mut sum = splat(0.0);
    for a in 0..3 {
        for b in 0..3 {
            let mut product = splat(if a == b { -1.0 } else { 0.0 });
            for axis in 0..3 {
                let factor = DoubleLanes::load(simd, &gradient[3 * a + axis]);
                product = factor.mul_add(DoubleLanes::load(simd, &gradient[3 * b + axis]), product);
            }
            sum = product.mul_add(product, sum);
        }
    }
    splat(0.5) * sum.sqrt()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::reconstruction::RestGeometry;

    /// A rolling patch, and a deformation of it with a step.
    pub fn stepped_patch() -> (SampleSet, Vec<Vec3>) {
        let jitter = |i: u32, k: u32| ((i * 7919 + k * 104_729) % 1000) as f32 / 1500.0;
        let place = |i: u32| {
            let (x, y) = ((i % 31) as f32 + jitter(i, 1), (i / 31) as f32 + jitter(i, 2));
            Vec3::new(x / 31.0, 0.1 * (x / 5.0).sin(), y / 31.0)
        };
        let samples = SampleSet::new((0..961).map(place).collect(), Vec::new()).expect("samples");
        let moved = |p: &Vec3| *p + Vec3::new(0.0, 0.2 * p.x * p.z, if p.z > 0.5 { 0.3 } else { p.x * p.x });
        let deformed = samples.positions.iter().map(moved).collect();
        (samples, deformed)
    }

    #[test]
    fn expansions_have_the_same_bits_with_any_vectors() {
        let (samples, deformed) = stepped_patch();
        let around = RestGeometry::new(&samples);
        let (gradients, stencils) = Gradients::fit(&samples, &around.sheets, &deformed);
        let fitted = FitInput {
            samples: &samples,
            stencils: &stencils,
            deformed: &deformed,
            gradient: &gradients.gradient,
        };
        let fit = |by: &dyn Fn(ExpansionFits<'_>)| {
            let affine =
                |(p, g): (&Vec3, &Mat3)| Expansion::new(*p, Vec3::ZERO, *g - Mat3::IDENTITY, [Vec3::ZERO; 6]);
            let mut expansions: Vec<Expansion> =
                samples.positions.iter().zip(&gradients.gradient[..]).map(affine).collect();
            let mut trouble = vec![0.0; 961];
            by(ExpansionFits { fitted, first: 0, expansions: &mut expansions, trouble: &mut trouble });
            let numbers = |(e, trouble): (&Expansion, &f32)| {
                (e.rows().map(|row| row.map(f32::to_bits)), trouble.to_bits())
            };
            expansions.iter().zip(&trouble).map(numbers).collect::<Vec<_>>()
        };
        let one_by_one = fit(&|fits| fits.with_simd(pulp::Scalar::new()));
        assert!(fit(&|fits| Arch::new().dispatch(fits)) == one_by_one);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert!(fit(&|fits| Simd::vectorize(simd, fits)) == one_by_one);
        }
        let in_trouble = one_by_one.iter().filter(|(_, trouble)| f32::from_bits(*trouble) > 0.5).count();
        assert!((10..500).contains(&in_trouble), "{in_trouble}");
    }
}
