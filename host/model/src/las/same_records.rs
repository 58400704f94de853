//! LAS as LAZ, and LAZ as LAS: header, records and the bytes between stay as they are, and so do points, but
//! for being compressed.

use std::ops::Range;

use super::blocks::PLACE;
use super::file::LasModel;
use super::form::{BLOCK, LASZIP, TALLIES, bytes_of, compress, laszip_patches, table, vlr};
use super::header::at;
use super::laszip::Laszip;
use super::points;
use super::vlrs::VlrKind;
use crate::form::{Form, WrittenRows};
use crate::{Error, Result, ScaledIntegers, Summary};

/// Most bytes before or behind the points, which are held.
const MOST: u64 = 256 << 20;

/// The points of a file, compressed or not.
pub(crate) struct SameRecords<'a> {
    source: &'a LasModel,
    /// Compression of the points, and the content of the VLR that describes it.
    laszip: Option<(Laszip, Vec<u8>)>,
    /// Range of the source's bytes behind its points.
    behind: Range<u64>,
}

impl<'a> SameRecords<'a> {
    pub(crate) fn new(source: &'a LasModel, is_compressed: bool) -> Result<Self> {
        let header = &source.header;
        // The place of the table, in the last bytes of the file, is left out.
        let told = source.compressed.as_ref().is_some_and(|(_, blocks)| blocks.is_told_at_end);
        let end = source.source.len() - if told { PLACE } else { 0 };
        let behind = match &source.compressed {
            None => header.points + source.info.vertex_bytes..end,
            Some((_, blocks)) => blocks.table.as_ref().map_or(blocks.end(), |table| table.end)..end,
        };
        let path = source.source.path().display();
        for length in [header.points - header.len, behind.end - behind.start] {
            if length > MOST {
                return Err(Error::argument(
                    format!(
                        "{path} has {length} bytes before or behind its points, which are too many to be held"
                    ),
                    "compress it with another program, as `pdal translate IN.las OUT.laz --writers.las.forward=all`",
                ));
            }
        }
        let anew = || Laszip::anew(header.format, header.extra_bytes() as u16, BLOCK);
        let laszip = is_compressed.then(anew).transpose().map_err(|e| {
            Error::argument(
                format!("{path}: points of format {} cannot be compressed: {e}", header.format),
                "write the model as las",
            )
        })?;
        Ok(Self { source, laszip, behind })
    }

    /// Bytes of a range of the source that go into the new file: all but the octree of COPC and the VLR of
    /// the compression.
    fn kept(&self, range: &Range<u64>) -> Result<Vec<u8>> {
        let LasModel { source, records, .. } = self.source;
        let mut dropped: Vec<_> = records.of_copc().chain(records.find(VlrKind::Laszip)).collect();
        dropped.sort_by_key(|record| record.all.start);
        let (mut bytes, mut start) = (Vec::new(), range.start);
        let within = |at: u64| at.clamp(range.start, range.end);
        for record in dropped {
            let end = within(record.all.start).max(start);
            source.append_at(&mut bytes, start, (end - start) as usize)?;
            start = within(record.all.end).max(start);
        }
        source.append_at(&mut bytes, start, (range.end - start) as usize)?;
        Ok(bytes)
    }

    /// Place in the new file of a byte of the source's records, if the bytes behind the points begin at `end`
    /// there.
    fn place(&self, at: u64, end: u64) -> Result<u64> {
        if at >= self.behind.start {
            return Ok(self.source.moved(at) - self.source.moved(self.behind.start) + end);
        }
        let header = &self.source.header;
        let before = self.laszip_vlr().len() + self.kept(&(header.len..at))?.len();
        Ok(header.len + before as u64)
    }

    /// The VLR on how points are compressed.
    fn laszip_vlr(&self) -> Vec<u8> {
        self.laszip.as_ref().map_or(Vec::new(), |(_, content)| vlr(LASZIP.0, LASZIP.1, content))
    }

    /// Byte of the new file at which the points begin.
    fn start(&self) -> Result<u64> {
        let header = &self.source.header;
        let between = self.kept(&(header.len..header.points))?.len() + self.laszip_vlr().len();
        Ok(header.len + between as u64)
    }
}

impl Form for SameRecords<'_> {
    fn attributes(&self) -> usize {
        0
    }

    fn head(&self) -> Result<Vec<u8>> {
        let LasModel { source, header, compressed, .. } = self.source;
        let mut head = Vec::new();
        source.append_at(&mut head, 0, header.len as usize)?;
        self.source.correct_header(&mut head);
        let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
        let start = self.start()?;
        let vlrs = header.vlrs - self.source.dropped(false) as u32 - u32::from(compressed.is_some())
            + u32::from(self.laszip.is_some());
        put(at::POINTS as usize, &u32::try_from(start).unwrap_or(u32::MAX).to_le_bytes());
        put(at::VLRS as usize, &vlrs.to_le_bytes());
        put(104, &[header.format | if self.laszip.is_some() { 0x80 } else { 0 }]);
        head.extend(self.laszip_vlr());
        head.extend(self.kept(&(header.len..header.points))?);
        if self.laszip.is_some() {
            // Room for the place of the table, which is not known yet.
            head.extend_from_slice(&[0; 8]);
        }
        Ok(head)
    }

    fn vertices(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, summary: &mut Summary) -> Result<()> {
        to.clear();
        to.extend_from_slice(self.source.records_of(rows.chunk));
        let grid = (self.source.written(), self.source.shift);
        let moved = (&rows.chunk.positions[..], rows.positions);
        points::patch(grid, to, self.source.header.record, moved, summary)
            .map_err(|unfit| self.source.unfit(rows.first, unfit))?;
        let turned = (rows.edited, 0..rows.positions.len());
        self.source.turn(turned, &rows.chunk.positions, to, summary);
        if let Some((laszip, _)) = &self.laszip {
            compress(laszip, to)?;
        }
        let mut tallies = [0; TALLIES];
        (tallies[0], tallies[1]) = (rows.positions.len() as u32, to.len() as u32);
        summary.lengths.extend_from_slice(&tallies);
        Ok(())
    }

    fn tail(&self, all: &Summary) -> Result<Vec<u8>> {
        let mut tail = if self.laszip.is_some() { table(all)? } else { Vec::new() };
        tail.extend(self.kept(&self.behind)?);
        Ok(tail)
    }

    fn patches(&self, all: &Summary) -> Result<Vec<(u64, Vec<u8>)>> {
        let LasModel { header, .. } = self.source;
        let mut patches = self.source.bounds(all);
        let start = self.start()?;
        let mut end = start + bytes_of(all);
        if self.laszip.is_some() {
            patches.extend(laszip_patches(header.len, start, all));
            end += 8 + table(all)?.len() as u64;
        }
        if let Some(content) = self.source.descriptions() {
            patches.extend(self.source.limits(all, self.place(content, end)?));
        }
        if let Some(waveforms) = header.waveforms.filter(|at| *at >= self.behind.start) {
            patches.push((at::WAVEFORMS, self.place(waveforms, end)?.to_le_bytes().to_vec()));
        }
        if let Some((evlrs, count)) = header.evlrs.filter(|(at, _)| *at >= self.behind.start) {
            let left = u64::from(count) - self.source.dropped(true);
            let place = if left > 0 { self.place(evlrs, end)? } else { 0 };
            patches.push((at::EVLRS_START, place.to_le_bytes().to_vec()));
        }
        Ok(patches)
    }

    fn integers(&self) -> Option<ScaledIntegers> {
        Some(*self.source.written())
    }

    fn bytes(&self) -> u64 {
        let LasModel { header, info, source, .. } = self.source;
        let points = info.vertices * header.record as u64;
        let others = source.len() - info.vertex_bytes.min(source.len());
        others + if self.laszip.is_some() { points / 3 } else { points }
    }
}
