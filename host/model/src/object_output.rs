//! An object as the output of a model: parts of one length, which are sent as they fill, while a few are held
//! of which bytes may still be replaced.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use crate::object::{self, BegunUpload};
use crate::{Error, Output, Result, Summary};

/// Bytes of a part at least: stores take 5 MiB and more.
const LEAST: u64 = 8 << 20;

/// Most parts: stores take 10 000, and the size of a file is known only about.
const MOST: u64 = 9000;

/// Bytes of each part, but for the last one, of an object of so many bytes.
pub fn part_bytes(bytes: u64) -> u64 {
    bytes.div_ceil(MOST).next_multiple_of(1 << 20).max(LEAST)
}

/// An object in the making. Dropped before [`commit`](Self::commit), it leaves no trace.
///
/// Memory: three parts, and those on their way: see [`Upload::send`](object::Upload::send). A part has 8 MiB,
/// or a 9000th of an object of more than 70 GB.
pub struct ObjectOutput {
    path: PathBuf,
    begun: BegunUpload,
    part_bytes: u64,
    /// Byte of the object at which the next written byte goes.
    at: u64,
    /// Parts that are not sent yet, by their numbers: the first one, where files say what comes later; the
    /// one that is being filled; and the one before it, as some formats say so at their end.
    held: BTreeMap<usize, Vec<u8>>,
    /// The tags of parts that others have sent.
    tags: BTreeMap<usize, String>,
}

impl ObjectOutput {
    /// Begins an object of about so many bytes.
    ///
    /// # Errors
    /// The store cannot be reached, refuses, or takes no parts.
    pub fn begin(path: &Path, bytes: u64) -> Result<Self> {
        Ok(Self::with_parts(path, object::begin(path)?, part_bytes(bytes)))
    }

    /// Goes on with an upload that was begun for other processes as well, which send ranges of it. When this
    /// output is dropped, the upload stays as it is.
    ///
    /// # Errors
    /// The store takes no parts.
    pub fn go_on(path: &Path, id: &str, bytes: u64) -> Result<Self> {
        Ok(Self::with_parts(path, object::go_on(path, id)?, part_bytes(bytes)))
    }

    /// Output that goes on with an upload that was begun, in parts of so many bytes.
    pub fn with_parts(path: &Path, begun: BegunUpload, part_bytes: u64) -> Self {
        let (held, tags) = (BTreeMap::new(), BTreeMap::new());
        Self { path: path.to_owned(), begun, part_bytes, at: 0, held, tags }
    }

    /// Byte of the object at which the next written byte goes.
    pub fn position(&self) -> u64 {
        self.at
    }

    /// Passes over a part that others have sent, which begins here.
    ///
    /// # Errors
    /// No part begins here: a mistake in this program.
    pub fn pass(&mut self, tag: String) -> Result<()> {
        if !self.at.is_multiple_of(self.part_bytes) {
            let what =
                format!("{}: a part begins at byte {}, within another one", self.path.display(), self.at);
            return Err(Error::internal(what));
        }
        self.tags.insert(self.number(), tag);
        self.at += self.part_bytes;
        self.send_settled()
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// A part did not arrive.
    pub fn write(&mut self, mut bytes: &[u8]) -> Result<()> {
        while !bytes.is_empty() {
            let number = self.number();
            let room = self.part_bytes - self.at % self.part_bytes;
            let (now, later) = bytes.split_at(bytes.len().min(room as usize));
            self.held.entry(number).or_default().extend_from_slice(now);
            self.at += now.len() as u64;
            bytes = later;
            self.send_settled()?;
        }
        Ok(())
    }

    /// The part that the next byte is of.
    fn number(&self) -> usize {
        (self.at / self.part_bytes) as usize
    }

    /// Sends the parts of which nothing will be replaced.
    fn send_settled(&mut self) -> Result<()> {
        let current = self.number();
        while let Some(settled) = self.held.keys().copied().find(|part| *part > 0 && part + 1 < current) {
            self.send(settled)?;
        }
        Ok(())
    }

    fn send(&mut self, number: usize) -> Result<()> {
        match self.held.remove(&number) {
            Some(bytes) => self.begun.upload().send(number, bytes),
            None => Ok(()),
        }
    }

    /// Replaces bytes of parts that are held.
    fn replace(&mut self, mut at: u64, mut bytes: &[u8]) -> Result<()> {
        while !bytes.is_empty() {
            let (number, within) = ((at / self.part_bytes) as usize, (at % self.part_bytes) as usize);
            let of_part = bytes.len().min(self.part_bytes as usize - within);
            let there = self.held.get_mut(&number).and_then(|part| part.get_mut(within..within + of_part));
            let Some(there) = there else {
                return Err(Error::argument(
                    format!(
                        "{}: byte {at} is known only in the end, when it is sent already",
                        self.path.display()
                    ),
                    "write the model to a file, and copy that to the store",
                ));
            };
            let (now, later) = bytes.split_at(of_part);
            there.copy_from_slice(now);
            (at, bytes) = (at + of_part as u64, later);
        }
        Ok(())
    }

    /// Ends the object, and waits until all parts have arrived.
    ///
    /// # Errors
    /// A part did not arrive.
    pub fn complete(&mut self) -> Result<()> {
        let held: Vec<usize> = self.held.keys().copied().collect();
        held.into_iter().try_for_each(|number| self.send(number))?;
        let sent = self.begun.upload().sent()?;
        self.tags.extend(sent);
        Ok(())
    }

    /// Puts the [completed](Self::complete) object in its place; returns its length.
    ///
    /// # Errors
    /// The store refuses; what was there of that name stays.
    pub fn commit(&mut self) -> Result<u64> {
        let tags = std::mem::take(&mut self.tags);
        if !tags.keys().copied().eq(0..tags.len()) {
            return Err(Error::internal(format!("{}: a part is missing", self.path.display())));
        }
        self.begun.complete(tags.into_values().collect(), self.at)?;
        Ok(self.at)
    }
}

/// Error packed so that it passes through [`io::Error`].
fn packed(error: Error) -> io::Error {
    io::Error::other(error)
}

impl Output for ObjectOutput {
    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.write(bytes).map_err(packed)
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.replace(at, bytes).map_err(packed)
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}
