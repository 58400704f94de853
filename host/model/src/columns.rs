//! Points in columns of text: XYZ, PTS, CSV, TXT, ASC and the like.
//!
//! Columns are separated by blanks and tabs, by commas, semicolons or bars, or by another character between
//! their numbers, as colons; in TSV by each tab. Which ones are the position and the normal is told by the
//! user, by names in a line before the points (a comment, too), or by the file's extension; without any, the
//! first three are the position. The others are attributes, if they are numbers in the first point's line. A
//! PTS file says first how many points follow, and so does each further scan in it.

use crate::source::SourceFile;
use crate::text::blocks::{TextBlocks, TextBlocksBuilder};
use crate::text::lines::{LineEnds, Lines, text_start, wrong_line};
use crate::text::model::{Grammar, TextModel, info};
use crate::text::{CUT_OFF, integer, is_space, next_word, parse, quoted};
use crate::{Attribute, Error, Model, ModelInfo, Result, Scalar, Type};

/// Extensions of such files.
pub(crate) const EXTENSIONS: [&str; 8] = ["xyz", "xyzn", "xyzrgb", "pts", "csv", "tsv", "txt", "asc"];

const HINT: &str = "say what the columns are, as by --columns x,y,z,_,nx,ny,nz; decimals have points";

/// Names of the six components in headers: position, then normal; in lower case.
const NAMES: [&[&str]; 6] = [
    &["x", "px", "pos_x", "position_x", "points_x", "points:0", "coord_x", "easting", "east"],
    &["y", "py", "pos_y", "position_y", "points_y", "points:1", "coord_y", "northing", "north"],
    &["z", "pz", "pos_z", "position_z", "points_z", "points:2", "coord_z", "height", "elevation", "altitude"],
    &["nx", "normal_x", "normals_x", "normals:0", "normalx"],
    &["ny", "normal_y", "normals_y", "normals:1", "normaly"],
    &["nz", "normal_z", "normals_z", "normals:2", "normalz"],
];

/// The meaning of each column.
#[derive(Debug)]
pub(crate) struct Columns {
    /// Byte that separates columns; blanks and tabs if none.
    separator: Option<u8>,
    /// Meaning of each column up to the last one that is written anew, as the index among a vertex' numbers:
    /// those of the components, and behind these those that turn.
    roles: Vec<Option<usize>>,
    /// 3, or 6 with a normal.
    components: usize,
    /// Number of the columns that turn with the surface.
    following: usize,
    /// Columns of the attributes.
    attributes: Vec<usize>,
    /// Names of the columns that are not read.
    unread: Vec<String>,
    /// Lines with a single word are numbers of points.
    is_counted: bool,
    /// Meaning of the columns as the user gave it, if so.
    wanted: Option<String>,
}

impl Columns {
    /// Columns between blanks that are so many components in this order, with `first` others behind the
    /// position. Attributes are these and those behind all, so many, or none at all.
    pub(crate) fn in_order(components: usize, first: usize, attributes: usize) -> Self {
        let position = (0..3).map(Some);
        Self {
            separator: None,
            roles: position.chain((0..first).map(|_| None)).chain((3..components).map(Some)).collect(),
            components,
            following: 0,
            attributes: (3..3 + first)
                .chain(components + first..components + attributes)
                .take(attributes)
                .collect(),
            unread: Vec::new(),
            is_counted: false,
            wanted: None,
        }
    }

    /// Finds the columns by their names, of which some components are.
    fn named(separator: Option<u8>, names: &[String], is_counted: bool) -> Result<Self, String> {
        let place = |component: usize| {
            let mut found = names.iter().enumerate().filter(|(_, name)| is_called(name, component));
            match (found.next(), found.next()) {
                (Some((column, _)), None) => Ok(Some(column)),
                (None, _) => Ok(None),
                _ => Err(format!("two columns are {}", NAMES[component][0])),
            }
        };
        let mut columns = Vec::new();
        for (component, names) in NAMES.iter().enumerate().take(3) {
            let missing = || format!("no column is {}", names[0]);
            columns.push(place(component)?.ok_or_else(missing)?);
        }
        let normal = [place(3)?, place(4)?, place(5)?];
        if let [Some(x), Some(y), Some(z)] = normal {
            columns.extend([x, y, z]);
        }
        let mut roles = vec![None; columns.iter().max().map_or(0, |last| last + 1)];
        columns.iter().enumerate().for_each(|(component, column)| roles[*column] = Some(component));
        Ok(Self {
            separator,
            roles,
            components: columns.len(),
            following: 0,
            attributes: Vec::new(),
            unread: Vec::new(),
            is_counted,
            wanted: None,
        })
    }

    /// The columns of a line: where each begins and ends.
    pub(crate) fn fields<'l>(&self, line: &'l [u8]) -> impl Iterator<Item = (usize, usize)> + 'l {
        fields(line, self.separator)
    }
}

/// Whether a column's name is that of a component.
fn is_called(name: &str, component: usize) -> bool {
    // Without a unit, as in "X (m)" or "x[m]".
    let end = name.find(['(', '[']).unwrap_or(name.len());
    let name = name[..end].trim().to_ascii_lowercase();
    NAMES[component].contains(&name.as_str())
}

/// The columns of a line, without blanks and quotes around them.
#[inline]
fn fields(line: &[u8], separator: Option<u8>) -> impl Iterator<Item = (usize, usize)> + '_ {
    let (mut at, mut is_over) = (0, false);
    std::iter::from_fn(move || {
        let Some(separator) = separator else {
            let (start, end) = next_word(line, at, true)?;
            at = end;
            return Some((start, end));
        };
        if is_over {
            return None;
        }
        let begin = at;
        let mut start = begin;
        while line.get(start).is_some_and(|b| is_space(*b) && *b != separator) {
            start += 1;
        }
        let quote = line.get(start) == Some(&b'"');
        // A separator within quotes separates nothing.
        let closing =
            if quote { memchr::memchr(b'"', &line[start + 1..]).map(|at| start + 1 + at) } else { None };
        let from = closing.unwrap_or(at);
        let mut end = memchr::memchr(separator, &line[from..]).map_or(line.len(), |found| from + found);
        is_over = end == line.len();
        at = end + 1;
        if start >= end {
            return Some((begin, begin));
        }
        while end > start && is_space(line[end - 1]) {
            end -= 1;
        }
        if end - start >= 2 && line[start] == b'"' && line[end - 1] == b'"' {
            (start, end) = (start + 1, end - 1);
        }
        Some((start, end))
    })
}

/// Whether a line is empty, or a comment.
#[inline]
fn is_blank(line: &[u8]) -> bool {
    match line.iter().position(|b| !is_space(*b)) {
        None => true,
        Some(at) => matches!(line[at], b'#' | b'%') || line[at..].starts_with(b"//"),
    }
}

impl Grammar for Columns {
    const EXTENSIONS: &[&str] = &EXTENSIONS;

    fn wanted(&self) -> Option<&str> {
        self.wanted.as_deref()
    }

    fn components(&self) -> usize {
        self.components
    }

    fn besides(&self) -> Vec<String> {
        let name = |name: &String| format!("the column {}, which is no attribute", quoted(name));
        self.unread.iter().map(name).collect()
    }

    fn follow(&mut self, attributes: &[usize]) {
        self.roles.iter_mut().filter(|role| **role >= Some(self.components)).for_each(|role| *role = None);
        let columns: Vec<usize> = attributes.iter().map(|attribute| self.attributes[*attribute]).collect();
        let end = columns.iter().max().map_or(0, |last| last + 1);
        self.roles.resize(self.roles.len().max(end), None);
        for (number, column) in (self.components..).zip(&columns) {
            self.roles[*column] = Some(number);
        }
        self.following = columns.len();
    }

    fn numbers(&self) -> usize {
        self.components + self.following
    }

    #[inline]
    fn is_vertex(&self, line: &[u8]) -> bool {
        !is_blank(line) && (!self.is_counted || self.fields(line).nth(1).is_some())
    }

    #[inline]
    fn words(&self, line: &[u8], spans: &mut [[usize; 2]]) {
        for (role, (start, end)) in self.roles.iter().zip(self.fields(line)) {
            if let Some(number) = role {
                spans[*number] = [start, end];
            }
        }
    }

    fn has_cell(&self, line: &[u8], component: usize) -> bool {
        let column = self.roles.iter().position(|role| *role == Some(component));
        self.separator.is_some() && column.is_some_and(|column| self.fields(line).nth(column).is_some())
    }

    fn attribute<'l>(&self, line: &'l [u8], attribute: usize) -> Option<&'l [u8]> {
        let (start, end) = self.fields(line).nth(self.attributes[attribute])?;
        Some(&line[start..end])
    }
}

/// Returns the byte that separates the columns of a line; none for blanks and tabs.
fn separator(line: &[u8], extension: &str) -> Option<u8> {
    let usual: &[u8] = if extension == "tsv" { b"\t;,|" } else { b";,|" };
    let usual = usual.iter().copied().find(|b| line.contains(b));
    usual.or_else(|| b":/&~!^@".iter().copied().find(|b| separates(line, *b)))
}

/// Whether a byte that dates, times and the like have, too, separates columns: three single words at least.
fn separates(line: &[u8], separator: u8) -> bool {
    let is_word =
        |(start, end): (usize, usize)| start < end && !line[start..end].iter().any(|b| is_space(*b));
    let mut columns = fields(line, Some(separator));
    (0..3).all(|_| columns.next().is_some_and(is_word))
}

/// Whether a line tells a spreadsheet the separator of columns, as `sep=;` does before all other lines. The
/// lines behind it show the separator, too.
fn says_separator(line: &[u8]) -> bool {
    let word = line.trim_ascii();
    word.len() <= 5 && word.len() >= 4 && word[..4].eq_ignore_ascii_case(b"sep=")
}

/// Whether a file's first lines are such columns, and its extension is that of one.
pub(crate) fn is_columns(source: &SourceFile, extension: &str) -> bool {
    EXTENSIONS.contains(&extension) && head(source, extension, None).is_ok()
}

impl Columns {
    /// Makes attributes of the columns without a role that are numbers on the first line of a point, and
    /// notes the others that have a name, where `is_told` says that there is such a column.
    fn find_attributes(
        &mut self,
        names: &[String],
        numbers: &[bool],
        is_told: impl Fn(usize) -> bool,
    ) -> Vec<Attribute> {
        let mut attributes: Vec<Attribute> = Vec::new();
        for (column, name) in names.iter().enumerate() {
            let is_number = numbers.get(column).copied().unwrap_or(false);
            let is_free = self.roles.get(column).copied().flatten().is_none();
            let is_known = attributes.iter().any(|known| known.name == *name);
            if !is_free || name == "_" {
                continue;
            }
            if is_number && !is_known && Attribute::is_name(name) {
                attributes.push(Attribute { name: name.clone(), kind: Type::F64 });
                self.attributes.push(column);
            } else if !name.is_empty() && is_told(column) {
                self.unread.push(name.clone());
            }
        }
        attributes
    }
}

/// Contents of the lines before the first point.
struct ColumnsHead {
    columns: Columns,
    /// Names of the columns.
    names: Vec<String>,
    attributes: Vec<Attribute>,
    /// Byte at which the first line begins, and the byte of the first line that may be a point.
    begin: u64,
    start: u64,
}

/// Opens a file, which is read once for that; `wanted` names its columns, as "x,y,z".
pub(crate) fn open(source: SourceFile, extension: &str, wanted: Option<&str>) -> Result<Box<dyn Model>> {
    let ColumnsHead { mut columns, names, attributes, begin, start } = head(&source, extension, wanted)?;
    let blocks = scan(&source, &columns, begin, start)?;
    columns.wanted = wanted.map(str::to_owned);
    let separated = match columns.separator {
        None => "blanks",
        Some(b',') => "commas",
        Some(b'\t') => "tabs",
        Some(b'|') => "bars",
        Some(b';') => "semicolons",
        Some(b':') => "colons",
        Some(b'/') => "slashes",
        Some(_) => "other characters",
    };
    let others = names.iter().enumerate().filter(|(i, _)| columns.roles.get(*i).copied().flatten().is_none());
    let info = ModelInfo {
        other_properties: others.map(|(_, name)| name.clone()).collect(),
        attributes,
        ..info(&source, format!("text in {} columns between {separated}", names.len()))
    };
    Ok(Box::new(TextModel::new(source, columns, blocks, info)?))
}

/// Finds the blocks of points. Where lines with a single word are numbers of points, they have to fit the
/// points found.
fn scan(source: &SourceFile, columns: &Columns, begin: u64, start: u64) -> Result<TextBlocks> {
    let mut lines = Lines::new(source, begin, u64::MAX, LineEnds::Breaks);
    let mut builder = TextBlocksBuilder::new(start, 1);
    let mut said = 0u64;
    while let Some((at, line)) = lines.next()? {
        if at >= start && columns.is_vertex(line) {
            builder.vertex(at, at + line.len() as u64);
        } else if columns.is_counted && !is_blank(line) {
            let word = next_word(line, 0, true).map_or(&[][..], |(a, b)| &line[a..b]);
            let count = integer(word).and_then(|count| u64::try_from(count).ok());
            let wrong = || {
                wrong_line(
                    source,
                    at,
                    format!("{} is no number of points", quoted(&String::from_utf8_lossy(word))),
                    HINT,
                )
            };
            said = said.saturating_add(count.ok_or_else(wrong)?);
        }
    }
    if columns.is_counted && said != builder.vertices() {
        let what = format!("says that it has {said} points, but it has {}", builder.vertices());
        return Err(source.malformed(what, CUT_OFF));
    }
    Ok(builder.finish())
}

/// Contents of the lines before the first row with a number.
#[derive(Default)]
struct BeforeRows {
    /// The last comment.
    comment: Vec<u8>,
    /// Whether a line was a number of points.
    is_counted: bool,
    /// Separator of the columns, and their names.
    header: Option<(Option<u8>, Vec<String>)>,
    /// The first row without any number, which tells nothing of the columns.
    empty: Option<u64>,
}

/// A line of a file with columns.
struct ColumnsLine<'a> {
    at: u64,
    separator: Option<u8>,
    words: Vec<&'a [u8]>,
    /// Whether each of the words is a number.
    numbers: Vec<bool>,
}

impl ColumnsLine<'_> {
    fn has_row(&self) -> bool {
        let mut words = self.words.iter().zip(&self.numbers);
        self.words.len() >= 3 && words.all(|(word, is_number)| *is_number || word.is_empty())
    }
}

impl BeforeRows {
    /// The names of the columns of a row, and whether the file or the user tells them.
    fn names(&mut self, extension: &str, wanted: Option<&str>, row: &ColumnsLine<'_>) -> (Vec<String>, bool) {
        if let Some(wanted) = wanted {
            return (wanted.split(',').map(|name| name.trim().to_owned()).collect(), true);
        }
        let columns = row.words.len();
        let named = self.header.take().map(|(_, names)| names);
        match named.or_else(|| in_comment(&self.comment, row.separator, columns)) {
            Some(names) => (names, true),
            None => (usual(extension, self.is_counted, columns), false),
        }
    }

    /// Returns the head of the file, with this first row of points.
    fn with_row(
        mut self,
        source: &SourceFile,
        (extension, wanted): (&str, Option<&str>),
        begin: u64,
        mut row: ColumnsLine<'_>,
    ) -> Result<ColumnsHead> {
        row.separator = self.header.as_ref().map_or(row.separator, |h| h.0.or(row.separator));
        let (mut names, is_named) = self.names(extension, wanted, &row);
        let wrong = |what: String| match wanted {
            Some(wanted) => {
                let path = source.path().display();
                let what = format!("{path}, of the columns {}: {what}", quoted(wanted));
                Error::argument(what, HINT)
            }
            None => wrong_line(source, row.at, what, HINT),
        };
        let mut columns = Columns::named(row.separator, &names, self.is_counted).map_err(wrong)?;
        let named = if is_named { names.len() } else { 0 };
        for column in names.len()..row.words.len() {
            names.push(format!("column {}", column + 1));
        }
        let has_word = |column: usize| row.words.get(column).is_some_and(|word| !word.is_empty());
        let is_told = |column: usize| column < named || has_word(column);
        let attributes = columns.find_attributes(&names, &row.numbers, is_told);
        Ok(ColumnsHead { columns, names, attributes, begin, start: self.empty.unwrap_or(row.at) })
    }
}

fn head(source: &SourceFile, extension: &str, wanted: Option<&str>) -> Result<ColumnsHead> {
    let begin = text_start(source)?;
    let mut lines = Lines::new(source, begin, u64::MAX, LineEnds::Breaks);
    let mut before = BeforeRows::default();
    loop {
        let Some((at, line)) = lines.next()? else {
            return Err(source.malformed("there is no line of numbers in it", HINT));
        };
        if at == begin && says_separator(line) {
            continue;
        }
        if is_blank(line) {
            before.comment.clear();
            before.comment.extend_from_slice(&line[..line.len().min(LONGEST_HEADER)]);
            continue;
        }
        let separator = separator(line, extension);
        let words: Vec<&[u8]> =
            fields(line, separator).map(|(a, b)| &line[a..b]).take(MOST_COLUMNS).collect();
        let numbers: Vec<bool> = words.iter().map(|word| parse(Scalar::F64, word).is_some()).collect();
        if words.len() == 1 && integer(words[0]).is_some() && !before.is_counted && before.header.is_none() {
            before.is_counted = true;
            continue;
        }
        let row = ColumnsLine { at, separator, words, numbers };
        let (is_row, has_number) = (row.has_row(), row.numbers.contains(&true));
        if is_row && !has_number {
            before.empty.get_or_insert(at);
            continue;
        }
        // Names, unless the position is numbers.
        if before.header.is_none()
            && !is_row
            && row.numbers.iter().take(3).filter(|n| **n).count() < 3
            && wanted.is_none_or(|_| !has_number)
        {
            if row.words.len() < 3 {
                let line = quoted(&String::from_utf8_lossy(line));
                let what = format!("{line} is neither a point nor names of columns");
                return Err(wrong_line(source, at, what, HINT));
            }
            let names = row.words.iter().map(|word| String::from_utf8_lossy(word).into_owned()).collect();
            (before.header, before.empty) = (Some((separator, names)), None);
            continue;
        }
        return before.with_row(source, (extension, wanted), begin, row);
    }
}

/// Most columns that have names, and the longest line of them in a comment.
const MOST_COLUMNS: usize = 4096;
const LONGEST_HEADER: usize = 1 << 16;

/// Names in a comment, if there are as many as columns.
fn in_comment(comment: &[u8], separator: Option<u8>, count: usize) -> Option<Vec<String>> {
    let start = comment.iter().position(|b| !is_space(*b) && !matches!(b, b'#' | b'%' | b'/'))?;
    let text = &comment[start..];
    let names: Vec<String> =
        fields(text, separator).map(|(a, b)| String::from_utf8_lossy(&text[a..b]).into_owned()).collect();
    let has_position = (0..3).all(|component| names.iter().any(|name| is_called(name, component)));
    (names.len() == count && has_position).then_some(names)
}

/// Names of the columns of a file that does not name them, by its extension and their number.
fn usual(extension: &str, is_counted: bool, count: usize) -> Vec<String> {
    let names: &[&str] = match (extension, count) {
        ("xyzn", 6..) => &["x", "y", "z", "nx", "ny", "nz"],
        ("xyzrgb", 6..) => &["x", "y", "z", "red", "green", "blue"],
        (_, 4) if is_counted => &["x", "y", "z", "intensity"],
        (_, 6) if is_counted => &["x", "y", "z", "red", "green", "blue"],
        (_, 7) if is_counted => &["x", "y", "z", "intensity", "red", "green", "blue"],
        _ => &["x", "y", "z"],
    };
    let more = (names.len()..count).map(|column| format!("column {}", column + 1));
    names.iter().map(|name| (*name).to_owned()).chain(more).collect()
}
