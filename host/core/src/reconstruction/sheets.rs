//! Sheets of the surface, and the samples on each: a deformation must not bleed from a finger to the next
//! one, or from one side of a thin wall to the other, however near they are in space.
//!
//! Two samples that see each other along the surface have normals that do not oppose, and lie near each
//! other's tangent planes. For an arc the chord is perpendicular to the mean of both normals, whatever its
//! curvature, so the chord's part along that mean tells the height of one sample *above* the other: it is
//! counted [`STACKED`]-fold. Each sample is linked to the nearest few others in that measure, and its sheet
//! are the samples among its neighbours in space that these links reach.
//!
//! The model's faces may have told the sheets ([`Contacts`](crate::touching::Contacts)): those hold instead.

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::lanes::{Lanes, triple};
use crate::counting_sort;
use crate::geometry::{STACKED, STEEPEST};
use crate::sampling::{NEIGHBOURS, NeighbourGraph, SampleSet};

/// Most neighbours of a sample on its sheet.
pub const SHEET_NEIGHBOURS: usize = 32;

/// Neighbours in space that are looked at where several sheets are near.
pub const CROWDED_NEIGHBOURS: usize = 96;

/// Samples that are linked by one job.
const TOGETHER: usize = 256;

/// Links of each sample: a ring.
const LINKS: usize = 6;

/// Least number of samples of a sheet besides the one that is looked at.
const LEAST: usize = 3;

/// Number of neighbours down to which those are left out on whose sheets a sample is not: two rings.
const ENOUGH: usize = 16;

/// A chord within this sine of the tangent planes is one along the surface.
const ALONG: f32 = 0.2;

/// The place of a sample that has none.
const NOWHERE: u8 = u8::MAX;

/// The list of a sample that has the graph's.
const NONE: u32 = u32::MAX;

/// Sample, and others that belong to its list.
pub type Listed = (u32, Vec<u32>);

/// The neighbours of each sample on its own sheet.
///
/// Memory: beside the graph, 4 bytes per sample, and at most 132 for each near which there is another sheet;
/// where faces have told sheets apart, 4 more, and 128 for each sample near which they meet.
#[derive(Debug)]
pub struct Sheets {
    /// The nearest samples in space: those of most samples are all on the sheet.
    graph: NeighbourGraph,
    /// The list of each sample that has one of its own; [`NONE`] of all others.
    list: Vec<u32>,
    /// Start of each list in `neighbours`, and the end of the last.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    /// Start of each sample's entries in `strangers`, and the end of the last; empty where there are none at
    /// all.
    stranger_starts: Vec<u32>,
    strangers: Vec<u32>,
}

impl Sheets {
    /// The sheets of samples that are [prepared](SampleSet::prepare).
    pub fn find(samples: &SampleSet) -> Self {
        let (positions, normals, graph) = (&samples.positions[..], samples.normals(), samples.neighbours());
        let mut links = vec![Links::default(); samples.len()];
        links.par_chunks_mut(TOGETHER).enumerate().for_each(|(chunk, links)| {
            samples.storage().gone_through(graph.bytes_of(links.len()));
            Arch::new().dispatch(Linking { positions, normals, graph, first: chunk * TOGETHER, links });
        });
        let mut is_told = vec![false; samples.len()];
        for i in samples.contacts().map_or(&[][..], |contacts| contacts.told()) {
            is_told[*i as usize] = true;
        }
        let nowhere = || vec![NOWHERE; samples.len()];
        let own = |places: &mut Vec<u8>, i: usize| {
            samples.storage().gone_through(graph.bytes_of(1));
            let contacts = samples.contacts().filter(|_| is_told[i]);
            let told = contacts.and_then(|contacts| contacts.same_sheet(i));
            let same = match told.filter(|same| same.len() >= LEAST) {
                Some(same) => Some(same.to_vec()),
                None => own_sheet(samples, &links, i, places),
            };
            same.map(|same| (i as u32, same))
        };
        let own = (0..samples.len()).into_par_iter().map_init(nowhere, own).flatten_iter();
        let (stranger_starts, strangers) = Default::default();
        let mut sheets = Self {
            graph: graph.clone(),
            list: vec![NONE; samples.len()],
            starts: vec![0],
            neighbours: Vec::new(),
            stranger_starts,
            strangers,
        };
        for (i, same) in own.collect::<Vec<(u32, Vec<u32>)>>() {
            sheets.push(i as usize, &same);
        }
        sheets.leave_out_denied(samples);
        sheets.note_strangers(samples);
        sheets
    }

    /// Sheets that were found before: the graph of `samples` samples, those that have lists of their own,
    /// and, where faces have told any, the strangers of those that have some; samples in ascending order.
    pub fn known(
        graph: NeighbourGraph,
        samples: usize,
        own: &[Listed],
        strangers: Option<&[Listed]>,
    ) -> Self {
        let mut sheets = Self {
            graph,
            list: vec![NONE; samples],
            starts: vec![0],
            neighbours: Vec::new(),
            stranger_starts: Vec::new(),
            strangers: Vec::new(),
        };
        own.iter().for_each(|(i, list)| sheets.push(*i as usize, list));
        if let Some(strangers) = strangers {
            sheets.set_strangers(samples, strangers);
        }
        sheets
    }

    /// Sets the strangers of some samples, in ascending order; all others of the `samples` have none.
    fn set_strangers(&mut self, samples: usize, lists: &[Listed]) {
        let mut lists = lists.iter().peekable();
        self.stranger_starts.push(0);
        for i in 0..samples {
            if let Some((_, list)) = lists.next_if(|(of, _)| *of as usize == i) {
                self.strangers.extend(list);
            }
            self.stranger_starts.push(self.strangers.len() as u32);
        }
    }

    /// Whether faces have told that samples are on another sheet.
    pub fn knows_strangers(&self) -> bool {
        !self.stranger_starts.is_empty()
    }

    /// Gives a sample a list of its own.
    fn push(&mut self, i: usize, list: &[u32]) {
        self.list[i] = self.starts.len() as u32 - 1;
        self.neighbours.extend_from_slice(list);
        self.starts.push(self.neighbours.len() as u32);
    }

    /// Notes who of the nearest in space is on another sheet, where the faces have told.
    fn note_strangers(&mut self, samples: &SampleSet) {
        let Some(contacts) = samples.contacts() else { return };
        let of_sample = |i: &u32| -> Listed {
            let is_stranger = |j: &&u32| !self.of_sample(*i as usize).contains(j);
            let near = samples.neighbours().nearest_to(*i as usize);
            (*i, near.iter().filter(is_stranger).copied().collect())
        };
        let lists: Vec<Listed> = contacts.told().par_iter().map(of_sample).collect();
        self.set_strangers(samples.len(), &lists);
    }

    /// Leaves out neighbours on whose sheets the sample is not: those of a roof, which the walls below link
    /// to the ground around a sample there, while from the roof only the roof is reached.
    ///
    /// Memory: as much again as for the lists, for the time.
    fn leave_out_denied(&mut self, samples: &SampleSet) {
        if self.neighbours.is_empty() {
            return;
        }
        let (lists, positions) = (&*self, &samples.positions);
        // List without those neighbours, if there are any, or if the list is one of its own.
        let left = |i: usize| -> Option<(u32, Vec<u32>)> {
            samples.storage().gone_through(lists.bytes_of(1));
            let list = lists.of_sample(i);
            if !lists.is_crowded(i) && !list.iter().any(|j| lists.is_crowded(*j as usize)) {
                return None;
            }
            let is_denied =
                |j: &u32| lists.is_crowded(*j as usize) && lists.denies(positions, *j as usize, i);
            let denied = list.iter().filter(|j| is_denied(j)).count();
            if denied > 0 && list.len() >= ENOUGH + denied {
                return Some((i as u32, list.iter().copied().filter(|j| !is_denied(j)).collect()));
            }
            lists.is_crowded(i).then(|| (i as u32, list.to_vec()))
        };
        let all: Vec<(u32, Vec<u32>)> = (0..lists.list.len()).into_par_iter().filter_map(left).collect();
        (self.starts, self.neighbours) = (vec![0], Vec::with_capacity(self.neighbours.len()));
        for (i, list) in all {
            self.push(i as usize, &list);
        }
    }

    /// Whether sample `j`, beside which there are several sheets, knows that sample `i` is not on its own
    /// sheet: `i` is nearer than samples that are.
    fn denies(&self, positions: &[Vec3], j: usize, i: usize) -> bool {
        let same = self.of_sample(j);
        let distance = |k: usize| positions[k].distance_squared(positions[j]);
        same.last().is_some_and(|last| distance(i) < distance(*last as usize)) && !same.contains(&(i as u32))
    }

    /// Whether all lists fit a set of `samples`: sheets that were read from a file may be damaged.
    pub fn is_valid(&self, samples: usize) -> bool {
        let lists = self.starts.len().saturating_sub(1);
        self.graph.is_valid(samples)
            && self.list.len() == samples
            && self.list.iter().all(|list| *list == NONE || (*list as usize) < lists)
            && are_lists(&self.starts, lists, self.neighbours.len())
            && self.starts.windows(2).all(|s| s[1] - s[0] <= SHEET_NEIGHBOURS as u32)
            && self.neighbours.iter().chain(&self.strangers).all(|j| (*j as usize) < samples)
            && (self.stranger_starts.is_empty() && self.strangers.is_empty()
                || are_lists(&self.stranger_starts, samples, self.strangers.len()))
    }

    /// The nearest neighbours in space, whatever their sheets are.
    pub fn graph(&self) -> &NeighbourGraph {
        &self.graph
    }

    /// Bytes of the lists of so many samples, about.
    pub fn bytes_of(&self, samples: usize) -> usize {
        self.graph.bytes_of(samples)
    }

    /// The neighbours of sample `i` on its sheet, nearest first, without itself.
    #[inline]
    pub fn of_sample(&self, i: usize) -> &[u32] {
        match self.list[i] {
            NONE => self.graph.nearest_to(i),
            list => {
                let list = list as usize;
                &self.neighbours[self.starts[list] as usize..self.starts[list + 1] as usize]
            }
        }
    }

    /// Whether another sheet is near the sample.
    #[inline]
    pub fn is_crowded(&self, i: usize) -> bool {
        self.list[i] != NONE
    }

    /// At most `count` nearest neighbours of sample `i` on its sheet, and the radius at which a kernel over
    /// them vanishes: the distance of the first neighbour that is left out, or half as much again as the last
    /// where there is none; 0 without any neighbours.
    pub fn around(&self, positions: &[Vec3], i: usize, count: usize) -> (&[u32], f32) {
        nearest_of(self.of_sample(i), positions, i, count)
    }

    /// The samples among the nearest in space that are not on the sheet of sample `i`, nearest first, where
    /// faces have told sheets apart; none elsewhere.
    #[inline]
    pub fn strangers(&self, i: usize) -> &[u32] {
        match self.stranger_starts.get(i..i + 2) {
            Some([start, end]) => &self.strangers[*start as usize..*end as usize],
            _ => &[],
        }
    }
}

/// At most `count` of these samples, which are the nearest of sample `i` in their order, and the radius at
/// which a kernel over them vanishes: see [`Sheets::around`].
pub fn nearest_of<'a>(all: &'a [u32], positions: &[Vec3], i: usize, count: usize) -> (&'a [u32], f32) {
    let near = &all[..all.len().min(count)];
    let distance = |j: &u32| positions[*j as usize].distance(positions[i]);
    let radius = match all.get(near.len()) {
        Some(beyond) => distance(beyond),
        None => 1.5 * near.last().map_or(0.0, distance),
    };
    (near, radius)
}

/// Whether `starts` are the starts of `lists` lists, one after the other, and the end of the last, at
/// `entries`.
pub fn are_lists(starts: &[u32], lists: usize, entries: usize) -> bool {
    starts.len() == lists + 1
        && starts.first() == Some(&0)
        && starts.is_sorted()
        && starts.last().is_some_and(|end| *end as usize == entries)
}

/// Links of a sample to others along the surface.
#[derive(Debug, Clone, Copy, Default)]
struct Links {
    /// The nearest samples along the surface; the sample itself in unused places.
    to: [u32; LINKS],
    /// Whether all neighbours are so plainly beside the sample that nothing else has to be looked at.
    are_all_beside: bool,
}

/// Links samples that follow each other from the first.
struct Linking<'a> {
    positions: &'a [Vec3],
    normals: &'a [Vec3],
    graph: &'a NeighbourGraph,
    first: usize,
    links: &'a mut [Links],
}

impl WithSimd for Linking<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { positions, normals, graph, first, links } = self;
        let mut chords = Chords::default();
        for (i, links) in (first..).zip(links) {
            let near = graph.nearest_to(i);
            chords.gather(positions, normals, near, i);
            let are_all_beside = chords.measure(simd, normals[i], near.len());
            *links = Links { to: chords.nearest(near, i), are_all_beside };
        }
    }
}

/// Chords from a sample to its neighbours, the neighbours' normals, and the chords' lengths along the
/// surface.
#[derive(Default)]
struct Chords {
    ways: [[f32; NEIGHBOURS]; 3],
    normals: [[f32; NEIGHBOURS]; 3],
    /// Infinite for those that no link goes to.
    distances: [f32; NEIGHBOURS],
}

impl Chords {
    #[inline(always)]
    fn gather(&mut self, positions: &[Vec3], normals: &[Vec3], near: &[u32], i: usize) {
        for (at, j) in near.iter().enumerate() {
            let (d, n) = (positions[*j as usize] - positions[i], normals[*j as usize]);
            for axis in 0..3 {
                (self.ways[axis][at], self.normals[axis][at]) = (d[axis], n[axis]);
            }
        }
    }

    /// Measures the chords' lengths as [`chord_length`](crate::geometry::chord_length) does for one; returns
    /// whether all chords are plainly along the surface. Entries behind the neighbours have no meaning.
    #[inline(always)]
    fn measure<S: Simd>(&mut self, simd: S, own: Vec3, count: usize) -> bool {
        let splat = |x| Lanes::splat(simd, x);
        let (zero, one) = (splat(0.0), splat(1.0));
        let own = [splat(own.x), splat(own.y), splat(own.z)];
        let mut beside = [0.0; NEIGHBOURS];
        let ways = lists::<S>(&self.ways);
        let normals = lists::<S>(&self.normals);
        let distances = S::as_mut_simd_f32s(&mut self.distances).0;
        let besides = S::as_mut_simd_f32s(&mut beside).0;
        for at in 0..distances.len() {
            let (d, n) = (triple(simd, &ways, at), triple(simd, &normals, at));
            let between =
                [splat(0.5) * (own[0] + n[0]), splat(0.5) * (own[1] + n[1]), splat(0.5) * (own[2] + n[2])];
            let (turn, along, squared) = (dot(own, n), dot(d, between), dot(d, d));
            let across = along * along;
            let stacked = splat(STACKED) * along;
            // More than 120° apart, as on both sides of a thin plate, but not between the walls of a groove.
            let faces_away = (splat(2.0) * turn + one).less_or_equal(zero);
            let distance = faces_away.select(splat(f32::INFINITY), squared + stacked * stacked);
            let is_link = across.less_or_equal(splat(STEEPEST * STEEPEST) * squared);
            distances[at] = is_link.select(distance, splat(f32::INFINITY)).1;
            let is_along = across.less_or_equal(splat(ALONG * ALONG) * squared);
            besides[at] = is_along.and(zero.less_or_equal(turn)).select(one, zero).1;
        }
        beside[..count].iter().sum::<f32>() == count as f32
    }

    /// The nearest along the surface.
    #[inline(always)]
    fn nearest(&self, near: &[u32], i: usize) -> [u32; LINKS] {
        let mut best = [(f32::INFINITY, i as u32); LINKS];
        for (distance, j) in self.distances.iter().zip(near) {
            let mut at = LINKS;
            while at > 0 && *distance < best[at - 1].0 {
                if at < LINKS {
                    best[at] = best[at - 1];
                }
                best[at - 1] = (*distance, *j);
                at -= 1;
            }
        }
        best.map(|(_, j)| j)
    }
}

/// Numbers by coordinate, as many at once as the processor takes.
#[inline(always)]
fn lists<S: Simd>(numbers: &[[f32; NEIGHBOURS]; 3]) -> [&[S::f32s]; 3] {
    let [x, y, z] = numbers;
    [S::as_simd_f32s(x).0, S::as_simd_f32s(y).0, S::as_simd_f32s(z).0]
}

/// Scalar products.
#[inline(always)]
fn dot<S: Simd>(a: [Lanes<S>; 3], b: [Lanes<S>; 3]) -> Lanes<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Whether each of `near` (nearest first) has a link to sample `i`, or to one that has: mostly so to a nearer
/// one, where there is one sheet alone. If not, links of the others may still lead there. `places` as for
/// [`reached`].
fn are_linked(links: &[Links], i: usize, near: &[u32], places: &mut [u8]) -> bool {
    places[i] = 0;
    let mut left = near.len();
    // The second pass is for neighbours that come before the one that they have a link to. It is without a
    // branch, as which one it is cannot be foretold: all bits of a place are set, or none.
    for _ in 0..2 {
        for j in near.iter().map(|j| *j as usize) {
            let linked = links[j].to.iter().fold(NOWHERE, |all, to| all & places[*to as usize]);
            left -= usize::from(places[j] > linked);
            places[j] &= linked;
        }
        if left == 0 {
            break;
        }
    }
    near.iter().chain([&(i as u32)]).for_each(|j| places[*j as usize] = NOWHERE);
    left == 0
}

/// The neighbours of sample `i` on its sheet, nearest first, where links tell that others of its neighbours
/// are on another one. `places` as of [`reached`].
fn own_sheet(samples: &SampleSet, links: &[Links], i: usize, places: &mut [u8]) -> Option<Vec<u32>> {
    let (positions, near) = (&samples.positions, samples.neighbours().nearest_to(i));
    if links[i].are_all_beside
        || are_linked(links, i, near, places)
        || reached(links, i, near, places).count_ones() as usize == near.len()
    {
        return None;
    }
    // Distance within which so many neighbours may be, on a surface.
    let reach = near.last().map_or(0.0, |j| positions[*j as usize].distance(positions[i]));
    let reach = reach * (CROWDED_NEIGHBOURS as f32 / near.len() as f32).sqrt();
    let about = samples.unsorted_neighbours_about(i, reach, CROWDED_NEIGHBOURS);
    let seen = reached(links, i, &about.iter().map(|j| *j as u32).collect::<Vec<_>>(), places);
    let mut same: Vec<u64> =
        about.into_iter().enumerate().filter(|(at, _)| seen >> at & 1 == 1).map(|(_, j)| j).collect();
    if same.len() > SHEET_NEIGHBOURS {
        same.select_nth_unstable(SHEET_NEIGHBOURS);
        same.truncate(SHEET_NEIGHBOURS);
    }
    counting_sort::sort(&mut same);
    let same: Vec<u32> = same.into_iter().map(|j| j as u32).collect();
    // Noise and creases alone do not make a second sheet, and fewer samples do not tell how they turn:
    // mostly the normal is wrong.
    (same.len() >= LEAST && same[..] != near[..same.len()]).then_some(same)
}

/// Samples of `near` (fewer than 127) that links within them reach from sample `i`: a bit for each. `places`
/// has one for each sample, all [`NOWHERE`], before and after.
fn reached(links: &[Links], i: usize, near: &[u32], places: &mut [u8]) -> u128 {
    // The sample itself has the last place.
    let nodes = || (0..).zip(near.iter().copied().chain([i as u32]));
    nodes().for_each(|(at, node)| places[node as usize] = at);
    // Links go both ways. Nowhere, cut to seven bits, is a place that no node has.
    let mut linked = [0u128; 128];
    for (at, node) in nodes() {
        for to in links[node as usize].to {
            let to = places[to as usize] & 127;
            linked[at as usize] |= 1 << to;
            linked[to as usize] |= 1 << at;
        }
    }
    nodes().for_each(|(_, node)| places[node as usize] = NOWHERE);
    let nowhere = 1 << 127;
    let (mut seen, mut open) = (nowhere, 1u128 << near.len());
    while open != 0 {
        let at = open.trailing_zeros();
        seen |= 1 << at;
        open = (open | linked[at as usize]) & !seen;
    }
    let seen = seen & !nowhere;
    // Without the sample itself.
    seen & !(1 << near.len())
}
