//! The viewer without its window, on models that are made here, with the plugins that are built here.
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

#[path = "../../../session/tests/common/mod.rs"]
mod common;
mod edits;
mod errors;
mod preview;
mod random;
mod selecting;

use common::{copy, load};
use glam::DVec3;
use simod_core::generate::{ModelOptions, Shape, write_file};
use simod_core::progress::Silent;
use simod_session::PluginRegistry;
use simod_session::session_file::Sampling;
use simod_viewer::{Command, State};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Longer than anything here takes.
const LONG: Duration = Duration::from_secs(300);

/// The plugins that the tests use, in this process.
fn plugins() -> Arc<PluginRegistry> {
    static PLUGINS: OnceLock<Arc<PluginRegistry>> = OnceLock::new();
    let all = || {
        let folder = tempfile::tempdir().unwrap();
        for name in ["simod_warp", "simod_rbf", "simod_displacement_paint", "simod_lattice"] {
            copy(name, folder.path(), name);
        }
        Arc::new(load(folder.path()))
    };
    PLUGINS.get_or_init(all).clone()
}

/// A state with nothing open.
fn state(plugins: Arc<PluginRegistry>) -> State {
    State::new(plugins, Arc::new(|| ()))
}

/// Writes a model.
fn model(folder: &Path, shape: Shape, vertices: u64) -> PathBuf {
    let path = folder.join("model.ply");
    let options = ModelOptions { shape, vertices, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    path
}

/// The command that opens a model.
fn open(path: &Path, samples: u64) -> Command {
    let sampling = Sampling { samples: Some(samples), ..Sampling::default() };
    Command::Open { path: path.to_owned(), sampling, recover: false }
}

/// Does a command, and waits for what it brings.
fn done(state: &mut State, command: Command) {
    state.apply(command.clone()).unwrap_or_else(|e| panic!("{command:?}: {e}"));
    state.settle(LONG).unwrap();
}

/// The pixel of a point, model coordinates.
fn pixel(state: &State, p: DVec3) -> [f64; 2] {
    let local = state.scene().unwrap().frame().to_local_exact(p);
    state.camera().project(local, state.size()).unwrap().0.to_array()
}
