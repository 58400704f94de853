//! `.splat`, as viewers in browsers take it: for each splat position and scales as floats, colour and opacity
//! as four bytes, and the quaternion as four more, real part first. There is no header; the extension tells.

use std::ops::Range;
use std::path::Path;

use glam::{DVec3, Vec3};

use super::{GroupOffsets, SplatLayout, SplatReader, gradient, info, packing, turn};
use crate::follow::{Follow, Following};
use crate::pipeline::{self, Piece, PieceVersion, Pieces, Rewritable, Skipped};
use crate::source::SourceFile;
use crate::unfit::Unfit;
use crate::{
    CHUNK_VERTICES, Division, Edit, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting,
    VertexChunk, VertexReader,
};

/// The extension of such files.
pub(crate) const EXTENSION: &str = "splat";

/// Bytes of a splat.
const RECORD: usize = 32;

/// Bytes of a record at which its scales, its colour and its quaternion begin.
const SCALES: usize = 12;
const COLOUR: usize = 24;
const QUATERNION: usize = 28;

/// Full scale of a number of the quaternion, and its step's inverse.
const HALF: f64 = 128.0;

/// A file of such records.
#[derive(Debug)]
struct SplatRecords {
    source: SourceFile,
    info: ModelInfo,
    following: Following,
}

/// # Errors
/// The file does not end with a splat.
pub(crate) fn open(source: SourceFile) -> Result<Box<dyn Model>> {
    let left = source.len() % RECORD as u64;
    if left != 0 {
        let what = format!("{left} bytes are left behind its splats, which take {RECORD} each");
        return Err(source.malformed(what, "the file is cut off or no .splat: copy or export it again"));
    }
    let info =
        info("SPLAT, 32 bytes a splat".into(), &source, source.len() / RECORD as u64, RECORD as u64, 0);
    let following = Following::declared(&Follow::default(), &info.attributes, source.path())?;
    Ok(Box::new(SplatRecords { source, info, following }))
}

fn float(record: &[u8], at: usize) -> f32 {
    let mut four = [0; 4];
    four.copy_from_slice(&record[at..at + 4]);
    f32::from_le_bytes(four)
}

fn put(record: &mut [u8], at: usize, value: f32) {
    record[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

fn position(record: &[u8]) -> DVec3 {
    Vec3::from_array([0, 4, 8].map(|at| float(record, at))).as_dvec3()
}

/// Appends all numbers of a splat besides its position, in the order of the attributes.
fn numbers(record: &[u8], to: &mut Vec<f64>) {
    to.clear();
    to.extend((0..3).map(|i| packing::coefficient(f64::from(record[COLOUR + i]) / 255.0)));
    to.push(packing::opacity(record[COLOUR + 3]));
    to.extend((0..3).map(|i| f64::from(float(record, SCALES + 4 * i)).ln()));
    to.extend((0..4).map(|i| (f64::from(record[QUATERNION + i]) - HALF) / HALF));
}

/// Writes the numbers that have changed.
fn put_numbers(record: &mut [u8], old: &[f64], new: &[f64]) {
    let at = GroupOffsets::new(0);
    let is_new = |i: usize| old[i].to_bits() != new[i].to_bits() && new[i].is_finite();
    if is_new(at.opacity) {
        record[COLOUR + 3] = packing::opacity_byte(new[at.opacity]);
    }
    for i in 0..3 {
        let scale = new[at.scale + i].exp() as f32;
        if is_new(at.scale + i) && scale > 0.0 && scale.is_finite() {
            put(record, SCALES + 4 * i, scale);
        }
    }
    for i in 0..4 {
        if is_new(at.rotation + i) {
            // A conversion saturates.
            record[QUATERNION + i] = (new[at.rotation + i] * HALF + HALF).round() as u8;
        }
    }
}

impl SplatLayout for SplatRecords {
    fn read(&self, chunk: &mut VertexChunk, splats: Range<u64>) -> Result<()> {
        chunk.first = splats.start;
        chunk.raw.resize((splats.end - splats.start) as usize * RECORD, 0);
        self.source.read_at(&mut chunk.raw, splats.start * RECORD as u64)?;
        Ok(())
    }
}

impl Model for SplatRecords {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[EXTENSION]
    }

    fn details(&self) -> Vec<String> {
        vec!["quaternions in steps of 1/128, opacities of 1/255: what turns is rounded to them".into()]
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(SplatReader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        to.iter_mut().for_each(Vec::clear);
        let mut all = Vec::new();
        for record in chunk.raw.chunks_exact(RECORD) {
            numbers(record, &mut all);
            to.iter_mut().zip(&all).for_each(|(to, number)| to.push(*number));
        }
        Ok(())
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn following(&self) -> Option<&Following> {
        (!self.following.is_empty()).then_some(&self.following)
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.following = Following::declared(follow, &self.info.attributes, self.source.path())?;
        Ok(())
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
        pipeline::rewrite(self, outputs, how, edit, progress)?;
        self.following.tell(self.source.path(), progress);
        Ok(())
    }
}

impl Rewritable for SplatRecords {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(RecordPieces { model: self, next: 0 }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = !self.following.is_empty();
        chunk.positions.clear();
        chunk.positions.extend(chunk.raw.chunks_exact(RECORD).map(position));
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, mut version: PieceVersion<'_>) -> Result<()> {
        let edited = version.edited;
        let VertexChunk { positions, raw, first, .. } = chunk;
        let (mut old, mut new, mut some) = (Vec::new(), Vec::new(), Vec::new());
        let records = version.begin_with(raw).chunks_exact_mut(RECORD);
        for (vertex, (record, (rest, now))) in
            records.zip(positions.iter().zip(&edited.positions)).enumerate()
        {
            if !rest.is_finite() {
                continue;
            }
            for axis in (0..3).filter(|axis| rest[*axis].to_bits() != now[*axis].to_bits()) {
                let value = now[axis] as f32;
                if !value.is_finite() {
                    return Err(Unfit { vertex, axis, value: now[axis] }.in_floats(&self.source, *first));
                }
                put(record, 4 * axis, value);
            }
            if let Some(gradient) = gradient(edited, vertex) {
                numbers(record, &mut old);
                new.clone_from(&old);
                turn(&self.following, gradient, edited.mirrored, &mut new, &mut some);
                put_numbers(record, &old, &new);
            }
        }
        Ok(())
    }

    fn division(&self, _normals: Normals) -> Option<Division> {
        let pieces = self.info.vertices.div_ceil(CHUNK_VERTICES as u64);
        Some(Division { pieces, vertices: 0..pieces, in_place: true })
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

struct RecordPieces<'a> {
    model: &'a SplatRecords,
    next: u64,
}

impl Pieces for RecordPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let SplatRecords { source, info, .. } = self.model;
        let end = info.vertices.min(self.next + CHUNK_VERTICES as u64);
        let count = (end - self.next) as usize;
        if count == 0 {
            source.check_unchanged()?;
            return Ok(Piece::End);
        }
        self.model.read(chunk, self.next..end)?;
        self.next = end;
        Ok(Piece::Vertices(count))
    }

    fn skip(&mut self, pieces: u64) -> Result<Skipped> {
        self.next = pieces.saturating_mul(CHUNK_VERTICES as u64).min(self.model.info.vertices);
        let bytes = self.next * RECORD as u64;
        Ok(Skipped { bytes, vertex_bytes: bytes })
    }
}
