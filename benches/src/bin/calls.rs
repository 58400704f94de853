//! Costs of calling a plugin: across the boundary in this process, and in a process of its own.
//!
//! The plugin is the one that the tests have misbehave, told to behave: it shifts all samples, which is as
//! little as a plugin can do.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Parser;
use simod_benches::process::{Result, exit};
use simod_benches::{head, median, row};
use simod_plugin_api::{Bounds, DeformInput, Param, ParamKind, PrepareInput, Samples};
use simod_session::plugins::PluginFolder;
use simod_session::worker::WorkerOptions;
use simod_session::{Code, Isolation, Plugin, PluginOptions, PluginRegistry};

/// Measure the calls of a plugin, as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Numbers of samples
    #[arg(long, value_delimiter = ',', default_value = "1,1000,20000,350000", value_name = "N,...")]
    samples: Vec<usize>,
    /// Calls of each sort; the table has their medians
    #[arg(long, default_value_t = 51, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Folder of the program and the plugin [default: that of this program]
    #[arg(long, value_name = "DIR")]
    built: Option<PathBuf>,
}

const COLUMNS: [&str; 6] = [
    "samples",
    "call, µs",
    "prepare here, ms",
    "deform here, ms",
    "prepare in a process, ms",
    "deform in a process, ms",
];

fn main() -> ExitCode {
    exit(run(&Arguments::parse()))
}

fn run(arguments: &Arguments) -> Result<()> {
    let here = std::env::current_exe()?;
    let built = arguments.built.clone().unwrap_or_else(|| here.parent().unwrap_or(Path::new("")).to_owned());
    let folder = tempfile::tempdir()?;
    let name = format!("{DLL_PREFIX}misbehaving{DLL_SUFFIX}");
    std::fs::copy(built.join(&name), folder.path().join(&name))?;
    let (inside, outside) =
        (plugin(folder.path(), &built, Isolation::Never)?, plugin(folder.path(), &built, Isolation::Always)?);
    println!("{}", head(&COLUMNS));
    for &count in &arguments.samples {
        let positions: Vec<[f32; 3]> = (0..count).map(|i| [i as f32 / count as f32, 0.5, 0.25]).collect();
        let measure = |plugin: &Plugin, how: &str| measure(plugin.code(), &positions, how, arguments.runs);
        let [_, call] = measure(&inside, "error-in-deform")?;
        let [prepare, deform] = measure(&inside, "well")?;
        let [prepare_outside, deform_outside] = measure(&outside, "well")?;
        let ms = |time: Duration| format!("{:.3}", time.as_secs_f64() * 1e3);
        let call = format!("{:.2}", call.as_secs_f64() * 1e6);
        let cells = [ms(prepare), ms(deform), ms(prepare_outside), ms(deform_outside)];
        println!("{}", row([count.to_string(), call].into_iter().chain(cells)));
    }
    println!(
        "\n*Call* is a deformation that is refused at once: what crossing the boundary costs, with the error's text."
    );
    Ok(())
}

/// The plugin, here or in a process of its own.
fn plugin(folder: &Path, built: &Path, isolation: Isolation) -> Result<Arc<Plugin>> {
    let folder = PluginFolder { path: folder.to_owned(), by_name: false, shipped: false };
    let command = vec![built.join("simod"), "plugin".into(), "serve".into()];
    let worker = WorkerOptions { command, silence: Duration::from_secs(60), memory: 4 << 30 };
    let options =
        PluginOptions { isolation, worker: Arc::new(worker), ..PluginOptions::in_process(vec![folder]) };
    Ok(PluginRegistry::discover(&options).get("misbehaving")?.clone())
}

/// Medians of the times of `prepare` and `deform`.
fn measure(code: &dyn Code, positions: &[[f32; 3]], how: &str, runs: u32) -> Result<[Duration; 2]> {
    let by = [1.0];
    let params = [Param::text("how", ParamKind::CHOICE, how), Param::numbers("by", ParamKind::FLOAT, &by)];
    let samples = Samples::new(positions, &[], &[]);
    let bounds = Bounds { min: [0.0; 3], max: [1.0; 3] };
    let prepare = PrepareInput::new(samples, bounds, &[], &params);
    let deform = DeformInput::new(samples, bounds, &[], &params);
    let mut out = vec![[0.0; 3]; positions.len()];
    let mut times = [Vec::new(), Vec::new()];
    let mut scratch = code.new_scratch()?;
    for _ in 0..runs {
        let started = Instant::now();
        let state = code.prepare(&prepare, &())?;
        times[0].push(started.elapsed().as_secs_f64());
        let started = Instant::now();
        let done = code.deform(&state, &deform, &mut scratch, &mut out, &());
        times[1].push(started.elapsed().as_secs_f64());
        if how == "well" {
            done?;
            assert!(out.iter().zip(positions).all(|(o, p)| o[0] == p[0] + 1.0), "it shifts by 1");
        }
    }
    Ok(times.map(|times| Duration::from_secs_f64(median(times))))
}
