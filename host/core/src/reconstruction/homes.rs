//! The home of a place: the sample around which its neighbourhood is looked up.
//!
//! The home follows from the position alone, so that vertices at one place, as those of a soup of triangles,
//! stay together wherever they stand in the file. A tree of cells has for each the sample whose support
//! reaches its middle best. That one, or one of its neighbours, is the home. Where several sheets of the
//! surface are near, it may be on the wrong one: there the home is the sample whose tangent plane the place
//! lies near.

use std::ops::Range;

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};

use super::RestGeometry;
use super::home_cells::{Finger, HomeOctree};
use super::lanes::{Lanes, PACKET, triple_from};
use super::sheets::{CROWDED_NEIGHBOURS, Sheets};
use crate::geometry::sheet_distance;
use crate::sampling::SampleSet;

/// The square of the part of a support within which its sample is taken for a home: it need not be the
/// nearest, as every sample knows all supports that meet its own.
const NEAR: f32 = 0.25;

/// Neighbours of a sample that have a say in its tangent plane.
pub const RING: usize = 6;

/// Samples, sheets and cells among which homes are looked up.
#[derive(Clone, Copy)]
pub struct Homes<'a> {
    samples: &'a SampleSet,
    sheets: &'a Sheets,
    radius: &'a [f32],
    cells: &'a HomeOctree,
}

impl<'a> Homes<'a> {
    /// The homes among samples that are prepared.
    pub fn new(around: &'a RestGeometry<'a>) -> Self {
        let RestGeometry { samples, sheets, supports, .. } = around;
        Self { samples, sheets, radius: &supports.radius, cells: around.cells() }
    }

    /// The homes of `count` finite positions, each of its position alone; fast where neighbours follow each
    /// other. Behind positions and homes there is [room](with_room).
    pub fn find(&self, positions: [&[f32]; 3], count: usize, homes: &mut Vec<u32>) {
        homes.resize(with_room(count), 0);
        Arch::new().dispatch(HomeSearch { by: *self, positions, count, homes });
    }

    /// The homes of finite positions.
    pub fn find_at(&self, positions: &[Vec3]) -> Vec<u32> {
        let count = positions.len();
        let mut by_axis = [0; 3].map(|_| vec![0.0; with_room(count)]);
        for (i, p) in positions.iter().enumerate() {
            (0..3).for_each(|axis| by_axis[axis][i] = p[axis]);
        }
        let mut homes = Vec::new();
        self.find(by_axis.each_ref().map(|x| &x[..]), count, &mut homes);
        homes.truncate(count);
        homes
    }

    /// The home of a place that is near a sample.
    #[inline(never)]
    fn among_sheets(&self, p: Vec3, near: u32) -> u32 {
        // The sheet of some places is known, where parts of the model touch.
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

    /// The sample whose support reaches a point best, though none does that is near, or else the nearest.
    #[inline(never)]
    fn far(&self, p: Vec3) -> u32 {
        let largest = self.cells.largest.get_or_init(|| self.samples.largest_below(self.radius));
        let deepest = self.samples.deepest(p, self.radius, largest);
        deepest.unwrap_or_else(|| self.samples.nearest(p))
    }

    /// The sample, among those around a near one, on whose sheet the point lies; or, if its support does not
    /// reach the point, another one of that sheet whose support does.
    fn on_its_sheet(&self, near: u32, p: Vec3) -> u32 {
        let mut found = (near, sheet_distance(p - self.samples.positions[near as usize], self.plane(near)));
        let around = self.samples.neighbours().nearest_to(near as usize);
        around.iter().for_each(|i| self.look_at(*i, p, &mut found));
        if self.sheets.knows_strangers() && self.may_be_beyond(around, near, p, found.1) {
            let mut nearest = [0; CROWDED_NEIGHBOURS];
            self.samples.nearest_ones(p, &mut nearest).for_each(|i| self.look_at(i, p, &mut found));
        }
        let best = found.0;
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

    /// Keeps a sample and how far it is from a point in the measure of sheets, if it is nearer than the best.
    #[inline]
    fn look_at(&self, sample: u32, p: Vec3, best: &mut (u32, f32)) {
        let d = p - self.samples.positions[sample as usize];
        // No plane makes it less than that.
        if d.length_squared() >= best.1 {
            return;
        }
        let distance = sheet_distance(d, self.plane(sample));
        if distance < best.1 {
            *best = (sample, distance);
        }
    }

    /// Whether a sample beyond those around a near one may be nearer to a point, in the measure of sheets,
    /// than `least`: among many sheets these do not reach as far as their supports.
    fn may_be_beyond(&self, around: &[u32], near: u32, p: Vec3, least: f32) -> bool {
        let place = |i: u32| self.samples.positions[i as usize];
        let reach = around.last().map_or(f32::INFINITY, |last| place(near).distance(place(*last)));
        place(near).distance(p) + least.sqrt() > reach
    }

    /// The normal of the surface around a sample, of which the sample's own tells the relief as well.
    fn plane(&self, sample: u32) -> Vec3 {
        let normals = self.samples.normals();
        let ring = self.sheets.of_sample(sample as usize).iter().take(RING);
        let sum = ring.map(|i| normals[*i as usize]).sum::<Vec3>() + normals[sample as usize];
        sum.try_normalize().unwrap_or(normals[sample as usize])
    }
}

/// Positions whose cells are found before their homes.
const TOGETHER: usize = 256;

/// Length of a list that has room for vectors which begin within `count` numbers.
pub fn with_room(count: usize) -> usize {
    count + PACKET
}

struct HomeSearch<'a> {
    by: Homes<'a>,
    positions: [&'a [f32]; 3],
    count: usize,
    homes: &'a mut [u32],
}

impl WithSimd for HomeSearch<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let mut finger = Finger::new(self.by.cells);
        // The finest cells, behind that of the last position; the first one differs from it.
        let mut finest = [[0; TOGETHER + PACKET]; 3];
        let mut differ = [0; TOGETHER];
        for first in (0..self.count).step_by(TOGETHER) {
            let count = TOGETHER.min(self.count - first);
            for at in (0..count).step_by(S::F32_LANES) {
                let p = triple_from(simd, self.positions, first + at);
                for (axis, cells) in finest.iter_mut().enumerate() {
                    let to = &mut cells[1 + at..1 + at + S::F32_LANES];
                    S::as_mut_simd_u32s(to).0[0] = self.by.cells.finest(axis, p[axis]);
                }
            }
            let [x, y, z] = &finest;
            for i in 0..count {
                differ[i] = Finger::differ([x[i], y[i], z[i]], [x[i + 1], y[i + 1], z[i + 1]]);
            }
            let mut start = 0;
            while start < count {
                if differ[start] >= finger.limit() {
                    finger.go([x[start + 1], y[start + 1], z[start + 1]], differ[start]);
                }
                let mut end = start + 1;
                while end < count && differ[end] < finger.limit() {
                    end += 1;
                }
                self.in_cell(simd, finger.sample(), first + start..first + end);
                start = end;
            }
            for cells in &mut finest {
                cells[0] = cells[count];
            }
        }
        self.tell_sheets_apart();
    }
}

impl HomeSearch<'_> {
    /// Finds the samples near positions in the cell of a sample: that one, where its support reaches them
    /// well, or the first of its neighbours whose does, or which reaches them best.
    #[inline(always)]
    fn in_cell<S: Simd>(&mut self, simd: S, sample: u32, range: Range<usize>) {
        let by = self.by;
        let (zero, one, near) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0), Lanes::splat(simd, NEAR));
        let places = Lanes(simd, S::as_simd_f32s(&PLACES).0[0]);
        for at in range.clone().step_by(S::F32_LANES) {
            let p = triple_from(simd, self.positions, at);
            let is_there = places.less(Lanes::splat(simd, (range.end - at) as f32));
            let mut least = is_there.select(by.cells.depths(simd, sample, p), zero);
            let mut best = simd.splat_u32s(sample);
            if near.less_or_equal(least).any() {
                for i in by.samples.neighbours().nearest_to(sample as usize) {
                    let depth = by.cells.depths(simd, *i, p);
                    let is_better = near.less_or_equal(least).and(depth.less(least));
                    least = is_better.select(depth, least);
                    best = is_better.select_whole(simd.splat_u32s(*i), best);
                    if !near.less_or_equal(least).any() {
                        break;
                    }
                }
            }
            S::as_mut_simd_u32s(&mut self.homes[at..at + S::F32_LANES]).0[0] = best;
            if one.less_or_equal(least).any() {
                self.far_off(&least.store(), at);
            }
        }
    }

    /// Finds the homes of those positions that no support near them reaches.
    #[inline(never)]
    fn far_off(&mut self, least: &[f32; PACKET], first: usize) {
        for (at, _) in (first..).zip(least).filter(|(_, least)| **least >= 1.0) {
            self.homes[at] = self.by.far(self.position(at));
        }
    }

    /// Finds the homes of those positions that are near samples beside other sheets.
    #[inline(always)]
    fn tell_sheets_apart(&mut self) {
        let (mut last, mut is_crowded) = (u32::MAX, false);
        for at in 0..self.count {
            let near = self.homes[at];
            if near != last {
                (last, is_crowded) = (near, self.by.sheets.is_crowded(near as usize));
            }
            if is_crowded {
                self.homes[at] = self.by.among_sheets(self.position(at), near);
            }
        }
    }

    fn position(&self, at: usize) -> Vec3 {
        Vec3::from_array(self.positions.map(|x| x[at]))
    }
}

/// The places of a packet.
const PLACES: [f32; PACKET] = {
    let mut places = [0.0; PACKET];
    let mut at = 0;
    while at < PACKET {
        places[at] = at as f32;
        at += 1;
    }
    places
};

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
            let homes = Homes::new(&around).find_at(&places);
            let by_axis = [0, 1, 2].map(|axis| {
                places.iter().map(|p| p[axis]).chain([0.0; PACKET]).collect::<Vec<f32>>()
            });
            let with = |dispatch: &dyn Fn(HomeSearch<'_>)| {
                let mut homes = vec![0; with_room(places.len())];
                let (by, positions) = (Homes::new(&around), by_axis.each_ref().map(|x| &x[..]));
                dispatch(HomeSearch { by, positions, count: places.len(), homes: &mut homes });
                homes.truncate(places.len());
                homes
            };
            prop_assert_eq!(&with(&|finding| finding.with_simd(pulp::Scalar::new())), &homes);
            #[cfg(target_arch = "x86_64")]
            if let Some(simd) = pulp::x86::V3::try_new() {
                prop_assert_eq!(&with(&|finding| Simd::vectorize(simd, finding)), &homes);
            }
            let cells = around.cells();
            for (p, home) in places.iter().zip(&homes) {
                prop_assert_eq!(Homes::new(&around).find_at(&[*p]), [*home]);
                let reaches = |i: u32| cells.depth(i, *p) < 0.999;
                let reached = (0..points.len() as u32).any(|i| reaches(i) && around.supports.radius[i as usize] > 1e-9);
                let crowded = (0..points.len()).any(|i| around.sheets.is_crowded(i));
                // Supports that reach a place may be of another sheet, where sheets are near.
                if reached && !crowded {
                    prop_assert!(cells.depth(*home, *p) < 1.0, "{p}: {home}");
                }
            }
        }
    }
}
