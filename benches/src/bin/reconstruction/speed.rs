//! The time and memory of `simod reconstruct` as models grow, beside a copy of the same file.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use glam::DVec3;
use simod_benches::peers::{Peer, carry};
use simod_benches::process::{self, Result, copy, number, own_cpu};
use simod_benches::{Map, head, median, row};
use simod_core::sampled_model::SampledModel;
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;
use simod_model::{CHUNK_VERTICES, Model, VertexChunk};

use crate::Arguments;

const COLUMNS: [&str; 11] = [
    "vertices",
    "file, MB",
    "samples",
    "wall, s",
    "copy, s",
    "wall / copy",
    "CPU, s",
    "CPU, ns/vertex",
    "vertices per CPU second",
    "of inverse distances'",
    "peak, MB",
];

/// Runs of consecutive vertices for which inverse distances are measured, spread over the model.
const RUNS: u64 = 16;

/// Figures of one round: seconds by the clock, of the processor and of a copy; peak of memory.
struct Round {
    wall: f64,
    cpu: f64,
    copy: f64,
    peak: f64,
    /// Processor seconds per vertex by inverse distances.
    inverse_distance: f64,
}

/// Measures, and prints a table.
pub fn measure(arguments: &Arguments) -> Result<()> {
    let simod = process::simod(arguments.simod.as_deref())?;
    println!("{}", head(&COLUMNS));
    for millions in &arguments.millions {
        // One model at a time: the folder is deleted with all that is in it.
        let folder = tempfile::tempdir_in(&arguments.folder)?;
        let subject = Subject::make(&simod, (millions * 1e6) as u64, arguments.samples, folder.path())?;
        let rounds = (0..arguments.runs).map(|_| subject.round(&simod)).collect::<Result<Vec<_>>>()?;
        let middle = |figure: &dyn Fn(&Round) -> f64| median(rounds.iter().map(figure).collect());
        let vertices = subject.vertices as f64;
        let cpu = middle(&|r| r.cpu);
        println!(
            "{}",
            row([
                subject.vertices.to_string(),
                format!("{:.0}", fs::metadata(&subject.model)?.len() as f64 / 1e6),
                subject.sampled.samples.len().to_string(),
                format!("{:.2}", middle(&|r| r.wall)),
                format!("{:.2}", middle(&|r| r.copy)),
                // Of the same round: what disturbs one disturbs the other.
                format!("{:.1}", middle(&|r| r.wall / r.copy)),
                format!("{cpu:.2}"),
                format!("{:.0}", cpu * 1e9 / vertices),
                format!("{:.0}", vertices / cpu),
                format!("{:.2}", middle(&|r| r.inverse_distance * vertices / r.cpu)),
                format!("{:.0}", middle(&|r| r.peak) / 1e6),
            ])
        );
    }
    Ok(())
}

/// A model with positions and normals, its samples, and these after a twist.
struct Subject {
    vertices: u64,
    model: PathBuf,
    folder: PathBuf,
    sampled: SampledModel,
}

impl Subject {
    fn make(simod: &Path, vertices: u64, samples: u64, folder: &Path) -> Result<Self> {
        let model = folder.join("model.ply");
        let options = ModelOptions { vertices, colors: false, faces: false, ..ModelOptions::default() };
        let vertices = write_file(&options, &model, &Silent)?.vertices;
        let samples_folder = folder.join("samples.simod");
        let mut command = Command::new(simod);
        command.arg("sample").arg(&model).arg("-o").arg(&samples_folder);
        process::run(command.arg("--samples").arg(samples.to_string()), None)?;

        let sampled = SampledModel::load(&samples_folder)?;
        let deformed = Map::Twist.deform(&sampled);
        sampled.write_deformed(&folder.join("deformed.ply"), &deformed, sampled.samples.normals())?;
        // Into the system's cache, for all that follow alike.
        io::copy(&mut File::open(&model)?, &mut io::sink())?;
        Ok(Self { vertices, model, folder: folder.to_owned(), sampled })
    }

    /// Reconstructs once, copies once, and takes inverse distances once.
    fn round(&self, simod: &Path) -> Result<Round> {
        let output = self.folder.join("output.ply");
        let mut command = Command::new(simod);
        command.arg("reconstruct").arg(self.folder.join("samples.simod")).arg("-o").arg(&output);
        // The program syncs its output.
        let ran = process::run(
            command.arg("--deformed").arg(self.folder.join("deformed.ply")).arg("--json"),
            None,
        )?;
        fs::remove_file(&output)?;
        let copy = copy(&self.model, &output)?;
        fs::remove_file(&output)?;
        Ok(Round {
            wall: ran.wall,
            cpu: ran.cpu,
            copy,
            // Known on Linux alone.
            peak: number(&ran.json()?, "peak_memory_bytes").unwrap_or(f64::NAN),
            inverse_distance: self.inverse_distance()?,
        })
    }

    /// Processor seconds per vertex by inverse distances, in memory; preparation is not counted.
    fn inverse_distance(&self) -> Result<f64> {
        let positions = some_positions(simod_model::open(&self.model)?.as_ref())?;
        let field = Peer::InverseDistance.prepare(&self.sampled, &Map::Twist.deform(&self.sampled).local);
        let start = own_cpu();
        carry(field.as_ref(), &self.sampled.frame, &positions);
        Ok((own_cpu() - start) / positions.len() as f64)
    }
}

/// Runs of consecutive vertices, spread over the model.
fn some_positions(model: &dyn Model) -> Result<Vec<DVec3>> {
    let vertices = model.info().vertices;
    let (mut positions, mut chunk) = (Vec::new(), VertexChunk::default());
    for run in 0..RUNS {
        let (first, next) = (vertices * run / RUNS, vertices * (run + 1) / RUNS);
        model.vertices(first..next.min(first + CHUNK_VERTICES as u64))?.read(&mut chunk)?;
        positions.extend_from_slice(&chunk.positions);
    }
    Ok(positions)
}
