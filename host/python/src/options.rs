//! Keywords of Python as the host's options, and the records that are returned in the end.

use pyo3::prelude::*;
use serde_json::{Value, json};
use simod_core::reconstruction::{Method, Normals, Reconstruction};
use simod_core::sampling::{Sampling, Skip};
use simod_session::session_file;

use crate::errors::argument;

/// A record of `simod._records`.
pub fn record<'py>(py: Python<'py>, class: &str, content: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("simod._records")?.getattr("record")?.call1((class, content.to_string()))
}

/// Value of a word, one of those that sessions have.
fn word<T: serde::de::DeserializeOwned>(
    py: Python<'_>,
    what: &str,
    given: Option<&str>,
) -> PyResult<Option<T>> {
    let Some(given) = given else { return Ok(None) };
    serde_json::from_value(json!(given))
        .map(Some)
        .map_err(|e| argument(py, &format!("`{what}` cannot be \"{given}\""), &e.to_string()))
}

/// Options of sampling, from the arguments of a function.
pub fn sampling(
    py: Python<'_>,
    samples: Option<i64>,
    error: Option<f64>,
    by: Option<&str>,
    place: Option<&str>,
    grid: Option<u32>,
) -> PyResult<Sampling> {
    let wrong = |what: &str, hint: &str| Err(argument(py, what, hint));
    if samples.is_some() && error.is_some() {
        return wrong("both `samples` and `error` are given", "keep one of the two");
    }
    if samples.is_some_and(|n| n < 1) {
        return wrong("`samples` is not positive", "give a number such as 50_000");
    }
    if error.is_some_and(|e| !(e > 0.0 && e.is_finite())) {
        return wrong("`error` is not positive", "give a fraction of the diagonal, such as 2e-4");
    }
    if grid == Some(0) {
        return wrong("`grid` is 0", "leave it out, or give a number such as 128");
    }
    let (by, place) = (word(py, "by", by)?, word(py, "place", place)?);
    let samples = samples.map(|n| n as u64);
    let sampling = session_file::SamplingTable {
        samples,
        error,
        grid,
        place,
        by,
        ..session_file::SamplingTable::default()
    };
    Ok(Sampling { skip: Skip::default(), ..Sampling::from(sampling) })
}

/// Options of the transfer of a deformation, from the arguments of a function.
pub fn reconstruction(py: Python<'_>, normals: &str, method: &str) -> PyResult<Reconstruction<'static>> {
    let normals = match normals {
        "transform" => Normals::Transform,
        "keep" => Normals::Keep,
        "drop" => Normals::Drop,
        other => {
            let hint = "give \"transform\", \"keep\" or \"drop\"";
            return Err(argument(py, &format!("`normals` cannot be \"{other}\""), hint));
        }
    };
    let method = match method {
        "blended-jets" => Method::BlendedJets,
        "projected-barycentric" => Method::ProjectedBarycentric,
        other => {
            let hint = "give \"blended-jets\" or \"projected-barycentric\"";
            return Err(argument(py, &format!("`method` cannot be \"{other}\""), hint));
        }
    };
    Ok(Reconstruction { normals, method, ..Reconstruction::default() })
}
