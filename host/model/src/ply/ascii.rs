//! Vertices of text files: finding the words, reading numbers, and putting edited ones in their place.
//!
//! Lines mean nothing here: words are separated by whitespace of any sort, as other readers have it.

use glam::{DVec3, Mat3, Vec3};

use super::layout::{Component, PlyLayout, PropertySlot};
use crate::follow::Following;
use crate::text::{
    coordinate, drop_word, next_word, no_coordinate, no_normal, parse, quoted, word, write_number,
};
use crate::unfit::{Unfit, new_component};
use crate::{Edited, VertexChunk};

/// Goes over the record that `bytes` begin with (after whitespace, which is part of it): notes where its
/// components lie (in the chunk's bytes, where the record begins at `base`) and returns its length, or `None`
/// if it is longer than `bytes`.
///
/// The error is the length of a list that cannot be.
pub(super) fn scan(
    layout: &PlyLayout,
    bytes: &[u8],
    base: usize,
    whole_file: bool,
    spans: &mut [[u32; 2]],
) -> Result<Option<usize>, String> {
    let mut at = 0;
    for slot in &layout.slots {
        let Some((start, end)) = next_word(bytes, at, whole_file) else { return Ok(None) };
        at = end;
        match *slot {
            PropertySlot::Other { .. } => {}
            PropertySlot::Component { index, .. } => {
                spans[index] = [base + start, base + end].map(|v| v as u32)
            }
            PropertySlot::List { .. } => {
                let text = String::from_utf8_lossy(&bytes[start..end]);
                let length: u64 = text.parse().map_err(|_| quoted(&text))?;
                for _ in 0..length {
                    let Some((_, end)) = next_word(bytes, at, whole_file) else { return Ok(None) };
                    at = end;
                }
            }
        }
    }
    Ok(Some(at))
}

/// Vertex of a chunk with a coordinate that is none, and advice.
#[derive(Debug, PartialEq)]
pub(super) struct NoCoordinate {
    pub(super) vertex: usize,
    pub(super) property: &'static str,
    pub(super) what: String,
    pub(super) hint: &'static str,
}

/// Fills the chunk's positions and normals from its bytes.
pub(super) fn decode(layout: &PlyLayout, chunk: &mut VertexChunk) -> Result<(), NoCoordinate> {
    let VertexChunk { positions, normals, raw, spans, .. } = chunk;
    positions.clear();
    normals.clear();
    let position = layout.triple(0);
    let normal = layout.has_normals().then(|| layout.triple(3));
    for (vertex, spans) in spans.chunks_exact(layout.components.len()).enumerate() {
        let wrong = |c: usize, of: [Component; 3], spans: &[[u32; 2]]| {
            let word = word(raw, spans[c]);
            let is_normal = of[c].name.starts_with('n');
            let (what, hint) =
                if is_normal { no_normal(of[c].scalar, word) } else { no_coordinate(of[c].scalar, word) };
            NoCoordinate { vertex, property: of[c].name, what, hint }
        };
        let p = parse_triple(raw, position, spans).map_err(|c| wrong(c, position, spans))?;
        positions.push(DVec3::from_array(p));
        if let Some(normal) = normal {
            let spans = &spans[3..];
            let n = parse_triple(raw, normal, spans).map_err(|c| wrong(c, normal, spans))?;
            normals.push(Vec3::from_array(n.map(|v| v as f32)));
        }
    }
    Ok(())
}

/// Appends the chunk's bytes to `text`, with those numbers replaced that were edited or follow the surface,
/// and without normals if they are to be dropped.
pub(super) fn splice(
    layout: &PlyLayout,
    following: &Following,
    chunk: &VertexChunk,
    edited: &Edited,
    drop_normals: bool,
    text: &mut Vec<u8>,
) -> Result<(), Unfit> {
    let first = layout.following();
    let VertexChunk { positions, raw, spans, .. } = chunk;
    let (mut numbers, mut copied) = (Vec::new(), 0);
    for (vertex, spans) in spans.chunks_exact(layout.components.len()).enumerate() {
        let is_finite = positions[vertex].is_finite();
        if !is_finite && !drop_normals {
            continue;
        }
        numbers.clear();
        if let Some(gradient) = edited.gradients.get(vertex).filter(|g| is_finite && **g != Mat3::IDENTITY) {
            let of = layout.components[first..].iter().zip(&spans[first..]);
            // A word that is no number stays, as nothing that it belongs to is finite.
            numbers.extend(of.map(|(c, span)| parse(c.scalar, word(raw, *span)).unwrap_or(f64::NAN)));
            following.turn(gradient, edited.mirrored, &mut numbers);
        }
        for &c in &layout.file_order {
            let [start, end] = spans[c].map(|v| v as usize);
            if (3..first).contains(&c) && drop_normals {
                text.extend_from_slice(&raw[copied..start]);
                copied = drop_word(text, raw, end);
                continue;
            }
            let scalar = layout.components[c].scalar;
            let value = if !is_finite {
                None
            } else if c < first {
                new_component(chunk, edited, (vertex, c), scalar)?
            } else {
                let old = || parse(scalar, word(raw, spans[c])).unwrap_or(f64::NAN);
                let new = numbers.get(c - first).map(|new| scalar.round(*new));
                new.filter(|new| new.is_finite() && new.to_bits() != old().to_bits())
            };
            if let Some(value) = value {
                text.extend_from_slice(&raw[copied..start]);
                write_number(text, scalar, value);
                copied = end;
            }
        }
    }
    text.extend_from_slice(&raw[copied..]);
    Ok(())
}

/// Three coordinates, or which of them is none.
#[inline(always)]
fn parse_triple(raw: &[u8], of: [Component; 3], spans: &[[u32; 2]]) -> Result<[f64; 3], usize> {
    let mut values = [0.0; 3];
    for c in 0..3 {
        values[c] = coordinate(of[c].scalar, word(raw, spans[c])).ok_or(c)?;
    }
    Ok(values)
}
