//! Writing long files past the operating system's page cache, where it lets us: what is written once and not
//! soon read need not be copied into memory that other things could use. Bytes are collected, and whole
//! blocks of them go to the disk as they are.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};

/// Places in memory and in the file are multiples of this: as much as any device in use asks for.
pub(crate) const BLOCK: usize = 4096;

/// Bytes that are written at once.
const BUFFER: usize = 2 << 20;

/// A file that is written from some place on, in order.
///
/// Memory: 2 MiB.
#[derive(Debug)]
pub(crate) struct UncachedFile {
    file: File,
    /// The bytes are those from `origin` on, which is a multiple of [`BLOCK`] in memory; `filled` of them
    /// have a meaning.
    buffer: Vec<u8>,
    origin: usize,
    filled: usize,
    /// Where in the file they belong: a multiple of [`BLOCK`].
    offset: u64,
    /// Where it began.
    begin: u64,
    /// Whether nothing tells yet that the file system has no way but through the page cache.
    is_direct: bool,
}

impl UncachedFile {
    /// From the beginning of an open file on.
    pub(crate) fn new(file: File) -> Self {
        Self { file, buffer: Vec::new(), origin: 0, filled: 0, offset: 0, begin: 0, is_direct: true }
    }

    /// The file, in which what was written after the last [`flush`](Self::flush) may be missing.
    pub(crate) fn file(&self) -> &File {
        &self.file
    }

    /// Cuts the file off at `end`, and goes on there.
    ///
    /// # Errors
    /// The operating system refuses.
    pub(crate) fn go_on_at(&mut self, end: u64) -> io::Result<()> {
        self.allocate();
        self.file.set_len(end)?;
        self.filled = (end % BLOCK as u64) as usize;
        self.offset = end - self.filled as u64;
        self.file.seek(SeekFrom::Start(self.offset))?;
        self.file.read_exact(&mut self.buffer[self.origin..self.origin + self.filled])
    }

    /// Goes on at a multiple of [`BLOCK`], whatever is there and was written before. What was not
    /// [flushed](Self::flush) is lost.
    pub(crate) fn begin_at(&mut self, offset: u64) {
        self.allocate();
        (self.filled, self.offset, self.begin) = (0, offset, offset);
    }

    /// Whether nothing was written since it was said where to [begin](Self::begin_at).
    pub(crate) fn is_at_begin(&self) -> bool {
        self.filled == 0 && self.offset == self.begin
    }

    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub(crate) fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        self.allocate();
        while !bytes.is_empty() {
            let at = self.origin + self.filled;
            let (now, later) = bytes.split_at(bytes.len().min(BUFFER - self.filled));
            self.buffer[at..at + now.len()].copy_from_slice(now);
            self.filled += now.len();
            bytes = later;
            if self.filled == BUFFER {
                self.write_blocks()?;
            }
        }
        Ok(())
    }

    /// Hands everything to the operating system.
    ///
    /// # Errors
    /// As of [`write`](Self::write).
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.write_blocks()?;
        if self.filled > 0 {
            // It stays here as well, and goes to the disk once more with the rest of its block.
            self.put(self.filled)?;
        }
        Ok(())
    }

    fn allocate(&mut self) {
        if self.buffer.is_empty() {
            self.buffer = vec![0; BUFFER + BLOCK];
            self.origin = self.buffer.as_ptr().align_offset(BLOCK).min(BLOCK);
        }
    }

    /// Writes the whole blocks, and puts the rest to the front.
    fn write_blocks(&mut self) -> io::Result<()> {
        let whole = self.filled - self.filled % BLOCK;
        if whole == 0 {
            return Ok(());
        }
        if !(self.is_direct && self.put_directly(whole)?) {
            self.is_direct = false;
            self.put(whole)?;
        }
        self.buffer.copy_within(self.origin + whole..self.origin + self.filled, self.origin);
        self.filled -= whole;
        self.offset += whole as u64;
        Ok(())
    }

    /// The same past the page cache, or `false` if that is not possible.
    fn put_directly(&mut self, count: usize) -> io::Result<bool> {
        if self.set_direct(true).is_err() {
            return Ok(false);
        }
        let put = self.put(count);
        self.set_direct(false)?;
        match put {
            // Other rules than ours, or half a block up to some limit.
            Err(e) if e.kind() == io::ErrorKind::InvalidInput => Ok(false),
            put => put.map(|()| true),
        }
    }

    /// Writes so many bytes to their place.
    fn put(&mut self, count: usize) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(self.offset))?;
        self.file.write_all(&self.buffer[self.origin..self.origin + count])
    }

    #[cfg(target_os = "linux")]
    fn set_direct(&self, direct: bool) -> io::Result<()> {
        use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
        let mut flags = fcntl_getfl(&self.file)?;
        if flags.contains(OFlags::DIRECT) != direct {
            flags.set(OFlags::DIRECT, direct);
            fcntl_setfl(&self.file, flags)?;
        }
        Ok(())
    }

    #[cfg(not(target_os = "linux"))]
    fn set_direct(&self, direct: bool) -> io::Result<()> {
        if direct { Err(io::ErrorKind::Unsupported.into()) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, Clone)]
    enum Action {
        Write(usize),
        Flush,
        /// Cut off at this part of what is there.
        Back(f64),
    }

    fn action() -> impl Strategy<Value = Action> {
        prop_oneof![
            4 => (0..3 * BUFFER).prop_map(Action::Write),
            4 => (0..3 * BLOCK).prop_map(Action::Write),
            2 => Just(Action::Flush),
            1 => (0.0..1.0).prop_map(Action::Back),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn the_file_is_what_was_written(actions in proptest::collection::vec(action(), 1..12), cached: bool) {
            let mut written = UncachedFile::new(tempfile::tempfile().unwrap());
            written.is_direct = !cached;
            let (mut expected, mut next) = (Vec::new(), 0u8);
            for action in actions {
                match action {
                    Action::Write(count) => {
                        let bytes: Vec<u8> = (0..count).map(|i| next.wrapping_add((i % 251) as u8)).collect();
                        next = next.wrapping_add(91);
                        written.write(&bytes).unwrap();
                        expected.extend(bytes);
                    }
                    Action::Flush => written.flush().unwrap(),
                    Action::Back(part) => {
                        written.flush().unwrap();
                        expected.truncate((part * expected.len() as f64) as usize);
                        written.go_on_at(expected.len() as u64).unwrap();
                    }
                }
            }
            written.flush().unwrap();
            let mut bytes = Vec::new();
            let mut file = written.file();
            file.seek(SeekFrom::Start(0)).unwrap();
            file.read_to_end(&mut bytes).unwrap();
            prop_assert!(bytes == expected, "{} bytes for {}", bytes.len(), expected.len());
        }
    }
}
