//! Pass 2: spatial finalization (M. Isenburg, Y. Liu, J. Shewchuk, J. Snoeyink, *Streaming Computation of
//! Delaunay Triangulations*, 2006; paper §4).
//!
//! Each vertex goes to its cell; when the cell's counter reaches zero no vertex of the rest of the stream
//! belongs to it: it is clustered, on any core, while the stream goes on.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::Vec3;
use simod_model::frame::Frame;
use simod_model::{Error, Model, Progress, Result};

use crate::colors::{Picked, Picking};
use crate::fingerprint::{PartHasher, VertexHash};

use super::cluster::{Element, Moments};
use super::cut::{ClusteredCell, Forest, most_kept, running_bound};
use super::density::SplitRule;
use super::grid::{CellKey, Grid};
use super::membership::{Leaves, Membership, Noted};
use super::opaque::Opaque;
use super::open_cells::CellItems;
use super::random::mix;
use super::ranges::{Jumps, PackedRanges};
use super::shared_vertices::{SharedReader, SharedWriter};
use super::shares::{Owner, Shares};
use super::vs_tree::{TreeWorkspace, VsTree};

/// Bytes of items that wait for, or are in, clustering, beyond which the stream stands still. The last cell
/// may be larger.
pub(super) const MAX_QUEUED: usize = 4 << 20;

/// Largest number of bytes of a cell's items that are clustered at once, and as much to sort them, on each
/// thread. A constant, so that the result depends neither on the machine's memory nor on the number of
/// threads.
pub const PART: usize = 3 << 20;

/// Memory for clustering cells of which the largest has `largest` bytes: each part twice, and its tree, of at
/// most 1.4 nodes per sample, twice.
pub fn work_memory(largest: u64) -> u64 {
    // Whatever the number of threads: no more is in work than may be queued, and the last cell.
    6 * (largest.min(PART as u64) + MAX_QUEUED as u64)
}

/// Inputs of pass 2.
pub struct ClusteringPass<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// The model's grid, from pass 1.
    pub grid: &'a Grid,
    /// The model's local coordinates.
    pub frame: &'a Frame,
    /// The rule by which clusters are split.
    pub rule: SplitRule,
    /// Number of samples that is aimed at, if any.
    pub target: Option<usize>,
    /// Error down to which cells are clustered, in local units.
    pub bound: f32,
    /// Largest number of clusters that may be kept if there is no target.
    pub most: usize,
    /// Factor times √f of the target's clusters that a part f of the vertices gets, where the number of
    /// samples of the whole model is foreseen, which is less work but can fail; `None` if it is not.
    pub foresight: Option<f64>,
    /// Part of the model that is streamed, and the cells that are clustered.
    pub job: StreamJob<'a>,
    /// Whether the cluster of each vertex is recorded.
    pub with_members: bool,
    /// Further records of the vertices, if their clusters are recorded.
    pub noted: Noted,
    /// The choice of vertices whose colours are kept, if colours are wanted.
    pub picking: Option<&'a Picking>,
    /// Splats that are left out.
    pub opaque: Option<Opaque>,
    /// The folder of temporary files.
    pub folder: &'a Path,
    /// Watches.
    pub progress: &'a dyn Progress,
}

/// Part of the model that is streamed, and the cells that are clustered.
#[derive(Clone, Copy)]
pub enum StreamJob<'a> {
    /// All.
    Whole,
    /// A range, and the cells that lie wholly within; vertices of the others are written down.
    Range(&'a Shares, u32, &'a Mutex<SharedWriter>),
    /// Vertices that ranges have written down for a group of cells.
    Group(&'a Shares, u32, &'a Mutex<SharedReader>),
}

impl StreamJob<'_> {
    /// Whether this job clusters a cell.
    #[inline]
    pub fn has(&self, cell: u32) -> bool {
        match self {
            Self::Whole => true,
            Self::Range(shares, number, _) => shares.owner(cell) == Owner::Range(*number),
            Self::Group(shares, number, _) => shares.owner(cell) == Owner::Group(*number),
        }
    }
}

/// The hash of the vertices that are streamed.
pub enum HashedStream {
    /// Bytes of all vertices.
    All(VertexHash),
    /// The bytes of a range of the vertices.
    Part(PartHasher),
    /// Nothing: others hash the vertices.
    Nothing,
}

impl HashedStream {
    /// Takes the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        match self {
            Self::All(hash) => hash.update(bytes),
            Self::Part(hash) => hash.update(bytes),
            Self::Nothing => {}
        }
    }
}

/// The findings of pass 2.
pub struct Clustered {
    /// The trees of all cells.
    pub forest: Forest,
    /// The hash of the bytes of all vertices.
    pub hash: HashedStream,
    /// Ranges of the stream with each cell's vertices.
    pub ranges: Vec<PackedRanges>,
    /// Number of items of each cell.
    pub items: Vec<u32>,
    /// The jumps of the stream from cell to cell.
    pub jumps: Jumps,
    /// Cluster of each vertex, if it is recorded.
    pub membership: Option<Membership>,
    /// The colours of some vertices, if they are wanted.
    pub picked: Option<Picked>,
}

impl ClusteringPass<'_> {
    /// Clusters a complete cell; one that is larger than a part in parts, whose trees are joined, and kept to
    /// the nodes that a cut of the target number of samples can reach.
    pub(super) fn cluster<E: Element>(
        &self,
        cell: u32,
        items: CellItems<E>,
        stop: &AtomicU32,
        members: Option<&Leaves>,
        workspace: &mut TreeWorkspace<E>,
    ) -> Result<ClusteredCell> {
        let seed = seed_of(&self.grid.keys[cell as usize]);
        let mut whole: Option<(VsTree, Moments)> = None;
        items.in_parts(PART / size_of::<E>(), |items| {
            self.progress.check()?;
            let stop = f32::from_bits(stop.load(Ordering::Relaxed));
            let first = items.first().map_or(0, E::index);
            let (tree, moments) = VsTree::build(items, workspace, self.rule, stop, seed);
            if let Some(members) = members {
                let before = whole.as_ref().map_or(0, |(tree, _)| tree.built());
                workspace.leaves.iter_mut().for_each(|leaf| *leaf += before);
                members.record(cell, first, &mut workspace.leaves)?;
            }
            whole = Some(match whole.take() {
                None => (tree, moments),
                Some((first, mut both)) => {
                    both.add(&moments);
                    let mut joined = VsTree::join(first, tree, &both);
                    if let Some(target) = self.target.filter(|n| joined.leaves() > most_kept(*n)) {
                        joined.prune(running_bound(std::iter::once(&joined), target));
                    }
                    (joined, both)
                }
            });
            Ok(())
        })?;
        let (tree, moments) = whole.unwrap_or_default();
        Ok(ClusteredCell { cell, tree, moments })
    }
}

/// Seed of a cell's tree, by which splits are dithered.
pub fn seed_of(key: &CellKey) -> u64 {
    key.iter().fold(0, |seed, k| mix(seed, *k as u64))
}

/// The direction of a normal; zero where it has none. Most are of unit length as they are.
#[inline]
pub fn unit(n: Vec3) -> Vec3 {
    if (n.length_squared() - 1.0).abs() < 1e-6 {
        return n;
    }
    // Of a size that can be squared.
    (n / n.abs().max_element()).normalize_or_zero()
}

/// The model holds other vertices in pass 2 than in pass 1.
pub(super) fn changed(model: &dyn Model) -> Error {
    Error::changed_while_read(model.path())
}
