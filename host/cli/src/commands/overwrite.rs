//! What a command's outputs may replace: the same for all commands.

use clap::Args;
use simod_core::guard::Guard;

/// The option on files that are there already.
#[derive(Args)]
pub struct Overwrite {
    /// Replace a file that is there though it is of another kind than what is written; never one that this
    /// command reads
    #[arg(long)]
    force: bool,
}

impl Overwrite {
    /// As if the option was given, or was not.
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
}
