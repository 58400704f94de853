//! Memory that is used again from block to block of vertices.

use std::sync::{Mutex, PoisonError};

use glam::Vec3;

use super::blend::Grouped;

/// Memory that is used again from block to block.
///
/// About 100 bytes per vertex of a block, at most 400 if all homes have four, and 4 per sample.
#[derive(Debug, Default)]
pub struct Workspace {
    /// Local positions.
    pub local: Vec<Vec3>,
    /// The vertices in the order in which they are gone through, and what it is found by.
    pub order: Vec<u32>,
    pub keys: Vec<u64>,
    pub homes: Vec<u32>,
    /// For each sample, the group of which it is the home, if that group is of this block.
    pub group_of: Vec<u32>,
    /// How far each group is filled.
    pub filled: Vec<Filled>,
    /// Where each vertex is among the grouped ones, if its home moves.
    pub place: Vec<u32>,
    pub grouped: Grouped,
}

/// Workspaces that are not in use: as many as there were ever blocks at a time.
#[derive(Debug, Default)]
pub struct Workspaces(Mutex<Vec<Workspace>>);

impl Workspaces {
    /// Lends one to `work`.
    pub fn with<R>(&self, work: impl FnOnce(&mut Workspace) -> R) -> R {
        let free = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut workspace = free().pop().unwrap_or_default();
        let result = work(&mut workspace);
        free().push(workspace);
        result
    }
}

/// How far a group is filled: where its next vertex goes, and where the next one of those that are scattered.
#[derive(Debug, Clone, Copy)]
pub struct Filled {
    /// At first, the number of its vertices.
    pub next: usize,
    pub scattered: usize,
}
