//! Costs of each method: preparation, and a frame of a drag, through the plugins' own calls on a generated
//! model.
//!
//! Each row is a process of its own, whose memory is looked at meanwhile.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

mod edits;
mod scene;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use clap::Parser;
use edits::{EDITS, Edit};
use scene::Scene;
use serde_json::json;
use simod_benches::process::{self, Result, exit};
use simod_benches::{head, row};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;
use simod_session::plugins::PluginFolder;
use simod_session::{PluginOptions, PluginRegistry};

/// Measure preparation and drags of all plugins, as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Numbers of samples
    #[arg(long, value_delimiter = ',', default_value = "20000,200000,350000", value_name = "N,...")]
    samples: Vec<u64>,
    /// Frames of each drag; the table has their median
    #[arg(long, default_value_t = 31, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Preparations; the table has their median
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Beginning of the names of the rows to measure
    #[arg(long, default_value = "", value_name = "TEXT")]
    only: String,
    /// Number of threads [default: all cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder for temporary files
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
    /// Row to measure on the samples in `folder`
    #[arg(long, hide = true)]
    row: Option<usize>,
}

const COLUMNS: [&str; 8] = [
    "method",
    "samples",
    "prepare, s",
    "CPU, s",
    "longest silence, ms",
    "frame, ms",
    "CPU, ms",
    "peak memory, MB",
];

/// So often a child's memory is looked at.
const POLL: Duration = Duration::from_millis(5);

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    exit(match arguments.row {
        Some(i) => measure(&arguments, EDITS.get(i)),
        None => table(&arguments),
    })
}

fn table(arguments: &Arguments) -> Result<()> {
    println!("{}", head(&COLUMNS));
    for &samples in &arguments.samples {
        let folder = tempfile::tempdir_in(&arguments.folder)?;
        let count = sampled(folder.path(), samples)?;
        // The first row, beyond all edits, has the samples alone.
        let edits = EDITS.iter().enumerate().filter(|(_, e)| e.name.starts_with(&arguments.only));
        let rows = std::iter::once((EDITS.len(), "no plugin")).chain(edits.map(|(i, e)| (i, e.name)));
        for (i, name) in rows {
            let mut command = Command::new(std::env::current_exe()?);
            command.arg("--folder").arg(folder.path()).args(["--row", &i.to_string()]);
            command.args(["--frames", &arguments.frames.to_string(), "--runs", &arguments.runs.to_string()]);
            if let Some(threads) = arguments.threads {
                command.args(["--threads", &threads.to_string()]);
            }
            let ran = process::run(&mut command, Some(POLL))?;
            let figures = ran.json()?;
            let figure = |name: &str, factor: f64, digits: usize| {
                figures[name].as_f64().map_or("-".to_owned(), |x| format!("{:.digits$}", factor * x))
            };
            println!(
                "{}",
                row([
                    name.to_owned(),
                    count.to_string(),
                    figure("prepare", 1.0, 3),
                    figure("prepare-cpu", 1.0, 3),
                    figure("silence", 1e3, 0),
                    figure("frame", 1e3, 1),
                    figure("frame-cpu", 1e3, 1),
                    format!("{:.0}", ran.peak() / 1e6),
                ])
            );
        }
    }
    Ok(())
}

/// Generates a model, samples it, and saves the samples; how many there are.
fn sampled(folder: &Path, samples: u64) -> Result<usize> {
    let path = folder.join("model.ply");
    write_file(&ModelOptions { vertices: 5 * samples, ..ModelOptions::default() }, &path, &Silent)?;
    let sampling = Sampling { target: Target::Samples(samples), ..Sampling::default() };
    let sampled = sample(simod_model::open(&path)?.as_ref(), &sampling, folder, &Silent)?;
    sampled.save(&folder.join("samples"))?;
    Ok(sampled.samples.len())
}

/// Prints the figures of one edit.
fn measure(arguments: &Arguments, edit: Option<&Edit>) -> Result<()> {
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    let sampled = SampledModel::load(&arguments.folder.join("samples"))?;
    let scene = Scene::new(&sampled);
    let Some(edit) = edit else {
        println!("{{}}");
        return Ok(());
    };
    let here = std::env::current_exe()?;
    let path = here.parent().unwrap_or(Path::new("")).to_owned();
    let folder = PluginFolder { path, by_name: true, shipped: true };
    let registry = PluginRegistry::discover(&PluginOptions::in_process(vec![folder]));
    let figures = scene.measure(registry.get(edit.plugin)?, edit, arguments.runs, arguments.frames)?;
    let figures = json!({
        "prepare": figures.prepare,
        "prepare-cpu": figures.prepare_cpu,
        "silence": figures.silence,
        "frame": figures.frame,
        "frame-cpu": figures.frame_cpu,
    });
    println!("{figures}");
    Ok(())
}
