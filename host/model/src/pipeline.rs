//! Rewriting a file on as many threads as the pool has: each takes the next piece of the file, decodes, edits
//! and encodes it, and the thread that has the next piece of the file writes this piece and those that wait
//! behind it. Only taking a piece and writing one are serial.
//!
//! A thread does not take another piece while too many are between reading and writing, so that what waits
//! has a bound. Where something fails, no further piece is taken, and those before it are still written:
//! which error is returned does not depend on the threads.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use glam::Mat3;

use super::{
    Division, Edit, Edited, MAX_VERSIONS, Normals, Output, RawChunk, Rewriting, Summary, VertexChunk,
};
use crate::source::SourceFile;
use crate::{Error, Progress, Result};

/// Pieces that are between reading and writing, beside one for each thread: so that a thread whose piece has
/// to wait need not.
const WAITING: usize = 2;

/// The trait of a format's files that are rewritten.
pub(crate) trait Rewritable: Sync {
    /// Reader of the pieces of the whole file, once, from its beginning.
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>>;

    /// Fills the positions and normals of a chunk whose bytes were read.
    fn decode(&self, chunk: &mut VertexChunk) -> Result<()>;

    /// Makes the bytes of the file for a version of a chunk.
    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()>;

    /// Bytes of a [piece](Piece::Made) that follows from the new version of all pieces before it. `is_still`
    /// says that nothing changes in this version.
    fn make(&self, _before: &Summary, _is_still: bool) -> Result<Vec<u8>> {
        Ok(Vec::new())
    }

    /// See [`Model::division`](super::Model::division).
    fn division(&self, _normals: Normals) -> Option<Division> {
        None
    }

    /// Replacements in the new file once all pieces are there: places, and their bytes.
    fn patches(&self, _all: &Summary, _is_still: bool) -> Result<Vec<(u64, Vec<u8>)>> {
        Ok(Vec::new())
    }

    /// The file.
    fn source(&self) -> &SourceFile;
}

/// A version of a chunk on its way into bytes.
pub(crate) struct PieceVersion<'a> {
    pub(crate) edited: &'a Edited,
    pub(crate) normals: Normals,
    /// No further version is made of the chunk.
    pub(crate) is_last: bool,
    /// Bytes of the version, once they are made; whatever they were before.
    pub(crate) bytes: &'a mut Vec<u8>,
    /// Summary of the piece for other places of the file; empty before.
    pub(crate) summary: &'a mut Summary,
}

impl<'a> PieceVersion<'a> {
    /// Begins with the bytes `raw` of the chunk, to be patched. They are gone if this is the last version.
    pub(crate) fn begin_with(&mut self, raw: &mut Vec<u8>) -> &mut Vec<u8> {
        if self.is_last {
            std::mem::swap(raw, self.bytes);
        } else {
            self.bytes.clone_from(raw);
        }
        self.bytes
    }
}

/// The pieces of a file that is read.
pub(crate) trait Pieces: Send {
    /// Reads the bytes of the next piece into `chunk`, in the file's order.
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece>;

    /// Reads up to `most` pieces with vertices as one, or a single other piece; returns the number of pieces
    /// as well.
    fn read_several(&mut self, chunk: &mut VertexChunk, _most: u64) -> Result<(Piece, u64)> {
        Ok((self.read(chunk)?, 1))
    }

    /// Passes over so many pieces at the beginning of a file that can be [divided](Rewritable::division),
    /// without reading them.
    fn skip(&mut self, _pieces: u64) -> Result<Skipped> {
        Err(Error::internal("a file that cannot be divided was divided"))
    }
}

/// The pieces that were passed over.
pub(crate) struct Skipped {
    /// Byte of the file at which the pieces end.
    pub(crate) bytes: u64,
    /// Number of bytes of the pieces that are of vertices.
    pub(crate) vertex_bytes: u64,
}

/// Kind of a piece of a file.
pub(crate) enum Piece {
    /// So many vertices, which are not decoded.
    Vertices(usize),
    /// Normals of vertices whose positions stand elsewhere, which are not decoded.
    Normals,
    /// Bytes to be copied.
    Bytes,
    /// Bytes in whose place others are [made](Rewritable::make).
    Made,
    /// No piece: the file was read whole.
    End,
}

/// # Errors
/// There are too many versions; a part of the file is asked for, and it has none.
fn check(file: &dyn Rewritable, versions: usize, how: Rewriting) -> Result<()> {
    if versions > MAX_VERSIONS {
        return Err(Error::argument(
            format!("{versions} versions of a model at once"),
            format!("write at most {MAX_VERSIONS} in one reading"),
        ));
    }
    if how.only.is_some() && file.division(how.normals).is_none() {
        return Err(indivisible(file));
    }
    Ok(())
}

/// Streams `file` to `outputs` through `edit`: see [`Model::rewrite`](super::Model::rewrite).
pub(crate) fn rewrite(
    file: &dyn Rewritable,
    outputs: &mut [&mut dyn Output],
    how: Rewriting,
    edit: &dyn Edit,
    progress: &dyn Progress,
) -> Result<()> {
    let (versions, threads) = (outputs.len(), rayon::current_num_threads());
    check(file, versions, how)?;
    let mut pieces = file.pieces(how.normals)?;
    let first = how.only.map_or(0, |only| only.first);
    if first > 0 {
        let Skipped { bytes, vertex_bytes } = pieces.skip(first)?;
        edit.begin_behind(vertex_bytes);
        let begun = outputs.iter_mut().try_for_each(|output| output.begin_at(bytes));
        begun.map_err(|e| failed_write(file, e))?;
    }
    let work = RewriteCall {
        file,
        versions,
        how,
        edit,
        progress,
        most: threads as u64 * how.pieces_at_once.max(1) + WAITING as u64,
        most_spare: (threads + WAITING) * versions,
        reading: Mutex::new(PieceReading { pieces, next: first, is_over: false }),
        queue: Mutex::new(Queue {
            writing: Some(PieceWriting::new(outputs)),
            taken: first,
            written: first,
            ..Queue::default()
        }),
        moved: Condvar::new(),
    };
    // Threads of their own: one of the pool's that waits for a piece could be needed to finish that piece.
    thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(|| work.go_on())).collect();
        work.go_on();
        for other in others {
            other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    let Queue { writing, failed, .. } = work.queue.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, error)) = failed {
        return Err(error);
    }
    let Some(written) = writing else { return Ok(()) };
    complete(file, written, how, edit)
}

/// Completes the outputs, all pieces of which are written.
fn complete(
    file: &dyn Rewritable,
    written: PieceWriting<'_, '_>,
    how: Rewriting,
    edit: &dyn Edit,
) -> Result<()> {
    let PieceWriting { outputs, summaries } = written;
    if how.only.is_some_and(|only| only.end.is_some()) {
        file.source().check_unchanged()?;
        let finish = |output: &mut &mut dyn Output| output.finish().map_err(|e| failed_write(file, e));
        return outputs.iter_mut().try_for_each(finish);
    }
    for (version, (output, summary)) in outputs.iter_mut().zip(&summaries).enumerate() {
        let patches = file.patches(summary, edit.is_still(version))?;
        let patched = patches.iter().try_for_each(|(at, bytes)| output.patch(*at, bytes));
        patched.and_then(|()| output.finish()).map_err(|e| failed_write(file, e))?;
    }
    Ok(())
}

/// A call of [`rewrite`].
struct RewriteCall<'a, 'o> {
    file: &'a dyn Rewritable,
    versions: usize,
    how: Rewriting,
    edit: &'a dyn Edit,
    progress: &'a dyn Progress,
    /// Most pieces between reading and writing; another chunk is read while there are fewer.
    most: u64,
    /// Most buffers that are kept for chunks to come: no more than are in use at a time.
    most_spare: usize,
    reading: Mutex<PieceReading<'a>>,
    queue: Mutex<Queue<'a, 'o>>,
    /// A piece was written, or the work is over.
    moved: Condvar,
}

struct PieceReading<'a> {
    pieces: Box<dyn Pieces + 'a>,
    /// Number of the piece that is read next.
    next: u64,
    /// Nothing more can be read: the file is at its end, or something failed.
    is_over: bool,
}

/// Pieces that wait to be written, and the state that the threads share.
#[derive(Default)]
struct Queue<'a, 'o> {
    /// Writer to the outputs: taken away while a thread writes.
    writing: Option<PieceWriting<'a, 'o>>,
    /// The pieces that are ready, by their numbers.
    ready: BTreeMap<u64, Ready>,
    /// Number of pieces that were taken, and (`written`) of those that are written.
    taken: u64,
    written: u64,
    /// Nothing more is to be read.
    is_over: bool,
    /// The first piece that failed.
    failed: Option<(u64, Error)>,
    /// Buffers of pieces that are written.
    spare: Vec<Vec<u8>>,
}

/// Outputs, and the summaries of the pieces that each has.
struct PieceWriting<'a, 'o> {
    outputs: &'a mut [&'o mut dyn Output],
    summaries: Vec<Summary>,
}

impl<'a, 'o> PieceWriting<'a, 'o> {
    fn new(outputs: &'a mut [&'o mut dyn Output]) -> Self {
        Self { summaries: outputs.iter().map(|output| output.summary()).collect(), outputs }
    }
}

/// A piece as it goes to the outputs.
#[derive(Default)]
struct Ready {
    /// Number of pieces that this one stands for.
    pieces: u64,
    /// First vertex of the piece, if its vertices were edited.
    edited: Option<u64>,
    /// Bytes of the file that the piece took.
    source_bytes: u64,
    /// The bytes for each output; one for all of them if there are no vertices, and none if they have it.
    versions: Vec<Vec<u8>>,
    /// The summary of each version of vertices.
    summaries: Vec<Summary>,
    /// The bytes are made when the piece is written.
    is_made: bool,
}

/// Buffers that a thread works with.
#[derive(Default)]
struct PieceWorkspace {
    chunk: VertexChunk,
    edited: Vec<Edited>,
}

impl<'a, 'o> RewriteCall<'a, 'o> {
    /// Takes pieces as long as there are any.
    fn go_on(&self) {
        let _guard = PanicGuard(self);
        let mut bench = PieceWorkspace::default();
        bench.edited.resize_with(self.versions, Edited::default);
        while self.may_take() {
            let (number, pieces, piece) = self.read(&mut bench.chunk);
            let done = piece.and_then(|piece| self.process(number, &piece, &mut bench));
            match done {
                Ok(Some(ready)) => self.hand_in(number, Ready { pieces, ..ready }),
                Ok(None) => self.end(None),
                Err(error) => self.end(Some((number, error))),
            }
        }
    }

    /// Waits until another piece may be read; `false` if there is none.
    fn may_take(&self) -> bool {
        let mut queue = self.queue();
        loop {
            if queue.is_over {
                return false;
            }
            if queue.taken - queue.written < self.most {
                queue.taken += 1;
                return true;
            }
            queue = self.moved.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Reads the next piece, or several as one: the number of the first, and how many they are.
    fn read(&self, chunk: &mut VertexChunk) -> (u64, u64, Result<Piece>) {
        if chunk.raw.is_empty() {
            chunk.raw = self.queue().spare.pop().unwrap_or_default();
        }
        let mut reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let number = reading.next;
        let end = self.how.only.and_then(|only| only.end);
        if reading.is_over || end == Some(number) {
            reading.is_over = true;
            return (number, 1, Ok(Piece::End));
        }
        // Pieces that are done already, and those of other parts, are not read together with others.
        let until = [Some(self.how.pieces_done).filter(|done| *done > number), end];
        let most = until.into_iter().flatten().map(|until| until - number).min().unwrap_or(u64::MAX);
        let most = self.how.pieces_at_once.clamp(1, most.max(1));
        let read = |()| reading.pieces.read_several(chunk, most);
        let (piece, pieces) = match self.progress.check().and_then(read) {
            Ok((piece, pieces)) => (Ok(piece), pieces),
            Err(error) => (Err(error), 1),
        };
        let piece = piece.and_then(|piece| {
            if let Piece::Vertices(vertices) = piece {
                let is_edited = number >= self.how.pieces_done;
                self.edit.begin(&RawChunk { first: chunk.first, vertices, bytes: &chunk.raw, is_edited })?;
            }
            Ok(piece)
        });
        reading.next += pieces;
        let goes_on = |piece: &Piece| !matches!(piece, Piece::End);
        reading.is_over = !piece.as_ref().is_ok_and(goes_on);
        drop(reading);
        // One was taken before it was known how many there are.
        self.queue().taken += pieces - 1;
        (number, pieces, piece)
    }

    /// Processes a piece; returns nothing at the end of the file.
    fn process(&self, number: u64, piece: &Piece, bench: &mut PieceWorkspace) -> Result<Option<Ready>> {
        let PieceWorkspace { chunk, edited } = bench;
        let mut ready = Ready { source_bytes: chunk.source_bytes(), ..Ready::default() };
        match piece {
            Piece::End => return Ok(None),
            _ if number < self.how.pieces_done => {}
            Piece::Bytes => ready.versions.push(std::mem::take(&mut chunk.raw)),
            Piece::Made => ready.is_made = true,
            Piece::Vertices(_) | Piece::Normals => {
                self.file.decode(chunk)?;
                // The bytes may have been read just now.
                ready.source_bytes = chunk.raw.len() as u64;
                edited.iter_mut().for_each(|version| version.reset(chunk, self.how.normals));
                if let Piece::Normals = piece {
                    self.edit.edit_normals(chunk, edited)?;
                } else {
                    self.edit.edit(chunk, edited)?;
                    ready.edited = Some(chunk.first);
                }
                edited.iter().try_for_each(|version| version.check(chunk, self.how.normals))?;
                self.edit_beside(chunk, edited)?;
                for (version, edited) in edited.iter().enumerate() {
                    let mut buffer = self.queue().spare.pop().unwrap_or_default();
                    let mut summary = Summary::default();
                    let version = PieceVersion {
                        edited,
                        normals: self.how.normals,
                        is_last: version + 1 == self.versions,
                        bytes: &mut buffer,
                        summary: &mut summary,
                    };
                    self.file.encode(chunk, version)?;
                    ready.versions.push(buffer);
                    ready.summaries.push(summary);
                }
            }
        }
        Ok(Some(ready))
    }

    /// Appends to the versions of a chunk the new positions and normals of the vertices
    /// [beside](VertexChunk::beside) it.
    fn edit_beside(&self, chunk: &VertexChunk, edited: &mut [Edited]) -> Result<()> {
        let (beside, mut first) = (&chunk.beside, 0);
        let (mut group, mut versions) =
            (VertexChunk { follows: chunk.follows, ..VertexChunk::default() }, Vec::new());
        versions.resize_with(edited.len(), Edited::default);
        for count in &beside.groups {
            let range = first..first + count;
            first = range.end;
            group.positions.clear();
            group.positions.extend_from_slice(&beside.positions[range.clone()]);
            group.normals.clear();
            group.normals.extend_from_slice(beside.normals.get(range).unwrap_or_default());
            versions.iter_mut().for_each(|version| version.reset(&group, self.how.normals));
            self.edit.edit_normals(&group, &mut versions)?;
            for (version, of_group) in edited.iter_mut().zip(&versions) {
                of_group.check(&group, self.how.normals)?;
                version.positions.extend_from_slice(&of_group.positions);
                version.normals.extend_from_slice(&of_group.normals);
                version.gradients.extend_from_slice(&of_group.gradients);
            }
        }
        Ok(())
    }

    /// Hands a piece in, and writes as many as are next, unless another thread does.
    fn hand_in(&self, number: u64, ready: Ready) {
        let mut queue = self.queue();
        queue.ready.insert(number, ready);
        let Some(mut writing) = queue.writing.take() else { return };
        loop {
            let next = queue.written;
            let Some(ready) = queue.ready.remove(&next).filter(|_| queue.is_wanted(next)) else { break };
            drop(queue);
            let written = self.write(&mut writing, &ready);
            if let Err(error) = written {
                self.end(Some((next, error)));
            }
            queue = self.queue();
            queue.written += ready.pieces;
            if queue.spare.len() < self.most_spare {
                queue.spare.extend(ready.versions);
            }
            self.moved.notify_all();
        }
        queue.writing = Some(writing);
    }

    fn write(&self, writing: &mut PieceWriting<'_, '_>, ready: &Ready) -> Result<()> {
        // Cancellation is checked here too: pieces that wait need not be written any more.
        self.progress.check()?;
        if let Some(first) = ready.edited {
            self.edit.end(first)?;
        }
        let PieceWriting { outputs, summaries } = writing;
        for (version, (output, before)) in outputs.iter_mut().zip(summaries).enumerate() {
            let made = || self.file.make(before, self.edit.is_still(version));
            let made = if ready.is_made { Some(made()?) } else { None };
            // Bytes that are copied are the same in all versions.
            let copied = ready.versions.get(version).or(ready.versions.first());
            let Some(bytes) = made.as_ref().or(copied) else { break };
            let none = Summary::default();
            let summary = ready.summaries.get(version).unwrap_or(&none);
            let written = output.write_pieces(ready.pieces, bytes, ready.source_bytes, summary);
            written.map_err(|e| failed_write(self.file, e))?;
            before.absorb(summary);
        }
        self.progress.advance(ready.source_bytes);
        Ok(())
    }

    /// Lets no thread take another piece: the file is at its end, or a piece failed.
    fn end(&self, failed: Option<(u64, Error)>) {
        let mut queue = self.queue();
        queue.is_over = true;
        if let Some((number, error)) = failed
            && queue.is_wanted(number)
        {
            queue.failed = Some((number, error));
        }
        self.moved.notify_all();
    }

    fn queue(&self) -> MutexGuard<'_, Queue<'a, 'o>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Queue<'_, '_> {
    /// Whether a piece comes before all pieces that failed.
    fn is_wanted(&self, number: u64) -> bool {
        self.failed.as_ref().is_none_or(|(first, _)| number < *first)
    }
}

/// Guard of a thread, which stops the other threads when its thread panics.
struct PanicGuard<'w, 'a, 'o>(&'w RewriteCall<'a, 'o>);

impl Drop for PanicGuard<'_, '_, '_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.end(None);
        }
    }
}

/// A part was asked for of a file that has none.
fn indivisible(file: &dyn Rewritable) -> Error {
    Error::argument(
        format!("{} cannot be rewritten in parts by itself", file.source().path().display()),
        "rewrite all of it at once",
    )
}

fn failed_write(file: &dyn Rewritable, error: io::Error) -> Error {
    match error.downcast::<Error>() {
        // Our own writers know best what went wrong.
        Ok(error) => error,
        Err(error) => file.source().write_error(&error),
    }
}

impl Edited {
    /// Makes the version equal to the chunk.
    fn reset(&mut self, chunk: &VertexChunk, normals: Normals) {
        self.positions.clear();
        self.positions.extend_from_slice(&chunk.positions);
        self.normals.clear();
        if normals == Normals::Transform {
            self.normals.extend_from_slice(&chunk.normals);
        }
        self.gradients.clear();
        self.gradients.resize(Self::gradients_of(chunk, normals), Mat3::IDENTITY);
        self.mirrored = false;
    }

    /// Number of gradients that the edit has to fill in.
    fn gradients_of(chunk: &VertexChunk, normals: Normals) -> usize {
        if chunk.follows {
            chunk.len()
        } else if normals == Normals::Transform {
            chunk.tangents.len()
        } else {
            0
        }
    }

    /// Error where the version does not have as many vertices as the chunk.
    fn check(&self, chunk: &VertexChunk, normals: Normals) -> Result<()> {
        let expected = |count: usize| if normals == Normals::Transform { count } else { 0 };
        let directions = (expected(chunk.normals.len()), Self::gradients_of(chunk, normals));
        if self.positions.len() == chunk.len() && (self.normals.len(), self.gradients.len()) == directions {
            return Ok(());
        }
        let (vertices, first, edited) = (chunk.len(), chunk.first, self.positions.len());
        Err(Error::mismatch(
            format!("the {vertices} vertices from {first} on came back as {edited}"),
            "this is a bug in the deformation: it has to keep the number of vertices",
        ))
    }
}
