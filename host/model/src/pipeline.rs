//! Rewriting a file in three threads: one reads, the caller's edits, one writes.
//!
//! Four pieces of the file go round from thread to thread, each with a place for every version: no more are
//! ever held, and none is allocated anew. A thread that fails or is told to stop drops its ends of the
//! channels, which stops the others at their next piece; since a channel holds all the pieces there are, none
//! of them ever waits to send.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use super::{Edited, MAX_VERSIONS, Normals, Output, Rewriting, VertexChunk};
use crate::{Error, ErrorKind, Progress, Result};

/// Pieces in flight.
const PIECES: usize = 4;

/// What a file format has to know about its files for them to be rewritten.
pub(crate) trait Rewritable: Sync {
    /// Reads the whole file, once, in pieces: takes an empty one, fills its chunk and gives it on, in the
    /// file's order. A chunk without vertices is bytes to be copied. When there is none to be taken, the work
    /// is over.
    fn read_pieces(&self, belt: &Belt, normals: Normals) -> Result<()>;

    /// The bytes of the file for a version of a chunk; `buffer` is an empty one, to be used if needed. The
    /// chunk's own bytes may be spoilt if `last` says that no further version is made of them.
    fn encode<'b>(
        &self,
        chunk: &'b mut VertexChunk,
        edited: &Edited,
        normals: Normals,
        last: bool,
        buffer: &'b mut Vec<u8>,
    ) -> Result<&'b [u8]>;

    /// What to say if the output cannot be written.
    fn write_error(&self, error: &io::Error) -> Error;
}

/// A part of the file on its way.
#[derive(Default)]
pub(crate) struct Piece {
    /// As it is in the file.
    pub(crate) chunk: VertexChunk,
    /// What becomes of it, version by version: at most [`MAX_VERSIONS`].
    versions: Vec<Edited>,
    /// The outputs have it already.
    is_done: bool,
}

/// The reading thread's end of the conveyor.
pub(crate) struct Belt {
    empty: Receiver<Piece>,
    full: SyncSender<Piece>,
}

impl Belt {
    /// A piece to be filled, with the buffers of an earlier one; `None` once the other threads have stopped.
    pub(crate) fn take(&self) -> Option<Piece> {
        self.empty.recv().ok()
    }

    /// Hands a filled piece on.
    pub(crate) fn give(&self, piece: Piece) {
        // If nobody takes it any more, the next `take` tells.
        let _ = self.full.send(piece);
    }
}

/// Streams `file` to `outputs` through `edit`: see [`Model::rewrite`](super::Model::rewrite).
pub(crate) fn rewrite(
    file: &impl Rewritable,
    outputs: &mut [&mut dyn Output],
    how: Rewriting,
    edit: &mut (dyn FnMut(&VertexChunk, &mut [Edited]) -> Result<()> + Send),
    progress: &dyn Progress,
) -> Result<()> {
    let versions = outputs.len();
    if versions > MAX_VERSIONS {
        return Err(Error::new(
            ErrorKind::Argument,
            format!("{versions} versions of a model at once"),
            format!("write at most {MAX_VERSIONS} in one reading"),
        ));
    }
    let (recycle, empty) = sync_channel(PIECES);
    let (full, to_edit) = sync_channel(PIECES);
    let (edited, to_write) = sync_channel(PIECES);
    for _ in 0..PIECES {
        // The channel holds them all.
        let _ = recycle.send(Piece::default());
    }
    thread::scope(|scope| {
        // Everything is moved to the thread that uses it, so that it is dropped when the thread ends, also by
        // a panic.
        let belt = Belt { empty, full };
        let reading = scope.spawn(move || file.read_pieces(&belt, how.normals));
        let writing =
            scope.spawn(move || write_pieces(file, outputs, how.normals, progress, &to_write, &recycle));
        let editing = edit_pieces(versions, how, edit, progress, to_edit, edited);
        let written = writing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        let read = reading.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        // Whoever stops because another did so returns no error of its own.
        editing.and(read).and(written)
    })
}

fn edit_pieces(
    versions: usize,
    how: Rewriting,
    edit: &mut (dyn FnMut(&VertexChunk, &mut [Edited]) -> Result<()> + Send),
    progress: &dyn Progress,
    to_edit: Receiver<Piece>,
    edited: SyncSender<Piece>,
) -> Result<()> {
    for (number, mut piece) in (0..).zip(to_edit) {
        progress.check()?;
        piece.is_done = number < how.pieces_done;
        if piece.is_done {
            piece.versions.clear();
        } else {
            piece.versions.resize_with(versions, Edited::default);
        }
        if !piece.chunk.is_empty() {
            for version in &mut piece.versions {
                version.reset(&piece.chunk, how.normals);
            }
            edit(&piece.chunk, &mut piece.versions)?;
            for version in &piece.versions {
                version.check(&piece.chunk, how.normals)?;
            }
        }
        if edited.send(piece).is_err() {
            break;
        }
    }
    Ok(())
}

impl Edited {
    /// Makes it what the chunk is.
    fn reset(&mut self, chunk: &VertexChunk, normals: Normals) {
        self.positions.clear();
        self.positions.extend_from_slice(&chunk.positions);
        self.normals.clear();
        if normals == Normals::Transform {
            self.normals.extend_from_slice(&chunk.normals);
        }
    }

    /// An error where it does not have as many vertices as the chunk.
    fn check(&self, chunk: &VertexChunk, normals: Normals) -> Result<()> {
        let expected_normals = if normals == Normals::Transform { chunk.normals.len() } else { 0 };
        if (self.positions.len(), self.normals.len()) == (chunk.len(), expected_normals) {
            return Ok(());
        }
        let (vertices, first, edited) = (chunk.len(), chunk.first, self.positions.len());
        Err(Error::new(
            ErrorKind::Mismatch,
            format!("the {vertices} vertices from {first} on came back as {edited}"),
            "this is a bug in the deformation: it has to keep the number of vertices",
        ))
    }
}

fn write_pieces(
    file: &impl Rewritable,
    outputs: &mut [&mut dyn Output],
    normals: Normals,
    progress: &dyn Progress,
    to_write: &Receiver<Piece>,
    recycle: &SyncSender<Piece>,
) -> Result<()> {
    let failed = |error: io::Error| match error.downcast::<Error>() {
        // Our own writers know best what went wrong.
        Ok(error) => error,
        Err(error) => file.write_error(&error),
    };
    // A version of one chunk.
    let mut buffer = Vec::new();
    for mut piece in to_write {
        // Here too: what is in flight need not be written any more.
        progress.check()?;
        let source_bytes = piece.chunk.raw.len() as u64;
        let count = if piece.is_done { 0 } else { outputs.len() };
        for (version, output) in outputs.iter_mut().enumerate().take(count) {
            let bytes = if piece.chunk.is_empty() {
                &piece.chunk.raw
            } else {
                buffer.clear();
                let last = version + 1 == count;
                file.encode(&mut piece.chunk, &piece.versions[version], normals, last, &mut buffer)?
            };
            output.write_piece(bytes, source_bytes).map_err(failed)?;
        }
        progress.advance(source_bytes);
        // The reader may have had all it needs.
        let _ = recycle.send(piece);
    }
    outputs.iter_mut().try_for_each(|output| output.finish()).map_err(failed)
}
