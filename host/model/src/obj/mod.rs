//! OBJ, as a stream of lines: the numbers of `v` and `vn` lines change, and every other byte is kept,
//! whatever the statement.
//!
//! Normals are of corners here. Where a file has as many as vertices, and every corner uses the normal that
//! has the number of its vertex, they are those of the vertices: either each beside its vertex, or apart from
//! them. Other normals are not read; when the model is written, each becomes the mean of its turned versions
//! at all places that use it, if these agree, and keeps its bytes otherwise, which is noted.
//!
//! | module | |
//! |---|---|
//! | `grammar` | what vertices and faces are in its lines |
//! | `model` | the model |
//! | `scan` | the one pass over the file when it is opened |
//! | `lines` | statements, their words, and corners |
//! | `apart` | normals that do not stand beside their vertices |
//! | `shared` | normals of corners |

mod apart;
mod grammar;
mod lines;
mod model;
mod scan;
mod shared;

use crate::cache::Making;
use crate::source::SourceFile;
use crate::text::model::{TextModel, info};
use crate::{Attribute, Model, ModelInfo, Result, Type};
use apart::{ApartModel, Sharing};
use grammar::Obj;
pub(crate) use lines::is_obj;
use lines::values;
use scan::{NormalsAre, ObjScan};

/// Opens a file, which is gone over once.
pub(crate) fn open(source: SourceFile, making: &Making<'_>) -> Result<Box<dyn Model>> {
    let ObjScan { vertices, normals, faces, face_lines, corners, is_relative, first_vertex, others } =
        ObjScan::from_source(&source)?;
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
        others,
    };
    let model = TextModel::new(source, grammar, vertices, info)?;
    Ok(match normals {
        NormalsAre::None | NormalsAre::Beside => Box::new(ApartModel::without(model, 0)),
        NormalsAre::Scattered(count) => Box::new(ApartModel::without(model, count)),
        NormalsAre::Shared(blocks) => {
            let sharing = Sharing { corners, cache: making.cache.clone() };
            Box::new(ApartModel::new(model, blocks, Some(sharing))?)
        }
        NormalsAre::Apart(blocks) => Box::new(ApartModel::new(model, blocks, None)?),
    })
}

/// Names of the numbers behind a vertex' position, by their count.
fn colours(first_vertex: &[u8]) -> &'static [&'static str] {
    match values(first_vertex).count() {
        4 => &["w"],
        6 | 7 => &["red", "green", "blue"],
        _ => &[],
    }
}
