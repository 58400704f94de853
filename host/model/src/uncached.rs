//! Writing long files past the operating system's page cache, where the system allows it: bytes that are
//! written once and not read soon need not be copied into memory that other things could use. Bytes are
//! collected, and whole blocks of them go to the disk as they are.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use crate::memory::{LARGE_PAGE, zeros};

/// Places in memory and in the file are multiples of this: as much as any device in use asks for.
pub(crate) const BLOCK: usize = 4096;

/// Bytes that are written at once: a large page. Of small ones, the system looks up one by one where they
/// are, and asks the disk in several steps for what it can do in one.
const BUFFER: usize = LARGE_PAGE;

/// A file that is written from some place on, in order. Where the operating system lets us write past the
/// page cache, a full buffer is written by a thread of its own while the next one fills.
///
/// Memory: 4 MiB.
#[derive(Debug)]
pub(crate) struct UncachedFile {
    disk: Disk,
    /// Bytes of the file from `offset` on.
    buffer: AlignedBuffer,
    /// Byte of the file at which the buffer belongs: a multiple of [`BLOCK`].
    offset: u64,
    /// Offset at which writing began.
    begin: u64,
    behind: Option<WriteBehind>,
}

impl UncachedFile {
    /// Writer from the beginning of an open file on.
    pub(crate) fn new(file: File) -> Self {
        let disk = Disk { file, is_direct: true };
        Self { disk, buffer: AlignedBuffer::default(), offset: 0, begin: 0, behind: None }
    }

    /// The file, in which bytes written after the last [`flush`](Self::flush) may be missing.
    pub(crate) fn file(&self) -> &File {
        &self.disk.file
    }

    /// Cuts the file off at `end`, and goes on there. Bytes that were not [flushed](Self::flush) are lost.
    ///
    /// # Errors
    /// The operating system refuses.
    pub(crate) fn go_on_at(&mut self, end: u64) -> io::Result<()> {
        self.wait()?;
        self.disk.file.set_len(end)?;
        let of_block = (end % BLOCK as u64) as usize;
        self.offset = end - of_block as u64;
        self.disk.file.seek(SeekFrom::Start(self.offset))?;
        self.buffer.filled = 0;
        self.disk.file.read_exact(self.buffer.take_room(of_block))
    }

    /// Goes on at a multiple of [`BLOCK`], whatever is there and was written before. Bytes that were not
    /// [flushed](Self::flush) are lost.
    ///
    /// # Errors
    /// What was written before could not be.
    pub(crate) fn begin_at(&mut self, offset: u64) -> io::Result<()> {
        self.wait()?;
        (self.buffer.filled, self.offset, self.begin) = (0, offset, offset);
        Ok(())
    }

    /// Whether nothing was written since the call of [`begin_at`](Self::begin_at).
    pub(crate) fn is_at_begin(&self) -> bool {
        self.buffer.filled == 0 && self.offset == self.begin
    }

    /// # Errors
    /// The disk is full, or the operating system refuses; it may be told late, and at the next
    /// [`flush`](Self::flush) at the latest.
    pub(crate) fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            let (now, later) = bytes.split_at(bytes.len().min(BUFFER - self.buffer.filled));
            self.buffer.take_room(now.len()).copy_from_slice(now);
            bytes = later;
            if self.buffer.filled == BUFFER {
                self.hand_over()?;
            }
        }
        Ok(())
    }

    /// Hands everything to the operating system.
    ///
    /// # Errors
    /// As of [`write`](Self::write).
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.wait()?;
        let whole = self.buffer.filled - self.buffer.filled % BLOCK;
        if whole > 0 {
            self.disk.write(&self.buffer.bytes()[..whole], self.offset)?;
            self.buffer.forget(whole);
            self.offset += whole as u64;
        }
        if self.buffer.filled > 0 {
            // The rest of a block stays in the buffer as well, and goes to the disk once more with the whole
            // block.
            self.disk.put(self.buffer.bytes(), self.offset)?;
        }
        Ok(())
    }

    /// Hands a full buffer over to be written, and begins an empty one.
    fn hand_over(&mut self) -> io::Result<()> {
        if self.behind.is_none() {
            self.disk.write(self.buffer.bytes(), self.offset)?;
            self.buffer.filled = 0;
            if self.disk.is_direct {
                // A writer that only copies into the page cache would be one more thread that works.
                self.behind = WriteBehind::start(&self.disk).ok();
            }
        } else if let Some(behind) = &mut self.behind {
            self.buffer = behind.swap(std::mem::take(&mut self.buffer), self.offset)?;
        }
        self.offset += BUFFER as u64;
        Ok(())
    }

    /// Waits until the thread has written all that it was given.
    ///
    /// # Errors
    /// As of [`write`](Self::write).
    pub(crate) fn wait(&mut self) -> io::Result<()> {
        self.behind.as_mut().map_or(Ok(()), WriteBehind::wait)
    }
}

/// Bytes that go to the disk together, in one large page where the system gives such.
#[derive(Debug, Default)]
struct AlignedBuffer {
    /// Empty until it is needed.
    memory: Vec<u8>,
    origin: usize,
    /// Number of bytes from `origin` on that have a meaning.
    filled: usize,
}

impl AlignedBuffer {
    fn bytes(&self) -> &[u8] {
        &self.memory[self.origin..self.origin + self.filled]
    }

    /// Room for the next `count` bytes, which have to fit into the buffer.
    fn take_room(&mut self, count: usize) -> &mut [u8] {
        if self.memory.is_empty() {
            // Half of the memory, or nearly, is never touched.
            self.memory = zeros(BUFFER + LARGE_PAGE);
            self.origin = self.memory.as_ptr().align_offset(LARGE_PAGE).min(LARGE_PAGE);
        }
        let at = self.origin + self.filled;
        self.filled += count;
        &mut self.memory[at..at + count]
    }

    /// Moves the bytes behind the first `count` to the front.
    fn forget(&mut self, count: usize) {
        self.memory.copy_within(self.origin + count..self.origin + self.filled, self.origin);
        self.filled -= count;
    }
}

/// A file, written at any place.
#[derive(Debug)]
struct Disk {
    file: File,
    /// Whether writing past the page cache may be possible: nothing has shown yet that the file system
    /// cannot.
    is_direct: bool,
}

impl Disk {
    /// Writes whole blocks, past the page cache if that is possible.
    fn write(&mut self, blocks: &[u8], offset: u64) -> io::Result<()> {
        self.is_direct = self.is_direct && self.put_directly(blocks, offset)?;
        if self.is_direct { Ok(()) } else { self.put(blocks, offset) }
    }

    /// Writes past the page cache, or returns `false` if that is not possible.
    fn put_directly(&mut self, blocks: &[u8], offset: u64) -> io::Result<bool> {
        if self.set_direct(true).is_err() {
            return Ok(false);
        }
        let put = self.put(blocks, offset);
        self.set_direct(false)?;
        match put {
            // Other rules than ours, or half a block up to some limit.
            Err(e) if e.kind() == io::ErrorKind::InvalidInput => Ok(false),
            put => put.map(|()| true),
        }
    }

    fn put(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(offset))?;
        self.file.write_all(bytes)
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

/// Thread that writes one full buffer after the other, so that the owner does not wait for the disk. The
/// thread and its owner never use the file, whose position and flags they share, at the same time.
#[derive(Debug)]
struct WriteBehind {
    /// Sender of a buffer and its place in the file; none once one could not be written.
    full: Option<SyncSender<(AlignedBuffer, u64)>>,
    /// The buffer that was written, empty again.
    empty: Receiver<io::Result<AlignedBuffer>>,
    /// The buffer that the thread does not have.
    spare: AlignedBuffer,
    is_writing: bool,
    thread: Option<JoinHandle<()>>,
}

impl WriteBehind {
    fn start(disk: &Disk) -> io::Result<Self> {
        let mut disk = Disk { file: disk.file.try_clone()?, is_direct: disk.is_direct };
        let (full, to_write) = sync_channel::<(AlignedBuffer, u64)>(1);
        let (written, empty) = sync_channel(1);
        let work = move || {
            for (mut buffer, offset) in to_write {
                let wrote = disk.write(buffer.bytes(), offset);
                buffer.filled = 0;
                if written.send(wrote.map(|()| buffer)).is_err() {
                    return;
                }
            }
        };
        let thread = Some(thread::Builder::new().name("write".to_owned()).spawn(work)?);
        Ok(Self { full: Some(full), empty, spare: AlignedBuffer::default(), is_writing: false, thread })
    }

    /// Waits for the last buffer, hands over this one, and returns an empty one.
    fn swap(&mut self, buffer: AlignedBuffer, offset: u64) -> io::Result<AlignedBuffer> {
        self.wait()?;
        self.full.as_ref().and_then(|full| full.send((buffer, offset)).ok()).ok_or_else(ended)?;
        self.is_writing = true;
        Ok(std::mem::take(&mut self.spare))
    }

    fn wait(&mut self) -> io::Result<()> {
        if std::mem::take(&mut self.is_writing) {
            let written = self.empty.recv().unwrap_or_else(|_| Err(ended()));
            // Nothing more is taken behind a gap.
            self.spare = written.inspect_err(|_| self.full = None)?;
        }
        self.full.as_ref().map(|_| ()).ok_or_else(ended)
    }
}

impl Drop for WriteBehind {
    fn drop(&mut self) {
        self.full = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn ended() -> io::Error {
    io::Error::other("an earlier part could not be written")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_was_not_written_behind_is_told_and_nothing_follows_it() {
        let cannot_be_written = File::open(tempfile::NamedTempFile::new().unwrap().path()).unwrap();
        let mut written = UncachedFile::new(cannot_be_written);
        written.behind = Some(WriteBehind::start(&written.disk).unwrap());
        let buffer = vec![7; BUFFER];
        written.write(&buffer).unwrap();
        let told = written.write(&buffer).unwrap_err();
        assert_ne!(told.to_string(), ended().to_string());
        for later in [written.write(&buffer), written.flush(), written.begin_at(0), written.go_on_at(0)] {
            assert_eq!(later.unwrap_err().to_string(), ended().to_string());
        }
    }

    #[test]
    fn what_is_written_at_once_begins_where_a_large_page_may() {
        let mut buffer = AlignedBuffer::default();
        buffer.take_room(BUFFER).fill(7);
        assert_eq!(buffer.bytes().as_ptr().addr() % LARGE_PAGE, 0);
        assert!(buffer.bytes().len() == LARGE_PAGE && buffer.bytes().iter().all(|byte| *byte == 7));
    }

    #[derive(Debug, Clone)]
    enum Action {
        Write(usize),
        Flush,
        /// Cuts the file off at this part of its length.
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
            written.disk.is_direct = !cached;
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
