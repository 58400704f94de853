//! Numbers of vertices that are neither position nor normal: found in the bytes of a chunk, by those who ask
//! for them.

use super::binary::{bytes_at, integer};
use super::header::{Encoding, quoted};
use super::layout::{PlyLayout, PropertySlot};
use crate::Type;
use crate::VertexChunk;
use crate::text::{self, next_word};

/// Vertex of a chunk with a word that is no number, and the attribute of the word.
#[derive(Debug, PartialEq)]
pub(super) struct NotANumber {
    pub(super) vertex: usize,
    pub(super) attribute: usize,
    pub(super) word: String,
}

/// Fills each list with the numbers of one attribute, in the order of the first attributes.
pub(super) fn decode(layout: &PlyLayout, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<(), NotANumber> {
    to.iter_mut().for_each(Vec::clear);
    match (layout.stride, layout.encoding) {
        (Some(stride), encoding) => {
            for ((values, (_, offset)), attribute) in
                to.iter_mut().zip(&layout.places).zip(&layout.attributes)
            {
                let records = chunk.raw.chunks_exact(stride);
                values.extend(
                    records.map(|r| number(attribute.kind, encoding == Encoding::Big, &r[*offset..])),
                );
            }
        }
        (None, Encoding::Ascii) => return decode_words(layout, chunk, to),
        (None, encoding) => decode_records(layout, chunk, encoding == Encoding::Big, to),
    }
    Ok(())
}

/// Fills each list with the numbers of the attribute at one of these places, if all records have the same
/// length.
pub(super) fn decode_some(
    layout: &PlyLayout,
    chunk: &VertexChunk,
    places: &[usize],
    to: &mut [Vec<f64>],
) -> bool {
    let Some(stride) = layout.stride else { return false };
    for (values, place) in to.iter_mut().zip(places) {
        let (kind, (_, offset)) = (layout.attributes[*place].kind, layout.places[*place]);
        let records = chunk.raw.chunks_exact(stride);
        values.clear();
        values.extend(records.map(|r| number(kind, layout.encoding == Encoding::Big, &r[offset..])));
    }
    true
}

/// The number of type `kind` that `raw` begins with.
#[inline]
fn number(kind: Type, big: bool, raw: &[u8]) -> f64 {
    match kind {
        Type::F32 if big => f64::from(f32::from_be_bytes(bytes_at(raw, 0))),
        Type::F32 => f64::from(f32::from_le_bytes(bytes_at(raw, 0))),
        Type::F64 if big => f64::from_be_bytes(bytes_at(raw, 0)),
        Type::F64 => f64::from_le_bytes(bytes_at(raw, 0)),
        whole => integer(whole, big, raw) as f64,
    }
}

/// Decodes binary records with lists, which the reader has gone over before.
fn decode_records(layout: &PlyLayout, chunk: &VertexChunk, big: bool, to: &mut [Vec<f64>]) {
    let (raw, mut at) = (&chunk.raw, 0);
    for _ in 0..chunk.len() {
        let mut wanted = to.iter_mut().zip(&layout.places).zip(&layout.attributes).peekable();
        for (i, slot) in layout.slots.iter().enumerate() {
            if let Some(((values, _), attribute)) = wanted.next_if(|((_, (slot, _)), _)| *slot == i) {
                values.push(number(attribute.kind, big, &raw[at..]));
            }
            at += match *slot {
                PropertySlot::Other { size } | PropertySlot::Component { size, .. } => size,
                PropertySlot::List { count, item } => {
                    let length = integer(count, big, &raw[at..]);
                    count.size() + usize::try_from(length).unwrap_or(0) * item.size()
                }
            };
        }
    }
}

/// Decodes text, which the reader has gone over before.
fn decode_words(layout: &PlyLayout, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<(), NotANumber> {
    let (raw, mut at) = (chunk.raw.as_slice(), 0);
    // The last word of a chunk ends with it.
    let mut next = || {
        let (start, end) = next_word(raw, at, true).unwrap_or((at, at));
        at = end;
        &raw[start..end]
    };
    for vertex in 0..chunk.len() {
        let mut wanted = to.iter_mut().zip(&layout.places).enumerate().peekable();
        for (i, slot) in layout.slots.iter().enumerate() {
            let word = next();
            if let PropertySlot::List { .. } = slot {
                for _ in 0..text::integer(word).unwrap_or(0) {
                    next();
                }
            }
            // Colours may be the bytes of one number.
            while let Some((attribute, (values, (_, byte)))) =
                wanted.next_if(|(_, (_, (slot, _)))| *slot == i)
            {
                let value = match layout.packed.filter(|(slot, _)| *slot == i) {
                    Some((_, kind)) => packed(kind, word).map(|bytes| f64::from(bytes[*byte])),
                    None => text::number(layout.attributes[attribute].kind, word),
                };
                let word = || quoted(&String::from_utf8_lossy(word));
                values.push(value.ok_or_else(|| NotANumber { vertex, attribute, word: word() })?);
            }
        }
    }
    Ok(())
}

/// The bytes of a number of 32 bits; none is a colour where it is no number, as opaque ones are that were
/// written as float.
fn packed(kind: Type, word: &[u8]) -> Option<[u8; 4]> {
    match kind {
        Type::F32 => {
            text::number(kind, word).map(|value| if value.is_nan() { 0 } else { (value as f32).to_bits() })
        }
        _ => text::integer(word).map(|value| value as u32),
    }
    .map(u32::to_le_bytes)
}
