//! Memory that is used again from part to part of a block of vertices, and from block to block.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::blend::Grouped;

/// Memory that is used again from part to part, and from block to block.
///
/// About 100 bytes per vertex of a part, at most 400 if all homes have four, 16 per run of vertices that
/// have one home, and 4 per sample; 4 bytes per vertex of a block.
#[derive(Debug, Default)]
pub struct Workspace {
    /// The vertices of a block in the order in which they are gone through.
    pub block_order: Vec<u32>,
    /// The vertices of the part that is gone through now, in that order.
    pub order: Vec<u32>,
    /// Whether all vertices of the part have finite positions.
    pub is_finite: bool,
    /// Local coordinates, in this order, with room behind them …
    pub local: [Vec<f32>; 3],
    /// … and homes, likewise.
    pub homes: Vec<u32>,
    /// Vertices that follow each other in this order and have one home.
    pub runs: Vec<HomeRun>,
    /// For each sample, the group of which it is the home, if that group is of this part.
    pub group_of: Vec<u32>,
    /// Fill level of each group.
    pub filled: Vec<GroupFill>,
    pub grouped: Grouped,
}

/// Vertices of one home that follow each other.
#[derive(Debug, Clone, Copy)]
pub struct HomeRun {
    pub home: u32,
    /// The run's first place in the order, and the number of its vertices.
    pub first: u32,
    pub count: u32,
    /// First of the run's vertices among the grouped ones, where they stand side by side; [`NOWHERE`] if
    /// their home does not move.
    pub place: u32,
}

/// The place of vertices that do not move.
pub const NOWHERE: u32 = u32::MAX;

impl HomeRun {
    /// The places of the run's vertices in the order.
    pub fn range(&self) -> Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }

    /// Places of the run's vertices among the grouped ones, if they are grouped.
    pub fn places(&self) -> Range<usize> {
        self.place as usize..(self.place + self.count) as usize
    }

    /// The places of the run's vertices, if these are put side by side.
    pub fn grouped(&self) -> Option<Range<usize>> {
        (self.place != NOWHERE).then(|| self.places())
    }
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

/// Fill level of a group: the place of its next vertex, and that of the next one of those that are scattered.
#[derive(Debug, Clone, Copy)]
pub struct GroupFill {
    /// Place of the group's next vertex; at first, the number of its vertices.
    pub next: usize,
    pub scattered: usize,
}
