//! Arrays of numpy's, and points of ours. Arrays from Python are checked by `simod._arrays`, which names the
//! fault.

use bytemuck::allocation::cast_vec;
use glam::{DVec3, Vec3};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// An (N, 3) array of doubles, which takes the points over.
pub fn of_points(py: Python<'_>, points: Vec<DVec3>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let count = points.len();
    let numbers: Vec<f64> = if points.is_empty() { Vec::new() } else { cast_vec(points) };
    PyArray1::from_vec(py, numbers).reshape([count, 3])
}

/// An array of directions of single precision.
pub fn of_directions<'py>(py: Python<'py>, directions: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    of_points(py, directions.iter().map(|d| d.as_dvec3()).collect())
}

/// An (N, 3) array of whole numbers.
pub fn of_triples<'py, T: numpy::Element>(
    py: Python<'py>,
    triples: Vec<T>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let count = triples.len() / 3;
    PyArray1::from_vec(py, triples).reshape([count, 3])
}

/// Makes an array read-only for everybody.
pub fn read_only<T: numpy::Element>(array: &Bound<'_, PyArray2<T>>) {
    if let Ok(writer) = array.try_readwrite() {
        let _ = writer.make_nonwriteable();
    }
}

/// An array of any numbers as (N, 3) doubles, each finite or not; `what` it is, for errors, and how many
/// there have to be.
pub fn points(what: &str, given: &Bound<'_, PyAny>, count: Option<usize>) -> PyResult<Vec<DVec3>> {
    let checked = given.py().import("simod._arrays")?.getattr("points")?.call1((what, given, count))?;
    let checked: PyReadonlyArray2<'_, f64> = checked.extract()?;
    Ok(bytemuck::cast_slice(checked.as_slice()?).to_vec())
}

/// An array of whole numbers as (N, 3) corners of triangles.
pub fn triangles(given: &Bound<'_, PyAny>, vertices: usize) -> PyResult<Vec<[u32; 3]>> {
    let checked = given.py().import("simod._arrays")?.getattr("triangles")?.call1((given, vertices))?;
    let checked: PyReadonlyArray2<'_, u32> = checked.extract()?;
    Ok(bytemuck::cast_slice(checked.as_slice()?).to_vec())
}

/// Whether an array still has the shape of so many points, with its numbers one behind the other.
pub fn is_of_points(array: &Bound<'_, PyArray2<f64>>, count: usize) -> bool {
    array.ndim() == 2 && array.shape() == [count, 3] && array.is_c_contiguous()
}
