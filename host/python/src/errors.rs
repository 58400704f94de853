//! Errors as exceptions: `simod.Error` and its kinds, each with its hint.

use pyo3::prelude::*;
use simod_model::{Error, ErrorKind};

/// The name of the exception of a kind, in `simod._errors`.
fn class(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::Io => "FileError",
        ErrorKind::Format => "FormatError",
        ErrorKind::Degenerate => "DegenerateError",
        ErrorKind::Mismatch => "MismatchError",
        ErrorKind::Argument => "ArgumentError",
        ErrorKind::Plugin => "PluginError",
        ErrorKind::Cancelled => "Cancelled",
        _ => "Error",
    }
}

/// The exception for an error.
pub fn exception(py: Python<'_>, error: &Error) -> PyErr {
    raised(py, class(error.kind()), &error.to_string(), error.hint())
}

/// An `ArgumentError`: the fault and the advice.
pub fn argument(py: Python<'_>, what: &str, hint: &str) -> PyErr {
    raised(py, "ArgumentError", what, hint)
}

fn raised(py: Python<'_>, class: &str, what: &str, hint: &str) -> PyErr {
    let make = || py.import("simod._errors")?.getattr(class)?.call1((what, hint));
    make().map_or_else(|e| e, PyErr::from_value)
}

/// The exception of a result's error.
pub trait OrRaise<T> {
    /// The value, or the exception for the error.
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> OrRaise<T> for simod_model::Result<T> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|e| exception(py, &e))
    }
}
