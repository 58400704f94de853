//! Expected error of a reconstruction, estimated without the exact map: around each sample, and at each
//! vertex.
//!
//! Halfway between two neighbouring samples the expansions about both count. Each leaves out the third order,
//! so the distance between the two expansions there is of the size of the terms that both leave out. Where
//! the deformation has details that the samples do not tell, as at a step, the expansions differ by those.
//!
//! At a sample itself the deformed position is known. The distance from there to the blend of the other
//! samples' expansions is the error of a blend, in which the terms that samples leave out cancel as they do
//! at vertices (M. Stone, *Cross-validatory choice and assessment of statistical predictions*, 1974); it is
//! somewhat less than the true error, as the expansions of the others were fitted to the sample, too.
//!
//! At a vertex all supports that reach it count. The distances of their expansions from the blend tell the
//! error at that very place. So does the distance of the blend from another one with wider supports, which
//! leaves out more of the same terms: two orders of one method tell its error, as in an embedded pair of
//! Runge and Kutta (E. Fehlberg, *Low-order classical Runge-Kutta formulas with stepsize control*, 1969).
//! Terms that all expansions leave out together do not show in these. For them stand the distances of the
//! samples around from where the others' expansions take them, with the largest disagreement of any two
//! halfway. These count more where a vertex lies beyond the samples, as off the surface, at a sharp edge or
//! outside a border: up to the distances of the expansions around from the vertex, and of another blend with
//! supports that are wider still. The change of the map across a sheet of gentle relief is guessed alike by
//! all samples; the error that this leaves open counts, too ([`unresolved`](super::unresolved)). Rounding
//! comes on top: of the samples' positions, of the displacement, and of the file that is written.

use std::iter;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use simod_model::frame::Frame;
use simod_model::{ModelInfo, Result};

use super::blend::LEAST_WEIGHT;
use super::expansion::{Expansion, ROUNDING};
use super::expectation::{ErrorExcess, ErrorSums, Expectation, ExpectedError, Rounding, hypot};
use super::neighbourhood::Neighbourhood;
use super::stencils::RING;
use super::{DeformationField, Method, Moved, blended_jets, carry, unresolved};
use crate::sampled_model::SampledModel;

/// Differences below so many times the rounding of positions tell nothing.
const TELLING: f64 = 4.0;

/// The part of a sample's disagreement with its ring that the vertices around it are expected to be off by,
/// where samples alone are asked.
const BY_SAMPLES: f32 = 0.42;

/// Weight of the change κ of gradients from one sample to the next, as a part of their size. Each order of a
/// map is about κ times the one before, so with a large κ the difference of two expansions is not most of
/// what both leave out: this many times κ of the difference counts besides.
const OF_TURNING: f32 = 2.0;

/// Part of the spread of the supports' displacements at a vertex that counts; the true error is mostly less.
const OF_SPREAD: f32 = 0.45;

/// Factor by which the supports of the other blend are wider, and the part of its distance from the first one
/// that counts: no more than this factor times the distance of the home's ring, as a sample that fails may
/// have all of the wider blend's weight.
const WIDER: f32 = 2.0;
const OF_WIDER: f32 = 0.5;

/// Parts that count of the samples' distances from where the others' expansions take them, and of the largest
/// disagreement halfway, where a vertex lies among the samples.
const OF_LEFT_OUT: f32 = 0.7;
const OF_LARGEST: f32 = 0.05;

/// Part of a sample's disagreement with its ring that is its error where no other support reaches it.
const BY_HALFWAY: f32 = 0.36;

/// Least square of a vertex's distance from the middle of the samples that reach it, each direction measured
/// by the samples' spread in it, at which the vertex lies beyond them. From there on the samples' errors
/// count more, in proportion to the square ...
const AMONG: f32 = 0.65;

/// ... up to a sum of three parts: of the largest distance of an expansion that reaches the vertex, of the
/// distance of the home's ring, and of that of a blend with supports `WIDEST` times as wide. Samples that
/// reach a vertex beyond an edge are few and lie side by side, and leave out alike the terms that other
/// samples, farther off, tell.
const SAID: f32 = 0.55;
const SAID_AROUND: f32 = 0.1;
const WIDEST: f32 = 3.0;
const SAID_WIDEST: f32 = 0.6;

/// The square of a distance that is far beyond any samples.
const FAR: f32 = 1e9;

/// The least spread, as a part of the support's radius: all samples of a roof lie in a plane.
const FLAT: f32 = 0.03;

impl DeformationField<'_> {
    /// Expected transfer error around each sample, local units: the largest difference between its expansion
    /// and those of its neighbours, halfway, as both ends expect it. 0 where rounding explains the
    /// difference, as for a rigid motion.
    ///
    /// The result is an estimate of the size, not a bound: `docs/refinement.md` says how it compares with the
    /// error.
    pub fn expected_error(&self) -> Vec<f32> {
        let told = |e: Expectation| if f64::from(e.largest) < TELLING * ROUNDING { 0.0 } else { e.largest };
        if self.expected.is_empty() {
            self.around_samples(&[]).into_iter().map(told).collect()
        } else {
            self.expected.iter().copied().map(told).collect()
        }
    }

    /// Finds the expected errors around the samples, on which all further estimates rest, for a file as
    /// `info` says.
    pub fn expecting(mut self, frame: &Frame, info: &ModelInfo) -> Self {
        self.expected = self.around_samples(&[]);
        self.rounding = Rounding::for_model(frame, self.shift, info);
        self
    }

    /// Largest disagreement, halfway, of the sample nearest to a place (local coordinates) with its
    /// neighbours, local units.
    pub fn disagreement(&self, place: Vec3) -> f32 {
        let i = self.around.samples.nearest(place) as usize;
        let halfway = |j: &u32| self.halfway(i, *j as usize, |i| self.scale_at(i));
        self.stencils.ring(i).iter().map(halfway).fold(0.0, f32::max)
    }

    /// Copy of this field in which two samples whose clusters are single places do not count against each
    /// other, as there are no vertices between them. The error of the transfer at these samples themselves
    /// counts there. A sample that has stayed from a larger cluster stands beside its vertex, of which this
    /// tells less: so the copy is for deformations that are compared with the exact map besides. The field
    /// has to be [expecting](Self::expecting).
    ///
    /// # Errors
    /// The cells are not in memory, or of another model.
    pub fn expecting_at_vertices(mut self, of: &SampledModel) -> Result<Self> {
        let is_single: Vec<bool> = of.cluster_errors()?.iter().map(|error| *error == 0.0).collect();
        self.expected = self.around_samples(&is_single);
        let single: Vec<usize> = (0..is_single.len()).filter(|i| is_single[*i]).collect();
        let at = |i: &usize| of.frame.to_model(self.around.samples.positions[*i]);
        let rest: Vec<DVec3> = single.iter().map(at).collect();
        let mut carried = rest.clone();
        let moved = Moved { positions: &mut carried, normals: &mut [], gradients: &mut [], figures: &mut [] };
        carry(std::slice::from_ref(&self), &of.frame, &rest, None, &mut [moved]);
        for (i, carried) in single.into_iter().zip(carried) {
            let off = self.place(&of.frame, i).distance(carried) / of.frame.scale;
            let largest = &mut self.expected[i].largest;
            *largest = largest.max(off as f32);
        }
        Ok(self)
    }

    /// Expected errors around all samples. Two samples whose clusters are single places, as `is_single` says,
    /// do not count in each other's largest disagreement; an empty `is_single` stands for none.
    pub(super) fn around_samples(&self, is_single: &[bool]) -> Vec<Expectation> {
        // A sample need not be among the neighbours of its own neighbour: both ends are told. Lengths are in
        // the order of their bits, and the largest is the same in whatever order they come.
        let samples = self.expansions.len();
        let scales: Vec<Scale> = self.each_sample().map(|i| self.scale_at(i)).collect();
        let largest: Vec<AtomicU32> = (0..samples).map(|_| AtomicU32::new(0)).collect();
        let disagreement = |i: usize| {
            let near = self.stencils.ring(i);
            let mut squares = 0.0;
            for j in near.iter().map(|j| *j as usize) {
                let off = self.halfway(i, j, |i| scales[i]);
                squares += off * off;
                let both_single = !is_single.is_empty() && is_single[i] && is_single[j];
                if off > 0.0 && !both_single {
                    for end in [i, j] {
                        largest[end].fetch_max(off.to_bits(), Ordering::Relaxed);
                    }
                }
            }
            (squares / near.len().max(1) as f32).sqrt()
        };
        let disagreement: Vec<f32> = self.each_sample().map(disagreement).collect();
        drop(scales);
        let largest = largest.into_iter().map(|bits| f32::from_bits(bits.into_inner()));
        let told = |(disagreement, largest)| Expectation { disagreement, largest, left_out: 0.0 };
        disagreement.into_iter().zip(largest).map(told).collect()
    }

    /// Finds the distances of samples from where the others' expansions take them: the expected error of
    /// vertices rests on these, too. The field has to be [expecting](Self::expecting).
    pub fn expecting_of_vertices(mut self) -> Self {
        let squares: Vec<f32> = self.each_sample().map(|i| self.without(i)).collect();
        let mean = |i: usize| {
            let ring = self.stencils.ring(i);
            let sum = squares[i] + ring.iter().map(|j| squares[*j as usize]).sum::<f32>();
            (sum / (ring.len() + 1) as f32).sqrt()
        };
        let means: Vec<f32> = (0..squares.len()).into_par_iter().map(mean).collect();
        self.expected.iter_mut().zip(means).for_each(|(expected, mean)| expected.left_out = mean);
        self.unresolved = unresolved::find(self.fit_input(), &self.expansions);
        self
    }

    /// All samples in order, by jobs that look at their expansions and neighbours.
    fn each_sample(&self) -> impl IndexedParallelIterator<Item = usize> {
        let bytes = size_of::<Expansion>() + self.stencils.bytes_of(1);
        self.around.samples.storage().counted(self.expansions.len(), bytes)
    }

    /// Square of the distance of a sample from where the blend of its neighbours alone takes it; where none
    /// of their supports reaches it, the sample's disagreement with them stands for that.
    fn without(&self, i: usize) -> f32 {
        let place = Vec3::from_array(self.expansions[i].center);
        let went = self.expansions[i].displacement();
        let (mut off, mut sum) = (Vec3::ZERO, 0.0);
        for j in self.stencils.of_sample(i) {
            let other = &self.expansions[*j as usize];
            let s = other.within(place).max(0.0);
            if s > 0.0 {
                off += s * s * s * (says(other, place) - went);
                sum += s * s * s;
            }
        }
        if sum < LEAST_WEIGHT {
            return (BY_HALFWAY * self.expected[i].disagreement).powi(2);
        }
        (off / sum).length_squared()
    }

    /// Distance between the expansions about two samples halfway between them, increased where these are so
    /// far from each other that the distance tells little; but for the part that rounding explains, which
    /// turns gradients, too.
    fn halfway(&self, i: usize, j: usize, scale_of: impl Fn(usize) -> Scale) -> f32 {
        let (one, other) = (&self.expansions[i], &self.expansions[j]);
        let (own, of_other) = (scale_of(i), scale_of(j));
        let halfway = 0.5 * (Vec3::from_array(one.center) + Vec3::from_array(other.center));
        let apart = says(one, halfway).distance(says(other, halfway));
        let rounding = TELLING as f32 * hypot([own.rounding, of_other.rounding]);
        // Difference of the gradients as a part of their mean size: at most 2.
        let size = (own.gradient + of_other.gradient).max(f32::MIN_POSITIVE);
        let turned = 2.0 * norm(one.slope() - other.slope()) / size;
        hypot([apart, OF_TURNING * turned * (apart - rounding).max(0.0)])
    }

    /// Size of the gradient and of rounding at a sample, by which differences from its expansion are
    /// measured.
    fn scale_at(&self, i: usize) -> Scale {
        let gradient = norm(self.expansions[i].slope() + Mat3::IDENTITY);
        Scale { gradient, rounding: self.rounding_at(i) }
    }

    /// Expected error of a vertex at `p`, of this home, that goes by `u`; local units. The field has to be
    /// [expecting of vertices](Self::expecting_of_vertices).
    pub(super) fn expected_at(&self, home: usize, p: Vec3, u: Vec3) -> f32 {
        let heard = self.heard(home, p, u);
        let around = self.heard_around(home, p, u);
        let radius = self.around.supports.radius[home].max(f32::MIN_POSITIVE);
        let further = (heard.beyond(FLAT * radius) / AMONG).max(1.0);
        let disagreement = hypot([OF_LEFT_OUT * heard.left_out / heard.sum, OF_LARGEST * heard.largest]);
        let said = SAID * heard.furthest
            + SAID_AROUND * around.differs
            + SAID_WIDEST * around.apart_by(&around.widest);
        hypot([
            OF_SPREAD * (heard.spread / heard.sum).sqrt(),
            OF_WIDER * around.apart_by(&around.wider),
            (further * disagreement).min(said),
            heard.unresolved / heard.sum,
            self.rounding.estimate(p, u),
        ])
    }

    /// Sums over the samples whose supports reach a vertex at `p`, of this home, that goes by `u`; over those
    /// near to it where none does.
    fn heard(&self, home: usize, p: Vec3, u: Vec3) -> Heard {
        let mut heard = Heard::default();
        for i in self.around.reaching(home) {
            let s = self.expansions[i].within(p);
            if s > 0.0 {
                heard.add(self, i, s * s * s, p, u);
            }
        }
        if heard.sum < LEAST_WEIGHT {
            heard = Heard::default();
            let near = Neighbourhood::gather(self.around, home, blended_jets::BLENDED, p);
            near.weighted().iter().for_each(|&(i, w)| heard.add(self, i as usize, w, p, u));
        }
        heard
    }

    /// What the expansions of the home of a vertex at `p`, that goes by `u`, and of the home's neighbours say
    /// of it; their supports need not reach the vertex.
    fn heard_around(&self, home: usize, p: Vec3, u: Vec3) -> HeardAround {
        let (mut furthest, mut differs) = (0.0f32, 0.0f32);
        let [mut wider, mut widest] = [WIDER, WIDEST].map(WideBlend::new);
        let neighbours = self.stencils.of_sample(home).iter().map(|i| *i as usize);
        for (place, i) in iter::once(home).chain(neighbours).enumerate() {
            let e = &self.expansions[i];
            let apart = says(e, p) - u;
            if place <= RING {
                let length = apart.length();
                differs = differs.max(length.min(furthest));
                furthest = furthest.max(length);
            }
            let beyond = 1.0 - e.within(p);
            wider.add(beyond, apart);
            widest.add(beyond, apart);
        }
        // Two samples alone do not tell which one fails.
        let are_two = self.stencils.ring(home).len() < 2;
        HeardAround { differs: if are_two { furthest } else { differs }, wider, widest }
    }

    /// Expected error of the vertices by that of the samples, each counted for as many vertices as it was the
    /// home of in all that was carried so far, of `vertices`; the others do not move. `None` where the method
    /// is another one, which leaves out other things. The field has to be [expecting](Self::expecting).
    pub(super) fn expected_of_samples(&self, of: &SampledModel, vertices: u64) -> Option<ExpectedError> {
        if self.method != Method::BlendedJets {
            return None;
        }
        let diagonal = of.local_diagonal();
        let (mut tally, mut counted) = (ErrorSums::default(), 0);
        for (i, e) in self.expected.iter().enumerate() {
            let n = self.around.vertices_of(i);
            let part = |x: f32| f64::from(hypot([x, self.rounding_at(i)])) / diagonal;
            tally.add(part(BY_SAMPLES * e.disagreement), n);
            tally.worst = tally.worst.max(if n > 0 { part(e.largest) } else { 0.0 });
            counted += n;
        }
        tally.add(0.0, vertices.saturating_sub(counted));
        // More samples do not mend rounding.
        let beyond = self.where_beyond(of, ExpectedError::ACCEPTED, |_, e| e.largest);
        Some(ExpectedError { beyond, ..tally.sum(false) })
    }

    /// Rounding error of the written position of a vertex that is known exactly, local units.
    pub(super) fn written_rounding(&self, p: Vec3, u: Vec3) -> f32 {
        self.rounding.written(p, u)
    }

    /// Rounding error at a sample, local units.
    fn rounding_at(&self, sample: usize) -> f32 {
        let place = self.around.samples.positions[sample];
        // The displacement as the expansion has it, which may be in a file.
        self.rounding.estimate(place, self.deformed[sample] - place)
    }

    /// Samples around which more than `accepted` is expected, a fraction of the diagonal of the model of
    /// which the samples are; `None` if there are none. The field has to be [expecting](Self::expecting).
    pub fn expected_beyond(&self, of: &SampledModel, accepted: f64) -> Option<ErrorExcess> {
        self.where_beyond(of, accepted, |i, e| hypot([e.largest, self.rounding_at(i)]))
    }

    /// Samples around which `expected` gives more than `accepted`, as
    /// [`expected_beyond`](Self::expected_beyond) does; `expected` is in local units.
    fn where_beyond(
        &self,
        of: &SampledModel,
        accepted: f64,
        expected: impl Fn(usize, &Expectation) -> f32,
    ) -> Option<ErrorExcess> {
        let diagonal = of.local_diagonal();
        let part = |(i, e): (usize, &Expectation)| (i, f64::from(expected(i, e)) / diagonal);
        let beyond = || self.expected.iter().enumerate().map(part).filter(|(_, e)| *e > accepted);
        let (at, worst) = beyond().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))?;
        let more = |(_, e): (usize, f64)| (e / accepted).powf(2.0 / ExpectedError::ORDER) - 1.0;
        Some(ErrorExcess {
            worst,
            rounding: f64::from(self.rounding_at(at)) / diagonal,
            place: of.frame.to_model(self.around.samples.positions[at]),
            samples: beyond().count() as u64,
            needed: beyond().map(more).sum::<f64>().ceil() as u64,
        })
    }
}

/// Sums over the samples whose supports reach a vertex, each with its weight.
#[derive(Default)]
struct Heard {
    /// Sum of the weights.
    sum: f32,
    /// Weighted squares of the distance of each sample's expansion from the vertex's position.
    spread: f32,
    /// Largest such distance.
    furthest: f32,
    /// Weighted distance of each sample and its neighbours from where the others' expansions take them.
    left_out: f32,
    /// Largest disagreement of any of the samples with its neighbours halfway.
    largest: f32,
    /// Weighted error that the gradient across the surface leaves open.
    unresolved: f32,
    /// Sums of the samples' places relative to the vertex, and of their products.
    places: Vec3,
    products: [Vec3; 3],
}

impl Heard {
    /// Adds what sample `i` tells of a vertex at `p` that goes by `u`, with the weight `w`.
    fn add(&mut self, field: &DeformationField<'_>, i: usize, w: f32, p: Vec3, u: Vec3) {
        let off = says(&field.expansions[i], p).distance_squared(u);
        let d = Vec3::from_array(field.expansions[i].center) - p;
        self.spread += w * off;
        self.furthest = self.furthest.max(off.sqrt());
        let unknown = Expectation { disagreement: f32::NAN, largest: f32::NAN, left_out: f32::NAN };
        let Expectation { left_out, largest, .. } = field.expected.get(i).copied().unwrap_or(unknown);
        self.left_out += w * left_out;
        self.largest = self.largest.max(largest);
        self.unresolved += w * field.unresolved.get(i).map_or(f32::NAN, |open| open.length(-d));
        self.places += w * d;
        (0..3).for_each(|axis| self.products[axis] += d * (w * d[axis]));
        self.sum += w;
    }

    /// Square of the vertex' distance from the middle of the samples, each direction measured by the samples'
    /// spread in it, or by `least`: the distance of Mahalanobis.
    fn beyond(&self, least: f32) -> f32 {
        let middle = self.places / self.sum;
        let column = |axis: usize| {
            self.products[axis] / self.sum - middle * middle[axis] + least * least * Vec3::AXES[axis]
        };
        let spread = Mat3::from_cols(column(0), column(1), column(2));
        let beyond = middle.dot(spread.inverse() * middle);
        // Samples at one place are spread in no direction.
        if beyond.is_finite() { beyond } else { FAR }
    }
}

/// Distances of the expansions of a vertex's home and its neighbours, and of wider blends, from the vertex's
/// position.
struct HeardAround {
    /// Second largest distance of an expansion of the home's ring from the vertex's position: a single one
    /// that fails tells nothing. Of two samples in all, the largest distance.
    differs: f32,
    /// Blends of these expansions with wider supports, as distances from the vertex's position.
    wider: WideBlend,
    widest: WideBlend,
}

impl HeardAround {
    /// Distance of one of the blends from the vertex's position, at most so many times `differs`.
    fn apart_by(&self, blend: &WideBlend) -> f32 {
        blend.apart().min(blend.times * self.differs)
    }
}

/// Blend, with supports that are `times` as wide, of the distances of expansions from a vertex's position.
struct WideBlend {
    times: f32,
    /// The weighted sum.
    apart: Vec3,
    /// The sum of the weights.
    sum: f32,
}

impl WideBlend {
    fn new(times: f32) -> Self {
        Self { times, apart: Vec3::ZERO, sum: 0.0 }
    }

    /// Adds an expansion that is `apart` from the vertex's position; `beyond` is the square of the vertex's
    /// distance from the sample, as a part of that of the support's radius.
    fn add(&mut self, beyond: f32, apart: Vec3) {
        let s = (1.0 - beyond / (self.times * self.times)).max(0.0);
        self.apart += s * s * s * apart;
        self.sum += s * s * s;
    }

    /// Length of the blend of all distances; 0 where no sample has a say.
    fn apart(&self) -> f32 {
        if self.sum < LEAST_WEIGHT { 0.0 } else { (self.apart / self.sum).length() }
    }
}

/// Sizes by which differences from a sample's expansion are measured.
#[derive(Clone, Copy)]
struct Scale {
    /// The norm of the deformation's gradient.
    gradient: f32,
    /// Rounding error, local units.
    rounding: f32,
}

/// The norm of Frobenius.
fn norm(f: Mat3) -> f32 {
    f.to_cols_array().iter().map(|x| x * x).sum::<f32>().sqrt()
}

/// The displacement at `p` by an expansion.
#[inline]
fn says(e: &Expansion, p: Vec3) -> Vec3 {
    e.displacement_at(p - Vec3::from_array(e.center))
}
