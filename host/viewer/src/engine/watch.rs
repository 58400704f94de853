//! Progress of a job, as the window reads it and the job's thread tells it.

use super::emerged::Emerged;
use simod_model::Progress;
use simod_model::memory::anonymous;
use simod_model::progress::{Emerging, Glimpse};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Function that is called from any thread when there is news for the window: an event, or progress.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// Present activity of a job.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Activity {
    /// A few words for the user.
    pub stage: &'static str,
    /// Share of the stage that is done, 0 to 1; nothing where that is not known.
    pub fraction: Option<f32>,
    /// Bytes of the stage a second; nothing where the stage is not of bytes.
    pub rate: Option<f64>,
    /// Seconds since the job began.
    pub seconds: f64,
    /// Memory that the program holds now, in bytes, where the system tells.
    pub memory: Option<u64>,
}

/// The kind of a stage, for those who decide whether the work is still of use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StageKind {
    /// Preparation of a step, which does not depend on motions.
    Preparation,
    /// Any other stage.
    Other,
}

struct WatchedStage {
    kind: StageKind,
    name: &'static str,
    total: u64,
    /// Whether the stage counts bytes.
    of_bytes: bool,
    since: Instant,
}

/// The progress of one job.
pub(super) struct JobWatch {
    wake: Wake,
    begun: Instant,
    stage: Mutex<WatchedStage>,
    done: AtomicU64,
    cancelled: AtomicBool,
    /// Whether the job was stopped for a newer request, which nobody needs to be told.
    superseded: AtomicBool,
    /// Hundredths of the stage that the window knows of.
    told: AtomicU64,
    notes: Mutex<Vec<String>>,
    emerged: Mutex<Option<Emerged>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl JobWatch {
    pub fn new(wake: Wake) -> Self {
        let now = Instant::now();
        Self {
            wake,
            begun: now,
            stage: Mutex::new(WatchedStage {
                kind: StageKind::Other,
                name: "starting",
                total: 0,
                of_bytes: false,
                since: now,
            }),
            done: AtomicU64::new(0),
            cancelled: AtomicBool::new(false),
            superseded: AtomicBool::new(false),
            told: AtomicU64::new(0),
            notes: Mutex::new(Vec::new()),
            emerged: Mutex::new(None),
        }
    }

    pub fn cancel(&self) {
        self.cancelled.store(true, Relaxed);
    }

    /// Cancels the job for a newer request.
    pub fn supersede(&self) {
        self.superseded.store(true, Relaxed);
        self.cancel();
    }

    pub fn is_superseded(&self) -> bool {
        self.superseded.load(Relaxed)
    }

    pub fn activity(&self) -> Activity {
        let (stage, done) = (lock(&self.stage), self.done.load(Relaxed));
        let fraction = (stage.total > 0).then(|| (done as f64 / stage.total as f64).min(1.0) as f32);
        let rate = done as f64 / stage.since.elapsed().as_secs_f64().max(1e-3);
        let rate = (stage.of_bytes && stage.total > 0).then_some(rate);
        let (seconds, memory) = (self.begun.elapsed().as_secs_f64(), anonymous());
        Activity { stage: stage.name, fraction, rate, seconds, memory }
    }

    /// The stage that the job is in.
    pub fn stage(&self) -> StageKind {
        lock(&self.stage).kind
    }

    fn start(&self, kind: StageKind, name: &'static str, total: u64, of_bytes: bool) {
        *lock(&self.stage) = WatchedStage { kind, name, total, of_bytes, since: Instant::now() };
        self.done.store(0, Relaxed);
        self.told.store(0, Relaxed);
        (self.wake)();
    }

    /// Calls `look` with the samples that have emerged, if there are any.
    pub fn emerged<T>(&self, look: impl FnOnce(&Emerged) -> T) -> Option<T> {
        lock(&self.emerged).as_ref().map(look)
    }

    /// Notes of the job since the last call.
    pub fn take_notes(&self) -> Vec<String> {
        std::mem::take(&mut lock(&self.notes))
    }
}

impl Progress for JobWatch {
    fn begin(&self, stage: &'static str, total: u64) {
        self.start(StageKind::Other, stage, total, true);
    }

    fn begin_parts(&self, stage: &'static str, total: u64) {
        self.start(StageKind::Other, stage, total, false);
    }

    fn begin_preparation(&self, stage: &'static str, total: u64) {
        self.start(StageKind::Preparation, stage, total, false);
    }

    fn advance(&self, bytes: u64) {
        let done = self.done.fetch_add(bytes, Relaxed) + bytes;
        let total = lock(&self.stage).total.max(1);
        let hundredths = (done as f64 / total as f64 * 100.0) as u64;
        if self.told.fetch_max(hundredths, Relaxed) < hundredths {
            (self.wake)();
        }
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Relaxed)
    }

    fn emerge(&self, samples: &Emerging<'_>) {
        lock(&self.emerged).get_or_insert_default().add(samples);
    }

    fn glimpse(&self, model: &mut Glimpse<'_>) {
        let seen = Emerged::glimpse(model, || self.is_cancelled());
        *lock(&self.emerged) = seen;
        (self.wake)();
    }

    fn note(&self, text: &str) {
        lock(&self.notes).push(text.to_owned());
        (self.wake)();
    }
}
