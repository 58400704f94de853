//! Doing a unit of a plan.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Mat3;
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::{
    Part, Reconstructed, Reconstruction, SharedTarget, Version, abort_object, begin_object, choose_offset,
    join_parts, reconstruct, write_part,
};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::divided::{
    UnitDivision, cluster, cluster_shared, merge_counts, sample_clustered, shared,
};
use simod_core::sampling::divided_faces::{self, FaceFiles};
use simod_core::sampling::{Sampling, count, face_runs, sample_counted};
use simod_model::claim::Claim;
use simod_model::object::{self, is_object};
use simod_model::resumable_output::OutputPaths;
use simod_model::{
    Cache, Conversion, Converted, Error, ErrorKind, Model, Normals, Progress, Result, input,
    is_named_otherwise, output,
};

use super::graph::{
    COUNTS, CUT, DEFORMED, FACE_RUNS, GRADIENTS, LONGEST_ID, Plan, REFINED, SAMPLED, SHARED, SHARED_TILES,
    UPLOAD,
};
use super::make::skipped;
use super::units::{FINISHED, Stage, Unit, check_before, hash_of, unit_of};
use crate::deformer::Message;
use crate::edit::{Refinements, turning_gradients};
use crate::pipeline::{DeformedSamples, deform, note_losses, open, sampled_of, sampling_of};
use crate::plugins::PluginRegistry;
use crate::session_file::SessionFile;
use crate::stack::Stack;

/// Longest file of gradients: of 2³² samples.
const LONGEST: u64 = 1 << 38;

/// The report of a unit.
#[derive(Default)]
pub struct UnitDone {
    /// The unit was done before, and nothing had to be.
    pub was_done: bool,
    /// Messages of the plugins.
    pub messages: Vec<Message>,
    /// Number of vertices in cells that ranges share, once that is known.
    pub shared_vertices: Option<u64>,
    /// Report on the model that was written, by the last unit.
    pub written: Option<Reconstructed>,
}

/// Does a unit of the plan in a folder. Work that is done already is not done again.
///
/// # Errors
/// There is no such unit, or one that has to be done before was not; the session or the model is not what it
/// was; what other units wrote is damaged; and as of the parts of a [`Run`](crate::Run).
pub fn do_unit(
    plan: &Plan,
    (folder, number): (&Path, usize),
    plugins: &PluginRegistry,
    progress: &dyn Progress,
) -> Result<UnitDone> {
    let unit = unit_of(plan.units(), (folder, number))?;
    let work = UnitRun { plan, unit, folder, progress };
    // Parts are checked where they are found, and the files that they were made of may be gone once all is
    // done.
    let checks_itself = matches!(
        unit.stage,
        Stage::Count | Stage::Cluster | Stage::ClusterShared | Stage::Members | Stage::Faces | Stage::Apply
    );
    let is_finished = folder.join(FINISHED).is_file();
    if is_finished && matches!(unit.stage, Stage::Finish | Stage::Write) {
        // The process that did it may have been killed before it had tidied.
        work.tidy();
    }
    if is_finished || (!checks_itself && folder.join(&unit.writes).is_file()) {
        return Ok(UnitDone { was_done: true, ..UnitDone::default() });
    }
    check_before(plan.units(), unit, folder)?;
    match unit.stage {
        Stage::Count => work.count(),
        Stage::FaceRuns => work.face_runs(),
        Stage::Merge => work.merge(plugins),
        Stage::Cluster | Stage::ClusterShared => work.cluster(plugins),
        Stage::Cut if plan.divides_faces() => work.cut(plugins),
        Stage::Members | Stage::Faces => work.faces(plugins),
        Stage::Cut | Stage::Complete | Stage::Sample => work.sample(plugins),
        Stage::Deform => work.deform(plugins),
        Stage::Apply => work.apply(),
        Stage::Finish => work.finish(),
        Stage::Write => work.write(),
        Stage::Method | Stage::Page => Err(Error::internal("no session has such a unit")),
    }
}

struct UnitRun<'a> {
    plan: &'a Plan,
    unit: &'a Unit,
    folder: &'a Path,
    progress: &'a dyn Progress,
}

impl UnitRun<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn count(&self) -> Result<UnitDone> {
        let session = self.session()?;
        let model = self.open(&session, &Arc::new(Cache::nameless(self.folder)))?;
        let vertices = self.unit.vertices.clone().unwrap_or_default();
        let target = (vertices, &*self.at_own());
        let did = count(&*model, &Sampling::from(session.sampling), target, self.progress)?;
        Ok(UnitDone { was_done: !did, ..UnitDone::default() })
    }

    /// Session, and the options for sampling its model.
    fn sampling(&self, plugins: &PluginRegistry) -> Result<(SessionFile, Sampling)> {
        let session = self.session()?;
        let stack = Stack::build(&session.steps, plugins)?;
        let sampling = sampling_of(&session, skipped(&session, &stack, self.plan.options.whole_samples));
        Ok((session, sampling))
    }

    /// Finds the starts of runs of faces.
    fn face_runs(&self) -> Result<UnitDone> {
        let session = self.session()?;
        let model = self.open(&session, &Arc::new(Cache::nameless(self.folder)))?;
        let did = face_runs::find(&*model, &self.at_own(), self.progress)?;
        Ok(UnitDone { was_done: !did, ..UnitDone::default() })
    }

    fn merge(&self, plugins: &PluginRegistry) -> Result<UnitDone> {
        let (session, sampling) = self.sampling(plugins)?;
        let model = self.open(&session, &Arc::new(Cache::nameless(self.folder)))?;
        let counted = self.plan.files_of(self.folder, Stage::Count);
        let counts = self.at_own();
        let did = merge_counts(&*model, &sampling, &counted, &counts)?;
        let division = self.division(&counts);
        let shared = shared(&*model, &sampling, &division, self.folder, self.progress)?;
        Ok(UnitDone { was_done: !did, shared_vertices: Some(shared), ..UnitDone::default() })
    }

    fn cluster(&self, plugins: &PluginRegistry) -> Result<UnitDone> {
        let (session, sampling) = self.sampling(plugins)?;
        let model = self.open(&session, &Arc::new(Cache::nameless(self.folder)))?;
        let (counts, part) = (self.path(COUNTS), self.unit.part.unwrap_or_default());
        let division = (&self.division(&counts), part);
        let (own, shared, files) = (self.at_own(), self.shared(), self.of_faces());
        let (folder, progress) = (self.folder, self.progress);
        let did = if self.unit.stage == Stage::Cluster {
            let (vertices, leaves) = (&shared[part as usize], &files.leaves[part as usize]);
            cluster(&*model, &sampling, division, (&own, vertices, leaves), folder, progress)?
        } else {
            let leaves = &files.leaves_of_groups[part as usize];
            cluster_shared(&*model, &sampling, division, &shared, (&own, leaves), folder, progress)?
        };
        Ok(UnitDone { was_done: !did, ..UnitDone::default() })
    }

    /// Makes the cut, for units that complete it.
    fn cut(&self, plugins: &PluginRegistry) -> Result<UnitDone> {
        let (session, sampling) = self.sampling(plugins)?;
        let model = self.open(&session, &Arc::new(Cache::nameless(self.folder)))?;
        let [ranges, groups] = self.clustered();
        let (counts, files, own) = (self.path(COUNTS), (&ranges[..], &groups[..]), self.at_own());
        let division = self.division(&counts);
        let did = divided_faces::cut(&*model, &sampling, &division, files, &own, self.folder, self.progress)?;
        Ok(UnitDone { was_done: !did, ..UnitDone::default() })
    }

    /// Reads a part of the faces for what they tell of the samples.
    fn faces(&self, plugins: &PluginRegistry) -> Result<UnitDone> {
        let (session, sampling) = self.sampling(plugins)?;
        let model = self.open(&session, &Arc::new(Cache::nameless(self.folder)))?;
        let counts = self.path(COUNTS);
        let part = (&self.division(&counts), self.unit.part.unwrap_or_default());
        let (files, own, progress) = (self.of_faces(), self.at_own(), self.progress);
        let files = &files.borrowed();
        let did = if self.unit.stage == Stage::Members {
            divided_faces::members(&*model, &sampling, part, files, &own, self.folder, progress)?
        } else {
            divided_faces::faces(&*model, &sampling, part, files, &own, self.folder, progress)?
        };
        Ok(UnitDone { was_done: !did, ..UnitDone::default() })
    }

    /// Files by which units tell each other about the faces.
    fn of_faces(&self) -> OfFaces {
        let ranges = 0..self.plan.files_of(self.folder, Stage::Cluster).len();
        let of = |name: &str| ranges.clone().map(|range| self.path(&format!("{name}-{range}.bin"))).collect();
        OfFaces {
            runs: self.path(FACE_RUNS),
            cut: self.path(CUT),
            leaves: of("leaves"),
            leaves_of_groups: of("group-leaves"),
            members: self.plan.files_of(self.folder, Stage::Members),
            faces: self.plan.files_of(self.folder, Stage::Faces),
        }
    }

    /// The trees of ranges, and of groups of cells.
    fn clustered(&self) -> [Vec<PathBuf>; 2] {
        [Stage::Cluster, Stage::ClusterShared].map(|stage| self.plan.files_of(self.folder, stage))
    }

    /// The division of clustering among units.
    fn division<'b>(&self, counts: &'b Path) -> UnitDivision<'b> {
        UnitDivision { counts, units: self.plan.files_of(self.folder, Stage::Cluster).len() as u64 }
    }

    /// Files of the data that each range has of cells that it shares with others.
    fn shared(&self) -> Vec<PathBuf> {
        let ranges = self.plan.files_of(self.folder, Stage::Cluster).len();
        (0..ranges).map(|range| self.path(&format!("shared-{range}.bin"))).collect()
    }

    fn sample(&self, plugins: &PluginRegistry) -> Result<UnitDone> {
        let session = self.session()?;
        let stack = Stack::build(&session.steps, plugins)?;
        let begun = SampledModel::begin(&self.path(SAMPLED))?;
        let cache = SampledModel::cache_in(&begun);
        let model = self.open(&session, &cache)?;
        let counted = self.plan.files_of(self.folder, Stage::Count);
        let counted = (!counted.is_empty()).then_some(&counted[..]);
        let skip = skipped(&session, &stack, self.plan.options.whole_samples);
        let by = |sampling: &Sampling| {
            if self.unit.stage == Stage::Sample {
                return sample_counted(&*model, sampling, counted, self.folder, self.progress);
            }
            let counts = self.path(COUNTS);
            let division = &self.division(&counts);
            if self.unit.stage == Stage::Complete {
                let files = self.of_faces();
                let (files, folder) = (&files.borrowed(), self.folder);
                return divided_faces::complete(&*model, sampling, division, files, folder, self.progress);
            }
            let [ranges, groups] = self.clustered();
            let files = (&ranges[..], &groups[..]);
            sample_clustered(&*model, sampling, division, files, self.folder, self.progress)
        };
        sampled_of(&session, &*model, skip, &cache, by, self.progress)?.save_in(begun)?;
        Ok(UnitDone::default())
    }

    fn deform(&self, plugins: &PluginRegistry) -> Result<UnitDone> {
        let session = self.session()?;
        let refines = session.steps.iter().any(|step| step.enabled && step.refines());
        let from = self.path(SAMPLED);
        let mut sampled = SampledModel::load(&from)?;
        if refines {
            sampled.hold_cells(sampled.cells_or_resample(&from, None, self.progress)?);
        }
        let mut model = sampled.open_source(None, self.progress)?;
        model.follow(&self.plan.follow())?;
        let (folder, time) = (self.folder.to_owned(), session.time.time());
        let how = Refinements { folder, time, ..Refinements::default() };
        let DeformedSamples { sampled, positions, normals, stack, messages } =
            deform(sampled, &session.steps, plugins, how, self.progress)?;
        if refines {
            sampled.save(&self.path(REFINED))?;
        }
        if let Some(known) = turning_gradients(&sampled, &stack, &*model, self.progress)? {
            let bytes = postcard::to_allocvec(&known.iter().map(Mat3::to_cols_array).collect::<Vec<_>>());
            let bytes = bytes.map_err(|e| Error::unwritable("the gradients", e))?;
            output::write_file(&self.path(GRADIENTS), &sealed(bytes))?;
        }
        self.begin_upload(&*model)?;
        // In the end, as it tells that all is there.
        sampled.write_deformed(&self.path(DEFORMED), &positions, &normals)?;
        Ok(UnitDone { messages, ..UnitDone::default() })
    }

    fn apply(&self) -> Result<UnitDone> {
        let edit = self.edit()?;
        let pieces = self.unit.pieces.clone().unwrap_or_default();
        let WritingInputs { sampled, model, deformed, .. } = &edit;
        let (own, file, upload) = (&*self.at_own(), self.output_in_the_making(), self.upload()?);
        let part = Part { pieces, own, shared: self.shared_by(&file, upload.as_deref()) };
        let did = write_part(sampled, &**model, deformed, &edit.how(), &part, self.progress)?;
        Ok(UnitDone { was_done: !did, ..UnitDone::default() })
    }

    fn finish(&self) -> Result<UnitDone> {
        let edit = self.edit()?;
        let WritingInputs { sampled, model, deformed, .. } = &edit;
        let parts = self.plan.files_of(self.folder, Stage::Apply);
        let version = Version { deformed, output: &self.plan.output, diagnostics: None };
        let (file, upload) = (self.output_in_the_making(), self.upload()?);
        let files = (&parts[..], self.shared_by(&file, upload.as_deref()));
        let written = join_parts(sampled, &**model, &version, &edit.how(), files, self.progress)
            .map_err(|e| self.give_up(e, &parts, upload.as_deref()))?;
        self.finished(&**model)?;
        self.tidy();
        Ok(UnitDone { written: Some(written), ..UnitDone::default() })
    }

    /// Begins the upload that units will send their parts by, if they will.
    fn begin_upload(&self, model: &dyn Model) -> Result<()> {
        let (_, normals) = self.plan.recorded().map_err(Error::internal)?;
        let is_divided = self.plan.units().iter().any(|unit| unit.stage == Stage::Apply);
        let is_in_place = is_divided && model.division(normals).is_some_and(|division| division.in_place);
        if is_in_place
            && self.plan.tiles.is_empty()
            && is_object(&self.plan.output)
            && self.upload()?.is_none()
        {
            let id = begin_object(&self.plan.output)?;
            output::write_file(&self.path(UPLOAD), id.as_bytes())
                .inspect_err(|_| drop(abort_object(&self.plan.output, &id)))?;
        }
        Ok(())
    }

    /// Gives up parts that do not fit the sampled model, which are of no use in any output: the parts that
    /// were sent are removed from the store, and the files that tell of them from the plan, so that units
    /// begin again with the deformation. After other errors, and for parts in files, nothing is removed.
    fn give_up(&self, e: Error, parts: &[PathBuf], upload: Option<&str>) -> Error {
        let Some(id) = upload.filter(|_| e.kind() == ErrorKind::Mismatch) else { return e };
        let output = &self.plan.output;
        for file in [self.path(DEFORMED)].iter().chain(parts) {
            drop(std::fs::remove_file(file));
        }
        match abort_object(output, id) {
            // Else it is gone on with, or aborted when the plan is made anew.
            Ok(()) => drop(std::fs::remove_file(self.path(UPLOAD))),
            Err(e) => self.progress.note(&format!("what was sent of {} stays: {e}", output.display())),
        }
        let hint =
            "make the plan again, or, if the model is what it was, do its units again from `deform` on";
        e.hinting(hint)
    }

    fn upload(&self) -> Result<Option<String>> {
        let path = self.path(UPLOAD);
        if path.exists() { input::read_text(&path, LONGEST_ID).map(Some) } else { Ok(None) }
    }

    /// Target that the parts share: `file`, or the output itself if it is an object.
    fn shared_by<'b>(&'b self, file: &'b Path, upload: Option<&'b str>) -> SharedTarget<'b> {
        upload.map_or(SharedTarget::File(file), |id| SharedTarget::Object(&self.plan.output, id))
    }

    fn write(&self) -> Result<UnitDone> {
        let mut edit = self.edit()?;
        let output = &self.plan.output;
        if self.plan.tiles.is_empty() && is_named_otherwise(&*edit.model, output) {
            let drops_normals = edit.normals == Normals::Drop;
            let how = Conversion { lossy: self.plan.options.lossy, drops_normals, ..Conversion::default() };
            let converted = Converted::new(edit.model, output, how, self.progress)?;
            note_losses(&converted, self.progress);
            edit.model = Box::new(converted);
            edit.model.follow(&self.plan.follow())?;
        }
        self.choose_offset(&mut edit)?;
        let WritingInputs { sampled, model, deformed, .. } = &edit;
        let version = Version { deformed, output, diagnostics: None };
        let written = reconstruct(sampled, &**model, &[version], &edit.how(), self.progress)?;
        self.finished(&**model)?;
        self.tidy();
        Ok(UnitDone { written: Some(written), ..UnitDone::default() })
    }

    /// Path of the output while it is made, which the units that apply the deformation share.
    fn output_in_the_making(&self) -> PathBuf {
        self.path(if self.plan.tiles.is_empty() { SHARED } else { SHARED_TILES })
    }

    /// The file that this unit writes.
    fn at_own(&self) -> PathBuf {
        self.folder.join(&self.unit.writes)
    }

    /// Session, whose content has to be the one of which the plan was made.
    fn session(&self) -> Result<SessionFile> {
        let path = &self.plan.session;
        if hash_of(path)? != self.plan.session_hash {
            return Err(self.changed(path));
        }
        let mut session = SessionFile::load(path)?;
        if self.plan.tiles.is_empty() {
            session.model = Some(self.plan.model.clone());
        } else {
            (session.model, session.tiles) = (None, self.plan.tiles.clone());
        }
        session.time = self.plan.options.time;
        Ok(session)
    }

    /// Opens the model, and checks that its size is that of the plan.
    fn open(&self, session: &SessionFile, cache: &Arc<Cache>) -> Result<Box<dyn Model>> {
        let mut model = open(session, cache, self.progress)?;
        if (model.info().bytes, model.info().vertices) != (self.plan.model_bytes, self.plan.vertices) {
            return Err(self.changed(model.path()));
        }
        model.follow(&self.plan.follow())?;
        Ok(model)
    }

    fn changed(&self, path: &Path) -> Error {
        Error::mismatch(
            format!("{} changed since the plan was made", path.display()),
            "make the plan again: `simod plan`",
        )
    }

    /// Loads the files that the units before have left for the writing of the model.
    fn edit(&self) -> Result<WritingInputs> {
        let of = if self.path(REFINED).is_dir() { REFINED } else { SAMPLED };
        let sampled = SampledModel::load(&self.path(of))?;
        let deformed = sampled.read_deformed(&self.path(DEFORMED), self.progress)?;
        let mut model = sampled.open_source(None, self.progress)?;
        model.follow(&self.plan.follow())?;
        let gradients = self.gradients(sampled.samples.len())?;
        let known = self.plan.recorded().map_err(Error::internal)?;
        let mut edit =
            WritingInputs { sampled, model, deformed, gradients, method: known.0, normals: known.1 };
        if self.unit.stage != Stage::Write {
            self.choose_offset(&mut edit)?;
        }
        Ok(edit)
    }

    fn choose_offset(&self, edit: &mut WritingInputs) -> Result<()> {
        if self.plan.options.choose_offset {
            let chosen = choose_offset(&edit.sampled, edit.model.as_mut(), [&edit.deformed])?;
            chosen.into_iter().for_each(|changed| self.progress.note(&changed));
        }
        Ok(())
    }

    fn gradients(&self, samples: usize) -> Result<Option<Vec<Mat3>>> {
        let path = self.path(GRADIENTS);
        if !path.exists() {
            return Ok(None);
        }
        let bytes = input::read(&path, LONGEST)?;
        let known = unsealed(&bytes).and_then(|bytes| postcard::from_bytes::<Vec<[f32; 9]>>(bytes).ok());
        let known = known.filter(|known| known.len() == samples).ok_or_else(|| {
            Error::format(
                format!("{} is damaged", path.display()),
                format!("remove {DEFORMED} beside it, and do the unit again that wrote both"),
            )
        })?;
        Ok(Some(known.iter().map(Mat3::from_cols_array).collect()))
    }

    /// Removes files that are not needed any more, and those that killed processes have left beside folders;
    /// a file that cannot be removed hurts nobody.
    fn tidy(&self) {
        [SAMPLED, REFINED].iter().for_each(|name| Claim::tidy(&self.path(name)));
        let parts = self.plan.files_of(self.folder, Stage::Apply);
        let [ranges, groups] = self.clustered();
        let OfFaces { leaves, leaves_of_groups, members, faces, .. } = self.of_faces();
        let of_faces = leaves.iter().chain(&leaves_of_groups).chain(&members).chain(&faces);
        let all = parts.iter().chain(&ranges).chain(&groups).chain(of_faces);
        all.chain(&self.shared())
            .chain([&self.path(UPLOAD)])
            .for_each(|file| drop(std::fs::remove_file(file)));
    }

    /// Notes in the plan's folder that the output is in its place.
    fn finished(&self, model: &dyn Model) -> Result<()> {
        let output = &self.plan.output;
        let bytes = if is_object(output) {
            object::open(output)?.bytes()
        } else {
            let files = OutputPaths::for_model(model, output).files();
            files.iter().map(|file| std::fs::metadata(file).map_or(0, |meta| meta.len())).sum()
        };
        let text = format!("output = {:?}\nbytes = {bytes}\n", self.plan.output.display().to_string());
        output::write_file(&self.path(FINISHED), text.as_bytes())
    }
}

/// The files by which units know the faces.
struct OfFaces {
    runs: PathBuf,
    cut: PathBuf,
    leaves: Vec<PathBuf>,
    leaves_of_groups: Vec<PathBuf>,
    members: Vec<PathBuf>,
    faces: Vec<PathBuf>,
}

impl OfFaces {
    fn borrowed(&self) -> FaceFiles<'_> {
        let Self { runs, cut, leaves, leaves_of_groups, members, faces } = self;
        FaceFiles { runs, cut, leaves, leaves_of_groups, members, faces }
    }
}

/// Input of the writing of the model.
struct WritingInputs {
    sampled: SampledModel,
    model: Box<dyn Model>,
    deformed: DeformedPositions,
    gradients: Option<Vec<Mat3>>,
    method: simod_core::reconstruction::Method,
    normals: Normals,
}

impl WritingInputs {
    fn how(&self) -> Reconstruction<'_> {
        Reconstruction {
            method: self.method,
            normals: self.normals,
            gradients: self.gradients.as_deref(),
            ..Reconstruction::default()
        }
    }
}

/// Bytes with their hash behind them.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let hash = xxhash_rust::xxh3::xxh3_128(&bytes).to_le_bytes();
    bytes.extend_from_slice(&hash);
    bytes
}

fn unsealed(bytes: &[u8]) -> Option<&[u8]> {
    let (content, hash) = bytes.split_last_chunk()?;
    (xxhash_rust::xxh3::xxh3_128(content) == u128::from_le_bytes(*hash)).then_some(content)
}
