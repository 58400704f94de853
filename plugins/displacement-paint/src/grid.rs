//! The nearest sample to a point, while samples move: a hashed grid whose cells are linked lists.

use glam::{DVec3, I64Vec3, Vec3};

/// No sample.
const NONE: u32 = u32::MAX;

/// Number of rings of cells that are looked through before all samples are.
const RINGS: i64 = 6;

/// Samples in each cell of a grid. The grid does not hold positions: the caller has them.
///
/// Memory: 16 bytes a sample at most.
#[derive(Debug, Clone)]
pub struct HashGrid {
    cell: f64,
    /// The first sample of each cell; as many as a power of two, and cells may share one.
    heads: Vec<u32>,
    /// The samples after and before each in its cell.
    next: Vec<u32>,
    before: Vec<u32>,
}

impl HashGrid {
    /// All samples, in cells of the given width.
    pub fn new(positions: &[Vec3], cell: f64) -> Self {
        let count = positions.len();
        let mut grid = Self {
            cell,
            heads: vec![NONE; count.next_power_of_two()],
            next: vec![NONE; count],
            before: vec![NONE; count],
        };
        (0..count).for_each(|i| grid.insert(i, positions[i]));
        grid
    }

    /// Width of the grid's cells.
    pub fn cell(&self) -> f64 {
        self.cell
    }

    fn cell_of(&self, p: DVec3) -> I64Vec3 {
        (p / self.cell).floor().as_i64vec3()
    }

    fn slot(&self, cell: I64Vec3) -> usize {
        // M. Teschner et al., Optimized Spatial Hashing for Collision Detection of Deformable Objects,
        // VMV 2003.
        let hash = cell.x.wrapping_mul(73_856_093)
            ^ cell.y.wrapping_mul(19_349_663)
            ^ cell.z.wrapping_mul(83_492_791);
        hash as usize & (self.heads.len() - 1)
    }

    fn insert(&mut self, i: usize, p: Vec3) {
        let slot = self.slot(self.cell_of(p.as_dvec3()));
        let head = std::mem::replace(&mut self.heads[slot], i as u32);
        (self.next[i], self.before[i]) = (head, NONE);
        if head != NONE {
            self.before[head as usize] = i as u32;
        }
    }

    /// Moves sample `i` from one cell to another.
    pub fn relocate(&mut self, i: usize, from: Vec3, to: Vec3) {
        let (old, new) = (self.cell_of(from.as_dvec3()), self.cell_of(to.as_dvec3()));
        if old == new {
            return;
        }
        let (next, before) = (self.next[i], self.before[i]);
        if before == NONE {
            let slot = self.slot(old);
            self.heads[slot] = next;
        } else {
            self.next[before as usize] = next;
        }
        if next != NONE {
            self.before[next as usize] = before;
        }
        self.insert(i, to);
    }

    fn in_slot(&self, slot: usize) -> impl Iterator<Item = usize> {
        let one = |i: u32| (i != NONE).then_some(i as usize);
        std::iter::successors(one(self.heads[slot]), move |&i| one(self.next[i]))
    }

    /// The nearest sample within a radius, the first of those that are equally near.
    pub fn nearest(&self, positions: &[Vec3], p: DVec3, radius: f64) -> Option<usize> {
        let nearer = |best: (f64, usize), i: usize| {
            let found = (positions[i].as_dvec3().distance_squared(p), i);
            if found.0 < best.0 || (found.0 == best.0 && found.1 < best.1) { found } else { best }
        };
        let found = |best: (f64, usize)| (best.1 != usize::MAX).then_some(best.1);
        let home = self.cell_of(p);
        let mut best = (radius * radius, usize::MAX);
        for ring in 0..=RINGS {
            let samples = ring_of(home, ring).flat_map(|cell| self.in_slot(self.slot(cell)));
            best = samples.fold(best, nearer);
            // Samples beyond this ring are at least so far away.
            if (ring as f64 * self.cell).powi(2) >= best.0 {
                return found(best);
            }
        }
        found((0..positions.len()).fold(best, nearer))
    }

    /// All samples of the cells around a point; some may come twice.
    pub fn around(&self, p: DVec3) -> impl Iterator<Item = usize> {
        let home = self.cell_of(p);
        (0..=1).flat_map(move |ring| ring_of(home, ring)).flat_map(|cell| self.in_slot(self.slot(cell)))
    }
}

/// The cells at distance `ring` from one, in the largest of their coordinates' differences.
fn ring_of(home: I64Vec3, ring: i64) -> impl Iterator<Item = I64Vec3> {
    let range = move || -ring..=ring;
    range().flat_map(move |x| {
        range().flat_map(move |y| {
            let inside = x.abs() < ring && y.abs() < ring;
            // Inner columns of the ring are its two ends alone.
            let step = if inside { 2 * ring as usize } else { 1 };
            range().step_by(step.max(1)).map(move |z| {
                let at = |a: i64, b: i64| a.saturating_add(b);
                I64Vec3::new(at(home.x, x), at(home.y, y), at(home.z, z))
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn finds_the_nearest_while_samples_move(
            points in prop::collection::vec(prop::array::uniform3(-1.0_f32..1.0), 1..200),
            moves in prop::collection::vec((any::<prop::sample::Index>(), prop::array::uniform3(-2.0_f32..2.0)), 0..50),
            query in prop::array::uniform3(-3.0_f64..3.0),
            cell in 0.05_f64..0.5,
            radius in 0.0_f64..4.0,
        ) {
            let mut positions: Vec<Vec3> = points.into_iter().map(Vec3::from).collect();
            let mut grid = HashGrid::new(&positions, cell);
            for (i, to) in moves {
                let i = i.index(positions.len());
                grid.relocate(i, positions[i], to.into());
                positions[i] = to.into();
            }
            let p = DVec3::from(query);
            let near = (0..positions.len())
                .map(|i| (positions[i].as_dvec3().distance_squared(p), i))
                .min_by(|a, b| a.partial_cmp(b).unwrap())
                .filter(|(d, _)| *d < radius * radius);
            prop_assert_eq!(grid.nearest(&positions, p, radius), near.map(|(_, i)| i));
        }
    }
}
