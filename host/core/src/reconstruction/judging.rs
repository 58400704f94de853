//! Vertices judged by how far each is expected to be off: whether any is by more than a tolerance, and around
//! which samples those are. It is found while a model is written, or in a pass that writes nothing.

use std::fmt;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Vec3};
use simod_model::{Model, Progress, Result, for_positions};
use xxhash_rust::xxh3::xxh3_64;

use super::expectation::{ErrorExcess, ErrorSums};
use super::homes::Homes;
use super::transfer_error::TransferError;
use super::{DeformationField, ExpectedError, Moved, carry};
use crate::sampled_model::SampledModel;

/// Number of vertices that are carried over at a time, in a pass that writes nothing: so many that all
/// threads have work.
const BATCH: usize = 1 << 18;

/// Part of the accepted error from which samples tell: their lengths are rounded to single precision, and a
/// vertex may be off by hardly more than is accepted.
const ROUNDED: f64 = 0.9999;

/// Largest distance of a cluster's vertices from its sample, as a multiple of the distance between samples.
const CLUSTER: f32 = 2.0;

/// Source of an error of [`reconstruct`](super::reconstruct): vertices of a version are expected to be off
/// by more than the tolerance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeyondTolerance {
    /// Place of the version among those that were asked for.
    pub version: usize,
    /// Number of these vertices; `None` where samples told, before any vertex was looked at.
    pub vertices: Option<u64>,
    /// Excess of the samples around them.
    pub beyond: ErrorExcess,
    /// About the number of additional samples with which no more than [`ADVISED`](Self::ADVISED) of the
    /// tolerance is expected around any sample.
    pub needed: u64,
}

impl BeyondTolerance {
    /// Part of the tolerance that a refinement asks for, as density changes around refined places.
    pub const ADVISED: f64 = 0.5;

    /// Excess around the samples of a version, by what these expect, if there is any.
    pub fn by_samples(
        version: usize,
        field: &DeformationField<'_>,
        of: &SampledModel,
        tolerance: f64,
    ) -> Option<Self> {
        let beyond = field.expected_beyond(of, tolerance)?;
        let needed = field.expected_beyond(of, Self::ADVISED * tolerance).map_or(0, |all| all.needed);
        Some(Self { version, vertices: None, beyond, needed })
    }

    /// Excess around the samples of a version, by what was found at so many vertices.
    pub fn by_vertices(version: usize, vertices: u64, beyond: ErrorExcess) -> Self {
        Self { version, vertices: Some(vertices), beyond, needed: beyond.needed }
    }
}

impl fmt::Display for BeyondTolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.vertices.map_or_else(String::new, |vertices| format!("{vertices} "));
        write!(f, "{count}vertices are expected to be off by up to {:.1e}", self.beyond.worst)
    }
}

impl std::error::Error for BeyondTolerance {}

/// Largest error, around each sample, of the vertices that are off by more than a tolerance.
///
/// Memory: 4 bytes per sample.
pub(super) struct ExcessAround {
    /// Lengths in local units are in the order of their bits, and the largest is the same in whatever order
    /// they come.
    largest: Vec<AtomicU32>,
}

impl ExcessAround {
    pub(super) fn new(samples: usize) -> Self {
        Self { largest: (0..samples).map(|_| AtomicU32::new(0)).collect() }
    }

    /// Notes vertices (local coordinates) and how far they are off (local units), around the samples that
    /// have a say there.
    pub(super) fn note(&self, field: &DeformationField<'_>, found: &[(Vec3, f32)]) {
        if found.is_empty() {
            return;
        }
        let places: Vec<Vec3> = found.iter().map(|(place, _)| *place).collect();
        let homes = Homes::new(field.around).find_at(&places);
        let samples = field.around.samples;
        for ((place, off), home) in found.iter().zip(homes) {
            let home = home as usize;
            let has_say = |i: &usize| field.expansions[*i].within(*place) > 0.0;
            // Beside dense samples, those whose clusters may hold the vertex have none.
            let may_hold =
                |i: &usize| samples.positions[*i].distance(*place) < CLUSTER * samples.spacing()[*i];
            let near = samples.neighbours().nearest_to(home).iter().map(|i| *i as usize).filter(may_hold);
            for i in [home].into_iter().chain(field.around.reaching(home).filter(has_say)).chain(near) {
                self.largest[i].fetch_max(off.to_bits(), Ordering::Relaxed);
            }
        }
    }

    pub(super) fn into_lengths(self) -> Vec<f32> {
        self.largest.into_iter().map(|bits| f32::from_bits(bits.into_inner())).collect()
    }
}

/// Exact map, with the number of vertices that are compared with it.
#[derive(Clone, Copy)]
pub struct ExactSample<'a> {
    /// Number of vertices, about, which are chosen at random, the same each time.
    pub most: u64,
    /// Map that replaces points, in the model's coordinates, by their images.
    pub map: &'a dyn Fn(&mut [DVec3]) -> Result<()>,
}

/// Errors of all vertices of a model that is not written.
pub struct JudgedVertices {
    /// Expected errors, or the true ones where the exact map was asked.
    pub expected: ExpectedError,
    /// Number of vertices that are off by more than is accepted.
    pub beyond: u64,
    /// True error of those that were chosen at random, if the map is known;
    /// [`jump`](TransferError::jump) is 0.
    pub truth: Option<TransferError>,
    /// Largest error beyond that around each sample, local units.
    around: Vec<f32>,
}

/// Judges each vertex as `field`, which is [expecting of
/// vertices](DeformationField::expecting_of_vertices), carries it over, without writing anything; `accepted`
/// is a fraction of the diagonal. Where the exact map is known, it is asked at some vertices, and at those
/// that are expected to be off by more.
///
/// Memory: a chunk of the model, 76 bytes for each of 262 144 vertices, 4 bytes per sample.
///
/// # Errors
/// The model cannot be read, the exact map fails, or the user cancelled.
pub fn judge(
    model: &dyn Model,
    field: &DeformationField<'_>,
    of: &SampledModel,
    accepted: f64,
    exact: Option<ExactSample<'_>>,
    progress: &dyn Progress,
) -> Result<JudgedVertices> {
    progress.begin("judging the vertices", model.info().vertex_bytes);
    let mut judging = Judging {
        model,
        field,
        of,
        accepted,
        exact,
        sums: ErrorSums::default(),
        truth: ErrorSums::default(),
        compared: 0,
        beyond: 0,
        around: ExcessAround::new(of.samples.len()),
    };
    let (mut first, mut batch) = (0, Vec::new());
    for_positions(model, |chunk| {
        progress.check()?;
        batch.extend_from_slice(&chunk.positions);
        if batch.len() >= BATCH {
            judging.add(first, &batch)?;
            first += batch.len() as u64;
            batch.clear();
        }
        progress.advance(chunk.raw().len() as u64);
        Ok(())
    })?;
    judging.add(first, &batch)?;
    Ok(judging.finish())
}

/// Pass over the vertices of a model.
struct Judging<'a> {
    model: &'a dyn Model,
    field: &'a DeformationField<'a>,
    of: &'a SampledModel,
    accepted: f64,
    exact: Option<ExactSample<'a>>,
    sums: ErrorSums,
    truth: ErrorSums,
    /// Number of vertices that were compared with the exact map.
    compared: u64,
    beyond: u64,
    around: ExcessAround,
}

impl Judging<'_> {
    /// Judges the vertices from `first` on.
    fn add(&mut self, first: u64, rest: &[DVec3]) -> Result<()> {
        let diagonal = self.of.bounds.diagonal().max(f64::MIN_POSITIVE);
        let frame = &self.of.frame;
        let mut found = rest.to_vec();
        let mut expected = vec![0.0; rest.len()];
        let moved = Moved { expected: &mut expected, ..Moved::places(&mut found) };
        carry(std::slice::from_ref(self.field), frame, rest, None, &mut [moved]);
        let mut off: Vec<f64> = expected.iter().map(|expected| f64::from(*expected) / diagonal).collect();
        drop(expected);
        self.compare(first, rest, &found, &mut off)?;
        let is_beyond = |off: &f64| *off > self.accepted;
        off.iter().for_each(|off| self.sums.add(*off, 1));
        let noted: Vec<(Vec3, f32)> = rest
            .iter()
            .zip(&off)
            .filter(|(_, off)| is_beyond(off))
            .map(|(rest, off)| (frame.to_local(*rest), (off * diagonal / frame.scale) as f32))
            .collect();
        self.beyond += noted.len() as u64;
        self.around.note(self.field, &noted);
        Ok(())
    }

    /// Asks the exact map, if it is known, where vertices are chosen, or expected to be off by more.
    fn compare(&mut self, first: u64, rest: &[DVec3], found: &[DVec3], off: &mut [f64]) -> Result<()> {
        let Some(ExactSample { most, map }) = self.exact else { return Ok(()) };
        let info = self.model.info();
        let share = most as f64 / info.vertices.max(1) as f64;
        let is_chosen = |i: usize| {
            let number = first + i as u64;
            share >= 1.0 || xxh3_64(&number.to_le_bytes()) as f64 / (u64::MAX as f64) < share
        };
        let asked: Vec<usize> = (0..rest.len())
            .filter(|i| rest[*i].is_finite() && (is_chosen(*i) || off[*i] > self.accepted))
            .collect();
        let mut images: Vec<DVec3> = asked.iter().map(|i| rest[*i]).collect();
        map(&mut images)?;
        let diagonal = self.of.bounds.diagonal().max(f64::MIN_POSITIVE);
        for (i, image) in asked.into_iter().zip(images) {
            // What does not move is not rounded again.
            let written = if found[i] == rest[i] { found[i] } else { info.rounded(found[i]) };
            off[i] = written.distance(image) / diagonal;
            if off[i].is_nan() {
                // Numbers overflow there: nothing certifies the vertex.
                off[i] = f64::INFINITY;
            }
            if is_chosen(i) {
                self.truth.add(off[i], 1);
                self.compared += 1;
            }
        }
        Ok(())
    }

    fn finish(self) -> JudgedVertices {
        let ExpectedError { rms, p999, worst: max, .. } = self.truth.sum(true);
        let truth = TransferError { vertices: self.compared, rms, p999, max, jump: 0.0 };
        JudgedVertices {
            expected: self.sums.sum(true),
            beyond: self.beyond,
            truth: self.exact.is_some().then_some(truth),
            around: self.around.into_lengths(),
        }
    }
}

impl DeformationField<'_> {
    /// Raises the expected errors, around the samples that have a say at vertices that are off by more than
    /// is `accepted`, to those of these vertices; returns the excess, if there are such vertices.
    pub fn learn(
        &mut self,
        of: &SampledModel,
        judged: &JudgedVertices,
        accepted: f64,
    ) -> Option<ErrorExcess> {
        self.learn_excess(of, &judged.around, accepted, judged.expected.worst)
    }

    /// Largest error that is expected around a sample, a fraction of the diagonal.
    pub fn most_expected(&self, of: &SampledModel) -> f64 {
        self.expected_beyond(of, 0.0).map_or(0.0, |all| all.worst)
    }

    /// Raises the expected error around each sample (local units), and returns the excess over what is
    /// accepted (a fraction of the diagonal), with the `worst` finite one of the vertices.
    pub(super) fn learn_excess(
        &mut self,
        of: &SampledModel,
        around: &[f32],
        accepted: f64,
        worst: f64,
    ) -> Option<ErrorExcess> {
        let both = self.expected.iter_mut().zip(around);
        both.for_each(|(expected, off)| expected.largest = expected.largest.max(*off));
        let beyond = self.expected_beyond(of, ROUNDED * accepted)?;
        Some(if beyond.worst.is_finite() { ErrorExcess { worst, ..beyond } } else { beyond })
    }
}
