//! Cells of space.

use glam::{DVec3, IVec3};

/// Empty cells about the model on all sides.
const MARGIN: i32 = 1;
/// The grid goes on beyond the samples where there are bones, for such a part of its longest side at most.
const NEAR: f64 = 0.25;

/// Cubic cells about the samples.
#[derive(Debug, Clone)]
pub struct Grid {
    /// The corner of the first cell, local coordinates.
    pub origin: DVec3,
    /// The cells' size.
    pub size: f64,
    /// Cells along each axis.
    pub counts: IVec3,
}

fn extent(points: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)))
}

impl Grid {
    /// Grid of cells about points and the parts of some bones near them; `resolution` cells along the longest
    /// side of the points' box, or along that of the bones where all points are in one place.
    pub fn new(points: &[[f32; 3]], bones: &[[DVec3; 2]], resolution: usize) -> Self {
        let (min, max) = extent(points.iter().map(|p| DVec3::from(p.map(f64::from))));
        let (from, to) = extent(bones.iter().flatten().copied());
        let longest = (max - min).max_element();
        let longest = if longest > 0.0 { longest } else { (to - from).max_element() };
        let near = DVec3::splat(NEAR * (max - min).max_element());
        let (min, max) = (min.min(from.max(min - near)), max.max(to.min(max + near)));
        // So that coordinates of single precision, far from the origin, are not rounded out of the grid.
        let far = min.abs().max(max.abs()).max_element() * 1e-7;
        let size = (longest / resolution as f64).max(far).max(f64::MIN_POSITIVE);
        // The points lie in the middle of their cells rather than between two.
        let counts = ((max - min) / size).floor().as_ivec3() + 1 + 2 * MARGIN;
        let spare = (counts.as_dvec3() * size - (max - min)) * 0.5;
        Self { origin: min - spare, size, counts }
    }

    /// The number of cells.
    pub fn len(&self) -> usize {
        self.counts.to_array().iter().map(|n| *n as usize).product()
    }

    /// The cell that a point is in, which may be beyond the grid.
    pub fn cell(&self, p: DVec3) -> IVec3 {
        ((p - self.origin) / self.size).floor().as_ivec3()
    }

    /// The middle of a cell.
    pub fn centre(&self, cell: IVec3) -> DVec3 {
        self.origin + (cell.as_dvec3() + 0.5) * self.size
    }

    /// The part of a segment that is in the grid.
    pub fn clip(&self, [a, b]: [DVec3; 2]) -> Option<[DVec3; 2]> {
        let (low, high) = (self.origin, self.origin + self.counts.as_dvec3() * self.size);
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for axis in 0..3 {
            let along = b[axis] - a[axis];
            let (to_low, to_high) = (low[axis] - a[axis], high[axis] - a[axis]);
            if along == 0.0 {
                if to_low > 0.0 || to_high < 0.0 {
                    return None;
                }
            } else {
                let (enters, leaves) = (to_low / along, to_high / along);
                from = from.max(enters.min(leaves));
                to = to.min(enters.max(leaves));
            }
        }
        (from <= to).then(|| [a.lerp(b, from), a.lerp(b, to)])
    }

    /// Whether the grid has a cell.
    pub fn contains(&self, cell: IVec3) -> bool {
        cell.cmpge(IVec3::ZERO).all() && cell.cmplt(self.counts).all()
    }

    /// Whether all cells around a cell are in the grid.
    pub fn is_inner(&self, cell: IVec3) -> bool {
        cell.cmpge(IVec3::ONE).all() && cell.cmplt(self.counts - 1).all()
    }

    /// The place of a cell in the order of all.
    pub fn index(&self, cell: IVec3) -> usize {
        (cell.z as usize * self.counts.y as usize + cell.y as usize) * self.counts.x as usize
            + cell.x as usize
    }

    /// The cell at a place in the order of all.
    pub fn cell_of(&self, index: usize) -> IVec3 {
        let (x, y) = (self.counts.x as usize, self.counts.y as usize);
        IVec3::new((index % x) as i32, (index / x % y) as i32, (index / x / y) as i32)
    }

    /// Distance to a neighbour in the order of all cells.
    pub fn step(&self, by: [i32; 3]) -> isize {
        (by[2] as isize * self.counts.y as isize + by[1] as isize) * self.counts.x as isize + by[0] as isize
    }
}
