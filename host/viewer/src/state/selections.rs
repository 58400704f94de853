//! Former selections, for undo and redo.

use crate::selection::Selection;
use std::collections::VecDeque;

/// Most selections that are kept ...
const LONGEST: usize = 200;
/// ... and most numbers of all of them, of four bytes each.
const MOST: usize = 4 << 20;

/// Former selection, and the number of changes of the steps that had been done when it was left.
pub(super) struct Left {
    pub depth: u64,
    pub runs: Vec<u32>,
}

/// Former selections.
///
/// Memory: [`MOST`] numbers, of a selection as it is recorded, forwards and backwards.
#[derive(Default)]
pub(super) struct Selections {
    pub done: VecDeque<Left>,
    pub undone: Vec<Left>,
    /// Whether a selection was left for the present one, with which others may go on; nothing if the last
    /// command made none such.
    pub going_on: Option<bool>,
}

impl Selections {
    /// Keeps a selection that was left.
    pub fn leave(&mut self, depth: u64, before: &Selection) {
        self.undone.clear();
        self.done.push_back(Left { depth, runs: before.runs() });
        while self.done.len() > LONGEST || self.done.iter().map(|left| left.runs.len()).sum::<usize>() > MOST
        {
            self.done.pop_front();
        }
    }

    /// Whether a selection was left after so many changes of the steps, and none was done since.
    pub fn is_last(&self, depth: u64) -> bool {
        self.done.back().is_some_and(|left| left.depth == depth)
    }

    /// Whether a selection was undone after so many changes of the steps, and none was done since.
    pub fn is_next(&self, depth: u64) -> bool {
        self.undone.last().is_some_and(|left| left.depth == depth)
    }
}
