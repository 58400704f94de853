//! The second streaming step: every vertex of P_L passes through the deformation field, and out goes the same
//! file with other positions (and normals) (paper §5, "Streaming Deformation Reconstruction"). Several
//! deformations of the same samples share a reading of the model.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::UNIX_EPOCH;

use glam::{DVec3, Mat3};
use simod_model::input::Identity;
use simod_model::memory::Reusing;
use simod_model::object::{self, is_object};
use simod_model::output::{Disk, check_space};
use simod_model::resumable_output::{FinishedOutput, OpenedOutput, OutputPaths, ResumableOutput};
use simod_model::size::human_size;
use simod_model::target::{canonical_target, folder_of};
use simod_model::{
    Error, MAX_VERSIONS, Model, Normals, Output, Progress, Result, Rewriting, is_named_otherwise,
};
use xxhash_rust::xxh3::Xxh3Default;

use super::binding::Binding;
use super::diagnostics::{DiagnosticsFile, has_splats};
use super::expansion::Expansion;
use super::judging::BeyondTolerance;
use super::reach::check_reach;
use super::sheets::SHEET_NEIGHBOURS;
use super::transfer::{HashedModel, SurveyedVertices, Surveys, Transfer, locked, pieces_at_once};
use super::{DeformationField, ExpectedError, Method, RestGeometry, kept_geometry};
use crate::deformed_positions::DeformedPositions;
use crate::fingerprint::{VertexHash, fingerprint};
use crate::sampled_model::SampledModel;
use crate::sampling::SampleSet;

/// Revision, counted up whenever the same inputs give other bytes: an earlier program's unfinished output is
/// not gone on with then.
const REVISION: u32 = 15;

/// Most samples of a reconstruction: a home's list has at most the home, its neighbours, and those whose
/// neighbour it is, which are as many on average, and all entries are numbered by 32 bits.
const MOST_SAMPLES: usize = u32::MAX as usize / (2 * SHEET_NEIGHBOURS + 1);

/// Bytes of a sample's entries in the long lists at rest, about: neighbours, and supports that reach it.
const LISTED_AT_REST: usize = 420;

/// Most bytes of the model whose work is lost when the program is killed: see [`Reconstruction::part_bytes`].
pub const PART_BYTES: u64 = 256 << 20;

/// Largest number of parts that an output is recorded in: those of a very large model are larger.
const MAX_PARTS: u64 = 1024;

/// A deformation of the samples, and where the model that is deformed likewise goes.
#[derive(Debug, Clone, Copy)]
pub struct Version<'a> {
    /// The samples' finite positions after the deformation.
    pub deformed: &'a DeformedPositions,
    /// The file to write, which appears whole or not at all; of a model that is made of tiles a folder of as
    /// many.
    pub output: &'a Path,
    /// Path of a file with diagnostics of the surface at each vertex, likewise: a binary PLY file of the
    /// deformed positions with `displacement` (in the model's unit), `stretch_max` and `stretch_min` (1 at
    /// rest), `folded` (0 or 1), `expected_error` (how far the vertex is probably off, in the model's unit),
    /// and `expected_error_fraction` (the same as a fraction of the diagonal at rest); of splats `anisotropy`
    /// as well (how many times as long as wide a round one becomes). The numbers of a vertex without a finite
    /// position are NaN, and it is not folded.
    pub diagnostics: Option<&'a Path>,
}

/// Options of a reconstruction.
#[derive(Debug, Clone, Copy)]
pub struct Reconstruction<'a> {
    /// Method by which a vertex is carried over.
    pub method: Method,
    /// Treatment of the model's normals.
    pub normals: Normals,
    /// Whether to go on with the files of an earlier call that was killed, or stopped with `resume`, as far
    /// as they are good. Without it, these files are replaced.
    pub resume: bool,
    /// Bytes of the model after which a part of an output is on the disk, and can be relied on by a later
    /// call; more where that would be over 1024 parts.
    pub part_bytes: u64,
    /// Whether outputs are removed soon, so that nobody waits until all of them is on the disk.
    pub is_scratch: bool,
    /// File in which [`bind`](super::bind) may have kept what does not depend on the deformation. It is used
    /// if it fits.
    pub binding: Option<&'a Path>,
    /// [Gradient](super::known_gradients) of the one version's map at each sample, where it is known: by it
    /// turn the attributes that [follow](Model::following).
    pub gradients: Option<&'a [Mat3]>,
    /// Tolerance for the expected error of vertices, a fraction of the diagonal at rest: where any is
    /// expected to be off by more, or more is expected around any sample, which is looked at before, no
    /// version of the same reading is written, and the error's source is [`BeyondTolerance`]. Parts and exact
    /// images are not judged.
    pub tolerance: Option<f64>,
}

impl Default for Reconstruction<'_> {
    fn default() -> Self {
        Self {
            method: Method::default(),
            normals: Normals::default(),
            resume: false,
            part_bytes: PART_BYTES,
            is_scratch: false,
            binding: None,
            gradients: None,
            tolerance: None,
        }
    }
}

/// Count of folded samples and vertices: at these the surface is mirrored and most of the model is not, or
/// the other way round, and between them the surface doubles back. A mirror of the whole model folds nothing;
/// and where the surface is flat, nothing tells, and nothing is counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Folding {
    /// Number of folded samples.
    pub samples: u64,
    /// Position of the first folded sample, in the model's coordinates at rest.
    pub first: Option<DVec3>,
    /// Number of folded vertices, if diagnostics were asked for.
    pub vertices: Option<u64>,
}

/// Figures of a reconstruction that was done.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstructed {
    /// Vertices of the model.
    pub vertices: u64,
    /// The number of vertices that have no finite position and were left as they are.
    pub non_finite: u64,
    /// Bytes of the outputs that an earlier call wrote.
    pub taken_over: u64,
    /// Folds of the surface in each version; `None` for those that an earlier call had finished.
    pub folding: Vec<Option<Folding>>,
    /// Expected error of each version; `None` for those that an earlier call had finished, and for another
    /// method than blended jets without diagnostics. Vertices that an earlier call wrote are not counted.
    pub expected: Vec<Option<ExpectedError>>,
    /// Largest error that is expected around a sample of any version, a fraction of the diagonal; 0 where no
    /// tolerance is given, of versions that an earlier call had finished, and of exact images.
    pub around_samples: f64,
    /// The XXH3 hash of 128 bits of each output, where it came about by the way: of one file that was written
    /// as one [part](Reconstruction::part_bytes), and in which nothing was replaced in the end.
    pub hashes: Vec<Option<u128>>,
}

/// Transfers each deformation of the samples to their model and writes it to its output. Up to
/// [`MAX_VERSIONS`] of them share a reading of the model, and are in their places when it is over.
///
/// An error leaves nothing of the versions that are not in their places; but with `resume` the finished parts
/// are kept if the user cancelled or the disk is full.
///
/// Memory: a field for each version of a reading (see [`DeformationField`]), the chunks of
/// [`Model::rewrite`], and with diagnostics 48 bytes for each vertex of a chunk in flight and version, with
/// a tolerance alone 4.
///
/// # Errors
/// The model cannot be read or is not what was sampled; an output cannot be written, is written by another
/// process, is the model itself or that of another version; diagnostics, or a tolerance, are asked for with
/// `resume`; a new position does not fit its type; vertices are expected to be off by more than the
/// tolerance, and no version of the same reading is written then; the user cancelled.
pub fn reconstruct(
    sampled: &SampledModel,
    model: &dyn Model,
    versions: &[Version<'_>],
    how: &Reconstruction<'_>,
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    // Before the work begins: targets that cannot be written, or must not be.
    check_targets(model, versions, how, Some(&sampled.samples))?;
    check_number(sampled)?;
    check_reach(sampled, model, versions.iter().map(|version| version.deformed))?;
    if let Some(cost) = sampled.source.cost_of_order() {
        progress.note(&cost);
    }
    let (folding, expected) = (vec![None; versions.len()], vec![None; versions.len()]);
    let hashes = vec![None; versions.len()];
    let mut work = ReconstructionCall {
        sampled,
        model,
        how,
        progress,
        pass: Vec::new(),
        finished: Vec::new(),
        taken_over: 0,
        folding,
        expected,
        around_samples: 0.0,
        hashes,
    };
    match work.write(versions) {
        Ok(()) => Ok(Reconstructed {
            vertices: model.info().vertices,
            non_finite: sampled.source.non_finite,
            taken_over: work.taken_over,
            folding: work.folding,
            expected: work.expected,
            around_samples: work.around_samples,
            hashes: work.hashes,
        }),
        Err(error) => Err(work.stop(error, versions)),
    }
}

/// Returns an error where the lists of supports could have more entries than are numbered.
fn check_number(sampled: &SampledModel) -> Result<()> {
    if sampled.samples.len() <= MOST_SAMPLES {
        return Ok(());
    }
    Err(Error::argument(
        format!(
            "{} samples are more than the {MOST_SAMPLES} that a reconstruction lists",
            sampled.samples.len()
        ),
        "sample the model with fewer",
    ))
}

/// An error where an output is the model or two are the same, or the disk has no room for them and for the
/// lists of `samples` in files beside them, if any are still to be made.
pub(super) fn check_targets(
    model: &dyn Model,
    versions: &[Version<'_>],
    how: &Reconstruction,
    samples: Option<&SampleSet>,
) -> Result<()> {
    let targets = checked_targets(model, versions, how)?;
    let outputs = targets.iter().map(|(target, (output, needed))| (*output, folder_of(target), *needed));
    let lists = samples.and_then(|samples| {
        Some((samples.storage().folder()?, listed_bytes(samples, versions.len().min(MAX_VERSIONS))))
    });
    rooms(outputs, lists).into_iter().try_for_each(|Room { output, folder, needed, lists }| {
        check_space(output, folder, needed.saturating_add(lists)).map_err(|error| match lists {
            0 => error,
            _ => {
                let hint = format!(
                    "{}; {} of it are for temporary files, with lists of the samples",
                    error.hint(),
                    human_size(lists)
                );
                error.hinting(hint)
            }
        })
    })
}

/// Room that is needed on a disk.
#[derive(Debug, PartialEq, Eq)]
struct Room<'a> {
    /// One of the outputs there, and its folder.
    output: &'a Path,
    folder: &'a Path,
    /// Bytes of all outputs there.
    needed: u64,
    /// Bytes of lists in temporary files there.
    lists: u64,
}

/// Rooms of outputs, each with its folder and bytes, disk by disk, and on one of these that of `lists`:
/// elsewhere lists take no room from outputs, and are in memory where they find none.
fn rooms<'a>(
    outputs: impl Iterator<Item = (&'a Path, &'a Path, u64)>,
    lists: Option<(&Path, u64)>,
) -> Vec<Room<'a>> {
    let mut rooms: BTreeMap<Disk, Room<'_>> = BTreeMap::new();
    for (output, folder, needed) in outputs {
        let room = rooms.entry(Disk::of_folder(folder));
        let room = room.or_insert(Room { output, folder, needed: 0, lists: 0 });
        room.needed = room.needed.saturating_add(needed);
    }
    let room = lists.and_then(|(folder, bytes)| Some((rooms.get_mut(&Disk::of_folder(folder))?, bytes)));
    if let Some((room, bytes)) = room {
        room.lists = bytes;
    }
    rooms.into_values().collect()
}

/// Bytes of the lists that are still to be made for so many versions at a time, about.
fn listed_bytes(samples: &SampleSet, versions: usize) -> u64 {
    let of_field = size_of::<Expansion>() + size_of::<Mat3>();
    let at_rest = if RestGeometry::held(samples).is_some() { 0 } else { LISTED_AT_REST };
    ((at_rest + versions * of_field) * samples.len()) as u64
}

/// Outputs that are written, by the one name that all paths to each share, with the bytes that it needs; or
/// an error where one is the model or two are the same.
pub(super) fn checked_targets<'a>(
    model: &dyn Model,
    versions: &[Version<'a>],
    how: &Reconstruction,
) -> Result<BTreeMap<PathBuf, (&'a Path, u64)>> {
    check_resumable(versions, how)?;
    let info = model.info();
    // Three numbers take at least six bytes.
    let left_out = if how.normals == Normals::Drop && info.has_normals { 6 * info.vertices } else { 0 };
    let of_model = |output| {
        let there = OutputPaths::for_model(model, output).bytes_there(how.resume);
        model.written_bytes().saturating_sub(left_out).saturating_sub(there)
    };
    let mut targets = BTreeMap::new();
    let outputs = versions.iter().flat_map(|v| {
        let diagnostics = v.diagnostics.map(|path| (path, DiagnosticsFile::expected_bytes(model)));
        [(v.output, of_model(v.output))].into_iter().chain(diagnostics)
    });
    for (output, needed) in outputs {
        let is_model = versions.iter().any(|v| v.output == output);
        let place = OutputPaths::for_model(model, output);
        check_no_source(model, if is_model { place.files() } else { vec![output.to_owned()] })?;
        if is_model {
            check_name(model, output)?;
        }
        let target = if is_model { place.checked()? } else { canonical_target(output)? };
        if targets.insert(target, (output, needed)).is_some() {
            return Err(Error::argument(
                format!("two files go to {}", output.display()),
                "give each of them a name of its own",
            ));
        }
    }
    Ok(targets)
}

/// An error where an interrupted reconstruction cannot be gone on with.
fn check_resumable(versions: &[Version<'_>], how: &Reconstruction<'_>) -> Result<()> {
    if how.resume && versions.iter().any(|v| v.diagnostics.is_some()) {
        return Err(Error::argument(
            "diagnostics of an interrupted reconstruction cannot be gone on with",
            "leave out either --diagnostics or --resume",
        ));
    }
    if how.resume && how.tolerance.is_some() {
        return Err(Error::argument(
            "vertices that an interrupted reconstruction has written are not judged any more",
            "leave out either the tolerance or --resume",
        ));
    }
    Ok(())
}

/// An error where the output's name is that of another format than the model has.
fn check_name(model: &dyn Model, output: &Path) -> Result<()> {
    if !is_named_otherwise(model, output) {
        return Ok(());
    }
    let format = &model.info().format;
    Err(Error::argument(
        format!("{} is named as if of another format than the model: {format}", output.display()),
        format!(
            "write it with the extension .{}, and then have `simod convert` make another format of it",
            model.extensions().first().unwrap_or(&"ply")
        ),
    ))
}

/// An error where a file to write is one that the model is in.
fn check_no_source(model: &dyn Model, files: Vec<PathBuf>) -> Result<()> {
    let sources = [model.path()].into_iter().chain(model.other_files());
    let sources: BTreeSet<Identity> = sources.filter_map(Identity::from_path).collect();
    let is_source = |file: &PathBuf| Identity::from_path(file).is_some_and(|is| sources.contains(&is));
    let Some(file) = files.iter().find(|file| is_source(file)) else { return Ok(()) };
    let (what, hint) = if model.tiles().is_empty() {
        ("is the model itself", "write the deformed model to another file")
    } else {
        ("is one of the model's tiles", "write the deformed tiles to another folder")
    };
    Err(Error::argument(
        format!("{} {what}", file.display()),
        format!("{hint}; the samples belong to the original"),
    ))
}

/// A call of [`reconstruct`].
struct ReconstructionCall<'a> {
    sampled: &'a SampledModel,
    model: &'a dyn Model,
    how: &'a Reconstruction<'a>,
    progress: &'a dyn Progress,
    /// The versions that share a reading: at most [`MAX_VERSIONS`].
    pass: Vec<Begun<'a>>,
    /// Outputs that are in their places. Their journals tell a later call so, should this one be killed.
    finished: Vec<FinishedOutput>,
    taken_over: u64,
    /// The folding of each version, as far as it is known.
    folding: Vec<Option<Folding>>,
    expected: Vec<Option<ExpectedError>>,
    /// Largest error that is expected around a sample of any version so far.
    around_samples: f64,
    hashes: Vec<Option<u128>>,
}

/// A version that is being written.
struct Begun<'a> {
    number: usize,
    version: Version<'a>,
    file: ResumableOutput,
    diagnostics: Option<DiagnosticsFile>,
}

impl<'a> ReconstructionCall<'a> {
    fn write(&mut self, versions: &[Version<'a>]) -> Result<()> {
        for (number, version) in versions.iter().enumerate() {
            let key = key(self.sampled, self.model, self.how, version.deformed)?;
            let part_bytes = self.part_bytes();
            let place = OutputPaths::for_model(self.model, version.output);
            match ResumableOutput::open(&place, key, self.how.resume, part_bytes, self.progress)? {
                OpenedOutput::Unfinished(mut file) => {
                    if self.how.is_scratch {
                        file.leave_syncing();
                    }
                    let diagonal = self.sampled.bounds.diagonal();
                    let create = |path| DiagnosticsFile::create(path, self.model, diagonal);
                    let diagnostics = version.diagnostics.map(create).transpose()?;
                    self.pass.push(Begun { number, version: *version, file, diagnostics });
                }
                OpenedOutput::Finished(file) => {
                    self.taken_over += file.bytes();
                    self.finished.push(file);
                }
            }
            let is_last = number + 1 == versions.len();
            if self.pass.len() == MAX_VERSIONS || is_last {
                self.write_pass(versions.len() > 1, is_last)?;
            }
        }
        Ok(())
    }

    /// Reads the model once, for all versions of the pass, which may be the last one.
    fn write_pass(&mut self, several: bool, is_last: bool) -> Result<()> {
        if self.pass.is_empty() {
            return Ok(());
        }
        let done = self.done();
        for Begun { file, .. } in &mut self.pass {
            self.taken_over += file.go_on_after(done)?;
        }

        self.progress.begin("preparing", 0);
        let reusing = Reusing::begin();
        let around = RestGeometry::kept(self.sampled);
        let binding = self.open_binding();
        let mut fields = self.prepared_fields(&around)?;
        if binding.is_none() || self.how.tolerance.is_some() {
            // Here, on all threads of the pool, and once: homes of vertices beyond a tolerance are looked up,
            // whether a binding has them or not.
            around.cells();
        }
        drop(reusing);
        self.sampled.samples.storage().tell_refusal(self.progress);

        let of_vertices = self.rewrite_model(&fields, binding, done)?;
        self.check_tolerance(&mut fields, &of_vertices)?;
        self.pass.iter_mut().try_for_each(|begun| begun.file.complete(several))?;
        // Completing the files may have taken a while.
        self.progress.check()?;
        let vertices = self.model.info().vertices;
        let of_samples: Vec<Option<ExpectedError>> =
            fields.iter().map(|field| field.expected_of_samples(self.sampled, vertices)).collect();
        drop(fields);
        let of_vertices = of_vertices.into_iter().map(|vertices| Some(vertices?.expected));
        self.commit_pass(of_samples.into_iter().zip(of_vertices).map(<[_; 2]>::from).collect())?;
        // At last, so that it takes no room from the outputs.
        if is_last && !around.is_kept() {
            kept_geometry::keep(self.sampled, &around);
        }
        Ok(())
    }

    /// The deformation of each version of the pass, ready for vertices; what the samples tell of folds and
    /// errors is noted.
    ///
    /// # Errors
    /// More than the tolerance is expected around a sample.
    fn prepared_fields<'f>(&mut self, around: &'f RestGeometry<'f>) -> Result<Vec<DeformationField<'f>>>
    where
        'a: 'f,
    {
        let prepared = |begun: &Begun<'a>| {
            let field = field(self.sampled, self.model, self.how, around, begun.version.deformed);
            self.check_samples(&field, begun)?;
            let of_vertices = begun.diagnostics.is_some() || self.how.tolerance.is_some();
            Ok(if of_vertices { field.expecting_of_vertices() } else { field }.prepared())
        };
        let fields: Vec<DeformationField<'f>> = self.pass.iter().map(prepared).collect::<Result<_>>()?;
        for (field, begun) in fields.iter().zip(&self.pass) {
            if self.how.tolerance.is_some() {
                self.around_samples = self.around_samples.max(field.most_expected(self.sampled));
            }
            self.folding[begun.number] = Some(Folding::of_samples(field, self.sampled));
        }
        Ok(fields)
    }

    /// Streams the model through the fields to the files of the pass, after the files and pieces that are
    /// done; returns what the surveys of vertices found for each version.
    ///
    /// # Errors
    /// A file cannot be read or written, the model is not the one that was sampled, or the user cancelled.
    fn rewrite_model(
        &mut self,
        fields: &[DeformationField<'_>],
        binding: Option<Binding>,
        (files_done, pieces_done): (u64, u64),
    ) -> Result<Vec<Option<SurveyedVertices>>> {
        let mut outputs: Vec<&mut dyn Output> = Vec::new();
        let mut surveys = Vec::new();
        for Begun { file, diagnostics, .. } in &mut self.pass {
            outputs.push(file.as_output());
            surveys.push(diagnostics.as_mut());
        }
        let judging = self.how.tolerance.map(|tolerance| (tolerance, self.sampled.samples.len()));
        let transfer = Transfer {
            fields,
            frame: &self.sampled.frame,
            hash: Mutex::new(HashedModel::All(VertexHash::like(&self.sampled.source.fingerprint))),
            binding: Mutex::new(binding.zip(self.how.binding)),
            homes: Mutex::default(),
            surveys: Surveys::new(surveys, self.sampled.bounds.diagonal(), judging),
            progress: self.progress,
        };
        self.progress.begin("reconstructing", self.model.bytes_to_rewrite());
        let how = Rewriting {
            normals: self.how.normals,
            files_done,
            pieces_done,
            only: None,
            pieces_at_once: pieces_at_once(self.sampled, fields.len()),
        };
        self.model.rewrite(&mut outputs, how, &transfer, self.progress)?;
        if let HashedModel::All(hash) = &*locked(&transfer.hash)
            && hash.fingerprint() != self.sampled.source.fingerprint
        {
            return Err(self.sampled.source_changed(self.model.path()));
        }
        Ok(transfer.surveys.finish())
    }

    /// Returns an error where more than the tolerance is expected around any sample, before any vertex is
    /// looked at.
    fn check_samples(&self, field: &DeformationField<'_>, begun: &Begun<'_>) -> Result<()> {
        let Some(tolerance) = self.how.tolerance else { return Ok(()) };
        let beyond = BeyondTolerance::by_samples(begun.number, field, self.sampled, tolerance);
        beyond.map_or(Ok(()), |beyond| Err(not_written(&begun.version, beyond)))
    }

    /// Returns an error where vertices of a version of the pass are expected to be off by more than the
    /// tolerance.
    fn check_tolerance(
        &self,
        fields: &mut [DeformationField<'_>],
        of_vertices: &[Option<SurveyedVertices>],
    ) -> Result<()> {
        let Some(tolerance) = self.how.tolerance else { return Ok(()) };
        for ((begun, field), vertices) in self.pass.iter().zip(fields).zip(of_vertices) {
            let Some(vertices) = vertices.as_ref().filter(|vertices| vertices.beyond > 0) else { continue };
            let (around, worst) = (&vertices.around, vertices.expected.worst);
            let beyond = field.learn_excess(self.sampled, around, tolerance, worst);
            let Some(beyond) = beyond else { continue };
            let beyond = BeyondTolerance::by_vertices(begun.number, vertices.beyond, beyond);
            return Err(not_written(&begun.version, beyond));
        }
        Ok(())
    }

    /// Finishes the files of the pass, whose vertices are written, with the expected errors of their samples,
    /// and those of their vertices, if these were found.
    fn commit_pass(&mut self, expected: Vec<[Option<ExpectedError>; 2]>) -> Result<()> {
        for (begun, [of_samples, of_vertices]) in self.pass.iter_mut().zip(expected) {
            let Begun { number, file, diagnostics, .. } = begun;
            self.expected[*number] = match (of_vertices, of_samples) {
                (Some(vertices), Some(samples)) => Some(ExpectedError { beyond: samples.beyond, ..vertices }),
                (vertices, samples) => vertices.or(samples),
            };
            // First, as they may still fill the disk.
            if let Some(diagnostics) = diagnostics.take() {
                self.folding[*number] =
                    self.folding[*number].map(|f| Folding { vertices: Some(diagnostics.folded), ..f });
                diagnostics.commit()?;
            }
            let file = file.commit()?;
            self.hashes[*number] = file.hash();
            self.finished.push(file);
        }
        self.pass.clear();
        Ok(())
    }

    /// The binding, if there is one that is of use; why another is not is told.
    fn open_binding(&self) -> Option<Binding> {
        let path = self.how.binding?;
        Binding::open(path, self.sampled).unwrap_or_else(|why| {
            self.progress.note(&format!("{} is not used: {why}", path.display()));
            None
        })
    }

    /// Number of files, and of pieces of the next one, that every version of the pass has, and that a part
    /// ends with in each.
    fn done(&self) -> (u64, u64) {
        let mut boundaries = self.pass.iter().map(|begun| begun.file.boundaries());
        let mut common = boundaries.next().unwrap_or_default();
        for others in boundaries {
            common.retain(|done| others.binary_search(done).is_ok());
        }
        common.last().copied().unwrap_or_default()
    }

    fn part_bytes(&self) -> u64 {
        self.how.part_bytes.max(self.model.info().bytes / MAX_PARTS)
    }

    /// Ends a call that failed.
    fn stop(self, error: Error, versions: &[Version<'_>]) -> Error {
        use simod_model::ErrorKind::{Cancelled, Degenerate, Format, Io, Mismatch};
        // A fault of the content would be there the next time, too, so there is nothing to resume.
        if !self.how.resume || matches!(error.kind(), Format | Degenerate | Mismatch) {
            return error;
        }
        self.pass.into_iter().for_each(|begun| begun.file.keep());
        self.finished.into_iter().for_each(FinishedOutput::keep);
        if !matches!(error.kind(), Cancelled | Io)
            || !versions.iter().any(|v| OutputPaths::for_model(self.model, v.output).is_left())
        {
            return error;
        }
        let then = if error.kind() == Cancelled { "when you like" } else { error.hint() };
        let hint = format!("what is done is kept, --resume goes on from there: {then}");
        error.hinting(hint)
    }
}

/// Error where a version is not written, as its vertices are expected to be off by more than the tolerance.
fn not_written(version: &Version<'_>, beyond: BeyondTolerance) -> Error {
    let what = format!("{}: {beyond}, and it is not written", version.output.display());
    Error::argument(what, "give a larger tolerance, or add samples there").because(beyond)
}

/// Hash of all that determines the bytes of a version.
pub(super) fn key(
    sampled: &SampledModel,
    model: &dyn Model,
    how: &Reconstruction<'_>,
    deformed: &DeformedPositions,
) -> Result<String> {
    let source = &sampled.source;
    // The fingerprint is of the vertices alone.
    let changed = |path: &Path| {
        let time = std::fs::metadata(path).and_then(|meta| meta.modified()).ok()?;
        time.duration_since(UNIX_EPOCH).ok()
    };
    let files = || [model.path()].into_iter().chain(model.other_files());
    let changed: Vec<_> = files().map(changed).collect();
    // Of tiles, the first of these is no file, but a pattern.
    let objects = files().skip(usize::from(!model.tiles().is_empty())).filter(|path| is_object(path));
    let objects =
        objects.map(|path| Ok(object::open(path)?.version().to_owned())).collect::<Result<Vec<_>>>()?;
    let method = match how.method {
        Method::ProjectedBarycentric => 0u8,
        Method::BlendedJets => 1,
    };
    let normals = match how.normals {
        Normals::Keep => 0u8,
        Normals::Transform => 1,
        Normals::Drop => 2,
    };
    let frame = (sampled.frame.origin.to_array(), sampled.frame.scale);
    let offset = model.info().written.map(|integers| integers.offset.to_array());
    let (ranges, shift) = (&model.info().ranges, deformed.shift.to_array());
    let numbers = (REVISION, method, normals, model.info().bytes, changed, frame, offset, ranges, shift);
    let small = (env!("CARGO_PKG_VERSION"), &source.fingerprint, numbers);
    let small = postcard::to_allocvec(&small).map_err(|e| Error::unwritable("a key", e))?;
    let samples = &sampled.samples;
    let points = [&samples.positions, samples.known_normals(), &deformed.local].map(bytemuck::cast_slice);
    let contacts = samples.contacts().map(|contacts| contacts.digest().to_le_bytes());
    let contacts = contacts.as_ref().map(|digest| &digest[..]);
    let following = model.following().map(|following| following.descriptions().join("; "));
    let following = following.as_ref().map(|text| text.as_bytes());
    let known: Option<&[u8]> = how.gradients.map(bytemuck::cast_slice);
    let mut hash = Xxh3Default::new();
    for bytes in [&small[..]]
        .into_iter()
        .chain(points)
        .chain(contacts)
        .chain(following)
        .chain(known)
        .chain(objects.iter().map(String::as_bytes))
    {
        hash.update(&(bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    }
    Ok(fingerprint(hash.digest128()))
}

/// The deformation of the samples as it is transferred to the model.
pub(super) fn field<'a>(
    sampled: &SampledModel,
    model: &dyn Model,
    how: &Reconstruction<'a>,
    around: &'a RestGeometry<'a>,
    deformed: &'a DeformedPositions,
) -> DeformationField<'a> {
    let field = DeformationField::from_deformed(around, deformed, how.method);
    let mut field = field.expecting(&sampled.frame, model.info());
    field.is_of_splats = has_splats(model);
    let known = how.gradients.filter(|known| known.len() == sampled.samples.len());
    let is_smooth = known.is_some() || how.method == Method::BlendedJets;
    if is_smooth && model.following().is_some() { field.knowing(known) } else { field }
}

impl Folding {
    /// Folds as far as the samples tell.
    pub(super) fn of_samples(field: &DeformationField<'_>, sampled: &SampledModel) -> Self {
        let folds = field.folds();
        let first = folds.first.map(|i| sampled.frame.to_model(sampled.samples.positions[i]));
        Self { samples: folds.samples, first, vertices: None }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use simod_model::long_list::ListStorage;

    use super::*;

    #[test]
    fn lists_take_room_from_outputs_on_their_disk() {
        let folder = tempfile::tempdir().expect("a folder");
        let [one, other] = ["one", "other"].map(|name| {
            let path = folder.path().join(name);
            std::fs::create_dir(&path).expect("a folder");
            path
        });
        let outputs = || {
            [(Path::new("a"), one.as_path(), 5), (Path::new("b"), other.as_path(), u64::MAX - 7)].into_iter()
        };
        let room = |needed, lists| Room { output: Path::new("a"), folder: &one, needed, lists };
        assert_eq!(rooms(outputs().take(1), Some((&other, 3))), [room(5, 3)]);
        assert_eq!(rooms(outputs(), None), [room(u64::MAX - 2, 0)]);
        // Lists on a disk without outputs take nothing from these.
        assert_eq!(rooms(outputs().take(1), Some((Path::new("/proc"), 3))), [room(5, 0)]);
    }

    #[test]
    fn lists_that_are_still_to_be_made_are_counted() {
        let points = (0..100).map(|i: u16| Vec3::new(f32::from(i % 10), f32::from(i / 10), 0.0));
        let mut samples = SampleSet::new(points.collect(), Vec::new()).expect("samples");
        samples.store_lists(ListStorage::in_folder(&std::env::temp_dir()));
        let field = (size_of::<Expansion>() + size_of::<Mat3>()) as u64;
        assert_eq!(listed_bytes(&samples, 1), 100 * (420 + field));
        let _around = RestGeometry::new(&samples);
        assert_eq!(listed_bytes(&samples, 3), 300 * field);
    }
}
