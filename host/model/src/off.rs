//! OFF: a line of counts, a line for each vertex, and one for each face.
//!
//! Letters before `OFF` say what vertices have beside their position: `N` a normal, `C` a colour, `ST`
//! texture coordinates, in this order in their lines, whatever the order of the letters; but where `N` comes
//! before `C`, as MeshLab writes it, colours come before normals.

use std::ops::Range;

use crate::columns::Columns;
use crate::model::NoFaces;
use crate::source::SourceFile;
use crate::text::blocks::TextBlocksBuilder;
use crate::text::faces::{FaceLines, LineFaces};
use crate::text::lines::{LineEnds, Lines, text_start, without_mark, wrong_line};
use crate::text::model::{Grammar, TextModel, info};
use crate::text::{CUT_OFF, DAMAGED, integer, is_space, next_word, quoted};
use crate::{Attribute, Error, FaceReader, Model, ModelInfo, Result, Type};

/// Most numbers of a vertex: position, normal, colour and texture coordinates.
const MOST_NUMBERS: usize = 12;

/// Meaning of the letters before `OFF`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Letters {
    normals: bool,
    colours: bool,
    texture: bool,
    /// Colours come before normals in the lines of vertices, as MeshLab has them where the letter of normals
    /// comes first.
    colours_first: bool,
    /// Four coordinates, or as many as are said.
    other_dimension: bool,
}

impl Letters {
    /// The letters of a word that ends in `OFF`.
    fn parse(word: &[u8]) -> Option<Self> {
        let (mut rest, mut found) = (word.strip_suffix(b"OFF")?, Self::default());
        while let Some(letter) = rest.first() {
            let is = match rest {
                [b'S', b'T', ..] => &mut found.texture,
                [b'C', ..] => &mut found.colours,
                [b'N', ..] => &mut found.normals,
                [b'4' | b'n', ..] => &mut found.other_dimension,
                _ => return None,
            };
            // Each is said once, but for `4nOFF`.
            if std::mem::replace(is, true) && !matches!(letter, b'4' | b'n') {
                return None;
            }
            found.colours_first |= *letter == b'C' && found.normals;
            rest = &rest[if *letter == b'S' { 2 } else { 1 }..];
        }
        Some(found)
    }

    /// The letters that stand before `OFF`.
    fn text(self) -> String {
        if self.colours_first {
            return if self.texture { "STNC".into() } else { "NC".into() };
        }
        let letters = [(self.texture, "ST"), (self.colours, "C"), (self.normals, "N")];
        letters.into_iter().filter(|(is, _)| *is).map(|(_, letter)| letter).collect()
    }
}

fn first_word(text: &[u8]) -> &[u8] {
    next_word(text, 0, true).map_or(&[], |(start, end)| &text[start..end])
}

/// The part of a line before a comment.
fn before_comment(line: &[u8]) -> &[u8] {
    &line[..memchr::memchr(b'#', line).unwrap_or(line.len())]
}

fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    before_comment(line).split(|b| is_space(*b)).filter(|word| !word.is_empty())
}

/// Whether a file says that it is OFF.
pub(crate) fn is_off(start: &[u8]) -> bool {
    Letters::parse(first_word(without_mark(start))).is_some()
}

/// Whether a file of the extension `off`, which need not say that it is OFF, begins as one.
pub(crate) fn is_head(source: &SourceFile) -> bool {
    OffHead::read(source).is_ok()
}

fn has_content(line: &[u8]) -> bool {
    line.iter().find(|b| !is_space(**b)).is_some_and(|b| *b != b'#')
}

/// Counts of vertices and faces, and the byte at which the first line behind the counts begins.
struct OffHead {
    letters: Letters,
    vertices: u64,
    faces: u64,
    start: u64,
}

impl OffHead {
    /// The error that a file has but so many lines of vertices and of faces.
    fn cut_off(&self, source: &SourceFile, [vertices, faces]: [u64; 2]) -> Error {
        let what = format!(
            "says {} vertices and {} faces, but it has {vertices} and {faces} lines of them",
            self.vertices, self.faces
        );
        source.malformed(what, CUT_OFF)
    }

    fn read(source: &SourceFile) -> Result<Self> {
        let mut lines = Lines::new(source, text_start(source)?, u64::MAX, LineEnds::Breaks);
        let (mut letters, mut counts) = (None, Vec::new());
        while let Some((at, line)) = lines.next()? {
            let end = at + line.len() as u64;
            let mut words = words(line);
            let mut glued = None;
            if letters.is_none() {
                let Some(word) = words.next() else { continue };
                // The word may be left out, and ModelNet has the first count behind it without a blank.
                let digits = word.iter().rev().take_while(|b| b.is_ascii_digit()).count();
                let (keyword, count) = word.split_at(word.len() - digits);
                let found =
                    if keyword.is_empty() { Some(Letters::default()) } else { Letters::parse(keyword) };
                let text = || quoted(&String::from_utf8_lossy(word));
                let Some(found) = found else {
                    let what = format!("{} is neither OFF nor a count", text());
                    return Err(wrong_line(source, at, what, DAMAGED));
                };
                (letters, glued) = (Some(found), Some(count).filter(|count| !count.is_empty()));
                if found.other_dimension {
                    let what = format!("{} has vertices of another dimension than three", text());
                    return Err(wrong_line(source, at, what, "export the model as OFF, with x, y and z"));
                }
            }
            for word in glued.into_iter().chain(words) {
                if word.eq_ignore_ascii_case(b"BINARY") {
                    let (what, hint) = ("binary OFF cannot be read", "export the model as OFF in ascii");
                    return Err(wrong_line(source, at, what, hint));
                }
                let count = integer(word).and_then(|count| u64::try_from(count).ok());
                let Some(count) = count else {
                    let what = format!("{} is no count", quoted(&String::from_utf8_lossy(word)));
                    return Err(wrong_line(source, at, what, DAMAGED));
                };
                counts.push(count);
            }
            // The number of edges, which says nothing, may be left out.
            if counts.len() >= 2 {
                let (letters, vertices, faces) = (letters.unwrap_or_default(), counts[0], counts[1]);
                let edges = if counts.len() == 2 && vertices > 0 { end_of_edges(&mut lines)? } else { None };
                return Ok(Self { letters, vertices, faces, start: edges.unwrap_or(end) });
            }
        }
        Err(source.malformed("the file ends before the counts of vertices and faces", CUT_OFF))
    }
}

/// Byte at which the line of the number of edges ends, if the next line with content is one: a vertex has
/// more than one number.
fn end_of_edges(lines: &mut Lines<'_>) -> Result<Option<u64>> {
    while let Some((at, line)) = lines.next()? {
        let mut words = words(line);
        let Some(word) = words.next() else { continue };
        let is_count = integer(word).is_some() && words.next().is_none();
        return Ok(is_count.then_some(at + line.len() as u64));
    }
    Ok(None)
}

/// Count of the numbers in the line of a vertex.
fn numbers_of_vertex(source: &SourceFile, at: u64, line: &[u8]) -> Result<usize> {
    let numbers = words(line).count();
    if numbers > MOST_NUMBERS {
        let what = format!("{numbers} numbers in the line of a vertex");
        return Err(wrong_line(source, at, what, "each vertex has to have a line of its own"));
    }
    Ok(numbers)
}

/// Counts of the faces of a file, as far as the file was read.
#[derive(Default)]
struct OffFaces {
    count: u64,
    /// The bytes from the first one's line to the end of the last one's.
    lines: Range<u64>,
    /// Whether any face has a colour.
    are_painted: bool,
}

impl OffFaces {
    /// Takes the line of a face, which begins at this byte.
    fn take(&mut self, at: u64, line: &[u8]) {
        if self.count == 0 {
            self.lines.start = at;
        }
        if !self.are_painted {
            let corners = integer(first_word(line)).unwrap_or_default();
            self.are_painted = words(line).count() as i64 > corners.saturating_add(1);
        }
        self.count += 1;
        self.lines.end = at + line.len() as u64;
    }
}

/// Opens a file, which is gone over once.
pub(crate) fn open(source: SourceFile) -> Result<Box<dyn Model>> {
    let head = OffHead::read(&source)?;
    let mut lines = Lines::new(&source, head.start, u64::MAX, LineEnds::Breaks);
    let mut builder = TextBlocksBuilder::new(head.start, 1);
    let Letters { normals, texture, colours_first, .. } = head.letters;
    let components = if normals { 6 } else { 3 };
    let (mut faces, mut names) = (OffFaces::default(), Vec::new());
    // So many numbers stand before the normal, whether they are colours that are known or not.
    let mut first = 0;
    let mut bytes = ColourBytes { behind: 0, colours: 0, largest: 0 };
    while builder.vertices() < head.vertices || faces.count < head.faces {
        let Some((at, line)) = lines.next()? else {
            return Err(head.cut_off(&source, [builder.vertices(), faces.count]));
        };
        let end = at + line.len() as u64;
        if !has_content(line) {
            continue;
        }
        if builder.vertices() < head.vertices {
            if builder.vertices() == 0 {
                let numbers = numbers_of_vertex(&source, at, line)?;
                let others = numbers.saturating_sub(components);
                names = attributes(others, texture);
                if colours_first {
                    first = if texture { others.saturating_sub(2) } else { others };
                }
                bytes = ColourBytes::new(&names, if colours_first { 3 } else { 0 });
            }
            bytes.take(line);
            builder.vertex(at, end);
        } else {
            faces.take(at, line);
        }
    }
    let kind = |name: &&str| if bytes.are_all() && !["s", "t"].contains(name) { Type::U8 } else { Type::F64 };
    let info = ModelInfo {
        faces: faces.count,
        face_bytes: faces.lines.end - faces.lines.start,
        other_properties: names.iter().map(|name| format!("{} {name}", kind(name).name())).collect(),
        attributes: names.iter().map(|name| Attribute { name: (*name).into(), kind: kind(name) }).collect(),
        ..info(&source, format!("{}OFF", head.letters.text()))
    };
    let columns = Columns::in_order(components, first, names.len());
    let off = Off { columns, face_lines: faces.lines, paints_faces: faces.are_painted };
    Ok(Box::new(TextModel::new(source, off, builder.finish(), info)?))
}

/// Names of the numbers behind a vertex' position and normal, by their count. Programs add colours without
/// saying so.
fn attributes(count: usize, texture: bool) -> Vec<&'static str> {
    let coordinates: &[&str] = if texture && count >= 2 { &["s", "t"] } else { &[] };
    let colours: &[&str] = match count - coordinates.len() {
        3 => &["red", "green", "blue"],
        4 => &["red", "green", "blue", "alpha"],
        _ => &[],
    };
    if colours.len() + coordinates.len() == count { [colours, coordinates].concat() } else { Vec::new() }
}

/// Check whether all colours are bytes: whole numbers up to 255, which are no fractions unless none is more
/// than 1.
struct ColourBytes {
    /// Numbers of a vertex behind its colours, and how many these are; none once one is no byte.
    behind: usize,
    colours: usize,
    largest: u8,
}

impl ColourBytes {
    /// Check of the colours among some attributes, with so many numbers of the normal behind them.
    fn new(attributes: &[&str], normal: usize) -> Self {
        let texture = attributes.iter().filter(|name| ["s", "t"].contains(name)).count();
        Self { behind: texture + normal, colours: attributes.len() - texture, largest: 0 }
    }

    /// Takes the line of a vertex.
    #[inline]
    fn take(&mut self, line: &[u8]) {
        if self.colours == 0 {
            return;
        }
        let words = before_comment(line).rsplit(|b| is_space(*b)).filter(|word| !word.is_empty());
        for word in words.skip(self.behind).take(self.colours) {
            match integer(word).and_then(|value| u8::try_from(value).ok()) {
                Some(value) => self.largest = self.largest.max(value),
                None => return self.colours = 0,
            }
        }
    }

    fn are_all(&self) -> bool {
        self.colours > 0 && self.largest > 1
    }
}

/// The lines of OFF.
#[derive(Debug)]
struct Off {
    columns: Columns,
    face_lines: Range<u64>,
    /// Numbers stand behind the corners of the first face, at least.
    paints_faces: bool,
}

impl Grammar for Off {
    const EXTENSIONS: &[&str] = &["off"];

    fn components(&self) -> usize {
        self.columns.components()
    }

    fn besides(&self) -> Vec<String> {
        let colours = self.paints_faces.then(|| "the colours of faces".to_owned());
        colours.into_iter().collect()
    }

    fn follow(&mut self, attributes: &[usize]) {
        self.columns.follow(attributes);
    }

    fn numbers(&self) -> usize {
        self.columns.numbers()
    }

    #[inline]
    fn is_vertex(&self, line: &[u8]) -> bool {
        has_content(line)
    }

    #[inline]
    fn words(&self, line: &[u8], spans: &mut [[usize; 2]]) {
        self.columns.words(before_comment(line), spans);
    }

    fn attribute<'l>(&self, line: &'l [u8], attribute: usize) -> Option<&'l [u8]> {
        self.columns.attribute(before_comment(line), attribute)
    }

    fn faces<'a>(
        model: &'a TextModel<Self>,
        ranges: Option<Vec<Range<u64>>>,
    ) -> Result<Box<dyn FaceReader + 'a>> {
        let all = model.grammar.face_lines.clone();
        if all.is_empty() {
            return Ok(Box::new(NoFaces));
        }
        Ok(Box::new(LineFaces::new(&model.source, OffCorners { left: 0 }, all, ranges)))
    }
}

/// The corners of faces: their number, then as many.
struct OffCorners {
    left: i64,
}

impl OffCorners {
    /// The next number of a line.
    #[inline]
    fn number(line: &[u8], at: &mut usize) -> Result<i64, String> {
        let (start, end) = next_word(line, *at, true).ok_or("a face has fewer corners than it says")?;
        *at = end;
        let word = &line[start..end];
        integer(word).ok_or_else(|| format!("{} is no whole number", quoted(&String::from_utf8_lossy(word))))
    }
}

impl FaceLines for OffCorners {
    fn face(&mut self, line: &[u8]) -> Result<Option<usize>, String> {
        if !has_content(line) {
            return Ok(None);
        }
        let mut at = 0;
        self.left = Self::number(line, &mut at)?;
        if self.left < 0 { Err(format!("a face of {} corners", self.left)) } else { Ok(Some(at)) }
    }

    #[inline]
    fn corner(&mut self, line: &[u8], at: &mut usize) -> Result<Option<i64>, String> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        Self::number(line, at).map(Some)
    }
}
