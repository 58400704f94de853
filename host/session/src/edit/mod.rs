//! Editing: a document of steps with undo, and their evaluation on the samples of a model.

mod around;
mod clipboard;
mod document;
mod editor;
mod entry;
mod evaluation;
mod groups;
#[cfg(test)]
mod tests;

pub(crate) use clipboard::seen_from;
pub use clipboard::{copied, pasted};
pub use document::{Change, Document, EditCommand};
pub use editor::{Editor, forget, kept_at, recover, saved_at};
pub use entry::{Entry, StepId};
pub(crate) use evaluation::messages;
pub use evaluation::turning_gradients;
pub use evaluation::{Evaluated, Evaluation, Refinements, Status};
pub use groups::{free_name, group_at};
