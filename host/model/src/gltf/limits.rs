//! `min` and `max` of positions in the JSON, and of normals and tangents where they are there. The JSON is
//! before the vertices in the file: the limits are written in the end, and the JSON has room for them until
//! then.

use std::ops::Range;

use serde_json::value::RawValue;

use super::container::Container;
use super::json::{GltfDocument, span};
use super::layout::GltfLayout;
use crate::Result;
use crate::summary::{PartBox, Summary};
use crate::text::DAMAGED;

/// Longest text of a float.
const LONGEST: usize = 16;

/// A number in the JSON that is the least or the greatest of a column of others.
#[derive(Debug)]
pub(super) struct Limit {
    /// Range of bytes of the limit in the JSON.
    text: Range<u32>,
    /// Part of the file whose limit this is, and the column of the part.
    part: u32,
    column: u8,
    is_max: bool,
    value: f32,
}

/// Limits of all accessors, in the order of the JSON.
#[derive(Debug, Default)]
pub(super) struct AccessorLimits {
    all: Vec<Limit>,
    /// Parts of which there are some, ascending.
    parts: Vec<u32>,
}

impl AccessorLimits {
    /// # Errors
    /// One that is there is not as many numbers as an element.
    pub(super) fn from_accessor(
        json: &[u8],
        document: &GltfDocument<'_>,
        layout: &GltfLayout,
        container: &Container,
    ) -> Result<Self> {
        let mut all = Vec::new();
        for (index, part) in &layout.accessors {
            let Some(accessor) = document.accessors.get(*index) else { continue };
            for (is_max, array) in [(false, accessor.min), (true, accessor.max)] {
                let Some(array) = array else { continue };
                let expected = if accessor.shape == "VEC4" { 4 } else { 3 };
                let Some(numbers) = numbers(array).filter(|numbers| numbers.len() == expected) else {
                    let name = if is_max { "max" } else { "min" };
                    let what = format!("{name} of accessor {index} is not {expected} numbers");
                    return Err(container.source.malformed(what, DAMAGED));
                };
                for (column, (number, value)) in (0..).zip(numbers) {
                    let text = span(json, number);
                    let text = text.start as u32..text.end as u32;
                    all.push(Limit { text, part: *part, column, is_max, value });
                }
            }
        }
        all.sort_by_key(|limit| limit.text.start);
        let mut parts: Vec<u32> = all.iter().map(|limit| limit.part).collect();
        parts.sort_unstable();
        parts.dedup();
        Ok(Self { all, parts })
    }

    /// Whether there are limits of a part.
    pub(super) fn has(&self, part: u32) -> bool {
        self.parts.binary_search(&part).is_ok()
    }

    /// Number of bytes by which the JSON may grow, whatever its new numbers are.
    pub(super) fn room(&self) -> usize {
        let missing = |limit: &Limit| LONGEST.saturating_sub(limit.text.len());
        self.all.iter().map(missing).sum::<usize>().next_multiple_of(4)
    }

    /// JSON with new numbers for the parts in which something moved, and the byte at which the first one of
    /// these numbers stands; `None` where all are as they were.
    pub(super) fn corrected(&self, json: &[u8], summary: &Summary) -> Option<(usize, Vec<u8>)> {
        let (mut text, mut copied, mut first) = (Vec::new(), 0, None);
        for limit in &self.all {
            let found = summary.parts.binary_search_by_key(&limit.part, |part| part.part);
            let Some(part) = found.ok().map(|i| &summary.parts[i]) else { continue };
            let PartBox { has_moved, min, max, .. } = part;
            let value = if limit.is_max { max } else { min }[usize::from(limit.column)];
            if !has_moved || !value.is_finite() || value == limit.value {
                continue;
            }
            let [start, end] = [limit.text.start, limit.text.end].map(|at| at as usize);
            first.get_or_insert(start);
            text.extend_from_slice(&json[copied..start]);
            text.extend_from_slice(shortest(value).as_bytes());
            copied = end;
        }
        text.extend_from_slice(&json[copied..]);
        first.map(|first| (first, text))
    }
}

/// The numbers of an array.
fn numbers(array: &RawValue) -> Option<Vec<(&RawValue, f32)>> {
    let numbers: Vec<&RawValue> = serde_json::from_str(array.get()).ok()?;
    let with_value = |number: &'_ RawValue| number.get().parse::<f64>().ok().map(|value| value as f32);
    numbers.into_iter().map(|number| Some((number, with_value(number)?))).collect()
}

/// Text of a float as JSON has it, with as few digits as give the float back.
fn shortest(value: f32) -> String {
    let size = value.abs();
    // Zero has no sign that would matter.
    if size == 0.0 {
        "0".into()
    } else if (1e-4..1e10).contains(&size) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn floats_come_back_and_have_room(bits in any::<u32>()) {
            let value = f32::from_bits(bits);
            prop_assume!(value.is_finite());
            let text = shortest(value);
            prop_assert!(text.len() <= LONGEST, "{}", text);
            prop_assert_eq!(text.parse::<f32>().unwrap(), value);
            let read: f64 = serde_json::from_str(&text).unwrap();
            prop_assert_eq!(read as f32, value);
        }
    }

    #[test]
    fn floats_are_short() {
        assert_eq!([0.1, -0.0, 1e20, 123.5, -2.5e-7].map(shortest), ["0.1", "0", "1e20", "123.5", "-2.5e-7"]);
    }
}
