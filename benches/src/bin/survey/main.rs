//! The four cases of M. Botsch, O. Sorkine, *On Linear Variational Surface Deformation Methods*, IEEE TVCG
//! 2008: a bumpy plane lifted, a cylinder bent, a bar twisted and a cactus bent, by each of our tools, as
//! tables and pictures.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the tables that it prints"
)]

mod cases;
mod figures;
mod others;
mod pictures;
mod sessions;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use cases::{CASES, Case, METHODS};
use clap::Parser;
use figures::Subject;
use pictures::Gallery;
use simod_benches::process::{self, Result, exit};
use simod_benches::{head, row};
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;

/// Deform the shapes of the deformation survey by each tool: figures as Markdown tables, and pictures
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Cases to measure, instead of all, or tools without handles of which to draw pictures
    #[arg(long, value_delimiter = ',', value_name = "CASE,...")]
    only: Vec<String>,
    /// Vertices of the generated models
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    vertices: u64,
    /// Rounds; the times are their medians
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Draw the results into this folder
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Folder with the cases' sessions
    #[arg(long, value_name = "DIR", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/survey"))]
    #[arg(hide_default_value = true)]
    sessions: PathBuf,
    /// Program to measure [default: the one beside this program]
    #[arg(long, value_name = "PATH")]
    simod: Option<PathBuf>,
    /// Folder for temporary files
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
}

fn main() -> ExitCode {
    exit(measure(&Arguments::parse()))
}

fn measure(arguments: &Arguments) -> Result<()> {
    let simod = process::simod(arguments.simod.as_deref())?;
    for case in &CASES {
        if arguments.only.is_empty() || arguments.only.iter().any(|only| only == case.name) {
            let folder = tempfile::tempdir_in(&arguments.folder)?;
            measure_case(case, arguments, &simod, folder.path())?;
        }
    }
    if let Some(pictures) = &arguments.pictures {
        let Arguments { vertices, only, sessions, folder, .. } = arguments;
        others::draw(&simod, (*vertices, only), sessions, folder, pictures)?;
    }
    Ok(())
}

fn measure_case(case: &Case, arguments: &Arguments, simod: &Path, folder: &Path) -> Result<()> {
    let model = folder.join(format!("{}.ply", case.name));
    let options = ModelOptions { shape: case.shape, vertices: arguments.vertices, ..ModelOptions::default() };
    write_file(&options, &model, &Silent)?;
    sessions::copy(&arguments.sessions, folder)?;
    let subject = Subject::new(case, options.vertices)?;
    let mut gallery = Gallery::new(case, &folder.join(format!("{}.toml", case.name)))?;
    gallery.add("at rest", &model)?;

    println!("### {}\n", case.title);
    let titles =
        ["tool", "volume", "edges", "99 %", "areas", "details", "folded", "prepare, ms", "deform, ms"];
    println!("{}", head(&titles));
    let mut samples = 0.0;
    for method in &METHODS {
        let Some(session) = sessions::find(folder, case, method)? else {
            println!("{}", row([method.name].into_iter().chain(std::iter::repeat_n("—", titles.len() - 1))));
            continue;
        };
        let output = folder.join(format!("{}.edited.ply", method.key));
        let figures = figures::measure(&subject, simod, &session, &output, arguments.runs)?;
        samples = figures.samples;
        println!("{}", row([method.name.to_owned()].into_iter().chain(figures.cells())));
        gallery.add(method.name, &output)?;
    }
    println!("\n{} vertices, {samples} samples.\n", subject.vertices());
    if let Some(pictures) = &arguments.pictures {
        gallery.write(&pictures.join(format!("methods-{}.png", case.name)))?;
    }
    Ok(())
}
