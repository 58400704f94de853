//! Which samples lie on the same sheet of the surface: a deformation must not bleed from a finger to the next
//! one, or from one side of a thin wall to the other, however near they are in space.
//!
//! Two samples that see each other along the surface have normals that do not oppose, and lie near each
//! other's tangent planes. For an arc the chord is perpendicular to the mean of both normals, whatever its
//! curvature, so the chord's part along that mean tells how far one sample is *above* the other: it is
//! counted [`STACKED`]-fold. Each sample is linked to the nearest few others in that measure, and its sheet
//! is what these links reach among its neighbours in space.
//!
//! Where the model's faces have told who is on whose sheet ([`Contacts`](crate::touching::Contacts)), what
//! they say holds.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::sampling::SampleSet;

/// Most neighbours of a sample on its sheet.
pub const SHEET_NEIGHBOURS: usize = 32;

/// Neighbours in space that are looked at where several sheets are near.
pub const CROWDED_NEIGHBOURS: usize = 96;

/// How much more a distance across the surface counts than one along it.
const STACKED: f32 = 10.0;

/// Links of each sample: a ring.
const LINKS: usize = 6;

/// A sheet has at least so many samples besides the one that is looked at.
const LEAST: usize = 3;

/// As long as so many are left, neighbours are left out on whose sheets a sample is not: two rings.
const ENOUGH: usize = 16;

/// A chord within this sine of the tangent planes is one along the surface.
const ALONG: f32 = 0.2;

/// A chord beyond this sine is no link.
const ACROSS: f32 = 0.5;

/// The place of a sample that has none.
const NOWHERE: u8 = u8::MAX;

/// The neighbours of each sample on its own sheet.
///
/// Memory: at most 133 bytes per sample; where faces have told sheets apart, 4 more, and 128 for each sample
/// near which they meet.
#[derive(Debug, Serialize, Deserialize)]
pub struct Sheets {
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    crowded: Vec<bool>,
    /// Where the strangers of each sample begin; empty where there are none at all.
    stranger_starts: Vec<u32>,
    strangers: Vec<u32>,
}

impl Sheets {
    /// Of samples that are [prepared](SampleSet::prepare).
    pub fn of(samples: &SampleSet) -> Self {
        let (positions, normals, graph) = (&samples.positions[..], samples.normals(), samples.neighbours());
        let links: Vec<[u32; LINKS]> =
            (0..samples.len()).into_par_iter().map(|i| links(positions, normals, graph.of(i), i)).collect();
        let nowhere = || vec![NOWHERE; samples.len()];
        let alone = |places: &mut Vec<u8>, i: usize| {
            let told = samples.contacts().and_then(|contacts| contacts.same_sheet(i));
            if let Some(same) = told.filter(|same| same.len() >= LEAST) {
                return Some(same.to_vec());
            }
            let near = graph.of(i);
            if near.iter().all(|j| surely_along(positions, normals, i, *j as usize))
                || are_linked(&links, i, near, places)
                || reached(&links, i, near, places).count() == near.len()
            {
                return None;
            }
            // As far as so many may be, on a surface.
            let reach = near.last().map_or(0.0, |j| positions[*j as usize].distance(positions[i]));
            let reach = reach * (CROWDED_NEIGHBOURS as f32 / near.len() as f32).sqrt();
            let near = samples.neighbours_about(i, reach, CROWDED_NEIGHBOURS);
            let same: Vec<u32> = reached(&links, i, &near, places).take(SHEET_NEIGHBOURS).copied().collect();
            // Noise and creases alone do not make a second sheet, and fewer samples do not tell how they
            // turn: mostly the normal is wrong.
            (same.len() >= LEAST && same[..] != near[..same.len()]).then_some(same)
        };
        let (mut starts, mut neighbours) = (vec![0], Vec::with_capacity(samples.len() * graph.k()));
        let mut crowded = Vec::with_capacity(samples.len());
        for block in blocks(samples.len()) {
            let lists: Vec<Option<Vec<u32>>> =
                block.clone().into_par_iter().map_init(nowhere, alone).collect();
            for (i, same) in block.zip(&lists) {
                neighbours.extend_from_slice(same.as_deref().unwrap_or(graph.of(i)));
                starts.push(neighbours.len() as u32);
                crowded.push(same.is_some());
            }
        }
        let (stranger_starts, strangers) = Default::default();
        let mut sheets = Self { starts, neighbours, crowded, stranger_starts, strangers };
        sheets.leave_out_denied(positions);
        sheets.note_strangers(samples);
        sheets
    }

    /// Notes who of the nearest in space is on another sheet, where the faces have told.
    fn note_strangers(&mut self, samples: &SampleSet) {
        let Some(contacts) = samples.contacts() else { return };
        let of_sample = |i: usize| -> Vec<u32> {
            let is_stranger = |j: &&u32| !self.of_sample(i).contains(j);
            let told = contacts.same_sheet(i).map(|_| samples.neighbours().of(i));
            told.unwrap_or_default().iter().filter(is_stranger).copied().collect()
        };
        let lists: Vec<Vec<u32>> = (0..samples.len()).into_par_iter().map(of_sample).collect();
        self.stranger_starts.push(0);
        for list in lists {
            self.strangers.extend(list);
            self.stranger_starts.push(self.strangers.len() as u32);
        }
    }

    /// Leaves out neighbours on whose sheets the sample is not: those of a roof, which the walls below link
    /// to the ground around a sample there, while from the roof only the roof is reached.
    ///
    /// Memory: four bytes per sample, for the time.
    fn leave_out_denied(&mut self, positions: &[Vec3]) {
        if !self.crowded.contains(&true) {
            return;
        }
        let lists = &*self;
        // A bit for each neighbour.
        let denied = |i: usize| -> u32 {
            let list = lists.of_sample(i);
            let bit = |(at, j): (usize, &u32)| u32::from(lists.denies(positions, *j as usize, i)) << at;
            let denied: u32 = list.iter().enumerate().map(bit).sum();
            if list.len() >= ENOUGH + denied.count_ones() as usize { denied } else { 0 }
        };
        let denied: Vec<u32> = (0..lists.crowded.len()).into_par_iter().map(denied).collect();
        let (mut from, mut to) = (0, 0);
        for (i, denied) in denied.into_iter().enumerate() {
            let end = self.starts[i + 1] as usize;
            for at in 0..end - from {
                if denied >> at & 1 == 0 {
                    self.neighbours[to] = self.neighbours[from + at];
                    to += 1;
                }
            }
            self.crowded[i] |= denied != 0;
            self.starts[i + 1] = to as u32;
            from = end;
        }
        self.neighbours.truncate(to);
    }

    /// Whether sample `j`, beside which there are several sheets, knows that sample `i` is not on its own: it
    /// is nearer than others that are.
    fn denies(&self, positions: &[Vec3], j: usize, i: usize) -> bool {
        if !self.crowded[j] {
            return false;
        }
        let same = self.of_sample(j);
        let distance = |k: usize| positions[k].distance_squared(positions[j]);
        same.last().is_some_and(|last| distance(i) < distance(*last as usize)) && !same.contains(&(i as u32))
    }

    /// Whether it is of so many samples: one that was read may be anything.
    pub fn is_valid(&self, samples: usize) -> bool {
        self.crowded.len() == samples
            && are_lists(&self.starts, samples, self.neighbours.len())
            && self.starts.windows(2).all(|s| s[1] - s[0] <= SHEET_NEIGHBOURS as u32)
            && self.neighbours.iter().chain(&self.strangers).all(|j| (*j as usize) < samples)
            && (self.stranger_starts.is_empty() && self.strangers.is_empty()
                || are_lists(&self.stranger_starts, samples, self.strangers.len()))
    }

    /// The neighbours of sample `i` on its sheet, nearest first, without itself.
    #[inline]
    pub fn of_sample(&self, i: usize) -> &[u32] {
        &self.neighbours[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Whether another sheet is near the sample.
    #[inline]
    pub fn is_crowded(&self, i: usize) -> bool {
        self.crowded[i]
    }

    /// At most `count` nearest neighbours of sample `i` on its sheet, and the radius at which a kernel over
    /// them vanishes: the distance of the first neighbour that is left out, or half as much again as the last
    /// where there is none; 0 without any neighbours.
    pub fn around(&self, positions: &[Vec3], i: usize, count: usize) -> (&[u32], f32) {
        nearest_of(self.of_sample(i), positions, i, count)
    }

    /// Those of the nearest samples in space that are not on the sheet of sample `i`, nearest first, where
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

/// All samples, a sixteenth at a time: lists that are found side by side need more room than one behind the
/// other.
pub fn blocks(samples: usize) -> impl Iterator<Item = Range<usize>> {
    let size = samples.div_ceil(16).max(1 << 14);
    (0..samples).step_by(size).map(move |start| start..samples.min(start + size))
}

/// Whether these are where `lists` lists begin, one after the other, and the last ends.
pub fn are_lists(starts: &[u32], lists: usize, entries: usize) -> bool {
    starts.len() == lists + 1
        && starts.first() == Some(&0)
        && starts.is_sorted()
        && starts.last().is_some_and(|end| *end as usize == entries)
}

/// Whether normals are more than 120° apart, as on both sides of a thin plate, but not between the walls of a
/// groove.
#[inline]
pub fn faces_away(n: Vec3, side: Vec3) -> bool {
    2.0 * n.dot(side) + 1.0 <= 0.0
}

/// The square of how far a point at `d` from a sample is, where the surface between them has the normal `n`.
#[inline]
pub fn sheet_distance(d: Vec3, n: Vec3) -> f32 {
    let across = STACKED * d.dot(n);
    d.length_squared() + across * across
}

/// The chord from sample `i` to sample `j`, and the surface's normal between them (not of unit length).
fn chord(positions: &[Vec3], normals: &[Vec3], i: usize, j: usize) -> (Vec3, Vec3) {
    (positions[j] - positions[i], 0.5 * (normals[i] + normals[j]))
}

fn within(d: Vec3, n: Vec3, sine: f32) -> bool {
    let across = d.dot(n);
    across * across <= sine * sine * d.length_squared()
}

/// Whether sample `j` is so plainly beside sample `i` that nothing else has to be looked at.
fn surely_along(positions: &[Vec3], normals: &[Vec3], i: usize, j: usize) -> bool {
    let (d, n) = chord(positions, normals, i, j);
    normals[i].dot(normals[j]) >= 0.0 && within(d, n, ALONG)
}

/// The nearest samples along the surface; the sample itself in unused places.
fn links(positions: &[Vec3], normals: &[Vec3], near: &[u32], i: usize) -> [u32; LINKS] {
    let mut best = [(f32::INFINITY, i as u32); LINKS];
    for j in near {
        let (d, n) = chord(positions, normals, i, *j as usize);
        if faces_away(normals[i], normals[*j as usize]) || !within(d, n, ACROSS) {
            continue;
        }
        let entry = (sheet_distance(d, n), *j);
        let mut at = LINKS;
        while at > 0 && entry.0 < best[at - 1].0 {
            if at < LINKS {
                best[at] = best[at - 1];
            }
            best[at - 1] = entry;
            at -= 1;
        }
    }
    best.map(|(_, j)| j)
}

/// Whether each of `near` (nearest first) has a link to sample `i`, or to one that has: mostly so to a nearer one,
/// where there is one sheet alone. If not, links of the others may still lead there. `places` as for [`reached`].
fn are_linked(links: &[[u32; LINKS]], i: usize, near: &[u32], places: &mut [u8]) -> bool {
    places[i] = 0;
    let mut left = near.len();
    // The second time for those that come before what they have a link to.
    for _ in 0..2 {
        for j in near.iter().map(|j| *j as usize) {
            if places[j] == NOWHERE && links[j].iter().any(|to| places[*to as usize] != NOWHERE) {
                places[j] = 0;
                left -= 1;
            }
        }
        if left == 0 {
            break;
        }
    }
    near.iter().chain([&(i as u32)]).for_each(|j| places[*j as usize] = NOWHERE);
    left == 0
}

/// Those of `near` (fewer than 128) that links within them reach from sample `i`, in their order. `places`
/// has one for each sample, all [`NOWHERE`], before and after.
fn reached<'a>(
    links: &[[u32; LINKS]],
    i: usize,
    near: &'a [u32],
    places: &mut [u8],
) -> impl Iterator<Item = &'a u32> + use<'a> {
    // The sample itself has the last place.
    let nodes = || (0..).zip(near.iter().copied().chain([i as u32]));
    nodes().for_each(|(at, node)| places[node as usize] = at);
    // Links go both ways.
    let mut linked = [0u128; CROWDED_NEIGHBOURS + 1];
    for (at, node) in nodes() {
        for to in links[node as usize].map(|to| places[to as usize]).into_iter().filter(|to| *to != NOWHERE) {
            linked[at as usize] |= 1 << to;
            linked[to as usize] |= 1 << at;
        }
    }
    nodes().for_each(|(_, node)| places[node as usize] = NOWHERE);
    let (mut seen, mut open) = (0u128, 1u128 << near.len());
    while open != 0 {
        let at = open.trailing_zeros();
        seen |= 1 << at;
        open = (open | linked[at as usize]) & !seen;
    }
    near.iter().enumerate().filter(move |(at, _)| seen >> at & 1 == 1).map(|(_, j)| j)
}
