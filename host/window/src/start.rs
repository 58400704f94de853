//! Opens the window, or says why there is none.

use crate::app::App;
use crate::arguments::{Arguments, sampling};
use crate::settings::Settings;
use crate::window::Window;
use eframe::{NativeOptions, Renderer, egui};
use simod_model::{Error, ErrorKind, Result};
use simod_scene::NoGpu;
use simod_session::PluginRegistry;
use simod_viewer::Command;
use simod_viewer::record::Recorder;
use std::sync::Arc;

/// The window, until it is closed.
///
/// # Errors
/// There is nothing to draw with, no screen, or a file cannot be read.
pub fn open_window(arguments: Arguments, recorded: Vec<Command>, plugins: Arc<PluginRegistry>) -> Result<()> {
    let recorder = match &arguments.record {
        Some(file) => {
            let made = std::fs::File::create(file).map_err(|e| Error::io("write", file, &e))?;
            Some(Recorder::new(made))
        }
        None => None,
    };
    let viewport = egui::ViewportBuilder::default()
        .with_title("SIMOD")
        .with_app_id("simod-viewer")
        .with_inner_size([1440.0, 900.0])
        .with_min_inner_size([800.0, 520.0])
        .with_drag_and_drop(true);
    let options = NativeOptions { viewport, renderer: Renderer::Wgpu, centered: true, ..Default::default() };
    let create: eframe::AppCreator<'_> = Box::new(move |cc| {
        let mut window = Window::new(&cc.egui_ctx, plugins, Settings::load());
        window.record(recorder);
        if let Some(path) = arguments.path {
            window.open(path, sampling(arguments.samples), false);
        }
        window.replay(recorded);
        Ok(Box::new(App::new(cc, window)))
    });
    // Panics of a driver or its loader must not look like a crash of the program.
    let run = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        eframe::run_native("simod-viewer", options, create)
    }));
    match run {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) => Err(refused(&error)),
        Err(_) => Err(Error::new(ErrorKind::Io, "the window ended with a mistake in the program", RECOVER)),
    }
}

const RECOVER: &str = "open the model again: what was not saved is offered for recovery";

/// Why there is no window, and what to do.
fn refused(error: &eframe::Error) -> Error {
    let text = error.to_string();
    let is_screen = matches!(error, eframe::Error::Winit(_) | eframe::Error::WinitEventLoop(_));
    if is_screen {
        // Without the place in the library's source.
        let text = text.rsplit(": ").next().unwrap_or_default();
        let hint = "start it where there is a screen, or replay a recording with --no-window";
        Error::new(ErrorKind::Io, format!("no window can be opened: {text}"), hint)
    } else {
        Error::new(ErrorKind::Io, format!("no graphics card can be used: {text}"), NoGpu::HINT)
    }
}
