//! Lines of bounded length. A line ends with a line feed, a carriage return, or both; files may mix them.

use super::next_word;
use crate::source::SourceFile;
use crate::{Error, Result};

/// Longest line: a text with a longer one is refused.
pub(crate) const MAX_LINE: usize = 16 << 20;

/// Bytes read at a time.
const BLOCK: usize = 1 << 18;

/// The mark that some programs put before text in UTF-8 (its byte order mark), which is no part of the text.
const MARK: &[u8] = b"\xef\xbb\xbf";

/// The marks of UTF-16 in either byte order.
const MARKS_OF_UTF16: [&[u8]; 2] = [b"\xff\xfe", b"\xfe\xff"];

/// The text behind the mark of UTF-8, if there is one.
pub(crate) fn without_mark(start: &[u8]) -> &[u8] {
    start.strip_prefix(MARK).unwrap_or(start)
}

/// Byte of the file at which the first line of its text begins: behind the mark of UTF-8, if there is one.
///
/// # Errors
/// The file cannot be read; it is UTF-16, or ends in bytes of zero, as one does whose writing was cut short.
pub(crate) fn text_start(source: &SourceFile) -> Result<u64> {
    let mut mark = [0; MARK.len()];
    let is_marked = source.read_at(&mut mark, 0)? == mark.len() && mark == MARK;
    if MARKS_OF_UTF16.iter().any(|mark_of| mark.starts_with(mark_of)) {
        let hint = "save it as UTF-8, or convert it: iconv -f UTF-16 -t UTF-8 IN > OUT";
        return Err(source.malformed("a text in UTF-16", hint));
    }
    check_end(source)?;
    Ok(if is_marked { mark.len() as u64 } else { 0 })
}

/// An error where a file ends in bytes of zero, which no text has.
fn check_end(source: &SourceFile) -> Result<()> {
    let mut last = [0];
    if source.len() == 0 || source.read_at(&mut last, source.len() - 1)? < 1 || last != [0] {
        return Ok(());
    }
    let mut end = Vec::new();
    let from = source.len().saturating_sub(BLOCK as u64);
    source.append_at(&mut end, from, BLOCK)?;
    let first = from + end.iter().rposition(|b| *b != 0).map_or(0, |at| at as u64 + 1);
    let what = format!("bytes of zero from byte {first} on, as far as the file goes");
    Err(source.malformed(what, "writing the file was cut short: copy or export it again"))
}

/// Way in which the lines of a format end.
#[derive(Debug, Clone, Copy)]
pub(crate) enum LineEnds {
    /// A line ends with each line feed, and with each carriage return.
    Breaks,
    /// A line ends at a break before which no backslash stands; but a comment, which may end in a backslash
    /// as the path of a folder does, ends at each break.
    Continued,
    /// A statement ends before the next word with which a statement begins: breaks are blanks as others.
    Words(fn(&[u8]) -> bool),
}

/// Whether the first line of `bytes` is a comment of OBJ as a whole.
fn is_comment(bytes: &[u8]) -> bool {
    bytes.iter().find(|b| !matches!(b, b' ' | b'\t')) == Some(&b'#')
}

/// Byte behind the first line of `bytes` and its line end; `None` if the line may go on after `bytes`.
#[inline]
pub(crate) fn line_end(bytes: &[u8], ends: LineEnds, whole_file: bool) -> Option<usize> {
    let continues = match ends {
        LineEnds::Breaks => false,
        LineEnds::Continued => true,
        LineEnds::Words(begins) => return statement_end(bytes, begins, whole_file),
    };
    let mut from = 0;
    loop {
        let Some(found) = memchr::memchr2(b'\n', b'\r', &bytes[from..]) else {
            return (whole_file && !bytes.is_empty()).then_some(bytes.len());
        };
        let at = from + found;
        let mut end = at + 1;
        if bytes[at] == b'\r' {
            match bytes.get(end) {
                Some(b'\n') => end += 1,
                None if !whole_file => return None,
                _ => {}
            }
        }
        if !(continues && at > 0 && bytes[at - 1] == b'\\' && !is_comment(bytes)) {
            return Some(end);
        }
        if end == bytes.len() {
            return whole_file.then_some(end);
        }
        from = end;
    }
}

/// Byte at which the first statement of `bytes` ends: before the next word that begins one.
fn statement_end(bytes: &[u8], begins: fn(&[u8]) -> bool, whole_file: bool) -> Option<usize> {
    let mut at = next_word(bytes, 0, whole_file).map_or(bytes.len(), |(_, end)| end);
    loop {
        let Some((start, end)) = next_word(bytes, at, whole_file) else {
            return (whole_file && !bytes.is_empty()).then_some(bytes.len());
        };
        if begins(&bytes[start..end]) {
            return Some(start);
        }
        at = end;
    }
}

/// The lines of bytes that hold whole lines: where each begins and ends.
pub(crate) fn lines(bytes: &[u8], ends: LineEnds) -> impl Iterator<Item = (usize, usize)> + '_ {
    let mut at = 0;
    std::iter::from_fn(move || {
        let start = at;
        at += line_end(&bytes[start..], ends, true)?;
        Some((start, at))
    })
}

/// Number of lines that end in `bytes`.
fn count_lines(bytes: &[u8]) -> u64 {
    let ends = memchr::memchr2_iter(b'\n', b'\r', bytes);
    ends.filter(|&at| bytes[at] == b'\n' || bytes.get(at + 1) != Some(&b'\n')).count() as u64
}

/// Goes over the lines of a part of a file.
///
/// Memory: a block, or a line and the bytes that are read with it: 32 MiB at most.
pub(crate) struct Lines<'a> {
    source: &'a SourceFile,
    ends: LineEnds,
    block: Vec<u8>,
    /// Byte of the block at which the next line begins.
    at: usize,
    /// Byte of the file at which the block begins.
    offset: u64,
    /// The place beyond which nothing is read.
    end: u64,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(source: &'a SourceFile, start: u64, end: u64, ends: LineEnds) -> Self {
        Self { source, ends, block: Vec::new(), at: 0, offset: start, end: end.min(source.len()) }
    }

    /// Byte of the file at which the next line begins.
    pub(crate) fn position(&self) -> u64 {
        self.offset + self.at as u64
    }

    /// Returns the byte of the file at which the next line begins, and the line with its end; `None` at the
    /// end.
    #[inline]
    pub(crate) fn next(&mut self) -> Result<Option<(u64, &[u8])>> {
        loop {
            let whole = self.offset + self.block.len() as u64 >= self.end;
            if let Some(length) = line_end(&self.block[self.at..], self.ends, whole)
                && length <= MAX_LINE
            {
                let (start, position) = (self.at, self.position());
                self.at += length;
                return Ok(Some((position, &self.block[start..self.at])));
            }
            if whole && self.at == self.block.len() {
                return Ok(None);
            }
            self.fill()?;
        }
    }

    #[cold]
    fn fill(&mut self) -> Result<()> {
        self.block.drain(..self.at);
        self.offset += self.at as u64;
        self.at = 0;
        let held = self.block.len();
        if held > MAX_LINE {
            let what = format!("line {} is longer than {} MiB", self.number()?, MAX_LINE >> 20);
            return Err(self.source.malformed(what, "this is no text of its format: export the model again"));
        }
        // Twice as much each time, so that a long line is not gone over too often.
        let left = self.end - self.offset - held as u64;
        let more = (held.max(BLOCK) as u64).min(left) as usize;
        self.source.append_at(&mut self.block, self.offset + held as u64, more)?;
        Ok(())
    }

    /// The number of the next line, from 1 on.
    fn number(&self) -> Result<u64> {
        line_number(self.source, self.position())
    }
}

/// The number of the line that a byte of the file stands in, from 1 on: found by counting, for messages.
pub(crate) fn line_number(source: &SourceFile, offset: u64) -> Result<u64> {
    let (mut at, mut number, mut block) = (0, 1, Vec::new());
    while at < offset {
        block.clear();
        let wanted = (offset - at).min(BLOCK as u64) as usize;
        let read = source.append_at(&mut block, at, wanted)?;
        if read == 0 {
            break;
        }
        at += read as u64;
        number += count_lines(&block);
        // A carriage return at the end of a block, and its line feed in the next block, are one end.
        let mut next = [0];
        if block.last() == Some(&b'\r') && source.read_at(&mut next, at)? == 1 && next == *b"\n" {
            number -= 1;
        }
    }
    Ok(number)
}

/// An error about the line that a byte of the file stands in.
pub(crate) fn wrong_line(
    source: &SourceFile,
    offset: u64,
    what: impl std::fmt::Display,
    hint: &str,
) -> Error {
    match line_number(source, offset) {
        Ok(number) => source.malformed(format_args!("line {number}: {what}"), hint),
        Err(error) => error,
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn source(bytes: &[u8]) -> SourceFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        SourceFile::open(file.path(), None).unwrap()
    }

    #[test]
    fn lines_end_in_any_way() {
        let text = b"a\nb\r\nc\rd\\\ne\\\r\nf\n\r\ng";
        let of = |ends| -> Vec<&[u8]> { lines(text, ends).map(|(a, b)| &text[a..b]).collect() };
        let plain: [&[u8]; 8] = [b"a\n", b"b\r\n", b"c\r", b"d\\\n", b"e\\\r\n", b"f\n", b"\r\n", b"g"];
        assert_eq!(of(LineEnds::Breaks), plain);
        let joined: [&[u8]; 6] = [b"a\n", b"b\r\n", b"c\r", b"d\\\ne\\\r\nf\n", b"\r\n", b"g"];
        assert_eq!(of(LineEnds::Continued), joined);
        let comments = b"# C:\\folder\\\n\t# a\\\r\nv 1 \\\n2\n";
        let found: Vec<(usize, usize)> = lines(comments, LineEnds::Continued).collect();
        assert_eq!(found, [(0, 13), (13, 20), (20, 28)], "comments do not go on");
        for end in 0..text.len() {
            // A line that may go on is not returned before its end is known.
            let mut at = 0;
            for line in plain {
                let found = line_end(&text[at..end], LineEnds::Breaks, false);
                let known = at + line.len() <= end && (line != b"c\r" || end > at + 2) && at + 1 < text.len();
                assert_eq!(found.is_some(), known, "{end} {at}");
                let Some(found) = found else { break };
                assert_eq!(found, line.len());
                at += found;
            }
        }
    }

    #[test]
    fn statements_end_where_others_begin() {
        let text = b" at 1\n2 at\rat 3 that at";
        let begins: fn(&[u8]) -> bool = |word| word == b"at";
        let found: Vec<&[u8]> = lines(text, LineEnds::Words(begins)).map(|(a, b)| &text[a..b]).collect();
        assert_eq!(found, [&b" at 1\n2 "[..], b"at\r", b"at 3 that ", b"at"]);
        for end in 0..text.len() {
            // Its end is the blank behind the word that begins the next one.
            let found = line_end(&text[..end], LineEnds::Words(begins), false);
            assert_eq!(found, (end > 10).then_some(8), "{end}");
        }
    }

    #[test]
    fn numbers_of_lines_are_counted_across_blocks() {
        let mut text = Vec::new();
        let mut starts = Vec::new();
        for i in 0..3000 {
            starts.push(text.len() as u64);
            text.extend(vec![b'x'; i % 200]);
            text.extend_from_slice([&b"\n"[..], b"\r\n", b"\r"][i % 3]);
        }
        // An empty line after a lone carriage return would be one with it.
        text.extend_from_slice(b"end");
        let source = source(&text);
        for (i, start) in starts.iter().enumerate().step_by(101) {
            let joined = (0..i).filter(|i| i % 3 == 2 && (i + 1) % 200 == 0 && (i + 1) % 3 == 0).count();
            assert_eq!(line_number(&source, *start).unwrap(), (i - joined) as u64 + 1);
        }
    }

    #[test]
    fn a_line_without_end_is_an_error_that_names_it() {
        let mut text = b"1\n2\n".to_vec();
        text.resize(text.len() + MAX_LINE + 3 * BLOCK, b'7');
        let source = source(&text);
        let mut lines = Lines::new(&source, 0, u64::MAX, LineEnds::Breaks);
        assert_eq!(lines.next().unwrap(), Some((0, &b"1\n"[..])));
        assert_eq!(lines.next().unwrap(), Some((2, &b"2\n"[..])));
        let error = lines.next().err().unwrap().to_string();
        assert!(error.ends_with("line 3 is longer than 16 MiB"), "{error}");
    }
}
