//! The plugins: those that came with the wheel, the user's, and Python functions.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use pyo3::prelude::*;
use serde_json::json;
use simod_session::{Plugin, PluginOptions, PluginRegistry, param_data};

use crate::work::locked;

/// Plugins that were found, once they were looked for.
static FOUND: Mutex<Option<Arc<PluginRegistry>>> = Mutex::new(None);

/// Python functions, by which a plugin of the same id is not seen.
static FUNCTIONS: Mutex<Vec<Arc<Plugin>>> = Mutex::new(Vec::new());

/// The program that came with the module: its plugins lie beside it.
fn program(py: Python<'_>) -> PyResult<PathBuf> {
    py.import("simod._program")?.getattr("PROGRAM")?.extract()
}

/// Registry of all plugins.
pub fn registry(py: Python<'_>) -> PyResult<Arc<PluginRegistry>> {
    let program = program(py)?;
    // Looking for them takes the lock that others wait for with that of the interpreter.
    py.detach(|| {
        let mut found = locked(&FOUND);
        if let Some(known) = &*found {
            return Ok(known.clone());
        }
        let mut registry = PluginRegistry::discover(&PluginOptions::of_program(&program));
        locked(&FUNCTIONS).iter().for_each(|plugin| registry.put(plugin.clone()));
        let registry = Arc::new(registry);
        *found = Some(registry.clone());
        Ok(registry)
    })
}

/// Adds a Python function, in the place of another one of its id.
pub fn put(plugin: Plugin) {
    let mut functions = locked(&FUNCTIONS);
    functions.retain(|known| known.id() != plugin.id());
    functions.push(Arc::new(plugin));
    drop(functions);
    *locked(&FOUND) = None;
}

/// Descriptions of all plugins, as JSON.
#[pyfunction(name = "_plugin_data")]
pub fn plugin_data(py: Python<'_>) -> PyResult<String> {
    let plugins = registry(py)?;
    let data = |plugin: &Arc<Plugin>| {
        let params: Vec<_> = plugin.params().iter().map(param_data).collect();
        let consumes = plugin.consumes();
        json!({
            "id": plugin.id(), "name": plugin.name(), "version": plugin.version(), "summary": plugin.summary(),
            "citation": plugin.citation(), "path": plugin.path().display().to_string(), "params": params,
            "handle_regions": consumes.handle_regions, "fixed_regions": consumes.fixed_regions,
            "joints": consumes.joints, "strokes": consumes.strokes, "handles": plugin.capabilities().handles,
        })
    };
    Ok(json!(plugins.plugins().iter().map(data).collect::<Vec<_>>()).to_string())
}
