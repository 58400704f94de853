//! A deformed model in parts, each of a range of the file and written by itself, on any machine, in any
//! order, as often as one likes; and the whole of them, the same bytes as [`reconstruct`](super::reconstruct)
//! writes.
//!
//! Bytes of a part whose place is known beforehand go there at once, into a file that all parts share, and
//! that becomes the output in the end; or into an object, by one upload of all; tiles go to a folder that
//! parts share. Otherwise each part has its bytes in a [file of its own](super::part_file), from which they
//! are copied. Behind them stands a record: the key of their content, their checksum, the summary that other
//! places of the file need, and the contribution of the vertices that were read to the model's hash.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use glam::DVec3;
use simod_model::memory::Reusing;
use simod_model::object::{self, Object, is_object};
use simod_model::object_output::{ObjectOutput, part_bytes};
use simod_model::object_range::ObjectRange;
use simod_model::output::OutputFile;
use simod_model::shared::{SharedFile, reaches};
use simod_model::shared_folder::{SharedFiles, become_output, settle};
use simod_model::{
    Division, Edit, Edited, Error, ErrorKind, Model, Normals, Output, PieceRange, Progress, Result,
    Rewriting, Summary, VertexChunk, input,
};

use super::part_file::{PartContent, PartFile, PartRecord, PartTarget, copy, damaged, open, refused};
use super::reach::check_reach;
use super::stream::{check_targets, checked_targets, field, key};
use super::transfer::{HashedModel, Surveys, Transfer, locked, pieces_at_once};
use super::{Folding, Reconstructed, Reconstruction, RestGeometry, Version};
use crate::deformed_positions::DeformedPositions;
use crate::fingerprint::{BlockHash, HashedPart};
use crate::sampled_model::SampledModel;

/// Destination that all parts share.
#[derive(Debug, Clone, Copy)]
pub enum SharedTarget<'a> {
    /// A file, or a folder for tiles.
    File(&'a Path),
    /// The output, which is an object, by an upload of this id.
    Object(&'a Path, &'a str),
}

impl SharedTarget<'_> {
    /// Whether the destination has the bytes that a record of the model's part tells of.
    fn has(&self, record: &PartRecord, model: &dyn Model) -> bool {
        match (self, &record.sent, record.place) {
            (Self::Object(_, id), Some(sent), _) => sent.id == *id,
            (Self::File(path), None, Some(place)) => reaches(path, place + record.bytes),
            (Self::File(path), None, None) => lost_tile(record, model, path).is_none(),
            (Self::Object(..), None, None) => true,
            _ => false,
        }
    }
}

/// Begins the object that parts are to share; the upload's id. Whoever begins it, has it completed by
/// [`join_parts`], or [aborts](abort_object) it.
///
/// # Errors
/// The store cannot be reached, refuses, or takes no parts.
pub fn begin_object(path: &Path) -> Result<String> {
    Ok(object::begin(path)?.leave())
}

/// Leaves nothing of such an object.
///
/// # Errors
/// The store cannot be reached.
pub fn abort_object(path: &Path, id: &str) -> Result<()> {
    object::go_on(path, id)?.upload().abort()
}

/// A part of a model that is written by itself: its range, and where it goes.
#[derive(Debug, Clone)]
pub struct Part<'a> {
    /// Pieces of those that can be written [by themselves](Model::division), from the first with vertices on;
    /// tiles, of a model that is made of these.
    pub pieces: Range<u64>,
    /// The part's own file, which appears whole or not at all, and tells that it is done.
    pub own: &'a Path,
    /// Destination that all parts share.
    pub shared: SharedTarget<'a>,
}

/// Writes a part. Of `how`, `resume`, `part_bytes`, `binding` and `tolerance` are not looked at. Nothing is
/// done if the part is there, whole, and of the same model, samples and options; `false` then.
///
/// Memory: as of [`reconstruct`](super::reconstruct), and a 16 000th of the bytes of the vertices that are
/// read.
///
/// # Errors
/// The model cannot be divided, cannot be read, or is not what was sampled, as far as its size tells; the
/// file cannot be written, or is being written by another process; a new position does not fit its type; the
/// user cancelled.
pub fn write_part(
    sampled: &SampledModel,
    model: &dyn Model,
    deformed: &DeformedPositions,
    how: &Reconstruction<'_>,
    part: &Part<'_>,
    progress: &dyn Progress,
) -> Result<bool> {
    let Part { pieces, own, shared } = part;
    let key = key(sampled, model, how, deformed)?;
    let is_same =
        |there: &PartRecord| there.key == key && there.pieces == *pieces && shared.has(there, model);
    if open(own).is_ok_and(|(_, there)| is_same(&there)) {
        return Ok(false);
    }
    check_reach(sampled, model, std::iter::once(deformed))?;
    let bytes_of = |all: u64| part_of(all, pieces, model, how.normals);
    let own_file = OutputFile::create(own, bytes_of(model.written_bytes()))?;
    // A file that is there tells of bytes that are written over from here on; if there is none, so much the
    // better.
    let _ = fs::remove_file(own);
    let mut part = PartFile::new(own_file, place_of_bytes(model, shared, how.normals)?);

    progress.begin("preparing", 0);
    let reusing = Reusing::begin();
    let around = RestGeometry::kept(sampled);
    let fields = [field(sampled, model, how, &around, deformed).prepared()];
    // Here, on all threads of the pool.
    around.cells();
    drop(reusing);
    sampled.samples.storage().tell_refusal(progress);
    let transfer = Transfer {
        fields: &fields,
        frame: &sampled.frame,
        hash: Mutex::new(HashedModel::Part(HashedPart::new(0))),
        binding: Mutex::default(),
        homes: Mutex::default(),
        surveys: Surveys::new([None], sampled.bounds.diagonal(), None),
        progress,
    };
    progress.begin("reconstructing", bytes_of(model.bytes_to_rewrite()));
    let only = PieceRange { first: pieces.start, end: Some(pieces.end) };
    let pieces_at_once = pieces_at_once(sampled, fields.len());
    let rewriting =
        Rewriting { normals: how.normals, only: Some(only), pieces_at_once, ..Rewriting::default() };
    model.rewrite(&mut [&mut part], rewriting, &transfer, progress)?;
    let HashedModel::Part(hashed) =
        std::mem::replace(&mut *locked(&transfer.hash), HashedModel::Part(Default::default()))
    else {
        return Err(Error::internal("a part was hashed as a whole"));
    };
    let Folding { samples, first, .. } = Folding::of_samples(&fields[0], sampled);
    let folded = (samples, first.map(|p| p.to_array()));
    part.commit(PartContent { key, pieces: pieces.clone(), hashed, folded }, own)?;
    Ok(true)
}

/// Destination of a part's bytes: what all parts write to, where the model's bytes keep their places, and
/// otherwise the part's own file.
fn place_of_bytes<'a>(
    model: &'a dyn Model,
    shared: &SharedTarget<'a>,
    normals: Normals,
) -> Result<PartTarget<'a>> {
    let in_place = model.division(normals).is_some_and(|division| division.in_place);
    Ok(match shared {
        SharedTarget::File(folder) if !model.tiles().is_empty() => {
            PartTarget::Tiles(SharedFiles::new(folder, model.tiles()))
        }
        _ if !in_place => PartTarget::Own,
        SharedTarget::File(path) => PartTarget::Shared(SharedFile::open(path)?),
        SharedTarget::Object(path, id) => {
            let range = ObjectRange::open(path, id, part_bytes(model.written_bytes()))?;
            PartTarget::Object(range, (*id).to_owned())
        }
    })
}

/// About the number of bytes of a part, of `all` bytes.
fn part_of(all: u64, pieces: &Range<u64>, model: &dyn Model, normals: Normals) -> u64 {
    let (part, whole) = if model.tiles().is_empty() {
        let whole = model.division(normals).map_or(1, |division| division.pieces);
        (pieces.end - pieces.start, whole)
    } else {
        let some = model.tiles().iter().take(pieces.end as usize).skip(pieces.start as usize);
        (some.map(|tile| tile.bytes).sum(), model.info().bytes)
    };
    (all as f64 * part as f64 / whole.max(1) as f64) as u64
}

/// The first tile of a part that is not in the folder that parts share.
fn lost_tile(record: &PartRecord, model: &dyn Model, shared: &Path) -> Option<PathBuf> {
    let own = model.tiles().iter().skip(record.pieces.start as usize);
    let paths = own.map(|tile| shared.join(&tile.name));
    paths.zip(&record.tiles).find(|(path, written)| !written.fits(path)).map(|(path, _)| path)
}

/// Puts parts together, which are of all pieces that can be written by themselves from the first with
/// vertices on, in their order: the whole model, which appears at once. `shared` is the parts' shared
/// destination.
///
/// Memory: 4 MiB, and the record of a part: see [`write_part`]; of tiles, 32 bytes and a name for each; of an
/// object, as of [`ObjectOutput`].
///
/// # Errors
/// A part is missing, damaged, or of other samples, options or pieces; the model is not what was sampled; the
/// output cannot be written, is written by another process, or is the model itself; the user cancelled.
pub fn join_parts(
    sampled: &SampledModel,
    model: &dyn Model,
    version: &Version<'_>,
    how: &Reconstruction<'_>,
    (parts, shared): (&[impl AsRef<Path>], SharedTarget<'_>),
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    let Some(Division { pieces, vertices, in_place }) = model.division(how.normals) else {
        let what = format!("{} cannot be written in parts", version.output.display());
        return Err(Error::argument(what, "write all of it at once"));
    };
    let is_still = version.deformed.are_still(&sampled.samples.positions);
    let joining = PartJoin {
        sampled,
        model,
        paths: parts.iter().map(AsRef::as_ref).collect(),
        output: version.output,
        key: key(sampled, model, how, version.deformed)?,
        first: vertices.start,
        end: pieces,
        normals: how.normals,
        edit: Nothing { is_still },
        progress,
    };
    let targets = || checked_targets(model, std::slice::from_ref(version), how);
    let folding = match shared {
        SharedTarget::File(folder) if !model.tiles().is_empty() => {
            targets()?;
            joining.tiles(folder)?
        }
        SharedTarget::File(shared) if in_place => {
            targets()?;
            joining.in_place(shared)?
        }
        _ => {
            check_targets(model, std::slice::from_ref(version), how, None)?;
            let sent =
                if let (SharedTarget::Object(_, id), true) = (shared, in_place) { Some(id) } else { None };
            joining.one_after_the_other(sent)?
        }
    };
    Ok(done(sampled, model, folding))
}

fn done(sampled: &SampledModel, model: &dyn Model, folding: Option<Folding>) -> Reconstructed {
    Reconstructed {
        vertices: model.info().vertices,
        non_finite: sampled.source.non_finite,
        taken_over: 0,
        folding: vec![folding],
        expected: vec![None],
        hashes: vec![None],
    }
}

/// Output to which parts are put together, where they are not in their places in a file.
struct Joined {
    to: JoinedTarget,
    /// Upload by which the parts have sent their bytes, as far as they could; `None` if they have not.
    sent: Option<String>,
}

enum JoinedTarget {
    File(OutputFile),
    Object(Box<ObjectOutput>),
}

impl Joined {
    fn create(output: &Path, sent: Option<&str>, bytes: u64) -> Result<Self> {
        let to = match sent {
            Some(id) => JoinedTarget::Object(Box::new(ObjectOutput::go_on(output, id, bytes)?)),
            None if is_object(output) => JoinedTarget::Object(Box::new(ObjectOutput::begin(output, bytes)?)),
            None => JoinedTarget::File(OutputFile::create(output, bytes)?),
        };
        Ok(Self { to, sent: sent.map(str::to_owned) })
    }

    /// Appends the bytes of a part, which has them or has sent them.
    fn take(&mut self, path: &Path, part: File, record: &PartRecord, progress: &dyn Progress) -> Result<()> {
        match (&mut self.to, &record.sent) {
            (to, None) if record.place.is_none() && self.sent.is_none() => {
                let bytes = (record.bytes, record.checksum);
                match to {
                    JoinedTarget::File(file) => {
                        copy(part, bytes, path, &mut |some| written(file, some), progress)
                    }
                    JoinedTarget::Object(object) => {
                        copy(part, bytes, path, &mut |some| object.write(some), progress)
                    }
                }
            }
            (JoinedTarget::Object(object), Some(sent))
                if self.sent.as_ref() == Some(&sent.id) && record.place == Some(object.position()) =>
            {
                // At most as long as two parts of the object.
                let mut edges = Vec::new();
                let keep = &mut |some: &[u8]| {
                    edges.extend_from_slice(some);
                    Ok(())
                };
                copy(part, (record.own(), sent.checksum), path, keep, progress)?;
                let (before, behind) = edges.split_at(sent.before as usize);
                object.write(before)?;
                sent.tags.iter().try_for_each(|tag| object.pass(tag.clone()))?;
                object.write(behind)
            }
            _ => Err(refused(path, "has its bytes in another place")),
        }
    }

    fn commit(self) -> Result<()> {
        match self.to {
            JoinedTarget::File(file) => file.commit(),
            JoinedTarget::Object(mut object) => {
                object.complete()?;
                object.commit().map(|_| ())
            }
        }
    }
}

impl Output for Joined {
    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()> {
        match &mut self.to {
            JoinedTarget::File(file) => file.replaceable().write_pieces(pieces, bytes, source_bytes, summary),
            JoinedTarget::Object(object) => object.write_pieces(pieces, bytes, source_bytes, summary),
        }
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        match &mut self.to {
            JoinedTarget::File(file) => file.replaceable().patch(at, bytes),
            JoinedTarget::Object(object) => object.patch(at, bytes),
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        match &mut self.to {
            JoinedTarget::File(file) => file.replaceable().finish(),
            JoinedTarget::Object(object) => object.finish(),
        }
    }
}

fn written(file: &mut OutputFile, bytes: &[u8]) -> Result<()> {
    file.write_all(bytes)
        .map_err(|e| e.downcast::<Error>().unwrap_or_else(|e| Error::internal(e.to_string()).because(e)))
}

/// Parts that are put together, and the key and the order that they have to have.
struct PartJoin<'a> {
    sampled: &'a SampledModel,
    model: &'a dyn Model,
    /// The files of the parts, in their order.
    paths: Vec<&'a Path>,
    output: &'a Path,
    key: String,
    /// First of the pieces that the parts are of, and the one behind the last.
    first: u64,
    end: u64,
    normals: Normals,
    /// Edit of the pieces before and behind the parts, which stay as they are.
    edit: Nothing,
    progress: &'a dyn Progress,
}

/// Sums of the records of the parts.
struct PartSums {
    summary: Summary,
    folding: Option<Folding>,
    /// End of the last part in the file that the parts share.
    end: u64,
}

impl PartJoin<'_> {
    /// Puts the folder of all tiles in its place.
    fn tiles(&self, shared: &Path) -> Result<Option<Folding>> {
        let (model, output) = (self.model, self.output);
        let (mut lost, mut written) = (None, Vec::new());
        let found = self.check(|path, _, record| {
            if record.tiles.len() as u64 != record.pieces.end - record.pieces.start {
                return Err(refused(path, "is of other tiles"));
            }
            let tile = || lost_tile(record, model, shared).map(|tile| (path.to_owned(), tile));
            lost = lost.take().or_else(tile);
            written.extend_from_slice(&record.tiles);
            Ok(())
        })?;
        let names: Vec<PathBuf> = model.tiles().iter().map(|tile| tile.name.clone()).collect();
        // An earlier call may have been killed when the output was in its place, before it could say so.
        if names.iter().zip(&written).all(|(name, file)| file.is(&output.join(name))) {
            settle(shared, output)?;
            return Ok(found.folding);
        }
        if let Some((part, tile)) = lost {
            let what = format!("speaks of {}, which is not there as a whole", tile.display());
            return Err(refused(&part, &what));
        }
        become_output(shared, &names, output, self.progress)?;
        Ok(found.folding)
    }

    /// Completes the file that the parts share, and puts it in its place.
    fn in_place(&self, shared: &Path) -> Result<Option<Folding>> {
        let found = self.check(|_, _, _| Ok(()))?;
        let is_short = !reaches(shared, found.end);
        if is_short || has_holes(shared) {
            // An earlier call may have been killed when the output was in its place, before it could say so:
            // then there is no file, or one that a part has begun anew since, without the others.
            match self.is_there(self.output) {
                Ok(()) => {
                    let _ = fs::remove_file(shared);
                    // The process that begins the output anew removes the files that a killed one has left
                    // beside it.
                    drop(OutputFile::create(self.output, 0));
                    return Ok(found.folding);
                }
                Err(e) if !shared.exists() => return Err(e),
                Err(_) if is_short => return Err(refused(shared, "is cut off: remove all parts")),
                Err(_) => self.is_there(shared)?,
            }
        }
        self.progress.begin("putting the parts together", 0);
        let mut file = SharedFile::open(shared)?;
        self.rewrite(self.before(), &mut file)?;
        // Parts are not written here: their ends are in their records.
        let end = found.end.max(file.position());
        if !reaches(shared, end) {
            return Err(refused(shared, "is cut off: remove all parts"));
        }
        self.rewrite(self.behind(), &mut Ending { to: &mut file, before: &found.summary })?;
        file.sync(true)?;
        self.progress.check()?;
        file.become_output(self.output)?;
        Ok(found.folding)
    }

    /// Writes the parts behind each other; where they were `sent` by an upload, only the bytes that the
    /// upload does not have.
    fn one_after_the_other(&self, sent: Option<&str>) -> Result<Option<Folding>> {
        let bytes = self.model.written_bytes();
        let join = || -> Result<PartSums> {
            let mut whole = Joined::create(self.output, sent, bytes)?;
            self.progress.begin("putting the parts together", bytes);
            self.rewrite(self.before(), &mut whole)?;
            let found = self.check(|path, part, record| whole.take(path, part, record, self.progress))?;
            self.rewrite(self.behind(), &mut Ending { to: &mut whole, before: &found.summary })?;
            self.progress.check()?;
            whole.commit()?;
            Ok(found)
        };
        let found = match join() {
            // The upload may be over as the output is in its place, and nobody had been told so.
            Err(e) if sent.is_some() && e.kind() == ErrorKind::Io => {
                self.is_there(self.output).map_err(|_| e)?;
                self.check(|_, _, _| Ok(()))?
            }
            joined => joined?,
        };
        Ok(found.folding)
    }

    /// The pieces before those that have vertices.
    fn before(&self) -> PieceRange {
        PieceRange { first: 0, end: Some(self.first) }
    }

    /// The pieces behind the parts.
    fn behind(&self) -> PieceRange {
        PieceRange { first: self.end, end: None }
    }

    fn rewrite(&self, only: PieceRange, to: &mut dyn Output) -> Result<()> {
        let rewriting = Rewriting { normals: self.normals, only: Some(only), ..Rewriting::default() };
        self.model.rewrite(&mut [to], rewriting, &self.edit, self.progress)
    }

    /// Takes the parts in their order, and sums up their records.
    fn check(&self, mut take: impl FnMut(&Path, File, &PartRecord) -> Result<()>) -> Result<PartSums> {
        let (mut hash, mut next) = (BlockHash::default(), self.first);
        let mut found = PartSums { summary: Summary::default(), folding: None, end: 0 };
        for path in &self.paths {
            let (part, record) = open(path)?;
            let refused = |what: &str| refused(path, what);
            if record.key != self.key {
                return Err(refused("is of another model, other samples or other options"));
            }
            if record.pieces.start != next || record.place.is_some_and(|place| place < found.end) {
                return Err(refused("is not the part that comes next"));
            }
            next = record.pieces.end;
            found.end = record.place.map_or(0, |place| place + record.bytes);
            take(path, part, &record)?;
            let of_part = record.summary.as_deref().map_or(Some(Summary::default()), Summary::decode);
            found.summary.absorb(&of_part.ok_or_else(|| damaged(path, "its record cannot be read"))?);
            if !hash.append(&record.hashed) {
                return Err(refused("has read other vertices than it is of"));
            }
            let (samples, first) = record.folded;
            let first = first.map(DVec3::from_array);
            found.folding.get_or_insert(Folding { samples, first, vertices: None });
        }
        if next != self.end {
            return Err(Error::argument(
                format!("parts of {} are missing", self.output.display()),
                "write all of them first",
            ));
        }
        if hash.fingerprint() != self.sampled.source.fingerprint {
            return Err(self.sampled.source_changed(self.model.path()));
        }
        Ok(found)
    }

    /// An error unless a file has the bytes of all parts in their places.
    fn is_there(&self, output: &Path) -> Result<()> {
        let gone = || {
            Error::mismatch(
                format!("the bytes of the parts of {} are gone", output.display()),
                "remove the parts, and write all of them again",
            )
        };
        let object = is_object(output).then(|| object::open(output)).transpose()?;
        for path in &self.paths {
            let record = open(path)?.1;
            let (at, bytes) = (record.place.unwrap_or_default(), (record.bytes, record.checksum));
            let nowhere = &mut |_: &[u8]| Ok(());
            let read = match &object {
                Some(object) => copy(ObjectReader { object, at }, bytes, output, nowhere, self.progress),
                None => {
                    let mut file = input::open(output).map_err(|e| gone().because(e))?;
                    file.seek(SeekFrom::Start(at)).map_err(|e| Error::io("read", output, &e))?;
                    copy(file, bytes, output, nowhere, self.progress)
                }
            };
            read.map_err(|e| if e.kind() == ErrorKind::Cancelled { e } else { gone().because(e) })?;
        }
        Ok(())
    }
}

/// Whether less of a file is on the disk than its length says: parts of the file were not written, or the
/// disk compresses.
fn has_holes(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        fs::metadata(path).is_ok_and(|is| is.blocks().saturating_mul(512) < is.len())
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        true
    }
}

/// An object from some place on.
struct ObjectReader<'a> {
    object: &'a Arc<dyn Object>,
    at: u64,
}

impl Read for ObjectReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.object.bytes().saturating_sub(self.at).min(buffer.len() as u64) as usize;
        self.object.read_at(&mut buffer[..count], self.at).map_err(io::Error::other)?;
        self.at += count as u64;
        Ok(count)
    }
}

/// Output for the bytes behind the parts, which adds the summary of the parts.
struct Ending<'a> {
    to: &'a mut dyn Output,
    before: &'a Summary,
}

impl Output for Ending<'_> {
    fn begin_at(&mut self, at: u64) -> io::Result<()> {
        self.to.begin_at(at)
    }

    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()> {
        self.to.write_pieces(pieces, bytes, source_bytes, summary)
    }

    fn summary(&self) -> Summary {
        self.before.clone()
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.to.patch(at, bytes)
    }

    fn finish(&mut self) -> io::Result<()> {
        self.to.finish()
    }
}

/// Edit of pieces that hold no vertices.
struct Nothing {
    is_still: bool,
}

impl Edit for Nothing {
    fn edit(&self, _chunk: &VertexChunk, _versions: &mut [Edited]) -> Result<()> {
        Ok(())
    }

    fn is_still(&self, _version: usize) -> bool {
        self.is_still
    }
}
