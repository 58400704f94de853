//! The formats that are known.

use std::path::Path;

use crate::source::Source;
use crate::{Error, ErrorKind, Model, Result, columns, las, obj, off, pcd, ply, stl};

/// Extensions of all formats, by which names say what a file is.
const EXTENSIONS: [&str; 7] = ["ply", "obj", "stl", "off", "pcd", "las", "laz"];

/// Whether a path's extension says that a file is of a format, and of another one than a model.
pub fn is_named_otherwise(model: &dyn Model, path: &Path) -> bool {
    let extension = extension(path);
    let is_known =
        EXTENSIONS.contains(&extension.as_str()) || columns::EXTENSIONS.contains(&extension.as_str());
    let own = model.extensions();
    is_known && !own.is_empty() && !own.contains(&extension.as_str())
}

/// Whether a file is a model, as far as its first bytes tell.
///
/// # Errors
/// It cannot be read.
pub fn is_model(path: &Path) -> Result<bool> {
    let source = Source::open(path)?;
    let mut start = [0; 64];
    let read = source.read_at(&mut start, 0)?;
    let start = &start[..read];
    Ok(ply::is_ply(start)
        || las::is_las(start)
        || pcd::is_pcd(start)
        || off::is_off(start)
        || stl::is_stl(&source)?
        || obj::is_obj(&source)?
        || columns::is_columns(&source, &extension(path)))
}

fn extension(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

/// Opens a model, of whatever format its content is; where that cannot tell, as of plain text, the extension
/// of its name does.
///
/// # Errors
/// The file cannot be read, its format is not known, or its content is not what the format says.
pub fn open(path: &Path) -> Result<Box<dyn Model>> {
    open_with_columns(path, None)
}

/// The same; of text in columns, these are what `columns` says, as "x,y,z,_,nx,ny,nz": a name for each from
/// the first one on, those of position and normal among them.
///
/// # Errors
/// As of [`open`], or columns are given of another format.
pub fn open_with_columns(path: &Path, columns: Option<&str>) -> Result<Box<dyn Model>> {
    let source = Source::open(path)?;
    let mut start = [0; 16];
    let read = source.read_at(&mut start, 0)?;
    let is_pcd = pcd::is_pcd(&start[..read]);
    let is_other = [ply::is_ply, las::is_las, pcd::is_pcd, off::is_off].iter().any(|is| is(&start[..read]));
    if columns.is_some() && is_other {
        let what = format!("{} is no text in columns, but columns are given", path.display());
        return Err(Error::new(ErrorKind::Argument, what, "leave out the columns"));
    }
    if ply::is_ply(&start[..read]) {
        return Ok(Box::new(ply::PlyModel::new(source)?));
    }
    if las::is_las(&start[..read]) {
        return Ok(Box::new(las::LasModel::new(source)?));
    }
    if is_pcd {
        return pcd::open(source);
    }
    open_text(source, columns)?.map_err(|source| unknown(&source, &start[..read]))
}

/// Opens a file whose first bytes do not tell what it is; gives it back where nothing else does.
fn open_text(source: Source, columns: Option<&str>) -> Result<Result<Box<dyn Model>, Source>> {
    let extension = extension(source.path());
    if columns.is_some() {
        return columns::open(source, &extension, columns).map(Ok);
    }
    let mut start = [0; 64];
    let read = source.read_at(&mut start, 0)?;
    if off::is_off(&start[..read]) || extension == "off" {
        return off::open(source).map(Ok);
    }
    if extension == "stl" || stl::is_stl(&source)? {
        return stl::open(source).map(Ok);
    }
    if extension == "obj" || obj::is_obj(&source)? {
        return obj::open(source).map(Ok);
    }
    if columns::EXTENSIONS.contains(&extension.as_str()) {
        return columns::open(source, &extension, None).map(Ok);
    }
    Ok(Err(source))
}

fn unknown(source: &Source, start: &[u8]) -> Error {
    let what = format!("no model of a known format: it begins with \"{}\"", start.escape_ascii());
    let hint =
        "PLY, OBJ, STL, OFF, PCD, LAS, LAZ and text in columns can be read: export the model as one of them";
    source.malformed(what, hint)
}
