//! The engine's other end: a thread that opens models, does steps, and has models written, one after the
//! other.

use super::requests::{ComparisonRequest, Event, Extra, Job, Opening, StepsRequest, WriteRequest};
use super::shared::{RunningJobs, SharedState};
use super::watch::{JobWatch, Wake};
use crate::scene::ViewerScene;
use simod_core::reconstruction::Reconstruction;
use simod_core::sampled_model::SampledModel;
use simod_model::target::folder_of;
use simod_model::{Error, ErrorKind, Progress, Result};
use simod_plugin_api::Effort;
use simod_session::edit::{Editor, Entry, Evaluated, Evaluation, recover};
use simod_session::session_file::SamplingTable;
use simod_session::{PluginRegistry, SessionFile};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Sender;
use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

/// State of the engine's thread.
pub(super) struct EngineThread {
    shared: Arc<SharedState>,
    tell: Teller,
    plugins: Arc<PluginRegistry>,
    evaluation: Option<Evaluation>,
    revision: u64,
    /// Whether the shading of all samples was asked for in the last draft.
    asked: Arc<AtomicBool>,
    writer: Option<JoinHandle<()>>,
}

/// The way to the window.
#[derive(Clone)]
pub(super) struct Teller {
    shared: Arc<SharedState>,
    events: Sender<Event>,
    wake: Wake,
}

/// The task that comes next.
enum EngineTask {
    Open(Opening),
    Evaluate(StepsRequest),
    Write(Arc<[Entry]>, WriteRequest),
    Compare(ComparisonRequest),
}

impl Teller {
    pub fn new(shared: Arc<SharedState>, events: Sender<Event>, wake: Wake) -> Self {
        Self { shared, events, wake }
    }

    pub fn wake(&self) -> Wake {
        self.wake.clone()
    }

    /// Sends an event of a job that goes on.
    pub fn send(&self, event: Event) {
        let mut inner = self.shared.lock();
        inner.1.events += 1;
        drop(self.events.send(event));
        self.shared.changed.notify_all();
        drop(inner);
        (self.wake)();
    }

    /// Sends the outcome of a job, which is over.
    pub fn end(&self, job: Job, watch: &JobWatch, event: Option<Event>) {
        let notes = watch.take_notes().into_iter().map(Event::Note);
        let mut inner = self.shared.lock();
        let running = &mut inner.1;
        let is_news = |event: &Event| match event {
            Event::Failed { error, .. } => !(error.kind() == ErrorKind::Cancelled && watch.is_superseded()),
            _ => true,
        };
        for event in notes.chain(event.filter(is_news)) {
            running.events += 1;
            running.opened += usize::from(event.ends_opening());
            // The event has no receiver once the window is closed.
            drop(self.events.send(event));
        }
        running.end(job);
        self.shared.changed.notify_all();
        drop(inner);
        (self.wake)();
    }
}

/// Result of work, or an error if the work panicked: a mistake here must not take the edit with it.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        let what = format!("a mistake in the program: {text}");
        Err(Error::internal(what).hinting("save the session, and report this"))
    })
}

impl EngineThread {
    pub fn new(shared: Arc<SharedState>, tell: Teller, plugins: Arc<PluginRegistry>) -> Self {
        Self { shared, tell, plugins, evaluation: None, revision: 0, asked: Arc::default(), writer: None }
    }

    pub fn run(mut self) {
        while let Some((task, watch)) = self.next() {
            self.execute(task, watch);
        }
        if let Some(writer) = self.writer.take() {
            let _ = writer.join();
        }
    }

    /// Does a task, and tells the window its outcome.
    fn execute(&mut self, task: EngineTask, watch: Arc<JobWatch>) {
        match task {
            EngineTask::Open(opening) => {
                let opened = guarded(|| self.open(&opening, &watch));
                self.tell.end(Job::Open, &watch, Some(event(Job::Open, opened)));
            }
            EngineTask::Evaluate(StepsRequest { number, steps, effort, extra }) => {
                let scene = guarded(|| {
                    let scene = self.scene(&steps, effort, &*watch)?;
                    with_extra(scene, &extra, &*watch)
                });
                let scene = scene.map(|scene| Event::Evaluated { request: number, scene: Box::new(scene) });
                self.tell.end(Job::Evaluate, &watch, Some(event(Job::Evaluate, scene)));
            }
            EngineTask::Write(steps, writing) => {
                match guarded(|| self.evaluated(&steps, Effort::FULL, &*watch)) {
                    Ok(evaluated) => self.write(evaluated, writing, watch),
                    Err(error) => {
                        self.tell.end(Job::Write, &watch, Some(Event::Failed { job: Job::Write, error }));
                    }
                }
            }
            EngineTask::Compare(comparing) => {
                let compared = guarded(|| self.compared(comparing, &*watch));
                self.tell.end(Job::Compare, &watch, Some(event(Job::Compare, compared)));
            }
        }
    }

    /// Waits for a task, which then counts as running; nothing once the window is closed.
    fn next(&mut self) -> Option<(EngineTask, Arc<JobWatch>)> {
        let mut inner = self.shared.lock();
        loop {
            let (wanted, running) = &mut *inner;
            if wanted.end {
                return None;
            }
            if let Some(plugins) = wanted.plugins.take() {
                self.plugins = plugins;
            }
            let watch = Arc::new(JobWatch::new(self.tell.wake.clone()));
            if let Some(opening) = wanted.open.take() {
                running.begin(Job::Open, &watch);
                return Some((EngineTask::Open(opening), watch));
            }
            if let Some(request) = wanted.evaluate.take() {
                running.begin(Job::Evaluate, &watch);
                running.evaluated = Some((request.steps.clone(), request.effort));
                return Some((EngineTask::Evaluate(request), watch));
            }
            if let Some(comparing) = wanted.compare.take() {
                running.begin(Job::Compare, &watch);
                return Some((EngineTask::Compare(comparing), watch));
            }
            if running.watch(Job::Write).is_none()
                && let Some((steps, writing)) = wanted.write.take()
            {
                running.begin(Job::Write, &watch);
                return Some((EngineTask::Write(steps, writing), watch));
            }
            inner = self.shared.changed.wait(inner).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Opens a model or session; the former one stays until that is done.
    fn open(&mut self, opening: &Opening, progress: &JobWatch) -> Result<Event> {
        let (editor, mut evaluation) = opened(opening, &self.plugins, progress)?;
        let rest = evaluation.update(&[], &self.plugins, Effort::FULL, progress)?;
        self.revision += 1;
        let scene = ViewerScene::new(rest, &evaluation, Effort::FULL, self.revision, &self.asked);
        let RunningJobs { step, .. } = &mut self.shared.lock().1;
        step.clone_from(evaluation.place());
        self.evaluation = Some(evaluation);
        Ok(Event::Opened(Box::new((editor, scene))))
    }

    fn evaluated(&mut self, steps: &[Entry], effort: Effort, progress: &dyn Progress) -> Result<Evaluated> {
        let evaluation = self.evaluation.as_mut().ok_or_else(nothing_open)?;
        let evaluated = evaluation.update(steps, &self.plugins, effort, progress)?;
        Ok(evaluated.with_notices(steps, &self.plugins))
    }

    fn compared(&mut self, comparing: ComparisonRequest, progress: &dyn Progress) -> Result<Event> {
        let evaluation = self.evaluation.as_ref().ok_or_else(nothing_open)?;
        comparing.done(evaluation, &self.plugins, &mut self.revision, progress)
    }

    fn scene(&mut self, steps: &[Entry], effort: Effort, progress: &dyn Progress) -> Result<ViewerScene> {
        let evaluated = self.evaluated(steps, effort, progress)?;
        self.revision += 1;
        let evaluation = self.evaluation.as_ref();
        let evaluation = evaluation.ok_or_else(Error::cancelled)?;
        Ok(ViewerScene::new(evaluated, evaluation, effort, self.revision, &self.asked))
    }

    /// Writes the model on a thread of its own, so that the edit goes on.
    fn write(&mut self, evaluated: Evaluated, writing: WriteRequest, watch: Arc<JobWatch>) {
        if let Some(former) = self.writer.take() {
            let _ = former.join();
        }
        let tell = self.tell.clone();
        let work = move || {
            let WriteRequest { output, model, follow, method, normals } = writing;
            let how = Reconstruction { method, normals, ..Reconstruction::default() };
            let start = Instant::now();
            let report = guarded(|| evaluated.write(model.as_deref(), &follow, &output, &how, &*watch));
            let written = report.map(|report| Event::Written {
                output,
                report: Box::new(report),
                seconds: start.elapsed().as_secs_f64(),
            });
            tell.end(Job::Write, &watch, Some(event(Job::Write, written)));
        };
        self.writer = std::thread::Builder::new().name("writer".into()).spawn(work).ok();
    }
}

/// The scene with the part that was wanted in addition. Where attributes cannot be read, the scene comes
/// without them.
fn with_extra(scene: ViewerScene, extra: &Extra, progress: &dyn Progress) -> Result<ViewerScene> {
    match extra {
        Extra::Nothing => Ok(scene),
        Extra::ExpectedError => Ok(scene.measured()),
        Extra::Attributes(model) => {
            match scene.sampled.attributes(model.as_deref(), progress) {
                Err(e) if e.kind() == ErrorKind::Cancelled => return Err(e),
                Err(e) => progress.note(&format!("the attributes cannot be shown: {e}")),
                Ok(_) => {}
            }
            Ok(scene)
        }
    }
}

fn nothing_open() -> Error {
    Error::argument("no model is open", "open one")
}

fn event(job: Job, result: Result<Event>) -> Event {
    result.unwrap_or_else(|error| Event::Failed { job, error })
}

/// Opens a session, the folder of a sampled model, or a model, which is sampled.
fn opened(
    opening: &Opening,
    plugins: &Arc<PluginRegistry>,
    progress: &dyn Progress,
) -> Result<(Editor, Evaluation)> {
    let kept = if opening.recover { recover(&opening.path)? } else { None };
    // An edit is unsaved that is in no file, or whose file names another path of the model.
    let is_unsaved = kept.is_some() || opening.model.is_some();
    let (editor, evaluation) = opened_as(opening, kept, plugins, progress)?;
    Ok((if is_unsaved { editor.unsaved() } else { editor }, evaluation))
}

/// Opens a model or a session, or the edit that was kept against a crash, if there is one.
fn opened_as(
    Opening { path, sampling, model, .. }: &Opening,
    kept: Option<SessionFile>,
    plugins: &Arc<PluginRegistry>,
    progress: &dyn Progress,
) -> Result<(Editor, Evaluation)> {
    let located = |session: SessionFile| SessionFile { model: model.clone().or(session.model), ..session };
    if path.is_dir() {
        let mut sampled = SampledModel::load(path)?;
        match SampledModel::kept_cells(path) {
            Some(cells) => sampled.hold_cells(cells),
            None => progress.note("the cells of the sampled model are missing: it cannot be refined"),
        }
        let session = located(kept.unwrap_or_else(|| session_of(&sampled)));
        let folder = folder_of(path).to_owned();
        let (editor, evaluation) = Editor::for_sampled(sampled, session, None, plugins.clone(), folder);
        return Ok((editor.opened_by(path), evaluation));
    }
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        let session = located(kept.map_or_else(|| SessionFile::load(path), Ok)?);
        return Editor::open(session, Some(path.clone()), plugins.clone(), progress);
    }
    let new = || SessionFile { model: Some(path.clone()), sampling: *sampling, ..SessionFile::default() };
    let (editor, evaluation) = Editor::open(kept.unwrap_or_else(new), None, plugins.clone(), progress)?;
    Ok((editor.opened_by(path), evaluation))
}

/// Session with the sampling by which a model was sampled.
fn session_of(sampled: &SampledModel) -> SessionFile {
    use simod_core::sampling::{By, Placement, Target};
    let (samples, error) = match sampled.sampling.target {
        Target::Samples(n) => (Some(n), None),
        Target::Error(e) => (None, Some(e)),
    };
    let by = Some(sampled.sampling.by).filter(|by| *by != By::Error);
    let place = Some(sampled.sampling.placement).filter(|by| *by == Placement::Faces);
    let has_opacity = simod_model::follow::opacity(&sampled.source.attributes).is_some();
    let min_opacity = has_opacity.then(|| sampled.sampling.min_opacity.unwrap_or(0.0));
    let sampling =
        SamplingTable { samples, error, grid: sampled.sampling.grid, place, by, sheets: None, min_opacity };
    // Tiles are named one by one where the model was sampled from tiles.
    let model = sampled.source.tiles.is_empty().then(|| sampled.source.path.clone());
    SessionFile { model, columns: sampled.source.columns.clone(), sampling, ..SessionFile::default() }
}
