//! Writing an E57 file anew, with other positions.

use glam::Mat3;

use super::file::E57Model;
use super::pages::{PAYLOAD, append_pages};
use super::pieces::{E57Pieces, PieceLayout, ScanSegment};
use super::scan::{CoordinateOverflow, ScanReach};
use crate::pipeline::{PieceVersion, Pieces, Rewritable};
use crate::source::SourceFile;
use crate::unfit::Unfit;
use crate::{Error, Normals, Result, Summary, VertexChunk};

impl Rewritable for E57Model {
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        if normals == Normals::Drop && self.info.has_normals {
            return Err(self.source.keeps_normals("keep or transform them: --normals keep"));
        }
        Ok(Box::new(E57Pieces::new(self)))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        self.decode_piece(chunk);
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, mut version: PieceVersion<'_>) -> Result<()> {
        let Some(layout) = chunk.of_format.first().and_then(|of| of.downcast_ref::<PieceLayout>()) else {
            return Err(Error::internal("a piece of E57 has no layout"));
        };
        let mut copy;
        let pages = if version.is_last {
            &mut chunk.pages
        } else {
            copy = chunk.pages.clone();
            &mut copy
        };
        let mut moving = Moving {
            model: self,
            from: [&chunk.positions, &chunk.beside.positions],
            from_normals: [&chunk.normals, &chunk.beside.normals],
            version: &mut version,
            own: 0,
            beside: chunk.positions.len(),
        };
        for segment in &layout.segments {
            moving.patch(segment, pages)?;
        }
        let PieceVersion { bytes, summary, .. } = version;
        bytes.clear();
        let first = layout.first_page;
        append_pages(pages, bytes, |page, checksum| {
            let page = first + page as u64;
            if self.is_finished_later(page) {
                summary.checksums.insert(page, checksum);
            }
        });
        Ok(())
    }

    fn make(&self, before: &Summary, _is_still: bool) -> Result<Vec<u8>> {
        self.make_ending(before)
    }

    fn patches(&self, all: &Summary, _is_still: bool) -> Result<Vec<(u64, Vec<u8>)>> {
        self.patches_in_the_end(all)
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

/// A version of a piece on its way into its pages.
struct Moving<'a, 'v> {
    model: &'a E57Model,
    /// The positions of the piece's own vertices, and of those beside.
    from: [&'a [glam::DVec3]; 2],
    from_normals: [&'a [glam::Vec3]; 2],
    version: &'a mut PieceVersion<'v>,
    /// The first of the own vertices of the next segment in all lists, and the first of those beside.
    own: usize,
    beside: usize,
}

impl Moving<'_, '_> {
    /// Notes the limits of a scan's vertices before and after the motion.
    fn note_reach(&mut self, scan: usize, before: ScanReach, after: ScanReach) {
        for (kind, boxes) in (0..).zip(before.into_iter().zip(after)) {
            let number = 2 * scan as u32 + kind;
            let one = Summary { boxes: [(number, [boxes.0, boxes.1])].into(), ..Summary::default() };
            self.version.summary.absorb(&one);
        }
    }

    /// Patches the numbers of a segment in its pages.
    fn patch(&mut self, segment: &ScanSegment, pages: &mut [u8]) -> Result<()> {
        let scan = &self.model.scans[segment.scan];
        let points = segment.points().clone();
        let width = scan.row.len();
        // For each point, which of the lists' vertices it is.
        let mut vertices = vec![0; (points.end - points.start) as usize];
        let mut place = |some: std::ops::Range<u64>, at: &mut usize| {
            for point in some {
                vertices[(point - points.start) as usize] = *at;
                *at += 1;
            }
        };
        place(segment.own.clone(), &mut self.own);
        segment.beside().for_each(|some| place(some, &mut self.beside));

        let (mut rows, mut changed) = (Vec::new(), Vec::new());
        segment.streams.rows(&scan.row, points.clone(), &mut rows);
        let (mut before, mut after) = (ScanReach::default(), ScanReach::default());
        for ((point, row), vertex) in points.clone().zip(rows.chunks_exact_mut(width)).zip(&vertices) {
            let is_own = scan.wants_reach() && segment.own.contains(&point);
            let was = is_own.then(|| scan.reach(row));
            let moves = self.move_vertex(segment, point, row, *vertex)?;
            if moves {
                changed.push((point - points.start) as usize);
            }
            if let Some(was) = was {
                include(&mut before, was);
                include(&mut after, if moves { scan.new_reach(row) } else { was });
            }
        }
        if scan.wants_reach() && !segment.own.is_empty() {
            self.note_reach(segment.scan, before, after);
        }
        put(segment, &scan.row, &rows, &changed, pages);
        let fields: Vec<usize> = scan.turning.iter().flatten().copied().collect();
        if fields.is_empty() {
            return Ok(());
        }
        rows.clear();
        changed.clear();
        segment.streams.rows(&fields, points, &mut rows);
        for (index, (row, vertex)) in rows.chunks_exact_mut(fields.len()).zip(&vertices).enumerate() {
            if self.turn_vertex(segment, row, *vertex) {
                changed.push(index);
            }
        }
        put(segment, &fields, &rows, &changed, pages);
        Ok(())
    }

    /// Turns the attributes of a vertex that follow the surface; returns whether any bits changed.
    fn turn_vertex(&self, segment: &ScanSegment, bits: &mut [u64], vertex: usize) -> bool {
        let edited = self.version.edited;
        let moves = entry_of(self.from, vertex).is_some_and(|from| from.is_finite());
        let gradient = edited.gradients.get(vertex).filter(|gradient| moves && **gradient != Mat3::IDENTITY);
        let following = &self.model.following;
        gradient.is_some_and(|gradient| {
            self.model.scans[segment.scan]
                .turn(bits, gradient, |gradient, numbers| following.turn(gradient, edited.mirrored, numbers))
        })
    }

    /// Moves the vertex of a row; whether any bits changed.
    fn move_vertex(&self, segment: &ScanSegment, point: u64, row: &mut [u64], vertex: usize) -> Result<bool> {
        let scan = &self.model.scans[segment.scan];
        let edited = self.version.edited;
        let (from, to) = (entry_of(self.from, vertex), edited.positions[vertex]);
        let mut changed = false;
        let moves = from.filter(|from| from.is_finite() && *from != to).map(|from| [from, to]);
        if moves.is_some() || scan.has_other_ranges() {
            changed = scan.move_point(row, moves).map_err(|e| self.beyond(segment, point, e))?;
        }
        if let (Some(from), Some(to)) = (entry_of(self.from_normals, vertex), edited.normals.get(vertex)) {
            changed |= scan.turn_normal(row, from, *to);
        }
        Ok(changed)
    }

    fn beyond(&self, segment: &ScanSegment, point: u64, beyond: CoordinateOverflow) -> Error {
        let CoordinateOverflow { field, value } = beyond;
        let (source, scan) = (&self.model.source, &self.model.scans[segment.scan]);
        let vertex = scan.first + point;
        if !value.is_finite() {
            return Unfit { vertex: 0, axis: 0, value }.error(source, vertex);
        }
        let (least, most) = scan.range(field);
        let (name, field) = (&scan.described.name, &scan.described.fields[field].name);
        Error::degenerate(
            format!(
                "{}: vertex {vertex} moves to {field} = {value} of {name}, \
                 which has room for {least} to {most} alone",
                source.path().display()
            ),
            "move it less, give --offset auto, which chooses other ranges, or export the model with coordinates as floats \
             (of type Float) first",
        )
    }
}

/// Puts the rows of `fields` that changed into the pages of a piece.
fn put(segment: &ScanSegment, fields: &[usize], rows: &[u64], changed: &[usize], pages: &mut [u8]) {
    if changed.is_empty() {
        return;
    }
    for (i, field) in fields.iter().enumerate() {
        let Some(Some(packed)) = segment.streams.packed.get(*field) else { continue };
        let mut packed = packed.clone();
        changed.iter().for_each(|index| packed.put(*index, rows[index * fields.len() + i]));
        for run in segment.runs.iter().filter(|run| run.field == *field) {
            // There may be more bytes behind the last number.
            let end = packed.first + packed.bytes().len() as u64;
            let (start, end) = (run.of_stream.start.max(packed.first), run.of_stream.end.min(end));
            if start < end {
                let new = &packed.bytes()[(start - packed.first) as usize..(end - packed.first) as usize];
                let at = run.at + (start - run.of_stream.start) as usize;
                pages[at..at + new.len()].copy_from_slice(new);
            }
        }
    }
}

fn include(all: &mut ScanReach, one: [Option<glam::DVec3>; 2]) {
    let both = all.iter_mut().zip(one);
    both.for_each(|(bounds, place)| place.into_iter().for_each(|place| bounds.include(place)));
}

/// An entry of two lists, one behind the other.
fn entry_of<T: Copy>(lists: [&[T]; 2], index: usize) -> Option<T> {
    let [first, second] = lists;
    first.get(index).or_else(|| second.get(index - first.len())).copied()
}

impl E57Model {
    /// Whether some bytes of a page are known in the end only: those of the header, and the first ones of the
    /// XML.
    fn is_finished_later(&self, page: u64) -> bool {
        page == 0 || page == self.header.xml.start / PAYLOAD
    }
}
