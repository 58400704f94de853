//! `simod compare`: several methods on one model, beside each other.

use std::path::{Path, PathBuf};

use clap::Args;
use simod_compare::{CompareFile, Comparing, Comparison, ComparisonPlanOptions, MethodRecord};
use simod_core::guard::Guard;
use simod_model::Result;
use simod_session::session_file::inputs;

use super::engines::{EngineName, engines};
use super::plugin_options::PluginArgs;
use crate::report::{Report, count, duration};

/// Do several methods on one model, and write a page, figures and pictures that compare them
#[derive(Args)]
pub struct Compare {
    /// Comparison file, with the model and the methods
    #[arg(value_name = "COMPARE.toml")]
    file: PathBuf,
    /// Folder to write: index.html, compare.json, compare.csv, compare.tex and pictures
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Model to deform, if it is not where the file says
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Keep the deformed models in the folder
    #[arg(long)]
    keep_models: bool,
    /// Folder to write the work to as units, for more machines than one, instead of doing it
    ///
    /// Each unit is done by `simod unit`, and all together write the same comparison.
    #[arg(long, value_name = "DIR")]
    plan: Option<PathBuf>,
    /// Engine for which to write what the plan needs as well (may be given several times)
    #[arg(long, value_enum, value_name = "ENGINE", value_delimiter = ',', requires = "plan")]
    emit: Vec<EngineName>,
    /// Run the programs that the file names as methods, only if you know what they do
    #[arg(long)]
    allow_commands: bool,
    #[command(flatten)]
    plugins: PluginArgs,
}

impl Compare {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut file = CompareFile::load(&self.file)?;
        file.model = self.model.unwrap_or(file.model);
        let chosen = self.plugins.chosen().to_owned();
        let plugins = self.plugins.discover(report)?;
        let mut guard = Guard::default();
        guard.reads_all([&self.file, &file.model]);
        guard.reads_all(inputs(&self.file)?);
        guard.reads_all(plugins.files());
        guard.replaces_folder(&self.output)?;
        let progress = report.progress();
        let how = Comparing { keep_models: self.keep_models, allow_commands: self.allow_commands };
        if let Some(folder) = &self.plan {
            guard.replaces_folder(folder)?;
            let options = ComparisonPlanOptions { how, plugins: &chosen, emit: &engines(&self.emit) };
            let plan = simod_compare::make(&file, &self.file, &self.output, &options, folder, progress)?;
            report.figure("units", plan.units().len());
            report.figure("methods", file.methods.len());
            report.line(format!(
                "{} units in {}, which write {}",
                plan.units().len(),
                folder.display(),
                plan.output().display()
            ));
            return Ok(());
        }
        let comparison = simod_compare::compare(&file, &plugins, how, &self.output, progress)?;
        comparison.methods.iter().for_each(|method| tell_method(method, report));
        tell_comparison(&comparison, &self.output, report);
        Ok(())
    }
}

/// Reports the times of a method, or why it was not done.
pub fn tell_method(method: &MethodRecord, report: &mut Report) {
    if let Some(failure) = &method.error {
        report.warn(format!("{} failed: {} ({})", method.name, failure.what, failure.hint));
    }
    let Some(figures) = &method.figures else { return };
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

/// Reports the outcome of all methods, and the place of the page.
pub fn tell_comparison(comparison: &Comparison, output: &Path, report: &mut Report) {
    report.figure("vertices", comparison.model.vertices);
    report.figure("done", comparison.done().count());
    report.figure("failed", comparison.failed().count());
    report.line(format!("wrote {}", output.join("index.html").display()));
}
