//! Time in which the samples follow a hand: from a drag's command to the moved samples that the viewer draws
//! next, as the viewer does it but for its window.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Parser;
use glam::DVec3;
use simod_benches::process::{Result, exit, own_cpu};
use simod_benches::{head, row};
use simod_core::refinement::Finer;
use simod_generate::{ModelOptions, write_file};
use simod_model::Error;
use simod_model::memory::anonymous;
use simod_model::progress::Silent;
use simod_session::edit::{self, Change};
use simod_session::plugins::PluginFolder;
use simod_session::session_file::SamplingTable;
use simod_session::step::Role;
use simod_session::{Motion, PluginOptions, PluginRegistry};
use simod_viewer::command::Area;
use simod_viewer::shading::Rings;
use simod_viewer::{Command, Selection, State};

/// Measure how fast samples follow a drag in the viewer, as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Numbers of samples
    #[arg(long, value_delimiter = ',', default_value = "50000,200000,1000000", value_name = "N,...")]
    samples: Vec<u64>,
    /// Pictures of each drag
    #[arg(long, default_value_t = 41, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Number of samples that a picture draws, and asks how the surface lies there; the window begins with as
    /// many
    #[arg(long, default_value_t = 128_000, value_name = "N")]
    drawn: u32,
    /// Beginning of the names of the rows to measure
    #[arg(long, default_value = "", value_name = "TEXT")]
    only: String,
    /// Folder for temporary files
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
}

const COLUMNS: [&str; 7] = [
    "what is dragged",
    "samples",
    "median, ms",
    "95 % below, ms",
    "processor, ms",
    "at rest after, ms",
    "memory, MB",
];

/// Longer than anything here takes.
const LONG: Duration = Duration::from_secs(600);

/// A stack of steps; what is dragged is the handle of step `dragged`, or a parameter where it has none.
struct Case {
    name: &'static str,
    steps: &'static [Step],
    dragged: usize,
}

#[derive(Clone, Copy)]
enum Step {
    /// A plugin that takes no regions, with the parameter that is dragged.
    Param(&'static str, &'static str),
    /// A plugin with the model's foot fixed and its top as a handle; maybe in a mode.
    Handle(&'static str, Option<&'static str>),
    /// A plugin that places handles itself, with the one that is dragged.
    Own(&'static str, &'static str),
    /// Twice as many samples around the middle.
    Refine,
}

use Step::{Handle, Own, Param, Refine};

const CASES: [Case; 8] = [
    Case { name: "warp, the angle", steps: &[Param("warp", "angle")], dragged: 0 },
    Case { name: "lattice, a point", steps: &[Own("lattice", "1,1,1")], dragged: 0 },
    Case { name: "rbf", steps: &[Handle("rbf", None)], dragged: 0 },
    Case { name: "smooth-handle", steps: &[Handle("smooth-handle", None)], dragged: 0 },
    Case {
        name: "laplacian, as rigid as possible",
        steps: &[Handle("laplacian", Some("smooth-arap"))],
        dragged: 0,
    },
    Case { name: "rbf above a warp", steps: &[Param("warp", "angle"), Handle("rbf", None)], dragged: 1 },
    Case { name: "rbf below a warp", steps: &[Handle("rbf", None), Param("warp", "angle")], dragged: 0 },
    Case { name: "rbf below a refinement", steps: &[Handle("rbf", None), Refine], dragged: 0 },
];

fn main() -> ExitCode {
    exit(table(&Arguments::parse()))
}

fn table(arguments: &Arguments) -> Result<()> {
    let here = std::env::current_exe()?;
    let path = here.parent().unwrap_or(Path::new("")).to_owned();
    let folder = PluginFolder { path, by_name: true, shipped: true };
    let plugins = Arc::new(PluginRegistry::discover(&PluginOptions::in_process(vec![folder])));
    println!("{}", head(&COLUMNS));
    for &samples in &arguments.samples {
        let folder = tempfile::tempdir_in(&arguments.folder)?;
        let path = folder.path().join("model.ply");
        write_file(&ModelOptions { vertices: 5 * samples, ..ModelOptions::default() }, &path, &Silent)?;
        for case in CASES.iter().filter(|case| case.name.starts_with(&arguments.only)) {
            let mut hand = Hand::new(plugins.clone(), &path, samples)?;
            for step in case.steps {
                hand.add(*step)?;
            }
            let Dragged { mut took, mut processor, rest } =
                hand.drag(case, arguments.frames, arguments.drawn)?;
            took.sort_unstable_by(f64::total_cmp);
            processor.sort_unstable_by(f64::total_cmp);
            let of = |all: &[f64], part: f64| {
                format!("{:.1}", 1e3 * all[(part * (all.len() - 1) as f64) as usize])
            };
            println!(
                "{}",
                row([
                    case.name.to_owned(),
                    hand.state.scene().map_or(0, |scene| scene.len()).to_string(),
                    of(&took, 0.5),
                    of(&took, 0.95),
                    of(&processor, 0.5),
                    format!("{:.0}", 1e3 * rest),
                    anonymous().map_or_else(|| "-".to_owned(), |bytes| format!("{:.0}", bytes as f64 / 1e6)),
                ])
            );
        }
    }
    Ok(())
}

/// Seconds that each picture of a drag took, by the clock and on all processors, and those of the one at
/// rest.
struct Dragged {
    took: Vec<f64>,
    processor: Vec<f64>,
    rest: f64,
}

/// A user.
struct Hand {
    state: State,
    /// The samples that pictures draw, and what is kept of them.
    drawn: Arc<[u32]>,
    rings: Option<Rings>,
}

impl Hand {
    fn new(plugins: Arc<PluginRegistry>, model: &Path, samples: u64) -> Result<Self> {
        let state = State::new(plugins, Arc::new(|| ()));
        let mut hand = Self { state, drawn: Arc::default(), rings: None };
        let sampling = SamplingTable { samples: Some(samples), ..SamplingTable::default() };
        hand.done(Command::Open { path: model.to_owned(), sampling, recover: false })?;
        Ok(hand)
    }

    fn done(&mut self, command: Command) -> Result<()> {
        self.state.apply(command)?;
        self.state.settle(LONG)?;
        match self.state.take_notices().into_iter().next() {
            Some(simod_viewer::state::Notice::Failed(_, error)) => Err(error.into()),
            _ => Ok(()),
        }
    }

    fn add(&mut self, step: Step) -> Result<()> {
        let at = self.state.document().map_or(0, |document| document.steps().len());
        match step {
            Param(plugin, _) | Own(plugin, _) => {
                self.done(Command::AddStep { plugin: plugin.to_owned(), at: None })
            }
            Handle(plugin, mode) => {
                self.done(Command::AddStep { plugin: plugin.to_owned(), at: None })?;
                if let Some(mode) = mode {
                    let change = Change::SetParam { id: "mode".to_owned(), value: Some(mode.into()) };
                    self.done(Command::Edit(edit::EditCommand::Change { at, change }))?;
                }
                self.region(at, Role::Fixed, 0.0..0.35)?;
                self.region(at, Role::Handle, 0.9..1.1)
            }
            Refine => {
                self.select(0.45..0.55)?;
                self.done(Command::RefineSelection { finer: Finer::Factor(2.0) })
            }
        }
    }

    /// Selects a part of the model by its height, in fractions.
    fn select(&mut self, heights: std::ops::Range<f32>) -> Result<()> {
        let scene = self.state.scene().ok_or_else(Error::cancelled)?;
        let [low, high] = scene.bounds();
        let height = |y: f32| (y - low.y) / (high.y - low.y);
        let marks = scene.positions.iter().map(|p| heights.contains(&height(p.y))).collect();
        let area = Area::Runs(Selection::from_marks(marks).runs());
        self.done(Command::Select { area, combine: Default::default(), visible: false, goes_on: false })
    }

    fn region(&mut self, step: usize, role: Role, heights: std::ops::Range<f32>) -> Result<()> {
        self.select(heights)?;
        self.done(Command::MakeRegion { step, role, falloff: 0.0, replaces: None })
    }

    /// Drags, and waits for each picture, which draws so many samples.
    fn drag(&mut self, case: &Case, frames: u32, drawn: u32) -> Result<Dragged> {
        let (mut took, mut processor) = (Vec::new(), Vec::new());
        // The first one prepares.
        for frame in 0..=frames {
            let t = f64::from(frame + 1) / f64::from(frames + 1);
            let change = match case.steps[case.dragged] {
                Param(_, id) => Change::SetParam { id: id.to_owned(), value: Some((90.0 * t).into()) },
                Own(_, id) => Change::MoveHandle {
                    id: id.to_owned(),
                    motion: Motion { translate: DVec3::X * (0.1 * t), ..Motion::default() },
                },
                _ => Change::MoveRegion {
                    region: 1,
                    motion: Motion {
                        translate: DVec3::X * (0.3 * t),
                        degrees: 30.0 * t,
                        ..Motion::default()
                    },
                },
            };
            let (start, before) = (Instant::now(), own_cpu());
            self.shown(Command::Drag(edit::EditCommand::Change { at: case.dragged, change }))?;
            self.shaded(drawn);
            if frame > 0 {
                took.push(start.elapsed().as_secs_f64());
                processor.push(own_cpu() - before);
            }
        }
        let start = Instant::now();
        self.done(Command::Rest)?;
        Ok(Dragged { took, processor, rest: start.elapsed().as_secs_f64() })
    }

    /// Has found how the surface lies at so many samples, spread over it.
    fn shaded(&mut self, drawn: u32) {
        let Some(scene) = self.state.scene() else { return };
        let all = scene.len() as u32;
        let drawn = drawn.min(all);
        if self.drawn.len() != drawn as usize {
            let spread = |k: u32| (u64::from(k) * u64::from(all) / u64::from(drawn)) as u32;
            self.drawn = (0..drawn).map(spread).collect();
        }
        std::hint::black_box(scene.shading_of(&self.drawn, &mut self.rings));
    }

    /// Does a command, and waits for other samples than before.
    fn shown(&mut self, command: Command) -> Result<()> {
        let revision = |state: &State| state.scene().map(|scene| scene.revision);
        let before = revision(&self.state);
        self.state.apply(command)?;
        while revision(&self.state) == before {
            if !self.state.poll() {
                std::thread::sleep(Duration::from_micros(100));
            }
            if let Some(simod_viewer::state::Notice::Failed(_, error)) =
                self.state.take_notices().into_iter().next()
            {
                return Err(error.into());
            }
        }
        Ok(())
    }
}
