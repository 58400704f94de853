//! The formats that are known.

use std::path::Path;

use crate::source::Source;
use crate::{Model, Result, las, ply};

/// Opens a model, of whatever format its content is (its name does not matter).
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
    if las::is_las(&start[..read]) {
        return Ok(Box::new(las::LasModel::new(source)?));
    }
    let what = format!("no model of a known format: it begins with \"{}\"", start[..read].escape_ascii());
    let hint = "PLY files can be read, which begin with \"ply\", and LAS and LAZ, which begin with \"LASF\": export \
                the model as one of these";
    Err(source.malformed(what, hint))
}
