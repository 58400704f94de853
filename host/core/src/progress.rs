//! How long work tells where it is, and learns that it shall stop.

use crate::{Error, Result};

/// The other end of a long operation: a progress bar, a window, or nobody.
///
/// Called from any thread, and often: implementations keep it cheap.
pub trait Progress: Sync {
    /// A new stage begins: a few words for the user, and its size in bytes (0 where it is not known).
    fn begin(&self, stage: &'static str, total_bytes: u64);

    /// So many more bytes of the stage are done.
    fn advance(&self, bytes: u64);

    /// Whether the user asked to stop. Work looks at it at least every 100 ms.
    fn is_cancelled(&self) -> bool;

    /// Something that the user should know, though the work goes on: one line.
    fn note(&self, _text: &str) {}

    /// An error of kind [`Cancelled`](crate::ErrorKind::Cancelled) once the user asked to stop.
    fn check(&self) -> Result<()> {
        if self.is_cancelled() { Err(Error::cancelled()) } else { Ok(()) }
    }
}

/// Progress that nobody watches.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, _bytes: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}
