//! The engines that do the units of a plan: the value of `--emit`.

use clap::ValueEnum;
use simod_session::plan::Emit;

/// Engine that does the units of a plan.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineName {
    /// Makefile: `make -C DIR -j 8` does all units
    Make,
    /// slurm.sh: submits arrays of jobs with their dependencies
    Slurm,
    /// commands.txt: a line for each unit, by stages, for render farms
    Commands,
}

impl From<EngineName> for Emit {
    fn from(name: EngineName) -> Self {
        match name {
            EngineName::Make => Self::Make,
            EngineName::Slurm => Self::Slurm,
            EngineName::Commands => Self::Commands,
        }
    }
}

/// Each engine once, in the order of their scripts.
pub fn engines(names: &[EngineName]) -> Vec<Emit> {
    let mut emit: Vec<Emit> = names.iter().map(|name| (*name).into()).collect();
    emit.sort_unstable();
    emit.dedup();
    emit
}
