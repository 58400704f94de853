//! Recordings of edits: commands, one JSON object a line.

use crate::command::Command;
use simod_model::{Error, Result};
use std::io::Write;

/// Recorder that writes commands down as they are done. A command that depends on the samples' positions
/// just then is written as one with the same effect anywhere.
pub struct Recorder(Box<dyn Write + Send>);

impl Recorder {
    /// Recorder that writes to `to`, a line at a time.
    pub fn new(to: impl Write + Send + 'static) -> Self {
        Self(Box::new(to))
    }

    /// Writes a command down.
    ///
    /// # Errors
    /// The command cannot be written.
    pub fn push(&mut self, command: &Command) -> Result<()> {
        let failed = |e: &dyn std::fmt::Display| {
            Error::system(format!("cannot record a command: {e}"), "check the disk")
        };
        let mut line = serde_json::to_string(command).map_err(|e| failed(&e))?;
        line.push('\n');
        self.0.write_all(line.as_bytes()).and_then(|()| self.0.flush()).map_err(|e| failed(&e))
    }
}

/// The commands of a recording.
///
/// # Errors
/// A line is no command; the error names the line.
pub fn parse(text: &str) -> Result<Vec<Command>> {
    let command = |(i, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| {
            let what = format!("line {} of the recording is no command: {e}", i + 1);
            Error::format(what, "one JSON object a line, as recordings have")
        })
    };
    text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).map(command).collect()
}
