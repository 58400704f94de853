//! Deformation of a model's chunks while it is streamed (paper §5, "Streaming Deformation Reconstruction"):
//! several of them at a time, on as many threads.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use glam::DVec3;
use simod_model::frame::Frame;
use simod_model::{Edit, Edited, Progress, RawChunk, Result, VertexChunk};

use super::binding::Binding;
use super::block::carry_on_this_thread;
use super::diagnostics::DiagnosticsFile;
use super::{DeformationField, Moved, VertexDiagnostics};
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
        let mut figures = self.surveys.figures(chunk.len());
        self.carry(chunk, homes.as_deref(), versions, &mut figures);
        self.surveys.keep(chunk.first, versions, figures);
        Ok(())
    }

    fn edit_normals(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        self.carry(chunk, None, versions, &mut vec![Vec::new(); versions.len()]);
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
        figures: &mut [Vec<VertexDiagnostics>],
    ) {
        for (edited, field) in versions.iter_mut().zip(self.fields) {
            edited.mirrored = field.is_mirrored();
        }
        let of_version = |(edited, figures)| -> Moved<'_> {
            let (edited, figures): (&mut Edited, &mut Vec<VertexDiagnostics>) = (edited, figures);
            let Edited { positions, normals, gradients, .. } = edited;
            Moved { positions, normals, gradients, figures }
        };
        let mut moved: Vec<Moved<'_>> = versions.iter_mut().zip(figures).map(of_version).collect();
        carry_on_this_thread(self.fields, self.frame, &chunk.positions, homes, &mut moved);
    }
}

/// The diagnostics of those versions that have any. Chunks are surveyed in any order, and written in the
/// model's.
///
/// Memory: 48 bytes for each vertex of the chunks in flight and each version with diagnostics.
pub(super) struct Surveys<'a> {
    files: Vec<Option<Mutex<&'a mut DiagnosticsFile>>>,
    /// Deformed positions of chunks that are not written yet, by their first vertices, and the diagnostics of
    /// the surface there.
    waiting: Mutex<BTreeMap<u64, Vec<Surveyed>>>,
}

type Surveyed = (Vec<DVec3>, Vec<VertexDiagnostics>);

impl<'a> Surveys<'a> {
    /// The surveys of as many versions.
    pub(super) fn new(files: impl IntoIterator<Item = Option<&'a mut DiagnosticsFile>>) -> Self {
        let files = files.into_iter().map(|file| file.map(Mutex::new)).collect();
        Self { files, waiting: Mutex::default() }
    }

    /// Lists for the diagnostics of `vertices` vertices, to be filled in, one for each version; empty for
    /// versions whose diagnostics are not written.
    pub(super) fn figures(&self, vertices: usize) -> Vec<Vec<VertexDiagnostics>> {
        let count = |file: &Option<_>| if file.is_some() { vertices } else { 0 };
        self.files.iter().map(|file| vec![VertexDiagnostics::UNKNOWN; count(file)]).collect()
    }

    /// Keeps the findings in a chunk.
    pub(super) fn keep(&self, first: u64, versions: &[Edited], figures: Vec<Vec<VertexDiagnostics>>) {
        if self.files.iter().all(Option::is_none) {
            return;
        }
        let surveyed = versions.iter().zip(figures).map(|(version, figures)| {
            (if figures.is_empty() { Vec::new() } else { version.positions.clone() }, figures)
        });
        locked(&self.waiting).insert(first, surveyed.collect());
    }

    /// Writes it.
    pub(super) fn write(&self, first: u64) -> Result<()> {
        let surveyed = locked(&self.waiting).remove(&first).unwrap_or_default();
        for (file, (positions, figures)) in self.files.iter().zip(&surveyed) {
            if let Some(file) = file {
                locked(file).write(positions, figures)?;
            }
        }
        Ok(())
    }
}

/// Content of a mutex, whatever became of the thread that held it last.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
