//! Python functions as deformers: the parts of the plugin interface that they need, so that regions, masks,
//! sessions and comparisons treat them as any other.

use glam::DVec3;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Deserialize;
use simod_plugin_api::{
    Affine, Consumes, DeformInput, Descriptor, ErrorCode, HostCalls, ModelFrame, ParamDesc, Params,
    PluginError, PluginResult, PrepareInput, Role, Scratch, Setting, State,
};
use simod_session::{Capabilities, Code, Migration, OwnHandles, Plugin};

use crate::errors::OrRaise;
use crate::work::keep_raised;
use crate::{arrays, plugins};

/// Description of a function as `simod.deformer` found it out.
#[derive(Deserialize)]
struct FunctionDescription {
    id: String,
    name: String,
    summary: String,
    /// The deformer is a map of space, and may be asked for any points.
    everywhere: bool,
    /// The deformer wants normals.
    normals: bool,
    /// The deformer wants regions.
    regions: bool,
    params: Vec<Parameter>,
}

/// A parameter, and its default.
#[derive(Deserialize)]
struct Parameter {
    /// Name of the parameter in the function.
    name: String,
    id: String,
    #[serde(flatten)]
    kind: ParameterKind,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", content = "default")]
enum ParameterKind {
    Float(f64),
    Int(i64),
    Bool(bool),
    Choice([Vec<String>; 2]),
    Direction([f64; 3]),
    File(()),
}

/// A Python function.
struct Function {
    function: Py<PyAny>,
    description: FunctionDescription,
}

/// Registers a function; `description` is JSON.
#[pyfunction(name = "_register")]
pub fn register(py: Python<'_>, function: Py<PyAny>, description: &str) -> PyResult<()> {
    let description: FunctionDescription = serde_json::from_str(description)
        .map_err(|e| pyo3::exceptions::PyTypeError::new_err(e.to_string()))?;
    let code = Function { function, description };
    py.detach(|| Plugin::of_host(Box::new(code)).map(plugins::put)).or_raise(py)
}

/// Inputs of a call of the function beside the points, all in model coordinates.
struct CallInputs {
    frame: ModelFrame,
    /// Role and weights of each region.
    regions: Vec<(Role, Vec<f32>)>,
}

impl Function {
    fn call(
        &self,
        py: Python<'_>,
        prepared: &CallInputs,
        input: &DeformInput<'_>,
        points: Vec<DVec3>,
    ) -> PyResult<Vec<DVec3>> {
        let count = points.len();
        let keywords = PyDict::new(py);
        for Parameter { name, id, kind } in &self.description.params {
            keywords.set_item(name, given(py, &input.params(), id, kind)?)?;
        }
        if self.description.normals {
            let normals: &[[f32; 3]] = input.samples.normals();
            keywords.set_item("normals", arrays::of_directions(py, bytemuck::cast_slice(normals))?)?;
        }
        if self.description.regions {
            keywords.set_item("regions", regions(py, prepared, input.transforms())?)?;
        }
        let points = arrays::of_points(py, points)?;
        let moved = self.function.bind(py).call((points,), Some(&keywords))?;
        arrays::points(&format!("what {} returned", self.description.id), &moved, Some(count))
    }

    /// Calls with the lock of the interpreter, and keeps an exception as the cause of the error.
    fn with_lock<T>(&self, call: impl FnOnce(Python<'_>) -> PyResult<T>) -> PluginResult<T> {
        let called = Python::try_attach(|py| {
            call(py).map_err(|e| {
                let name = e.get_type(py).name().map_or_else(|_| "an exception".into(), |n| n.to_string());
                let text = format!("{name}: {}", e.value(py));
                keep_raised(e);
                PluginError::new(ErrorCode::INVALID_INPUT, text)
                    .hint("correct the function, or what it is given")
            })
        });
        called.unwrap_or_else(|| Err(PluginError::internal("the interpreter is about to end")))
    }
}

/// The value of a parameter as the function gets it.
fn given<'py>(
    py: Python<'py>,
    params: &Params<'_>,
    id: &str,
    kind: &ParameterKind,
) -> PyResult<Bound<'py, PyAny>> {
    let wrong = |e: PluginError| pyo3::exceptions::PyRuntimeError::new_err(e.message.to_string());
    Ok(match kind {
        ParameterKind::Float(_) => params.float(id).map_err(wrong)?.into_pyobject(py)?.into_any(),
        ParameterKind::Int(_) => params.int(id).map_err(wrong)?.into_pyobject(py)?.into_any(),
        ParameterKind::Bool(_) => params.bool(id).map_err(wrong)?.into_pyobject(py)?.to_owned().into_any(),
        ParameterKind::Choice(_) => params.choice(id).map_err(wrong)?.into_pyobject(py)?.into_any(),
        ParameterKind::Direction(_) => PyArray1::from_slice(py, &params.vec3(id).map_err(wrong)?).into_any(),
        ParameterKind::File(()) => params.file(id).map_err(wrong)?.into_pyobject(py)?.into_any(),
    })
}

/// Regions as the function gets them.
fn regions<'py>(
    py: Python<'py>,
    prepared: &CallInputs,
    transforms: &[Affine],
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let class = py.import("simod._records")?.getattr("Region")?;
    let mut transforms = transforms.iter();
    let region = |(role, weights): &(Role, Vec<f32>)| {
        let weights = PyArray1::from_iter(py, weights.iter().map(|w| f64::from(*w)));
        let is_handle = *role == Role::HANDLE;
        let map = if is_handle { transforms.next().copied() } else { None }.unwrap_or(Affine::IDENTITY);
        let rows = to_model(&map, &prepared.frame).map(|row| row.to_vec()).to_vec();
        let map = PyArray2::from_vec2(py, &rows)
            .map_err(|e| pyo3::exceptions::PyValueError::new_err(e.to_string()))?;
        class.call1((if is_handle { "handle" } else { "fixed" }, weights, map))
    };
    prepared.regions.iter().map(region).collect()
}

/// A map of local coordinates as one of the model's: M x + t becomes M x + (s t + o - M o).
fn to_model(map: &Affine, frame: &ModelFrame) -> [[f64; 4]; 3] {
    let o = frame.origin;
    std::array::from_fn(|i| {
        let [x, y, z, t] = map.rows[i];
        [x, y, z, frame.scale * t + o[i] - (x * o[0] + y * o[1] + z * o[2])]
    })
}

/// Error of a state that another plugin made.
fn no_state() -> PluginError {
    PluginError::internal("the state is another plugin's")
}

impl Code for Function {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        let FunctionDescription { id, name, summary, normals, regions, params, .. } = &self.description;
        let consumes = Consumes {
            normals: *normals,
            fixed_regions: *regions,
            handle_regions: *regions,
            frame: true,
            ..Consumes::default()
        };
        let param = |of: &Parameter| match &of.kind {
            ParameterKind::Float(default) => ParamDesc::float(&of.id, &of.name, *default),
            ParameterKind::Int(default) => ParamDesc::int(&of.id, &of.name, *default),
            ParameterKind::Bool(default) => ParamDesc::bool(&of.id, &of.name, *default),
            ParameterKind::Choice([choices, default]) => {
                let choices: Vec<(&str, &str)> = choices.iter().map(|c| (c.as_str(), c.as_str())).collect();
                let default = default.first().map_or("", String::as_str);
                ParamDesc::choice(&of.id, &of.name, default, &choices)
            }
            ParameterKind::Direction(default) => ParamDesc::direction(&of.id, &of.name, *default),
            ParameterKind::File(()) => ParamDesc::file(&of.id, &of.name, &[]),
        };
        let descriptor = Descriptor::new(id, name, "1.0.0").summary(summary).consumes(consumes);
        Ok(params.iter().map(param).fold(descriptor, Descriptor::param))
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities { evaluate: self.description.everywhere, ..Capabilities::default() }
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        Ok(None)
    }

    fn prepare(&self, input: &PrepareInput<'_>, _calls: &dyn HostCalls) -> PluginResult<State> {
        let frame = *input.frame().ok_or_else(|| PluginError::internal("the host gave no frame"))?;
        let regions = input.regions().iter().map(|r| (r.role, r.weights().to_vec())).collect();
        Ok(State::new(CallInputs { frame, regions }))
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        Ok(Scratch::new(()))
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        _scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        _calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let prepared = state.get::<CallInputs>().ok_or_else(no_state)?;
        let frame = &prepared.frame;
        let rest = input.samples.positions().iter();
        let rest: Vec<DVec3> = rest.map(|p| frame.to_model(p.map(f64::from)).into()).collect();
        let moved = self.with_lock(|py| self.call(py, prepared, input, rest.clone()))?;
        for (((out, local), rest), moved) in
            out.iter_mut().zip(input.samples.positions()).zip(rest).zip(moved)
        {
            // A point that the function left where it was stays to the bit.
            *out = if moved == rest { *local } else { frame.to_local(moved.into()).map(|x| x as f32) };
        }
        Ok(())
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        _calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let prepared = state.get::<CallInputs>().ok_or_else(no_state)?;
        let rest = points.iter().map(|p| prepared.frame.to_model(*p).into()).collect();
        let moved = self.with_lock(|py| self.call(py, prepared, input, rest))?;
        points.iter_mut().zip(moved).for_each(|(p, moved)| *p = prepared.frame.to_local(moved.into()));
        Ok(())
    }

    fn handles(&self, _input: &PrepareInput<'_>, _calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        Ok(OwnHandles::default())
    }

    fn is_identity(&self, _input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(false)
    }

    fn migrate(&self, _from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        Ok(settings)
    }
}
