//! The header: fields, their types, and how many points there are.

use crate::source::SourceFile;
use crate::text::lines::{LineEnds, lines, without_mark};
use crate::text::{CUT_OFF, DAMAGED, quoted};
use crate::{Result, Type};

/// A header has to end within this many bytes.
const LONGEST: usize = 1 << 20;

/// Most numbers of a point.
const MOST_NUMBERS: usize = 1 << 14;

/// The storage of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Data {
    Ascii,
    Binary,
    Compressed,
}

impl Data {
    /// The name of this layout in the header.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::Binary => "binary",
            Self::Compressed => "binary_compressed",
        }
    }
}

/// A field of a point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PcdField {
    pub(super) name: String,
    /// Letter and size of the type as the header has them, as `F` and 4.
    letter: String,
    pub(super) size: usize,
    pub(super) count: usize,
    /// Type of the numbers; none for whole numbers of 64 bits.
    pub(super) kind: Option<Type>,
}

impl PcdField {
    /// Name that PLY has for a coordinate of the position or the normal.
    pub(super) fn component(&self) -> Option<&'static str> {
        Some(match self.name.as_str() {
            "x" => "x",
            "y" => "y",
            "z" => "z",
            "normal_x" => "nx",
            "normal_y" => "ny",
            "normal_z" => "nz",
            _ => return None,
        })
    }

    pub(super) fn is_component(&self) -> bool {
        self.component().is_some()
    }

    /// The field in words for people, as "F4 intensity".
    pub(super) fn describe(&self) -> String {
        let times = if self.count == 1 { String::new() } else { format!(" ({})", self.count) };
        format!("{}{} {}{times}", self.letter, self.size, self.name)
    }

    /// Bytes in a binary file.
    pub(super) fn bytes(&self) -> usize {
        self.size * self.count
    }
}

/// A parsed header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PcdHeader {
    pub(super) version: String,
    pub(super) fields: Vec<PcdField>,
    pub(super) points: u64,
    pub(super) data: Data,
    /// The length of the header, behind which the points begin.
    pub(super) len: u64,
    /// Text of the header, and the byte at which its last line begins.
    pub(super) text: Vec<u8>,
    pub(super) data_line: usize,
}

/// Whether a file says that it is PCD.
pub(crate) fn is_pcd(start: &[u8]) -> bool {
    let start = without_mark(start);
    start.starts_with(b"# .PCD") || start.starts_with(b"VERSION ") || start.starts_with(b"FIELDS ")
}

type PcdFault = (String, &'static str);

impl PcdHeader {
    pub(super) fn read(source: &SourceFile) -> Result<Self> {
        let mut start = Vec::new();
        source.append_at(&mut start, 0, LONGEST)?;
        let mut parser = Parser::default();
        for (number, (at, end)) in lines(&start, LineEnds::Breaks).enumerate() {
            let line = if at == 0 { without_mark(&start[..end]) } else { &start[at..end] };
            let line = String::from_utf8_lossy(line).into_owned();
            let wrong = |(what, hint): PcdFault| {
                source.malformed(format_args!("line {} of the header: {what}", number + 1), hint)
            };
            if let Some(data) = parser.line(&line).map_err(wrong)? {
                // Binary points may begin with what looks like a line feed.
                let is_break = start[..end].ends_with(b"\r\n") || !start[..end].ends_with(b"\r");
                let end = if is_break { end } else { at + start[at..end].trim_ascii_end().len() + 1 };
                let header = parser.finish(data, &start[..end], at).map_err(wrong)?;
                return Ok(header);
            }
        }
        if start.len() == LONGEST {
            return Err(source.malformed("no DATA within the first MiB", DAMAGED));
        }
        Err(source.malformed("the file ends within its header", CUT_OFF))
    }
}

/// Contents of the header's lines read so far.
#[derive(Default)]
struct Parser {
    version: Option<String>,
    names: Vec<String>,
    sizes: Vec<usize>,
    letters: Vec<String>,
    counts: Vec<usize>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
}

impl Parser {
    /// Takes a line; returns the encoding of the data if the line is the last one.
    fn line(&mut self, line: &str) -> Result<Option<Data>, PcdFault> {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_ascii_whitespace();
        let Some(keyword) = words.next() else { return Ok(None) };
        let words: Vec<&str> = words.collect();
        if words.len() > MOST_NUMBERS {
            return Err((format!("{} words", words.len()), DAMAGED));
        }
        let numbers = || words.iter().map(|word| number(word)).collect::<Result<Vec<u64>, PcdFault>>();
        let sizes = || {
            Ok::<_, PcdFault>(
                numbers()?.into_iter().map(|n| usize::try_from(n).unwrap_or(usize::MAX)).collect(),
            )
        };
        let one = || {
            words
                .first()
                .ok_or_else(|| (format!("{keyword} of nothing"), DAMAGED))
                .and_then(|word| number(word))
        };
        match keyword {
            "VERSION" => self.version = words.first().map(|word| (*word).to_owned()),
            "FIELDS" | "COLUMNS" => self.names = words.iter().map(|word| (*word).to_owned()).collect(),
            "SIZE" => self.sizes = sizes()?,
            "TYPE" => self.letters = words.iter().map(|word| (*word).to_owned()).collect(),
            "COUNT" => self.counts = sizes()?,
            "WIDTH" => self.width = Some(one()?),
            "HEIGHT" => self.height = Some(one()?),
            "POINTS" => self.points = Some(one()?),
            "VIEWPOINT" => {}
            "DATA" => {
                return match words.first() {
                    Some(&"ascii") => Ok(Some(Data::Ascii)),
                    Some(&"binary") => Ok(Some(Data::Binary)),
                    Some(&"binary_compressed") => Ok(Some(Data::Compressed)),
                    other => Err((
                        format!("unknown DATA {}", quoted(other.unwrap_or(&""))),
                        "it is ascii, binary or binary_compressed: export the points so",
                    )),
                };
            }
            _ => return Err((format!("unknown keyword {}", quoted(keyword)), DAMAGED)),
        }
        Ok(None)
    }

    fn finish(self, data: Data, text: &[u8], data_line: usize) -> Result<PcdHeader, PcdFault> {
        let fields = self.names.len();
        let counts = if self.counts.is_empty() { vec![1; fields] } else { self.counts };
        if [self.sizes.len(), self.letters.len(), counts.len()] != [fields; 3] {
            let what = format!(
                "{fields} fields, but {} sizes, {} types and {} counts",
                self.sizes.len(),
                self.letters.len(),
                counts.len()
            );
            return Err((what, DAMAGED));
        }
        if counts.iter().fold(0usize, |sum, count| sum.saturating_add(*count)) > MOST_NUMBERS {
            return Err((format!("more than {MOST_NUMBERS} numbers for each point"), DAMAGED));
        }
        let product = match (self.width, self.height) {
            (Some(width), Some(height)) => Some(width.saturating_mul(height)),
            (Some(width), None) => Some(width),
            _ => None,
        };
        let points = self
            .points
            .or(product)
            .ok_or_else(|| ("it says nowhere how many points there are".to_owned(), DAMAGED))?;
        if let Some(product) = product.filter(|product| *product != points) {
            return Err((format!("says {points} points, but also {product}, by width and height"), DAMAGED));
        }
        let of_fields = self.names.into_iter().zip(self.letters).zip(self.sizes.into_iter().zip(counts));
        let field = |((name, letter), (size, count)): ((String, String), (usize, usize))| {
            let Some(kind) = kind(&letter, size) else {
                let (name, letter) = (quoted(&name), quoted(&letter));
                let what = format!("field {name} has the unknown type {letter} of {size} bytes");
                return Err((what, DAMAGED));
            };
            Ok(PcdField { name, letter, size, count, kind })
        };
        let fields = of_fields.map(field).collect::<Result<Vec<PcdField>, PcdFault>>()?;
        Ok(PcdHeader {
            version: self.version.unwrap_or_else(|| "0.7".into()),
            fields,
            points,
            data,
            len: text.len() as u64,
            text: text.to_vec(),
            data_line,
        })
    }
}

fn number(word: &str) -> Result<u64, PcdFault> {
    word.parse().map_err(|_| (format!("{} is no count", quoted(word)), DAMAGED))
}

/// The type of a letter and a size; within it none for whole numbers of 64 bits.
fn kind(letter: &str, size: usize) -> Option<Option<Type>> {
    Some(Some(match (letter, size) {
        ("F", 4) => Type::F32,
        ("F", 8) => Type::F64,
        ("I", 1) => Type::I8,
        ("I", 2) => Type::I16,
        ("I", 4) => Type::I32,
        ("U", 1) => Type::U8,
        ("U", 2) => Type::U16,
        ("U", 4) => Type::U32,
        ("I" | "U", 8) => return Some(None),
        _ => return None,
    }))
}

/// The text of a header that can be parsed, without the fields of the points' normals.
pub(super) fn without_normals(header: &[u8]) -> Vec<u8> {
    let is_normal = |name: &str| matches!(name, "normal_x" | "normal_y" | "normal_z");
    let text = String::from_utf8_lossy(header);
    let (mut dropped, mut left) = (Vec::new(), String::new());
    for line in text.split_inclusive('\n') {
        let (mark, line) = line.split_at(line.len() - line.trim_start_matches('\u{feff}').len());
        left += mark;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let end = &line[line.trim_ascii_end().len()..];
        match words[..] {
            ["FIELDS" | "COLUMNS" | "SIZE" | "TYPE" | "COUNT", ref values @ ..] => {
                if matches!(words[0], "FIELDS" | "COLUMNS") {
                    dropped = values.iter().map(|name| is_normal(name)).collect();
                }
                let kept = values.iter().enumerate().filter(|(i, _)| dropped.get(*i) != Some(&true));
                left += words[0];
                kept.for_each(|(_, word)| left += &format!(" {word}"));
                left += end;
            }
            _ => left += line,
        }
    }
    left.into_bytes()
}
