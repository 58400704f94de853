//! Spacing of a model's points, from place to place.

use std::sync::OnceLock;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

/// Cells of the grid along the longest side of the model: 8 MiB of counters for a cube.
const CELLS: f64 = 128.0;

/// The local spacing of points, from how many there are in the cells of a grid.
///
/// Scans are irregular, and their points come in any order, so neither the extent and the count nor the
/// distance of consecutive points tells the spacing. The count does, in a block of 3 x 3 x 3 cells, by the
/// area of the surface there. A plane along the grid meets 9 of the cells, and its area is that of 9 faces of
/// cells; in the mean over all orientations it meets 3/2 cells per such area. So does a surface that is
/// folded more, roughly.
pub struct Spacing {
    origin: DVec3,
    cell: f64,
    size: IVec3,
    counts: Vec<u32>,
    /// Radii of the discs in each cell that has points, once they are asked for: 4 bytes for each cell.
    radii: OnceLock<Vec<f32>>,
}

impl Spacing {
    /// An empty grid over a box (its lowest and highest corners), of bounded size.
    pub fn new(bounds: [DVec3; 2]) -> Self {
        let extent = bounds[1] - bounds[0];
        let longest = extent.max_element();
        let cell = if longest.is_finite() && longest > 0.0 { longest / CELLS } else { 1.0 };
        let size = (extent / cell).floor().as_ivec3().clamp(IVec3::ZERO, IVec3::splat(CELLS as i32)) + 1;
        let origin = if bounds[0].is_finite() { bounds[0] } else { DVec3::ZERO };
        let counts = vec![0; size.as_usizevec3().element_product()];
        Self { origin, cell, size, counts, radii: OnceLock::new() }
    }

    /// Counts points, in any order and any number of calls; those outside the box or not finite are left out.
    pub fn add(&mut self, positions: impl IntoIterator<Item = DVec3>) {
        self.radii.take();
        for position in positions {
            if let Some(index) = self.cell_of(position).and_then(|cell| self.index(cell)) {
                self.counts[index] = self.counts[index].saturating_add(1);
            }
        }
    }

    /// The mean distance of neighbouring points around a position, no longer than a cell; a cell where there
    /// are none.
    pub fn around(&self, position: DVec3) -> f64 {
        self.cell_of(position).map_or(self.cell, |cell| self.in_cell(cell))
    }

    fn in_cell(&self, cell: IVec3) -> f64 {
        let (mut points, mut cells) = (0.0, 0.0f64);
        for offset in (0..27).map(|i| IVec3::new(i % 3, i / 3 % 3, i / 9) - 1) {
            if let Some(index) = self.index(cell + offset) {
                let count = self.counts[index];
                points += f64::from(count);
                cells += f64::from(u8::from(count > 0));
            }
        }
        let area = f64::max(2.0 / 3.0 * cells, cells.min(9.0)) * self.cell * self.cell;
        if points > 0.0 { (area / points).sqrt().min(self.cell) } else { self.cell }
    }

    /// Radius of discs that cover the surface around a position without holes: wider than the spacing, as
    /// points are not on a perfect grid.
    pub fn radius_at(&self, position: DVec3) -> f32 {
        let radius = |spacing: f64| (1.35 * spacing) as f32;
        let in_cell = |i: usize| if self.counts[i] > 0 { radius(self.in_cell(self.cell_at(i))) } else { 0.0 };
        let radii = || (0..self.counts.len()).into_par_iter().with_min_len(1 << 12).map(in_cell).collect();
        let index = self.cell_of(position).and_then(|cell| self.index(cell));
        match index.filter(|index| self.counts[*index] > 0) {
            Some(index) => self.radii.get_or_init(radii)[index],
            None => radius(self.around(position)),
        }
    }

    fn cell_of(&self, position: DVec3) -> Option<IVec3> {
        let place = (position - self.origin) / self.cell;
        // Rounding as `floor` does, which calls a library for each coordinate; points that are far off are
        // outside all the same.
        let cell = place.as_ivec3();
        place.is_finite().then(|| {
            cell.saturating_sub(IVec3::select(cell.as_dvec3().cmpgt(place), IVec3::ONE, IVec3::ZERO))
        })
    }

    /// The cell of an index.
    fn cell_at(&self, index: usize) -> IVec3 {
        let (index, [x, y]) = (index as i32, [self.size.x, self.size.y]);
        IVec3::new(index % x, index / x % y, index / (x * y))
    }

    fn index(&self, cell: IVec3) -> Option<usize> {
        let inside = cell.cmpge(IVec3::ZERO).all() && cell.cmplt(self.size).all();
        inside.then(|| ((cell.z * self.size.y + cell.y) * self.size.x + cell.x) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacing_of_a_lattice_on_planes() {
        for (across, along) in [
            (DVec3::X, DVec3::Z),
            (DVec3::new(0.8, 0.6, 0.0), DVec3::new(-0.36, 0.48, 0.8)),
            (DVec3::new(0.6, 0.0, 0.8), DVec3::new(-0.8, 0.0, 0.6)),
        ] {
            let at = |i: u32| across * f64::from(i % 1000) * 0.001 + along * f64::from(i / 1000) * 0.001;
            let points = || (0..1_000_000).map(at);
            let (low, high) =
                points().fold((DVec3::MAX, DVec3::MIN), |(low, high), p| (low.min(p), high.max(p)));
            let mut spacing = Spacing::new([low, high]);
            spacing.add(points());
            for i in 0..20 {
                let measured = spacing.around((across + along) * (0.2 + 0.03 * f64::from(i)));
                assert!((0.00085..0.0013).contains(&measured), "{measured} for {across}, {along}");
            }
        }
    }

    #[test]
    fn radii_are_told_of_where_points_are_now() {
        let mut spacing = Spacing::new([DVec3::ZERO, DVec3::new(3.0, 2.0, 1.0)]);
        let point = |i: u32| {
            let [x, y, z] = [7u32, 11, 13].map(|n| f64::from(i * n % 101) / 101.0);
            DVec3::new(3.0 * x, 2.0 * y, z * z)
        };
        for more in [0..500, 500..20_000] {
            spacing.add(more.map(point));
            for i in 0..1000 {
                // Beside points as well, and outside of the box.
                for p in [point(i), point(i) * 1.02, point(i) + 1.5] {
                    assert_eq!(spacing.radius_at(p), (1.35 * spacing.around(p)) as f32, "{p}");
                }
            }
        }
    }

    #[test]
    fn degenerate_boxes_and_points_are_taken() {
        for bounds in [[DVec3::ZERO; 2], [DVec3::NAN; 2], [DVec3::INFINITY, DVec3::NEG_INFINITY]] {
            let mut spacing = Spacing::new(bounds);
            spacing.add([DVec3::ZERO, DVec3::NAN, DVec3::splat(1e300)]);
            assert!(spacing.radius_at(DVec3::ZERO) > 0.0);
            assert!(spacing.radius_at(DVec3::NAN) > 0.0);
        }
    }
}
