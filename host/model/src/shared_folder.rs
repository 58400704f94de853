//! A folder that several processes fill at the same time, each with files of its own, and that becomes an
//! output once all of them are there: the tiles of a model.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::claim::remove;
use crate::output::{OutputFile, check_space, sync_folder};
use crate::output_folder::OutputFolder;
use crate::resumable_folder::check_target;
use crate::target::folder_of;
use crate::{Error, ErrorKind, Output, Progress, Result, Summary, Tile};

/// Stamp of a file that was written, by which a later process knows the file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WrittenFile {
    bytes: u64,
    /// Time of the last change since 1970, where the file system tells it.
    changed: Option<Duration>,
}

impl WrittenFile {
    /// The file at a path.
    fn read_stamp(path: &Path) -> io::Result<Self> {
        let is = fs::metadata(path)?;
        let changed = is.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        Ok(Self { bytes: is.len(), changed })
    }

    /// Size of the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether a file of the same size is at a path.
    pub fn fits(&self, path: &Path) -> bool {
        Self::read_stamp(path).is_ok_and(|file| file.bytes == self.bytes)
    }

    /// Whether the file at a path is this one, unchanged.
    pub fn is(&self, path: &Path) -> bool {
        Self::read_stamp(path).is_ok_and(|file| file == *self)
    }
}

/// Files of the folder that one process writes, one after the other, for the tiles that it rewrites. Dropped
/// before [`keep`](Self::keep), it leaves none of them.
///
/// Memory: a buffer of 256 KiB.
pub struct SharedFiles<'a> {
    folder: PathBuf,
    tiles: &'a [Tile],
    current: Option<OutputFile>,
    written: Vec<(PathBuf, WrittenFile)>,
    keeps: bool,
}

impl<'a> SharedFiles<'a> {
    /// Begins to write some of the tiles to a folder, which need not be there.
    pub fn new(folder: &Path, tiles: &'a [Tile]) -> Self {
        Self { folder: folder.to_owned(), tiles, current: None, written: Vec::new(), keeps: false }
    }

    /// The files that are finished, and on the disk, in their order.
    pub fn written(&self) -> Vec<WrittenFile> {
        self.written.iter().map(|(_, file)| file.clone()).collect()
    }

    /// Keeps the written files.
    pub fn keep(mut self) {
        self.keeps = true;
    }

    fn current(&mut self) -> io::Result<&mut OutputFile> {
        self.current.as_mut().ok_or_else(none_begun)
    }
}

fn none_begun() -> io::Error {
    io::Error::other("no tile is being written")
}

/// An error that passes through [`Output`].
fn packed(e: Error) -> io::Error {
    let kind = if e.kind() == ErrorKind::Io { io::ErrorKind::Other } else { io::ErrorKind::InvalidInput };
    io::Error::new(kind, e)
}

impl Output for SharedFiles<'_> {
    fn begin_file(&mut self, number: usize) -> io::Result<()> {
        let tile = self.tiles.get(number).ok_or_else(|| io::Error::other("there is no such tile"))?;
        let path = self.folder.join(&tile.name);
        let folder = folder_of(&path);
        fs::create_dir_all(folder).map_err(|e| packed(Error::io("make the folder", folder, &e)))?;
        self.current = Some(OutputFile::create(&path, tile.bytes).map_err(packed)?);
        Ok(())
    }

    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.current()?.write_all(bytes)
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.current()?.replaceable().patch(at, bytes)
    }

    fn finish(&mut self) -> io::Result<()> {
        let file = self.current.take().ok_or_else(none_begun)?;
        let path = file.path().to_owned();
        file.commit().map_err(packed)?;
        let written = WrittenFile::read_stamp(&path)?;
        self.written.push((path, written));
        Ok(())
    }
}

impl Drop for SharedFiles<'_> {
    fn drop(&mut self) {
        if !self.keeps {
            // A file that cannot be removed will be written again.
            self.written.iter().for_each(|(path, _)| drop(fs::remove_file(path)));
        }
    }
}

/// Puts the folder, to which nobody writes any more, in the place of an output, on whichever disk that is:
/// files of these names.
///
/// # Errors
/// The output holds something else; another process writes it, or the operating system refuses; the user
/// cancelled. The output is then what it was.
pub fn become_output(folder: &Path, names: &[PathBuf], output: &Path, progress: &dyn Progress) -> Result<()> {
    check_target(folder, names)?;
    sync_folders(folder, names).map_err(|e| Error::io("write", folder, &e))?;
    let place = OutputFolder::create(output)?;
    if place.put_other_in_place(folder)? {
        return Ok(());
    }
    let size = |name: &PathBuf| fs::metadata(folder.join(name)).map_or(0, |is| is.len());
    let bytes = names.iter().map(size).sum();
    check_space(output, place.path(), bytes)?;
    progress.begin("copying the tiles", bytes);
    for name in names {
        progress.check()?;
        let to = place.path().join(name);
        let copied = copy(&folder.join(name), &to).map_err(|e| place.named(Error::io("write", &to, &e)))?;
        progress.advance(copied);
    }
    sync_folders(place.path(), names).map_err(|e| Error::io("write", output, &e))?;
    place.commit()?;
    // The output is there: files that cannot be removed hurt nobody.
    let _ = remove(folder);
    Ok(())
}

/// Removes the folder that a process left which was killed when the folder had become the output.
///
/// # Errors
/// Another process writes the output, or the operating system refuses.
pub fn settle(folder: &Path, output: &Path) -> Result<()> {
    drop(OutputFolder::create(output)?);
    // The folder holds the files that the output replaced, or was copied from.
    remove(folder).map_err(|e| Error::io("remove", folder, &e))
}

/// Copies a file to the disk.
fn copy(from: &Path, to: &Path) -> io::Result<u64> {
    fs::create_dir_all(folder_of(to))?;
    let copied = fs::copy(from, to)?;
    fs::File::open(to)?.sync_all()?;
    Ok(copied)
}

/// Makes the names of files last through a power failure.
fn sync_folders(folder: &Path, names: &[PathBuf]) -> io::Result<()> {
    let folders: BTreeSet<&Path> = names.iter().flat_map(|name| name.ancestors().skip(1)).collect();
    folders.iter().try_for_each(|below| sync_folder(&folder.join(below)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::tests::names as listed;
    use crate::progress::Silent;

    fn tiles() -> Vec<Tile> {
        let tile = |name: &str| Tile { path: name.into(), name: name.into(), bytes: 3, vertices: 1 };
        ["a", "sub/b", "c"].map(tile).to_vec()
    }

    fn write(files: &mut SharedFiles<'_>, number: usize, text: &[u8]) {
        files.begin_file(number).unwrap();
        files.write_piece(text, 0, &Summary::default()).unwrap();
        files.patch(0, b"1").unwrap();
        files.finish().unwrap();
    }

    #[test]
    fn a_folder_that_several_fill_becomes_an_output() {
        let (place, tiles) = (tempfile::tempdir().unwrap(), tiles());
        let [folder, output] = ["plan", "out"].map(|name| place.path().join(name));
        let names: Vec<PathBuf> = tiles.iter().map(|tile| tile.name.clone()).collect();
        for text in [b"000", b"002"] {
            let [mut one, mut other] = [(); 2].map(|()| SharedFiles::new(&folder, &tiles));
            write(&mut other, 2, text);
            write(&mut one, 0, text);
            write(&mut one, 1, text);
            let [one, other] = [one, other].map(|files| {
                let written = files.written();
                files.keep();
                written
            });
            assert_eq!(one.iter().map(WrittenFile::bytes).collect::<Vec<_>>(), [3, 3]);
            become_output(&folder, &names, &output, &Silent).unwrap();
            for (name, file) in names.iter().zip(one.iter().chain(&other)) {
                assert!(file.is(&output.join(name)) && file.fits(&output.join(name)));
                assert_eq!(fs::read(output.join(name)).unwrap(), [b'1', text[1], text[2]]);
            }
            assert_eq!(listed(place.path()), ["out"]);
            // The file has the same size, and is another one.
            crate::output::write_file(&output.join("c"), b"102").unwrap();
            assert!(!other[0].is(&output.join("c")) && other[0].fits(&output.join("c")));
        }
    }

    #[test]
    fn who_does_not_keep_leaves_none() {
        let (place, tiles) = (tempfile::tempdir().unwrap(), tiles());
        let mut files = SharedFiles::new(place.path(), &tiles);
        write(&mut files, 0, b"000");
        files.begin_file(2).unwrap();
        drop(files);
        assert_eq!(listed(place.path()), Vec::<String>::new());
        assert!(SharedFiles::new(place.path(), &tiles).begin_file(3).is_err());
        assert!(SharedFiles::new(place.path(), &tiles).finish().is_err());
    }
}
