//! The state that the window and the engine's threads share: requests that wait, and jobs that run.

use super::requests::{ComparisonRequest, Job, Opening, StepsRequest, Streaming, WriteRequest};
use super::watch::JobWatch;
use simod_plugin_api::Effort;
use simod_session::PluginRegistry;
use simod_session::edit::Entry;
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Requests that wait for the threads.
#[derive(Default)]
pub(super) struct WantedJobs {
    pub open: Option<Opening>,
    pub evaluate: Option<StepsRequest>,
    pub write: Option<(Arc<[Entry]>, WriteRequest)>,
    pub preview: Option<Streaming>,
    pub compare: Option<ComparisonRequest>,
    /// Whether nothing is to be seen in full any more.
    pub forget: bool,
    pub plugins: Option<Arc<PluginRegistry>>,
    pub end: bool,
}

impl WantedJobs {
    /// The requests that wait, by the number of their job.
    fn requests(&mut self) -> [&mut dyn PendingRequest; Job::ALL.len()] {
        let Self { open, evaluate, write, preview, compare, .. } = self;
        [open, evaluate, write, preview, compare]
    }

    /// Whether a job waits to be begun.
    pub fn has(&mut self, job: Job) -> bool {
        self.requests()[job as usize].is_there()
    }

    /// Drops the request for a job.
    pub fn give_up(&mut self, job: Job) {
        self.requests()[job as usize].drop();
    }
}

/// A request for a job, whatever it is for, while it waits.
trait PendingRequest {
    /// Whether there is a request.
    fn is_there(&self) -> bool;

    /// Drops the request.
    fn drop(&mut self);
}

impl<T> PendingRequest for Option<T> {
    fn is_there(&self) -> bool {
        self.is_some()
    }

    fn drop(&mut self) {
        *self = None;
    }
}

/// The jobs that run.
#[derive(Default)]
pub(super) struct RunningJobs {
    /// The progress of each job that runs, by its number.
    watches: [Option<Arc<JobWatch>>; Job::ALL.len()],
    /// The steps that are being done, or were last, and their effort.
    pub evaluated: Option<(Arc<[Entry]>, Effort)>,
    /// The place of the step that is being done.
    pub step: Arc<AtomicUsize>,
    /// Number of events that were sent, and not taken yet; and of those among them that are the outcome of
    /// an opening.
    pub events: usize,
    pub opened: usize,
}

impl RunningJobs {
    /// The progress of a job, if it runs.
    pub fn watch(&self, job: Job) -> Option<&Arc<JobWatch>> {
        self.watches[job as usize].as_ref()
    }

    /// Notes that a job runs from now on.
    pub fn begin(&mut self, job: Job, watch: &Arc<JobWatch>) {
        self.watches[job as usize] = Some(watch.clone());
    }

    /// Notes that a job is over.
    pub fn end(&mut self, job: Job) {
        self.watches[job as usize] = None;
    }

    /// Stops a job, if it runs, for a newer request.
    pub fn supersede(&self, job: Job) {
        self.watch(job).iter().for_each(|watch| watch.supersede());
    }
}

/// The state of all threads: jobs that are wanted and that run, and the threads that wait for a change of
/// them.
#[derive(Default)]
pub(super) struct SharedState {
    inner: Mutex<(WantedJobs, RunningJobs)>,
    pub changed: Condvar,
}

impl SharedState {
    pub fn lock(&self) -> MutexGuard<'_, (WantedJobs, RunningJobs)> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether nothing is running, nothing waits, and all events were taken.
pub(super) fn is_idle(wanted: &mut WantedJobs, running: &RunningJobs) -> bool {
    Job::ALL.iter().all(|job| !wanted.has(*job) && running.watch(*job).is_none()) && running.events == 0
}
