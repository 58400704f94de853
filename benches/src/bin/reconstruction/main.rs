//! Errors and speed of the reconstruction, beside other ways to carry the deformation of P_S over to P_L.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the tables that it prints"
)]

mod accuracy;
mod details;
mod exactness;
mod method;
mod pictures;
mod scene;
mod speed;
mod steps;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use simod_benches::process::{Result, exit};

/// Measure the transfer of deformations to all vertices, beside other methods, as Markdown tables
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Sections to measure, instead of all
    #[arg(long, value_enum, value_delimiter = ',', value_name = "SECTION,...")]
    only: Vec<Section>,
    /// Measure on this model instead of a generated amphora; details measures it beside a generated one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Accuracy: vertices of the generated model
    #[arg(long, default_value_t = 2_150_000, value_name = "N")]
    vertices: u64,
    /// Accuracy and speed: number of samples
    #[arg(long, default_value_t = 200_000, value_name = "N")]
    samples: u64,
    /// The other sections: vertices of the generated models
    #[arg(long, default_value_t = 500_000, value_name = "N")]
    small_vertices: u64,
    /// The other sections: number of samples
    #[arg(long, default_value_t = 50_000, value_name = "N")]
    small_samples: u64,
    /// Details: draw the models into this folder
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Speed: vertices of the generated models, in millions
    #[arg(long, value_delimiter = ',', default_value = "2,32", value_name = "M,...")]
    millions: Vec<f64>,
    /// Speed: rounds; the table has their medians
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Speed: the program to measure [default: the one beside this program]
    #[arg(long, value_name = "PATH")]
    simod: Option<PathBuf>,
    /// Folder for temporary files; for speed on the disk to be measured, with room for the largest model
    /// twice
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
}

/// Section of the figures that is measured.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Section {
    /// The error of smooth maps, and processor time
    Accuracy,
    /// Maps that change within a few samples
    Steps,
    /// Maps that come out without an error
    Exactness,
    /// Edges and angles of the model
    Details,
    /// The real program, beside a copy of the file
    Speed,
}

fn main() -> ExitCode {
    exit(measure(&Arguments::parse()))
}

fn measure(arguments: &Arguments) -> Result<()> {
    for section in Section::value_variants() {
        if !arguments.only.is_empty() && !arguments.only.contains(section) {
            continue;
        }
        match section {
            Section::Accuracy => accuracy::measure(arguments)?,
            Section::Steps => steps::measure(arguments)?,
            Section::Exactness => exactness::measure(arguments)?,
            Section::Details => details::measure(arguments)?,
            Section::Speed => speed::measure(arguments)?,
        }
        println!();
    }
    Ok(())
}
