//! `simod view`: the window, which is a program of its own, so that this one needs nothing to draw with.

use std::env::consts::EXE_SUFFIX;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::Command;

use clap::Args;
use simod_model::{Error, Result};

/// Edit a model, the folder of a sampled one, or a session in a window
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct View {
    /// Arguments of `simod-viewer`, which `simod view --help` lists
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

impl View {
    pub fn execute(self) -> Result<()> {
        let program = format!("simod-viewer{EXE_SUFFIX}");
        // The viewer beside this program fits it; otherwise the system looks in its folders.
        let beside = std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(&program)));
        let path = beside.filter(|path| path.is_file()).unwrap_or_else(|| PathBuf::from(&program));
        let status = Command::new(&path).args(self.arguments).status().map_err(|e| {
            let what = format!("cannot start {}: {e}", path.display());
            Error::system(what, "build it with `cargo build --release -p simod-window`")
        })?;
        if status.success() {
            return Ok(());
        }
        let hint = "see what it says above";
        Err(Error::system(format!("simod-viewer ended with {status}"), hint))
    }
}
