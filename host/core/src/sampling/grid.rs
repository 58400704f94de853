//! Pass 1: vertices are counted per cell of the coarse grid G (paper §4), whose bounds need not be known.
//!
//! The cells are those of a sparse lattice of power-of-two size anchored at the model's zero. It starts as
//! fine as the coordinates' own precision and its cells are merged two by two whenever the extent outgrows
//! the resolution. ⌊⌊x/s⌋/2⌋ = ⌊x/2s⌋ exactly for powers of two, so the final cells depend on the set of
//! points alone, not on their order.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use glam::DVec3;
use simod_model::bounds::Bounds;

/// Integer coordinates of a cell: ⌊p / cell size⌋.
pub type CellKey = [i64; 3];

/// Record of pass 1 for one cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellRecord {
    /// Number of vertices in the cell.
    pub count: u64,
    /// Index in the stream of its first vertex.
    pub first: u64,
    /// Index in the stream of its last vertex.
    pub last: u64,
}

/// Hashes cell keys by multiplication and folding: they come from geometry, not from an adversary.
#[derive(Default)]
pub struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        // Arrays come as their bytes.
        let (words, rest) = bytes.as_chunks();
        words.iter().for_each(|word| self.write_u64(u64::from_le_bytes(*word)));
        rest.iter().for_each(|&b| self.write_u64(u64::from(b)));
    }
    fn write_i64(&mut self, x: i64) {
        self.write_u64(x as u64);
    }
    fn write_u32(&mut self, x: u32) {
        self.write_u64(u64::from(x));
    }
    fn write_u64(&mut self, x: u64) {
        let mixed = (self.0 ^ x).wrapping_add(0x9E37_79B9_7F4A_7C15);
        let product = u128::from(mixed) * 0xD6E8_FEB8_6659_FD93;
        self.0 = (product >> 64) as u64 ^ product as u64;
    }
    fn write_usize(&mut self, x: usize) {
        self.write_u64(x as u64);
    }
}

/// A map from cells.
pub type CellMap<T> = HashMap<CellKey, T, BuildHasherDefault<CellHasher>>;

/// The sparse grid that pass 1 fills.
///
/// Memory: one record per occupied cell. A surface meets about 3R² of R³ cells; space-filling points could
/// meet all of them, and then R has to be chosen lower.
pub struct GridCounter {
    resolution: i64,
    /// log₂ of the cell size.
    level: i32,
    cells: CellMap<CellRecord>,
    key_min: CellKey,
    key_max: CellKey,
    /// The cell of the last vertex: streams are coherent, so the map is seldom asked.
    current: Option<(CellKey, CellRecord)>,
    /// Box that is surely inside that cell and the bounds: most vertices are in it, and need no further look.
    inside: Bounds,
    bounds: Bounds,
}

impl GridCounter {
    /// An empty grid of at most `resolution` cells along each axis (two at the least: cells on both sides of
    /// zero never merge).
    pub fn new(resolution: u32) -> Self {
        Self {
            resolution: i64::from(resolution.max(2)),
            level: i32::MIN,
            cells: CellMap::default(),
            key_min: [i64::MAX; 3],
            key_max: [i64::MIN; 3],
            current: None,
            inside: Bounds::default(),
            bounds: Bounds::default(),
        }
    }

    /// Counts the vertex of the given index in the stream. Its position must be finite.
    #[inline]
    pub fn add(&mut self, p: DVec3, index: u64) {
        if let Some((_, record)) = &mut self.current
            && self.inside.contains(p)
        {
            record.count += 1;
            record.first = record.first.min(index);
            record.last = record.last.max(index);
            return;
        }
        let stays = self.enter(p, index);
        // A stream in no order leaves each cell at once, and needs no box.
        self.inside = match self.current {
            Some((key, _)) if stays => {
                let cell = cell_box(key, self.level);
                Bounds { min: cell.min.max(self.bounds.min), max: cell.max.min(self.bounds.max) }
            }
            _ => Bounds::default(),
        };
    }

    /// Counts a vertex that may lie in another cell than the last, or outside the bounds so far; returns
    /// whether it is in the same cell.
    fn enter(&mut self, p: DVec3, index: u64) -> bool {
        self.bounds.include(p);
        // Keys stay below 2^53, exact in a double and far from overflow.
        let finest = exponent(p.abs().max_element()) - 52;
        if finest > self.level {
            self.coarsen_to(finest);
        }
        let key = key_at(p, self.level);
        if let Some((current, record)) = &mut self.current
            && *current == key
        {
            record.count += 1;
            record.first = record.first.min(index);
            record.last = record.last.max(index);
            return true;
        }
        self.flush();
        self.current = Some((key, CellRecord { count: 1, first: index, last: index }));
        let mut grown = false;
        for (k, (low, high)) in key.iter().zip(self.key_min.iter_mut().zip(&mut self.key_max)) {
            grown |= k < low || k > high;
            *low = *k.min(low);
            *high = *k.max(high);
        }
        if grown {
            self.fit();
        }
        false
    }

    /// Merges cells until there are no more than the resolution along each axis.
    fn fit(&mut self) {
        let extent = |shift: i32| {
            (0..3).map(|a| (self.key_max[a] >> shift) - (self.key_min[a] >> shift) + 1).max().unwrap_or(0)
        };
        let mut shift = 0;
        while extent(shift) > self.resolution {
            shift += 1;
        }
        if shift > 0 {
            self.coarsen_to(self.level + shift);
        }
    }

    /// Puts the record at hand into the map.
    fn flush(&mut self) {
        if let Some((key, record)) = self.current.take() {
            merge(&mut self.cells, key, record);
        }
    }

    /// Merges cells until their size is 2^level.
    fn coarsen_to(&mut self, level: i32) {
        self.flush();
        if !self.cells.is_empty() {
            let shift = (level - self.level).min(63);
            let mut coarse = CellMap::default();
            for (key, record) in self.cells.drain() {
                merge(&mut coarse, key.map(|k| k >> shift), record);
            }
            self.cells = coarse;
            self.key_min = self.key_min.map(|k| k >> shift);
            self.key_max = self.key_max.map(|k| k >> shift);
        }
        self.level = level;
    }

    /// Adds the counts of another counter of the same resolution: the result is that of one that counted all
    /// vertices.
    pub fn absorb(&mut self, mut other: Self) {
        other.flush();
        if other.cells.is_empty() {
            return;
        }
        let level = self.level.max(other.level);
        self.coarsen_to(level);
        other.coarsen_to(level);
        self.bounds.min = self.bounds.min.min(other.bounds.min);
        self.bounds.max = self.bounds.max.max(other.bounds.max);
        for a in 0..3 {
            self.key_min[a] = self.key_min[a].min(other.key_min[a]);
            self.key_max[a] = self.key_max[a].max(other.key_max[a]);
        }
        for (key, record) in other.cells {
            merge(&mut self.cells, key, record);
        }
        self.fit();
    }

    /// Counts: the level, the bounds, and the cells by their keys.
    pub fn into_cells(mut self) -> (i32, Bounds, Vec<(CellKey, CellRecord)>) {
        self.flush();
        let mut cells: Vec<_> = self.cells.into_iter().collect();
        cells.sort_unstable_by_key(|(key, _)| *key);
        (self.level, self.bounds, cells)
    }

    /// Counter with the counts that another one of this resolution [gave](Self::into_cells); `None` if no
    /// counter can have given them.
    pub fn of_cells(
        resolution: u32,
        level: i32,
        [min, max]: [DVec3; 2],
        cells: impl Iterator<Item = (CellKey, CellRecord)>,
    ) -> Option<Self> {
        let mut counter = Self { level, bounds: Bounds { min, max }, ..Self::new(resolution) };
        for (key, record) in cells {
            let is_key = key.iter().all(|k| k.abs() <= 1 << 53);
            if !is_key || record.count == 0 || counter.cells.insert(key, record).is_some() {
                return None;
            }
            for (k, (low, high)) in key.iter().zip(counter.key_min.iter_mut().zip(&mut counter.key_max)) {
                (*low, *high) = (*k.min(low), *k.max(high));
            }
        }
        let is_level = counter.cells.is_empty() || (-1074..=1024).contains(&level);
        (is_level && (counter.cells.is_empty() || (min.is_finite() && max.is_finite()))).then_some(counter)
    }

    /// The finished grid.
    pub fn finish(mut self) -> Grid {
        self.flush();
        let mut cells: Vec<_> = self.cells.into_iter().collect();
        // Cells are in the order in which the stream meets them; no two cells share a first vertex.
        cells.sort_unstable_by_key(|(_, record)| record.first);
        let index = cells.iter().enumerate().map(|(i, (key, _))| (*key, i as u32)).collect();
        let (keys, records) = cells.into_iter().unzip();
        Grid { level: self.level, bounds: self.bounds, keys, records, index }
    }
}

/// Coarse grid G after pass 1: the occupied cells, their numbers of vertices and their places in the stream.
#[derive(Debug)]
pub struct Grid {
    /// log₂ of the cell size.
    pub level: i32,
    /// Bounding box of the finite positions.
    pub bounds: Bounds,
    /// The occupied cells, in the order in which the stream first meets them.
    pub keys: Vec<CellKey>,
    /// A record per occupied cell.
    pub records: Vec<CellRecord>,
    index: CellMap<u32>,
}

impl Grid {
    /// Edge length of a cell, in the model's unit.
    pub fn cell_size(&self) -> f64 {
        2f64.powi(self.level)
    }

    /// The cell that holds `p`, which must be finite.
    #[inline]
    pub fn key_of(&self, p: DVec3) -> CellKey {
        key_at(p, self.level)
    }

    /// Position in [`Grid::keys`] of an occupied cell.
    #[inline]
    pub fn find(&self, key: &CellKey) -> Option<u32> {
        self.index.get(key).copied()
    }
}

fn merge(cells: &mut CellMap<CellRecord>, key: CellKey, record: CellRecord) {
    cells
        .entry(key)
        .and_modify(|r| {
            r.count += record.count;
            r.first = r.first.min(record.first);
            r.last = r.last.max(record.last);
        })
        .or_insert(record);
}

/// ⌊log₂ x⌋ of a positive normal double; the least exponent for anything smaller.
#[inline]
fn exponent(x: f64) -> i32 {
    ((x.to_bits() >> 52) & 0x7ff).max(1) as i32 - 1023
}

/// Box of the points that are surely in a cell: its upper faces are not, nor those that rounding may have
/// moved.
pub fn cell_box(key: CellKey, level: i32) -> Bounds {
    let half = level / 2;
    let (a, b) = (power_of_two(half), power_of_two(level - half));
    let corner = |k: [i64; 3]| DVec3::from_array(k.map(|k| k as f64 * a * b));
    let max = corner(key.map(|k| k + 1));
    Bounds { min: corner(key), max: DVec3::from_array(max.to_array().map(f64::next_down)) }
}

/// ⌊p / 2^level⌋, exact.
#[inline]
pub fn key_at(p: DVec3, level: i32) -> CellKey {
    // Two factors, as 2^-level itself can overflow; a product with a power of two is exact, or so small that
    // its floor is that of a tiny number of the same sign.
    let half = -level / 2;
    let (a, b) = (power_of_two(half), power_of_two(-level - half));
    [p.x, p.y, p.z].map(|x| floor(x * a * b))
}

/// ⌊x⌋, without the call that it is on older processors.
#[inline]
fn floor(x: f64) -> i64 {
    let towards_zero = x as i64;
    towards_zero.saturating_sub(i64::from(towards_zero as f64 > x))
}

/// 2^e for −1022 ≤ e ≤ 1023, without a call.
#[inline]
fn power_of_two(e: i32) -> f64 {
    f64::from_bits(((e + 1023) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid(points: &[DVec3], resolution: u32) -> Grid {
        let mut counter = GridCounter::new(resolution);
        points.iter().enumerate().for_each(|(i, &p)| counter.add(p, i as u64));
        counter.finish()
    }

    #[test]
    fn numbers_are_rounded_down() {
        for x in [0.0, 0.3, 1.0, 2.5, 1e15 + 0.5, 2f64.powi(53), 2f64.powi(63), 1e300, 1e-300] {
            assert_eq!([floor(x), floor(-x)], [x.floor() as i64, (-x).floor() as i64], "{x}");
        }
    }

    fn point() -> impl Strategy<Value = DVec3> {
        let x = || prop_oneof![-1.0..1.0f64, -1e-30..1e-30f64, -1e30..1e30f64, Just(0.0), 4.2e6..4.3e6f64];
        (x(), x(), x()).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn every_vertex_is_counted_once_in_its_own_cell(
            points in proptest::collection::vec(point(), 1..200), resolution in 2u32..64,
        ) {
            let g = grid(&points, resolution);
            let mut counts = vec![0u64; g.keys.len()];
            for p in &points {
                counts[g.find(&g.key_of(*p)).expect("an occupied cell") as usize] += 1;
            }
            prop_assert!(g.records.iter().zip(&counts).all(|(r, c)| r.count == *c));
            for a in 0..3 {
                let low = g.keys.iter().map(|k| k[a]).min().expect("a cell");
                let high = g.keys.iter().map(|k| k[a]).max().expect("a cell");
                prop_assert!(high - low < i64::from(resolution));
            }
        }

        #[test]
        fn lattices_that_share_the_work_agree_with_one(
            points in proptest::collection::vec(point(), 0..100), cut in 0usize..100, resolution in 2u32..64,
        ) {
            let cut = cut.min(points.len());
            let mut parts = [GridCounter::new(resolution), GridCounter::new(resolution), GridCounter::new(resolution)];
            for (i, p) in points.iter().enumerate() {
                parts[usize::from(i >= cut)].add(*p, i as u64);
            }
            let [mut first, second, empty] = parts;
            first.absorb(empty);
            first.absorb(second);
            let (shared, one) = (first.finish(), grid(&points, resolution));
            prop_assert_eq!((shared.level, shared.bounds), (one.level, one.bounds));
            prop_assert_eq!((shared.keys, shared.records), (one.keys, one.records));
        }

        #[test]
        fn cells_do_not_depend_on_the_order(
            points in proptest::collection::vec(point(), 1..100), seed in any::<u64>(),
        ) {
            let mut shuffled = points.clone();
            let mut state = seed;
            for i in (1..shuffled.len()).rev() {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                shuffled.swap(i, (state >> 33) as usize % (i + 1));
            }
            let cells = |g: Grid| {
                let mut cells: Vec<_> = g.keys.iter().zip(&g.records).map(|(k, r)| (*k, r.count)).collect();
                cells.sort_unstable();
                (g.level, cells)
            };
            prop_assert_eq!(cells(grid(&points, 16)), cells(grid(&shuffled, 16)));
        }
    }

    #[test]
    fn resolution_is_used() {
        let points: Vec<_> = (0..=1000).map(|i| DVec3::new(f64::from(i) * 1e-3, 0.0, 0.0)).collect();
        let g = grid(&points, 64);
        assert!((32..=64).contains(&g.keys.len()), "{} cells", g.keys.len());
    }

    #[test]
    fn equal_points_share_one_cell_at_any_scale() {
        for scale in [0.0, 5e-324, 1e-300, 1e-30, 1.0, 1e30, 1e300, f64::MAX] {
            let g = grid(&[DVec3::new(scale, -scale, scale / 3.0); 5], 64);
            assert_eq!(g.keys.len(), 1, "scale {scale}");
            assert_eq!(g.records[0], CellRecord { count: 5, first: 0, last: 4 });
        }
    }
}
