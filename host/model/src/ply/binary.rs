//! Vertices of binary files: decoding a chunk, and patching edited numbers into its bytes.
//!
//! Each loop is written once, for any [`Codec`]; which one is looked up once per chunk.

use glam::{DVec3, Mat3, Vec3};

use super::header::Encoding;
use super::layout::{PlyLayout, PropertySlot};
use crate::Type;
use crate::follow::Following;
use crate::frame::is_finite;
use crate::unfit::{Unfit, same_normal};
use crate::{Edited, Scalar, VertexChunk};

/// Chunk of a binary file without its bytes, as it was read.
#[derive(Clone, Copy)]
pub(super) struct Rest<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) normals: &'a [Vec3],
    pub(super) spans: &'a [[u32; 2]],
}

/// Type of floating-point numbers in the file: reads and writes one in place.
trait Codec: Copy {
    fn get(self, raw: &[u8], at: usize) -> f64;
    fn put(self, raw: &mut [u8], at: usize, value: f64);
    /// Puts the value at a byte, or else the number that is there already: without a branch.
    fn put_if(self, raw: &mut [u8], at: usize, whether: bool, value: f64);
}

#[derive(Clone, Copy)]
struct F32<const BIG: bool>;

impl<const BIG: bool> Codec for F32<BIG> {
    #[inline(always)]
    fn get(self, raw: &[u8], at: usize) -> f64 {
        let bytes = bytes_at(raw, at);
        f64::from(if BIG { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) })
    }

    #[inline(always)]
    fn put(self, raw: &mut [u8], at: usize, value: f64) {
        let value = value as f32;
        let bytes = if BIG { value.to_be_bytes() } else { value.to_le_bytes() };
        raw[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    #[inline(always)]
    fn put_if(self, raw: &mut [u8], at: usize, whether: bool, value: f64) {
        let value = value as f32;
        let bytes = if BIG { value.to_be_bytes() } else { value.to_le_bytes() };
        let bytes = if whether { bytes } else { bytes_at(raw, at) };
        raw[at..at + bytes.len()].copy_from_slice(&bytes);
    }
}

#[derive(Clone, Copy)]
struct F64<const BIG: bool>;

impl<const BIG: bool> Codec for F64<BIG> {
    #[inline(always)]
    fn get(self, raw: &[u8], at: usize) -> f64 {
        let bytes = bytes_at(raw, at);
        if BIG { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) }
    }

    #[inline(always)]
    fn put(self, raw: &mut [u8], at: usize, value: f64) {
        let bytes = if BIG { value.to_be_bytes() } else { value.to_le_bytes() };
        raw[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    #[inline(always)]
    fn put_if(self, raw: &mut [u8], at: usize, whether: bool, value: f64) {
        let bytes = if BIG { value.to_be_bytes() } else { value.to_le_bytes() };
        let bytes = if whether { bytes } else { bytes_at(raw, at) };
        raw[at..at + bytes.len()].copy_from_slice(&bytes);
    }
}

/// Float or double, known at run time alone: for vertices that mix both.
#[derive(Clone, Copy)]
struct Any<const BIG: bool>(Scalar);

impl<const BIG: bool> Codec for Any<BIG> {
    fn get(self, raw: &[u8], at: usize) -> f64 {
        match self.0 {
            Scalar::F32 => F32::<BIG>.get(raw, at),
            Scalar::F64 => F64::<BIG>.get(raw, at),
        }
    }

    fn put(self, raw: &mut [u8], at: usize, value: f64) {
        match self.0 {
            Scalar::F32 => F32::<BIG>.put(raw, at, value),
            Scalar::F64 => F64::<BIG>.put(raw, at, value),
        }
    }

    fn put_if(self, raw: &mut [u8], at: usize, whether: bool, value: f64) {
        match self.0 {
            Scalar::F32 => F32::<BIG>.put_if(raw, at, whether, value),
            Scalar::F64 => F64::<BIG>.put_if(raw, at, whether, value),
        }
    }
}

#[inline(always)]
pub(super) fn bytes_at<const N: usize>(raw: &[u8], at: usize) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.copy_from_slice(&raw[at..at + N]);
    bytes
}

/// The integer of type `kind` that `raw` begins with.
#[inline]
pub(super) fn integer(kind: Type, big: bool, raw: &[u8]) -> i64 {
    macro_rules! read {
        ($t:ty) => {{
            let bytes = bytes_at(raw, 0);
            i64::from(if big { <$t>::from_be_bytes(bytes) } else { <$t>::from_le_bytes(bytes) })
        }};
    }
    match kind {
        Type::I8 => read!(i8),
        Type::U8 => read!(u8),
        Type::I16 => read!(i16),
        Type::U16 => read!(u16),
        Type::I32 => read!(i32),
        // The header lets no list be counted in floating-point numbers, and no such list is read as corners.
        Type::U32 | Type::F32 | Type::F64 => read!(u32),
    }
}

/// Runs `$body` with `$codecs` for the three `$components`: one loop for each common case.
macro_rules! with_codecs {
    ($encoding:expr, $components:expr, $codecs:ident => $body:expr) => {{
        use Scalar::{F32 as S, F64 as D};
        match ($encoding == Encoding::Big, $components.map(|c| c.scalar)) {
            (false, [S, S, S]) => {
                let $codecs = [F32::<false>; 3];
                $body
            }
            (true, [S, S, S]) => {
                let $codecs = [F32::<true>; 3];
                $body
            }
            (false, [D, D, D]) => {
                let $codecs = [F64::<false>; 3];
                $body
            }
            (true, [D, D, D]) => {
                let $codecs = [F64::<true>; 3];
                $body
            }
            (false, mixed) => {
                let $codecs = mixed.map(Any::<false>);
                $body
            }
            (true, mixed) => {
                let $codecs = mixed.map(Any::<true>);
                $body
            }
        }
    }};
}

/// Runs `$body` with `$places`, which gives for each vertex of a chunk where in `raw` its three `$components`
/// lie, the first of which has index `$first`.
macro_rules! with_places {
    ($layout:expr, $raw:expr, $spans:expr, $first:expr, $components:expr, $places:ident => $body:expr) => {
        match $layout.stride {
            Some(stride) => {
                let [a, b, c] = $components.map(|c| c.offset);
                let $places = (0..$raw.len() / stride).map(move |i| {
                    let record = i * stride;
                    [record + a, record + b, record + c]
                });
                $body
            }
            None => {
                let of_vertex = $spans.chunks_exact($layout.components.len());
                let $places = of_vertex.map(|s| [0, 1, 2].map(|i| s[$first + i][0] as usize));
                $body
            }
        }
    };
}

/// Fills the chunk's positions and normals from its bytes.
pub(super) fn decode(layout: &PlyLayout, chunk: &mut VertexChunk) {
    let VertexChunk { positions, normals, raw, spans, .. } = chunk;
    let raw = raw.as_slice();
    positions.clear();
    normals.clear();
    let components = layout.triple(0);
    with_codecs!(layout.encoding, components, codecs => {
        with_places!(layout, raw, spans, 0, components, places => {
            positions.extend(places.map(|at| DVec3::from_array(get(codecs, raw, at))));
        });
    });
    if layout.has_normals() {
        let components = layout.triple(3);
        with_codecs!(layout.encoding, components, codecs => {
            with_places!(layout, raw, spans, 3, components, places => {
                normals.extend(places.map(|at| Vec3::from_array(get(codecs, raw, at).map(|v| v as f32))));
            });
        });
    }
}

#[inline(always)]
fn get<C: Codec>(codecs: [C; 3], raw: &[u8], at: [usize; 3]) -> [f64; 3] {
    [codecs[0].get(raw, at[0]), codecs[1].get(raw, at[1]), codecs[2].get(raw, at[2])]
}

/// Writes those edited positions and normals into `raw`, the chunk's bytes, that differ from those at rest.
pub(super) fn patch(
    layout: &PlyLayout,
    rest: Rest<'_>,
    edited: &Edited,
    raw: &mut [u8],
) -> Result<(), Unfit> {
    let spans = rest.spans;
    let components = layout.triple(0);
    with_codecs!(layout.encoding, components, codecs => {
        with_places!(layout, raw, spans, 0, components, places => {
            patch_positions(codecs, raw, places, rest.positions, &edited.positions)?;
        });
    });
    // Empty where there are none or they keep their bytes.
    if !edited.normals.is_empty() {
        let components = layout.triple(3);
        with_codecs!(layout.encoding, components, codecs => {
            with_places!(layout, raw, spans, 3, components, places => {
                patch_normals(codecs, raw, places, rest, &edited.normals);
            });
        });
    }
    Ok(())
}

fn patch_positions<C: Codec>(
    codecs: [C; 3],
    raw: &mut [u8],
    places: impl Iterator<Item = [usize; 3]> + Clone,
    rest: &[DVec3],
    edited: &[DVec3],
) -> Result<(), Unfit> {
    let mut fits = true;
    for ((old, new), at) in rest.iter().zip(edited).zip(places.clone()) {
        if !is_finite(*old) {
            continue;
        }
        // A coordinate that did not change gets the bytes that it had: writing it takes no branch.
        for (c, new) in new.to_array().into_iter().enumerate() {
            codecs[c].put(raw, at[c], new);
            fits &= codecs[c].get(raw, at[c]).is_finite();
        }
    }
    if fits {
        return Ok(());
    }
    // A finite number may be too large for the type that the file keeps it in.
    let mut of_finite =
        rest.iter().zip(edited).enumerate().zip(places).filter(|((_, (old, _)), _)| is_finite(**old));
    let unfit = |((vertex, (_, new)), at): ((usize, (_, &DVec3)), [usize; 3])| {
        let axis = (0..3).find(|c| !codecs[*c].get(raw, at[*c]).is_finite())?;
        Some(Unfit { vertex, axis, value: new[axis] })
    };
    of_finite.find_map(unfit).map_or(Ok(()), Err)
}

fn patch_normals<C: Codec>(
    codecs: [C; 3],
    raw: &mut [u8],
    places: impl Iterator<Item = [usize; 3]>,
    rest: Rest<'_>,
    edited: &[Vec3],
) {
    let of_vertex = rest.positions.iter().zip(rest.normals).zip(edited).zip(places);
    for (((position, old), new), at) in of_vertex {
        if !is_finite(*position) {
            continue;
        }
        for (c, (old, new)) in old.to_array().into_iter().zip(new.to_array()).enumerate() {
            codecs[c].put_if(raw, at[c], !same_normal(old, new), f64::from(new));
        }
    }
}

/// Turns the attributes that follow in `raw`, the bytes of whole vertices, of which these had finite
/// positions.
pub(super) fn turn(
    layout: &PlyLayout,
    following: &Following,
    rest: Rest<'_>,
    edited: &Edited,
    raw: &mut [u8],
) {
    if layout.encoding == Encoding::Big {
        turn_all::<true>(layout, following, rest, edited, raw);
    } else {
        turn_all::<false>(layout, following, rest, edited, raw);
    }
}

fn turn_all<const BIG: bool>(
    layout: &PlyLayout,
    following: &Following,
    rest: Rest<'_>,
    edited: &Edited,
    raw: &mut [u8],
) {
    let first = layout.following();
    let components = &layout.components[first..];
    let (mut old, mut new) = (Vec::new(), Vec::new());
    let moving = edited.gradients.iter().zip(rest.positions).enumerate();
    for (vertex, (gradient, _)) in moving.filter(|(_, (g, p))| **g != Mat3::IDENTITY && p.is_finite()) {
        let at = |c: usize| match layout.stride {
            Some(stride) => vertex * stride + components[c].offset,
            None => rest.spans[vertex * layout.components.len() + first + c][0] as usize,
        };
        old.clear();
        old.extend(components.iter().enumerate().map(|(c, of)| Any::<BIG>(of.scalar).get(raw, at(c))));
        new.clone_from(&old);
        following.turn(gradient, edited.mirrored, &mut new);
        for (c, (old, new)) in old.iter().zip(&new).enumerate() {
            let new = components[c].scalar.round(*new);
            if new.to_bits() != old.to_bits() && new.is_finite() {
                Any::<BIG>(components[c].scalar).put(raw, at(c), new);
            }
        }
    }
}

/// Takes the normals out of `raw`, the bytes of whole vertices.
pub(super) fn cut_normals(layout: &PlyLayout, spans: &[[u32; 2]], raw: &mut Vec<u8>) {
    let normals = || layout.file_order.iter().copied().filter(|c| (3..layout.following()).contains(c));
    match layout.stride {
        Some(stride) => {
            let in_record: Vec<[usize; 2]> = normals()
                .map(|c| &layout.components[c])
                .map(|c| [c.offset, c.offset + c.scalar.size()])
                .collect();
            let records = (0..raw.len()).step_by(stride);
            cut(raw, records.flat_map(|record| in_record.iter().map(move |span| span.map(|at| record + at))));
        }
        None => {
            let of_vertex = spans.chunks_exact(layout.components.len());
            cut(raw, of_vertex.flat_map(|spans| normals().map(|c| spans[c].map(|at| at as usize))));
        }
    }
}

/// Takes spans out of `raw`, which come in ascending order and do not overlap.
fn cut(raw: &mut Vec<u8>, spans: impl Iterator<Item = [usize; 2]>) {
    let (mut kept, mut at) = (0, 0);
    for [start, end] in spans {
        raw.copy_within(at..start, kept);
        kept += start - at;
        at = end;
    }
    raw.copy_within(at.., kept);
    kept += raw.len() - at;
    raw.truncate(kept);
}

/// Goes over the record that `bytes` begin with: notes where its components lie (in the chunk's bytes, where
/// the record begins at `base`) and returns its length, or `None` if it is longer than `bytes`.
///
/// The error is the length of a list that cannot be.
pub(super) fn scan(
    layout: &PlyLayout,
    bytes: &[u8],
    base: usize,
    spans: &mut [[u32; 2]],
) -> Result<Option<usize>, String> {
    let mut at = 0usize;
    for slot in &layout.slots {
        match *slot {
            PropertySlot::Other { size } => at += size,
            PropertySlot::Component { index, size } => {
                spans[index] = [base + at, base + at + size].map(|v| v as u32);
                at += size;
            }
            PropertySlot::List { count, item } => {
                if bytes.len() < at.saturating_add(count.size()) {
                    return Ok(None);
                }
                let length = integer(count, layout.encoding == Encoding::Big, &bytes[at..]);
                let length = usize::try_from(length).map_err(|_| length.to_string())?;
                at = at.saturating_add(count.size()).saturating_add(length.saturating_mul(item.size()));
            }
        }
        if at > bytes.len() {
            return Ok(None);
        }
    }
    Ok(Some(at))
}
