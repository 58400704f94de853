//! `simod plan` and `simod unit`: a session, or a comparison, by units, for more machines than one.

use std::path::{Path, PathBuf};

use clap::Args;
use simod_compare::ComparisonPlan;
use simod_core::guard::Guard;
use simod_model::Result;
use simod_model::size::human_size;
use simod_session::SessionFile;
use simod_session::plan::{Plan as Units, PlanOptions, Stage, UnitDone, do_unit, make};
use simod_session::session_file::inputs;

use super::compare::{tell_comparison, tell_method};
use super::engines::{EngineName, engines};
use super::follow_options::FollowOptions;
use super::overwrite::Overwrite;
use super::plugin_options::PluginArgs;
use super::reconstruct::{MethodName, NormalsName, OffsetName};
use super::tell;
use super::time_options::TimeOptions;
use crate::report::{Report, count};

/// Write a session as units of work, for more machines than one
///
/// Each unit is done by `simod unit`, and all together write the same bytes as `simod run`.
#[derive(Args)]
pub struct Plan {
    /// Session file
    session: PathBuf,
    /// Folder to write the plan to, which all machines see
    ///
    /// Units read and write there.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Number of units that share each stage that can be divided
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    units: u64,
    /// Engine for which to write what it needs as well (may be given several times)
    #[arg(long, value_enum, value_name = "ENGINE", value_delimiter = ',')]
    emit: Vec<EngineName>,
    /// File to write the deformed model to, instead of the session's own output
    #[arg(long, value_name = "FILE")]
    to: Option<PathBuf>,
    /// Model to deform, if it is not where the session says
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Method by which the deformation goes from the samples to the vertices
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    /// Normals of the deformed model
    #[arg(long, value_enum, default_value_t)]
    normals: NormalsName,
    /// Offset of positions that are stored as integers, as in LAS
    #[arg(long, value_enum, default_value_t)]
    offset: OffsetName,
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

impl Plan {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut session = SessionFile::load(&self.session)?;
        session.model = self.model.or(session.model);
        session.time = self.time.over(session.time)?;
        let output = match self.to {
            Some(output) => output,
            None => session.output_beside(&self.session)?.to_owned(),
        };
        let (chosen, force) = (self.plugins.chosen().to_owned(), self.overwrite.force());
        let plugins = self.plugins.discover(report)?;
        let guard = self.overwrite.guard_session(&self.session, &session, &plugins, &output)?;
        guard.replaces_folder(&self.output)?;
        let emit = engines(&self.emit);
        let options = PlanOptions {
            method: self.method.into(),
            normals: self.normals.into(),
            choose_offset: self.offset == OffsetName::Auto,
            lossy: self.lossy,
            force,
            follow: &self.following.follow(&session.follow),
            plugins: &chosen,
            whole_samples: false,
            units: self.units,
            emit: &emit,
        };
        let plan =
            make(&session, &self.session, &plugins, &output, &options, &self.output, report.progress())?;
        tell_plan(&plan, &self.output, report);
        Ok(())
    }
}

/// Reports the units of a plan.
fn tell_plan(plan: &Units, folder: &Path, report: &mut Report) {
    if let Some(why) = plan.undivided() {
        report.warn(format!("one unit writes the model: {why}"));
    }
    let exchange = plan.exchange();
    if let Some(why) = &exchange.undivided {
        report.warn(format!("one unit samples the model: {why}"));
    }
    let of = |stage| plan.units().iter().filter(|unit| unit.stage == stage).count();
    report.figure("units", plan.units().len());
    report.figure("counting_units", of(Stage::Count));
    report.figure("clustering_units", of(Stage::Cluster) + of(Stage::ClusterShared));
    report.figure("face_units", of(Stage::Members) + of(Stage::Faces));
    report.figure("exchange_at_most_bytes", exchange.at_most_bytes);
    report.figure("writing_units", of(Stage::Apply) + of(Stage::Write));
    report.figure("vertices", plan.vertices());
    report.line(format!(
        "{} units in {}, which write {}",
        plan.units().len(),
        folder.display(),
        plan.output().display()
    ));
    if exchange.at_most_bytes > 0 {
        report.line(format!(
            "they write down at most {} for each other, which it comes to where vertices, and faces, are in no order",
            human_size(exchange.at_most_bytes)
        ));
    }
}

/// Do one unit of a plan
///
/// A unit that is done already is not done again.
#[derive(Args)]
pub struct Unit {
    /// Folder of the plan
    #[arg(value_name = "DIR")]
    plan: PathBuf,
    /// Number of the unit, from 0 on
    #[arg(value_name = "N")]
    number: usize,
    #[command(flatten)]
    plugins: PluginArgs,
}

impl Unit {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        if ComparisonPlan::is_at(&self.plan) {
            return self.of_comparison(report);
        }
        let plan = Units::load(&self.plan)?;
        let plugins = self.plugins.or_chosen(plan.plugins()).discover(report)?;
        let mut guard = Overwrite::forcing(plan.force()).guard();
        guard.reads(plan.session());
        guard.reads_all(plan.model().files());
        guard.reads_all(inputs(plan.session())?);
        guard.writes_model(plan.output(), &plan.model().written_tiles())?;
        let UnitDone { was_done, messages, shared_vertices, written } =
            do_unit(&plan, (&self.plan, self.number), &plugins, report.progress())?;
        tell(&messages, report);
        let stage = plan.units().get(self.number).map_or("", |unit| unit.stage.name());
        report.figure("unit", self.number);
        report.figure("stage", stage);
        report.figure("was_done", was_done);
        if let Some(shared) = shared_vertices {
            report.figure("shared_vertices", shared);
            let (shared, all) = (count(shared), count(plan.vertices()));
            report.line(format!("{shared} of {all} vertices are in cells that units share"));
        }
        if let Some(written) = written {
            report.figure("vertices", written.vertices);
            let folded = written.folding.first().copied().flatten().map_or(0, |folding| folding.samples);
            report.figure("folded_samples", folded);
            if folded > 0 {
                report.warn(format!("the deformation folds the surface at {} samples", count(folded)));
            }
            report.line(format!("wrote {}", plan.output().display()));
        }
        let was = if was_done { "was done before" } else { "is done" };
        report.line(format!("unit {} ({stage}) {was}", self.number));
        Ok(())
    }
    fn of_comparison(self, report: &mut Report) -> Result<()> {
        let plan = ComparisonPlan::load(&self.plan)?;
        let plugins = self.plugins.or_chosen(plan.plugins()).discover(report)?;
        let mut guard = Guard::default();
        guard.reads_all([plan.file(), plan.model()]);
        guard.reads_all(inputs(plan.file())?);
        guard.reads_all(plugins.files());
        guard.replaces_folder(plan.output())?;
        let simod_compare::ComparisonUnitDone { was_done, method, comparison } =
            simod_compare::do_unit(&plan, (&self.plan, self.number), &plugins, report.progress())?;
        let stage = plan.units().get(self.number).map_or("", |unit| unit.stage.name());
        report.figure("unit", self.number);
        report.figure("stage", stage);
        report.figure("was_done", was_done);
        if let Some(method) = method {
            tell_method(&method, report);
        }
        if let Some(comparison) = comparison {
            tell_comparison(&comparison, plan.output(), report);
        }
        let was = if was_done { "was done before" } else { "is done" };
        report.line(format!("unit {} ({stage}) {was}", self.number));
        Ok(())
    }
}
