//! Quality of the expected transfer error: exact maps of space applied to the samples alone, and at every
//! vertex the error that is expected beside the true one.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use glam::DVec3;
use simod_benches::{Map, error_figure, head, row};
use simod_core::reconstruction::{ExpectedError, Reconstruction, Version, reconstruct};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::{ModelOptions, Shape, write_file};
use simod_model::progress::Silent;
use simod_model::{Error, Result, in_step};

/// Thresholds t, as fractions of the diagonal: of the vertices that are off by more than three times t, how
/// many are expected to be off by more than t?
const THRESHOLDS: [f64; 9] = [1e-7, 3e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3];

/// Fewer vertices beyond a threshold tell no share.
const FEWEST: u64 = 100;

/// Measure how well the expected error predicts the true one, as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Vertices of the generated models
    #[arg(long, default_value_t = 500_000, value_name = "N")]
    vertices: u64,
    /// Numbers of samples
    #[arg(long, value_delimiter = ',', default_values_t = [5_000, 50_000], value_name = "N,...")]
    samples: Vec<u64>,
    /// Measure on these models, instead of generated ones
    #[arg(long, num_args = 1.., value_name = "FILE", conflicts_with = "vertices")]
    model: Vec<PathBuf>,
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
    let mut models: Vec<(String, PathBuf)> = Vec::new();
    let generated =
        [("amphora", Shape::Amphora), ("bumpy sphere", Shape::BumpySphere), ("plane", Shape::Plane)];
    for (name, shape) in generated.into_iter().filter(|_| arguments.model.is_empty()) {
        let path = folder.path().join(format!("{name}.ply"));
        let options = ModelOptions { shape, vertices: arguments.vertices, ..ModelOptions::default() };
        write_file(&options, &path, &Silent)?;
        models.push((name.to_owned(), path));
    }
    for path in &arguments.model {
        models.push((path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), path.clone()));
    }
    println!(
        "{}",
        head(&[
            "model",
            "samples",
            "map",
            "true rms",
            "expected / true",
            "by samples / true",
            "true 99.9 %",
            "expected / true",
            "by samples / true",
            "true worst",
            "by samples / true",
            "least share warned",
            "at t",
            "of vertices"
        ])
    );
    for (name, path) in &models {
        for samples in &arguments.samples {
            let model = simod_model::open(path)?;
            let sampling = Sampling { target: Target::Samples(*samples), ..Sampling::default() };
            let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent)?;
            for map in maps(&sampled) {
                let found = compare(&sampled, path, map, folder.path())?;
                println!("{}", row(found.cells(name, sampled.samples.len(), map.name())));
            }
        }
    }
    Ok(())
}

/// Maps that are smooth, or exact.
fn maps(sampled: &SampledModel) -> Vec<Map> {
    let bounds = &sampled.bounds;
    // On the surface, a third of the way from the middle to a corner.
    let aim = bounds.center() + (bounds.max - bounds.min) * DVec3::new(0.3, 0.12, 0.06);
    let at = sampled.samples.nearest(sampled.frame.to_local(aim)) as usize;
    let at = sampled.frame.to_model(sampled.samples.positions[at]);
    vec![Map::Rigid, Map::Affine, Map::Twist, Map::Bend, Map::Bump(at)]
}

struct Compared {
    /// Of all vertices, sorted.
    truth: Vec<f32>,
    expected: Vec<f32>,
    /// For each threshold: how many vertices are beyond three times that, and how many of them are expected
    /// beyond it.
    beyond: [(u64, u64); THRESHOLDS.len()],
    by_samples: ExpectedError,
}

fn compare(sampled: &SampledModel, path: &Path, map: Map, folder: &Path) -> Result<Compared> {
    let [output, figures] = ["deformed.ply", "figures.ply"].map(|name| folder.join(name));
    let deformed = map.deform(sampled);
    let model = simod_model::open(path)?;
    let version = |diagnostics| Version { deformed: &deformed, output: &output, diagnostics };
    let how = Reconstruction::default();
    let plain = reconstruct(sampled, model.as_ref(), &[version(None)], &how, &Silent)?;
    reconstruct(sampled, model.as_ref(), &[version(Some(&figures))], &how, &Silent)?;
    let expected = column(&figures, "expected_error_fraction")?;

    let diagonal = sampled.bounds.diagonal();
    let mut found = Compared {
        truth: Vec::new(),
        expected: Vec::new(),
        beyond: [(0, 0); THRESHOLDS.len()],
        by_samples: plain.expected[0].ok_or_else(|| unreadable(&figures))?,
    };
    let result = simod_model::open(&output)?;
    let mut all = expected.iter();
    in_step(&[model.as_ref(), result.as_ref()], 0, &Silent, |versions| {
        for (rest, moved) in versions[0].positions.iter().zip(versions[1].positions) {
            let expected = f64::from(*all.next().ok_or_else(|| unreadable(&figures))?);
            if !rest.is_finite() {
                continue;
            }
            let truth = moved.distance(map.apply(&sampled.bounds, *rest)) / diagonal;
            for (t, (beyond, warned)) in THRESHOLDS.iter().zip(&mut found.beyond) {
                if truth > 3.0 * t {
                    *beyond += 1;
                    *warned += u64::from(expected > *t);
                }
            }
            found.truth.push(truth as f32);
            found.expected.push(expected as f32);
        }
        Ok(())
    })?;
    found.truth.sort_unstable_by(f32::total_cmp);
    found.expected.sort_unstable_by(f32::total_cmp);
    Ok(found)
}

impl Compared {
    fn cells(&self, model: &str, samples: usize, map: &str) -> Vec<String> {
        let rms = |all: &[f32]| {
            let squares: f64 = all.iter().map(|e| f64::from(*e).powi(2)).sum();
            (squares / all.len().max(1) as f64).sqrt()
        };
        let high = |all: &[f32]| all.get(all.len() * 999 / 1000).map_or(0.0, |e| f64::from(*e));
        let worst = self.truth.last().map_or(0.0, |e| f64::from(*e));
        let ratio = |expected: f64, truth: f64| format!("{:.2}", expected / truth.max(f64::MIN_POSITIVE));
        let shares = THRESHOLDS.iter().zip(self.beyond).filter(|(_, (beyond, _))| *beyond >= FEWEST);
        let share = |(beyond, warned): (u64, u64)| warned as f64 / beyond as f64;
        let least = shares.min_by(|a, b| share(a.1).total_cmp(&share(b.1)));
        let (truth_rms, truth_high) = (rms(&self.truth), high(&self.truth));
        let mut cells = vec![
            model.to_owned(),
            samples.to_string(),
            map.to_owned(),
            error_figure(truth_rms),
            ratio(rms(&self.expected), truth_rms),
            ratio(self.by_samples.rms, truth_rms),
            error_figure(truth_high),
            ratio(high(&self.expected), truth_high),
            ratio(self.by_samples.p999, truth_high),
            error_figure(worst),
            ratio(self.by_samples.worst, worst),
        ];
        cells.extend(match least {
            Some((t, of)) => [format!("{:.3}", share(of)), format!("{t:.0e}"), of.0.to_string()],
            None => ["-", "-", "-"].map(str::to_owned),
        });
        cells
    }
}

/// A column of floats of a diagnostics file, by its header.
fn column(path: &Path, name: &str) -> Result<Vec<f32>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io("read", path, &e))?;
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end).ok_or_else(|| unreadable(path))? + end.len();
    let header = String::from_utf8_lossy(&bytes[..at]);
    let (mut offset, mut stride) = (None, 0);
    for line in header.lines() {
        if let Some((kind, of)) = line.strip_prefix("property ").and_then(|line| line.split_once(' ')) {
            if of == name {
                offset = Some(stride);
            }
            stride += match kind {
                "double" => 8,
                "float" => 4,
                _ => 1,
            };
        }
    }
    let offset = offset.ok_or_else(|| unreadable(path))?;
    let of_vertex =
        |vertex: &[u8]| f32::from_le_bytes(vertex[offset..offset + 4].try_into().unwrap_or_default());
    Ok(bytes[at..].chunks_exact(stride).map(of_vertex).collect())
}

fn unreadable(path: &Path) -> Error {
    Error::format(format!("{} is no file of diagnostics", path.display()), "report this")
}
