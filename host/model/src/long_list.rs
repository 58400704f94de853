//! Long lists of plain values, as those of P_S: in memory, or, where all of them together would take too
//! much, in temporary files that are mapped.

use std::fmt;
use std::io::{self, Read};
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytemuck::Pod;
use rayon::prelude::*;

use crate::mapped::{self, MapMut};
use crate::scratch::Scratch;
use crate::size::human_size;
use crate::{Error, Progress, Result, input, memory};

/// Bytes from which on a list is long: shorter ones are in memory wherever the others are.
const LONG: usize = 1 << 20;

/// The place of long lists.
#[derive(Debug, Clone, Default)]
pub enum ListStorage {
    /// Memory.
    #[default]
    Memory,
    /// Temporary files in a folder, without a name. Their pages are the system's to keep or to write down,
    /// and leave the process' memory as lists are [gone through](Self::gone_through).
    Files(Arc<ListFolder>),
}

/// A folder with temporary files of long lists.
#[derive(Debug)]
pub struct ListFolder {
    path: PathBuf,
    /// Bytes of lists that it had no room for, which are in memory; 0 once they were told.
    refused: AtomicU64,
}

impl ListStorage {
    /// The place of lists that take so many bytes together: memory up to a limit, and beyond it files in
    /// `folder`, or in the system's folder for temporary files if nothing can be written there.
    pub fn for_bytes(bytes: u64, limit: u64, folder: &Path) -> Self {
        if bytes <= limit {
            return Self::Memory;
        }
        let can_write = |folder: &Path| tempfile::tempfile_in(folder).is_ok();
        let elsewhere = std::env::temp_dir();
        let folder = if can_write(folder) { folder } else { &elsewhere };
        Self::in_folder(folder)
    }

    /// Temporary files in `folder`.
    pub fn in_folder(folder: &Path) -> Self {
        // The same folder where the process' own changes.
        let path = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        Self::Files(Arc::new(ListFolder { path, refused: AtomicU64::new(0) }))
    }

    /// The folder with the temporary files, if lists are not in memory.
    pub fn folder(&self) -> Option<&Path> {
        match self {
            Self::Memory => None,
            Self::Files(folder) => Some(&folder.path),
        }
    }

    /// Tells the user, once, where lists are in memory that should be in files.
    pub fn tell_refusal(&self, progress: &dyn Progress) {
        if let Some(refusal) = self.refusal() {
            progress.note(&refusal);
        }
    }

    fn refusal(&self) -> Option<String> {
        let Self::Files(folder) = self else { return None };
        let bytes = folder.refused.swap(0, Ordering::Relaxed);
        let refused = || {
            format!(
                "lists of the samples take {} of memory, as {} has no room for temporary files: free some \
                 space there, or have fewer samples",
                human_size(bytes),
                folder.path.display()
            )
        };
        (bytes > 0).then(refused)
    }

    /// Tells that about so many bytes of lists were gone through, and others follow: from time to time the
    /// pages of those in files leave the process' memory.
    #[inline]
    pub fn gone_through(&self, bytes: usize) {
        if self.folder().is_some() {
            mapped::looked_at(bytes);
        }
    }

    /// All numbers below `count` in order, by jobs that [go through](Self::gone_through) about so many bytes
    /// of lists for each.
    pub fn counted(&self, count: usize, bytes: usize) -> impl IndexedParallelIterator<Item = usize> {
        (0..count).into_par_iter().inspect(move |_| self.gone_through(bytes))
    }
}

/// A long list of plain values, of a length that does not change.
pub struct LongList<T>(Held<T>);

enum Held<T> {
    Memory(Vec<T>),
    /// The bytes of the values, from the first of them on.
    File(MapMut, PhantomData<T>),
}

impl<T: Pod> LongList<T> {
    /// A list of so many zeros. If no file can be made, or the disk has no room for it, the list is in
    /// memory, and the user [is told](ListStorage::tell_refusal).
    pub fn zeros(count: usize, storage: &ListStorage) -> Self {
        let in_memory = || Self(Held::Memory(memory::zeros(count)));
        match storage {
            ListStorage::Files(folder) if count * size_of::<T>() >= LONG => {
                let bytes = (count * size_of::<T>()) as u64;
                let map = Scratch::new(&folder.path, "").and_then(|file| file.zeros(bytes));
                map.map_or_else(
                    |_| {
                        folder.refused.fetch_add(bytes, Ordering::Relaxed);
                        in_memory()
                    },
                    |map| Self(Held::File(map, PhantomData)),
                )
            }
            _ => in_memory(),
        }
    }
}

impl<T: Pod> LongList<T> {
    /// All values in order, for a pass that looks at each once: the pages that they are in leave the process'
    /// memory behind it.
    pub fn pass(&self) -> impl Iterator<Item = &T> {
        let is_file = matches!(self.0, Held::File(..));
        self.chunks(LONG / size_of::<T>().max(1)).flat_map(move |values| {
            if is_file {
                mapped::looked_at(size_of_val(values));
            }
            values
        })
    }
}

impl LongList<u8> {
    /// Reads a whole file of at most `most` bytes.
    ///
    /// # Errors
    /// As of [`input::read`].
    pub fn read(path: &Path, most: u64, storage: &ListStorage) -> Result<Self> {
        if storage.folder().is_none() {
            return input::read(path, most).map(Self::from);
        }
        let mut file = input::open(path)?;
        let failed = |e: io::Error| Error::io("read", path, &e);
        let length = file.metadata().map_err(failed)?.len();
        if length > most {
            return Err(input::too_long(path, most));
        }
        let mut bytes = Self::zeros(length as usize, storage);
        for part in bytes.chunks_mut(LONG) {
            file.read_exact(part).map_err(failed)?;
            storage.gone_through(part.len());
        }
        Ok(bytes)
    }
}

impl<T> From<Vec<T>> for LongList<T> {
    fn from(list: Vec<T>) -> Self {
        Self(Held::Memory(list))
    }
}

impl<T> Default for LongList<T> {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl<T: Pod> Deref for LongList<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match &self.0 {
            Held::Memory(list) => list,
            Held::File(map, _) => bytemuck::cast_slice(map),
        }
    }
}

impl<T: Pod> DerefMut for LongList<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.0 {
            Held::Memory(list) => list,
            Held::File(map, _) => bytemuck::cast_slice_mut(map),
        }
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for LongList<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self[..].fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_the_same_in_memory_and_in_files() {
        let folder = tempfile::tempdir().unwrap();
        for count in [0, 1, 1000, 1 << 18, (1 << 18) + 1, 3 << 18] {
            let storages = [ListStorage::Memory, ListStorage::in_folder(folder.path())];
            let [memory, file] = storages.map(|storage| {
                let mut list = LongList::<u32>::zeros(count, &storage);
                assert_eq!(list.len(), count);
                assert!(list.iter().all(|x| *x == 0));
                list.iter_mut().zip(1..).for_each(|(x, i)| *x = i);
                storage.gone_through(1 << 30);
                list
            });
            assert!(matches!(memory.0, Held::Memory(_)));
            assert_eq!(matches!(file.0, Held::File(..)), 4 * count >= LONG, "{count}");
            assert!(memory[..] == file[..]);
            assert!(file.pass().eq(&memory[..]));
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the files have no names");
    }

    #[test]
    fn files_are_read_alike_into_memory_and_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bytes");
        let bytes: Vec<u8> = (0..5 << 19).map(|i: u32| (i % 251) as u8).collect();
        crate::output::write_file(&path, &bytes).unwrap();
        for storage in [ListStorage::Memory, ListStorage::in_folder(folder.path())] {
            let all = bytes.len() as u64;
            assert!(LongList::read(&path, all, &storage).unwrap()[..] == bytes[..]);
            assert!(LongList::read(&path, all - 1, &storage).is_err());
            assert!(LongList::read(folder.path(), all, &storage).is_err());
        }
    }

    #[test]
    fn lists_beyond_the_limit_are_in_files_where_these_can_be_written() {
        let folder = tempfile::tempdir().unwrap();
        let place =
            |bytes, folder: &Path| ListStorage::for_bytes(bytes, 1000, folder).folder().map(Path::to_owned);
        assert_eq!(place(1000, folder.path()), None);
        assert_eq!(place(1001, folder.path()), Some(folder.path().to_owned()));
        let nowhere = folder.path().join("nowhere");
        assert_eq!(place(1001, &nowhere), Some(std::env::temp_dir()));
    }

    #[test]
    fn lists_that_files_have_no_room_for_are_in_memory_and_told() {
        let folder = tempfile::tempdir().unwrap();
        let storage = ListStorage::in_folder(folder.path());
        let is_in_memory =
            |count, storage: &ListStorage| matches!(LongList::<u8>::zeros(count, storage).0, Held::Memory(_));
        assert!(!is_in_memory(LONG, &storage));
        assert_eq!(storage.refusal(), None);
        let nowhere = ListStorage::in_folder(&folder.path().join("nowhere"));
        // Short ones are in memory anyhow.
        assert!(is_in_memory(LONG - 1, &nowhere));
        assert_eq!(nowhere.refusal(), None);
        assert!(is_in_memory(2_000_000, &nowhere) && is_in_memory(3_000_000, &nowhere.clone()));
        let told = nowhere.refusal().unwrap();
        assert!(told.starts_with("lists of the samples take 5.0 MB of memory, as "), "{told}");
        assert!(told.contains("nowhere has no room"), "{told}");
        assert_eq!(nowhere.refusal(), None, "once");
    }
}
