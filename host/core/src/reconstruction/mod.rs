//! Reconstruction: the deformation P_S → P_S* is transferred to every vertex of P_L, in one stream (paper
//! §5).
//!
//! P_S and P_S* sample an unknown map D of space. Before streaming, `sheets` finds which samples belong
//! together, `gradients` fits D's gradient at each, and `blended_jets` expands D about it to second order.
//! While streaming, `homes` finds the sample around which a vertex lies, by its position alone; `blend`
//! carries whole blocks of vertices over by the expansions around their homes, or `projected_barycentric`
//! each vertex in the paper's way; `stream` does so for the whole file. `diagnostics` says what it does to
//! the surface, and `expected_error` how far it is probably off. Where the map of space itself is known,
//! `exact` evaluates it at each vertex instead, and [`transfer_error`] compares results with it.

mod across;
mod binding;
mod blend;
mod blended_jets;
mod block;
mod bound;
#[cfg(test)]
mod bound_tests;
mod diagnostics;
mod double_lanes;
mod eigen_lanes;
mod exact;
mod expansion;
mod expected_error;
#[cfg(test)]
mod expected_error_tests;
mod gradients;
mod homes;
mod hull;
mod lanes;
mod least_squares;
mod limiter;
mod neighbourhood;
mod packets;
mod part_file;
mod parts;
mod projected_barycentric;
mod reach;
mod scattered;
mod sheets;
mod stencils;
mod stream;
#[cfg(test)]
mod tests;
mod transfer;
pub mod transfer_error;
mod within_range;

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use crate::sampling::SampleSet;
pub(crate) use binding::MAGIC as BINDING_MAGIC;
pub use binding::bind;
use blend::{Grouped, LEAST_WEIGHT, Supports};
use blended_jets::Expanded;
use block::Workspaces;
pub(crate) use block::homes;
pub use block::{Moved, carry, carry_positions};
use bound::Bound;
pub use diagnostics::{Folds, VertexDiagnostics, principal_stretches};
pub use exact::{EVALUATIONS_WITH_GRADIENT, ExactMap, known_gradients, needs_gradient, write_exact};
use expansion::Expansion;
pub use expected_error::{Beyond, ExpectedError};
use expected_error::{Expectation, Rounding};
use gradients::Gradients;
use homes::Cells;
pub(crate) use homes::RING as TANGENT_RING;
use least_squares::Unresolved;
use limiter::{Limiter, outer};
use neighbourhood::Neighbourhood;
pub use parts::{Part, Shared, abort_object, begin_object, join_parts, write_part};
pub use reach::choose_offset;
use sheets::Sheets;
pub(crate) use sheets::{CROWDED_NEIGHBOURS, SHEET_NEIGHBOURS, sheet_distance};
pub use simod_model::Normals;
use simod_model::follow;
use stencils::Stencils;
pub use stream::{Folding, PART_BYTES, Reconstructed, Reconstruction, Version, reconstruct};

/// A home that does not reach a vertex is not its own if other samples are so many times nearer.
const MUCH_NEARER: f32 = 2.0;

/// What happens to one vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transport {
    /// From its old position to its new one, in local coordinates.
    pub displacement: Vec3,
    /// The gradient of the deformation there; normals go with its inverse transpose.
    pub gradient: Mat3,
}

impl Transport {
    /// Nothing happens.
    pub const NONE: Self = Self { displacement: Vec3::ZERO, gradient: Mat3::IDENTITY };

    /// The [normal](follow::normal) after the deformation.
    pub fn normal(&self, n: Vec3, mirrored: bool) -> Vec3 {
        follow::normal(&self.gradient, n, mirrored)
    }
}

/// The unit normals of the deformed samples: those at rest, turned as their neighbourhoods are.
pub fn deformed_normals(samples: &SampleSet, deformed: &[Vec3]) -> Vec<Vec3> {
    samples.prepare();
    Gradients::fit(samples, &Sheets::find(samples), deformed).0.normal
}

/// How a vertex is carried over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// The paper's (§5), guarded: an offset along the normal of an average plane, over a projected triangle.
    ProjectedBarycentric,
    /// A blend of second-order expansions around the nearest samples.
    #[default]
    BlendedJets,
}

/// What there is to know of the samples at rest, for all deformations of them: who is on whose sheet, and
/// whose word counts where.
///
/// Memory: about 290 bytes per sample, up to 130 more beside other sheets, and what [`SampleSet::prepare`] finds.
pub struct RestGeometry<'a> {
    samples: &'a SampleSet,
    sheets: Sheets,
    supports: Supports,
    /// What homes are found by: made when a place is first looked up, as fitting does not need it.
    cells: OnceLock<Cells>,
    workspaces: Workspaces,
    /// The number of vertices whose home each sample was.
    vertices: Vec<AtomicU64>,
}

impl<'a> RestGeometry<'a> {
    /// Finds the sheets and supports of the samples at rest.
    pub fn new(samples: &'a SampleSet) -> Self {
        samples.prepare();
        let sheets = Sheets::find(samples);
        let supports = Supports::new(samples, &sheets);
        Self::known(samples, sheets, supports)
    }

    /// Whether a sample is on the sheet of another.
    pub(crate) fn share_sheet(&self, i: usize, j: u32) -> bool {
        i as u32 == j
            || self.sheets.of_sample(i).contains(&j)
            || self.sheets.of_sample(j as usize).contains(&(i as u32))
    }

    /// The sample nearest to a local place of this home, among those on the home's sheet; the first of those
    /// that are equally near.
    pub(crate) fn nearest_on_sheet(&self, home: u32, p: Vec3) -> u32 {
        let distance = |i: u32| self.samples.positions[i as usize].distance_squared(p);
        let near = self.sheets.of_sample(home as usize).iter().map(|i| (distance(*i), *i));
        let nearer = |a: (f32, u32), b: (f32, u32)| if b < a { b } else { a };
        near.fold((distance(home), home), nearer).1
    }

    /// The samples whose supports reach where one is the home.
    fn reaching(&self, home: usize) -> impl Iterator<Item = usize> {
        self.supports.of_home(home).iter().map(|r| r.sample as usize)
    }

    /// What was found out before.
    fn known(samples: &'a SampleSet, sheets: Sheets, supports: Supports) -> Self {
        let vertices = (0..samples.len()).map(|_| AtomicU64::new(0)).collect();
        Self {
            samples,
            sheets,
            supports,
            cells: OnceLock::new(),
            workspaces: Workspaces::default(),
            vertices,
        }
    }

    fn cells(&self) -> &Cells {
        match self.cells.get() {
            Some(cells) => cells,
            // Jobs of the thread pool make them: no other one may wait for that.
            None => {
                let cells = Cells::build(self.samples, &self.supports.radius);
                self.cells.get_or_init(|| cells)
            }
        }
    }

    /// Counts vertices that were carried around homes.
    fn count(&self, grouped: &Grouped) {
        let count = |home: u32, vertices: usize| {
            self.vertices[home as usize].fetch_add(vertices as u64, Ordering::Relaxed);
        };
        grouped.groups.iter().for_each(|(home, vertices)| count(*home, vertices.len()));
        grouped.scattered.iter().for_each(|home| count(*home, 1));
    }

    /// The number of vertices so far of which the sample was the home, where anything moves.
    fn vertices_of(&self, sample: usize) -> u64 {
        self.vertices[sample].load(Ordering::Relaxed)
    }
}

/// The deformation that P_S and P_S* sample, ready to be evaluated anywhere near P_S.
///
/// Memory: about 240 bytes per sample.
pub struct DeformationField<'a> {
    around: &'a RestGeometry<'a>,
    deformed: &'a [Vec3],
    method: Method,
    gradients: Gradients,
    stencils: Stencils<'a>,
    expansions: Vec<Expansion>,
    unresolved: Vec<Unresolved>,
    limiter: Limiter,
    bound: Bound,
    /// Whether anything moves around the sample as a home.
    active: Vec<bool>,
    folds: Folds,
    /// What is expected around each sample, if [that was asked for](Self::expecting).
    expected: Vec<Expectation>,
    rounding: Rounding,
    /// The expansions whose gradients turn numbers; empty unless [smooth ones](Self::knowing) are asked for.
    turning: Vec<Expansion>,
}

impl<'a> DeformationField<'a> {
    /// Prepares the field. `deformed` holds the finite local position of each sample after the deformation.
    ///
    /// # Panics
    /// The number of deformed positions is not that of the samples.
    pub fn new(around: &'a RestGeometry<'a>, deformed: &'a [Vec3], method: Method) -> Self {
        let RestGeometry { samples, sheets, supports, .. } = around;
        assert_eq!(samples.len(), deformed.len(), "P_S* corresponds to P_S one to one");
        let (gradients, stencils) = Gradients::fit(samples, sheets, deformed);
        let Expanded { mut expansions, unresolved, doubtful } =
            blended_jets::expand(samples, &stencils, deformed, &gradients);
        let supported = |(e, radius): (&mut Expansion, &f32)| {
            e.inverse_square = (1.0 / (radius * radius)).min(Expansion::NO_SUPPORT);
            !e.is_still()
        };
        let moves: Vec<bool> = expansions.par_iter_mut().zip(&supports.radius).map(supported).collect();
        let reached = |home| supports.of_home(home).iter().any(|r| moves[r.sample as usize]);
        let active = (0..samples.len()).into_par_iter().map(|home| moves[home] || reached(home)).collect();
        let limiter = Limiter::new(supports, &expansions, &doubtful);
        let bound = Bound::new(samples, sheets, &expansions);
        let neighbours = |i| sheets.of_sample(i);
        let folds = Folds::of(&expansions, &gradients.tells_side, samples.normals(), neighbours);
        Self {
            around,
            deformed,
            method,
            gradients,
            stencils,
            expansions,
            unresolved,
            limiter,
            bound,
            active,
            folds,
            expected: Vec::new(),
            rounding: Rounding::default(),
            turning: Vec::new(),
        }
    }

    /// Local position of each sample after the deformation.
    pub fn deformed(&self) -> &'a [Vec3] {
        self.deformed
    }

    /// Whether no sample moves at all, and so no vertex.
    pub fn is_still(&self) -> bool {
        let bits = |p: &Vec3| p.to_array().map(f32::to_bits);
        self.deformed.iter().map(bits).eq(self.around.samples.positions.iter().map(bits))
    }

    /// Whether it turns left into right as a whole.
    pub(crate) fn is_mirrored(&self) -> bool {
        self.gradients.mirrored
    }

    /// What is known of the samples at rest.
    pub fn around(&self) -> &'a RestGeometry<'a> {
        self.around
    }

    /// Where it folds the surface.
    pub fn folds(&self) -> &Folds {
        &self.folds
    }

    /// What becomes of the surface at a vertex of this home, at `p`, local coordinates; `scale` is the length
    /// of a local unit.
    fn figures(&self, home: usize, p: Vec3, moved: &Transport, scale: f64) -> VertexDiagnostics {
        let Transport { displacement, gradient } = moved;
        let stretch = principal_stretches(gradient, self.around.samples.normals()[home]);
        let folded = self.folds.contains(home, gradient);
        let expected_error = if self.active[home] { self.expected_at(home, p, *displacement) } else { 0.0 };
        let [displacement, expected_error] =
            [displacement.length(), expected_error].map(|x| (f64::from(x) * scale) as f32);
        let anisotropy = follow::anisotropy(gradient);
        VertexDiagnostics { displacement, stretch, folded, expected_error, anisotropy }
    }

    /// The same, with smooth gradients for what turns: by what wider neighbourhoods tell, and with those at the
    /// samples known, if they are.
    ///
    /// Memory: 136 bytes per sample.
    pub(super) fn knowing(mut self, known: Option<&[Mat3]>) -> Self {
        let Self { around, stencils, deformed, gradients, expansions, .. } = &self;
        let exact = |(e, known): (&Expansion, &Mat3)| e.with_slope(*known - Mat3::IDENTITY);
        let told = across::told(around.samples, stencils, deformed, &gradients.gradient, expansions);
        self.turning = match known {
            Some(known) => told.iter().zip(known).map(exact).collect(),
            None => told,
        };
        self
    }

    /// Carries a vertex over that no support reaches, as one that lies far off the samples.
    fn beyond(&self, home: usize, p: Vec3) -> Transport {
        let around = Neighbourhood::gather(self.around, home, blended_jets::BLENDED, p);
        let (mut displacement, mut gradient, mut sum) = (Vec3::ZERO, Mat3::ZERO, 0.0);
        for &(i, w) in around.weighted() {
            let i = i as usize;
            let d = p - Vec3::from_array(self.expansions[i].center);
            let (u, slope) = self.limiter.beyond(&self.expansions, i, d);
            displacement += w * u;
            gradient += w * slope;
            sum += w;
        }
        Transport { displacement: displacement / sum, gradient: Mat3::IDENTITY + gradient * (1.0 / sum) }
    }

    /// Where a vertex goes that its home's support does not reach, if other samples are much nearer and
    /// theirs do. A sheet is taken for its own then because a tangent plane of it happens to go past, as
    /// planes of the ground do by roofs that have few samples.
    fn by_nearer_ones(&self, home: usize, p: Vec3) -> Option<Transport> {
        let samples = self.around.samples;
        let mut found = [0; blend::AROUND];
        let mut near = samples.nearest_ones(p, &mut found).map(|i| i as usize).peekable();
        let distance = |i: usize| samples.positions[i].distance(p);
        let much_nearer = near.peek().is_some_and(|first| distance(home) > MUCH_NEARER * distance(*first));
        let (sum, moved) = much_nearer.then(|| self.blended(near, p))?;
        (sum >= LEAST_WEIGHT).then_some(moved)
    }

    /// Whether the support of its home reaches a vertex.
    #[inline]
    fn reaches(&self, home: usize, p: Vec3) -> bool {
        self.expansions[home].within(p) > 0.0
    }

    /// The blend of the expansions of these samples at a place, and the sum of their weights: as
    /// [`blend`](mod@blend) does it, for single vertices.
    fn blended(&self, samples: impl Iterator<Item = usize>, p: Vec3) -> (f32, Transport) {
        let (mut own, mut u, mut gradient) = (None, Vec3::ZERO, Mat3::ZERO);
        let (mut sum, mut sum_slope) = (0.0, Vec3::ZERO);
        for e in samples.map(|i| &self.expansions[i]) {
            let d = p - Vec3::from_array(e.center);
            let s = (1.0 - d.length_squared() * e.inverse_square).max(0.0);
            if s == 0.0 {
                continue;
            }
            // Beyond the first one's, for precision.
            let own = *own.get_or_insert(e.displacement());
            let (at, slope) = e.evaluate(d);
            let (w, of_weight) = (s * s * s, -6.0 * s * s * e.inverse_square * d);
            u += w * (at - own);
            gradient += slope * w + outer(at - own, of_weight);
            sum += w;
            sum_slope += of_weight;
        }
        let displacement = own.unwrap_or_default() + u / sum;
        let gradient = Mat3::IDENTITY + (gradient - outer(u / sum, sum_slope)) * (1.0 / sum);
        (sum, Transport { displacement, gradient })
    }
}
