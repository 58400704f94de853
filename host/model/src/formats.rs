//! The formats that are known.

use std::path::Path;

use crate::source::Source;
use crate::{Error, Model, Result, obj, ply, stl};

/// Opens a model, of whatever format its content is; where that cannot tell, as of plain text, the extension
/// of its name does.
///
/// # Errors
/// The file cannot be read, its format is not known, or its content is not what the format says.
pub fn open(path: &Path) -> Result<Box<dyn Model>> {
    let source = Source::open(path)?;
    let mut start = [0; 16];
    let read = source.read_at(&mut start, 0)?;
    if ply::is_ply(&start[..read]) {
        return Ok(Box::new(ply::PlyModel::new(source)?));
    }
    open_text(source)?.map_err(|source| unknown(&source, &start[..read]))
}

/// Opens a file whose first bytes do not tell what it is; gives it back where nothing else does.
fn open_text(source: Source) -> Result<Result<Box<dyn Model>, Source>> {
    let extension = source.path().extension().and_then(|e| e.to_str()).unwrap_or_default();
    let extension = extension.to_ascii_lowercase();
    if extension == "stl" || stl::is_stl(&source)? {
        return stl::open(source).map(Ok);
    }
    if extension == "obj" || obj::is_obj(&source)? {
        return obj::open(source).map(Ok);
    }
    Ok(Err(source))
}

fn unknown(source: &Source, start: &[u8]) -> Error {
    let what = format!("no model of a known format: it begins with \"{}\"", start.escape_ascii());
    source.malformed(what, "PLY, OBJ and STL files can be read: export the model as one of them")
}
