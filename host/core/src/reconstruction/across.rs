//! Gradients of the deformation by which vectors, splats and other numbers turn, fitted to wider
//! neighbourhoods than those of the expansions. Their difference from the expansions' own gradients tells the
//! error of these across the surface.
//!
//! A surface tells the change of a map of space across it by the variation of its own bending: the same
//! gradient across moves a place that bends more by more. Next to a sample that hardly shows, and the second
//! order of the map along the surface looks alike. Over a dozen spacings it shows, if the map is expanded to
//! fourth order. So at some samples, the *anchors*, such an expansion is fitted to all samples that four
//! links of the graph of neighbours lead to. The expansion goes beyond the affine map, with the ridge for
//! noise of the size of the residual (N. Wiener, *Extrapolation, Interpolation, and Smoothing of Stationary
//! Time Series*, 1949): where samples are not moved by a smooth map of space, the gradients of the samples'
//! own expansions stand.
//!
//! Memory: 4 bytes per sample and thread, some 500 per anchor and 4 for each sample at which it has a say,
//! about 250, of one anchor for about 30 samples; the result takes 144 per sample.

use glam::{DMat3, DVec3, Mat3, Vec3};
use pulp::Arch;
use rayon::prelude::*;
use simod_model::long_list::LongList;

use super::blended_jets::FitInput;
use super::expansion::{Expansion, ROUNDING};
use super::stencils::Stencils;
use crate::lists::lists;

/// Number of links of the graph of neighbours that lead to the samples an anchor is fitted to, at most.
const LINKS: usize = 4;

/// Number of links that lead to the samples at which an anchor has a say, at most.
const HEARD: usize = 3;

/// Number of links to the nearest neighbours, within which no other sample is an anchor.
const APART: usize = 2;

/// Nearest neighbours of a sample that are looked at.
const NEAREST: usize = 16;

/// Terms of a fourth-order expansion without its constant: three, six, ten and fifteen.
const TERMS: usize = 34;

/// Factors of a term, at most.
const ORDER: usize = 4;

/// The coordinates whose product each term is, ascending; 3 stands for none.
const FACTORS: [[usize; ORDER]; TERMS] = {
    let (mut factors, mut at, mut order) = ([[3; ORDER]; TERMS], 0, 1);
    while order <= ORDER {
        // All numbers of four digits of base four, of which those that ascend are terms.
        let mut number = 0;
        while number < 1 << (2 * ORDER) {
            let digits = [number >> 6 & 3, number >> 4 & 3, number >> 2 & 3, number & 3];
            let (mut count, mut ascends, mut i) = (0, true, 0);
            while i < ORDER {
                count += (digits[i] < 3) as usize;
                ascends &= i == 0 || digits[i - 1] <= digits[i];
                i += 1;
            }
            if ascends && count == order {
                factors[at] = digits;
                at += 1;
            }
            number += 1;
        }
        order += 1;
    }
    factors
};

/// A derivative of a term, along one axis or two: the term, where it goes (an axis, or a pair of these as in
/// [`Expansion::second`]), the term that it is a multiple of, or 34 for a constant, and that multiple.
type Derivative = (usize, usize, usize, f32);

/// Number of derivatives along one axis, and of those along two.
const DERIVATIVES: usize = 60;

/// Place of the term for each pair of axes in a list of second-order terms.
const PAIRS: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// The derivatives along each axis.
const FIRST: [Derivative; DERIVATIVES] = derivatives(false);

/// Derivatives along each pair of axes, halved for an axis with itself: second-order terms of the expansion
/// elsewhere.
const SECOND: [Derivative; DERIVATIVES] = derivatives(true);

const fn derivatives(of_second_order: bool) -> [Derivative; DERIVATIVES] {
    let (mut all, mut count, mut term) = ([(0, 0, 0, 0.0); DERIVATIVES], 0, 0);
    while term < TERMS {
        // Without each factor that is an axis, or each pair of these; equal ones add up.
        let mut one = 0;
        while one < ORDER {
            let mut other = if of_second_order { one + 1 } else { ORDER };
            loop {
                let factors = FACTORS[term];
                let is_axis = factors[one] < 3 && (other >= ORDER || factors[other] < 3);
                if is_axis && (!of_second_order || other < ORDER) {
                    let to = if of_second_order { PAIRS[factors[one]][factors[other]] } else { factors[one] };
                    let mut at = 0;
                    while at < count && !(all[at].0 == term && all[at].1 == to) {
                        at += 1;
                    }
                    if at == count {
                        all[at] = (term, to, without(factors, one, other), 0.0);
                        count += 1;
                    }
                    all[at].3 += 1.0;
                }
                other += 1;
                if other >= ORDER {
                    break;
                }
            }
            one += 1;
        }
        term += 1;
    }
    assert!(count == DERIVATIVES);
    all
}

/// The term of the factors that are left without one and, if it is one, another.
const fn without(factors: [usize; ORDER], one: usize, other: usize) -> usize {
    let (mut left, mut count, mut at) = ([3; ORDER], 0, 0);
    while at < ORDER {
        if at != one && at != other {
            left[count] = factors[at];
            count += 1;
        }
        at += 1;
    }
    let mut term = 0;
    while term < TERMS {
        let [a, b, c, d] = FACTORS[term];
        if a == left[0] && b == left[1] && c == left[2] && d == left[3] {
            break;
        }
        term += 1;
    }
    term
}

/// The least ridge, for each of the weights.
const LEAST_RIDGE: f64 = 1e-14;

/// Expected square of the terms of a fit, as a multiple of the squares of the strain and of the residual of
/// the affine map, which both tell little of shear across.
const EXPECTED: f64 = 10.0;

/// Least number of degrees of freedom that a fit leaves, as a part of its data's; with less a fit tells
/// nothing.
const LEAST_FREE: f64 = 0.3;

/// A gradient that leaves less than this part of the volume, or more than its inverse, is not taken for the
/// map's.
const THINNEST: f32 = 0.1;

/// An anchor that has more than this part of the say is alone.
const ALONE: f32 = 0.9;

/// The expansion around an anchor.
struct Anchor {
    center: Vec3,
    /// One over the radius of the neighbourhood.
    scale: f32,
    /// The affine map that it goes beyond.
    affine: Mat3,
    /// The terms, in units of the radius; their images are local units.
    terms: [Vec3; TERMS],
    /// Part of the gradient across the surface that the anchor's neighbours determine, from 0 to 1.
    trust: f32,
    /// One over the square of the radius within which the anchor has a say.
    inverse_square: f32,
}

/// Expansions by whose gradients numbers turn: those of the samples, corrected by the anchors' gradients
/// across the surface and their second order. `fitted` has the affine maps.
pub fn told(fitted: FitInput<'_>, expansions: &[Expansion]) -> LongList<Expansion> {
    let anchors = Anchors::fit(fitted, expansions);
    let positions = &fitted.samples.positions;
    let told = |i: usize| {
        let e = &expansions[i];
        if e.is_still() || anchors.are_silent_at(i) {
            return *e;
        }
        let (own, own_second) = (Mat3::IDENTITY + e.slope(), e.second());
        let (mut more, mut second, mut sum) = (Mat3::ZERO, [Vec3::ZERO; 6], 0.0);
        for (anchor, products, w) in anchors.heard_at(i, positions[i]) {
            let trusted = w * anchor.trust;
            more += (anchor.gradient(&products) - own) * trusted;
            let theirs = anchor.second(&products).into_iter().zip(own_second);
            second.iter_mut().zip(theirs).for_each(|(sum, (theirs, own))| *sum += trusted * (theirs - own));
            sum += w;
        }
        let more = more * (1.0 / sum);
        if !is_plausible(own, more) {
            return *e;
        }
        let second = std::array::from_fn(|at| own_second[at] + second[at] / sum);
        e.with_slope(e.slope() + more).with_second(second)
    };
    // The system's own zeros: the threads that fill them touch them first.
    let mut all = LongList::zeros(expansions.len(), fitted.samples.storage());
    each_sample(fitted, expansions).zip(&mut all[..]).for_each(|(i, to)| *to = told(i));
    all
}

/// Gradient across the surface by the anchors, compared with that of a sample's own expansion.
#[derive(Debug, Clone, Copy, Default)]
pub struct ToldAcross {
    /// Distance of the expansion's own gradient from the anchors' mean.
    apart: f32,
    /// Root of the mean square by which the anchors differ in that distance.
    spread: f32,
    /// Part of the gradient that the anchors' neighbours determine, from 0 to 1; 0 where the anchors'
    /// gradient is not plausible.
    trust: f32,
}

impl ToldAcross {
    /// Expected error of the expansion's own gradient across the surface, where `guessed` is the one expected
    /// without the anchors. The anchors count as far as their neighbours determine the gradient, and the
    /// more, the less they differ from each other beside `guessed`.
    pub fn expected(self, guessed: f32) -> f32 {
        let [apart, spread, guessed] = [self.apart, self.spread, guessed].map(|x| x * x);
        let told = self.trust.powi(4) * guessed / (guessed + spread).max(f32::MIN_POSITIVE);
        (told * (apart + spread) + (1.0 - told) * guessed).sqrt()
    }
}

/// Gradients by the anchors compared with those of the `expansions`, along the normals of all samples.
///
/// Memory: 12 bytes per sample, and some 85 more meanwhile, with 4 for each thread.
pub fn told_across(fitted: FitInput<'_>, expansions: &[Expansion]) -> Vec<ToldAcross> {
    let anchors = Anchors::fit(fitted, expansions);
    let samples = fitted.samples;
    let told = |i: usize| {
        let e = &expansions[i];
        if e.is_still() || anchors.are_silent_at(i) {
            return ToldAcross::default();
        }
        let (own, normal) = (Mat3::IDENTITY + e.slope(), samples.normals()[i]);
        let (mut more, mut squares, mut trust, mut sum) = (Mat3::ZERO, 0.0, 0.0, 0.0);
        let mut heaviest: f32 = 0.0;
        for (anchor, products, w) in anchors.heard_at(i, samples.positions[i]) {
            let differs = (anchor.gradient(&products) - own) * anchor.trust;
            heaviest = heaviest.max(w);
            more += differs * w;
            squares += w * (differs * normal).length_squared();
            trust += w * anchor.trust;
            sum += w;
        }
        let more = more * (1.0 / sum);
        // One anchor alone agrees with itself, which tells nothing.
        if !is_plausible(own, more) || heaviest > ALONE * sum {
            return ToldAcross::default();
        }
        let apart = (more * normal).length();
        let spread = (squares / sum - apart * apart).max(0.0).sqrt();
        ToldAcross { apart, spread, trust: trust / sum }
    };
    each_sample(fitted, expansions).map(told).collect()
}

/// All samples in order, by jobs that look at their expansions and neighbours.
fn each_sample(fitted: FitInput<'_>, expansions: &[Expansion]) -> impl IndexedParallelIterator<Item = usize> {
    let bytes = size_of::<Expansion>() + fitted.stencils.bytes_of(1);
    fitted.samples.storage().counted(expansions.len(), bytes)
}

/// Whether a gradient that differs by `more` from `own`, that of an expansion, may be the map's: its volume
/// is not far from that of `own`.
fn is_plausible(own: Mat3, more: Mat3) -> bool {
    let ratio = (own + more).determinant() / own.determinant();
    more.is_finite() && (THINNEST..1.0 / THINNEST).contains(&ratio)
}

/// All anchors, and the samples at which each has a say.
struct Anchors {
    anchors: Vec<Anchor>,
    lists: AnchorLists,
}

impl Anchors {
    /// The anchors of a deformation with these affine maps and expansions.
    fn fit(fitted: FitInput<'_>, expansions: &[Expansion]) -> Self {
        let chosen = anchors(fitted.stencils, expansions);
        let samples = fitted.samples.len();
        let fit = |walk: &mut NeighbourWalk, i: &u32| {
            let fit = AnchorFit { fitted, i: *i as usize };
            Arch::new().dispatch(|| fit.anchor(walk))
        };
        let found = chosen.par_iter().map_init(|| NeighbourWalk::new(samples), fit);
        let (anchors, heard): (Vec<Anchor>, Vec<Vec<u32>>) = found.unzip();
        Self { anchors, lists: AnchorLists::new(samples, &heard) }
    }

    /// Whether no anchor has a say at a sample.
    fn are_silent_at(&self, i: usize) -> bool {
        self.lists.anchors(i).is_empty()
    }

    /// The anchors that have a say at sample `i`, which is at `q`, with the products of terms there, and
    /// their weights.
    fn heard_at(&self, i: usize, q: Vec3) -> impl Iterator<Item = (&Anchor, [f32; TERMS + 1], f32)> {
        self.lists.anchors(i).iter().map(move |anchor| {
            let anchor = &self.anchors[*anchor as usize];
            let d = q - anchor.center;
            let w = (1.0 - d.length_squared() * anchor.inverse_square).max(0.0).powi(3);
            (anchor, anchor.products(d), w)
        })
    }
}

/// The anchors, ascending, among samples that move.
fn anchors(stencils: &Stencils<'_>, expansions: &[Expansion]) -> Vec<u32> {
    let (mut is_near, mut chosen) = (vec![false; expansions.len()], Vec::new());
    let mut walk = NeighbourWalk::new(expansions.len());
    for i in (0..expansions.len()).filter(|i| !expansions[*i].is_still()) {
        if !is_near[i] {
            let (near, _) = walk.from(i as u32, APART, |j| {
                let near = stencils.of_sample(j);
                &near[..near.len().min(NEAREST)]
            });
            near.iter().for_each(|j| is_near[*j as usize] = true);
            chosen.push(i as u32);
        }
    }
    chosen
}

/// A way through the graph of neighbours, to each sample once.
struct NeighbourWalk {
    /// Number of the walk in which each sample was met last.
    met: Vec<u32>,
    walks: u32,
}

impl NeighbourWalk {
    fn new(samples: usize) -> Self {
        Self { met: vec![0; samples], walks: 0 }
    }

    /// Samples that at most `links` links lead to, by the number of links, sample `i` first; and the number
    /// of those that [`HEARD`] links lead to.
    fn from<'a>(&mut self, i: u32, links: usize, near: impl Fn(usize) -> &'a [u32]) -> (Vec<u32>, usize) {
        self.walks += 1;
        self.met[i as usize] = self.walks;
        let (mut all, mut start, mut heard) = (vec![i], 0, 1);
        for link in 1..=links {
            let end = all.len();
            for at in start..end {
                for j in near(all[at] as usize) {
                    if std::mem::replace(&mut self.met[*j as usize], self.walks) != self.walks {
                        all.push(*j);
                    }
                }
            }
            start = end;
            if link <= HEARD {
                heard = all.len();
            }
        }
        (all, heard)
    }
}

/// Anchors that have a say at each sample, ascending.
struct AnchorLists {
    starts: Vec<u32>,
    anchors: Vec<u32>,
}

impl AnchorLists {
    /// The anchors of each sample, from the samples of each anchor.
    fn new(samples: usize, of_anchors: &[Vec<u32>]) -> Self {
        let of_anchors = of_anchors.iter().zip(0..);
        let pairs = of_anchors.flat_map(|(all, anchor)| all.iter().map(move |i| (*i, anchor)));
        let (starts, anchors) = lists(samples, pairs);
        Self { starts, anchors }
    }

    fn anchors(&self, i: usize) -> &[u32] {
        &self.anchors[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
}

/// Inputs of the fit of an anchor at sample `i`.
struct AnchorFit<'a> {
    fitted: FitInput<'a>,
    i: usize,
}

impl AnchorFit<'_> {
    /// The anchor, and the samples at which it has a say.
    #[inline(always)]
    fn anchor(&self, walk: &mut NeighbourWalk) -> (Anchor, Vec<u32>) {
        let Self { fitted: FitInput { samples, stencils, deformed, gradient }, i } = *self;
        let affine = gradient[i];
        let (mut near, heard) = walk.from(i as u32, LINKS, |j| stencils.of_sample(j));
        let way = |j: u32| samples.positions[j as usize] - samples.positions[i];
        let radius = |near: &[u32]| near.iter().map(|j| way(*j).length_squared()).fold(0.0, f32::max);
        let (square, of_heard) = (radius(&near), radius(&near[..heard]));
        let none = Anchor {
            center: samples.positions[i],
            scale: 0.0,
            affine,
            terms: [Vec3::ZERO; TERMS],
            trust: 0.0,
            inverse_square: 1.0 / of_heard,
        };
        if of_heard == 0.0 {
            return (none, Vec::new());
        }
        let radius = f64::from(square).sqrt();
        let mut squares = ResidualSquares::new();
        for j in &near {
            let d = way(*j).as_dvec3();
            let moved = (deformed[*j as usize].as_dvec3() - deformed[i].as_dvec3()) - affine.as_dmat3() * d;
            squares.include(d / radius, moved);
        }
        let normal = samples.normals()[i].as_dvec3();
        near.truncate(heard);
        // The lists of all anchors are held at once, and the walk has met nearly twice as many samples.
        near.shrink_to_fit();
        let anchor = match squares.solve(radius * strain(affine.as_dmat3()), normal) {
            Some((terms, trust)) => Anchor {
                scale: (1.0 / radius) as f32,
                terms: terms.map(|t| t.as_vec3()),
                trust: trust as f32,
                ..none
            },
            None => none,
        };
        (anchor, near)
    }
}

impl Anchor {
    /// The product that each term is of at `d` from the anchor, and 1.
    fn products(&self, d: Vec3) -> [f32; TERMS + 1] {
        let x = (d * self.scale).extend(1.0).to_array();
        let mut products = [1.0; TERMS + 1];
        for (to, [a, b, c, d]) in products.iter_mut().zip(&FACTORS) {
            *to = x[*a] * x[*b] * x[*c] * x[*d];
        }
        products
    }

    /// The sums of derivatives, by where they go.
    fn derived<const N: usize>(
        &self,
        derivatives: &[Derivative; DERIVATIVES],
        products: &[f32; TERMS + 1],
    ) -> [Vec3; N] {
        let mut sums = [Vec3::ZERO; N];
        for (term, to, product, times) in derivatives {
            sums[*to] += self.terms[*term] * (products[*product] * times);
        }
        sums
    }

    /// The gradient of the map where the products are these.
    fn gradient(&self, products: &[f32; TERMS + 1]) -> Mat3 {
        let [x, y, z] = self.derived(&FIRST, products).map(|slope: Vec3| slope * self.scale);
        self.affine + Mat3::from_cols(x, y, z)
    }

    /// The second-order terms of the map there: xx, xy, xz, yy, yz, zz.
    fn second(&self, products: &[f32; TERMS + 1]) -> [Vec3; 6] {
        self.derived(&SECOND, products).map(|term: Vec3| term * self.scale * self.scale)
    }
}

/// Numbers in a block, as many as the processor takes at once.
const BLOCK: usize = 8;

/// Length of the rows of a matrix: whole blocks.
const ROW: usize = TERMS.next_multiple_of(BLOCK);

type RowBlocks = [[f64; ROW]; TERMS];

/// Sums of the squares of the affine map's residual, which is to be explained by the terms in units of the
/// radius.
struct ResidualSquares {
    /// Lower triangle of the products of terms, which is read, with the entries beside it in blocks of
    /// [`BLOCK`]; and the products with the residual.
    matrix: RowBlocks,
    right: [DVec3; TERMS],
    /// The sums of the weights, and of their squares.
    weights: f64,
    squared_weights: f64,
    /// Weighted sum of the residual's squares.
    squares: f64,
    /// The largest of that, as the square of a length.
    largest: f64,
}

impl ResidualSquares {
    fn new() -> Self {
        let (matrix, right) = ([[0.0; ROW]; TERMS], [DVec3::ZERO; TERMS]);
        Self { matrix, right, weights: 0.0, squared_weights: 0.0, squares: 0.0, largest: 0.0 }
    }

    /// Adds a neighbour at `x`, in units of the radius, that the affine map leaves so far from its image.
    #[inline(always)]
    fn include(&mut self, x: DVec3, left: DVec3) {
        let w = (1.0 - x.length_squared()).max(0.0);
        let x = [x.x, x.y, x.z, 1.0];
        let mut terms = [0.0; ROW];
        for (to, [a, b, c, d]) in terms.iter_mut().zip(&FACTORS) {
            *to = x[*a] * x[*b] * x[*c] * x[*d];
        }
        for a in 0..TERMS {
            let weighted = w * terms[a];
            let blocks = self.matrix[a].chunks_exact_mut(BLOCK).zip(terms.chunks_exact(BLOCK));
            for (to, terms) in blocks.take(a / BLOCK + 1) {
                for at in 0..BLOCK {
                    to[at] += weighted * terms[at];
                }
            }
            self.right[a] += weighted * left;
        }
        self.weights += w;
        self.squared_weights += w * w;
        self.squares += w * left.length_squared();
        self.largest = self.largest.max(left.length_squared());
    }

    /// Terms, and the part of the one along the normal that the neighbours determine; `extent` is the strain
    /// times the radius. `None` where the affine map explains all but rounding, or too few neighbours are
    /// there.
    fn solve(&self, extent: f64, normal: DVec3) -> Option<([DVec3; TERMS], f64)> {
        let free = 1.0 - TERMS as f64 * self.squared_weights / (self.weights * self.weights);
        if self.largest <= ROUNDING * ROUNDING || free.is_nan() || free < LEAST_FREE {
            return None;
        }
        let least = LEAST_RIDGE * self.weights;
        let explained: f64 =
            self.ridged(least)?.solve(self.right).iter().zip(&self.right).map(|(c, b)| c.dot(*b)).sum();
        let noise = (self.squares - explained).max(0.0) / (self.weights * free);
        let ridge = least + noise / (EXPECTED * (self.squares / self.weights + extent * extent));
        let factor = self.ridged(ridge)?;
        let mut across = [DVec3::ZERO; TERMS];
        (0..3).for_each(|axis| across[axis].x = normal[axis]);
        let open = factor.solve(across);
        let untold: f64 = ridge * (0..3).map(|axis| open[axis].x * normal[axis]).sum::<f64>();
        let terms = factor.solve(self.right);
        terms.iter().all(|t| t.is_finite()).then_some((terms, (1.0 - untold).clamp(0.0, 1.0)))
    }

    /// Cholesky's decomposition of the products, with a ridge along the diagonal.
    fn ridged(&self, ridge: f64) -> Option<CholeskyFactor> {
        let mut rows = self.matrix;
        for j in 0..TERMS {
            for i in j..TERMS {
                let sum: f64 = (0..j).map(|k| rows[i][k] * rows[j][k]).sum();
                rows[i][j] -= sum;
            }
            let pivot = rows[j][j] + ridge;
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            let root = pivot.sqrt();
            rows[j][j] = root;
            (j + 1..TERMS).for_each(|i| rows[i][j] /= root);
        }
        Some(CholeskyFactor(rows))
    }
}

/// The lower triangle of Cholesky's decomposition.
struct CholeskyFactor(RowBlocks);

impl CholeskyFactor {
    fn solve(&self, mut right: [DVec3; TERMS]) -> [DVec3; TERMS] {
        let Self(rows) = self;
        for i in 0..TERMS {
            let sum: DVec3 = (0..i).map(|k| rows[i][k] * right[k]).sum();
            right[i] = (right[i] - sum) / rows[i][i];
        }
        for i in (0..TERMS).rev() {
            let sum: DVec3 = (i + 1..TERMS).map(|k| rows[k][i] * right[k]).sum();
            right[i] = (right[i] - sum) / rows[i][i];
        }
        right
    }
}

/// The size of Green's strain of a gradient.
fn strain(f: DMat3) -> f64 {
    0.5 * (f.transpose() * f - DMat3::IDENTITY).to_cols_array().iter().map(|e| e * e).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::{DeformationField, Method, RestGeometry};
    use super::*;
    use crate::sampling::SampleSet;

    /// Samples of a surface that bends here more and there less.
    fn samples() -> SampleSet {
        let place = |i: u32| {
            let jitter = |k: u32| ((i * 7919 + k * 104_729) % 1000) as f32 / 2500.0;
            let (x, z) = (((i % 50) as f32 + jitter(1)) / 50.0, ((i / 50) as f32 + jitter(2)) / 50.0);
            Vec3::new(x, 0.05 * (9.0 * x + 4.0 * z).sin() + 0.05 * (7.0 * z).cos(), z)
        };
        SampleSet::new((0..2500).map(place).collect(), Vec::new()).expect("samples")
    }

    /// Root of the mean square error of the gradient across the surface, over the samples that are not at the
    /// border: by the expansions, and by the anchors.
    fn off(map: impl Fn(Vec3) -> Vec3, gradient: impl Fn(Vec3) -> Mat3) -> [f32; 2] {
        let samples = samples();
        let around = RestGeometry::new(&samples);
        let deformed: Vec<Vec3> = samples.positions.iter().map(|p| map(*p)).collect();
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets).knowing(None);
        let is_within = |p: &Vec3| (0.15..0.85).contains(&p.x) && (0.15..0.85).contains(&p.z);
        let inner = (0..samples.len()).filter(|i| is_within(&samples.positions[*i]));
        let (mut sums, mut count) = ([0.0; 2], 0.0);
        for i in inner {
            let n = samples.normals()[i];
            let expected = gradient(samples.positions[i]) * n;
            for (sum, all) in sums.iter_mut().zip([&field.expansions[..], &field.turning[..]]) {
                *sum += ((Mat3::IDENTITY + all[i].slope()) * n).distance_squared(expected);
            }
            count += 1.0;
        }
        sums.map(|sum| (sum / count).sqrt())
    }

    #[test]
    fn shear_across_is_told_by_how_the_surface_bends() {
        // Along y, by as much as z says, which no sample alone tells from bending.
        let map =
            |p: Vec3| p + Vec3::new(0.3 * p.y * p.z + 0.4 * p.y, 0.2 * p.x * p.x * p.z, 0.2 * p.y * p.x);
        let gradient = |p: Vec3| {
            Mat3::from_cols(
                Vec3::new(1.0, 0.4 * p.x * p.z, 0.2 * p.y),
                Vec3::new(0.4 + 0.3 * p.z, 1.0, 0.2 * p.x),
                Vec3::new(0.3 * p.y, 0.2 * p.x * p.x, 1.0),
            )
        };
        let [by_expansions, told] = off(map, gradient);
        assert!(told < 0.01 && told < 0.3 * by_expansions, "{told}, by expansions {by_expansions}");
    }

    #[test]
    fn noise_is_not_taken_for_what_happens_across() {
        let gradient = Mat3::from_diagonal(Vec3::new(1.2, 1.0, 1.0));
        for size in [1e-4, 2e-3] {
            let noise = |p: Vec3| size * (p.x * 12_345.6).sin() * (p.z * 7_654.3).cos();
            let [by_expansions, told] = off(|p| gradient * p + noise(p) * Vec3::Y, |_| gradient);
            assert!(told < by_expansions, "{told}, by expansions {by_expansions}");
        }
    }

    #[test]
    fn rigid_motions_and_what_is_still_are_as_they_were() {
        assert_eq!(changed(|p| p), 0.0);
        let changed = changed(|p| glam::Quat::from_rotation_y(0.7) * p + Vec3::X);
        assert!(changed < 1e-5, "{changed}");
    }

    /// The mean difference between the gradients of a map and those of the expansions.
    fn changed(map: impl Fn(Vec3) -> Vec3) -> f32 {
        let samples = samples();
        let around = RestGeometry::new(&samples);
        let deformed: Vec<Vec3> = samples.positions.iter().map(|p| map(*p)).collect();
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets).knowing(None);
        let square = |m: Mat3| m.to_cols_array().iter().map(|x| x * x).sum::<f32>();
        let all = field.expansions.iter().zip(&field.turning[..]);
        let sum: f32 = all.map(|(a, b)| square(a.slope() - b.slope())).sum();
        (sum / samples.len() as f32).sqrt()
    }
}
