//! The paper's Table 1 (§7): the time of each step as models grow, beside a copy of the same file.
//!
//! The real `simod` runs, a process for each step, and is asked for its own clock and memory (`--json`).
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use clap::Parser;
use simod_benches::process::{self, Result, copy, exit, number, phase, report};
use simod_benches::{Map, head, median, row};
use simod_core::sampled_model::SampledModel;
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;

/// Measure time and memory on models of growing size, as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Vertices of the generated models, in millions
    #[arg(long, value_delimiter = ',', default_value = "0.4,2,8,32", value_name = "M,...")]
    millions: Vec<f64>,
    /// Number of samples
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    samples: u64,
    /// Runs of each step; the table has their medians
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Program to measure [default: the one beside this program]
    #[arg(long, value_name = "PATH")]
    simod: Option<PathBuf>,
    /// Folder for temporary files, on the disk to be measured, with room for the largest model twice
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
}

const COLUMNS: [&str; 13] = [
    "vertices",
    "normals",
    "file, MB",
    "samples",
    "first pass, s",
    "second pass, s",
    "post-process, s",
    "sampling, M vertices/s",
    "post-process, M vertices/s",
    "sampling, peak MB",
    "post-process, peak MB",
    "copy, s",
    "post-process / copy",
];

/// Figures of one round of all steps: seconds, and peaks of memory.
#[derive(Default)]
struct Round {
    first_pass: f64,
    second_pass: f64,
    post_process: f64,
    sampling: f64,
    copy: f64,
    sampling_memory: f64,
    post_process_memory: f64,
}

fn main() -> ExitCode {
    exit(measure(&Arguments::parse()))
}

fn measure(arguments: &Arguments) -> Result<()> {
    let simod = process::simod(arguments.simod.as_deref())?;
    println!("{}", head(&COLUMNS));
    for millions in &arguments.millions {
        for normals in [true, false] {
            // One model at a time: the folder is deleted with all that is in it.
            let folder = tempfile::tempdir_in(&arguments.folder)?;
            let model = folder.path().join("model.ply");
            let vertices = (millions * 1e6) as u64;
            let options = ModelOptions { vertices, normals, ..ModelOptions::default() };
            let info = write_file(&options, &model, &Silent)?;

            let rounds = (0..arguments.runs)
                .map(|_| round(&simod, &model, folder.path(), arguments.samples))
                .collect::<Result<Vec<_>>>()?;
            let middle = |figure: fn(&Round) -> f64| median(rounds.iter().map(figure).collect());
            let samples = SampledModel::load(&folder.path().join("samples.simod"))?.samples.len();
            let rate = |seconds: f64| format!("{:.2}", info.vertices as f64 / seconds / 1e6);
            let megabytes = |bytes: f64| format!("{:.0}", bytes / 1e6);
            println!(
                "{}",
                row([
                    info.vertices.to_string(),
                    if normals { "yes" } else { "no" }.to_owned(),
                    megabytes(info.bytes as f64),
                    samples.to_string(),
                    format!("{:.2}", middle(|r| r.first_pass)),
                    format!("{:.2}", middle(|r| r.second_pass)),
                    format!("{:.2}", middle(|r| r.post_process)),
                    rate(middle(|r| r.sampling)),
                    rate(middle(|r| r.post_process)),
                    megabytes(middle(|r| r.sampling_memory)),
                    megabytes(middle(|r| r.post_process_memory)),
                    format!("{:.2}", middle(|r| r.copy)),
                    // Of the same round: what disturbs one disturbs the other.
                    format!("{:.1}", middle(|r| r.post_process / r.copy)),
                ])
            );
        }
    }
    Ok(())
}

/// Does all steps once.
fn round(simod: &Path, model: &Path, folder: &Path, samples: u64) -> Result<Round> {
    let sampled = folder.join("samples.simod");
    let (deformed, output) = (folder.join("deformed.ply"), folder.join("output.ply"));

    let mut command = Command::new(simod);
    command.arg("sample").arg(model).arg("--samples").arg(samples.to_string()).arg("-o").arg(&sampled);
    let sampling = report(&mut command)?;

    // The deformation itself, whatever it may cost, is not what is measured here.
    let loaded = SampledModel::load(&sampled)?;
    loaded.write_deformed(&deformed, &Map::Twist.deform(&loaded), loaded.samples.normals())?;

    let mut command = Command::new(simod);
    command.arg("reconstruct").arg(&sampled).arg("--deformed").arg(&deformed).arg("-o").arg(&output);
    let post_process = report(&mut command)?;
    fs::remove_file(&output)?;

    let copy = copy(model, &output)?;
    fs::remove_file(&output)?;
    Ok(Round {
        first_pass: phase(&sampling, "counting")?,
        second_pass: phase(&sampling, "clustering")? + phase(&sampling, "completing the samples")?,
        post_process: number(&post_process, "seconds")?,
        sampling: number(&sampling, "seconds")?,
        copy,
        // Known on Linux alone.
        sampling_memory: number(&sampling, "peak_memory_bytes").unwrap_or(f64::NAN),
        post_process_memory: number(&post_process, "peak_memory_bytes").unwrap_or(f64::NAN),
    })
}
