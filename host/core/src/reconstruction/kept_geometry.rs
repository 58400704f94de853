//! Geometry of the samples at rest, kept beside them in `rest.bin`. The first reconstruction finds it, and
//! all others read it.
//!
//! The file is [sealed](crate::sealed). It has the parts that take time to find, and are small: neighbours,
//! as differences of their numbers; the sheets that are not just those; the order of the supports around each
//! home; the cells by which homes are found; and normals, where they were estimated. Numbers that follow from
//! these and the samples' places, as distances and radii, are computed anew. The file is a cache: where it is
//! not there, damaged, or of other samples, all is found as if there were none, and where it cannot be
//! written, nobody misses it.

use std::io::{self, Write};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use bytemuck::Zeroable;
use glam::Vec3;
use rayon::prelude::*;
use serde::ser::SerializeSeq;
use serde::{Deserialize, Serialize, Serializer};
use simod_model::long_list::{ListStorage, LongList};
use xxhash_rust::xxh3::Xxh3Default;

use super::RestGeometry;
use super::blend::Supports;
use super::expansion::ReachingSupport;
use super::home_cells::HomeOctree;
use super::near_lists::{self, BEHIND, LONGEST};
use super::sheets::{Listed, Sheets};
use crate::sampled_model::{REST, SampledModel};
use crate::sampling::{NEIGHBOURS, NeighbourGraph, SampleSet};
use crate::sealed::{unseal, write_sealed};
use crate::touching::Contacts;
use crate::varint::{self, VarintNumbers};

const LETTERS: &[u8; 8] = b"SIMODRST";

/// Version of the file, counted up whenever the format changes, or the geometry of the same samples.
const VERSION: u32 = 1;

/// Samples whose lists are packed by one job.
const TOGETHER: usize = 4096;

/// Pieces that are packed at a time.
const AT_ONCE: usize = 64;

/// Most bytes of a file for each sample, beside [`LEAST`]: lists of 32 samples take 200 bytes at most, and
/// there are three for each.
const MOST: u64 = 1 << 10;

/// Bytes of a file for each sample, mostly.
const USUAL: u64 = 110;

/// Bytes that a file of any number of samples may have.
const LEAST: u64 = 1 << 16;

/// Code in a home's list, in place of a neighbour, for the home itself.
const ITSELF: u8 = LONGEST as u8;

/// Code in a home's list, in place of a neighbour, for another sample, whose difference follows.
const OTHER: u8 = ITSELF + 1;

/// The content of the file.
#[derive(Serialize, Deserialize)]
struct RestFile<'a, P> {
    /// Hash of all that it depends on.
    key: u128,
    /// Three numbers of each normal, if some had to be estimated.
    #[serde(serialize_with = "as_bytes")]
    normals: &'a [u8],
    /// Lists of those that have their own, and strangers.
    #[serde(serialize_with = "as_bytes")]
    sheets: &'a [u8],
    /// Eight numbers of each cell.
    #[serde(serialize_with = "as_bytes")]
    cells: &'a [u8],
    pieces: P,
}

/// Neighbours and supports of [`TOGETHER`] samples, packed.
#[derive(Serialize, Deserialize)]
struct SamplePiece<'a> {
    #[serde(serialize_with = "as_bytes")]
    neighbours: &'a [u8],
    /// Number of the supports of all homes.
    reaching: u32,
    #[serde(serialize_with = "as_bytes")]
    supports: &'a [u8],
}

/// Writes all bytes at once, in place of one by one.
fn as_bytes<S: Serializer>(bytes: &[u8], to: S) -> std::result::Result<S::Ok, S::Error> {
    to.serialize_bytes(bytes)
}

impl<'a> RestGeometry<'a> {
    /// Geometry of a model's samples at rest: as it is held from before, as it was kept beside them, or found
    /// now.
    pub fn kept(sampled: &'a SampledModel) -> Self {
        let held = Self::held(&sampled.samples).or_else(|| kept(sampled));
        held.unwrap_or_else(|| Self::new(&sampled.samples))
    }
}

/// Geometry that was kept beside the samples, if it is there, whole, and of these samples.
pub(super) fn kept(sampled: &SampledModel) -> Option<RestGeometry<'_>> {
    let samples = sampled.samples.len() as u64;
    let around = unpack(&sampled.samples, &sampled.read_beside(REST, LEAST + MOST * samples)?)?;
    if around.sheets.knows_strangers() {
        // Homes among many sheets are looked up in it: built here, on all threads.
        sampled.samples.prepare_tree();
    }
    around.set_kept();
    Some(around)
}

/// Keeps the geometry that is held with a model's samples in their folder, for later reconstructions, unless
/// it is there. It is left out where another process has the folder, or it cannot be written.
pub fn keep_geometry(sampled: &SampledModel) {
    if let Some(around) = RestGeometry::held(&sampled.samples).filter(|around| !around.is_kept()) {
        keep(sampled, &around);
    }
}

/// Keeps it in the folder that the samples are from, if there is one, and as far as that can be written.
///
/// Memory: 110 bytes for each sample of [`AT_ONCE`] pieces, some 30 MB; for each sample of all one byte for
/// each thread, about 5 for the cells, and 12 where normals were estimated.
pub(super) fn keep(sampled: &SampledModel, around: &RestGeometry<'_>) {
    // A file that cannot be written is not missed.
    let bytes = USUAL * sampled.samples.len() as u64;
    if sampled.keep_beside(REST, bytes, |file| pack(around, file)).is_ok() {
        around.set_kept();
    }
}

/// Hash of all that the geometry is found by.
fn key(samples: &SampleSet) -> u128 {
    let mut hash = Xxh3Default::new();
    hash.update(env!("CARGO_PKG_VERSION").as_bytes());
    for points in [&samples.positions, samples.known_normals()] {
        hash.update(&(points.len() as u64).to_le_bytes());
        hash.update(bytemuck::cast_slice(points));
    }
    if let Some(contacts) = samples.contacts().map(Contacts::digest) {
        hash.update(&contacts.to_le_bytes());
    }
    hash.digest128()
}

/// Writes the bytes of a file.
pub(super) fn pack(around: &RestGeometry<'_>, to: impl Write) -> io::Result<()> {
    let RestGeometry { samples, sheets, .. } = around;
    let estimated = if samples.knows_normals() { &[] } else { samples.normals() };
    let normals: Vec<_> = estimated.iter().map(|n| n.to_array().map(f32::to_le_bytes)).collect();
    let cells: Vec<_> =
        around.cells().parted().as_flattened().iter().map(|what| what.to_le_bytes()).collect();
    let content = RestFile {
        key: key(samples),
        normals: normals.as_flattened().as_flattened(),
        sheets: &pack_sheets(sheets, samples.len()),
        cells: cells.as_flattened(),
        pieces: Packing(around),
    };
    write_sealed(LETTERS, VERSION, &content, to)
}

/// The pieces of all samples, packed as they are written.
///
/// Memory: the bytes of [`AT_ONCE`] pieces, some 30 MB, and one for each sample and thread.
struct Packing<'a>(&'a RestGeometry<'a>);

impl Serialize for Packing<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        let samples = self.0.samples.len();
        let count = samples.div_ceil(TOGETHER);
        let mut sequence = to.serialize_seq(Some(count))?;
        let rooms: Mutex<Vec<Vec<u8>>> = Mutex::default();
        let lock = || rooms.lock().unwrap_or_else(PoisonError::into_inner);
        for first in (0..count).step_by(AT_ONCE) {
            let pack = |at: usize| {
                let room = lock().pop();
                let mut places = room.unwrap_or_else(|| vec![OTHER; samples]);
                let packed = self.packed(at * TOGETHER..samples.min((at + 1) * TOGETHER), &mut places);
                lock().push(places);
                packed
            };
            let pieces = first..count.min(first + AT_ONCE);
            let packed: Vec<(Vec<u8>, u32, Vec<u8>)> = pieces.into_par_iter().map(pack).collect();
            for (neighbours, reaching, supports) in &packed {
                sequence.serialize_element(&SamplePiece { neighbours, reaching: *reaching, supports })?;
            }
        }
        sequence.end()
    }
}

impl Packing<'_> {
    /// The neighbours of some samples, the number of the supports of them as homes, and the order of these.
    /// `places` is as for [`pack_order`].
    fn packed(&self, homes: Range<usize>, places: &mut [u8]) -> (Vec<u8>, u32, Vec<u8>) {
        let RestGeometry { samples, sheets, supports, .. } = self.0;
        samples.storage().gone_through(sheets.bytes_of(homes.len()) + supports.bytes_of(homes.len()));
        // As much as most take.
        let room = || Vec::with_capacity(homes.len() * USUAL as usize / 2);
        let (mut neighbours, mut orders, mut reaching) = (room(), room(), 0);
        for i in homes {
            near_lists::push(i as u32, sheets.graph().nearest_to(i), &mut neighbours);
            pack_order(i, sheets.of_sample(i), supports.of_home(i), places, &mut orders);
            reaching += supports.of_home(i).len() as u32;
        }
        neighbours.extend(BEHIND);
        (neighbours, reaching, orders)
    }
}

/// Writes in which order a home's supports are: as places among its neighbours. `places` has [`OTHER`] for
/// each sample, before and after.
fn pack_order(home: usize, near: &[u32], reaching: &[ReachingSupport], places: &mut [u8], to: &mut Vec<u8>) {
    near.iter().zip(0..).for_each(|(j, place)| places[*j as usize] = place);
    places[home] = ITSELF;
    varint::push(reaching.len() as u64, to);
    let first = to.len();
    to.extend(reaching.iter().map(|r| places[r.sample as usize]));
    if to[first..].contains(&OTHER) {
        to.truncate(first);
        for ReachingSupport { sample, .. } in reaching {
            to.push(places[*sample as usize]);
            if places[*sample as usize] == OTHER {
                varint::push(u64::from(*sample), to);
            }
        }
    }
    places[home] = OTHER;
    near.iter().for_each(|j| places[*j as usize] = OTHER);
}

/// The lists of all samples that have one of their own, and the strangers of all that have some.
fn pack_sheets(sheets: &Sheets, samples: usize) -> Vec<u8> {
    let mut to = Vec::new();
    let mut pack = |lists: &mut dyn Iterator<Item = (u32, &[u32])>| {
        let (mut last, mut count, mut bytes) = (0, 0, Vec::new());
        for (i, list) in lists {
            varint::push(u64::from(i - last), &mut bytes);
            varint::push(list.len() as u64, &mut bytes);
            near_lists::push(i, list, &mut bytes);
            (last, count) = (i, count + 1);
        }
        varint::push(count, &mut to);
        to.extend(bytes);
    };
    let all = || 0..samples as u32;
    pack(&mut all().filter(|i| sheets.is_crowded(*i as usize)).map(|i| (i, sheets.of_sample(i as usize))));
    if sheets.knows_strangers() {
        pack(&mut all().map(|i| (i, sheets.strangers(i as usize))).filter(|(_, list)| !list.is_empty()));
    }
    to.extend(BEHIND);
    to
}

/// Geometry of samples from the bytes of a file; `None` if the file is damaged, or of other samples.
pub(super) fn unpack<'a>(samples: &'a SampleSet, bytes: &[u8]) -> Option<RestGeometry<'a>> {
    let (version, content) = unseal(bytes, LETTERS).ok()?;
    (version == VERSION).then_some(())?;
    let content: RestFile<'_, Vec<SamplePiece<'_>>> = postcard::from_bytes(content).ok()?;
    let n = samples.len();
    let is_of_these = content.key == key(samples) && content.pieces.len() == n.div_ceil(TOGETHER);
    is_of_these.then_some(())?;
    let graph = unpack_graph(n, &content.pieces, samples.storage())?;
    let sheets = unpack_sheets(graph, n, content.sheets).filter(|sheets| sheets.is_valid(n))?;
    let (ends, reaching) = unpack_orders(&sheets, n, &content.pieces, samples.storage())?;
    let supports = Supports::known(samples, &sheets, ends, reaching);
    let parted = fours(content.cells)?.as_chunks().0.iter().map(|cell| cell.map(u32::from_le_bytes));
    let cells = HomeOctree::known(samples, &supports.radius, parted.collect())?;
    let normals: Vec<f32> = fours(content.normals)?.iter().map(|x| f32::from_le_bytes(*x)).collect();
    let normals = normals.chunks_exact(3).map(Vec3::from_slice).collect();
    // Normals and neighbours are set at last, as whoever finds the geometry anew otherwise shall not go by
    // damaged ones.
    (samples.set_normals(normals) && samples.set_neighbours(sheets.graph().clone())).then_some(())?;
    let around = RestGeometry::known(samples, sheets, supports);
    around.set_cells(cells);
    Some(around)
}

/// Bytes four by four, if nothing is left over.
fn fours(bytes: &[u8]) -> Option<&[[u8; 4]]> {
    let (chunks, rest) = bytes.as_chunks();
    rest.is_empty().then_some(chunks)
}

fn unpack_graph(samples: usize, pieces: &[SamplePiece<'_>], storage: &ListStorage) -> Option<NeighbourGraph> {
    let k = NEIGHBOURS.min(samples - 1);
    // The lengths of all pieces are checked before anything is held by what the file says.
    let is_there = |(at, piece): (usize, &SamplePiece<'_>)| {
        piece.neighbours.len() > (samples.min((at + 1) * TOGETHER) - at * TOGETHER) * k
    };
    pieces.iter().enumerate().all(is_there).then_some(())?;
    let mut flat = LongList::zeros(k * samples, storage);
    let lists = flat.par_chunks_mut((TOGETHER * k).max(1)).zip(pieces).enumerate();
    lists.try_for_each(|(at, (lists, piece))| {
        storage.gone_through(size_of_val(lists));
        let mut bytes = piece.neighbours;
        for (i, list) in (at * TOGETHER..).zip(lists.chunks_exact_mut(k)) {
            near_lists::take(i as u32, list, &mut bytes)?;
        }
        (bytes == BEHIND).then_some(())
    })?;
    Some(NeighbourGraph::known(k, flat))
}

fn unpack_sheets(graph: NeighbourGraph, samples: usize, bytes: &[u8]) -> Option<Sheets> {
    let mut numbers = VarintNumbers(bytes);
    let own = unpack_lists(samples, &mut numbers)?;
    let strangers = (numbers.0 != BEHIND).then(|| unpack_lists(samples, &mut numbers));
    let strangers = match strangers {
        Some(lists) => Some(lists?),
        None => None,
    };
    (numbers.0 == BEHIND).then(|| Sheets::known(graph, samples, &own, strangers.as_deref()))
}

/// Lists of samples in ascending order.
fn unpack_lists(samples: usize, numbers: &mut VarintNumbers<'_>) -> Option<Vec<Listed>> {
    let (mut lists, mut last): (Vec<Listed>, _) = (Vec::new(), None);
    for _ in 0..numbers.next()? {
        let (step, length) = (numbers.next()?, numbers.next()?);
        let i = last.unwrap_or(0u64).checked_add(step).filter(|i| *i < samples as u64)?;
        (last.is_none() || step > 0).then_some(())?;
        let mut list = vec![0; usize::try_from(length).ok().filter(|length| *length <= LONGEST)?];
        near_lists::take(i as u32, &mut list, &mut numbers.0)?;
        lists.push((i as u32, list));
        last = Some(i);
    }
    Some(lists)
}

/// Lists of the supports that reach each home, and the end of each list; the distances from which on supports
/// reach are not known yet.
fn unpack_orders(
    sheets: &Sheets,
    samples: usize,
    pieces: &[SamplePiece<'_>],
    storage: &ListStorage,
) -> Option<(Vec<u32>, LongList<ReachingSupport>)> {
    // Each takes a byte at least.
    pieces.iter().all(|piece| piece.reaching as usize <= piece.supports.len()).then_some(())?;
    let all: usize = pieces.iter().map(|piece| piece.reaching as usize).sum();
    u32::try_from(all).ok()?;
    let (mut ends, mut reaching) = (vec![0; samples], LongList::<ReachingSupport>::zeros(all, storage));
    let (mut rest, mut first, mut rooms) = (&mut reaching[..], 0, Vec::with_capacity(pieces.len()));
    for piece in pieces {
        let (room, behind) = rest.split_at_mut(piece.reaching as usize);
        rooms.push((first, room, piece.supports));
        (rest, first) = (behind, first + piece.reaching);
    }
    let jobs = rooms.into_par_iter().zip(ends.par_chunks_mut(TOGETHER)).enumerate();
    jobs.try_for_each(|(at, ((first, room, bytes), ends))| {
        storage.gone_through(size_of_val(room) + sheets.bytes_of(ends.len()));
        let (mut numbers, mut written) = (VarintNumbers(bytes), 0usize);
        for (home, end) in (at * TOGETHER..).zip(ends) {
            let count = usize::try_from(numbers.next()?).ok()?;
            let list = room.get_mut(written..written.checked_add(count)?)?;
            let near = sheets.of_sample(home);
            for to in list {
                let (place, rest) = numbers.0.split_first()?;
                numbers.0 = rest;
                let sample = match *place {
                    ITSELF => home as u32,
                    OTHER => u32::try_from(numbers.next()?).ok().filter(|j| (*j as usize) < samples)?,
                    place => *near.get(usize::from(place))?,
                };
                *to = ReachingSupport { sample, ..Zeroable::zeroed() };
            }
            written += count;
            *end = first + written as u32;
        }
        (written == room.len() && numbers.0.is_empty()).then_some(())
    })?;
    Some((ends, reaching))
}
