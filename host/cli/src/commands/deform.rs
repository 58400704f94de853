//! `simod deform`: a session's stack of plugins on the samples.

use std::path::{Path, PathBuf};

use clap::Args;
use simod_core::guard::OutputKind;
use simod_core::sampled_model::SampledModel;
use simod_model::target::folder_of;
use simod_model::{Error, Result};
use simod_session::edit::Refinements;
use simod_session::session_file::inputs;
use simod_session::{SessionFile, Stack, deform};

use super::overwrite::Overwrite;
use super::plugin_options::PluginArgs;
use super::time_options::TimeOptions;
use super::{notices, tell};
use crate::report::{Report, count};

/// Deform the samples of a model by the steps of a session
#[derive(Args)]
pub struct Deform {
    /// Folder of the sampled model
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// Session file: its steps are done, its model and output are not used
    #[arg(long, value_name = "FILE")]
    session: PathBuf,
    /// PLY file to write the deformed samples to
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Model that was sampled, if its file has moved since
    ///
    /// It is read where a step refines, or where a plugin asks for colours or other attributes that the
    /// sampled model does not keep yet.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Folder to write the refined model to; needed if a step of the session refines
    ///
    /// The deformed samples are then those of the refined model.
    #[arg(long, value_name = "DIR")]
    refined: Option<PathBuf>,
    #[command(flatten)]
    time: TimeOptions,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    plugins: PluginArgs,
}

impl Deform {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let session = SessionFile::load(&self.session)?;
        let refined = self.refined_folder(&session)?.map(Path::to_owned);
        let plugins = self.plugins.discover(report)?;
        let mut guard = self.overwrite.guard();
        guard.reads_all([&self.sampled, &self.session]);
        guard.reads_all(inputs(&self.session)?);
        guard.reads_all(plugins.files());
        notices(&plugins, &session.steps, report);
        let stack = Stack::build(&session.steps, &plugins)?;
        let mut sampled = SampledModel::load(&self.sampled)?;
        guard.reads_all(sampled.source.files());
        guard.reads_all(&self.model);
        guard.writes(&self.output, OutputKind::Model)?;
        let begun = refined.as_deref().map(|folder| {
            guard.replaces_folder(folder)?;
            SampledModel::begin(folder)
        });
        let begun = begun.transpose()?;
        let progress = report.progress();
        let time = self.time.over(session.time)?.time();
        let mut how = Refinements { model: self.model.clone(), time, ..Refinements::default() };
        if let Some(folder) = &refined {
            sampled.hold_cells(sampled.cells_or_resample(&self.sampled, self.model.as_deref(), progress)?);
            how.folder = folder_of(folder).to_owned();
        }
        let deformed = deform(sampled, &session.steps, &plugins, how, progress)?;
        let sampled = &deformed.sampled;
        if let Some(begun) = begun {
            sampled.save_in(begun)?;
        }
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

    /// Folder for the refined model, if the session refines.
    fn refined_folder(&self, session: &SessionFile) -> Result<Option<&Path>> {
        let mut refinements = session.steps.iter().filter(|step| step.enabled && step.refines());
        let Some(first) = refinements.next() else { return Ok(None) };
        let folder = self.refined.as_deref().ok_or_else(|| {
            Error::argument(
                format!("{}: this step refines the samples", first.place),
                "say with --refined where the refined model goes, which the deformed samples belong to",
            )
        })?;
        SampledModel::check_target(folder)?;
        Ok(Some(folder))
    }
}
