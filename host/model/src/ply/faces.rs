//! Triangles of all faces: lists of corners, wherever they lie among other properties and elements.
//!
//! Polygons are the records of element `face`, strips those of `tristrips`; either keeps its corners in a
//! list `vertex_indices` (or `vertex_index`) of integers. Without such a list, an element has no triangles.
//!
//! A list may be as long as the file, so it is never held: a fan or a strip needs two corners beside the
//! next. The memory is [`BLOCK`] bytes of the file.

use std::ops::Range;

use super::binary;
use super::file::PlyModel;
use super::header::{DAMAGED, Encoding, PlyElement, PlyHeader, Property, PropertyShape, quoted};
use super::reader::{CHUNK_BYTES, PlyReader};
use super::walk::{CUT_OFF, RecordPlan, WalkStep};
use crate::Type;
use crate::fan::Fan;
use crate::source::SourceFile;
use crate::text;
use crate::{CHUNK_TRIANGLES, Error, FACES_OF_A_BLOCK, FaceChunk, FaceMark, FaceReader, Result};

/// Bytes read at a time; no word of a text file is longer.
const BLOCK: usize = 1 << 18;

/// Reads all faces of a model.
pub(super) struct PlyFaces<'a> {
    parts: Vec<FaceElement>,
    /// Index of the part that the cursor stands in.
    part: usize,
    cursor: RecordCursor<'a>,
}

/// An element to go over.
struct FaceElement {
    plan: RecordPlan,
    /// Byte at which the element begins; `None` in a text file, where it begins at the end of the element
    /// before.
    start: Option<u64>,
    /// The list whose items are corners, of those elements that have triangles.
    corners: Option<IndexList>,
    /// Whether the list is one of triangle strips.
    strips: bool,
    /// Plan for records that are read all at once, if they are of such a kind.
    compact: Option<Compact>,
}

#[derive(Clone, Copy)]
struct IndexList {
    /// Index of the property.
    property: usize,
    item: Type,
}

impl FaceElement {
    fn new(element: &PlyElement, encoding: Encoding, start: Option<u64>) -> Self {
        let corners = corner_list(element);
        let strips = element.name == "tristrips";
        let plan = RecordPlan::new(element, encoding);
        let compact = corners.filter(|_| !strips).and_then(|list| Compact::new(&plan, list.item, encoding));
        Self { plan, start, corners, strips, compact }
    }
}

/// Binary records of polygons whose only list are the corners, of 32 bits each.
struct Compact {
    /// Bytes before the list's length, before the corners, and of the whole record without corners.
    before: usize,
    corners: usize,
    bare: usize,
    /// Right shift and (`mask`) mask by which the list's length is taken from the 32 bits at its place.
    shift: u32,
    mask: u32,
    /// The bit of a signed corner that makes it negative.
    sign: u32,
}

impl Compact {
    /// Most corners of a polygon that is read so, in one go.
    const CORNERS: usize = 16;

    fn new(plan: &RecordPlan, item: Type, encoding: Encoding) -> Option<Self> {
        let (before, count, after) = match plan.steps[..] {
            [WalkStep::Count { kind, .. }] => (0, kind, 0),
            [WalkStep::Skip(before), WalkStep::Count { kind, .. }] => (before, kind, 0),
            [WalkStep::Count { kind, .. }, WalkStep::Skip(after)] => (0, kind, after),
            [WalkStep::Skip(before), WalkStep::Count { kind, .. }, WalkStep::Skip(after)] => {
                (before, kind, after)
            }
            _ => return None,
        };
        if encoding == Encoding::Ascii || item.size() != 4 {
            return None;
        }
        let unused = 32 - 8 * count.size() as u32;
        let before = before as usize;
        let corners = before + count.size();
        Some(Self {
            before,
            corners,
            bare: corners + after as usize,
            shift: if encoding == Encoding::Big { unused } else { 0 },
            mask: u32::MAX >> unused,
            sign: if item == Type::I32 { 1 << 31 } else { 0 },
        })
    }

    /// Reads up to so many records that `bytes` begin with into `chunk`, up to one that is short or long.
    /// Returns the number of records and their bytes.
    #[inline(always)]
    fn read(
        &self,
        bytes: &[u8],
        records: u64,
        chunk: &mut FaceChunk,
        decode: impl Fn([u8; 4]) -> u32,
    ) -> (u64, usize) {
        let corner = |bytes: &[u8], at: usize| {
            let corner = decode(binary::bytes_at(bytes, at));
            if corner & self.sign == 0 { corner } else { u32::MAX }
        };
        let FaceChunk { triangles, continued, .. } = chunk;
        let (mut record, mut at) = (0, 0);
        while record < records && triangles.len() + Self::CORNERS <= CHUNK_TRIANGLES {
            let rest = &bytes[at..];
            // Records with fewer corners, which have no triangle, may be shorter.
            let Some(list) = rest.get(self.corners..self.bare + 12) else { break };
            let Some(triangle) = list.first_chunk::<12>() else { break };
            let length = (decode(binary::bytes_at(rest, self.before)) >> self.shift) & self.mask;
            match length as usize {
                3 => {
                    triangles.push([0, 4, 8].map(|at| corner(triangle, at)));
                    // A constant: the next record need not wait for the length of this one's list.
                    at += self.bare + 12;
                }
                corners @ 4..=Self::CORNERS if rest.len() >= self.bare + 4 * corners => {
                    let corner = |i: usize| corner(rest, self.corners + 4 * i);
                    let first = triangles.len() as u32;
                    continued.extend(first + 1..first + corners as u32 - 2);
                    triangles.extend((2..corners).map(|i| [corner(0), corner(i - 1), corner(i)]));
                    at += self.bare + 4 * corners;
                }
                _ => break,
            }
            record += 1;
        }
        (record, at)
    }
}

/// The list of corners in the records of an element, if it has triangles.
fn corner_list(element: &PlyElement) -> Option<IndexList> {
    if !matches!(element.name.as_str(), "face" | "tristrips") || element.count == 0 {
        return None;
    }
    element.properties.iter().enumerate().find_map(|(property, p)| match p.shape {
        PropertyShape::List { item, .. } if are_corners(p) => Some(IndexList { property, item }),
        _ => None,
    })
}

/// Whether a property is the list of the corners of faces.
pub(super) fn are_corners(property: &Property) -> bool {
    matches!(property.shape, PropertyShape::List { item, .. } if !item.is_float())
        && matches!(property.name.as_str(), "vertex_indices" | "vertex_index")
}

/// Indices of the elements that have triangles.
fn with_triangles(header: &PlyHeader) -> Vec<usize> {
    (0..header.elements.len()).filter(|&i| corner_list(&header.elements[i]).is_some()).collect()
}

/// Bytes of the file that a reader of all faces goes over; in a text file an estimate.
pub(super) fn bytes(model: &PlyModel) -> u64 {
    let with_triangles = with_triangles(&model.header);
    if model.header.encoding != Encoding::Ascii {
        with_triangles.iter().map(|&i| model.starts[i + 1] - model.starts[i]).sum()
    } else if with_triangles.is_empty() {
        0
    } else {
        // The size counts all bytes as faces that are no vertices.
        model.source.len().saturating_sub(model.header.len + model.info.vertex_bytes)
    }
}

/// Byte at which a face begins, if the length of the element shows that all faces are triangles: see
/// [`face_at`](crate::Model::face_at).
pub(super) fn triangle_at(model: &PlyModel, face: u64) -> Option<u64> {
    let [element] = with_triangles(&model.header)[..] else { return None };
    if model.header.encoding == Encoding::Ascii {
        return None;
    }
    let (start, end) = (model.starts[element], model.starts[element + 1]);
    let FaceElement { plan, compact, .. } =
        FaceElement::new(&model.header.elements[element], model.header.encoding, None);
    let bytes = compact?.bare as u64 + 12;
    let is_one = face <= plan.count && plan.count.checked_mul(bytes)? == end - start;
    is_one.then_some(start + face * bytes)
}

/// Whether all faces can be read from any mark on.
pub(super) fn are_marked(model: &PlyModel) -> bool {
    model.header.encoding != Encoding::Ascii && with_triangles(&model.header).len() == 1
}

impl<'a> PlyFaces<'a> {
    pub(super) fn new(model: &'a PlyModel) -> Result<Self> {
        Self::by(BLOCK, model)
    }

    /// Like [`Self::new`], reading so many bytes at a time.
    fn by(block_size: usize, model: &'a PlyModel) -> Result<Self> {
        let encoding = model.header.encoding;
        let with_triangles = with_triangles(&model.header);
        let part = |i: usize, start| FaceElement::new(&model.header.elements[i], encoding, start);
        let mut parts = Vec::new();
        if encoding != Encoding::Ascii {
            parts.extend(with_triangles.iter().map(|&i| part(i, Some(model.starts[i]))));
        } else if let (Some(&first), Some(&last)) = (with_triangles.first(), with_triangles.last()) {
            // Text has to be gone over from a known place on.
            let (known, start) = if first < model.vertex {
                (0, model.header.len)
            } else {
                let all = model.info.vertices;
                (model.vertex + 1, PlyReader::new(model, all..all)?.offset())
            };
            parts.extend((known..=last).map(|i| part(i, (i == known).then_some(start))));
        }
        let mut cursor = RecordCursor::new(encoding, BlockWindow::new(&model.source, block_size));
        if let Some(part) = parts.first() {
            cursor.enter(part);
        }
        // With several elements, a place in the file does not tell which one it is of.
        cursor.next_mark = if with_triangles.len() == 1 { 0 } else { NO_MARK };
        Ok(Self { parts, part: 0, cursor })
    }
}

impl FaceReader for PlyFaces<'_> {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        chunk.clear();
        let Some(part) = self.parts.get(self.part) else { return Ok(false) };
        chunk.triangles.reserve(CHUNK_TRIANGLES);
        let cursor = &mut self.cursor;
        let start = cursor.window.position();
        let mut more = true;
        while more && chunk.triangles.len() < CHUNK_TRIANGLES && chunk.bytes < CHUNK_BYTES as u64 {
            more = cursor.advance(part, chunk)?;
            chunk.bytes = cursor.window.position() - start;
        }
        if !more {
            if part.corners.is_some() && cursor.next_mark != NO_MARK {
                chunk.marks.push(cursor.mark(chunk.triangles.len()));
            }
            self.part += 1;
            if let Some(next) = self.parts.get(self.part) {
                cursor.enter(next);
            }
        }
        Ok(true)
    }
}

/// Reads the faces in some ranges of the file, each of whole records.
pub(super) struct SomeFaces<'a> {
    part: FaceElement,
    cursor: RecordCursor<'a>,
    ranges: std::vec::IntoIter<Range<u64>>,
    with_marks: bool,
}

impl<'a> SomeFaces<'a> {
    /// Reader of all faces from a mark on, with marks.
    pub(super) fn from(model: &'a PlyModel, mark: u64) -> Result<Self> {
        let end = with_triangles(&model.header).first().and_then(|element| model.starts.get(element + 1));
        let end = end.copied().unwrap_or(mark);
        Ok(Self { with_marks: true, ..Self::new(model, std::iter::once(mark..end).collect())? })
    }

    pub(super) fn new(model: &'a PlyModel, ranges: Vec<Range<u64>>) -> Result<Self> {
        let encoding = model.header.encoding;
        let [element] = with_triangles(&model.header)[..] else {
            return Err(Error::internal(format!(
                "{}: its faces can be read only all at once",
                model.source.path().display()
            )));
        };
        let part = FaceElement::new(&model.header.elements[element], encoding, None);
        let mut cursor = RecordCursor::new(encoding, BlockWindow::new(&model.source, BLOCK));
        cursor.window.limit = Some(0);
        Ok(Self { part, cursor, ranges: ranges.into_iter(), with_marks: false })
    }
}

impl FaceReader for SomeFaces<'_> {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        chunk.clear();
        chunk.triangles.reserve(CHUNK_TRIANGLES);
        let cursor = &mut self.cursor;
        while chunk.triangles.len() < CHUNK_TRIANGLES && chunk.bytes < CHUNK_BYTES as u64 {
            let before = cursor.window.position();
            let more = cursor.advance(&self.part, chunk)?;
            chunk.bytes += cursor.window.position() - before;
            if !more {
                if std::mem::replace(&mut cursor.next_mark, NO_MARK) != NO_MARK {
                    chunk.marks.push(cursor.mark(chunk.triangles.len()));
                }
                let Some(range) = self.ranges.next() else {
                    return Ok(chunk.bytes > 0 || !chunk.marks.is_empty());
                };
                cursor.window.seek(range.start);
                cursor.window.limit = Some(range.end.min(cursor.window.source.len()));
                cursor.record = 0;
                cursor.next_mark = if self.with_marks { 0 } else { NO_MARK };
            }
        }
        Ok(true)
    }
}

/// The record at which the next mark comes, where there are none.
const NO_MARK: u64 = u64::MAX;

/// A place in the records of a part.
struct RecordCursor<'a> {
    encoding: Encoding,
    window: BlockWindow<'a>,
    record: u64,
    /// Index into the steps of the record.
    step: usize,
    /// Units (bytes or words) to pass over before the next step.
    skip: u64,
    /// Corners of the list that are still to come.
    left: u64,
    fan: Fan,
    /// The record at which the next mark comes.
    next_mark: u64,
}

impl<'a> RecordCursor<'a> {
    /// Most corners, or words to pass over, of one [`Self::advance`].
    const AT_ONCE: usize = 1 << 12;

    fn new(encoding: Encoding, window: BlockWindow<'a>) -> Self {
        let (fan, next_mark) = (Fan::default(), NO_MARK);
        Self { encoding, window, record: 0, step: 0, skip: 0, left: 0, fan, next_mark }
    }

    /// Goes to the first record.
    fn enter(&mut self, part: &FaceElement) {
        (self.record, self.step) = (0, 0);
        if let Some(start) = part.start {
            self.window.seek(start);
        }
    }

    /// Goes on by a little: `false` at the end of the part. Adds no more triangles than fit into a chunk.
    fn advance(&mut self, part: &FaceElement, chunk: &mut FaceChunk) -> Result<bool> {
        let plan = &part.plan;
        if self.skip > 0 {
            self.pass(plan)?;
            return Ok(true);
        }
        if let (Some(list), 1..) = (part.corners, self.left) {
            self.read_corners(part, list.item, chunk)?;
            return Ok(true);
        }
        if self.step == 0 {
            if part.corners.is_some() {
                self.note_mark(chunk);
            }
            if let Some(compact) = &part.compact {
                self.read_compact(plan, compact, chunk);
            }
            if self.record == plan.count || self.window.is_drained() {
                return Ok(false);
            }
        }
        match plan.steps.get(self.step) {
            None => (self.record, self.step) = (self.record + 1, 0),
            Some(&WalkStep::Skip(units)) => (self.skip, self.step) = (units, self.step + 1),
            Some(&WalkStep::Count { property, kind, item }) => {
                let length = self.integer(plan, kind)?;
                let Ok(length) = u64::try_from(length) else {
                    return Err(self.wrong(plan, format_args!("a list of length {length}")));
                };
                if part.corners.is_some_and(|list| list.property == property) {
                    (self.left, self.fan) = (length, Fan::default());
                } else {
                    self.skip = length.saturating_mul(item);
                }
                self.step += 1;
            }
        }
        Ok(true)
    }

    /// Reads the records that lie in the window, as far as they are short.
    fn read_compact(&mut self, plan: &RecordPlan, compact: &Compact, chunk: &mut FaceChunk) {
        loop {
            let end = plan.count.min(self.next_mark);
            let (bytes, left) = (self.window.rest(), end.saturating_sub(self.record));
            let (records, bytes) = if self.encoding == Encoding::Big {
                compact.read(bytes, left, chunk, u32::from_be_bytes)
            } else {
                compact.read(bytes, left, chunk, u32::from_le_bytes)
            };
            self.record += records;
            self.window.at += bytes;
            if self.record < end || end == plan.count {
                return;
            }
            self.note_mark(chunk);
        }
    }

    /// Notes a mark at the current record, if a block begins there.
    fn note_mark(&mut self, chunk: &mut FaceChunk) {
        if self.record >= self.next_mark {
            self.next_mark = self.record + FACES_OF_A_BLOCK;
            chunk.marks.push(self.mark(chunk.triangles.len()));
        }
    }

    /// Mark at the current record, behind so many triangles.
    fn mark(&self, triangle: usize) -> FaceMark {
        FaceMark { triangle, offset: self.window.position() }
    }

    /// Reads corners of the list, each of which ends a triangle at most.
    fn read_corners(&mut self, part: &FaceElement, item: Type, chunk: &mut FaceChunk) -> Result<()> {
        let room = (CHUNK_TRIANGLES - chunk.triangles.len()).min(Self::AT_ONCE);
        for _ in 0..self.left.min(room as u64) {
            let index = self.integer(&part.plan, item)?;
            self.left -= 1;
            if part.strips {
                chunk.triangles.extend(self.fan.strip(index));
            } else {
                chunk.add_corner(&mut self.fan, index);
            }
        }
        Ok(())
    }

    /// Passes over the properties that are not read.
    fn pass(&mut self, plan: &RecordPlan) -> Result<()> {
        if self.encoding != Encoding::Ascii {
            if !self.window.pass(self.skip) {
                return Err(self.ends_early(plan));
            }
            self.skip = 0;
            return Ok(());
        }
        for _ in 0..self.skip.min(Self::AT_ONCE as u64) {
            self.word(plan)?;
            self.skip -= 1;
        }
        Ok(())
    }

    /// Reads the next number, in binary files of this type.
    #[inline]
    fn integer(&mut self, plan: &RecordPlan, kind: Type) -> Result<i64> {
        if self.encoding == Encoding::Ascii {
            let span = self.word(plan)?;
            let word = &self.window.block[span];
            return text::integer(word).ok_or_else(|| {
                let word = quoted(&String::from_utf8_lossy(word));
                self.wrong(plan, format_args!("{word} is no whole number"))
            });
        }
        if !self.window.holds(kind.size())? {
            return Err(self.ends_early(plan));
        }
        let value = binary::integer(kind, self.encoding == Encoding::Big, self.window.rest());
        self.window.at += kind.size();
        Ok(value)
    }

    /// Takes the next word of a text file, and returns its range in the window's block.
    fn word(&mut self, plan: &RecordPlan) -> Result<Range<usize>> {
        loop {
            let window = &mut self.window;
            let whole_file = window.is_last();
            if let Some((start, end)) = text::next_word(&window.block[..window.filled], window.at, whole_file)
            {
                window.at = end;
                return Ok(start..end);
            }
            if whole_file {
                return Err(self.ends_early(plan));
            }
            let rest = window.rest();
            window.at += rest.iter().position(|&b| !text::is_space(b)).unwrap_or(rest.len());
            if !window.refill()? {
                let what = format!("a word of more than {} bytes", window.block.len());
                return Err(self.wrong(plan, what));
            }
        }
    }

    fn ends_early(&self, plan: &RecordPlan) -> Error {
        self.window.source.malformed(plan.ends_early(self.record), CUT_OFF)
    }

    fn wrong(&self, plan: &RecordPlan, what: impl std::fmt::Display) -> Error {
        self.window.source.malformed(plan.wrong(self.record, what), DAMAGED)
    }
}

/// A block of the file that moves on.
struct BlockWindow<'a> {
    source: &'a SourceFile,
    block: Vec<u8>,
    /// Number of the block's bytes that were taken, and (`filled`) of those that were read.
    at: usize,
    filled: usize,
    /// Byte of the file at which the filled part ends.
    end: u64,
    /// Byte of the file beyond which nothing is read, if only a part of the file shall be read.
    limit: Option<u64>,
}

impl<'a> BlockWindow<'a> {
    fn new(source: &'a SourceFile, block_size: usize) -> Self {
        Self { source, block: vec![0; block_size], at: 0, filled: 0, end: 0, limit: None }
    }

    /// Byte of the file that comes next.
    fn position(&self) -> u64 {
        self.end - self.rest().len() as u64
    }

    /// Bytes that were read and not taken.
    fn rest(&self) -> &[u8] {
        &self.block[self.at..self.filled]
    }

    /// Whether no more bytes are to be read.
    fn is_last(&self) -> bool {
        self.end >= self.limit()
    }

    /// Whether all bytes of the part of the file that shall be read were taken.
    fn is_drained(&self) -> bool {
        self.limit.is_some_and(|limit| self.position() >= limit)
    }

    fn limit(&self) -> u64 {
        self.limit.unwrap_or_else(|| self.source.len())
    }

    fn seek(&mut self, position: u64) {
        (self.at, self.filled, self.end) = (0, 0, position);
    }

    /// Passes over so many bytes; `false` if there are fewer.
    fn pass(&mut self, bytes: u64) -> bool {
        if bytes <= self.rest().len() as u64 {
            self.at += bytes as usize;
            return true;
        }
        match self.position().checked_add(bytes) {
            Some(position) if position <= self.limit() => {
                self.seek(position);
                true
            }
            _ => false,
        }
    }

    /// Whether so many bytes, fewer than a block, are there; reads on where needed.
    #[inline]
    fn holds(&mut self, bytes: usize) -> Result<bool> {
        if self.filled - self.at < bytes {
            self.refill()?;
        }
        Ok(self.filled - self.at >= bytes)
    }

    /// Drops the bytes that were taken and reads on; `false` if nothing was taken of a full block.
    #[cold]
    fn refill(&mut self) -> Result<bool> {
        self.block.copy_within(self.at..self.filled, 0);
        self.filled -= self.at;
        self.at = 0;
        if self.filled == self.block.len() {
            return Ok(false);
        }
        let room =
            self.limit().saturating_sub(self.end).min((self.block.len() - self.filled) as u64) as usize;
        let read = self.source.read_at(&mut self.block[self.filled..self.filled + room], self.end)?;
        self.filled += read;
        self.end += read as u64;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use proptest::prelude::*;
    use tempfile::NamedTempFile;

    use super::*;
    use crate::Model;
    use crate::ply::header::Property;

    const ENCODINGS: [Encoding; 3] = [Encoding::Ascii, Encoding::Little, Encoding::Big];
    const INTEGERS: [Type; 6] = [Type::I8, Type::U8, Type::I16, Type::U16, Type::I32, Type::U32];

    fn scalar(kind: Type, name: &str) -> Property {
        Property { name: name.into(), shape: PropertyShape::Scalar(kind) }
    }

    fn list(count: Type, item: Type, name: &str) -> Property {
        Property { name: name.into(), shape: PropertyShape::List { count, item } }
    }

    /// An element and its records, each of which has a list of numbers for each property (for a scalar, of
    /// one).
    #[derive(Debug, Clone)]
    struct Table {
        name: &'static str,
        properties: Vec<Property>,
        records: Vec<Vec<Vec<i64>>>,
    }

    fn vertices(count: i64) -> Table {
        let properties = ["x", "y", "z"].map(|name| scalar(Type::F32, name)).to_vec();
        let record = |i: i64| vec![vec![i], vec![-i], vec![7]];
        Table { name: "vertex", properties, records: (0..count).map(record).collect() }
    }

    /// An element with nothing but these lists.
    fn lists(name: &'static str, property: Property, lists: &[&[i64]]) -> Table {
        let records = lists.iter().map(|list| vec![list.to_vec()]).collect();
        Table { name, properties: vec![property], records }
    }

    fn polygons(polygons: &[&[i64]]) -> Table {
        lists("face", list(Type::U8, Type::I32, "vertex_indices"), polygons)
    }

    fn put(bytes: &mut Vec<u8>, encoding: Encoding, kind: Type, value: i64) {
        macro_rules! put {
            ($t:ty) => {
                match encoding {
                    Encoding::Ascii => bytes.extend(format!("{value} ").bytes()),
                    Encoding::Little => bytes.extend((value as $t).to_le_bytes()),
                    Encoding::Big => bytes.extend((value as $t).to_be_bytes()),
                }
            };
        }
        match kind {
            Type::I8 => put!(i8),
            Type::U8 => put!(u8),
            Type::I16 => put!(i16),
            Type::U16 => put!(u16),
            Type::I32 => put!(i32),
            Type::U32 => put!(u32),
            Type::F32 => put!(f32),
            Type::F64 => put!(f64),
        }
    }

    fn header(encoding: Encoding, tables: &[Table]) -> String {
        let name = encoding.name().replace(' ', "_");
        let mut header = format!("ply\nformat {name} 1.0\n");
        for table in tables {
            header += &format!("element {} {}\n", table.name, table.records.len());
            for property in &table.properties {
                header += &format!("property {}\n", property.describe());
            }
        }
        header + "end_header\n"
    }

    fn file(encoding: Encoding, tables: &[Table]) -> Vec<u8> {
        let mut bytes = header(encoding, tables).into_bytes();
        for table in tables {
            for record in &table.records {
                for (property, values) in table.properties.iter().zip(record) {
                    let kind = match property.shape {
                        PropertyShape::Scalar(kind) => kind,
                        PropertyShape::List { count, item } => {
                            put(&mut bytes, encoding, count, values.len() as i64);
                            item
                        }
                    };
                    values.iter().for_each(|&value| put(&mut bytes, encoding, kind, value));
                }
                if encoding == Encoding::Ascii {
                    bytes.push(b'\n');
                }
            }
        }
        bytes
    }

    fn open(bytes: &[u8]) -> Result<PlyModel> {
        let mut file = NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        // The open file outlives its name.
        PlyModel::new(SourceFile::open(file.path(), None)?)
    }

    fn read_by(block: usize, model: &PlyModel) -> Result<Vec<[u32; 3]>> {
        let mut faces = PlyFaces::by(block, model)?;
        let mut chunk = FaceChunk::default();
        let (mut all, mut bytes) = (Vec::new(), 0);
        while faces.read(&mut chunk)? {
            assert!(chunk.triangles.len() <= CHUNK_TRIANGLES);
            all.extend_from_slice(&chunk.triangles);
            bytes += chunk.bytes;
        }
        assert!(chunk.triangles.is_empty() && chunk.bytes == 0 && !faces.read(&mut chunk)?);
        if model.header.encoding == Encoding::Ascii {
            assert!(bytes <= model.info.bytes);
        } else {
            assert_eq!(bytes, model.info.face_bytes);
        }
        Ok(all)
    }

    fn read(bytes: &[u8]) -> Result<Vec<[u32; 3]>> {
        read_by(BLOCK, &open(bytes)?)
    }

    fn error(bytes: &[u8]) -> String {
        let error = read(bytes).unwrap_err().to_string();
        // Without the file's name.
        error.split_once(": ").unwrap().1.to_owned()
    }

    /// The fans of polygons.
    fn fans(polygons: &[&[i64]]) -> Vec<[u32; 3]> {
        let corner = |v: i64| if (0..i64::from(u32::MAX)).contains(&v) { v as u32 } else { u32::MAX };
        let fan = |p: &&[i64]| (2..p.len()).map(|i| [p[0], p[i - 1], p[i]].map(corner)).collect::<Vec<_>>();
        polygons.iter().flat_map(fan).collect()
    }

    #[test]
    fn polygons_of_every_type_in_every_encoding() {
        let all: [&[i64]; 9] = [
            &[0, 1, 2],
            &[3, 2, 1, 0],
            &[],
            &[5],
            &[6, 7],
            &[1, 2, 3],
            &[9; 17],
            &[4, 100, 127, 3, 2, 90],
            &[8, 8, 120],
        ];
        for encoding in ENCODINGS {
            for (count, item) in INTEGERS.iter().flat_map(|&c| INTEGERS.map(|i| (c, i))) {
                for name in ["vertex_indices", "vertex_index"] {
                    let table = lists("face", list(count, item, name), &all);
                    let triangles = read(&file(encoding, &[vertices(3), table])).unwrap();
                    assert_eq!(triangles, fans(&all), "{encoding:?} {count:?} {item:?}");
                }
            }
        }
    }

    #[test]
    fn elements_and_properties_of_any_sort_lie_around() {
        let corners = || list(Type::I16, Type::U16, "vertex_indices");
        let mixed = Table {
            name: "face",
            properties: vec![
                scalar(Type::F64, "quality"),
                list(Type::U8, Type::F32, "texcoord"),
                corners(),
                list(Type::U32, Type::U8, "vertex_index"),
                scalar(Type::U8, "flags"),
            ],
            records: vec![
                vec![vec![1], vec![7; 6], vec![0, 1, 2], vec![9, 9, 9], vec![5]],
                vec![vec![-1], vec![], vec![3, 4, 5, 6], vec![], vec![6]],
            ],
        };
        let framed = Table {
            name: "face",
            properties: vec![
                scalar(Type::U8, "a"),
                list(Type::U16, Type::U32, "vertex_indices"),
                scalar(Type::I16, "b"),
            ],
            records: vec![
                vec![vec![3], vec![20, 21, 22], vec![3]],
                vec![vec![4], vec![23, 24], vec![4]],
                vec![vec![3], vec![25, 26, 27, 28], vec![3]],
            ],
        };
        let strips = || lists("tristrips", list(Type::I32, Type::I32, "vertex_indices"), &[&[7, 8, 9, 10]]);
        let camera = || {
            let properties = vec![scalar(Type::F32, "focus"), list(Type::U8, Type::I8, "name")];
            Table { name: "camera", properties, records: vec![vec![vec![35], vec![1, 2]]; 3] }
        };
        let other = || lists("edge", list(Type::U8, Type::I32, "vertex_indices"), &[&[1, 2, 3]]);
        let floats = || lists("face", list(Type::U8, Type::F32, "vertex_indices"), &[&[1, 2, 3]]);
        let none = || Table {
            name: "face",
            properties: vec![scalar(Type::I32, "id")],
            records: vec![vec![vec![3]]],
        };
        let empty = || Table { name: "face", properties: vec![], records: vec![vec![]; 5] };

        let in_mixed = vec![[0, 1, 2], [3, 4, 5], [3, 5, 6]];
        let in_framed = vec![[20, 21, 22], [25, 26, 27], [25, 27, 28]];
        let in_strips = vec![[7, 8, 9], [9, 8, 10]];
        let files = [
            (vec![vertices(2)], vec![]),
            (vec![vertices(2), polygons(&[])], vec![]),
            (vec![floats(), vertices(2), none(), other(), empty()], vec![]),
            (vec![vertices(2), mixed.clone()], in_mixed.clone()),
            (vec![mixed.clone(), vertices(2)], in_mixed.clone()),
            (vec![vertices(0), camera(), floats(), framed.clone(), other()], in_framed.clone()),
            (vec![camera(), framed.clone(), none(), vertices(9), camera()], in_framed.clone()),
            (
                vec![mixed, camera(), vertices(2), strips(), empty(), camera(), framed],
                [in_mixed, in_strips, in_framed].concat(),
            ),
        ];
        for encoding in ENCODINGS {
            for (tables, triangles) in &files {
                let model = open(&file(encoding, tables)).unwrap();
                for block in [24, 25, 31, 32, 100, BLOCK] {
                    assert_eq!(&read_by(block, &model).unwrap(), triangles, "{encoding:?} {block}");
                }
                assert_eq!(model.info.face_bytes == 0, triangles.is_empty());
            }
        }
    }

    /// The faces between any mark and any other are read, and no others.
    #[test]
    fn faces_are_read_between_marks() {
        let lists: Vec<Vec<i64>> = (0..100)
            .map(|i| (0..[3, 3, 4, 2, 3, 0, 17][i % 7]).map(|k| (7 * i + k) as i64).collect())
            .collect();
        let lists: Vec<&[i64]> = lists.iter().map(Vec::as_slice).collect();
        for encoding in ENCODINGS {
            for name in ["face", "tristrips"] {
                let table = self::lists(name, list(Type::U8, Type::I32, "vertex_indices"), &lists);
                let model = open(&file(encoding, &[vertices(2), table.clone()])).unwrap();
                let mut chunk = FaceChunk::default();
                let mut faces = PlyFaces::new(&model).unwrap();
                assert!(faces.read(&mut chunk).unwrap());
                let (all, marks) = (chunk.triangles.clone(), chunk.marks.clone());
                assert_eq!(marks.len() as u64, 100u64.div_ceil(FACES_OF_A_BLOCK) + 1);
                for (i, from) in marks.iter().enumerate() {
                    for to in &marks[i + 1..] {
                        let end = marks.last().unwrap();
                        let ranges = vec![from.offset..to.offset, end.offset - 1..end.offset - 1];
                        let mut some = SomeFaces::new(&model, ranges).unwrap();
                        assert!(some.read(&mut chunk).unwrap());
                        assert_eq!(chunk.triangles, all[from.triangle..to.triangle], "{encoding:?} {name}");
                        assert_eq!(chunk.bytes, to.offset - from.offset);
                        assert!(!some.read(&mut chunk).unwrap() && chunk.triangles.is_empty());
                        // A range that ends within a face.
                        let mut cut =
                            SomeFaces::new(&model, std::iter::once(from.offset..to.offset - 2).collect())
                                .unwrap();
                        assert!(encoding == Encoding::Ascii || cut.read(&mut chunk).is_err());
                    }
                }
                let two = lists_of_two(&table, encoding);
                assert!(two.1.is_empty() && SomeFaces::new(&two.0, Vec::new()).is_err());
            }
        }
    }

    /// A model with two elements of faces, and its marks.
    fn lists_of_two(table: &Table, encoding: Encoding) -> (PlyModel, Vec<FaceMark>) {
        let model = open(&file(encoding, &[vertices(2), table.clone(), polygons(&[&[1, 2, 3]])])).unwrap();
        let mut chunk = FaceChunk::default();
        assert!(PlyFaces::new(&model).unwrap().read(&mut chunk).unwrap());
        (model, chunk.marks)
    }

    #[test]
    fn strips_alternate_and_begin_anew() {
        let strip: [&[i64]; 3] =
            [&[0, 1, 2, 3, 4, -1, 5, 6, 7, -1, -1, 8, 9, -1], &[10, 11], &[12, 13, 14, 14]];
        let triangles = [[0, 1, 2], [2, 1, 3], [2, 3, 4], [5, 6, 7], [12, 13, 14], [14, 13, 14]];
        for encoding in ENCODINGS {
            for item in [Type::I8, Type::I16, Type::I32, Type::U32] {
                let table = lists("tristrips", list(Type::I32, item, "vertex_indices"), &strip);
                assert_eq!(read(&file(encoding, &[vertices(1), table])).unwrap(), triangles);
            }
        }
    }

    #[test]
    fn indices_that_no_vertex_has_are_told() {
        let most = i64::from(u32::MAX);
        let signed: [&[i64]; 2] = [&[0, -1, -128], &[5, i64::from(i32::MAX), i64::from(i32::MIN), 4]];
        let unsigned: [&[i64]; 2] = [&[most - 1, most, 1 << 31], &[0, most, most, 7]];
        for encoding in ENCODINGS {
            for (item, all) in [(Type::I32, signed), (Type::U32, unsigned)] {
                // Read all at once, and number by number.
                for count in [list(Type::U8, item, "vertex_index"), list(Type::I8, item, "vertex_index")] {
                    let both = Table {
                        name: "face",
                        properties: vec![count.clone(), list(Type::U8, Type::U8, "more")],
                        records: all.iter().map(|p| vec![p.to_vec(), vec![1]]).collect(),
                    };
                    for table in [lists("face", count, &all), both] {
                        assert_eq!(read(&file(encoding, &[vertices(1), table])).unwrap(), fans(&all));
                    }
                }
            }
        }
        let huge: [&[i64]; 1] = [&[i64::MAX, most, 1 << 40]];
        let text = file(Encoding::Ascii, &[vertices(1), polygons(&huge)]);
        assert_eq!(read(&text).unwrap(), [[u32::MAX; 3]]);
    }

    #[test]
    fn blocks_of_any_size_give_the_same() {
        let all: [&[i64]; 8] = [
            &[0, 1, 2],
            &[3, 4, 5],
            &[6; 20],
            &[7, 8],
            &[],
            &[9, 10, 11, 12],
            &[13, 14, 15],
            &[16, 17, 100_000],
        ];
        for encoding in ENCODINGS {
            for count in [Type::U8, Type::I32] {
                let table = lists("face", list(count, Type::I32, "vertex_indices"), &all);
                let model = open(&file(encoding, &[vertices(2), table])).unwrap();
                for block in 8..200 {
                    assert_eq!(read_by(block, &model).unwrap(), fans(&all), "{encoding:?} {block}");
                }
            }
        }
    }

    #[test]
    fn lists_and_elements_longer_than_chunks() {
        let fan: Vec<i64> = (0..2 * CHUNK_TRIANGLES as i64 + 100).collect();
        let triangle = [7, 8, 9];
        for encoding in ENCODINGS {
            let table = lists("face", list(Type::I32, Type::I32, "vertex_indices"), &[&fan, &triangle, &fan]);
            let triangles = read(&file(encoding, &[vertices(1), table])).unwrap();
            assert_eq!(triangles, fans(&[&fan, &triangle, &fan]));

            let strip = lists("tristrips", list(Type::I32, Type::I32, "vertex_indices"), &[&fan]);
            let triangles = read(&file(encoding, &[vertices(1), strip])).unwrap();
            assert_eq!(triangles.len(), fan.len() - 2);
            assert!(triangles.iter().zip(0..).all(|(t, i)| t.iter().sum::<u32>() == 3 * i + 3));

            let quads: Vec<Vec<i64>> = fan.windows(4).map(<[i64]>::to_vec).collect();
            let quads: Vec<&[i64]> = quads.iter().map(Vec::as_slice).collect();
            assert_eq!(read(&file(encoding, &[vertices(1), polygons(&quads)])).unwrap(), fans(&quads));
        }
    }

    #[test]
    fn chunks_end_where_there_are_no_triangles() {
        let mut bytes = header(Encoding::Little, &[vertices(0), polygons(&[])])
            .replace("face 0", "face 10000000")
            .into_bytes();
        bytes.resize(bytes.len() + 10_000_000, 0);
        let model = open(&bytes).unwrap();
        let mut faces = model.faces().unwrap();
        let mut chunk = FaceChunk::default();
        let mut chunks = 0;
        while faces.read(&mut chunk).unwrap() {
            assert!(chunk.triangles.is_empty() && chunk.bytes <= CHUNK_BYTES as u64);
            chunks += 1;
        }
        assert_eq!(chunks, 3);
    }

    #[test]
    fn cut_off_anywhere() {
        let all: [&[i64]; 4] = [&[0, 1, 2], &[2, 1, 3, 4], &[], &[1, 2, 3]];
        let strips = lists("tristrips", list(Type::I32, Type::I32, "vertex_indices"), &[&[7, 8, 9, -1, 5]]);
        for encoding in ENCODINGS {
            for tables in
                [[vertices(2), polygons(&all), strips.clone()], [strips.clone(), polygons(&all), vertices(2)]]
            {
                let bytes = file(encoding, &tables);
                let triangles = read(&bytes).unwrap();
                for end in 0..bytes.len() {
                    match read(&bytes[..end]) {
                        // The spaces behind the last number of a text may be missing.
                        Ok(read) => {
                            assert_eq!(encoding, Encoding::Ascii);
                            assert_eq!(read, triangles, "{end}");
                        }
                        Err(error) => assert!(!error.hint().is_empty()),
                    }
                }
            }
        }
        let text = file(Encoding::Ascii, &[vertices(2), polygons(&all)]);
        assert_eq!(error(&text[..text.len() - 5]), "the file ends within element \"face\", record 3 of 4");
    }

    #[test]
    fn a_file_that_only_looks_like_triangles() {
        let triangles = vec![&[67_108_864i64, 2, 3][..]; 100_000];
        let mut bytes = file(Encoding::Little, &[vertices(1), polygons(&triangles)]);
        let last_but_one = bytes.len() - 26;
        bytes[last_but_one] = 4;
        assert_eq!(error(&bytes), "the file ends within element \"face\", record 99999 of 100000");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_record() {
        let text = |faces: &str| {
            let header = header(Encoding::Ascii, &[vertices(0), polygons(&[&[], &[]])]);
            error(&[header.as_bytes(), faces.as_bytes()].concat())
        };
        let wrong = |what: &str| format!("element \"face\", record 1: {what}");
        assert_eq!(text("3 0 1 2 -1 0"), wrong("a list of length -1"));
        assert_eq!(text("3 0 1 2\n3.5 0"), wrong("\"3.5\" is no whole number"));
        assert_eq!(text("3 0 1 2\n3 0 1 x\u{e9}"), wrong("\"x\u{e9}\" is no whole number"));
        assert_eq!(text("3 0 1 2\n3 0 1 1e3"), wrong("\"1e3\" is no whole number"));
        assert_eq!(
            text(&format!("3 0 1 2 3 {}", "9".repeat(BLOCK + 1))),
            wrong("a word of more than 262144 bytes")
        );
        let endless = "the file ends within element \"face\", record 1 of 2";
        assert_eq!(text("0 99999999999999999999 0"), endless);

        // A long element is opened by a few of its lists, so that a wrong one shows only when the faces are
        // read.
        let triangles = vec![&[0i64, 2, 3][..]; 100_000];
        let table = lists("face", list(Type::I8, Type::I32, "vertex_indices"), &triangles);
        let mut bytes = file(Encoding::Big, &[vertices(1), table]);
        let last_but_one = bytes.len() - 26;
        bytes[last_but_one] = 0x80;
        assert_eq!(error(&bytes), "element \"face\", record 99998: a list of length -128");
    }

    fn tables() -> impl Strategy<Value = (Vec<Table>, Vec<[u32; 3]>)> {
        let integer = || prop::sample::select(&INTEGERS[..]);
        let polygon = prop_oneof![
            8 => prop::collection::vec(0..128i64, 3),
            2 => prop::collection::vec(0..128i64, 0..7),
            1 => prop::collection::vec(0..128i64, 0..40),
        ];
        let all = prop::collection::vec(polygon, 0..60);
        (all, integer(), integer(), any::<[bool; 4]>()).prop_map(|(all, count, item, [a, b, c, first])| {
            let mut properties = vec![list(count, item, "vertex_indices")];
            let mut records: Vec<Vec<_>> = all.iter().map(|p| vec![p.clone()]).collect();
            let mut add = |at: usize, property, value: Vec<i64>| {
                properties.insert(at, property);
                records.iter_mut().for_each(|record| record.insert(at, value.clone()));
            };
            if a {
                add(1, scalar(Type::U16, "after"), vec![3]);
            }
            if b {
                add(0, scalar(Type::U8, "before"), vec![3]);
            }
            if c {
                add(0, list(Type::U8, Type::F32, "more"), vec![3, 3, 3]);
            }
            let mut tables = vec![vertices(3), Table { name: "face", properties, records }];
            if first {
                tables.reverse();
            }
            let all: Vec<&[i64]> = all.iter().map(Vec::as_slice).collect();
            (tables, fans(&all))
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..Default::default() })]

        #[test]
        fn what_was_written_is_read(
            (tables, triangles) in tables(),
            encoding in prop::sample::select(&ENCODINGS[..]),
            block in prop_oneof![24..100usize, 100..5000usize],
        ) {
            let model = open(&file(encoding, &tables)).unwrap();
            prop_assert_eq!(read_by(block, &model).unwrap(), triangles);
        }

        #[test]
        fn spoilt_files_give_errors_or_something(
            (tables, _) in tables(),
            encoding in prop::sample::select(&ENCODINGS[..]),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..5),
        ) {
            let mut bytes = file(encoding, &tables);
            let data = header(encoding, &tables).len();
            for (at, byte) in changes {
                let at = data + at.index(bytes.len() - data);
                bytes[at] = byte;
            }
            let _ = read(&bytes);
        }
    }
}
