//! SPZ of Niantic, versions 2 and 3: a header and one array after the other (positions of 24 bits, opacities,
//! colours, logarithms of scales, quaternions, harmonics), compressed as a whole by gzip.
//!
//! The file is unpacked into the cache once. The new file goes through gzip again, array by array: splats are
//! carried over once for each array of numbers that turn, each time with the same result.
//!
//! A chunk's bytes are those of its splats, with all of a splat's numbers side by side.

use std::io::{self, Read, Write};
use std::ops::Range;
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;

use super::{GroupOffsets, HARMONICS, SplatLayout, SplatReader, gradient, info, packing, turn};
use crate::cache::{CachedContent, Making};
use crate::follow::{Follow, Following};
use crate::pipeline::{self, Piece, PieceVersion, Pieces, Rewritable};
use crate::source::SourceFile;
use crate::{
    CHUNK_VERTICES, Edit, Edited, Error, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting,
    Summary, VertexChunk, VertexReader,
};

/// First bytes of the unpacked file.
const MAGIC: [u8; 4] = *b"NGSP";

/// Bytes of the header.
const HEADER: u64 = 16;

/// Bytes that are unpacked at a time.
const BLOCK: usize = 1 << 20;

/// Largest ratio of a file's unpacked size to its size, as the format of the compression allows it.
const MOST_PACKED: u64 = 1100;

/// Advice about a file that is malformed.
const HINT: &str = "the file is damaged, or no SPZ of version 2 or 3: copy or export it again";

/// Whole numbers of a position lie between minus this and this.
const REACH: f64 = (1 << 23) as f64;

/// The arrays, in the file's order.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Array {
    Positions,
    Opacities,
    Colours,
    Scales,
    Quaternions,
    Harmonics,
}

const ARRAYS: [Array; 6] =
    [Array::Positions, Array::Opacities, Array::Colours, Array::Scales, Array::Quaternions, Array::Harmonics];

/// An SPZ file.
#[derive(Debug)]
struct Spz {
    source: SourceFile,
    unpacked: SourceFile,
    info: ModelInfo,
    following: Following,
    /// Bytes of a splat in each array.
    sizes: [usize; 6],
    /// Whole numbers of a position to a unit.
    unit: f64,
}

/// Whether a file with these first bytes is compressed as SPZ is.
pub(crate) fn is_gzip(start: &[u8]) -> bool {
    start.starts_with(&[0x1f, 0x8b])
}

/// # Errors
/// The file is no SPZ, or of another version; it is cut off or damaged; there is no room for what is
/// unpacked.
pub(crate) fn open(source: SourceFile, making: &Making<'_>) -> Result<Box<dyn Model>> {
    let damaged = |what: &str| source.malformed(what, HINT);
    let mut header = [0; HEADER as usize];
    let unknown = |e| damaged("it is compressed by gzip, and its content is of no known format").because(e);
    reader(&source).read_exact(&mut header).map_err(unknown)?;
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let [version, count] = [word(4), word(8)];
    let (degree, fraction) = (usize::from(header[12]), i32::from(header[13]));
    if header[..4] != MAGIC {
        return Err(damaged("it is compressed by gzip, and its content is no SPZ"));
    }
    if !(2..=3).contains(&version) {
        return Err(damaged(&format!("its SPZ is of version {version}, and versions 2 and 3 are known")));
    }
    if degree > 3 || fraction > 23 {
        let what = format!("its SPZ has harmonics of degree {degree} and {fraction} bits of fractions");
        return Err(damaged(&what));
    }
    let harmonics = 3 * ((degree + 1).pow(2) - 1);
    let sizes = [9, 1, 3, 3, if version == 2 { 3 } else { 4 }, harmonics];
    let each: usize = sizes.iter().sum();
    let bytes = HEADER + u64::from(count) * each as u64;
    if bytes / MOST_PACKED > source.len() {
        return Err(damaged(&format!(
            "its header says {count} splats, but the file has {} bytes in all",
            source.len()
        )));
    }
    let unpacked = unpack(&source, (count, bytes), making)?;
    let mut info = info(format!("SPZ {version}"), &source, u64::from(count), each as u64, harmonics);
    let unit = 2f64.powi(fraction);
    info.step = DVec3::splat(1.0 / unit);
    let following = Following::declared(&Follow::default(), &info.attributes, source.path())?;
    Ok(Box::new(Spz { source, unpacked, info, following, sizes, unit }))
}

/// The bytes of a file that is compressed by gzip.
fn reader(source: &SourceFile) -> GzDecoder<SourceReader<'_>> {
    GzDecoder::new(SourceReader { source, at: 0 })
}

/// Unpacks so many splats, of so many bytes with the header, into the cache.
fn unpack(source: &SourceFile, (count, bytes): (u32, u64), making: &Making<'_>) -> Result<SourceFile> {
    let damaged = |what: &str| source.malformed(what, HINT);
    let need = CachedContent { what: "its splats are unpacked", bytes: bytes..=bytes, meanwhile: 0 };
    making.cache.get(source, &need, making.progress, |to| {
        let (mut reader, mut block, mut at) = (reader(source), vec![0; BLOCK], 0);
        loop {
            making.progress.check()?;
            let read = reader.read(&mut block);
            let read = read.map_err(|e| damaged(&format!("its compressed bytes are damaged: {e}")))?;
            if at + read as u64 > bytes || (read == 0 && at < bytes) {
                let what =
                    format!("its header says {count} splats, but another number of bytes stands for them");
                return Err(damaged(&what));
            }
            if read == 0 {
                return Ok(bytes);
            }
            to.write_at(&block[..read], at)?;
            at += read as u64;
        }
    })
}

struct SourceReader<'a> {
    source: &'a SourceFile,
    at: u64,
}

impl Read for SourceReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.source.read_at(buffer, self.at).map_err(io::Error::other)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Spz {
    /// Range of an array among the numbers of a splat.
    fn place(&self, array: Array) -> Range<usize> {
        let start = self.sizes[..array as usize].iter().sum();
        start..start + self.sizes[array as usize]
    }

    /// Bytes of a splat.
    fn each(&self) -> usize {
        self.sizes.iter().sum()
    }

    fn position(&self, splat: &[u8]) -> DVec3 {
        DVec3::from_array([0, 3, 6].map(|at| {
            // The sign is that of the highest byte.
            let whole = i32::from_le_bytes([0, splat[at], splat[at + 1], splat[at + 2]]) >> 8;
            f64::from(whole) / self.unit
        }))
    }

    /// Appends all numbers of a splat besides its position, in the order of the attributes.
    fn numbers(&self, splat: &[u8], to: &mut Vec<f64>) {
        let at = |array| &splat[self.place(array)];
        to.clear();
        to.extend(at(Array::Colours).iter().map(|c| (f64::from(*c) / 255.0 - 0.5) / 0.15));
        let harmonics = at(Array::Harmonics);
        let coefficients = harmonics.len() / 3;
        let coefficient = |i: usize| harmonics[i % coefficients * 3 + i / coefficients];
        to.extend((0..harmonics.len()).map(|i| (f64::from(coefficient(i)) - 128.0) / 128.0));
        to.push(packing::opacity(at(Array::Opacities)[0]));
        to.extend(at(Array::Scales).iter().map(|s| f64::from(*s) / 16.0 - 10.0));
        let [x, y, z, w] = quaternion(at(Array::Quaternions));
        to.extend([w, x, y, z]);
    }

    /// Appends the new bytes of an array of one splat.
    fn put(&self, array: Array, splat: &[u8], old: &[f64], new: &[f64], to: &mut Vec<u8>) {
        let places = GroupOffsets::new(self.sizes[Array::Harmonics as usize]);
        let start = to.len();
        to.extend_from_slice(&splat[self.place(array)]);
        let bytes = &mut to[start..];
        let is_new = |i: usize| old[i].to_bits() != new[i].to_bits() && new[i].is_finite();
        match array {
            Array::Positions | Array::Colours => {}
            Array::Opacities if is_new(places.opacity) => {
                bytes[0] = packing::opacity_byte(new[places.opacity])
            }
            Array::Opacities => {}
            Array::Scales => {
                for i in (0..3).filter(|i| is_new(places.scale + i)) {
                    // A conversion saturates.
                    bytes[i] = ((new[places.scale + i] + 10.0) * 16.0).round() as u8;
                }
            }
            Array::Quaternions => {
                if (places.rotation..places.all).any(is_new) {
                    let [w, x, y, z] = [0, 1, 2, 3].map(|i| new[places.rotation + i]);
                    put_quaternion([x, y, z, w], bytes);
                }
            }
            Array::Harmonics => {
                let coefficients = bytes.len() / 3;
                for i in (0..bytes.len()).filter(|i| is_new(HARMONICS + i)) {
                    bytes[i % coefficients * 3 + i / coefficients] =
                        (new[HARMONICS + i] * 128.0 + 128.0).round() as u8;
                }
            }
        }
    }

    /// The positions of a chunk's splats.
    fn put_positions(&self, chunk: &VertexChunk, edited: &Edited, to: &mut Vec<u8>) -> Result<()> {
        let each = chunk.raw.chunks_exact(self.each()).zip(chunk.positions.iter().zip(&edited.positions));
        for (i, (splat, (rest, now))) in each.enumerate() {
            let start = to.len();
            to.extend_from_slice(&splat[..9]);
            for axis in (0..3).filter(|axis| rest[*axis].to_bits() != now[*axis].to_bits()) {
                let whole = (now[axis] * self.unit).round();
                if !(-REACH..REACH).contains(&whole) {
                    let (vertex, path) = (chunk.first + i as u64, self.source.path().display());
                    let what =
                        format!("{path}: vertex {vertex} moves to {}, too far for its 24 bits", now[axis]);
                    return Err(Error::degenerate(what, "move it less, or write a .ply file"));
                }
                to[start + 3 * axis..][..3].copy_from_slice(&(whole as i32).to_le_bytes()[..3]);
            }
        }
        Ok(())
    }

    /// Whether an array may change: positions may, colours do not, and the others only where splats turn.
    fn may_change(&self, array: Array) -> bool {
        match array {
            Array::Positions => true,
            Array::Colours => false,
            _ => self.sizes[array as usize] > 0 && !self.following.is_empty(),
        }
    }
}

/// A quaternion, real part last: three bytes of the others, with the real part not negative, or the smallest
/// three.
fn quaternion(bytes: &[u8]) -> [f64; 4] {
    let (mut q, largest) = match *bytes {
        [a, b, c, d] => {
            let packed = u32::from_le_bytes([a, b, c, d]);
            let (largest, mut q, mut shift) = ((packed >> 30) as usize, [0.0; 4], 0);
            for i in (0..4).rev().filter(|i| *i != largest) {
                let part = packing::part(packed >> shift, 9) * 0.5f64.sqrt();
                q[i] = if packed >> (shift + 9) & 1 == 1 { -part } else { part };
                shift += 10;
            }
            (q, largest)
        }
        _ => {
            let part = |i: usize| bytes.get(i).map_or(0.0, |byte| f64::from(*byte) / 127.5 - 1.0);
            ([part(0), part(1), part(2), 0.0], 3)
        }
    };
    q[largest] = (1.0 - q.iter().map(|x| x * x).sum::<f64>()).max(0.0).sqrt();
    q
}

/// Packs a quaternion of any length and sign.
fn put_quaternion(q: [f64; 4], bytes: &mut [u8]) {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if bytes.len() == 3 {
        let unit = length.copysign(q[3]);
        bytes.iter_mut().zip(q).for_each(|(byte, x)| *byte = ((x / unit + 1.0) * 127.5).round() as u8);
        return;
    }
    let largest = (1..4).fold(0, |best: usize, i| if q[i].abs() > q[best].abs() { i } else { best });
    let unit = length.copysign(q[largest]);
    let others = q.iter().enumerate().filter(|(i, _)| *i != largest);
    let packed = others.fold(largest as u32, |packed, (_, x)| {
        let x = x / unit;
        packed << 10 | u32::from(x < 0.0) << 9 | packing::bits(x.abs() * 2f64.sqrt(), 9)
    });
    bytes.copy_from_slice(&packed.to_le_bytes());
}

impl SplatLayout for Spz {
    fn read(&self, chunk: &mut VertexChunk, splats: Range<u64>) -> Result<()> {
        let (count, each) = ((splats.end - splats.start) as usize, self.each());
        chunk.first = splats.start;
        chunk.raw.clear();
        chunk.raw.resize(count * each, 0);
        let (mut bytes, mut start) = (Vec::new(), HEADER);
        for array in ARRAYS {
            let (size, place) = (self.sizes[array as usize], self.place(array));
            bytes.clear();
            self.unpacked.append_at(&mut bytes, start + splats.start * size as u64, count * size)?;
            start += self.info.vertices * size as u64;
            if size > 0 {
                for (to, from) in chunk.raw.chunks_exact_mut(each).zip(bytes.chunks_exact(size)) {
                    to[place.clone()].copy_from_slice(from);
                }
            }
        }
        Ok(())
    }
}

impl Model for Spz {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["spz"]
    }

    fn details(&self) -> Vec<String> {
        let step = 1.0 / self.unit;
        vec![format!("positions in steps of {step:.2e}, logarithms of scales of 1/16, harmonics of 1/128")]
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(SplatReader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        to.iter_mut().for_each(Vec::clear);
        let mut numbers = Vec::new();
        for splat in chunk.raw.chunks_exact(self.each()) {
            self.numbers(splat, &mut numbers);
            to.iter_mut().zip(&numbers).for_each(|(to, number)| to.push(*number));
        }
        Ok(())
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn has_room_for(&self, p: DVec3) -> bool {
        (p * self.unit).abs().max_element() < REACH - 1.0
    }

    fn bytes_to_rewrite(&self) -> u64 {
        let read = |array| if self.may_change(array) { self.each() } else { self.sizes[array as usize] };
        HEADER + self.info.vertices * ARRAYS.into_iter().map(read).sum::<usize>() as u64
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
        if how.pieces_done > 0 {
            let what = format!(
                "{}: an SPZ file is compressed as a whole, and cannot be gone on with",
                self.source.path().display()
            );
            return Err(Error::argument(what, "leave out --resume, or write a .ply file"));
        }
        let mut packed: Vec<CompressedOutput<'_>> =
            outputs.iter_mut().map(|output| CompressedOutput::new(&mut **output)).collect();
        let mut outputs: Vec<&mut dyn Output> =
            packed.iter_mut().map(|output| output as &mut dyn Output).collect();
        pipeline::rewrite(self, &mut outputs, how, edit, progress)?;
        self.following.tell(self.source.path(), progress);
        Ok(())
    }
}

/// Output that compresses the bytes that it gets.
struct CompressedOutput<'a> {
    to: &'a mut dyn Output,
    encoder: GzEncoder<Vec<u8>>,
}

impl<'a> CompressedOutput<'a> {
    fn new(to: &'a mut dyn Output) -> Self {
        Self { to, encoder: GzEncoder::new(Vec::new(), Compression::default()) }
    }
}

impl Output for CompressedOutput<'_> {
    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()> {
        self.encoder.write_all(bytes)?;
        let ready = std::mem::take(self.encoder.get_mut());
        self.to.write_pieces(pieces, &ready, source_bytes, summary)
    }

    fn patch(&mut self, _at: u64, _bytes: &[u8]) -> io::Result<()> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "compressed bytes cannot be replaced"))
    }

    fn finish(&mut self) -> io::Result<()> {
        self.encoder.try_finish()?;
        let ready = std::mem::take(self.encoder.get_mut());
        self.to.write_piece(&ready, 0, &Summary::default())?;
        self.to.finish()
    }
}

impl Rewritable for Spz {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        Ok(Box::new(SpzPieces { model: self, has_header: false, array: 0, next: 0 }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = !self.following.is_empty();
        chunk.positions.clear();
        chunk.positions.extend(chunk.raw.chunks_exact(self.each()).map(|splat| self.position(splat)));
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()> {
        let edited = version.edited;
        version.bytes.clear();
        let array =
            chunk.of_format.iter().find_map(|of| of.downcast_ref().copied()).unwrap_or(Array::Positions);
        if array == Array::Positions {
            return self.put_positions(chunk, edited, version.bytes);
        }
        let (mut old, mut new, mut some) = (Vec::new(), Vec::new(), Vec::new());
        for (i, splat) in chunk.raw.chunks_exact(self.each()).enumerate() {
            let Some(gradient) = gradient(edited, i) else {
                version.bytes.extend_from_slice(&splat[self.place(array)]);
                continue;
            };
            self.numbers(splat, &mut old);
            new.clone_from(&old);
            turn(&self.following, gradient, edited.mirrored, &mut new, &mut some);
            self.put(array, splat, &old, &new, version.bytes);
        }
        Ok(())
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

/// The header, and the arrays one after the other.
struct SpzPieces<'a> {
    model: &'a Spz,
    has_header: bool,
    array: usize,
    next: u64,
}

impl Pieces for SpzPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let Spz { info, sizes, unpacked, source, .. } = self.model;
        chunk.of_format.clear();
        if !std::mem::replace(&mut self.has_header, true) {
            chunk.raw.clear();
            unpacked.append_at(&mut chunk.raw, 0, HEADER as usize)?;
            return Ok(Piece::Bytes);
        }
        if self.next == info.vertices || self.array < sizes.len() && sizes[self.array] == 0 {
            (self.array, self.next) = (self.array + 1, 0);
        }
        let Some(array) = ARRAYS.get(self.array).filter(|_| info.vertices > 0 && sizes[self.array] > 0)
        else {
            source.check_unchanged()?;
            return Ok(Piece::End);
        };
        let splats = self.next..info.vertices.min(self.next + CHUNK_VERTICES as u64);
        self.next = splats.end;
        let count = (splats.end - splats.start) as usize;
        if !self.model.may_change(*array) {
            let before: usize = sizes[..self.array].iter().sum();
            let start = HEADER + info.vertices * before as u64;
            chunk.raw.clear();
            let size = sizes[self.array];
            unpacked.append_at(&mut chunk.raw, start + splats.start * size as u64, count * size)?;
            return Ok(Piece::Bytes);
        }
        self.model.read(chunk, splats)?;
        chunk.of_format.push(Box::new(*array));
        Ok(if *array == Array::Positions { Piece::Vertices(count) } else { Piece::Normals })
    }
}
