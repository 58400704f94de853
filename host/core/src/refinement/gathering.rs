//! The vertices of some cells, read again: their ranges of the stream alone (paper §6).

use std::ops::Range;

use glam::{DVec3, Vec3};
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::{Model, Progress, Result, SMALL_CHUNK, VertexChunk};

use crate::sampling::Opaque;
use crate::sampling::cluster::{Group, Vertex};
use crate::sampling::finalization::{PART, unit};
use crate::sampling::gather::{Cubes, Gather, GatherPiece, GroupGather, PieceGroups};
use crate::sampling::grid::{CellMap, cell_box, key_at};
use crate::sampling::kept_cells::KeptCells;
use crate::sampling::ranges::joined;

/// Vertices of which a cell's tree was built at once, where they were not in groups.
pub(super) const VERTICES_OF_A_PART: usize = PART / size_of::<Vertex>();

/// All vertices of a cell.
pub(crate) struct GatheredCell {
    /// The cell's place among the kept cells.
    pub cell: u32,
    /// Vertices in the order of the stream, counted.
    pub vertices: Vec<Vertex>,
    /// Index of each vertex in the model; empty, if it is not asked for.
    pub ids: Vec<u32>,
    /// Groups that the cell's tree was built of, and the group of each vertex; `None` if the tree was built
    /// of the vertices.
    pub groups: Option<(Vec<Vec<Group>>, Vec<u32>)>,
    /// A sample on the sheet of each vertex, if the model touches itself in the cell.
    pub guides: Vec<u32>,
}

/// A vertex of one of the cells that are read.
pub(crate) struct Visited<'a> {
    /// The place of its cell among these.
    pub at: u32,
    /// Position in the model's coordinates; finite.
    pub position: DVec3,
    /// The unit normal; zero where it is not known.
    pub normal: Vec3,
    /// The vertex's index in the model.
    pub index: u64,
    /// The attributes of all vertices of a chunk, and its place among these.
    attributes: (&'a [Vec<f64>], usize),
}

impl Visited<'_> {
    /// One of the vertex's attributes, of those that are read.
    pub fn attribute(&self, place: usize) -> f64 {
        let (of_chunk, vertex) = self.attributes;
        of_chunk[place][vertex]
    }
}

/// The box of the cell that the stream is in, and the cell's number among those that are read; none for any
/// other cell.
type CurrentCell = (Bounds, Option<u32>);

/// Choice of what is read of the model's vertices, and the model.
pub(crate) struct Gathering<'a> {
    pub model: &'a dyn Model,
    pub kept: &'a KeptCells,
    pub frame: Frame,
    /// Cubes in which groups were gathered; `None` if there were no groups.
    pub cubes: Option<Cubes>,
    /// Whether the vertices' indices are gathered as well.
    pub with_ids: bool,
    /// Number of attributes, from the first on, that are read.
    pub attributes: usize,
    /// Splats that were left out when the model was sampled, and are again.
    pub opaque: Option<Opaque>,
}

impl Gathering<'_> {
    /// Largest number of bytes that a vertex takes until its cell is done: itself, its index and group, and
    /// once more while it is clustered, with the nodes of a tree down to it.
    pub const BYTES_PER_VERTEX: u64 = 240;

    /// Reads some cells; returns them and the number of bytes that were read. `None` if a cell has more or
    /// fewer vertices than it had: the model has changed.
    ///
    /// Memory: [`BYTES_PER_VERTEX`](Self::BYTES_PER_VERTEX) for each vertex of these cells, and a chunk.
    pub fn read(&self, cells: &[u32], progress: &dyn Progress) -> Result<Option<(Vec<GatheredCell>, u64)>> {
        let kept = |cell: &u32| &self.kept.cells[*cell as usize];
        let mut groups = self.cubes.map(|cubes| GroupsAgain::new(cells.len(), cubes));
        let mut found: Vec<GatheredCell> = cells.iter().map(|cell| self.empty(*cell)).collect();
        let bytes = self.visit(cells, progress, |visited| {
            let Some(Visited { at, position, normal, index, .. }) = visited else {
                groups.iter_mut().for_each(|groups| groups.piece.leave());
                return Ok(true);
            };
            let position = self.frame.to_local(position);
            let found = &mut found[at as usize];
            if found.vertices.len() as u64 == kept(&found.cell).vertices {
                return Ok(false);
            }
            if let Some(groups) = &mut groups {
                groups.add(at, (index, position, normal))?;
            }
            found.vertices.push(Vertex { position, normal, index: found.vertices.len() as u32 });
            if self.with_ids {
                found.ids.push(index as u32);
            }
            Ok(true)
        })?;
        let Some(bytes) = bytes else { return Ok(None) };
        groups.iter_mut().try_for_each(GroupsAgain::end_piece)?;
        for (at, found) in (0..).zip(&mut found) {
            if found.vertices.len() as u64 != kept(&found.cell).vertices {
                return Ok(None);
            }
            if let (Some(groups), Some((parts, group_of))) = (&mut groups, &mut found.groups) {
                *group_of = std::mem::take(&mut groups.group_of[at as usize]);
                groups.all.take(at).in_parts(PART / size_of::<Group>(), |part| {
                    parts.push(part.to_vec());
                    Ok(())
                })?;
            }
        }
        Ok(Some((found, bytes)))
    }

    /// A cell without its vertices, which has room for them.
    fn empty(&self, cell: u32) -> GatheredCell {
        let n = usize::try_from(self.kept.cells[cell as usize].vertices).unwrap_or(0);
        GatheredCell {
            cell,
            vertices: Vec::with_capacity(n),
            ids: Vec::with_capacity(if self.with_ids { n } else { 0 }),
            groups: self.cubes.map(|_| (Vec::new(), Vec::new())),
            guides: Vec::new(),
        }
    }

    /// Streams the vertices of some cells through `visit`, in the model's order, and nothing each time the
    /// stream leaves them; returns the number of bytes that were read. `None` once `visit` says `false`: that
    /// the model has changed.
    ///
    /// Memory: a chunk.
    pub fn visit(
        &self,
        cells: &[u32],
        progress: &dyn Progress,
        mut visit: impl FnMut(Option<Visited<'_>>) -> Result<bool>,
    ) -> Result<Option<u64>> {
        let key = |cell: &u32| self.kept.cells[*cell as usize].key;
        let places: CellMap<u32> = cells.iter().map(key).zip(0..).collect();
        let (mut bytes, mut chunk) = (0, VertexChunk::default());
        let mut attributes = vec![Vec::new(); self.attributes];
        for range in self.ranges(cells) {
            // The vertices between two ranges were in other cells, so no cell is current.
            let mut current: Option<CurrentCell> = None;
            visit(None)?;
            let mut reader = self.model.vertices(range)?;
            reader.set_chunk(SMALL_CHUNK);
            if attributes.is_empty() && self.opaque.is_none() {
                reader.skip_attributes();
            }
            while reader.read(&mut chunk)? {
                progress.check()?;
                if let Some(opaque) = self.opaque {
                    opaque.leave_out(self.model, &mut chunk)?;
                }
                if !attributes.is_empty() {
                    self.model.attributes(&chunk, &mut attributes)?;
                }
                if !self.visit_chunk((&chunk, &attributes), &places, &mut current, &mut visit)? {
                    return Ok(None);
                }
                bytes += chunk.raw().len() as u64;
                progress.advance(chunk.raw().len() as u64);
            }
        }
        Ok(Some(bytes))
    }

    /// Hands the vertices of a chunk to `visit` that are in one of the cells, of which `places` has the
    /// numbers; and nothing where the stream comes to another cell. `false` as soon as `visit` says so.
    fn visit_chunk(
        &self,
        (chunk, attributes): (&VertexChunk, &[Vec<f64>]),
        places: &CellMap<u32>,
        current: &mut Option<CurrentCell>,
        visit: &mut impl FnMut(Option<Visited<'_>>) -> Result<bool>,
    ) -> Result<bool> {
        for (i, p) in chunk.positions.iter().enumerate() {
            let cell = match current {
                Some((inside, cell)) if inside.contains(*p) => *cell,
                _ if !p.is_finite() => continue,
                _ => {
                    let key = key_at(*p, self.kept.level);
                    let cell = places.get(&key).copied();
                    *current = Some((cell_box(key, self.kept.level), cell));
                    if cell.is_none() {
                        visit(None)?;
                    }
                    cell
                }
            };
            let Some(at) = cell else { continue };
            let normal = chunk.normals.get(i).map_or(Vec3::ZERO, |n| unit(*n));
            let index = chunk.first + i as u64;
            if !visit(Some(Visited { at, position: *p, normal, index, attributes: (attributes, i) }))? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Bytes of the model that some cells lie in, about.
    pub fn bytes_of(&self, cells: &[u32]) -> u64 {
        let vertices: u64 = self.ranges(cells).iter().map(|r| r.end - r.start).sum();
        let info = self.model.info();
        (vertices as f64 / info.vertices.max(1) as f64 * info.vertex_bytes as f64) as u64
    }

    /// Ranges of the stream that hold the vertices of these cells, ascending.
    pub fn ranges(&self, cells: &[u32]) -> Vec<Range<u64>> {
        // Where reading cannot begin anywhere, going on costs less than beginning again.
        let near = self.model.info().near();
        joined(cells.iter().flat_map(|cell| self.kept.cells[*cell as usize].ranges.iter().cloned()), near)
    }
}

/// Gathers groups as sampling did.
struct GroupsAgain {
    cubes: Cubes,
    /// The groups of the piece that is gathered.
    piece: PieceGroups,
    number: u64,
    all: GroupGather,
    /// The group of each vertex of each cell.
    group_of: Vec<Vec<u32>>,
    /// The cell of each vertex of the piece, and its group there.
    in_piece: Vec<(u32, u32)>,
}

impl GroupsAgain {
    fn new(cells: usize, cubes: Cubes) -> Self {
        Self {
            cubes,
            piece: PieceGroups::new(cubes.edge),
            number: 0,
            all: GroupGather::new(cells, cubes.edge, u64::MAX),
            group_of: vec![Vec::new(); cells],
            in_piece: Vec::new(),
        }
    }

    fn add(&mut self, cell: u32, (vertex, position, normal): (u64, Vec3, Vec3)) -> Result<()> {
        if vertex / self.cubes.piece != self.number {
            self.end_piece()?;
            self.number = vertex / self.cubes.piece;
        }
        self.in_piece.push((cell, self.piece.add(cell, position, normal)));
        Ok(())
    }

    /// Merges the piece with those before.
    fn end_piece(&mut self) -> Result<()> {
        let groups = self.piece.end();
        let mut merged = Vec::with_capacity(groups.len());
        for (cell, group) in &groups {
            // Groups of a refinement have no bound to their memory.
            merged.push(self.all.merge(*cell, group)?.unwrap_or(0));
        }
        for (cell, group) in self.in_piece.drain(..) {
            self.group_of[cell as usize].push(merged[group as usize]);
        }
        self.piece.begin(groups);
        Ok(())
    }
}

impl GatheredCell {
    /// Number of parts in which the cell's tree was built.
    pub fn parts(&self) -> usize {
        match &self.groups {
            Some((parts, _)) => parts.len(),
            None => self.vertices.len().div_ceil(VERTICES_OF_A_PART),
        }
    }

    /// The item of the tree that a vertex is, or is part of.
    pub fn item_of(&self, vertex: usize) -> usize {
        match &self.groups {
            Some((_, group_of)) => group_of[vertex] as usize,
            None => vertex,
        }
    }

    /// Number of these items.
    pub fn items(&self) -> usize {
        match &self.groups {
            Some((parts, _)) => parts.iter().map(Vec::len).sum(),
            None => self.vertices.len(),
        }
    }
}
