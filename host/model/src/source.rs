//! A model's file, read at given positions.
//!
//! Files are read, never mapped into memory: a mapped file that another program shortens kills the process
//! (SIGBUS), whereas a read returns an error; and mapped pages count as memory of the process.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use crate::object::{self, Object};
use crate::pool::{Pool, Pooled};
use crate::positioned::Positioned;
use crate::scratch::Scratch;
use crate::{Error, Result, input};

/// An open file of known length that several threads read at once, each where it likes.
#[derive(Debug, Clone)]
pub(crate) struct SourceFile {
    file: Handle,
    path: PathBuf,
    len: u64,
    /// Bytes of the file itself, of which a part may be read.
    file_len: u64,
}

/// Way in which a file is held.
#[derive(Debug, Clone)]
enum Handle {
    /// Open.
    Open(Arc<Positioned>),
    /// A file that is opened when it is read, as there are many.
    Pooled(Arc<Pooled>),
    /// An object in a store.
    Object(Arc<dyn Object>),
}

/// Stamp of a file or an object, by which a change is noticed: its size, and the time when it was written or
/// its version.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Stamp {
    File(u64, SystemTime),
    Object(u64, String),
}

impl SourceFile {
    /// Opens a regular file, or an object, that is not empty; a file of a pool is closed when others are
    /// read.
    pub(crate) fn open(path: &Path, pool: Option<&Arc<Pool>>) -> Result<Self> {
        let refused = |e| Error::io("open", path, &e);
        let (file, len) = if object::is_object(path) {
            let object = object::open(path)?;
            let len = object.bytes();
            (Handle::Object(object), len)
        } else if let Some(pool) = pool {
            let file = Pooled::open(pool, path)?;
            let len = file.metadata().map_err(refused)?.len();
            (Handle::Pooled(Arc::new(file)), len)
        } else {
            let file = input::open(path)?;
            let len = file.metadata().map_err(refused)?.len();
            (Handle::Open(Arc::new(Positioned::new(file))), len)
        };
        if len == 0 {
            return Err(Error::format(
                format!("{} is empty", path.display()),
                "copy or export the model again",
            ));
        }
        Ok(Self { file, path: path.to_owned(), len, file_len: len })
    }

    /// Opens a file that goes with this one, in the same way.
    pub(crate) fn open_beside(&self, path: &Path) -> Result<Self> {
        let pool = match &self.file {
            Handle::Open(_) | Handle::Object(_) => None,
            Handle::Pooled(file) => Some(file.pool()),
        };
        Self::open(path, pool)
    }

    /// Source of the bytes that were written to a temporary file, under the path of another file.
    pub(crate) fn of_scratch(scratch: Scratch, path: &Path, len: u64) -> Self {
        Self::of_part(scratch.into_file(), path, len)
    }

    /// The first bytes of a file, in the name of another one.
    pub(crate) fn of_part(file: Positioned, path: &Path, len: u64) -> Self {
        let file_len = file.metadata().map_or(len, |is| is.len());
        Self { file: Handle::Open(Arc::new(file)), path: path.to_owned(), len, file_len }
    }

    /// Stamp of the file, by which a change of it is noticed, where the system tells one.
    pub(crate) fn stamp(&self) -> Option<Stamp> {
        let is = match &self.file {
            Handle::Open(file) => file.metadata(),
            Handle::Pooled(file) => file.metadata(),
            Handle::Object(object) => {
                return Some(Stamp::Object(object.bytes(), object.version().to_owned()));
            }
        };
        let is = is.ok()?;
        Some(Stamp::File(is.len(), is.modified().ok()?))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file when it was opened; nothing beyond is ever read.
    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// Fills `buffer` from `offset` on; returns the number of bytes read, which is less than the buffer's
    /// length only at the end of the file.
    pub(crate) fn read_at(&self, buffer: &mut [u8], offset: u64) -> Result<usize> {
        let wanted = self.len.saturating_sub(offset).min(buffer.len() as u64) as usize;
        let again;
        let file = match &self.file {
            Handle::Open(file) => file,
            Handle::Pooled(file) => {
                again = file.file()?;
                &again
            }
            Handle::Object(object) => return object.read_at(&mut buffer[..wanted], offset).map(|()| wanted),
        };
        let mut done = 0;
        while done < wanted {
            match file.read_at(&mut buffer[done..wanted], offset + done as u64) {
                Ok(0) => break,
                Ok(n) => done += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(Error::io("read", &self.path, &e)),
            }
        }
        if done < wanted { Err(self.changed()) } else { Ok(done) }
    }

    /// Appends to `buffer` up to `count` bytes from `offset` on; returns how many, fewer only at the file's
    /// end.
    pub(crate) fn append_at(&self, buffer: &mut Vec<u8>, offset: u64, count: usize) -> Result<usize> {
        let old = buffer.len();
        let count = self.len.saturating_sub(offset).min(count as u64) as usize;
        buffer.resize(old + count, 0);
        self.read_at(&mut buffer[old..], offset)
    }

    /// Error where the file is not as long any more as when it was opened. Reads of an object are all of the
    /// version that was opened.
    pub(crate) fn check_unchanged(&self) -> Result<()> {
        let is = match &self.file {
            Handle::Open(file) => file.metadata(),
            Handle::Pooled(file) => file.metadata(),
            Handle::Object(_) => return Ok(()),
        };
        let len = is.map_err(|e| Error::io("read", &self.path, &e))?.len();
        if len == self.file_len { Ok(()) } else { Err(self.changed()) }
    }

    /// An error about the content: `what` follows the file's name.
    pub(crate) fn malformed(&self, what: impl std::fmt::Display, hint: &str) -> Error {
        Error::format(format!("{}: {what}", self.path.display()), hint)
    }

    /// An error where normals are to be left out of what cannot be without.
    pub(crate) fn keeps_normals(&self, hint: &str) -> Error {
        let what = format!("{}: normals cannot be left out of a file of this format", self.path.display());
        Error::argument(what, hint)
    }

    /// An error of writing a new version.
    pub(crate) fn write_error(&self, error: &io::Error) -> Error {
        Error::io("write the new version of", &self.path, error)
    }

    fn changed(&self) -> Error {
        Error::changed_while_read(&self.path)
    }
}
