//! Binary STL: 80 bytes of anything, the number of facets, and 50 bytes for each: normal, three corners, all
//! of 32-bit floats, and two bytes of anything.

use std::ops::Range;
use std::path::Path;

use glam::{DVec3, Vec3};

use super::facets::{FACET, Facets, START, normal};
use crate::pipeline::{self, Piece, PieceVersion, Pieces, Rewritable, Skipped};
use crate::source::SourceFile;
use crate::text::CUT_OFF;
use crate::unfit::Unfit;
use crate::{
    CHUNK_VERTICES, Division, Edit, FaceReader, Model, ModelInfo, Normals, Output, Progress, Result,
    Rewriting, Scalar, VertexChunk, VertexReader,
};

/// Most facets of a chunk.
const CHUNK_FACETS: u64 = (CHUNK_VERTICES / 3) as u64;

/// Bytes that are copied at once.
const COPIED: usize = 4 << 20;

/// Number of facets that the file declares, if the file is long enough to declare one.
fn count(source: &SourceFile) -> Result<Option<u64>> {
    let mut count = [0; 4];
    let read = source.read_at(&mut count, START - 4)?;
    Ok((read == count.len()).then(|| u64::from(u32::from_le_bytes(count))))
}

/// Whether the file is just as long as its number of facets implies: a text never is, but by a very rare
/// chance.
pub(super) fn has_its_length(source: &SourceFile) -> Result<bool> {
    Ok(count(source)?.is_some_and(|count| START + FACET * count == source.len()))
}

/// A binary STL file.
#[derive(Debug)]
pub(super) struct BinaryStl {
    source: SourceFile,
    facets: u64,
    info: ModelInfo,
}

impl BinaryStl {
    /// # Errors
    /// The file is shorter than its number of facets says, or longer by a facet or more.
    pub(super) fn new(source: SourceFile) -> Result<Self> {
        let Some(facets) = count(&source)? else {
            return Err(source.malformed(
                format_args!("{} bytes are too few for STL, which begins with 84", source.len()),
                CUT_OFF,
            ));
        };
        let expected = START + FACET * facets;
        // A few more are kept as they are.
        if !(expected..expected + FACET).contains(&source.len()) {
            let what = format!(
                "says {facets} facets, which makes {expected} bytes of binary STL, but it has {}",
                source.len()
            );
            return Err(source.malformed(what, CUT_OFF));
        }
        let info = ModelInfo {
            format: "STL, binary".into(),
            vertices: 3 * facets,
            faces: facets,
            position_type: Scalar::F32,
            bytes: source.len(),
            vertex_bytes: FACET * facets,
            face_bytes: FACET * facets,
            ..ModelInfo::default()
        };
        Ok(Self { source, facets, info })
    }

    /// Reads the bytes of some facets.
    fn read_facets(&self, raw: &mut Vec<u8>, facets: Range<u64>) -> Result<()> {
        // Not cleared first: filling a buffer with zeros, only to overwrite it, takes time.
        raw.resize((FACET * (facets.end - facets.start)) as usize, 0);
        self.source.read_at(raw, START + FACET * facets.start)?;
        Ok(())
    }
}

/// Three floats.
fn vector(bytes: &[u8]) -> DVec3 {
    let number = |i: usize| {
        let mut four = [0; 4];
        four.copy_from_slice(&bytes[4 * i..4 * i + 4]);
        f32::from_le_bytes(four)
    };
    Vec3::new(number(0), number(1), number(2)).as_dvec3()
}

fn put(bytes: &mut [u8], value: Vec3) {
    for (bytes, value) in bytes.chunks_exact_mut(4).zip(value.to_array()) {
        bytes.copy_from_slice(&value.to_le_bytes());
    }
}

/// Range of a corner's bytes in its facet.
fn corner(i: usize) -> Range<usize> {
    12 * (i + 1)..12 * (i + 2)
}

/// All corners of some facets.
fn corners(raw: &[u8]) -> impl Iterator<Item = DVec3> + '_ {
    raw.chunks_exact(FACET as usize).flat_map(|facet| [0, 1, 2].map(|i| vector(&facet[corner(i)])))
}

struct StlReader<'a> {
    model: &'a BinaryStl,
    range: Range<u64>,
    /// Most facets of a chunk.
    chunk: u64,
}

impl VertexReader for StlReader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = (vertices as u64 / 3).clamp(1, CHUNK_FACETS);
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let Range { start, end } = self.range;
        let first = start / 3;
        let facets = first..(first + self.chunk).min(end.div_ceil(3)).max(first);
        let next = end.min(3 * facets.end).max(start);
        chunk.first = start;
        self.model.read_facets(&mut chunk.raw, facets)?;
        chunk.positions.clear();
        let skipped = (start - 3 * first) as usize;
        chunk.positions.extend(corners(&chunk.raw).skip(skipped).take((next - start) as usize));
        if skipped > 0 {
            // A facet's bytes come with its first corner: all chunks of a model together have all, once.
            chunk.raw.drain(..FACET as usize);
        }
        self.range.start = next;
        Ok(next > start)
    }
}

impl Model for BinaryStl {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["stl"]
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        let end = range.end.min(self.info.vertices);
        Ok(Box::new(StlReader { model: self, range: range.start.min(end)..end, chunk: CHUNK_FACETS }))
    }

    fn attributes(&self, _chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        to.iter_mut().for_each(Vec::clear);
        Ok(())
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(Facets::new(self.facets)))
    }

    fn faces_at(&self, ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(Facets::between(self.facets, ranges)))
    }

    fn face_at(&self, face: u64) -> Option<u64> {
        (face <= self.facets).then(|| Facets::start(face))
    }

    fn has_face_marks(&self) -> bool {
        true
    }

    fn faces_from(&self, mark: u64) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(Facets::from(self.facets, mark)))
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn division(&self, normals: Normals) -> Option<Division> {
        Rewritable::division(self, normals)
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        pipeline::rewrite(self, outputs, how, edit, progress)
    }
}

impl Rewritable for BinaryStl {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(StlPieces { model: self, at: 0 }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.positions.clear();
        chunk.positions.extend(corners(&chunk.raw));
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, mut version: PieceVersion<'_>) -> Result<()> {
        let edited = version.edited;
        let VertexChunk { positions, raw, first, .. } = chunk;
        let bytes = version.begin_with(raw);
        let rest = positions.chunks_exact(3);
        let facets = bytes.chunks_exact_mut(FACET as usize);
        for (facet, ((bytes, old), new)) in facets.zip(rest).zip(edited.positions.chunks_exact(3)).enumerate()
        {
            let mut moved = false;
            for i in 0..3 {
                let (old, new, rounded) = (old[i], new[i], new[i].as_vec3());
                let same = old.to_array().map(f64::to_bits) == new.to_array().map(f64::to_bits);
                if same || !old.is_finite() {
                    continue;
                }
                if let Some(axis) = (0..3).find(|axis| !rounded[*axis].is_finite()) {
                    let unfit = Unfit { vertex: 3 * facet + i, axis, value: new[axis] };
                    return Err(unfit.in_floats(&self.source, *first));
                }
                put(&mut bytes[corner(i)], rounded);
                moved = true;
            }
            if moved {
                let now = [0, 1, 2].map(|i| vector(&bytes[corner(i)]));
                if let Some(normal) = normal(vector(bytes), [old[0], old[1], old[2]], now) {
                    put(&mut bytes[..12], normal.as_vec3());
                }
            }
        }
        Ok(())
    }

    fn division(&self, _normals: Normals) -> Option<Division> {
        let facets = 1..1 + self.facets.div_ceil(CHUNK_FACETS);
        Some(Division { pieces: facets.end, vertices: facets, in_place: true })
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

/// The header, facets, and what follows them.
struct StlPieces<'a> {
    model: &'a BinaryStl,
    at: u64,
}

impl Pieces for StlPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let BinaryStl { source, facets, .. } = self.model;
        let end = START + FACET * facets;
        if (START..end).contains(&self.at) {
            let first = (self.at - START) / FACET;
            let some = first..(first + CHUNK_FACETS).min(*facets);
            let vertices = 3 * (some.end - first);
            self.at = START + FACET * some.end;
            self.model.read_facets(&mut chunk.raw, some)?;
            chunk.first = 3 * first;
            return Ok(Piece::Vertices(vertices as usize));
        }
        chunk.raw.clear();
        let left = if self.at < START { START - self.at } else { source.len() - self.at };
        if left == 0 {
            source.check_unchanged()?;
            return Ok(Piece::End);
        }
        self.at += source.append_at(&mut chunk.raw, self.at, left.min(COPIED as u64) as usize)? as u64;
        Ok(Piece::Bytes)
    }

    fn skip(&mut self, pieces: u64) -> Result<Skipped> {
        let facets = pieces.saturating_sub(1).saturating_mul(CHUNK_FACETS).min(self.model.facets);
        self.at = if pieces == 0 { 0 } else { START + FACET * facets };
        Ok(Skipped { bytes: self.at, vertex_bytes: FACET * facets })
    }
}
