//! Distances of all vertices of a model like a scan from the samples, and from the triangles between these.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use clap::ValueEnum;
use glam::DVec3;
use simod_benches::distance::{Distances, to_points, to_triangles};
use simod_benches::process::{self, Ran, Result};
use simod_benches::scan::Mesh;
use simod_benches::{head, median, row};
use simod_core::sampled_model::SampledModel;

use crate::peer::{Job, Peer, voxel_edge};
use crate::{Arguments, figure};

const COLUMNS: [&str; 11] = [
    "method",
    "points",
    "wall, s",
    "CPU, s",
    "CPU, ns/vertex",
    "peak, MB",
    "to points, rms",
    "to points, worst",
    "to triangles, rms",
    "to triangles, worst",
    "points off the surface, mean",
];

/// Time between two looks at a process' memory: rarely enough that they cost it nothing.
const POLL: Duration = Duration::from_millis(5);

/// A model that was thinned out.
struct Thinned {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Measures, and prints a table.
pub fn measure(arguments: &Arguments, simod: &Path) -> Result<()> {
    let folder = tempfile::tempdir_in(&arguments.folder)?;
    let temporary = folder.path().join("scan.ply");
    let model = arguments.keep.as_deref().unwrap_or(&temporary);
    let (mesh, diagonal) = make_scan(arguments)?;
    mesh.write(model)?;
    let made = mesh.positions.len();
    println!(
        "{made} vertices, {} triangles, relief {:.1e}; distances as fractions of the diagonal\n",
        mesh.triangles.len(),
        arguments.relief
    );

    let samples = arguments.samples as usize;
    let edge = voxel_edge(&mesh.positions, diagonal, samples);
    let sampled = folder.path().join("samples.simod");
    let points = |peer: &Peer| folder.path().join(format!("{peer:?}.points"));
    let jobs: Vec<Job> =
        Peer::value_variants().iter().map(|p| Job::new(*p, model, &points(p), samples, edge)).collect();
    let mut rounds = Vec::new();
    for _ in 0..arguments.runs {
        let mut command = Command::new(simod);
        command.arg("sample").arg(model).arg("-o").arg(&sampled).arg("--samples").arg(samples.to_string());
        let mut round = vec![process::run(&mut command, Some(POLL))?];
        for job in &jobs {
            round.push(process::run(&mut job.command()?, Some(POLL))?);
        }
        rounds.push(round);
    }

    println!("{}", head(&COLUMNS));
    let names = std::iter::once("SIMOD").chain(Peer::value_variants().iter().map(|peer| peer.name()));
    for (i, name) in names.enumerate() {
        let thinned = match i.checked_sub(1) {
            None => load_samples(&sampled)?,
            Some(peer) => Thinned { points: jobs[peer].read_points()?, triangles: Vec::new() },
        };
        let runs: Vec<&Ran> = rounds.iter().map(|round| &round[i]).collect();
        println!("{}", table_row(name, &runs, &thinned, &mesh, diagonal));
    }
    Ok(())
}

/// The model to be sampled, and its diagonal.
fn make_scan(arguments: &Arguments) -> Result<(Mesh, f64)> {
    let vertices = (arguments.millions * 1e6) as usize;
    let mut mesh = match &arguments.mesh {
        Some(path) => Mesh::read_obj(path)?,
        None => Mesh::amphora(vertices)?,
    };
    mesh.order();
    mesh.number_by_triangles();
    mesh.refine_to(vertices);
    mesh.roughen(arguments.relief * mesh.bounds().diagonal());
    mesh.number_by_triangles();
    mesh.round();
    let diagonal = mesh.bounds().diagonal();
    Ok((mesh, diagonal))
}

/// P_S, in the model's coordinates.
fn load_samples(folder: &Path) -> Result<Thinned> {
    let sampled = SampledModel::load(folder)?;
    let points = sampled.samples.positions.iter().map(|p| sampled.frame.to_model(*p)).collect();
    Ok(Thinned { points, triangles: sampled.triangles })
}

fn table_row(name: &str, runs: &[&Ran], thinned: &Thinned, mesh: &Mesh, diagonal: f64) -> String {
    let middle = |figure: fn(&Ran) -> f64| median(runs.iter().map(|ran| figure(ran)).collect());
    let cpu = middle(|ran| ran.cpu);
    let distance = |found: Option<Distances>, which: fn(Distances) -> f64| {
        found.map_or("-".to_owned(), |found| format!("{:.2e}", which(found.over(diagonal))))
    };
    let to_points = to_points(&mesh.positions, &thinned.points);
    let to_triangles = to_triangles(&mesh.positions, &thinned.points, &thinned.triangles);
    let off_surface =
        simod_benches::distance::to_triangles(&thinned.points, &mesh.positions, &mesh.triangles);
    row([
        name.to_owned(),
        thinned.points.len().to_string(),
        figure(middle(|ran| ran.wall), 2),
        figure(cpu, 2),
        figure(cpu * 1e9 / mesh.positions.len() as f64, 0),
        figure(middle(Ran::peak) / 1e6, 0),
        distance(to_points, |d| d.rms),
        distance(to_points, |d| d.worst),
        distance(to_triangles, |d| d.rms),
        distance(to_triangles, |d| d.worst),
        distance(off_surface, |d| d.mean),
    ])
}
