//! Deformation of a model's chunks while it is streamed (paper §5, "Streaming Deformation Reconstruction"):
//! several of them at a time, on as many threads.

use std::collections::BTreeMap;
use std::iter;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use glam::{DVec3, Vec3};
use simod_model::frame::Frame;
use simod_model::{Edit, Edited, Progress, RawChunk, Result, VertexChunk};

use super::binding::Binding;
use super::block::carry_on_this_thread;
use super::diagnostics::DiagnosticsFile;
use super::expectation::ErrorSums;
use super::judging::ExcessAround;
use super::{DeformationField, ExpectedError, Moved, VertexDiagnostics};
use crate::fingerprint::{HashedPart, VertexHash};
use crate::sampled_model::SampledModel;

/// Most pieces of vertices in no order that a thread takes at a time …
const SCATTERED_AT_ONCE: u64 = 3;

/// … and all threads and versions together, unless each has one: about 8 MB each.
const SCATTERED_PIECES: u64 = 16;

/// Number of pieces of the model that a thread takes at a time: one, or, where vertices come in no order in
/// space, so many that several are near to each other among them.
pub(super) fn pieces_at_once(sampled: &SampledModel, versions: usize) -> u64 {
    if !sampled.source.comes_in_no_order() {
        return 1;
    }
    let all = rayon::current_num_threads() * versions.max(1);
    (SCATTERED_PIECES / all as u64).clamp(1, SCATTERED_AT_ONCE)
}

/// Transfers deformations of the same samples to chunks of their model, one for each version.
pub(super) struct Transfer<'a> {
    pub(super) fields: &'a [DeformationField<'a>],
    pub(super) frame: &'a Frame,
    /// The hash of the bytes of all vertices, or of a part.
    pub(super) hash: Mutex<HashedModel>,
    /// Binding from which homes are read, if they were kept, and its file.
    pub(super) binding: Mutex<Option<(Binding, &'a Path)>>,
    /// The homes that were read of chunks in flight, by their first vertices: 4 bytes for each vertex.
    pub(super) homes: Mutex<BTreeMap<u64, Vec<u32>>>,
    pub(super) surveys: Surveys<'a>,
    pub(super) progress: &'a dyn Progress,
}

/// Hash of the vertices of the model that are read.
pub(super) enum HashedModel {
    All(VertexHash),
    Part(HashedPart),
}

impl Edit for Transfer<'_> {
    fn begin_behind(&self, vertex_bytes: u64) {
        *locked(&self.hash) = HashedModel::Part(HashedPart::new(vertex_bytes));
    }

    fn begin(&self, chunk: &RawChunk<'_>) -> Result<()> {
        match &mut *locked(&self.hash) {
            HashedModel::All(hash) => hash.update(chunk.bytes),
            HashedModel::Part(hash) => hash.update(chunk.bytes),
        }
        let mut binding = locked(&self.binding);
        let Some((known, path)) = binding.as_mut() else { return Ok(()) };
        match known.next(chunk.vertices) {
            Ok(homes) if chunk.is_edited => drop(locked(&self.homes).insert(chunk.first, homes)),
            Ok(_) => {}
            Err(why) => {
                // Homes that the binding gave so far are those that would have been found without it.
                self.progress.note(&format!("{} is not used from here on: {why}", path.display()));
                *binding = None;
            }
        }
        Ok(())
    }

    fn edit(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        let homes = locked(&self.homes).remove(&chunk.first);
        let mut findings = self.surveys.findings(chunk.len());
        self.carry(chunk, homes.as_deref(), versions, &mut findings);
        self.surveys.judge(self.fields, self.frame, &chunk.positions, &findings);
        self.surveys.keep(chunk.first, versions, findings);
        Ok(())
    }

    fn edit_normals(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        let mut nothing: Vec<VertexFindings> = versions.iter().map(|_| VertexFindings::default()).collect();
        self.carry(chunk, None, versions, &mut nothing);
        Ok(())
    }

    fn end(&self, first: u64) -> Result<()> {
        self.surveys.write(first)
    }

    fn is_still(&self, version: usize) -> bool {
        self.fields.get(version).is_some_and(DeformationField::is_still)
    }
}

impl Transfer<'_> {
    /// Carries the vertices of a chunk over, in each version.
    fn carry(
        &self,
        chunk: &VertexChunk,
        homes: Option<&[u32]>,
        versions: &mut [Edited],
        findings: &mut [VertexFindings],
    ) {
        for (edited, field) in versions.iter_mut().zip(self.fields) {
            edited.mirrored = field.is_mirrored();
        }
        let of_version = |(edited, findings)| -> Moved<'_> {
            let (edited, findings): (&mut Edited, &mut VertexFindings) = (edited, findings);
            let Edited { positions, normals, gradients, .. } = edited;
            let VertexFindings { figures, expected } = findings;
            Moved { positions, normals, gradients, figures, expected }
        };
        let mut moved: Vec<Moved<'_>> = versions.iter_mut().zip(findings).map(of_version).collect();
        carry_on_this_thread(self.fields, self.frame, &chunk.positions, homes, &mut moved);
    }
}

/// Vertices of those versions that have diagnostics, or are judged. Chunks are surveyed in any order, and
/// written and summed up in the model's.
///
/// Memory: 48 bytes for each vertex of the chunks in flight and each version with diagnostics, 4 where it is
/// only judged, and 4 bytes per sample then.
pub(super) struct Surveys<'a> {
    versions: Vec<Option<Mutex<Survey<'a>>>>,
    /// Tolerance, a fraction of the diagonal, and the errors of each version's vertices that are beyond it;
    /// `None` where vertices are not judged.
    judging: Option<(f64, Vec<ExcessAround>)>,
    /// One over the model's diagonal at rest.
    inverse_diagonal: f64,
    /// Deformed positions of chunks that are not written yet, by their first vertices, and the diagnostics of
    /// the surface there.
    waiting: Mutex<BTreeMap<u64, Vec<SurveyedChunk>>>,
}

type SurveyedChunk = (Vec<DVec3>, VertexFindings);

/// Findings on the vertices of a chunk.
#[derive(Default)]
pub(super) struct VertexFindings {
    /// Diagnostics of the surface at each vertex, where these are written.
    pub figures: Vec<VertexDiagnostics>,
    /// Expected error of each vertex, in the model's unit; NaN where it has no finite position.
    pub expected: Vec<f32>,
}

/// Diagnostics of a version's vertices up to here.
struct Survey<'a> {
    file: Option<&'a mut DiagnosticsFile>,
    expected: ErrorSums,
    /// Number of those that are expected to be off by more than is accepted.
    beyond: u64,
}

/// Expected errors of all vertices of a version.
pub(super) struct SurveyedVertices {
    pub expected: ExpectedError,
    /// Number of those that are expected to be off by more than is accepted.
    pub beyond: u64,
    /// Largest of their errors around each sample, local units; empty where they are not judged.
    pub around: Vec<f32>,
}

impl<'a> Surveys<'a> {
    /// Surveys of as many versions of a model with this diagonal at rest; where there is a tolerance, a
    /// fraction of it, vertices are judged, by so many samples.
    pub(super) fn new(
        files: impl IntoIterator<Item = Option<&'a mut DiagnosticsFile>>,
        diagonal: f64,
        judging: Option<(f64, usize)>,
    ) -> Self {
        let survey = |file: Option<&'a mut DiagnosticsFile>| {
            let is_asked = file.is_some() || judging.is_some();
            is_asked.then(|| Mutex::new(Survey { file, expected: ErrorSums::default(), beyond: 0 }))
        };
        let versions: Vec<_> = files.into_iter().map(survey).collect();
        let around = |samples| versions.iter().map(|_| ExcessAround::new(samples)).collect();
        let judging = judging.map(|(accepted, samples)| (accepted, around(samples)));
        let inverse_diagonal = 1.0 / diagonal.max(f64::MIN_POSITIVE);
        Self { versions, judging, inverse_diagonal, waiting: Mutex::default() }
    }

    /// Lists for the findings on `vertices` vertices, to be filled in, those of each version; empty for
    /// versions that are not surveyed.
    pub(super) fn findings(&self, vertices: usize) -> Vec<VertexFindings> {
        let of_version = |survey: &Option<Mutex<Survey<'_>>>| {
            let count = |is_asked: bool| if is_asked { vertices } else { 0 };
            VertexFindings {
                figures: vec![VertexDiagnostics::UNKNOWN; count(is_written(survey))],
                expected: vec![0.0; count(survey.is_some())],
            }
        };
        self.versions.iter().map(of_version).collect()
    }

    /// Notes which vertices of a chunk are expected to be off by more than is accepted.
    fn judge(
        &self,
        fields: &[DeformationField<'_>],
        frame: &Frame,
        rest: &[DVec3],
        findings: &[VertexFindings],
    ) {
        let Some((_, around)) = &self.judging else { return };
        for ((field, findings), around) in fields.iter().zip(findings).zip(around) {
            let beyond =
                rest.iter().zip(&findings.expected).filter(|(_, expected)| self.is_beyond(**expected));
            let local = |length: f32| (f64::from(length) / frame.scale) as f32;
            let noted: Vec<(Vec3, f32)> =
                beyond.map(|(rest, expected)| (frame.to_local(*rest), local(*expected))).collect();
            around.note(field, &noted);
        }
    }

    fn is_beyond(&self, expected: f32) -> bool {
        let expected = f64::from(expected) * self.inverse_diagonal;
        self.judging.as_ref().is_some_and(|(accepted, _)| expected > *accepted)
    }

    /// Keeps the findings in a chunk.
    pub(super) fn keep(&self, first: u64, versions: &[Edited], findings: Vec<VertexFindings>) {
        if self.versions.iter().all(Option::is_none) {
            return;
        }
        let surveyed =
            versions.iter().zip(findings).zip(&self.versions).map(|((version, findings), survey)| {
                (if is_written(survey) { version.positions.clone() } else { Vec::new() }, findings)
            });
        locked(&self.waiting).insert(first, surveyed.collect());
    }

    /// Writes the diagnostics of a chunk, and sums them up.
    pub(super) fn write(&self, first: u64) -> Result<()> {
        let surveyed = locked(&self.waiting).remove(&first).unwrap_or_default();
        for (survey, (positions, VertexFindings { figures, expected })) in self.versions.iter().zip(&surveyed)
        {
            let Some(survey) = survey else { continue };
            let mut survey = locked(survey);
            for expected in expected {
                survey.expected.add(f64::from(*expected) * self.inverse_diagonal, 1);
                survey.beyond += u64::from(self.is_beyond(*expected));
            }
            if let Some(file) = &mut survey.file {
                file.write(positions, figures, expected)?;
            }
        }
        Ok(())
    }

    /// Sums for the vertices of each version, all of which are written.
    pub(super) fn finish(self) -> Vec<Option<SurveyedVertices>> {
        let around = self.judging.map_or_else(Vec::new, |(_, around)| around);
        let around = around.into_iter().map(ExcessAround::into_lengths).chain(iter::repeat(Vec::new()));
        let of_version = |(survey, around): (Option<Mutex<Survey<'_>>>, Vec<f32>)| {
            let Survey { expected, beyond, .. } =
                survey?.into_inner().unwrap_or_else(PoisonError::into_inner);
            Some(SurveyedVertices { expected: expected.sum(true), beyond, around })
        };
        self.versions.into_iter().zip(around).map(of_version).collect()
    }
}

/// Whether a version's diagnostics are written.
fn is_written(survey: &Option<Mutex<Survey<'_>>>) -> bool {
    survey.as_ref().is_some_and(|survey| locked(survey).file.is_some())
}

/// Content of a mutex, whatever became of the thread that held it last.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
