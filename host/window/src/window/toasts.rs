//! Messages that go away.

use crate::wording::in_window;
use simod_model::Error;
use simod_viewer::engine::Job;
use std::time::{Duration, Instant};

/// Time for which a note stays, and an error.
const STAYS: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(20)];
/// Greatest number of messages.
const MOST: usize = 5;

/// A message.
pub struct Toast {
    /// The message.
    pub text: String,
    /// The advice; may be empty.
    pub hint: String,
    /// Whether the message tells of a failure.
    pub is_error: bool,
    /// The cause, with which the message goes away once it is mended.
    cause: Option<Cause>,
    since: Instant,
}

impl Toast {
    fn stays(&self) -> Duration {
        STAYS[usize::from(self.is_error)]
    }
}

/// Cause of an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// A command that could not be done: the next one mends it.
    Command,
    /// A job that failed, until it succeeds.
    Job(Job),
}

/// The messages, oldest first.
#[derive(Default)]
pub struct Toasts(Vec<Toast>);

impl Toasts {
    /// Adds a note.
    pub fn note(&mut self, text: impl Into<String>) {
        self.push(text.into(), String::new(), false, None);
    }

    /// Adds an error.
    pub fn error(&mut self, error: &Error) {
        self.push(error.to_string(), error.hint().to_owned(), true, None);
    }

    /// Adds an error whose cause may be mended.
    pub fn error_of(&mut self, cause: Cause, error: &Error) {
        let [text, hint] = [&error.to_string(), error.hint()].map(|text| in_window(text, None));
        self.push(text, hint, true, Some(cause));
    }

    /// Removes the errors with a cause that is mended.
    pub fn leave(&mut self, cause: Cause) {
        self.0.retain(|toast| toast.cause != Some(cause));
    }

    /// Lets messages go that are too old.
    pub fn leave_old(&mut self) {
        self.0.retain(|toast| toast.since.elapsed() < toast.stays());
    }

    /// All messages, and the time until the first one goes.
    pub fn shown(&self) -> (&[Toast], Option<Duration>) {
        let left = self.0.iter().map(|toast| toast.stays().saturating_sub(toast.since.elapsed())).min();
        (&self.0, left)
    }

    /// Removes a message.
    pub fn close(&mut self, i: usize) {
        self.0.remove(i);
    }

    /// Texts of the messages.
    pub fn texts(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|toast| toast.text.as_str())
    }

    fn push(&mut self, text: String, hint: String, is_error: bool, cause: Option<Cause>) {
        // A message that comes again stays longer.
        self.0.retain(|toast| toast.text != text);
        self.0.push(Toast { text, hint, is_error, cause, since: Instant::now() });
        let surplus = self.0.len().saturating_sub(MOST);
        self.0.drain(..surplus);
    }
}
