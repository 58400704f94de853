//! File of a part: its bytes, unless they are in a file, a folder or an object that parts share, and behind
//! them a record of them.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use simod_model::object_range::{ObjectRange, SentRange};
use simod_model::output::OutputFile;
use simod_model::shared::SharedFile;
use simod_model::shared_folder::{SharedFiles, WrittenFile};
use simod_model::{Error, Output, Progress, Result, Summary, input};
use xxhash_rust::xxh3::Xxh3Default;

use crate::fingerprint::HashedPart;
use crate::sealed::{seal, unsealed};

/// First letters of the record of a part.
const LETTERS: &[u8; 8] = b"simodprt";

const VERSION: u32 = 2;

/// Most bytes of a record: that of a part of 256 TiB.
const LONGEST: u64 = 16 << 30;

/// Bytes that are copied at a time.
const BLOCK: usize = 1 << 20;

/// Record behind the bytes of a part.
#[derive(Serialize, Deserialize)]
pub(super) struct PartRecord {
    /// Hash of all that determines the bytes of the whole.
    pub(super) key: String,
    /// The numbers of the model's pieces that the part holds.
    pub(super) pieces: Range<u64>,
    /// Offset of the part's bytes in the file, or the object, that parts share, if they are there.
    pub(super) place: Option<u64>,
    /// Bytes of the part that are in an object, if parts share one; the others are in the part's own file.
    pub(super) sent: Option<Sent>,
    /// Number of the part's bytes, in either place.
    pub(super) bytes: u64,
    pub(super) checksum: u128,
    /// The files in the folder that parts share, if the pieces are tiles: 25 bytes each.
    pub(super) tiles: Vec<WrittenFile>,
    /// Summary of the part's bytes that other places of the output need, as a word.
    pub(super) summary: Option<String>,
    pub(super) hashed: HashedPart,
    /// Number of folded samples, and the position of the first of them, in the model's coordinates.
    pub(super) folded: (u64, Option<[f64; 3]>),
}

/// Bytes of a part that were sent to an object.
#[derive(Serialize, Deserialize)]
pub(super) struct Sent {
    /// Id of the upload.
    pub(super) id: String,
    /// Number of bytes before those that were sent, and behind them: they are of parts of the object that
    /// others have the rest of.
    pub(super) before: u64,
    pub(super) behind: u64,
    pub(super) checksum: u128,
    /// Tags by which the store knows the object's parts that were sent.
    pub(super) tags: Vec<String>,
}

impl PartRecord {
    /// Bytes in the part's own file.
    pub(super) fn own(&self) -> u64 {
        match (&self.sent, self.place) {
            (Some(sent), _) => sent.before.saturating_add(sent.behind),
            (None, Some(_)) => 0,
            (None, None) => self.bytes,
        }
    }
}

/// Identity of a part's content, and the findings while its bytes are written.
pub(super) struct PartContent {
    pub(super) key: String,
    pub(super) pieces: Range<u64>,
    pub(super) hashed: HashedPart,
    pub(super) folded: (u64, Option<[f64; 3]>),
}

/// Destination of the bytes of a part.
pub(super) enum PartTarget<'a> {
    /// To its own file.
    Own,
    /// To a place in a file that parts share.
    Shared(SharedFile),
    /// To a folder that parts share, a file for each tile.
    Tiles(SharedFiles<'a>),
    /// To an object that parts share, by an upload of this id.
    Object(ObjectRange, String),
}

/// A part in the making. Dropped before it is [committed](Self::commit), it leaves nothing but the bytes that
/// it wrote to the shared file.
pub(super) struct PartFile<'a> {
    // Dropped first, while nobody else can begin the part.
    to: PartTarget<'a>,
    own: OutputFile,
    /// Offset of the part's bytes in the file that is read.
    place: u64,
    bytes: u64,
    hash: Xxh3Default,
    summary: Summary,
}

impl<'a> PartFile<'a> {
    /// Begins a part, whose bytes go elsewhere.
    pub(super) fn new(own: OutputFile, to: PartTarget<'a>) -> Self {
        let (hash, summary) = (Xxh3Default::new(), Summary::default());
        Self { to, own, place: 0, bytes: 0, hash, summary }
    }

    /// Records in the part's own file, which is called `path`, that the part is done.
    pub(super) fn commit(mut self, content: PartContent, path: &Path) -> Result<()> {
        let (bytes, checksum, summary) = (self.bytes, self.hash.digest128(), self.summary.encode());
        // First, so that no record speaks of bytes that are not on the disk, or in the store.
        let (place, sent, kept) = match self.to {
            PartTarget::Own => (None, None, None),
            PartTarget::Shared(mut file) => {
                file.sync(false)?;
                (Some(self.place), None, None)
            }
            PartTarget::Tiles(files) => (None, None, Some(files)),
            PartTarget::Object(range, id) => {
                let SentRange { before, tags, behind } = range.finish()?;
                let mut hash = Xxh3Default::new();
                for edge in [&before, &behind] {
                    hash.update(edge);
                    self.own.write_all(edge).map_err(|e| Error::io("write", path, &e))?;
                }
                let (before, behind) = (before.len() as u64, behind.len() as u64);
                let checksum = hash.digest128();
                (Some(self.place), Some(Sent { id, before, behind, checksum, tags }), None)
            }
        };
        let tiles = kept.as_ref().map(SharedFiles::written).unwrap_or_default();
        let PartContent { key, pieces, hashed, folded } = content;
        let record = PartRecord { key, pieces, place, sent, bytes, checksum, tiles, summary, hashed, folded };
        let sealed = seal(LETTERS, VERSION, &record).map_err(|e| Error::unwritable(path.display(), e))?;
        let length = (sealed.len() as u64).to_le_bytes();
        let written = self.own.write_all(&sealed).and_then(|()| self.own.write_all(&length));
        written.map_err(|e| Error::io("write", path, &e))?;
        self.own.commit()?;
        if let Some(files) = kept {
            files.keep();
        }
        Ok(())
    }
}

impl Output for PartFile<'_> {
    fn begin_at(&mut self, at: u64) -> io::Result<()> {
        self.place = at;
        match &mut self.to {
            PartTarget::Shared(file) => file.begin_at(at),
            PartTarget::Object(range, _) => {
                range.begin_at(at);
                Ok(())
            }
            PartTarget::Own | PartTarget::Tiles(_) => Ok(()),
        }
    }

    fn begin_file(&mut self, number: usize) -> io::Result<()> {
        match &mut self.to {
            PartTarget::Tiles(files) => files.begin_file(number),
            _ => Err(io::Error::other("the part is of a model in one file")),
        }
    }

    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()> {
        match &mut self.to {
            PartTarget::Own => self.own.write_all(bytes)?,
            PartTarget::Shared(file) => file.write_pieces(pieces, bytes, source_bytes, summary)?,
            PartTarget::Object(range, _) => range.write(bytes).map_err(io::Error::other)?,
            PartTarget::Tiles(files) => return files.write_pieces(pieces, bytes, source_bytes, summary),
        }
        self.hash.update(bytes);
        self.bytes += bytes.len() as u64;
        self.summary.absorb(summary);
        Ok(())
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        match &mut self.to {
            PartTarget::Tiles(files) => files.patch(at, bytes),
            _ => Err(io::Error::new(io::ErrorKind::Unsupported, "nothing is replaced in a part")),
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        match &mut self.to {
            PartTarget::Tiles(files) => files.finish(),
            _ => Ok(()),
        }
    }
}

/// Error of a part that belongs to other parts, or to another output.
pub(super) fn refused(path: &Path, what: &str) -> Error {
    Error::mismatch(format!("{} {what}", path.display()), "remove it, and write that part again")
}

/// Error of a damaged part.
pub(super) fn damaged(path: &Path, what: &str) -> Error {
    Error::format(format!("{} is damaged: {what}", path.display()), "remove it, and write that part again")
}

/// A part's file, at its beginning, and its record.
pub(super) fn open(path: &Path) -> Result<(File, PartRecord)> {
    let failed = |e: io::Error| Error::io("read", path, &e);
    let damaged = |what: &str| damaged(path, what);
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
    let record: PartRecord = unsealed(&sealed, (LETTERS, VERSION), damaged)?;
    if record.own() != start || record.pieces.start > record.pieces.end {
        return Err(damaged("its record makes no sense"));
    }
    file.seek(SeekFrom::Start(0)).map_err(failed)?;
    Ok((file, record))
}

/// Copies `left` bytes, and checks that they have their checksum.
pub(super) fn copy(
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
        return Err(damaged(path, "its checksum is wrong"));
    }
    Ok(())
}
