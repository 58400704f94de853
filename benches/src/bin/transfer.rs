//! True error of the reconstruction: exact maps of space applied to the samples alone, and the result
//! compared with the map of every vertex.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use simod_benches::{Map, error_figure, head, row};
use simod_core::reconstruction::{Method, Reconstruction, Version, reconstruct, transfer_error};
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;
use simod_model::{Error, Result};

/// Measure the transfer error of exact deformations, as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Vertices of the generated model
    #[arg(long, default_value_t = 2_000_000, value_name = "N")]
    vertices: u64,
    /// Number of samples
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    samples: u64,
    /// Measure on this model instead of a generated one
    #[arg(long, value_name = "FILE", conflicts_with = "vertices")]
    model: Option<PathBuf>,
    /// Folder for temporary files
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
}

fn main() -> ExitCode {
    match measure(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}\nhint: {}", error.hint());
            ExitCode::FAILURE
        }
    }
}

fn measure(arguments: &Arguments) -> Result<()> {
    let folder =
        tempfile::tempdir_in(&arguments.folder).map_err(|e| Error::io("write to", &arguments.folder, &e))?;
    let (generated, deformed) = (folder.path().join("model.ply"), folder.path().join("deformed.ply"));
    if arguments.model.is_none() {
        let options = ModelOptions { vertices: arguments.vertices, ..ModelOptions::default() };
        write_file(&options, &generated, &Silent)?;
    }
    let model = simod_model::open(arguments.model.as_deref().unwrap_or(&generated))?;

    let start = Instant::now();
    let sampling = Sampling { target: Target::Samples(arguments.samples), ..Sampling::default() };
    let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent)?;
    println!(
        "{} vertices, {} samples in {:.2} s; errors as fractions of the diagonal\n",
        model.info().vertices,
        sampled.samples.len(),
        start.elapsed().as_secs_f64()
    );
    println!("{}", head(&["method", "map", "rms", "99.9 % below", "worst", "jump", "reconstruction, s"]));
    let bounds = sampled.bounds;
    let methods =
        [("projected-barycentric", Method::ProjectedBarycentric), ("blended-jets", Method::BlendedJets)];
    for ((name, method), map) in methods.into_iter().flat_map(|m| Map::ALL.map(|map| (m, map))) {
        let samples = map.deform(&sampled);
        let start = Instant::now();
        let version = Version { deformed: &samples, output: &deformed, diagnostics: None };
        let how = Reconstruction { method, ..Reconstruction::default() };
        reconstruct(&sampled, model.as_ref(), &[version], &how, &Silent)?;
        let seconds = start.elapsed().as_secs_f64();

        let result = simod_model::open(&deformed)?;
        let truth = |points: &mut [glam::DVec3]| {
            points.iter_mut().for_each(|p| *p = map.apply(&bounds, *p));
            Ok(())
        };
        let error = transfer_error::measure(
            model.as_ref(),
            result.as_ref(),
            (bounds.diagonal(), None),
            &truth,
            &Silent,
        )?;
        let figures = [error.rms, error.p999, error.max, error.jump].map(error_figure);
        println!(
            "{}",
            row([name.to_owned(), map.name().to_owned()]
                .into_iter()
                .chain(figures)
                .chain([format!("{seconds:.2}")]))
        );
    }
    Ok(())
}
