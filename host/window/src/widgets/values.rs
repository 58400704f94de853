//! Values of parameters, as a session has them, and the user's requests for others.

use simod_model::bounds::Bounds;
use simod_plugin_api::{ParamDesc, ParamKind};
use toml::Value;

/// Request of the user.
#[derive(Debug, Clone, PartialEq)]
pub enum ListRequest {
    /// Another value; nothing for the default.
    Set(Option<Value>),
    /// Another value, while it is dragged.
    Drag(Value),
    /// The drag is over, maybe with a last value.
    Rest(Option<Value>),
    /// A dialog that chooses a file.
    File,
}

/// A number, whole or not.
pub fn as_number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}

/// The N numbers of a value that is a list of just so many.
pub fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(as_number).collect();
    numbers?.try_into().ok()
}

/// The points of a curve.
pub fn points(value: &Value) -> Option<Vec<[f64; 2]>> {
    value.as_array()?.iter().map(numbers).collect()
}

/// The value of numbers.
pub fn list(numbers: &[f64]) -> Value {
    Value::Array(numbers.iter().map(|x| Value::Float(*x)).collect())
}

/// The number that a parameter has, given or not.
pub fn number_of(desc: &ParamDesc, value: Option<&Value>) -> f64 {
    let default = desc.default_numbers.first().copied().unwrap_or(0.0);
    value.and_then(as_number).unwrap_or(default)
}

/// The direction or point that a parameter has, given or not; points in model coordinates.
pub fn vector_of(desc: &ParamDesc, value: Option<&Value>, bounds: &Bounds) -> [f64; 3] {
    let size = bounds.max - bounds.min;
    let default = || {
        std::array::from_fn(|i| {
            let x = desc.default_numbers.get(i).copied().unwrap_or(0.0);
            // A point's default is a fraction of the model's box.
            if desc.kind == ParamKind::POINT { bounds.min[i] + x * size[i] } else { x }
        })
    };
    value.and_then(numbers::<3>).unwrap_or_else(default)
}
