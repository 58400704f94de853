//! The plugins that the window has, and the process that runs one of those that did not come with the
//! program.

use simod_model::{Error, Result};
use simod_session::worker::{self, WorkerOptions};
use simod_session::{Isolation, PluginOptions, PluginRegistry};
use std::path::PathBuf;
use std::time::Duration;

/// How long a plugin in a process of its own may give no sign of life, and how much memory it may take: as
/// `simod` has it.
const PATIENCE: Duration = Duration::from_secs(120);
const MEMORY: u64 = 4 << 30;
/// The argument by which the program is told to run one.
pub const SERVE: &str = "serve-plugin";

/// Runs a plugin for a program of this kind: its library, the memory that it may take, and whose process it
/// is.
///
/// # Errors
/// The arguments are not those that the program itself gives, or the plugin cannot be run.
pub fn serve(rest: Vec<std::ffi::OsString>) -> Result<()> {
    let wrong = || Error::argument("the program calls this itself", "do not call it");
    let [file, memory, parent] = rest.as_slice() else { return Err(wrong()) };
    let memory = memory.to_str().and_then(|text| text.parse().ok()).ok_or_else(wrong)?;
    let parent = parent.to_str().and_then(|text| text.parse().ok()).ok_or_else(wrong)?;
    worker::serve(file.as_ref(), memory, parent)
}

/// The plugins in the standard folders.
pub fn discover() -> PluginRegistry {
    let program = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("simod-viewer"));
    let options = WorkerOptions { command: vec![program, SERVE.into()], silence: PATIENCE, memory: MEMORY };
    PluginRegistry::discover(&PluginOptions::standard(Isolation::Others, options))
}
