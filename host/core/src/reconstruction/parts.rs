//! A deformed model in parts, each of a range of the file and written by itself, on any machine, in any order, as
//! often as one likes; and the whole of them, the same bytes as [`reconstruct`](super::reconstruct) writes.
//!
//! Where it is known beforehand where the bytes of each part go, they go there at once, into a file that all parts
//! share, and that becomes the output in the end; or into an object, by one upload of all. Otherwise each part has them in
//! a file of its own, and they are copied. Behind them stands a record: what they are of, their checksum, what other places of the file have to know of
//! them, and what the vertices that were read add to the model's hash.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex};

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::object::{self, Object, is_object};
use simod_model::object_output::{ObjectOutput, part_bytes};
use simod_model::object_range::{ObjectRange, SentRange};
use simod_model::output::OutputFile;
use simod_model::shared::{SharedFile, reaches};
use simod_model::{
    Division, Edit, Edited, Error, ErrorKind, Model, Output, PieceRange, Progress, Result, Rewriting,
    Summary, VertexChunk, input,
};
use xxhash_rust::xxh3::Xxh3Default;

use super::reach::check_reach;
use super::stream::{check_targets, field, key};
use super::transfer::{Hashing, Surveys, Transfer, locked};
use super::{Folding, Reconstructed, Reconstruction, RestGeometry, Version};
use crate::fingerprint::{Blocks, HashedPart};
use crate::sampled_model::SampledModel;
use crate::sealed::{UNKNOWN_VERSION, seal, unseal};

/// What the record of a part begins with.
const LETTERS: &[u8; 8] = b"simodprt";

const VERSION: u32 = 2;

/// No record is longer: of a part of 256 TiB.
const LONGEST: u64 = 16 << 30;

/// Bytes that are copied at a time.
const BLOCK: usize = 1 << 20;

/// What stands behind the bytes of a part.
#[derive(Serialize, Deserialize)]
struct Record {
    /// Hash of all that determines the bytes of the whole.
    key: String,
    /// Which pieces of the model these are.
    pieces: Range<u64>,
    /// Where the bytes are in what parts share, if they are there.
    place: Option<u64>,
    /// What of them is in an object, if parts share one; the others are here.
    sent: Option<Sent>,
    bytes: u64,
    checksum: u128,
    /// What other places of the file have to know of them, in a word.
    summary: Option<String>,
    hashed: HashedPart,
    /// How many samples are folded, and where the first of them is, in the model's coordinates.
    folded: (u64, Option<[f64; 3]>),
}

/// What of a part was sent to an object.
#[derive(Serialize, Deserialize)]
struct Sent {
    /// The upload.
    id: String,
    /// So many bytes come before it, and behind it: they are of parts of the object that others have the rest of.
    before: u64,
    behind: u64,
    checksum: u128,
    /// What the store knows the object's parts between these by.
    tags: Vec<String>,
}

impl Record {
    /// Bytes in the part's own file.
    fn own(&self) -> u64 {
        match (&self.sent, self.place) {
            (Some(sent), _) => sent.before.saturating_add(sent.behind),
            (None, Some(_)) => 0,
            (None, None) => self.bytes,
        }
    }
}

/// What parts share.
#[derive(Debug, Clone, Copy)]
pub enum Shared<'a> {
    /// A file.
    File(&'a Path),
    /// The output, which is an object, by an upload of this id.
    Object(&'a Path, &'a str),
}

impl Shared<'_> {
    /// Whether it has what a record speaks of.
    fn has(&self, record: &Record) -> bool {
        match (self, &record.sent, record.place) {
            (Self::Object(_, id), Some(sent), _) => sent.id == *id,
            (Self::File(path), None, Some(place)) => reaches(path, place + record.bytes),
            (_, None, None) => true,
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

/// Which part of a model is written, and where.
#[derive(Debug, Clone)]
pub struct Part<'a> {
    /// Pieces of those that can be written [by themselves](Model::division), from the first with vertices on.
    pub pieces: Range<u64>,
    /// The part's own file, which appears whole or not at all, and tells that it is done.
    pub own: &'a Path,
    /// What all parts share.
    pub shared: Shared<'a>,
}

/// Writes a part. Of `how`, `resume`, `part_bytes` and `binding` are not looked at. Nothing is done if the part is
/// there, whole, and of the same model, samples and options; `false` then.
///
/// Memory: as of [`reconstruct`](super::reconstruct), a 16 000th of the bytes of the vertices that are read, and what an
/// [object's](ObjectRange) range takes.
///
/// # Errors
/// The model cannot be divided, cannot be read, or is not what was sampled, as far as its size tells; the file
/// cannot be written, or is being written by another process; a new position does not fit its type; the user
/// cancelled.
pub fn write_part(
    sampled: &SampledModel,
    model: &dyn Model,
    deformed: &[Vec3],
    how: &Reconstruction<'_>,
    part: &Part<'_>,
    progress: &dyn Progress,
) -> Result<bool> {
    let Part { pieces, own, shared } = part;
    let key = key(sampled, model, how, deformed)?;
    if let Ok((_, there)) = open(own)
        && there.key == key
        && there.pieces == *pieces
        && shared.has(&there)
    {
        return Ok(false);
    }
    check_reach(sampled, model, std::iter::once(deformed))?;
    let division = model.division(how.normals);
    let all = division.as_ref().map_or(1, |division| division.pieces).max(1);
    let of_part = |bytes: u64| (bytes as f64 * (pieces.end - pieces.start) as f64 / all as f64) as u64;
    let in_place = division.is_some_and(|division| division.in_place);
    let mut part = PartFile {
        own: OutputFile::create(own, of_part(model.written_bytes()))?,
        to: match shared {
            _ if !in_place => To::Own,
            Shared::File(path) => To::File(SharedFile::open(path)?),
            Shared::Object(path, id) => {
                To::Object(ObjectRange::open(path, id, part_bytes(model.written_bytes()))?, (*id).to_owned())
            }
        },
        place: 0,
        bytes: 0,
        hash: Xxh3Default::new(),
        summary: Summary::default(),
    };

    progress.begin("preparing", 0);
    let surroundings = RestGeometry::new(&sampled.samples);
    let fields = [field(sampled, model, how, &surroundings, deformed)];
    // Here, on all threads of the pool.
    surroundings.cells();
    let transfer = Transfer {
        fields: &fields,
        frame: &sampled.frame,
        hash: Mutex::new(Hashing::Part(HashedPart::new(0))),
        binding: Mutex::default(),
        homes: Mutex::default(),
        surveys: Surveys::new([None]),
        progress,
    };
    progress.begin("reconstructing", of_part(model.info().bytes));
    let only = PieceRange { first: pieces.start, end: Some(pieces.end) };
    let rewriting = Rewriting { normals: how.normals, only: Some(only), ..Rewriting::default() };
    model.rewrite(&mut [&mut part], rewriting, &transfer, progress)?;
    let hashed = match std::mem::replace(&mut *locked(&transfer.hash), Hashing::Part(HashedPart::default())) {
        Hashing::Part(hashed) => hashed,
        Hashing::All(_) => return Err(Error::internal("a part was hashed as a whole", "report this")),
    };
    let Folding { samples, first, .. } = Folding::of_samples(&fields[0], sampled);
    let folded = (samples, first.map(|p| p.to_array()));
    part.commit(key, pieces.clone(), hashed, folded, own)?;
    Ok(true)
}

/// Puts parts together, which are of all pieces that can be written by themselves from the first with vertices on, in
/// their order: the whole model, which appears at once. `shared` is what they share.
///
/// Memory: 4 MiB, and the record of a part: see [`write_part`]; of an object, as of [`ObjectOutput`].
///
/// # Errors
/// A part is missing, damaged, or of other samples, options or pieces; the model is not what was sampled; the
/// output cannot be written, is written by another process, or is the model itself; the user cancelled.
pub fn join_parts(
    sampled: &SampledModel,
    model: &dyn Model,
    version: &Version<'_>,
    how: &Reconstruction<'_>,
    (parts, shared): (&[impl AsRef<Path>], Shared<'_>),
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    check_targets(model, std::slice::from_ref(version), how)?;
    let Some(Division { pieces, vertices, in_place }) = model.division(how.normals) else {
        let what = format!("{} cannot be written in parts", version.output.display());
        return Err(Error::new(ErrorKind::Argument, what, "write all of it at once"));
    };
    let bits = |p: &Vec3| p.to_array().map(f32::to_bits);
    let is_still = version.deformed.iter().map(bits).eq(sampled.samples.positions.iter().map(bits));
    let rewrite = |only: PieceRange, to: &mut dyn Output| {
        let rewriting = Rewriting { normals: how.normals, only: Some(only), ..Rewriting::default() };
        model.rewrite(&mut [to], rewriting, &Nothing { is_still }, progress)
    };
    let before = PieceRange { first: 0, end: Some(vertices.start) };
    let behind = PieceRange { first: pieces, end: None };
    let paths: Vec<&Path> = parts.iter().map(AsRef::as_ref).collect();
    let key = key(sampled, model, how, version.deformed)?;
    let joining = Joining { key, first: vertices.start, end: pieces, output: version.output };
    let found = match shared {
        Shared::File(shared) if in_place => {
            let found = joining.check(&paths, sampled, model, |_, _, _| Ok(()))?;
            if !shared.exists() {
                // Killed when the output was in its place, and nobody had been told so.
                is_there(version.output, &paths, progress)?;
                return Ok(done(sampled, model, found.folding));
            }
            progress.begin("putting the parts together", 0);
            let mut file = SharedFile::open(shared)?;
            rewrite(before, &mut file)?;
            // Nothing of the parts is written here: how far they reach is in their records.
            let end = found.end.max(file.position());
            if !reaches(shared, end) {
                return Err(refused(shared, "is cut off: remove all parts"));
            }
            let mut rest = Rest { to: &mut file, before: &found.summary };
            rewrite(behind, &mut rest)?;
            file.sync(true)?;
            progress.check()?;
            file.become_output(version.output)?;
            found
        }
        _ => {
            let sent = if let (Shared::Object(_, id), true) = (shared, in_place) { Some(id) } else { None };
            let join = || -> Result<Found> {
                let mut whole = Joined::create(version.output, sent, model.written_bytes())?;
                progress.begin("putting the parts together", model.written_bytes());
                rewrite(before, &mut whole)?;
                let take = |path: &Path, part, record: &Record| whole.take(path, part, record, progress);
                let found = joining.check(&paths, sampled, model, take)?;
                rewrite(behind, &mut Rest { to: &mut whole, before: &found.summary })?;
                progress.check()?;
                whole.commit()?;
                Ok(found)
            };
            match join() {
                // The upload may be over as the output is in its place, and nobody had been told so.
                Err(e) if sent.is_some() && e.kind() == ErrorKind::Io => {
                    is_there(version.output, &paths, progress).map_err(|_| e)?;
                    joining.check(&paths, sampled, model, |_, _, _| Ok(()))?
                }
                joined => joined?,
            }
        }
    };
    Ok(done(sampled, model, found.folding))
}

fn done(sampled: &SampledModel, model: &dyn Model, folding: Option<Folding>) -> Reconstructed {
    Reconstructed {
        vertices: model.info().vertices,
        non_finite: sampled.source.non_finite,
        taken_over: 0,
        folding: vec![folding],
        expected: vec![None],
    }
}

/// The whole that parts are put together to, where they are not in their places in a file.
struct Joined {
    to: Whole,
    /// The upload by which parts have sent what of them they could, if they have.
    sent: Option<String>,
}

enum Whole {
    File(OutputFile),
    Object(Box<ObjectOutput>),
}

impl Joined {
    fn create(output: &Path, sent: Option<&str>, bytes: u64) -> Result<Self> {
        let to = match sent {
            Some(id) => Whole::Object(Box::new(ObjectOutput::go_on(output, id, bytes)?)),
            None if is_object(output) => Whole::Object(Box::new(ObjectOutput::begin(output, bytes)?)),
            None => Whole::File(OutputFile::create(output, bytes)?),
        };
        Ok(Self { to, sent: sent.map(str::to_owned) })
    }

    /// Appends the bytes of a part, which has them or has sent them.
    fn take(&mut self, path: &Path, part: File, record: &Record, progress: &dyn Progress) -> Result<()> {
        match (&mut self.to, &record.sent) {
            (to, None) if record.place.is_none() && self.sent.is_none() => {
                let bytes = (record.bytes, record.checksum);
                match to {
                    Whole::File(file) => copy(part, bytes, path, &mut |some| written(file, some), progress),
                    Whole::Object(object) => {
                        copy(part, bytes, path, &mut |some| object.write(some), progress)
                    }
                }
            }
            (Whole::Object(object), Some(sent))
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
            Whole::File(file) => file.commit(),
            Whole::Object(mut object) => {
                object.complete()?;
                object.commit().map(|_| ())
            }
        }
    }
}

impl Output for Joined {
    fn write_piece(&mut self, bytes: &[u8], source_bytes: u64, summary: &Summary) -> io::Result<()> {
        match &mut self.to {
            Whole::File(file) => file.replaceable().write_piece(bytes, source_bytes, summary),
            Whole::Object(object) => object.write_piece(bytes, source_bytes, summary),
        }
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        match &mut self.to {
            Whole::File(file) => file.replaceable().patch(at, bytes),
            Whole::Object(object) => object.patch(at, bytes),
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        match &mut self.to {
            Whole::File(file) => file.replaceable().finish(),
            Whole::Object(object) => object.finish(),
        }
    }
}

fn written(file: &mut OutputFile, bytes: &[u8]) -> Result<()> {
    file.write_all(bytes)
        .map_err(|e| e.downcast::<Error>().unwrap_or_else(|e| Error::internal(e.to_string(), "report this")))
}

/// What parts have to be.
struct Joining<'a> {
    key: String,
    /// The first of the pieces that they are of, and the one behind the last.
    first: u64,
    end: u64,
    output: &'a Path,
}

/// What parts say of themselves.
struct Found {
    summary: Summary,
    folding: Option<Folding>,
    /// Where the last one ends in the file that they share.
    end: u64,
}

impl Joining<'_> {
    /// Takes the parts in their order, and what they say together.
    fn check(
        &self,
        paths: &[&Path],
        sampled: &SampledModel,
        model: &dyn Model,
        mut take: impl FnMut(&Path, File, &Record) -> Result<()>,
    ) -> Result<Found> {
        let (mut hash, mut next) = (Blocks::default(), self.first);
        let mut found = Found { summary: Summary::default(), folding: None, end: 0 };
        for path in paths {
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
            found.summary.absorb(&of_part.ok_or_else(|| refused("has a record that cannot be read"))?);
            if !hash.append(&record.hashed) {
                return Err(refused("has read other vertices than it is of"));
            }
            let (samples, first) = record.folded;
            let first = first.map(DVec3::from_array);
            found.folding.get_or_insert(Folding { samples, first, vertices: None });
        }
        if next != self.end {
            return Err(Error::new(
                ErrorKind::Argument,
                format!("parts of {} are missing", self.output.display()),
                "write all of them first",
            ));
        }
        if hash.fingerprint() != sampled.source.fingerprint {
            return Err(sampled.source_changed(model.path()));
        }
        Ok(found)
    }
}

/// An error unless a file has the bytes of all parts in their places.
fn is_there(output: &Path, parts: &[&Path], progress: &dyn Progress) -> Result<()> {
    let gone = || {
        Error::new(
            ErrorKind::Mismatch,
            format!("the bytes of the parts of {} are gone", output.display()),
            "remove the parts, and write all of them again",
        )
    };
    let object = is_object(output).then(|| object::open(output)).transpose()?;
    for path in parts {
        let record = open(path)?.1;
        let (at, bytes) = (record.place.unwrap_or_default(), (record.bytes, record.checksum));
        let nowhere = &mut |_: &[u8]| Ok(());
        let read = match &object {
            Some(object) => copy(Reading { object, at }, bytes, output, nowhere, progress),
            None => {
                let mut file = input::open(output).map_err(|_| gone())?;
                file.seek(SeekFrom::Start(at)).map_err(|e| Error::io("read", output, &e))?;
                copy(file, bytes, output, nowhere, progress)
            }
        };
        read.map_err(|_| gone())?;
    }
    Ok(())
}

/// An object from some place on.
struct Reading<'a> {
    object: &'a Arc<dyn Object>,
    at: u64,
}

impl Read for Reading<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.object.bytes().saturating_sub(self.at).min(buffer.len() as u64) as usize;
        self.object.read_at(&mut buffer[..count], self.at).map_err(io::Error::other)?;
        self.at += count as u64;
        Ok(count)
    }
}

/// Where the bytes of a part go.
enum To {
    /// Its own file.
    Own,
    /// The file that all share.
    File(SharedFile),
    /// The object that all share, and the upload.
    Object(ObjectRange, String),
}

/// A part in the making.
struct PartFile {
    own: OutputFile,
    to: To,
    /// Where it begins in the file that is read.
    place: u64,
    bytes: u64,
    hash: Xxh3Default,
    summary: Summary,
}

impl PartFile {
    fn commit(
        mut self,
        key: String,
        pieces: Range<u64>,
        hashed: HashedPart,
        folded: (u64, Option<[f64; 3]>),
        path: &Path,
    ) -> Result<()> {
        let (bytes, checksum, summary) = (self.bytes, self.hash.digest128(), self.summary.encode());
        // First, so that no record speaks of bytes that are not on the disk, or in the store.
        let (place, sent) = match self.to {
            To::Own => (None, None),
            To::File(mut file) => {
                file.sync(false)?;
                (Some(self.place), None)
            }
            To::Object(range, id) => {
                let SentRange { before, tags, behind } = range.finish()?;
                let mut hash = Xxh3Default::new();
                for edge in [&before, &behind] {
                    hash.update(edge);
                    self.own.write_all(edge).map_err(|e| Error::io("write", path, &e))?;
                }
                let (before, behind) = (before.len() as u64, behind.len() as u64);
                (Some(self.place), Some(Sent { id, before, behind, checksum: hash.digest128(), tags }))
            }
        };
        let record = Record { key, pieces, place, sent, bytes, checksum, summary, hashed, folded };
        let sealed = seal(LETTERS, VERSION, &record).map_err(|e| {
            Error::internal(format!("cannot write {}: {e}", path.display()), "report this").because(e)
        })?;
        let length = (sealed.len() as u64).to_le_bytes();
        let written = self.own.write_all(&sealed).and_then(|()| self.own.write_all(&length));
        written.map_err(|e| Error::io("write", path, &e))?;
        self.own.commit()
    }
}

impl Output for PartFile {
    fn begin_at(&mut self, at: u64) -> io::Result<()> {
        self.place = at;
        match &mut self.to {
            To::Own => Ok(()),
            To::File(file) => file.begin_at(at),
            To::Object(range, _) => {
                range.begin_at(at);
                Ok(())
            }
        }
    }

    fn write_piece(&mut self, bytes: &[u8], source_bytes: u64, summary: &Summary) -> io::Result<()> {
        match &mut self.to {
            To::Own => self.own.write_all(bytes)?,
            To::File(file) => file.write_piece(bytes, source_bytes, summary)?,
            To::Object(range, _) => range.write(bytes).map_err(io::Error::other)?,
        }
        self.hash.update(bytes);
        self.bytes += bytes.len() as u64;
        self.summary.absorb(summary);
        Ok(())
    }

    fn patch(&mut self, _at: u64, _bytes: &[u8]) -> io::Result<()> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "nothing is replaced in a part"))
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What comes behind the parts, which have told so much of themselves.
struct Rest<'a> {
    to: &'a mut dyn Output,
    before: &'a Summary,
}

impl Output for Rest<'_> {
    fn begin_at(&mut self, at: u64) -> io::Result<()> {
        self.to.begin_at(at)
    }

    fn write_piece(&mut self, bytes: &[u8], source_bytes: u64, summary: &Summary) -> io::Result<()> {
        self.to.write_piece(bytes, source_bytes, summary)
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

/// Edits what holds no vertices.
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

fn refused(path: &Path, what: &str) -> Error {
    Error::new(
        ErrorKind::Mismatch,
        format!("{} {what}", path.display()),
        "remove it, and write that part again",
    )
}

/// A part's file, at its beginning, and its record.
fn open(path: &Path) -> Result<(File, Record)> {
    let failed = |e: io::Error| Error::io("read", path, &e);
    let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
    let mut file = input::open(path)?;
    let length = file.metadata().map_err(failed)?.len();
    let Some(end) = length.checked_sub(8) else { return Err(damaged("it is cut off")) };
    let mut number = [0; 8];
    file.seek(SeekFrom::Start(end)).and_then(|_| file.read_exact(&mut number)).map_err(failed)?;
    let of_record = u64::from_le_bytes(number);
    let Some(start) = end.checked_sub(of_record).filter(|_| of_record <= LONGEST) else {
        return Err(damaged("it is cut off"));
    };
    let mut sealed = Vec::new();
    file.seek(SeekFrom::Start(start)).map_err(failed)?;
    Read::by_ref(&mut file).take(of_record).read_to_end(&mut sealed).map_err(failed)?;
    let (version, content) = unseal(&sealed, LETTERS).map_err(damaged)?;
    if version != VERSION {
        return Err(damaged(UNKNOWN_VERSION));
    }
    let record: Record = postcard::from_bytes(content).map_err(|_| damaged("its record makes no sense"))?;
    if record.own() != start || record.pieces.start > record.pieces.end {
        return Err(damaged("its record makes no sense"));
    }
    file.seek(SeekFrom::Start(0)).map_err(failed)?;
    Ok((file, record))
}

/// Hands on so many bytes, and looks whether they have their checksum.
fn copy(
    mut from: impl Read,
    (mut left, checksum): (u64, u128),
    path: &Path,
    to: &mut dyn FnMut(&[u8]) -> Result<()>,
    progress: &dyn Progress,
) -> Result<()> {
    let (mut hash, mut block) = (Xxh3Default::new(), vec![0; BLOCK]);
    while left > 0 {
        progress.check()?;
        let some = &mut block[..left.min(BLOCK as u64) as usize];
        from.read_exact(some).map_err(|e| Error::io("read", path, &e))?;
        hash.update(some);
        to(some)?;
        left -= some.len() as u64;
        progress.advance(some.len() as u64);
    }
    if hash.digest128() != checksum {
        return Err(refused(path, "is damaged: its checksum is wrong"));
    }
    Ok(())
}
