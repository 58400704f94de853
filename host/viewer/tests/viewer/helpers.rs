//! Helpers that all tests of the viewer share.

#[path = "../../../session/tests/session/common/mod.rs"]
pub mod common;

use common::{copy, load};
use simod_generate::{ModelOptions, Shape, write_file};
use simod_model::progress::Silent;
use simod_session::PluginRegistry;
use simod_session::session_file::SamplingTable;
use simod_viewer::{Command, State};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Longer than anything here takes.
pub const LONG: Duration = Duration::from_secs(300);

/// The plugins that the tests use, in this process.
pub fn plugins() -> Arc<PluginRegistry> {
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
pub fn state(plugins: Arc<PluginRegistry>) -> State {
    State::new(plugins, Arc::new(|| ()))
}

/// Writes a model.
pub fn model(folder: &Path, shape: Shape, vertices: u64) -> PathBuf {
    let path = folder.join("model.ply");
    let options = ModelOptions { shape, vertices, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    path
}

/// The command that opens a model.
pub fn open(path: &Path, samples: u64) -> Command {
    let sampling = SamplingTable { samples: Some(samples), ..SamplingTable::default() };
    Command::Open { path: path.to_owned(), sampling, recover: false }
}

/// Does a command, and waits for its results.
pub fn done(state: &mut State, command: Command) {
    state.apply(command.clone()).unwrap_or_else(|e| panic!("{command:?}: {e}"));
    state.settle(LONG).unwrap();
}
