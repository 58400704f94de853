//! `simod._simod`: the library for Python.
//!
//! Work is done by threads of its own without the interpreter's lock, while the thread that asked for it
//! looks after signals and progress (`work`). Arrays are numpy's, of doubles in the model's coordinates
//! (`arrays`). All that the program does is done by the same functions: those of `simod-session` and
//! `simod-core`.

mod arrays;
mod deformer;
mod errors;
mod model;
mod options;
mod plugins;
mod samples;
mod session;
mod steps;
mod units;
mod work;

use pyo3::prelude::*;

/// Native part of `simod`, which has all names of it that are meant to be used.
#[pymodule]
fn _simod(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<model::Model>()?;
    module.add_class::<model::Chunks>()?;
    module.add_class::<samples::Samples>()?;
    module.add_class::<session::Session>()?;
    module.add_function(wrap_pyfunction!(model::open, module)?)?;
    module.add_function(wrap_pyfunction!(samples::load, module)?)?;
    module.add_function(wrap_pyfunction!(samples::sample, module)?)?;
    module.add_function(wrap_pyfunction!(session::compare, module)?)?;
    module.add_function(wrap_pyfunction!(plugins::plugin_data, module)?)?;
    module.add_function(wrap_pyfunction!(deformer::register, module)?)?;
    module.add_function(wrap_pyfunction!(units::plan, module)?)?;
    module.add_function(wrap_pyfunction!(units::comparison_plan, module)?)?;
    module.add_function(wrap_pyfunction!(units::unit, module)?)?;
    module.add_function(wrap_pyfunction!(work::stop_all, module)?)?;
    Ok(())
}
