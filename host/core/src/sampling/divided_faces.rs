//! Sampling by faces in units of work: the sample of each vertex of a range, the findings in a range of the
//! faces, and P_S of all of it. The samples are those of [`sample`](super::sample), to the byte.
//!
//! - A cut of all trees says which leaves belong to which sample, and a range of the vertices looks up its
//!   own.
//! - The start of a range of the faces is a matter of arithmetic, or was found by a reading of all faces
//!   (`face_runs`).
//! - A range of the faces reads of the vertices those between the least and the greatest corner. The findings
//!   in its faces are sets (triangles, islands and what joins them), lists in the order of the file (offsets
//!   of faces), and sums of runs of faces that do not depend on the ranges (planes).
//! - Islands are the connected parts of those that ranges found, each known by its first vertex.

use std::ops::Range;
use std::path::{Path, PathBuf};

use bytemuck::{cast_slice, cast_slice_mut};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use simod_model::frame::Frame;
use simod_model::mapped::{Map, MapMut, looked_at};
use simod_model::scratch::Scratch;
use simod_model::{
    Error, FACES_OF_A_BLOCK, FaceChunk, FaceMark, Model, Progress, Result, SMALL_CHUNK, VertexChunk,
    for_faces_at, for_faces_from, input, output,
};
use xxhash_rust::xxh3::xxh3_128;

use super::clustered_file::{mark_of, refused};
use super::cut::Cut;
use super::divided::{Divided, UnitDivision, leaves_key, reads_faces};
use super::face_ranges::FaceRanges;
use super::face_runs::{FaceRuns, RunsRead, have_to_be_found};
use super::gather::Grouping;
use super::membership::{self, LeafSamples, SampleOf};
use super::numbers_file::{NumbersFile, NumbersWriter, is_there};
use super::placement::{FACES_OF_A_SUM, LISTED, Placement, Planes};
use super::shares::{Owner, Shares};
use super::triangles::{Reindexing, Triangles, Wanted};
use super::{
    ClusteredStream, FaceResult, Read, Sampling, SamplingPass, Target, begin_islands, finds_triangles,
    keeps_faces,
};
use crate::sampled_model::SampledModel;
use crate::sealed::{seal, unsealed};
use crate::touching::{FoundTwins, Islands, TwinSearch, twins_may_be_there};

/// First letters of the file of a cut.
const LETTERS: &[u8; 8] = b"simodcut";

/// Version of the files on faces that units leave each other, all of which are bound to a cut.
const VERSION: u32 = 3;

/// Most bytes of the file of a cut: that of 2³² samples.
const LONGEST: u64 = 1 << 40;

/// No sample.
const NONE: u32 = u32::MAX;

/// Numbers that are copied at a time.
const COPIED: usize = 1 << 16;

const ADVICE: &str = "do without the faces, by --skip triangles,sheets and --place vertices";

/// Files on the faces that units leave each other.
#[derive(Debug, Clone, Copy)]
pub struct FaceFiles<'a> {
    /// File with the starts of runs of faces, if they [had to be found](have_to_be_found).
    pub runs: &'a Path,
    /// The cut through all trees.
    pub cut: &'a Path,
    /// The leaves of the vertices of each range.
    pub leaves: &'a [PathBuf],
    /// The leaves of the vertices of each group of shared cells.
    pub leaves_of_groups: &'a [PathBuf],
    /// The samples of the vertices of each range.
    pub members: &'a [PathBuf],
    /// Files with the findings in each range of the faces.
    pub faces: &'a [PathBuf],
}

/// Content of the file of a cut through all trees.
#[derive(Serialize, Deserialize)]
struct CutFile {
    /// The division's key.
    key: u128,
    /// Reason why one unit has to sample the model by itself, if there is one.
    alone: Option<String>,
    /// The level of groups of vertices, if there are any.
    level: Option<u32>,
    cut: Cut,
    fingerprint: String,
    jumps: u64,
    ranges: Vec<Vec<Range<u64>>>,
    /// The marks of the trees of all ranges and groups.
    trees: Vec<u128>,
    #[serde(skip)]
    mark: u128,
}

/// Number of ranges that a model's faces are divided into, if there are to be `units`.
pub fn face_ranges_of(model: &dyn Model, units: u64) -> u64 {
    units.clamp(1, model.info().faces.div_ceil(FACES_OF_A_SUM).max(1))
}

/// Largest number of bytes that units write down for each other on the faces, besides those for clusters:
/// that where neither vertices nor faces come in any order. 0 where faces have no say.
///
/// # Errors
/// As of [`reads_faces`].
pub fn faces_exchanged_at_most(model: &dyn Model, sampling: &Sampling) -> Result<u64> {
    if !reads_faces(model, sampling)? {
        return Ok(0);
    }
    let info = model.info();
    // Leaves, once more of those in shared cells, samples, and vertices at the same place.
    let twins = !sampling.skip.sheets && twins_may_be_there(info.vertices, info.faces);
    let of_vertices = (3 + u64::from(twins)) * size_of::<u32>() as u64;
    let corners_of_a_sum = 3 * FACES_OF_A_SUM;
    let samples = match sampling.target {
        Target::Samples(n) => n.min(corners_of_a_sum),
        Target::Error(_) => corners_of_a_sum,
    };
    let of_a_sum = (LISTED * size_of::<u32>()) as u64 * samples;
    // A triangle makes one island of two, twice at most, and is in three cells at most.
    let islands = if sampling.skip.sheets { 0 } else { 16 };
    let ranges = if sampling.skip.triangles || sampling.skip.cells { 0 } else { 60 };
    let triangles = most_triangles(model);
    let of_faces = triangles.saturating_mul(islands + ranges);
    let of_sums = triangles.div_ceil(FACES_OF_A_SUM).saturating_mul(of_a_sum);
    Ok(info.vertices.saturating_mul(of_vertices).saturating_add(of_faces).saturating_add(of_sums))
}

/// Largest number of triangles that the faces of a model can be.
fn most_triangles(model: &dyn Model) -> u64 {
    let info = model.info();
    if !have_to_be_found(model) {
        return info.faces;
    }
    // A triangle takes a corner at least, of as many bytes as it takes to tell all vertices of its file
    // apart.
    let least = model.tiles().iter().map(|tile| tile.vertices).min().unwrap_or(info.vertices);
    let bytes = if least > 1 << 16 { 4 } else { 1 };
    info.face_bytes / bytes
}

/// Cuts the trees of all ranges and groups, each in one of some files, to a file. Nothing is done if it is
/// there already; `false` then. Where parts have kept too little, as for
/// [`sample_clustered`](super::divided::sample_clustered), the file says so.
///
/// Memory: that of [`sample`](super::sample) without vertices, and a file; twice its own.
///
/// # Errors
/// As of [`sample_clustered`](super::divided::sample_clustered).
pub fn cut(
    model: &dyn Model,
    sampling: &Sampling,
    division: &UnitDivision<'_>,
    (of_ranges, of_groups): (&[PathBuf], &[PathBuf]),
    target: &Path,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<bool> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    if divided.read_cut(target).is_ok() {
        return Ok(false);
    }
    progress.begin("completing the samples", 0);
    let mut file = CutFile {
        key: divided.key(),
        alone: None,
        level: None,
        cut: Cut::default(),
        fingerprint: String::new(),
        jumps: 0,
        ranges: Vec::new(),
        trees: Vec::new(),
        mark: 0,
    };
    let level = |grouping| if let Grouping::Level(level) = grouping { Some(level) } else { None };
    match divided.cut(&divided.files(of_ranges, of_groups))? {
        Ok((found, trees)) => {
            let ClusteredStream { cut, fingerprint, jumps, ranges, grouping, .. } = found;
            file = CutFile { cut, fingerprint, jumps, ranges, trees, level: level(grouping), ..file };
        }
        Err((why, grouping)) => {
            file.alone = Some(why.to_owned());
            file.level = level(grouping);
        }
    }
    let bytes = seal(LETTERS, VERSION, &file)
        .map_err(|e| Error::internal("the cut cannot be held in a file").because(e))?;
    output::write_file(target, &bytes)?;
    Ok(true)
}

/// Finds the sample of each vertex of a range, to a file; and the vertices that are at one place, if these
/// are worth knowing, for which up to a million vertices before the range are read as well. Nothing is done
/// if it is there already; `false` then.
///
/// Memory: that of the cut; 4 bytes for each cell; a block of each file that is read, 32 MiB or 8 KiB for
/// each group; 4 MiB and a chunk of vertices, if these are read.
///
/// # Errors
/// The model cannot be read, or the user cancelled; a file is missing, damaged, or of something else; or
/// cannot be written, or another process writes it.
pub fn members(
    model: &dyn Model,
    sampling: &Sampling,
    (division, range): (&UnitDivision<'_>, u64),
    files: &FaceFiles<'_>,
    target: &Path,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<bool> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    let owner = divided.owner(Owner::Range, range)?;
    let cut = divided.read_cut(files.cut)?;
    let key = cut.key_of("members", range);
    if is_there(target, key) {
        return Ok(false);
    }
    let mut writer = NumbersWriter::create(target, key, member::COUNT)?;
    if cut.alone.is_none() {
        let own = divided.shares.ranges()[range as usize].clone();
        progress.begin_parts("looking up each vertex' sample", own.end - own.start);
        divided.look_up(owner, &cut, files, |samples| {
            progress.check()?;
            progress.advance(samples.len() as u64);
            writer.push(member::SAMPLES, samples)
        })?;
        if divided.looks_for_twins() {
            divided.find_twins(own, |back| writer.push(member::TWINS, back))?;
        }
    }
    writer.commit()?;
    Ok(true)
}

/// Owners of the cells of leaves; the leaves of a cell mostly follow each other.
struct LeafOwners<'a> {
    shares: &'a Shares,
    /// The first leaf of each cell.
    starts: Vec<u32>,
    /// Leaves of the cell at hand, and the owner that clustered it.
    leaves: Range<u32>,
    owner: Owner,
}

impl LeafOwners<'_> {
    fn owner_of(&mut self, leaf: u32) -> Owner {
        let Self { starts, leaves, .. } = self;
        if !leaves.contains(&leaf) {
            let next = starts.partition_point(|start| *start <= leaf);
            let cell = next.saturating_sub(1);
            let end = starts.get(next).copied().unwrap_or(NONE);
            *leaves = starts.get(cell).copied().unwrap_or(0)..end;
            self.owner = self.shares.owner(cell as u32);
        }
        self.owner
    }
}

/// Lists in a file on the vertices of a range.
mod member {
    /// The samples of the vertices.
    pub const SAMPLES: usize = 0;
    /// Distance of each vertex behind an earlier one at the same position, or 0, in a model in which these
    /// are worth looking for.
    pub const TWINS: usize = 1;
    pub const COUNT: usize = 2;
}

impl Divided<'_> {
    /// Whether vertices at the same position are worth looking for.
    fn looks_for_twins(&self) -> bool {
        let SamplingPass { model, sampling, .. } = &self.prepared;
        !sampling.skip.sheets && twins_may_be_there(model.info().vertices, model.info().faces)
    }

    /// Visits the twins of a range of the vertices, as all vertices tell of them.
    fn find_twins(&self, range: Range<u64>, mut visit: impl FnMut(&[u32]) -> Result<()>) -> Result<()> {
        let SamplingPass { model, progress, .. } = self.prepared;
        let first = TwinSearch::first_for(range.start);
        let (mut search, mut back, mut chunk) = (TwinSearch::new(first), Vec::new(), VertexChunk::default());
        let mut reader = model.vertices(first..range.end)?;
        reader.set_chunk(SMALL_CHUNK);
        reader.skip_attributes();
        while reader.read(&mut chunk)? {
            progress.check()?;
            back.clear();
            search.take(&chunk.positions, &mut back);
            let before = range.start.saturating_sub(chunk.first) as usize;
            visit(back.get(before..).unwrap_or_default())?;
        }
        Ok(())
    }

    fn read_cut(&self, path: &Path) -> Result<CutFile> {
        let bytes = input::read(path, LONGEST)?;
        let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
        let file: CutFile = unsealed(&bytes, (LETTERS, VERSION), damaged)?;
        if file.key != self.key() {
            return Err(refused(path, "is a cut of another model, or for other samples"));
        }
        let Self { prepared, shares, .. } = self;
        let cells = prepared.grid.keys.len();
        let known = shares.ranges().len() + shares.groups() as usize;
        let fits = file.cut.trees.len() == cells && file.ranges.len() == cells && file.trees.len() == known;
        if file.alone.is_none() && !(fits && file.cut.is_sound()) {
            return Err(damaged("it has not what the others have"));
        }
        Ok(CutFile { mark: mark_of(&bytes), ..file })
    }

    /// Visits the samples of the vertices of a range, in their order.
    fn look_up(
        &self,
        owner: Owner,
        cut: &CutFile,
        files: &FaceFiles<'_>,
        mut visit: impl FnMut(&[u32]) -> Result<()>,
    ) -> Result<()> {
        let Self { prepared: SamplingPass { grid, .. }, shares, .. } = self;
        let Owner::Range(range) = owner else { return Ok(()) };
        let (of_ranges, of_groups) = cut.trees.split_at(shares.ranges().len());
        let open = |(path, mark): (&PathBuf, &u128)| NumbersFile::open(path, leaves_key(*mark));
        let missing = || Error::argument("not all leaves are there", "do the units first that write them");
        let own = open(files.leaves.iter().zip(of_ranges).nth(range as usize).ok_or_else(missing)?)?;
        let groups = files.leaves_of_groups.iter().zip(of_groups).map(open).collect::<Result<Vec<_>>>()?;
        let mut of_groups: Vec<_> = groups.iter().map(|group| group.one_by_one(range as usize)).collect();

        let mut owners = LeafOwners { shares, starts: membership::starts(grid), leaves: 0..0, owner };
        let mut samples = LeafSamples::new(&cut.cut.starts);
        let mut count = 0;
        let mut found = Vec::with_capacity(COPIED);
        own.each(0, |leaves| {
            count += leaves.len() as u64;
            found.clear();
            for leaf in leaves {
                if *leaf == NONE {
                    found.push(NONE);
                    continue;
                }
                let leaf = match owners.owner_of(*leaf) {
                    Owner::Range(_) => *leaf,
                    Owner::Group(group) => {
                        let of_group = of_groups.get_mut(group as usize).ok_or_else(missing)?;
                        let lacks = || refused(groups[group as usize].path(), "lacks vertices");
                        of_group.next()?.ok_or_else(lacks)?
                    }
                };
                found.push(samples.sample_of(leaf));
            }
            visit(&found)
        })?;
        let all = &shares.ranges()[range as usize];
        if count != all.end - all.start {
            return Err(refused(own.path(), "is not of all vertices of its range"));
        }
        of_groups.iter_mut().zip(&groups).try_for_each(|(of_group, group)| match of_group.next()? {
            Some(_) => Err(refused(group.path(), "has vertices of other ranges")),
            None => Ok(()),
        })
    }
}

impl CutFile {
    /// The key of a file of this name and number that belongs to the cut.
    fn key_of(&self, what: &str, number: u64) -> u128 {
        self.mark ^ xxh3_128(format!("{what} {number}").as_bytes())
    }
}

/// Lists in a file on a range of the faces.
mod list {
    /// Counts of the triangles: the number that lack a vertex (lower and upper half), whether they are of
    /// vertices, whether tangled.
    pub const HEAD: usize = 0;
    /// Three corners each.
    pub const TRIANGLES: usize = 1;
    /// Ranges of a cell's faces: the cell, and the lower and the upper halves of the first byte and the end.
    pub const RANGES: usize = 2;
    pub const PLANES: usize = 3;
    /// A vertex, and the first one of its island.
    pub const ISLANDS: usize = 4;
    /// Two vertices of different clusters that a face joins.
    pub const LINKS: usize = 5;
    pub const COUNT: usize = 6;
}

/// Finds triangles, islands, ranges and planes in a range of the faces, of so many [ranges](face_ranges_of),
/// to a file. Nothing is done if it is there already; `false` then.
///
/// Memory: that of the cut; 16 bytes for each 65 536 triangles; per sample 140 bytes, 12 for each of at most
/// 32 triangles, twice while the list grows, and 8 for each of at most 32 links, or of a million, whichever
/// is more; 16 bytes per cell; chunks of faces. Temporary files of 8 bytes for each vertex between the least
/// and the greatest corner, and 12 more where faces place the samples: where vertices come in no order, these
/// are all vertices.
///
/// # Errors
/// A file is missing, damaged, or of something else, or cannot be written, or another process writes it; the
/// model cannot be read, or its faces are no triangles; the user cancelled.
pub fn faces(
    model: &dyn Model,
    sampling: &Sampling,
    (division, part): (&UnitDivision<'_>, u64),
    files: &FaceFiles<'_>,
    target: &Path,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<bool> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    let cut = divided.read_cut(files.cut)?;
    let key = cut.key_of("faces", part);
    if is_there(target, key) {
        return Ok(false);
    }
    let parts = files.faces.len() as u64;
    if part >= parts {
        let what = format!("there is no part {part} of {parts}");
        return Err(Error::argument(what, "count from 0"));
    }
    let mut writer = NumbersWriter::create(target, key, list::COUNT)?;
    if cut.alone.is_none() {
        let runs = FaceRuns::known(model, files.runs)?;
        if let Some(read) = runs.part(part, parts) {
            FacePart::new(&divided, &cut, read, runs.triangles()).read(files, &mut writer)?;
        } else {
            let of_vertices = finds_triangles(&divided.prepared.sampling) && !sampling.skip.sheets;
            let none = Triangles { of_vertices, ..Triangles::default() };
            write_triangles(&none, 0, &mut writer)?;
        }
    }
    writer.commit()?;
    Ok(true)
}

/// A part of the faces.
struct FacePart<'a> {
    divided: &'a Divided<'a>,
    cut: &'a CutFile,
    read: RunsRead,
    /// Bytes of all triangles that it reads, about.
    bytes: u64,
}

impl<'a> FacePart<'a> {
    fn new(divided: &'a Divided<'a>, cut: &'a CutFile, read: RunsRead, triangles: u64) -> Self {
        let all = u128::from(divided.prepared.model.info().face_bytes);
        let bytes = (all * u128::from(read.summed.end) / u128::from(triangles.max(1))) as u64;
        Self { divided, cut, read, bytes }
    }

    /// Streams the triangles, with the number of those before them, and the marks that come with them.
    fn each(&self, mut visit: impl FnMut(u64, &[[u32; 3]], &[FaceMark]) -> Result<()>) -> Result<()> {
        let SamplingPass { model, progress, .. } = self.divided.prepared;
        let (RunsRead { from, summed, to, .. }, are_triangles) = (&self.read, !have_to_be_found(model));
        let mut count = 0;
        let mut take = |chunk: &FaceChunk| {
            progress.check()?;
            if are_triangles && !chunk.continued.is_empty() {
                return Err(no_triangles(model));
            }
            let some = chunk.triangles.len().min(summed.end.saturating_sub(count) as usize);
            visit(count, &chunk.triangles[..some], &chunk.marks)?;
            count += chunk.triangles.len() as u64;
            progress.advance(chunk.bytes);
            Ok(())
        };
        if are_triangles {
            let all = || model.face_at(model.info().faces).ok_or_else(|| no_triangles(model));
            let bytes = *from..to.map_or_else(all, Ok)?;
            for_faces_at(model, std::iter::once(bytes).collect(), take)?;
            // So many triangles take all of the bytes.
            return if count == summed.end { Ok(()) } else { Err(no_triangles(model)) };
        }
        let triangles = to.map_or(u64::MAX, |_| summed.end);
        for_faces_from(model, *from, triangles, &mut take)?;
        let is_all = if to.is_some() { count >= summed.end } else { count == summed.end };
        if is_all { Ok(()) } else { Err(super::finalization::changed(model)) }
    }

    /// The vertices between the least corner and the greatest.
    fn span(&self) -> Result<Range<u64>> {
        let vertices = self.divided.prepared.model.info().vertices;
        let (mut least, mut end) = (u64::MAX, 0);
        self.each(|_, triangles, _| {
            let corners = triangles.iter().flatten().map(|corner| u64::from(*corner));
            for corner in corners.filter(|corner| *corner < vertices) {
                (least, end) = (least.min(corner), end.max(corner + 1));
            }
            Ok(())
        })?;
        Ok(least.min(end)..end)
    }

    /// Reads the faces of the part, and writes the findings.
    fn read(&self, files: &FaceFiles<'_>, to: &mut NumbersWriter) -> Result<()> {
        let Self { divided: Divided { prepared, .. }, cut: CutFile { cut, .. }, .. } = *self;
        let SamplingPass { model, sampling, folder, progress, .. } = prepared;
        progress.begin("reindexing the faces", 2 * self.bytes);
        let span = self.span()?;
        let (first, count) = (span.start as u32, span.end - span.start);
        let sample_of =
            if count > 0 { Some(self.divided.samples_of(self.cut, files, span.clone())?) } else { None };
        let sample_of: &[u32] = sample_of.as_ref().map_or(&[], |map| cast_slice(map));
        let places = sampling.placement == Placement::Faces;
        let vertices =
            if places && count > 0 { Some(prepared.positions(sample_of, span, &|_| ())?) } else { None };
        let vertices: &[Vec3] = vertices.as_ref().map_or(&[], |map| cast_slice(map));

        let (triangles, samples) = (finds_triangles(sampling), cut.samples());
        let mut ranges = keeps_faces(sampling).then(|| FaceRanges::listed(&cut.trees, samples));
        let mut planes = places.then(|| Planes::listed(vertices, &cut.positions));
        let mut islands = if sampling.skip.sheets {
            None
        } else {
            Some(Islands::new(FoundTwins::none(count.max(1), folder)?, sample_of, samples, folder))
        };
        let wanted =
            Wanted { triangles, ranges: ranges.as_mut(), islands: islands.as_mut(), planes: planes.as_mut() };
        let mut reindexing = Reindexing::new(sample_of, samples, wanted);
        let mut here = Vec::new();
        self.each(|before, triangles, marks| {
            let known = |corner: u32| u64::from(corner) < model.info().vertices;
            let local = |corner| if known(corner) { corner - first } else { NONE };
            here.clear();
            here.extend(triangles.iter().map(|corners| corners.map(local)));
            let up_to = |end: u64| here.len().min(end.saturating_sub(before) as usize);
            let (found, skipped) = (&here[..up_to(self.read.found)], up_to(self.read.summed.start));
            reindexing.take(found, &self.marks(before..before + found.len() as u64, marks), &here[skipped..]);
            write_listed(reindexing.wanted(), false, to)
        })?;
        if let Some(offset) = self.end() {
            reindexing.take(&[], &[FaceMark { triangle: 0, offset }], &[]);
        }
        write_listed(reindexing.wanted(), true, to)?;
        let found = reindexing.finish();
        write_triangles(&found, first, to)?;
        if let Some(mut islands) = islands {
            write_islands(&mut islands, first..first.wrapping_add(count as u32), *progress, to)?;
        }
        Ok(())
    }

    /// End of the part's last block in the file, if no mark tells otherwise; `None` for tiles.
    fn end(&self) -> Option<u64> {
        let model = self.divided.prepared.model;
        let end = || model.face_at(model.info().faces);
        self.read.to.or_else(end).filter(|_| model.tiles().is_empty())
    }

    /// The marks among the part's own of some triangles, by those that came with them.
    fn marks(&self, own: Range<u64>, marks: &[FaceMark]) -> Vec<FaceMark> {
        let (model, RunsRead { from, to, found, .. }) = (self.divided.prepared.model, &self.read);
        if !model.tiles().is_empty() {
            return Vec::new();
        }
        if have_to_be_found(model) {
            // Marks behind the part's triangles are of the next part.
            let is_own = |mark: &&FaceMark| own.start + (mark.triangle as u64) < *found || to.is_none();
            return marks.iter().filter(is_own).copied().collect();
        }
        // Triangles of one length, each a face.
        let length = model.face_at(1).zip(model.face_at(0)).map_or(1, |(second, first)| second - first);
        let begin = own.clone().filter(|face| face.is_multiple_of(FACES_OF_A_BLOCK));
        let mark =
            |face: u64| FaceMark { triangle: (face - own.start) as usize, offset: from + face * length };
        begin.map(mark).collect()
    }
}

fn halves(number: u64) -> [u32; 2] {
    [number as u32, (number >> 32) as u32]
}

fn whole(low: u32, high: u32) -> u64 {
    u64::from(high) << 32 | u64::from(low)
}

/// Writes the ranges and planes that were listed meanwhile.
fn write_listed(wanted: &mut Wanted<'_, '_>, is_end: bool, to: &mut NumbersWriter) -> Result<()> {
    if let Some(ranges) = &mut wanted.ranges {
        for (cell, range) in ranges.take_listed(is_end) {
            let ([a, b], [c, d]) = (halves(range.start), halves(range.end));
            to.push(list::RANGES, &[cell, a, b, c, d])?;
        }
    }
    match &mut wanted.planes {
        Some(planes) => to.push(list::PLANES, &planes.take_listed(is_end)),
        None => Ok(()),
    }
}

/// Writes triangles, whose vertices are counted from `first` on.
fn write_triangles(found: &Triangles, first: u32, to: &mut NumbersWriter) -> Result<()> {
    let [a, b] = halves(found.without_vertex);
    to.push(list::HEAD, &[a, b, found.of_vertices.into(), found.tangled.into()])?;
    let first = if found.of_vertices { first } else { 0 };
    found.triangles.iter().try_for_each(|t| to.push(list::TRIANGLES, &t.map(|corner| corner + first)))
}

/// Writes the islands of some vertices.
fn write_islands(
    islands: &mut Islands,
    vertices: Range<u32>,
    progress: &dyn Progress,
    to: &mut NumbersWriter,
) -> Result<()> {
    for vertex in 0..vertices.end - vertices.start {
        if vertex.is_multiple_of(COPIED as u32) {
            progress.check()?;
            looked_at(size_of::<u32>() * COPIED);
        }
        let first = islands.first(vertex);
        if first != vertex {
            to.push(list::ISLANDS, &[vertex + vertices.start, first + vertices.start])?;
        }
    }
    islands.drain_links(|links| {
        links.iter().try_for_each(|link| to.push(list::LINKS, &link.map(|vertex| vertex + vertices.start)))
    })
}

impl Divided<'_> {
    /// The samples of some vertices, by the files of all ranges.
    fn samples_of(&self, cut: &CutFile, files: &FaceFiles<'_>, vertices: Range<u64>) -> Result<MapMut> {
        self.members_of(member::SAMPLES, cut, files, vertices)?.map_mut()
    }

    /// List of the samples or twins of some vertices, from the files of all ranges.
    fn members_of(
        &self,
        list: usize,
        cut: &CutFile,
        files: &FaceFiles<'_>,
        vertices: Range<u64>,
    ) -> Result<Scratch> {
        let scratch = Scratch::new(self.prepared.folder, ADVICE)?;
        let mut at = 0;
        for (number, (range, path)) in (0..).zip(self.shares.ranges().iter().zip(files.members)) {
            let own = range.start.max(vertices.start)..range.end.min(vertices.end);
            if own.start >= own.end {
                continue;
            }
            let file = NumbersFile::open(path, cut.key_of("members", number))?;
            let places = own.start - range.start..own.end - range.start;
            file.some(list, places, |numbers| {
                self.prepared.progress.check()?;
                scratch.write_at(cast_slice(numbers), at)?;
                at += size_of_val(numbers) as u64;
                Ok(())
            })?;
        }
        if at != (vertices.end - vertices.start) * size_of::<u32>() as u64 {
            let what = "not all vertices have been looked up";
            return Err(Error::argument(what, "do the units first that do so"));
        }
        Ok(scratch)
    }
}

impl SamplingPass<'_> {
    /// Local positions of some vertices, not a number for those that have no sample. Calls `done` with the
    /// number of vertices read since the last call.
    fn positions(&self, sample_of: &[u32], vertices: Range<u64>, done: &dyn Fn(u64)) -> Result<Map> {
        let scratch = Scratch::new(self.folder, ADVICE)?;
        let mut reader = self.model.vertices(vertices)?;
        reader.set_chunk(SMALL_CHUNK);
        reader.skip_attributes();
        let (mut chunk, mut local, mut at) = (VertexChunk::default(), Vec::new(), 0);
        let mut samples = sample_of.iter();
        let place = |(p, sample): (&glam::DVec3, &u32), frame: &Frame| {
            if *sample == NONE { Vec3::NAN } else { frame.to_local(*p) }
        };
        while reader.read(&mut chunk)? {
            self.progress.check()?;
            local.clear();
            local.extend(chunk.positions.iter().zip(samples.by_ref()).map(|both| place(both, &self.frame)));
            scratch.write_at(cast_slice(&local), at)?;
            at += size_of_val(&local[..]) as u64;
            done(local.len() as u64);
        }
        if samples.next().is_some() {
            return Err(super::finalization::changed(self.model));
        }
        scratch.map()
    }
}

/// Samples a model of which all is known, by the files of all units.
///
/// Memory: that of [`sample`](super::sample) without vertices; 12 bytes for each of at most 32 triangles per
/// sample. Temporary files of 8 bytes per vertex where sheets are told apart; where faces place the samples,
/// of 4 and 12 more, for which all vertices are read.
///
/// # Errors
/// A file is missing, damaged, or of something else; as of [`sample`](super::sample).
pub fn complete(
    model: &dyn Model,
    sampling: &Sampling,
    division: &UnitDivision<'_>,
    files: &FaceFiles<'_>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    let mut cut = divided.read_cut(files.cut)?;
    let grouping = cut.level.map_or(Grouping::Never, Grouping::Level);
    if let Some(why) = &cut.alone {
        progress.note(&format!("{why}: this unit samples the model by itself"));
        let found = divided.prepared.clustered_with(grouping)?;
        return divided.prepared.complete(found);
    }
    let info = model.info();
    progress.begin("completing the samples", 0);
    let Divided { prepared, .. } = &divided;
    let SamplingPass { sampling, bound, .. } = prepared;
    let mut reindexed = FaceResult::new(std::mem::take(&mut cut.cut));
    let ranges = std::mem::take(&mut cut.ranges);
    let parting = prepared.parting(&ranges);
    let read = Read { sampling, bound: *bound, parting: &parting };

    let sheets = !sampling.skip.sheets;
    let mut sample_of = if sheets || sampling.placement == Placement::Faces {
        Some(divided.samples_of(&cut, files, 0..info.vertices)?)
    } else {
        None
    };
    let known: &[u32] = sample_of.as_ref().map_or(&[], |map| cast_slice(map));
    let (mut islands, mut welded) = (None, false);
    if sheets {
        let twins = divided.twins(&cut, files)?;
        let found = begin_islands(&parting, twins, known, reindexed.cut.samples())?;
        (islands, welded) = (Some(found.0), found.1);
    }
    divided.take_faces(&cut, files, &read, (known, islands.as_mut()), &mut reindexed)?;
    if let Some(map) = &mut sample_of {
        divided.part_and_place(&read, islands, welded, cast_slice_mut(map), &mut reindexed)?;
    }
    let CutFile { fingerprint, jumps, .. } = cut;
    let (cut, membership, picked) = (Cut::default(), None, None);
    let found = ClusteredStream { cut, fingerprint, jumps, ranges, membership, picked, grouping };
    divided.prepared.assemble(found, reindexed, sample_of.map(SampleOf::of_all))
}

impl Divided<'_> {
    /// The vertices that are at one place with others, as far as units have found that.
    fn twins(&self, cut: &CutFile, files: &FaceFiles<'_>) -> Result<FoundTwins> {
        let SamplingPass { model, folder, .. } = self.prepared;
        let vertices = model.info().vertices;
        if self.looks_for_twins() {
            FoundTwins::of_all(self.members_of(member::TWINS, cut, files, 0..vertices)?)
        } else {
            FoundTwins::none(vertices, folder)
        }
    }

    /// Parts the samples of several sheets, and places samples by the faces around them.
    fn part_and_place(
        &self,
        read: &Read<'_>,
        islands: Option<Islands>,
        welded: bool,
        sample_of: &mut [u32],
        reindexed: &mut FaceResult,
    ) -> Result<()> {
        let prepared = &self.prepared;
        let changed = match islands {
            Some(islands) => reindexed.part_sheets(read, islands, sample_of, welded)?,
            None => None,
        };
        let places = prepared.sampling.placement == Placement::Faces;
        let looked_at = places && (changed.is_some() || !reindexed.triangles.triangles.is_empty());
        let vertices = if looked_at {
            let all = 0..prepared.model.info().vertices;
            prepared.progress.begin_parts("reading the vertices", all.end);
            Some(prepared.positions(sample_of, all, &|more| prepared.progress.advance(more))?)
        } else {
            None
        };
        let vertices: Option<&[Vec3]> = vertices.as_ref().map(|map| cast_slice(map));
        if let (Some(changed), Some(vertices)) = (changed, vertices) {
            reindexed.place_again(read, sample_of, vertices, &changed)?;
        }
        reindexed.fit(read, sample_of, vertices)
    }

    /// Takes the findings of all ranges of the faces; islands, if sheets are told apart, by the samples of
    /// all vertices.
    fn take_faces(
        &self,
        cut: &CutFile,
        files: &FaceFiles<'_>,
        read: &Read<'_>,
        (sample_of, islands): (&[u32], Option<&mut Islands>),
        reindexed: &mut FaceResult,
    ) -> Result<()> {
        let SamplingPass { sampling, progress, .. } = &self.prepared;
        let (trees, samples) = (&reindexed.cut.trees, reindexed.cut.samples());
        let triangles = finds_triangles(sampling);
        let mut ranges = keeps_faces(sampling).then(|| FaceRanges::new(trees, samples));
        let places = sampling.placement == Placement::Faces;
        let mut planes = places.then(|| Planes::new(&[], &reindexed.cut.positions, 0));
        let wanted = Wanted { triangles, ranges: ranges.as_mut(), islands, planes: planes.as_mut() };
        let mut reindexing = Reindexing::new(sample_of, samples, wanted);
        for (number, path) in (0..).zip(files.faces) {
            let file = NumbersFile::open(path, cut.key_of("faces", number))?;
            take(&file, &mut reindexing, [samples, sample_of.len()], trees.len(), *progress)?;
        }
        let triangles = reindexing.finish();
        let placed = planes.map(|planes| reindexed.place(read, planes));
        let faces = ranges.filter(|_| !triangles.triangles.is_empty()).and_then(|r| r.into_cells(trees));
        (reindexed.triangles, reindexed.placed, reindexed.faces) = (triangles, placed, faces);
        Ok(())
    }
}

/// Takes the findings of a range of the faces, for a model with these numbers of samples, vertices and cells.
fn take(
    file: &NumbersFile,
    all: &mut Reindexing<'_, '_>,
    [samples, vertices]: [usize; 2],
    cells: usize,
    progress: &dyn Progress,
) -> Result<()> {
    let damaged = || refused(file.path(), "is damaged: its numbers make no sense");
    let mut found = Triangles::default();
    file.each(list::HEAD, |head| {
        let [a, b, of_vertices, tangled] = *head else { return Err(damaged()) };
        found.without_vertex = whole(a, b);
        (found.of_vertices, found.tangled) = (of_vertices > 0, tangled > 0);
        Ok(())
    })?;
    let known = if found.of_vertices { vertices } else { samples };
    let triangles = &mut found.triangles;
    records(file, list::TRIANGLES, progress, |corners: &[u32; 3]| {
        triangles.push(*corners);
        corners.iter().all(|corner| (*corner as usize) < known)
    })?;
    all.add(&found);
    if let Some(ranges) = &mut all.wanted().ranges {
        records(file, list::RANGES, progress, |[cell, a, b, c, d]: &[u32; 5]| {
            let range = whole(*a, *b)..whole(*c, *d);
            let is_one = (*cell as usize) < cells && !range.is_empty();
            if is_one {
                ranges.join(*cell, range);
            }
            is_one
        })?;
    }
    if let Some(planes) = &mut all.wanted().planes {
        records(file, list::PLANES, progress, |one: &[u32; LISTED]| planes.add_listed(one))?;
    }
    for list in [list::ISLANDS, list::LINKS] {
        records(file, list, progress, |[u, v]: &[u32; 2]| {
            let (Some(a), Some(b)) = (all.sample(*u), all.sample(*v)) else { return false };
            let Some(islands) = &mut all.wanted().islands else { return true };
            match list {
                list::ISLANDS if a == b => islands.unite_both(*u, *v),
                list::LINKS if a != b => islands.add_link([*u, *v]),
                _ => return false,
            }
            true
        })?;
    }
    Ok(())
}

/// Visits the numbers of a list, `N` at a time, as long as they make sense.
fn records<const N: usize>(
    file: &NumbersFile,
    list: usize,
    progress: &dyn Progress,
    mut visit: impl FnMut(&[u32; N]) -> bool,
) -> Result<()> {
    let damaged = || refused(file.path(), "is damaged: its numbers make no sense");
    // Numbers of a record that goes on in the next block.
    let mut begun: Vec<u32> = Vec::with_capacity(N);
    file.each(list, |mut numbers| {
        progress.check()?;
        if !begun.is_empty() {
            let (end, rest) = numbers.split_at(numbers.len().min(N - begun.len()));
            begun.extend_from_slice(end);
            numbers = rest;
            if let Some(record) = begun.first_chunk() {
                if !visit(record) {
                    return Err(damaged());
                }
                begun.clear();
            }
        }
        let (whole, rest) = numbers.as_chunks();
        begun.extend_from_slice(rest);
        if whole.iter().all(&mut visit) { Ok(()) } else { Err(damaged()) }
    })?;
    if begun.is_empty() { Ok(()) } else { Err(damaged()) }
}

fn no_triangles(model: &dyn Model) -> Error {
    Error::format(
        format!("{} has faces that are no triangles, which cannot be read in parts", model.path().display()),
        "sample it at once: by `simod run`, or a plan of --units 1",
    )
}
