//! Lattice of cubic cells wherever the body is, and their corners, which move.

use crate::occupancy::Occupancy;
use glam::{DAffine3, DVec3};

/// No cell, or no corner.
pub const NONE: u32 = u32::MAX;

/// The corners of a cell, each by 0 or 1 along the axes.
pub const CORNERS: [[usize; 3]; 8] =
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]];

/// Cells with some of the body in them.
#[derive(Debug)]
pub struct HexMesh {
    origin: DVec3,
    /// The cells' edges.
    pub size: DVec3,
    /// Fine cells along an edge.
    parts: usize,
    counts: [usize; 3],
    ids: Vec<u32>,
    /// The corners of each cell.
    pub cells: Vec<[u32; 8]>,
    /// Weights of each corner of a cell, summed over the filled part of the cell.
    pub moments: Vec<[f64; 8]>,
    /// Position of each corner at rest.
    pub rest: Vec<DVec3>,
    /// Place of each corner in the grid of corners.
    pub places: Vec<[u32; 3]>,
    starts: Vec<u32>,
    uses: Vec<[u32; 2]>,
}

/// A place in a cell.
#[derive(Debug, Clone, Copy)]
pub struct CellPoint {
    /// The cell.
    pub cell: u32,
    /// Position along the cell's edges, 0 to 1.
    pub at: DVec3,
}

/// Weight of each corner of a cell at a place in it.
pub fn weights(at: DVec3) -> [f64; 8] {
    let side = |axis: usize, corner: usize| if corner == 1 { at[axis] } else { 1.0 - at[axis] };
    CORNERS.map(|c| side(0, c[0]) * side(1, c[1]) * side(2, c[2]))
}

/// The gradients of these weights, for edges of length 1.
pub fn slopes(at: DVec3) -> [DVec3; 8] {
    let side = |axis: usize, corner: usize| if corner == 1 { at[axis] } else { 1.0 - at[axis] };
    let sign = |corner: usize| if corner == 1 { 1.0 } else { -1.0 };
    CORNERS.map(|c| {
        DVec3::new(
            sign(c[0]) * side(1, c[1]) * side(2, c[2]),
            side(0, c[0]) * sign(c[1]) * side(2, c[2]),
            side(0, c[0]) * side(1, c[1]) * sign(c[2]),
        )
    })
}

impl HexMesh {
    /// Cells of `parts` fine cells along each edge.
    pub fn new(body: &Occupancy, parts: usize) -> Self {
        let counts = body.counts.map(|n| n.div_ceil(parts));
        let mut this = Self {
            origin: body.origin,
            size: body.step * parts as f64,
            parts,
            counts,
            ids: vec![NONE; counts.iter().product()],
            cells: Vec::new(),
            moments: Vec::new(),
            rest: Vec::new(),
            places: Vec::new(),
            starts: Vec::new(),
            uses: Vec::new(),
        };
        let mut corners = vec![NONE; counts.iter().map(|n| n + 1).product()];
        for index in 0..this.ids.len() {
            let cell = [index % counts[0], index / counts[0] % counts[1], index / counts[0] / counts[1]];
            let moments = moments(body, cell, parts);
            if moments.iter().all(|m| *m == 0.0) {
                continue;
            }
            this.ids[index] = this.cells.len() as u32;
            this.moments.push(moments);
            let cell = CORNERS.map(|corner| {
                let at: [usize; 3] = std::array::from_fn(|axis| cell[axis] + corner[axis]);
                let id = &mut corners[(at[2] * (counts[1] + 1) + at[1]) * (counts[0] + 1) + at[0]];
                if *id == NONE {
                    *id = this.rest.len() as u32;
                    this.rest.push(this.origin + this.size * DVec3::from(at.map(|n| n as f64)));
                    this.places.push(at.map(|n| n as u32));
                }
                *id
            });
            this.cells.push(cell);
        }
        this.find_uses();
        this
    }

    fn find_uses(&mut self) {
        self.starts = vec![0; self.rest.len() + 1];
        self.cells.iter().flatten().for_each(|c| self.starts[*c as usize + 1] += 1);
        (1..self.starts.len()).for_each(|i| self.starts[i] += self.starts[i - 1]);
        let mut next = self.starts.clone();
        self.uses = vec![[0; 2]; self.cells.len() * 8];
        for (cell, corners) in self.cells.iter().enumerate() {
            for (corner, id) in corners.iter().enumerate() {
                let at = &mut next[*id as usize];
                self.uses[*at as usize] = [cell as u32, corner as u32];
                *at += 1;
            }
        }
    }

    /// Cells about a corner, and the number that the corner has in each.
    pub fn uses(&self, corner: usize) -> &[[u32; 2]] {
        &self.uses[self.starts[corner] as usize..self.starts[corner + 1] as usize]
    }

    /// The cell over some fine cell.
    pub fn over(&self, fine: [usize; 3]) -> u32 {
        let [x, y, z] = fine.map(|n| n / self.parts);
        self.ids[(z * self.counts[1] + y) * self.counts[0] + x]
    }

    /// The cell that a point of the body lies in. None where there is no cell.
    pub fn place(&self, body: &Occupancy, p: DVec3) -> Option<CellPoint> {
        self.place_in(body.cell(p), p)
    }

    /// The place of a point in the cell over some fine cell.
    pub fn place_in(&self, fine: [usize; 3], p: DVec3) -> Option<CellPoint> {
        let cell = Some(self.over(fine)).filter(|id| *id != NONE)?;
        let at = (p - self.origin) / self.size - DVec3::from(fine.map(|n| (n / self.parts) as f64));
        Some(CellPoint { cell, at })
    }

    /// Value at a place, interpolated from those at the corners of its cell.
    pub fn interpolate(&self, place: CellPoint, values: &[DVec3]) -> DVec3 {
        let corners = &self.cells[place.cell as usize];
        weights(place.at).iter().zip(corners).map(|(w, c)| *w * values[*c as usize]).sum()
    }

    /// Displacement of a point, blended of those by each corner's map (to shifts): smooth from cell to cell.
    pub fn shift(&self, place: CellPoint, at: DVec3, maps: &[DAffine3]) -> DVec3 {
        let corners = &self.cells[place.cell as usize];
        weights(place.at).iter().zip(corners).map(|(w, c)| *w * maps[*c as usize].transform_point3(at)).sum()
    }

    /// Number of the part that each cell hangs together with, and the number of parts.
    pub fn parts(&self) -> (Vec<u32>, usize) {
        let (mut part, mut count) = (vec![NONE; self.cells.len()], 0);
        for first in 0..part.len() {
            if part[first] != NONE {
                continue;
            }
            part[first] = count;
            let mut open = vec![first];
            while let Some(cell) = open.pop() {
                for corner in self.cells[cell] {
                    for [next, _] in self.uses(corner as usize) {
                        if part[*next as usize] == NONE {
                            part[*next as usize] = count;
                            open.push(*next as usize);
                        }
                    }
                }
            }
            count += 1;
        }
        (part, count as usize)
    }
}

/// Weights of each corner of a cell, summed over the filled part of the cell: their sum is the part that is
/// filled, and they tell where it is.
fn moments(body: &Occupancy, cell: [usize; 3], parts: usize) -> [f64; 8] {
    let mut sums = [0.0; 8];
    for i in 0..parts * parts * parts {
        let by = [i % parts, i / parts % parts, i / parts / parts];
        let fine: [usize; 3] = std::array::from_fn(|axis| cell[axis] * parts + by[axis]);
        let part = body.part(fine);
        if part > 0.0 {
            let at = (DVec3::from(by.map(|n| n as f64 + 0.5)) + body.off(fine)) / parts as f64;
            sums.iter_mut().zip(weights(at)).for_each(|(sum, w)| *sum += part * w);
        }
    }
    sums.map(|sum| sum / (parts * parts * parts) as f64)
}
