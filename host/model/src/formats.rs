//! The formats that are known.

use std::path::Path;
use std::sync::Arc;

use crate::cache::Making;
use crate::pool::Pool;
use crate::source::SourceFile;
use crate::{Error, Model, Result, columns, e57, gltf, las, obj, off, pcd, ply, splats, stl};

/// Extensions of all formats, by which a file's name tells its format.
const EXTENSIONS: [&str; 12] = [
    "ply",
    "obj",
    "stl",
    "off",
    "pcd",
    "las",
    "laz",
    "e57",
    "glb",
    "gltf",
    "spz",
    splats::records::EXTENSION,
];

/// Extensions of formats whose files describe their layout, and their place on earth, in a header: opening
/// one takes no reading of the whole file, and no cache.
const WITH_HEADER: [&str; 4] = ["ply", "las", "laz", "e57"];

/// Whether a file of this name tells all that it says of itself as soon as it is opened.
pub fn tells_when_opened(path: &Path) -> bool {
    WITH_HEADER.contains(&extension(path).as_str())
}

/// Test whether a file with these first bytes is of a format, and the function that opens it.
type Opener = (fn(&[u8]) -> bool, fn(SourceFile, &Making<'_>) -> Result<Box<dyn Model>>);

/// The formats that a file's first bytes tell.
const BY_BEGINNING: [Opener; 7] = [
    (ply::is_ply, |source, _| splats::chunks::open_ply(source)),
    (las::is_las, |source, _| Ok(Box::new(las::LasModel::new(source)?))),
    (e57::is_e57, |source, _| e57::open(source)),
    (pcd::is_pcd, pcd::open),
    (off::is_off, |source, _| off::open(source)),
    (gltf::is_glb, gltf::open),
    (splats::spz::is_gzip, splats::spz::open),
];

/// Extensions that models usually have, in lower case.
pub fn extensions() -> impl Iterator<Item = &'static str> {
    EXTENSIONS.into_iter().chain(columns::EXTENSIONS)
}

/// Whether a path's extension is that of a known format, and of another one than the model's.
pub fn is_named_otherwise(model: &dyn Model, path: &Path) -> bool {
    let extension = extension(path);
    let is_known = extensions().any(|known| known == extension);
    let own = model.extensions();
    is_known && !own.is_empty() && !own.contains(&extension.as_str())
}

/// Note on a file name that promises more than is written.
pub fn note_on_name(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    name.ends_with(".copc.laz").then(|| {
        format!(
            "{}: what is written is LAZ without the octree that its name speaks of; `pdal translate OUT.laz OUT.copc.laz` \
             makes COPC of LAZ",
            path.display()
        )
    })
}

/// Whether a file is a model, as far as its first bytes tell.
///
/// # Errors
/// The file cannot be read.
pub fn is_model(path: &Path) -> Result<bool> {
    let source = SourceFile::open(path, None)?;
    let start = beginning(&source)?;
    Ok(BY_BEGINNING.iter().any(|(is, _)| is(&start))
        || stl::is_stl(&source)?
        || obj::is_obj(&source)?
        || gltf::is_gltf(&source)?
        || extension(path) == splats::records::EXTENSION
        || extension(path) == "off" && off::is_head(&source)
        || extension(path) == "pcd" && pcd::is_head(&source)
        || columns::is_columns(&source, &extension(path)))
}

/// The bytes by which formats are recognised that can be by such.
fn beginning(source: &SourceFile) -> Result<Vec<u8>> {
    let mut start = Vec::new();
    source.append_at(&mut start, 0, 64)?;
    Ok(start)
}

pub(crate) fn extension(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

/// Opens a model in one file, in the format that its content shows; where the content cannot tell, as of
/// plain text, the extension of the file's name does. For text in columns, these are what `columns` says. The
/// file of a pool is closed when others are read.
///
/// # Errors
/// The file cannot be read, its format is not known, or its content is not what the format says; columns are
/// given of another format; there is no room for what is made to read it from anywhere; the user cancelled.
pub(crate) fn open_file(
    path: &Path,
    pool: Option<&Arc<Pool>>,
    columns: Option<&str>,
    making: &Making<'_>,
) -> Result<Box<dyn Model>> {
    let source = SourceFile::open(path, pool)?;
    let start = beginning(&source)?;
    let found = BY_BEGINNING.iter().find(|(is, _)| is(&start));
    let extension = extension(path);
    match (found, columns) {
        (Some(_), Some(_)) => {
            let what = format!("{} is no text in columns, but columns are given", path.display());
            Err(Error::argument(what, "leave out the columns"))
        }
        (Some((_, open)), None) => open(source, making),
        (None, Some(_)) => columns::open(source, &extension, columns),
        (None, None) if extension == splats::records::EXTENSION => splats::records::open(source),
        // Comments may come first, and the word OFF may be left out.
        (None, None) if extension == "off" => off::open(source),
        (None, None) if extension == "pcd" => pcd::open(source, making),
        (None, None) if extension == "gltf" || gltf::is_gltf(&source)? => gltf::open(source, making),
        (None, None) if extension == "stl" || stl::is_stl(&source)? => stl::open(source),
        (None, None) if extension == "obj" || obj::is_obj(&source)? => obj::open(source, making),
        (None, None) if columns::EXTENSIONS.contains(&extension.as_str()) => {
            columns::open(source, &extension, None)
        }
        (None, None) => Err(unknown(&source, &start)),
    }
}

fn unknown(source: &SourceFile, start: &[u8]) -> Error {
    let start = &start[..start.len().min(16)];
    let what = format!("no model of a known format: it begins with \"{}\"", start.escape_ascii());
    let hint = "PLY, OBJ, STL, GLB, OFF, PCD, LAS, LAZ, E57, .splat, SPZ and text in columns can be read: export the model as one of them";
    source.malformed(what, hint)
}
