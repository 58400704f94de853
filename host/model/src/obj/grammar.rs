//! The grammar of an OBJ file's lines with vertices and faces.

use std::collections::BTreeMap;
use std::ops::Range;

use super::lines::{ENDS, Statement, absolute, leading_integer, values};
use crate::form::counted;
use crate::model::NoFaces;
use crate::text::faces::{FaceLines, LineFaces};
use crate::text::lines::{LineEnds, Lines, lines};
use crate::text::model::{Grammar, TextModel};
use crate::text::{next_word, quoted};
use crate::{FaceReader, Result};

/// The statements of OBJ.
#[derive(Debug)]
pub(crate) struct Obj {
    /// Each vertex has its normal in a line of its own, before the next vertex.
    pub(super) beside: bool,
    /// Numbers of a vertex before its attributes.
    pub(super) skipped: usize,
    /// Byte at which the first face begins, and the byte at which the last one ends.
    pub(super) face_lines: Range<u64>,
    /// Some corners count vertices backwards from the place where they stand.
    pub(super) is_relative: bool,
    /// Other lines, by their first words.
    pub(super) others: BTreeMap<Vec<u8>, u64>,
}

impl Grammar for Obj {
    const EXTENSIONS: &[&str] = &["obj"];
    fn ends(&self) -> LineEnds {
        ENDS
    }

    fn components(&self) -> usize {
        if self.beside { 6 } else { 3 }
    }

    fn besides(&self) -> Vec<String> {
        let name = |(word, count): (&Vec<u8>, &u64)| {
            let what = match &word[..] {
                b"#" => return counted(*count, "comment"),
                b"vt" => "texture coordinate",
                b"mtllib" | b"usemtl" => "material statement",
                b"g" | b"o" => "group statement",
                b"s" => "smoothing group statement",
                b"l" => "line",
                b"p" => "point statement",
                _ => "statement",
            };
            format!("{} ({})", counted(*count, what), String::from_utf8_lossy(word).escape_debug())
        };
        self.others.iter().map(name).collect()
    }

    fn is_vertex(&self, line: &[u8]) -> bool {
        Statement::parse(line) == Statement::Vertex
    }

    fn words(&self, line: &[u8], spans: &mut [[usize; 2]]) {
        for (span, (start, end)) in spans.iter_mut().take(3).zip(values(line)) {
            *span = [start, end];
        }
    }

    fn find(&self, raw: &[u8], spans: &mut Vec<[u32; 2]>) -> usize {
        let components = self.components();
        let (mut vertices, mut normals) = (0, 0);
        for (start, end) in lines(raw, ENDS) {
            let line = &raw[start..end];
            let at = match Statement::parse(line) {
                Statement::Vertex => {
                    vertices += 1;
                    components * (vertices - 1)
                }
                Statement::Normal if self.beside => {
                    normals += 1;
                    components * (normals - 1) + 3
                }
                _ => continue,
            };
            let mut words = [[0; 2]; 3];
            self.words(line, &mut words);
            if spans.len() < components * vertices.max(normals) {
                spans.resize(components * vertices.max(normals), [0; 2]);
            }
            for (span, word) in spans[at..].iter_mut().zip(words) {
                *span = word.map(|at| (start + at) as u32);
            }
        }
        // There are as many normals as vertices, unless the file has changed.
        if self.beside && normals != vertices { usize::MAX } else { vertices }
    }

    fn cut(&self, bytes: &[u8], count: u64) -> Option<usize> {
        let (mut vertices, mut normals) = (0, if self.beside { 0 } else { count });
        if count == 0 {
            return Some(0);
        }
        for (start, end) in lines(bytes, ENDS) {
            match Statement::parse(&bytes[start..end]) {
                Statement::Vertex => vertices += 1,
                Statement::Normal if self.beside => normals += 1,
                _ => continue,
            }
            if vertices == count && normals == count {
                return Some(end);
            }
        }
        None
    }

    fn attribute<'l>(&self, line: &'l [u8], attribute: usize) -> Option<&'l [u8]> {
        let (start, end) = values(line).nth(self.skipped + attribute)?;
        Some(&line[start..end])
    }

    fn faces<'a>(
        model: &'a TextModel<Self>,
        ranges: Option<Vec<Range<u64>>>,
    ) -> Result<Box<dyn FaceReader + 'a>> {
        let all = model.grammar.face_lines.clone();
        if all.is_empty() {
            return Ok(Box::new(NoFaces));
        }
        Ok(Box::new(LineFaces::new(&model.source, ObjCorners::new(model), all, ranges)))
    }

    fn without_normals(&self) -> &'static str {
        "corners of OBJ refer to normals: keep them, or have them transformed"
    }
}

/// The corners of faces.
struct ObjCorners<'a> {
    model: &'a TextModel<Obj>,
    /// Vertices before the line that is read.
    vertices: u64,
}

impl<'a> ObjCorners<'a> {
    fn new(model: &'a TextModel<Obj>) -> Self {
        Self { model, vertices: 0 }
    }
}

impl FaceLines for ObjCorners<'_> {
    const ENDS: LineEnds = super::lines::ENDS;

    fn seek(&mut self, offset: u64) -> Result<()> {
        if !self.model.grammar.is_relative {
            return Ok(());
        }
        let TextModel { blocks, source, .. } = self.model;
        let (vertices, start) = blocks.of_byte(offset).unwrap_or_default();
        self.vertices = vertices;
        // From the end of the last vertex on, there is none.
        if start < blocks.end() {
            let mut lines = Lines::new(source, start, offset, ENDS);
            while let Some((_, line)) = lines.next()? {
                self.vertices += u64::from(Statement::parse(line) == Statement::Vertex);
            }
        }
        Ok(())
    }

    fn face(&mut self, line: &[u8]) -> Result<Option<usize>, String> {
        match Statement::parse(line) {
            Statement::Face => Ok(next_word(line, 0, true).map(|(_, end)| end)),
            Statement::Vertex => {
                self.vertices += 1;
                Ok(None)
            }
            _ => Ok(None),
        }
    }

    #[inline]
    fn corner(&mut self, line: &[u8], at: &mut usize) -> Result<Option<i64>, String> {
        loop {
            let Some((start, end)) = next_word(line, *at, true) else { return Ok(None) };
            *at = end;
            match line[start] {
                b'#' => {
                    *at = line.len();
                    return Ok(None);
                }
                b'\\' => continue,
                _ => {}
            }
            let word = &line[start..end];
            return match leading_integer(word) {
                Some((index, end)) if matches!(word.get(end), None | Some(b'/' | b'\\')) => {
                    Ok(Some(absolute(index, self.vertices)))
                }
                _ => Err(format!("{} is no corner of a face", quoted(&String::from_utf8_lossy(word)))),
            };
        }
    }
}
