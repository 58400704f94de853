//! Sampling: P_L is streamed twice and leaves the small point set P_S (paper §4).
//!
//! Pass 1 ([`lattice`]) counts samples per cell of a coarse grid. Pass 2 (`finalization`) puts each sample in its
//! cell and clusters a cell ([`vs_tree`], [`cluster`]) once it is complete. A cut through all trees (`cut`)
//! gives the samples, which [`SampleSet`] completes with neighbours, spacing and normals.

pub mod cluster;
mod cut;
mod finalization;
pub mod lattice;
mod normals;
mod open_cells;
mod sample_set;
pub mod vs_tree;

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::Vec3;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3Default;

pub use sample_set::{NEIGHBOURS, NeighbourGraph, SampleSet};

use crate::frame::Frame;
use crate::model::{Model, VertexChunk};
use crate::sampled_model::{SampledModel, Source, fingerprint};
use crate::{Error, ErrorKind, Progress, Result};
use cut::Forest;
use finalization::Pass;
use lattice::{Grid, Lattice};

/// How fine P_S shall be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// This many samples, at most, and only less where the model has no more to tell apart.
    Samples(u64),
    /// No cluster has a larger error (see [`cluster::Moments::error`]); a fraction of the diagonal.
    Error(f64),
}

impl Default for Target {
    fn default() -> Self {
        Self::Samples(100_000)
    }
}

/// What sampling is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sampling {
    /// How fine P_S shall be.
    pub target: Target,
    /// Most cells of the coarse grid along an axis; by the model's size where not given.
    pub grid: Option<u32>,
    /// Bytes of memory to stay below, for any order of the vertices; a quarter of the machine's, and at most
    /// 2 GiB, where not given.
    pub memory_limit: Option<u64>,
}

/// Memory that is needed whatever the limit: chunks of the model, the queue of cells, the program itself.
const OVERHEAD: u64 = 32 << 20;

/// Least memory for samples, however low the limit.
const MIN_SAMPLE_MEMORY: u64 = 8 << 20;

impl Sampling {
    /// What is left of the memory limit for the samples of cells, after the clusters that are kept and the table
    /// of so many cells.
    fn sample_memory(&self, cells: usize) -> u64 {
        let limit = self.memory_limit.unwrap_or_else(|| (total_memory() / 4).min(2 << 30));
        let clusters = match self.target {
            Target::Samples(n) => n.saturating_mul(cut::BYTES_PER_SAMPLE),
            Target::Error(_) => limit / 4,
        };
        let taken = OVERHEAD.saturating_add(clusters).saturating_add(512 * cells as u64);
        limit.saturating_sub(taken).max(MIN_SAMPLE_MEMORY)
    }
}

/// Memory of the machine in bytes; 4 GiB where it does not tell.
fn total_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let total = text
        .lines()
        .find_map(|l| l.strip_prefix("MemTotal:")?.trim().strip_suffix("kB")?.trim().parse().ok());
    total.unwrap_or(4 << 20) * 1024
}

/// Samples a model. If the memory limit is reached, a temporary file without a name is made in `folder`, of at most
/// 40 bytes per vertex.
///
/// # Errors
/// The model cannot be read, changes meanwhile, or has no vertex with a finite position; the target is zero or not
/// finite; the temporary file cannot be written; the user cancelled.
pub fn sample(
    model: &dyn Model,
    sampling: &Sampling,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    check(sampling)?;
    let info = model.info();
    if info.vertices == 0 {
        return Err(Error::new(
            ErrorKind::Degenerate,
            format!("{} has no vertices", model.path().display()),
            "a model needs at least one vertex to be sampled",
        ));
    }

    model.check_complete()?;

    progress.begin("counting", info.vertex_bytes);
    let resolution = sampling.grid.unwrap_or_else(|| default_grid(info.vertices));
    let (grid, non_finite) = count_cells(model, resolution, progress)?;
    let frame = Frame::of(&grid.bounds);

    progress.begin("clustering", info.vertex_bytes);
    let (target, bound) = match sampling.target {
        Target::Samples(n) => (Some(usize::try_from(n).unwrap_or(usize::MAX / 8)), 0.0),
        Target::Error(e) => (None, (e * grid.bounds.diagonal() / frame.scale) as f32),
    };
    let mut forest = Forest::new(grid.keys.len(), target, bound);
    let stop = AtomicU32::new(bound.to_bits());
    let mut hash = Xxh3Default::new();
    let memory = sampling.sample_memory(grid.keys.len());
    let pass = Pass { model, grid: &grid, frame: &frame, target, memory, folder, progress };
    pass.run(&stop, &mut hash, |cell| stop.store(forest.add(cell).to_bits(), Ordering::Relaxed))?;

    progress.begin("completing the samples", 0);
    let clusters = forest.cut(&grid);
    let (positions, normals): (Vec<Vec3>, Vec<Vec3>) =
        clusters.iter().map(|c| (c.position, c.normal)).unzip();
    SampledModel::new(
        Source {
            path: model.path().to_owned(),
            bytes: info.bytes,
            vertices: info.vertices,
            non_finite: non_finite.count,
            first_non_finite: non_finite.first,
            fingerprint: fingerprint(hash.digest128()),
        },
        *sampling,
        &grid,
        info.position_type,
        positions,
        normals,
    )
}

/// Samples are indexed by 32 bits.
const MAX_SAMPLES: u64 = u32::MAX as u64;

fn check(sampling: &Sampling) -> Result<()> {
    let bad = match sampling.target {
        Target::Samples(n) if n == 0 || n > MAX_SAMPLES => format!("the target of {n} samples"),
        Target::Error(e) if !(e.is_finite() && e > 0.0) => format!("the error bound {e}"),
        _ => match sampling.grid {
            Some(r @ (0 | 1 | 4097..)) => format!("a grid of {r} cells along an axis"),
            _ => return Ok(()),
        },
    };
    Err(Error::new(
        ErrorKind::Argument,
        format!("{bad} is out of range"),
        "give a number of samples from 1 to 2^32 - 1, an error above 0 (a fraction of the diagonal), a grid from 2 to 4096",
    ))
}

/// About 2000 vertices per cell of a surface, which meets about 3R² cells: enough for a tree to be adaptive, few
/// enough that the open cells of a coherent stream stay small.
fn default_grid(vertices: u64) -> u32 {
    let resolution = (vertices as f64 / 6000.0).sqrt() as u32;
    resolution.next_power_of_two().clamp(16, 512)
}

/// Vertices whose position is not finite: they are left out of P_S, and keep their bytes.
#[derive(Default)]
struct NonFinite {
    count: u64,
    first: Option<u64>,
}

/// Pass 1.
fn count_cells(model: &dyn Model, resolution: u32, progress: &dyn Progress) -> Result<(Grid, NonFinite)> {
    let mut lattice = Lattice::new(resolution);
    let mut non_finite = NonFinite::default();
    let mut reader = model.vertices(0..model.info().vertices)?;
    let mut chunk = VertexChunk::default();
    while reader.read(&mut chunk)? {
        progress.check()?;
        for (index, p) in (chunk.first..).zip(&chunk.positions) {
            if p.is_finite() {
                lattice.add(*p, index);
            } else {
                non_finite.count += 1;
                non_finite.first.get_or_insert(index);
            }
        }
        progress.advance(chunk.raw().len() as u64);
    }
    if non_finite.count == model.info().vertices {
        return Err(Error::new(
            ErrorKind::Degenerate,
            format!("none of the {} vertices of {} is finite", non_finite.count, model.path().display()),
            "check how the file was written: all of its positions hold NaN or infinity",
        ));
    }
    Ok((lattice.finish(), non_finite))
}
