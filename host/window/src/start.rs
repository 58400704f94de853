//! The program: opens the window, or says why there is none, or does without a window what the command line
//! asks for.

use crate::app::App;
use crate::arguments::WindowArguments;
use crate::plugins::{SERVE, discover, serve};
use crate::screenshot::{ScreenshotFormat, Shot};
use crate::settings::{WindowSettings, is_sampled, sampling};
use crate::window::Window;
use crate::{screenshot, turntable};
use clap::Parser;
use eframe::{NativeOptions, Renderer, egui};
use simod_model::progress::Silent;
use simod_model::{Error, Result};
use simod_scene::NoGpu;
use simod_session::PluginRegistry;
use simod_viewer::record::Recorder;
use simod_viewer::state::Notice;
use simod_viewer::{Command, record, replay};
use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;

/// Main function of `simod-viewer`, but for `main` itself.
pub fn main() -> ExitCode {
    // A plugin that did not come with the program is run by this program once more.
    let mut plain = std::env::args_os().skip(1);
    let ended = if plain.next().is_some_and(|first| first == SERVE) {
        serve(plain.collect())
    } else {
        execute(WindowArguments::parse())
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "error: {error}\nhint: {}", error.hint());
            ExitCode::FAILURE
        }
    }
}

fn execute(arguments: WindowArguments) -> Result<()> {
    let plugins = Arc::new(discover());
    let recorded = match &arguments.replay {
        Some(file) => {
            let text = std::fs::read_to_string(file).map_err(|e| Error::io("read", file, &e))?;
            record::parse(&text)?
        }
        None => Vec::new(),
    };
    if !arguments.no_window && arguments.screenshot.is_none() && arguments.turntable.is_none() {
        return open_window(arguments, recorded, plugins);
    }
    let open = arguments.path.map(|path| {
        let sampling =
            sampling(arguments.samples.or((!is_sampled(&path)).then_some(WindowSettings::default().samples)));
        Command::Open { path, sampling, recover: false }
    });
    let commands: Vec<Command> = open.into_iter().chain(recorded).collect();
    let mut state = replay(&commands, &plugins)?;
    for notice in state.take_notices() {
        if let Notice::Failed(_, error) = notice {
            return Err(error);
        }
    }
    let format = ScreenshotFormat { size: arguments.size, transparent: arguments.transparent };
    if let Some(file) = &arguments.screenshot {
        screenshot::write(&mut state, file, format)?;
    }
    if let Some(folder) = &arguments.turntable {
        let shot = Shot::take(&state)?.formatted(turntable::of_film(format));
        turntable::write(&shot, folder, arguments.frames, &Silent)?;
        let command = turntable::film(folder, turntable::RATE, arguments.transparent);
        let _ = writeln!(std::io::stdout(), "film: {command}");
    }
    Ok(())
}

/// Shows the window until it is closed.
///
/// # Errors
/// There is nothing to draw with, no screen, or a file cannot be read.
fn open_window(
    arguments: WindowArguments,
    recorded: Vec<Command>,
    plugins: Arc<PluginRegistry>,
) -> Result<()> {
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
        let mut window = Window::new(&cc.egui_ctx, plugins, WindowSettings::load());
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
        Err(_) => Err(Error::system("the window ended with a mistake in the program", RECOVER)),
    }
}

const RECOVER: &str = "open the model again: what was not saved is offered for recovery";

/// Error that tells why there is no window, and what to do.
fn refused(error: &eframe::Error) -> Error {
    let text = error.to_string();
    let is_screen = matches!(error, eframe::Error::Winit(_) | eframe::Error::WinitEventLoop(_));
    if is_screen {
        // The library's message without the place in its source.
        let text = text.rsplit(": ").next().unwrap_or_default();
        let hint = "start it where there is a screen, or replay a recording with --no-window";
        Error::system(format!("no window can be opened: {text}"), hint)
    } else {
        Error::system(format!("no graphics card can be used: {text}"), NoGpu::HINT)
    }
}
