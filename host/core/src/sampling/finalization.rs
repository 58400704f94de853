//! Pass 2: spatial finalization (M. Isenburg, Y. Liu, J. Shewchuk, J. Snoeyink, *Streaming Computation of
//! Delaunay Triangulations*, 2006; paper §4).
//!
//! Each sample goes to its cell; when the cell's counter reaches zero no sample of the rest of the stream
//! belongs to it: it is clustered, on any core, while the stream goes on.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};

use glam::Vec3;
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::progress::{Emerging, Visitor};
use simod_model::{Error, ErrorKind, Model, Progress, Result, for_positions};
use xxhash_rust::xxh3::Xxh3Default;

use super::cluster::{Element, Moments};
use super::cut::{Forest, most_kept, running_bound};
use super::density::Rule;
use super::gather::Gather;
use super::grid::{CellKey, Grid, cell_box};
use super::membership::{Leaves, Membership, Noted};
use super::open_cells::CellItems;
use super::random::mix;
use super::ranges::Ranges;
use super::vs_tree::{VsTree, Workspace};

/// Bytes of items that wait for, or are in, clustering, beyond which the stream stands still. The last cell
/// may be larger.
const MAX_QUEUED: usize = 4 << 20;

/// Most bytes of a cell's items that are clustered at once, and as much to sort them, on each thread. A
/// constant, so that the result depends neither on the machine's memory nor on the number of threads.
pub const PART: usize = 3 << 20;

/// Memory that it takes to cluster cells of which the largest has so many bytes: each part twice, and its
/// tree, of at most 1.4 nodes per sample, twice.
pub fn work_memory(largest: u64) -> u64 {
    // Whatever the number of threads: no more is in work than may be queued, and the last cell.
    6 * (largest.min(PART as u64) + MAX_QUEUED as u64)
}

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
    /// How clusters are split.
    pub rule: Rule,
    /// Number of samples that is aimed at, if any.
    pub target: Option<usize>,
    /// Error down to which cells are clustered, in local units.
    pub bound: f32,
    /// Most clusters that may be kept if there is no target.
    pub most: usize,
    /// Whether the number of samples that the whole model will have is foreseen: less work, but it can fail.
    pub foresight: bool,
    /// Whether it shall be known which cluster each vertex belongs to.
    pub with_members: bool,
    /// What else shall be known of the vertices then.
    pub noted: Noted,
    /// Where temporary files go.
    pub folder: &'a Path,
    /// Watches.
    pub progress: &'a dyn Progress,
}

/// What pass 2 finds.
pub struct Clustered {
    /// The trees of all cells.
    pub forest: Forest,
    /// Of the bytes of all vertices.
    pub hash: Xxh3Default,
    /// Where in the stream each cell's vertices are.
    pub ranges: Ranges,
    /// Which cluster each vertex belongs to.
    pub membership: Option<Membership>,
}

impl Pass<'_> {
    /// Streams the model through the grid and clusters each cell, down to the bound or to that which the
    /// target has come to meanwhile. `None` if `gather` finds no room.
    ///
    /// Memory: that of `gather`, [`Forest`], [`Ranges`] and [`Membership`]; [`MAX_QUEUED`], and two parts of
    /// a cell on each thread; the chunks of [`for_positions`]. Not to be called on a thread of the pool that
    /// clusters, which it waits for.
    ///
    /// # Errors
    /// The model cannot be read, or is not the one that the grid was made from; a temporary file cannot be
    /// written; the user cancelled.
    pub fn run<G: Gather>(&self, gather: G) -> Result<Option<Clustered>> {
        let info = self.model.info();
        self.progress.begin("clustering", info.vertex_bytes);
        let members = || Membership::new(self.grid, info, self.noted, self.folder);
        let mut clustered = Clustered {
            forest: Forest::new(self.grid, self.target, self.bound, self.most, self.foresight),
            hash: Xxh3Default::new(),
            ranges: Ranges::new(self.grid.keys.len()),
            membership: self.with_members.then(members).transpose()?,
        };
        let has_room = self.stream(gather, &mut clustered)?;
        Ok(has_room.then_some(clustered))
    }

    /// Whether there was room.
    fn stream<G: Gather>(&self, mut gather: G, found: &mut Clustered) -> Result<bool> {
        let Self { model, grid, frame, .. } = *self;
        let Clustered { forest, hash, ranges, membership } = found;
        let leaves = membership.as_ref().map(Membership::leaves);
        let stop = &AtomicU32::new(self.bound.to_bits());
        let mut first = true;
        let mut collect = |cell: ClusteredCell| -> Result<()> {
            let threshold = f32::from_bits(stop.load(Ordering::Relaxed));
            let visit = |visit: Visitor<'_>| {
                cell.tree.cut(threshold, |node| visit(node.position, node.normal));
            };
            self.progress.emerge(&Emerging::new(first, &grid.bounds, frame, &visit));
            first = false;
            stop.store(forest.add(cell)?.to_bits(), Ordering::Relaxed);
            Ok(())
        };
        let workspaces = &Mutex::new(Vec::<Workspace<G::Item>>::new());
        let (send, receive) = mpsc::channel::<(usize, Result<ClusteredCell>)>();
        let mut has_room = true;
        let streamed = rayon::in_place_scope(|scope| {
            let mut left: Vec<u64> = grid.records.iter().map(|r| r.count).collect();
            let mut queued = 0usize;
            let mut current: Option<(Bounds, u32)> = None;

            for_positions(model, |chunk| {
                self.progress.check()?;
                membership.as_mut().map_or(Ok(()), |members| members.look_for_twins(&chunk.positions))?;
                for (i, p) in chunk.positions.iter().enumerate() {
                    let cell = match &current {
                        Some((inside, cell)) if inside.contains(*p) => *cell,
                        _ if !p.is_finite() => {
                            membership.as_mut().map_or(Ok(()), |members| members.push(None, Vec3::NAN))?;
                            continue;
                        }
                        _ => {
                            let key = grid.key_of(*p);
                            let cell = grid.find(&key).ok_or_else(|| changed(model))?;
                            current = Some((cell_box(key, grid.level), cell));
                            ranges.enter(cell, chunk.first + i as u64);
                            cell
                        }
                    };
                    let c = cell as usize;
                    left[c] = left[c].checked_sub(1).ok_or_else(|| changed(model))?;
                    let normal = chunk.normals.get(i).map_or(Vec3::ZERO, |n| unit(*n));
                    let local = frame.to_local(*p);
                    let Some(index) = gather.add(cell, local, normal)? else {
                        has_room = false;
                        return Err(Error::cancelled());
                    };
                    if let Some(members) = membership.as_mut() {
                        members.push(Some((cell, index)), local)?;
                    }
                    if left[c] == 0 {
                        let items = gather.take(cell);
                        // Those in the file as well: they will be read, and their trees held.
                        let bytes = items.bytes();
                        queued += bytes;
                        let (send, leaves) = (send.clone(), leaves.clone());
                        scope.spawn(move |_| {
                            let free = || workspaces.lock().unwrap_or_else(PoisonError::into_inner);
                            let job = || {
                                let mut workspace = free().pop().unwrap_or_default();
                                let clustered =
                                    self.cluster(cell, items, stop, leaves.as_deref(), &mut workspace);
                                free().push(workspace);
                                clustered
                            };
                            let clustered =
                                catch_unwind(AssertUnwindSafe(job)).unwrap_or_else(|_| Err(panicked()));
                            // The receiver is gone only when the stream has failed already.
                            let _ = send.send((bytes, clustered));
                        });
                        while queued > MAX_QUEUED {
                            let Ok((bytes, cell)) = receive.recv() else { break };
                            queued -= bytes;
                            collect(cell?)?;
                        }
                    }
                }
                while let Ok((bytes, cell)) = receive.try_recv() {
                    queued -= bytes;
                    collect(cell?)?;
                }
                hash.update(chunk.raw());
                self.progress.advance(chunk.raw().len() as u64);
                Ok(())
            })?;
            if left.iter().any(|n| *n > 0) {
                return Err(changed(model));
            }
            ranges.finish(model.info().vertices);
            // Taken in as they come: the bound that they raise shortens the work on the rest.
            drop(send);
            receive.iter().try_for_each(|(_, cell)| collect(cell?))
        });
        if has_room { streamed.map(|()| true) } else { Ok(false) }
    }

    /// Clusters a complete cell; one that is larger than a part in parts, whose trees are joined, and kept to
    /// what a cut of the target number of samples can reach.
    fn cluster<E: Element>(
        &self,
        cell: u32,
        items: CellItems<E>,
        stop: &AtomicU32,
        members: Option<&Leaves>,
        workspace: &mut Workspace<E>,
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

/// What the tree of a cell is dithered by.
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

/// A thread that clusters panicked.
fn panicked() -> Error {
    Error::internal("clustering a cell failed", "this is a bug: please report it, with the model")
}

/// The model holds other vertices in pass 2 than in pass 1.
fn changed(model: &dyn Model) -> Error {
    Error::new(
        ErrorKind::Mismatch,
        format!("{} changed while it was read", model.path().display()),
        "wait until nothing writes to the file any more, then sample it again",
    )
}
