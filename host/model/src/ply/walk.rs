//! Goes over elements without reading their numbers: to find where an element ends, and whether the file does
//! so too early.
//!
//! The walker is fed the file block by block, of any size, and keeps a few bytes between them. It counts in
//! bytes in a binary file, and in words in a text file; all the rest is the same for both.

use std::fmt::Display;

use super::binary;
use super::header::{DAMAGED, Encoding, PlyElement, Property, PropertyShape, quoted};
use crate::Type;
use crate::progress::Silent;
use crate::source::SourceFile;
use crate::text::is_space;
use crate::{Progress, Result};

pub(super) use crate::text::CUT_OFF;

/// Longest word that can be the length of a list.
const LONGEST_COUNT: usize = 32;

/// Bytes read at a time.
const BLOCK: usize = 1 << 18;

#[derive(Debug, Clone, Copy)]
pub(super) enum WalkStep {
    /// Number of units (bytes or words) that are passed over.
    Skip(u64),
    /// The length of the list that the property of this index is, whose items take so many units each.
    Count { property: usize, kind: Type, item: u64 },
}

/// Steps of one record, and the number of records.
#[derive(Debug)]
pub(super) struct RecordPlan {
    name: String,
    pub(super) count: u64,
    pub(super) steps: Vec<WalkStep>,
    /// Number of units of a record, where no property is a list: all records are one skip.
    fixed: Option<u64>,
}

impl RecordPlan {
    pub(super) fn new(element: &PlyElement, encoding: Encoding) -> Self {
        let size = |t: Type| if encoding == Encoding::Ascii { 1 } else { t.size() as u64 };
        let (name, count) = (element.name.clone(), element.count);
        if !element.has_lists() {
            let record = element.properties.iter().fold(0, |sum, p| match p.shape {
                PropertyShape::Scalar(t) | PropertyShape::List { count: t, .. } => sum + size(t),
            });
            // More than any file holds, if it overflows.
            let all = record.saturating_mul(count);
            return Self { name, count: 1, steps: vec![WalkStep::Skip(all)], fixed: Some(record) };
        }
        let mut steps = Vec::new();
        for (property, Property { shape, .. }) in element.properties.iter().enumerate() {
            match (*shape, steps.last_mut()) {
                (PropertyShape::Scalar(t), Some(WalkStep::Skip(units))) => *units += size(t),
                (PropertyShape::Scalar(t), _) => steps.push(WalkStep::Skip(size(t))),
                (PropertyShape::List { count, item }, _) => {
                    steps.push(WalkStep::Count { property, kind: count, item: size(item) });
                }
            }
        }
        Self { name, count, steps, fixed: None }
    }

    /// Message on a file that ends within this record.
    pub(super) fn ends_early(&self, record: u64) -> String {
        let (name, count) = (quoted(&self.name), self.count);
        match self.fixed {
            Some(_) => format!("the file ends within element {name}"),
            None => format!("the file ends within element {name}, record {record} of {count}"),
        }
    }

    /// Message on a malformed record.
    pub(super) fn wrong(&self, record: u64, what: impl Display) -> String {
        format!("element {}, record {record}: {what}", quoted(&self.name))
    }
}

/// Goes over the records of consecutive elements.
#[derive(Debug)]
pub(super) struct Walker {
    encoding: Encoding,
    plans: Vec<RecordPlan>,
    /// Position of the walk: index into `plans`, record, index into the steps of the record.
    plan: usize,
    record: u64,
    step: usize,
    /// Units to pass by before the next step.
    skip: u64,
    /// The first bytes of a list's length that a block ended within; in text, of any word but one passed by.
    partial: Vec<u8>,
    /// Whether a block of text ended within a word.
    in_word: bool,
}

impl Walker {
    pub(super) fn new(elements: &[PlyElement], encoding: Encoding) -> Self {
        let plans = elements.iter().map(|e| RecordPlan::new(e, encoding)).collect();
        let (partial, in_word) = (Vec::new(), false);
        let mut walker = Self { encoding, plans, plan: 0, record: 0, step: 0, skip: 0, partial, in_word };
        walker.settle();
        walker
    }

    /// Bytes that follow and that need not be fed: call [`Self::pass`] instead.
    fn passable(&self) -> u64 {
        if self.encoding == Encoding::Ascii { 0 } else { self.skip }
    }

    fn pass(&mut self, bytes: u64) {
        self.skip -= bytes;
        self.settle();
    }

    fn is_done(&self) -> bool {
        self.plan == self.plans.len()
    }

    /// Takes the next bytes of the file. Returns the number of bytes that belong to the elements: fewer than
    /// all, or all of them at the exact end, once the walk is done. The error tells the fault, without the
    /// file's name.
    pub(super) fn feed(&mut self, bytes: &[u8]) -> Result<usize, String> {
        match self.encoding {
            Encoding::Ascii => self.feed_words(bytes),
            Encoding::Little | Encoding::Big => self.feed_binary(bytes),
        }
    }

    /// Ends the walk at the end of the file: an error unless all elements are complete.
    pub(super) fn finish(&mut self) -> Result<(), String> {
        if self.in_word {
            // The end of the file ends a word as well.
            self.feed_words(b" ")?;
        }
        if self.is_done() { Ok(()) } else { Err(self.ends_early()) }
    }

    fn ends_early(&self) -> String {
        match self.plans.get(self.plan) {
            Some(plan) => plan.ends_early(self.record),
            None => "the file ends early".into(),
        }
    }

    /// Goes on to the next step for which bytes have to be read.
    fn settle(&mut self) {
        while self.skip == 0 {
            let Some(plan) = self.plans.get(self.plan) else { return };
            if self.record == plan.count || plan.steps.is_empty() {
                (self.plan, self.record, self.step) = (self.plan + 1, 0, 0);
                continue;
            }
            match plan.steps.get(self.step) {
                None => (self.record, self.step) = (self.record + 1, 0),
                Some(WalkStep::Skip(units)) => (self.skip, self.step) = (*units, self.step + 1),
                Some(WalkStep::Count { .. }) => return,
            }
        }
    }

    /// The list whose length comes next.
    fn expected_count(&self) -> Option<(Type, u64)> {
        if self.skip > 0 {
            return None;
        }
        match self.plans.get(self.plan)?.steps.get(self.step)? {
            WalkStep::Count { kind, item, .. } => Some((*kind, *item)),
            WalkStep::Skip(_) => None,
        }
    }

    fn begin_list(&mut self, length: u64, item: u64) {
        self.skip = length.saturating_mul(item);
        self.step += 1;
        self.settle();
    }

    fn bad_length(&self, length: &str) -> String {
        let what = format!("a list of length {length}");
        match self.plans.get(self.plan) {
            Some(plan) => plan.wrong(self.record, what),
            None => what,
        }
    }

    fn feed_binary(&mut self, bytes: &[u8]) -> Result<usize, String> {
        let big = self.encoding == Encoding::Big;
        let mut at = 0;
        while !self.is_done() {
            if self.skip > 0 {
                let passed = self.skip.min((bytes.len() - at) as u64);
                if passed == 0 {
                    break;
                }
                at += passed as usize;
                self.pass(passed);
            }
            let Some((kind, item)) = self.expected_count() else { continue };
            let rest = &bytes[at..];
            let wanted = kind.size() - self.partial.len();
            if rest.len() < wanted {
                self.partial.extend_from_slice(rest);
                return Ok(bytes.len());
            }
            at += wanted;
            let length = if self.partial.is_empty() {
                binary::integer(kind, big, rest)
            } else {
                self.partial.extend_from_slice(&rest[..wanted]);
                let length = binary::integer(kind, big, &self.partial);
                self.partial.clear();
                length
            };
            let length = u64::try_from(length).map_err(|_| self.bad_length(&length.to_string()))?;
            self.begin_list(length, item);
        }
        Ok(at)
    }

    fn feed_words(&mut self, bytes: &[u8]) -> Result<usize, String> {
        let mut at = 0;
        while !self.is_done() {
            if !self.in_word {
                let Some(spaces) = bytes[at..].iter().position(|&b| !is_space(b)) else {
                    return Ok(bytes.len());
                };
                at += spaces;
            }
            let rest = &bytes[at..];
            let end = rest.iter().position(|&b| is_space(b));
            let word = &rest[..end.unwrap_or(rest.len())];
            if self.skip == 0 && self.partial.len() + word.len() <= LONGEST_COUNT {
                self.partial.extend_from_slice(word);
            } else if self.skip == 0 {
                return Err(self.bad_length("that is no number"));
            }
            at += word.len();
            self.in_word = end.is_none();
            if self.in_word {
                return Ok(bytes.len());
            }
            if let Some((_, item)) = self.expected_count() {
                let text = String::from_utf8_lossy(&self.partial);
                let length = text.parse().map_err(|_| self.bad_length(&quoted(&text)))?;
                self.partial.clear();
                self.begin_list(length, item);
            } else {
                self.pass(1);
            }
        }
        Ok(at)
    }
}

/// Walks over `elements`, which begin at `start` of the file; returns the byte at which they end.
pub(super) fn walk(
    source: &SourceFile,
    encoding: Encoding,
    elements: &[PlyElement],
    start: u64,
    progress: &dyn Progress,
) -> Result<u64> {
    walk_by(BLOCK, source, encoding, elements, start, progress)
}

/// Like [`walk`], reading so many bytes at a time.
fn walk_by(
    block_size: usize,
    source: &SourceFile,
    encoding: Encoding,
    elements: &[PlyElement],
    start: u64,
    progress: &dyn Progress,
) -> Result<u64> {
    let mut walker = Walker::new(elements, encoding);
    let mut block = Vec::new();
    let mut at = start;
    while !walker.is_done() {
        progress.check()?;
        let passable = walker.passable();
        if passable > block_size as u64 {
            let passed = passable.min(source.len() - at);
            walker.pass(passed);
            at += passed;
        }
        block.clear();
        let read = source.append_at(&mut block, at, block_size)?;
        if read == 0 {
            walker.finish().map_err(|what| source.malformed(what, CUT_OFF))?;
            break;
        }
        let fed = walker.feed(&block).map_err(|what| source.malformed(what, DAMAGED))? as u64;
        at += fed;
        progress.advance(fed);
    }
    Ok(at)
}

/// Returns the bytes at which the elements of a binary file begin, and after them the end of the last one.
///
/// Elements without lists are summed up. Those with lists would have to be read in full; but most meshes have
/// triangles alone, and then the rest of the file is as long as that many records of the first one's size.
/// Where that is so, and some records all over the element have that size, it is taken as complete.
pub(super) fn extents(
    source: &SourceFile,
    encoding: Encoding,
    elements: &[PlyElement],
    start: u64,
) -> Result<Vec<u64>> {
    let mut at = start;
    let mut starts = vec![at];
    for (i, element) in elements.iter().enumerate() {
        let left = source.len() - at;
        let bytes = element.min_bytes().checked_mul(element.count);
        let Some(bytes) = bytes.filter(|&b| b <= left) else {
            let least = if element.has_lists() { "at least " } else { "" };
            let (count, record) = (element.count, element.min_bytes());
            let records = if element.name == "vertex" {
                "vertices".into()
            } else {
                format!("records of element {}", quoted(&element.name))
            };
            let place = if i == 0 { "follow the header" } else { "are left for them" };
            let what = format!(
                "says {count} {records} of {least}{record} bytes each, but only {left} bytes {place}"
            );
            return Err(source.malformed(what, CUT_OFF));
        };
        at = if !element.has_lists() {
            at + bytes
        } else if let Some(end) = uniform_lists(source, encoding, element, &elements[i + 1..], at) {
            end
        } else {
            walk(source, encoding, std::slice::from_ref(element), at, &Silent)?
        };
        starts.push(at);
    }
    Ok(starts)
}

/// End of an element with lists, if the file is exactly as long as if all records of the element had the size
/// of the first one, and no lists follow in the elements `after`.
fn uniform_lists(
    source: &SourceFile,
    encoding: Encoding,
    element: &PlyElement,
    after: &[PlyElement],
    start: u64,
) -> Option<u64> {
    /// Smaller elements are read in full.
    const SMALL: u64 = 4 * BLOCK as u64;
    /// Records that are looked at.
    const PROBES: u64 = 64;
    const PROBE_BLOCK: usize = 512;

    let left = source.len() - start;
    if left < SMALL || element.count == 0 || after.iter().any(PlyElement::has_lists) {
        return None;
    }
    let one = PlyElement { count: 1, ..element.clone() };
    // An error in a record is reported by the walk over all of them.
    let record_size = |at| {
        walk_by(PROBE_BLOCK, source, encoding, std::slice::from_ref(&one), at, &Silent).map(|end| end - at)
    };
    let Ok(size) = record_size(start) else { return None };
    let tail = after.iter().try_fold(0u64, |sum, e| sum.checked_add(e.count.checked_mul(e.min_bytes())?));
    let end = size.checked_mul(element.count).and_then(|all| all.checked_add(start));
    let (Some(tail), Some(end)) = (tail, end) else { return None };
    if end.checked_add(tail) != Some(source.len()) {
        return None;
    }
    for probe in 1..=PROBES {
        let record = (u128::from(element.count - 1) * u128::from(probe) / u128::from(PROBES)) as u64;
        if record_size(start + record * size).ok() != Some(size) {
            return None;
        }
    }
    Some(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENCODINGS: [Encoding; 3] = [Encoding::Ascii, Encoding::Little, Encoding::Big];

    /// Two elements with and without lists, and the data of two and three records of them.
    fn elements() -> Vec<PlyElement> {
        let scalar = |t| Property { name: "s".into(), shape: PropertyShape::Scalar(t) };
        let list = |count, item| Property { name: "l".into(), shape: PropertyShape::List { count, item } };
        let element = |name: &str, count, properties| PlyElement { name: name.into(), count, properties };
        vec![
            element("empty", 5, vec![]),
            element("none", 0, vec![list(Type::U8, Type::U8)]),
            element("plain", 2, vec![scalar(Type::F64), scalar(Type::U8)]),
            element(
                "lists",
                3,
                vec![scalar(Type::I16), list(Type::U32, Type::I16), list(Type::I8, Type::F64)],
            ),
        ]
    }

    fn data(encoding: Encoding) -> Vec<u8> {
        if encoding == Encoding::Ascii {
            return b"1.5 2\n3 4 \n 0 2 7 7 1 8.25\r\n0 0 0\n0 1 7\t0".to_vec();
        }
        let mut data = vec![7; 2 * 9];
        for (a, b) in [(2u32, 1u8), (0, 0), (1, 0)] {
            data.extend([0; 2]);
            data.extend(if encoding == Encoding::Big { a.to_be_bytes() } else { a.to_le_bytes() });
            data.extend(vec![7; 2 * a as usize]);
            data.push(b);
            data.extend(vec![7; 8 * b as usize]);
        }
        data
    }

    /// Feeds blocks of the given size up to the end; returns how many bytes were taken.
    fn feed(walker: &mut Walker, data: &[u8], block: usize) -> Result<usize, String> {
        let mut taken = 0;
        for block in data.chunks(block) {
            taken += walker.feed(block)?;
        }
        walker.finish().map(|()| taken)
    }

    #[test]
    fn blocks_of_any_size_give_the_same() {
        for encoding in ENCODINGS {
            let data = data(encoding);
            for tail in [&b""[..], b"\n", b" 12 and \x00 more"] {
                let all = [&data, tail].concat();
                for block in 1..=all.len() {
                    let taken = feed(&mut Walker::new(&elements(), encoding), &all, block);
                    assert_eq!(taken, Ok(data.len()), "{encoding:?} {block}");
                }
            }
            for end in 0..data.len() {
                for block in [1, 2, 7, 100] {
                    let error =
                        feed(&mut Walker::new(&elements(), encoding), &data[..end], block).unwrap_err();
                    assert!(error.starts_with("the file ends within element"), "{error}");
                }
            }
        }
    }

    #[test]
    fn lengths_that_cannot_be_are_named() {
        let lists = &elements()[3..];
        let mut walker = Walker::new(lists, Encoding::Big);
        let error = walker.feed(&[0, 0, 0, 0, 0, 0, 0x80]).unwrap_err();
        assert_eq!(error, "element \"lists\", record 0: a list of length -128");
        for (text, length) in [("0 -1 ", "\"-1\""), ("0 1.5 ", "\"1.5\""), ("0 x ", "\"x\"")] {
            let error = Walker::new(lists, Encoding::Ascii).feed(text.as_bytes()).unwrap_err();
            assert_eq!(error, format!("element \"lists\", record 0: a list of length {length}"));
        }
        let endless = "0 ".to_string() + &"9".repeat(100);
        for block in [1, 100] {
            feed(&mut Walker::new(lists, Encoding::Ascii), endless.as_bytes(), block).unwrap_err();
        }
    }
}
