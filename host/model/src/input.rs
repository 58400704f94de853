//! Files that are read: regular ones alone, and no more of them than makes sense. A pipe would be waited for,
//! and a device such as `/dev/zero` has no end; both are told from the opened file, so that nothing can
//! change in between.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::object::{check_file, is_object};
use crate::size::human_size;
use crate::{Error, Result};

/// Opens a regular file to read it, by way of links.
///
/// # Errors
/// There is none, or it is a folder, a pipe or a device, or an object. This never waits.
pub fn open(path: &Path) -> Result<File> {
    check_file("open", path)?;
    let file = open_at_once(path, true).map_err(|e| Error::io("open", path, &e))?;
    let is = file.metadata().map_err(|e| Error::io("open", path, &e))?;
    check_regular(path, &is)?;
    Ok(file)
}

/// Whether a model may be at a path. For an object this is found out only when it is opened.
pub fn may_be_there(path: &Path) -> bool {
    is_object(path) || path.exists()
}

/// A path that is as seen from a folder; an object's is a whole one.
pub fn seen_from(folder: &Path, path: &Path) -> PathBuf {
    if is_object(path) { path.to_owned() } else { folder.join(path) }
}

/// Reads a whole file of at most `most` bytes.
///
/// # Errors
/// As of [`open`], it cannot be read, or is longer.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let failed = |e: io::Error| Error::io("read", path, &e);
    let length = file.metadata().map_err(failed)?.len();
    if length > most {
        return Err(too_long(path, most));
    }
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(most + 1).read_to_end(&mut bytes).map_err(failed)?;
    // The file may grow while it is read.
    if bytes.len() as u64 > most { Err(too_long(path, most)) } else { Ok(bytes) }
}

/// Reads a whole text of at most `most` bytes.
///
/// # Errors
/// As of [`read`], or it is no UTF-8.
pub fn read_text(path: &Path, most: u64) -> Result<String> {
    String::from_utf8(read(path, most)?).map_err(|e| {
        Error::format(format!("{} is no text in UTF-8", path.display()), "give another file").because(e)
    })
}

pub(crate) fn too_long(path: &Path, most: u64) -> Error {
    Error::format(
        format!("{} is longer than the {} that such a file has at most", path.display(), human_size(most)),
        "give another file",
    )
}

fn check_regular(path: &Path, is: &Metadata) -> Result<()> {
    if is.is_dir() {
        return Err(Error::io("open", path, &io::ErrorKind::IsADirectory.into()));
    }
    if !is.is_file() {
        return Err(Error::argument(
            format!("{} is a pipe or a device, not a file", path.display()),
            "save what it gives to a file first",
        ));
    }
    Ok(())
}

/// Opens the file at a path, of any kind, without waiting for another process; not through a link, unless
/// `follow` allows it.
pub(crate) fn open_at_once(path: &Path, follow: bool) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
        let flags = if follow { flags } else { flags | OFlags::NOFOLLOW };
        options.custom_flags(flags.bits() as i32);
    }
    let _ = follow;
    options.open(path)
}

/// The identity of a file, which tells it from all others, whatever it is called.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Identity(Known);

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Known {
    /// Device and number.
    #[cfg(unix)]
    File(u64, u64),
    /// The one name of an object or, where files have no numbers, of a file.
    Name(PathBuf),
}

impl Identity {
    /// The identity of the file or folder that a path leads to, by way of links; `None` where there is none.
    /// An object has one whether it is there or not.
    pub fn from_path(path: &Path) -> Option<Self> {
        if is_object(path) {
            return Some(Self(Known::Name(path.to_owned())));
        }
        #[cfg(unix)]
        {
            std::fs::metadata(path).ok().map(|is| Self::known(&is))
        }
        #[cfg(not(unix))]
        {
            path.canonicalize().ok().map(|path| Self(Known::Name(path)))
        }
    }

    #[cfg(unix)]
    fn known(is: &Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        Self(Known::File(is.dev(), is.ino()))
    }

    /// Whether an open file is the one at this path, which is no link.
    pub(crate) fn is_at(file: &File, path: &Path) -> bool {
        #[cfg(unix)]
        {
            let (open, named) = (file.metadata(), std::fs::symlink_metadata(path));
            matches!((open, named), (Ok(a), Ok(b)) if Self::known(&a) == Self::known(&b))
        }
        #[cfg(not(unix))]
        {
            // Nothing renames or removes an open file there.
            let _ = (file, path);
            true
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::write_file;

    #[test]
    fn files_are_read_up_to_their_bound() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        write_file(&path, "äb".as_bytes()).unwrap();
        assert_eq!(read_text(&path, 3).unwrap(), "äb");
        assert!(read(&path, 2).unwrap_err().to_string().contains("longer than the 2 bytes"));
        write_file(&path, &[0xff]).unwrap();
        assert!(read_text(&path, 3).unwrap_err().to_string().contains("UTF-8"));
        assert!(read(folder.path(), 9).unwrap_err().to_string().ends_with("is a directory"));
        assert!(
            read(&folder.path().join("b"), 9).unwrap_err().to_string().ends_with("no such file or directory")
        );
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, rustix::fs::Mode::RWXU, 0)
            .unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for path in [Path::new("/dev/zero"), &link, &pipe] {
            let error = read(path, 100).unwrap_err();
            assert!(error.to_string().contains("is a pipe or a device"), "{error}");
        }
    }

    #[test]
    fn a_file_is_the_same_by_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        write_file(&at("a"), b"1").unwrap();
        write_file(&at("b"), b"1").unwrap();
        std::fs::hard_link(at("a"), at("c")).unwrap();
        assert_eq!(Identity::from_path(&at("a")), Identity::from_path(&at("./a")));
        assert_ne!(Identity::from_path(&at("a")), Identity::from_path(&at("b")));
        assert_eq!(Identity::from_path(&at("missing")), None);
        #[cfg(unix)]
        assert_eq!(Identity::from_path(&at("a")), Identity::from_path(&at("c")));
    }
}
