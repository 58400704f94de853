//! Long lists of plain values, as those of P_S: in memory, or, where all of them together would take too
//! much, in temporary files that are mapped.

use std::fmt;
use std::io::{self, Read};
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};

use bytemuck::Pod;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::mapped::{self, MapMut};
use crate::scratch::Scratch;
use crate::{Error, Result, input, memory};

/// Bytes from which on a list is long: shorter ones are in memory wherever the others are.
const LONG: usize = 1 << 20;

/// The place of long lists.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum ListStorage {
    /// Memory.
    #[default]
    Memory,
    /// Temporary files in a folder, without a name. Their pages are the system's to keep or to write down,
    /// and leave the process' memory as lists are [gone through](Self::gone_through).
    Files(PathBuf),
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
        // The same folder where the process' own changes.
        Self::Files(std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()))
    }

    /// Tells that about so many bytes of lists were gone through, and others follow: from time to time the
    /// pages of those in files leave the process' memory.
    #[inline]
    pub fn gone_through(&self, bytes: usize) {
        if *self != Self::Memory {
            mapped::looked_at(bytes);
        }
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
    /// memory.
    pub fn zeros(count: usize, storage: &ListStorage) -> Self {
        let in_memory = || Self(Held::Memory(memory::zeros(count)));
        match storage {
            ListStorage::Files(folder) if count * size_of::<T>() >= LONG => {
                let map =
                    Scratch::new(folder, "").and_then(|file| file.zeros((count * size_of::<T>()) as u64));
                map.map_or_else(|_| in_memory(), |map| Self(Held::File(map, PhantomData)))
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
        if *storage == ListStorage::Memory {
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

impl<T: Pod + Serialize> Serialize for LongList<T> {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        self[..].serialize(to)
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for LongList<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> std::result::Result<Self, D::Error> {
        Vec::deserialize(from).map(Self::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_the_same_in_memory_and_in_files() {
        let folder = tempfile::tempdir().unwrap();
        for count in [0, 1, 1000, 1 << 18, (1 << 18) + 1, 3 << 18] {
            let storages = [ListStorage::Memory, ListStorage::Files(folder.path().to_owned())];
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
        for storage in [ListStorage::Memory, ListStorage::Files(folder.path().to_owned())] {
            let all = bytes.len() as u64;
            assert!(LongList::read(&path, all, &storage).unwrap()[..] == bytes[..]);
            assert!(LongList::read(&path, all - 1, &storage).is_err());
            assert!(LongList::read(folder.path(), all, &storage).is_err());
        }
    }

    #[test]
    fn lists_beyond_the_limit_are_in_files_where_these_can_be_written() {
        let folder = tempfile::tempdir().unwrap();
        let place = |bytes, folder: &Path| ListStorage::for_bytes(bytes, 1000, folder);
        assert_eq!(place(1000, folder.path()), ListStorage::Memory);
        assert_eq!(place(1001, folder.path()), ListStorage::Files(folder.path().to_owned()));
        let nowhere = folder.path().join("nowhere");
        assert_eq!(place(1001, &nowhere), ListStorage::Files(std::env::temp_dir()));
        // Where even that cannot be written, lists are in memory.
        let list = LongList::<u32>::zeros(1 << 19, &ListStorage::Files(nowhere));
        assert!(matches!(list.0, Held::Memory(_)));
    }
}
