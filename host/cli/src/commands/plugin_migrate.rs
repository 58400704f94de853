//! `simod plugin migrate`: a session with the parameters that its plugins have today.

use std::path::PathBuf;

use clap::Args;
use simod_core::guard::OutputKind;
use simod_model::Result;
use simod_model::target::canonical_target;
use simod_session::SessionFile;
use simod_session::edit::saved_at;
use simod_session::session_file::inputs;

use super::notices;
use super::overwrite::Overwrite;
use super::plugin_options::PluginArgs;
use crate::report::Report;

/// Write a session anew with the parameters that its plugins have now
///
/// Sessions that are older than their plugins work as they are, and say what is changed each time. Comments
/// stay.
#[derive(Args)]
pub struct Migrate {
    /// Session file
    session: PathBuf,
    /// File to write the session to
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    plugins: PluginArgs,
}

impl Migrate {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut session = SessionFile::load(&self.session)?;
        let plugins = self.plugins.discover(report)?;
        let mut guard = self.overwrite.guard();
        guard.reads(&self.session);
        guard.reads_all(inputs(&self.session)?);
        guard.reads_all(plugins.files());
        guard.writes(&self.output, OutputKind::Session)?;
        notices(&plugins, &session.steps, report);
        let notes = plugins.migrate(&mut session.steps)?;
        for step in &session.steps {
            if let Some(deformation) = step.deformation() {
                // A plugin that is not there cannot say how its parameters changed.
                plugins.get(&deformation.deform)?;
            }
        }
        // A session names files relative to its folder, which the folder of a descriptor, as `/dev/stdout`,
        // is not.
        let place = if self.output.starts_with("/dev") || self.output.starts_with("/proc") {
            canonical_target(&self.output)?
        } else {
            self.output.clone()
        };
        saved_at(&session, &place, &plugins)?.save_over(&place, &self.session)?;
        report.figure("changes", notes.as_slice());
        if notes.is_empty() {
            report.line("the session is as its plugins have it");
        }
        notes.into_iter().for_each(|note| report.line(note));
        report.line(format!("wrote {}", self.output.display()));
        Ok(())
    }
}
