//! Content of a cell while it is open: its single vertices, or small groups of them.
//!
//! Single vertices take memory by the number of vertices in open cells, which grows with the model. Where
//! that is too much, vertices in the same little cube are summed up as they come ([`Group`]): a cell then
//! holds as many groups as the surface in it meets cubes, however many vertices the model has.

use std::collections::HashMap;
use std::hash::BuildHasherDefault;
use std::path::Path;

use glam::{IVec3, Vec3};
use serde::Serialize;
use simod_model::Result;
use simod_model::frame::Frame;

use super::Target;
use super::cluster::{Element, Group, GroupSums, Vertex};
use super::grid::{CellHasher, CellRecord, Grid};
use super::open_cells::{BLOCK, CellItems, OpenCells};
use super::shares::PIECE;

/// Memory for the vertices of open cells beyond which they are summed up in groups, if that takes less.
const VERTICES_AT_EASE: u64 = 12 << 20;

/// The factor by which the groups that are expected are too many, where there are surely no fewer than find
/// room.
const SURELY_TOO_MANY: u64 = 4;

/// Groups for each sample of P_S: a cluster is then about as well formed as from the vertices themselves.
const GROUPS_PER_SAMPLE: f64 = 12.0;

/// Most levels of little cubes below a cell, so that its groups are few enough to be clustered at once.
const MAX_LEVEL: u32 = 6;

/// Bytes of a group, with its place in the table of its cell.
const GROUP_BYTES: u64 = size_of::<Group>() as u64 + 18;

/// Holder of the vertices, or groups, of each open cell.
pub trait Gather: Send {
    /// Element of a cell's VS-Tree.
    type Item: Element;
    /// Gatherer of a piece of the stream, apart from all others.
    type Piece: GatherPiece<Item = Self::Item>;

    /// Gatherer that has gathered nothing yet.
    fn piece(&self) -> Self::Piece;

    /// Adds an item of a piece to a cell; returns the index of the cell's item that it is, or is part of.
    /// Pieces come in the order of the stream, and their items in theirs. `None` if there is no room.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    fn merge(&mut self, cell: u32, item: &Self::Item) -> Result<Option<u32>>;

    /// Memory that all items of a cell take, in bytes, also those in a file: they will be read, and their
    /// trees held.
    fn bytes(&self, cell: u32) -> usize;

    /// Removes all items of a cell.
    fn take(&mut self, cell: u32) -> CellItems<Self::Item>;
}

/// Gathers the vertices of one piece of the stream.
///
/// Memory: an item for each of its vertices at most, with 20 bytes to find it by.
pub trait GatherPiece: Send + Sync {
    /// The items that are gathered.
    type Item: Element;

    /// Adds a vertex to a cell; returns the piece's item that it is, or is part of.
    fn add(&mut self, cell: u32, position: Vec3, normal: Vec3) -> u32;

    /// The stream was in a cell that is not gathered: the next vertex is looked up as if it were so here.
    fn leave(&mut self);

    /// Ends the piece: all that was gathered, with the cell of each item, in the order in which items were
    /// begun.
    fn end(&mut self) -> Vec<(u32, Self::Item)>;

    /// Forgets everything, for the next piece, whose items take the memory of former ones.
    fn begin(&mut self, memory: Vec<(u32, Self::Item)>);
}

/// Holder of single vertices.
pub struct VertexGather(OpenCells<Vertex>);

impl VertexGather {
    /// Holder for `cells` cells, in `memory` bytes and otherwise in a file in `folder`.
    pub fn new(cells: usize, memory: u64, folder: &Path) -> Self {
        Self(OpenCells::new(cells, memory, folder))
    }
}

impl Gather for VertexGather {
    type Item = Vertex;
    type Piece = PieceVertices;

    fn piece(&self) -> PieceVertices {
        PieceVertices::default()
    }

    #[inline]
    fn merge(&mut self, cell: u32, vertex: &Vertex) -> Result<Option<u32>> {
        // The index is asked for where there are fewer than 2^32 vertices.
        let index = self.0.count(cell) as u32;
        self.0.push(cell, Vertex { index, ..*vertex })?;
        Ok(Some(index))
    }

    fn bytes(&self, cell: u32) -> usize {
        self.0.bytes(cell)
    }

    fn take(&mut self, cell: u32) -> CellItems<Vertex> {
        self.0.take(cell)
    }
}

/// Single vertices of a piece.
#[derive(Default)]
pub struct PieceVertices(Vec<(u32, Vertex)>);

impl GatherPiece for PieceVertices {
    type Item = Vertex;

    #[inline]
    fn add(&mut self, cell: u32, position: Vec3, normal: Vec3) -> u32 {
        self.0.push((cell, Vertex { position, normal, index: 0 }));
        self.0.len() as u32 - 1
    }

    fn leave(&mut self) {}

    fn end(&mut self) -> Vec<(u32, Vertex)> {
        std::mem::take(&mut self.0)
    }

    fn begin(&mut self, memory: Vec<(u32, Vertex)>) {
        self.0 = memory;
        self.0.clear();
    }
}

/// Vertices summed up in little cubes. They stay in memory: sums that were parted by a file would be other
/// sums.
pub struct GroupGather {
    open: OpenCells<Group>,
    edge: f32,
    tables: Vec<Option<CubeGroups>>,
    /// Tables of closed cells, to be filled again.
    spare: Vec<CubeGroups>,
}

/// Place among the open cells' groups of each group of a cell, by the [`key`] of its cube and a number of up
/// to eight for groups of one cube.
type CubeGroups = HashMap<u32, u32, BuildHasherDefault<CellHasher>>;

impl GroupGather {
    /// Holder for `cells` cells, with cubes of this edge, in `memory` bytes.
    pub fn new(cells: usize, edge: f32, memory: u64) -> Self {
        let mut tables = Vec::new();
        tables.resize_with(cells, || None);
        // The tables take their part of the memory.
        let memory = memory / GROUP_BYTES * size_of::<Group>() as u64;
        Self { open: OpenCells::new(cells, memory, Path::new("")), edge, tables, spare: Vec::new() }
    }
}

impl Gather for GroupGather {
    type Item = Group;
    type Piece = PieceGroups;

    fn piece(&self) -> PieceGroups {
        PieceGroups::new(self.edge)
    }

    fn merge(&mut self, cell: u32, group: &Group) -> Result<Option<u32>> {
        let spare = &mut self.spare;
        let table = self.tables[cell as usize].get_or_insert_with(|| spare.pop().unwrap_or_default());
        let mut key = key(floor(group.center() * (1.0 / self.edge)));
        for _ in 0..SHEETS {
            let Some(place) = table.get(&key) else { break };
            let known = self.open.at_mut(*place);
            if known.takes(group) {
                known.add(group);
                return Ok(Some(known.index()));
            }
            key += NEXT_SHEET;
        }
        if !self.open.has_room(cell) {
            return Ok(None);
        }
        let index = self.open.count(cell) as u32;
        table.insert(key, self.open.push(cell, group.with_index(index))?);
        Ok(Some(index))
    }

    fn bytes(&self, cell: u32) -> usize {
        self.open.bytes(cell)
    }

    fn take(&mut self, cell: u32) -> CellItems<Group> {
        if let Some(mut table) = self.tables[cell as usize].take() {
            table.clear();
            self.spare.push(table);
        }
        self.open.take(cell)
    }
}

/// Whether groups find room in `memory` bytes, if each cell has the given number of them in the end; the room
/// while they are gathered depends on who gathers which cells.
pub fn find_room(records: &[CellRecord], groups: &[u32], memory: u64) -> bool {
    groups_find_room(records, groups, GroupGather::new(0, 1.0, memory).open.blocks())
}

/// Whether the groups of all cells that are open at a time have room in `blocks` blocks. A cell counts with
/// all groups that it has in the end, and in all of each piece of the stream that it is open in, so that no
/// order in which pieces or cells are gathered finds less room than this.
fn groups_find_room(records: &[CellRecord], groups: &[u32], blocks: u64) -> bool {
    let in_pieces = |r: &CellRecord| CellRecord { first: r.first / PIECE, last: r.last / PIECE, ..*r };
    let records: Vec<_> = records.iter().map(in_pieces).collect();
    most_open(&records, |cell| u64::from(groups[cell]).div_ceil(BLOCK as u64)) <= blocks
}

/// The vertices of a piece, summed up in little cubes.
pub struct PieceGroups {
    edge: f32,
    /// The inverse of the edge: a division for each vertex would take as long as all else.
    per_edge: f32,
    items: Vec<(u32, Group)>,
    /// Group of the same cell that was begun next after each group.
    next: Vec<u32>,
    /// The number of groups of each cell, and the one that was begun last.
    cells: HashMap<u32, (u32, u32), BuildHasherDefault<CellHasher>>,
    /// Place in `items` of each group, by its cell, the [`key`] of its cube, and a number of up to eight for
    /// groups of one cube.
    table: HashMap<u64, u32, BuildHasherDefault<CellHasher>>,
    last: Option<Last>,
}

/// No group.
const NONE: u32 = u32::MAX;

/// Cube and group of the last vertex: the next one is probably near.
struct Last {
    cell: u32,
    cube: IVec3,
    place: u32,
    /// Sums of the group so far, which are written back when another one follows.
    sums: GroupSums,
}

impl PieceGroups {
    /// Empty groups, with cubes of this edge.
    pub fn new(edge: f32) -> Self {
        Self {
            edge,
            per_edge: 1.0 / edge,
            items: Vec::new(),
            next: Vec::new(),
            cells: HashMap::default(),
            table: HashMap::default(),
            last: None,
        }
    }

    /// Adds a vertex to a group of its cube other than the last one.
    #[inline(never)]
    fn find_and_add(&mut self, cell: u32, cube: IVec3, position: Vec3, normal: Vec3) -> u32 {
        self.leave();
        let mut key = u64::from(cell) << 32 | u64::from(key(cube));
        let mut found = None;
        for _ in 0..SHEETS {
            let Some(place) = self.table.get(&key) else { break };
            if self.items[*place as usize].1.sums().takes(normal) {
                found = Some(*place);
                break;
            }
            key += u64::from(NEXT_SHEET);
        }
        let place = found.unwrap_or_else(|| self.begin(cell, cube, key));
        let mut sums = self.items[place as usize].1.sums();
        sums.add(position, normal);
        self.last = Some(Last { cell, cube, place, sums });
        place
    }

    fn begin(&mut self, cell: u32, cube: IVec3, key: u64) -> u32 {
        let place = self.items.len() as u32;
        let (count, last) = self.cells.entry(cell).or_insert((0, NONE));
        let group = Group::new(middle(cube, self.edge), 0.5 * self.edge, *count);
        if let Some(next) = self.next.get_mut(*last as usize) {
            *next = place;
        }
        (*count, *last) = (*count + 1, place);
        self.items.push((cell, group));
        self.next.push(NONE);
        self.table.insert(key, place);
        place
    }
}

impl GatherPiece for PieceGroups {
    type Item = Group;

    // The method is always inlined, as a position that is stored by two numbers and one for a call, and read
    // otherwise, has to be waited for.
    #[inline(always)]
    fn add(&mut self, cell: u32, position: Vec3, normal: Vec3) -> u32 {
        let cube = floor(position * self.per_edge);
        if let Some(last) = &mut self.last
            && last.cell == cell
        {
            if last.cube != cube {
                // A stream that went from this cube to another does so again: the group that was begun next
                // is tried first.
                let index = self.items[last.place as usize].1.index();
                let next = self.next[last.place as usize];
                if !(index as usize + 1).is_multiple_of(BLOCK)
                    && let Some((_, group)) = self.items.get(next as usize)
                    && group.center() == middle(cube, self.edge)
                {
                    let (sums, place) = (group.sums(), last.place);
                    self.items[place as usize].1.set(&last.sums);
                    (last.cube, last.place, last.sums) = (cube, next, sums);
                }
            }
            if last.cube == cube && last.sums.takes(normal) {
                last.sums.add(position, normal);
                return last.place;
            }
        }
        self.find_and_add(cell, cube, position, normal)
    }

    fn leave(&mut self) {
        if let Some(Last { place, sums, .. }) = self.last.take() {
            self.items[place as usize].1.set(&sums);
        }
    }

    fn end(&mut self) -> Vec<(u32, Group)> {
        self.leave();
        std::mem::take(&mut self.items)
    }

    fn begin(&mut self, memory: Vec<(u32, Group)>) {
        self.items = memory;
        self.items.clear();
        self.next.clear();
        self.cells.clear();
        self.table.clear();
        self.last = None;
    }
}

/// Cubes in which the vertices of a model were gathered in groups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cubes {
    /// Edge of the cubes, local units.
    pub edge: f32,
    /// Number of vertices that were gathered at a time: [`PIECE`], or all of them at once by former versions.
    pub piece: u64,
}

/// Groups of one cube that are looked at before another is begun.
const SHEETS: u32 = 8;
const NEXT_SHEET: u32 = 1 << 24;

/// Place of a cube among those of its cell, which are at most 2^[`MAX_LEVEL`] and one along each axis: so a
/// part of the coordinates' digits will do.
fn key(cube: IVec3) -> u32 {
    let [x, y, z] = cube.to_array().map(|x| x as u32 & 0xff);
    x | y << 8 | z << 16
}

#[inline]
fn middle(cube: IVec3, edge: f32) -> Vec3 {
    (cube.as_vec3() + 0.5) * edge
}

/// ⌊x⌋ of numbers that are not large, without the call that it is on older processors.
#[inline]
fn floor(x: Vec3) -> IVec3 {
    let towards_zero = x.as_ivec3();
    let above = towards_zero.as_vec3().cmpgt(x);
    IVec3::select(above, towards_zero - 1, towards_zero)
}

/// Form in which the vertices of open cells are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub enum Grouping {
    /// Single vertices, unless too many are held at a time, and groups of them would be fewer.
    #[default]
    Automatic,
    /// Single vertices.
    Never,
    /// Groups, by cubes of 2^-level of a cell; the level is at most 6.
    Level(u32),
}

impl Grouping {
    /// The grouping of a model, of which pass 1 has told when each cell is open: never
    /// [`Grouping::Automatic`]. It does not depend on the machine, but on the `memory` that groups may take,
    /// in bytes.
    pub fn resolve(self, grid: &Grid, frame: &Frame, target: Target, memory: u64) -> Self {
        let resolved = match self {
            Self::Never => Self::Never,
            Self::Level(level) => Self::Level(level.min(MAX_LEVEL)),
            Self::Automatic => {
                let count = |cell: usize| grid.records[cell].count;
                let vertices = size_of::<Vertex>() as u64;
                let vertices = most_open(&grid.records, |cell| count(cell).saturating_mul(vertices));
                level(grid, frame, target).map_or(Self::Never, |level| {
                    // A surface meets about twice as many little cubes as its area has.
                    let cubes = 2 << (2 * level);
                    let groups = most_open(&grid.records, |cell| count(cell).min(cubes) * GROUP_BYTES);
                    let helps = vertices > VERTICES_AT_EASE && 2 * groups < vertices;
                    // Groups that would probably find no room need not be tried.
                    let has_room = groups / SURELY_TOO_MANY <= memory;
                    if helps && has_room { Self::Level(level) } else { Self::Never }
                })
            }
        };
        // Cubes have no size where all vertices are in one place.
        resolved.edge(grid.cell_size(), frame).map_or(Self::Never, |_| resolved)
    }

    /// Whether vertices are in groups.
    pub fn is_level(self) -> bool {
        matches!(self, Self::Level(_))
    }

    /// Edge of the cubes in local units; `None` without groups, or if it is too small to count cubes.
    pub fn edge(self, cell_size: f64, frame: &Frame) -> Option<f32> {
        let Self::Level(level) = self else { return None };
        let edge = (cell_size / frame.scale / f64::from(1u32 << level)) as f32;
        (edge > 1e-6).then_some(edge)
    }
}

/// The level of cubes that are fine enough for the target; `None` if there is none.
fn level(grid: &Grid, frame: &Frame, target: Target) -> Option<u32> {
    match target {
        Target::Samples(n) => {
            let per_cell = GROUPS_PER_SAMPLE * n as f64 / grid.keys.len() as f64;
            let level = (per_cell.max(1.0).log2() / 2.0).round() as u32;
            (level <= MAX_LEVEL).then_some(level)
        }
        Target::Error(e) => {
            // The error of a cube's vertices is about its edge at most, so that no group breaks the bound.
            let edge = 0.5 * e * grid.bounds.diagonal();
            let level = (grid.cell_size() / edge).log2().ceil().max(0.0);
            (edge / frame.scale > 0.0 && level <= f64::from(MAX_LEVEL)).then_some(level as u32)
        }
    }
}

/// Largest sum of `size` over the cells that are open at a time; a cell is open from its first vertex to its
/// last one.
fn most_open(records: &[CellRecord], size: impl Fn(usize) -> u64) -> u64 {
    let mut events: Vec<(u64, bool, u32)> = Vec::with_capacity(2 * records.len());
    for (i, r) in records.iter().enumerate() {
        events.push((r.first, false, i as u32));
        events.push((r.last, true, i as u32));
    }
    events.sort_unstable();
    let (mut now, mut most) = (0u128, 0);
    for (_, closes, i) in events {
        let size = u128::from(size(i as usize));
        if closes {
            now -= size;
        } else {
            now += size;
            most = most.max(now);
        }
    }
    u64::try_from(most).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::cluster::Moments;

    /// The indices of the vertices of three cells, and the items, of a stream in pieces.
    fn gathered<G: Gather>(
        gather: &mut G,
        vertices: &[(u32, Vec3, Vec3)],
        size: usize,
    ) -> Vec<(Vec<u32>, Vec<G::Item>)> {
        let mut indices = vec![Vec::new(); 3];
        let mut piece = gather.piece();
        for vertices in vertices.chunks(size) {
            let of: Vec<u32> = vertices.iter().map(|(cell, p, n)| piece.add(*cell, *p, *n)).collect();
            let merge = |(cell, item): &(u32, G::Item)| {
                gather.merge(*cell, item).expect("no file is written").expect("room")
            };
            let items = piece.end();
            let merged: Vec<u32> = items.iter().map(merge).collect();
            let places = vertices.iter().zip(&of).map(|((cell, ..), item)| (cell, merged[*item as usize]));
            places.for_each(|(cell, index)| indices[*cell as usize].push(index));
            piece.begin(items);
        }
        let items = |cell| {
            let mut items = Vec::new();
            let collect = |part: &mut [G::Item]| {
                items.extend_from_slice(part);
                Ok(())
            };
            gather.take(cell).in_parts(1000, collect).expect("readable");
            items
        };
        let items: Vec<_> = (0..3).map(items).collect();
        indices.into_iter().zip(items).collect()
    }

    /// Two sheets with opposite normals, a thousandth apart, in three cells that take turns.
    fn vertices() -> Vec<(u32, Vec3, Vec3)> {
        let one = |i: u32| {
            let (a, b) = ((i * 7919 % 1000) as f32 / 1000.0, (i.wrapping_mul(104_729) % 997) as f32 / 997.0);
            let up = i.is_multiple_of(2);
            let p = Vec3::new(a - 0.5, if up { 0.001 } else { 0.0 }, b);
            (i % 3, p, if up { Vec3::Y } else { -Vec3::Y })
        };
        (0..60_000).map(one).collect()
    }

    #[test]
    fn groups_add_up_to_the_vertices_of_their_cell() {
        let vertices = vertices();
        let edge = 1.0 / 32.0;
        let whole = gathered(&mut GroupGather::new(3, edge, 1 << 30), &vertices, vertices.len());
        let groups = gathered(&mut GroupGather::new(3, edge, 1 << 30), &vertices, 7000);
        for ((_, whole), (_, groups)) in whole.iter().zip(&groups) {
            let count = |groups: &[Group]| groups.iter().map(|g| g.vertices()).sum::<u32>();
            assert_eq!(count(whole), count(groups));
        }
        for (cell, (indices, groups)) in groups.iter().enumerate() {
            let own: Vec<_> = vertices.iter().filter(|(c, ..)| *c as usize == cell).collect();
            assert!(groups.len() <= 2 * 33 * 33, "{} groups", groups.len());
            assert!(groups.iter().enumerate().all(|(i, g)| g.index() as usize == i));
            for ((_, p, n), i) in own.iter().zip(indices) {
                let group = &groups[*i as usize];
                assert!((group.position() - *p).abs().max_element() <= edge, "{p}");
                assert!(group.normal().dot(*n) > 0.99, "sheets are mixed");
            }
            let all: Vec<_> = own
                .iter()
                .map(|(_, position, normal)| Vertex { position: *position, normal: *normal, index: 0 })
                .collect();
            let (a, b) = (Moments::from_elements(&all), Moments::from_elements(groups));
            assert!(a.mean().distance(b.mean()) < 1e-6 && (a.spread() - b.spread()).abs() < 1e-6);
        }
    }

    #[test]
    fn groups_that_find_no_room_say_so() {
        let mut groups = GroupGather::new(3, 1.0 / 512.0, 0);
        let mut piece = groups.piece();
        vertices().into_iter().for_each(|(cell, p, n)| {
            piece.add(cell, p, n);
        });
        let merge = |(cell, group): &(u32, Group)| groups.merge(*cell, group).expect("no file");
        assert!(piece.end().iter().map(merge).collect::<Vec<_>>().contains(&None));
    }

    #[test]
    fn the_most_that_is_open_is_counted() {
        let record = |first, last| CellRecord { count: last - first + 1, first, last };
        let records = [record(0, 9), record(5, 20), record(9, 9), record(21, 30)];
        assert_eq!(most_open(&records, |_| 1), 3);
        assert_eq!(most_open(&records, |cell| records[cell].count), 10 + 16 + 1);
        assert_eq!(most_open(&[], |_| 1), 0);
    }

    /// A cell has all of its groups from the piece in which it opens to that in which it closes.
    #[test]
    fn room_is_told_by_what_cells_have_in_the_end() {
        let record = |first, last| CellRecord { count: last - first + 1, first, last };
        let block = BLOCK as u32;
        // The second opens in the piece in which the first one closes, the third behind them.
        let records = [record(0, PIECE + 1), record(2 * PIECE - 1, 3 * PIECE), record(4 * PIECE, 5 * PIECE)];
        let groups = [2 * block, block + 1, 3 * block];
        assert!(groups_find_room(&records, &groups, 4));
        assert!(!groups_find_room(&records, &groups, 3));
        // Groups that are counted while they are gathered have no more room.
        assert!(groups_find_room(&records, &[block; 3], 2));
        assert!(find_room(&records, &groups, 1 << 30) && find_room(&records, &[1, 1, 1], 0));
    }
}
