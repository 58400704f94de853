//! Files read and written at given positions, from several threads.

use std::fs::{File, Metadata};
use std::io::{ErrorKind, Result};

/// File that is read and written at a place, by the operating system where it has such calls.
#[cfg(unix)]
#[derive(Debug)]
pub(crate) struct Positioned(File);

#[cfg(unix)]
impl Positioned {
    pub(crate) fn new(file: File) -> Self {
        Self(file)
    }

    /// Reads some bytes, which may be fewer than the buffer takes.
    pub(crate) fn read_at(&self, buffer: &mut [u8], offset: u64) -> Result<usize> {
        std::os::unix::fs::FileExt::read_at(&self.0, buffer, offset)
    }

    pub(crate) fn write_all_at(&self, buffer: &[u8], offset: u64) -> Result<()> {
        std::os::unix::fs::FileExt::write_all_at(&self.0, buffer, offset)
    }

    pub(crate) fn metadata(&self) -> Result<Metadata> {
        self.0.metadata()
    }
}

/// Elsewhere seek and read are two calls, which a lock keeps together.
#[cfg(not(unix))]
#[derive(Debug)]
pub(crate) struct Positioned(std::sync::Mutex<File>);

#[cfg(not(unix))]
impl Positioned {
    pub(crate) fn new(file: File) -> Self {
        Self(std::sync::Mutex::new(file))
    }

    fn lock_at(&self, offset: u64) -> Result<std::sync::MutexGuard<'_, File>> {
        use std::io::{Seek, SeekFrom};
        let mut file = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(SeekFrom::Start(offset))?;
        Ok(file)
    }

    /// Reads some bytes, which may be fewer than the buffer takes.
    pub(crate) fn read_at(&self, buffer: &mut [u8], offset: u64) -> Result<usize> {
        std::io::Read::read(&mut *self.lock_at(offset)?, buffer)
    }

    pub(crate) fn write_all_at(&self, buffer: &[u8], offset: u64) -> Result<()> {
        std::io::Write::write_all(&mut *self.lock_at(offset)?, buffer)
    }

    pub(crate) fn metadata(&self) -> Result<Metadata> {
        self.lock_at(0)?.metadata()
    }
}

impl Positioned {
    /// Fills the whole buffer.
    pub(crate) fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> Result<()> {
        let mut done = 0;
        while done < buffer.len() {
            match self.read_at(&mut buffer[done..], offset + done as u64) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(n) => done += n,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}
