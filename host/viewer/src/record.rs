//! Recordings of edits: commands, one JSON object a line; and replaying them without a window.

use crate::command::Command;
use crate::state::State;
use simod_model::{Error, ErrorKind, Result};
use simod_session::PluginRegistry;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

/// Writes commands down as they are done. Whatever was shown when they were: what depends on where samples
/// were just then is written as what it came to.
pub struct Recorder(Box<dyn Write + Send>);

impl Recorder {
    /// Writes to this, a line at a time.
    pub fn new(to: impl Write + Send + 'static) -> Self {
        Self(Box::new(to))
    }

    /// One more command.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn push(&mut self, command: &Command) -> Result<()> {
        let failed = |e: &dyn std::fmt::Display| {
            Error::new(ErrorKind::Io, format!("cannot record a command: {e}"), "check the disk")
        };
        let mut line = serde_json::to_string(command).map_err(|e| failed(&e))?;
        line.push('\n');
        self.0.write_all(line.as_bytes()).and_then(|()| self.0.flush()).map_err(|e| failed(&e))
    }
}

/// The commands of a recording.
///
/// # Errors
/// A line is no command; it is named.
pub fn parse(text: &str) -> Result<Vec<Command>> {
    let command = |(i, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| {
            let what = format!("line {} of the recording is no command: {e}", i + 1);
            Error::new(ErrorKind::Format, what, "one JSON object a line, as recordings have")
        })
    };
    text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).map(command).collect()
}

/// How long a single command may take before a replay gives up.
const PATIENCE: Duration = Duration::from_secs(24 * 3600);

/// Does commands one after the other, waiting each time until all that they ask for is done.
///
/// # Errors
/// A command cannot be done; it is named.
pub fn replay(commands: &[Command], plugins: &Arc<PluginRegistry>) -> Result<State> {
    let mut state = State::new(plugins.clone(), Arc::new(|| ()));
    for (i, command) in commands.iter().enumerate() {
        state.apply(command.clone()).map_err(|e| {
            let what = format!("command {} of the recording cannot be done: {e}", i + 1);
            e.saying(what)
        })?;
        state.settle(PATIENCE)?;
    }
    Ok(state)
}
