//! Pass 2: spatial finalization (M. Isenburg, Y. Liu, J. Shewchuk, J. Snoeyink, *Streaming Computation of
//! Delaunay Triangulations*, 2006; paper §4).
//!
//! Each sample goes to its cell; when the cell's counter reaches zero no sample of the rest of the stream belongs
//! to it: it is clustered, on any core, while the stream goes on.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc;

use glam::Vec3;
use xxhash_rust::xxh3::Xxh3Default;

use super::cluster::{Moments, Sample};
use super::cut::{most_kept, running_bound};
use super::lattice::{Grid, cell_box};
use super::open_cells::{CellSamples, OpenCells};
use super::vs_tree::{VsTree, mix};
use crate::frame::Frame;
use crate::geometry::Bounds;
use crate::model::{Model, VertexChunk};
use crate::{Error, ErrorKind, Progress, Result};

/// Most samples that wait for, or are in, clustering: 6 MiB of them. Beyond it the stream stands still.
const MAX_QUEUED_SAMPLES: usize = 1 << 18;

/// Most samples of a cell that are clustered at once: 6 MiB, and as much to sort them, on each thread. A constant, so
/// that the result depends neither on the machine's memory nor on the number of threads.
const PART: usize = 1 << 18;

/// The clusters of one finalized cell.
pub struct ClusteredCell {
    /// The cell's place in the grid's list.
    pub cell: u32,
    /// Its VS-Tree.
    pub tree: VsTree,
    /// The moments of all its samples.
    pub moments: Moments,
}

/// What pass 2 works on.
pub struct Pass<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// Its grid, from pass 1.
    pub grid: &'a Grid,
    /// Its local coordinates.
    pub frame: &'a Frame,
    /// Number of samples that is aimed at, if any.
    pub target: Option<usize>,
    /// Bytes of samples that may be held.
    pub memory: u64,
    /// Where a temporary file goes if that is not enough.
    pub folder: &'a Path,
    /// Watches.
    pub progress: &'a dyn Progress,
}

impl Pass<'_> {
    /// Streams the model through the grid and hands each cell, clustered down to the current value of `stop` (an
    /// error in local units, as the bits of an f32), to `collect`, in no particular order. `hash` takes in the
    /// bytes of all vertices.
    ///
    /// Memory: `memory` for the samples of open cells ([`OpenCells`]); [`MAX_QUEUED_SAMPLES`], and two
    /// parts of a cell on each thread; a chunk of the model. Not to be called on a thread of the pool that clusters,
    /// which it waits for.
    ///
    /// # Errors
    /// The model cannot be read, or is not the one that the grid was made from; a temporary file cannot be written;
    /// the user cancelled.
    pub fn run(
        &self,
        stop: &AtomicU32,
        hash: &mut Xxh3Default,
        mut collect: impl FnMut(ClusteredCell),
    ) -> Result<()> {
        let Self { model, grid, frame, .. } = *self;
        let (send, receive) = mpsc::channel::<(usize, Result<ClusteredCell>)>();
        rayon::in_place_scope(move |scope| {
            let mut open = OpenCells::new(grid.keys.len(), self.memory, self.folder);
            let mut left: Vec<u64> = grid.records.iter().map(|r| r.count).collect();
            let mut queued = 0usize;
            let mut current = None;

            let mut reader = model.vertices(0..model.info().vertices)?;
            let mut chunk = VertexChunk::default();
            while reader.read(&mut chunk)? {
                self.progress.check()?;
                for (i, p) in chunk.positions.iter().enumerate() {
                    let cell = match &current {
                        Some((inside, cell)) if Bounds::contains(inside, *p) => *cell,
                        _ if !p.is_finite() => continue,
                        _ => {
                            let key = grid.key_of(*p);
                            let cell = grid.find(&key).ok_or_else(|| changed(model))?;
                            current = Some((cell_box(key, grid.level), cell));
                            cell
                        }
                    };
                    let c = cell as usize;
                    left[c] = left[c].checked_sub(1).ok_or_else(|| changed(model))?;
                    let normal = chunk.normals.get(i).map_or(Vec3::ZERO, |n| unit(*n));
                    open.push(cell, Sample { position: frame.to_local(*p), normal })?;
                    if left[c] == 0 {
                        let samples = open.take(cell);
                        // Those in the file as well: they will be read, and their trees held.
                        let count = usize::try_from(grid.records[c].count).unwrap_or(usize::MAX / 2);
                        queued += count;
                        let send = send.clone();
                        let seed = grid.keys[c].iter().fold(0, |seed, k| mix(seed, *k as u64));
                        scope.spawn(move |_| {
                            let job = || cluster(cell, samples, stop, self.target, seed);
                            let clustered =
                                catch_unwind(AssertUnwindSafe(job)).unwrap_or_else(|_| Err(panicked()));
                            // The receiver is gone only when the stream has failed already.
                            let _ = send.send((count, clustered));
                        });
                        while queued > MAX_QUEUED_SAMPLES {
                            let Ok((samples, cell)) = receive.recv() else { break };
                            queued -= samples;
                            collect(cell?);
                        }
                    }
                }
                while let Ok((samples, cell)) = receive.try_recv() {
                    queued -= samples;
                    collect(cell?);
                }
                hash.update(chunk.raw());
                self.progress.advance(chunk.raw().len() as u64);
            }
            if left.iter().any(|n| *n > 0) {
                return Err(changed(model));
            }
            // Taken in as they come: the bound that they raise shortens the work on the rest.
            drop(send);
            receive.iter().try_for_each(|(_, cell)| cell.map(&mut collect))
        })
    }
}

/// Clusters a complete cell; one that is larger than a part in parts, whose trees are joined, and kept to what a cut
/// of `target` samples can reach.
fn cluster(
    cell: u32,
    samples: CellSamples,
    stop: &AtomicU32,
    target: Option<usize>,
    seed: u64,
) -> Result<ClusteredCell> {
    let mut scratch = Vec::new();
    let mut whole: Option<(VsTree, Moments)> = None;
    samples.in_parts(PART, |samples| {
        let stop = f32::from_bits(stop.load(Ordering::Relaxed));
        let (tree, moments) = VsTree::build(samples, &mut scratch, stop, seed);
        whole = Some(match whole.take() {
            None => (tree, moments),
            Some((first, mut both)) => {
                both.add(&moments);
                let mut joined = VsTree::join(first, tree, &both);
                if let Some(target) = target.filter(|n| joined.leaves() > most_kept(*n)) {
                    joined.prune(running_bound(std::iter::once(&joined), target));
                }
                (joined, both)
            }
        });
    })?;
    let (tree, moments) = whole.unwrap_or_default();
    Ok(ClusteredCell { cell, tree, moments })
}

/// The direction of a normal; zero where it has none. Most are of unit length as they are.
#[inline]
fn unit(n: Vec3) -> Vec3 {
    if (n.length_squared() - 1.0).abs() < 1e-6 { n } else { n.normalize_or_zero() }
}

/// A thread that clusters panicked.
fn panicked() -> Error {
    Error::new(
        ErrorKind::Degenerate,
        "clustering a cell failed",
        "this is a bug: please report it, with the model",
    )
}

/// The model holds other vertices in pass 2 than in pass 1.
fn changed(model: &dyn Model) -> Error {
    Error::new(
        ErrorKind::Mismatch,
        format!("{} changed while it was read", model.path().display()),
        "wait until nothing writes to the file any more, then sample it again",
    )
}
