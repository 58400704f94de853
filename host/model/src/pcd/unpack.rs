//! Compressed points, unpacked point by point.
//!
//! The block is compressed by LZF (Marc Lehmann's LibLZF): runs of up to 32 bytes, and copies of up to 264
//! bytes that begin at most 8192 bytes before.

use super::header::PcdHeader;
use crate::cache::{CachedContent, Making};
use crate::scratch::Scratch;
use crate::source::SourceFile;
use crate::text::{CUT_OFF, DAMAGED};
use crate::{Error, Progress, Result};

/// Longest distance back at which a copy may begin, in bytes.
const WINDOW: usize = 1 << 13;

/// Bytes that are read, and written, at a time.
const BLOCK: usize = 1 << 20;

/// The points of a compressed file as binary records, in the cache.
///
/// Disk: the unpacked size, at most 4 GiB, and as much again until that is done. Memory: a few MiB.
pub(super) fn unpack(source: &SourceFile, header: &PcdHeader, making: &Making<'_>) -> Result<SourceFile> {
    let mut sizes = [0; 8];
    if source.read_at(&mut sizes, header.len)? < sizes.len() {
        return Err(source.malformed("the file ends before the compressed points", CUT_OFF));
    }
    let [packed, unpacked] = [0, 4].map(|at| {
        let mut four = [0; 4];
        four.copy_from_slice(&sizes[at..at + 4]);
        u64::from(u32::from_le_bytes(four))
    });
    let stride: usize = header.fields.iter().map(|field| field.bytes()).sum();
    if (stride as u64).checked_mul(header.points) != Some(unpacked) {
        let what =
            format!("says {} points of {stride} bytes each, but also {unpacked} bytes in all", header.points);
        return Err(source.malformed(what, DAMAGED));
    }
    let start = header.len + sizes.len() as u64;
    if source.len() - start < packed {
        let what =
            format!("says {packed} bytes of compressed points, but only {} follow", source.len() - start);
        return Err(source.malformed(what, CUT_OFF));
    }
    let text = [&header.text[..header.data_line], b"DATA binary\n"].concat();
    let len = text.len() as u64 + unpacked;
    let need =
        CachedContent { what: "its compressed points are unpacked", bytes: len..=len, meanwhile: unpacked };
    making.cache.get(source, &need, making.progress, |points| {
        let fields = points.beside()?;
        let unpacker = Unpacker {
            source,
            at: start,
            end: start + packed,
            input: Vec::new(),
            taken: 0,
            output: Vec::new(),
            written: 0,
            limit: unpacked,
            to: &fields,
            progress: making.progress,
        };
        unpacker.run()?;
        points.write_at(&text, 0)?;
        transpose(&fields, points, header, stride, text.len() as u64)?;
        Ok(len)
    })
}

struct Unpacker<'a> {
    source: &'a SourceFile,
    /// Byte of the file that is read next, and the end of the compressed block.
    at: u64,
    end: u64,
    input: Vec<u8>,
    taken: usize,
    /// The last bytes, of which the first ones are written already.
    output: Vec<u8>,
    written: u64,
    /// Bytes that there should be.
    limit: u64,
    to: &'a Scratch,
    progress: &'a dyn Progress,
}

impl Unpacker<'_> {
    fn run(mut self) -> Result<()> {
        while let Some(control) = self.byte()? {
            let control = usize::from(control);
            if control < 32 {
                for _ in 0..=control {
                    let byte = self.must()?;
                    self.output.push(byte);
                }
            } else {
                let mut length = control >> 5;
                if length == 7 {
                    length += usize::from(self.must()?);
                }
                let back = ((control & 31) << 8) + usize::from(self.must()?) + 1;
                let Some(from) = self.output.len().checked_sub(back) else {
                    return Err(self.damaged("the compressed points copy bytes from before the first one"));
                };
                // A copy may overlap the bytes that it makes.
                for i in from..from + length + 2 {
                    self.output.push(self.output[i]);
                }
            }
            if self.written + self.output.len() as u64 > self.limit {
                return Err(self.damaged("the compressed points have more bytes than their head says"));
            }
            if self.output.len() > BLOCK + WINDOW {
                self.flush(WINDOW)?;
            }
        }
        self.flush(0)?;
        if self.written < self.limit {
            return Err(self.damaged(&format!(
                "the compressed points have {} bytes, but their head says {}",
                self.written, self.limit
            )));
        }
        Ok(())
    }

    fn byte(&mut self) -> Result<Option<u8>> {
        if self.taken == self.input.len() {
            self.input.clear();
            self.taken = 0;
            let wanted = (self.end - self.at).min(BLOCK as u64) as usize;
            self.at += self.source.append_at(&mut self.input, self.at, wanted)? as u64;
        }
        let byte = self.input.get(self.taken).copied();
        self.taken += 1;
        Ok(byte)
    }

    fn must(&mut self) -> Result<u8> {
        self.byte()?.ok_or_else(|| self.damaged("the compressed points end early"))
    }

    /// Writes all but the last bytes.
    fn flush(&mut self, kept: usize) -> Result<()> {
        self.progress.check()?;
        let done = self.output.len().saturating_sub(kept);
        self.to.write_at(&self.output[..done], self.written)?;
        self.output.drain(..done);
        self.written += done as u64;
        Ok(())
    }

    fn damaged(&self, what: &str) -> Error {
        self.source.malformed(what, DAMAGED)
    }
}

/// Writes points, field by field, as records.
fn transpose(
    fields: &Scratch,
    points: &Scratch,
    header: &PcdHeader,
    stride: usize,
    start: u64,
) -> Result<()> {
    let at_once = (BLOCK / stride.max(1)).max(1) as u64;
    let (mut records, mut column) = (Vec::new(), Vec::new());
    let mut first = 0;
    while first < header.points {
        let count = at_once.min(header.points - first);
        records.resize(count as usize * stride, 0);
        let (mut base, mut offset) = (0, 0);
        for field in header.fields.iter().filter(|field| field.bytes() > 0) {
            let bytes = field.bytes();
            column.resize(count as usize * bytes, 0);
            fields.read_at(&mut column, base + first * bytes as u64)?;
            for (record, value) in records.chunks_exact_mut(stride).zip(column.chunks_exact(bytes)) {
                record[offset..offset + bytes].copy_from_slice(value);
            }
            base += header.points * bytes as u64;
            offset += bytes;
        }
        points.write_at(&records, start + first * stride as u64)?;
        first += count;
    }
    Ok(())
}
