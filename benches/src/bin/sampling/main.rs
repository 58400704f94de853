//! Quality and speed of the sampling: the distances of all vertices of a model like a scan from P_S, beside
//! other ways to thin a model out; and the time and memory of `simod sample` beside a copy of the same
//! file.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

mod peer;
mod quality;
mod speed;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use simod_benches::process::{self, Result, exit};

/// Measure the quality and the speed of sampling, as Markdown tables
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Section to measure, instead of both
    #[arg(long, value_enum, value_name = "PART")]
    only: Option<Part>,
    /// Quality: refine the triangles of this OBJ file, instead of a coarse amphora
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Quality: vertices of the refined model, in millions
    #[arg(long, default_value_t = 2.15, value_name = "M")]
    millions: f64,
    /// Quality: r.m.s. height of the relief on it, as a fraction of the diagonal
    #[arg(long, default_value_t = 2e-4, value_name = "H")]
    relief: f64,
    /// Quality: keep the refined model, as this PLY file
    #[arg(long, value_name = "FILE")]
    keep: Option<PathBuf>,
    /// Speed: vertices of the generated models, in millions
    #[arg(long, value_delimiter = ',', default_value = "2,8,32", value_name = "M,...")]
    growth: Vec<f64>,
    /// Number of samples
    #[arg(long, default_value_t = 200_000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Runs of each program; the tables have the medians of their times
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Program to measure [default: the one beside this program]
    #[arg(long, value_name = "PATH")]
    simod: Option<PathBuf>,
    /// Folder for temporary files, on the disk to be measured, with room for the largest model twice
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
    #[command(subcommand)]
    command: Option<Hidden>,
}

/// Part of the figures that is measured.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    Quality,
    Speed,
}

/// Commands for which this program calls itself.
#[derive(Subcommand)]
enum Hidden {
    /// Be one of the programs to compare with
    #[command(hide = true)]
    Peer(peer::Job),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let done = match &arguments.command {
        Some(Hidden::Peer(job)) => job.execute(),
        None => measure(&arguments),
    };
    exit(done)
}

fn measure(arguments: &Arguments) -> Result<()> {
    let simod = process::simod(arguments.simod.as_deref())?;
    if arguments.only != Some(Part::Speed) {
        quality::measure(arguments, &simod)?;
    }
    if arguments.only.is_none() {
        println!();
    }
    if arguments.only != Some(Part::Quality) {
        speed::measure(arguments, &simod)?;
    }
    Ok(())
}

/// A figure of a table; "-" where it is not known.
fn figure(value: f64, digits: usize) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{value:.digits$}") }
}
