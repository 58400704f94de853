//! A deformed model in parts, each of a range of the file and written by itself, on any machine, in any order, as
//! often as one likes; and the whole of them, the same bytes as [`reconstruct`](super::reconstruct) writes.
//!
//! A part's file has the bytes, and behind them a record: what they are of, their checksum, what other places of
//! the file have to know of them, and what the vertices that were read add to the model's hash.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Mutex;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::output::OutputFile;
use simod_model::{
    Edit, Edited, Error, ErrorKind, Model, Output, PieceRange, Progress, Result, Rewriting, Summary,
    VertexChunk, input,
};
use xxhash_rust::xxh3::Xxh3Default;

use super::reach::check_reach;
use super::stream::{check_targets, field, key};
use super::transfer::{Hashing, Surveys, Transfer, locked};
use super::{Folding, Reconstructed, Reconstruction, Surroundings, Version};
use crate::fingerprint::{Blocks, HashedPart};
use crate::sampled_model::SampledModel;
use crate::sealed::{UNKNOWN_VERSION, seal, unseal};

/// What the record of a part begins with.
const LETTERS: &[u8; 8] = b"simodprt";

const VERSION: u32 = 1;

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
    bytes: u64,
    checksum: u128,
    /// What other places of the file have to know of them, in a word.
    summary: Option<String>,
    hashed: HashedPart,
    /// How many samples are folded, and where the first of them is, in the model's coordinates.
    folded: (u64, Option<[f64; 3]>),
}

/// Writes what becomes of some pieces of the model, of those that can be written [by
/// themselves](Model::division), to a file that appears whole or not at all. Of `how`, `resume`, `part_bytes` and
/// `binding` are not looked at. Nothing is done if the file is there, whole, and of the same model, samples and
/// options; `false` then.
///
/// Memory: as of [`reconstruct`](super::reconstruct), and a 16 000th of the bytes of the vertices that are read.
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
    (pieces, path): (Range<u64>, &Path),
    progress: &dyn Progress,
) -> Result<bool> {
    let key = key(sampled, model, how, deformed)?;
    if let Ok((_, there)) = open(path)
        && there.key == key
        && there.pieces == pieces
    {
        return Ok(false);
    }
    check_reach(sampled, model, std::iter::once(deformed))?;
    let all = model.division(how.normals).map_or(1, |division| division.pieces).max(1);
    let of_part = |bytes: u64| (bytes as f64 * (pieces.end - pieces.start) as f64 / all as f64) as u64;
    let mut part = PartFile {
        file: OutputFile::create(path, of_part(model.written_bytes()))?,
        bytes: 0,
        hash: Xxh3Default::new(),
        summary: Summary::default(),
    };

    progress.begin("preparing", 0);
    let surroundings = Surroundings::of(&sampled.samples);
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
    part.commit(key, pieces, hashed, folded, path)?;
    Ok(true)
}

/// Puts parts together, which are of all pieces that can be written by themselves, in their order: the whole
/// model, which appears at once.
///
/// Memory: 1 MiB, and the record of a part: see [`write_part`].
///
/// # Errors
/// A part is missing, damaged, or of other samples, options or pieces; the model is not what was sampled; the
/// output cannot be written, is written by another process, or is the model itself; the user cancelled.
pub fn join_parts(
    sampled: &SampledModel,
    model: &dyn Model,
    version: &Version<'_>,
    how: &Reconstruction<'_>,
    parts: &[impl AsRef<Path>],
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    check_targets(model, std::slice::from_ref(version), how)?;
    let key = key(sampled, model, how, version.deformed)?;
    let info = model.info();
    let mut file = OutputFile::create(version.output, model.written_bytes())?;
    progress.begin("putting the parts together", model.written_bytes());
    let (mut summary, mut hash, mut next) = (Summary::default(), Blocks::default(), 0);
    let mut folding = None;
    for path in parts.iter().map(AsRef::as_ref) {
        let (part, record) = open(path)?;
        let refused = |what: &str| refused(path, what);
        if record.key != key {
            return Err(refused("is of another model, other samples or other options"));
        }
        if record.pieces.start != next {
            return Err(refused("is not the part that comes next"));
        }
        next = record.pieces.end;
        copy(part, &record, path, &mut file, progress)?;
        let of_part = record.summary.as_deref().map_or(Some(Summary::default()), Summary::decode);
        summary.absorb(&of_part.ok_or_else(|| refused("has a record that cannot be read"))?);
        if !hash.append(&record.hashed) {
            return Err(refused("has read other vertices than it is of"));
        }
        let (samples, first) = record.folded;
        folding.get_or_insert(Folding { samples, first: first.map(DVec3::from_array), vertices: None });
    }
    if model.division(how.normals).is_none_or(|division| division.pieces != next) {
        return Err(Error::new(
            ErrorKind::Argument,
            format!("parts of {} are missing", version.output.display()),
            "write all of them first",
        ));
    }
    if hash.fingerprint() != sampled.source.fingerprint {
        return Err(sampled.source_changed(model.path()));
    }
    let bits = |p: &Vec3| p.to_array().map(f32::to_bits);
    let is_still = version.deformed.iter().map(bits).eq(sampled.samples.positions.iter().map(bits));
    let only = PieceRange { first: next, end: None };
    let rewriting = Rewriting { normals: how.normals, only: Some(only), ..Rewriting::default() };
    let mut rest = Rest { to: file.replaceable(), before: summary };
    model.rewrite(&mut [&mut rest], rewriting, &Nothing { is_still }, progress)?;
    progress.check()?;
    file.commit()?;
    Ok(Reconstructed {
        vertices: info.vertices,
        non_finite: sampled.source.non_finite,
        taken_over: 0,
        folding: vec![folding],
        expected: vec![None],
    })
}

/// A part in the making.
struct PartFile {
    file: OutputFile,
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
        let record = Record { key, pieces, bytes, checksum, summary, hashed, folded };
        let sealed = seal(LETTERS, VERSION, &record).map_err(|e| {
            Error::internal(format!("cannot write {}: {e}", path.display()), "report this").because(e)
        })?;
        let length = (sealed.len() as u64).to_le_bytes();
        let written = self.file.write_all(&sealed).and_then(|()| self.file.write_all(&length));
        written.map_err(|e| Error::io("write", path, &e))?;
        self.file.commit()
    }
}

impl Output for PartFile {
    fn write_piece(&mut self, bytes: &[u8], _source_bytes: u64, summary: &Summary) -> io::Result<()> {
        self.file.write_all(bytes)?;
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
struct Rest<O> {
    to: O,
    before: Summary,
}

impl<O: Output> Output for Rest<O> {
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
    if record.bytes != start || record.pieces.start > record.pieces.end {
        return Err(damaged("its record makes no sense"));
    }
    file.seek(SeekFrom::Start(0)).map_err(failed)?;
    Ok((file, record))
}

/// Appends the bytes of a part, and checks them.
fn copy(
    mut part: File,
    record: &Record,
    path: &Path,
    to: &mut OutputFile,
    progress: &dyn Progress,
) -> Result<()> {
    let (mut left, mut hash, mut block) = (record.bytes, Xxh3Default::new(), vec![0; BLOCK]);
    while left > 0 {
        progress.check()?;
        let some = &mut block[..left.min(BLOCK as u64) as usize];
        part.read_exact(some).map_err(|e| Error::io("read", path, &e))?;
        hash.update(some);
        to.write_all(some)
            .map_err(|e| e.downcast::<Error>().unwrap_or_else(|e| Error::io("write", path, &e)))?;
        left -= some.len() as u64;
        progress.advance(some.len() as u64);
    }
    if hash.digest128() != record.checksum {
        return Err(refused(path, "is damaged: its checksum is wrong"));
    }
    Ok(())
}
