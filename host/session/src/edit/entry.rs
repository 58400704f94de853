//! A step of a document, and the number by which it is known.

use crate::step::Step;
use std::sync::Arc;

/// The identity of a step: the same after others were added, moved or removed, and after undo.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StepId(u64);

impl StepId {
    /// The id of a number, which a document gives but once.
    pub(super) fn new(number: u64) -> Self {
        Self(number)
    }
}

/// A step of a [`Document`](super::Document).
#[derive(Debug, Clone)]
pub struct Entry {
    /// The step's identity.
    pub id: StepId,
    /// The step itself.
    pub step: Arc<Step>,
}
