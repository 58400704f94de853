//! The time and memory of `simod sample` as models grow, beside a copy of the same file.

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::process::Command;

use simod_benches::process::{self, Result, copy, number};
use simod_benches::{head, median, row};
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;

use crate::{Arguments, figure};

const COLUMNS: [&str; 10] = [
    "vertices",
    "normals",
    "file, MB",
    "samples",
    "wall, s",
    "CPU, s",
    "CPU, ns/vertex",
    "peak, MB",
    "copy, s",
    "wall / copy",
];

/// Figures of one run: seconds by the clock, of the processor and of a copy; peak of memory; samples.
struct Round {
    wall: f64,
    cpu: f64,
    peak: f64,
    copy: f64,
    samples: f64,
}

/// Measures, and prints a table.
pub fn measure(arguments: &Arguments, simod: &Path) -> Result<()> {
    println!("{}", head(&COLUMNS));
    for millions in &arguments.growth {
        for normals in [true, false] {
            // One model at a time: the folder is deleted with all that is in it.
            let folder = tempfile::tempdir_in(&arguments.folder)?;
            let model = folder.path().join("model.ply");
            let vertices = (millions * 1e6) as u64;
            let options =
                ModelOptions { vertices, normals, colors: false, faces: false, ..ModelOptions::default() };
            let info = write_file(&options, &model, &Silent)?;
            // Into the system's cache, for all that follow alike.
            io::copy(&mut File::open(&model)?, &mut io::sink())?;

            let rounds = (0..arguments.runs)
                .map(|_| round(simod, &model, folder.path(), arguments.samples))
                .collect::<Result<Vec<_>>>()?;
            let middle = |figure: fn(&Round) -> f64| median(rounds.iter().map(figure).collect());
            let cpu = middle(|r| r.cpu);
            println!(
                "{}",
                row([
                    info.vertices.to_string(),
                    if normals { "yes" } else { "no" }.to_owned(),
                    figure(info.bytes as f64 / 1e6, 0),
                    figure(middle(|r| r.samples), 0),
                    figure(middle(|r| r.wall), 2),
                    figure(cpu, 2),
                    figure(cpu * 1e9 / info.vertices as f64, 0),
                    figure(middle(|r| r.peak) / 1e6, 0),
                    figure(middle(|r| r.copy), 2),
                    // Of the same round: what disturbs one disturbs the other.
                    figure(middle(|r| r.wall / r.copy), 1),
                ])
            );
        }
    }
    Ok(())
}

/// Samples once, and copies once.
fn round(simod: &Path, model: &Path, folder: &Path, samples: u32) -> Result<Round> {
    let mut command = Command::new(simod);
    command.arg("sample").arg(model).arg("-o").arg(folder.join("samples.simod"));
    command.arg("--samples").arg(samples.to_string()).arg("--json");
    let ran = process::run(&mut command, None)?;
    let report = ran.json()?;

    let copied = folder.join("copy.ply");
    let copy = copy(model, &copied)?;
    fs::remove_file(&copied)?;
    Ok(Round {
        wall: ran.wall,
        cpu: ran.cpu,
        // Known on Linux alone.
        peak: number(&report, "peak_memory_bytes").unwrap_or(f64::NAN),
        copy,
        samples: number(&report, "samples")?,
    })
}
