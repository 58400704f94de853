//! The whole way of an edit, which reads as the design's picture: sample, deform, reconstruct.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, Vec3};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::fingerprint::are_same;
use simod_core::reconstruction::transfer_error::{self, TransferError};
use simod_core::reconstruction::{
    DeformationField, EVALUATIONS_WITH_GRADIENT, Method, Reconstructed, Reconstruction, RestGeometry,
    Version, choose_offset, needs_gradient, reconstruct, write_exact,
};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Skip, Target, sample};
use simod_model::follow::Follow;
use simod_model::input::may_be_there;
use simod_model::target::scratch_folder;
use simod_model::{
    Cache, Conversion, Converted, Error, Model, ModelName, Normals, Progress, Result, is_named_otherwise,
    note_on_name,
};
use simod_plugin_api::Effort;

pub use crate::deformed_samples::{DeformedSamples, deform};
use crate::deformer::Message;
use crate::edit::{Document, Evaluation, Refinements, messages, turning_gradients};
use crate::plugins::PluginRegistry;
use crate::session_file::{self, SessionFile};
use crate::sidecar;
use crate::stack::{BLOCK, Stack};
use crate::step::Step;
use crate::tolerance::{self, Certificate, Sought, Tolerance};

/// Samples a session's model, which comes with it. Temporary files without a name are made in `folder`.
///
/// # Errors
/// The session names no model; it is gone, or cannot be sampled; the user cancelled.
pub fn sampled(
    session: &SessionFile,
    skip: Skip,
    (folder, cache): (&Path, &Arc<Cache>),
    progress: &dyn Progress,
) -> Result<(SampledModel, Box<dyn Model>)> {
    let model = open(session, cache, progress)?;
    let by = |sampling: &Sampling| sample(&*model, sampling, folder, progress);
    let sampled = sampled_of(session, &*model, skip, cache, by, progress)?;
    Ok((sampled, model))
}

/// Opens a session's model.
pub(crate) fn open(
    session: &SessionFile,
    cache: &Arc<Cache>,
    progress: &dyn Progress,
) -> Result<Box<dyn Model>> {
    let named = session.named_model()?.ok_or_else(|| {
        Error::argument(
            "the session does not name a model",
            "add [model] path = \"…\" to it; the path is relative to the session's folder",
        )
    })?;
    if let Some(gone) = named.files().iter().find(|file| !may_be_there(file)) {
        return Err(Error::system(
            format!("the session's model {} is gone", gone.display()),
            "put it back, correct [model] path in the session, or say where it is with --model",
        ));
    }
    named.open(session.columns.as_deref(), cache, progress)
}

/// The samples as a session's steps deform them; samples of its refinements are kept in `folder`.
fn deformed(
    sampled: SampledModel,
    session: &SessionFile,
    plugins: &PluginRegistry,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<DeformedSamples> {
    let (folder, time) = (folder.to_owned(), session.time.time());
    deform(sampled, &session.steps, plugins, Refinements { folder, time, ..Refinements::default() }, progress)
}

/// Samples a session's model, which is open, as `sample` does.
pub(crate) fn sampled_of(
    session: &SessionFile,
    model: &dyn Model,
    skip: Skip,
    cache: &Arc<Cache>,
    sample: impl FnOnce(&Sampling) -> Result<SampledModel>,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    let mut sampled = sample(&sampling_of(session, skip))?;
    sampled.set_cache(cache.clone());
    let now = &sampled.source.fingerprint;
    if session.fingerprint.as_ref().is_some_and(|known| are_same(known, now) == Some(false)) {
        progress.note(&format!("{} is not what it was when the session was saved", model.path().display()));
    }
    Ok(sampled)
}

/// Options for sampling a session's model, without the parts that the session has no use for.
pub(crate) fn sampling_of(session: &SessionFile, skip: Skip) -> Sampling {
    let sampling = Sampling::from(session.sampling);
    let skip = Skip { sheets: sampling.skip.sheets, ..skip };
    Sampling { skip, ..sampling }
}

/// Samples after steps that something else may go on from.
pub struct MovedSamples {
    /// The model with its samples at rest, with those that steps appended.
    pub sampled: Arc<SampledModel>,
    /// Local positions, one per sample, which nothing rounded.
    pub positions: Arc<[Vec3]>,
    /// Messages of the plugins.
    pub messages: Vec<Message>,
}

/// Does steps on samples that something else may have moved before.
///
/// # Errors
/// A step cannot be done, or the user cancelled.
pub fn deform_from(
    sampled: Arc<SampledModel>,
    positions: Arc<[Vec3]>,
    steps: &[Step],
    plugins: &PluginRegistry,
    how: Refinements,
    progress: &dyn Progress,
) -> Result<MovedSamples> {
    let document = Document::new(steps.iter().cloned());
    let evaluation = Evaluation::new(sampled, how);
    let mut evaluation = if *positions == *evaluation.sampled().samples.positions {
        evaluation
    } else {
        evaluation.starting_at(positions)?
    };
    let done = evaluation.update(document.steps(), plugins, Effort::FULL, progress)?;
    let done = done.with_notices(document.steps(), plugins);
    let messages = messages(done.statuses)?;
    Ok(MovedSamples { sampled: done.sampled, positions: done.positions, messages })
}

/// Writes the model as its samples were deformed, from `model`, which was sampled, to a file of its own
/// format or of another one that the file's name says. Of `running`, the options of writing count.
///
/// # Errors
/// As of [`reconstruct`]; another format cannot hold all.
pub fn write(
    sampled: &SampledModel,
    mut model: Box<dyn Model>,
    positions: &DeformedPositions,
    output: &Path,
    running: &Running<'_>,
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    sidecar::follow(&mut *model, running.follow)?;
    if is_named_otherwise(&*model, output) {
        let drops_normals = running.how.normals == Normals::Drop;
        let how = Conversion { lossy: running.lossy, drops_normals, ..Conversion::default() };
        let converted = Converted::new(model, output, how, progress)?;
        note_losses(&converted, progress);
        model = Box::new(converted);
    }
    if running.choose_offset {
        let chosen = choose_offset(sampled, model.as_mut(), [positions])?;
        chosen.into_iter().for_each(|changed| progress.note(&changed));
    }
    note_on_name(output).into_iter().for_each(|note| progress.note(&note));
    let version = Version { deformed: positions, output, diagnostics: running.diagnostics };
    reconstruct(sampled, model.as_ref(), &[version], &running.how, progress)
}

pub(crate) fn note_losses(converted: &Converted, progress: &dyn Progress) {
    let losses = converted.losses();
    if !losses.is_empty() {
        progress.note(&format!("what is lost: {}", losses.join("; ")));
    }
}

/// Options of running a session.
#[derive(Debug, Clone, Copy)]
pub struct Running<'a> {
    /// Options of the transfer of the deformation.
    pub how: Reconstruction<'a>,
    /// File for the diagnostics of each vertex: see [`Version::diagnostics`].
    pub diagnostics: Option<&'a Path>,
    /// [`Run::transfer_error`] will be asked for.
    pub measure: bool,
    /// Every vertex is evaluated by the plugins; nothing is transferred.
    pub exact: bool,
    /// Samples are added until nothing is expected to be off by more.
    pub tolerance: Option<Tolerance>,
    /// Whether the offset of positions that are stored as integers may be [another one](choose_offset), where
    /// the integers do not reach.
    pub choose_offset: bool,
    /// Whether output in another format than the model's may lose content that the format cannot hold.
    pub lossy: bool,
    /// Rules for the attributes that turn with the surface besides normals; by [default](Follow::default)
    /// those of splats.
    pub follow: &'a Follow,
}

impl Default for Running<'_> {
    fn default() -> Self {
        static FOLLOW: Follow = Follow::SPLATS;
        Self {
            how: Reconstruction::default(),
            diagnostics: None,
            measure: false,
            exact: false,
            tolerance: None,
            choose_offset: false,
            lossy: false,
            follow: &FOLLOW,
        }
    }
}

impl Running<'_> {
    /// # Errors
    /// What is asked for cannot be had together, or not with these steps.
    fn check(&self, stack: &Stack) -> Result<()> {
        if self.measure || self.exact {
            stack.check_evaluable()?;
        }
        if self.exact && self.how.method != Method::default() {
            return Err(Error::argument(
                "every vertex is evaluated: no method transfers anything",
                "leave out --exact or --method",
            ));
        }
        if self.tolerance.is_some() && (self.exact || self.how.method != Method::BlendedJets) {
            return Err(Error::argument(
                "a tolerance is kept by refining for the method blended-jets",
                "leave out --tolerance, or --exact and --method",
            ));
        }
        Ok(())
    }
}

/// Expected cost of evaluating every vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactCost {
    /// Number of evaluations of the steps, in all.
    pub evaluations: u64,
    /// An estimate made beforehand, from the time that some vertices took.
    pub seconds: f64,
}

/// Number of points that each thread evaluates to estimate the time for all vertices.
const TRIED: usize = BLOCK;

/// A finished run of a session.
pub struct Run {
    /// The samples after the deformation, with those at rest.
    pub deformed: DeformedSamples,
    /// The deformed model.
    pub output: PathBuf,
    /// The report on the model that was written.
    pub written: Reconstructed,
    /// The proof that the tolerance is met, if there was one.
    pub certificate: Option<Certificate>,
    /// The cost that was expected, if every vertex was evaluated.
    pub exact: Option<ExactCost>,
    /// Attributes that turned with the surface besides normals and tangents, for people.
    pub following: Vec<String>,
    /// Seconds from opening the model to the finished output.
    pub seconds: f64,
}

impl Run {
    /// Samples the session's model, deforms the samples and writes the deformed model, whole or not at all.
    /// `measure` says that [`transfer_error`](Self::transfer_error) will be asked for.
    ///
    /// # Errors
    /// Any step fails; what is wrong in the session is noticed before the model is read.
    pub fn execute(
        session: &SessionFile,
        plugins: &PluginRegistry,
        how: &Reconstruction,
        measure: bool,
        output: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let follow = Follow::default().or_declared(&session.follow);
        let running = Running { how: *how, measure, follow: &follow, ..Running::default() };
        Self::execute_with(session, plugins, &running, output, progress)
    }

    /// Runs a session in other ways than [`execute`](Self::execute).
    ///
    /// # Errors
    /// As of [`execute`](Self::execute); a step deforms samples alone, and all vertices are to be evaluated,
    /// or measured, which is noticed before anything is read; the tolerance cannot be met, which is known
    /// before anything is written.
    pub fn execute_with(
        session: &SessionFile,
        plugins: &PluginRegistry,
        running: &Running<'_>,
        output: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let Running { how, tolerance, choose_offset: may_move, lossy, follow, .. } = running;
        let start = Instant::now();
        let stack = Stack::build(&session.steps, plugins)?;
        running.check(&stack)?;
        let folder = &*scratch_folder(output);
        let skip = needed(session, &stack, tolerance.is_some());
        let cache = &Arc::new(Cache::nameless(folder));
        let converted = converted(session, output, (how.normals, *lossy), (cache, progress))?;
        let mut model = open(session, cache, progress)?;
        // Attributes are declared before sampling, as a declared one may not be there.
        let follow = &sidecar::follow(&mut *model, follow)?;
        let following = model.following().map_or(Vec::new(), |following| following.descriptions().to_vec());
        let by = |sampling: &Sampling| {
            let target =
                if tolerance.is_some() { tolerance::beginning(sampling.target) } else { sampling.target };
            sample(&*model, &Sampling { target, ..*sampling }, folder, progress)
        };
        let sampled = sampled_of(session, &*model, skip, cache, by, progress)?;
        // The model may be sampled anew as it was read.
        let mut read = None;
        if let Some(converted) = converted {
            note_losses(&converted, progress);
            read = Some(std::mem::replace(&mut model, Box::new(converted)));
            model.follow(follow)?;
        }
        let (deformed, certificate) = match tolerance {
            Some(tolerance) => {
                let models = [read.as_deref().unwrap_or(&*model), &*model];
                let (by, room) = ((session, plugins, *tolerance), (folder, progress));
                let (met, certificate) = met(sampled, models, by, (skip, cache), room)?;
                (met, Some(certificate))
            }
            None => (deformed(sampled, session, plugins, folder, progress)?, None),
        };
        if *may_move {
            let chosen = choose_offset(&deformed.sampled, model.as_mut(), [&deformed.positions])?;
            chosen.into_iter().for_each(|changed| progress.note(&changed));
        }
        note_on_name(output).into_iter().for_each(|note| progress.note(&note));
        let (written, exact) = written(&deformed, model.as_ref(), running, output, progress)?;
        let seconds = start.elapsed().as_secs_f64();
        let output = output.to_owned();
        Ok(Self { deformed, output, written, certificate, exact, following, seconds })
    }

    /// Compares the output with the exact image of every vertex of the model.
    ///
    /// # Errors
    /// A plugin of the stack does not know its map between the samples; a file cannot be read; cancelled.
    pub fn transfer_error(&self, progress: &dyn Progress) -> Result<TransferError> {
        let model = self.deformed.sampled.open_source(None, progress)?;
        let columns = model.columns().filter(|_| !is_named_otherwise(&*model, &self.output));
        let output = simod_model::open_version(&*model, &self.output, columns)?;
        let diagonal = self.deformed.sampled.bounds.diagonal();
        let map = |points: &mut [DVec3]| self.deformed.stack.evaluate_with(points, progress);
        transfer_error::measure(model.as_ref(), output.as_ref(), (diagonal, None), &map, progress)
    }
}

/// Samples that meet a tolerance, of a model as it is read and as it is written. The model may be sampled
/// anew, but where an error was asked for that is not exchanged for a number of samples.
fn met(
    sampled: SampledModel,
    [read, written]: [&dyn Model; 2],
    (session, plugins, tolerance): (&SessionFile, &PluginRegistry, Tolerance),
    (skip, cache): (Skip, &Arc<Cache>),
    (folder, progress): (&Path, &dyn Progress),
) -> Result<(DeformedSamples, Certificate)> {
    let sought = Sought {
        model: written,
        steps: &session.steps,
        plugins,
        time: session.time.time(),
        tolerance: tolerance.fraction(sampled.bounds.diagonal()),
        folder,
        progress,
    };
    let sampling = sampling_of(session, skip);
    let anew = |samples: u64| {
        let sampling = Sampling { target: Target::Samples(samples), ..sampling };
        let mut sampled = sample(read, &sampling, folder, progress)?;
        sampled.set_cache(cache.clone());
        Ok(sampled)
    };
    let by_number = matches!(sampling.target, Target::Samples(_));
    sought.meet(sampled, by_number.then_some(&anew))
}

/// Writes the deformed model, by the samples or by the evaluation of each vertex, of which the cost is told.
fn written(
    deformed: &DeformedSamples,
    model: &dyn Model,
    running: &Running<'_>,
    output: &Path,
    progress: &dyn Progress,
) -> Result<(Reconstructed, Option<ExactCost>)> {
    let version = Version { deformed: &deformed.positions, output, diagnostics: running.diagnostics };
    if running.exact {
        let cost = told_cost(deformed, model, running, progress)?;
        return Ok((evaluated(deformed, model, &version, &running.how, progress)?, Some(cost)));
    }
    let known = turning_gradients(&deformed.sampled, &deformed.stack, model, progress)?;
    let how = Reconstruction { gradients: known.as_deref(), ..running.how };
    Ok((reconstruct(&deformed.sampled, model, &[version], &how, progress)?, None))
}

/// Parts of a sampled model that a session has no use for; `refines` says that more than the session's steps
/// refines it.
pub(crate) fn needed(session: &SessionFile, stack: &Stack, refines: bool) -> Skip {
    let cells = refines || session.steps.iter().any(|step| step.enabled && step.refines());
    // With triangles, a refinement knows the faces, and places its samples as it does those of a folder.
    let triangles = cells || stack.plugins().any(|p| p.consumes().triangles);
    Skip { triangles: !triangles, cells: !cells, colors: true, ..Skip::default() }
}

/// The session's model in the format that the output's name has, if that is another one; before sampling, as
/// losses may not be allowed.
pub(crate) fn converted(
    session: &SessionFile,
    output: &Path,
    (normals, lossy): (Normals, bool),
    (cache, progress): (&Arc<Cache>, &dyn Progress),
) -> Result<Option<Converted>> {
    let Some(named @ ModelName::File(_)) = session.named_model()? else { return Ok(None) };
    if !named.files().iter().all(|file| may_be_there(file)) {
        return Ok(None);
    }
    let model = named.open(session.columns.as_deref(), cache, progress)?;
    if !is_named_otherwise(&*model, output) {
        return Ok(None);
    }
    let how = Conversion { lossy, drops_normals: normals == Normals::Drop, ..Conversion::default() };
    Converted::new(model, output, how, progress).map(Some)
}

/// Tells the expected time of evaluating all vertices, by that of some samples.
fn told_cost(
    deformed: &DeformedSamples,
    model: &dyn Model,
    running: &Running<'_>,
    progress: &dyn Progress,
) -> Result<ExactCost> {
    let DeformedSamples { sampled, stack, .. } = deformed;
    let rest = &sampled.samples.positions;
    // As many blocks as there are threads, or only some of these would have work.
    let tried = TRIED * rayon::current_num_threads();
    let step = rest.len().div_ceil(tried).max(1);
    let some = rest.iter().step_by(step).map(|p| sampled.frame.to_model(*p));
    let some: Vec<DVec3> = some.cycle().take(tried).collect();
    // The first time, caches are cold.
    let mut seconds = f64::INFINITY;
    for _ in 0..2 {
        let start = Instant::now();
        stack.evaluate_with(&mut some.clone(), progress)?;
        seconds = seconds.min(start.elapsed().as_secs_f64());
    }
    let gradient = needs_gradient(model, running.how.normals, running.diagnostics);
    let vertices = model.info().vertices;
    let evaluations = vertices * if gradient { EVALUATIONS_WITH_GRADIENT } else { 1 };
    let seconds = seconds / some.len() as f64 * evaluations as f64;
    progress.note(&format!(
        "the steps are evaluated at each of {vertices} vertices{}, which takes about {seconds:.1} s besides reading and writing",
        if gradient { ", and at six points around it for the gradient" } else { "" }
    ));
    Ok(ExactCost { evaluations, seconds })
}

/// Writes the exact image of every vertex.
fn evaluated(
    deformed: &DeformedSamples,
    model: &dyn Model,
    version: &Version<'_>,
    how: &Reconstruction<'_>,
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    let DeformedSamples { sampled, positions, stack, .. } = deformed;
    progress.begin("preparing", 0);
    let around = RestGeometry::kept(sampled);
    let field = DeformationField::from_deformed(&around, positions, Method::default())
        .expecting(&sampled.frame, model.info());
    let map = |points: &mut [DVec3]| stack.evaluate_with(points, progress);
    write_exact(sampled, model, &field, &map, version, how, progress)
}

impl From<session_file::SamplingTable> for Sampling {
    fn from(from: session_file::SamplingTable) -> Self {
        let target = match (from.samples, from.error) {
            (Some(n), _) => Target::Samples(n),
            (None, Some(e)) => Target::Error(e),
            (None, None) => Target::default(),
        };
        Self {
            target,
            grid: from.grid,
            by: from.by.unwrap_or_default(),
            placement: from.place.unwrap_or_default(),
            min_opacity: from.min_opacity,
            skip: Skip { sheets: from.sheets == Some(false), ..Skip::default() },
            ..Self::default()
        }
    }
}
