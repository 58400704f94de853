//! Vertices of cells that ranges of the stream share: each range writes those that it meets to a file, piece
//! by piece, and who clusters a group of cells reads those of the group from the files of all ranges, in the
//! order of the stream.
//!
//! A file has blocks, each of records of one group; a table of their offsets and hashes is at its end. A
//! record has the part of a group in one piece of the stream: its visits to cells, and the vertices'
//! positions and normals as they are clustered, in local coordinates.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::Vec3;
use serde::{Deserialize, Serialize};
use simod_model::output::OutputFile;
use simod_model::{Error, Result, input};
use xxhash_rust::xxh3::xxh3_128;

use super::shares::PIECE;
use crate::sealed::{read_end, seal};
use crate::varint::{self, VarintNumbers};

/// First letters of the end of a file.
const LETTERS: &[u8; 8] = b"simodshv";

const VERSION: u32 = 1;

/// Bytes that are collected before they are written: of all groups together, and of one.
const BUFFERS: usize = 32 << 20;
const BUFFER: Range<usize> = 4 << 10..256 << 10;

/// Largest number of bytes of the table at a file's end.
const LONGEST: u64 = 4 << 30;

/// Bytes of a vertex besides its position and its normal, at most.
const VISIT_BYTES: u64 = 14;

/// Largest number of bytes of `vertices` shared vertices, if each is a visit of its own, as where vertices
/// come in no order.
pub fn bytes_at_most(vertices: u64, with_normals: bool) -> u64 {
    vertices.saturating_mul(VISIT_BYTES + bytes_of(with_normals))
}

/// Bytes of a vertex itself.
pub fn bytes_of(with_normals: bool) -> u64 {
    if with_normals { 24 } else { 12 }
}

/// A visit of the stream to a cell, within one piece.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Visit {
    pub cell: u32,
    /// Vertices from the cell's first one to before the first one elsewhere.
    pub vertices: Range<u64>,
    /// Number of these vertices that are in the cell: others are nowhere.
    pub finite: u32,
}

/// Vertices of some cells in a piece of the stream.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SharedPiece {
    pub visits: Vec<Visit>,
    /// The positions of all visits, one after another, in local coordinates.
    pub positions: Vec<Vec3>,
    /// Unit normals of these vertices; zero where they are not known.
    pub normals: Vec<Vec3>,
}

impl SharedPiece {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.visits.clear();
        self.positions.clear();
        self.normals.clear();
    }

    /// Adds a vertex to the last visit.
    #[inline]
    pub fn add(&mut self, position: Vec3, normal: Vec3) {
        if let Some(visit) = self.visits.last_mut() {
            visit.finite += 1;
            self.positions.push(position);
            self.normals.push(normal);
        }
    }

    /// A record of the visits of each group, by `group_of` cells; `None` if one is of no group.
    pub fn records(&self, group_of: impl Fn(u32) -> Option<u32>) -> Option<Vec<(u32, Vec<u8>)>> {
        let mut first = 0;
        let mut visits: Vec<(u32, usize, &Visit)> = Vec::with_capacity(self.visits.len());
        for visit in &self.visits {
            visits.push((group_of(visit.cell)?, first, visit));
            first += visit.finite as usize;
        }
        // The visits of a group stay in their order.
        visits.sort_by_key(|(group, ..)| *group);
        let of_group = visits.chunk_by(|a, b| a.0 == b.0);
        Some(of_group.map(|visits| (visits[0].0, self.record(visits))).collect())
    }

    fn record(&self, visits: &[(u32, usize, &Visit)]) -> Vec<u8> {
        let of = |first: usize, visit: &Visit| first..first + visit.finite as usize;
        let normals = || visits.iter().flat_map(|(_, first, visit)| &self.normals[of(*first, visit)]);
        let with_normals = normals().any(|normal| *normal != Vec3::ZERO);
        let piece = visits.first().map_or(0, |(.., visit)| visit.vertices.start / PIECE);
        let mut bytes = Vec::new();
        varint::push(piece, &mut bytes);
        varint::push(visits.len() as u64, &mut bytes);
        varint::push(u64::from(with_normals), &mut bytes);
        let mut end = piece * PIECE;
        for (.., Visit { cell, vertices, finite }) in visits {
            let length = vertices.end - vertices.start;
            let is_whole = length == u64::from(*finite);
            varint::push(u64::from(*cell), &mut bytes);
            varint::push(vertices.start - end, &mut bytes);
            varint::push(length << 1 | u64::from(!is_whole), &mut bytes);
            if !is_whole {
                varint::push(u64::from(*finite), &mut bytes);
            }
            end = vertices.end;
        }
        let mut put = |v: &Vec3| v.to_array().iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
        visits.iter().flat_map(|(_, first, visit)| &self.positions[of(*first, visit)]).for_each(&mut put);
        if with_normals {
            normals().for_each(&mut put);
        }
        bytes
    }

    /// Replaces the content by that of a record; `None` if the record makes no sense.
    fn read(&mut self, record: &[u8]) -> Option<()> {
        self.clear();
        let mut numbers = VarintNumbers(record);
        let (piece, count, with_normals) = (numbers.next()?, numbers.next()?, numbers.next()?);
        let mut end = piece.checked_mul(PIECE)?;
        let last = end.checked_add(PIECE)?;
        for _ in 0..count {
            let cell = u32::try_from(numbers.next()?).ok()?;
            let start = end.checked_add(numbers.next()?)?;
            let length = numbers.next()?;
            let finite = if length & 1 == 1 { numbers.next()? } else { length >> 1 };
            end = start.checked_add(length >> 1)?;
            let finite = u32::try_from(finite).ok().filter(|n| u64::from(*n) <= length >> 1)?;
            if end > last || start == end {
                return None;
            }
            self.visits.push(Visit { cell, vertices: start..end, finite });
        }
        let all: usize = self.visits.iter().map(|visit| visit.finite as usize).sum();
        let (vectors, rest) = numbers.0.as_chunks::<12>();
        if !rest.is_empty() || with_normals > 1 || vectors.len() != all << with_normals {
            return None;
        }
        let vector = |bytes: &[u8; 12]| {
            let (words, _) = bytes.as_chunks();
            Vec3::from_array([0, 1, 2].map(|i: usize| f32::from_le_bytes(words[i])))
        };
        let (positions, normals) = vectors.split_at(all);
        self.positions.extend(positions.iter().map(vector));
        self.normals.extend(normals.iter().map(vector));
        self.normals.resize(all, Vec3::ZERO);
        self.positions.iter().chain(&self.normals).all(|v| v.is_finite()).then_some(())
    }
}

/// The place of a block.
#[derive(Serialize, Deserialize)]
struct RecordBlock {
    at: u64,
    bytes: u64,
    records: u64,
    hash: u128,
}

/// Table at the end of a file.
#[derive(Serialize, Deserialize)]
struct SharedVertexTable {
    /// Key of the content that the file is for.
    key: u128,
    /// Whether all vertices are in the file: none are needed where groups found no room.
    is_whole: bool,
    /// The blocks of each group.
    groups: Vec<Vec<RecordBlock>>,
}

/// The file of a range in the making, which appears whole or not at all.
///
/// Memory: [`BUFFERS`], or 4 KiB for each group, and 64 bytes for each block.
pub struct SharedWriter {
    file: OutputFile,
    path: PathBuf,
    at: u64,
    buffers: Vec<(Vec<u8>, u64)>,
    most: usize,
    table: SharedVertexTable,
}

impl SharedWriter {
    /// Begins the file of a range, for `groups` groups.
    ///
    /// # Errors
    /// The file cannot be made, or another process makes it.
    pub fn create(path: &Path, key: u128, groups: u32) -> Result<Self> {
        let (mut buffers, mut blocks) = (Vec::new(), Vec::new());
        buffers.resize_with(groups as usize, Default::default);
        blocks.resize_with(groups as usize, Vec::new);
        Ok(Self {
            file: OutputFile::create(path, 0)?,
            path: path.to_owned(),
            at: 0,
            most: (BUFFERS / buffers.len().max(1)).clamp(BUFFER.start, BUFFER.end),
            buffers,
            table: SharedVertexTable { key, is_whole: true, groups: blocks },
        })
    }

    /// Adds the [records](SharedPiece::records) of the piece that comes next.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn append(&mut self, records: &[(u32, Vec<u8>)]) -> Result<()> {
        for (group, record) in records {
            let (buffer, count) = &mut self.buffers[*group as usize];
            buffer.extend_from_slice(&(record.len() as u32).to_le_bytes());
            buffer.extend_from_slice(record);
            *count += 1;
            if buffer.len() >= self.most {
                self.flush(*group as usize)?;
            }
        }
        Ok(())
    }

    fn flush(&mut self, group: usize) -> Result<()> {
        let (buffer, records) = &mut self.buffers[group];
        let block = RecordBlock {
            at: self.at,
            bytes: buffer.len() as u64,
            records: *records,
            hash: xxh3_128(buffer),
        };
        self.file.write_all(buffer).map_err(|e| Error::io("write", &self.path, &e))?;
        self.at += block.bytes;
        self.table.groups[group].push(block);
        buffer.clear();
        *records = 0;
        Ok(())
    }

    /// Puts the file in its place, whether it has all vertices or not; returns the number of its bytes.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub fn commit(mut self, is_whole: bool) -> Result<u64> {
        self.table.is_whole = is_whole;
        for group in 0..self.buffers.len() {
            if self.buffers[group].1 > 0 {
                self.flush(group)?;
            }
        }
        let table =
            seal(LETTERS, VERSION, &self.table).map_err(|e| Error::unwritable(self.path.display(), e))?;
        let failed = |e| Error::io("write", &self.path, &e);
        self.file.write_all(&table).map_err(failed)?;
        self.file.write_all(&(table.len() as u64).to_le_bytes()).map_err(failed)?;
        self.file.commit()?;
        Ok(self.at + table.len() as u64 + 8)
    }
}

/// Whether there is a whole file of this key.
pub fn is_there(path: &Path, key: u128) -> bool {
    read_table(path).is_ok_and(|(_, table)| table.key == key)
}

fn read_table(path: &Path) -> Result<(File, SharedVertexTable)> {
    let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
    let (file, table, _) = read_end(path, (LETTERS, VERSION), LONGEST, damaged)?;
    Ok((file, table))
}

fn refused(path: &Path, what: &str) -> Error {
    Error::mismatch(
        format!("{} {what}", path.display()),
        "remove it and the trees of its range beside it, and cluster that range again",
    )
}

/// Reads the vertices of a group from the files of all ranges.
///
/// Memory: 48 bytes for each block of the group, and a block.
pub struct SharedReader {
    /// Files in the order of the ranges; of each file those blocks that are still to be read, the last one
    /// first.
    files: Vec<(PathBuf, Vec<RecordBlock>)>,
    open: Option<File>,
    at: usize,
    block: Vec<u8>,
    /// Offset of the next record in the block.
    next: usize,
    records: u64,
}

impl SharedReader {
    /// A reader of the files of these ranges, in their order, with their keys; `None` if one does not have
    /// all vertices.
    ///
    /// # Errors
    /// One cannot be read, is damaged, or is of something else.
    pub fn open(files: &[(&Path, u128)], group: u32) -> Result<Option<Self>> {
        let (mut blocks, mut records) = (Vec::new(), 0);
        for (path, key) in files {
            let (_, mut table) = read_table(path)?;
            if table.key != *key {
                return Err(refused(path, "has vertices of another model, or for other samples"));
            }
            if !table.is_whole {
                return Ok(None);
            }
            let of_group = table.groups.get_mut(group as usize).map(std::mem::take);
            let mut of_group = of_group.ok_or_else(|| refused(path, "is damaged: it lacks a group"))?;
            records += of_group.iter().map(|block| block.records).sum::<u64>();
            of_group.reverse();
            blocks.push(((*path).to_owned(), of_group));
        }
        Ok(Some(Self { files: blocks, open: None, at: 0, block: Vec::new(), next: 0, records }))
    }

    /// Bytes of the blocks that are still to be read.
    pub fn bytes(&self) -> u64 {
        self.files.iter().flat_map(|(_, blocks)| blocks).map(|block| block.bytes).sum()
    }

    /// Number of records in all.
    pub fn records(&self) -> u64 {
        self.records
    }

    /// Reads the next record, in the order of the stream; returns the number of its bytes.
    ///
    /// # Errors
    /// A file cannot be read, or is damaged; there is no record left.
    pub fn read(&mut self, to: &mut SharedPiece) -> Result<u64> {
        while self.next == self.block.len() {
            self.read_block()?;
        }
        let record = self.block[self.next..]
            .split_first_chunk()
            .and_then(|(length, rest)| rest.get(..u32::from_le_bytes(*length) as usize));
        let length = record.map_or(0, <[u8]>::len);
        if record.and_then(|record| to.read(record)).is_none() {
            return Err(refused(&self.files[self.at].0, "is damaged: a record makes no sense"));
        }
        self.next += 4 + length;
        Ok(length as u64 + 4)
    }

    fn read_block(&mut self) -> Result<()> {
        let Some((path, blocks)) = self.files.get_mut(self.at) else {
            return Err(Error::internal("shared vertices are read beyond their end"));
        };
        let Some(block) = blocks.pop() else {
            (self.open, self.at) = (None, self.at + 1);
            return Ok(());
        };
        let file = match &mut self.open {
            Some(file) => file,
            none => none.insert(input::open(path)?),
        };
        let failed = |e| Error::io("read", path, &e);
        if block.bytes > file.metadata().map_err(failed)?.len() {
            return Err(refused(path, "is damaged: it is cut off"));
        }
        self.block.resize(block.bytes as usize, 0);
        file.seek(SeekFrom::Start(block.at)).map_err(failed)?;
        file.read_exact(&mut self.block).map_err(failed)?;
        if xxh3_128(&self.block) != block.hash {
            return Err(refused(path, "is damaged: a checksum is wrong"));
        }
        self.next = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Visits by cell: the vertices before the visit, its length, and the number of those that are nowhere;
    /// and whether there are normals.
    type Made = (Vec<(u32, u64, u64, u32)>, bool);

    /// Pieces with visits to cells, the longest of a few vertices.
    fn pieces() -> impl Strategy<Value = Vec<SharedPiece>> {
        let visit = (0u32..40, 0u64..50, 1u64..60, 0u32..3);
        let piece = (proptest::collection::vec(visit, 1..40), any::<bool>());
        proptest::collection::vec(piece, 1..12).prop_map(|pieces| {
            let one = |(piece, (visits, with_normals)): (u64, Made)| {
                let (mut made, mut at) = (SharedPiece::default(), piece * PIECE);
                for (cell, gap, length, lost) in visits {
                    let vertices = at + gap..at + gap + length;
                    at = vertices.end;
                    let finite = (length as u32).saturating_sub(lost);
                    for i in 0..finite {
                        let x = (vertices.start + u64::from(i)) as f32;
                        made.positions.push(Vec3::new(x, -x, cell as f32));
                        made.normals.push(if with_normals && i % 2 == 0 { Vec3::Y } else { Vec3::ZERO });
                    }
                    made.visits.push(Visit { cell, vertices, finite });
                }
                made
            };
            (0..).zip(pieces).map(one).collect()
        })
    }

    /// The part of a piece that is of some cells.
    fn part(piece: &SharedPiece, is: impl Fn(u32) -> bool) -> SharedPiece {
        let (mut part, mut first) = (SharedPiece::default(), 0);
        for visit in &piece.visits {
            let of = first..first + visit.finite as usize;
            first = of.end;
            if is(visit.cell) {
                part.positions.extend_from_slice(&piece.positions[of.clone()]);
                part.normals.extend_from_slice(&piece.normals[of]);
                part.visits.push(visit.clone());
            }
        }
        part
    }

    proptest! {
        #[test]
        fn each_group_gets_its_vertices_back(pieces in pieces(), groups in 1u32..6, cut in 0usize..12) {
            let folder = tempfile::tempdir().expect("a folder");
            let files = ["a", "b"].map(|name| folder.path().join(name));
            let (first, second) = pieces.split_at(cut.min(pieces.len()));
            for (path, pieces) in files.iter().zip([first, second]) {
                let mut writer = SharedWriter::create(path, 7, groups).expect("a file");
                writer.most = 300;
                let mut bytes = 0;
                for piece in pieces {
                    let records = piece.records(|cell| Some(cell % groups)).expect("groups");
                    bytes += records.iter().map(|(_, record)| record.len() as u64).sum::<u64>();
                    writer.append(&records).expect("space");
                }
                let vertices: usize = pieces.iter().map(|piece| piece.positions.len()).sum();
                let visits: usize = pieces.iter().map(|piece| piece.visits.len()).sum();
                prop_assert!(bytes <= bytes_at_most(vertices.max(visits) as u64, true) + 12 * visits as u64);
                prop_assert!(!path.exists());
                let length = writer.commit(true).expect("space");
                prop_assert_eq!(length, path.metadata().expect("a file").len());
                prop_assert!(is_there(path, 7) && !is_there(path, 8));
            }
            for group in 0..groups {
                let keyed = files.each_ref().map(|path| (path.as_path(), 7));
                let mut reader = SharedReader::open(&keyed, group).expect("files").expect("all");
                let expected: Vec<_> = pieces.iter().map(|piece| part(piece, |cell| cell % groups == group))
                    .filter(|piece| !piece.visits.is_empty()).collect();
                prop_assert_eq!(reader.records(), expected.len() as u64);
                let mut found = SharedPiece::default();
                for expected in expected {
                    reader.read(&mut found).expect("a record");
                    prop_assert_eq!(&found, &expected);
                }
                prop_assert!(reader.read(&mut found).is_err());
            }
        }
    }

    #[test]
    fn damage_is_noticed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        let visit = |cell: u32| Visit { cell, vertices: u64::from(cell)..u64::from(cell) + 1, finite: 1 };
        let (positions, normals) = (vec![Vec3::X; 20], vec![Vec3::Y; 20]);
        let piece = SharedPiece { visits: (0..20).map(visit).collect(), positions, normals };
        let mut writer = SharedWriter::create(&path, 1, 2).expect("a file");
        writer.append(&piece.records(|cell| Some(cell % 2)).expect("groups")).expect("space");
        writer.commit(true).expect("space");
        let read_all = || -> Result<()> {
            for group in 0..2 {
                let mut reader = SharedReader::open(&[(&path, 1)], group)?.expect("all");
                let mut found = SharedPiece::default();
                (0..reader.records()).try_for_each(|_| reader.read(&mut found).map(drop))?;
            }
            Ok(())
        };
        read_all().expect("as it was written");
        SharedReader::open(&[(&path, 2)], 0).err().expect("another key");
        let bytes = std::fs::read(&path).expect("the file");
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 4;
            simod_model::output::write_file(&path, &changed).expect("space");
            read_all().expect_err("changed");
            simod_model::output::write_file(&path, &bytes[..at]).expect("space");
            read_all().expect_err("cut off");
        }
    }
}
