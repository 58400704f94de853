//! The one pass over a file when it is opened: where vertices, normals and faces are, and whose the normals
//! are.

use std::collections::BTreeMap;
use std::ops::Range;

use super::lines::{ENDS, Statement, normals_are_of_vertices, values};
use crate::source::SourceFile;
use crate::text::blocks::{GAP, TextBlocks, TextBlocksBuilder};
use crate::text::lines::{Lines, text_start, wrong_line};
use crate::text::{coordinate, may_be_beyond, next_word, no_normal, parse};
use crate::{Result, Scalar};

/// Most runs of vertices or of normals, one after the other, of a file whose normals are read: a bound of the
/// memory for them.
const MOST_RUNS: u64 = 1 << 18;

/// Owner and place of the normals: those of vertices, or those of corners.
#[derive(Debug)]
pub(super) enum NormalsAre {
    /// The file has no normals.
    None,
    /// The vertices': each stands in a line before or behind its vertex, and no other vertex between.
    Beside,
    /// The vertices', in the same order, but elsewhere in the file.
    Apart(TextBlocks),
    /// Normals of corners, which share them.
    Shared(TextBlocks),
    /// So many normals, in too many runs to be read.
    Scattered(u64),
}

/// The findings of a scan.
#[derive(Debug)]
pub(super) struct ObjScan {
    pub(super) vertices: TextBlocks,
    pub(super) normals: NormalsAre,
    pub(super) faces: u64,
    /// Byte at which the first face begins, and the byte at which the last one ends.
    pub(super) face_lines: Range<u64>,
    /// Number of corners of all faces that may name a normal, at most.
    pub(super) corners: u64,
    /// Some numbers of corners are negative.
    pub(super) is_relative: bool,
    pub(super) first_vertex: Vec<u8>,
    /// Number of lines that begin with each other word; a bounded number of words is told apart.
    pub(super) others: BTreeMap<Vec<u8>, u64>,
}

/// Most first words of other lines that are told apart, and most bytes of each.
const MOST_WORDS: usize = 64;
const LONGEST_WORD: usize = 16;

/// Notes a line that is neither vertex nor normal nor face.
fn note(line: &[u8], others: &mut BTreeMap<Vec<u8>, u64>) {
    let Some((start, end)) = next_word(line, 0, true) else { return };
    let word = &line[start..end.min(start + LONGEST_WORD)];
    let word = if word.starts_with(b"#") { b"#" } else { word };
    if let Some(count) = others.get_mut(word) {
        *count += 1;
    } else {
        let word: &[u8] = if others.len() < MOST_WORDS { word } else { b"other words" };
        *others.entry(word.to_vec()).or_default() += 1;
    }
}

/// An error where a normal has a number beyond doubles: who samples a model does not read the normals of its
/// corners, and would be told when it is written.
#[inline]
fn check_normal(source: &SourceFile, start: u64, line: &[u8], normal: u64) -> Result<()> {
    if !may_be_beyond(line) {
        return Ok(());
    }
    for word in values(line).take(3).map(|(a, b)| &line[a..b]) {
        if coordinate(Scalar::F64, word).is_none() && parse(Scalar::F64, word).is_some() {
            let (what, hint) = no_normal(Scalar::F64, word);
            return Err(wrong_line(source, start, format!("normal {normal}: {what}"), hint));
        }
    }
    Ok(())
}

/// The lines of faces.
#[derive(Default)]
struct ScannedFaces {
    count: u64,
    /// The bytes from the first one to the last one.
    lines: Range<u64>,
    slashes: u64,
    /// Whether any face counts vertices backwards.
    is_relative: bool,
}

impl ScannedFaces {
    fn take(&mut self, start: u64, line: &[u8]) {
        if self.count == 0 {
            self.lines.start = start;
        }
        self.lines.end = start + line.len() as u64;
        self.count += 1;
        self.slashes += memchr::memchr_iter(b'/', line).count() as u64;
        self.is_relative = self.is_relative || memchr::memchr(b'-', line).is_some();
    }
}

/// Vertices that have their normals beside them, as long as all have.
struct NormalPairs {
    builder: Option<TextBlocksBuilder>,
    vertices: u64,
    normals: u64,
    /// Byte at which the first line of a vertex begins, as long as the second one is to come.
    start: u64,
}

impl NormalPairs {
    fn line(&mut self, statement: Statement, start: u64, end: u64) {
        match statement {
            Statement::Vertex => self.vertices += 1,
            _ => self.normals += 1,
        }
        let Some(builder) = &mut self.builder else { return };
        match self.vertices.abs_diff(self.normals) {
            0 if start - self.start <= GAP => builder.vertex(self.start, end),
            1 => self.start = start,
            _ => self.builder = None,
        }
    }

    /// Blocks of the vertices of a file, and the place of their normals, from the lines of both.
    fn finish(
        self,
        [vertices, normals]: [TextBlocks; 2],
        are_of_vertices: bool,
        are_scattered: bool,
    ) -> (TextBlocks, NormalsAre) {
        let are_paired = self.normals == self.vertices && are_of_vertices;
        let normals = match self.builder {
            _ if self.normals == 0 => NormalsAre::None,
            Some(pairs) if are_paired => return (pairs.finish(), NormalsAre::Beside),
            _ if are_scattered => NormalsAre::Scattered(self.normals),
            _ if !are_paired => NormalsAre::Shared(normals),
            _ => NormalsAre::Apart(normals),
        };
        (vertices, normals)
    }
}

impl ObjScan {
    pub(super) fn from_source(source: &SourceFile) -> Result<Self> {
        let begin = text_start(source)?;
        let mut lines = Lines::new(source, begin, u64::MAX, ENDS);
        let builder = || TextBlocksBuilder::new(begin, 1);
        let (mut vertices, mut normals) = (builder(), builder());
        let mut beside = NormalPairs { builder: Some(builder()), vertices: 0, normals: 0, start: begin };
        let mut faces = ScannedFaces::default();
        let (mut are_of_vertices, mut first_vertex) = (true, Vec::new());
        let mut others = BTreeMap::new();
        let (mut runs, mut last) = (0u64, Statement::Other);
        while let Some((start, line)) = lines.next()? {
            let statement = Statement::parse(line);
            let end = start + line.len() as u64;
            match statement {
                Statement::Vertex | Statement::Normal => {
                    if statement != last && last != Statement::Other {
                        // A run of the other sort lies between.
                        runs += 1;
                        if runs <= MOST_RUNS {
                            vertices.separate();
                            normals.separate();
                        }
                    }
                    last = statement;
                    beside.line(statement, start, end);
                    if statement == Statement::Normal {
                        check_normal(source, start, line, normals.vertices())?;
                        normals.vertex(start, end);
                    } else {
                        vertices.vertex(start, end);
                        if vertices.vertices() == 1 {
                            first_vertex = line.to_vec();
                        }
                    }
                }
                Statement::Face => {
                    faces.take(start, line);
                    are_of_vertices = are_of_vertices
                        && normals_are_of_vertices(line, vertices.vertices(), normals.vertices());
                }
                Statement::Other => note(line, &mut others),
            }
        }
        let blocks = [vertices.finish(), normals.finish()];
        let (vertices, normals) = beside.finish(blocks, are_of_vertices, runs > MOST_RUNS);
        let ScannedFaces { count: faces, lines: face_lines, slashes, is_relative } = faces;
        let corners = slashes / 2;
        Ok(Self { vertices, normals, faces, face_lines, corners, is_relative, first_vertex, others })
    }
}
