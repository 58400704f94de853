//! The target of a path, by way of links: the file or folder that is written in the end.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::object::{check_file, is_object};
use crate::{Error, Result};

/// Links followed from one to the next, before it is a circle.
const MAX_LINKS: usize = 40;

/// The file that `path` means in the end: one that need not exist, but can be created or replaced.
///
/// # Errors
/// The path is a folder or a device, or an object, or links lead nowhere.
pub(crate) fn regular_target(path: &Path) -> Result<PathBuf> {
    check_file("write", path)?;
    // The check is on the path itself: its target may have no name, as a pipe behind `/dev/stdout`.
    let is = fs::metadata(path);
    let target = target_of(path)?;
    match is {
        Ok(meta) if meta.is_dir() => Err(Error::io("write", path, &io::ErrorKind::IsADirectory.into())),
        // Renaming a file over a device would replace the device.
        Ok(meta) if !meta.is_file() => Err(Error::argument(
            format!("cannot write {}: it is a pipe or a device", path.display()),
            "what is written has another name until it is whole, and a pipe or a device cannot take that back: give the path of \
             a file",
        )),
        _ => Ok(target),
    }
}

/// Path that `path` leads to through links, whatever is there; it has a name.
pub(crate) fn target_of(path: &Path) -> Result<PathBuf> {
    check_file("write", path)?;
    let target = follow_links(path)?;
    if target.file_name().is_none() {
        return Err(Error::io("write", path, &io::ErrorKind::IsADirectory.into()));
    }
    Ok(target)
}

/// Path of the file by the one name that all paths to it share, where its folder exists. An object has one
/// name.
///
/// # Errors
/// The path is a folder or a device, links lead nowhere, or the folder is missing.
pub fn canonical_target(path: &Path) -> Result<PathBuf> {
    if is_object(path) {
        return Ok(path.to_owned());
    }
    let target = regular_target(path)?;
    let folder = folder_of(&target).canonicalize().map_err(|e| Error::io("write", path, &e))?;
    if !folder.is_dir() {
        return Err(Error::io("write", path, &io::ErrorKind::NotADirectory.into()));
    }
    Ok(folder.join(target.file_name().unwrap_or_default()))
}

/// The path of a folder without links, which need not exist.
///
/// # Errors
/// Links lead nowhere, or the folder that it lies in is missing.
pub fn canonical_folder(path: &Path) -> Result<PathBuf> {
    if let Ok(folder) = path.canonicalize() {
        return Ok(folder);
    }
    let target = target_of(path)?;
    let folder = folder_of(&target).canonicalize().map_err(|e| Error::io("write", path, &e))?;
    Ok(folder.join(target.file_name().unwrap_or_default()))
}

/// The file that a path means in the end. It need not exist.
fn follow_links(path: &Path) -> Result<PathBuf> {
    let mut target = path.to_owned();
    for _ in 0..MAX_LINKS {
        let is_link = fs::symlink_metadata(&target).is_ok_and(|meta| meta.is_symlink());
        if !is_link {
            return Ok(target);
        }
        let next = fs::read_link(&target).map_err(|e| Error::io("write", path, &e))?;
        target = folder_of(&target).join(next);
    }
    Err(Error::system(
        format!("cannot write {}: too many links from one to the next", path.display()),
        "give the path of the file itself",
    ))
}

/// Folder for temporary files of an output: the one that holds the output, or for an object the system's.
pub fn scratch_folder(path: &Path) -> PathBuf {
    if is_object(path) { std::env::temp_dir() } else { folder_of(path).to_owned() }
}

/// The folder that holds a file: that of the same name but for its last part.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}
