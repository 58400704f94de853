//! Parts that text formats share: words and numbers, lines, and models whose vertices are lines.
//!
//! | module | |
//! |---|---|
//! | here | words and numbers |
//! | `digits` | numbers written with as many digits as a file has |
//! | `lines` | lines of bounded length |
//! | `blocks` | where vertices lie among lines, found in one pass; reading them from anywhere |
//! | `model` | vertices of lines as chunks, and new numbers in their places |
//! | `faces` | lines of corners as triangles |

pub(crate) mod blocks;
pub(crate) mod digits;
pub(crate) mod faces;
pub(crate) mod lines;
pub(crate) mod model;

use std::io::Write;

use crate::{Scalar, Type};

/// Hint for everything that no correct program writes.
pub(crate) const DAMAGED: &str = "the file is damaged: copy or export it again";

/// Hint for files that end too early.
pub(crate) const CUT_OFF: &str = "the file is cut off, or its header lies: copy or export it again";

/// Hint for coordinates that are too large.
const BEYOND: &str = "write nan in its place if the vertex has no position, or export the file again";

/// Hint for components of normals that are too large.
const BEYOND_NORMAL: &str = "write a normal of length 1 in its place, as 0 0 1, or export the file again";

/// Hint for numbers with commas.
const POINTS: &str =
    "write decimals with points, as 1.5, which is a setting of most programs that export text";

/// Whether a byte separates words. Control characters do, so that a NUL is no part of a number.
#[inline(always)]
pub(crate) fn is_space(byte: u8) -> bool {
    byte <= b' '
}

/// The next word of `bytes` from `at` on; `None` if it may go on after them, which it does not at the file's
/// end.
#[inline(always)]
pub(crate) fn next_word(bytes: &[u8], at: usize, whole_file: bool) -> Option<(usize, usize)> {
    let start = at + bytes[at..].iter().position(|&b| !is_space(b))?;
    match bytes[start..].iter().position(|&b| is_space(b)) {
        Some(len) => Some((start, start + len)),
        None => whole_file.then_some((start, bytes.len())),
    }
}

/// Drops a word that ends at `end` of `raw`, where the bytes before the word are in `text` already: with the
/// blanks before it, or at the start of a line with those behind it. Returns the byte to go on at.
pub(crate) fn drop_word(text: &mut Vec<u8>, raw: &[u8], end: usize) -> usize {
    let is_blank = |byte: &u8| is_space(*byte) && !matches!(byte, b'\n' | b'\r');
    if text.last().is_some_and(is_blank) {
        let kept = text.iter().rposition(|b| !is_blank(b)).map_or(0, |last| last + 1);
        text.truncate(kept);
        return end;
    }
    end + raw[end..].iter().take_while(|b| is_blank(b)).count()
}

/// A number of the given type, which a decimal one is rounded to.
#[inline]
pub(crate) fn parse(scalar: Scalar, word: &[u8]) -> Option<f64> {
    let value = match scalar {
        Scalar::F32 => fast_float2::parse::<f32, _>(word).ok().map(f64::from),
        Scalar::F64 => fast_float2::parse(word).ok(),
    };
    value.or_else(|| is_microsoft_nan(std::str::from_utf8(word).ok()?).then_some(f64::NAN))
}

/// A coordinate of the given type: like [`parse`], but `None` for a finite number that the type cannot hold.
#[inline]
pub(crate) fn coordinate(scalar: Scalar, word: &[u8]) -> Option<f64> {
    parse(scalar, word).filter(|value| !value.is_infinite() || !word.iter().any(u8::is_ascii_digit))
}

/// Reason for which a word is no [`coordinate`], for people, and advice.
#[cold]
pub(crate) fn no_coordinate(scalar: Scalar, word: &[u8]) -> (String, &'static str) {
    let text = quoted(&String::from_utf8_lossy(word));
    match (parse(scalar, word), scalar) {
        (None, _) if word.contains(&b',') => (format!("{text} is no number"), POINTS),
        (None, _) => (format!("{text} is no number"), DAMAGED),
        (_, Scalar::F32) => (format!("{text} is beyond the type float"), BEYOND),
        (_, Scalar::F64) => (format!("{text} is beyond the type double"), BEYOND),
    }
}

/// The error for a word in a normal that is no number.
#[cold]
pub(crate) fn no_normal(scalar: Scalar, word: &[u8]) -> (String, &'static str) {
    let (what, hint) = no_coordinate(scalar, word);
    (what, if hint == BEYOND { BEYOND_NORMAL } else { hint })
}

/// Number of a type, rounded to that type if it is single precision.
pub(crate) fn number(kind: Type, word: &[u8]) -> Option<f64> {
    parse(if kind == Type::F32 { Scalar::F32 } else { Scalar::F64 }, word)
}

/// Whether a text is a number that is not finite as Microsoft's C library prints it: vertices with such
/// numbers are left alone anyway.
fn is_microsoft_nan(text: &str) -> bool {
    let text = text.strip_prefix(['-', '+']).unwrap_or(text).to_ascii_lowercase();
    text.starts_with("1.#") || text.starts_with("nan(")
}

/// A whole number; one that is too large becomes the largest.
pub(crate) fn integer(word: &[u8]) -> Option<i64> {
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

/// Whether a word is a whole number of which double precision does not hold all digits. The digits of a large
/// number that is a double, as 10^30, come back, and it does not count.
pub(crate) fn is_beyond_doubles(word: &[u8]) -> bool {
    if integer(word).is_none_or(|value| value.unsigned_abs() <= 1 << 53) {
        return false;
    }
    let text = std::str::from_utf8(word).unwrap_or_default().trim_start_matches('+');
    let double: f64 = text.parse().unwrap_or(f64::NAN);
    // All of its digits, or as few as tell it from others.
    format!("{double:.0}") != text && format!("{double}") != text
}

/// Whether a text has as many digits in a row as a number beyond doubles has at least: one of these digits is
/// at a multiple of that count.
pub(crate) fn has_many_digits(text: &[u8]) -> bool {
    const MANY: usize = 16;
    (0..text.len()).step_by(MANY).filter(|at| text[*at].is_ascii_digit()).any(|at| {
        let before = text[..at].iter().rev().take_while(|byte| byte.is_ascii_digit()).take(MANY).count();
        let behind = text[at..].iter().take_while(|byte| byte.is_ascii_digit()).take(MANY).count();
        before + behind >= MANY
    })
}

/// Whether a line may have a number beyond all doubles: one with an exponent of three digits, or with more
/// than 308 digits. Hardly any line has.
#[inline]
pub(crate) fn may_be_beyond(line: &[u8]) -> bool {
    let is_large = |at: usize| line[at + 1..].iter().take(4).filter(|b| b.is_ascii_digit()).count() >= 3;
    line.len() > f64::MAX_10_EXP as usize || memchr::memchr2_iter(b'e', b'E', line).any(is_large)
}

/// The word that was noted to stand there.
#[inline]
pub(crate) fn word(raw: &[u8], [start, end]: [u32; 2]) -> &[u8] {
    &raw[start as usize..end as usize]
}

/// Appends the fewest digits that are read back as this very number of the given type.
pub(crate) fn write_number(text: &mut Vec<u8>, scalar: Scalar, value: f64) {
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

/// Text of a file for a message: in quotes, escaped, and not too long.
pub(crate) fn quoted(text: &str) -> String {
    const LONGEST: usize = 40;
    let mut chars = text.trim_ascii_end().chars();
    let short: String = chars.by_ref().take(LONGEST).collect();
    let dots = if chars.next().is_some() { "..." } else { "" };
    format!("\"{}{dots}\"", short.escape_debug())
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
    fn whole_numbers_beyond_doubles_are_found() {
        for (word, is_beyond) in [("9007199254740992", false), ("-9007199254740993", true), ("1e300", false)]
        {
            assert_eq!(is_beyond_doubles(word.as_bytes()), is_beyond, "{word}");
        }
        for (digits, are_many) in [(15, false), (16, true), (40, true)] {
            for before in 0..40 {
                let text = format!("{}{},5", "a".repeat(before), "7".repeat(digits));
                assert_eq!(has_many_digits(text.as_bytes()), are_many, "{text}");
            }
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

    #[test]
    fn quotes_are_short_and_printable() {
        assert_eq!(quoted("a\u{7}b"), "\"a\\u{7}b\"");
        assert_eq!(quoted(&"x".repeat(100)).len(), 45);
    }
}
