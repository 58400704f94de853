//! The plugins that the window has, and the process that runs one of those that did not come with the
//! program.

use simod_model::{Error, Result};
use simod_session::worker::{self, WorkerOptions};
use simod_session::{Isolation, PluginOptions, PluginRegistry};
use std::path::PathBuf;
use std::time::Duration;

/// Limits of a plugin in a process of its own, the same as in `simod`: time without a sign of life, and
/// memory in bytes.
const PATIENCE: Duration = Duration::from_secs(120);
const MEMORY: u64 = 4 << 30;
/// Argument by which the program is told to run a plugin.
pub const SERVE: &str = "serve-plugin";

/// Runs a plugin for a program of this kind. The arguments are the plugin's library, the memory that the
/// plugin may take, and the process that started this one.
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
