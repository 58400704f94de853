//! Several versions of one model, read in step: the same vertices of all of them at once.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{Model, SMALL_CHUNK, VertexChunk, VertexReader};
use crate::{Error, Progress, Result};

/// Consecutive vertices of one of the models; those of the others are the same ones.
#[derive(Debug, Clone, Copy)]
pub struct Vertices<'a> {
    /// Positions in the model's coordinates; some may not be finite.
    pub positions: &'a [DVec3],
    /// Normals as stored; none where the model has none.
    pub normals: &'a [Vec3],
    /// Attributes of the chunk that were asked for, and (`first`) the index in the chunk of the first vertex
    /// here.
    attributes: &'a [Vec<f64>],
    first: usize,
}

impl Vertices<'_> {
    /// Number of one of these vertices: that of the attribute at a place, which was [asked for](in_step).
    #[inline]
    pub fn attribute(&self, place: usize, vertex: usize) -> f64 {
        self.attributes[place][self.first + vertex]
    }
}

/// A reader that is ahead of the others by a part of its chunk.
struct ChunkCursor<'a> {
    model: &'a dyn Model,
    reader: Box<dyn VertexReader + 'a>,
    chunk: VertexChunk,
    attributes: Vec<Vec<f64>>,
    used: usize,
}

impl ChunkCursor<'_> {
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

/// Streams the vertices of versions of a model through `visit`, the same vertices of all versions at a time.
/// Begins no stage of the progress, and advances it by the bytes of the first model, of which so many of the
/// first [attributes](crate::ModelInfo::attributes) come with the vertices.
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
    let vertices = checked_count(models)?;
    let how = (0..vertices, SMALL_CHUNK);
    chunks_in_step(models, how, attributes, progress, |_, parts| visit(parts))
}

/// Vertices of a range that one thread reads: enough that the files are read in large pieces.
const RANGE: u64 = 1 << 18;

/// Ranges for each thread that are worked on before their results are put together.
const RANGES_AHEAD: usize = 2;

/// Vertices of a chunk there: so few that those of several models stay near the processor from reading to
/// comparing, and that their memory is not asked of the system anew for each range.
const RANGE_CHUNK: usize = 1 << 12;

/// Streams versions as [`in_step`] does, by ranges of vertices on all threads where the models can be read
/// from anywhere: what `visit` finds in each range, beginning with the default, comes to `merge` in the order
/// of the ranges, which are the same for any number of threads. `visit` gets the first vertex' number, too.
///
/// Memory: for each thread a chunk of 4096 vertices of each model, and what is found of two ranges.
///
/// # Errors
/// As of [`in_step`].
pub fn in_ranges<T: Default + Send>(
    models: &[&dyn Model],
    attributes: usize,
    progress: &dyn Progress,
    visit: impl Fn(&mut T, u64, &[Vertices<'_>]) -> Result<()> + Sync,
    mut merge: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let vertices = checked_count(models)?;
    let of_range = |range: Range<u64>| {
        let mut found = T::default();
        let how = (range, RANGE_CHUNK);
        chunks_in_step(models, how, attributes, progress, |first, parts| visit(&mut found, first, parts))?;
        Ok(found)
    };
    if !models.iter().all(|model| model.info().random_access) {
        return merge(of_range(0..vertices)?);
    }
    let wave = RANGE * (RANGES_AHEAD * rayon::current_num_threads()) as u64;
    for from in (0..vertices).step_by(wave as usize) {
        let firsts: Vec<u64> = (from..vertices.min(from + wave)).step_by(RANGE as usize).collect();
        let found: Vec<Result<T>> = firsts
            .into_par_iter()
            .with_max_len(1)
            .map(|first| of_range(first..vertices.min(first + RANGE)))
            .collect();
        found.into_iter().try_for_each(|found| merge(found?))?;
    }
    Ok(())
}

/// Number of vertices, which all models have in common.
fn checked_count(models: &[&dyn Model]) -> Result<u64> {
    let Some(first) = models.first() else { return Ok(0) };
    let vertices = first.info().vertices;
    if let Some(other) = models.iter().find(|m| m.info().vertices != vertices) {
        return Err(Error::mismatch(
            format!(
                "{} has {} vertices, but {} has {vertices}",
                other.path().display(),
                other.info().vertices,
                first.path().display()
            ),
            "compare versions of the same model",
        ));
    }
    Ok(vertices)
}

/// Streams versions as [`in_step`] does, over the vertices of a range alone, each part with the number of its
/// first vertex.
///
/// # Errors
/// As of [`in_step`], but that the models' numbers of vertices are not compared.
pub fn range_in_step(
    models: &[&dyn Model],
    range: Range<u64>,
    attributes: usize,
    progress: &dyn Progress,
    visit: impl FnMut(u64, &[Vertices<'_>]) -> Result<()>,
) -> Result<()> {
    chunks_in_step(models, (range, SMALL_CHUNK), attributes, progress, visit)
}

/// Streams versions as [`range_in_step`] does, in chunks of so many vertices at most.
fn chunks_in_step(
    models: &[&dyn Model],
    (range, chunk): (Range<u64>, usize),
    attributes: usize,
    progress: &dyn Progress,
    mut visit: impl FnMut(u64, &[Vertices<'_>]) -> Result<()>,
) -> Result<()> {
    let Some(first) = models.first() else { return Ok(()) };
    let mut cursors = Vec::with_capacity(models.len());
    for (i, model) in models.iter().enumerate() {
        let mut reader = model.vertices(range.clone())?;
        reader.set_chunk(chunk);
        let attributes = vec![Vec::new(); if i == 0 { attributes } else { 0 }];
        if attributes.is_empty() {
            reader.skip_attributes();
        }
        cursors.push(ChunkCursor {
            model: *model,
            reader,
            chunk: VertexChunk::default(),
            attributes,
            used: 0,
        });
    }
    let per_vertex = first.info().vertex_bytes / first.info().vertices.max(1);
    let mut at = range.start;
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
        visit(at, &parts)?;
        at += count as u64;
        cursors.iter_mut().for_each(|cursor| cursor.used += count);
        progress.advance(count as u64 * per_vertex);
    }
}
