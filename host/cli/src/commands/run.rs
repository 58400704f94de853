//! `simod run`: a session from the model to the deformed model.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use simod_core::guard::OutputKind;
use simod_core::reconstruction::Reconstruction;
use simod_core::reconstruction::transfer_error::TransferError;
use simod_model::{Progress, Result};
use simod_session::{Certificate, ExactCost, Run as Pipeline, Running, SessionFile, Tolerance};

use super::follow_options::FollowOptions;
use super::overwrite::Overwrite;
use super::plugin_options::PluginArgs;
use super::reconstruct::{
    MethodName, NormalsName, OffsetName, describe_expected, expected_figure, warn_beyond,
};
use super::time_options::TimeOptions;
use super::{notices, tell, tell_cache, tell_transparent, warn_non_finite};
use crate::report::{Report, count, errors, length, rate, with_lengths};

/// Do a whole session: sample its model, deform the samples, write the deformed model
#[derive(Args)]
pub struct Run {
    /// Session file
    session: PathBuf,
    /// File to write the deformed model to, instead of the session's own output
    ///
    /// For a model of several tiles it is a folder.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Model to deform, if it is not where the session says
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Method by which the deformation goes from the samples to the vertices
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    /// Normals of the deformed model
    #[arg(long, value_enum, default_value_t)]
    normals: NormalsName,
    /// Compare the result with the exact deformation of every vertex
    ///
    /// Where a step deforms samples only, this is refused, and the step is named.
    #[arg(long)]
    measure: bool,
    /// Evaluate all steps at every vertex, instead of transferring the samples' deformation
    ///
    /// The result is the reference, at its cost, which is told beforehand. Where a step deforms samples only,
    /// this is refused, and the step is named.
    #[arg(long, conflicts_with_all = ["tolerance", "method"])]
    exact: bool,
    /// Largest expected error of a vertex, as 1e-4 or 0.002u; samples are added to meet it
    ///
    /// A number is a fraction of the diagonal of the bounding box; with the suffix u it is a length in the
    /// model's unit. The plugins deform the added samples as well. If it cannot be met, nothing is written,
    /// and the reason is told.
    #[arg(long, value_name = "L", allow_hyphen_values = true)]
    tolerance: Option<Tolerance>,
    /// Offset of positions that are stored as integers, as in LAS
    #[arg(long, value_enum, default_value_t)]
    offset: OffsetName,
    /// Least opacity of the Gaussian splats that are sampled, instead of the session's
    ///
    /// It means what `simod sample --min-opacity` does.
    #[arg(long, value_name = "A")]
    min_opacity: Option<f64>,
    /// PLY file to write as well, with the figures of `simod reconstruct --diagnostics`
    #[arg(long, value_name = "FILE")]
    diagnostics: Option<PathBuf>,
    /// Write a format that cannot hold all that the model has
    ///
    /// The output's extension says the format. Without it, that is an error, which lists what would be lost.
    #[arg(long)]
    lossy: bool,
    #[command(flatten)]
    following: FollowOptions,
    #[command(flatten)]
    time: TimeOptions,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    plugins: PluginArgs,
}

impl Run {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut session = SessionFile::load(&self.session)?;
        session.model = self.model.or(session.model);
        session.time = self.time.over(session.time)?;
        session.sampling.min_opacity = self.min_opacity.or(session.sampling.min_opacity);
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
        let mut guard = self.overwrite.guard_session(&self.session, &session, &plugins, &output)?;
        if let Some(diagnostics) = &self.diagnostics {
            guard.writes(diagnostics, OutputKind::Model)?;
        }
        notices(&plugins, &session.steps, report);
        let progress = report.progress();
        let running = Running {
            how,
            diagnostics: self.diagnostics.as_deref(),
            measure: self.measure,
            exact: self.exact,
            tolerance: self.tolerance,
            choose_offset: self.offset == OffsetName::Auto,
            lossy: self.lossy,
            follow: &self.following.follow(&session.follow),
        };
        let run = Pipeline::execute_with(&session, &plugins, &running, &output, progress)?;
        tell_run(&run, self.measure, progress, report)?;
        report.line(format!("wrote {}", output.display()));
        Ok(())
    }
}

/// Reports the result of a session.
fn tell_run(run: &Pipeline, measure: bool, progress: &dyn Progress, report: &mut Report) -> Result<()> {
    describe(run, report);
    tell_cache(run.deformed.sampled.cache(), report);
    if !run.following.is_empty() {
        report.line(format!("turned with the surface: {}", run.following.join("; ")));
        report.figure("following", run.following.clone());
    }
    let diagonal = run.deformed.sampled.bounds.diagonal();
    if let Some(expected) = run.written.expected.first().copied().flatten() {
        report.figure("expected_error", expected_figure(&expected, diagonal));
        describe_expected(&expected, diagonal, report);
        // Whoever gives a tolerance accepts it.
        if let Some(beyond) = expected.beyond.filter(|_| run.certificate.is_none()) {
            let help = "add a step `refine = { auto = true }` at the end, or run with --tolerance";
            warn_beyond("", &beyond, diagonal, help, report);
        }
    }
    if let Some(cost) = &run.exact {
        describe_cost(cost, report);
    }
    if let Some(certificate) = &run.certificate {
        describe_certificate(certificate, diagonal, report);
    }
    if measure {
        describe_error(&run.transfer_error(progress)?, diagonal, report);
    }
    Ok(())
}

/// Reports a finished run.
pub fn describe(run: &Pipeline, report: &mut Report) {
    warn_non_finite(&run.deformed.sampled, report);
    tell_transparent(&run.deformed.sampled, report);
    tell(&run.deformed.messages, report);
    let (vertices, samples) = (run.deformed.sampled.source.vertices, run.deformed.sampled.samples.len());
    report.figure("vertices", vertices);
    report.figure("samples", samples);
    report.figure("diagonal", run.deformed.sampled.bounds.diagonal());
    report.figure("vertices_per_second", vertices as f64 / run.seconds.max(1e-9));
    report.line(format!(
        "{} vertices through {} samples, {}",
        count(vertices),
        count(samples as u64),
        rate(vertices, run.seconds)
    ));
    // The peak is taken before anything is measured or drawn, as that is not part of an edit.
    if let Some(peak) = report.peak_memory() {
        report.figure("run_peak_memory_bytes", peak);
        report.line(format!("peak memory of the edit {} MB", peak.div_ceil(1 << 20)));
    }
}

/// Reports the expected cost of evaluating every vertex.
fn describe_cost(cost: &ExactCost, report: &mut Report) {
    report.figure("exact", json!({"evaluations": cost.evaluations, "expected_seconds": cost.seconds}));
    report.line(format!(
        "every vertex is exact: {} evaluations of the steps, which were expected to take {:.1} s besides \
         reading and writing",
        count(cost.evaluations),
        cost.seconds
    ));
}

/// Reports that a tolerance is met, and by which figures.
fn describe_certificate(certificate: &Certificate, diagonal: f64, report: &mut Report) {
    let Certificate { tolerance, expected, of_vertices, added, rounds, sampled_anew, truth } = certificate;
    let true_error = truth.map(|t| {
        let figures = json!({"vertices": t.vertices, "rms": t.rms, "p999": t.p999, "max": t.max});
        with_lengths(figures, &["rms", "p999", "max"], diagonal)
    });
    let figures = json!({
        "tolerance": tolerance,
        "tolerance_length": tolerance * diagonal,
        "expected": expected,
        "vertices": expected_figure(of_vertices, diagonal),
        "added_samples": added,
        "rounds": rounds,
        "sampled_anew": sampled_anew,
        "true_error": true_error,
    });
    report.figure("certificate", with_lengths(figures, &["tolerance", "expected"], diagonal));
    report.line(format!(
        "tolerance {}: up to {} are expected around the samples, {} of which were added in {rounds} rounds and \
         deformed by the plugins",
        length(*tolerance, diagonal),
        length(*expected, diagonal),
        count(*added)
    ));
    describe_expected(of_vertices, diagonal, report);
    if let Some(samples) = sampled_anew {
        report.line(format!("sampled anew with {} samples, as from fewer it was not met", count(*samples)));
    }
    report.line(match truth {
        Some(t) => format!(
            "true error at {} vertices: {}",
            count(t.vertices),
            errors([t.rms, t.p999, t.max], diagonal)
        ),
        None => "the true error is not known, as a step deforms samples only".to_owned(),
    });
}

/// Reports the distances of a run from the exact deformation.
pub fn describe_error(error: &TransferError, diagonal: f64, report: &mut Report) {
    report.line(format!("transfer error: {}", errors([error.rms, error.p999, error.max], diagonal)));
    report.figure(
        "transfer_error",
        with_lengths(
            json!({"vertices": error.vertices, "rms": error.rms, "p999": error.p999, "max": error.max, "jump": error.jump}),
            &["rms", "p999", "max", "jump"],
            diagonal,
        ),
    );
}
