//! OBJ, as a stream of lines: the numbers of `v` and `vn` lines change, and every other byte is kept, whatever
//! the statement.
//!
//! Normals are of corners here. Where a file has as many as vertices, and every corner uses the normal that
//! has the number of its vertex, they are those of the vertices: either each beside its vertex, or apart from
//! them. Other normals are not read; when the model is written, each becomes the mean of what it becomes where
//! it is used, if that agrees, and keeps its bytes otherwise, which is said.
//!
//! | module | |
//! |---|---|
//! | here | the model |
//! | `scan` | the one pass over the file when it is opened |
//! | `lines` | statements, their words, and corners |
//! | `apart` | normals that do not stand beside their vertices |
//! | `shared` | normals of corners |

mod apart;
mod lines;
mod scan;
mod shared;

use std::ops::Range;

use crate::source::Source;
use crate::text::faces::LineFaces;
use crate::text::lines::lines as lines_of;
use crate::text::model::{Grammar, NoFaces, TextModel, info};
use crate::text::next_word;
use crate::{Attribute, FaceReader, Model, ModelInfo, Result, Type};
use apart::ApartModel;
pub(crate) use lines::is_obj;
use lines::{Corners, Statement, values};
use scan::{NormalsAre, Scan};

/// Opens a file, which is gone over once.
pub(crate) fn open(source: Source) -> Result<Box<dyn Model>> {
    let Scan { vertices, normals, faces, face_lines, is_relative, first_vertex } = Scan::of(&source)?;
    let colours = colours(&first_vertex);
    let attributes = |name: &&str| Attribute { name: (*name).into(), kind: Type::F64 };
    let info = ModelInfo {
        faces,
        face_bytes: face_lines.end - face_lines.start,
        other_properties: colours.iter().map(|name| format!("double {name}")).collect(),
        attributes: colours.iter().map(attributes).collect(),
        ..info(&source, "OBJ".into())
    };
    let beside = matches!(normals, NormalsAre::Beside);
    let grammar = Obj {
        beside,
        skipped: if colours.len() == 1 { 3 } else { values(&first_vertex).count() - colours.len() },
        face_lines,
        is_relative,
    };
    let model = TextModel::new(source, grammar, vertices, info)?;
    Ok(match normals {
        NormalsAre::None | NormalsAre::Beside => Box::new(ApartModel::without(model, 0)),
        NormalsAre::Scattered(count) => Box::new(ApartModel::without(model, count)),
        NormalsAre::Shared(blocks) => Box::new(ApartModel::new(model, blocks, true)?),
        NormalsAre::Apart(blocks) => Box::new(ApartModel::new(model, blocks, false)?),
    })
}

/// What the numbers behind a vertex' position mean.
fn colours(first_vertex: &[u8]) -> &'static [&'static str] {
    match values(first_vertex).count() {
        4 => &["w"],
        6 | 7 => &["red", "green", "blue"],
        _ => &[],
    }
}

/// The statements of OBJ.
#[derive(Debug)]
pub(crate) struct Obj {
    /// Each vertex has its normal in a line of its own, before the next vertex.
    beside: bool,
    /// Numbers of a vertex before its attributes.
    skipped: usize,
    /// Where the first face begins and the last one ends.
    face_lines: Range<u64>,
    /// Some corners are counted backwards from where they stand.
    is_relative: bool,
}

impl Grammar for Obj {
    const EXTENSIONS: &[&str] = &["obj"];
    const CONTINUES: bool = true;

    fn components(&self) -> usize {
        if self.beside { 6 } else { 3 }
    }

    fn is_vertex(&self, line: &[u8]) -> bool {
        Statement::of(line) == Statement::Vertex
    }

    fn words(&self, line: &[u8], spans: &mut [[usize; 2]]) {
        for (span, (start, end)) in spans.iter_mut().take(3).zip(values(line)) {
            *span = [start, end];
        }
    }

    fn find(&self, raw: &[u8], spans: &mut Vec<[u32; 2]>) -> usize {
        let components = self.components();
        let (mut vertices, mut normals) = (0, 0);
        for (start, end) in lines_of(raw, Self::CONTINUES) {
            let line = &raw[start..end];
            let at = match Statement::of(line) {
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
        // As many as there should be, unless the file has changed.
        if self.beside && normals != vertices { usize::MAX } else { vertices }
    }

    fn cut(&self, bytes: &[u8], count: u64) -> Option<usize> {
        let (mut vertices, mut normals) = (0, if self.beside { 0 } else { count });
        if count == 0 {
            return Some(0);
        }
        for (start, end) in lines_of(bytes, Self::CONTINUES) {
            match Statement::of(&bytes[start..end]) {
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
        Ok(Box::new(LineFaces::new(&model.source, Corners::new(model), all, ranges)))
    }

    fn without_normals(&self) -> &'static str {
        "corners of OBJ refer to normals: keep them, or have them transformed"
    }
}

/// The first word of a line.
fn keyword(line: &[u8]) -> Option<&[u8]> {
    next_word(line, 0, true).map(|(start, end)| &line[start..end])
}
