//! The sheets of samples where sheets meet, found once, while sampling, by the ways over the surface that the
//! model's faces make; and looked up for vertices that are sampled again.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, HashMap, HashSet};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use bytemuck::cast_slice;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_model::Result;
use simod_model::frame::Frame;
use simod_model::mapped::looked_at;
use simod_model::scratch::Scratch;

use super::ADVICE;
use super::contacts::{self, ContactLists, Contacts};
use super::islands::met_within;
use super::parting::{Parted, Parting};
use super::places::PlaceSamples;
use super::sorter::Sorter;
use crate::geometry::sheet_distance;
use crate::reconstruction::{CROWDED_NEIGHBOURS, RestGeometry, SHEET_NEIGHBOURS, TANGENT_RING, homes};
use crate::sampled_model::SampledModel;
use crate::sampling::kept_cells::CutTree;
use crate::sampling::{NEIGHBOURS, SampleSet};

// The lists that are kept are as long as those of the reconstruction.
const _: () = assert!(contacts::MOST == SHEET_NEIGHBOURS);

/// Ratio of the length of a way over the surface, from sample to sample, to the distance of the furthest
/// neighbour, above which the way leads to another sheet, or another side of a fold.
const DETOUR: f32 = 1.5;

/// Vertices whose homes are looked up at a time.
const BATCH: usize = 1 << 14;

impl Contacts {
    /// Contacts of the samples of a model in which sheets meet; `sample_of` has the sample of each vertex,
    /// and `trees` the samples of each cell. Where clusters were parted there are contacts, though nothing
    /// may be near any more: so it is known that they were.
    ///
    /// # Errors
    /// The model cannot be read, or a temporary file written; the user cancelled.
    pub fn find(
        sampled: &mut SampledModel,
        parted: &Parted,
        sample_of: &[u32],
        trees: &[CutTree],
        parting: &Parting<'_>,
    ) -> Result<()> {
        let samples = &sampled.samples;
        samples.prepare_tree();
        let first = samples.len() - parted.added.len();
        let parted_from: Vec<[u32; 2]> =
            (first as u32..).zip(&parted.added).map(|(i, (of, ..))| [i, *of]).collect();
        let (lists, others) = same_sheet(samples, parted, &parted.all_seeds());
        if lists.is_empty() && parted.moved.is_empty() {
            return Ok(());
        }
        let contacts = Self { lists: ContactLists::new(lists, parted_from), ..Self::default() };
        let places = contacts.exceptions(sampled, &others, sample_of, trees, parting)?;
        sampled.samples.set_contacts(Some(Self { places: Arc::new(places), ..contacts }));
        Ok(())
    }

    /// The places of vertices whose homes may be on another sheet than their own cluster is on: where a
    /// sample of one of the `others` explains the place about as well as its own does.
    fn exceptions(
        &self,
        sampled: &SampledModel,
        others: &BTreeMap<u32, Vec<u32>>,
        sample_of: &[u32],
        trees: &[CutTree],
        parting: &Parting<'_>,
    ) -> Result<PlaceSamples> {
        let Self { lists, .. } = self;
        if lists.samples.is_empty() {
            return Ok(PlaceSamples::default());
        }
        let of_cell: BTreeMap<u32, u32> = lists.parted.iter().map(|[sample, of]| (*sample, *of)).collect();
        // A byte per sample, for the time: whether its cell is read, and whether its own vertices are.
        let mut wanted = vec![(false, false); sampled.samples.len()];
        for sample in &lists.samples {
            wanted[*sample as usize].1 = true;
            wanted[*of_cell.get(sample).unwrap_or(sample) as usize].0 = true;
        }
        let others = lists.samples.iter().map(|sample| others.get(sample).map_or(&[][..], |others| others));
        let others: Vec<&[u32]> = others.collect();
        let planes = Tangents::new(&sampled.samples, lists, &others);
        let mut places = Sorter::new(parting.folder);
        let ranges = parting.ranges_with(trees, |sample| wanted[sample as usize].0);
        parting.vertices(ranges, |vertex, p, _| {
            let own = sample_of[vertex as usize];
            if !p.is_finite() || !wanted[own as usize].1 {
                return Ok(());
            }
            let p = sampled.frame.to_local(p);
            if planes.may_be_of_others(own, others[planes.place[own as usize] as usize], p) {
                places.push(PlaceSamples::entry(p, own))
            } else {
                Ok(())
            }
        })?;
        PlaceSamples::build(places, sampled.samples.len(), parting.folder)
    }

    /// Contacts of a refined model: of `samples`, whose sheets are `inherited`. `parted` are the samples that
    /// no cell's tree has now, each with a sample of its cluster that a tree has.
    pub(crate) fn refined(
        inherited: &InheritedSheets<'_>,
        samples: &SampleSet,
        parted: Vec<[u32; 2]>,
    ) -> Self {
        let list = |i: u32| {
            let own = inherited.origin(i);
            inherited.contacts.same_sheet(own as usize)?;
            let near = samples.nearest_neighbours(i as usize, CROWDED_NEIGHBOURS);
            let is_same = |j: &u32| inherited.is_of(*j, own);
            let mut same: Vec<u32> = near.iter().copied().filter(is_same).take(SHEET_NEIGHBOURS).collect();
            let left_out: Vec<(u32, u32)> = left_out_by(i, &near, &same).collect();
            if same.len() < SHEET_NEIGHBOURS {
                // Samples farther off, as the sample's own sheet had before.
                let known = inherited.contacts.same_sheet(own as usize).unwrap_or_default();
                let distance = |j: u32| samples.positions[i as usize].distance(samples.positions[j as usize]);
                let farther = known.iter().chain([&own]).filter(|j| **j != i && !near.contains(*j));
                let mut farther: Vec<(u32, u32)> = farther.map(|j| (distance(*j).to_bits(), *j)).collect();
                farther.sort_unstable();
                farther.truncate(SHEET_NEIGHBOURS - same.len());
                same.extend(farther.into_iter().map(|(_, j)| j));
            }
            Some(((i, same), left_out))
        };
        let found: Vec<_> = (0..samples.len() as u32).into_par_iter().filter_map(list).collect();
        let (mut lists, left_out): (BTreeMap<_, _>, Vec<_>) = found.into_iter().unzip();
        make_mutual(samples, left_out.concat(), &mut lists);
        Self { lists: ContactLists::new(lists, parted), places: inherited.contacts.places.clone() }
    }

    /// Contacts with the places of those vertices whose homes would be on another sheet than before, each
    /// with the nearest sample of its sheet now: its former sample may be far off, as samples are apart here.
    ///
    /// Memory: besides that of the places, a bit for each place that there was.
    pub(crate) fn with_places(
        self,
        inherited: &InheritedSheets<'_>,
        sampled: &SampledModel,
        vertices: ContactVertices,
        folder: &Path,
    ) -> Result<Self> {
        if vertices.bytes == 0 {
            return Ok(self);
        }
        let (mut all, mut again) = (Sorter::new(folder), vec![0u64; self.places.all().len().div_ceil(64)]);
        let near = self.near(&sampled.samples);
        let around = RestGeometry::new(&near.samples);
        let mut found = Vec::new();
        vertices.each(|positions, own| {
            let in_model: Vec<DVec3> = positions.iter().map(|p| sampled.frame.to_model(*p)).collect();
            homes(&around, &sampled.frame, &in_model, &mut found);
            for ((p, own), home) in positions.iter().zip(own).zip(&found) {
                if let Some(at) = self.places.find(*p) {
                    again[at / 64] |= 1 << (at % 64);
                }
                if !inherited.is_of(near.numbers[*home as usize], *own) {
                    let mut found = [0; CROWDED_NEIGHBOURS];
                    let mut nearest = sampled.samples.nearest_ones(*p, &mut found);
                    let nearest = nearest.find(|j| inherited.is_of(*j, *own)).unwrap_or(*own);
                    all.push(PlaceSamples::entry(*p, nearest))?;
                }
            }
            Ok(())
        })?;
        let stays = |at: usize| again[at / 64] >> (at % 64) & 1 == 0;
        let stay = self.places.all().iter().enumerate().filter(|(at, _)| stays(*at));
        stay.map(|(_, place)| *place).try_for_each(|place| all.push(place))?;
        let places = Arc::new(PlaceSamples::build(all, sampled.samples.len(), folder)?);
        Ok(Self { places, ..self })
    }

    /// The samples, of all of these, near which sheets meet, and those that homes there depend on.
    pub(crate) fn near(&self, samples: &SampleSet) -> Near {
        Near::new(samples, &self.lists)
    }
}

/// The sheets of the samples of a refined model, by those that were there before.
pub(crate) struct InheritedSheets<'a> {
    /// The contacts that were known before.
    pub contacts: &'a Contacts,
    /// Number of samples before the refinement.
    pub before: usize,
    /// Sample from before the refinement on whose sheet each new sample is.
    pub origins: &'a [u32],
}

impl InheritedSheets<'_> {
    /// Sample from before the refinement on the sheet of `sample`; itself, if it was there.
    fn origin(&self, sample: u32) -> u32 {
        (sample as usize).checked_sub(self.before).map_or(sample, |new| self.origins[new])
    }

    /// Whether `sample` is known to be on the sheet of `own`, a sample from before the refinement, and near
    /// to it.
    fn is_of(&self, sample: u32, own: u32) -> bool {
        let other = self.origin(sample);
        let knows =
            |i: u32, j: u32| self.contacts.same_sheet(i as usize).is_some_and(|same| same.contains(&j));
        other == own || knows(own, other) || knows(other, own)
    }
}

/// The samples near which sheets meet, with all that the homes of places there depend on.
pub(crate) struct Near {
    /// The samples' numbers in the whole set, ascending.
    numbers: Vec<u32>,
    samples: SampleSet,
}

/// Numbers of neighbours that are gone on to, one after the other: the home of a place is among those of the
/// sample of its cell, whose sheet is looked for among those around, by the links that these have to their
/// own neighbours.
const RINGS: [usize; 3] = [NEIGHBOURS, CROWDED_NEIGHBOURS, NEIGHBOURS];

impl Near {
    fn new(samples: &SampleSet, lists: &ContactLists) -> Self {
        let mut numbers: BTreeSet<u32> = lists.samples.iter().copied().collect();
        let mut border = lists.samples.clone();
        for count in RINGS {
            let near = border.par_iter().map(|i| samples.nearest_neighbours(*i as usize, count));
            border = near.collect::<Vec<_>>().into_iter().flatten().filter(|i| numbers.insert(*i)).collect();
        }
        // The outermost samples of all are included, so that the cells in which homes are looked up are those
        // of the whole set.
        for axis in 0..3 {
            let by_place = |a: &u32, b: &u32| {
                let [a, b] = [a, b].map(|i| samples.positions[*i as usize][axis]);
                a.total_cmp(&b)
            };
            numbers.extend((0..samples.len() as u32).min_by(by_place));
            numbers.extend((0..samples.len() as u32).max_by(by_place));
        }
        let numbers: Vec<u32> = numbers.into_iter().collect();
        let mut near = Self { samples: samples.part(&numbers), numbers };
        let lists = (0..)
            .zip(&near.numbers)
            .filter_map(|(place, i)| Some((place, lists.get(*i as usize)?)))
            .map(|(place, same)| (place, same.iter().filter_map(|i| near.place(*i)).collect()));
        let lists = ContactLists::new(lists.collect(), Vec::new());
        near.samples.set_contacts(Some(Contacts { lists, ..Contacts::default() }));
        near
    }

    /// The place of a sample of the whole set.
    fn place(&self, sample: u32) -> Option<u32> {
        self.numbers.binary_search(&sample).ok().map(|place| place as u32)
    }
}

/// Vertices near which sheets meet, and a sample on the sheet of each: in a temporary file of 16 bytes per
/// vertex.
pub(crate) struct ContactVertices {
    file: Scratch,
    bytes: u64,
}

impl ContactVertices {
    /// A table without vertices yet. The file goes to `folder`.
    pub fn new(folder: &Path) -> Result<Self> {
        Ok(Self { file: Scratch::new(folder, ADVICE)?, bytes: 0 })
    }

    /// Notes vertices at local positions, each with a sample.
    pub fn note(&mut self, vertices: impl Iterator<Item = (Vec3, u32)>) -> Result<()> {
        let vertices: Vec<[u32; 4]> =
            vertices.map(|(p, sample)| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits(), sample]).collect();
        self.file.write_at(cast_slice(&vertices), self.bytes)?;
        self.bytes += size_of_val(&vertices[..]) as u64;
        Ok(())
    }

    /// Visits all vertices, some at a time.
    fn each(self, mut visit: impl FnMut(&[Vec3], &[u32]) -> Result<()>) -> Result<()> {
        let map = self.file.map()?;
        let all: &[[u32; 4]] = cast_slice(&map);
        for some in all.chunks(BATCH) {
            let place =
                |v: &[u32; 4]| Vec3::new(f32::from_bits(v[0]), f32::from_bits(v[1]), f32::from_bits(v[2]));
            let positions: Vec<Vec3> = some.iter().map(place).collect();
            let samples: Vec<u32> = some.iter().map(|v| v[3]).collect();
            visit(&positions, &samples)?;
            looked_at(size_of_val(some));
        }
        Ok(())
    }
}

/// Finder of the sheets of vertices where sheets meet, by samples whose sheets are known. Its tables are made
/// when the first vertices are [looked at](Self::of).
pub(crate) struct Guides<'a> {
    contacts: &'a Contacts,
    samples: &'a SampleSet,
    near: &'a OnceLock<Near>,
    around: OnceLock<RestGeometry<'a>>,
    /// The samples that share the cluster of one that a tree has.
    parted: HashMap<u32, Vec<u32>>,
}

impl<'a> Guides<'a> {
    /// The guides of samples that have contacts. `near` is to be empty.
    pub fn new(samples: &'a SampleSet, contacts: &'a Contacts, near: &'a OnceLock<Near>) -> Self {
        let mut parted: HashMap<u32, Vec<u32>> = HashMap::new();
        contacts.parted().iter().for_each(|[sample, of]| parted.entry(*of).or_default().push(*sample));
        Self { contacts, samples, near, around: OnceLock::new(), parted }
    }

    fn near(&self) -> &'a Near {
        self.near.get_or_init(|| self.contacts.near(self.samples))
    }

    fn around(&self) -> &RestGeometry<'a> {
        self.around.get_or_init(|| RestGeometry::new(&self.near().samples))
    }

    /// Whether sheets meet near one of these samples.
    pub fn concern(&self, samples: &[u32]) -> bool {
        samples.iter().any(|sample| self.contacts.same_sheet(*sample as usize).is_some())
    }

    /// Sample of its sheet for each local position near such a sample. Not to be called by jobs of the thread
    /// pool.
    pub fn find(&self, frame: &Frame, positions: impl Iterator<Item = Vec3> + Clone) -> Vec<u32> {
        let in_model: Vec<DVec3> = positions.clone().map(|p| frame.to_model(p)).collect();
        let mut guides = Vec::new();
        homes(self.around(), frame, &in_model, &mut guides);
        for (guide, p) in guides.iter_mut().zip(positions) {
            let home = self.near().numbers[*guide as usize];
            *guide = self.contacts.sample_at(p).unwrap_or(home);
        }
        guides
    }

    /// Whether two samples are on one sheet; `true` where that is not known.
    pub fn share_sheet(&self, a: u32, b: u32) -> bool {
        match [a, b].map(|sample| self.near().place(sample)) {
            [Some(a), Some(b)] => self.around().share_sheet(a as usize, b),
            _ => true,
        }
    }

    /// Samples that no cell's tree has, and the one of its cluster that each was parted from.
    pub fn parted(&self) -> &[[u32; 2]] {
        self.contacts.parted()
    }

    /// Samples that share the cluster of one that a tree has, without that one.
    pub fn parted_from(&self, sample: u32) -> &[u32] {
        self.parted.get(&sample).map_or(&[], |parted| parted)
    }

    /// Samples on each of the sheets that some vertices are on, that of most vertices first, and the place
    /// among these of each vertex's.
    pub fn sheets(&self, guides: impl Iterator<Item = u32> + Clone) -> (Vec<u32>, Vec<u32>) {
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        guides.clone().for_each(|guide| *counts.entry(guide).or_default() += 1);
        let mut by_count: Vec<(u32, usize)> = counts.into_iter().collect();
        by_count.sort_by_key(|(_, count)| Reverse(*count));
        let (mut sheets, mut sheet_of): (Vec<u32>, HashMap<u32, u32>) = Default::default();
        for (guide, _) in by_count {
            let known = sheets.iter().position(|first| self.share_sheet(*first, guide));
            sheet_of.insert(guide, known.unwrap_or(sheets.len()) as u32);
            if known.is_none() {
                sheets.push(guide);
            }
        }
        (sheets, guides.map(|guide| sheet_of[&guide]).collect())
    }

    /// The sample, in the cluster of one that a tree has, that is on the sheet of `guide`; `guide` itself if
    /// there is none.
    pub fn of_cluster(&self, sample: u32, guide: u32) -> u32 {
        let all = || [sample].into_iter().chain(self.parted_from(sample).iter().copied());
        let found =
            all().find(|own| *own == guide).or_else(|| all().find(|own| self.share_sheet(*own, guide)));
        found.unwrap_or(guide)
    }
}

/// Ratio by which a plane may suit a place worse than that of its own sample and yet be kept: homes are found
/// with a few neighbours more or less than here.
const AMBIGUOUS: f32 = 2.0;

/// Tangent planes by which homes are told where sheets meet.
struct Tangents<'a> {
    samples: &'a SampleSet,
    normals: Vec<Vec3>,
    /// Square of the distance of each sample from the last one of its ring.
    reach: Vec<f32>,
    /// Distance from each sample up to which all samples are known, on whatever sheet.
    known: Vec<f32>,
    /// The place of each sample in the lists; [`NONE`] where no sheets meet.
    place: Vec<u32>,
}

/// No place.
const NONE: u32 = u32::MAX;

impl<'a> Tangents<'a> {
    /// The tangent planes of the samples near which sheets meet.
    ///
    /// Memory: 20 bytes for each sample with a list, and 4 per sample.
    fn new(samples: &'a SampleSet, lists: &ContactLists, others: &[&[u32]]) -> Self {
        let of_samples = samples.normals();
        let normal = |i: &u32| {
            let ring = lists.get(*i as usize).unwrap_or_default().iter().take(TANGENT_RING);
            let sum: Vec3 = ring.chain([i]).map(|j| of_samples[*j as usize]).sum();
            sum.try_normalize().unwrap_or(of_samples[*i as usize])
        };
        let mut place = vec![NONE; samples.len()];
        (0..).zip(&lists.samples).for_each(|(at, sample)| place[*sample as usize] = at);
        let reach = |i: &u32| {
            let ring = lists.get(*i as usize).unwrap_or_default();
            let last = ring.get(TANGENT_RING).or(ring.last());
            let distance =
                |j: &u32| samples.positions[*i as usize].distance_squared(samples.positions[*j as usize]);
            last.map_or(0.0, distance)
        };
        let known = |(i, others): (&u32, &&[u32])| {
            let all = lists.get(*i as usize).unwrap_or_default().iter().chain(*others);
            let distance = |j: &u32| samples.positions[*i as usize].distance(samples.positions[*j as usize]);
            let mut all: Vec<f32> = all.map(distance).collect();
            all.sort_unstable_by(f32::total_cmp);
            // What is farther than the neighbours that were looked at is of the sample's own sheet alone.
            all.get(CROWDED_NEIGHBOURS - 1).or(all.last()).copied().unwrap_or_default()
        };
        let known = lists.samples.par_iter().zip(others).map(known).collect();
        let (normals, reach) = lists.samples.par_iter().map(|i| (normal(i), reach(i))).unzip();
        Self { samples, normals, reach, known, place }
    }

    /// Whether the home of a place of sample `own` may be one of `others`: where one of their planes suits
    /// the place about as well, or where the place is so far from `own` that others are decided on before
    /// `own`, be it that those of its own sheet are or that none of the samples around `own` is near to the
    /// place.
    fn may_be_of_others(&self, own: u32, others: &[u32], p: Vec3) -> bool {
        let away = |i: u32| p - self.samples.positions[i as usize];
        let normal = |i: u32| self.normals[self.place[i as usize] as usize];
        let d = away(own);
        if d.length_squared() >= self.reach[self.place[own as usize] as usize] {
            return true;
        }
        let most = AMBIGUOUS * sheet_distance(d, normal(own));
        if self.known[self.place[own as usize] as usize] <= d.length() + most.sqrt() {
            return true;
        }
        others.iter().any(|j| {
            let d = away(*j);
            d.length_squared() <= most
                && (self.place[*j as usize] == NONE || sheet_distance(d, normal(*j)) <= most)
        })
    }
}

/// The neighbours of each of some samples.
type SampleLists = BTreeMap<u32, Vec<u32>>;

/// A sample near which sheets meet.
struct Crowded {
    sample: u32,
    /// Distance of the last of as many neighbours as a list may have.
    reach: f32,
    near: Vec<u32>,
    /// The neighbours that are on the sample's sheet, no more than a list may have, and those that are not.
    same: Vec<u32>,
    others: Vec<u32>,
}

/// Samples that are looked at by one job.
const JOB: usize = 256;

/// The nearest neighbours of a sample among which another sheet is looked for: a ring, and some more.
const NEAREST: usize = 8;

/// Largest number of samples that are met from one: more of them are around one that stands for much of a
/// model.
const MOST_MET: usize = 256;

/// The samples, ascending, among whose nearest are some on another sheet, if samples are at these positions
/// (local coordinates): sheets meet there, though no cluster may hold vertices of both.
///
/// Memory: 80 bytes per sample.
///
/// # Errors
/// A position is not finite.
pub(crate) fn meeting(positions: Vec<Vec3>, parted: &Parted) -> Result<Vec<u32>> {
    let samples = SampleSet::new(positions, Vec::new())?;
    let nearest = samples.graph_to(NEAREST);
    let meets = |ring: &mut Vec<u32>, sample: u32| {
        let near = nearest.nearest_to(sample as usize);
        !are_beside(parted, sample, near, ring) && !are_met(parted, sample, near)
    };
    let all = (0..samples.len() as u32).into_par_iter().with_min_len(JOB);
    let found = all.map_init(Vec::new, |ring, sample| meets(ring, sample).then_some(sample));
    Ok(found.flatten().collect())
}

/// Whether each sample of `near` is joined with `sample`, or with one that is, as is mostly so. `ring`
/// becomes the samples that are joined with `sample`.
fn are_beside(parted: &Parted, sample: u32, near: &[u32], ring: &mut Vec<u32>) -> bool {
    ring.clear();
    parted.each_joined(sample, |other| ring.push(other));
    let is_beside = |j: &u32| {
        let mut found = ring.contains(j);
        if !found {
            parted.each_joined(*j, |other| found |= ring.contains(&other));
        }
        found
    };
    near.iter().all(is_beside)
}

/// Whether faces lead from a sample to each one of `near` in few steps.
fn are_met(parted: &Parted, sample: u32, near: &[u32]) -> bool {
    let are_all = |met: &[u32]| near.iter().all(|j| met.contains(j));
    let each_joined = |sample, visit: &mut dyn FnMut(u32)| parted.each_joined(sample, visit);
    are_all(&met_within(sample, MOST_MET, each_joined, are_all))
}

/// The samples near which sheets meet, ascending, if samples are at these positions (local coordinates).
///
/// Memory: 48 bytes per sample, and on each thread another one; the lists of neighbours of those that it
/// finds.
///
/// # Errors
/// A position is not finite.
pub(crate) fn crowded(positions: Vec<Vec3>, parted: &Parted) -> Result<Vec<u32>> {
    let samples = SampleSet::new(positions, Vec::new())?;
    samples.prepare_tree();
    Ok(same_sheet(&samples, parted, &parted.seeds).0.into_keys().collect())
}

/// The neighbours on its sheet of each sample near which sheets meet, and those that are left out: going out
/// from some where they do, as far as the nearest samples are not all on the same one.
///
/// Memory: a byte per sample, and on each thread another one.
fn same_sheet(samples: &SampleSet, parted: &Parted, seeds: &[u32]) -> (SampleLists, SampleLists) {
    let mut known = vec![false; samples.len()];
    // Samples with the distance of the neighbours of the one from which each was gone on to.
    let mut open: Vec<(u32, f32)> = seeds.iter().map(|seed| (*seed, 0.0)).collect();
    open.iter().for_each(|(seed, _)| known[*seed as usize] = true);
    let (mut lists, mut others) = (SampleLists::new(), SampleLists::new());
    let mut left_out = Vec::new();
    let distance = |i: u32, j: u32| samples.positions[i as usize].distance(samples.positions[j as usize]);
    let look = |ways: &mut WaySearch<'_>, sample: u32, reach: f32| {
        // Mostly short ways lead to as many as a list holds, without going round by others.
        let near = samples.neighbours_about(sample as usize, reach, SHEET_NEIGHBOURS);
        if ways.lead_to_all(sample, &near) {
            return None;
        }
        // On a surface their number grows as the square of the distance does.
        let more = (CROWDED_NEIGHBOURS as f32 / near.len().max(1) as f32).sqrt();
        let reach = near.last().map_or(0.0, |last| distance(sample, *last));
        let near = samples.neighbours_about(sample as usize, more * reach, CROWDED_NEIGHBOURS);
        let mut same = ways.connected(sample, &near);
        let others: Vec<u32> = without(&near, &same).collect();
        if same.len() < SHEET_NEIGHBOURS {
            same.extend(ways.farther(sample, &near, SHEET_NEIGHBOURS - same.len()));
        }
        same.truncate(SHEET_NEIGHBOURS);
        (same[..] != near[..same.len()]).then_some(Crowded { sample, reach, near, same, others })
    };
    while !open.is_empty() {
        let jobs = open.par_chunks(JOB).flat_map_iter(|some| {
            let mut ways = WaySearch::new(&samples.positions, parted);
            some.iter().filter_map(|(sample, reach)| look(&mut ways, *sample, *reach)).collect::<Vec<_>>()
        });
        let found: Vec<Crowded> = jobs.collect();
        open.clear();
        for crowded in found {
            let Crowded { sample, reach, near, same, others: left } = crowded;
            // Samples of another sheet beyond the end of the list are beside others that are nearer.
            for near in &near[..end_of(&near, &same).max(SHEET_NEIGHBOURS.min(near.len()))] {
                if !std::mem::replace(&mut known[*near as usize], true) {
                    open.push((*near, reach));
                }
            }
            left_out.extend(left_out_by(sample, &near, &same));
            others.insert(sample, left);
            lists.insert(sample, same);
        }
    }
    for (by, whom) in make_mutual(samples, left_out, &mut lists) {
        others.entry(by).or_default().push(whom);
    }
    (lists, others)
}

/// The samples among the nearest of one that are on another sheet, each with that sample.
fn left_out_by<'a>(sample: u32, near: &'a [u32], same: &'a [u32]) -> impl Iterator<Item = (u32, u32)> + 'a {
    // Samples beyond the last one of the list are not left out.
    without(&near[..end_of(near, same)], same).map(move |j| (j, sample))
}

/// Place in `near` of the last sample of `same`; the length of `near` if `same` is empty, or ends beyond it.
fn end_of(near: &[u32], same: &[u32]) -> usize {
    same.last().map_or(near.len(), |last| near.iter().position(|j| j == last).unwrap_or(near.len()))
}

/// Samples of `all` without `some` of them, which are in the same order.
fn without<'a>(all: &'a [u32], some: &'a [u32]) -> impl Iterator<Item = u32> + 'a {
    let mut some = some.iter().peekable();
    all.iter().filter(move |j| some.next_if_eq(j).is_none()).copied()
}

/// Makes leaving out mutual: a sample that another one leaves out leaves that one out, too. Returns each
/// sample that had not, with the other one.
fn make_mutual(
    samples: &SampleSet,
    left_out: Vec<(u32, u32)>,
    lists: &mut BTreeMap<u32, Vec<u32>>,
) -> Vec<(u32, u32)> {
    let mut new = Vec::new();
    // Neighbours of samples without a list.
    let mut nearest: HashMap<u32, Vec<u32>> = HashMap::new();
    for (by, whom) in left_out {
        if let Some(list) = lists.get_mut(&by) {
            if let Some(at) = list.iter().position(|j| *j == whom) {
                list.remove(at);
                new.push((by, whom));
            }
            continue;
        }
        let list = nearest.entry(by).or_insert_with(|| samples.nearest_neighbours(by as usize, NEIGHBOURS));
        if list.contains(&whom) {
            lists.insert(by, list.iter().copied().filter(|j| *j != whom).collect());
            new.push((by, whom));
        }
    }
    new
}

/// Looks for ways over the surface, over samples that faces join.
struct WaySearch<'a> {
    positions: &'a [Vec3],
    parted: &'a Parted,
    /// The place of each sample among those that are looked at, from one on; 0 for others.
    places: Vec<u8>,
    /// Start of each sample's joins, and for each join the place of the other sample and the distance to it.
    starts: Vec<usize>,
    joins: Vec<(u8, f32)>,
    /// Length of the shortest way found to each sample, and the most that it may be.
    lengths: Vec<f32>,
    most: f32,
}

impl<'a> WaySearch<'a> {
    fn new(positions: &'a [Vec3], parted: &'a Parted) -> Self {
        let places = vec![0; positions.len()];
        let (starts, joins, lengths) = Default::default();
        Self { positions, parted, places, starts, joins, lengths, most: 0.0 }
    }

    /// Whether short ways are found at once from a sample to all of `near`; if not, there may still be such
    /// ways.
    fn lead_to_all(&mut self, sample: u32, near: &[u32]) -> bool {
        self.join(sample, near);
        self.shorten();
        self.lengths.iter().all(|length| length.is_finite())
    }

    /// The samples of `near`, in their order, to which a short way leads from a sample.
    fn connected(&mut self, sample: u32, near: &[u32]) -> Vec<u32> {
        self.join(sample, near);
        while self.shorten() {}
        near.iter().zip(&self.lengths[1..]).filter(|(_, way)| way.is_finite()).map(|(j, _)| *j).collect()
    }

    /// Samples beyond the last of `near` to which short ways lead from a sample, the nearest first: as many
    /// as are wanted, by the shortest ways. Where many sheets are near each other, few samples near in space
    /// are on one of them.
    fn farther(&self, sample: u32, near: &[u32], wanted: usize) -> Vec<u32> {
        let distance = |a: u32, b: u32| self.positions[a as usize].distance(self.positions[b as usize]);
        // Lengths are never less than nothing: their bits have the same order.
        let mut open = BinaryHeap::from([Reverse((0.0f32.to_bits(), sample))]);
        let (mut met, mut found) = (HashSet::new(), Vec::new());
        while found.len() < wanted
            && met.len() < MOST_MET
            && let Some(Reverse((bits, node))) = open.pop()
        {
            if !met.insert(node) {
                continue;
            }
            let (way, direct) = (f32::from_bits(bits), distance(sample, node));
            if node != sample && way <= DETOUR * direct && !near.contains(&node) {
                found.push((direct.to_bits(), node));
            }
            self.parted.each_joined(node, |other| {
                if !met.contains(&other) {
                    open.push(Reverse(((way + distance(node, other)).to_bits(), other)));
                }
            });
        }
        found.sort_unstable();
        found.into_iter().map(|(_, node)| node).collect()
    }

    /// Looks up the joins among a sample, which has the first place, and others around it, the nearest first:
    /// fewer than 255.
    fn join(&mut self, sample: u32, near: &[u32]) {
        let Self { positions, parted, places, starts, joins, lengths, most } = self;
        let distance = |a: u32, b: u32| positions[a as usize].distance(positions[b as usize]);
        *most = DETOUR * near.last().map_or(0.0, |last| distance(sample, *last));
        let nodes = || [sample].into_iter().chain(near.iter().copied());
        (1..).zip(nodes()).for_each(|(place, node)| places[node as usize] = place);
        starts.clear();
        joins.clear();
        for node in nodes() {
            starts.push(joins.len());
            parted.each_joined(node, |other| {
                if let Some(to) = places[other as usize].checked_sub(1) {
                    joins.push((to, distance(node, other)));
                }
            });
        }
        starts.push(joins.len());
        nodes().for_each(|node| places[node as usize] = 0);
        lengths.clear();
        lengths.push(0.0);
        lengths.resize(near.len() + 1, f32::INFINITY);
    }

    /// Goes on from all places to which ways are known, whether there were any shorter ones.
    fn shorten(&mut self) -> bool {
        let mut shorter = false;
        for at in 0..self.lengths.len() {
            let way = self.lengths[at];
            if way.is_finite() {
                for (to, length) in &self.joins[self.starts[at]..self.starts[at + 1]] {
                    let (way, known) = (way + length, &mut self.lengths[usize::from(*to)]);
                    if way < *known && way <= self.most {
                        *known = way;
                        shorter = true;
                    }
                }
            }
        }
        shorter
    }
}
