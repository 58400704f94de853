//! Occupancy of space by the body: fine cells that are outside of it, inside, or on its surface.
//!
//! The surface are triangles, or fans of neighbours among points alone. Cells that cannot be reached from the
//! border of the grid without a step through the surface are inside. Cells of the surface count by half, and
//! the grid lies so that flat sides of the samples' box pass through the middle of cells.

use glam::DVec3;
use simod_plugin_api::{Host, PluginResult, PrepareInput};
use std::sync::atomic::{AtomicU8, Ordering};

/// Fine cells along an edge of a cell of the lattice.
pub const PARTS: usize = 4;
/// Value of a fine cell of the surface, and of one inside; cells outside have 0.
const SURFACE: u8 = 1;
const INSIDE: u8 = 2;
/// Number of the six directions along the axes in which a cell inside an open surface sees it, at least.
const SEEN: u32 = 5;
/// A surface encloses something if there are more fine cells inside than this part of those on it.
const ENCLOSING: f64 = 0.02;
/// Neighbours that a sample without triangles spans a fan with.
const FAN: usize = 8;
/// Samples or triangles at once on one thread.
const TOGETHER: usize = 1024;

/// The kind of surface that encloses the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Enclosure {
    /// A closed surface.
    Closed,
    /// A surface with holes, at which most lines of sight from within end.
    Open,
    /// A surface that encloses nothing: a sheet, or walls thinner than two fine cells.
    Skin,
}

/// Fine cells about the samples.
#[derive(Debug)]
pub struct Occupancy {
    /// The corner of the first cell.
    pub origin: DVec3,
    /// The cells' edges.
    pub step: DVec3,
    /// Cells along each axis.
    pub counts: [usize; 3],
    /// The kind of surface that encloses the body.
    pub kind: Enclosure,
    values: Vec<u8>,
}

impl Occupancy {
    /// The cells that points take up in a box of which the longest side is 1; `resolution` cells of the
    /// lattice are along that.
    pub fn new(
        points: &[DVec3],
        input: &PrepareInput<'_>,
        resolution: usize,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = points.iter().fold(start, |(low, high), p| (low.min(*p), high.max(*p)));
        let (mut origin, mut step, mut counts) = (low, DVec3::ONE, [PARTS; 3]);
        for axis in 0..3 {
            let extent = high[axis] - low[axis];
            let cells = (extent * resolution as f64).round().max(1.0) as usize;
            counts[axis] = PARTS * cells;
            let thin = 1.0 / (resolution * PARTS) as f64;
            // A body thinner than half a cell lies in the middle of one.
            let is_thin = extent * (2 * resolution) as f64 <= 1.0;
            step[axis] = if is_thin { thin } else { extent / (counts[axis] - 1) as f64 };
            origin[axis] = if is_thin {
                0.5 * (low[axis] + high[axis] - thin * PARTS as f64)
            } else {
                low[axis] - 0.5 * step[axis]
            };
        }
        let mut this = Self { origin, step, counts, kind: Enclosure::Closed, values: Vec::new() };
        this.values = this.surface(points, input, host)?;
        host.progress(0.1)?;
        let on = this.values.iter().filter(|v| **v == SURFACE).count();
        let encloses = |inside: &[bool]| inside.iter().filter(|i| **i).count() as f64 > ENCLOSING * on as f64;
        let mut inside = this.enclosed(host)?;
        if !encloses(&inside) {
            inside = this.seen();
            this.kind = if encloses(&inside) { Enclosure::Open } else { Enclosure::Skin };
        }
        this.values.iter_mut().zip(inside).filter(|(_, i)| *i).for_each(|(v, _)| *v = INSIDE);
        Ok(this)
    }

    /// The fine cell of a point, the nearest one of points beyond the grid.
    pub fn cell(&self, p: DVec3) -> [usize; 3] {
        let at = (p - self.origin) / self.step;
        [0, 1, 2].map(|axis| (at[axis].max(0.0) as usize).min(self.counts[axis] - 1))
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.counts[1] + y) * self.counts[0] + x
    }

    /// Part of a fine cell that is the body's, 0 to 1; 0 beyond the grid.
    pub fn part(&self, cell: [usize; 3]) -> f64 {
        let is_in = (0..3).all(|axis| cell[axis] < self.counts[axis]);
        if is_in { f64::from(self.values[self.index(cell)]) * 0.5 } else { 0.0 }
    }

    /// Offset of the middle of a fine cell's filled part from the middle of the cell, as parts of its edges.
    pub fn off(&self, cell: [usize; 3]) -> DVec3 {
        if self.values[self.index(cell)] != SURFACE {
            return DVec3::ZERO;
        }
        // A cell of the surface is half filled, towards the inside.
        let beside = |axis: usize, by: isize| {
            let mut next = cell;
            next[axis] = cell[axis].wrapping_add_signed(by);
            self.part(next)
        };
        DVec3::from([0, 1, 2].map(|axis| 0.25 * (beside(axis, 1) - beside(axis, -1))))
    }

    /// Clears the fine cells for which `goes` is true.
    pub fn clear(&mut self, goes: impl Fn([usize; 3]) -> bool) {
        for z in 0..self.counts[2] {
            for y in 0..self.counts[1] {
                for x in (0..self.counts[0]).filter(|x| goes([*x, y, z])) {
                    let index = self.index([x, y, z]);
                    self.values[index] = 0;
                }
            }
        }
    }

    /// Marks the cells of the surface.
    fn surface(&self, points: &[DVec3], input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Vec<u8>> {
        let values: Vec<AtomicU8> = (0..self.counts.iter().product()).map(|_| AtomicU8::new(0)).collect();
        let mark = |p: DVec3| values[self.index(self.cell(p))].store(SURFACE, Ordering::Relaxed);
        let is_right = |t: &&[u32; 3]| t.iter().all(|c| (*c as usize) < points.len());
        let given: Vec<[u32; 3]> =
            input.triangles().map_or(Vec::new(), |t| t.indices().iter().filter(is_right).copied().collect());
        host.parallel_for(given.len().div_ceil(TOGETHER), |block| {
            for triangle in given.iter().skip(block * TOGETHER).take(TOGETHER) {
                self.cover(triangle.map(|c| points[c as usize]), mark);
            }
        })?;
        let mut is_in_one = vec![false; points.len()];
        given.iter().flatten().for_each(|c| is_in_one[*c as usize] = true);
        let graph = input.graph().filter(|g| g.len() == points.len());
        host.parallel_for(points.len().div_ceil(TOGETHER), |block| {
            for i in (0..points.len()).skip(block * TOGETHER).take(TOGETHER) {
                mark(points[i]);
                let Some(graph) = graph.filter(|_| !is_in_one[i]) else { continue };
                let near = graph.of(i);
                let near: Vec<DVec3> = near[..near.len().min(FAN)]
                    .iter()
                    .filter_map(|n| points.get(*n as usize).copied())
                    .collect();
                for (n, a) in near.iter().enumerate() {
                    near[..n].iter().for_each(|b| self.cover([points[i], *a, *b], mark));
                }
            }
        })?;
        Ok(values.into_iter().map(AtomicU8::into_inner).collect())
    }

    /// Marks points of a triangle, so dense that no path over faces of cells leads through between them.
    fn cover(&self, [a, b, c]: [DVec3; 3], mark: impl Fn(DVec3)) {
        let longest = [b - a, c - b, a - c].map(|e| (e / self.step).length()).into_iter().fold(0.0, f64::max);
        let parts = (2.0 * longest).ceil().max(1.0);
        let count = parts as usize;
        for i in 0..=count {
            for j in 0..=count - i {
                mark(a + (b - a) * (i as f64 / parts) + (c - a) * (j as f64 / parts));
            }
        }
    }

    /// The cells that cannot be reached from the border of the grid.
    fn enclosed(&self, host: &Host<'_>) -> PluginResult<Vec<bool>> {
        let [nx, ny, nz] = self.counts;
        let mut is_inside: Vec<bool> = self.values.iter().map(|v| *v == 0).collect();
        let mut open = Vec::new();
        for z in 0..nz {
            for y in 0..ny {
                let is_border = z == 0 || z + 1 == nz || y == 0 || y + 1 == ny;
                let width = if is_border || nx == 1 { 1 } else { nx - 1 };
                open.extend((0..nx).step_by(width).map(|x| [x, y, z]));
            }
        }
        let mut seen = 0_usize;
        while let Some(cell) = open.pop() {
            seen += 1;
            if seen.is_multiple_of(1 << 16) {
                host.progress(0.1)?;
            }
            let index = self.index(cell);
            if !is_inside[index] {
                continue;
            }
            is_inside[index] = false;
            for axis in 0..3 {
                let at = |to: usize| {
                    let mut next = cell;
                    next[axis] = to;
                    next
                };
                if cell[axis] > 0 {
                    open.push(at(cell[axis] - 1));
                }
                if cell[axis] + 1 < self.counts[axis] {
                    open.push(at(cell[axis] + 1));
                }
            }
        }
        Ok(is_inside)
    }

    /// The cells that see the surface in nearly all directions.
    fn seen(&self) -> Vec<bool> {
        let mut times = vec![0_u8; self.values.len()];
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for row in 0..self.counts[u] * self.counts[v] {
                let at = |along: usize| {
                    let mut cell = [0; 3];
                    (cell[axis], cell[u], cell[v]) = (along, row % self.counts[u], row / self.counts[u]);
                    self.index(cell)
                };
                let mut look = |index: usize, seen: &mut bool| {
                    *seen |= self.values[index] == SURFACE;
                    times[index] += u8::from(*seen);
                };
                let (mut before, mut behind) = (false, false);
                (0..self.counts[axis]).for_each(|along| look(at(along), &mut before));
                (0..self.counts[axis]).rev().for_each(|along| look(at(along), &mut behind));
            }
        }
        times.iter().zip(&self.values).map(|(t, v)| *v == 0 && u32::from(*t) >= SEEN).collect()
    }
}
