//! Samples as arrays, which any program may deform, as plugins do.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::{DVec3, Vec3};
use numpy::{PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::{PyDict, PyTuple};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::{DeformationField, Method, Moved, RestGeometry, carry, deformed_normals};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::sample as sample_model;
use simod_model::progress::Silent;
use simod_model::{InMemory, Progress};
use simod_session::edit::Refinements;
use simod_session::pipeline::{MovedSamples, deform_from};
use simod_session::step::Step;

use crate::errors::{OrRaise, argument};
use crate::options::sampling;
use crate::plugins::registry;
use crate::work::{warn, work};
use crate::{arrays, steps};

/// An array of points, or of directions.
type Points<'py> = Bound<'py, PyArray2<f64>>;

/// Vertices that are carried over between two looks at whether that shall stop.
const BATCH: usize = 1 << 19;

/// The samples of a model: a small set of points that stands for all of it, and that anything may deform.
///
/// `len(samples)` is their number. Move them by writing to `points`, or by `apply`.
#[pyclass(module = "simod", frozen)]
pub struct Samples {
    state: Mutex<SamplesState>,
    /// Whether the model is a file.
    of_file: bool,
}

/// State of the samples at a time.
struct SamplesState {
    now: UndoMoment,
    rest: Py<PyArray2<f64>>,
    points: Py<PyArray2<f64>>,
    past: Vec<UndoMoment>,
    future: Vec<UndoMoment>,
}

/// State of the samples that undo goes back to.
#[derive(Clone)]
struct UndoMoment {
    sampled: Arc<SampledModel>,
    /// Local positions, which are exact, and (`points`) the same in the model's coordinates: a point of the
    /// array that still has these coordinates was not moved by anybody else.
    local: Arc<[Vec3]>,
    points: Arc<[DVec3]>,
    /// The names of the steps that led here.
    steps: Vec<String>,
}

impl UndoMoment {
    fn new(sampled: Arc<SampledModel>, local: Arc<[Vec3]>, steps: Vec<String>) -> Self {
        let points = local.iter().map(|p| sampled.frame.to_model(*p)).collect();
        Self { sampled, local, points, steps }
    }

    /// Positions of the samples. Near the model's place at rest, local positions are exact.
    fn deformed(&self) -> DeformedPositions {
        let SampledModel { frame, samples, .. } = &*self.sampled;
        let far = DeformedPositions::new(frame, &samples.positions, &self.points);
        if far.is_unshifted() { self.local.to_vec().into() } else { far }
    }

    /// Deformed positions, rounded as they are written.
    fn rounded(&self) -> DeformedPositions {
        let deformed = self.deformed();
        self.sampled.rounded_places(deformed.places(&self.sampled.frame))
    }

    /// Local positions of an array's.
    fn local_of(&self, points: &[DVec3]) -> simod_model::Result<Arc<[Vec3]>> {
        let local = self.sampled.to_local(points, &"the array `points`")?;
        let known = self.points.iter().zip(&*self.local);
        let kept = |((new, now), (before, exact)): ((Vec3, &DVec3), (&DVec3, &Vec3))| {
            if now == before { *exact } else { new }
        };
        Ok(local.into_iter().zip(points).zip(known).map(kept).collect())
    }
}

impl SamplesState {
    /// The array's points.
    fn read(&self, py: Python<'_>) -> PyResult<Vec<DVec3>> {
        let points = self.points.bind(py);
        if !arrays::is_of_points(points, self.now.points.len()) {
            let what = format!("`points` is not of shape ({}, 3) any more", self.now.points.len());
            return Err(PyValueError::new_err(what));
        }
        let points = points.try_readonly()?;
        Ok(bytemuck::cast_slice(points.as_slice()?).to_vec())
    }

    /// State of the samples now, whoever moved them.
    fn look(&self, py: Python<'_>) -> PyResult<UndoMoment> {
        let points = self.read(py)?;
        let local = self.now.local_of(&points).or_raise(py)?;
        Ok(UndoMoment { local, points: points.into(), ..self.now.clone() })
    }

    /// Restores the state of another time. The arrays stay the same ones as long as there are as many
    /// samples.
    fn go_to(&mut self, py: Python<'_>, moment: UndoMoment) -> PyResult<()> {
        if Arc::ptr_eq(&moment.sampled, &self.now.sampled) {
            let points = self.points.bind(py).try_readwrite()?;
            let mut points = points;
            points.as_slice_mut()?.copy_from_slice(bytemuck::cast_slice(&moment.points));
        } else {
            self.rest = rest(py, &moment.sampled)?;
            self.points = arrays::of_points(py, moment.points.to_vec())?.unbind();
        }
        self.now = moment;
        Ok(())
    }
}

/// Positions of the samples at rest, as an array in model coordinates.
fn rest(py: Python<'_>, sampled: &SampledModel) -> PyResult<Py<PyArray2<f64>>> {
    let points = sampled.samples.positions.iter().map(|p| sampled.frame.to_model(*p)).collect();
    let rest = arrays::of_points(py, points)?;
    arrays::read_only(&rest);
    Ok(rest.unbind())
}

impl Samples {
    /// The samples of a model that was sampled, at rest.
    pub fn new(py: Python<'_>, sampled: SampledModel, of_file: bool) -> PyResult<Self> {
        let sampled = Arc::new(sampled);
        let local = sampled.samples.positions.as_slice().into();
        let now = UndoMoment::new(sampled.clone(), local, Vec::new());
        let rest = rest(py, &sampled)?;
        let points = arrays::of_points(py, now.points.to_vec())?.unbind();
        let state = SamplesState { now, rest, points, past: Vec::new(), future: Vec::new() };
        Ok(Self { state: Mutex::new(state), of_file })
    }

    /// Samples, and their finite local positions now.
    pub fn now(&self, py: Python<'_>) -> PyResult<(Arc<SampledModel>, Arc<[Vec3]>)> {
        let UndoMoment { sampled, local, .. } = self.state(py).look(py)?;
        Ok((sampled, local))
    }

    /// Samples, and their positions now, as they are written.
    pub fn written(&self, py: Python<'_>) -> PyResult<(Arc<SampledModel>, DeformedPositions)> {
        let now = self.state(py).look(py)?;
        let deformed = now.rounded();
        Ok((now.sampled, deformed))
    }

    /// The state; who waits for it lets others have the interpreter's lock.
    fn state(&self, py: Python<'_>) -> MutexGuard<'_, SamplesState> {
        self.state.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }

    fn sampled(&self, py: Python<'_>) -> Arc<SampledModel> {
        self.state(py).now.sampled.clone()
    }

    /// Does a step.
    fn do_step(
        &self,
        py: Python<'_>,
        step: Step,
        before: UndoMoment,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let plugins = registry(py)?;
        let name = step.name().to_owned();
        let (moved, mut notes) = work(py, progress, |watch| {
            let how = Refinements { folder: std::env::temp_dir(), ..Refinements::default() };
            let (sampled, local) = (before.sampled.clone(), before.local.clone());
            deform_from(sampled, local, &[step], &plugins, how, watch)
        })?;
        let MovedSamples { sampled, positions, messages } = moved;
        let steps = before.steps.iter().cloned().chain([name]).collect();
        let after = UndoMoment::new(sampled, positions, steps);
        let mut state = self.state(py);
        state.go_to(py, after)?;
        state.past.push(before);
        state.future.clear();
        drop(state);
        let (warnings, said): (Vec<_>, Vec<_>) =
            messages.iter().filter(|m| !m.is_debug()).partition(|m| m.is_warning());
        notes.extend(warnings.into_iter().map(|m| format!("{}: {}", m.plugin, m.text)));
        let logger = py.import("logging")?.getattr("getLogger")?.call1(("simod",))?;
        said.into_iter().try_for_each(|m| {
            logger.call_method1("info", ("%s: %s", m.plugin.as_str(), m.text.as_str())).map(drop)
        })?;
        warn(py, &notes)
    }
}

/// Puts an argument that is given into a table, under the name that a session has for it.
fn add(to: &Bound<'_, PyDict>, name: &str, given: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
    let Some(given) = given.filter(|given| !given.is_none()) else { return Ok(()) };
    // An iterator, which can be gone over once only, is looked at twice, and becomes a list.
    to.set_item(name, given.try_iter()?.collect::<PyResult<Vec<_>>>()?)
}

#[pymethods]
impl Samples {
    /// Positions of the samples at rest: shape (N, 3), float64, model coordinates. Nobody may write to the
    /// array.
    #[getter]
    fn rest<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.state(py).rest.bind(py).clone()
    }

    /// Positions of the samples now: shape (N, 3), float64, model coordinates. Write to the array to deform
    /// the model.
    ///
    /// The array is the same until `refine` appends samples, or undoing that takes them away. Assigning to
    /// `samples.points` copies into the array.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.state(py).points.bind(py).clone()
    }

    #[setter]
    fn set_points(&self, py: Python<'_>, given: &Bound<'_, PyAny>) -> PyResult<()> {
        let points = arrays::points("points", given, Some(self.__len__(py)))?;
        let state = self.state(py);
        let mut array = state.points.bind(py).try_readwrite()?;
        array.as_slice_mut()?.copy_from_slice(bytemuck::cast_slice(&points));
        Ok(())
    }

    /// Unit normals of the surface where the samples are now: shape (N, 3), float64.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (sampled, local) = self.now(py)?;
        let samples = &sampled.samples;
        let normals = py.detach(|| {
            if *local == *samples.positions {
                samples.normals().to_vec()
            } else {
                deformed_normals(samples, &local)
            }
        });
        arrays::of_directions(py, &normals)
    }

    /// Triangles between the samples, by the samples' indices: shape (T, 3), uint32; none where the model has
    /// no faces.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        arrays::of_triples(py, self.sampled(py).triangles.as_flattened().to_vec())
    }

    /// Distance to the nearest other samples at rest, in the model's unit: shape (N,), float64.
    #[getter]
    fn spacing<'py>(&self, py: Python<'py>) -> Bound<'py, numpy::PyArray1<f64>> {
        let sampled = self.sampled(py);
        let spacing = sampled.samples.spacing().iter().map(|s| f64::from(*s) * sampled.frame.scale);
        numpy::PyArray1::from_vec(py, spacing.collect())
    }

    /// The samples' colours: shape (N, 3), uint8; None where the model has none.
    #[getter]
    fn colors<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        let sampled = self.sampled(py);
        let colors = sampled.colors.as_flattened().to_vec();
        (colors.len() == 3 * sampled.samples.len()).then(|| arrays::of_triples(py, colors)).transpose()
    }

    /// The model's bounding box at rest: shape (2, 3), float64, smallest and largest coordinates.
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let bounds = self.sampled(py).bounds;
        arrays::of_points(py, vec![bounds.min, bounds.max])
    }

    /// The names of the steps that were applied, first to last.
    #[getter]
    fn steps(&self, py: Python<'_>) -> Vec<String> {
        self.state(py).now.steps.clone()
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.sampled(py).samples.len()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let sampled = self.sampled(py);
        format!("<simod.Samples: {} of {} vertices>", sampled.samples.len(), sampled.source.vertices)
    }

    /// Deforms the samples by a plugin, or by a function that `simod.deformer` registered, from their
    /// positions now. On an error the samples stay where they are.
    ///
    /// `parameters` are the plugin's (`help(simod.plugins["rbf"])`), with `_` for `-`, and `from_` for
    /// `from`; `params` are such as well, by their ids. `regions` is a list of dictionaries as in a session:
    /// `role` ("fixed", "handle" or "mask"), `shapes` or `where`, perhaps `falloff` (a length) and, for
    /// handles, `move`. `where` is a boolean array of shape (N,), of the samples that are in the region.
    /// `handles` moves handles that the plugin places: a dictionary of moves by id. `joints` and `strokes`
    /// are lists of dictionaries. `progress`: see `Model.sample`.
    ///
    /// Raises ArgumentError or PluginError; where a Python function raised, that is its cause.
    #[pyo3(signature = (deformer, *, regions = None, handles = None, joints = None, strokes = None, params = None,
        progress = None, **parameters))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn apply(
        &self,
        py: Python<'_>,
        deformer: &Bound<'_, PyAny>,
        regions: Option<&Bound<'_, PyAny>>,
        handles: Option<&Bound<'_, PyAny>>,
        joints: Option<&Bound<'_, PyAny>>,
        strokes: Option<&Bound<'_, PyAny>>,
        params: Option<&Bound<'_, PyDict>>,
        progress: Option<&Bound<'_, PyAny>>,
        parameters: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<()> {
        let id: String = match deformer.extract() {
            Ok(id) => id,
            Err(_) => deformer.getattr("id")?.extract()?,
        };
        let before = self.state(py).look(py)?;
        let all = PyDict::new(py);
        params.into_iter().chain(parameters).try_for_each(|some| all.update(some.as_mapping()))?;
        let step = PyDict::new(py);
        step.set_item("deform", &id)?;
        step.set_item("params", all)?;
        add(&step, "region", regions)?;
        add(&step, "joint", joints)?;
        add(&step, "stroke", strokes)?;
        if let Some(moves) = handles.filter(|moves| !moves.is_none()) {
            step.set_item("handle", by_id(moves)?)?;
        }
        let step = steps::step(&format!("apply({id:?})"), &step, &before.points)?;
        self.do_step(py, step, before, progress)
    }

    /// Appends samples in a part of the model as it is deformed now; the samples before keep their indices,
    /// and all arrays become new ones.
    ///
    /// `shapes` is a list of shapes as in a session, on the model as it is deformed now; it may be left out
    /// with `auto`, which finds out where the deformation needs samples. One of `factor` (times as many),
    /// `samples` (so many more) and `error` (a fraction of the diagonal) says how fine. `progress`: see
    /// `Model.sample`.
    #[pyo3(signature = (shapes = None, *, factor = None, samples = None, error = None, auto = false, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn refine(
        &self,
        py: Python<'_>,
        shapes: Option<&Bound<'_, PyAny>>,
        factor: Option<f64>,
        samples: Option<u64>,
        error: Option<f64>,
        auto: bool,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        if !self.of_file {
            return Err(argument(
                py,
                "samples of arrays in memory cannot be refined",
                "sample the arrays more finely",
            ));
        }
        let before = self.state(py).look(py)?;
        let refine = PyDict::new(py);
        add(&refine, "shapes", shapes)?;
        refine.set_item("factor", factor)?;
        refine.set_item("samples", samples)?;
        refine.set_item("error", error)?;
        if auto {
            refine.set_item("auto", true)?;
        }
        let step = PyDict::new(py);
        step.set_item("refine", refine)?;
        let step = steps::step("refine", &step, &[])?;
        self.do_step(py, step, before, progress)
    }

    /// Takes back the last `apply` or `refine`, with all that was written to `points` since. Returns whether
    /// there was one.
    fn undo(&self, py: Python<'_>) -> PyResult<bool> {
        let mut state = self.state(py);
        let now = state.look(py)?;
        let Some(before) = state.past.pop() else { return Ok(false) };
        state.future.push(now);
        state.go_to(py, before)?;
        Ok(true)
    }

    /// Does again the step that was taken back last. Returns whether there was one.
    fn redo(&self, py: Python<'_>) -> PyResult<bool> {
        let mut state = self.state(py);
        let now = state.look(py)?;
        let Some(after) = state.future.pop() else { return Ok(false) };
        state.past.push(now);
        state.go_to(py, after)?;
        Ok(true)
    }

    /// Carries points near the model's surface over, as `Model.apply` does its vertices: gives the new points
    /// and, where normals are given, the new normals, else None. Both are of shape (M, 3), float64, model
    /// coordinates. Points that are not finite stay as they are. `progress`: see `Model.sample`.
    #[pyo3(signature = (points, normals = None, *, progress = None))]
    fn transfer<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
        normals: Option<&Bound<'py, PyAny>>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Points<'py>, Option<Points<'py>>)> {
        let now = self.state(py).look(py)?;
        let (sampled, deformed) = (now.sampled.clone(), now.deformed());
        let rest = arrays::points("points", points, None)?;
        let normals = normals.filter(|normals| !normals.is_none());
        let normals = normals.map(|n| arrays::points("normals", n, Some(rest.len()))).transpose()?;
        let has_normals = normals.is_some();
        let mut normals: Vec<Vec3> = normals.unwrap_or_default().iter().map(|n| n.as_vec3()).collect();
        let ((moved, normals), _) = work(py, progress, |watch| {
            watch.begin("transferring", rest.len() as u64);
            let around = RestGeometry::kept(&sampled);
            let field = [DeformationField::from_deformed(&around, &deformed, Method::default())];
            let mut moved = rest.clone();
            let mut of_normals = normals.chunks_mut(BATCH);
            for (rest, positions) in rest.chunks(BATCH).zip(moved.chunks_mut(BATCH)) {
                watch.check()?;
                let normals = of_normals.next().unwrap_or_default();
                let moved = Moved { normals, ..Moved::places(positions) };
                carry(&field, &sampled.frame, rest, None, &mut [moved]);
                watch.advance(rest.len() as u64);
            }
            Ok((moved, normals))
        })?;
        let normals = has_normals.then(|| arrays::of_directions(py, &normals)).transpose()?;
        Ok((arrays::of_points(py, moved)?, normals))
    }

    /// Writes the samples as a folder, as `simod sample` does: at rest, with what a refinement needs. A
    /// former one at the place is replaced; any other folder or file there is an error.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        if !self.of_file {
            let what = "samples of arrays in memory have no model that a folder could name";
            return Err(argument(py, what, "write the arrays to a file, open that, and sample it"));
        }
        let sampled = self.sampled(py);
        py.detach(|| sampled.save(&folder)).or_raise(py)
    }

    /// Writes the samples at their positions now as a PLY file, which `simod reconstruct --deformed` takes,
    /// or any other program.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let (sampled, deformed) = self.written(py)?;
        let write = || {
            let mut guard = simod_core::guard::Guard::default();
            guard.reads_all(sampled.source.files());
            guard.writes(&path, simod_core::guard::OutputKind::Model)?;
            sampled.write_deformed(&path, &deformed, &deformed_normals(&sampled.samples, &deformed.local))
        };
        py.detach(write).or_raise(py)
    }

    /// Moves the samples to the positions that a file has: `samples.ply` with other positions, from any
    /// program. If the file has ids, these assign its points to the samples; otherwise the order does.
    fn read(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let sampled = self.sampled(py);
        let read =
            || sampled.read_deformed(&path, &Silent).map(|deformed| deformed.into_unshifted(&sampled.frame));
        let local = py.detach(read).or_raise(py)?;
        let mut state = self.state(py);
        let before = state.look(py)?;
        let named = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let steps = before.steps.iter().cloned().chain([named]).collect();
        state.go_to(py, UndoMoment::new(sampled, local.into(), steps))?;
        state.past.push(before);
        state.future.clear();
        Ok(())
    }
}

/// Moves of handles by their ids, as a session has them: a list of dictionaries.
fn by_id<'py>(moves: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let Ok(moves) = moves.cast::<PyDict>() else {
        return moves.try_iter()?.map(|entry| Ok(entry?.cast_into::<PyDict>()?)).collect();
    };
    let entry = |pair: Bound<'py, PyAny>| {
        let pair = pair.cast_into::<PyTuple>()?;
        let entry = PyDict::new(pair.py());
        entry.set_item("id", pair.get_item(0)?)?;
        entry.set_item("move", pair.get_item(1)?)?;
        Ok(entry)
    };
    moves.items().iter().map(entry).collect()
}

/// Reads samples from a folder that `Samples.save` or `simod sample` wrote: at rest.
#[pyfunction]
pub fn load(py: Python<'_>, folder: PathBuf) -> PyResult<Samples> {
    let load = || -> simod_model::Result<SampledModel> {
        let mut sampled = SampledModel::load(&folder)?;
        if let Some(cells) = SampledModel::kept_cells(Path::new(&folder)) {
            sampled.hold_cells(cells);
        }
        Ok(sampled)
    };
    Samples::new(py, py.detach(load).or_raise(py)?, true)
}

/// Samples arrays in memory: `points` of shape (M, 3), any numbers, in model coordinates; perhaps `normals`
/// of the same shape and `triangles` of shape (T, 3), whole numbers. They are copied once. `Samples.transfer`
/// carries the arrays over then.
///
/// `samples`, `error`, `by`, `place`, `grid` and `progress`: see `Model.sample`.
#[pyfunction]
#[pyo3(signature = (points, normals = None, *, triangles = None, samples = None, error = None, by = None, place = None,
    grid = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub fn sample(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    normals: Option<&Bound<'_, PyAny>>,
    triangles: Option<&Bound<'_, PyAny>>,
    samples: Option<i64>,
    error: Option<f64>,
    by: Option<&str>,
    place: Option<&str>,
    grid: Option<u32>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Samples> {
    let sampling = sampling(py, samples, error, by, place, grid)?;
    let points = arrays::points("points", points, None)?;
    let given = |array: Option<_>| array.filter(|array: &&Bound<'_, PyAny>| !array.is_none());
    let normals = given(normals).map(|n| arrays::points("normals", n, Some(points.len()))).transpose()?;
    let normals: Vec<Vec3> = normals.unwrap_or_default().iter().map(|n| n.as_vec3()).collect();
    let triangles = given(triangles).map(|t| arrays::triangles(t, points.len())).transpose()?;
    let model = InMemory::new(points, normals, triangles.unwrap_or_default()).or_raise(py)?;
    let (sampled, notes) =
        work(py, progress, |watch| sample_model(&model, &sampling, &std::env::temp_dir(), watch))?;
    let samples = Samples::new(py, sampled, false)?;
    warn(py, &notes)?;
    Ok(samples)
}
