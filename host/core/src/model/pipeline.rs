//! Rewriting a file in three threads: one reads, the caller's edits, one writes.
//!
//! Four pieces of the file go round from thread to thread: no more are ever held, and none is allocated anew. A
//! thread that fails or is told to stop drops its ends of the channels, which stops the others at their next
//! piece; since a channel holds all the pieces there are, none of them ever waits to send.

use std::io::{self, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use super::VertexChunk;
use crate::{Error, ErrorKind, Progress, Result};

/// Pieces in flight.
const PIECES: usize = 4;

/// What a file format has to know about its files for them to be rewritten.
pub(crate) trait Rewritable: Sync {
    /// Reads the whole file, once, in pieces: takes an empty one, fills it and gives it on, in the file's order.
    /// A chunk without vertices is bytes to be copied. When there is none to be taken, the work is over.
    fn read_pieces(&self, belt: &Belt) -> Result<()>;

    /// The bytes of the file for a chunk that was edited; `text` is an empty buffer, to be used if needed.
    fn encode<'b>(&self, chunk: &'b mut VertexChunk, text: &'b mut Vec<u8>) -> Result<&'b [u8]>;

    /// What to say if the output cannot be written.
    fn write_error(&self, error: &io::Error) -> Error;
}

/// The reading thread's end of the conveyor.
pub(crate) struct Belt {
    empty: Receiver<VertexChunk>,
    full: SyncSender<VertexChunk>,
}

impl Belt {
    /// A chunk to be filled, with the buffers of an earlier one; `None` once the other threads have stopped.
    pub(crate) fn take(&self) -> Option<VertexChunk> {
        self.empty.recv().ok()
    }

    /// Hands a filled chunk on.
    pub(crate) fn give(&self, chunk: VertexChunk) {
        // If nobody takes it any more, the next `take` tells.
        let _ = self.full.send(chunk);
    }
}

/// Streams `file` to `out` through `edit`: see [`Model::rewrite`](super::Model::rewrite).
pub(crate) fn rewrite(
    file: &impl Rewritable,
    out: &mut (dyn Write + Send),
    edit: &mut (dyn FnMut(&mut VertexChunk) -> Result<()> + Send),
    progress: &dyn Progress,
) -> Result<()> {
    let (recycle, empty) = sync_channel(PIECES);
    let (full, to_edit) = sync_channel(PIECES);
    let (edited, to_write) = sync_channel(PIECES);
    for _ in 0..PIECES {
        // The channel holds them all.
        let _ = recycle.send(VertexChunk::default());
    }
    thread::scope(|scope| {
        // Everything is moved to the thread that uses it, so that it is dropped when the thread ends, also by a
        // panic.
        let belt = Belt { empty, full };
        let reading = scope.spawn(move || file.read_pieces(&belt));
        let writing = scope.spawn(move || write_pieces(file, out, progress, &to_write, &recycle));
        let editing = edit_pieces(edit, progress, to_edit, edited);
        let written = writing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        let read = reading.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        // Whoever stops because another did so returns no error of its own.
        editing.and(read).and(written)
    })
}

fn edit_pieces(
    edit: &mut (dyn FnMut(&mut VertexChunk) -> Result<()> + Send),
    progress: &dyn Progress,
    to_edit: Receiver<VertexChunk>,
    edited: SyncSender<VertexChunk>,
) -> Result<()> {
    for mut chunk in to_edit {
        progress.check()?;
        if !chunk.is_empty() {
            let lengths = |c: &VertexChunk| [c.positions.len(), c.normals.len(), c.raw.len(), c.spans.len()];
            let before = lengths(&chunk);
            edit(&mut chunk)?;
            if lengths(&chunk) != before {
                return Err(Error::new(
                    ErrorKind::Mismatch,
                    format!(
                        "the {} vertices from {} on came back as {}",
                        before[0],
                        chunk.first,
                        chunk.len()
                    ),
                    "this is a bug in the deformation: it has to keep the number of vertices",
                ));
            }
        }
        if edited.send(chunk).is_err() {
            break;
        }
    }
    Ok(())
}

fn write_pieces(
    file: &impl Rewritable,
    out: &mut (dyn Write + Send),
    progress: &dyn Progress,
    to_write: &Receiver<VertexChunk>,
    recycle: &SyncSender<VertexChunk>,
) -> Result<()> {
    let failed = |error: io::Error| match error.downcast::<Error>() {
        // Our own writers know best what went wrong.
        Ok(error) => error,
        Err(error) => file.write_error(&error),
    };
    let mut text = Vec::new();
    for mut chunk in to_write {
        // Here too: what is in flight need not be written any more.
        progress.check()?;
        let source_bytes = chunk.raw.len() as u64;
        let bytes = if chunk.is_empty() {
            &chunk.raw
        } else {
            text.clear();
            file.encode(&mut chunk, &mut text)?
        };
        out.write_all(bytes).map_err(failed)?;
        progress.advance(source_bytes);
        // The reader may have had all it needs.
        let _ = recycle.send(chunk);
    }
    out.flush().map_err(failed)
}
