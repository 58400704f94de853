//! The host as a plugin under check sees it, and the plugin's answers.

use crate::finding::{Checked, Finding};
use rayon::prelude::*;
use simod_plugin_api::{ErrorCode, HostCalls, LogLevel, PluginError, PluginResult};
use simod_session::deformer::line;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The host as the plugin under check sees it.
pub(crate) struct Listener {
    /// Whether the host lets the plugin go on.
    go_on: bool,
    /// Number of lines that the plugin said.
    lines: AtomicUsize,
}

impl Listener {
    /// Host that lets the plugin do its work.
    pub fn patient() -> Self {
        Self { go_on: true, lines: AtomicUsize::new(0) }
    }

    /// Host that asks the plugin to stop, from the first call on.
    pub fn impatient() -> Self {
        Self { go_on: false, ..Self::patient() }
    }

    /// Number of lines that the plugin said.
    pub fn lines(&self) -> usize {
        self.lines.load(Ordering::Relaxed)
    }
}

impl HostCalls for Listener {
    fn progress(&self, _: f64) -> bool {
        self.go_on
    }

    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        if self.go_on {
            // As in sessions: a single part takes less time here than another thread takes to wake up.
            if count == 1 { body(0) } else { (0..count).into_par_iter().for_each(body) }
        }
        self.go_on
    }

    fn log(&self, _: LogLevel, _: &str) {
        self.lines.fetch_add(1, Ordering::Relaxed);
    }
}

/// Refusal of a plugin to answer, with its message.
pub(crate) struct PluginRefusal(pub String);

/// Answer of a plugin, or its refusal.
pub(crate) type Answer<T> = Result<T, PluginRefusal>;

impl PluginRefusal {
    /// Finding where a plugin refuses ordinary input: the rule cannot be checked.
    pub fn of_ordinary(self) -> Finding {
        Finding::skip(format!("it refuses the ordinary model: {}", self.0))
    }
}

/// Answer of a call: a panic and a stop unasked end the rule, other errors are polite refusals.
pub(crate) fn answer<T>(call: &str, result: PluginResult<T>) -> Checked<Answer<T>> {
    match result {
        Ok(value) => Ok(Ok(value)),
        Err(error) if error.code == ErrorCode::PANICKED => Err(panicked(call, &error)),
        Err(error) if error.code == ErrorCode::CANCELLED => Err(Finding::fail(
            format!("{call} says that it was cancelled, and nobody asked it to stop"),
            "return `cancelled` where the host's `progress` says so, and nowhere else",
        )),
        Err(error) => Ok(Err(PluginRefusal(match line(&error.message) {
            text if text.is_empty() => "an error without a message".to_owned(),
            text => text,
        }))),
    }
}

/// A panic, as a finding.
pub(crate) fn panicked(call: &str, error: &PluginError) -> Finding {
    Finding::fail(
        format!("{call} {}", line(&error.message)),
        "return an error instead; `RUST_BACKTRACE=1 simod plugin check-rule FILE RULE` shows where it panics",
    )
}
