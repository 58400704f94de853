//! Long work beside the interpreter: on a thread of its own, without the lock. The thread that asked for it
//! looks after signals, calls the progress function, and stops the work where either of them raises.

use std::num::NonZeroU32;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use simod_model::{Error, ErrorKind, Progress, Result};

use crate::errors::exception;

/// Time between two looks at signals and progress.
const TICK: Duration = Duration::from_millis(50);

/// Works that are going on, and whether the interpreter is about to end.
static GOING_ON: Mutex<u64> = Mutex::new(0);
static ONE_LESS: Condvar = Condvar::new();
static ENDING: AtomicBool = AtomicBool::new(false);

/// Number of the process that has the threads of the pool; 0 where they were not started yet.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// Exception that a Python function called by work raised last.
static RAISED: Mutex<Option<PyErr>> = Mutex::new(None);

/// Keeps the exception of a function, to be the cause of the work's error.
pub fn keep_raised(error: PyErr) {
    *locked(&RAISED) = Some(error);
}

/// The progress of work, and the wish that it shall stop.
#[derive(Default)]
pub struct Watch {
    cancelled: AtomicBool,
    stage: Mutex<WorkStage>,
    done: AtomicU64,
    notes: Mutex<Vec<String>>,
}

#[derive(Default, Clone, Copy)]
struct WorkStage {
    name: &'static str,
    total: u64,
}

impl Progress for Watch {
    fn begin(&self, name: &'static str, total: u64) {
        *locked(&self.stage) = WorkStage { name, total };
        self.done.store(0, Ordering::Relaxed);
    }

    fn advance(&self, bytes: u64) {
        self.done.fetch_add(bytes, Ordering::Relaxed);
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    fn note(&self, text: &str) {
        locked(&self.notes).push(text.to_owned());
    }
}

impl Watch {
    /// Stage, and the part of it that is done: none where that is not known.
    fn place(&self) -> (&'static str, Option<f64>) {
        let WorkStage { name, total } = *locked(&self.stage);
        let done = self.done.load(Ordering::Relaxed);
        (name, (total > 0).then(|| (done as f64 / total as f64).min(1.0)))
    }
}

/// Count of work, as long as the work goes on.
struct GoingOn;

impl GoingOn {
    fn begin() -> PyResult<Self> {
        let mut count = locked(&GOING_ON);
        if ENDING.load(Ordering::Relaxed) {
            return Err(PyRuntimeError::new_err("the interpreter is about to end"));
        }
        *count += 1;
        Ok(Self)
    }
}

impl Drop for GoingOn {
    fn drop(&mut self) {
        *locked(&GOING_ON) -= 1;
        ONE_LESS.notify_all();
    }
}

/// Stops all work, and waits until it has ended: as the interpreter ends, threads that wait for its lock
/// would never get it.
#[pyfunction(name = "_stop_all")]
pub fn stop_all(py: Python<'_>) {
    ENDING.store(true, Ordering::Relaxed);
    py.detach(|| {
        let mut count = locked(&GOING_ON);
        while *count > 0 {
            count = ONE_LESS.wait(count).unwrap_or_else(PoisonError::into_inner);
        }
    });
}

/// Listener that the argument `progress` of a function means: a function, or none.
fn listener<'py>(progress: Option<&Bound<'py, PyAny>>) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(progress) = progress.filter(|p| !p.is_none()) else { return Ok(None) };
    if let Ok(wanted) = progress.extract::<bool>() {
        let bar = || progress.py().import("simod._bar")?.getattr("Bar")?.call0();
        return wanted.then(bar).transpose();
    }
    if progress.is_callable() {
        return Ok(Some(progress.clone()));
    }
    Err(PyTypeError::new_err("progress is neither True nor a function (stage: str, fraction: float | None)"))
}

/// A result that a thread hands to another one.
#[derive(Default)]
struct Finish {
    is_over: Mutex<bool>,
    changed: Condvar,
}

impl Finish {
    fn tell(&self) {
        *locked(&self.is_over) = true;
        self.changed.notify_all();
    }

    /// Whether the result is there, after a while at most.
    fn wait(&self) -> bool {
        let is_over = locked(&self.is_over);
        let waited = self.changed.wait_timeout_while(is_over, TICK, |over| !*over);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Tells that work is over, whatever became of its thread.
struct Telling<'a>(&'a Finish);

impl Drop for Telling<'_> {
    fn drop(&mut self) {
        self.0.tell();
    }
}

/// Does work, and returns its result with the notes on it. The first exception of `progress` or a signal
/// stops the work, and is raised.
pub fn work<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Watch) -> Result<T> + Send,
) -> PyResult<(T, Vec<String>)> {
    let listener = listener(progress)?;
    let _going_on = GoingOn::begin()?;
    let (watch, finish) = (Watch::default(), Finish::default());
    let (done, raised) = thread::scope(|scope| {
        let thread = scope.spawn(|| {
            let _telling = Telling(&finish);
            in_pool(|| work(&watch))
        });
        let mut raised = None;
        while !py.detach(|| finish.wait()) {
            if ENDING.load(Ordering::Relaxed) {
                watch.cancelled.store(true, Ordering::Relaxed);
            }
            if raised.is_none() {
                let (stage, fraction) = watch.place();
                let tell =
                    || listener.as_ref().filter(|_| !stage.is_empty()).map(|l| l.call1((stage, fraction)));
                if let Err(e) = py.check_signals().and_then(|()| tell().transpose().map(drop)) {
                    watch.cancelled.store(true, Ordering::Relaxed);
                    raised = Some(e);
                }
            }
        }
        (py.detach(|| thread.join()).unwrap_or_else(|panic| resume_unwind(panic)), raised)
    });
    if let Some(listener) = &listener {
        let (stage, _) = watch.place();
        let last = if raised.is_none() && done.is_ok() { Some(listener.call1((stage, 1.0))) } else { None };
        if listener.hasattr("close")? {
            listener.call_method0("close")?;
        }
        last.transpose()?;
    }
    let notes = std::mem::take(&mut *locked(&watch.notes));
    match (done, raised) {
        (_, Some(raised)) => Err(raised),
        (Ok(done), None) => Ok((done, notes)),
        (Err(e), None) => Err(failed(py, &e)),
    }
}

/// Exception for an error of work, with the exception of a Python function as its cause.
fn failed(py: Python<'_>, error: &Error) -> PyErr {
    let exception = exception(py, error);
    let cause = locked(&RAISED).take();
    if error.kind() == ErrorKind::Plugin {
        exception.set_cause(py, cause);
    }
    exception
}

/// Passes on notes for the user on work that was done.
pub fn warn(py: Python<'_>, notes: &[String]) -> PyResult<()> {
    let category = py.import("simod._errors")?.getattr("SimodWarning")?;
    let warn = py.import("warnings")?.getattr("warn")?;
    notes.iter().try_for_each(|note| warn.call1((note, &category, 1)).map(drop))
}

/// Does work on threads that exist: those of the pool do not in a process that was forked from the one that
/// made them.
fn in_pool<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let here = std::process::id();
    let owner = OWNER.compare_exchange(0, here, Ordering::Relaxed, Ordering::Relaxed).unwrap_or_else(|o| o);
    if NonZeroU32::new(owner).is_none_or(|owner| owner.get() == here) {
        return work();
    }
    match rayon::ThreadPoolBuilder::new().build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}

/// Locks a mutex, whatever became of the thread that held it last.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
