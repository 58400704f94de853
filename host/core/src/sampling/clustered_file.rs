//! Trees of some cells in a file, which clustering a range of the stream, or a group of cells, leaves for the
//! cut.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use simod_model::{Error, Result, input};

use super::cluster::Moments;
use super::vs_tree::VsTree;
use crate::fingerprint::HashedPart;
use crate::sealed::{seal, unsealed};

/// First letters of a file of trees.
const LETTERS: &[u8; 8] = b"simodtre";

const VERSION: u32 = 2;

/// Most bytes of a file of trees: that of 10⁹ clusters.
const LONGEST: u64 = 64 << 30;

/// Content of a file of trees.
///
/// Memory: 40 bytes for each of about 1.4 nodes per cluster, 250 for each cell, and the ranges of cells; as
/// much again for the file.
#[derive(Serialize, Deserialize)]
pub struct ClusteredFile {
    /// The hash of the model, the options and the division, and of which range or group the file is.
    pub key: u128,
    /// Whether groups found room; if not, there are no cells.
    pub has_room: bool,
    /// Clusters below this bound were dropped.
    pub bound: f32,
    /// The cells in which the range begins and ends.
    pub ends: Option<[u32; 2]>,
    /// Number of times that the stream came into another cell.
    pub jumps: u64,
    /// Contribution of the range to the hash of all vertices.
    pub hashed: Option<HashedPart>,
    pub cells: Vec<CellOfFile>,
    /// Hash of the content, once it was read: files that belong to these trees are keyed by it.
    #[serde(skip)]
    pub mark: u128,
}

/// A cell with its tree.
#[derive(Serialize, Deserialize)]
pub struct CellOfFile {
    /// The cell's place in the grid's list.
    pub cell: u32,
    /// Number of elements that the tree was built of: vertices, or groups of them.
    pub items: u32,
    /// Ranges of the stream with the cell's vertices.
    pub ranges: Vec<Range<u64>>,
    pub moments: Moments,
    pub tree: VsTree,
}

impl ClusteredFile {
    /// Content that says that groups found no room.
    pub fn without_room(key: u128) -> Self {
        Self {
            key,
            has_room: false,
            bound: f32::INFINITY,
            ends: None,
            jumps: 0,
            hashed: None,
            cells: Vec::new(),
            mark: 0,
        }
    }

    /// Reads a file of this key.
    ///
    /// # Errors
    /// The file cannot be read, is damaged, or is of something else.
    pub fn read(path: &Path, key: u128) -> Result<Self> {
        let bytes = input::read(path, LONGEST)?;
        let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
        let mut file: Self = unsealed(&bytes, (LETTERS, VERSION), damaged)?;
        if file.key != key {
            return Err(refused(path, "has clusters of another model, or for other samples"));
        }
        if !file.cells.iter().all(|cell| cell.tree.is_sound()) {
            return Err(damaged("a tree is malformed"));
        }
        file.mark = mark_of(&bytes);
        Ok(file)
    }

    /// Bytes that are written to a file.
    ///
    /// # Errors
    /// Never, for what clustering makes.
    pub fn sealed(&self) -> Result<Vec<u8>> {
        seal(LETTERS, VERSION, self).map_err(|e| Error::internal("trees cannot be held in a file").because(e))
    }
}

/// Hash at the end of sealed content.
pub fn mark_of(sealed: &[u8]) -> u128 {
    sealed.last_chunk().map_or(0, |mark| u128::from_le_bytes(*mark))
}

/// Error about a file, with advice.
pub fn refused(path: &Path, what: &str) -> Error {
    Error::mismatch(format!("{} {what}", path.display()), "remove it, and do the unit again that writes it")
}
