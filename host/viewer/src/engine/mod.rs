//! The engine: a thread that owns the samples and does the steps, so that the window never waits.
//!
//! Of requests to do steps, the latest wins: a waiting request is replaced. A running one goes on, so that
//! a drag is followed as quickly as the plugins are, unless its result is of no more use: see `wasted`. A
//! preparation that the newer request needs as well is never cancelled by it, or slow preparations would
//! never come to an end while a handle is dragged.
//!
//! The deformed model is written on a thread of its own, so that the edit goes on meanwhile; vertices that
//! are to be seen in full are streamed on another one.

mod comparing;
mod emerged;
mod preview;
mod requests;
mod shared;
mod thread;
mod wasted;
mod watch;

use crate::tint::Tint;
pub use emerged::{Emerged, SurfacePoints};

pub use requests::{CarriedSamples, ComparisonRequest, Event, Extra, Job, Opening, SamplePose, WriteRequest};
use requests::{StepsRequest, Streaming};
use shared::{RunningJobs, SharedState, WantedJobs, is_idle};
use simod_core::detail::DetailRequest;
use simod_model::{Error, Result};
use simod_plugin_api::Effort;
use simod_session::PluginRegistry;
use simod_session::edit::Entry;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thread::{EngineThread, Teller};
pub use watch::{Activity, Wake};

/// Time that work may go on after the window is closed.
const PARTING: Duration = Duration::from_secs(5);

/// The window's end of the engine.
pub struct Engine {
    shared: Arc<SharedState>,
    events: Receiver<Event>,
    requests: u64,
    threads: Vec<JoinHandle<()>>,
}

impl Engine {
    /// Starts the threads.
    pub fn new(plugins: Arc<PluginRegistry>, wake: Wake) -> Self {
        let (sender, events) = channel();
        let shared = Arc::new(SharedState::default());
        let tell = Teller::new(shared.clone(), sender, wake);
        let preview = preview::PreviewThread { shared: shared.clone(), tell: tell.clone() };
        let engine = EngineThread::new(shared.clone(), tell, plugins);
        let spawn = |name: &str, run: Box<dyn FnOnce() + Send>| {
            std::thread::Builder::new().name(name.into()).spawn(run).ok()
        };
        let threads = [
            spawn("engine", Box::new(move || engine.run())),
            spawn("preview", Box::new(move || preview.run())),
        ];
        Self { shared, events, requests: 0, threads: threads.into_iter().flatten().collect() }
    }

    fn want(&self, change: impl FnOnce(&mut WantedJobs, &mut RunningJobs)) {
        let mut inner = self.shared.lock();
        let (wanted, running) = &mut *inner;
        change(wanted, running);
        self.shared.changed.notify_all();
    }

    /// Opens a model or session. Jobs that run for the former model are cancelled, but not the writing of a
    /// model.
    pub fn open(&mut self, opening: Opening) {
        self.want(|wanted, running| {
            (wanted.open, wanted.evaluate, wanted.write) = (Some(opening), None, None);
            running.supersede(Job::Open);
            running.supersede(Job::Evaluate);
        });
        self.forget_preview();
        self.compare(None);
    }

    /// Has vertices streamed, instead of those that are being streamed; returns the request's number, which
    /// comes back with the vertices. `model` is the model's path, if it was moved.
    pub fn preview(
        &mut self,
        pose: SamplePose,
        chosen: DetailRequest,
        tint: Tint,
        model: Option<PathBuf>,
    ) -> u64 {
        self.requests += 1;
        let number = self.requests;
        self.want(|wanted, running| {
            running.supersede(Job::Preview);
            wanted.preview = Some(Streaming { number, pose, chosen, tint, model });
        });
        number
    }

    /// Streams no more vertices for now, and tells nobody.
    pub fn pause_preview(&mut self) {
        self.want(|wanted, running| {
            wanted.preview = None;
            running.supersede(Job::Preview);
        });
    }

    /// Lets go of the memory for the preview, as nothing is to be seen in full any more.
    pub fn forget_preview(&mut self) {
        self.pause_preview();
        self.want(|wanted, _| wanted.forget = true);
    }

    /// Has another version made, instead of a former one, or none any more.
    pub fn compare(&mut self, comparing: Option<ComparisonRequest>) {
        self.want(|wanted, running| {
            wanted.compare = comparing;
            running.supersede(Job::Compare);
        });
    }

    /// Has steps done, instead of those that wait; if wanted, with the [error to be
    /// expected](crate::ViewerScene::expected_error). Returns the request's number, which comes back with
    /// the result.
    pub fn evaluate(&mut self, steps: Arc<[Entry]>, effort: Effort, extra: Extra) -> u64 {
        self.requests += 1;
        let number = self.requests;
        self.want(|wanted, running| {
            if let (Some(watch), Some((before, was))) = (running.watch(Job::Evaluate), &running.evaluated) {
                let at = running.step.load(Relaxed);
                if wasted::is_wasted(before, *was, &steps, effort, at, watch.stage()) {
                    watch.supersede();
                }
            }
            wanted.evaluate = Some(StepsRequest { number, steps, effort, extra });
        });
        number
    }

    /// Writes the model that these steps deform; one at a time, the latest request waits.
    pub fn write(&mut self, steps: Arc<[Entry]>, writing: WriteRequest) {
        self.want(|wanted, _| wanted.write = Some((steps, writing)));
    }

    /// Takes other plugins from the next request on.
    pub fn set_plugins(&mut self, plugins: Arc<PluginRegistry>) {
        self.want(|wanted, _| wanted.plugins = Some(plugins));
    }

    /// Stops a job, and a request that waits to become one. A plugin in a process of its own is stopped
    /// even if it hangs.
    pub fn cancel(&mut self, job: Job) {
        self.want(|wanted, running| {
            wanted.give_up(job);
            running.watch(job).iter().for_each(|watch| watch.cancel());
        });
    }

    /// Progress of a job, if it is running.
    pub fn activity(&self, job: Job) -> Option<Activity> {
        self.shared.lock().1.watch(job).map(|watch| watch.activity())
    }

    /// Calls `look` with the samples of the model that is being opened, as far as they are there.
    pub fn emerged<T>(&self, look: impl FnOnce(&Emerged) -> T) -> Option<T> {
        let watch = self.shared.lock().1.watch(Job::Open)?.clone();
        watch.emerged(look)
    }

    /// The place of the step that is being done, if any is.
    pub fn step(&self) -> Option<usize> {
        let running = &self.shared.lock().1;
        running.watch(Job::Evaluate).map(|_| running.step.load(Relaxed))
    }

    /// Whether a job waits to be begun.
    pub fn wants(&self, job: Job) -> bool {
        self.shared.lock().0.has(job)
    }

    /// Whether another model may be there before long, or the outcome of an opening was not taken yet.
    pub fn is_opening(&self) -> bool {
        let (wanted, running) = &mut *self.shared.lock();
        wanted.has(Job::Open) || running.watch(Job::Open).is_some() || running.opened > 0
    }

    /// The next thing that happened, if any; never waits.
    pub fn poll(&mut self) -> Option<Event> {
        let event = self.events.try_recv().ok()?;
        let RunningJobs { events, opened, .. } = &mut self.shared.lock().1;
        *events -= 1;
        *opened -= usize::from(event.ends_opening());
        Some(event)
    }

    /// Whether nothing is running, nothing waits, and all events were taken.
    pub fn is_idle(&self) -> bool {
        let (wanted, running) = &mut *self.shared.lock();
        is_idle(wanted, running)
    }

    /// Waits for the next event, for programs without a window.
    ///
    /// # Errors
    /// There was no event for so long.
    pub fn wait(&mut self, longest: Duration) -> Result<Option<Event>> {
        let end = Instant::now() + longest;
        loop {
            if let Some(event) = self.poll() {
                return Ok(Some(event));
            }
            let mut inner = self.shared.lock();
            let (wanted, running) = &mut *inner;
            if is_idle(wanted, running) {
                return Ok(None);
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let what = format!("what was asked for has not come in {} s", longest.as_secs());
                return Err(Error::internal(what).hinting("save the session, and report this"));
            }
            if running.events == 0 {
                drop(self.shared.changed.wait_timeout(inner, left));
            }
        }
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        for job in Job::ALL {
            self.cancel(job);
        }
        self.want(|wanted, _| wanted.end = true);
        // All work stops soon, but that of a plugin in this process that hangs: it ends with the program.
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
