//! The stream from one format to another, as the pipeline of rewriting takes it.
//!
//! A model whose vertices can be read from anywhere is read by all threads, each its own piece, and the edit
//! is told of the pieces in turn; any other is read by one thread at a time, from its first vertex to its
//! last.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use glam::Mat3;

use crate::follow::Following;
use crate::form::{Form, WrittenRows};
use crate::pipeline::{Piece, PieceVersion, Pieces, Rewritable};
use crate::polygons::{PolygonJoin, Polygons};
use crate::progress::Emerging;
use crate::source::SourceFile;
use crate::{
    Edit, Edited, Error, FaceChunk, FaceReader, Model, Normals, Progress, RawChunk, Result, Rewriting,
    Summary, VertexChunk, VertexReader,
};

/// Vertices of a piece: as many as a compressed block of LAS usually has.
pub(crate) const PIECE: u64 = 50_000;

/// A call of [`Converted::rewrite`](super::Converted).
pub(super) struct ConversionCall<'a> {
    model: &'a dyn Model,
    source: &'a SourceFile,
    form: &'a dyn Form,
    how: Rewriting,
    edit: &'a dyn Edit,
    progress: &'a dyn Progress,
    /// Whether one reader reads all vertices in their order.
    in_order: bool,
    turns: Mutex<VertexTurns>,
    turned: Condvar,
}

/// Progress of the vertices in their order, for which pieces wait.
struct VertexTurns {
    /// The first vertex that the edit was not told of.
    next: u64,
    /// Number of vertices that the form has.
    done: u64,
    /// The piece that begins with this vertex failed, or none did: those behind it will never have their
    /// turn.
    failed: u64,
}

/// The count of vertices that have come once all have.
const BEHIND_ALL: u64 = u64::MAX;

impl<'a> ConversionCall<'a> {
    pub(super) fn new(
        model: &'a dyn Model,
        source: &'a SourceFile,
        form: &'a dyn Form,
        how: Rewriting,
        edit: &'a dyn Edit,
        progress: &'a dyn Progress,
    ) -> Self {
        let in_order = !model.info().reads_exactly();
        let turns = Mutex::new(VertexTurns { next: 0, done: 0, failed: BEHIND_ALL });
        let turned = Condvar::new();
        Self { model, source, form, how, edit, progress, in_order, turns, turned }
    }

    /// The edit, which is told of pieces in turn.
    pub(super) fn edit(&self) -> EditInTurn<'_, 'a> {
        EditInTurn(self)
    }

    /// Progress that advances by the bytes that were read.
    pub(super) fn quietly(&self) -> Quietly<'a> {
        Quietly(self.progress)
    }

    fn turns(&self) -> MutexGuard<'_, VertexTurns> {
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut VertexTurns)) {
        change(&mut self.turns());
        self.turned.notify_all();
    }

    /// Waits, for the piece that begins with a vertex, until a condition holds; an error if it never will, as
    /// a piece before it has failed, whose error is the one that is reported.
    fn wait(&self, piece: u64, until: impl Fn(&VertexTurns) -> bool) -> Result<()> {
        let mut turns = self.turns();
        while !until(&turns) {
            if turns.failed < piece {
                return Err(Error::cancelled());
            }
            turns = self.turned.wait(turns).unwrap_or_else(PoisonError::into_inner);
        }
        Ok(())
    }

    /// Does work for the piece that begins with a vertex; pieces that wait for its result learn if it fails.
    fn guarded<T>(&self, piece: u64, work: impl FnOnce() -> Result<T>) -> Result<T> {
        struct TurnGuard<'w, 'a> {
            of: &'w ConversionCall<'a>,
            piece: u64,
            is_done: bool,
        }
        impl Drop for TurnGuard<'_, '_> {
            fn drop(&mut self) {
                if !self.is_done {
                    self.of.change(|turns| turns.failed = turns.failed.min(self.piece));
                }
            }
        }
        let mut guard = TurnGuard { of: self, piece, is_done: false };
        let done = work();
        guard.is_done = done.is_ok();
        done
    }

    /// The attributes of vertices that the form asks for, and others that turn with them.
    fn attributes(&self, chunk: &VertexChunk, edited: &Edited) -> Result<Vec<Vec<f64>>> {
        if self.form.attributes() == 0 {
            return Ok(Vec::new());
        }
        let following = self.model.following().filter(|_| !edited.gradients.is_empty());
        let places = following.map_or(&[][..], Following::places);
        let needed = places.iter().map(|place| place + 1).max().unwrap_or(0);
        let mut attributes = vec![Vec::new(); self.form.attributes().max(needed)];
        self.model.attributes(chunk, &mut attributes)?;
        let Some(following) = following else { return Ok(attributes) };
        let mut numbers = Vec::new();
        for (i, gradient) in edited.gradients.iter().enumerate().filter(|(_, g)| **g != Mat3::IDENTITY) {
            numbers.clear();
            numbers.extend(places.iter().map(|place| attributes[*place][i]));
            following.turn(gradient, edited.mirrored, &mut numbers);
            places.iter().zip(&numbers).for_each(|(place, number)| attributes[*place][i] = *number);
        }
        Ok(attributes)
    }

    /// Reads the vertices of the piece that begins with the chunk's first one.
    fn read_piece(&self, chunk: &mut VertexChunk) -> Result<()> {
        let end = (chunk.first + PIECE).min(self.model.info().vertices);
        let mut reader = self.model.vertices(chunk.first..end)?;
        reader.set_chunk((end - chunk.first) as usize);
        let first = chunk.first;
        let mut is_there = reader.read(chunk)?;
        let mut more = VertexChunk::default();
        while is_there && chunk.first + (chunk.len() as u64) < end {
            is_there = reader.read(&mut more)?;
            chunk.append(&mut more);
        }
        if chunk.first == first && first + chunk.len() as u64 == end {
            return Ok(());
        }
        Err(self.ends_before(end - 1))
    }

    fn ends_before(&self, vertex: u64) -> Error {
        let hint = "it changed while it was read: wait until nothing writes to it any more, then try again";
        self.source.malformed(format_args!("it ends before vertex {vertex}"), hint)
    }
}

impl Rewritable for ConversionCall<'_> {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        let vertices = self.model.info().vertices;
        let reader = self.in_order.then(|| self.model.vertices(0..vertices)).transpose()?;
        Ok(Box::new(ConversionPieces {
            work: self,
            next: NextPiece::Head,
            number: 0,
            vertex: 0,
            reader,
            triangles: None,
            chunk: FaceChunk::default(),
            joining: PolygonJoin::new(vertices, self.form.holds_polygons()),
            faces: Polygons::default(),
        }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = self.model.following().is_some();
        if self.in_order {
            return Ok(());
        }
        self.guarded(chunk.first, || self.read_piece(chunk))
    }

    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()> {
        self.guarded(chunk.first, || {
            let PieceVersion { edited, normals, bytes, summary, .. } = version;
            let attributes = self.attributes(chunk, edited)?;
            // A vertex without a position stays without one.
            let mut positions = Vec::new();
            if chunk.positions.iter().any(|p| !p.is_finite()) {
                let kept = |(old, new): (&_, &_)| if glam::DVec3::is_finite(*old) { *new } else { *old };
                positions.extend(chunk.positions.iter().zip(&edited.positions).map(kept));
            }
            let rows = WrittenRows {
                first: chunk.first,
                positions: if positions.is_empty() { &edited.positions } else { &positions },
                normals: if normals == Normals::Transform { &edited.normals } else { &chunk.normals },
                attributes: &attributes[..self.form.attributes()],
                chunk,
                edited,
            };
            let moved = |i: usize| {
                let (was, is) = (chunk.positions[i], rows.positions[i]);
                was.is_finite() && !is.is_finite()
            };
            if let Some(i) = (0..chunk.len()).find(|i| moved(*i)) {
                return Err(rows.unfit(i, "where the deformation moves it"));
            }
            bytes.clear();
            self.form.vertices(&rows, bytes, summary)?;
            self.change(|turns| turns.done += chunk.len() as u64);
            Ok(())
        })
    }

    fn make(&self, before: &Summary, _is_still: bool) -> Result<Vec<u8>> {
        self.form.tail(before)
    }

    fn patches(&self, all: &Summary, _is_still: bool) -> Result<Vec<(u64, Vec<u8>)>> {
        self.form.patches(all)
    }

    fn source(&self) -> &SourceFile {
        self.source
    }
}

/// The piece that comes next.
enum NextPiece {
    Head,
    Vertices,
    Faces,
    Tail,
    End,
}

/// The pieces of a conversion.
struct ConversionPieces<'a> {
    work: &'a ConversionCall<'a>,
    next: NextPiece,
    /// Number of the next piece.
    number: u64,
    /// The first vertex that was not read.
    vertex: u64,
    reader: Option<Box<dyn VertexReader + 'a>>,
    triangles: Option<Box<dyn FaceReader + 'a>>,
    chunk: FaceChunk,
    joining: PolygonJoin,
    faces: Polygons,
}

impl Pieces for ConversionPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let piece = self.work.guarded(self.vertex, || self.read_next(chunk));
        self.number += 1;
        piece
    }
}

impl ConversionPieces<'_> {
    fn read_next(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let work = self.work;
        loop {
            match self.next {
                NextPiece::Head => {
                    chunk.raw = work.form.head()?;
                    self.next = NextPiece::Vertices;
                    return Ok(Piece::Bytes);
                }
                NextPiece::Vertices => {
                    if let Some(vertices) = self.read_vertices(chunk)? {
                        return Ok(Piece::Vertices(vertices));
                    }
                    self.reader = None;
                    self.next = if work.form.has_faces() { NextPiece::Faces } else { NextPiece::Tail };
                }
                NextPiece::Faces => {
                    if self.read_faces(chunk)? {
                        return Ok(Piece::Bytes);
                    }
                    self.next = NextPiece::Tail;
                }
                NextPiece::Tail => {
                    self.next = NextPiece::End;
                    chunk.raw.clear();
                    return Ok(Piece::Made);
                }
                NextPiece::End => {
                    work.source.check_unchanged()?;
                    return Ok(Piece::End);
                }
            }
        }
    }

    /// Reads the next vertices; where the thread that takes the piece reads them, returns only their number.
    fn read_vertices(&mut self, chunk: &mut VertexChunk) -> Result<Option<usize>> {
        let work = self.work;
        let left = work.model.info().vertices - self.vertex;
        if left == 0 {
            return Ok(None);
        }
        if let Some(reader) = &mut self.reader {
            reader.set_chunk(PIECE as usize);
            if !reader.read(chunk)? {
                return Err(work.ends_before(self.vertex));
            }
            work.progress.advance(chunk.raw.len() as u64);
            self.vertex += chunk.len() as u64;
            return Ok(Some(chunk.len()));
        }
        let count = left.min(PIECE);
        chunk.first = self.vertex;
        chunk.raw.clear();
        self.vertex += count;
        if self.number < work.how.pieces_done {
            // The edit wants to see the bytes of the piece, and no other code reads them.
            work.read_piece(chunk)?;
            work.progress.advance(chunk.raw.len() as u64);
            work.change(|turns| turns.next = chunk.first + count);
        }
        Ok(Some(count as usize))
    }

    /// The next faces as they are written; `false` at their end.
    fn read_faces(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let work = self.work;
        let vertices = work.model.info().vertices;
        let reader = match &mut self.triangles {
            Some(reader) => reader,
            None => {
                if work.form.needs_vertices() {
                    work.wait(BEHIND_ALL, |turns| turns.done == vertices)?;
                }
                self.triangles.insert(work.model.faces()?)
            }
        };
        self.faces.clear();
        while self.faces.len() == 0 {
            if !reader.read(&mut self.chunk)? {
                // Once more, and there is nothing left.
                self.joining.finish(&mut self.faces);
                break;
            }
            work.progress.check()?;
            work.progress.advance(self.chunk.bytes);
            self.joining.add(&self.chunk, &mut self.faces);
        }
        chunk.raw.clear();
        work.form.faces(&self.faces, &mut chunk.raw)?;
        Ok(self.faces.len() > 0)
    }
}

/// Tells the edit of pieces in their order, and lets it edit them in any.
pub(super) struct EditInTurn<'w, 'a>(&'w ConversionCall<'a>);

impl Edit for EditInTurn<'_, '_> {
    fn begin(&self, chunk: &RawChunk<'_>) -> Result<()> {
        if self.0.in_order || !chunk.is_edited { self.0.edit.begin(chunk) } else { Ok(()) }
    }

    fn edit(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        let Self(work) = self;
        work.guarded(chunk.first, || {
            if !work.in_order {
                work.wait(chunk.first, |turns| turns.next == chunk.first)?;
                let (first, vertices, bytes) = (chunk.first, chunk.len(), chunk.raw());
                work.edit.begin(&RawChunk { first, vertices, bytes, is_edited: true })?;
                work.progress.advance(bytes.len() as u64);
                work.change(|turns| turns.next = first + vertices as u64);
            }
            work.edit.edit(chunk, versions)
        })
    }

    fn end(&self, first: u64) -> Result<()> {
        self.0.edit.end(first)
    }

    fn is_still(&self, version: usize) -> bool {
        self.0.edit.is_still(version)
    }
}

/// Progress that advances elsewhere.
pub(super) struct Quietly<'a>(&'a dyn Progress);

impl Progress for Quietly<'_> {
    fn begin(&self, stage: &'static str, total_bytes: u64) {
        self.0.begin(stage, total_bytes);
    }

    fn advance(&self, _bytes: u64) {}

    fn is_cancelled(&self) -> bool {
        self.0.is_cancelled()
    }

    fn note(&self, text: &str) {
        self.0.note(text);
    }

    fn emerge(&self, samples: &Emerging<'_>) {
        self.0.emerge(samples);
    }
}
