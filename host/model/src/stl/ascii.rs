//! STL as text: `solid`, and for each facet its normal and three lines that begin with `vertex`.

use std::ops::Range;

use glam::DVec3;

use super::facets::{FACET, Facets, normal};
use crate::source::SourceFile;
use crate::text::blocks::{GAP, TextBlocks, TextBlocksBuilder, too_far};
use crate::text::digits::Digits;
use crate::text::lines::{LineEnds, Lines, lines, text_start, without_mark, wrong_line};
use crate::text::model::{Grammar, TextModel, info};
use crate::text::{CUT_OFF, DAMAGED, coordinate, is_space, next_word, no_normal, parse, quoted};
use crate::unfit::Unfit;
use crate::{Edited, FaceReader, Model, ModelInfo, Result, Scalar, VertexChunk};

/// Whether a file begins as text: with `solid`, and without bytes that are no text.
pub(super) fn is_text(source: &SourceFile) -> Result<bool> {
    const START: usize = 1024;
    let mut start = Vec::new();
    source.append_at(&mut start, 0, START)?;
    let text = without_mark(&start).trim_ascii_start();
    let (mut head, is_binary) = (text.iter(), |b: &u8| *b < b' ' && !b.is_ascii_whitespace());
    let solid = first_word(text).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    Ok(solid && !head.any(is_binary))
}

/// Opens a file, which is gone over once.
pub(super) fn open(source: SourceFile) -> Result<Box<dyn Model>> {
    // Breaks are but blanks to the format, though nearly all programs give each statement a line of its own.
    const STATEMENTS: LineEnds = LineEnds::Words(|word| StlLine::of_word(word) != StlLine::Unknown);
    let (ends, (blocks, facets)) = match scan(&source, LineEnds::Breaks) {
        Ok(found) => (LineEnds::Breaks, found),
        Err(error) => (STATEMENTS, scan(&source, STATEMENTS).map_err(|_| error)?),
    };
    let face_bytes = FACET * facets;
    let of_file = info(&source, "STL, ascii".into());
    let info = ModelInfo { faces: facets, face_bytes, ..of_file };
    Ok(Box::new(TextModel::new(source, StlLines { ends }, blocks, info)?))
}

fn first_word(line: &[u8]) -> Option<&[u8]> {
    next_word(line, 0, true).map(|(start, end)| &line[start..end])
}

/// Kind of a line of STL.
#[derive(Debug, Clone, Copy, PartialEq)]
enum StlLine {
    Solid,
    EndSolid,
    Facet,
    Vertex,
    EndFacet,
    Other,
    Unknown,
}

impl StlLine {
    fn parse(line: &[u8]) -> Self {
        first_word(line).map_or(Self::Other, Self::of_word)
    }

    /// Kind of a line that begins with this word.
    fn of_word(word: &[u8]) -> Self {
        let is = |name: &str| word.eq_ignore_ascii_case(name.as_bytes());
        match word.len() {
            6 if is("vertex") => Self::Vertex,
            5 if is("facet") => Self::Facet,
            5 if is("outer") => Self::Other,
            7 if is("endloop") => Self::Other,
            8 if is("endfacet") => Self::EndFacet,
            5 if is("solid") => Self::Solid,
            8 if is("endsolid") => Self::EndSolid,
            _ => Self::Unknown,
        }
    }

    /// Number of words of the line's statement, behind which any number of other words could stand otherwise;
    /// none where the statement may be of any length.
    fn words(self, line: &[u8]) -> Option<usize> {
        match self {
            Self::Solid | Self::EndSolid | Self::Unknown => None,
            Self::Vertex => Some(4),
            Self::Facet => Some(5),
            Self::EndFacet => Some(1),
            Self::Other => first_word(line).map(|word| if word.len() == 5 { 2 } else { 1 }),
        }
    }
}

/// Message on a line that is no statement, or none that may follow so many facets and corners.
fn wrong_statement(kind: StlLine, line: &[u8], facets: u64, corners: u64) -> String {
    let text = quoted(&String::from_utf8_lossy(line.trim_ascii_start()));
    match kind {
        StlLine::Unknown => format!("{text} is nothing of STL"),
        _ => format!("{text} after {facets} facets and {corners} corners"),
    }
}

/// Finds the vertices and counts the facets. The whole structure of the file is checked here.
fn scan(source: &SourceFile, ends: LineEnds) -> Result<(TextBlocks, u64)> {
    let begin = text_start(source)?;
    let mut lines = Lines::new(source, begin, u64::MAX, ends);
    let mut builder = TextBlocksBuilder::new(begin, StlLines::UNIT);
    let (mut facets, mut in_solid, mut in_facet, mut at) = (0u64, false, false, 0);
    let is_free = matches!(ends, LineEnds::Words(_));
    while let Some((start, line)) = lines.next()? {
        let kind = StlLine::parse(line);
        // Blanks between statements belong to none of them.
        let own = if is_free { line.trim_ascii_end() } else { line };
        let end = start + own.len() as u64;
        let is_right = match kind {
            StlLine::Vertex => {
                if builder.vertices() > 0 && start - builder.end() > GAP {
                    return Err(too_far(source, start));
                }
                builder.vertex(start, end);
                in_facet && builder.vertices() <= 3 * facets
            }
            StlLine::Facet => {
                facets += 1;
                check_normal(source, start, line)?;
                in_solid && !std::mem::replace(&mut in_facet, true)
            }
            StlLine::EndFacet => std::mem::take(&mut in_facet) && builder.vertices() == 3 * facets,
            // Some programs leave out `endsolid` between two solids.
            StlLine::Solid => {
                in_solid |= !in_facet;
                !in_facet
            }
            StlLine::EndSolid => !in_facet && std::mem::take(&mut in_solid),
            StlLine::Other => true,
            StlLine::Unknown => false,
        };
        // Further words behind a statement would count as part of it.
        let is_whole = || !is_free || kind.words(line).is_none_or(|words| words_of(line).count() == words);
        if !is_right || !is_whole() {
            let what = wrong_statement(kind, line, facets, builder.vertices());
            return Err(wrong_line(source, start, what, DAMAGED));
        }
        at = start;
    }
    if in_solid || in_facet {
        return Err(wrong_line(source, at, "the file ends before endsolid", CUT_OFF));
    }
    Ok((builder.finish(), facets))
}

fn words_of(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|b| is_space(*b)).filter(|word| !word.is_empty())
}

/// An error where a facet's normal has a number that is too large; other words that are no numbers are kept.
fn check_normal(source: &SourceFile, start: u64, line: &[u8]) -> Result<()> {
    let mut words = [[0; 2]; 3];
    words_after(line, 2, &mut words);
    for word in words.map(|[start, end]| &line[start..end]) {
        if coordinate(Scalar::F64, word).is_none() && parse(Scalar::F64, word).is_some() {
            let (what, hint) = no_normal(Scalar::F64, word);
            return Err(wrong_line(source, start, format!("the normal of a facet: {what}"), hint));
        }
    }
    Ok(())
}

/// The corners of a facet, which begin with a vertex, after an edit. Those at no finite place stay.
fn moved_corners(vertex: usize, rest: &[DVec3], moved: &[DVec3]) -> Result<[DVec3; 3], Unfit> {
    let mut corners = [rest[0], rest[1], rest[2]];
    for i in 0..3 {
        if rest[i].is_finite() {
            corners[i] = moved[i];
            if let Some(axis) = (0..3).find(|axis| !moved[i][*axis].is_finite()) {
                return Err(Unfit { vertex: vertex + i, axis, value: moved[i][axis] });
            }
        }
    }
    Ok(corners)
}

/// The lines of STL.
#[derive(Debug)]
struct StlLines {
    ends: LineEnds,
}

impl Grammar for StlLines {
    const EXTENSIONS: &[&str] = &["stl"];
    const UNIT: u64 = 3;

    fn ends(&self) -> LineEnds {
        self.ends
    }

    fn is_vertex(&self, line: &[u8]) -> bool {
        let start = line.iter().position(|b| !is_space(*b)).unwrap_or(line.len());
        let word = &line[start..];
        word.len() > 6 && word[..6].eq_ignore_ascii_case(b"vertex") && is_space(word[6])
    }

    fn words(&self, line: &[u8], spans: &mut [[usize; 2]]) {
        words_after(line, 1, spans);
    }

    fn encode(
        model: &TextModel<Self>,
        chunk: &VertexChunk,
        edited: &Edited,
        text: &mut Vec<u8>,
    ) -> Result<(), Unfit> {
        let VertexChunk { positions, raw, spans, .. } = chunk;
        let (mut copied, mut facet_at) = (0, 0);
        for vertex in (0..positions.len()).step_by(3) {
            let (Some(rest), Some(moved), Some(places)) = (
                positions.get(vertex..vertex + 3),
                edited.positions.get(vertex..vertex + 3),
                spans.get(3 * vertex..3 * vertex + 9),
            ) else {
                break;
            };
            let before = facet_at..places[0][0] as usize;
            facet_at = places[8][1] as usize;
            let corners = moved_corners(vertex, rest, moved)?;
            let bits = |p: DVec3| p.to_array().map(f64::to_bits);
            if corners.map(bits) == [rest[0], rest[1], rest[2]].map(bits) {
                continue;
            }
            if let Some((words, old)) = facet_normal(raw, before, model.grammar.ends)
                && let Some(new) = normal(old, [rest[0], rest[1], rest[2]], corners)
            {
                let of_normal = normal_digits(&words.map(|[start, end]| &raw[start..end]));
                for ([start, end], value) in words.into_iter().zip(new.to_array()) {
                    text.extend_from_slice(&raw[copied..start]);
                    of_normal.write(text, &raw[start..end], value);
                    copied = end;
                }
            }
            for (i, place) in places.iter().enumerate() {
                let [start, end] = place.map(|at| at as usize);
                let (old, new) = (rest[i / 3][i % 3], corners[i / 3][i % 3]);
                if old.to_bits() != new.to_bits() {
                    text.extend_from_slice(&raw[copied..start]);
                    model.digits[i % 3].write(text, &raw[start..end], new);
                    copied = end;
                }
            }
        }
        text.extend_from_slice(&raw[copied..]);
        Ok(())
    }

    fn faces<'a>(
        model: &'a TextModel<Self>,
        ranges: Option<Vec<Range<u64>>>,
    ) -> Result<Box<dyn FaceReader + 'a>> {
        let facets = model.info.faces;
        Ok(Box::new(match ranges {
            None => Facets::new(facets),
            Some(ranges) => Facets::between(facets, ranges),
        }))
    }
}

/// Finds up to as many words of a line as `spans` has places, after the first `others` words.
fn words_after(line: &[u8], others: usize, spans: &mut [[usize; 2]]) {
    let mut at = 0;
    for i in 0..others + 3 {
        let Some((start, end)) = next_word(line, at, true) else { return };
        if i >= others {
            spans[i - others] = [start, end];
        }
        at = end;
    }
}

/// Places of the numbers of the last facet's normal in a part of a chunk, and the normal.
fn facet_normal(raw: &[u8], part: Range<usize>, ends: LineEnds) -> Option<([[usize; 2]; 3], DVec3)> {
    let bytes = &raw[part.clone()];
    let (start, end) =
        lines(bytes, ends).filter(|l| StlLine::parse(&bytes[l.0..l.1]) == StlLine::Facet).last()?;
    let mut words = [[0; 2]; 3];
    words_after(&bytes[start..end], 2, &mut words);
    let words = words.map(|word| word.map(|at| part.start + start + at));
    let [x, y, z] = words.map(|[start, end]| parse(Scalar::F64, &raw[start..end]));
    Some((words, DVec3::new(x?, y?, z?)))
}

/// Digits of a new normal: as many as the old one has; six if the old one was along an axis, and had none.
fn normal_digits(words: &[&[u8]; 3]) -> Digits {
    const FEW: usize = 4;
    const ENOUGH: usize = 6;
    let digits = Digits::most_of(words.iter().copied());
    if digits.decimals < FEW { Digits { decimals: ENOUGH, ..digits } } else { digits }
}
