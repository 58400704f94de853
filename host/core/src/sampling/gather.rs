//! What is gathered of a cell while it is open: its vertices as they are, or small groups of them.
//!
//! Vertices as they are take memory by the number of vertices in open cells, which grows with the model. Where
//! that is too much, vertices in the same little cube are summed up as they come ([`Group`]): a cell then
//! holds as many groups as the surface in it meets cubes, however many vertices the model has.

use std::collections::HashMap;
use std::hash::BuildHasherDefault;
use std::path::Path;

use glam::{IVec3, Vec3};
use simod_model::Result;
use simod_model::frame::Frame;

use super::Target;
use super::cluster::{Element, Group, Vertex};
use super::grid::{CellHasher, CellRecord, Grid};
use super::open_cells::{CellItems, OpenCells};

/// Memory for the vertices of open cells beyond which they are summed up in groups, if that helps.
const VERTICES_AT_EASE: u64 = 12 << 20;

/// Groups for each sample of P_S: a cluster is then about as well formed as from the vertices themselves.
const GROUPS_PER_SAMPLE: f64 = 12.0;

/// Most levels of little cubes below a cell, so that its groups are few enough to be clustered at once.
const MAX_LEVEL: u32 = 6;

/// Bytes of a group, with its place in the table of its cell.
const GROUP_BYTES: u64 = size_of::<Group>() as u64 + 18;

/// Holds what the stream has brought of each open cell.
pub trait Gather {
    /// What a cell's VS-Tree is built of.
    type Item: Element;

    /// Adds a vertex to a cell; the index of the item that it is, or is part of. `None` if there is no room.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    fn add(&mut self, cell: u32, position: Vec3, normal: Vec3) -> Result<Option<u32>>;

    /// Removes all items of a cell.
    fn take(&mut self, cell: u32) -> CellItems<Self::Item>;
}

/// Vertices as they are.
pub struct Vertices(OpenCells<Vertex>);

impl Vertices {
    /// For so many cells, in `memory` bytes and otherwise in a file in `folder`.
    pub fn new(cells: usize, memory: u64, folder: &Path) -> Self {
        Self(OpenCells::new(cells, memory, folder))
    }
}

impl Gather for Vertices {
    type Item = Vertex;

    #[inline]
    fn add(&mut self, cell: u32, position: Vec3, normal: Vec3) -> Result<Option<u32>> {
        // Who asks for the index has fewer than 2^32 vertices.
        let index = self.0.count(cell) as u32;
        self.0.push(cell, Vertex { position, normal, index })?;
        Ok(Some(index))
    }

    fn take(&mut self, cell: u32) -> CellItems<Vertex> {
        self.0.take(cell)
    }
}

/// Where the latest group of each cube of a cell is, by [`key`].
type Table = HashMap<u32, u32, BuildHasherDefault<CellHasher>>;

/// Vertices summed up in little cubes. They stay in memory: sums that were parted by a file would be other
/// sums.
pub struct Groups {
    open: OpenCells<Group>,
    edge: f32,
    tables: Vec<Option<Table>>,
    /// Tables of closed cells, to be filled again.
    spare: Vec<Table>,
    last: Option<Last>,
}

impl Groups {
    /// The stream was in a cell that is not gathered: the next vertex is looked up as if it were so here.
    pub fn leave(&mut self) {
        self.last = None;
    }
}

/// Where the last vertex went: the next one is probably near.
struct Last {
    cell: u32,
    cube: IVec3,
    place: u32,
    index: u32,
}

impl Groups {
    /// For so many cells, with cubes of this edge, in `memory` bytes.
    pub fn new(cells: usize, edge: f32, memory: u64) -> Self {
        let mut tables = Vec::new();
        tables.resize_with(cells, || None);
        // The tables take their part of the memory.
        let memory = memory / GROUP_BYTES * size_of::<Group>() as u64;
        Self {
            open: OpenCells::new(cells, memory, Path::new("")),
            edge,
            tables,
            spare: Vec::new(),
            last: None,
        }
    }
}

impl Gather for Groups {
    type Item = Group;

    #[inline]
    fn add(&mut self, cell: u32, position: Vec3, normal: Vec3) -> Result<Option<u32>> {
        let cube = floor(position * (1.0 / self.edge));
        let middle = middle(cube, self.edge);
        if let Some(last) = &mut self.last
            && last.cell == cell
        {
            // A stream that went from this cube to another does so again: that one's group was begun next.
            if last.cube != cube
                && let Some(next) = self.open.after(cell, last.place, last.index)
                && self.open.at_mut(next).center() == middle
            {
                (last.cube, last.place, last.index) = (cube, next, last.index + 1);
            }
            let group = self.open.at_mut(last.place);
            if last.cube == cube && group.takes(normal) {
                group.add(position, normal);
                return Ok(Some(last.index));
            }
        }
        self.find_and_add(cell, cube, position, normal)
    }

    fn take(&mut self, cell: u32) -> CellItems<Group> {
        self.last = None;
        if let Some(mut table) = self.tables[cell as usize].take() {
            table.clear();
            self.spare.push(table);
        }
        self.open.take(cell)
    }
}

impl Groups {
    fn find_and_add(&mut self, cell: u32, cube: IVec3, position: Vec3, normal: Vec3) -> Result<Option<u32>> {
        let spare = &mut self.spare;
        let table = self.tables[cell as usize].get_or_insert_with(|| spare.pop().unwrap_or_default());
        let mut key = key(cube);
        for _ in 0..SHEETS {
            let Some(place) = table.get(&key).copied() else { break };
            let group = self.open.at_mut(place);
            if group.takes(normal) {
                group.add(position, normal);
                let index = group.index();
                self.last = Some(Last { cell, cube, place, index });
                return Ok(Some(index));
            }
            key += NEXT_SHEET;
        }
        if !self.open.has_room(cell) {
            return Ok(None);
        }
        let index = self.open.count(cell) as u32;
        let mut group = Group::new(middle(cube, self.edge), 0.5 * self.edge, index);
        group.add(position, normal);
        let place = self.open.push(cell, group)?;
        table.insert(key, place);
        self.last = Some(Last { cell, cube, place, index });
        Ok(Some(index))
    }
}

/// Groups of one cube that are looked at before another is begun.
const SHEETS: u32 = 8;
const NEXT_SHEET: u32 = 1 << 24;

/// A cube's place among those of its cell, which are at most 2^[`MAX_LEVEL`] and one along each axis: so a
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

/// How the vertices of open cells are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Grouping {
    /// As they are, unless too many are held at a time, and groups of them would be fewer.
    #[default]
    Automatic,
    /// As they are.
    Never,
    /// In groups, by cubes of 2^-level of a cell; the level is at most 6.
    Level(u32),
}

impl Grouping {
    /// What it comes to for a model, of which pass 1 has told when each cell is open: never
    /// [`Grouping::Automatic`]. It does not depend on the machine.
    pub fn resolve(self, grid: &Grid, frame: &Frame, target: Target) -> Self {
        let resolved = match self {
            Self::Never => Self::Never,
            Self::Level(level) => Self::Level(level.min(MAX_LEVEL)),
            Self::Automatic => {
                let vertices =
                    most_open(&grid.records, |r| r.count.saturating_mul(size_of::<Vertex>() as u64));
                level(grid, frame, target).map_or(Self::Never, |level| {
                    // A surface meets about twice as many little cubes as its area has.
                    let cubes = 2 << (2 * level);
                    let groups = most_open(&grid.records, |r| r.count.min(cubes) * GROUP_BYTES);
                    let helps = vertices > VERTICES_AT_EASE && 2 * groups < vertices;
                    if helps { Self::Level(level) } else { Self::Never }
                })
            }
        };
        // Where all is in one place, cubes have no size.
        resolved.edge(grid.cell_size(), frame).map_or(Self::Never, |_| resolved)
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

/// Most of something that open cells hold at a time; a cell is open from its first vertex to its last one.
fn most_open(records: &[CellRecord], size: impl Fn(&CellRecord) -> u64) -> u64 {
    let mut events: Vec<(u64, bool, u32)> = Vec::with_capacity(2 * records.len());
    for (i, r) in records.iter().enumerate() {
        events.push((r.first, false, i as u32));
        events.push((r.last, true, i as u32));
    }
    events.sort_unstable();
    let (mut now, mut most) = (0u128, 0);
    for (_, closes, i) in events {
        let size = u128::from(size(&records[i as usize]));
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

    fn gathered<G: Gather>(gather: &mut G, vertices: &[(u32, Vec3, Vec3)]) -> Vec<(Vec<u32>, Vec<G::Item>)> {
        let mut indices = vec![Vec::new(); 3];
        for (cell, p, n) in vertices {
            let index = gather.add(*cell, *p, *n).expect("no file is written").expect("room");
            indices[*cell as usize].push(index);
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
        let groups = gathered(&mut Groups::new(3, edge, 1 << 30), &vertices);
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
            let (a, b) = (Moments::of(&all), Moments::of(groups));
            assert!(a.mean().distance(b.mean()) < 1e-6 && (a.spread() - b.spread()).abs() < 1e-6);
        }
    }

    #[test]
    fn groups_that_find_no_room_say_so() {
        let mut groups = Groups::new(3, 1.0 / 512.0, 0);
        let added = vertices().into_iter().map(|(cell, p, n)| groups.add(cell, p, n).expect("no file"));
        assert!(added.collect::<Vec<_>>().contains(&None));
    }

    #[test]
    fn the_most_that_is_open_is_counted() {
        let record = |first, last| CellRecord { count: last - first + 1, first, last };
        let records = [record(0, 9), record(5, 20), record(9, 9), record(21, 30)];
        assert_eq!(most_open(&records, |_| 1), 3);
        assert_eq!(most_open(&records, |r| r.count), 10 + 16 + 1);
        assert_eq!(most_open(&[], |r| r.count), 0);
    }
}
