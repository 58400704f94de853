//! The deformation that P_S and P_S* sample, as expansions around the samples.

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use simod_model::follow;
use simod_model::frame::Frame;
use simod_model::long_list::LongList;

use super::blend::LEAST_WEIGHT;
use super::blended_jets::{Expanded, FitInput};
use super::bound::Bound;
use super::diagnostics::{Folds, VertexDiagnostics, principal_stretches};
use super::expansion::Expansion;
use super::expectation::{Expectation, Rounding};
use super::gradients::Gradients;
use super::limiter::{Limiter, outer};
use super::neighbourhood::Neighbourhood;
use super::rest_geometry::RestGeometry;
use super::stencils::Stencils;
use super::transport::{Method, Transport};
use super::unresolved::Unresolved;
use super::{across, blend, blended_jets};
use crate::deformed_positions::{DeformedPositions, are_still};

/// Ratio of distances from which on a home that does not reach a vertex is not taken for the vertex's own, as
/// other samples are that much nearer.
const MUCH_NEARER: f32 = 2.0;

/// The deformation that P_S and P_S* sample, ready to be evaluated anywhere near P_S.
///
/// Memory: about 210 bytes per sample.
pub struct DeformationField<'a> {
    pub(super) around: &'a RestGeometry<'a>,
    pub(super) deformed: &'a [Vec3],
    /// Shift that is added to all displacements, in the model's unit.
    pub(super) shift: DVec3,
    pub(super) method: Method,
    pub(super) gradients: Gradients,
    pub(super) stencils: Stencils<'a>,
    pub(super) expansions: LongList<Expansion>,
    pub(super) limiter: Limiter,
    pub(super) bound: Bound,
    /// Whether the deformation moves anything at vertices that have each sample as their home.
    pub(super) active: Vec<bool>,
    pub(super) folds: Folds,
    /// Expected error around each sample, if [that was asked for](Self::expecting).
    pub(super) expected: Vec<Expectation>,
    /// Error that the gradient across the surface leaves open at each sample, if
    /// [vertices](Self::expecting_of_vertices) ask for it.
    pub(super) unresolved: Vec<Unresolved>,
    pub(super) rounding: Rounding,
    /// The expansions whose gradients turn numbers; empty unless [smooth ones](Self::knowing) are asked for.
    pub(super) turning: LongList<Expansion>,
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
        let Expanded { mut expansions, troubled } =
            blended_jets::expand(samples, &stencils, deformed, &gradients);
        let storage = samples.storage();
        let supported = |(e, radius): (&mut Expansion, &f32)| {
            storage.gone_through(size_of_val(e));
            e.inverse_square = (1.0 / (radius * radius)).min(Expansion::NO_SUPPORT);
            !e.is_still()
        };
        let moves: Vec<bool> = expansions.par_iter_mut().zip(&supports.radius).map(supported).collect();
        let reached = |home| supports.of_home(home).iter().any(|r| moves[r.sample as usize]);
        let active = storage.counted(samples.len(), supports.bytes_of(1));
        let active = active.map(|home| moves[home] || reached(home)).collect();
        let limiter = Limiter::new(supports, &expansions, &troubled, storage);
        let bound = Bound::new(samples, sheets, deformed);
        let neighbours = |i| sheets.of_sample(i);
        let folds = Folds::new(&expansions, &gradients.tells_side, samples.normals(), neighbours, storage);
        Self {
            around,
            deformed,
            shift: DVec3::ZERO,
            method,
            gradients,
            stencils,
            expansions,
            limiter,
            bound,
            active,
            folds,
            expected: Vec::new(),
            unresolved: Vec::new(),
            rounding: Rounding::default(),
            turning: LongList::default(),
        }
    }

    /// Prepares the field of samples that may all have gone far.
    ///
    /// # Panics
    /// The number of deformed positions is not that of the samples.
    pub fn from_deformed(
        around: &'a RestGeometry<'a>,
        deformed: &'a DeformedPositions,
        method: Method,
    ) -> Self {
        Self { shift: deformed.shift, ..Self::new(around, &deformed.local, method) }
    }

    /// Position of a sample after the deformation, in the coordinates of the model with this frame.
    pub fn place(&self, frame: &Frame, sample: usize) -> DVec3 {
        frame.to_model(self.deformed[sample]) + self.shift
    }

    /// Whether no sample moves at all, and so no vertex.
    pub fn is_still(&self) -> bool {
        are_still(self.deformed, self.shift, &self.around.samples.positions)
    }

    /// Whether the deformation turns left into right as a whole.
    pub(crate) fn is_mirrored(&self) -> bool {
        self.gradients.mirrored
    }

    /// Geometry of the samples at rest.
    pub fn around(&self) -> &'a RestGeometry<'a> {
        self.around
    }

    /// Folds of the surface under this deformation.
    pub fn folds(&self) -> &Folds {
        &self.folds
    }

    /// Diagnostics at a vertex of this home, at `p`, local coordinates; `scale` is the length of a local
    /// unit.
    pub(super) fn figures(&self, home: usize, p: Vec3, moved: &Transport, scale: f64) -> VertexDiagnostics {
        let Transport { displacement, gradient } = moved;
        let stretch = principal_stretches(gradient, self.around.samples.normals()[home]);
        let folded = self.folds.contains(home, gradient);
        let expected_error = if self.active[home] { self.expected_at(home, p, *displacement) } else { 0.0 };
        let whole = (displacement.as_dvec3() * scale + self.shift).length() as f32;
        let [near, expected_error] =
            [displacement.length(), expected_error].map(|x| (f64::from(x) * scale) as f32);
        let displacement = if self.shift == DVec3::ZERO { near } else { whole };
        let anisotropy = follow::anisotropy(gradient);
        VertexDiagnostics { displacement, stretch, folded, expected_error, anisotropy }
    }

    /// Copy of this field with smooth gradients for what turns: those of wider neighbourhoods, or `known`
    /// ones at the samples.
    ///
    /// Memory: 136 bytes per sample.
    pub(super) fn knowing(mut self, known: Option<&[Mat3]>) -> Self {
        self.turning = across::told(self.fit_input(), &self.expansions);
        if let Some(known) = known {
            let all = self.turning.par_iter_mut().zip(known);
            all.for_each(|(e, known)| *e = e.with_slope(*known - Mat3::IDENTITY));
        }
        self
    }

    /// Inputs to which the expansions were fitted; available until the field is [prepared](Self::prepared).
    pub(super) fn fit_input(&self) -> FitInput<'_> {
        let Self { around, stencils, deformed, gradients, .. } = self;
        FitInput { samples: around.samples, stencils, deformed, gradient: &gradients.gradient }
    }

    /// Copy of this field without what vertices need no more: the gradients and normals of the samples, but
    /// by the paper's method.
    ///
    /// Memory: 49 bytes per sample less.
    pub(super) fn prepared(mut self) -> Self {
        if self.method == Method::BlendedJets {
            self.gradients = Gradients { mirrored: self.gradients.mirrored, ..Gradients::default() };
        }
        self
    }

    /// Carries a vertex over that no support reaches, as one that lies far off the samples.
    pub(super) fn beyond(&self, home: usize, p: Vec3) -> Transport {
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

    /// Transport of a vertex that its home's support does not reach, if other samples are much nearer and
    /// their supports do. A vertex is taken for one of the home's sheet then because a tangent plane of that
    /// sheet happens to go past, as planes of the ground do by roofs that have few samples; but not where
    /// faces have told whose it is.
    pub(super) fn by_nearer_ones(&self, home: usize, p: Vec3) -> Option<Transport> {
        let samples = self.around.samples;
        let mut found = [0; blend::AROUND];
        let mut near = samples.nearest_ones(p, &mut found).map(|i| i as usize).peekable();
        let distance = |i: usize| samples.positions[i].distance(p);
        let much_nearer = near.peek().is_some_and(|first| distance(home) > MUCH_NEARER * distance(*first));
        let is_told = || samples.contacts().is_some_and(|contacts| contacts.sample_at(p).is_some());
        let (sum, moved) = (much_nearer && !is_told()).then(|| self.blended(near, p))?;
        (sum >= LEAST_WEIGHT).then_some(moved)
    }

    /// Whether the support of a vertex's home reaches the vertex.
    #[inline]
    pub(super) fn reaches(&self, home: usize, p: Vec3) -> bool {
        self.expansions[home].within(p) > 0.0
    }

    /// The blend of the expansions of these samples at a place, and the sum of their weights: as
    /// [`blend`](mod@blend) does it, for single vertices.
    pub(super) fn blended(&self, samples: impl Iterator<Item = usize>, p: Vec3) -> (f32, Transport) {
        let (mut own, mut u, mut gradient) = (None, Vec3::ZERO, Mat3::ZERO);
        let (mut sum, mut sum_slope) = (0.0, Vec3::ZERO);
        for e in samples.map(|i| &self.expansions[i]) {
            let d = p - Vec3::from_array(e.center);
            let s = (1.0 - d.length_squared() * e.inverse_square).max(0.0);
            if s == 0.0 {
                continue;
            }
            // Displacements beyond the first one's are blended, for precision.
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
