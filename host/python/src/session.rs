//! Sessions from the model to the deformed model, and comparisons of methods.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use serde_json::{Value, json};
use simod_compare::{CompareFile, Comparing};
use simod_core::guard::{Guard, OutputKind};
use simod_core::reconstruction::transfer_error::TransferError;
use simod_model::follow::Follow;
use simod_session::session_file::inputs;
use simod_session::{PluginRegistry, Run, Running, SessionFile, Tolerance};

use crate::errors::{OrRaise, argument};
use crate::options::{reconstruction, record};
use crate::plugins::registry;
use crate::work::{warn, work};

/// A session file: a model, its sampling, the steps of an edit, and the path of the result. Steps may name
/// functions that `simod.deformer` registered.
#[pyclass(module = "simod", frozen)]
pub struct Session {
    path: PathBuf,
    file: SessionFile,
}

#[pymethods]
impl Session {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let file = py.detach(|| SessionFile::load(&path)).or_raise(py)?;
        Ok(Self { path, file })
    }

    /// The file.
    #[getter]
    fn path(&self) -> &Path {
        &self.path
    }

    /// Path of the model that the session names, if it does.
    #[getter]
    fn model(&self) -> Option<&Path> {
        self.file.model.as_deref()
    }

    /// Path of the result that the session names, if it does.
    #[getter]
    fn output(&self) -> Option<&Path> {
        self.file.output.as_deref()
    }

    /// Names of the session's steps, first to last, without those that are switched off.
    #[getter]
    fn steps(&self) -> Vec<&str> {
        self.file.steps.iter().filter(|step| step.enabled).map(|step| step.name()).collect()
    }

    fn __repr__(&self) -> String {
        format!("<simod.Session {:?}: {}>", self.path, self.steps().join(", "))
    }

    /// Runs the session: samples its model, deforms the samples, and writes the deformed model, which appears
    /// whole or not at all. Gives a `simod.Report`.
    ///
    /// `out` and `model` stand for what the session says. With `measure`, the result is compared with the
    /// exact deformation of every vertex; with `exact`, nothing is transferred, and every vertex is
    /// evaluated; `tolerance` adds samples until no vertex is expected to be off by more: a fraction of the
    /// diagonal, or a length in the model's unit as the text "0.002u". The rest is as of `Model.apply`.
    #[pyo3(signature = (out = None, *, model = None, normals = "transform", method = "blended-jets", measure = false,
        exact = false, tolerance = None, diagnostics = None, choose_offset = false, lossy = false, overwrite = false,
        progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn run<'py>(
        &self,
        py: Python<'py>,
        out: Option<PathBuf>,
        model: Option<PathBuf>,
        normals: &str,
        method: &str,
        measure: bool,
        exact: bool,
        tolerance: Option<&Bound<'py, PyAny>>,
        diagnostics: Option<PathBuf>,
        choose_offset: bool,
        lossy: bool,
        overwrite: bool,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let tolerance = tolerance.filter(|t| !t.is_none()).map(tolerance_of).transpose()?;
        if exact && tolerance.is_some() {
            return Err(argument(py, "both `exact` and `tolerance` are given", "keep one of the two"));
        }
        let how = reconstruction(py, normals, method)?;
        let follow = Follow::default().or_declared(&self.file.follow);
        let running = Running {
            how,
            diagnostics: diagnostics.as_deref(),
            measure,
            exact,
            tolerance,
            choose_offset,
            lossy,
            follow: &follow,
        };
        let plugins = registry(py)?;
        let mut session = self.file.clone();
        session.model = model.or(session.model);
        let ((run, error), mut notes) = work(py, progress, |watch| {
            let output = out.as_deref().map_or_else(|| session.output_beside(&self.path), Ok)?.to_owned();
            let read = (&*self.path, &session, &*plugins);
            check_targets(Guard::new(overwrite), read, &output, diagnostics.as_deref())?;
            let run = Run::execute_with(&session, &plugins, &running, &output, watch)?;
            let error = measure.then(|| run.transfer_error(watch)).transpose()?;
            Ok((run, error))
        })?;
        notes.extend(plugins.notices(&session.steps));
        let said = run.deformed.messages.iter().filter(|m| m.is_warning());
        notes.extend(said.map(|m| format!("{}: {}", m.plugin, m.text)));
        warn(py, &notes)?;
        record(py, "Report", &report(&run, error))
    }
}

/// Checks that neither the output nor the diagnostics take the place of what is read, or of what is there.
fn check_targets(
    mut guard: Guard,
    (path, session, plugins): (&Path, &SessionFile, &PluginRegistry),
    output: &Path,
    diagnostics: Option<&Path>,
) -> simod_model::Result<()> {
    guard.reads(path);
    let named = session.named_model()?;
    guard.reads_all(named.iter().flat_map(|named| named.files()));
    guard.reads_all(inputs(path)?);
    guard.reads_all(plugins.files());
    guard.writes_model(output, &named.map_or(Vec::new(), |named| named.written_tiles()))?;
    diagnostics.iter().try_for_each(|path| guard.writes(path, OutputKind::Model))
}

/// Report on a run, with the error that was measured beside the exact deformation.
fn report(run: &Run, error: Option<TransferError>) -> Value {
    let folded = run.written.folding.first().copied().flatten().map_or(0, |f| f.samples);
    let certificate = run.certificate.map(|c| {
        let truth = c.truth.map(transfer_error);
        json!({
            "tolerance": c.tolerance, "expected": c.expected, "vertices": c.of_vertices, "added_samples": c.added,
            "rounds": c.rounds, "sampled_anew": c.sampled_anew, "true_error": truth,
        })
    });
    json!({
        "output": run.output, "vertices": run.written.vertices, "non_finite": run.written.non_finite,
        "samples": run.deformed.sampled.samples.len(), "seconds": run.seconds, "folded_samples": folded,
        "expected_error": run.written.expected.first().copied().flatten(), "transfer_error": error.map(transfer_error),
        "certificate": certificate, "diagonal": run.deformed.sampled.bounds.diagonal(),
    })
}

/// Figures of a transfer error.
fn transfer_error(e: TransferError) -> Value {
    json!({"vertices": e.vertices, "rms": e.rms, "p999": e.p999, "max": e.max, "jump": e.jump})
}

/// A fraction of the diagonal, or a text as on the command line.
fn tolerance_of(given: &Bound<'_, PyAny>) -> PyResult<Tolerance> {
    let text = given.str()?.to_string();
    text.parse()
        .map_err(|e: String| argument(given.py(), &format!("`tolerance` is {text}: {e}"), "give 1e-4, say"))
}

/// Runs several methods on one model, which `file` lists, and writes a folder with a page, figures
/// (compare.json) and pictures. Methods may name functions that `simod.deformer` registered. Gives the
/// figures as compare.json has them. With `keep_models`, the deformed models stay in the folder; with
/// `allow_commands`, programs that the file names are run. `progress`: see `Model.sample`.
#[pyfunction]
#[pyo3(signature = (file, output, *, model = None, keep_models = false, allow_commands = false, progress = None))]
pub fn compare<'py>(
    py: Python<'py>,
    file: PathBuf,
    output: PathBuf,
    model: Option<PathBuf>,
    keep_models: bool,
    allow_commands: bool,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let plugins = registry(py)?;
    let (figures, _) = work(py, progress, |watch| {
        let mut methods = CompareFile::load(&file)?;
        methods.model = model.unwrap_or(methods.model);
        let mut guard = Guard::default();
        guard.reads_all([&file, &methods.model]);
        guard.reads_all(inputs(&file)?);
        guard.reads_all(plugins.files());
        guard.replaces_folder(&output)?;
        let how = Comparing { keep_models, allow_commands };
        Ok(simod_compare::compare(&methods, &plugins, how, &output, watch)?.to_json())
    })?;
    py.import("json")?.call_method1("loads", (figures,))
}
