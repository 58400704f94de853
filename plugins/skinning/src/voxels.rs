//! The model as a solid of voxels, whatever its surface is like: closed or with holes, a soup of triangles,
//! or points alone.
//!
//! The surface's voxels are those that triangles pass through; where a sample is in no triangle, those
//! between it and its nearest neighbours are taken. Inside are voxels that cannot be reached from without
//! over the faces of voxels; and, as there may be holes, also those from where nearly all lines of sight end
//! at the surface (ray stabbing: F. S. Nooruddin, G. Turk, *Simplification and repair of polygonal models
//! using volumetric techniques*, IEEE TVCG 9, 2003). So a vessel's hollow is inside too. An open surface, as
//! one side of a relief, encloses nothing: there the voxels between it and the bones count as inside.

use crate::grid::Grid;
use crate::skeleton::on_segment;
use glam::{DVec3, IVec3};
use simod_plugin_api::{Host, PluginError, PluginResult, PrepareInput};
use std::sync::atomic::{AtomicBool, Ordering};

/// No voxel.
pub const NONE: u32 = u32::MAX;
/// Largest number of voxels of a model.
const MOST: usize = 1 << 22;
/// Points along an edge of a triangle, for each cell.
const FINENESS: f64 = 2.5;
/// Number of the 26 lines of sight that end at the surface where a cell is inside, at least.
const STABBED: u32 = 21;
/// Number of the surface's voxels for which there is at least one inside, if the surface encloses something.
const ENCLOSING: usize = 8;
/// Nearest neighbours with which a sample without triangles spans some.
const FAN: usize = 6;
/// Samples and triangles at once on one thread.
const TOGETHER: usize = 2048;

/// The neighbours that come after a cell, as their columns, rows and layers are numbered; those before it are
/// opposite.
const LATER: [[i32; 3]; 13] = [
    [1, 0, 0],
    [-1, 1, 0],
    [0, 1, 0],
    [1, 1, 0],
    [-1, -1, 1],
    [0, -1, 1],
    [1, -1, 1],
    [-1, 0, 1],
    [0, 0, 1],
    [1, 0, 1],
    [-1, 1, 1],
    [0, 1, 1],
    [1, 1, 1],
];

/// The voxels of a model.
#[derive(Debug, Clone)]
pub struct Voxels {
    pub grid: Grid,
    /// For each cell its voxel, numbered in the order of cells, or [`NONE`].
    ids: Vec<u32>,
    /// Cell of each voxel.
    pub cells: Vec<u32>,
    /// The neighbours over the faces, in pairs along the axes, or [`NONE`].
    pub neighbours: Vec<[u32; 6]>,
    /// Whether anything is inside of the surface.
    pub encloses: bool,
}

impl Voxels {
    /// Voxels of samples with their triangles, or neighbours; and of the space between them and the bones, if
    /// the surface encloses nothing.
    ///
    /// # Errors
    /// The voxels are too many; a sample is not finite.
    pub fn new(
        input: &PrepareInput<'_>,
        bones: &[[DVec3; 2]],
        resolution: usize,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let positions = input.samples.positions();
        if positions.is_empty() {
            return Err(PluginError::input("there are no samples"));
        }
        if let Some(i) = positions.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(PluginError::input(format!("the sample {i} is at no finite place")));
        }
        let grid = Grid::new(positions, bones, resolution);
        let surface = surface(&grid, input, host)?;
        host.progress(0.08)?;
        let is_surface: Vec<bool> = surface.into_iter().map(AtomicBool::into_inner).collect();
        let mut is_inside = inside(&grid, &is_surface, host)?;
        let [outer, inner] = [&is_surface, &is_inside].map(|cells| cells.iter().filter(|c| **c).count());
        // Corners of a surface that is open may look as if they enclosed something.
        let encloses = inner * ENCLOSING > outer;
        if !encloses {
            is_inside = between(&grid, &is_surface, bones, host)?;
        }
        host.progress(0.15)?;
        let mut ids = vec![NONE; grid.len()];
        let mut cells = Vec::new();
        for index in (0..ids.len()).filter(|i| is_surface[*i] || is_inside[*i]) {
            ids[index] = cells.len() as u32;
            cells.push(index as u32);
        }
        if cells.len() > MOST {
            let what = format!("is too fine: {} voxels", cells.len());
            return Err(PluginError::parameter("resolution", &what)
                .hint(format!("lower it: {MOST} voxels are the most")));
        }
        let faces = [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]];
        let steps = faces.map(|by| grid.step(by));
        // The margin's cells are no voxels, so that all neighbours are in the grid.
        let around = |cell: &u32| steps.map(|step| ids[(*cell as isize + step) as usize]);
        let neighbours = cells.iter().map(around).collect();
        Ok(Self { grid, ids, cells, neighbours, encloses })
    }

    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// The voxel of a cell, or [`NONE`].
    pub fn id(&self, cell: IVec3) -> u32 {
        if self.grid.contains(cell) { self.ids[self.grid.index(cell)] } else { NONE }
    }

    /// The middle of a voxel.
    pub fn centre(&self, voxel: u32) -> DVec3 {
        self.grid.centre(self.grid.cell_of(self.cells[voxel as usize] as usize))
    }

    /// Neighbours over edges and corners that are voxels, and their distances, in cells.
    pub fn diagonal(&self, voxel: u32) -> impl Iterator<Item = (u32, f32)> + '_ {
        let cell = self.cells[voxel as usize] as isize;
        let both = LATER.iter().flat_map(|by| [*by, by.map(|x| -x)]);
        let far = |by: [i32; 3]| (by, by.iter().map(|x| x.abs()).sum::<i32>());
        both.map(far).filter(|(_, n)| *n > 1).filter_map(move |(by, n)| {
            let id = self.ids[(cell + self.grid.step(by)) as usize];
            (id != NONE).then_some((id, (n as f32).sqrt()))
        })
    }

    /// The neighbours over faces, edges and corners that are voxels.
    pub fn all_around(&self, voxel: u32) -> impl Iterator<Item = u32> + '_ {
        let cell = self.cells[voxel as usize] as isize;
        let both = LATER.iter().flat_map(|by| [*by, by.map(|x| -x)]);
        both.map(move |by| self.ids[(cell + self.grid.step(by)) as usize]).filter(|id| *id != NONE)
    }

    /// The neighbours over edges that are voxels, where none beside both is.
    pub fn over_edges(&self, voxel: u32) -> impl Iterator<Item = u32> + '_ {
        let cell = self.cells[voxel as usize] as isize;
        let at = move |by: [i32; 3]| self.ids[(cell + self.grid.step(by)) as usize];
        let both = LATER.iter().flat_map(|by| [*by, by.map(|x| -x)]);
        let edges = both.filter(|by| by.iter().filter(|x| **x != 0).count() == 2);
        let is_apart = move |by: &[i32; 3]| {
            let mut beside = (0..3).filter(|a| by[*a] != 0).map(|a| {
                let mut beside = *by;
                beside[a] = 0;
                beside
            });
            beside.all(|by| at(by) == NONE)
        };
        edges.filter(is_apart).map(at).filter(|id| *id != NONE)
    }

    /// Whether all neighbours over the faces are voxels.
    pub fn is_inner(&self, voxel: u32) -> bool {
        !self.neighbours[voxel as usize].contains(&NONE)
    }
}

/// The cells that the surface passes through.
fn surface(grid: &Grid, input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Vec<AtomicBool>> {
    let positions = input.samples.positions();
    let count = positions.len();
    let is_surface: Vec<AtomicBool> = (0..grid.len()).map(|_| AtomicBool::new(false)).collect();
    let at = |i: u32| DVec3::from(positions[i as usize].map(f64::from));
    let mark = |p: DVec3| is_surface[grid.index(grid.cell(p))].store(true, Ordering::Relaxed);
    let given = input.triangles().map_or(&[][..], |t| t.indices());
    let is_right = |t: &[u32; 3]| t.iter().all(|c| (*c as usize) < count);
    host.parallel_for(given.len().div_ceil(TOGETHER), |block| {
        for triangle in given.iter().skip(block * TOGETHER).take(TOGETHER).filter(|t| is_right(t)) {
            cover(triangle.map(at), grid, mark);
        }
    })?;
    let mut is_in_one = vec![false; count];
    given.iter().filter(|t| is_right(t)).flatten().for_each(|c| is_in_one[*c as usize] = true);
    let graph = input.graph().filter(|g| g.len() == count);
    host.parallel_for(count.div_ceil(TOGETHER), |block| {
        let samples = block * TOGETHER..((block + 1) * TOGETHER).min(count);
        for i in samples {
            mark(at(i as u32));
            let Some(graph) = graph.filter(|_| !is_in_one[i]) else { continue };
            let near = graph.of(i);
            let near = &near[..near.len().min(FAN)];
            for (n, a) in near.iter().enumerate() {
                near[..n].iter().for_each(|b| cover([at(i as u32), at(*a), at(*b)], grid, mark));
            }
        }
    })?;
    Ok(is_surface)
}

/// Marks points of a triangle that are so dense that no path over faces of cells leads through between them.
fn cover([a, b, c]: [DVec3; 3], grid: &Grid, mark: impl Fn(DVec3)) {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let parts = (FINENESS * longest / grid.size).ceil().max(1.0);
    let count = parts as usize;
    for i in 0..=count {
        for j in 0..=count - i {
            mark(a + (b - a) * (i as f64 / parts) + (c - a) * (j as f64 / parts));
        }
    }
}

/// The cells inside of a surface.
fn inside(grid: &Grid, is_surface: &[bool], host: &Host<'_>) -> PluginResult<Vec<bool>> {
    let mut is_inside = stabbed(grid, is_surface, host)?;
    // Cells that can be reached from without; those that cannot are inside.
    let mut is_outside = vec![false; grid.len()];
    let mut open = vec![0_usize];
    is_outside[0] = true;
    let faces = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(IVec3::from_array);
    let mut seen = 0_usize;
    while let Some(index) = open.pop() {
        seen += 1;
        if seen.is_multiple_of(1 << 16) {
            host.progress(0.12)?;
        }
        let cell = grid.cell_of(index);
        for next in faces.iter().flat_map(|by| [cell + *by, cell - *by]).filter(|c| grid.contains(*c)) {
            let next = grid.index(next);
            if !is_surface[next] && !is_outside[next] {
                is_outside[next] = true;
                open.push(next);
            }
        }
    }
    for (index, inside) in is_inside.iter_mut().enumerate() {
        *inside = !is_surface[index] && (*inside || !is_outside[index]);
    }
    Ok(is_inside)
}

/// The cells between a surface and the bones that are nearest to it, as far as nothing else is in between.
fn between(
    grid: &Grid,
    is_surface: &[bool],
    bones: &[[DVec3; 2]],
    host: &Host<'_>,
) -> PluginResult<Vec<bool>> {
    let mut is_between = vec![false; is_surface.len()];
    for (n, index) in (0..is_surface.len()).filter(|i| is_surface[*i]).enumerate() {
        if n.is_multiple_of(TOGETHER) {
            host.progress(0.13)?;
        }
        let from = grid.centre(grid.cell_of(index));
        let to = bones.iter().map(|bone| on_segment(from, *bone));
        let nearest = to.min_by(|a, b| a.distance_squared(from).total_cmp(&b.distance_squared(from)));
        let Some([from, to]) = nearest.and_then(|to| grid.clip([from, to])) else { continue };
        let steps = (2.0 * from.distance(to) / grid.size).ceil().max(1.0);
        let way = (0..=steps as usize).map(|i| grid.cell(from.lerp(to, i as f64 / steps)));
        let way: Vec<usize> = way.filter(|c| grid.is_inner(*c)).map(|c| grid.index(c)).collect();
        // The way may begin along the surface, and does not come to it again.
        let mut off = way.iter().skip_while(|i| is_surface[**i]);
        if off.all(|i| !is_surface[*i]) {
            way.iter().for_each(|i| is_between[*i] = true);
        }
    }
    Ok(is_between)
}

/// The cells from where nearly all of 26 lines of sight end at the surface.
fn stabbed(grid: &Grid, is_surface: &[bool], host: &Host<'_>) -> PluginResult<Vec<bool>> {
    let steps = LATER.map(|by| grid.step(by));
    // The lines that end at the surface: 13 bits for those that go on, 13 for those that go back.
    let mut ends: Vec<u32> = is_surface.iter().map(|s| if *s { u32::MAX } else { 0 }).collect();
    // Beyond the margin there is nothing to look up.
    let rows = |z: i32| (1..grid.counts.y - 1).map(move |y| grid.index(IVec3::new(1, y, z)));
    let width = grid.counts.x as usize - 2;
    for z in (1..grid.counts.z - 1).rev() {
        host.progress(0.1)?;
        for index in rows(z).rev().flat_map(|row| (row..row + width).rev()) {
            for (bit, step) in steps.iter().enumerate() {
                ends[index] |= ends[(index as isize + step) as usize] & (1 << bit);
            }
        }
    }
    for z in 1..grid.counts.z - 1 {
        host.progress(0.11)?;
        for index in rows(z).flat_map(|row| row..row + width) {
            for (bit, step) in steps.iter().enumerate() {
                ends[index] |= ends[(index as isize - step) as usize] & (1 << (bit + 13));
            }
        }
    }
    // A line may slip through between two cells of the surface that touch at an edge: those beside it do not.
    let mut is_inside = vec![false; ends.len()];
    let around = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|by| grid.step(by) as usize);
    for z in 1..grid.counts.z - 1 {
        host.progress(0.12)?;
        for index in rows(z).flat_map(|row| row..row + width).filter(|i| !is_surface[*i]) {
            let beside =
                around.iter().flat_map(|step| [index - step, index + step]).filter(|i| !is_surface[*i]);
            let bits = beside.fold(ends[index], |bits, i| bits | ends[i]);
            is_inside[index] = (bits & ((1 << 26) - 1)).count_ones() >= STABBED;
        }
    }
    Ok(is_inside)
}
