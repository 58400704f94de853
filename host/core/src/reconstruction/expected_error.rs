//! How far the reconstruction is probably off, without knowing the exact map: around each sample, and at each
//! vertex.
//!
//! Halfway between two neighbours the expansions about both have a say. Each takes what it leaves out, the
//! third order, for nothing; so the distance between what they say is of the size of what both leave out
//! there. Where the deformation has details that the samples do not tell, as at a step, they differ by those.
//!
//! At a sample itself it is known where it went. How far what the others make of its place is from that is
//! the error of a blend, in which what samples leave out cancels as it does at vertices (M. Stone,
//! *Cross-validatory choice and assessment of statistical predictions*, 1974); somewhat less than its true
//! one, as the expansions of the others were fitted to it, too.
//!
//! At a vertex all supports that reach it have a say, and how far these are from what is made of them tells
//! about that very place. So does how far the blend is from another one with wider supports, which leaves out
//! more of the same: two orders of one method tell its error, as in an embedded pair of Runge and Kutta (E.
//! Fehlberg, *Low-order classical Runge-Kutta formulas with stepsize control*, 1969). What all leave out
//! together they do not tell; how far the samples around are from where others would have them stands for
//! that, with the worst that any two disagree by halfway, and for more of it where a vertex lies beyond the
//! samples, as off the surface, at a sharp edge or outside a border, up to what those around say there, and
//! another blend with supports that are wider still. How the map varies
//! across a sheet of gentle relief all of them guess alike: what that leaves open counts, too
//! ([`unresolved`](super::unresolved)). Rounding comes on top: of the samples' positions, of
//! the displacement, and of the file that is written.

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

/// Where gradients differ by κ from one sample to the next, as a part of their size, each order of a map is
/// about κ times the one before, and what two expansions differ by is not most of what both leave out. So
/// many times κ of it counts besides.
const OF_TURNING: f32 = 2.0;

/// The part of the spread of what supports say at a vertex that counts; the truth is mostly less.
const OF_SPREAD: f32 = 0.45;

/// The other blend has supports so many times as wide, and so much of how far it is from the first one
/// counts: no more than as many times what the home's ring says, as one that fails may have all of its say.
const WIDER: f32 = 2.0;
const OF_WIDER: f32 = 0.5;

/// The parts that count of how far samples are from where others would have them, and of the largest of what
/// they disagree by halfway, where a vertex lies among them.
const OF_LEFT_OUT: f32 = 0.7;
const OF_LARGEST: f32 = 0.05;

/// The part of what a sample disagrees by with its ring that it is off by where no other one reaches it.
const BY_HALFWAY: f32 = 0.36;

/// A vertex lies beyond the samples that reach it from this square of its distance from their middle on, each
/// direction measured by how far they are spread in it: what they leave out counts as many times more as the
/// square is larger ...
const AMONG: f32 = 0.65;

/// ... up to so much of what the one that differs most says there, together with so much of what the home's
/// ring says, and of how far a blend is with supports so many times as wide: those who have a say beyond an
/// edge are few and lie side by side, and take alike for nothing what others, farther off, tell.
const SAID: f32 = 0.55;
const SAID_AROUND: f32 = 0.1;
const WIDEST: f32 = 3.0;
const SAID_WIDEST: f32 = 0.6;

/// The square of a distance that is far beyond any samples.
const FAR: f32 = 1e9;

/// The least spread, as a part of the support's radius: all samples of a roof lie in a plane.
const FLAT: f32 = 0.03;

impl DeformationField<'_> {
    /// The transfer error to be expected around each sample, local units: the largest difference between its
    /// expansion and those of its neighbours, halfway, as both ends expect it. Nothing for what rounding
    /// explains, as of a rigid motion.
    ///
    /// It is an estimate of the size, not a bound: `docs/refinement.md` says how it compares with the error.
    pub fn expected_error(&self) -> Vec<f32> {
        let told = |e: Expectation| if f64::from(e.largest) < TELLING * ROUNDING { 0.0 } else { e.largest };
        if self.expected.is_empty() {
            self.around_samples(&[]).into_iter().map(told).collect()
        } else {
            self.expected.iter().copied().map(told).collect()
        }
    }

    /// Finds out what is expected around the samples, which all further estimates rest on, of a file as
    /// `info` says.
    pub fn expecting(mut self, frame: &Frame, info: &ModelInfo) -> Self {
        self.expected = self.around_samples(&[]);
        self.rounding = Rounding::for_model(frame, self.shift, info);
        self
    }

    /// How far the sample nearest to a place (local coordinates) and its neighbours disagree halfway at most,
    /// local units.
    pub fn disagreement(&self, place: Vec3) -> f32 {
        let i = self.around.samples.nearest(place) as usize;
        let halfway = |j: &u32| self.halfway(i, *j as usize, |i| self.scale_at(i));
        self.stencils.ring(i).iter().map(halfway).fold(0.0, f32::max)
    }

    /// Expects nothing between two samples whose clusters are single places, as there are no vertices. How
    /// far the transfer is off at these samples themselves counts there. One that has stayed from a larger
    /// cluster stands beside its vertex, of which this tells less: so it is for deformations that are
    /// compared with the exact map besides. The field has to be [expecting](Self::expecting).
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

    /// What is expected around all samples. Nothing is told between two that are single places; none are, if
    /// nobody says.
    pub(super) fn around_samples(&self, is_single: &[bool]) -> Vec<Expectation> {
        // A sample need not be among the neighbours of its own neighbour: both ends are told. Lengths are in
        // the order of their bits, and the largest is the same in whatever order they come.
        let samples = self.expansions.len();
        let scales: Vec<Scale> = (0..samples).into_par_iter().map(|i| self.scale_at(i)).collect();
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
        let disagreement: Vec<f32> = (0..samples).into_par_iter().map(disagreement).collect();
        drop(scales);
        let largest = largest.into_iter().map(|bits| f32::from_bits(bits.into_inner()));
        let told = |(disagreement, largest)| Expectation { disagreement, largest, left_out: 0.0 };
        disagreement.into_iter().zip(largest).map(told).collect()
    }

    /// Finds out how far samples are from where the others would have them: what is expected of vertices
    /// rests on that, too. The field has to be [expecting](Self::expecting).
    pub fn expecting_of_vertices(mut self) -> Self {
        let squares: Vec<f32> = (0..self.expected.len()).into_par_iter().map(|i| self.without(i)).collect();
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

    /// The square of how far a sample is from where the blend of its neighbours alone would have it; where
    /// none of them reaches it, what it disagrees by with them stands for that.
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

    /// How far the expansions about two samples are apart halfway between them, and more where these are so
    /// far from each other that this tells little; but for what rounding explains, which turns gradients,
    /// too.
    fn halfway(&self, i: usize, j: usize, scale_of: impl Fn(usize) -> Scale) -> f32 {
        let (one, other) = (&self.expansions[i], &self.expansions[j]);
        let (own, of_other) = (scale_of(i), scale_of(j));
        let halfway = 0.5 * (Vec3::from_array(one.center) + Vec3::from_array(other.center));
        let apart = says(one, halfway).distance(says(other, halfway));
        let rounding = TELLING as f32 * hypot([own.rounding, of_other.rounding]);
        // How far their gradients differ, as a part of their mean size: at most 2.
        let size = (own.gradient + of_other.gradient).max(f32::MIN_POSITIVE);
        let turned = 2.0 * norm(one.slope() - other.slope()) / size;
        hypot([apart, OF_TURNING * turned * (apart - rounding).max(0.0)])
    }

    /// What differences from a sample's expansion are measured by.
    fn scale_at(&self, i: usize) -> Scale {
        let gradient = norm(self.expansions[i].slope() + Mat3::IDENTITY);
        Scale { gradient, rounding: self.rounding_at(i) }
    }

    /// How far a vertex at `p`, of this home, that goes by `u`, is expected to be off; local units. The field
    /// has to be [expecting of vertices](Self::expecting_of_vertices).
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

    /// What those have to say who reach a vertex at `p`, of this home, that goes by `u`.
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

    /// What the home of a vertex at `p`, that goes by `u`, and its neighbours have to say, who need not reach
    /// it.
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
        // Of two alone nobody tells which one fails.
        let are_two = self.stencils.ring(home).len() < 2;
        HeardAround { differs: if are_two { furthest } else { differs }, wider, widest }
    }

    /// How far vertices are expected to be off by what the samples tell, each for as many vertices as it was
    /// the home of in all that was carried so far, of `vertices`; the others do not move. `None` where the
    /// method is another one, which leaves out other things. The field has to be
    /// [expecting](Self::expecting).
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
        // More samples do not mend what rounding makes.
        let beyond = self.where_beyond(of, ExpectedError::ACCEPTED, |_, e| e.largest);
        Some(ExpectedError { beyond, ..tally.sum(false) })
    }

    /// What writing the file makes of a vertex that is known exactly, local units.
    pub(super) fn written_rounding(&self, p: Vec3, u: Vec3) -> f32 {
        self.rounding.written(p, u)
    }

    /// What rounding makes at a sample.
    fn rounding_at(&self, sample: usize) -> f32 {
        self.rounding.estimate(self.around.samples.positions[sample], self.expansions[sample].displacement())
    }

    /// Where more is expected than `accepted`, a fraction of the diagonal of the model of which the samples
    /// are. The field has to be [expecting](Self::expecting).
    pub fn expected_beyond(&self, of: &SampledModel, accepted: f64) -> Option<ErrorExcess> {
        self.where_beyond(of, accepted, |i, e| hypot([e.largest, self.rounding_at(i)]))
    }

    /// The same of what `expected` makes of each sample; local units.
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

/// What those who reach a vertex have to say, each with its weight.
#[derive(Default)]
struct Heard {
    /// The sum of the weights.
    sum: f32,
    /// Squares of how far each is from what was made of them.
    spread: f32,
    /// The largest of these.
    furthest: f32,
    /// How far they and their neighbours are from where others would have them.
    left_out: f32,
    /// The largest of what they and their neighbours disagree by halfway.
    largest: f32,
    /// What the gradient across the surface leaves open.
    unresolved: f32,
    /// The sums of the samples' places relative to the vertex, and of their products.
    places: Vec3,
    products: [Vec3; 3],
}

impl Heard {
    /// Hears sample `i` on a vertex at `p` that goes by `u`.
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

    /// The square of the vertex' distance from the middle of the samples, each direction measured by how far
    /// they are spread in it, or by `least`: the distance of Mahalanobis.
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

/// What the home of a vertex and its neighbours have to say.
struct HeardAround {
    /// How far the one of the home's ring that differs second most is from what was made of the vertex: one
    /// that fails tells nothing. Of two samples in all, how far the one that differs most is.
    differs: f32,
    /// What their blends with wider supports make of it.
    wider: WideBlend,
    widest: WideBlend,
}

impl HeardAround {
    /// How far one of the blends is from what was made of the vertex.
    fn apart_by(&self, blend: &WideBlend) -> f32 {
        blend.apart().min(blend.times * self.differs)
    }
}

/// A blend with supports so many times as wide, of how far each is from what was made of a vertex.
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

    /// Adds one that is so far from it, at a vertex whose distance is `beyond`, the square as a part of that
    /// of its support's radius.
    fn add(&mut self, beyond: f32, apart: Vec3) {
        let s = (1.0 - beyond / (self.times * self.times)).max(0.0);
        self.apart += s * s * s * apart;
        self.sum += s * s * s;
    }

    /// How far all of them together are from it; nothing where nobody has a say.
    fn apart(&self) -> f32 {
        if self.sum < LEAST_WEIGHT { 0.0 } else { (self.apart / self.sum).length() }
    }
}

/// What differences from a sample's expansion are measured by.
#[derive(Clone, Copy)]
struct Scale {
    /// The norm of the deformation's gradient.
    gradient: f32,
    /// What rounding makes, local units.
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
