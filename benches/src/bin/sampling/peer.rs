//! Other ways to thin a model out, as processes of their own that do nothing else: they read the vertices of
//! a file of this program's in one go, and write the positions that are left as raw floats.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::{Args, ValueEnum};
use glam::DVec3;
use simod_benches::process::Result;
use simod_benches::scan::VERTEX_BYTES;
use simod_model::output::write_file;

/// Another way to thin a model out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Peer {
    /// The mean of the vertices in each cell of a uniform grid. The edge of a cell is found beforehand.
    Voxels,
    /// `meshopt_simplifyPoints`.
    #[cfg(feature = "peers")]
    Meshoptimizer,
}

impl Peer {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Voxels => "means over voxels",
            #[cfg(feature = "peers")]
            Self::Meshoptimizer => "meshoptimizer",
        }
    }
}

/// Work of one process.
#[derive(Debug, Args)]
pub struct Job {
    peer: Peer,
    model: PathBuf,
    output: PathBuf,
    /// Points to leave
    #[arg(long)]
    samples: usize,
    /// Edge of a voxel
    #[arg(long)]
    edge: f64,
}

impl Job {
    /// The command that does the job.
    pub fn command(&self) -> Result<Command> {
        let mut command = Command::new(std::env::current_exe()?);
        let peer = self.peer.to_possible_value().ok_or("no such program")?;
        command.arg("peer").arg(peer.get_name()).arg(&self.model).arg(&self.output);
        command.arg("--samples").arg(self.samples.to_string()).arg("--edge").arg(self.edge.to_string());
        Ok(command)
    }

    /// A job for a peer.
    pub fn new(peer: Peer, model: &Path, output: &Path, samples: usize, edge: f64) -> Self {
        Self { peer, model: model.to_owned(), output: output.to_owned(), samples, edge }
    }

    /// Does it.
    pub fn execute(&self) -> Result<()> {
        let vertices = read_vertices(&self.model)?;
        let left: Vec<[f32; 3]> = match self.peer {
            Peer::Voxels => voxel_means(vertices.chunks_exact(VERTEX_BYTES).map(position), self.edge),
            #[cfg(feature = "peers")]
            Peer::Meshoptimizer => {
                let points = meshopt::VertexDataAdapter::new(&vertices, VERTEX_BYTES, 0)?;
                let kept = meshopt::simplify_points(&points, None, 0.0, self.samples);
                kept.iter().map(|i| position(&vertices[*i as usize * VERTEX_BYTES..])).collect()
            }
        };
        write_file(&self.output, bytemuck::cast_slice(&left))?;
        Ok(())
    }

    /// Reads the points that the job has left.
    pub fn read_points(&self) -> Result<Vec<DVec3>> {
        let bytes = std::fs::read(&self.output)?;
        Ok(bytes.chunks_exact(12).map(|p| DVec3::from_array(position(p).map(f64::from))).collect())
    }
}

/// The bytes of all vertices of a file that `Mesh::write` has written.
fn read_vertices(path: &Path) -> Result<Vec<u8>> {
    let mut file = BufReader::with_capacity(1 << 10, File::open(path)?);
    let (mut line, mut count) = (String::new(), 0);
    while line != "end_header\n" {
        line.clear();
        if file.read_line(&mut line)? == 0 {
            return Err(format!("{} has no header", path.display()).into());
        }
        if let Some(vertices) = line.strip_prefix("element vertex ") {
            count = vertices.trim().parse()?;
        }
    }
    let mut vertices = vec![0; count * VERTEX_BYTES];
    file.read_exact(&mut vertices)?;
    Ok(vertices)
}

/// The three floats that a vertex begins with.
fn position(vertex: &[u8]) -> [f32; 3] {
    [0, 4, 8].map(|at| f32::from_ne_bytes([vertex[at], vertex[at + 1], vertex[at + 2], vertex[at + 3]]))
}

/// The means of the points in each cell of a uniform grid.
fn voxel_means(points: impl Iterator<Item = [f32; 3]>, edge: f64) -> Vec<[f32; 3]> {
    let mut cells: HashMap<u64, ([f64; 3], f64), foldhash::fast::FixedState> = HashMap::default();
    for p in points {
        let (sum, count) = cells.entry(cell(p, edge)).or_default();
        sum.iter_mut().zip(p).for_each(|(sum, x)| *sum += f64::from(x));
        *count += 1.0;
    }
    cells.values().map(|(sum, count)| sum.map(|x| (x / count) as f32)).collect()
}

/// The cell of a uniform grid that a point is in, 2²¹ cells along each axis.
fn cell(p: [f32; 3], edge: f64) -> u64 {
    let along = |x: f32| ((f64::from(x) / edge).floor() as i64 & 0x1f_ffff) as u64;
    along(p[0]) | along(p[1]) << 21 | along(p[2]) << 42
}

/// The edge of the cells of a uniform grid of which about `wanted` are occupied.
pub fn voxel_edge(points: &[DVec3], diagonal: f64, wanted: usize) -> f64 {
    let occupied = |edge: f64| {
        let mut cells: Vec<u64> = points.iter().map(|p| cell(p.as_vec3().to_array(), edge)).collect();
        cells.sort_unstable();
        cells.dedup();
        cells.len()
    };
    let mut edge = diagonal / 300.0;
    for _ in 0..12 {
        // As many cells as a surface takes; far below the distances of points there are no more cells to be
        // had.
        let ratio = occupied(edge) as f64 / wanted as f64;
        if (ratio - 1.0).abs() < 2e-3 {
            break;
        }
        edge *= ratio.sqrt();
    }
    edge
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 201 × 201 points, in the plane z = 1, about the origin.
    fn square() -> Vec<DVec3> {
        let at = |i: i32| f64::from(i) * 0.01;
        (-100..=100).flat_map(|i| (-100..=100).map(move |j| DVec3::new(at(i), at(j), 1.0))).collect()
    }

    #[test]
    fn voxels_are_as_many_as_wanted_and_leave_their_means() {
        let points = square();
        let edge = voxel_edge(&points, 2.83, 1000);
        let left = voxel_means(points.iter().map(|p| p.as_vec3().to_array()), edge);
        assert!(left.len().abs_diff(1000) < 60, "{}", left.len());
        assert!(left.iter().all(|p| p[2] == 1.0));
        let mean: f32 = left.iter().map(|p| p[0]).sum::<f32>() / left.len() as f32;
        assert!(mean.abs() < 0.02, "{mean}");
    }

    #[test]
    fn jobs_do_what_they_are_for() {
        let folder = tempfile::tempdir().expect("a folder");
        let (model, output) = (folder.path().join("scan.ply"), folder.path().join("points.bin"));
        let mut mesh = simod_benches::scan::Mesh::amphora(30_000).expect("an amphora");
        mesh.refine_to(30_000);
        mesh.round();
        mesh.write(&model).expect("a file");
        let edge = voxel_edge(&mesh.positions, mesh.bounds().diagonal(), 3000);
        for peer in Peer::value_variants() {
            let job = Job::new(*peer, &model, &output, 3000, edge);
            job.execute().expect("points");
            let left = job.read_points().expect("points");
            assert!(left.len().abs_diff(3000) < 300, "{peer:?}: {}", left.len());
            assert!(left.iter().all(|p| mesh.bounds().contains(*p)), "{peer:?}");
        }
    }
}
