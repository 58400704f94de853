//! Cuts an E57 file into pieces: pages of points, with all that is needed to patch them; and bytes to be
//! copied.
//!
//! A page may have some numbers of a point and others not, or even a part of a number. So a piece has points
//! of its own, each of which belongs to one piece, and points *beside* them, of which its pages have some
//! numbers as well. A point of which a piece has a part of a number is evaluated alone in both pieces, so
//! that both come to the same bits.

use std::collections::VecDeque;
use std::ops::Range;

use super::file::E57Model;
use super::pages::{PAGE, PAYLOAD, PageWindow, pages_of};
use super::reader::decoded;
use super::scan::Scan;
use super::streams::Streams;
use crate::model::StraddlingVertices;
use crate::pipeline::{Piece, Pieces};
use crate::{CHUNK_VERTICES, Result, VertexChunk};

/// Most pages of a piece.
const MOST_PAGES: u64 = 1024;

/// Number of pages that have no more points than a chunk, whatever they hold: even where a point takes a
/// single bit.
const FEW_PAGES: u64 = 8;

/// Number of pages that are read before and behind a piece, for the numbers of its points that are there.
const AROUND: u64 = 66;

/// Bytes that are copied at a time.
const CHUNK_BYTES: u64 = 4 << 20;

/// Section of the file that comes next.
#[derive(Debug)]
enum E57Section {
    Copy(Range<u64>),
    /// Pages with the points of some scans.
    Points {
        pages: Range<u64>,
        scans: Range<usize>,
    },
    /// The end of the file, or the place where it ends now.
    Ending(Range<u64>),
}

/// Points of a scan in a piece, and where their bytes are.
#[derive(Debug, Default)]
pub(super) struct ScanSegment {
    pub scan: usize,
    /// The points that belong to the piece.
    pub own: Range<u64>,
    /// The points of which a part of a number is here.
    pub alone: Vec<u64>,
    /// Streams of all points of which the piece has a number, or a part of one.
    pub streams: Streams,
    /// Bytes of the streams that are in the pages of the piece.
    pub runs: Vec<StreamRun>,
}

/// Bytes of a stream in the pages of a piece.
#[derive(Debug)]
pub(super) struct StreamRun {
    pub field: usize,
    pub of_stream: Range<u64>,
    pub at: usize,
}

/// The layout of a piece, by which it is patched.
#[derive(Debug, Default)]
pub(super) struct PieceLayout {
    pub first_page: u64,
    pub segments: Vec<ScanSegment>,
}

impl ScanSegment {
    /// Range of all points of which numbers are in the piece.
    pub fn points(&self) -> &Range<u64> {
        &self.streams.points
    }

    /// The groups of points beside those that belong to the piece.
    pub fn beside(&self) -> impl Iterator<Item = Range<u64>> + '_ {
        let around = [self.points().start..self.own.start, self.own.end..self.points().end];
        let alone = self.alone.iter().map(|point| *point..point + 1);
        around.into_iter().filter(|points| !points.is_empty()).chain(alone)
    }
}

/// The pieces of an E57 file, in its order.
pub(super) struct E57Pieces<'a> {
    model: &'a E57Model,
    next: VecDeque<E57Section>,
    window: PageWindow<'a>,
    rows: Vec<u64>,
}

impl<'a> E57Pieces<'a> {
    pub fn new(model: &'a E57Model) -> Self {
        let ending = model.ending();
        let (mut next, mut at) = (VecDeque::new(), 0);
        let mut regions: Vec<(Range<u64>, Range<usize>)> = Vec::new();
        for (number, scan) in model.scans.iter().enumerate().filter(|(_, scan)| scan.described.count > 0) {
            let pages = pages_of(&(scan.packets.section.start..scan.packets.end));
            match regions.last_mut() {
                Some((last, scans)) if pages.start < last.end => {
                    last.end = last.end.max(pages.end);
                    scans.end = number + 1;
                }
                _ => regions.push((pages, number..number + 1)),
            }
        }
        for (pages, scans) in regions {
            next.push_back(E57Section::Copy(at..pages.start * PAGE));
            at = pages.end * PAGE;
            next.push_back(E57Section::Points { pages, scans });
        }
        next.push_back(E57Section::Copy(at..ending.start));
        next.push_back(E57Section::Ending(ending));
        let window = PageWindow::new(&model.source, MOST_PAGES + 2 * AROUND);
        Self { model, next, window, rows: Vec::new() }
    }

    /// The page before which the piece ends that begins with the first of some pages: where a packet begins,
    /// if possible, so that few points are divided.
    fn end_of_piece(&mut self, pages: &Range<u64>, scans: &Range<usize>) -> Result<u64> {
        let model = self.model;
        let (mut end, mut points) = (None, 0);
        for scan in &model.scans[scans.clone()] {
            let start = pages.start * PAYLOAD;
            if scan.packets.end <= start {
                continue;
            }
            let before = scan.lead_numbers(&self.before(scan, start)?);
            let Some(mut place) = scan.packets.last_place(|at, _| at <= start) else {
                points += scan.described.count;
                continue;
            };
            loop {
                let (page, numbers) = (place.at / PAYLOAD, scan.lead_numbers(&place.before));
                let of_piece = points + numbers.saturating_sub(before);
                if page > pages.start + MOST_PAGES || of_piece > CHUNK_VERTICES as u64 {
                    return Ok(end.unwrap_or((pages.start + FEW_PAGES).min(pages.end)));
                }
                if page > pages.start {
                    end = Some(page);
                }
                if place.at >= scan.packets.end {
                    points = of_piece;
                    break;
                }
                model.walk(scan, &mut self.window).next(&mut place, scan.packets.section.end, |_| {})?;
            }
        }
        Ok(pages.end)
    }

    /// Number of bytes of each stream of a scan before a logical byte of the file.
    fn before(&mut self, scan: &Scan, byte: u64) -> Result<Vec<u64>> {
        let mut before = scan.packets.before(&mut self.model.walk(scan, &mut self.window), byte)?;
        before.resize(scan.described.fields.len(), 0);
        Ok(before)
    }

    /// Segment of a scan that some pages have.
    fn segment(&mut self, number: usize, pages: &Range<u64>) -> Result<ScanSegment> {
        let scan = &self.model.scans[number];
        let bytes = pages.start * PAYLOAD..pages.end * PAYLOAD;
        let is_first = bytes.start <= scan.packets.section.start;
        let is_last = bytes.end >= scan.packets.end;
        let (start, end) = (self.before(scan, bytes.start)?, self.before(scan, bytes.end)?);
        let count = scan.described.count;
        let own = match (is_first, is_last) {
            _ if scan.lead.is_none() => 0..if is_first { count } else { 0 },
            (true, true) => 0..count,
            (true, false) => 0..scan.lead_numbers(&end),
            (false, true) => scan.lead_numbers(&start)..count,
            (false, false) => scan.lead_numbers(&start)..scan.lead_numbers(&end),
        };
        // The range never goes backwards, even if the file has changed meanwhile.
        let own = own.start..own.end.max(own.start);
        let (mut points, mut alone) = (own.clone(), Vec::new());
        let patched = scan.patched();
        for field in &patched {
            let width = u64::from(scan.described.fields[*field].bits());
            if width == 0 {
                continue;
            }
            // The first number of which something is here, and the one behind the last.
            let [first, behind] = [&start, &end].map(|before| 8 * before[*field]);
            let here = (first / width).min(count)..behind.div_ceil(width).min(count);
            points = points.start.min(here.start)..points.end.max(here.end);
            let divided = [(first, here.start), (behind, here.end.saturating_sub(1))];
            alone.extend(
                divided.iter().filter(|(bit, at)| bit % width != 0 && *at < count).map(|(_, at)| *at),
            );
        }
        alone.sort_unstable();
        alone.dedup();
        let mut segment = ScanSegment { scan: number, own, alone, ..ScanSegment::default() };
        let walk = self.model.walk(scan, &mut self.window);
        segment.streams.read(walk, scan, points, &patched)?;
        segment.runs = self.runs(scan, &patched, &bytes)?;
        Ok(segment)
    }

    /// Runs of those fields of a scan that are written anew, within some bytes of the file.
    fn runs(&mut self, scan: &Scan, patched: &[usize], bytes: &Range<u64>) -> Result<Vec<StreamRun>> {
        let mut runs = Vec::new();
        let Some(mut place) = scan.packets.last_place(|at, _| at <= bytes.start) else { return Ok(runs) };
        let mut walk = self.model.walk(scan, &mut self.window);
        while place.at < bytes.end.min(scan.packets.end) {
            walk.next(&mut place, scan.packets.section.end, |part| {
                let end = part.at + (part.of_stream.end - part.of_stream.start);
                let here = part.at.max(bytes.start)..end.min(bytes.end);
                if here.start < here.end && patched.contains(&part.stream) {
                    let of_stream = |at: u64| part.of_stream.start + (at - part.at);
                    runs.push(StreamRun {
                        field: part.stream,
                        of_stream: of_stream(here.start)..of_stream(here.end),
                        at: (here.start - bytes.start) as usize,
                    });
                }
            })?;
        }
        Ok(runs)
    }

    /// Reads the piece that begins with the first of some pages; returns the page at which the piece ends.
    fn read_points(
        &mut self,
        pages: &Range<u64>,
        scans: &Range<usize>,
        chunk: &mut VertexChunk,
    ) -> Result<(u64, Piece)> {
        self.window.load(pages.start.saturating_sub(AROUND)..pages.start + MOST_PAGES + AROUND)?;
        let end = self.end_of_piece(pages, scans)?;
        let piece = pages.start..end;
        let mut layout = chunk.take_of_format::<PieceLayout>();
        layout.first_page = piece.start;
        layout.segments.clear();
        chunk.raw.clear();
        let (mut first, mut vertices, mut is_touched) = (None, 0, false);
        for number in scans.clone() {
            let scan = &self.model.scans[number];
            let is_here =
                scan.packets.section.start < piece.end * PAYLOAD && scan.packets.end > piece.start * PAYLOAD;
            if scan.described.count == 0 || !is_here {
                continue;
            }
            let segment = self.segment(number, &piece)?;
            self.rows.clear();
            segment.streams.rows(&scan.row, segment.own.clone(), &mut self.rows);
            chunk.raw.extend(self.rows.iter().flat_map(|number| number.to_le_bytes()));
            if !segment.own.is_empty() {
                first.get_or_insert(scan.first + segment.own.start);
            }
            vertices += segment.own.end - segment.own.start;
            is_touched |= !segment.points().is_empty();
            layout.segments.push(segment);
        }
        if !is_touched {
            chunk.pages.clear();
            chunk.raw.clear();
            self.model.source.append_at(
                &mut chunk.raw,
                piece.start * PAGE,
                ((end - piece.start) * PAGE) as usize,
            )?;
            return Ok((end, Piece::Bytes));
        }
        chunk.first = first.unwrap_or(0);
        chunk.pages.clear();
        chunk.pages.extend_from_slice(self.window.get(piece.start * PAYLOAD..piece.end * PAYLOAD)?);
        chunk.of_format.push(layout);
        Ok((end, if vertices == 0 { Piece::Normals } else { Piece::Vertices(vertices as usize) }))
    }
}

impl Pieces for E57Pieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        loop {
            let Some(part) = self.next.pop_front() else {
                self.model.source.check_unchanged()?;
                return Ok(Piece::End);
            };
            match part {
                E57Section::Copy(range) if range.is_empty() => {}
                E57Section::Copy(range) => {
                    let wanted = (range.end - range.start).min(CHUNK_BYTES);
                    self.next.push_front(E57Section::Copy(range.start + wanted..range.end));
                    self.copy(range.start..range.start + wanted, chunk)?;
                    return Ok(Piece::Bytes);
                }
                E57Section::Points { pages, .. } if pages.is_empty() => {}
                E57Section::Points { pages, scans } => {
                    let (end, piece) = self.read_points(&pages, &scans, chunk)?;
                    self.next.push_front(E57Section::Points { pages: end..pages.end, scans });
                    return Ok(piece);
                }
                E57Section::Ending(range) => {
                    self.copy(range, chunk)?;
                    return Ok(Piece::Made);
                }
            }
        }
    }
}

impl E57Pieces<'_> {
    fn copy(&self, range: Range<u64>, chunk: &mut VertexChunk) -> Result<()> {
        chunk.pages.clear();
        chunk.raw.clear();
        self.model.source.append_at(&mut chunk.raw, range.start, (range.end - range.start) as usize)?;
        Ok(())
    }
}

impl E57Model {
    /// Fills the positions and normals of a piece.
    pub(super) fn decode_piece(&self, chunk: &mut VertexChunk) {
        let Some(of_format) = chunk.of_format.pop() else { return };
        let Some(layout) = of_format.downcast_ref::<PieceLayout>() else { return };
        let normals = self.info.has_normals;
        let VertexChunk { positions, normals: of_normals, raw, beside, follows, .. } = chunk;
        *follows = !self.following.is_empty();
        let StraddlingVertices { positions: positions_beside, normals: normals_beside, groups } = beside;
        positions.clear();
        of_normals.clear();
        positions_beside.clear();
        normals_beside.clear();
        groups.clear();
        let mut numbers = super::reader::numbers(raw);
        let mut rows = Vec::new();
        for segment in &layout.segments {
            let scan = &self.scans[segment.scan];
            rows.clear();
            rows.extend(
                numbers.by_ref().take((segment.own.end - segment.own.start) as usize * scan.row.len()),
            );
            let (of_own, normals_of_own) = decoded(scan, &rows, normals);
            positions.extend(of_own);
            of_normals.extend(normals_of_own);
            for points in segment.beside() {
                groups.push((points.end - points.start) as usize);
                rows.clear();
                segment.streams.rows(&scan.row, points, &mut rows);
                let (of_group, normals_of_group) = decoded(scan, &rows, normals);
                positions_beside.extend(of_group);
                normals_beside.extend(normals_of_group);
            }
        }
        chunk.of_format.push(of_format);
    }
}

impl Scan {
    /// Number of points that begin within the first `before` bytes of each stream: those of whose leading
    /// number there is a bit.
    pub fn lead_numbers(&self, before: &[u64]) -> u64 {
        let Some(lead) = self.lead else { return 0 };
        let width = u64::from(self.described.fields[lead].bits().max(1));
        before.get(lead).map_or(0, |bytes| (8 * bytes).div_ceil(width).min(self.described.count))
    }
}
