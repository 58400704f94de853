//! Blocks of compressed points: their places, and the table in the file that lists them (LASzip's chunk
//! table).

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use laz::LazVlrBuilder;
use laz::laszip::{ChunkTable, ChunkTableEntry};

use super::header::{CUT_OFF, DAMAGED, LasHeader};
use super::laszip::{BlockLengths, Laszip};
use crate::model::CompressedBlock;
use crate::source::SourceFile;
use crate::{CHUNK_VERTICES, Result};

/// Most vertices of a block: a bound of what a thread holds.
pub(super) const MOST_VERTICES: u64 = 1 << 18;

/// Bytes of the table's place, before the first block.
pub(super) const PLACE: u64 = 8;

const TOO_LARGE: &str = "write it in blocks of the usual size first, as `laszip` or `pdal translate` do: \
                         `pdal translate IN.laz OUT.laz`";

/// The blocks of a file.
///
/// Memory: 16 bytes for each.
#[derive(Debug)]
pub(super) struct LasBlocks {
    /// First vertex of each block, and the byte at which the block begins; in the end, the byte at which the
    /// last one ends.
    starts: Vec<(u64, u64)>,
    /// Range of bytes of the table, if the file has one.
    pub table: Option<Range<u64>>,
    /// Whether the last bytes of the file are the place of the table.
    pub is_told_at_end: bool,
    is_variable: bool,
}

impl LasBlocks {
    /// Memory: besides, the table.
    pub fn read(source: &SourceFile, header: &LasHeader, laszip: &Laszip) -> Result<Self> {
        let is_variable = laszip.blocks == BlockLengths::Variable;
        // Byte at which the points end at the latest.
        let end = header.evlrs.map_or(source.len(), |(start, _)| start);
        let mut this = Self { starts: Vec::new(), table: None, is_told_at_end: false, is_variable };
        if laszip.blocks == BlockLengths::One {
            this.starts = vec![(0, header.points), (header.count, end.max(header.points))];
        } else if header.count == 0 && source.len() < header.points + PLACE {
            this.starts = vec![(0, header.points)];
        } else {
            match this.place(source, header)? {
                Some(at) => this.read_table(source, header, laszip, at)?,
                None => this.find(source, header, laszip, end)?,
            }
        }
        this.check(source, header)?;
        Ok(this)
    }

    /// The place of the table.
    fn place(&mut self, source: &SourceFile, header: &LasHeader) -> Result<Option<u64>> {
        let place = |at: u64| -> Result<Option<u64>> {
            let mut bytes = [0; 8];
            if source.read_at(&mut bytes, at)? < bytes.len() {
                return Err(source.malformed("the file ends where its compressed points begin", CUT_OFF));
            }
            Ok(u64::try_from(i64::from_le_bytes(bytes)).ok())
        };
        let first = header.points + PLACE;
        let fits = |at: &u64| *at >= first && *at <= source.len().saturating_sub(8);
        match place(header.points)? {
            Some(at) if fits(&at) => Ok(Some(at)),
            Some(at) if at >= first => {
                let what = format!(
                    "the table of compressed blocks is said to be at byte {at}, but the file has {} bytes",
                    source.len()
                );
                Err(source.malformed(what, CUT_OFF))
            }
            // A program that could not go back wrote it at the end.
            _ => {
                let told = place(source.len().saturating_sub(8).max(header.points))?.filter(fits);
                self.is_told_at_end = told.is_some();
                Ok(told)
            }
        }
    }

    fn read_table(
        &mut self,
        source: &SourceFile,
        header: &LasHeader,
        laszip: &Laszip,
        at: u64,
    ) -> Result<()> {
        let wrong = |what: String| {
            source.malformed(format!("the table of compressed blocks at byte {at}: {what}"), DAMAGED)
        };
        let mut head = [0; 8];
        source.read_at(&mut head, at)?;
        let count = u64::from(u32::from_le_bytes([head[4], head[5], head[6], head[7]]));
        let room = at - header.points - PLACE;
        // A block has a point as it is, at least; but for one of no points.
        if count > room / header.record as u64 + 1 {
            return Err(wrong(format!("it has {count} blocks, but the points have {room} bytes")));
        }
        let mut reader = ByteStream::new(source, at);
        let table = ChunkTable::read(&mut reader, self.is_variable).map_err(|e| wrong(e.to_string()))?;
        let (points, mut vertex, mut byte) = (header.count, 0u64, header.points + PLACE);
        self.starts.reserve(table.len() + 1);
        for entry in &table {
            self.starts.push((vertex, byte));
            let left = points - vertex;
            let vertices = match laszip.blocks {
                BlockLengths::Fixed(size) => u64::from(size).min(left),
                // The library takes counts beyond its signed type for negative numbers.
                _ => u64::from(entry.point_count as u32),
            };
            if vertices > left {
                return Err(wrong(format!("its blocks have more than the {points} points of the file")));
            }
            vertex += vertices;
            byte += u64::from(entry.byte_count as u32);
            if byte > at {
                return Err(wrong("its blocks go on beyond it".to_owned()));
            }
        }
        self.starts.push((vertex, byte));
        if vertex < points {
            return Err(wrong(format!("its blocks have {vertex} of the {points} points of the file")));
        }
        // The length of the table follows only from encoding it anew, as the bytes behind it may be anything.
        let again = table_of(table.as_ref(), self.is_variable).map_err(|e| wrong(e.to_string()))?;
        self.table = Some(self.extent(source, header, at, &again)?);
        Ok(())
    }

    /// Range of bytes of the table that begins at a byte and is encoded anew as `again`; where the file has
    /// other bytes there, the range goes up to the next thing in the file.
    fn extent(&self, source: &SourceFile, header: &LasHeader, at: u64, again: &[u8]) -> Result<Range<u64>> {
        let mut there = Vec::new();
        source.append_at(&mut there, at, again.len())?;
        if there == again {
            return Ok(at..at + again.len() as u64);
        }
        let last = source.len() - if self.is_told_at_end { PLACE } else { 0 };
        Ok(at..header.evlrs.map_or(last, |(start, _)| start).max(at))
    }

    /// Finds the blocks of a file without a table, one after the other.
    fn find(&mut self, source: &SourceFile, header: &LasHeader, laszip: &Laszip, end: u64) -> Result<()> {
        if laszip.blocks == BlockLengths::Variable && !laszip.is_layered {
            let what = "there is no table of compressed blocks, and nothing else tells where these end";
            return Err(source.malformed(what, CUT_OFF));
        }
        let (mut vertex, mut byte) = (0, header.points + PLACE);
        while vertex < header.count {
            self.starts.push((vertex, byte));
            let most = match laszip.blocks {
                BlockLengths::Fixed(size) => u64::from(size).min(header.count - vertex),
                _ => header.count - vertex,
            };
            let measured = laszip.measure(ByteStream::new(source, byte), most);
            let wrong = |what| {
                let block = self.starts.len() - 1;
                let what = format!(
                    "there is no table of compressed blocks, and in block {block} at byte {byte}: {what}"
                );
                source.malformed(what, CUT_OFF)
            };
            let (vertices, bytes) = measured.map_err(wrong)?;
            if vertices == 0 || vertices > header.count - vertex || bytes > end - byte.min(end) {
                return Err(wrong(format!("{vertices} points in {bytes} bytes")));
            }
            (vertex, byte) = (vertex + vertices, byte + bytes);
        }
        self.starts.push((vertex, byte));
        Ok(())
    }

    /// An error where blocks are too large to be held, or too small to hold their points.
    fn check(&self, source: &SourceFile, header: &LasHeader) -> Result<()> {
        for (number, pair) in self.starts.windows(2).enumerate() {
            let [(first, start), (end, behind)] = pair else { continue };
            let (vertices, bytes) = (end - first, behind - start);
            if vertices > MOST_VERTICES {
                let what = format!(
                    "compressed block {number} at byte {start} has {vertices} points, and more than \
                     {MOST_VERTICES} cannot be held"
                );
                return Err(source.malformed(what, TOO_LARGE));
            }
            // Compression may make points longer, but never by much.
            let needed = if vertices > 0 { header.record as u64 } else { 0 };
            // Some programs end with a block of no points, of a few bytes.
            let is_idle = vertices == 0 && bytes > header.record as u64;
            if is_idle || bytes < needed || bytes > (vertices + 16) * (2 * header.record as u64 + 64) {
                let what = format!(
                    "compressed block {number} at byte {start} has {vertices} points in {bytes} bytes"
                );
                return Err(source.malformed(what, DAMAGED));
            }
        }
        Ok(())
    }

    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of vertices of all blocks.
    pub fn vertices(&self) -> u64 {
        self.starts[self.len()].0
    }

    /// The end of the blocks.
    pub fn end(&self) -> u64 {
        self.starts[self.len()].1
    }

    /// Bytes of all blocks.
    pub fn bytes(&self) -> u64 {
        self.end() - self.starts[0].1
    }

    /// The vertices and bytes of a block.
    pub fn block(&self, number: usize) -> CompressedBlock {
        let [(first, start), (end, behind)] = [self.starts[number], self.starts[number + 1]];
        CompressedBlock { vertices: end - first, bytes: behind - start }
    }

    /// Vertices of the largest group of blocks that are read at a time, about.
    pub fn most_vertices(&self) -> u64 {
        let largest = (0..self.len()).map(|number| self.block(number).vertices).max().unwrap_or(1);
        largest.max((CHUNK_VERTICES as u64).min(self.vertices())).max(1)
    }

    /// First vertex of a block, and the byte at which the block begins.
    pub fn start(&self, number: usize) -> (u64, u64) {
        self.starts[number]
    }

    /// The block that a vertex is in.
    pub fn of_vertex(&self, vertex: u64) -> usize {
        self.starts[..self.len()].partition_point(|(first, _)| *first <= vertex).saturating_sub(1)
    }

    /// The blocks from one on that are read at a time: of a chunk's vertices together, or a single one.
    pub fn group(&self, from: usize) -> Range<usize> {
        let mut to = from + 1;
        while to < self.len() && self.starts[to + 1].0 - self.starts[from].0 <= CHUNK_VERTICES as u64 {
            to += 1;
        }
        from..to
    }

    /// The table of blocks of the same vertices with other lengths.
    pub fn table(&self, lengths: &[u32]) -> io::Result<Vec<u8>> {
        let entries = lengths.iter().enumerate().map(|(number, length)| ChunkTableEntry {
            point_count: self.block(number).vertices,
            byte_count: u64::from(*length),
        });
        table_of(&entries.collect::<Vec<_>>(), self.is_variable)
    }
}

/// The bytes of a table.
pub(super) fn table_of(entries: &[ChunkTableEntry], is_variable: bool) -> io::Result<Vec<u8>> {
    let mut table = ChunkTable::with_capacity(entries.len());
    entries.iter().for_each(|entry| table.push(*entry));
    let builder = LazVlrBuilder::default().with_point_format(0, 0);
    let builder = builder.map_err(|e| io::Error::other(e.to_string()))?;
    let vlr = if is_variable { builder.with_variable_chunk_size() } else { builder }.build();
    let mut bytes = Vec::new();
    table.write_to(&mut bytes, &vlr)?;
    Ok(bytes)
}

/// The file from some byte on, as a stream.
struct ByteStream<'a> {
    source: &'a SourceFile,
    /// Bytes of the file before byte `at` that were read; from `used` on they are not handed out yet.
    buffer: Vec<u8>,
    used: usize,
    at: u64,
}

impl<'a> ByteStream<'a> {
    fn new(source: &'a SourceFile, at: u64) -> Self {
        Self { source, buffer: Vec::new(), used: 0, at }
    }
}

impl Read for ByteStream<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        const BUFFER: usize = 1 << 16;
        if self.used == self.buffer.len() {
            (self.buffer, self.used) = (std::mem::take(&mut self.buffer), 0);
            self.buffer.clear();
            let read = self.source.append_at(&mut self.buffer, self.at, BUFFER);
            self.at += read.map_err(|e| io::Error::other(e.to_string()))? as u64;
        }
        let ready = &self.buffer[self.used..];
        let count = ready.len().min(to.len());
        to[..count].copy_from_slice(&ready[..count]);
        self.used += count;
        Ok(count)
    }
}

impl Seek for ByteStream<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let here = self.at - (self.buffer.len() - self.used) as u64;
        let to = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => here.checked_add_signed(by),
            SeekFrom::End(by) => self.source.len().checked_add_signed(by),
        };
        let to = to.ok_or(io::ErrorKind::InvalidInput)?;
        if to != here {
            (self.at, self.used) = (to, 0);
            self.buffer.clear();
        }
        Ok(to)
    }
}
