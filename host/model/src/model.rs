//! Models behind one streaming interface: vertices come in chunks, and go out as patched chunks; faces come
//! as triangles.
//!
//! A model is never held: readers keep one chunk of at most [`CHUNK_VERTICES`] vertices or
//! [`CHUNK_TRIANGLES`] triangles, and [`Model::rewrite`] one for each thread, with up to [`MAX_VERSIONS`] new
//! versions, and the bytes of a few more.

use std::any::Any;
use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::thread;

use glam::{DVec3, Mat3, Vec3, Vec4};

use crate::bounds::Bounds;
use crate::fan::Fan;
use crate::follow::{self, Follow, Following};
use crate::{Attribute, Error, Progress, Result, ScaledIntegers, Summary};

/// Most vertices in a chunk: the bound of every buffer of a reader or a writer.
pub const CHUNK_VERTICES: usize = 1 << 16;

/// Most vertices in a chunk where they are only read: several chunks are held then, and large ones gain
/// nothing.
pub const SMALL_CHUNK: usize = 1 << 14;

/// Most triangles in a chunk.
pub const CHUNK_TRIANGLES: usize = 1 << 16;

/// Most versions that one reading of a model writes: a bound of what is held beside each chunk.
pub const MAX_VERSIONS: usize = 4;

/// Type of the numbers of positions in the file, in which they are written back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// 32-bit IEEE float.
    F32,
    /// 64-bit IEEE float.
    F64,
}

impl Scalar {
    /// Bytes of a number in binary files.
    pub fn size(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number of this type that is nearest.
    #[inline]
    pub(crate) fn round(self, value: f64) -> f64 {
        match self {
            Self::F32 => f64::from(value as f32),
            Self::F64 => value,
        }
    }
}

/// A model's description, known once it is open, before any vertex is read.
#[derive(Debug, Clone)]
pub struct ModelInfo {
    /// The file format for people, as "PLY 1.0, binary little endian".
    pub format: String,
    /// Number of vertices that the file holds.
    pub vertices: u64,
    /// Number of faces (polygons, or strips), where the file has any.
    pub faces: u64,
    /// Whether each vertex has a normal.
    pub has_normals: bool,
    /// Type of the positions; one that holds them exactly, where they are [integers](Self::integers).
    pub position_type: Scalar,
    /// Vertex properties other than position and normal, in the file's order, as "uchar red".
    pub other_properties: Vec<String>,
    /// The properties of vertices that are numbers, as colours, in the file's order: no two have one name.
    pub attributes: Vec<Attribute>,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Whether reading can begin at any vertex without going over those before it.
    pub random_access: bool,
    /// Vertices that are read at least, wherever reading begins: those of a compressed block, or else one.
    pub block_vertices: u64,
    /// Bytes of the file that hold vertices (what one streaming pass reads). In a text file where other
    /// things follow the vertices, an estimate.
    pub vertex_bytes: u64,
    /// Bytes of the file that hold faces which have triangles. In a text file, an estimate.
    pub face_bytes: u64,
    /// Scale and offset of the integers as which positions are stored, where they are.
    pub integers: Option<ScaledIntegers>,
    /// Scale and offset of the integers in files that are written: with another offset, where one was
    /// [chosen](Model::make_room).
    pub written: Option<ScaledIntegers>,
    /// Step from one whole number that positions are written as to the next, along three directions at right
    /// angles: the coarsest, where there are several; zero where positions are floats.
    pub step: DVec3,
    /// Ranges of whole numbers that were [chosen](Model::make_room) for files that are written.
    pub ranges: Vec<[i64; 2]>,
    /// Coordinate reference system that the file names, as "EPSG:25832" or the name in its WKT.
    pub crs: Option<String>,
}

/// Info on a model without any vertices, each of which could be read without the others.
impl Default for ModelInfo {
    fn default() -> Self {
        Self {
            format: String::new(),
            vertices: 0,
            faces: 0,
            has_normals: false,
            position_type: Scalar::F64,
            other_properties: Vec::new(),
            attributes: Vec::new(),
            bytes: 0,
            random_access: true,
            block_vertices: 1,
            vertex_bytes: 0,
            face_bytes: 0,
            integers: None,
            written: None,
            step: DVec3::ZERO,
            ranges: Vec::new(),
            crs: None,
        }
    }
}

impl ModelInfo {
    /// Whether a range of vertices can be read without others: neither all before it, nor those of the same
    /// compressed block.
    pub fn reads_exactly(&self) -> bool {
        self.random_access && self.block_vertices == 1
    }

    /// Vertices of no interest between two others that are better read as well than passed over.
    pub fn near(&self) -> u64 {
        if self.random_access { self.block_vertices - 1 } else { u64::MAX }
    }

    /// Distance of a position that is written as whole numbers from its exact place, the root of the mean
    /// square, in model units; zero where positions are floats.
    pub fn rounding(&self) -> f64 {
        (self.step.length_squared() / 12.0).sqrt()
    }

    /// Position that is read back when `p` was written to such a file; one that does not fit stays as it is.
    pub fn rounded(&self, p: DVec3) -> DVec3 {
        match (&self.written, self.position_type) {
            (Some(integers), _) => integers.nearest(p).map_or(p, |i| integers.position(i)),
            (None, Scalar::F32) => p.as_vec3().as_dvec3(),
            (None, Scalar::F64) => p,
        }
    }
}

/// A run of consecutive vertices, in the file's order.
#[derive(Debug, Default)]
pub struct VertexChunk {
    /// Index in the model of the first vertex here.
    pub first: u64,
    /// Vertices of the model in files before theirs.
    pub(crate) before: u64,
    /// Positions in the model's coordinates. May be non-finite, where the file says so.
    pub positions: Vec<DVec3>,
    /// Normals as stored, so not always of unit length or finite; empty where the model has none.
    pub normals: Vec<Vec3>,
    /// Tangents as glTF has them: a direction along the surface, and the side of the bitangent, which is
    /// normal × direction times the last number (1 or -1). Only where a model is rewritten that has any.
    pub tangents: Vec<Vec4>,
    /// Other numbers of the vertices [turn with the surface](Model::following): only where the model is
    /// rewritten.
    pub(crate) follows: bool,
    /// The bytes of the file that these vertices were read from; in a compressed file those of whole blocks,
    /// each with the first chunk that was read of it.
    pub(crate) raw: Vec<u8>,
    /// The vertices' records, where `raw` is compressed.
    pub(crate) records: Vec<u8>,
    /// Number of vertices and of bytes of each compressed block in `raw`.
    pub(crate) blocks: Vec<CompressedBlock>,
    /// Range of bytes in `raw` of each vertex' numbers; its exact meaning is up to the format.
    pub(crate) spans: Vec<[u32; 2]>,
    /// Pages that are patched, where `raw` is only the vertices' bytes of them.
    pub(crate) pages: Vec<u8>,
    /// Vertices of other chunks that have some of their numbers in these bytes.
    pub(crate) beside: StraddlingVertices,
    /// Data of the format's own that belong to the bytes, for each part that was read by itself.
    pub(crate) of_format: Vec<Box<dyn Any + Send + Sync>>,
    /// The bytes are those of the vertices' normals, which stand elsewhere in the file than their positions.
    pub(crate) of_normals: bool,
}

impl VertexChunk {
    /// Appends vertices of a file that is not compressed, which come next.
    pub(crate) fn append(&mut self, behind: &mut Self) {
        let shift = self.raw.len() as u32;
        self.positions.append(&mut behind.positions);
        self.normals.append(&mut behind.normals);
        self.tangents.append(&mut behind.tangents);
        self.spans.extend(behind.spans.drain(..).map(|span| span.map(|at| at + shift)));
        self.records.append(&mut behind.records);
        self.raw.append(&mut behind.raw);
        self.of_format.append(&mut behind.of_format);
    }

    /// Index of the first vertex of the chunk in its file.
    pub(crate) fn first_of_file(&self) -> u64 {
        self.first - self.before
    }

    /// Number of vertices in the chunk.
    #[inline]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no vertex in the chunk.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The bytes of the file that these vertices were read from. Those of a compressed block, which hold more
    /// vertices than a chunk does, come with the first of its chunks alone: all chunks of a model together
    /// have all bytes, once.
    #[inline]
    pub fn raw(&self) -> &[u8] {
        &self.raw
    }

    /// Bytes of the file that the chunk stands for.
    pub(crate) fn source_bytes(&self) -> u64 {
        (if self.pages.is_empty() { &self.raw } else { &self.pages }).len() as u64
    }

    /// Data of the format's own of former bytes, to be filled anew.
    pub(crate) fn take_of_format<T: Any + Default>(&mut self) -> Box<T> {
        self.of_format.drain(..).find_map(|of| of.downcast::<T>().ok()).unwrap_or_default()
    }
}

/// Vertices that are edited once more, since a part of their numbers is among the bytes of another chunk than
/// the rest: in groups, each by itself, which are neither begun nor ended.
#[derive(Debug, Default)]
pub(crate) struct StraddlingVertices {
    pub(crate) positions: Vec<DVec3>,
    /// Normals, as many as positions, where the model has any.
    pub(crate) normals: Vec<Vec3>,
    /// Number of vertices of each group.
    pub(crate) groups: Vec<usize>,
}

/// A compressed block of a file, which can be read without the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct CompressedBlock {
    pub(crate) vertices: u64,
    pub(crate) bytes: u64,
}

/// Vertices of a chunk in one version of the model.
///
/// Memory: 36 bytes per vertex, so at most 2.3 MiB, and 36 more with gradients; [`Model::rewrite`] holds one
/// for each version and thread.
#[derive(Debug, Default)]
pub struct Edited {
    /// Positions, as many as the chunk has.
    pub positions: Vec<DVec3>,
    /// Normals, as many as the chunk has; empty where the model has none, or they are not to be transformed.
    pub normals: Vec<Vec3>,
    /// The gradient of the deformation at each vertex, which is the identity until it is changed; empty where
    /// nothing is to turn by it. Tangents and [all that follows](Model::following) do.
    pub gradients: Vec<Mat3>,
    /// Whether the deformation as a whole turns left into right.
    pub mirrored: bool,
}

impl Edited {
    /// Tangents of the chunk's vertices in this version.
    pub(crate) fn tangents(&self, chunk: &VertexChunk) -> Vec<Vec4> {
        let turned = chunk.tangents.iter().zip(&self.gradients);
        turned.map(|(t, gradient)| follow::tangent(gradient, *t, self.mirrored)).collect()
    }
}

/// Treatment of a model's normals when it is rewritten. Of no effect on a model without normals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Normals {
    /// Normals keep their bytes.
    Keep,
    /// Normals change with the positions, and so do tangents.
    #[default]
    Transform,
    /// Normals are left out of the new file, header and vertices.
    Drop,
}

/// Function that gives the vertices of a model their new positions and normals: see [`Model::rewrite`]. A
/// closure on a chunk and its versions is one.
pub trait Edit: Sync {
    /// Gets, before all else, the number of bytes of vertices before the [part](Rewriting::only) of a file
    /// that is rewritten, if it is a part.
    fn begin_behind(&self, _vertex_bytes: u64) {}

    /// Gets each chunk before it is decoded: one at a time, in the file's order. Where the model is made of
    /// several [tiles](Model::tiles), vertices are counted in each tile by itself, and one tile is over
    /// before the next begins.
    ///
    /// # Errors
    /// What has been read so far shows that the work is in vain.
    fn begin(&self, _chunk: &RawChunk<'_>) -> Result<()> {
        Ok(())
    }

    /// Edits a chunk's versions, which are as the chunk until then: on any thread, in any order, several at a
    /// time.
    ///
    /// # Errors
    /// The vertices cannot be edited.
    fn edit(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()>;

    /// Edits vertices once more for their normals alone, where these stand elsewhere in the file than the
    /// positions: such chunks are neither begun nor ended.
    ///
    /// # Errors
    /// As of [`edit`](Self::edit).
    fn edit_normals(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        self.edit(chunk, versions)
    }

    /// Gets each edited chunk, by its first vertex, before the chunk is written: one at a time, in the file's
    /// order.
    ///
    /// # Errors
    /// What goes with the chunk cannot be written.
    fn end(&self, _first: u64) -> Result<()> {
        Ok(())
    }

    /// Whether it is known that a version is the same as the model.
    fn is_still(&self, _version: usize) -> bool {
        false
    }
}

impl<F: Fn(&VertexChunk, &mut [Edited]) -> Result<()> + Sync> Edit for F {
    fn edit(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        self(chunk, versions)
    }
}

/// A run of consecutive vertices as they are in the file.
#[derive(Debug, Clone, Copy)]
pub struct RawChunk<'a> {
    /// The first vertex' index in the model.
    pub first: u64,
    /// The number of vertices.
    pub vertices: usize,
    /// Bytes of the file that hold the vertices.
    pub bytes: &'a [u8],
    /// Whether these vertices are edited: the outputs may have them already.
    pub is_edited: bool,
}

/// Options of rewriting a model.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rewriting {
    /// Treatment of the normals.
    pub normals: Normals,
    /// Number of pieces at the beginning that are read, but neither edited nor written: the outputs have them
    /// already.
    pub pieces_done: u64,
    /// Number of files of a model that is made of [tiles](Model::tiles) that are read, but neither edited nor
    /// written; pieces are those of the file after them.
    pub files_done: u64,
    /// The pieces that alone are read, edited and written: a part of a file that can be
    /// [divided](Model::division).
    pub only: Option<PieceRange>,
    /// Most consecutive pieces with vertices that are edited at a time, as one chunk, where the format
    /// supports that: it pays where vertices are in no order. Zero is as one. The file comes out in the same
    /// pieces.
    pub pieces_at_once: u64,
}

/// Consecutive pieces of a model that is rewritten, by their numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PieceRange {
    /// The first piece.
    pub first: u64,
    /// Index behind the last piece; the end of the file where not given, and then bytes that are known only
    /// there are replaced in the outputs.
    pub end: Option<u64>,
}

/// Division of the rewriting of a model among calls that know nothing of each other. The pieces of a model
/// that is made of [tiles](Model::tiles) are its tiles, each as a whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Division {
    /// Number of pieces, from the file's beginning on, that each follow from the model alone. The pieces
    /// behind them, if there are any, follow from the new version of these.
    pub pieces: u64,
    /// The pieces that hold vertices; the others are copied.
    pub vertices: Range<u64>,
    /// Whether the place of each piece in the new file is known beforehand: as the piece has as many bytes in
    /// the new file as in the old one, and nothing is replaced in the end in the pieces with vertices or
    /// behind them; or as it is a file by itself.
    pub in_place: bool,
}

/// Destination of a new version of a model. Anything that can be written to is one, for formats that replace
/// nothing in the end.
pub trait Output: Send {
    /// Gets, before all else, the byte of the old file at which the [part](Rewriting::only) begins that is
    /// rewritten, if it is a part.
    ///
    /// # Errors
    /// Nothing can be written there.
    fn begin_at(&mut self, _at: u64) -> io::Result<()> {
        Ok(())
    }

    /// Gets, before all else, the number of the file that comes next, where the model is made of
    /// [tiles](Model::tiles).
    ///
    /// # Errors
    /// Nothing can be written there.
    fn begin_file(&mut self, _number: usize) -> io::Result<()> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "a model of several files goes to a folder"))
    }

    /// Takes the next `pieces` pieces of the new file, which stand for `source_bytes` of the model, and their
    /// summary for other places of the file. The same model, rewritten in the same way, comes in the same
    /// pieces each time.
    ///
    /// # Errors
    /// The pieces cannot be written.
    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()>;

    /// Takes the next piece alone.
    ///
    /// # Errors
    /// As of [`write_pieces`](Self::write_pieces).
    fn write_piece(&mut self, bytes: &[u8], source_bytes: u64, summary: &Summary) -> io::Result<()> {
        self.write_pieces(1, bytes, source_bytes, summary)
    }

    /// The summaries of the pieces that are there already, as one.
    fn summary(&self) -> Summary {
        Summary::default()
    }

    /// Replaces bytes of pieces that were written, such as numbers at the beginning of a file that depend on
    /// later pieces. Called after the last piece, and before [`finish`](Self::finish).
    ///
    /// # Errors
    /// The bytes cannot be replaced.
    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()>;

    /// Ends a file, after its last piece.
    ///
    /// # Errors
    /// What is still held cannot be written.
    fn finish(&mut self) -> io::Result<()>;
}

impl<W: Write + Send> Output for W {
    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn patch(&mut self, _at: u64, _bytes: &[u8]) -> io::Result<()> {
        Err(io::Error::new(
            io::ErrorKind::Unsupported,
            "bytes that were written cannot be replaced in a stream",
        ))
    }

    fn finish(&mut self) -> io::Result<()> {
        self.flush()
    }
}

/// Faces between two [`FaceMark`]s, but for the last ones: what can be read alone.
pub const FACES_OF_A_BLOCK: u64 = 16;

/// A place in the file from which faces can be read: see [`Model::faces_at`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaceMark {
    /// Number of the chunk's triangles before the mark.
    pub triangle: usize,
    /// The byte of the file at which a face begins, or the last one ends; of a model of several files,
    /// counted through all of them, each with a byte more than it has.
    pub offset: u64,
}

/// Triangles of consecutive faces, in the file's order.
#[derive(Debug, Default)]
pub struct FaceChunk {
    /// Indices of each triangle's corners, at most [`CHUNK_TRIANGLES`] triangles. Nothing is checked: there
    /// may be no vertex of an index, and corners may be equal. An index that no vertex can have, as it is
    /// negative or 2³² - 1 or more, is given as [`u32::MAX`].
    pub triangles: Vec<[u32; 3]>,
    /// Indices, ascending, of the triangles that belong to the same polygon as the triangle before, at whose
    /// first corner and last one they begin: the last triangle of the chunk before, for the first one here.
    pub continued: Vec<u32>,
    /// Starts of blocks of [`FACES_OF_A_BLOCK`] faces, ascending; at the very end, the end of the last one.
    /// None where faces cannot be read but all at once.
    pub marks: Vec<FaceMark>,
    /// Bytes of the file that this chunk took.
    pub bytes: u64,
}

impl FaceChunk {
    /// Leaves nothing of former triangles.
    pub(crate) fn clear(&mut self) {
        self.triangles.clear();
        self.continued.clear();
        self.marks.clear();
        self.bytes = 0;
    }

    /// Adds the next corner of a polygon.
    #[inline]
    pub(crate) fn add_corner(&mut self, fan: &mut Fan, index: i64) {
        let continues = fan.has_triangle();
        if let Some(triangle) = fan.polygon(index) {
            if continues {
                self.continued.push(self.triangles.len() as u32);
            }
            self.triangles.push(triangle);
        }
    }
}

/// Reads consecutive vertices of a model, a chunk at a time.
pub trait VertexReader: Send {
    /// Sets the most vertices of the chunks to come: [`CHUNK_VERTICES`] until then, and at most.
    fn set_chunk(&mut self, vertices: usize);

    /// Leaves out from now on all that takes time to read and is neither position, normal nor [raw
    /// bytes](VertexChunk::raw).
    fn skip_attributes(&mut self) {}

    /// Leaves out from now on attributes that are no colours.
    fn skip_all_but_colors(&mut self) {}

    /// Reads the next vertices into `chunk`, whose buffers are reused; `false` (and an empty chunk) at the
    /// end.
    ///
    /// # Errors
    /// The file cannot be read, ends early or, in a text format, holds something that is no number.
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool>;
}

/// Reads triangles of consecutive faces, a chunk at a time.
pub trait FaceReader: Send {
    /// Reads the next triangles into `chunk`, whose buffer is reused; `false` (and an empty chunk) at the
    /// end.
    ///
    /// Before the end a chunk may be empty, too: for other things in the file that have to be passed over.
    /// The triangles of a polygon or a strip may lie in two chunks or more.
    ///
    /// # Errors
    /// The file cannot be read, ends early, or holds a list of negative length or, in a text format,
    /// something that is no whole number. Nothing more can be read then.
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool>;
}

/// Reads the faces of a model that has none.
pub(crate) struct NoFaces;

impl FaceReader for NoFaces {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        *chunk = FaceChunk::default();
        Ok(false)
    }
}

/// Chunks that are read ahead: one that is worked on, one that is ready, one that is filled.
const CHUNKS_AHEAD: usize = 3;

/// Streams all vertices of a model through `visit`, on this thread, while another one reads on.
///
/// Memory: three chunks.
///
/// # Errors
/// The model cannot be read, or `visit` failed.
pub fn for_vertices(model: &dyn Model, visit: impl FnMut(&VertexChunk) -> Result<()>) -> Result<()> {
    let mut reader = model.vertices(0..model.info().vertices)?;
    reader.set_chunk(SMALL_CHUNK);
    read_ahead(move |chunk| reader.read(chunk), visit)
}

/// Streams all vertices of a model as [`for_vertices`] does, without their [attributes](Model::attributes).
///
/// # Errors
/// As of [`for_vertices`].
pub fn for_positions(model: &dyn Model, visit: impl FnMut(&VertexChunk) -> Result<()>) -> Result<()> {
    let mut reader = model.vertices(0..model.info().vertices)?;
    reader.set_chunk(SMALL_CHUNK);
    reader.skip_attributes();
    read_ahead(move |chunk| reader.read(chunk), visit)
}

/// Streams all faces of a model through `visit`, likewise.
///
/// # Errors
/// The model cannot be read, or `visit` failed.
pub fn for_faces(model: &dyn Model, visit: impl FnMut(&FaceChunk) -> Result<()>) -> Result<()> {
    let mut reader = model.faces()?;
    read_ahead(move |chunk| reader.read(chunk), visit)
}

/// Streams the faces between marks through `visit`, likewise.
///
/// # Errors
/// As of [`Model::faces_at`], or `visit` failed.
pub fn for_faces_at(
    model: &dyn Model,
    ranges: Vec<Range<u64>>,
    visit: impl FnMut(&FaceChunk) -> Result<()>,
) -> Result<()> {
    let mut reader = model.faces_at(ranges)?;
    read_ahead(move |chunk| reader.read(chunk), visit)
}

/// Streams the faces from a mark on through `visit`, likewise, up to a chunk with which there are so many
/// triangles.
///
/// # Errors
/// As of [`Model::faces_from`], or `visit` failed.
pub fn for_faces_from(
    model: &dyn Model,
    mark: u64,
    triangles: u64,
    visit: impl FnMut(&FaceChunk) -> Result<()>,
) -> Result<()> {
    let mut reader = model.faces_from(mark)?;
    let mut left = triangles;
    let read = move |chunk: &mut FaceChunk| {
        if left == 0 {
            return Ok(false);
        }
        let more = reader.read(chunk)?;
        left = left.saturating_sub(chunk.triangles.len() as u64);
        Ok(more)
    };
    read_ahead(read, visit)
}

fn read_ahead<C: Default + Send>(
    mut read: impl FnMut(&mut C) -> Result<bool> + Send,
    mut visit: impl FnMut(&C) -> Result<()>,
) -> Result<()> {
    let (recycle, empty) = sync_channel(CHUNKS_AHEAD);
    let (full, ready) = sync_channel(CHUNKS_AHEAD);
    for _ in 0..CHUNKS_AHEAD {
        // The channel holds them all.
        let _ = recycle.send(C::default());
    }
    thread::scope(|scope| {
        // The thread's ends of the channels are dropped with it, so that no end waits for another in vain.
        let reading = scope.spawn(move || -> Result<()> {
            while let Ok(mut chunk) = empty.recv() {
                if !read(&mut chunk)? || full.send(chunk).is_err() {
                    break;
                }
            }
            Ok(())
        });
        let visited = ready.into_iter().try_for_each(|chunk| {
            visit(&chunk)?;
            // The reader may be at its end.
            let _ = recycle.send(chunk);
            Ok(())
        });
        drop(recycle);
        let read = reading.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        visited.and(read)
    })
}

/// Reads some attributes by reading all up to the last one of them.
pub(crate) fn some_by_all(
    attributes: impl FnOnce(&mut [Vec<f64>]) -> Result<()>,
    places: &[usize],
    to: &mut [Vec<f64>],
) -> Result<()> {
    let mut lists = vec![Vec::new(); places.iter().max().map_or(0, |last| last + 1)];
    to.iter_mut().zip(places).for_each(|(to, place)| lists[*place] = std::mem::take(to));
    attributes(&mut lists)?;
    to.iter_mut().zip(places).for_each(|(to, place)| *to = std::mem::take(&mut lists[*place]));
    Ok(())
}

/// One of the files that a model is made of, where it is made of several: a model by itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile {
    /// The file.
    pub path: PathBuf,
    /// Name of the tile in a folder that all tiles are written to.
    pub name: PathBuf,
    /// The tile's size in bytes.
    pub bytes: u64,
    /// The tile's number of vertices, which come after those of the tiles before it.
    pub vertices: u64,
}

/// A model on disk that can be streamed any number of times, from several threads.
pub trait Model: Send + Sync {
    /// Info on the model that is known without reading the vertices.
    fn info(&self) -> &ModelInfo;

    /// The file; of a model that is made of several, a pattern that they have in common.
    fn path(&self) -> &Path;

    /// Files beside the model's own file that are part of the model.
    fn other_files(&self) -> Vec<&Path> {
        Vec::new()
    }

    /// Files that the model is made of, if these are several, in the order of their vertices: it is
    /// [rewritten](Self::rewrite) to as many files then.
    fn tiles(&self) -> &[Tile] {
        &[]
    }

    /// Extensions that names of such files have, in lower case, the usual one first; none if any will do.
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }

    /// Details that the file tells of itself, for people: a line for each scan, where it has several.
    fn details(&self) -> Vec<String> {
        Vec::new()
    }

    /// The coordinate reference system as text (WKT), in one line, where the file has more of it than its
    /// [name](ModelInfo::crs).
    fn wkt(&self) -> Option<String> {
        None
    }

    /// Remarks of the file on its attributes that have no place in most formats: lines that PLY keeps as
    /// comments, and LAS reads.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }

    /// Least and largest intensity that the file declares, if it does.
    fn intensity_limits(&self) -> Option<[f64; 2]> {
        None
    }

    /// Content of the file that no other method of this trait returns, each in a few words, as "3 comments":
    /// a loss where the model is written in another format.
    ///
    /// # Errors
    /// The file cannot be read.
    fn besides(&self) -> Result<Vec<String>> {
        Ok(Vec::new())
    }

    /// Attributes with whole numbers that double precision does not tell apart, each in a few words, as of
    /// [`besides`](Self::besides), where finding them takes a reading of all vertices.
    ///
    /// # Errors
    /// The file cannot be read; the user cancelled.
    fn beyond_doubles(&self, _progress: &dyn Progress) -> Result<Vec<String>> {
        Ok(Vec::new())
    }

    /// The model as its own type, for conversions that keep more than this trait gives.
    fn as_any(&self) -> Option<&dyn Any> {
        None
    }

    /// Size in bytes of the file that is [written](Self::rewrite), about.
    fn written_bytes(&self) -> u64 {
        self.info().bytes
    }

    /// Bytes by which the progress of [rewriting](Self::rewrite) is counted: more than the file has where
    /// parts of it are read several times.
    fn bytes_to_rewrite(&self) -> u64 {
        self.info().bytes
    }

    /// Columns of a text as the user named them, as "x,y,z": the file has to be opened so again.
    fn columns(&self) -> Option<&str> {
        None
    }

    /// A reader of the vertices whose indices lie in `range` (clipped to the model).
    ///
    /// # Errors
    /// The file cannot be read.
    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>>;

    /// Bytes of a reading of all vertices, counted in the order of the file: those that come before the
    /// vertex' unit of reading, and those before the vertex itself or, in compressed blocks, before the first
    /// block that begins at the vertex or behind it; at the end, all bytes.
    fn bytes_before(&self, vertex: u64) -> [u64; 2] {
        let info = self.info();
        let before = u128::from(info.vertex_bytes) * u128::from(vertex) / u128::from(info.vertices.max(1));
        [before as u64; 2]
    }

    /// Prepares for several readings of all vertices for their positions and colours, or with `None` ends
    /// that. Where finding these takes long, as in compressed blocks, they may be kept in a temporary file in
    /// `folder`, of 18 bytes per vertex as a rule, and of 8 GiB at most; if the folder has no room, they are
    /// not kept.
    fn keep_positions(&self, _folder: Option<&Path>) {}

    /// The numbers of the [first attributes](ModelInfo::attributes), as many as there are lists, one for each
    /// vertex of a chunk that was read from this model. Former contents of the lists are lost.
    ///
    /// # Errors
    /// In a text format, something is no number.
    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()>;

    /// The numbers of the [attributes](ModelInfo::attributes) at some places among them, no place twice, a
    /// list each.
    ///
    /// # Errors
    /// As of [`attributes`](Self::attributes).
    fn some_attributes(&self, chunk: &VertexChunk, places: &[usize], to: &mut [Vec<f64>]) -> Result<()> {
        some_by_all(|lists| self.attributes(chunk, lists), places, to)
    }

    /// A reader of all faces, if the format has any, in the file's order, as triangles: a polygon of more
    /// than three corners becomes a fan about its first corner, one of fewer gives none, and a strip's
    /// triangles are turned to the same side.
    ///
    /// In a text file the end of the vertices has to be found, where it is not known from reading them.
    ///
    /// # Errors
    /// The file cannot be read, or ends within the vertices.
    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(NoFaces))
    }

    /// A reader of the faces that lie in some ranges of the file's bytes, each from one [`FaceMark`] to
    /// another, and of nothing else.
    ///
    /// # Errors
    /// The model's faces have no marks. When it is read: the file cannot be, or no face ends where a range
    /// does, as the file has changed; records are counted from the beginning of the range then.
    fn faces_at(&self, _ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(NoFaces))
    }

    /// Byte of the file at which a face begins, or the last one ends, where reading can
    /// [begin](Self::faces_at) at any face: as all faces are triangles of one length, if the size of the file
    /// tells the truth. A reader of the faces finds out whether each of so many bytes was one.
    fn face_at(&self, _face: u64) -> Option<u64> {
        None
    }

    /// Whether the faces come with marks from each of which they can be read [on](Self::faces_from).
    fn has_face_marks(&self) -> bool {
        false
    }

    /// A reader of all faces from a [`FaceMark`] on, with their marks.
    ///
    /// # Errors
    /// As of [`faces_at`](Self::faces_at).
    fn faces_from(&self, _mark: u64) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(NoFaces))
    }

    /// Checks that the file holds all that its header speaks of. Most formats know once the file is open, and
    /// this takes no time; text has to be read to its end, as a stage of its own, which
    /// [`rewrite`](Self::rewrite) does as well.
    ///
    /// # Errors
    /// The file cannot be read, or ends early; the user cancelled.
    fn check_complete(&self, progress: &dyn Progress) -> Result<()>;

    /// Whether the rewritten file has room for a vertex at a position, as far as that can be said without
    /// knowing which vertex it is: integers do not reach everywhere.
    fn has_room_for(&self, p: DVec3) -> bool {
        self.info().written.is_none_or(|integers| integers.range().contains(p))
    }

    /// Box of all vertices as the file tells it, which may be wrong; none where the file tells none.
    fn told_bounds(&self) -> Option<Bounds> {
        None
    }

    /// Makes room in the files that are rewritten from now on for vertices that go from the first place of
    /// each pair to the second, and for others that go further by `margin`: where integers do not reach, by
    /// another offset, or another range. Returns what was changed, if anything: all integers are written anew
    /// then.
    ///
    /// # Errors
    /// The format has no integers for positions, or they cannot reach so far.
    fn make_room(&mut self, _moves: &[[DVec3; 2]], _margin: f64) -> Result<Option<String>> {
        Err(Error::argument(
            format!("{} has no offset: its positions are not stored as integers", self.path().display()),
            "leave out --offset auto",
        ))
    }

    /// Attributes that turn with the surface besides normals and tangents when the model is rewritten; none
    /// where the format cannot tell. They are known by their names, or by the properties of Gaussian splats.
    fn following(&self) -> Option<&Following> {
        None
    }

    /// Sets the attributes that turn with the surface from now on.
    ///
    /// # Errors
    /// What is declared is not there, or cannot be changed in the format; splats lack a property.
    fn follow(&mut self, follow: &Follow) -> Result<()> {
        let Some(name) = follow.declared.keys().next() else { return Ok(()) };
        Err(Error::argument(
            format!(
                "{} has no property {name} that can be rewritten: its format is {}",
                self.path().display(),
                self.info().format
            ),
            "properties follow in PLY, PCD, LAS, E57 and columns of text: have `simod convert` make such a file first",
        ))
    }

    /// Division of the rewriting, where it can begin at any piece without going over those before it.
    fn division(&self, _normals: Normals) -> Option<Division> {
        None
    }

    /// Streams the whole file to all `outputs` in one reading: each gets a version of its own, with the
    /// positions and normals that `edit` gives its vertices, and what [follows](Self::following) from the
    /// gradients. Every other byte is copied as it is.
    ///
    /// `edit` sees each chunk as it is in the file, and for each output an [`Edited`], which is as the chunk
    /// until it is changed. Pieces that are done, according to `how`, are reported to `edit`, but not edited.
    /// A vertex whose position is not finite keeps its bytes, whatever `edit` writes, and so does a component
    /// that `edit` left as it was.
    ///
    /// As many pieces are worked on as there are threads in the pool, each from reading to writing by one
    /// thread. Where something fails, all that comes before it in the file is written. Advances `progress` by
    /// those bytes of this file whose new versions are written; the caller begins the stage.
    ///
    /// # Errors
    /// The file cannot be read, is not what its header says, or changed length; an output cannot be written;
    /// `edit` failed, gave a finite vertex a non-finite position, or changed the number of vertices; there
    /// are more than [`MAX_VERSIONS`] outputs; a part is asked for of a file that cannot be divided; the user
    /// cancelled.
    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()>;
}
