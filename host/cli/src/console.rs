//! The terminal: progress and errors on standard error, cancel by Ctrl-C.

use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use simod_core::memory::MemoryWatch;
use simod_core::{Error, Progress};

/// Progress bar (silent where standard error is no terminal), clock of the stages, and cancel flag.
pub struct Console {
    cancelled: Arc<AtomicBool>,
    memory: MemoryWatch,
    stages: Mutex<Stages>,
}

#[derive(Default)]
struct Stages {
    bar: Option<ProgressBar>,
    current: Option<(&'static str, Instant)>,
    done: Vec<(&'static str, Duration)>,
}

impl Console {
    /// Takes over Ctrl-C: the first asks the work to stop, the second ends the process.
    pub fn new() -> Self {
        let cancelled = Arc::new(AtomicBool::new(false));
        let flag = cancelled.clone();
        // Without a handler Ctrl-C ends the process at once, which leaves a temporary file at worst.
        let _ = ctrlc::set_handler(move || {
            if flag.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        });
        Self { cancelled, memory: MemoryWatch::start(), stages: Mutex::default() }
    }

    /// Peak anonymous memory so far.
    pub fn peak_memory(&self) -> Option<u64> {
        self.memory.peak()
    }

    /// Ends the current stage; the time that each one took so far.
    pub fn stages(&self) -> Vec<(&'static str, Duration)> {
        let mut stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        stages.end();
        stages.done.clone()
    }

    /// Prints an error: what is wrong, and what to do about it.
    pub fn error(&self, error: &Error) {
        self.stages();
        let mut err = std::io::stderr().lock();
        // Nothing is left to tell it to where standard error is closed.
        let _ = writeln!(err, "error: {}\nhint: {}", line(&error.to_string()), line(error.hint()));
    }

    /// Prints a line that the user should see though the work goes on.
    pub fn warn(&self, text: &str) {
        self.say("warning", text);
    }

    fn say(&self, what: &str, text: &str) {
        let stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        let line = format!("{what}: {}", line(text));
        match &stages.bar {
            Some(bar) if !bar.is_hidden() => bar.println(line),
            _ => {
                let _ = writeln!(std::io::stderr(), "{line}");
            }
        }
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
    }
}

impl Progress for Console {
    fn begin(&self, stage: &'static str, total_bytes: u64) {
        let mut stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        stages.end();
        let bar = ProgressBar::with_draw_target(Some(total_bytes), ProgressDrawTarget::stderr_with_hz(10));
        let template = if total_bytes > 0 {
            "{msg:>22} {bar:30} {percent:>3}%  {bytes_per_sec:>12}  {eta:>4} left"
        } else {
            "{msg:>22} {spinner}"
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(stage);
        bar.enable_steady_tick(Duration::from_millis(100));
        stages.bar = Some(bar);
        stages.current = Some((stage, Instant::now()));
    }

    fn advance(&self, bytes: u64) {
        let stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        if let (Some(bar), Some((stage, _))) = (&stages.bar, stages.current) {
            bar.inc(bytes);
            if let Some(peak) = self.memory.peak().filter(|_| !bar.is_hidden()) {
                bar.set_message(format!("{stage} ({} MB)", peak >> 20));
            }
        }
    }

    fn note(&self, text: &str) {
        self.say("note", text);
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}
