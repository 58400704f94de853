//! Lines of corners as triangles.

use std::ops::Range;

use super::DAMAGED;
use super::lines::{LineEnds, Lines, wrong_line};
use crate::fan::Fan;
use crate::source::SourceFile;
use crate::{CHUNK_TRIANGLES, FACES_OF_A_BLOCK, FaceChunk, FaceMark, FaceReader, Result};

/// Bytes of the file that a chunk takes.
const CHUNK_BYTES: u64 = 4 << 20;

/// The lines with faces of a format.
pub(crate) trait FaceLines: Send {
    /// Way in which the lines of the format end.
    const ENDS: LineEnds = LineEnds::Breaks;

    /// Reading goes on at this byte of the file.
    fn seek(&mut self, _offset: u64) -> Result<()> {
        Ok(())
    }

    /// Byte of a line at which its corners begin, if the line is a face. Lines come in the file's order.
    fn face(&mut self, line: &[u8]) -> Result<Option<usize>, String>;

    /// Returns the next corner of a face from `at` on, and moves `at` behind it; `None` if there is no more.
    fn corner(&mut self, line: &[u8], at: &mut usize) -> Result<Option<i64>, String>;
}

/// Reads the faces of a part of a file, or of some ranges of it.
///
/// Memory: a line, twice; no polygon is held otherwise.
pub(crate) struct LineFaces<'a, P> {
    source: &'a SourceFile,
    parser: P,
    lines: Lines<'a>,
    ranges: std::vec::IntoIter<Range<u64>>,
    /// Line of the face that is being read, the part of it that was read, and the byte of the file at which
    /// it begins.
    line: Vec<u8>,
    at: usize,
    start: u64,
    fan: Fan,
    /// Faces until the next mark; none where ranges are read.
    until_mark: Option<u64>,
    is_over: bool,
}

impl<'a, P: FaceLines> LineFaces<'a, P> {
    /// A reader of the faces between two bytes of the file; or of some ranges, which are whole lines.
    pub(crate) fn new(
        source: &'a SourceFile,
        parser: P,
        all: Range<u64>,
        ranges: Option<Vec<Range<u64>>>,
    ) -> Self {
        let until_mark = ranges.is_none().then_some(0);
        let ranges = ranges.unwrap_or_else(|| vec![all]).into_iter();
        let lines = Lines::new(source, 0, 0, P::ENDS);
        let (line, fan) = (Vec::new(), Fan::default());
        Self { source, parser, lines, ranges, line, at: 0, start: 0, fan, until_mark, is_over: false }
    }

    /// Goes on to the next face; `false` if there is none, or `most` bytes were passed.
    fn next_face(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        loop {
            if chunk.bytes >= CHUNK_BYTES {
                return Ok(false);
            }
            let Some((start, line)) = self.lines.next()? else {
                let Some(range) = self.ranges.next() else {
                    self.is_over = true;
                    return Ok(false);
                };
                self.parser.seek(range.start)?;
                self.lines = Lines::new(self.source, range.start, range.end, P::ENDS);
                continue;
            };
            chunk.bytes += line.len() as u64;
            match self.parser.face(line) {
                Ok(Some(at)) => {
                    self.line.clear();
                    self.line.extend_from_slice(line);
                    (self.at, self.start, self.fan) = (at, start, Fan::default());
                    return Ok(true);
                }
                Ok(None) => {}
                Err(what) => return Err(wrong_line(self.source, start, what, DAMAGED)),
            }
        }
    }

    /// Adds the triangles of the face that is being read; `false` if there is no room for all.
    fn add(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        while chunk.triangles.len() < CHUNK_TRIANGLES {
            match self.parser.corner(&self.line, &mut self.at) {
                Ok(Some(index)) => chunk.add_corner(&mut self.fan, index),
                Ok(None) => {
                    self.line.clear();
                    return Ok(true);
                }
                Err(what) => return Err(wrong_line(self.source, self.start, what, DAMAGED)),
            }
        }
        Ok(false)
    }
}

impl<P: FaceLines> FaceReader for LineFaces<'_, P> {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        chunk.clear();
        if self.is_over {
            return Ok(false);
        }
        chunk.triangles.reserve(CHUNK_TRIANGLES);
        loop {
            if !self.line.is_empty() && !self.add(chunk)? {
                return Ok(true);
            }
            if chunk.triangles.len() == CHUNK_TRIANGLES || !self.next_face(chunk)? {
                break;
            }
            if let Some(left) = &mut self.until_mark {
                if *left == 0 {
                    *left = FACES_OF_A_BLOCK;
                    chunk.marks.push(FaceMark { triangle: chunk.triangles.len(), offset: self.start });
                }
                *left -= 1;
            }
        }
        if self.is_over && self.until_mark.is_some() {
            let offset = self.lines.position();
            chunk.marks.push(FaceMark { triangle: chunk.triangles.len(), offset });
        }
        Ok(!self.is_over || chunk.bytes > 0 || !chunk.triangles.is_empty() || !chunk.marks.is_empty())
    }
}
