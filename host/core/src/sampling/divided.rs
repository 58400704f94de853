//! Sampling by units of work, on more machines than one: pass 2 in ranges of the stream, each from files to
//! files. The samples are those of [`sample`](super::sample), to the byte, for any number of ranges.
//!
//! A range clusters the cells that lie wholly within, and writes down its vertices of the others
//! (`shared_vertices`), which are clustered by groups of cells. The cut goes through the trees of all. The
//! division of the stream into pieces, the groups of vertices, and whether there are any, follow from the
//! counts and the cell alone, and not from the other cells that are open.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use simod_model::{Error, Model, Progress, Result, input, output};
use xxhash_rust::xxh3::Xxh3Default;

use super::clustered_file::{CellOfFile, ClusteredFile, mark_of, refused};
use super::cut::{ClusteredCell, Forest};
use super::face_runs::have_to_be_found;
use super::finalization::{Clustered, HashedStream, StreamJob, changed};
use super::gather::{Grouping, find_room};
use super::numbers_file::{NumbersWriter, is_there};
use super::ranges::Jumps;
use super::shared_vertices::{self, SharedReader, SharedWriter};
use super::shares::{Owner, Shares, ranges};
use super::{ClusteredStream, Sampling, SamplingPass, are_told, can_tell, counted, counting};
use crate::fingerprint::BlockHash;
use crate::sampled_model::SampledModel;

/// Factor of √f in the share of the samples that a part f of the vertices may have: more than for a part of
/// the stream on one machine, as parts are fewer, and one that is too rich is seen in the end alone.
const FORESIGHT: f64 = 2.0;

/// Most bytes of a file of counts.
const LONGEST_COUNTS: u64 = 8 << 30;

/// Division of pass 2 into units.
#[derive(Debug, Clone, Copy)]
pub struct UnitDivision<'a> {
    /// The counts of all vertices, in one file: see [`merge_counts`].
    pub counts: &'a Path,
    /// Number of ranges, and of groups of cells that ranges share: no fewer than [`ranges_of`].
    pub units: u64,
}

/// Number of ranges that a model is divided into, if there are to be `units`.
pub fn ranges_of(model: &dyn Model, units: u64) -> u64 {
    ranges(model.info().vertices, units).len() as u64
}

/// Reason why pass 2 of a model cannot be divided; `None` if it can.
///
/// # Errors
/// The vertices cannot be read, some of which may be compared with faces.
pub fn undivided(model: &dyn Model, sampling: &Sampling) -> Result<Option<&'static str>> {
    let info = model.info();
    Ok(if !info.random_access {
        Some("its vertices cannot be read from anywhere")
    } else if !sampling.skip.colors && simod_model::Colors::seen(&info.attributes).is_some() {
        Some("colours of its samples are wanted")
    } else if reads_faces(model, sampling)? {
        if have_to_be_found(model) && !model.has_face_marks() {
            Some(
                "its faces, which tell of the samples, cannot be read from anywhere, as those of one element of a binary file can",
            )
        } else {
            None
        }
    } else {
        None
    })
}

/// Whether the faces of a model have a say in its samples.
///
/// # Errors
/// As of [`undivided`].
pub fn reads_faces(model: &dyn Model, sampling: &Sampling) -> Result<bool> {
    Ok(can_tell(model.info()) && are_told(sampling.placement.resolve(model)?, &sampling.skip))
}

/// Largest number of bytes that ranges write down of cells that they share: that of vertices in no order.
pub fn exchanged_at_most(model: &dyn Model) -> u64 {
    let info = model.info();
    shared_vertices::bytes_at_most(info.vertices, info.has_normals)
}

/// Adds up [counts](super::count) of ranges that are all of the model, to a file of the same kind. Nothing is
/// done if it is there already; `false` then.
///
/// Memory: 48 bytes for each occupied cell, as much for the file, and a file that is added.
///
/// # Errors
/// A file is missing, damaged, or of another model or other options; they are not of all vertices; the file
/// cannot be written.
pub fn merge_counts(
    model: &dyn Model,
    sampling: &Sampling,
    counted: &[impl AsRef<Path>],
    target: &Path,
) -> Result<bool> {
    counted::merge(model, &counting(model, sampling)?, counted, target)
}

/// A division of a model that was counted.
pub(super) struct Divided<'a> {
    pub(super) prepared: SamplingPass<'a>,
    pub(super) shares: Shares,
    key: u128,
}

impl<'a> Divided<'a> {
    pub(super) fn new(
        model: &'a dyn Model,
        sampling: &Sampling,
        division: &UnitDivision<'_>,
        folder: &'a Path,
        progress: &'a dyn Progress,
    ) -> Result<Self> {
        if let Some(why) = undivided(model, sampling)? {
            let what = format!("the sampling of {} cannot be divided: {why}", model.path().display());
            return Err(Error::argument(what, "sample it at once"));
        }
        model.check_complete(progress)?;
        let prepared = SamplingPass::new(model, sampling, Some(&[division.counts]), folder, progress)?;
        let ranges = ranges(model.info().vertices, division.units);
        let groups = ranges.len() as u32;
        let mut hash = Xxh3Default::new();
        hash.update(&input::read(division.counts, LONGEST_COUNTS)?);
        let asked = postcard::to_allocvec(&(prepared.sampling, groups));
        hash.update(&asked.map_err(|e| Error::unwritable("a key", e))?);
        let shares = Shares::new(&prepared.grid, ranges, groups);
        Ok(Self { prepared, shares, key: hash.digest128() })
    }

    /// The key of the division.
    pub(super) fn key(&self) -> u128 {
        self.key
    }

    /// Key of the files that an owner leaves.
    pub(super) fn key_of(&self, owner: Owner) -> u128 {
        let (kind, number) = match owner {
            Owner::Range(number) => (1, number),
            Owner::Group(number) => (2, number),
        };
        self.key ^ (kind << 32 | u128::from(number))
    }

    /// An owner of a number, which there has to be.
    pub(super) fn owner(&self, owner: impl Fn(u32) -> Owner, number: u64) -> Result<Owner> {
        let known = u32::try_from(number).ok().filter(|number| *number < self.shares.groups());
        known.map(owner).ok_or_else(|| {
            let what = format!("there is no part {number} of {}", self.shares.groups());
            Error::argument(what, "count from 0")
        })
    }

    /// Leaves for the cut the clusters, or the fact that groups found no room; and before that, the leaf of
    /// each vertex, if that is wanted. `false` if another process has left these files meanwhile: its trees
    /// are as good but not these, and what others have made of them already would not fit these.
    fn leave(
        &self,
        owner: Owner,
        clustered: Option<Clustered>,
        (trees, leaves): (&Path, &Path),
    ) -> Result<bool> {
        if self.is_left(owner, (trees, leaves)) {
            return Ok(false);
        }
        let key = self.key_of(owner);
        let Some(Clustered { forest, hash, ranges, jumps, items, membership, .. }) = clustered else {
            output::write_file(trees, &ClusteredFile::without_room(key).sealed()?)?;
            return Ok(true);
        };
        let hashed = match hash {
            HashedStream::Part(hash) => Some(hash.finish().ok_or_else(|| changed(self.prepared.model))?),
            HashedStream::All(_) | HashedStream::Nothing => None,
        };
        let (bound, forest) = forest.into_trees();
        let cell = |ClusteredCell { cell, tree, moments }| {
            let at = cell as usize;
            CellOfFile { cell, items: items[at], ranges: ranges[at].all(), moments, tree }
        };
        let cells = forest.map(cell).collect();
        let Jumps { ends, count: jumps } = jumps;
        let file = ClusteredFile { key, has_room: true, bound, ends, jumps, hashed, cells, mark: 0 };
        let sealed = file.sealed()?;
        if let Some(members) = membership {
            self.leave_members(owner, members, leaves, leaves_key(mark_of(&sealed)))?;
        }
        // The trees are written in the end, as their file tells that all is there.
        output::write_file(trees, &sealed)?;
        Ok(true)
    }

    /// Leaves which leaf each vertex is in: of a group, by the ranges that the vertices are of.
    fn leave_members(
        &self,
        owner: Owner,
        members: super::Membership,
        leaves: &Path,
        key: u128,
    ) -> Result<()> {
        let lists = match owner {
            Owner::Range(_) => 1,
            Owner::Group(_) => self.shares.ranges().len(),
        };
        let mut writer = NumbersWriter::create(leaves, key, lists)?;
        members.each_leaf(|list, some| writer.push(list as usize, some))?;
        writer.commit()
    }

    /// Whether an owner has left all files that it has to.
    fn is_left(&self, owner: Owner, (trees, leaves): (&Path, &Path)) -> bool {
        let file = ClusteredFile::read(trees, self.key_of(owner));
        file.is_ok_and(|file| {
            !file.has_room || !self.prepared.with_members() || is_there(leaves, leaves_key(file.mark))
        })
    }
}

/// Key of the leaves that belong to trees: the depth of these, and so their leaves, depends on the clusters
/// found meanwhile.
pub(super) fn leaves_key(mark_of_trees: u128) -> u128 {
    mark_of_trees ^ 3 << 32
}

/// Number of vertices in cells that ranges share: the ranges write these down for each other, of 12 bytes
/// each, or 24 with normals, and some 5 to 14 for each visit to a cell.
///
/// # Errors
/// The counts cannot be read, or are of something else.
pub fn shared(
    model: &dyn Model,
    sampling: &Sampling,
    division: &UnitDivision<'_>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<u64> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    Ok(divided.shares.shared_vertices(&divided.prepared.grid))
}

/// Clusters the cells that lie wholly within a range of the model, to one file, and writes the range's
/// vertices of the others to another one. Nothing is done if both are there already; `false` then. Temporary
/// files without a name are made in `folder`.
///
/// Memory: that of [`sample`](super::sample); twice the file of trees; 32 MiB of vertices, or 4 KiB for each
/// group.
///
/// # Errors
/// As of [`sample`](super::sample); the counts are damaged, or of something else; a file cannot be written,
/// or another process writes it.
pub fn cluster(
    model: &dyn Model,
    sampling: &Sampling,
    (division, range): (&UnitDivision<'_>, u64),
    (trees, vertices, leaves): (&Path, &Path, &Path),
    folder: &Path,
    progress: &dyn Progress,
) -> Result<bool> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    let owner = divided.owner(Owner::Range, range)?;
    let (key, grouping) = (divided.key_of(owner), divided.prepared.sampling.grouping);
    if shared_vertices::is_there(vertices, key) && divided.is_left(owner, (trees, leaves)) {
        return Ok(false);
    }
    let writer = Mutex::new(SharedWriter::create(vertices, key, divided.shares.groups())?);
    let job = StreamJob::Range(&divided.shares, range as u32, &writer);
    let clustered = divided.prepared.stream(job, Some(FORESIGHT), grouping)?;
    model.check_complete(progress)?;
    let writer = writer.into_inner().unwrap_or_else(PoisonError::into_inner);
    writer.commit(clustered.is_some())?;
    divided.leave(owner, clustered, (trees, leaves))?;
    Ok(true)
}

/// Clusters a group of the cells that ranges share, of the vertices that these [wrote down](cluster), to a
/// file. Nothing is done if it is there already; `false` then.
///
/// Memory: that of [`sample`](super::sample); twice the file of trees; 48 bytes for each 256 KiB of the
/// group's vertices.
///
/// # Errors
/// As of [`cluster`]; a file that a range has written is missing or damaged.
pub fn cluster_shared(
    model: &dyn Model,
    sampling: &Sampling,
    (division, group): (&UnitDivision<'_>, u64),
    vertices: &[PathBuf],
    (trees, leaves): (&Path, &Path),
    folder: &Path,
    progress: &dyn Progress,
) -> Result<bool> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    let owner = divided.owner(Owner::Group, group)?;
    if divided.is_left(owner, (trees, leaves)) {
        return Ok(false);
    }
    let keys: Vec<u128> = (0..divided.shares.groups()).map(|k| divided.key_of(Owner::Range(k))).collect();
    let files: Vec<(&Path, u128)> = vertices.iter().map(PathBuf::as_path).zip(keys).collect();
    let clustered = match SharedReader::open(&files, group as u32)? {
        Some(reader) => {
            let reader = Mutex::new(reader);
            let job = StreamJob::Group(&divided.shares, group as u32, &reader);
            divided.prepared.stream(job, Some(FORESIGHT), divided.prepared.sampling.grouping)?
        }
        None => None,
    };
    divided.leave(owner, clustered, (trees, leaves))
}

/// Samples a model of which all ranges and all groups are clustered, each to one of some files. It is not
/// read, unless the parts have kept too little: where groups of vertices find no room, or a part of the model
/// has far more of the samples than of the vertices, it is sampled as by [`sample`](super::sample), which is
/// noted.
///
/// Memory: that of [`sample`](super::sample) without vertices, and a file.
///
/// # Errors
/// As of [`sample`](super::sample); a file is missing, damaged, or of something else.
pub fn sample_clustered(
    model: &dyn Model,
    sampling: &Sampling,
    division: &UnitDivision<'_>,
    (of_ranges, of_groups): (&[PathBuf], &[PathBuf]),
    folder: &Path,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    let divided = Divided::new(model, sampling, division, folder, progress)?;
    let files = divided.files(of_ranges, of_groups);
    progress.begin("completing the samples", 0);
    match divided.cut(&files)? {
        Ok((found, _)) => divided.prepared.complete(found),
        Err((why, grouping)) => {
            progress.note(&format!("{why}: this unit samples the model by itself"));
            let found = divided.prepared.clustered_with(grouping)?;
            divided.prepared.complete(found)
        }
    }
}

/// Reason why the files of parts are of no use, and the grouping of vertices to sample with instead.
pub(super) type Useless = (&'static str, Grouping);

/// Hash and jumps of the stream, put together of the ranges in their order.
#[derive(Default)]
struct InOrder {
    hash: BlockHash,
    jumps: Jumps,
}

impl InOrder {
    /// Takes the next range; `false` if it does not follow on those before.
    fn goes_on_with(&mut self, file: &ClusteredFile) -> bool {
        if !file.hashed.as_ref().is_some_and(|part| self.hash.append(part)) {
            return false;
        }
        self.jumps.follow(&Jumps { ends: file.ends, count: file.jumps });
        true
    }
}

impl Divided<'_> {
    /// The files of all ranges and all groups, with their owners.
    pub(super) fn files<'b>(
        &self,
        of_ranges: &'b [PathBuf],
        of_groups: &'b [PathBuf],
    ) -> Vec<(Owner, &'b PathBuf)> {
        let owners = |owner: fn(u32) -> Owner| (0..self.shares.groups()).map(owner);
        owners(Owner::Range).zip(of_ranges).chain(owners(Owner::Group).zip(of_groups)).collect()
    }

    /// Findings of pass 2, from the files of all parts, and the [marks](ClusteredFile::mark) of these.
    pub(super) fn cut(
        &self,
        files: &[(Owner, &PathBuf)],
    ) -> Result<Result<(ClusteredStream, Vec<u128>), Useless>> {
        let SamplingPass { grid, target, bound, for_groups, sampling, .. } = &self.prepared;
        let grouping = sampling.grouping;
        let mut forest = Forest::new(grid, *target, *bound, self.prepared.most(), None);
        let mut items = vec![0; grid.keys.len()];
        let mut ranges = vec![Vec::new(); grid.keys.len()];
        let mut stream = InOrder::default();
        let (mut known, mut marks) = (0, Vec::new());
        for (owner, path) in files {
            self.prepared.progress.check()?;
            let file = ClusteredFile::read(path, self.key_of(*owner))?;
            marks.push(file.mark);
            if !file.has_room {
                return Ok(Err(("groups of vertices find no room", Grouping::Never)));
            }
            if matches!(owner, Owner::Range(_)) && !stream.goes_on_with(&file) {
                return Err(refused(path, "is not of the vertices behind those of the former range"));
            }
            forest.raise(file.bound);
            for CellOfFile { cell, items: of_cell, ranges: where_it_is, moments, tree } in file.cells {
                let at = cell as usize;
                if at >= items.len() || items[at] != 0 || self.shares.owner(cell) != *owner {
                    return Err(refused(path, "has a cell that is not its own"));
                }
                (items[at], ranges[at]) = (of_cell.max(1), where_it_is);
                known += 1;
                forest.add(ClusteredCell { cell, tree, moments })?;
            }
        }
        if known < items.len() {
            return Err(Error::argument(
                "not all ranges and groups of cells are clustered".to_owned(),
                "do the units first that do so",
            ));
        }
        if grouping.is_level() && !find_room(&grid.records, &items, *for_groups) {
            return Ok(Err(("groups of vertices find no room", Grouping::Never)));
        }
        let Some(cut) = forest.cut(grid) else {
            let why = "a part of the model has far more of the samples than of the vertices";
            return Ok(Err((why, grouping)));
        };
        let (fingerprint, jumps) = (stream.hash.fingerprint(), stream.jumps.count);
        let (membership, picked) = (None, None);
        Ok(Ok((ClusteredStream { cut, fingerprint, jumps, ranges, membership, picked, grouping }, marks)))
    }
}
