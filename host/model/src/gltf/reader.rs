//! Chunks of vertices from anywhere in the file.

use std::ops::Range;
use std::sync::OnceLock;

use glam::{DVec3, Vec3, Vec4};

use super::file::GltfModel;
use super::layout::{VectorRole, VertexSet};
use super::places::AccessorBytes;
use crate::{CHUNK_VERTICES, Result, Type, VertexChunk, VertexReader};

/// Most bytes that are read for a chunk at once, unless a vertex takes more.
pub(super) const CHUNK_BYTES: u64 = 2 << 20;

/// Reads so many floats at a byte.
#[inline(always)]
pub(super) fn floats<const N: usize>(bytes: &[u8], at: usize) -> [f32; N] {
    let mut floats = [0.0; N];
    for (float, bytes) in floats.iter_mut().zip(bytes[at..at + 4 * N].chunks_exact(4)) {
        let mut four = [0; 4];
        four.copy_from_slice(bytes);
        *float = f32::from_le_bytes(four);
    }
    floats
}

/// Bytes at which the element at `offset` begins in each row that has all of it: the last row may be cut off
/// behind that element.
pub(super) fn rows(stride: usize, bytes: usize, offset: usize, size: usize) -> impl Iterator<Item = usize> {
    (0..bytes).step_by(stride.max(1)).map(move |at| at + offset).take_while(move |at| at + size <= bytes)
}

impl GltfModel {
    /// Adds the positions in rows of a set's region.
    pub(super) fn add_positions(&self, set: &VertexSet, raw: &[u8], to: &mut Vec<DVec3>) {
        let region = &self.layout.regions[set.region];
        let offset = region.offset(VectorRole::Position).unwrap_or_default();
        let local =
            rows(region.stride as usize, raw.len(), offset, 12).map(|at| Vec3::from_array(floats(raw, at)));
        match &set.placement {
            None => to.extend(local.map(|p| p.as_dvec3())),
            Some(placement) => to.extend(local.map(|p| placement.position(p))),
        }
    }

    /// Adds normals that are so many bytes apart, the first of them at `offset`.
    pub(super) fn add_normals(
        &self,
        set: &VertexSet,
        raw: &[u8],
        (stride, offset): (u64, usize),
        to: &mut Vec<Vec3>,
    ) {
        let local = rows(stride as usize, raw.len(), offset, 12).map(|at| Vec3::from_array(floats(raw, at)));
        match &set.placement {
            None => to.extend(local),
            Some(placement) => to.extend(local.map(|n| placement.normal(n))),
        }
    }

    /// Adds tangents, likewise.
    pub(super) fn add_tangents(
        &self,
        set: &VertexSet,
        raw: &[u8],
        (stride, offset): (u64, usize),
        to: &mut Vec<Vec4>,
    ) {
        let local = rows(stride as usize, raw.len(), offset, 16).map(|at| Vec4::from_array(floats(raw, at)));
        match &set.placement {
            None => to.extend(local),
            Some(placement) => to.extend(local.map(|t| placement.tangent(t.truncate()).extend(t.w))),
        }
    }

    /// The set of a vertex, and its number.
    pub(super) fn set_of(&self, vertex: u64) -> Option<&VertexSet> {
        let sets = &self.layout.sets;
        sets.get(sets.partition_point(|set| set.first + set.place.count <= vertex))
    }

    /// Most rows of this length that are read at once.
    pub(super) fn most_rows(stride: u64) -> u64 {
        (CHUNK_BYTES / stride.max(1)).clamp(1, CHUNK_VERTICES as u64)
    }

    /// Colours of the vertices from one on, number by number.
    pub(super) fn read_colours(&self, vertices: Range<u64>, to: &mut [Vec<f64>]) -> Result<()> {
        let (mut raw, mut at) = (Vec::new(), vertices.start);
        to.iter_mut().for_each(Vec::clear);
        while let Some(set) = self.set_of(at).filter(|_| at < vertices.end) {
            let elements = at - set.first..(vertices.end - set.first).min(set.place.count);
            at = set.first + elements.end;
            let Some((place, kind)) =
                set.colours.zip(self.info.attributes.first()).map(|((p, _), a)| (p, a.kind))
            else {
                continue;
            };
            let curve = SrgbCurve::of_type(kind);
            self.container.read(&mut raw, place.bytes(elements))?;
            let AccessorBytes { stride, size, .. } = place;
            for at in rows(stride as usize, raw.len(), 0, size as usize) {
                let numbers = raw[at..at + size as usize].chunks_exact(kind.size());
                for (part, (to, bytes)) in to.iter_mut().zip(numbers).enumerate() {
                    let number = number(kind, bytes);
                    to.push(if part < 3 { curve.apply(number) } else { number });
                }
            }
        }
        Ok(())
    }
}

/// Conversion from linear light, as glTF has it, to the curve of sRGB, as all other formats have it: to
/// numbers of the same type, whole where they were.
#[derive(Clone, Copy)]
enum SrgbCurve {
    /// Conversion of bytes by a table.
    Bytes(&'static [u8; 256]),
    Whole(f64),
    Fractions,
}

impl SrgbCurve {
    fn of_type(kind: Type) -> Self {
        static BYTES: OnceLock<[u8; 256]> = OnceLock::new();
        match kind {
            Type::U8 => Self::Bytes(
                BYTES.get_or_init(|| std::array::from_fn(|i| (255.0 * srgb(i as f64 / 255.0)).round() as u8)),
            ),
            Type::U16 => Self::Whole(65535.0),
            _ => Self::Fractions,
        }
    }

    #[inline]
    fn apply(self, number: f64) -> f64 {
        match self {
            Self::Bytes(table) => f64::from(table[usize::from(number as u8)]),
            Self::Whole(full) => (full * srgb(number / full)).round(),
            Self::Fractions => srgb(number),
        }
    }
}

fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// A number of a colour.
fn number(kind: Type, bytes: &[u8]) -> f64 {
    match (kind, bytes) {
        (Type::U8, [a]) => f64::from(*a),
        (Type::U16, [a, b]) => f64::from(u16::from_le_bytes([*a, *b])),
        (Type::F32, [a, b, c, d]) => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
        _ => f64::NAN,
    }
}

/// Reads consecutive vertices.
pub(super) struct GltfReader<'a> {
    model: &'a GltfModel,
    range: Range<u64>,
    /// Most vertices of a chunk.
    chunk: u64,
    /// Bytes of normals that stand elsewhere.
    apart: Vec<u8>,
}

impl<'a> GltfReader<'a> {
    pub(super) fn new(model: &'a GltfModel, range: Range<u64>) -> Self {
        let end = range.end.min(model.layout.vertices);
        Self { model, range: range.start.min(end)..end, chunk: CHUNK_VERTICES as u64, apart: Vec::new() }
    }
}

impl VertexReader for GltfReader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES) as u64;
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let (model, first) = (self.model, self.range.start);
        let VertexChunk { positions, normals, raw, .. } = chunk;
        chunk.first = first;
        positions.clear();
        normals.clear();
        let Some(set) = model.set_of(first).filter(|_| !self.range.is_empty()) else {
            raw.clear();
            return Ok(false);
        };
        let region = &model.layout.regions[set.region];
        let start = first - set.first;
        let most = self.chunk.min(GltfModel::most_rows(region.stride));
        let elements = start..(start + most).min(set.place.count).min(self.range.end - set.first);
        self.range.start = set.first + elements.end;
        model.container.read(raw, region.window(elements.clone()))?;
        model.add_positions(set, raw, positions);
        if let Some(place) = set.normals.filter(|_| model.info.has_normals) {
            let beside = region
                .offset(VectorRole::Normal)
                .filter(|offset| region.bytes.start + *offset as u64 == place.start);
            if let Some(offset) = beside {
                model.add_normals(set, raw, (region.stride, offset), normals);
            } else {
                model.container.read(&mut self.apart, place.bytes(elements))?;
                model.add_normals(set, &self.apart, (place.stride, 0), normals);
            }
        }
        Ok(true)
    }
}
