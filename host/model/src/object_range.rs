//! A range of an object that several processes write at the same time, each a range of its own. The object is
//! divided into parts of one length. Parts that lie wholly in a range are sent by its process; bytes of other
//! parts, at the two edges of the range, are left to the process that puts all together.

use std::path::Path;

use crate::Result;
use crate::object::{self, BegunUpload};

/// A range in the making.
///
/// Memory: two parts, and those on their way: see [`ObjectOutput`](crate::object_output::ObjectOutput).
pub struct ObjectRange {
    begun: BegunUpload,
    part_bytes: u64,
    /// Byte of the object at which the next written byte goes.
    at: u64,
    /// Bytes of the range that belong to a part that begins before the range.
    before: Vec<u8>,
    /// The part that is being filled.
    open: Vec<u8>,
}

/// Result of sending a range.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SentRange {
    /// First bytes of the range, of a part that begins before the range.
    pub before: Vec<u8>,
    /// The tags of the parts that were sent, in a row.
    pub tags: Vec<String>,
    /// Last bytes of the range, of a part that ends behind the range.
    pub behind: Vec<u8>,
}

impl ObjectRange {
    /// Goes on with an upload, whose parts have so many bytes, from its beginning on.
    ///
    /// # Errors
    /// The store takes no parts.
    pub fn open(path: &Path, id: &str, part_bytes: u64) -> Result<Self> {
        let begun = object::go_on(path, id)?;
        Ok(Self { begun, part_bytes, at: 0, before: Vec::new(), open: Vec::new() })
    }

    /// Sets the byte of the object at which the range begins, before anything is written.
    pub fn begin_at(&mut self, at: u64) {
        self.at = at;
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// A part did not arrive.
    pub fn write(&mut self, mut bytes: &[u8]) -> Result<()> {
        while !bytes.is_empty() {
            let room = self.part_bytes - self.at % self.part_bytes;
            let (now, later) = bytes.split_at(bytes.len().min(room as usize));
            // Whether this part begins before the range: none of its bytes came yet, and the next one is not
            // its first.
            let begins_before = self.open.is_empty() && !self.at.is_multiple_of(self.part_bytes);
            if begins_before {
                self.before.extend_from_slice(now)
            } else {
                self.open.extend_from_slice(now)
            }
            self.at += now.len() as u64;
            bytes = later;
            if self.open.len() as u64 == self.part_bytes {
                let number = (self.at / self.part_bytes) as usize - 1;
                self.begun.upload().send(number, std::mem::take(&mut self.open))?;
            }
        }
        Ok(())
    }

    /// Waits until all that was sent has arrived.
    ///
    /// # Errors
    /// A part did not arrive.
    pub fn finish(mut self) -> Result<SentRange> {
        let tags = self.begun.upload().sent()?.into_values().collect();
        Ok(SentRange { before: self.before, tags, behind: self.open })
    }
}
