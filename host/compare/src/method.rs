//! One method from the model to the deformed model, with its times and its memory.

use crate::clock::Clock;
use crate::external::{self, Files, Ran, write_given};
use crate::file::{CompareFile, ComparedMethod, MethodWork, ProgramMethod};
use crate::lengths::WithLengths;
use crate::record::{DeformationRecord, Figures, MethodRecord, ResultFile, RunSeconds, Seconds, words};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::transfer_error::{self, TransferError};
use simod_core::reconstruction::{ExpectedError, Reconstruction, RestGeometry, Version, reconstruct};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::Skip;
use simod_model::memory::MemoryWatch;
use simod_model::resumable_output::OutputPaths;
use simod_model::{Cache, Error, ErrorKind, Model, Progress, Result, processor};
use simod_session::deformer::Message;
use simod_session::edit::{Refinements, turning_gradients};
use simod_session::pipeline::{DeformedSamples, deform, sampled};
use simod_session::plugins::PluginRegistry;
use simod_session::session_file::{SamplingTable, SessionFile, read_text};
use simod_session::stack::{PreparedStack, Stack};
use simod_session::step::{Action, Deformation, Role, Step};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use xxhash_rust::xxh3::Xxh3Default;

/// Bench where methods are done, with the samplings that they share.
pub(crate) struct Bench<'a> {
    file: &'a CompareFile,
    plugins: &'a PluginRegistry,
    folder: &'a Path,
    cache: Arc<Cache>,
    samplings: Vec<TakenSampling>,
    /// Whether a method refines: then samplings keep their cells.
    refines: bool,
    /// Whether the deformed models are measured by this process, and go with it.
    is_scratch: bool,
}

/// A sampling that was done.
struct TakenSampling {
    of: SamplingTable,
    sampled: Arc<SampledModel>,
    seconds: f64,
    /// Rest geometry of the samples, as the first method that was transferred computed it.
    found: OnceLock<PreparedRest>,
}

/// Cost of the samples' rest geometry, which reconstructions need.
struct PreparedRest {
    seconds: f64,
    processor: Option<f64>,
}

impl PreparedRest {
    fn new(sampled: &SampledModel) -> Self {
        let (start, processor) = (Instant::now(), processor::seconds());
        RestGeometry::new(&sampled.samples).prepare();
        Self { seconds: start.elapsed().as_secs_f64(), processor: since(processor) }
    }
}

/// A method that was done, as far as it is kept to be compared.
pub(crate) struct Deformed {
    /// Beginning of the names of the method's files.
    pub name: String,
    pub sampled: Arc<SampledModel>,
    /// Positions of the samples; nothing where the method deforms none.
    pub positions: Option<DeformedPositions>,
    /// The deformed model.
    pub output: PathBuf,
    /// Whether the output was made here, and not by the user before.
    pub is_ours: bool,
}

/// A method that was begun.
pub(crate) enum BegunMethod<'a> {
    Finished(Box<Deformed>),
    /// The method whose samples were deformed, and are still to be transferred.
    Untransferred(Box<UntransferredMethod<'a>>),
}

/// A method whose samples were deformed once, so that it can be transferred in one reading with others of its
/// kind.
pub(crate) struct UntransferredMethod<'a> {
    known: PreparedMethod<'a>,
    ready: TimedSamples,
    notices: Vec<String>,
    sample: f64,
    /// Peak memory while the samples were deformed.
    peak_memory_bytes: Option<u64>,
}

impl UntransferredMethod<'_> {
    /// Whether both methods have the same samples, and are transferred likewise.
    pub fn goes_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.ready.moved.sampled, &other.ready.moved.sampled)
            && self.known.method.reconstruction == other.known.method.reconstruction
    }
}

/// A method that was transferred.
pub(crate) struct Transferred<'a> {
    waiting: UntransferredMethod<'a>,
    once: Once,
}

/// Deformed samples, and the cost of deforming them.
struct TimedSamples {
    moved: MethodSamples,
    deform: f64,
    processor: Option<f64>,
}

impl TimedSamples {
    /// Times that the method took so far.
    fn seconds(&self) -> RunSeconds {
        let Self { moved, deform, processor } = self;
        RunSeconds {
            deform: Some(*deform),
            prepare: moved.prepare,
            motion: moved.prepare.map(|prepare| (deform - prepare).max(0.0)),
            reconstruct: None,
            processor: *processor,
        }
    }
}

/// A run of a method.
struct Once {
    sampled: Arc<SampledModel>,
    positions: Option<DeformedPositions>,
    output: PathBuf,
    /// Files of the deformed model: `output`, or the tiles there.
    files: Vec<PathBuf>,
    /// Messages of the plugins.
    messages: Vec<Message>,
    seconds: RunSeconds,
    /// Peak memory of a program of the user's.
    peak_memory_bytes: Option<u64>,
    transfer_error: Option<TransferError>,
    expected_error: Option<ExpectedError>,
    folded_samples: Option<u64>,
    /// Hash of the output, where it was computed while the output was written.
    hash: Option<u128>,
}

impl Once {
    /// Run whose deformed model, a version of `source`, was written to `output`; its deviations and its
    /// hash are not known yet.
    fn written(source: &dyn Model, output: PathBuf, moved: &MethodSamples, seconds: RunSeconds) -> Self {
        Self {
            sampled: moved.sampled.clone(),
            positions: Some(moved.positions.clone()),
            files: OutputPaths::for_model(source, &output).files(),
            output,
            messages: moved.messages.clone(),
            seconds,
            peak_memory_bytes: moved.peak_memory_bytes,
            transfer_error: None,
            expected_error: None,
            folded_samples: None,
            hash: None,
        }
    }
}

/// Samples as a method has moved them: plugins, another program or a file.
struct MethodSamples {
    sampled: Arc<SampledModel>,
    positions: DeformedPositions,
    messages: Vec<Message>,
    /// The exact map, if the plugins know it.
    stack: Option<PreparedStack>,
    prepare: Option<f64>,
    peak_memory_bytes: Option<u64>,
}

/// Method with its samples at rest and its steps, before it is done.
struct PreparedMethod<'a> {
    method: &'a ComparedMethod,
    /// Beginning of the names of the method's files.
    name: String,
    /// The steps of plugins.
    steps: Vec<Step>,
    rest: Arc<SampledModel>,
}

impl<'a> Bench<'a> {
    /// Bench without samplings; files are written to `folder`, and the model is read by `cache`.
    pub fn new(
        file: &'a CompareFile,
        plugins: &'a PluginRegistry,
        (folder, cache): (&'a Path, Arc<Cache>),
    ) -> Self {
        let refines = file.methods.iter().any(refines);
        Self { file, plugins, folder, cache, samplings: Vec::new(), refines, is_scratch: false }
    }

    /// Marks the deformed models as needed by this process alone.
    pub fn make_scratch(&mut self) {
        self.is_scratch = true;
    }

    /// Takes a sampling that was done before, and the seconds that it took.
    pub fn take(&mut self, of: SamplingTable, sampled: Arc<SampledModel>, seconds: f64) {
        self.samplings.push(TakenSampling { of, sampled, seconds, found: OnceLock::new() });
    }

    /// Does a method, as often as the file says. `record` gets its figures as soon as they are known.
    pub fn run(
        &mut self,
        method: &'a ComparedMethod,
        name: &str,
        record: &mut MethodRecord,
        progress: &dyn Progress,
    ) -> Result<Deformed> {
        let memory = MemoryWatch::start();
        let (known, notices, sample) = self.known(method, name, record, progress)?;
        self.all_runs(&known, (notices, sample, &memory), record, progress)
    }

    /// Does a method, or only deforms its samples where these may be transferred together with those of
    /// others: where the method is run once, so that no time of its own is measured over several runs.
    pub fn begin(
        &mut self,
        method: &'a ComparedMethod,
        name: &str,
        record: &mut MethodRecord,
        progress: &dyn Progress,
    ) -> Result<BegunMethod<'a>> {
        let memory = MemoryWatch::start();
        let (known, notices, sample) = self.known(method, name, record, progress)?;
        if self.file.runs > 1 || !deforms_samples(method) {
            let done = self.all_runs(&known, (notices, sample, &memory), record, progress)?;
            return Ok(BegunMethod::Finished(Box::new(done)));
        }
        let ready = self.ready(&known, progress)?;
        let peak_memory_bytes = memory.peak().max(ready.moved.peak_memory_bytes);
        Ok(BegunMethod::Untransferred(Box::new(UntransferredMethod {
            known,
            ready,
            notices,
            sample,
            peak_memory_bytes,
        })))
    }

    /// Transfers methods that go with each other, in one reading of the model. If that cannot be done, each
    /// method is transferred by itself, so that one of them does not keep the others from being done.
    pub fn transfer(
        &self,
        waiting: Vec<UntransferredMethod<'a>>,
        progress: &dyn Progress,
    ) -> Vec<Result<Transferred<'a>>> {
        let memory = MemoryWatch::start();
        let all: Vec<(&PreparedMethod<'_>, &TimedSamples)> =
            waiting.iter().map(|one| (&one.known, &one.ready)).collect();
        let transferred = match self.transferred(&all, true, progress) {
            Err(e) if e.kind() != ErrorKind::Cancelled && all.len() > 1 => {
                all.iter().map(|one| self.alone(*one, true, progress)).collect()
            }
            Err(e) => vec![Err(e)],
            Ok(done) => done.into_iter().map(Ok).collect::<Vec<_>>(),
        };
        let peak = memory.peak();
        let with = |(waiting, once): (UntransferredMethod<'a>, Result<Once>)| {
            let peak_memory_bytes = peak.map(|peak| peak.max(waiting.peak_memory_bytes.unwrap_or(0)));
            Ok(Transferred { once: once?, waiting: UntransferredMethod { peak_memory_bytes, ..waiting } })
        };
        waiting.into_iter().zip(transferred).map(with).collect()
    }

    /// Writes the figures of a method into its record.
    pub fn finish(
        &self,
        transferred: Transferred<'_>,
        record: &mut MethodRecord,
        progress: &dyn Progress,
    ) -> Result<Deformed> {
        let Transferred {
            once,
            waiting: UntransferredMethod { known, sample, notices, peak_memory_bytes, .. },
        } = transferred;
        let result = result_of(&once, progress)?;
        let runs = vec![once.seconds];
        Ok(finished(&known, once, (runs, sample, peak_memory_bytes, notices), (result, None), record))
    }

    /// A method before it is done, the notices on its plugins, and the time of its sampling in seconds.
    fn known(
        &mut self,
        method: &'a ComparedMethod,
        name: &str,
        record: &mut MethodRecord,
        progress: &dyn Progress,
    ) -> Result<(PreparedMethod<'a>, Vec<String>, f64)> {
        let steps = self.steps(method, record)?;
        let notices = self.plugins.notices(&steps);
        notices.iter().for_each(|notice| progress.note(notice));
        let stack = Stack::build(&steps, self.plugins)?;
        record.steps = stack.in_effect().map(DeformationRecord::new).collect();
        let (rest, sample) = self.sampling(method.sampling, progress)?;
        Ok((PreparedMethod { method, name: name.to_owned(), steps, rest }, notices, sample))
    }

    /// Does a method as often as the file says, each time by itself.
    fn all_runs(
        &self,
        known: &PreparedMethod<'_>,
        (notices, sample, memory): (Vec<String>, f64, &MemoryWatch),
        record: &mut MethodRecord,
        progress: &dyn Progress,
    ) -> Result<Deformed> {
        let mut first: Option<(Once, (u64, String))> = None;
        let (mut runs, mut peak, mut repeats) = (Vec::new(), None, None);
        for number in 0..self.file.runs {
            if self.file.runs > 1 {
                progress.note(&format!("{}: run {} of {}", known.method.name, number + 1, self.file.runs));
            }
            let once = self.once(known, number == 0, progress)?;
            runs.push(once.seconds);
            peak = peak.max(once.peak_memory_bytes);
            let result = result_of(&once, progress)?;
            match &first {
                Some((_, former)) => repeats = Some(repeats.unwrap_or(true) && result == *former),
                None => first = Some((once, result)),
            }
        }
        let peak = memory.peak().map(|own| own.max(peak.unwrap_or(0)));
        let Some((once, result)) = first else {
            return Err(Error::internal("a method was not run"));
        };
        Ok(finished(known, once, (runs, sample, peak, notices), (result, repeats), record))
    }

    /// Does a method once; figures that do not change from run to run are computed if `measure` says so.
    fn once(&self, known: &PreparedMethod<'_>, measure: bool, progress: &dyn Progress) -> Result<Once> {
        match &known.method.work {
            MethodWork::Model(path) => self.of_model(known, path.clone(), None, progress),
            MethodWork::Command(command) if command.makes_model() => {
                let source = known.rest.open_source(Some(&self.file.model), progress)?;
                let output = self.folder.join(file_name(&known.name, source.as_ref()));
                let processor = processor::seconds();
                let ran = self.run_program(command, known, &output, progress)?;
                let seconds = RunSeconds {
                    deform: Some(ran.seconds),
                    processor: since(processor),
                    ..RunSeconds::default()
                };
                let once = self.of_model(known, output, Some(seconds), progress)?;
                Ok(Once { peak_memory_bytes: ran.peak_memory_bytes, ..once })
            }
            _ => {
                let ready = self.ready(known, progress)?;
                self.alone((known, &ready), measure, progress)
            }
        }
    }

    /// Run of a method whose deformed model another program made.
    fn of_model(
        &self,
        known: &PreparedMethod<'_>,
        output: PathBuf,
        seconds: Option<RunSeconds>,
        progress: &dyn Progress,
    ) -> Result<Once> {
        let source = known.rest.open_source(Some(&self.file.model), progress)?;
        let made = simod_model::open_version(source.as_ref(), &output, source.columns())?;
        let (there, needed) = (made.info().vertices, source.info().vertices);
        if there != needed {
            return Err(Error::mismatch(
                format!("{} has {there} vertices, but the model has {needed}", output.display()),
                "a deformed model has the model's vertices, in the same order: switch off what merges, sorts or splits \
                 them",
            ));
        }
        Ok(Once {
            sampled: known.rest.clone(),
            positions: None,
            files: OutputPaths::for_model(source.as_ref(), &output).files(),
            output,
            messages: Vec::new(),
            seconds: seconds.unwrap_or_default(),
            peak_memory_bytes: None,
            transfer_error: None,
            expected_error: None,
            folded_samples: None,
            hash: None,
        })
    }

    /// Deforms samples.
    fn ready(&self, known: &PreparedMethod<'_>, progress: &dyn Progress) -> Result<TimedSamples> {
        let (start, processor) = (Instant::now(), processor::seconds());
        let moved = self.moved(known, progress)?;
        Ok(TimedSamples { moved, deform: start.elapsed().as_secs_f64(), processor: since(processor) })
    }

    /// Transfers one deformation of samples.
    fn alone(
        &self,
        of: (&PreparedMethod<'_>, &TimedSamples),
        measure: bool,
        progress: &dyn Progress,
    ) -> Result<Once> {
        let transferred = self.transferred(&[of], measure, progress)?.into_iter().next();
        transferred.ok_or_else(|| Error::internal("a method was not transferred"))
    }

    /// Transfers deformations of the same samples, in one reading; the time of each is an equal part of the
    /// reading's.
    fn transferred(
        &self,
        all: &[(&PreparedMethod<'_>, &TimedSamples)],
        measure: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Once>> {
        let Some((known, TimedSamples { moved: MethodSamples { sampled, .. }, .. })) = all.first() else {
            return Ok(Vec::new());
        };
        let found = self.found(sampled, progress);
        let (start, processor) = (Instant::now(), processor::seconds());
        let source = sampled.open_source(Some(&self.file.model), progress)?;
        if all.len() > 1 && source.following().is_some() {
            // Attributes that turn with the surface are turned by the gradients of one map alone.
            return all.iter().map(|one| self.alone(*one, measure, progress)).collect();
        }
        let output = |known: &PreparedMethod<'_>| self.folder.join(file_name(&known.name, source.as_ref()));
        let outputs: Vec<PathBuf> = all.iter().map(|(known, _)| output(known)).collect();
        let mut versions = Vec::new();
        for ((_, ready), output) in all.iter().zip(&outputs) {
            versions.push(Version { deformed: &ready.moved.positions, output, diagnostics: None });
        }
        let stack = all.first().and_then(|(_, ready)| ready.moved.stack.as_ref());
        let gradients = stack.map(|stack| turning_gradients(sampled, stack, source.as_ref(), progress));
        let gradients = gradients.transpose()?.flatten();
        let gradients = gradients.as_deref();
        let method = known.method.reconstruction;
        // The output is written as one part: nobody resumes a comparison, and the hash is computed on the
        // way.
        let (part_bytes, is_scratch) = (u64::MAX, self.is_scratch);
        let how = Reconstruction { method, gradients, part_bytes, is_scratch, ..Reconstruction::default() };
        let done = reconstruct(sampled, source.as_ref(), &versions, &how, progress)?;
        let part = 1.0 / all.len() as f64;
        let (seconds, used) =
            (part * start.elapsed().as_secs_f64(), since(processor).map(|used| part * used));

        let mut transferred = Vec::new();
        for (i, ((_, ready), output)) in all.iter().zip(outputs).enumerate() {
            let seconds = RunSeconds {
                reconstruct: Some(seconds + found.map_or(0.0, |found| found.seconds)),
                processor: sum([ready.processor, found.map_or(Some(0.0), |found| found.processor), used]),
                ..ready.seconds()
            };
            let exact = ready.moved.stack.as_ref().filter(|_| measure);
            let transfer_error =
                exact.map(|stack| beside_exact(source.as_ref(), &output, stack, sampled, progress));
            transferred.push(Once {
                expected_error: done.expected.get(i).cloned().flatten(),
                folded_samples: done.folding.get(i).copied().flatten().map(|f| f.samples),
                hash: done.hashes.get(i).copied().flatten(),
                transfer_error: transfer_error.transpose()?,
                ..Once::written(source.as_ref(), output, &ready.moved, seconds)
            });
        }
        Ok(transferred)
    }

    /// Rest geometry of a sampling's samples, computed once for all methods that have the sampling; nothing
    /// of samples to which a method appended some.
    fn found(&self, sampled: &Arc<SampledModel>, progress: &dyn Progress) -> Option<&PreparedRest> {
        let taken = self.samplings.iter().find(|taken| Arc::ptr_eq(&taken.sampled, sampled))?;
        Some(taken.found.get_or_init(|| {
            progress.begin("preparing", 0);
            PreparedRest::new(sampled)
        }))
    }

    /// Samples as a method has moved them.
    fn moved(&self, known: &PreparedMethod<'_>, progress: &dyn Progress) -> Result<MethodSamples> {
        let by_another = |positions: DeformedPositions, peak_memory_bytes| MethodSamples {
            sampled: known.rest.clone(),
            positions: known.rest.rounded_places(positions.places(&known.rest.frame)),
            messages: Vec::new(),
            stack: None,
            prepare: None,
            peak_memory_bytes,
        };
        match &known.method.work {
            MethodWork::Deformed(path) => Ok(by_another(known.rest.read_deformed(path, progress)?, None)),
            MethodWork::Command(command) => {
                let output = self.folder.join("given-output.ply");
                let ran = self.run_program(command, known, &output, progress)?;
                let read = known.rest.read_deformed(&output, progress);
                std::fs::remove_file(&output).map_err(|e| Error::io("remove", &output, &e))?;
                Ok(by_another(read?, ran.peak_memory_bytes))
            }
            _ => {
                let refinements = Refinements {
                    model: Some(self.file.model.clone()),
                    folder: self.folder.to_owned(),
                    ..Refinements::default()
                };
                let clock = Clock::new(progress);
                let rest = known.rest.clone();
                let done = deform(rest, &known.steps, self.plugins, refinements, &clock)?;
                let DeformedSamples { sampled, positions, messages, stack, .. } = done;
                let prepare = Some(clock.preparing());
                Ok(MethodSamples {
                    sampled,
                    positions,
                    messages,
                    // A stack that cannot evaluate is of no more use, and may be large.
                    stack: Some(stack).filter(PreparedStack::can_evaluate),
                    prepare,
                    peak_memory_bytes: None,
                })
            }
        }
    }

    /// Runs a program, with files of its own that last as long as the run.
    fn run_program(
        &self,
        command: &ProgramMethod,
        known: &PreparedMethod<'_>,
        output: &Path,
        progress: &dyn Progress,
    ) -> Result<Ran> {
        let [samples, constraints] =
            ["given-samples.ply", "given-constraints.txt"].map(|name| self.folder.join(name));
        let model = &self.file.model;
        let files = Files { samples: &samples, constraints: &constraints, model, output };
        // The output of a former run would pass for that of this one.
        if output.exists() {
            std::fs::remove_file(output).map_err(|e| Error::io("remove", output, &e))?;
        }
        write_given(command, &files, &known.rest, &self.file.regions)?;
        let ran = external::run(command, &files, progress);
        for given in [&samples, &constraints].into_iter().filter(|path| path.exists()) {
            std::fs::remove_file(given).map_err(|e| Error::io("remove", given, &e))?;
        }
        ran
    }

    /// The steps of a method.
    fn steps(&self, method: &ComparedMethod, record: &mut MethodRecord) -> Result<Vec<Step>> {
        match &method.work {
            MethodWork::Session(path) => {
                let text = read_text(path, "session", "give a session file (session.toml), not a model")?;
                let session = SessionFile::parse(&text, path)?;
                record.session = Some(text);
                Ok(session.steps)
            }
            MethodWork::Deformed(_) | MethodWork::Model(_) | MethodWork::Command(_) => Ok(Vec::new()),
            MethodWork::Plugin { deform, state_version, params, folder } => {
                let takes = self.plugins.get(deform)?.consumes();
                let regions = self.file.regions.iter().filter(|region| match region.role {
                    Role::Fixed => takes.fixed_regions,
                    Role::Handle => takes.handle_regions,
                    Role::Mask => true,
                });
                let action = Action::Deform(Deformation {
                    state_version: *state_version,
                    params: params.clone(),
                    regions: regions.cloned().collect(),
                    folder: folder.clone(),
                    ..Deformation::by_plugin(deform)
                });
                Ok(vec![Step { place: method.place.clone(), ..Step::new(action) }])
            }
        }
    }

    /// Samples, which are taken once for all methods that want the same, and the seconds that this took.
    pub fn sampling(
        &mut self,
        of: SamplingTable,
        progress: &dyn Progress,
    ) -> Result<(Arc<SampledModel>, f64)> {
        if let Some(known) = self.samplings.iter().find(|known| known.of == of) {
            return Ok((known.sampled.clone(), known.seconds));
        }
        let start = Instant::now();
        let session = SessionFile {
            model: Some(self.file.model.clone()),
            columns: self.file.columns.clone(),
            fingerprint: self.file.fingerprint.clone(),
            sampling: of,
            ..SessionFile::default()
        };
        let skip = Skip { cells: !self.refines, colors: true, ..Skip::default() };
        let sampled = Arc::new(sampled(&session, skip, (self.folder, &self.cache), progress)?.0);
        let seconds = start.elapsed().as_secs_f64();
        self.samplings.push(TakenSampling { of, sampled: sampled.clone(), seconds, found: OnceLock::new() });
        Ok((sampled, seconds))
    }
}

/// Distances of the vertices of a deformed model from their exact images.
fn beside_exact(
    source: &dyn Model,
    output: &Path,
    stack: &PreparedStack,
    sampled: &SampledModel,
    progress: &dyn Progress,
) -> Result<TransferError> {
    let map = |points: &mut [glam::DVec3]| stack.evaluate_with(points, progress);
    let deformed = simod_model::open_version(source, output, source.columns())?;
    let how = (sampled.bounds.diagonal(), Some(MEASURED));
    transfer_error::measure(source, deformed.as_ref(), how, &map, progress)
}

/// Whether a method moves samples, and makes no deformed model itself.
fn deforms_samples(method: &ComparedMethod) -> bool {
    match &method.work {
        MethodWork::Model(_) => false,
        MethodWork::Command(command) => !command.makes_model(),
        MethodWork::Plugin { .. } | MethodWork::Session(_) | MethodWork::Deformed(_) => true,
    }
}

/// Bytes and hash of a deformed model.
fn result_of(once: &Once, progress: &dyn Progress) -> Result<(u64, String)> {
    let bytes = size_of_all(&once.files)?;
    let hash = match once.hash {
        Some(hash) => hash,
        None => hash_of(&once.files, bytes, progress)?,
    };
    Ok((bytes, format!("xxh3-128:{hash:032x}")))
}

/// Puts the result of a method into its record, and returns the part that is compared.
fn finished(
    known: &PreparedMethod<'_>,
    once: Once,
    (runs, sample, peak_memory_bytes, notices): (Vec<RunSeconds>, f64, Option<u64>, Vec<String>),
    ((bytes, hash), repeats): ((u64, String), Option<bool>),
    record: &mut MethodRecord,
) -> Deformed {
    let Once { sampled, positions, output, .. } = once;
    let is_model = positions.is_none();
    let diagonal = sampled.bounds.diagonal();
    record.figures = Some(Figures {
        samples: if is_model { 0 } else { sampled.samples.len() },
        triangles: if is_model { 0 } else { sampled.triangles.len() },
        seconds: Seconds::from_runs((!is_model).then_some(sample), runs),
        peak_memory_bytes,
        transfer_error: once.transfer_error.map(|error| WithLengths::new(error, diagonal)),
        expected_error: once.expected_error.map(|error| WithLengths::new(error, diagonal)),
        displacement: None,
        to_first: None,
        on_samples: None,
        on_model: None,
        folded_samples: once.folded_samples,
        result: ResultFile { bytes, hash, repeats },
        messages: notices
            .into_iter()
            .map(|notice| format!("warning: {notice}"))
            .chain(words(&once.messages))
            .collect(),
    });
    let is_ours = !matches!(known.method.work, MethodWork::Model(_));
    Deformed { name: known.name.clone(), sampled, positions, output, is_ours }
}

/// Whether a method appends samples.
pub(crate) fn refines(method: &ComparedMethod) -> bool {
    match &method.work {
        // Defects of a session are reported when the session is done.
        MethodWork::Session(path) => SessionFile::load(path)
            .is_ok_and(|session| session.steps.iter().any(|step| step.enabled && step.refines())),
        _ => false,
    }
}

/// Approximate number of vertices that are compared with their exact images, where a model has several
/// times as many.
const MEASURED: u64 = 1 << 20;

/// Time of the processor since `before`.
fn since(before: Option<f64>) -> Option<f64> {
    Some(processor::seconds()? - before?)
}

/// Sum of three times; nothing where one of them is not known.
fn sum(seconds: [Option<f64>; 3]) -> Option<f64> {
    seconds.into_iter().sum()
}

/// Bytes of all files together.
fn size_of_all(files: &[PathBuf]) -> Result<u64> {
    let size =
        |path: &PathBuf| std::fs::metadata(path).map(|is| is.len()).map_err(|e| Error::io("read", path, &e));
    files.iter().map(size).sum()
}

/// Hash of all bytes of files, one after the other, which are read for that.
fn hash_of(files: &[PathBuf], bytes: u64, progress: &dyn Progress) -> Result<u128> {
    progress.begin("hashing the result", bytes);
    let (mut hash, mut block) = (Xxh3Default::new(), vec![0; 1 << 20]);
    for path in files {
        let failed = |e: std::io::Error| Error::io("read", path, &e);
        let mut file = std::fs::File::open(path).map_err(failed)?;
        loop {
            progress.check()?;
            match file.read(&mut block).map_err(failed)? {
                0 => break,
                count => {
                    hash.update(&block[..count]);
                    progress.advance(count as u64);
                }
            }
        }
    }
    Ok(hash.digest128())
}

/// Name of a method's model: with an extension of the model's format, the model's own if it is one; of
/// tiles a folder.
pub(crate) fn file_name(method: &str, model: &dyn Model) -> String {
    if !model.tiles().is_empty() {
        return method.to_owned();
    }
    let all = model.extensions();
    let own = model.path().extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let extension = if all.contains(&own.as_str()) { &own } else { all.first().copied().unwrap_or("ply") };
    format!("{method}.{extension}")
}
