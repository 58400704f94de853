//! Several versions of one model, read in step: the same vertices of all of them at once.

use glam::{DVec3, Vec3};

use super::{Model, SMALL_CHUNK, VertexChunk, VertexReader};
use crate::{Error, ErrorKind, Progress, Result};

/// The same consecutive vertices in one of the models.
#[derive(Debug, Clone, Copy)]
pub struct Vertices<'a> {
    /// Positions in the model's coordinates; some may not be finite.
    pub positions: &'a [DVec3],
    /// Normals as stored; none where the model has none.
    pub normals: &'a [Vec3],
    /// The chunk's attributes that were asked for, and which of its vertices is the first here.
    attributes: &'a [Vec<f64>],
    first: usize,
}

impl Vertices<'_> {
    /// A number of one of these vertices, by the attribute's place, of an attribute that was
    /// [asked for](in_step).
    #[inline]
    pub fn attribute(&self, place: usize, vertex: usize) -> f64 {
        self.attributes[place][self.first + vertex]
    }
}

/// A reader that is ahead of the others by a part of its chunk.
struct Cursor<'a> {
    model: &'a dyn Model,
    reader: Box<dyn VertexReader + 'a>,
    chunk: VertexChunk,
    attributes: Vec<Vec<f64>>,
    used: usize,
}

impl Cursor<'_> {
    /// Vertices that are there, after another chunk was read if there were none; 0 at the end.
    fn ready(&mut self) -> Result<usize> {
        if self.used == self.chunk.len() {
            self.used = 0;
            self.reader.read(&mut self.chunk)?;
            if !self.attributes.is_empty() {
                self.model.attributes(&self.chunk, &mut self.attributes)?;
            }
        }
        Ok(self.chunk.len() - self.used)
    }

    fn next(&self, count: usize) -> Vertices<'_> {
        let range = self.used..self.used + count;
        Vertices {
            positions: &self.chunk.positions[range.clone()],
            normals: self.chunk.normals.get(range).unwrap_or_default(),
            attributes: &self.attributes,
            first: self.used,
        }
    }
}

/// Streams the vertices of versions of a model through `visit`, the same ones of all of them at a time.
/// Begins no stage of the progress, and advances it by the bytes of the first model, of which so many of the first
/// [attributes](crate::ModelInfo::attributes) come with the vertices.
///
/// Memory: a small chunk for each model.
///
/// # Errors
/// The models differ in their number of vertices; one cannot be read; `visit` failed; the user cancelled.
pub fn in_step(
    models: &[&dyn Model],
    attributes: usize,
    progress: &dyn Progress,
    mut visit: impl FnMut(&[Vertices<'_>]) -> Result<()>,
) -> Result<()> {
    let Some(first) = models.first() else { return Ok(()) };
    let vertices = first.info().vertices;
    if let Some(other) = models.iter().find(|m| m.info().vertices != vertices) {
        return Err(Error::new(
            ErrorKind::Mismatch,
            format!(
                "{} has {} vertices, but {} has {vertices}",
                other.path().display(),
                other.info().vertices,
                first.path().display()
            ),
            "compare versions of the same model",
        ));
    }
    let mut cursors = Vec::with_capacity(models.len());
    for (i, model) in models.iter().enumerate() {
        let mut reader = model.vertices(0..vertices)?;
        reader.set_chunk(SMALL_CHUNK);
        let attributes = vec![Vec::new(); if i == 0 { attributes } else { 0 }];
        if attributes.is_empty() {
            reader.skip_attributes();
        }
        cursors.push(Cursor { model: *model, reader, chunk: VertexChunk::default(), attributes, used: 0 });
    }
    let per_vertex = first.info().vertex_bytes / vertices.max(1);
    loop {
        progress.check()?;
        // A file's chunks may end elsewhere, as its text is of another length.
        let mut count = usize::MAX;
        for cursor in &mut cursors {
            count = count.min(cursor.ready()?);
        }
        if count == 0 {
            return Ok(());
        }
        let parts: Vec<Vertices<'_>> = cursors.iter().map(|cursor| cursor.next(count)).collect();
        visit(&parts)?;
        cursors.iter_mut().for_each(|cursor| cursor.used += count);
        progress.advance(count as u64 * per_vertex);
    }
}
