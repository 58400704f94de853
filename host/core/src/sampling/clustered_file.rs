//! The trees of some cells in a file: what a range of the stream, or a group of cells, leaves for the cut.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use simod_model::{Error, Result, input};

use super::cluster::Moments;
use super::vs_tree::VsTree;
use crate::fingerprint::HashedPart;
use crate::sealed::{seal, unsealed};

/// What such a file begins with.
const LETTERS: &[u8; 8] = b"simodtre";

const VERSION: u32 = 2;

/// No file is longer: of 10⁹ clusters.
const LONGEST: u64 = 64 << 30;

/// What a file holds.
///
/// Memory: 40 bytes for each of about 1.4 nodes per cluster, 250 for each cell, and the ranges of cells; as
/// much again for the file.
#[derive(Serialize, Deserialize)]
pub struct ClusteredFile {
    /// The hash of the model, the options and the division, and of which range or group the file is.
    pub key: u128,
    /// Whether groups found room; the cells are none if not.
    pub has_room: bool,
    /// Clusters below this bound were dropped.
    pub bound: f32,
    /// The cells in which the range begins and ends.
    pub ends: Option<[u32; 2]>,
    /// How often the stream came into another cell.
    pub jumps: u64,
    /// What the range adds to the hash of all vertices.
    pub hashed: Option<HashedPart>,
    pub cells: Vec<CellOfFile>,
    /// The hash of all this, once it was read: what belongs to these trees goes by it.
    #[serde(skip)]
    pub mark: u128,
}

/// A cell with its tree.
#[derive(Serialize, Deserialize)]
pub struct CellOfFile {
    /// The cell's place in the grid's list.
    pub cell: u32,
    /// What the tree was built of: vertices, or groups of them.
    pub items: u32,
    /// Where in the stream its vertices are.
    pub ranges: Vec<Range<u64>>,
    pub moments: Moments,
    pub tree: VsTree,
}

impl ClusteredFile {
    /// One that says that groups found no room.
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

    /// What is written.
    ///
    /// # Errors
    /// Never, for what clustering makes.
    pub fn sealed(&self) -> Result<Vec<u8>> {
        seal(LETTERS, VERSION, self).map_err(|e| Error::internal("trees cannot be held in a file").because(e))
    }
}

/// The hash at the end of what is sealed.
pub fn mark_of(sealed: &[u8]) -> u128 {
    sealed.last_chunk().map_or(0, |mark| u128::from_le_bytes(*mark))
}

/// An error about a file, and what to do.
pub fn refused(path: &Path, what: &str) -> Error {
    Error::mismatch(format!("{} {what}", path.display()), "remove it, and do the unit again that writes it")
}
