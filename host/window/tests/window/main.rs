//! The window, driven as by people who do not see it: by the names of its controls. No graphics card is
//! needed, but for the pictures.
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

mod buttons;
mod compare;
mod detail;
mod edit;
mod files;
mod lessons;
mod looking;
mod motion;
mod parameters;
mod picture;
mod steps;
mod transform;
mod whole;

use egui_kittest::Harness;
use simod_generate::{ModelOptions, Shape, write_file};
use simod_model::progress::Silent;
use simod_session::plugins::PluginFolder;
use simod_session::session_file::SamplingTable;
use simod_session::{PluginOptions, PluginRegistry};
use simod_tests::library;
use simod_viewer::Command;
use simod_window::{App, Window, WindowSettings};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// The libraries of the project's plugins.
const PLUGINS: [&str; 8] = [
    "simod_cage",
    "simod_displacement_paint",
    "simod_laplacian",
    "simod_lattice",
    "simod_rbf",
    "simod_skinning",
    "simod_smooth_handle",
    "simod_warp",
];

/// Time that is longer than anything here takes.
const LONG: Duration = Duration::from_secs(300);

/// All plugins of the project, in this process.
fn plugins() -> Arc<PluginRegistry> {
    static REGISTRY: OnceLock<Arc<PluginRegistry>> = OnceLock::new();
    let all = || {
        let folder = tempfile::tempdir().unwrap();
        for name in PLUGINS {
            let file = library(name);
            std::fs::copy(&file, folder.path().join(file.file_name().unwrap())).unwrap();
        }
        let folder = PluginFolder { path: folder.path().to_owned(), by_name: false, shipped: false };
        let registry = PluginRegistry::discover(&PluginOptions::in_process(vec![folder]));
        assert_eq!(registry.plugins().len(), PLUGINS.len(), "{:?}", registry.rejected());
        Arc::new(registry)
    };
    REGISTRY.get_or_init(all).clone()
}

/// A window with nothing open.
fn window() -> Harness<'static, App> {
    let plugins = plugins();
    let builder = Harness::builder().with_size([1440.0, 900.0]);
    builder.build_eframe(|cc| App::new(cc, Window::new(&cc.egui_ctx, plugins, WindowSettings::default())))
}

/// Goes on until all work that was asked for is done.
fn settle(harness: &mut Harness<'_, App>) {
    let end = Instant::now() + LONG;
    loop {
        harness.run_steps(2);
        if !harness.state().window().state().is_busy() {
            harness.run_steps(2);
            return;
        }
        assert!(Instant::now() < end, "it takes too long");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Does a command, and waits for its results.
fn done(harness: &mut Harness<'_, App>, command: Command) {
    let shown = format!("{command:?}");
    let window = harness.state_mut().window_mut();
    let errors = |window: &Window| window.toasts.texts().map(str::to_owned).collect::<Vec<_>>();
    assert!(window.apply(command), "{shown}: {:?}", errors(window));
    settle(harness);
}

/// A bar with a session's worth of samples, opened.
fn open(harness: &mut Harness<'_, App>, path: &Path) {
    let sampling = SamplingTable { samples: Some(1500), ..SamplingTable::default() };
    done(harness, Command::Open { path: path.to_owned(), sampling, recover: false });
    assert!(harness.state().window().state().scene().is_some());
}

/// Writes a model.
fn model(folder: &Path) -> PathBuf {
    let path = folder.join("model.ply");
    let options = ModelOptions { shape: Shape::Bar, vertices: 12_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    path
}
