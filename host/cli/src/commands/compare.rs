//! `simod compare`: several methods on one model, beside each other.

use std::path::PathBuf;

use clap::Args;
use simod_core::guard::Guard;
use simod_model::Result;
use simod_session::compare::{self, CompareFile, Comparing};
use simod_session::session_file::inputs;

use super::plugin_options::PluginOptions;
use crate::report::{Report, count, duration};

/// Do several methods on one model, and compare what they make of it: a page, figures and pictures
#[derive(Args)]
pub struct Compare {
    /// The methods, and what they are done to
    #[arg(value_name = "COMPARE.toml")]
    file: PathBuf,
    /// The folder to write: index.html, compare.json, compare.csv, compare.tex and pictures
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// The model, if it is not where the file says
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Keep the deformed models in the folder
    #[arg(long)]
    keep_models: bool,
    /// Run the programs that the file names as methods: only if you know what they do
    #[arg(long)]
    allow_commands: bool,
    #[command(flatten)]
    plugins: PluginOptions,
}

impl Compare {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut file = CompareFile::load(&self.file)?;
        file.model = self.model.unwrap_or(file.model);
        let plugins = self.plugins.discover(report)?;
        let mut guard = Guard::default();
        guard.reads_all([&self.file, &file.model]);
        guard.reads_all(inputs(&self.file)?);
        guard.reads_all(plugins.files());
        guard.replaces_folder(&self.output)?;
        let progress = report.progress();
        let how = Comparing { keep_models: self.keep_models, allow_commands: self.allow_commands };
        let comparison = compare::compare(&file, &plugins, how, &self.output, progress)?;
        for (method, figures) in comparison.done() {
            let seconds = &figures.seconds;
            let time = |what: &str, time: Option<f64>| Some(format!("{what} in {}", duration(time?)));
            let samples = format!("{} samples", count(figures.samples as u64));
            let done = [
                time(&samples, seconds.sample),
                time("deformed", seconds.deform),
                time("reconstructed", seconds.reconstruct),
            ];
            let done: Vec<String> = done.into_iter().flatten().collect();
            let done = if done.is_empty() { "measured".to_owned() } else { done.join(", ") };
            report.line(format!("{}: {done}", method.name));
        }
        for (method, failure) in comparison.failed() {
            report.warn(format!("{} failed: {} ({})", method.name, failure.what, failure.hint));
        }
        report.figure("vertices", comparison.model.vertices);
        report.figure("done", comparison.done().count());
        report.figure("failed", comparison.failed().count());
        report.line(format!("wrote {}", self.output.join("index.html").display()));
        Ok(())
    }
}
