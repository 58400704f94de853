//! Editing: a document of steps with undo, and their evaluation on the samples of a model.

mod document;
mod evaluation;
#[cfg(test)]
mod tests;

pub use document::{Change, Command, Document, Entry, StepId};
pub use evaluation::{Evaluated, Evaluation, Status};
