//! Statements of OBJ, and their words.

use crate::source::SourceFile;
use crate::text::lines::{LineEnds, lines, without_mark};
use crate::text::{is_space, next_word, parse};
use crate::{Result, Scalar};

/// Way in which the lines of OBJ end.
pub(super) const ENDS: LineEnds = LineEnds::Continued;

/// The kind of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Statement {
    Vertex,
    Normal,
    Face,
    Other,
}

impl Statement {
    #[inline]
    pub(super) fn parse(line: &[u8]) -> Self {
        // Most lines begin with their word.
        let start = if line.first().is_some_and(|b| is_space(*b)) {
            line.iter().position(|b| !is_space(*b)).unwrap_or(line.len())
        } else {
            0
        };
        match line[start..] {
            [b'v', next, ..] if is_space(next) => Self::Vertex,
            [b'v', b'n', next, ..] if is_space(next) => Self::Normal,
            [b'f', next, ..] if is_space(next) => Self::Face,
            _ => Self::Other,
        }
    }
}

/// The words behind a line's first one, up to a comment. Backslashes, with which lines go on, are blanks.
pub(super) fn values(line: &[u8]) -> impl Iterator<Item = (usize, usize)> + '_ {
    let mut at = next_word(line, 0, true).map_or(line.len(), |(_, end)| end);
    std::iter::from_fn(move || {
        loop {
            let (start, mut end) = next_word(line, at, true)?;
            at = end;
            while end > start && line[end - 1] == b'\\' {
                end -= 1;
            }
            match line.get(start) {
                Some(b'#') => return None,
                _ if end > start => return Some((start, end)),
                _ => {}
            }
        }
    })
}

/// The first word of a line.
fn keyword(line: &[u8]) -> Option<&[u8]> {
    next_word(line, 0, true).map(|(start, end)| &line[start..end])
}

/// Whether a file looks like OBJ: its first statement is one that OBJ files begin with.
pub(crate) fn is_obj(source: &SourceFile) -> Result<bool> {
    const START: usize = 1 << 14;
    let mut start = Vec::new();
    source.append_at(&mut start, 0, START)?;
    let start = without_mark(&start);
    let mut words = lines(start, ENDS)
        .map(|(a, b)| &start[a..b])
        .filter(|line| keyword(line).is_some_and(|w| w[0] != b'#'));
    Ok(words.next().is_some_and(|line| match keyword(line) {
        Some(b"v" | b"vn") => {
            let mut numbers = values(line).map(|(a, b)| parse(Scalar::F64, &line[a..b]));
            (0..3).all(|_| numbers.next().flatten().is_some())
        }
        Some(b"mtllib" | b"o" | b"g" | b"usemtl") => !start.contains(&0),
        _ => false,
    }))
}

/// Whole number that a word begins with, and the byte at which the number ends; `None` if the word begins
/// with none. A number that is too large becomes the largest.
#[inline]
pub(super) fn leading_integer(word: &[u8]) -> Option<(i64, usize)> {
    let negative = word.first() == Some(&b'-');
    let start = usize::from(negative || word.first() == Some(&b'+'));
    let (mut value, mut at) = (0i64, start);
    while let Some(digit) = word.get(at).map(|b| b.wrapping_sub(b'0')).filter(|d| *d < 10) {
        value = value.saturating_mul(10).saturating_add(i64::from(digit));
        at += 1;
    }
    (at > start).then_some((if negative { -value } else { value }, at))
}

/// The thing that a number refers to, counted from 0 on, where so many came before; -1 for none.
#[inline]
pub(super) fn absolute(index: i64, before: u64) -> i64 {
    match index {
        1.. => index - 1,
        0 => -1,
        _ => (before as i64).saturating_add(index).max(-1),
    }
}

/// Whether every corner of a face that names a normal names the one with the number of the corner's vertex.
pub(super) fn normals_are_of_vertices(line: &[u8], vertices: u64, normals: u64) -> bool {
    values(line).all(|(start, end)| {
        let word = &line[start..end];
        let Some((vertex, at)) = leading_integer(word) else { return true };
        // Between the slashes is the texture's coordinate, if there is one.
        let mut slashes = word[at..].iter().enumerate().filter(|(_, b)| **b == b'/').skip(1);
        let Some(behind) = slashes.next().map(|(i, _)| at + i + 1) else { return true };
        match leading_integer(&word[behind..]) {
            Some((normal, _)) => absolute(vertex, vertices) == absolute(normal, normals),
            None => true,
        }
    })
}
