//! Compressed PLY of PlayCanvas and SuperSplat: an element `chunk` with bounds of positions, logarithms of
//! scales and (in later files) colours, for 256 splats each; an element `vertex` of four packed numbers
//! between these; and maybe an element `sh` with a byte for each coefficient of the harmonics.
//!
//! New bounds follow from all splats of a chunk, and stand before all splats in the file. So splats are
//! carried over once for each element, each time with the same result.
//!
//! A chunk's bytes are, splat by splat, its packed numbers and its harmonics; before each splat that begins a
//! chunk of the file stand the bounds. The bounds of all chunks that it meets are its records.

use std::ops::Range;
use std::path::Path;

use glam::DVec3;

use super::{GroupOffsets, HARMONICS, SplatLayout, SplatReader, gradient, info, packing, turn};
use crate::follow::{Follow, Following};
use crate::pipeline::{self, Piece, PieceVersion, Pieces, Rewritable};
use crate::ply::{Encoding, PlyElement, PlyHeader, PlyModel, PropertyShape};
use crate::source::SourceFile;
use crate::unfit::Unfit;
use crate::{
    CHUNK_VERTICES, Edit, Edited, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting, Type,
    VertexChunk, VertexReader,
};

/// Splats between one pair of bounds.
const CHUNK: u64 = 256;

/// Bytes of a splat's packed numbers.
const PACKED: usize = 16;

/// Bytes that are copied at once.
const COPIED: usize = 4 << 20;

/// The bounds of a chunk, in the file's order: of position and scales, and of colours.
const BOUNDS: [[&str; 6]; 3] = [
    ["min_x", "min_y", "min_z", "max_x", "max_y", "max_z"],
    ["min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"],
    ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"],
];

/// The numbers of a splat.
const SPLAT: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Steps between bounds, along three axes.
const STEPS: DVec3 = DVec3::new(2047.0, 1023.0, 2047.0);

/// Advice about a file that looks like a compressed PLY and is malformed, for people.
const HINT: &str = "export it again as a compressed PLY, or as an ordinary one";

/// A compressed PLY file.
#[derive(Debug)]
struct CompressedPly {
    source: SourceFile,
    info: ModelInfo,
    following: Following,
    /// Bytes at which the bounds, the splats, their harmonics and the rest of the file begin.
    starts: [u64; 4],
    /// Groups of bounds: two, or three with colours.
    groups: usize,
    /// Coefficients of the harmonics of a splat, a byte each.
    harmonics: usize,
}

/// A PLY file: of vertices, or of packed splats.
///
/// # Errors
/// As of [`PlyModel`]; its chunks are not what packed splats have.
pub(crate) fn open_ply(source: SourceFile) -> Result<Box<dyn Model>> {
    let header = PlyHeader::read(&source)?;
    let has = |name: &str| header.elements.iter().any(|e| e.name == name);
    let is_packed = |e: &PlyElement| e.name == "vertex" && e.properties.iter().any(|p| p.name == SPLAT[0]);
    if has("chunk") && header.elements.iter().any(is_packed) {
        return Ok(Box::new(CompressedPly::new(source, &header)?));
    }
    Ok(Box::new(PlyModel::new(source)?))
}

/// Whether an element has just these properties, all of one type.
fn has_just<'a>(element: &PlyElement, kind: Type, names: impl IntoIterator<Item = &'a str>) -> bool {
    let found = element.properties.iter().map(|p| (p.name.as_str(), p.shape));
    found.eq(names.into_iter().map(|name| (name, PropertyShape::Scalar(kind))))
}

/// The chunks and the splats of a file.
///
/// # Errors
/// The elements are not what packed splats have.
fn check_elements<'a>(source: &SourceFile, header: &'a PlyHeader) -> Result<[&'a PlyElement; 2]> {
    let wrong = |what: &str| Err(source.malformed(format_args!("packed splats, but {what}"), HINT));
    if header.encoding != Encoding::Little {
        return wrong("not in the format binary_little_endian");
    }
    let [chunk, vertex, ..] = &header.elements[..] else { return wrong("without chunks before them") };
    let groups = chunk.properties.len() / 6;
    if chunk.name != "chunk" || !(2..=3).contains(&groups) {
        return wrong("without bounds of positions and scales before them");
    }
    if !has_just(chunk, Type::F32, BOUNDS[..groups].iter().flatten().copied()) {
        return wrong("the bounds of their chunks have other names, another order or another type");
    }
    if vertex.name != "vertex" || !has_just(vertex, Type::U32, SPLAT) {
        return wrong(
            "with other properties than packed_position, packed_rotation, packed_scale, packed_color",
        );
    }
    if chunk.count != vertex.count.div_ceil(CHUNK) {
        let what = format!("{} chunks are not of {} splats, {CHUNK} each", chunk.count, vertex.count);
        return wrong(&what);
    }
    if let Some(sh) = header.elements.get(2).filter(|e| e.name == "sh") {
        let harmonics = sh.properties.len();
        let names: Vec<String> = (0..harmonics).map(|i| format!("f_rest_{i}")).collect();
        let is_known = matches!(harmonics, 9 | 24 | 45) && sh.count == vertex.count;
        if !is_known || !has_just(sh, Type::U8, names.iter().map(String::as_str)) {
            return wrong("its harmonics are not bytes of degree 1 to 3 for each splat");
        }
    }
    Ok([chunk, vertex])
}

impl CompressedPly {
    fn new(source: SourceFile, header: &PlyHeader) -> Result<Self> {
        let [chunk, vertex] = check_elements(&source, header)?;
        let groups = chunk.properties.len() / 6;
        let harmonics = header.elements.get(2).filter(|e| e.name == "sh").map_or(0, |sh| sh.properties.len());
        let sizes = [24 * groups as u64 * chunk.count, PACKED as u64, harmonics as u64];
        let bytes = [Some(sizes[0]), vertex.count.checked_mul(sizes[1]), vertex.count.checked_mul(sizes[2])];
        let (mut starts, mut at) = ([header.len; 4], header.len);
        for (start, bytes) in starts[1..].iter_mut().zip(bytes) {
            at = bytes
                .and_then(|bytes| at.checked_add(bytes))
                .filter(|end| *end <= source.len())
                .ok_or_else(|| {
                    source.malformed(
                        format_args!("the file ends within its {} packed splats", vertex.count),
                        HINT,
                    )
                })?;
            *start = at;
        }
        let mut info = info(
            "PLY 1.0, packed Gaussian splats".into(),
            &source,
            vertex.count,
            (PACKED + harmonics) as u64,
            harmonics,
        );
        info.vertex_bytes += sizes[0];
        let following = Following::declared(&Follow::default(), &info.attributes, source.path())?;
        let mut model = Self { source, info, following, starts, groups, harmonics };
        model.info.step = model.step()?;
        Ok(model)
    }

    /// Bytes of a chunk's bounds.
    fn bounds_bytes(&self) -> usize {
        24 * self.groups
    }

    /// Step from one position to the next along each axis, in the chunk of the file where the steps are
    /// largest.
    fn step(&self) -> Result<DVec3> {
        let (mut step, mut bytes, mut at) = (DVec3::ZERO, Vec::new(), self.starts[0]);
        while at < self.starts[1] {
            bytes.clear();
            let most = (COPIED / self.bounds_bytes() * self.bounds_bytes()) as u64;
            at += self.source.append_at(&mut bytes, at, most.min(self.starts[1] - at) as usize)? as u64;
            for record in bytes.chunks_exact(self.bounds_bytes()) {
                let extent = ChunkRange::from_record(record, 0).extent();
                step = step.max(if extent.is_finite() { extent.abs() / STEPS } else { DVec3::ZERO });
            }
        }
        Ok(step)
    }

    /// The splats of a chunk, each with the bounds of its chunk of the file.
    fn splats<'c>(&self, chunk: &'c VertexChunk) -> impl Iterator<Item = (&'c [u8], &'c [u8])> {
        let (size, each) = (self.bounds_bytes(), PACKED + self.harmonics);
        let (first, mut at, mut i) = (chunk.first_of_file(), 0, 0);
        std::iter::from_fn(move || {
            let splat = first + i;
            at += if splat.is_multiple_of(CHUNK) { size } else { 0 };
            let packed = chunk.raw.get(at..at + each)?;
            at += each;
            i += 1;
            let bounds = (splat / CHUNK - first / CHUNK) as usize * size;
            Some((chunk.records.get(bounds..bounds + size)?, packed))
        })
    }

    /// Appends all numbers of a splat besides its position, in the order of the attributes.
    fn numbers(&self, bounds: &[u8], packed: &[u8], to: &mut Vec<f64>) {
        to.clear();
        let [_, rotation, scale, colour] = words(packed);
        let colours = [24, 16, 8].map(|shift| packing::part(colour >> shift, 8));
        let colours = match self.groups {
            3 => ChunkRange::from_record(bounds, 2).interpolate(colours),
            _ => DVec3::from_array(colours),
        };
        to.extend(colours.to_array().map(packing::coefficient));
        to.extend(packed[PACKED..].iter().map(|byte| packing::harmonic(*byte)));
        to.push(packing::opacity(colour as u8));
        to.extend(ChunkRange::from_record(bounds, 1).interpolate(packing::three(scale)).to_array());
        to.extend(packing::quaternion(rotation));
    }
}

/// The four packed numbers.
fn words(packed: &[u8]) -> [u32; 4] {
    [0, 4, 8, 12].map(|at| {
        let mut four = [0; 4];
        four.copy_from_slice(&packed[at..at + 4]);
        u32::from_le_bytes(four)
    })
}

/// The least and the largest of three numbers in a chunk.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ChunkRange([DVec3; 2]);

impl ChunkRange {
    /// The box that holds nothing.
    const NONE: Self = Self([DVec3::INFINITY, DVec3::NEG_INFINITY]);

    /// Range of a group in a chunk's record.
    fn from_record(record: &[u8], group: usize) -> Self {
        let at = |i: usize| {
            let mut four = [0; 4];
            four.copy_from_slice(&record[24 * group + 4 * i..][..4]);
            f64::from(f32::from_le_bytes(four))
        };
        Self([DVec3::new(at(0), at(1), at(2)), DVec3::new(at(3), at(4), at(5))])
    }

    fn put(&self, record: &mut [u8], group: usize) {
        let numbers = self.0.iter().flat_map(|side| side.to_array());
        for (to, number) in record[24 * group..].chunks_exact_mut(4).zip(numbers) {
            to.copy_from_slice(&(number as f32).to_le_bytes());
        }
    }

    fn extent(&self) -> DVec3 {
        self.0[1] - self.0[0]
    }

    fn include(&mut self, p: DVec3) {
        self.0 = [self.0[0].min(p), self.0[1].max(p)];
    }

    /// The range as a file has it, in single precision.
    fn rounded(&self) -> Self {
        Self(self.0.map(|side| side.as_vec3().as_dvec3()))
    }

    /// Position at these parts of the way from the first corner to the second, along each axis.
    fn interpolate(&self, parts: [f64; 3]) -> DVec3 {
        let t = DVec3::from_array(parts);
        self.0[0] * (1.0 - t) + self.0[1] * t
    }

    /// Parts of the way from the first corner to the second at which a position lies, along each axis.
    fn parts(&self, p: DVec3) -> [f64; 3] {
        let (way, extent) = (p - self.0[0], self.extent());
        [0, 1, 2].map(|axis| if extent[axis] > 0.0 { way[axis] / extent[axis] } else { 0.0 })
    }
}

/// New numbers of the splats of a chunk of the file.
struct TurnedSplats {
    positions: Vec<DVec3>,
    /// The splats' numbers before and after, one splat after the other.
    old: Vec<f64>,
    new: Vec<f64>,
    /// New bounds of positions and of scales, where any of these changed.
    bounds: [Option<ChunkRange>; 2],
}

impl CompressedPly {
    /// Turns the splats of one chunk of the file, which are `splats` of a chunk that was read.
    fn turned(
        &self,
        chunk: &VertexChunk,
        edited: &Edited,
        splats: Range<usize>,
        bytes: &[(&[u8], &[u8])],
    ) -> TurnedSplats {
        let places = GroupOffsets::new(self.harmonics);
        let mut turned =
            TurnedSplats { positions: Vec::new(), old: Vec::new(), new: Vec::new(), bounds: [None; 2] };
        let (mut numbers, mut some) = (Vec::new(), Vec::new());
        let (mut has_moved, mut has_stretched) = (false, false);
        let mut bounds = [ChunkRange::NONE; 2];
        for i in splats {
            let (rest, now) = (chunk.positions[i], edited.positions[i]);
            let is_there = rest.is_finite();
            has_moved |= is_there && rest.to_array().map(f64::to_bits) != now.to_array().map(f64::to_bits);
            turned.positions.push(if is_there { now } else { rest });
            self.numbers(bytes[i].0, bytes[i].1, &mut numbers);
            turned.old.extend_from_slice(&numbers);
            if let Some(gradient) = gradient(edited, i).filter(|_| is_there) {
                turn(&self.following, gradient, edited.mirrored, &mut numbers, &mut some);
            }
            let old = &turned.old[turned.old.len() - places.all..];
            numbers
                .iter_mut()
                .zip(old)
                .filter(|(new, _)| !new.is_finite())
                .for_each(|(new, old)| *new = *old);
            let scales = places.scale..places.scale + 3;
            has_stretched |= scales.clone().any(|i| numbers[i].to_bits() != old[i].to_bits());
            if is_there {
                bounds[0].include(now);
                bounds[1].include(DVec3::from_slice(&numbers[scales]));
            }
            turned.new.extend_from_slice(&numbers);
        }
        let [positions, scales] = bounds.map(|bounds| bounds.rounded());
        turned.bounds = [has_moved.then_some(positions), has_stretched.then_some(scales)];
        turned
    }

    /// Writes the part of a chunk of the file that a piece is of.
    fn put(&self, turned: &TurnedSplats, bytes: &[(&[u8], &[u8])], part: ChunkElement, to: &mut Vec<u8>) {
        let places = GroupOffsets::new(self.harmonics);
        if part == ChunkElement::Bounds {
            let at = to.len();
            to.extend_from_slice(bytes[0].0);
            for (group, bounds) in turned.bounds.iter().enumerate() {
                if let Some(bounds) = bounds {
                    bounds.put(&mut to[at..], group);
                }
            }
            return;
        }
        let each = turned.old.chunks_exact(places.all).zip(turned.new.chunks_exact(places.all));
        for (((_, packed), p), (old, new)) in bytes.iter().zip(&turned.positions).zip(each) {
            let is_new = |numbers: Range<usize>| old[numbers.clone()] != new[numbers];
            if part == ChunkElement::Harmonics {
                let coefficients = packed[PACKED..].iter().enumerate();
                to.extend(coefficients.map(|(i, byte)| match is_new(HARMONICS + i..HARMONICS + i + 1) {
                    true => packing::harmonic_byte(new[HARMONICS + i]),
                    false => *byte,
                }));
                continue;
            }
            let [mut position, mut rotation, mut scale, mut colour] = words(packed);
            if let Some(bounds) = turned.bounds[0].filter(|_| p.is_finite()) {
                position = packing::pack_three(bounds.parts(*p));
            }
            if is_new(places.rotation..places.all) {
                let q = &new[places.rotation..];
                rotation = packing::pack_quaternion([q[0], q[1], q[2], q[3]]);
            }
            if let Some(bounds) = turned.bounds[1].filter(|_| p.is_finite()) {
                scale = packing::pack_three(bounds.parts(DVec3::from_slice(&new[places.scale..])));
            }
            if is_new(places.opacity..places.scale) {
                colour = colour & !0xff | u32::from(packing::opacity_byte(new[places.opacity]));
            }
            to.extend([position, rotation, scale, colour].iter().flat_map(|word| word.to_le_bytes()));
        }
    }
}

/// The elements of the file, in its order.
#[derive(Debug, Clone, Copy, PartialEq)]
enum ChunkElement {
    Bounds,
    Splats,
    Harmonics,
}

impl SplatLayout for CompressedPly {
    fn read(&self, chunk: &mut VertexChunk, splats: Range<u64>) -> Result<()> {
        let VertexChunk { raw, records, first, .. } = chunk;
        raw.clear();
        records.clear();
        *first = splats.start;
        if splats.is_empty() {
            return Ok(());
        }
        let (size, count) = (self.bounds_bytes() as u64, (splats.end - splats.start) as usize);
        let chunks = splats.start / CHUNK..splats.end.div_ceil(CHUNK);
        let bytes = (chunks.end - chunks.start) * size;
        self.source.append_at(records, self.starts[0] + chunks.start * size, bytes as usize)?;
        let (mut packed, mut harmonics) = (Vec::new(), Vec::new());
        self.source.append_at(&mut packed, self.starts[1] + splats.start * PACKED as u64, count * PACKED)?;
        let each = self.harmonics;
        self.source.append_at(&mut harmonics, self.starts[2] + splats.start * each as u64, count * each)?;
        for (i, packed) in packed.chunks_exact(PACKED).enumerate() {
            let splat = splats.start + i as u64;
            if splat.is_multiple_of(CHUNK) {
                let at = ((splat / CHUNK - chunks.start) * size) as usize;
                raw.extend_from_slice(&records[at..at + size as usize]);
            }
            raw.extend_from_slice(packed);
            raw.extend_from_slice(&harmonics[i * each..(i + 1) * each]);
        }
        Ok(())
    }
}

impl Model for CompressedPly {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["ply"]
    }

    fn details(&self) -> Vec<String> {
        vec![format!(
            "positions in steps of at most {:.2e}, between the bounds of 256 splats each; quaternions of 1/723",
            self.info.step.max_element()
        )]
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(SplatReader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        to.iter_mut().for_each(Vec::clear);
        let mut numbers = Vec::new();
        for (bounds, packed) in self.splats(chunk) {
            self.numbers(bounds, packed, &mut numbers);
            to.iter_mut().zip(&numbers).for_each(|(to, number)| to.push(*number));
        }
        Ok(())
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn bytes_to_rewrite(&self) -> u64 {
        let again = if self.harmonics == 0 { 1 } else { 2 };
        self.info.bytes + again * self.info.vertex_bytes
    }

    fn following(&self) -> Option<&Following> {
        (!self.following.is_empty()).then_some(&self.following)
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.following = Following::declared(follow, &self.info.attributes, self.source.path())?;
        Ok(())
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

impl Rewritable for CompressedPly {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(ChunkPieces { model: self, at: 0, part: ChunkElement::Bounds, next: 0 }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = !self.following.is_empty();
        let mut positions = std::mem::take(&mut chunk.positions);
        positions.clear();
        let place = |(bounds, packed)| {
            ChunkRange::from_record(bounds, 0).interpolate(packing::three(words(packed)[0]))
        };
        positions.extend(self.splats(chunk).map(place));
        chunk.positions = positions;
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()> {
        let edited = version.edited;
        version.bytes.clear();
        let part =
            chunk.of_format.iter().find_map(|of| of.downcast_ref().copied()).unwrap_or(ChunkElement::Splats);
        let moved = chunk.positions.iter().zip(&edited.positions).enumerate();
        for (vertex, (_, now)) in moved.filter(|(_, (rest, _))| rest.is_finite()) {
            if let Some(axis) = (0..3).find(|axis| !(now[*axis] as f32).is_finite()) {
                return Err(Unfit { vertex, axis, value: now[axis] }.in_floats(&self.source, chunk.first));
            }
        }
        let bytes: Vec<_> = self.splats(chunk).collect();
        // Pieces begin with a chunk of the file.
        for start in (0..bytes.len()).step_by(CHUNK as usize) {
            let splats = start..bytes.len().min(start + CHUNK as usize);
            let turned = self.turned(chunk, edited, splats.clone(), &bytes);
            self.put(&turned, &bytes[splats], part, version.bytes);
        }
        Ok(())
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

/// Pieces of the file: the header, the bounds, the splats and their harmonics, each of these made of all
/// bytes of the splats; and the bytes behind them.
struct ChunkPieces<'a> {
    model: &'a CompressedPly,
    /// Byte of the header, or behind the splats, that comes next.
    at: u64,
    part: ChunkElement,
    /// The next splat of the part.
    next: u64,
}

impl Pieces for ChunkPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let CompressedPly { source, info, starts, harmonics, .. } = self.model;
        chunk.of_format.clear();
        if self.at < starts[0] {
            return self.copy(chunk, starts[0]);
        }
        while self.next == info.vertices && self.part != ChunkElement::Harmonics {
            let next = if self.part == ChunkElement::Bounds {
                ChunkElement::Splats
            } else {
                ChunkElement::Harmonics
            };
            (self.part, self.next) = (next, 0);
        }
        if self.next < info.vertices && !(self.part == ChunkElement::Harmonics && *harmonics == 0) {
            let end = info.vertices.min(self.next + CHUNK_VERTICES as u64);
            self.model.read(chunk, self.next..end)?;
            let count = (end - self.next) as usize;
            self.next = end;
            chunk.of_format.push(Box::new(self.part));
            return Ok(if self.part == ChunkElement::Splats {
                Piece::Vertices(count)
            } else {
                Piece::Normals
            });
        }
        self.at = self.at.max(starts[3]);
        if self.at < source.len() {
            return self.copy(chunk, source.len());
        }
        source.check_unchanged()?;
        Ok(Piece::End)
    }
}

impl ChunkPieces<'_> {
    /// Bytes that are not of splats.
    fn copy(&mut self, chunk: &mut VertexChunk, end: u64) -> Result<Piece> {
        chunk.raw.clear();
        let wanted = (end - self.at).min(COPIED as u64) as usize;
        self.at += self.model.source.append_at(&mut chunk.raw, self.at, wanted)? as u64;
        Ok(Piece::Bytes)
    }
}
