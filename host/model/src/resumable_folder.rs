//! Large files that appear together, as one folder, and are gone on with after the program was killed: the
//! tiles of a model. Each is a [resumable file](crate::resumable) in the folder that is in the making; a
//! finished one keeps its journal there until all of them are.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::thread;

use crate::output::sync_folder;
use crate::output_folder::OutputFolder;
use crate::resumable::{Finished, Opened, ResumableFile, bytes_there, is_left};
use crate::target::folder_of;
use crate::{Error, ErrorKind, Output, Progress, Result, Summary};

/// Files that are brought to the disk at a time.
const SYNCED_AT_ONCE: usize = 16;

/// Files of a folder in the making, one after the other. Dropped before [`commit`](Self::commit), it leaves
/// no trace, unless it is to be [kept](Self::keep).
pub struct ResumableFolder {
    /// File after the finished ones, if it was begun; it is given up before the folder is.
    current: Option<Box<ResumableFile>>,
    folder: OutputFolder,
    names: Vec<PathBuf>,
    key: String,
    part_bytes: u64,
    /// Whether the end of writing waits until all is on the disk.
    syncs: bool,
    /// Number of finished files, which are the first ones.
    finished: usize,
    /// The bytes of each file that an earlier call wrote.
    taken_over: Vec<u64>,
    /// The folder stands in its place.
    is_in_place: bool,
}

/// Result of [`ResumableFolder::open`].
pub enum OpenedFolder {
    /// The folder has still to be written, as a whole or in part.
    Unfinished(Box<ResumableFolder>),
    /// The folder is complete: an earlier call wrote all of it, and it stands in its place.
    Finished(FinishedFolder),
}

/// The key of a file: that of all of them, and which one it is.
fn key_of(key: &str, number: usize) -> String {
    format!("{key}-{number}")
}

impl ResumableFolder {
    /// Begins a folder of files of these names, whose bytes `key` determines. With `resume`, the files that
    /// an earlier call left are checked and kept as far as they are good.
    ///
    /// # Errors
    /// The folder cannot be written, or holds what would be lost; another process writes it; the user
    /// cancelled.
    pub fn open(
        path: &Path,
        names: &[PathBuf],
        key: String,
        resume: bool,
        part_bytes: u64,
        progress: &dyn Progress,
    ) -> Result<OpenedFolder> {
        check_target(path, names)?;
        if resume && let Some(finished) = in_place(path, names, &key, part_bytes, progress)? {
            return Ok(OpenedFolder::Finished(finished));
        }
        let folder = OutputFolder::create_or_go_on(path, resume)?;
        let mut this = Self {
            folder,
            names: names.to_vec(),
            key,
            part_bytes,
            syncs: true,
            finished: 0,
            taken_over: Vec::new(),
            current: None,
            is_in_place: false,
        };
        if resume && let Err(e) = this.find(progress) {
            // A cancellation now loses nothing.
            this.keep();
            return Err(e);
        }
        Ok(OpenedFolder::Unfinished(Box::new(this)))
    }

    /// Takes over the files that an earlier call left and that can be relied on.
    fn find(&mut self, progress: &dyn Progress) -> Result<()> {
        for number in 0..self.names.len() {
            let path = self.path_of(number);
            if !is_left(&path) {
                break;
            }
            let key = key_of(&self.key, number);
            match ResumableFile::open(&path, key, true, self.part_bytes, progress)
                .map_err(|e| self.named(e))?
            {
                Opened::Finished(file) => {
                    self.taken_over.push(file.bytes());
                    self.finished += 1;
                    file.keep();
                }
                Opened::Unfinished(mut file) => {
                    file.leave_syncing();
                    self.current = Some(file);
                    break;
                }
            }
        }
        Ok(())
    }

    fn path_of(&self, number: usize) -> PathBuf {
        self.folder.path().join(&self.names[number])
    }

    fn named(&self, e: Error) -> Error {
        self.folder.named(e)
    }

    /// Numbers of files, and of pieces of the file after them, behind which work can be gone on with.
    pub fn boundaries(&self) -> Vec<(u64, u64)> {
        let files = self.finished as u64;
        let of_files = (0..=files).map(|files| (files, 0));
        let of_pieces = self.current.iter().flat_map(|file| file.boundaries());
        of_files.chain(of_pieces.map(|pieces| (files, pieces))).collect()
    }

    /// Goes on after one of the [boundaries](Self::boundaries). Has to be called before anything is written.
    /// Returns how many bytes are there.
    ///
    /// # Errors
    /// What is left cannot be written.
    pub fn go_on_after(&mut self, (files, pieces): (u64, u64)) -> Result<u64> {
        if (files as usize) < self.finished {
            self.current = None;
            self.finished = files as usize;
        }
        let mut bytes: u64 = self.taken_over.iter().take(self.finished).sum();
        if let Some(file) = &mut self.current {
            bytes += file.go_on_after(pieces).map_err(|e| self.folder.named(e))?;
        }
        Ok(bytes)
    }

    /// Leaves it to the caller to bring the complete folder to the disk, or not to.
    pub fn leave_syncing(&mut self) {
        self.syncs = false;
    }

    /// Ends the folder: nothing more is written to it.
    ///
    /// # Errors
    /// Not all files were written.
    pub fn complete(&mut self) -> Result<()> {
        if self.finished < self.names.len() || self.current.is_some() {
            return Err(Error::internal("a folder of tiles is not complete"));
        }
        Ok(())
    }

    /// Puts the [completed](Self::complete) folder in its place.
    ///
    /// # Errors
    /// The operating system refuses, or something came to the place that would be lost.
    pub fn commit(&mut self) -> Result<FinishedFolder> {
        let target = self.folder.target().to_owned();
        check_target(&target, &self.names)?;
        let files = self.names.iter().map(|name| target.join(name)).collect();
        if self.syncs {
            self.sync().map_err(|e| Error::io("write", &target, &e))?;
        }
        self.folder.put_in_place()?;
        self.is_in_place = true;
        Ok(FinishedFolder { files, leave: false })
    }

    /// Brings all files to the disk, several at a time, for which file systems write their own journal once.
    fn sync(&self) -> io::Result<()> {
        let folders: BTreeSet<&Path> = self.names.iter().flat_map(|name| name.ancestors().skip(1)).collect();
        let share = self.names.len().div_ceil(SYNCED_AT_ONCE).max(1);
        let folder = self.folder.path();
        thread::scope(|scope| {
            let sync = |names: &[PathBuf]| -> io::Result<()> {
                names.iter().try_for_each(|name| File::open(folder.join(name))?.sync_all())
            };
            let shares: Vec<_> =
                self.names.chunks(share).map(|names| scope.spawn(move || sync(names))).collect();
            shares
                .into_iter()
                .try_for_each(|share| share.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
        })?;
        folders.iter().try_for_each(|inner| sync_folder(&folder.join(inner)))
    }

    /// Leaves the recorded parts to a later call, if there are any.
    pub fn keep(self) {
        let Self { folder, finished, current, is_in_place, .. } = self;
        let in_part = current.as_ref().is_some_and(|file| file.boundaries().next().is_some());
        if let Some(file) = current {
            file.keep();
        }
        if (finished > 0 || in_part) && !is_in_place {
            folder.keep();
        }
    }

    fn current(&mut self) -> io::Result<&mut ResumableFile> {
        self.current.as_deref_mut().ok_or_else(|| io::Error::other("no tile is being written"))
    }

    /// An error with the name that the folder will have, packed so that it passes through.
    fn packed(&self, e: Error) -> io::Error {
        let kind = if e.kind() == ErrorKind::Io { io::ErrorKind::Other } else { io::ErrorKind::InvalidInput };
        io::Error::new(kind, self.named(e))
    }

    fn repacked(&self, e: io::Error) -> io::Error {
        match e.downcast::<Error>() {
            Ok(e) => self.packed(e),
            Err(e) => e,
        }
    }
}

impl Output for ResumableFolder {
    fn begin_file(&mut self, number: usize) -> io::Result<()> {
        if number != self.finished || number >= self.names.len() {
            return Err(io::Error::other("tiles are written out of their order"));
        }
        if self.current.is_some() {
            // An earlier call had begun it.
            return Ok(());
        }
        let path = self.path_of(number);
        fs::create_dir_all(folder_of(&path))?;
        let (key, silent) = (key_of(&self.key, number), &crate::progress::Silent);
        match ResumableFile::open(&path, key, false, self.part_bytes, silent).map_err(|e| self.packed(e))? {
            Opened::Unfinished(mut file) => {
                file.leave_syncing();
                self.current = Some(file);
            }
            Opened::Finished(_) => return Err(io::Error::other("a tile is there that was not written")),
        }
        Ok(())
    }

    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()> {
        let written = self.current()?.write_pieces(pieces, bytes, source_bytes, summary);
        written.map_err(|e| self.repacked(e))
    }

    fn summary(&self) -> Summary {
        self.current.as_ref().map_or_else(Summary::default, |file| file.summary())
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let patched = self.current()?.patch(at, bytes);
        patched.map_err(|e| self.repacked(e))
    }

    fn finish(&mut self) -> io::Result<()> {
        let mut file = self.current.take().ok_or_else(|| io::Error::other("no tile is being written"))?;
        let finish = |file: &mut ResumableFile| {
            file.complete(true)?;
            file.commit().map(Finished::keep)
        };
        finish(&mut file).map_err(|e| self.packed(e))?;
        self.finished += 1;
        Ok(())
    }
}

/// A folder that stands in its place; the journals of its files are removed with this.
pub struct FinishedFolder {
    files: Vec<PathBuf>,
    leave: bool,
}

impl FinishedFolder {
    /// Size of all files.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| fs::metadata(file).map_or(0, |m| m.len())).sum()
    }

    /// Leaves the journals, for a later call that does the rest.
    pub fn keep(mut self) {
        self.leave = true;
    }
}

impl Drop for FinishedFolder {
    fn drop(&mut self) {
        if !self.leave {
            self.files.iter().for_each(|file| crate::resumable::forget(file));
        }
    }
}

/// Takes the folder in its place, if an earlier call had finished it and another one is to do the rest.
fn in_place(
    path: &Path,
    names: &[PathBuf],
    key: &str,
    part_bytes: u64,
    progress: &dyn Progress,
) -> Result<Option<FinishedFolder>> {
    let files: Vec<PathBuf> = names.iter().map(|name| path.join(name)).collect();
    if !files.iter().all(|file| file.is_file() && is_left(file)) {
        return Ok(None);
    }
    let mut found = Vec::new();
    for (number, file) in files.iter().enumerate() {
        match ResumableFile::open(file, key_of(key, number), true, part_bytes, progress)? {
            Opened::Finished(file) => found.push(file),
            Opened::Unfinished(_) => return Ok(None),
        }
    }
    found.into_iter().for_each(Finished::keep);
    Ok(Some(FinishedFolder { files, leave: false }))
}

/// Checks that files of these names may be written to a folder of their own: a folder that is there holds
/// nothing else.
///
/// # Errors
/// The path is a file, or the folder holds something that would be lost.
pub fn check_target(folder: &Path, names: &[PathBuf]) -> Result<()> {
    let refused = |what: String| {
        let hint = "tiles go to a folder of their own: give the name of a new one, or of one with former tiles alone";
        Err(Error::argument(format!("{} {what}", folder.display()), hint))
    };
    let failed = |e: io::Error| Error::io("write", folder, &e);
    let Ok(is) = fs::metadata(folder) else {
        let parent = fs::metadata(folder_of(folder)).map_err(failed)?;
        return if parent.is_dir() { Ok(()) } else { Err(failed(io::ErrorKind::NotADirectory.into())) };
    };
    if !is.is_dir() {
        return refused("is a file, and not a folder for the tiles".to_owned());
    }
    let own: BTreeSet<&Path> = names.iter().map(PathBuf::as_path).collect();
    let folders: BTreeSet<&Path> = names.iter().flat_map(|name| name.ancestors().skip(1)).collect();
    let mut open = vec![PathBuf::new()];
    while let Some(below) = open.pop() {
        for entry in fs::read_dir(folder.join(&below)).map_err(|e| Error::io("read", folder, &e))? {
            let entry = entry.map_err(|e| Error::io("read", folder, &e))?;
            let (name, is) = (entry.file_name(), entry.file_type().map_err(failed)?);
            let path = below.join(&name);
            let is_hidden = name.to_str().is_some_and(|name| name.starts_with(".simod-"));
            if is.is_dir() && folders.contains(path.as_path()) {
                open.push(path);
            } else if !(is.is_file() && (is_hidden || own.contains(path.as_path()))) {
                return refused(format!("holds {}, which is none of the tiles", path.display()));
            }
        }
    }
    Ok(())
}

/// Bytes of the folder that the disk holds already.
pub fn bytes_in_folder(folder: &Path, names: &[PathBuf], resume: bool) -> u64 {
    let there = |folder: &Path| -> u64 {
        let of_file = |name: &PathBuf| {
            let file = folder.join(name);
            let done = if is_left(&file) { fs::metadata(&file).map_or(0, |is| is.len()) } else { 0 };
            done.max(bytes_there(&file, resume))
        };
        names.iter().map(of_file).sum()
    };
    let made = there(&OutputFolder::in_the_making(folder));
    if resume { made.max(there(folder)) } else { made }
}

/// Whether an earlier call left something of the folder.
pub fn is_folder_left(folder: &Path, names: &[PathBuf]) -> bool {
    names.first().is_some_and(|name| {
        is_left(&OutputFolder::in_the_making(folder).join(name)) || is_left(&folder.join(name))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::tests::names as listed;
    use crate::progress::Silent;

    fn names() -> Vec<PathBuf> {
        ["a", "sub/b", "c"].map(PathBuf::from).to_vec()
    }

    fn open(path: &Path, resume: bool) -> OpenedFolder {
        ResumableFolder::open(path, &names(), "k".into(), resume, 10, &Silent).unwrap()
    }

    fn unfinished(path: &Path, resume: bool) -> ResumableFolder {
        match open(path, resume) {
            OpenedFolder::Unfinished(folder) => *folder,
            OpenedFolder::Finished(_) => panic!("it is finished"),
        }
    }

    /// Writes files from the first on, of six pieces each, up to so many pieces of all.
    fn write(folder: &mut ResumableFolder, from: (u64, u64), pieces: u64) {
        let mut left = pieces;
        for number in from.0..3 {
            if left == 0 {
                return;
            }
            folder.begin_file(number as usize).unwrap();
            for piece in (if number == from.0 { from.1 } else { 0 })..6 {
                if left == 0 {
                    return;
                }
                folder.write_piece(&[(10 * number + piece) as u8; 5], 5, &Summary::default()).unwrap();
                left -= 1;
            }
            folder.finish().unwrap();
        }
    }

    fn check(path: &Path) {
        for (number, name) in names().iter().enumerate() {
            let expected: Vec<u8> = (0..6).flat_map(|piece| [(10 * number + piece) as u8; 5]).collect();
            assert_eq!(fs::read(path.join(name)).unwrap(), expected);
        }
        assert_eq!(listed(path), ["a", "c", "sub"]);
        assert_eq!(listed(&path.join("sub")), ["b"]);
    }

    /// A folder is gone on with wherever writing stopped, and nothing but the folder is left.
    #[test]
    fn a_kept_folder_is_gone_on_with() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("out");
        for stopped in 0..=18 {
            let mut folder = unfinished(&path, false);
            write(&mut folder, (0, 0), stopped);
            folder.keep();
            assert!(!path.exists());
            assert_eq!(is_folder_left(&path, &names()), stopped >= 2, "{stopped}");
            let mut folder = unfinished(&path, true);
            let last = folder.boundaries().last().copied().unwrap();
            assert_eq!(last, (stopped / 6, stopped % 6 / 2 * 2), "{stopped}");
            assert_eq!(folder.go_on_after(last).unwrap(), 5 * (6 * last.0 + last.1));
            write(&mut folder, last, u64::MAX);
            folder.complete().unwrap();
            let finished = folder.commit().unwrap();
            drop(folder);
            assert_eq!(finished.bytes(), 90);
            if stopped % 2 == 0 {
                // Another version is not done yet: this one is known to be.
                finished.keep();
                assert!(matches!(open(&path, true), OpenedFolder::Finished(folder) if folder.bytes() == 90));
            } else {
                drop(finished);
            }
            check(&path);
            assert_eq!(listed(place.path()), ["out"]);
            fs::remove_dir_all(&path).unwrap();
        }
    }

    #[test]
    fn it_goes_on_where_another_version_does_and_leaves_nothing_if_dropped() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("out");
        let mut folder = unfinished(&path, false);
        write(&mut folder, (0, 0), 15);
        folder.keep();
        let mut folder = unfinished(&path, true);
        assert!(folder.boundaries().contains(&(1, 0)));
        assert_eq!(folder.go_on_after((1, 0)).unwrap(), 30);
        write(&mut folder, (1, 0), u64::MAX);
        folder.complete().unwrap();
        drop(folder.commit().unwrap());
        drop(folder);
        check(&path);
        // Over the former one, which stays as it was.
        let mut folder = unfinished(&path, false);
        write(&mut folder, (0, 0), 9);
        assert!(folder.complete().is_err());
        drop(folder);
        check(&path);
        assert_eq!(listed(place.path()), ["out"]);
    }

    #[test]
    fn a_folder_with_something_else_is_not_replaced() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("out");
        fs::create_dir_all(path.join("sub")).unwrap();
        check_target(&path, &names()).unwrap();
        crate::output::write_file(&path.join("sub/b"), b"1").unwrap();
        check_target(&path, &names()).unwrap();
        crate::output::write_file(&path.join("sub/mine"), b"1").unwrap();
        let error = check_target(&path, &names()).unwrap_err().to_string();
        assert!(error.ends_with("holds sub/mine, which is none of the tiles"), "{error}");
        let error = check_target(&path.join("sub/b"), &names()).unwrap_err().to_string();
        assert!(error.contains("is a file"), "{error}");
        assert!(check_target(&place.path().join("no/out"), &names()).is_err());
    }
}
