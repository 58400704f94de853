//! Pass 2 on all cores: the stream is gathered in pieces, several at a time, which are merged in its order.
//!
//! Open cells are dealt out to shards. Each thread takes a task: a cell that is complete is clustered; the
//! items that a piece has for the cells of a shard are merged into them, if it comes next in the stream; a
//! piece that all shards have merged is finished, in the order of the stream; or another piece is read and
//! gathered on its own. Only merging of a shard, finishing, and taking a cell's tree in, are each done by one
//! thread at a time.

use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use glam::{DVec3, Vec3};
use simod_model::bounds::Bounds;
use simod_model::progress::{Emerging, Visitor};
use simod_model::{Error, Result, VertexChunk, VertexReader};

use crate::colors::{ColorLists, Pick, Picked};
use crate::fingerprint::{PartHasher, VertexHash};

use super::cluster::Element;
use super::cut::{ClusteredCell, Forest};
use super::finalization::{Clustered, ClusteringPass, HashedStream, MAX_QUEUED, StreamJob, changed, unit};
use super::gather::{Gather, GatherPiece};
use super::grid::{CellKey, CellRecord, cell_box};
use super::membership::{Leaves, Membership};
use super::open_cells::CellItems;
use super::ranges::{Jumps, Ranges};
use super::shared_vertices::{SharedPiece, Visit};
use super::shares::{Owner, PIECE};
use super::tasks::{Schedule, Stopped, Task, Tasks};
use super::vs_tree::TreeWorkspace;

/// Pieces that are read and not yet merged, beside one for each thread: so that a thread whose piece has to
/// wait need not.
const WAITING: u64 = 1;

/// Largest number of shards: merging is a fifth to a fourth of the work.
const MOST_SHARDS: usize = 8;

/// Streams the model, or a part of it, through the grid and clusters each cell that is to be clustered, down
/// to the bound or to that which the target has come to meanwhile. `gather(n)` makes the gatherer of one of
/// `n` parts of the cells, in as small a part of the memory. `None` if one finds no room for all cells.
///
/// Memory: that of the gatherers of all parts, [`Forest`], [`Ranges`] and [`Membership`]; so many bytes of
/// cells as may be queued, and two parts of a cell on each thread; as many pieces as there are threads, and
/// one more, of [`PIECE`] vertices: their bytes in the file, and at most 212 for each.
///
/// # Errors
/// The model cannot be read, or is not the one that the grid was made from; a temporary file cannot be
/// written; the user cancelled.
pub fn cluster<G: Gather>(
    pass: &ClusteringPass<'_>,
    gather: impl Fn(usize) -> G,
) -> Result<Option<Clustered>> {
    // Parts of a model hand on their findings, which cannot be done twice.
    let is_whole = matches!(pass.job, StreamJob::Whole);
    let shards = if is_whole { (rayon::current_num_threads() / 2).clamp(1, MOST_SHARDS) } else { 1 };
    let clustered = cluster_in_shards(pass, (0..shards).map(|_| gather(shards)).collect())?;
    if clustered.is_some() || shards == 1 {
        return Ok(clustered);
    }
    // Items that find no room in a shard's part of the memory may find it in the whole.
    cluster_in_shards(pass, vec![gather(1)])
}

fn cluster_in_shards<G: Gather>(pass: &ClusteringPass<'_>, gather: Vec<G>) -> Result<Option<Clustered>> {
    let hash = match pass.job {
        StreamJob::Whole => HashedStream::All(VertexHash::default()),
        StreamJob::Range(..) => {
            let Range { start, end } = vertices_of(pass);
            let [begin, first] = pass.model.bytes_before(start);
            HashedStream::Part(PartHasher::new(first..pass.model.bytes_before(end)[1], first - begin))
        }
        StreamJob::Group(..) => HashedStream::Nothing,
    };
    pass.progress.begin("clustering", bytes_of(pass));
    let members = || members(pass);
    let mut clustered = Clustered {
        forest: Forest::new(pass.grid, pass.target, pass.bound, pass.most, pass.foresight),
        hash,
        ranges: Vec::new(),
        items: Vec::new(),
        jumps: Jumps::default(),
        membership: pass.with_members.then(members).transpose()?,
        picked: pass.picking.map(|_| Picked::new(pass.folder)).transpose()?,
    };
    let has_room = stream(pass, gather, &mut clustered)?;
    Ok(has_room.then_some(clustered))
}

/// A table for the members of all clusters. Vertices of cells that others cluster are in it with the first
/// leaf of their cell.
fn members(pass: &ClusteringPass<'_>) -> Result<Membership> {
    let range = vertices_of(pass);
    let coming = match &pass.job {
        StreamJob::Whole | StreamJob::Range(..) => range.end - range.start,
        StreamJob::Group(shares, number, _) => shares.vertices_of_group(pass.grid, *number),
    };
    let members = Membership::new(pass.grid, pass.model.info(), coming, pass.noted, pass.folder)?;
    if let StreamJob::Range(..) = pass.job {
        let leaves = members.leaves();
        let mut others = (0..pass.grid.keys.len() as u32).filter(|cell| !pass.job.has(*cell));
        others.try_for_each(|cell| leaves.record(cell, 0, &mut [0]))?;
    }
    Ok(members)
}

/// The vertices that are streamed.
fn vertices_of(pass: &ClusteringPass<'_>) -> Range<u64> {
    match &pass.job {
        StreamJob::Range(shares, number, _) => shares.ranges()[*number as usize].clone(),
        StreamJob::Whole | StreamJob::Group(..) => 0..pass.model.info().vertices,
    }
}

/// Number of pieces of the stream.
fn pieces_of(pass: &ClusteringPass<'_>) -> u64 {
    let Range { start, end } = vertices_of(pass);
    match pass.job {
        StreamJob::Group(_, _, reader) => lock(reader).records(),
        StreamJob::Whole | StreamJob::Range(..) => (end - start).div_ceil(PIECE),
    }
}

/// Bytes that are streamed, about.
fn bytes_of(pass: &ClusteringPass<'_>) -> u64 {
    let info = pass.model.info();
    let Range { start, end } = vertices_of(pass);
    match &pass.job {
        StreamJob::Whole => info.vertex_bytes,
        StreamJob::Range(..) => {
            (info.vertex_bytes as f64 * ((end - start) as f64 / info.vertices.max(1) as f64)) as u64
        }
        StreamJob::Group(_, _, reader) => lock(reader).bytes(),
    }
}

/// Open cells, dealt out to the gatherer of each part of them.
fn shards<G: Gather>(pass: &ClusteringPass<'_>, gather: Vec<G>) -> Vec<Mutex<CellShard<G>>> {
    let own = |(cell, record): (u32, &CellRecord)| if pass.job.has(cell) { record.count } else { 0 };
    let left = deal((0..).zip(&pass.grid.records).map(own), gather.len());
    let cells = pass.grid.keys.len();
    let shard = |(gather, left): (G, Vec<u64>)| CellShard {
        gather,
        items: vec![0; left.len()],
        ranges: Ranges::of_part(left.len(), cells),
        left,
        at: 0,
        complete: None,
    };
    gather.into_iter().zip(left).map(shard).map(Mutex::new).collect()
}

/// Streams the vertices; `false` if there was no room.
fn stream<G: Gather>(pass: &ClusteringPass<'_>, gather: Vec<G>, found: &mut Clustered) -> Result<bool> {
    let Clustered { forest, hash, ranges, items, jumps, membership, picked } = found;
    let vertices = vertices_of(pass);
    let threads = rayon::current_num_threads();
    let in_order = !pass.model.info().reads_exactly() && !matches!(pass.job, StreamJob::Group(..));
    let reader = in_order.then(|| positions_of(pass, vertices.clone())).transpose()?;
    let pieces = pieces_of(pass);
    let shards = shards(pass, gather);
    let stream = Stream {
        pass,
        leaves: membership.as_ref().map(Membership::leaves),
        stop: AtomicU32::new(pass.bound.to_bits()),
        vertices,
        reading: Mutex::new(StreamReading { next: 0, reader }),
        schedule: Schedule::new(Tasks::new(pieces, threads as u64 + WAITING, shards.len(), MAX_QUEUED)),
        shards,
        finishing: Mutex::new(Finishing {
            hash,
            jumps,
            membership: membership.as_mut(),
            picked: picked.as_mut(),
        }),
        forest: Mutex::new((forest, true)),
        workspaces: Mutex::new(Vec::new()),
    };
    thread::scope(|scope| {
        (1..threads).for_each(|_| {
            scope.spawn(|| stream.go_on());
        });
        stream.go_on();
    });
    let Stream { shards, schedule, .. } = stream;
    match schedule.into_stopped() {
        Some(Stopped::NoRoom) => return Ok(false),
        Some(Stopped::Failed(error)) => return Err(error),
        None => {}
    }
    let shards: Vec<CellShard<G>> =
        shards.into_iter().map(|shard| shard.into_inner().unwrap_or_else(PoisonError::into_inner)).collect();
    if shards.iter().flat_map(|shard| &shard.left).any(|n| *n > 0) {
        return Err(changed(pass.model));
    }
    let (of_items, of_ranges): (Vec<_>, Vec<_>) =
        shards.into_iter().map(|shard| (shard.items, shard.ranges.into_cells())).unzip();
    (*items, *ranges) = (gathered_up(of_items), gathered_up(of_ranges));
    Ok(true)
}

/// Notes that the stream is in a cell from the first of these vertices on; `false` if it was there before.
/// Vertices before the first visit of a piece are of no cell, so that ranges follow from the pieces, whoever
/// reads which of them.
fn note_visit(visits: &mut Vec<(u32, Range<u64>)>, cell: u32, vertices: &Range<u64>) -> bool {
    if let Some((last, visited)) = visits.last_mut() {
        if *last == cell {
            return false;
        }
        visited.end = vertices.start;
    }
    visits.push((cell, vertices.clone()));
    true
}

/// The cell that the stream is in.
struct EnteredCell {
    key: CellKey,
    /// Box that is surely inside the cell, once the stream has stayed in it; empty before, as a stream in no
    /// order does not stay.
    inside: Bounds,
    cell: u32,
    /// Whether the cell is clustered by this job.
    is_own: bool,
}

/// Deals the items of each cell out to shards.
fn deal<T>(of_cells: impl Iterator<Item = T>, shards: usize) -> Vec<Vec<T>> {
    let mut dealt: Vec<Vec<T>> = (0..shards).map(|_| Vec::new()).collect();
    of_cells.enumerate().for_each(|(cell, of_cell)| dealt[cell % shards].push(of_cell));
    dealt
}

/// Items that were [dealt](deal) out, in the order of cells.
fn gathered_up<T>(dealt: Vec<Vec<T>>) -> Vec<T> {
    let cells = dealt.iter().map(Vec::len).sum();
    let mut shards: Vec<_> = dealt.into_iter().map(Vec::into_iter).collect();
    let count = shards.len();
    (0..cells).filter_map(|cell| shards[cell % count].next()).collect()
}

/// A call of [`stream`].
struct Stream<'a, G: Gather> {
    pass: &'a ClusteringPass<'a>,
    leaves: Option<Arc<Leaves>>,
    /// Error down to which cells are clustered by now, as bits.
    stop: AtomicU32,
    /// The vertices that are streamed.
    vertices: Range<u64>,
    reading: Mutex<StreamReading<'a>>,
    /// A cell is of the shard of its number modulo theirs.
    shards: Vec<Mutex<CellShard<G>>>,
    finishing: Mutex<Finishing<'a>>,
    /// Forest that takes all trees in, and whether it has none yet.
    forest: Mutex<(&'a mut Forest, bool)>,
    workspaces: Mutex<Vec<TreeWorkspace<G::Item>>>,
    schedule: Schedule<StreamPiece<G::Piece>, Complete<G>>,
}

/// Complete cell, and the items that were gathered of it.
type Complete<G> = (u32, CellItems<<G as Gather>::Item>);

struct StreamReading<'a> {
    /// Number of the piece that is read next.
    next: u64,
    /// Reader of all vertices, where they are read best in their order.
    reader: Option<Box<dyn VertexReader + 'a>>,
}

/// A part of the open cells, into which pieces are merged in the order of the stream. A cell is counted by
/// its number divided by that of shards.
struct CellShard<G> {
    gather: G,
    /// Vertices of each cell that are still to come.
    left: Vec<u64>,
    /// Number of items of each cell in the end.
    items: Vec<u32>,
    /// Ranges of the stream with each cell's vertices.
    ranges: Ranges,
    /// Items that are merged of those that the next piece has for the shard.
    at: usize,
    /// A cell that is complete, for which there was no room yet.
    complete: Option<u32>,
}

/// Sums over the pieces, added up in the order of the stream.
struct Finishing<'a> {
    hash: &'a mut HashedStream,
    jumps: &'a mut Jumps,
    membership: Option<&'a mut Membership>,
    picked: Option<&'a mut Picked>,
}

/// Consecutive vertices of the model.
struct StreamPiece<P: GatherPiece> {
    /// The chunks as they were read.
    chunks: Vec<VertexChunk>,
    gatherer: P,
    /// Items that were gathered, once they all are, and the cell of each.
    gathered: Vec<(u32, P::Item)>,
    /// The item that each vertex is part of, if it shall be known; [`NONE`] where the vertex is not finite.
    items: Vec<u32>,
    /// Local positions of the vertices, if they are recorded.
    positions: Vec<Vec3>,
    /// The vertices whose colours are kept.
    picks: Vec<Pick>,
    lists: ColorLists,
    /// Places of the items for the cells of each shard, and of the visits there, if there are several shards.
    of_shards: Vec<[Vec<u32>; 2]>,
    /// Place of each item in its cell, if members are recorded, once the item is merged.
    places: Vec<AtomicU32>,
    /// Cells that the stream enters, each with the vertices up to where the stream leaves it.
    visits: Vec<(u32, Range<u64>)>,
    /// Jumps between these cells.
    jumps: Jumps,
    /// Vertices of the piece in cells that others cluster, and the records that are written down of them.
    shared: SharedPiece,
    records: Vec<(u32, Vec<u8>)>,
    /// Number of bytes that were read in the place of the model.
    bytes: u64,
}

/// No item.
const NONE: u32 = u32::MAX;

/// The bit with which the number of a cell that others cluster is noted for its vertices: pieces have
/// fewer items, and grids fewer cells.
const OF_OTHERS: u32 = 1 << 31;

impl<'a, G: Gather> Stream<'a, G> {
    /// Does tasks as long as there are any.
    fn go_on(&self) {
        while let Some(task) = self.schedule.take() {
            let done = catch_unwind(AssertUnwindSafe(|| match task {
                Task::Gather(spare) => self.gather(spare),
                Task::Merge(shard, piece) => self.merge(shard, piece),
                Task::Finish(piece) => self.finish(piece),
                Task::Cluster((cell, items)) => self.cluster(cell, items),
            }));
            if let Err(error) = done.unwrap_or_else(|_| Err(panicked())) {
                self.schedule.tasks().stop(Stopped::Failed(error));
            }
        }
    }

    /// Reads a piece and gathers it.
    fn gather(&self, spare: Option<StreamPiece<G::Piece>>) -> Result<()> {
        self.pass.progress.check()?;
        let mut piece = spare.unwrap_or_else(|| self.piece());
        piece.clear();
        let number = if let StreamJob::Group(_, _, reader) = self.pass.job {
            let number = {
                let mut reading = lock(&self.reading);
                piece.bytes = lock(reader).read(&mut piece.shared)?;
                reading.next += 1;
                reading.next - 1
            };
            self.put_shared_in_cells(&mut piece)?;
            number
        } else {
            let (number, vertices) = self.read(&mut piece.chunks)?;
            self.put_in_cells(&mut piece, vertices.end)?;
            number
        };
        piece.deal(self.shards.len(), self.leaves.is_some());
        self.schedule.tasks().gathered(number, piece);
        Ok(())
    }

    fn piece(&self) -> StreamPiece<G::Piece> {
        StreamPiece {
            chunks: Vec::new(),
            gatherer: lock(&self.shards[0]).gather.piece(),
            gathered: Vec::new(),
            of_shards: Vec::new(),
            places: Vec::new(),
            items: Vec::new(),
            positions: Vec::new(),
            picks: Vec::new(),
            lists: ColorLists::default(),
            visits: Vec::new(),
            jumps: Jumps::default(),
            shared: SharedPiece::default(),
            records: Vec::new(),
            bytes: 0,
        }
    }

    /// Reads the vertices of the next piece; returns its number, and the range of the vertices.
    fn read(&self, chunks: &mut Vec<VertexChunk>) -> Result<(u64, Range<u64>)> {
        let mut reading = lock(&self.reading);
        let number = reading.next;
        reading.next += 1;
        let start = self.vertices.start + number * PIECE;
        let range = start..(start + PIECE).min(self.vertices.end);
        match &mut reading.reader {
            Some(reader) => read_all(&mut **reader, range.clone(), chunks, self.pass)?,
            None => {
                drop(reading);
                let mut reader = positions_of(self.pass, range.clone())?;
                read_all(&mut *reader, range.clone(), chunks, self.pass)?;
            }
        }
        Ok((number, range))
    }

    /// Leaves out the splats of a chunk in which nobody sees a surface, and picks vertices for their colours.
    fn look_at_attributes(
        &self,
        chunk: &mut VertexChunk,
        lists: &mut ColorLists,
        picks: &mut Vec<Pick>,
    ) -> Result<()> {
        let ClusteringPass { model, frame, opaque, picking, .. } = self.pass;
        if let Some(opaque) = opaque {
            opaque.leave_out(*model, chunk)?;
        }
        if let Some(picking) = picking {
            picking.pick(*model, frame, chunk, lists, picks)?;
        }
        Ok(())
    }

    /// The cell at a place.
    fn enter(&self, p: DVec3, current: Option<EnteredCell>) -> Result<EnteredCell> {
        let ClusteringPass { model, grid, job, .. } = self.pass;
        let key = grid.key_of(p);
        if let Some(stayed_in) = current.filter(|entered| entered.key == key) {
            return Ok(EnteredCell { inside: cell_box(key, grid.level), ..stayed_in });
        }
        let cell = grid.find(&key).ok_or_else(|| changed(*model))?;
        Ok(EnteredCell { key, inside: Bounds::default(), cell, is_own: job.has(cell) })
    }

    /// Puts each vertex of a piece, which ends before a vertex, into its cell.
    fn put_in_cells(&self, piece: &mut StreamPiece<G::Piece>, end: u64) -> Result<()> {
        let ClusteringPass { frame, noted, .. } = *self.pass;
        let with_items = self.leaves.is_some();
        let StreamPiece { chunks, gatherer, items, positions, picks, lists, visits, shared, .. } = piece;
        let mut note = |item: u32, local: Vec3| {
            if with_items {
                items.push(item);
            }
            if noted.positions {
                positions.push(local);
            }
        };
        let mut current: Option<EnteredCell> = None;
        for chunk in chunks {
            self.look_at_attributes(chunk, lists, picks)?;
            for (i, p) in chunk.positions.iter().enumerate() {
                let (cell, is_own) = match &current {
                    Some(entered) if entered.inside.contains(*p) => (entered.cell, entered.is_own),
                    _ if !p.is_finite() => {
                        note(NONE, Vec3::NAN);
                        continue;
                    }
                    _ => {
                        let entered = self.enter(*p, current.take())?;
                        let EnteredCell { cell, is_own, .. } = *current.insert(entered);
                        let vertices = chunk.first + i as u64..end;
                        if note_visit(visits, cell, &vertices) && !is_own {
                            gatherer.leave();
                            shared.visits.push(Visit { cell, vertices, finite: 0 });
                        }
                        (cell, is_own)
                    }
                };
                let normal = chunk.normals.get(i).map_or(Vec3::ZERO, |n| unit(*n));
                let local = frame.to_local(*p);
                let item = if is_own {
                    gatherer.add(cell, local, normal)
                } else {
                    shared.add(local, normal);
                    OF_OTHERS | cell
                };
                note(item, local);
            }
            // Nothing but the bytes is needed any more, unless positions are compared.
            chunk.normals = Vec::new();
            if !noted.twins {
                chunk.positions = Vec::new();
            }
        }
        self.record_shared(piece)
    }

    /// Writes down the vertices of a piece in cells that others cluster, where units of work cluster ranges.
    fn record_shared(&self, piece: &mut StreamPiece<G::Piece>) -> Result<()> {
        let ClusteringPass { model, job, .. } = self.pass;
        let StreamJob::Range(shares, ..) = job else { return Ok(()) };
        let StreamPiece { visits, shared, records, .. } = piece;
        let mut ends = visits.iter().filter(|(cell, _)| !job.has(*cell)).map(|(_, vertices)| vertices.end);
        shared.visits.iter_mut().zip(&mut ends).for_each(|(visit, end)| visit.vertices.end = end);
        let group_of = |cell| match shares.owner(cell) {
            Owner::Group(group) => Some(group),
            // The cell's vertices were elsewhere when they were counted.
            Owner::Range(_) => None,
        };
        *records = shared.records(group_of).ok_or_else(|| changed(*model))?;
        Ok(())
    }

    /// Puts the vertices that ranges have written down for shared cells into these.
    fn put_shared_in_cells(&self, piece: &mut StreamPiece<G::Piece>) -> Result<()> {
        let with_items = self.leaves.is_some();
        let StreamPiece { gatherer, items, visits, shared, .. } = piece;
        let SharedPiece { visits: from, positions, normals } = shared;
        let (mut vertices, mut last) = (positions.iter().zip(normals.iter()), None);
        for Visit { cell, vertices: range, finite } in from {
            if *cell as usize >= self.pass.grid.keys.len() || !self.pass.job.has(*cell) {
                return Err(changed(self.pass.model));
            }
            // Between two visits the stream was elsewhere.
            if last.replace(range.end).is_some() {
                gatherer.leave();
            }
            visits.push((*cell, range.clone()));
            vertices.by_ref().take(*finite as usize).for_each(|(position, normal)| {
                let item = gatherer.add(*cell, *position, *normal);
                if with_items {
                    items.push(item);
                }
            });
        }
        Ok(())
    }

    /// Merges the items that the piece that comes next in the stream has for the cells of a shard into these,
    /// until too many of the cells wait to be clustered.
    fn merge(&self, shard: usize, piece: Arc<StreamPiece<G::Piece>>) -> Result<()> {
        let mut merging = lock(&self.shards[shard]);
        let of_shard = piece.of_shards.get(shard);
        let has_all = match of_shard {
            Some([own, _]) => {
                self.merge_items(&mut merging, &piece, own.iter().map(|item| *item as usize))?
            }
            None => self.merge_items(&mut merging, &piece, 0..piece.gathered.len())?,
        };
        if has_all {
            merging.at = 0;
            match of_shard {
                Some([_, own]) => {
                    self.note_ranges(&mut merging, own.iter().map(|visit| &piece.visits[*visit as usize]));
                }
                None => self.note_ranges(&mut merging, &piece.visits),
            }
        }
        drop(merging);
        // The thread that finishes the piece has it alone.
        drop(piece);
        self.schedule.tasks().merged(shard, has_all);
        Ok(())
    }

    /// Notes where the vertices of a shard's cells are.
    fn note_ranges<'b>(
        &self,
        shard: &mut CellShard<G>,
        visits: impl IntoIterator<Item = &'b (u32, Range<u64>)>,
    ) {
        for (cell, vertices) in visits.into_iter().filter(|(cell, _)| self.pass.job.has(*cell)) {
            shard.ranges.add(cell / self.shards.len() as u32, vertices.clone());
        }
    }

    /// Merges items of a piece into a shard; `false` if some found no room or have to wait.
    fn merge_items(
        &self,
        shard: &mut CellShard<G>,
        piece: &StreamPiece<G::Piece>,
        own: impl ExactSizeIterator<Item = usize>,
    ) -> Result<bool> {
        if !self.hand_over(shard) {
            return Ok(false);
        }
        let (items, count) = (&piece.gathered, own.len());
        for item in own.skip(shard.at) {
            shard.at += 1;
            let (cell, item, place) = (items[item].0, &items[item].1, piece.places.get(item));
            let of_shard = cell / self.shards.len() as u32;
            let Some(index) = shard.gather.merge(of_shard, item)? else {
                self.schedule.tasks().stop(Stopped::NoRoom);
                return Ok(false);
            };
            if let Some(place) = place {
                place.store(index, Ordering::Relaxed);
            }
            let left = &mut shard.left[of_shard as usize];
            *left = left.checked_sub(item.vertices().into()).ok_or_else(|| changed(self.pass.model))?;
            if *left == 0 {
                shard.complete = Some(cell);
                if !self.hand_over(shard) {
                    break;
                }
            }
        }
        Ok(shard.at == count && shard.complete.is_none())
    }

    /// Lets the complete cell of a shard be clustered, if it has one; `false` if there is no room for it yet.
    fn hand_over(&self, shard: &mut CellShard<G>) -> bool {
        let Some(cell) = shard.complete else { return true };
        let of_shard = cell / self.shards.len() as u32;
        if !self.schedule.tasks().reserve(shard.gather.bytes(of_shard)) {
            return false;
        }
        shard.complete = None;
        let items = shard.gather.take(of_shard);
        shard.items[of_shard as usize] = u32::try_from(items.count()).unwrap_or(u32::MAX);
        self.schedule.hand_over((cell, items));
        true
    }

    /// Finishes the piece that comes next in the stream, which all shards have merged.
    fn finish(&self, piece: Arc<StreamPiece<G::Piece>>) -> Result<()> {
        let mut finishing = lock(&self.finishing);
        let Finishing { hash, jumps, membership, picked } = &mut *finishing;
        jumps.follow(&piece.jumps);
        if let Some(members) = membership {
            self.note_members(members, &piece)?;
        }
        if let Some(picked) = picked {
            picked.add(&piece.picks)?;
        }
        if let StreamJob::Range(_, _, writer) = self.pass.job {
            lock(writer).append(&piece.records)?;
        }
        for chunk in &piece.chunks {
            hash.update(chunk.raw());
            self.pass.progress.advance(chunk.raw().len() as u64);
        }
        self.pass.progress.advance(piece.bytes);
        drop(finishing);
        self.schedule.tasks().finished(Arc::into_inner(piece));
        Ok(())
    }

    /// Notes which item each vertex of a piece is part of.
    fn note_members(&self, members: &mut Membership, piece: &StreamPiece<G::Piece>) -> Result<()> {
        piece.chunks.iter().try_for_each(|chunk| members.look_for_twins(&chunk.positions))?;
        if let (StreamJob::Group(shares, ..), Some((_, first))) = (self.pass.job, piece.visits.first()) {
            members.begin_list(shares.range_of(first.start));
        }
        let mut positions = piece.positions.iter();
        for item in &piece.items {
            let position = positions.next().copied().unwrap_or(Vec3::NAN);
            let place = match piece.places.get(*item as usize) {
                Some(place) => Some((piece.gathered[*item as usize].0, place.load(Ordering::Relaxed))),
                None if *item == NONE => None,
                None => Some((*item & !OF_OTHERS, 0)),
            };
            members.push(place, position)?;
        }
        Ok(())
    }

    /// Clusters a cell, and takes its tree in: as they come, for the bound that they raise shortens the work
    /// on the rest.
    fn cluster(&self, cell: u32, items: CellItems<G::Item>) -> Result<()> {
        let bytes = items.bytes();
        let mut workspace = lock(&self.workspaces).pop().unwrap_or_default();
        let clustered = self.pass.cluster(cell, items, &self.stop, self.leaves.as_deref(), &mut workspace);
        lock(&self.workspaces).push(workspace);
        let taken = clustered.and_then(|cell| self.collect(cell));
        self.schedule.tasks().clustered(bytes);
        taken
    }

    fn collect(&self, cell: ClusteredCell) -> Result<()> {
        let mut forest = lock(&self.forest);
        let (forest, first) = &mut *forest;
        let ClusteringPass { grid, frame, progress, .. } = *self.pass;
        let threshold = f32::from_bits(self.stop.load(Ordering::Relaxed));
        let visit = |visit: Visitor<'_>| {
            cell.tree.cut(threshold, |node| visit(node.position, node.normal));
        };
        progress.emerge(&Emerging::new(*first, &grid.bounds, frame, &visit));
        *first = false;
        self.stop.store(forest.add(cell)?.to_bits(), Ordering::Relaxed);
        Ok(())
    }
}

impl<P: GatherPiece> StreamPiece<P> {
    /// Ends gathering, and finds the items that are of the cells of each shard.
    fn deal(&mut self, shards: usize, with_places: bool) {
        let Self { gatherer, gathered, of_shards, places, visits, jumps, .. } = self;
        *gathered = gatherer.end();
        if shards > 1 {
            of_shards.resize_with(shards, Default::default);
            let of_items = gathered.iter().map(|(cell, _)| *cell);
            of_items.zip(0..).for_each(|(cell, item)| of_shards[cell as usize % shards][0].push(item));
            let of_visits = visits.iter().map(|(cell, _)| *cell);
            of_visits.zip(0..).for_each(|(cell, visit)| of_shards[cell as usize % shards][1].push(visit));
        }
        visits.iter().for_each(|(cell, _)| jumps.visit(*cell));
        if with_places {
            places.resize_with(gathered.len(), AtomicU32::default);
        }
    }

    fn clear(&mut self) {
        self.gatherer.begin(std::mem::take(&mut self.gathered));
        self.of_shards.iter_mut().flatten().for_each(Vec::clear);
        self.places.clear();
        self.items.clear();
        self.positions.clear();
        self.picks.clear();
        self.visits.clear();
        self.jumps = Jumps::default();
        self.shared.clear();
        self.records.clear();
        self.bytes = 0;
    }
}

fn positions_of<'a>(pass: &ClusteringPass<'a>, range: Range<u64>) -> Result<Box<dyn VertexReader + 'a>> {
    let mut reader = pass.model.vertices(range)?;
    match (pass.picking, pass.opaque) {
        (_, Some(_)) => {}
        (None, None) => reader.skip_attributes(),
        (Some(_), None) => reader.skip_all_but_colors(),
    }
    Ok(reader)
}

/// Reads all vertices of a range, from where the reader is.
fn read_all(
    reader: &mut dyn VertexReader,
    range: Range<u64>,
    chunks: &mut Vec<VertexChunk>,
    pass: &ClusteringPass<'_>,
) -> Result<()> {
    let (mut used, mut at) = (0, range.start);
    while at < range.end {
        if used == chunks.len() {
            chunks.push(VertexChunk::default());
        }
        reader.set_chunk((range.end - at) as usize);
        if !reader.read(&mut chunks[used])? {
            return Err(changed(pass.model));
        }
        at += chunks[used].len() as u64;
        used += 1;
    }
    chunks.truncate(used);
    Ok(())
}

/// Content of a mutex, whatever became of the thread that had it: a failure ends the work.
fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A thread panicked.
fn panicked() -> Error {
    Error::internal("clustering a cell failed").hinting("this is a bug: please report it, with the model")
}
