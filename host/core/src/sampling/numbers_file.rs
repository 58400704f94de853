//! Lists of numbers in a file, which units of work leave each other of vertices and faces.
//!
//! Each list is in blocks, which may lie among those of the others; a table of their offsets and hashes is at
//! the file's end.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use simod_model::output::OutputFile;
use simod_model::{Error, Result, input};
use xxhash_rust::xxh3::xxh3_128;

use super::clustered_file::refused;
use crate::sealed::{read_end, seal};

/// First letters of the end of a file.
const LETTERS: &[u8; 8] = b"simodnum";

const VERSION: u32 = 1;

/// Bytes of all lists together that are collected before they are written, and of one list.
const BUFFERS: usize = 32 << 20;
const BUFFER: Range<usize> = 4 << 10..256 << 10;

/// Largest number of bytes of the table at a file's end.
const LONGEST: u64 = 4 << 30;

const BYTES: usize = size_of::<u32>();

/// The place of a block.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct NumberBlock {
    at: u64,
    numbers: u64,
    hash: u128,
}

/// Table at the end of a file.
#[derive(Serialize, Deserialize)]
struct NumberTable {
    /// Key of the content that the file is for.
    key: u128,
    /// The blocks of each list.
    lists: Vec<Vec<NumberBlock>>,
}

/// A file in the making, which appears whole or not at all.
///
/// Memory: [`BUFFERS`], or 4 KiB for each list that is not closed, and 32 bytes for each block.
pub struct NumbersWriter {
    file: OutputFile,
    path: PathBuf,
    at: u64,
    buffers: Vec<Vec<u8>>,
    most: usize,
    table: NumberTable,
}

impl NumbersWriter {
    /// Begins a file of `lists` lists.
    ///
    /// # Errors
    /// The file cannot be made, or another process makes it.
    pub fn create(path: &Path, key: u128, lists: usize) -> Result<Self> {
        Ok(Self {
            file: OutputFile::create(path, 0)?,
            path: path.to_owned(),
            at: 0,
            buffers: vec![Vec::new(); lists],
            most: (BUFFERS / lists.max(1)).clamp(BUFFER.start, BUFFER.end) / BYTES * BYTES,
            table: NumberTable { key, lists: vec![Vec::new(); lists] },
        })
    }

    /// Appends numbers to a list.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn push(&mut self, list: usize, numbers: &[u32]) -> Result<()> {
        let mut rest = numbers;
        while !rest.is_empty() {
            let buffer = &mut self.buffers[list];
            let some =
                rest.split_off(..rest.len().min((self.most - buffer.len()) / BYTES)).unwrap_or_default();
            some.iter().for_each(|number| buffer.extend_from_slice(&number.to_le_bytes()));
            if buffer.len() == self.most {
                self.close(list)?;
            }
        }
        Ok(())
    }

    /// Writes the numbers that are collected of a list, which may go on.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn close(&mut self, list: usize) -> Result<()> {
        let buffer = std::mem::take(&mut self.buffers[list]);
        if !buffer.is_empty() {
            self.file.write_all(&buffer).map_err(|e| Error::io("write", &self.path, &e))?;
            let numbers = (buffer.len() / BYTES) as u64;
            self.table.lists[list].push(NumberBlock { at: self.at, numbers, hash: xxh3_128(&buffer) });
            self.at += buffer.len() as u64;
        }
        Ok(())
    }

    /// Puts the file in its place.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub fn commit(mut self) -> Result<()> {
        (0..self.buffers.len()).try_for_each(|list| self.close(list))?;
        let table =
            seal(LETTERS, VERSION, &self.table).map_err(|e| Error::unwritable(self.path.display(), e))?;
        let failed = |e| Error::io("write", &self.path, &e);
        self.file.write_all(&table).map_err(failed)?;
        self.file.write_all(&(table.len() as u64).to_le_bytes()).map_err(failed)?;
        self.file.commit()
    }
}

/// Whether there is a whole file of this key.
pub fn is_there(path: &Path, key: u128) -> bool {
    NumbersFile::open(path, key).is_ok()
}

/// File of lists that was written. It is open only while a block is read, as there may be as many of them as
/// units.
///
/// Memory: 32 bytes for each block.
pub struct NumbersFile {
    path: PathBuf,
    lists: Vec<Vec<NumberBlock>>,
}

impl NumbersFile {
    /// Opens a file of this key.
    ///
    /// # Errors
    /// The file cannot be read, is damaged, or is of something else.
    pub fn open(path: &Path, key: u128) -> Result<Self> {
        let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
        let (_, table, end) = read_end::<NumberTable>(path, (LETTERS, VERSION), LONGEST, damaged)?;
        if table.key != key {
            return Err(refused(path, "is of another model, or for other samples"));
        }
        let is_inside = |block: &NumberBlock| {
            let bytes = block.numbers.checked_mul(BYTES as u64);
            bytes.and_then(|bytes| block.at.checked_add(bytes)).is_some_and(|behind| behind <= end)
        };
        let is_small = |block: &NumberBlock| block.numbers <= (BUFFER.end / BYTES) as u64;
        if !table.lists.iter().flatten().all(|block| is_inside(block) && is_small(block)) {
            return Err(damaged("a block lies outside"));
        }
        Ok(Self { path: path.to_owned(), lists: table.lists })
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Visits a list, a block at a time.
    ///
    /// Memory: a block, of 256 KiB at most, twice.
    ///
    /// # Errors
    /// The file cannot be read, or is damaged; `visit` failed.
    pub fn each(&self, list: usize, visit: impl FnMut(&[u32]) -> Result<()>) -> Result<()> {
        self.some(list, 0..u64::MAX, visit)
    }

    /// Reads the numbers at some places of the list.
    ///
    /// # Errors
    /// As of [`each`](Self::each).
    pub fn some(
        &self,
        list: usize,
        places: Range<u64>,
        mut visit: impl FnMut(&[u32]) -> Result<()>,
    ) -> Result<()> {
        let (mut first, mut numbers, mut file) = (0, Vec::new(), None);
        for block in self.lists.get(list).into_iter().flatten() {
            let own = first.max(places.start)..(first + block.numbers).min(places.end);
            if own.start < own.end {
                self.read(block, &mut file, &mut numbers)?;
                visit(&numbers[(own.start - first) as usize..(own.end - first) as usize])?;
            }
            first += block.numbers;
        }
        Ok(())
    }

    /// The numbers of a list one by one.
    pub fn one_by_one(&self, list: usize) -> OneByOne<'_> {
        OneByOne { of: self, list, next: 0, block: Vec::new(), at: 0 }
    }

    fn read(&self, block: &NumberBlock, file: &mut Option<File>, to: &mut Vec<u32>) -> Result<()> {
        let file = match file {
            Some(file) => file,
            none => none.insert(input::open(&self.path)?),
        };
        let failed = |e| Error::io("read", &self.path, &e);
        let mut bytes = vec![0; block.numbers as usize * BYTES];
        file.seek(SeekFrom::Start(block.at)).map_err(failed)?;
        file.read_exact(&mut bytes).map_err(failed)?;
        if xxh3_128(&bytes) != block.hash {
            return Err(refused(&self.path, "is damaged: a checksum is wrong"));
        }
        let (words, _) = bytes.as_chunks();
        to.clear();
        to.extend(words.iter().map(|word| u32::from_le_bytes(*word)));
        Ok(())
    }
}

/// Gives the numbers of a list one by one.
///
/// Memory: a block, twice.
pub struct OneByOne<'a> {
    of: &'a NumbersFile,
    list: usize,
    next: usize,
    block: Vec<u32>,
    at: usize,
}

impl OneByOne<'_> {
    /// The next number, if there is one.
    ///
    /// # Errors
    /// The file cannot be read, or is damaged.
    #[inline]
    pub fn next(&mut self) -> Result<Option<u32>> {
        while self.at == self.block.len() {
            let blocks = self.of.lists.get(self.list).map_or(&[][..], |blocks| blocks);
            let Some(block) = blocks.get(self.next) else { return Ok(None) };
            self.of.read(block, &mut None, &mut self.block)?;
            (self.next, self.at) = (self.next + 1, 0);
        }
        self.at += 1;
        Ok(Some(self.block[self.at - 1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lists_come_back_as_a_whole_and_in_part(
            parts in proptest::collection::vec((0usize..3, proptest::collection::vec(any::<u32>(), 0..90)), 0..40),
            from in 0u64..300, length in 0u64..300,
        ) {
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path().join("file");
            let mut writer = NumbersWriter::create(&path, 7, 3).expect("a file");
            writer.most = 100;
            let mut expected = vec![Vec::new(); 3];
            for (list, numbers) in &parts {
                writer.push(*list, numbers).expect("room");
                expected[*list].extend_from_slice(numbers);
            }
            prop_assert!(!path.exists());
            writer.commit().expect("room");
            let file = NumbersFile::open(&path, 7).expect("a file");
            prop_assert!(NumbersFile::open(&path, 8).is_err());
            for (list, expected) in expected.iter().enumerate() {
                let mut found = Vec::new();
                file.each(list, |some| { found.extend_from_slice(some); Ok(()) }).expect("readable");
                prop_assert_eq!(&found, expected);
                found.clear();
                let mut numbers = file.one_by_one(list);
                while let Some(number) = numbers.next().expect("readable") { found.push(number); }
                prop_assert_eq!(&found, expected);
                found.clear();
                file.some(list, from..from + length, |some| { found.extend_from_slice(some); Ok(()) })
                    .expect("readable");
                let part: Vec<u32> =
                    expected.iter().skip(from as usize).take(length as usize).copied().collect();
                prop_assert_eq!(&found, &part);
            }
        }
    }

    #[test]
    fn damage_is_noticed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        let mut writer = NumbersWriter::create(&path, 1, 2).expect("a file");
        (0..2).for_each(|list| writer.push(list, &[1, 2, 3, u32::MAX]).expect("room"));
        writer.commit().expect("room");
        let read_all = || -> Result<()> {
            let file = NumbersFile::open(&path, 1)?;
            (0..2).try_for_each(|list| file.each(list, |_| Ok(())))
        };
        read_all().expect("as it was written");
        let bytes = std::fs::read(&path).expect("the file");
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 4;
            simod_model::output::write_file(&path, &changed).expect("room");
            read_all().expect_err("changed");
            simod_model::output::write_file(&path, &bytes[..at]).expect("room");
            read_all().expect_err("cut off");
        }
    }
}
