//! `simod deform`: a session's stack of plugins on the samples.

use std::path::PathBuf;

use clap::Args;
use simod_core::Result;
use simod_core::sampled_model::SampledModel;
use simod_session::{SessionFile, Stack, deform};

use super::plugin_options::PluginOptions;
use super::tell;
use crate::report::{Report, count};

/// Deform the samples by the steps of a session
#[derive(Args)]
pub struct Deform {
    /// The sampled model
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// The session; its steps are taken, its model and output are not
    #[arg(long, value_name = "FILE")]
    session: PathBuf,
    /// The deformed samples to write (PLY)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    plugins: PluginOptions,
}

impl Deform {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let session = SessionFile::load(&self.session)?;
        let stack = Stack::build(&session.steps, &self.plugins.discover(report))?;
        let sampled = SampledModel::load(&self.sampled)?;
        let deformed = deform(&sampled, &stack, report.progress())?;
        tell(&deformed.messages, report);
        sampled.write_deformed(&self.output, &deformed.positions, &deformed.normals)?;
        report.figure("vertices", sampled.source.vertices);
        report.figure("samples", sampled.samples.len());
        report.figure("layers", stack.len());
        report.line(format!(
            "{} samples deformed by {} in {}",
            count(sampled.samples.len() as u64),
            stack.plugins().map(|p| p.id()).collect::<Vec<_>>().join(", "),
            self.output.display()
        ));
        Ok(())
    }
}
