//! The home of a place: the sample around which its neighbourhood is looked up.
//!
//! It follows from the position alone, so that vertices at one place, as those of a soup of triangles, stay
//! together wherever they stand in the file. A tree of cells has for each the sample whose support reaches
//! its middle best. That one, or one of its neighbours, is the home. Where several sheets of the surface are
//! near, it may be on the wrong one: there the home is the sample whose tangent plane the place lies near.

use glam::Vec3;

use super::RestGeometry;
use super::home_cells::{Cells, Finger};
use super::sheets::{Sheets, sheet_distance};
use crate::sampling::SampleSet;

/// The square of the part of a support within which its sample is taken for a home: it need not be the
/// nearest, as every sample knows all supports that meet its own.
const NEAR: f32 = 0.25;

/// Neighbours of a sample that have a say in its tangent plane.
pub const RING: usize = 6;

/// What homes are found with.
#[derive(Clone, Copy)]
pub struct Homes<'a> {
    samples: &'a SampleSet,
    sheets: &'a Sheets,
    radius: &'a [f32],
    cells: &'a Cells,
}

impl<'a> Homes<'a> {
    /// The homes among samples that are prepared.
    pub fn new(around: &'a RestGeometry<'a>) -> Self {
        let RestGeometry { samples, sheets, supports, .. } = around;
        Self { samples, sheets, radius: &supports.radius, cells: around.cells() }
    }

    /// The homes of finite positions, each of its position alone; found in this order, which is fast where
    /// neighbours follow each other.
    pub fn find(&self, positions: &[Vec3], order: impl Iterator<Item = usize>, homes: &mut Vec<u32>) {
        let mut finger = Finger::new(self.cells);
        homes.clear();
        homes.resize(positions.len(), 0);
        for i in order {
            let p = positions[i];
            homes[i] = self.home(p, finger.sample(p));
        }
    }

    /// The home of a place, in the cell of a sample: a function of the place, and of nothing else that is
    /// known of a vertex.
    #[inline]
    fn home(&self, p: Vec3, of_cell: u32) -> u32 {
        let near = if self.cells.depth(of_cell, p) < NEAR { of_cell } else { self.near(p, of_cell) };
        if !self.sheets.is_crowded(near as usize) {
            return near;
        }
        // Where parts touch, it is known which sheet some places are on.
        match self.samples.contacts().and_then(|contacts| contacts.sample_at(p)) {
            Some(own) => self.nearest_on_sheet(own, p),
            None => self.on_its_sheet(near, p),
        }
    }

    /// The sample, of one and those on its sheet, whose support reaches a point best.
    fn nearest_on_sheet(&self, own: u32, p: Vec3) -> u32 {
        let all = self.sheets.of_sample(own as usize).iter().copied().chain([own]);
        let depth = |i: u32| self.cells.depth(i, p);
        all.min_by(|a, b| depth(*a).total_cmp(&depth(*b)).then(a.cmp(b))).unwrap_or(own)
    }

    /// A sample whose support reaches a point, if there is one, or else the nearest.
    fn near(&self, p: Vec3, of_cell: u32) -> u32 {
        let (mut best, mut least) = (of_cell, self.cells.depth(of_cell, p));
        for i in self.samples.neighbours().nearest_to(of_cell as usize) {
            let depth = self.cells.depth(*i, p);
            if depth < least {
                (best, least) = (*i, depth);
                if depth < NEAR {
                    return best;
                }
            }
        }
        if least < 1.0 {
            return best;
        }
        let largest = self.cells.largest.get_or_init(|| self.samples.largest_below(self.radius));
        let deepest = self.samples.deepest(p, self.radius, largest);
        deepest.unwrap_or_else(|| self.samples.nearest(p))
    }

    /// The sample, among those around a near one, on whose sheet the point lies; or, if its support does not
    /// reach the point, another one of that sheet whose support does.
    fn on_its_sheet(&self, near: u32, p: Vec3) -> u32 {
        let away = |i: u32| p - self.samples.positions[i as usize];
        let (mut best, mut least) = (near, sheet_distance(away(near), self.plane(near)));
        for i in self.samples.neighbours().nearest_to(near as usize) {
            let d = away(*i);
            // No plane makes it less than that.
            if d.length_squared() >= least {
                continue;
            }
            let distance = sheet_distance(d, self.plane(*i));
            if distance < least {
                (best, least) = (*i, distance);
            }
        }
        let (mut home, mut least) = (best, self.cells.depth(best, p));
        if least >= 1.0 {
            for i in self.sheets.of_sample(best as usize) {
                let depth = self.cells.depth(*i, p);
                if depth < least {
                    (home, least) = (*i, depth);
                }
            }
        }
        if least < 1.0 { home } else { best }
    }

    /// The normal of the surface around a sample, of which the sample's own tells the relief as well.
    fn plane(&self, sample: u32) -> Vec3 {
        let normals = self.samples.normals();
        let ring = self.sheets.of_sample(sample as usize).iter().take(RING);
        let sum = ring.map(|i| normals[*i as usize]).sum::<Vec3>() + normals[sample as usize];
        sum.try_normalize().unwrap_or(normals[sample as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Samples of a density that varies by much, in heaps, on lines and at the same places.
    fn samples() -> impl Strategy<Value = Vec<Vec3>> {
        let x = || (0u32..1000).prop_map(|x| x as f32 / 1000.0);
        let point = (x(), x(), x(), 0i32..12).prop_map(|(x, y, z, size)| {
            let p = Vec3::new(x, 0.1 * (6.0 * x).sin() + 1e-3 * y, z);
            Vec3::new(0.3, 0.0, 0.7) + (p - Vec3::new(0.5, 0.0, 0.5)) * 0.5f32.powi(size)
        });
        (proptest::collection::vec(point, 1..400), 1usize..10).prop_map(|(mut points, copies)| {
            let again: Vec<Vec3> = points.iter().take(20).copied().collect();
            (1..copies).for_each(|_| points.extend(&again));
            points
        })
    }

    proptest! {
        #[test]
        fn a_home_reaches_its_places_wherever_any_sample_does(
            points in samples(),
            offsets in proptest::collection::vec((any::<u32>(), -1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32, 0i32..14), 1..100),
        ) {
            let set = SampleSet::new(points.clone(), Vec::new()).expect("samples");
            let around = RestGeometry::new(&set);
            let places: Vec<Vec3> = offsets
                .iter()
                .map(|(i, x, y, z, size)| points[*i as usize % points.len()] + Vec3::new(*x, *y, *z) * 0.5f32.powi(*size))
                .collect();
            let (mut homes, mut one) = (Vec::new(), Vec::new());
            Homes::new(&around).find(&places, 0..places.len(), &mut homes);
            let cells = around.cells();
            for (p, home) in places.iter().zip(&homes) {
                Homes::new(&around).find(&[*p], 0..1, &mut one);
                prop_assert_eq!(&one, &[*home]);
                let reaches = |i: u32| cells.depth(i, *p) < 0.999;
                let reached = (0..points.len() as u32).any(|i| reaches(i) && around.supports.radius[i as usize] > 1e-9);
                let crowded = (0..points.len()).any(|i| around.sheets.is_crowded(i));
                // Where sheets are near, those who reach a place may be on another one.
                if reached && !crowded {
                    prop_assert!(cells.depth(*home, *p) < 1.0, "{p}: {home}");
                }
            }
        }
    }
}
