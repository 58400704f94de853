//! Models as users name them: a file, or the tiles that a model is made of, as a pattern or a list.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glob::MatchOptions;

use crate::cache::{Cache, Making};
use crate::formats::open_file;
use crate::input::may_be_there;
use crate::progress::Silent;
use crate::tiles::{TiledModel, names, written_names};
use crate::{Error, Model, Progress, Result};

/// Name of a model: a file, or several tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModelName {
    /// Path of one file, which need not be there.
    File(PathBuf),
    /// Files that are one model together, in the order of their vertices.
    Tiles(Vec<PathBuf>),
}

impl ModelName {
    /// Returns the model that a path names: the files that it matches, if it is a [pattern](matching).
    ///
    /// # Errors
    /// As of [`matching`].
    pub fn from_path(path: &Path) -> Result<Self> {
        Ok(match matching(path)? {
            Some(files) => Self::Tiles(files),
            None => Self::File(path.to_owned()),
        })
    }

    /// Returns the model that a list of paths names: a single path, that of a file or a pattern; several
    /// paths, tiles.
    ///
    /// # Errors
    /// As of [`matching`], or there is none.
    pub fn of_all<P: AsRef<Path>>(paths: &[P]) -> Result<Self> {
        if let [path] = paths {
            return Self::from_path(path.as_ref());
        }
        let mut files = Vec::new();
        for path in paths {
            match Self::from_path(path.as_ref())? {
                Self::File(file) => files.push(file),
                Self::Tiles(more) => files.extend(more),
            }
        }
        if files.is_empty() {
            return Err(Error::argument("the list of tiles is empty", "name the files in it"));
        }
        Ok(Self::Tiles(files))
    }

    /// The files.
    pub fn files(&self) -> &[PathBuf] {
        match self {
            Self::File(file) => std::slice::from_ref(file),
            Self::Tiles(files) => files,
        }
    }

    /// Names of the tiles' files in a folder of all of them; none if the model is a single file.
    pub fn tiles(&self) -> Vec<PathBuf> {
        match self {
            Self::File(_) => Vec::new(),
            Self::Tiles(files) => names(files),
        }
    }

    /// Names of the tiles in a folder that all of them are written to; none if the model is a single file.
    pub fn written_tiles(&self) -> Vec<PathBuf> {
        match self {
            Self::File(_) => Vec::new(),
            Self::Tiles(files) => written_names(files),
        }
    }

    /// Opens the model: see [`open_with`].
    ///
    /// # Errors
    /// As of [`open_with`].
    pub fn open(
        &self,
        columns: Option<&str>,
        cache: &Arc<Cache>,
        progress: &dyn Progress,
    ) -> Result<Box<dyn Model>> {
        let making = &Making { cache, progress };
        match self {
            Self::File(path) => open_file(path, None, columns, making),
            Self::Tiles(files) => Ok(Box::new(TiledModel::open(files, columns, making)?)),
        }
    }
}

/// Opens a model, in the format that its content shows; where the content cannot tell, as of plain text, the
/// extension of its name does. For a pattern, as `tiles/*.laz`, all files that match it are one model.
///
/// # Errors
/// The file cannot be read, its format is not known, or its content is not what the format says; a pattern
/// matches none.
pub fn open(path: &Path) -> Result<Box<dyn Model>> {
    open_with_columns(path, None)
}

/// Opens a model as [`open`] does; the columns of a text are what `columns` says, as "x,y,z,_,nx,ny,nz": a
/// name for each from the first one on, those of position and normal among them.
///
/// # Errors
/// As of [`open`], or columns are given of another format.
pub fn open_with_columns(path: &Path, columns: Option<&str>) -> Result<Box<dyn Model>> {
    open_with(path, columns, &Arc::default(), &Silent)
}

/// Opens a model as [`open_with_columns`] does; content that has to be made to read the model from anywhere
/// goes to a cache, whose size `progress` gets first.
///
/// # Errors
/// As of [`open_with_columns`], there is no room for what is made, or the user cancelled.
pub fn open_with(
    path: &Path,
    columns: Option<&str>,
    cache: &Arc<Cache>,
    progress: &dyn Progress,
) -> Result<Box<dyn Model>> {
    ModelName::from_path(path)?.open(columns, cache, progress)
}

/// Opens a version that was written of a model of the same format, at a path: a file, or a folder with its
/// tiles.
///
/// # Errors
/// As of [`open_with_columns`].
pub fn open_version(of: &dyn Model, path: &Path, columns: Option<&str>) -> Result<Box<dyn Model>> {
    if of.tiles().is_empty() {
        return open_with_columns(path, columns);
    }
    let tiles = of.tiles().iter().map(|tile| path.join(&tile.name)).collect();
    ModelName::Tiles(tiles).open(columns, &Arc::default(), &Silent)
}

/// The files that a pattern matches, as a shell has it, in the order of people; `None` where a path has no
/// wildcard (`*`, `?`, `[`), or is the name of something that is there, or of an object.
///
/// # Errors
/// The pattern is none, or matches no file; a folder cannot be read.
pub fn matching(path: &Path) -> Result<Option<Vec<PathBuf>>> {
    let is_pattern = |text: &&str| text.contains(['*', '?', '[']) && !may_be_there(path);
    let Some(pattern) = path.to_str().filter(is_pattern) else { return Ok(None) };
    let refused = |what: String| {
        let hint = "give a pattern as 'frame-*.ply', in quotes, or the names of files";
        Error::argument(what, hint)
    };
    let options = MatchOptions {
        case_sensitive: true,
        require_literal_separator: true,
        require_literal_leading_dot: true,
    };
    let found = glob::glob_with(pattern, options)
        .map_err(|e| refused(format!("{pattern} is no pattern: {}", e.msg)))?;
    let mut paths = Vec::new();
    for path in found {
        let path = path.map_err(|e| Error::io("look for files in", e.path(), e.error()))?;
        if path.is_file() {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(refused(format!("{pattern} matches no file")));
    }
    paths.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(Some(paths))
}

/// The order of people: numbers in names count as numbers, so that frame-2 comes before frame-10.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (Some(x), Some(y)) = (left.chars().next(), right.chars().next()) else {
            // One of them is at its end. What differs in zeros alone is told apart by them.
            return left.len().cmp(&right.len()).then_with(|| a.cmp(b));
        };
        let order = if x.is_ascii_digit() && y.is_ascii_digit() {
            let (x, y);
            ((x, left), (y, right)) = (number(left), number(right));
            x.len().cmp(&y.len()).then_with(|| x.cmp(y))
        } else {
            (left, right) = (&left[x.len_utf8()..], &right[y.len_utf8()..]);
            x.cmp(&y)
        };
        if order.is_ne() {
            return order;
        }
    }
}

/// The number that a text begins with, without leading zeros, and the rest.
fn number(text: &str) -> (&str, &str) {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    (digits.trim_start_matches('0'), rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_count_as_numbers() {
        let sorted =
            ["a", "a-1", "a-02", "a-2", "a-2b", "a-10", "a-010-1", "b-1", "b-99999999999999999999999", "é"];
        for (i, a) in sorted.iter().enumerate() {
            for (j, b) in sorted.iter().enumerate() {
                assert_eq!(natural_order(a, b), i.cmp(&j), "{a} {b}");
            }
        }
    }
}
