//! Vertices of text files: finding the words, reading numbers, and putting edited ones in their place.
//!
//! Lines mean nothing here: words are separated by whitespace of any sort, as other readers have it.

use std::io::Write;

use glam::{DVec3, Vec3};

use super::header::quoted;
use super::layout::{Component, Layout, Slot};
use super::patch::{Unfit, same_normal};
use crate::Type;
use crate::{Edited, Scalar, VertexChunk};

/// Whether a byte separates words. Control characters do, so that a NUL is no part of a number.
#[inline(always)]
pub(super) fn is_space(byte: u8) -> bool {
    byte <= b' '
}

/// The next word of `bytes` from `at` on; `None` if it may go on after them, which it does not at the file's
/// end.
#[inline(always)]
pub(super) fn next_word(bytes: &[u8], at: usize, whole_file: bool) -> Option<(usize, usize)> {
    let start = at + bytes[at..].iter().position(|&b| !is_space(b))?;
    match bytes[start..].iter().position(|&b| is_space(b)) {
        Some(len) => Some((start, start + len)),
        None => whole_file.then_some((start, bytes.len())),
    }
}

/// Goes over the record that `bytes` begin with (after whitespace, which is part of it): notes where its
/// components lie (in the chunk's bytes, where the record begins at `base`) and returns its length, or `None`
/// if it is longer than `bytes`.
///
/// The error is the length of a list that cannot be.
pub(super) fn scan(
    layout: &Layout,
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
            Slot::Other { .. } => {}
            Slot::Component { index, .. } => spans[index] = [base + start, base + end].map(|v| v as u32),
            Slot::List { .. } => {
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

/// Which vertex of a chunk has what for a number.
#[derive(Debug, PartialEq)]
pub(super) struct NotANumber {
    pub(super) vertex: usize,
    pub(super) property: &'static str,
    pub(super) word: String,
}

/// Fills the chunk's positions and normals from its bytes.
pub(super) fn decode(layout: &Layout, chunk: &mut VertexChunk) -> Result<(), NotANumber> {
    let VertexChunk { positions, normals, raw, spans, .. } = chunk;
    positions.clear();
    normals.clear();
    let position = layout.triple(0);
    let normal = layout.has_normals().then(|| layout.triple(3));
    for (vertex, spans) in spans.chunks_exact(layout.components.len()).enumerate() {
        let not_a_number = |c: usize, of: [Component; 3], spans: &[[u32; 2]]| NotANumber {
            vertex,
            property: of[c].name,
            word: quoted(&String::from_utf8_lossy(word(raw, spans[c]))),
        };
        let p = parse_triple(raw, position, spans).map_err(|c| not_a_number(c, position, spans))?;
        positions.push(DVec3::from_array(p));
        if let Some(normal) = normal {
            let spans = &spans[3..];
            let n = parse_triple(raw, normal, spans).map_err(|c| not_a_number(c, normal, spans))?;
            normals.push(Vec3::from_array(n.map(|v| v as f32)));
        }
    }
    Ok(())
}

/// Appends the chunk's bytes to `text`, with those numbers replaced that were edited, and without normals if
/// they are to be dropped.
pub(super) fn splice(
    layout: &Layout,
    chunk: &VertexChunk,
    edited: &Edited,
    drop_normals: bool,
    text: &mut Vec<u8>,
) -> Result<(), Unfit> {
    let VertexChunk { positions, normals, raw, spans, .. } = chunk;
    let mut copied = 0;
    for (vertex, spans) in spans.chunks_exact(layout.components.len()).enumerate() {
        let is_finite = positions[vertex].is_finite();
        if !is_finite && !drop_normals {
            continue;
        }
        for &c in &layout.file_order {
            let [start, end] = spans[c].map(|v| v as usize);
            if c >= 3 && drop_normals {
                text.extend_from_slice(&raw[copied..start]);
                copied = drop_word(text, raw, end);
                continue;
            }
            let scalar = layout.components[c].scalar;
            let value = if !is_finite {
                None
            } else if c < 3 {
                let (old, new) = (positions[vertex][c], edited.positions[vertex][c]);
                let value = round(scalar, new);
                if !value.is_finite() {
                    return Err(Unfit { vertex, value: new });
                }
                (value.to_bits() != old.to_bits()).then_some(value)
            } else {
                // Normals are edited all or none.
                let old = normals[vertex][c - 3];
                let new = edited.normals.get(vertex).map_or(old, |n| n[c - 3]);
                (!same_normal(old, new)).then_some(f64::from(new))
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

/// Drops a word that ends at `end` of `raw`, what stands before it being in `text` already: with the blanks
/// before it, or at the start of a line with those behind it. Returns where to go on.
fn drop_word(text: &mut Vec<u8>, raw: &[u8], end: usize) -> usize {
    let is_blank = |byte: &u8| is_space(*byte) && !matches!(byte, b'\n' | b'\r');
    if text.last().is_some_and(is_blank) {
        let kept = text.iter().rposition(|b| !is_blank(b)).map_or(0, |last| last + 1);
        text.truncate(kept);
        return end;
    }
    end + raw[end..].iter().take_while(|b| is_blank(b)).count()
}

fn word(raw: &[u8], span: [u32; 2]) -> &[u8] {
    &raw[span[0] as usize..span[1] as usize]
}

/// Three numbers, or which of them is none.
#[inline(always)]
fn parse_triple(raw: &[u8], of: [Component; 3], spans: &[[u32; 2]]) -> Result<[f64; 3], usize> {
    let mut values = [0.0; 3];
    for c in 0..3 {
        values[c] = parse(of[c].scalar, word(raw, spans[c])).ok_or(c)?;
    }
    Ok(values)
}

/// A number of the given type, which a decimal one is rounded to.
fn parse(scalar: Scalar, word: &[u8]) -> Option<f64> {
    let value = match scalar {
        Scalar::F32 => fast_float2::parse::<f32, _>(word).ok().map(f64::from),
        Scalar::F64 => fast_float2::parse(word).ok(),
    };
    value.or_else(|| is_microsoft_nan(std::str::from_utf8(word).ok()?).then_some(f64::NAN))
}

/// A number of a type, rounded to it if that is single precision.
pub(super) fn number(kind: Type, word: &[u8]) -> Option<f64> {
    parse(if kind == Type::F32 { Scalar::F32 } else { Scalar::F64 }, word)
}

/// Numbers that are not finite, as Microsoft's C library prints them: such vertices are left alone anyway.
fn is_microsoft_nan(text: &str) -> bool {
    let text = text.strip_prefix(['-', '+']).unwrap_or(text).to_ascii_lowercase();
    text.starts_with("1.#") || text.starts_with("nan(")
}

/// A whole number; one that is too large becomes the largest.
pub(super) fn integer(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] | digits => (false, digits),
    };
    if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let value =
        digits.iter().fold(0i64, |value, b| value.saturating_mul(10).saturating_add(i64::from(b - b'0')));
    Some(if negative { -value } else { value })
}

fn round(scalar: Scalar, value: f64) -> f64 {
    match scalar {
        Scalar::F32 => f64::from(value as f32),
        Scalar::F64 => value,
    }
}

/// Appends the fewest digits that are read back as this very number of the given type.
fn write_number(text: &mut Vec<u8>, scalar: Scalar, value: f64) {
    macro_rules! write_shortest {
        ($value:expr) => {{
            let value = $value;
            // Beyond these bounds the digits would drown in zeros.
            if value == 0.0 || !value.is_finite() || (1e-5..1e16).contains(&value.abs()) {
                write!(text, "{value}")
            } else {
                write!(text, "{value:e}")
            }
        }};
    }
    // Writing to a vector cannot fail.
    let _ = match scalar {
        Scalar::F32 => write_shortest!(value as f32),
        Scalar::F64 => write_shortest!(value),
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(scalar: Scalar, value: f64) -> String {
        let mut text = Vec::new();
        write_number(&mut text, scalar, value);
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn numbers_come_back_from_their_shortest_text() {
        let values =
            [0.0, -0.0, 0.1, 1e-5, -9.999e-6, 123_456_789.0, 1e16, 1e38, 1e-40, 1.0 / 3.0, f64::INFINITY];
        for value in values {
            for (scalar, value) in [(Scalar::F32, f64::from(value as f32)), (Scalar::F64, value)] {
                let text = written(scalar, value);
                assert!(text.len() <= 24, "{text}");
                assert_eq!(parse(scalar, text.as_bytes()).unwrap().to_bits(), value.to_bits(), "{text}");
            }
        }
        assert_eq!(written(Scalar::F32, f64::from(0.1f32)), "0.1");
        assert_eq!(written(Scalar::F64, f64::from(0.1f32)), "0.10000000149011612");
        assert!(parse(Scalar::F32, written(Scalar::F32, f64::NAN).as_bytes()).unwrap().is_nan());
    }

    #[test]
    fn whole_numbers_are_read_however_long() {
        let words =
            [("0", 0), ("-0", 0), ("+7", 7), ("-1", -1), ("00042", 42), ("4294967295", 4_294_967_295)];
        for (word, value) in words {
            assert_eq!(integer(word.as_bytes()), Some(value), "{word}");
        }
        assert_eq!(integer(&[b'9'; 1000]), Some(i64::MAX));
        for word in ["", "-", "+", "--1", "1.0", "1e3", "0x1", "x", "\u{e9}"] {
            assert_eq!(integer(word.as_bytes()), None, "{word}");
        }
    }

    #[test]
    fn what_others_write_is_understood() {
        let words =
            ["nan", "-NaN", "inf", "-Infinity", "1.#QNAN", "-1.#IND00", "1.#INF", "-nan(ind)", "1e999"];
        for word in words {
            assert!(!parse(Scalar::F64, word.as_bytes()).unwrap().is_finite(), "{word}");
        }
        for (word, value) in [("+1.", 1.0), (".5", 0.5), ("-1E-2", -0.01), ("007", 7.0)] {
            assert_eq!(parse(Scalar::F64, word.as_bytes()), Some(value), "{word}");
        }
        for word in ["", "-", "1,5", "0x10", "1e", "x", "\u{e9}", "1_000", "nano"] {
            assert_eq!(parse(Scalar::F64, word.as_bytes()), None, "{word}");
        }
        assert_eq!(parse(Scalar::F64, b"\xff"), None);
    }

    #[test]
    fn a_dropped_word_glues_no_others() {
        let drop = |line: &str, words: &[&str]| {
            let (mut text, mut copied) = (Vec::new(), 0);
            for word in words {
                let start = line.find(word).unwrap();
                text.extend_from_slice(&line.as_bytes()[copied..start]);
                copied = drop_word(&mut text, line.as_bytes(), start + word.len());
            }
            text.extend_from_slice(&line.as_bytes()[copied..]);
            String::from_utf8(text).unwrap()
        };
        let all = ["a", "b", "c"];
        assert_eq!(drop("a b c 1 2\n", &all), "1 2\n");
        assert_eq!(drop("\na b c 1 2\n", &all), "\n1 2\n");
        assert_eq!(drop("1 2 a b c\r\n3", &all), "1 2\r\n3");
        assert_eq!(drop("1 a  b\tc 2", &all), "1 2");
        assert_eq!(drop("1 a 2 b 3 c \n", &all), "1 2 3 \n");
        assert_eq!(drop(" a b c 1", &all), " 1");
        assert_eq!(drop("1\na\n2\n", &["a"]), "1\n\n2\n");
        assert_eq!(drop("1\na 2\n", &["a"]), "1\n2\n");
        assert_eq!(drop("1 a", &["a"]), "1");
    }
}
