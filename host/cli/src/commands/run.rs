//! `simod run`: a session from the model to the deformed model.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use simod_core::Result;
use simod_core::guard::Kind;
use simod_core::reconstruction::Reconstruction;
use simod_core::reconstruction::transfer_error::TransferError;
use simod_session::session_file::inputs;
use simod_session::{Run as Pipeline, SessionFile};

use super::overwrite::Overwrite;
use super::plugin_options::PluginOptions;
use super::reconstruct::{MethodName, NormalsName};
use super::{notices, tell, warn_non_finite};
use crate::report::{Report, count, rate};

/// Do a whole session: sample its model, deform the samples, write the deformed model
#[derive(Args)]
pub struct Run {
    /// The session
    session: PathBuf,
    /// The deformed model to write, instead of the session's own output
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The model, if it is not where the session says
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// How to transfer the deformation
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    /// What becomes of the model's normals
    #[arg(long, value_enum, default_value_t)]
    normals: NormalsName,
    /// Compare the result with the exact deformation of every vertex, where all plugins know it
    #[arg(long)]
    measure: bool,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    plugins: PluginOptions,
}

impl Run {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut session = SessionFile::load(&self.session)?;
        session.model = self.model.or(session.model);
        let output = match self.output {
            Some(output) => output,
            None => session.output_beside(&self.session)?.to_owned(),
        };
        let how = Reconstruction {
            method: self.method.into(),
            normals: self.normals.into(),
            ..Reconstruction::default()
        };
        let plugins = self.plugins.discover(report)?;
        let mut guard = self.overwrite.guard();
        guard.reads(&self.session);
        guard.reads_all(&session.model);
        guard.reads_all(inputs(&self.session)?);
        guard.reads_all(plugins.files());
        guard.writes(&output, Kind::Model)?;
        notices(&plugins, &session.steps, report);
        let progress = report.progress();
        let run = Pipeline::execute(&session, &plugins, &how, self.measure, &output, progress)?;
        describe(&run, report);
        if self.measure {
            describe_error(&run.transfer_error(progress)?, report);
        }
        report.line(format!("wrote {}", output.display()));
        Ok(())
    }
}

/// Reports a finished run.
pub fn describe(run: &Pipeline, report: &mut Report) {
    warn_non_finite(&run.deformed.sampled, report);
    tell(&run.deformed.messages, report);
    let (vertices, samples) = (run.deformed.sampled.source.vertices, run.deformed.sampled.samples.len());
    report.figure("vertices", vertices);
    report.figure("samples", samples);
    report.figure("vertices_per_second", vertices as f64 / run.seconds.max(1e-9));
    report.line(format!(
        "{} vertices through {} samples, {}",
        count(vertices),
        count(samples as u64),
        rate(vertices, run.seconds)
    ));
    // Here, before anything is measured or drawn, which is not part of an edit.
    if let Some(peak) = report.peak_memory() {
        report.figure("run_peak_memory_bytes", peak);
        report.line(format!("peak memory of the edit {} MB", peak.div_ceil(1 << 20)));
    }
}

/// Reports how far a run is from the exact deformation.
pub fn describe_error(error: &TransferError, report: &mut Report) {
    report.line(format!(
        "transfer error: rms {:.1e}, 99.9 % below {:.1e}, worst {:.1e} of the diagonal",
        error.rms, error.p999, error.max
    ));
    report.figure(
        "transfer_error",
        json!({"vertices": error.vertices, "rms": error.rms, "p999": error.p999, "max": error.max, "jump": error.jump}),
    );
}
