//! Files that appear whole or not at all.
//!
//! All that the program writes goes to a hidden file beside the target first, which takes the target's name
//! only when it is complete and on the disk; caches, which know whether they are damaged and are made anew,
//! when they are complete. Killed at any moment, the program leaves the old file or the new one (and perhaps
//! the hidden one, `.simod-NAME.part`, which the next call to the same target removes: `claim`). Models,
//! which take long, are written in parts (`resumable`).

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::claim::Claim;
use crate::size::human_size;
use crate::target::{folder_of, regular_target};
use crate::{Error, Output, Result, Summary};

/// Bytes collected before they are written; longer writes go straight through.
const BUFFER: usize = 1 << 18;

/// A file in the making. Dropped before [`commit`](Self::commit), it leaves no trace.
#[derive(Debug)]
pub struct OutputFile {
    writer: BufWriter<File>,
    claim: Claim,
}

impl OutputFile {
    /// Begins the file `path`, which will be of about `expected_bytes`. A link is followed: the file that it
    /// points to is replaced.
    ///
    /// # Errors
    /// The folder is missing or cannot be written to, `path` is a folder or a device, another process writes
    /// it, or the disk is too full.
    pub fn create(path: &Path, expected_bytes: u64) -> Result<Self> {
        check_space(path, folder_of(&regular_target(path)?), expected_bytes)?;
        let claim = Claim::file(path, false)?;
        let file = claim.part().try_clone().map_err(|e| claim.failed(&e))?;
        Ok(Self { writer: BufWriter::with_capacity(BUFFER, file), claim })
    }

    /// Puts the file in its place, once all of it is on the disk, with the permissions and the owner of what
    /// it replaces.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses; the target is then what it was.
    pub fn commit(self) -> Result<()> {
        let Self { writer, mut claim } = self;
        let commit = || -> io::Result<()> {
            writer.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
            claim.put_in_place()?;
            sync_folder(folder_of(&claim.places().target))
        };
        commit().map_err(|e| claim.failed(&e))
    }

    /// Puts the file in its place without waiting for the disk: for a file that is made again where it is
    /// damaged, as a power failure may leave it.
    ///
    /// # Errors
    /// As of [`commit`](Self::commit), as far as the operating system tells by now.
    pub fn commit_unsynced(self) -> Result<()> {
        let Self { writer, mut claim } = self;
        let flushed = writer.into_inner().map_err(io::IntoInnerError::into_error);
        flushed.and_then(|_| claim.put_in_place()).map_err(|e| claim.failed(&e))
    }

    /// The path of the file once it is whole.
    pub(crate) fn path(&self) -> &Path {
        &self.claim.places().path
    }

    /// The file, to be written at any place.
    ///
    /// # Errors
    /// The operating system refuses.
    pub(crate) fn part(&self) -> Result<File> {
        self.claim.part().try_clone().map_err(|e| self.claim.failed(&e))
    }

    /// The file as an output of a model, whose bytes may be replaced in the end.
    pub fn replaceable(&mut self) -> Replaceable<'_> {
        Replaceable(self)
    }

    /// A refusal with the file's name, packed so that it passes through [`Write`].
    fn named(&self, error: &io::Error) -> io::Error {
        io::Error::new(error.kind(), self.claim.failed(error))
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes).map_err(|e| self.named(&e))
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.writer.write_all(bytes).map_err(|e| self.named(&e))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(|e| self.named(&e))
    }
}

/// A file in the making as an output of a model: see [`OutputFile::replaceable`].
#[derive(Debug)]
pub struct Replaceable<'a>(&'a mut OutputFile);

impl Output for Replaceable<'_> {
    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let writer = &mut self.0.writer;
        let patched = writer.seek(SeekFrom::Start(at)).and_then(|_| writer.write_all(bytes));
        patched.map_err(|e| self.0.named(&e))
    }

    fn finish(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// Writes a small file, whole or not at all.
///
/// # Errors
/// As for [`OutputFile::create`] and [`OutputFile::commit`].
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut file = OutputFile::create(path, bytes.len() as u64)?;
    file.writer.write_all(bytes).map_err(|e| Error::io("write", path, &e))?;
    file.commit()
}

/// An error where the disk of `folder` has no room for so many bytes of `path`.
pub fn check_space(path: &Path, folder: &Path, needed: u64) -> Result<()> {
    // A file system that cannot tell is no reason to stop; a missing folder is reported when it is written
    // to.
    let Some(available) = available_space(folder).filter(|available| *available < needed) else {
        return Ok(());
    };
    Err(Error::system(
        format!(
            "cannot write {}: it needs {}, and the disk has {} available",
            path.display(),
            human_size(needed),
            human_size(available)
        ),
        "free some space, or write to another disk",
    ))
}

/// The disk that a folder is on, where the system tells, and otherwise the folder itself.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Disk(DiskName);

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum DiskName {
    #[cfg(unix)]
    Device(u64),
    Folder(PathBuf),
}

impl Disk {
    /// The disk of a folder.
    pub fn of_folder(folder: &Path) -> Self {
        #[cfg(unix)]
        if let Ok(is) = std::fs::metadata(folder) {
            use std::os::unix::fs::MetadataExt;
            return Self(DiskName::Device(is.dev()));
        }
        Self(DiskName::Folder(folder.to_owned()))
    }
}

/// Bytes that the disk of `folder` has room for, where it tells.
pub(crate) fn available_space(folder: &Path) -> Option<u64> {
    let stats = fs4::statvfs(folder).ok().filter(|stats| stats.total_space() > 0)?;
    Some(stats.available_space())
}

/// Exchanges two folders in one step, where the system can: at any moment each name has one of both. `false`
/// where the system cannot, and nothing is changed.
pub(crate) fn exchange(a: &Path, b: &Path) -> io::Result<bool> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE) {
            Ok(()) => return Ok(true),
            Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {}
            Err(e) => return Err(e.into()),
        }
    }
    let _ = (a, b);
    Ok(false)
}

/// Makes the new name last through a power failure.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    if !cfg!(unix) {
        return Ok(());
    }
    match File::open(folder).and_then(|f| f.sync_all()) {
        // Some file systems cannot synchronise folders, and a folder that may be written need not be
        // readable.
        Err(e)
            if matches!(
                e.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported | io::ErrorKind::PermissionDenied
            ) =>
        {
            Ok(())
        }
        result => result,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::fs;

    use super::*;

    /// The files of a folder.
    pub(crate) fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_appears_when_committed_and_not_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_file(&path, b"old").unwrap();
        let mut file = OutputFile::create(&path, 3).unwrap();
        file.write_all(b"new").unwrap();
        file.flush().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        drop(file);
        assert_eq!(names(folder.path()), ["a.bin"]);

        let mut file = OutputFile::create(&path, 3).unwrap();
        file.write_all(b"new").unwrap();
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn what_cannot_be_written_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path, size| OutputFile::create(path, size).unwrap_err();
        let error = refused(folder.path(), 0);
        assert!(error.to_string().ends_with("is a directory"), "{error}");
        assert!(error.to_string().contains(&folder.path().display().to_string()));
        let error = refused(&folder.path().join("missing/a"), 0);
        assert!(error.to_string().contains("missing/a: no such file"), "{error}");
        let error = refused(&folder.path().join("a"), 1 << 62);
        assert!(error.to_string().contains("it needs 4.6 EB, and the disk has "), "{error}");
        refused(Path::new(""), 0);
        refused(Path::new("/"), 0);
        refused(Path::new(".."), 0);
        assert!(names(folder.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn a_device_or_a_folder_without_rights_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(
            OutputFile::create(Path::new("/dev/null"), 0).unwrap_err().kind(),
            crate::ErrorKind::Argument
        );
        let folder = tempfile::tempdir().unwrap();
        fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o555)).unwrap();
        // The superuser may write everywhere.
        if File::create(folder.path().join("probe")).is_err() {
            let error = OutputFile::create(&folder.path().join("a"), 0).unwrap_err();
            assert!(error.hint().contains("permissions"));
        }
        fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o755)).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let mode = |name: &str| fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        File::create(folder.path().join("plain")).unwrap();
        write_file(&folder.path().join("ours"), b"").unwrap();
        assert_eq!(mode("ours"), mode("plain"));
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("sub")).unwrap();
        // Relative to the link's folder, by way of another link; the file is not there yet.
        symlink("sub/second", at("first")).unwrap();
        symlink("file", at("sub/second")).unwrap();
        write_file(&at("first"), b"1").unwrap();
        write_file(&at("first"), b"2").unwrap();
        assert_eq!(fs::read(at("sub/file")).unwrap(), b"2");
        assert!(fs::symlink_metadata(at("first")).unwrap().is_symlink());
        assert_eq!(names(&at("sub")), ["file", "second"]);
        symlink("circle", at("circle")).unwrap();
        write_file(&at("circle"), b"").unwrap_err();
    }

    #[test]
    fn a_failed_write_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = OutputFile::create(&folder.path().join("a"), 0).unwrap();
        let error = file.named(&io::ErrorKind::StorageFull.into());
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        let error: Error = error.downcast().unwrap();
        assert!(error.to_string().contains("/a: "), "{error}");
        assert!(error.hint().starts_with("free some space"));
    }
}
