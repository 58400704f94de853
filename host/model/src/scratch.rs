//! Temporary files without a name: nothing is left of them, however the process ends.

use std::fs::File;
use std::path::{Path, PathBuf};

use memmap2::{Mmap, MmapMut};

use crate::mapped::{Map, MapMut, Mapped};
use crate::output::check_space;
use crate::positioned::Positioned;
use crate::{Error, Result};

/// A temporary file that several threads write and read at once, each where it likes.
#[derive(Debug)]
pub struct Scratch {
    file: Positioned,
    /// Second handle of the file, by which it is mapped.
    handle: File,
    folder: PathBuf,
    /// Advice for a failure beside making room, for the user.
    advice: &'static str,
}

impl Scratch {
    /// A new file in `folder`. If creating it fails, or a later operation on it, the error's hint ends with
    /// `advice`.
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn new(folder: &Path, advice: &'static str) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(|e| refused("write", folder, advice, &e))?;
        Self::from_file(file, folder, advice)
    }

    /// Error where the disk of `folder` has no room for so many bytes of temporary files: better known before
    /// long work than in the midst of it. The error's hint ends with `advice`.
    ///
    /// # Errors
    /// The disk has no room.
    pub fn check_space(folder: &Path, bytes: u64, advice: &str) -> Result<()> {
        check_space(folder, folder, bytes).map_err(|e| advised(e, advice))
    }

    /// An open file in `folder`, which may have a name: it must not be [mapped](Self::map) then.
    pub(crate) fn from_file(file: File, folder: &Path, advice: &'static str) -> Result<Self> {
        let handle = file.try_clone().map_err(|e| refused("write", folder, advice, &e))?;
        Ok(Self { file: Positioned::new(file), handle, folder: folder.to_owned(), advice })
    }

    /// Creates another temporary file in the same folder.
    ///
    /// # Errors
    /// The file cannot be made.
    pub(crate) fn beside(&self) -> Result<Self> {
        Self::new(&self.folder, self.advice)
    }

    /// Writes all of `bytes` at a place.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub fn write_at(&self, bytes: &[u8], offset: u64) -> Result<()> {
        self.file.write_all_at(bytes, offset).map_err(|e| refused("write", &self.folder, self.advice, &e))
    }

    /// Fills `bytes` from a place of the file.
    ///
    /// # Errors
    /// The file is shorter, or the operating system refuses.
    pub fn read_at(&self, bytes: &mut [u8], offset: u64) -> Result<()> {
        self.file.read_exact_at(bytes, offset).map_err(|e| refused("read", &self.folder, self.advice, &e))
    }

    /// Sets the length of the file to `bytes`, with zeros where nothing is written.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn set_len(&self, bytes: u64) -> Result<()> {
        self.handle.set_len(bytes).map_err(|e| refused("write", &self.folder, self.advice, &e))
    }

    /// The file with so many zeros in place of what was in it, as memory that can be written: the disk has
    /// room for all of it. `bytes` is not 0.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub(crate) fn zeros(self, bytes: u64) -> Result<MapMut> {
        Self::check_space(&self.folder, bytes, self.advice)?;
        self.set_len(0)?;
        self.reserve(bytes)?;
        self.map_mut()
    }

    /// Makes it `bytes` long by zeros that have a place on the disk.
    fn reserve(&self, bytes: u64) -> Result<()> {
        #[cfg(target_os = "linux")]
        {
            use rustix::fs::{FallocateFlags, fallocate};
            use rustix::io::Errno;
            match fallocate(&self.handle, FallocateFlags::empty(), 0, bytes) {
                Ok(()) => return Ok(()),
                // Zeros would fill the little that others need.
                Err(e @ (Errno::NOSPC | Errno::DQUOT)) => {
                    return Err(refused("write", &self.folder, self.advice, &e.into()));
                }
                Err(_) => {}
            }
        }
        // File systems that cannot do that are written to.
        let zeros = vec![0; 1 << 20];
        let mut at = 0;
        while at < bytes {
            let length = (bytes - at).min(zeros.len() as u64);
            self.write_at(&zeros[..length as usize], at)?;
            at += length;
        }
        Ok(())
    }

    /// The file, to be read by others.
    pub(crate) fn into_file(self) -> Positioned {
        self.file
    }

    /// The whole file as memory, which is not anonymous. It must not be empty, and nothing can be written any
    /// more.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn map(self) -> Result<Map> {
        #[expect(unsafe_code, reason = "the map of a file")]
        // SAFETY: the file has no name and both its handles are in `self`, which ends here: no one else can
        // shorten or change it as long as it is mapped.
        let map = unsafe { Mmap::map(&self.handle) };
        map.map(Mapped::new).map_err(|e| refused("read", &self.folder, self.advice, &e))
    }

    /// The file as memory that can be written. All bytes of the file must have been written before, so that
    /// the disk has room for them.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn map_mut(self) -> Result<MapMut> {
        #[expect(unsafe_code, reason = "the map of a file")]
        // SAFETY: as of `map`: no one else has the file.
        let map = unsafe { MmapMut::map_mut(&self.handle) };
        map.map(Mapped::new).map_err(|e| refused("read", &self.folder, self.advice, &e))
    }
}

fn refused(action: &str, folder: &Path, advice: &str, e: &std::io::Error) -> Error {
    // The folder's full path names it also where the user called it `.`.
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    advised(Error::io(&format!("{action} a temporary file in"), &folder, e), advice)
}

fn advised(error: Error, advice: &str) -> Error {
    let hint = format!("{}; or {advice}", error.hint());
    error.hinting(hint)
}
