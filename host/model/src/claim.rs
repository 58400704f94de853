//! The right to write a target, which one process has at a time, and the hidden files beside it.
//!
//! While a file or folder `name` is written, `.simod-name.part` is there and locked. A file is written into
//! it; for a folder it stays empty, and `.simod-name.new` is the folder in the making (`.simod-name.old` the
//! former one, where the system cannot exchange both at once). `.simod-name.journal`, and `.journal.new` by
//! which it is replaced, are those of large files (`resumable`). Files that a killed process left are removed
//! by the next process that has the lock; a locked file belongs to a process that is at work, on this machine
//! or another.
//!
//! The hidden names are known, so that somebody else may have put something there: links are never followed
//! or written through, and a file that has other names, or another owner, is replaced by a new one.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use xxhash_rust::xxh3::xxh3_128;

use crate::input::Identity;
use crate::object;
use crate::target::{regular_target, target_of};
use crate::{Error, Result};

/// Longest name of a target that the hidden names contain; names of files have at most 255 bytes.
const LONGEST_NAME: usize = 200;

/// The files that belong to an output.
#[derive(Debug, Clone)]
pub(crate) struct OutputFiles {
    /// Path of the output as the caller gave it.
    pub path: PathBuf,
    /// The file or folder that is created or replaced: `path` itself, unless that is a link to a file.
    pub target: PathBuf,
    pub part: PathBuf,
    pub journal: PathBuf,
    pub new_journal: PathBuf,
    pub new_folder: PathBuf,
    pub old_folder: PathBuf,
}

impl OutputFiles {
    /// The places of a file.
    pub fn of_file(path: &Path) -> Result<Self> {
        Ok(Self::beside(path, regular_target(path)?))
    }

    /// The places of a folder.
    fn of_folder(path: &Path) -> Result<Self> {
        // A link to a folder is followed as one to a file is.
        Ok(Self::beside(path, target_of(path)?))
    }

    fn beside(path: &Path, target: PathBuf) -> Self {
        let name = target.file_name().unwrap_or_default();
        let beside = |suffix: &str| {
            let mut hidden = OsString::from(".simod-");
            if name.len() > LONGEST_NAME {
                hidden.push(format!("{:032x}", xxh3_128(name.as_encoded_bytes())));
            } else {
                hidden.push(name);
            }
            hidden.push(suffix);
            target.with_file_name(hidden)
        };
        Self {
            path: path.to_owned(),
            part: beside(".part"),
            journal: beside(".journal"),
            new_journal: beside(".journal.new"),
            new_folder: beside(".new"),
            old_folder: beside(".old"),
            target,
        }
    }

    pub fn remove_journal(&self) {
        // A journal that cannot be removed does no harm: the next call sees that its part is missing.
        let _ = remove(&self.journal);
        let _ = remove(&self.new_journal);
    }
}

/// The right to write a target. Dropped, nothing hidden is left beside it, unless it is to be gone on with.
#[derive(Debug)]
pub struct Claim {
    places: OutputFiles,
    /// The part file, locked.
    file: File,
    keeps: bool,
}

impl Claim {
    /// Claims a file; the files of an earlier attempt are removed, unless this one `resumes` it.
    ///
    /// # Errors
    /// Another process has it, its folder is missing or cannot be written to, or `path` is a folder or a
    /// device.
    pub(crate) fn file(path: &Path, resumes: bool) -> Result<Self> {
        Self::for_places(OutputFiles::of_file(path)?, resumes)
    }

    /// Claims a folder, or the files in it that go with it; files of an earlier attempt are removed.
    ///
    /// # Errors
    /// Another process has it, or the folder that it lies in is missing or cannot be written to.
    pub fn folder(path: &Path) -> Result<Self> {
        Self::for_places(OutputFiles::of_folder(path)?, false)
    }

    /// Removes the hidden files that an earlier attempt has left beside a folder, unless another process is
    /// writing: perhaps no process will ever claim the folder itself.
    pub fn tidy(path: &Path) {
        drop(Self::folder(path));
    }

    /// Claims a folder, whose beginning is gone on with.
    ///
    /// # Errors
    /// As of [`folder`](Self::folder).
    pub(crate) fn folder_again(path: &Path) -> Result<Self> {
        Self::for_places(OutputFiles::of_folder(path)?, true)
    }

    fn for_places(places: OutputFiles, resumes: bool) -> Result<Self> {
        let file = lock(&places, resumes)?;
        let this = Self { places, file, keeps: false };
        let OutputFiles { target, journal, new_journal, new_folder, old_folder, .. } = &this.places;
        let clean = || -> io::Result<()> {
            if target.symlink_metadata().is_err() && old_folder.symlink_metadata().is_ok_and(|is| is.is_dir())
            {
                // Killed between two renames.
                fs::rename(old_folder, target)?;
            }
            remove(old_folder)?;
            remove(new_journal)?;
            if !resumes {
                remove(new_folder)?;
                // In this order: a journal never speaks of bytes that are gone.
                remove(journal)?;
                this.file.set_len(0)?;
            }
            Ok(())
        };
        clean().map_err(|e| this.failed(&e))?;
        if !resumes {
            claimed().push(this.places.clone());
        }
        Ok(this)
    }

    pub(crate) fn places(&self) -> &OutputFiles {
        &self.places
    }

    /// Path of the hidden folder in which the files of a folder are written until it takes its name.
    pub(crate) fn new_folder(&self) -> &Path {
        &self.places.new_folder
    }

    /// The part file.
    pub(crate) fn part(&self) -> &File {
        &self.file
    }

    /// Leaves the files that are there to a later call.
    pub(crate) fn keep(&mut self) {
        self.keeps = true;
    }

    /// Puts the part file in the target's place, with the permissions and the owner of the file that it
    /// replaces.
    ///
    /// # Errors
    /// The operating system refuses; the target is then what it was.
    pub(crate) fn put_in_place(&mut self) -> io::Result<()> {
        let _busy = claimed();
        take_permissions(&self.file, &self.places.target)?;
        fs::rename(&self.places.part, &self.places.target)?;
        self.keeps = true;
        Ok(())
    }

    /// Puts another open file in the target's place, on whichever disk it is.
    ///
    /// # Errors
    /// As of [`put_in_place`](Self::put_in_place).
    pub(crate) fn put_other_in_place(&mut self, mut file: &File, path: &Path) -> io::Result<()> {
        let busy = claimed();
        take_permissions(file, &self.places.target)?;
        match fs::rename(path, &self.places.target) {
            Err(e) if e.kind() == io::ErrorKind::CrossesDevices => {}
            renamed => return renamed,
        }
        drop(busy);
        io::Seek::rewind(&mut file)?;
        io::copy(&mut file, &mut self.file)?;
        self.file.sync_all()?;
        self.put_in_place()?;
        remove(path)
    }

    /// A refusal of the operating system, with the target's name.
    pub(crate) fn failed(&self, error: &io::Error) -> Error {
        Error::io("write", &self.places.path, error)
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        claimed().retain(|places| places.part != self.places.part);
        // While it is locked.
        if !self.keeps {
            let _ = remove(&self.places.new_folder);
            self.places.remove_journal();
            let _ = fs::remove_file(&self.places.part);
        }
    }
}

/// Path of the hidden folder in which a folder is written before it takes its name.
pub(crate) fn new_folder_of(path: &Path) -> PathBuf {
    OutputFiles::of_folder(path).map_or_else(|_| path.to_owned(), |places| places.new_folder)
}

/// Hidden files and folders that this process claims and that no later process can go on with.
static CLAIMED: Mutex<Vec<OutputFiles>> = Mutex::new(Vec::new());

fn claimed() -> MutexGuard<'static, Vec<OutputFiles>> {
    CLAIMED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes what this process is writing, as the process ends at once. Files that a later call can go on with
/// stay.
pub fn abandon_all() {
    object::abandon_all();
    for places in claimed().drain(..) {
        let _ = remove(&places.new_folder);
        places.remove_journal();
        let _ = fs::remove_file(&places.part);
    }
}

/// Opens a part file that is there; `None` if it is gone, or was removed because no process owns it.
fn open_there(part: &Path, in_the_way: &dyn Fn() -> Error) -> Result<Option<File>> {
    match fs::symlink_metadata(part) {
        Err(_) => return Ok(None),
        Ok(is) if is.is_dir() => return Err(in_the_way()),
        Ok(is) if !is.is_file() => {
            // A link, a pipe or a device is no part file of a process.
            remove(part).map_err(|e| in_the_way().because(e))?;
            return Ok(None);
        }
        Ok(_) => {}
    }
    match open_again(part) {
        Ok(file) => Ok(Some(file)),
        Err(e) if e.kind() == io::ErrorKind::PermissionDenied => Err(in_the_way().because(e)),
        Err(_) => Ok(None),
    }
}

/// Opens the part file for this process alone.
fn lock(places: &OutputFiles, resumes: bool) -> Result<File> {
    const ATTEMPTS: usize = 100;
    let OutputFiles { path, target, part, .. } = places;
    let failed = |e: io::Error| Error::io("write", path, &e);
    let in_the_way = || {
        let what = format!("cannot write {}: {} is in the way", path.display(), part.display());
        Error::argument(what, "remove it")
    };
    for _ in 0..ATTEMPTS {
        let (file, is_new) = match create_new(part, target) {
            Ok(file) => (file, true),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => match open_there(part, &in_the_way)? {
                Some(file) => (file, false),
                None => continue,
            },
            Err(e) => return Err(failed(e)),
        };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => break,
            // On a file system without locks, the file itself stands for one; a caller that resumes says that
            // no other process has it.
            Err(TryLockError::Error(_)) if !is_new && !resumes => break,
            _ => {}
        }
        // The process that had the file before may have renamed or removed it meanwhile.
        if !Identity::is_at(&file, part) {
            continue;
        }
        if is_new || is_ours_alone(&file).map_err(failed)? {
            return Ok(file);
        }
        fs::remove_file(part).map_err(|e| in_the_way().because(e))?;
    }
    Err(Error::argument(
        format!("{} is being written by another process", path.display()),
        "wait until it is done, or write to another file",
    ))
}

/// Creates a file that is not there yet, which nobody can read who cannot read its target.
fn create_new(part: &Path, target: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        // Permissions are those of any other new file, from which the system takes the bits of the user's
        // umask.
        options.mode(if target.exists() { 0o600 } else { 0o666 });
    }
    let _ = target;
    options.open(part)
}

/// Opens a file that is there, not through a link.
fn open_again(part: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32);
    }
    options.open(part)
}

/// Whether a file has a single name, and belongs to this user.
fn is_ours_alone(file: &File) -> io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let is = file.metadata()?;
        Ok(is.nlink() <= 1 && is.uid() == rustix::process::geteuid().as_raw())
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        Ok(true)
    }
}

/// Gives an open file or folder the permissions and the owner of the one at a path, if there is any.
pub(crate) fn take_permissions(file: &File, from: &Path) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
        let Ok(former) = fs::metadata(from) else { return Ok(()) };
        let new = file.metadata()?;
        let mut mode = former.mode() & 0o777;
        if (new.uid(), new.gid()) != (former.uid(), former.gid())
            && fchown(file, Some(former.uid()), Some(former.gid())).is_err()
            && fchown(file, None, Some(former.gid())).is_err()
        {
            // The superuser alone gives files away. The group is another one now, and gets no more rights
            // than others.
            mode = (mode & !0o070) | (((mode & 0o007) << 3) & mode);
        }
        file.set_permissions(fs::Permissions::from_mode(mode))?;
    }
    let _ = (file, from);
    Ok(())
}

/// Removes a file, a link or a folder, which need not be there.
pub(crate) fn remove(path: &Path) -> io::Result<()> {
    let removed = match fs::symlink_metadata(path) {
        Ok(is) if is.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(e) => Err(e),
    };
    match removed {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}
