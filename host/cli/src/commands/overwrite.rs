//! The option on files that a command's outputs may replace: the same for all commands.

use std::path::Path;

use clap::Args;
use simod_core::guard::Guard;
use simod_model::{ModelName, Result};
use simod_session::session_file::inputs;
use simod_session::{PluginRegistry, SessionFile, sidecar};

/// The option on files that are there already.
#[derive(Args)]
pub struct Overwrite {
    /// Replace files of another kind than what is written
    ///
    /// Files of the same kind are replaced without it. Files that this command reads are never replaced.
    #[arg(long)]
    force: bool,
}

impl Overwrite {
    /// The options as if `--force` was given, or was not.
    pub fn forcing(force: bool) -> Self {
        Self { force }
    }

    /// Whether files of another kind are replaced.
    pub fn force(&self) -> bool {
        self.force
    }

    /// The guard of a command that reads nothing so far.
    pub fn guard(&self) -> Guard {
        Guard::new(self.force)
    }

    /// The guard of a command that does the session of a file, all of whose inputs it reads, and writes its
    /// deformed model.
    pub fn guard_session(
        &self,
        path: &Path,
        session: &SessionFile,
        plugins: &PluginRegistry,
        output: &Path,
    ) -> Result<Guard> {
        let mut guard = self.guard();
        guard.reads(path);
        let named = session.named_model()?;
        guard.reads_all(named.iter().flat_map(ModelName::files));
        guard.reads_all(session.model.as_deref().map(sidecar::path_beside));
        guard.reads_all(inputs(path)?);
        guard.reads_all(plugins.files());
        guard.writes_model(output, &named.map_or(Vec::new(), |named| named.written_tiles()))?;
        Ok(guard)
    }
}
