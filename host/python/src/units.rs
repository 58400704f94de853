//! Sessions by units, for workers of a cluster: `simod.dask`.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use serde_json::json;
use simod_compare::{CompareFile, Comparing, ComparisonPlan, MethodRecord};
use simod_core::guard::Guard;
use simod_model::ModelName;
use simod_model::follow::Follow;
use simod_session::plan::{Plan, PlanOptions, Unit, UnitDone, do_unit, make};
use simod_session::session_file::inputs;
use simod_session::{PluginRegistry, SessionFile};

use crate::options::reconstruction;
use crate::plugins::registry;
use crate::work::{warn, work};

/// Writes the plan of a session to a folder; returns its units, the path of the result, and a name of its
/// samples, as JSON. `whole` samples have all that samples of a model have, and not only what the steps need.
#[pyfunction(name = "_plan")]
#[pyo3(signature = (session, folder, out = None, *, units, model = None, normals = "transform", method = "blended-jets",
    choose_offset = false, lossy = false, overwrite = false, whole = false))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub fn plan(
    py: Python<'_>,
    session: PathBuf,
    folder: PathBuf,
    out: Option<PathBuf>,
    units: u64,
    model: Option<PathBuf>,
    normals: &str,
    method: &str,
    choose_offset: bool,
    lossy: bool,
    overwrite: bool,
    whole: bool,
) -> PyResult<String> {
    let how = reconstruction(py, normals, method)?;
    let plugins = registry(py)?;
    let ((plan, sampled), notes) = work(py, None, |watch| {
        let mut file = SessionFile::load(&session)?;
        file.model = model.or(file.model);
        let output = out.as_deref().map_or_else(|| file.output_beside(&session), Ok)?.to_owned();
        let mut guard = Guard::new(overwrite);
        guard.reads(&session);
        let named = file.named_model()?;
        guard.reads_all(named.iter().flat_map(ModelName::files));
        guard.reads_all(inputs(&session)?);
        guard.reads_all(plugins.files());
        guard.writes_model(&output, &named.map_or(Vec::new(), |named| named.written_tiles()))?;
        guard.replaces_folder(&folder)?;
        let options = PlanOptions {
            method: how.method,
            normals: how.normals,
            choose_offset,
            lossy,
            force: overwrite,
            follow: &Follow::default().or_declared(&file.follow),
            plugins: &[],
            whole_samples: whole,
            units,
            emit: &[],
        };
        let plan = make(&file, &session, &plugins, &output, &options, &folder, watch)?;
        // Plans of which this is the same take the same samples.
        let sampled = json!([plan.model().files(), file.columns, file.sampling]).to_string();
        Ok((plan, sampled))
    })?;
    warn(py, &notes)?;
    Ok(described(plan.output(), &sampled, plan.units()))
}

/// Writes the plan of a comparison to a folder; its units, and where the result goes, as JSON.
#[pyfunction(name = "_comparison_plan")]
#[pyo3(signature = (file, folder, out, *, model = None, keep_models = false, allow_commands = false))]
pub fn comparison_plan(
    py: Python<'_>,
    file: PathBuf,
    folder: PathBuf,
    out: PathBuf,
    model: Option<PathBuf>,
    keep_models: bool,
    allow_commands: bool,
) -> PyResult<String> {
    let plugins = registry(py)?;
    let (plan, notes) = work(py, None, |watch| {
        let mut comparison = CompareFile::load(&file)?;
        comparison.model = model.unwrap_or(comparison.model);
        let mut guard = Guard::default();
        guard.reads_all([&file, &comparison.model]);
        guard.reads_all(inputs(&file)?);
        guard.reads_all(plugins.files());
        guard.replaces_folder(&out)?;
        guard.replaces_folder(&folder)?;
        let how = Comparing { keep_models, allow_commands };
        let options = simod_compare::ComparisonPlanOptions { how, plugins: &[], emit: &[] };
        simod_compare::make(&comparison, &file, &out, &options, &folder, watch)
    })?;
    warn(py, &notes)?;
    // The samplings of a comparison are those of no other plan.
    Ok(described(plan.output(), &folder.display().to_string(), plan.units()))
}

/// Properties of a plan for Python, as JSON; plans of which `sampled` is the same take the same samples.
fn described(output: &Path, sampled: &str, units: &[Unit]) -> String {
    let units: Vec<_> =
        units.iter().map(|unit| json!({"number": unit.number, "stage": unit.stage.name()})).collect();
    json!({"output": output, "sampled": sampled, "units": units}).to_string()
}

/// Does a unit of the plan in a folder; returns whether it was not done before.
#[pyfunction(name = "_unit")]
pub fn unit(py: Python<'_>, folder: PathBuf, number: usize) -> PyResult<bool> {
    let plugins = registry(py)?;
    if ComparisonPlan::is_at(&folder) {
        return comparison_unit(py, (&folder, number), &plugins);
    }
    let (UnitDone { was_done, messages, .. }, mut notes) = work(py, None, |watch| {
        let plan = Plan::load(&folder)?;
        let mut guard = Guard::new(plan.force());
        guard.reads(plan.session());
        guard.reads_all(plan.model().files());
        guard.reads_all(inputs(plan.session())?);
        guard.writes_model(plan.output(), &plan.model().written_tiles())?;
        do_unit(&plan, (&folder, number), &plugins, watch)
    })?;
    let said = messages.iter().filter(|m| m.is_warning());
    notes.extend(said.map(|m| format!("{}: {}", m.plugin, m.text)));
    warn(py, &notes)?;
    Ok(!was_done)
}

fn comparison_unit(
    py: Python<'_>,
    (folder, number): (&Path, usize),
    plugins: &PluginRegistry,
) -> PyResult<bool> {
    let (done, mut notes) = work(py, None, |watch| {
        let plan = ComparisonPlan::load(folder)?;
        let mut guard = Guard::default();
        guard.reads_all([plan.file(), plan.model()]);
        guard.reads_all(inputs(plan.file())?);
        guard.reads_all(plugins.files());
        guard.replaces_folder(plan.output())?;
        simod_compare::do_unit(&plan, (folder, number), plugins, watch)
    })?;
    let failed = |method: &MethodRecord| {
        method.error.as_ref().map(|e| format!("{} failed: {} ({})", method.name, e.what, e.hint))
    };
    notes.extend(done.method.as_ref().and_then(failed));
    warn(py, &notes)?;
    Ok(!done.was_done)
}
