//! The thread that owns the samples and does the steps, so that the window never waits.
//!
//! Of requests to do steps, the latest wins: one that waits is replaced. One that runs goes on, so that a
//! drag is followed as quickly as the plugins are, unless its result is of no more use: see `wasted`. A
//! preparation that the newer request needs as well is never cancelled by it, or slow ones would never come
//! to an end while a handle is dragged.
//!
//! The deformed model is written on a thread of its own, so that the edit goes on meanwhile; and so are
//! vertices streamed that are to be seen in full.

mod comparing;
mod emerged;
mod preview;
mod thread;
mod wasted;
mod watch;

use crate::scene::Scene;
use crate::tint::Tint;
pub use comparing::{Carried, Comparing};
pub use emerged::{Emerged, Points};
pub use preview::Pose;
use preview::Streaming;
use serde::{Deserialize, Serialize};
use simod_core::detail::{Batch, Chosen, Streamed};
use simod_core::reconstruction::{Method, Normals, Reconstructed};
use simod_model::follow::Follow;
use simod_model::{Error, Result};
use simod_plugin_api::Effort;
use simod_session::PluginRegistry;
use simod_session::edit::{Editor, Entry};
use simod_session::session_file::Sampling;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thread::{Teller, Thread};
pub use watch::Activity;
use watch::Watch;

/// How long work may go on when the window is closed.
const PARTING: Duration = Duration::from_secs(5);

/// Called from any thread when there is something new to be looked at: an event, or progress.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// What is to be opened.
#[derive(Debug, Clone, PartialEq)]
pub struct Opening {
    /// A model, the folder of a sampled one, or a session.
    pub path: PathBuf,
    /// How finely a model is sampled.
    pub sampling: Sampling,
    /// Takes what was kept of it against a crash, if there is something.
    pub recover: bool,
    /// Where the model is, if it was moved.
    pub model: Option<PathBuf>,
}

/// How the deformed model is written.
#[derive(Debug, Clone, PartialEq)]
pub struct Writing {
    /// The file.
    pub output: PathBuf,
    /// The model, if it was moved since it was sampled.
    pub model: Option<PathBuf>,
    /// What turns with the surface besides normals.
    pub follow: Follow,
    /// How vertices are carried over.
    pub method: Method,
    /// What becomes of the model's normals.
    pub normals: Normals,
}

/// The jobs that there are: at most one of each runs at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Job {
    /// A model is read and sampled.
    Open,
    /// Steps are done.
    Evaluate,
    /// The deformed model is written.
    Write,
    /// Vertices are streamed to be seen.
    Preview,
    /// Another version is made, to be compared with.
    Compare,
}

/// What became of a request.
pub enum Event {
    /// A model is there, with its samples at rest.
    Opened(Box<(Editor, Scene)>),
    /// Steps were done.
    Evaluated {
        /// Which request it was.
        request: u64,
        /// Where the samples are.
        scene: Box<Scene>,
    },
    /// Another version is there.
    Compared {
        /// Which, as it was asked for.
        number: u64,
        /// Its samples.
        scene: Arc<Scene>,
        /// Where it has the others that were asked for.
        carried: Option<Carried>,
    },
    /// The deformed model was written.
    Written {
        /// The file.
        output: PathBuf,
        /// What was done.
        report: Box<Reconstructed>,
        /// How long it took.
        seconds: f64,
    },
    /// Some vertices of the model are there to be seen.
    Detail {
        /// Which request for them it was.
        request: u64,
        /// The vertices.
        batch: Box<Batch>,
    },
    /// All vertices are that were asked for.
    Streamed {
        /// Which request it was.
        request: u64,
        /// How many, and what was read.
        report: Streamed,
        /// How long it took.
        seconds: f64,
    },
    /// Something that the user should know.
    Note(String),
    /// A job came to nothing; what was there before still holds. Of kind
    /// [`Cancelled`](simod_model::ErrorKind::Cancelled) if the user stopped it.
    Failed {
        /// Which.
        job: Job,
        /// Why.
        error: Error,
    },
}

impl Event {
    /// Whether it says what became of a model that was to be opened.
    fn ends_opening(&self) -> bool {
        matches!(self, Self::Opened(_) | Self::Failed { job: Job::Open, .. })
    }
}

/// Steps to be done.
struct Request {
    number: u64,
    steps: Arc<[Entry]>,
    effort: Effort,
    extra: Extra,
}

/// What is wanted with a scene that takes its time.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Extra {
    /// Nothing.
    #[default]
    Nothing,
    /// The error to be expected between the samples.
    ExpectedError,
    /// The [attributes](simod_core::sampled_model::SampledModel::attributes) of the samples, by the model, if it was moved
    /// since it was sampled.
    Attributes(Option<PathBuf>),
}

/// What the thread shall do next.
#[derive(Default)]
struct Wanted {
    open: Option<Opening>,
    evaluate: Option<Request>,
    write: Option<(Arc<[Entry]>, Writing)>,
    preview: Option<Streaming>,
    /// Nothing is to be seen in full any more.
    forget: bool,
    compare: Option<Comparing>,
    plugins: Option<Arc<PluginRegistry>>,
    end: bool,
}

/// What is running.
#[derive(Default)]
struct Running {
    open: Option<Arc<Watch>>,
    evaluate: Option<(Arc<Watch>, Arc<[Entry]>, Effort)>,
    write: Option<Arc<Watch>>,
    preview: Option<Arc<Watch>>,
    compare: Option<Arc<Watch>>,
    /// The place of the step that is being done.
    step: Arc<std::sync::atomic::AtomicUsize>,
    /// Events that were sent, and not taken yet; and those among them that say what became of a model.
    events: usize,
    opened: usize,
}

#[derive(Default)]
struct Shared {
    inner: Mutex<(Wanted, Running)>,
    changed: Condvar,
}

fn is_idle(wanted: &Wanted, running: &Running) -> bool {
    let waiting = wanted.open.is_some() || wanted.evaluate.is_some() || wanted.write.is_some();
    let busy = running.open.is_some() || running.evaluate.is_some() || running.write.is_some();
    let compares = wanted.compare.is_some() || running.compare.is_some();
    let previews = wanted.preview.is_some() || running.preview.is_some();
    !waiting && !busy && !compares && !previews && running.events == 0
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, (Wanted, Running)> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The window's end of it.
pub struct Engine {
    shared: Arc<Shared>,
    events: Receiver<Event>,
    requests: u64,
    threads: Vec<JoinHandle<()>>,
}

impl Engine {
    /// Starts the threads.
    pub fn new(plugins: Arc<PluginRegistry>, wake: Wake) -> Self {
        let (sender, events) = channel();
        let shared = Arc::new(Shared::default());
        let tell = Teller::new(shared.clone(), sender, wake);
        let preview = preview::Thread { shared: shared.clone(), tell: tell.clone() };
        let engine = Thread::new(shared.clone(), tell, plugins);
        let spawn = |name: &str, run: Box<dyn FnOnce() + Send>| {
            std::thread::Builder::new().name(name.into()).spawn(run).ok()
        };
        let threads = [
            spawn("engine", Box::new(move || engine.run())),
            spawn("preview", Box::new(move || preview.run())),
        ];
        Self { shared, events, requests: 0, threads: threads.into_iter().flatten().collect() }
    }

    fn want(&self, change: impl FnOnce(&mut Wanted, &mut Running)) {
        let mut inner = self.shared.lock();
        let (wanted, running) = &mut *inner;
        change(wanted, running);
        self.shared.changed.notify_all();
    }

    /// Opens something else. What is running for the former model is cancelled, but for a model that is being
    /// written.
    pub fn open(&mut self, opening: Opening) {
        self.want(|wanted, running| {
            (wanted.open, wanted.evaluate, wanted.write) = (Some(opening), None, None);
            running.open.iter().for_each(|watch| watch.supersede());
            running.evaluate.iter().for_each(|(watch, ..)| watch.supersede());
        });
        self.forget_preview();
        self.compare(None);
    }

    /// Has vertices streamed, instead of those that are being streamed; gives the request's number, which
    /// comes back with them. `model` is where it is, if it was moved.
    pub fn preview(&mut self, pose: Pose, chosen: Chosen, tint: Tint, model: Option<PathBuf>) -> u64 {
        self.requests += 1;
        let number = self.requests;
        self.want(|wanted, running| {
            running.preview.iter().for_each(|watch| watch.supersede());
            wanted.preview = Some(Streaming { number, pose, chosen, tint, model });
        });
        number
    }

    /// Streams no more vertices for now, and tells nobody.
    pub fn pause_preview(&mut self) {
        self.want(|wanted, running| {
            wanted.preview = None;
            running.preview.iter().for_each(|watch| watch.supersede());
        });
    }

    /// Nothing is to be seen in full any more: memory is let go.
    pub fn forget_preview(&mut self) {
        self.pause_preview();
        self.want(|wanted, _| wanted.forget = true);
    }

    /// Has another version made, instead of a former one, or none any more.
    pub fn compare(&mut self, comparing: Option<Comparing>) {
        self.want(|wanted, running| {
            wanted.compare = comparing;
            running.compare.iter().for_each(|watch| watch.supersede());
        });
    }

    /// Has steps done, instead of those that wait for it; if wanted, with the [error to be
    /// expected](Scene::expected_error). Gives the request's number, which comes back with the result.
    pub fn evaluate(&mut self, steps: Arc<[Entry]>, effort: Effort, extra: Extra) -> u64 {
        self.requests += 1;
        let number = self.requests;
        self.want(|wanted, running| {
            if let Some((watch, before, was)) = &running.evaluate {
                let at = running.step.load(std::sync::atomic::Ordering::Relaxed);
                if wasted::is_wasted(before, *was, &steps, effort, at, watch.stage()) {
                    watch.supersede();
                }
            }
            wanted.evaluate = Some(Request { number, steps, effort, extra });
        });
        number
    }

    /// Writes the model that these steps deform; one at a time, the latest request waits.
    pub fn write(&mut self, steps: Arc<[Entry]>, writing: Writing) {
        self.want(|wanted, _| wanted.write = Some((steps, writing)));
    }

    /// Takes other plugins from the next request on.
    pub fn set_plugins(&mut self, plugins: Arc<PluginRegistry>) {
        self.want(|wanted, _| wanted.plugins = Some(plugins));
    }

    /// Stops a job, and what waits to become one. A plugin in a process of its own is stopped even if it
    /// hangs.
    pub fn cancel(&mut self, job: Job) {
        self.want(|wanted, running| match job {
            Job::Open => {
                wanted.open = None;
                running.open.iter().for_each(|watch| watch.cancel());
            }
            Job::Evaluate => {
                wanted.evaluate = None;
                running.evaluate.iter().for_each(|(watch, ..)| watch.cancel());
            }
            Job::Write => {
                wanted.write = None;
                running.write.iter().for_each(|watch| watch.cancel());
            }
            Job::Preview => {
                wanted.preview = None;
                running.preview.iter().for_each(|watch| watch.cancel());
            }
            Job::Compare => {
                wanted.compare = None;
                running.compare.iter().for_each(|watch| watch.cancel());
            }
        });
    }

    /// What a job is doing, if it is running.
    pub fn activity(&self, job: Job) -> Option<Activity> {
        let inner = self.shared.lock();
        let running = &inner.1;
        let watch = match job {
            Job::Open => running.open.as_ref(),
            Job::Evaluate => running.evaluate.as_ref().map(|(watch, ..)| watch),
            Job::Write => running.write.as_ref(),
            Job::Preview => running.preview.as_ref(),
            Job::Compare => running.compare.as_ref(),
        };
        watch.map(|watch| watch.activity())
    }

    /// Looks at those samples of the model that is being opened that are there by now, if there are any.
    pub fn emerged<T>(&self, look: impl FnOnce(&Emerged) -> T) -> Option<T> {
        let watch = self.shared.lock().1.open.clone()?;
        watch.emerged(look)
    }

    /// The place of the step that is being done, if any is.
    pub fn step(&self) -> Option<usize> {
        let inner = self.shared.lock();
        inner.1.evaluate.as_ref().map(|_| inner.1.step.load(std::sync::atomic::Ordering::Relaxed))
    }

    /// Whether something is going to be done that was asked for.
    pub fn wants(&self, job: Job) -> bool {
        let wanted = &self.shared.lock().0;
        match job {
            Job::Open => wanted.open.is_some(),
            Job::Evaluate => wanted.evaluate.is_some(),
            Job::Write => wanted.write.is_some(),
            Job::Preview => wanted.preview.is_some(),
            Job::Compare => wanted.compare.is_some(),
        }
    }

    /// Whether another model may be there before long, or what became of one was not taken yet.
    pub fn is_opening(&self) -> bool {
        let (wanted, running) = &*self.shared.lock();
        wanted.open.is_some() || running.open.is_some() || running.opened > 0
    }

    /// The next thing that happened, if any; never waits.
    pub fn poll(&mut self) -> Option<Event> {
        let event = self.events.try_recv().ok()?;
        let Running { events, opened, .. } = &mut self.shared.lock().1;
        *events -= 1;
        *opened -= usize::from(event.ends_opening());
        Some(event)
    }

    /// Whether nothing is running, nothing waits, and all events were taken.
    pub fn is_idle(&self) -> bool {
        let (wanted, running) = &*self.shared.lock();
        is_idle(wanted, running)
    }

    /// Waits for the next event, for programs without a window.
    ///
    /// # Errors
    /// Nothing happened for so long.
    pub fn wait(&mut self, longest: Duration) -> Result<Option<Event>> {
        let end = Instant::now() + longest;
        loop {
            if let Some(event) = self.poll() {
                return Ok(Some(event));
            }
            let inner = self.shared.lock();
            let (wanted, running) = &*inner;
            if is_idle(wanted, running) {
                return Ok(None);
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let what = format!("what was asked for has not come in {} s", longest.as_secs());
                return Err(Error::internal(what, "save the session, and report this"));
            }
            if running.events == 0 {
                drop(self.shared.changed.wait_timeout(inner, left));
            }
        }
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        for job in [Job::Open, Job::Evaluate, Job::Write, Job::Preview, Job::Compare] {
            self.cancel(job);
        }
        self.want(|wanted, _| wanted.end = true);
        // All work stops soon, but for that of a plugin in this process that hangs: it ends with the program.
        let end = Instant::now() + PARTING;
        for thread in self.threads.drain(..) {
            while !thread.is_finished() && Instant::now() < end {
                std::thread::sleep(Duration::from_millis(1));
            }
            if thread.is_finished() {
                let _ = thread.join();
            }
        }
    }
}
