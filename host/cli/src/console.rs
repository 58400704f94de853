//! The terminal: progress and errors on standard error, cancel by Ctrl-C and by the signals that mean the
//! same.

use std::fmt::Write as _;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{HumanBytes, ProgressBar, ProgressDrawTarget, ProgressStyle};
use simod_model::memory::MemoryWatch;
use simod_model::{Error, Progress};

/// The exit code of a program that was stopped.
pub const CANCELLED: i32 = 130;

/// Time within which work that is asked to stop has to look whether it is.
const DEAF: Duration = Duration::from_secs(1);

/// Time that the work may take to stop after that.
const SLOW: Duration = Duration::from_secs(10);

/// Time between two lines of progress.
const PAUSE: Duration = Duration::from_millis(250);

/// Time between two drawings of the bar, and between two looks at the memory.
const TICK: Duration = Duration::from_millis(100);

/// Form of the progress on standard error.
#[derive(Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Show {
    /// A bar, where standard error is a terminal
    #[default]
    Auto,
    /// Lines for programs and logs: stage, percentage done, bytes per second
    Lines,
    /// No progress
    None,
}

/// The user's wish to stop, and whether the work knows of it.
#[derive(Default)]
struct Wish {
    cancelled: AtomicBool,
    is_known: AtomicBool,
}

/// Progress bar (silent where standard error is no terminal), clock of the stages, and cancel flag.
pub struct Console {
    wish: Arc<Wish>,
    memory: MemoryWatch,
    stages: Mutex<Stages>,
}

#[derive(Default)]
struct Stages {
    show: Show,
    bar: Option<ProgressBar>,
    told: Option<Instant>,
    /// Time when the bar was last told the memory.
    measured: Option<Instant>,
    current: Option<(&'static str, Instant)>,
    done: Vec<(&'static str, Duration)>,
}

impl Console {
    /// Takes over Ctrl-C and signals like it: the first asks the work to stop, the second ends the process.
    /// The first one ends the process, too, if the work does not look for it, as in a library that is being
    /// loaded.
    pub fn new() -> Self {
        let wish = Arc::new(Wish::default());
        let (for_signals, watched) = (wish.clone(), wish.clone());
        let watcher = start("cancel", move || watched.watch()).ok();
        // Without a handler Ctrl-C ends the process at once, which leaves hidden files at worst.
        let _ = signals::listen(move |again| for_signals.stop(again, watcher.as_ref()));
        Self { wish, memory: MemoryWatch::start(), stages: Mutex::default() }
    }

    /// The console of a process that works for another one, which asks it to stop by other means.
    pub fn of_worker() -> Self {
        let _ = signals::ignore_interrupt();
        Self { wish: Arc::default(), memory: MemoryWatch::start(), stages: Mutex::default() }
    }

    /// Chooses how progress is shown.
    pub fn show(&self, how: Show) {
        self.locked().show = how;
    }

    /// Peak anonymous memory so far.
    pub fn peak_memory(&self) -> Option<u64> {
        self.memory.peak()
    }

    /// Ends the current stage, and returns the time of each stage so far.
    pub fn stages(&self) -> Vec<(&'static str, Duration)> {
        let mut stages = self.locked();
        stages.end();
        stages.done.clone()
    }

    /// Prints an error with its advice.
    pub fn error(&self, error: &Error) {
        self.stages();
        let mut err = std::io::stderr().lock();
        // An error has nowhere to be told where standard error is closed.
        let _ = writeln!(err, "error: {}\nhint: {}", line(&error.to_string()), line(error.hint()));
    }

    /// Prints a line that the user should see though the work goes on.
    pub fn warn(&self, text: &str) {
        self.say("warning", text);
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, Stages> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn say(&self, what: &str, text: &str) {
        let stages = self.locked();
        let line = format!("{what}: {}", line(text));
        match &stages.bar {
            Some(bar) if !bar.is_hidden() => bar.println(line),
            _ => {
                let _ = writeln!(std::io::stderr(), "{line}");
            }
        }
    }
}

impl Wish {
    /// Asks the work to stop.
    fn stop(&self, again: bool, watcher: Option<&std::thread::Thread>) {
        if again {
            leave();
        }
        self.cancelled.store(true, Ordering::Relaxed);
        if let Some(watcher) = watcher {
            watcher.unpark();
        }
    }

    /// Ends the process if the work does not stop in time after it was asked to.
    fn watch(&self) {
        while !self.cancelled.load(Ordering::Relaxed) {
            std::thread::park();
        }
        std::thread::sleep(DEAF);
        if self.is_known.load(Ordering::Relaxed) {
            std::thread::sleep(SLOW);
        }
        let error = Error::cancelled();
        let _ = writeln!(std::io::stderr(), "error: {error}\nhint: {}", error.hint());
        leave();
    }
}

/// Starts a thread, and waits until it runs: a thread that begins while a library loads waits in the C
/// library until that is done.
fn start(name: &str, work: impl FnOnce() + Send + 'static) -> std::io::Result<std::thread::Thread> {
    let (running, runs) = std::sync::mpsc::channel();
    let thread = std::thread::Builder::new().name(name.into()).spawn(move || {
        let _ = running.send(());
        work();
    })?;
    let _ = runs.recv();
    Ok(thread.thread().clone())
}

/// Ends the process, without the outputs that it is writing.
fn leave() -> ! {
    simod_model::claim::abandon_all();
    // The end is at once: to end in order, the C library waits for libraries that are being loaded.
    #[cfg(unix)]
    signal_hook::low_level::exit(CANCELLED);
    #[cfg(not(unix))]
    std::process::exit(CANCELLED)
}

/// Signals that ask a program to stop.
#[cfg(unix)]
mod signals {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
    use signal_hook::iterator::Signals;

    /// Calls `told` for each of these signals, with whether the process is to end at once.
    pub fn listen(told: impl Fn(bool) + Send + 'static) -> std::io::Result<()> {
        let ignored = ignored();
        let is_wanted = |signal: &i32| {
            // Ignored signals stay ignored, as `nohup` and shells ask for: a process that ignores a limit
            // on files hears of the limit by the write that fails.
            ![SIGHUP, SIGXFSZ].contains(signal) || ignored.is_some_and(|set| (set >> (signal - 1)) & 1 == 0)
        };
        let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP, SIGXFSZ].into_iter().filter(is_wanted))?;
        let wait = move || {
            let mut before = false;
            for signal in signals.forever() {
                // Each write beyond the limit on files sends the signal, so that a second one means
                // nothing.
                told(before && signal != SIGXFSZ);
                before |= signal != SIGXFSZ;
            }
        };
        crate::console::start("signals", wait).map(drop)
    }

    /// Ignores Ctrl-C, which the terminal sends to all processes and which is not meant for this one.
    pub fn ignore_interrupt() -> std::io::Result<()> {
        let mut signals = Signals::new([SIGINT])?;
        crate::console::start("signals", move || signals.forever().for_each(drop)).map(drop)
    }

    /// The signals that this process was started to ignore, a bit each; nothing where the system does not
    /// tell.
    fn ignored() -> Option<u64> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let set = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
        u64::from_str_radix(set.trim(), 16).ok()
    }
}

/// See the version for Unix.
#[cfg(not(unix))]
mod signals {
    use std::sync::atomic::{AtomicBool, Ordering};

    pub fn listen(told: impl Fn(bool) + Send + 'static) -> Result<(), ctrlc::Error> {
        let before = AtomicBool::new(false);
        ctrlc::set_handler(move || told(before.swap(true, Ordering::Relaxed)))
    }

    pub fn ignore_interrupt() -> Result<(), ctrlc::Error> {
        ctrlc::set_handler(|| {})
    }
}

/// Text that may quote a file's content, on one line of a terminal.
pub fn line(text: &str) -> String {
    text.chars().map(|c| if simod_session::is_raw(c) { ' ' } else { c }).collect()
}

impl Stages {
    fn end(&mut self) {
        if let Some((name, since)) = self.current.take() {
            match self.done.iter_mut().find(|(n, _)| *n == name) {
                Some((_, spent)) => *spent += since.elapsed(),
                None => self.done.push((name, since.elapsed())),
            }
        }
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        self.told = None;
    }

    /// Prints the progress of the stage, where lines are wanted and none was printed for a while.
    fn line(&mut self) {
        if self.show != Show::Lines || self.told.is_some_and(|last| last.elapsed() < PAUSE) {
            return;
        }
        let (Some(bar), Some((stage, since))) = (&self.bar, self.current) else { return };
        self.told = Some(Instant::now());
        let done = bar.position();
        let mut text = format!("progress: {stage}");
        if let Some(total) = bar.length().filter(|total| *total > 0) {
            let _ = write!(text, " {}%", done.min(total) * 100 / total);
            if done > 0 {
                let rate = done as f64 / since.elapsed().as_secs_f64().max(1e-3);
                let _ = write!(text, ", {}/s", HumanBytes(rate as u64));
            }
        }
        let _ = writeln!(std::io::stderr(), "{text}");
    }
}

impl Progress for Console {
    fn begin(&self, stage: &'static str, total_bytes: u64) {
        let mut stages = self.locked();
        stages.end();
        let target = match stages.show {
            Show::Auto => ProgressDrawTarget::stderr_with_hz(10),
            Show::Lines | Show::None => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(Some(total_bytes), target);
        let template = if total_bytes > 0 {
            "{msg:>22} {bar:30} {percent:>3}%  {bytes_per_sec:>12}  {eta:>4} left"
        } else {
            "{msg:>22} {spinner}"
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(stage);
        bar.enable_steady_tick(TICK);
        stages.bar = Some(bar);
        stages.current = Some((stage, Instant::now()));
        stages.line();
    }

    fn advance(&self, bytes: u64) {
        let mut stages = self.locked();
        let stages = &mut *stages;
        stages.line();
        if let (Some(bar), Some((stage, _))) = (&stages.bar, stages.current) {
            bar.inc(bytes);
            // The memory is read seldom, and only where somebody sees it: the system takes longer to tell
            // than a chunk does.
            let is_due = stages.measured.is_none_or(|last| last.elapsed() >= TICK);
            if is_due
                && !bar.is_hidden()
                && let Some(peak) = self.memory.peak()
            {
                bar.set_message(format!("{stage} ({} MB)", peak >> 20));
                stages.measured = Some(Instant::now());
            }
        }
    }

    fn note(&self, text: &str) {
        self.say("note", text);
    }

    fn is_cancelled(&self) -> bool {
        let cancelled = self.wish.cancelled.load(Ordering::Relaxed);
        if cancelled {
            self.wish.is_known.store(true, Ordering::Relaxed);
        }
        cancelled
    }
}
