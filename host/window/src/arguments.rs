//! The command line.

use crate::screenshot::{Format, LARGEST, Shot};
use crate::settings::Settings;
use crate::turntable::FRAMES;
use crate::{screenshot, start, turntable};
use clap::Parser;
use simod_model::progress::Silent;
use simod_model::{Error, ErrorKind, Result};
use simod_picture::FrameFolder;
use simod_session::session_file::Sampling;
use simod_session::worker::{self, WorkerOptions};
use simod_session::{Isolation, PluginOptions, PluginRegistry};
use simod_viewer::state::Notice;
use simod_viewer::{Command, record, replay};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

/// How long a plugin in a process of its own may give no sign of life, and how much memory it may take: as
/// `simod` has it.
const PATIENCE: Duration = Duration::from_secs(120);
const MEMORY: u64 = 4 << 30;

/// Edit a model of any size in a window
#[derive(Parser)]
#[command(name = "simod-viewer", version, max_term_width = 100)]
pub struct Arguments {
    /// A model, the folder of a sampled one, or a session (session.toml)
    pub path: Option<PathBuf>,
    /// About how many samples to take of a model
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// Write all that is done to a file, one command a line
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Do what was recorded
    #[arg(long, value_name = "FILE", conflicts_with = "path")]
    pub replay: Option<PathBuf>,
    /// Do it without a window
    #[arg(long, requires = "replay")]
    pub no_window: bool,
    /// Draw what there is after that to a PNG file, and end
    #[arg(long, value_name = "PNG")]
    pub screenshot: Option<PathBuf>,
    /// Width and height of what is drawn, in pixels
    #[arg(long, value_name = "WxH", default_value = "1600x1000", value_parser = size)]
    pub size: [u32; 2],
    /// Draw it before a background that is seen through
    #[arg(long)]
    pub transparent: bool,
    /// Draw frames of a full turn of it into a folder, and end
    #[arg(long, value_name = "DIR")]
    pub turntable: Option<PathBuf>,
    /// How many frames
    #[arg(long, value_name = "N", default_value_t = FRAMES, requires = "turntable",
        value_parser = clap::value_parser!(u32).range(1..=i64::from(FrameFolder::MOST)))]
    pub frames: u32,
}

/// What `simod-viewer` does: everything but `main` itself.
pub fn main() -> ExitCode {
    // A plugin that did not come with the program is run by this program once more.
    let mut plain = std::env::args_os().skip(1);
    let ended = if plain.next().is_some_and(|first| first == SERVE) {
        serve(plain.collect())
    } else {
        execute(Arguments::parse())
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "error: {error}\nhint: {}", error.hint());
            ExitCode::FAILURE
        }
    }
}

const SERVE: &str = "serve-plugin";

fn serve(rest: Vec<std::ffi::OsString>) -> Result<()> {
    let wrong = || Error::new(ErrorKind::Argument, "the program calls this itself", "do not call it");
    let [file, memory, parent] = rest.as_slice() else { return Err(wrong()) };
    let memory = memory.to_str().and_then(|text| text.parse().ok()).ok_or_else(wrong)?;
    let parent = parent.to_str().and_then(|text| text.parse().ok()).ok_or_else(wrong)?;
    worker::serve(file.as_ref(), memory, parent)
}

fn execute(arguments: Arguments) -> Result<()> {
    let plugins = Arc::new(discover());
    let recorded = match &arguments.replay {
        Some(file) => {
            let text = std::fs::read_to_string(file).map_err(|e| Error::io("read", file, &e))?;
            record::parse(&text)?
        }
        None => Vec::new(),
    };
    if !arguments.no_window && arguments.screenshot.is_none() && arguments.turntable.is_none() {
        return start::open_window(arguments, recorded, plugins);
    }
    let open = arguments.path.map(|path| {
        let sampling =
            sampling(arguments.samples.or((!is_sampled(&path)).then_some(Settings::default().samples)));
        Command::Open { path, sampling, recover: false }
    });
    let commands: Vec<Command> = open.into_iter().chain(recorded).collect();
    let mut state = replay(&commands, &plugins)?;
    for notice in state.take_notices() {
        if let Notice::Failed(_, error) = notice {
            return Err(error);
        }
    }
    let format = Format { size: arguments.size, transparent: arguments.transparent };
    if let Some(file) = &arguments.screenshot {
        screenshot::write(&mut state, file, format)?;
    }
    if let Some(folder) = &arguments.turntable {
        let shot = Shot::of(&mut state)?.formatted(turntable::of_film(format));
        turntable::write(&shot, folder, arguments.frames, &Silent)?;
        let command = turntable::film(folder, turntable::RATE, arguments.transparent);
        let _ = writeln!(std::io::stdout(), "film: {command}");
    }
    Ok(())
}

/// Width and height, as `1920x1080`.
fn size(text: &str) -> std::result::Result<[u32; 2], String> {
    let sides =
        text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    let sides = sides.filter(|sides: &[u32; 2]| sides.iter().all(|side| (1..=LARGEST).contains(side)));
    sides.ok_or_else(|| format!("give width and height, as 1920x1080, of at most {LARGEST} pixels each"))
}

/// Whether it says itself how it is sampled: a session, or the folder of a sampled model.
pub fn is_sampled(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "toml") || path.is_dir()
}

/// How finely a model is sampled, if `--samples` says so.
pub fn sampling(samples: Option<u64>) -> Sampling {
    Sampling { samples, ..Sampling::default() }
}

/// The plugins in the standard folders.
pub fn discover() -> PluginRegistry {
    let program = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("simod-viewer"));
    let options = WorkerOptions { command: vec![program, SERVE.into()], silence: PATIENCE, memory: MEMORY };
    PluginRegistry::discover(&PluginOptions::standard(Isolation::Others, options))
}
