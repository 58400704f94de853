//! Builds the plugins that the tests load, and finds them.
#![allow(dead_code, reason = "each test file uses its part")]
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

use simod_session::plugins::PluginFolder;
use simod_session::{PluginOptions, PluginRegistry};
use simod_tests::{built, library};
use std::env::consts::DLL_SUFFIX;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The plugins' libraries.
const PLUGINS: [&str; 3] = ["simod_warp", "simod_rbf", "misbehaving"];

/// Copies a plugin's library into a folder, under a name of its own.
pub fn copy(name: &str, folder: &Path, new_name: &str) -> PathBuf {
    let path = folder.join(format!("{new_name}{DLL_SUFFIX}"));
    std::fs::copy(library(name), &path).unwrap();
    path
}

/// Libraries of a folder, in this process.
pub fn options(folder: &Path) -> PluginOptions {
    PluginOptions::in_process(vec![PluginFolder { path: folder.to_owned(), by_name: false, shipped: false }])
}

/// Registry of all libraries in a folder.
pub fn load(folder: &Path) -> PluginRegistry {
    PluginRegistry::discover(&options(folder))
}

/// Registry of all libraries in a folder, each in a process of its own.
#[cfg(unix)]
pub fn load_isolated(folder: &Path) -> PluginRegistry {
    let command = ["simod", "plugin", "serve"].map(PathBuf::from);
    let command = vec![built().join(&command[0]), command[1].clone(), command[2].clone()];
    let options = PluginOptions {
        isolation: simod_session::Isolation::Always,
        worker: std::sync::Arc::new(simod_session::worker::WorkerOptions {
            command,
            silence: std::time::Duration::from_secs(60),
            memory: 1 << 30,
        }),
        ..options(folder)
    };
    PluginRegistry::discover(&options)
}

/// Registry of all built plugins.
pub fn registry() -> &'static PluginRegistry {
    static REGISTRY: OnceLock<PluginRegistry> = OnceLock::new();
    REGISTRY.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        for name in PLUGINS {
            copy(name, folder.path(), name);
        }
        load(folder.path())
    })
}
