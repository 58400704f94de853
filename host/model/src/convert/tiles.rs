//! The tiles of a model written in another format, each by itself, to a folder.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Converted, WRITTEN};
use crate::cache::{Cache, Making};
use crate::form::{Conversion, Rounding};
use crate::formats::open_file;
use crate::output_folder::OutputFolder;
use crate::resumable_folder::check_target;
use crate::target::folder_of;
use crate::{Error, ModelName, Progress, Result};

/// Tiles that were written in another format.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ConvertedTiles {
    /// The number of vertices of all tiles.
    pub vertices: u64,
    /// Triangles, where the format has any.
    pub triangles: u64,
    /// Size of all files.
    pub bytes: u64,
    /// Losses of the new files, in a few words each, every one once.
    pub losses: Vec<String>,
    /// Rounding of the tile where it is most of the diagonal, if positions lose digits by it in any tile.
    pub rounding: Option<Rounding>,
}

/// Names of the tiles in their folder, in another format.
///
/// # Errors
/// A name cannot be written; two tiles would have one name.
pub fn converted_names(tiles: &ModelName, extension: &str) -> Result<Vec<PathBuf>> {
    if !WRITTEN.contains(&extension) {
        return Err(Error::argument(
            format!("{extension} is no format that can be written anew"),
            format!("give one of {}", WRITTEN.join(", ")),
        ));
    }
    let names: Vec<PathBuf> = tiles.tiles().iter().map(|name| name.with_extension(extension)).collect();
    let mut seen = BTreeSet::new();
    match names.iter().find(|name| !seen.insert(*name)) {
        Some(name) => Err(Error::argument(
            format!("two tiles would become {}", name.display()),
            "give them different names, or convert them to different folders",
        )),
        None => Ok(names),
    }
}

/// Writes each tile, opened as text of `columns` if any are given, in the format of an extension to a file in
/// the folder `output`, which appears whole or not at all. A former folder is replaced if it holds nothing
/// but files of these names.
///
/// Memory: as of one [`Converted`], and the names.
///
/// # Errors
/// As of [`Converted::new`] and [`Converted::write`]; two tiles would have one name; the folder holds
/// something else.
pub fn convert_tiles(
    tiles: &ModelName,
    extension: &str,
    (columns, how): (Option<&str>, Conversion),
    output: &Path,
    progress: &dyn Progress,
) -> Result<ConvertedTiles> {
    let names = converted_names(tiles, extension)?;
    check_target(output, &names)?;
    let folder = OutputFolder::create(output)?;
    let size = |file: &PathBuf| fs::metadata(file).map_or(0, |is| is.len());
    let bytes = tiles.files().iter().map(size).sum();
    progress.begin("converting the tiles", bytes);
    let mut done = ConvertedTiles::default();
    for (tile, name) in tiles.files().iter().zip(&names) {
        let path = folder.path().join(name);
        let convert = || -> Result<Converted> {
            let within = folder_of(&path);
            fs::create_dir_all(within).map_err(|e| Error::io("make the folder", within, &e))?;
            let cache = Arc::new(Cache::nameless(within));
            let within_tile = WithinTile(progress);
            let model = open_file(tile, None, columns, &Making { cache: &cache, progress: &within_tile })?;
            let converted = Converted::new(model, &path, how, &within_tile)?;
            converted.write(&path, &within_tile)?;
            Ok(converted)
        };
        let converted = convert().map_err(|e| folder.named(e))?;
        done.vertices += converted.vertices();
        done.triangles += converted.triangles();
        done.bytes += size(&path);
        // Told of the coarsest alone.
        let rounded = converted.rounding().map(|rounding| rounding.to_string());
        for loss in converted.losses().iter().filter(|loss| Some(*loss) != rounded.as_ref()) {
            if !done.losses.contains(loss) {
                done.losses.push(loss.clone());
            }
        }
        let fraction = |rounding: &Option<Rounding>| rounding.and_then(|rounding| rounding.fraction());
        if done.rounding.is_none() || fraction(&converted.rounding()) > fraction(&done.rounding) {
            done.rounding = converted.rounding().or(done.rounding);
        }
        progress.advance(size(tile));
    }
    done.losses.extend(done.rounding.map(|rounding| rounding.to_string()));
    progress.check()?;
    check_target(output, &names)?;
    folder.commit()?;
    Ok(done)
}

/// Progress of which a tile is a step: its own stages are not told.
struct WithinTile<'a>(&'a dyn Progress);

impl Progress for WithinTile<'_> {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}

    fn advance(&self, _bytes: u64) {}

    fn is_cancelled(&self) -> bool {
        self.0.is_cancelled()
    }

    fn note(&self, text: &str) {
        self.0.note(text);
    }
}
