//! The header: elements of the file, and the encoding of their data.

use std::str::FromStr;

use crate::source::SourceFile;
use crate::{Result, Type};

/// Longest header in bytes: a file whose header goes on is no PLY file.
pub(super) const MAX_HEADER: usize = 1 << 20;

/// The properties that are a vertex' normal.
pub(super) const NORMAL: [&str; 3] = ["nx", "ny", "nz"];

pub(super) use crate::text::{DAMAGED, quoted};

/// Encoding of the data behind the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    Little,
    Big,
}

impl Encoding {
    /// Name of the encoding for people, as in "PLY 1.0, ascii".
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::Little => "binary little endian",
            Self::Big => "binary big endian",
        }
    }
}

impl FromStr for Type {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Ok(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return Err(format!("unknown type {}", quoted(name))),
        })
    }
}

/// One number, or a count and that many numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PropertyShape {
    Scalar(Type),
    List { count: Type, item: Type },
}

/// A property of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) shape: PropertyShape,
}

impl Property {
    /// The property in words for people, as "uchar red" or "list uchar int vertex_indices".
    pub(super) fn describe(&self) -> String {
        match self.shape {
            PropertyShape::Scalar(t) => format!("{} {}", t.name(), self.name),
            PropertyShape::List { count, item } => {
                format!("list {} {} {}", count.name(), item.name(), self.name)
            }
        }
    }
}

/// A table of records, each with the same properties.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PlyElement {
    pub(crate) name: String,
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
}

impl PlyElement {
    /// Whether records may differ in length, as some property is a list.
    pub(super) fn has_lists(&self) -> bool {
        self.properties.iter().any(|p| matches!(p.shape, PropertyShape::List { .. }))
    }

    /// Bytes that a record takes at least in a binary file: with all its lists empty.
    pub(super) fn min_bytes(&self) -> u64 {
        self.properties
            .iter()
            .map(|p| match p.shape {
                PropertyShape::Scalar(t) | PropertyShape::List { count: t, .. } => t.size() as u64,
            })
            .sum()
    }
}

/// A parsed header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PlyHeader {
    pub(crate) encoding: Encoding,
    /// Elements in the file's order, which is that of the data.
    pub(crate) elements: Vec<PlyElement>,
    /// The length of the header, behind which the data begins.
    pub(crate) len: u64,
}

/// Whether a file with these first bytes says that it is PLY.
pub(crate) fn is_ply(start: &[u8]) -> bool {
    start.strip_prefix(b"ply").is_some_and(|rest| rest.first().is_none_or(u8::is_ascii_whitespace))
}

impl PlyHeader {
    /// Reads the header of `source`.
    pub(crate) fn read(source: &SourceFile) -> Result<Self> {
        let mut bytes = Vec::new();
        // Headers are short: do not fetch 1 MiB where 4 KiB hold it all.
        for limit in [4096, MAX_HEADER] {
            source.append_at(&mut bytes, 0, limit)?;
            let whole_file = bytes.len() as u64 == source.len();
            match parse(&bytes, whole_file) {
                Ok(Some(header)) => return Ok(header),
                Ok(None) if whole_file => {
                    return Err(source.malformed("the file ends within its header", DAMAGED));
                }
                Ok(None) => bytes.clear(),
                Err(HeaderFault { line, what, hint }) => {
                    return Err(source.malformed(format_args!("line {line} of the header: {what}"), hint));
                }
            }
        }
        let what = format!("no end_header within the first {} MiB", MAX_HEADER >> 20);
        Err(source.malformed(what, DAMAGED))
    }

    /// The element that holds the vertices, and its place among the elements.
    pub(super) fn vertex(&self, source: &SourceFile) -> Result<(usize, &PlyElement)> {
        let mut found = self.elements.iter().enumerate().filter(|(_, e)| e.name == "vertex");
        let vertex = found.next().ok_or_else(|| {
            source
                .malformed("the header has no element \"vertex\"", "this PLY file is not a model: export one")
        })?;
        if found.next().is_some() {
            return Err(source.malformed("the header has two elements \"vertex\"", DAMAGED));
        }
        Ok(vertex)
    }
}

/// The text of a header that can be parsed, without the lines of the vertices' normals.
pub(super) fn without_normals(header: &[u8]) -> Vec<u8> {
    let separator = line_separator(header);
    let mut of_vertices = false;
    let lines = header.split_inclusive(|byte| *byte == separator).filter(|line| {
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match *words {
            ["element", name, _] => of_vertices = name == "vertex",
            ["property", _, name] if of_vertices => return !NORMAL.contains(&name),
            _ => {}
        }
        true
    });
    lines.flatten().copied().collect()
}

/// Fault of a header: its line, the fault in words, and advice.
#[derive(Debug)]
struct HeaderFault {
    line: usize,
    what: String,
    hint: &'static str,
}

/// Parses what `bytes` begins with; `None` if the header goes on after it.
fn parse(bytes: &[u8], whole_file: bool) -> Result<Option<PlyHeader>, HeaderFault> {
    let separator = line_separator(bytes);
    let mut encoding = None;
    let mut elements = Vec::new();
    let mut at = 0;
    for number in 1.. {
        let rest = &bytes[at..];
        let (line, next) = match memchr::memchr(separator, rest) {
            Some(end) => (&rest[..end], at + end + 1),
            // A file without data may end right here, without a line end.
            None if whole_file && rest.trim_ascii() == b"end_header" => (rest, bytes.len()),
            None => return Ok(None),
        };
        at = next;
        let text = String::from_utf8_lossy(line);
        let wrong = |(what, hint)| HeaderFault { line: number, what, hint };
        match parse_line(&text, number, &mut encoding, &mut elements).map_err(wrong)? {
            HeaderLine::More => {}
            HeaderLine::End(encoding) => return Ok(Some(PlyHeader { encoding, elements, len: at as u64 })),
        }
    }
    Ok(None)
}

/// The byte that ends the lines of a header.
///
/// The end of the first line tells. Binary data may begin with a byte that looks like a line feed, so a
/// carriage return ends lines only where the first line ends in it alone.
fn line_separator(bytes: &[u8]) -> u8 {
    match memchr::memchr2(b'\r', b'\n', bytes) {
        Some(at) if bytes[at] == b'\r' && bytes.get(at + 1).is_some_and(|&b| b != b'\n') => b'\r',
        _ => b'\n',
    }
}

enum HeaderLine {
    More,
    End(Encoding),
}

type LineError = (String, &'static str);

/// The encoding that a format line says.
fn parse_encoding(name: &str, version: &str) -> Result<Encoding, LineError> {
    if version != "1.0" {
        let what = format!("unknown version {} of PLY", quoted(version));
        return Err((what, "export the model as PLY 1.0"));
    }
    match name {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::Little),
        "binary_big_endian" => Ok(Encoding::Big),
        _ => {
            let hint = "formats are ascii, binary_little_endian and binary_big_endian";
            Err((format!("unknown format {}", quoted(name)), hint))
        }
    }
}

fn parse_line(
    text: &str,
    number: usize,
    encoding: &mut Option<Encoding>,
    elements: &mut Vec<PlyElement>,
) -> Result<HeaderLine, LineError> {
    let damaged = |what: String| (what, DAMAGED);
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    match *words {
        ["ply"] if number == 1 => {}
        _ if number == 1 => return Err(damaged(format!("{} is not \"ply\"", quoted(text)))),
        [] | ["comment" | "obj_info", ..] => {}
        ["format", name, version] => {
            if encoding.is_some() {
                return Err(damaged("a second format line".into()));
            }
            *encoding = Some(parse_encoding(name, version)?);
        }
        ["element", name, count] => {
            let count = count.parse().map_err(|_| damaged(bad_count(name, count)))?;
            elements.push(PlyElement { name: name.into(), count, properties: Vec::new() });
        }
        ["property", "list", count, item, name] => {
            let (count, item): (Type, Type) =
                (count.parse().map_err(damaged)?, item.parse().map_err(damaged)?);
            if count.is_float() {
                return Err(damaged(format!("the list {} is counted in {}", quoted(name), count.name())));
            }
            add_property(elements, name, PropertyShape::List { count, item }).map_err(damaged)?;
        }
        ["property", kind, name] if kind != "list" => {
            let shape = PropertyShape::Scalar(kind.parse().map_err(damaged)?);
            add_property(elements, name, shape).map_err(damaged)?;
        }
        ["end_header"] => {
            return encoding
                .map(HeaderLine::End)
                .ok_or_else(|| damaged("no format line before end_header".into()));
        }
        ["format" | "element" | "property" | "end_header", ..] => {
            return Err(damaged(format!("cannot understand {}", quoted(text))));
        }
        [keyword, ..] => return Err(damaged(format!("unknown keyword {}", quoted(keyword)))),
    }
    Ok(HeaderLine::More)
}

fn add_property(elements: &mut [PlyElement], name: &str, shape: PropertyShape) -> Result<(), String> {
    let Some(element) = elements.last_mut() else {
        return Err(format!("property {} before any element", quoted(name)));
    };
    element.properties.push(Property { name: name.into(), shape });
    Ok(())
}

fn bad_count(element: &str, count: &str) -> String {
    let element = quoted(element);
    let digits = count.strip_prefix(['-', '+']).unwrap_or(count);
    if digits.is_empty() || !digits.bytes().all(|b| b.is_ascii_digit()) {
        format!("the count {} of element {element} is no number", quoted(count))
    } else if count.starts_with('-') {
        format!("element {element} has a negative count, {}", quoted(count))
    } else {
        format!("the count {} of element {element} is too large for any file", quoted(count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ok(text: &str) -> PlyHeader {
        parse(text.as_bytes(), true).unwrap().unwrap()
    }

    fn error(text: &str) -> String {
        let e = parse(text.as_bytes(), true).unwrap_err();
        format!("{}: {}", e.line, e.what)
    }

    #[test]
    fn line_ends_comments_and_spaces_make_no_difference() {
        let lines = [
            "ply",
            "format ascii 1.0",
            "comment caf\u{e9}  ",
            "element vertex 3",
            "property float32 x",
            "obj_info",
            "element face 1",
            "property list uint8 int32 vertex_indices",
            "end_header",
        ];
        let plain = ok(&(lines.join("\n") + "\n"));
        assert_eq!(plain.elements.len(), 2);
        assert!(plain.elements[1].has_lists());
        for end in ["\r\n", "\r", " \n", "\t \r\n", "\n\n"] {
            let text = lines.join(end) + end;
            let header = ok(&(text.clone() + "1 2 3"));
            assert_eq!(header.elements, plain.elements, "{end:?}");
            let blank_line = if end == "\n\n" { 1 } else { 0 };
            assert_eq!(header.len as usize, text.len() - blank_line, "{end:?}");
        }
    }

    #[test]
    fn data_that_begins_like_a_line_end_is_data() {
        let lines = ["ply", "format binary_little_endian 1.0", "element vertex 0", "end_header"];
        for end in ["\n", "\r\n", "\r"] {
            let text = lines.join(end) + end;
            assert_eq!(ok(&(text.clone() + "\n\r")).len as usize, text.len(), "{end:?}");
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let p = "ply\nformat ascii 1.0\n";
        assert_eq!(error("plywood\n"), "1: \"plywood\" is not \"ply\"");
        assert_eq!(error("ply\nformat ascii 2.0\n"), "2: unknown version \"2.0\" of PLY");
        assert_eq!(error("ply\nformat text 1.0\n"), "2: unknown format \"text\"");
        assert_eq!(error(&format!("{p}format ascii 1.0\n")), "3: a second format line");
        assert_eq!(error(&format!("{p}vertices 3\n")), "3: unknown keyword \"vertices\"");
        assert_eq!(error(&format!("{p}property float x\n")), "3: property \"x\" before any element");
        assert_eq!(error(&format!("{p}element vertex\n")), "3: cannot understand \"element vertex\"");
        assert_eq!(error(&format!("{p}element v -3\n")), "3: element \"v\" has a negative count, \"-3\"");
        assert_eq!(
            error(&format!("{p}element v 3.5\n")),
            "3: the count \"3.5\" of element \"v\" is no number"
        );
        assert_eq!(
            error(&format!("{p}element v 99999999999999999999\n")),
            "3: the count \"99999999999999999999\" of element \"v\" is too large for any file"
        );
        assert_eq!(error(&format!("{p}element v 3\nproperty quad x\n")), "4: unknown type \"quad\"");
        assert_eq!(
            error(&format!("{p}element v 3\nproperty list float int i\n")),
            "4: the list \"i\" is counted in float"
        );
        assert_eq!(error("ply\nend_header\n"), "2: no format line before end_header");
    }

    #[test]
    fn a_header_that_goes_on_is_not_an_error_yet() {
        let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n";
        for end in 0..text.len() - 1 {
            let prefix = &text.as_bytes()[..end];
            assert!(parse(prefix, false).unwrap().is_none());
            // In a file that ends here the line end may be missing, which changes nothing.
            let complete = end == text.len() - 1;
            assert_eq!(parse(prefix, true).unwrap().is_some(), complete, "{end}");
        }
    }

    #[test]
    fn types_have_two_names_each() {
        let names = "char int8 uchar uint8 short int16 ushort uint16 int int32 uint uint32 float float32 double float64";
        let types: Vec<Type> = names.split(' ').map(|n| n.parse().unwrap()).collect();
        for (pair, name) in types.chunks(2).zip(names.split(' ').step_by(2)) {
            assert_eq!(pair[0], pair[1]);
            assert_eq!(pair[0].name(), name);
        }
        assert_eq!(types.iter().map(|t| t.size()).sum::<usize>(), 2 * (1 + 1 + 2 + 2 + 4 + 4 + 4 + 8));
        assert!("Float".parse::<Type>().is_err());
    }
}
