//! Steps as a session has them, made of Python's lists and dictionaries. They are read by the reader of
//! sessions, which checks them.

use std::path::Path;

use glam::DVec3;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyString};
use simod_session::session_file::SessionFile;
use simod_session::step::{Action, Step};
use simod_session::{PickedPoints, RegionShape};
use toml::{Table, Value};

use crate::errors::{OrRaise, argument};

/// Key of a region that has, instead of shapes, an array of truth values, one for each sample.
const WHERE: &str = "where";

/// Reads one step; `positions` are those of the samples now, in the model's coordinates, for regions that are
/// told by the samples in them.
pub fn step(name: &str, step: &Bound<'_, PyDict>, positions: &[DVec3]) -> PyResult<Step> {
    let py = step.py();
    let mut table = table(step)?;
    let masks = masks(step, &mut table, positions.len())?;
    let session = Table::from_iter([("step".to_owned(), Value::Array(vec![Value::Table(table)]))]);
    let text = toml::to_string(&session)
        .map_err(|e| argument(py, &format!("{name}: {e}"), "give numbers, texts, lists and dictionaries"))?;
    let session = SessionFile::parse(&text, Path::new(name)).or_raise(py)?;
    let mut step = session.steps.into_iter().next().ok_or_else(|| argument(py, "there is no step", ""))?;
    name.clone_into(&mut step.place);
    if let Action::Deform(deformation) = &mut step.action {
        for (region, mask) in deformation.regions.iter_mut().zip(masks) {
            let Some(mask) = mask else { continue };
            let some = |wanted| positions.iter().zip(&mask).filter(move |m| *m.1 == wanted).map(|m| *m.0);
            let picked = PickedPoints::new(some(true).collect(), some(false).collect());
            if let Some(defect) = picked.defect() {
                return Err(argument(py, &format!("{name}: {defect}"), "choose at least one sample"));
            }
            region.shapes.shapes = vec![RegionShape::Selection(picked)];
        }
    }
    Ok(step)
}

/// The arrays of truth values among the regions, which leave the table.
fn masks(step: &Bound<'_, PyDict>, table: &mut Table, samples: usize) -> PyResult<Vec<Option<Vec<bool>>>> {
    let Some(regions) = step.get_item("region")? else { return Ok(Vec::new()) };
    let Some(Value::Array(tables)) = table.get_mut("region") else { return Ok(Vec::new()) };
    let mut masks = Vec::new();
    for (region, table) in regions.try_iter()?.zip(tables) {
        let given = region?.cast::<PyDict>().ok().map(|region| region.get_item(WHERE)).transpose()?.flatten();
        let (Some(given), Value::Table(table)) = (given, table) else {
            masks.push(None);
            continue;
        };
        let mask = step.py().import("simod._arrays")?.getattr("mask")?.call1((given, samples))?;
        masks.push(Some(mask.extract()?));
        // A shape that the reader of sessions asks for; the samples picked take its place later.
        let origin = Value::Array(vec![Value::Float(0.0); 3]);
        let sphere =
            Table::from_iter([("center".to_owned(), origin), ("radius".to_owned(), Value::Float(1.0))]);
        let shape = Table::from_iter([("sphere".to_owned(), Value::Table(sphere))]);
        table.insert("shapes".to_owned(), Value::Array(vec![Value::Table(shape)]));
    }
    Ok(masks)
}

/// Table of a dictionary, whose names may have `_` for `-`, and one more at the end where they are Python's
/// own, as `from_`; values of None are left out.
fn table(of: &Bound<'_, PyDict>) -> PyResult<Table> {
    let mut table = Table::new();
    for (key, given) in of {
        let key: String = key.extract().map_err(|_| PyTypeError::new_err(format!("{key} is no name")))?;
        if key != WHERE && !given.is_none() {
            table.insert(key.trim_end_matches('_').replace('_', "-"), value(&given)?);
        }
    }
    Ok(table)
}

/// Value of a Python object that has a counterpart in a session.
fn value(of: &Bound<'_, PyAny>) -> PyResult<Value> {
    if let Ok(table_of) = of.cast::<PyDict>() {
        return table(table_of).map(Value::Table);
    }
    if of.is_instance_of::<PyBool>() {
        return of.extract().map(Value::Boolean);
    }
    if of.is_instance_of::<PyInt>() {
        return of.extract().map(Value::Integer);
    }
    if of.is_instance_of::<PyFloat>() {
        return of.extract().map(Value::Float);
    }
    if of.is_instance_of::<PyString>() {
        return of.extract().map(Value::String);
    }
    if of.hasattr("__fspath__")? {
        return of.call_method0("__fspath__")?.extract().map(Value::String);
    }
    // Numbers and arrays of numpy's.
    if of.hasattr("tolist")? {
        return value(&of.call_method0("tolist")?);
    }
    let Ok(entries) = of.try_iter() else {
        let kind = of.get_type().qualname()?;
        return Err(PyTypeError::new_err(format!(
            "a parameter is of type {kind}, which no session can hold"
        )));
    };
    entries.map(|entry| value(&entry?)).collect::<PyResult<_>>().map(Value::Array)
}
