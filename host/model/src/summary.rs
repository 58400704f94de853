//! What places elsewhere in a file have to know of its vertices: their box, which its header has, and the
//! lengths of its compressed blocks, which a table lists. Where parts of a file have boxes of their own, theirs.

use glam::{DVec3, Vec4};

use crate::bounds::Bounds;

/// What is known of some pieces of a new version of a model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Summary {
    /// The box of the vertices as they were, in whatever the format counts in.
    pub(crate) before: Bounds,
    /// Their box in the new version.
    pub(crate) after: Bounds,
    /// Bytes of each compressed block of the new version, in the file's order.
    pub(crate) lengths: Vec<u32>,
    /// Of parts of the file that have boxes of their own: ascending, no part twice.
    pub(crate) parts: Vec<PartBox>,
}

/// The box of a part of the new version, of up to four numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PartBox {
    /// Which part.
    pub(crate) part: u32,
    /// Whether anything in it is elsewhere than it was.
    pub(crate) has_moved: bool,
    pub(crate) min: Vec4,
    pub(crate) max: Vec4,
}

impl PartBox {
    /// Numbers of its word.
    const NUMBERS: usize = 10;

    /// With nothing in it.
    pub(crate) fn empty(part: u32) -> Self {
        Self { part, has_moved: false, min: Vec4::INFINITY, max: Vec4::NEG_INFINITY }
    }

    fn absorb(&mut self, behind: &Self) {
        self.has_moved |= behind.has_moved;
        self.min = self.min.min(behind.min);
        self.max = self.max.max(behind.max);
    }

    fn to_numbers(self) -> [u32; Self::NUMBERS] {
        let [min, max] = [self.min, self.max].map(|p| p.to_array().map(f32::to_bits));
        let [a, b, c, d] = min;
        let [e, f, g, h] = max;
        [self.part, u32::from(self.has_moved), a, b, c, d, e, f, g, h]
    }

    fn of_numbers(numbers: [u32; Self::NUMBERS]) -> Option<Self> {
        let [part, has_moved, min @ .., e, f, g, h] = numbers;
        let corner = |bits: [u32; 4]| Vec4::from_array(bits.map(f32::from_bits));
        (has_moved <= 1).then(|| Self {
            part,
            has_moved: has_moved == 1,
            min: corner(min),
            max: corner([e, f, g, h]),
        })
    }
}

impl Summary {
    /// Adds what comes behind it.
    pub(crate) fn absorb(&mut self, behind: &Self) {
        for (all, more) in [(&mut self.before, behind.before), (&mut self.after, behind.after)] {
            all.min = all.min.min(more.min);
            all.max = all.max.max(more.max);
        }
        self.lengths.extend_from_slice(&behind.lengths);
        for part in &behind.parts {
            match self.parts.binary_search_by_key(&part.part, |known| known.part) {
                Ok(known) => self.parts[known].absorb(part),
                Err(at) => self.parts.insert(at, *part),
            }
        }
    }

    /// A word without spaces; none if there is nothing to be told.
    pub(crate) fn encode(&self) -> Option<String> {
        if *self == Self::default() {
            return None;
        }
        let corners = [self.before.min, self.before.max, self.after.min, self.after.max];
        let corners = corners.iter().flat_map(|p| p.to_array()).map(|x| format!("{:x}", x.to_bits()));
        let lengths = self.lengths.iter().map(|length| format!("{length:x}"));
        let mut word = corners.chain(lengths).collect::<Vec<_>>().join(",");
        for part in &self.parts {
            word += ";";
            word += &part.to_numbers().map(|number| format!("{number:x}")).join(",");
        }
        Some(word)
    }

    /// What such a word says.
    pub(crate) fn decode(word: &str) -> Option<Self> {
        let mut all = word.split(';');
        let mut words = all.next()?.split(',');
        let mut corner = || {
            let mut next = || u64::from_str_radix(words.next()?, 16).ok().map(f64::from_bits);
            Some(DVec3::new(next()?, next()?, next()?))
        };
        let before = Bounds { min: corner()?, max: corner()? };
        let after = Bounds { min: corner()?, max: corner()? };
        let lengths = words.map(|word| u32::from_str_radix(word, 16).ok()).collect::<Option<_>>()?;
        let part = |word: &str| {
            let numbers =
                word.split(',').map(|word| u32::from_str_radix(word, 16).ok()).collect::<Option<Vec<_>>>()?;
            PartBox::of_numbers(numbers.try_into().ok()?)
        };
        let parts = all.map(part).collect::<Option<_>>()?;
        Some(Self { before, after, lengths, parts })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_comes_back_and_adds_up() {
        let first = Summary { lengths: vec![7, u32::MAX], ..Summary::default() };
        let after = Bounds::of([DVec3::new(-1.0, 0.1, 3.0), DVec3::ONE]);
        let part = PartBox { part: 3, has_moved: true, min: Vec4::NEG_ONE, max: Vec4::splat(0.1) };
        let parts = vec![part, PartBox::empty(7)];
        let second = Summary { after, before: Bounds::of([DVec3::X]), lengths: vec![0], parts };
        let mut both = first.clone();
        both.absorb(&second);
        assert_eq!(both, Summary { lengths: vec![7, u32::MAX, 0], ..second.clone() });
        let more = PartBox { min: Vec4::splat(-2.0), has_moved: false, ..PartBox::empty(7) };
        let mut all = both.clone();
        all.absorb(&Summary { parts: vec![more], ..Summary::default() });
        assert_eq!(all.parts, [part, more]);
        for summary in [first, second, both, all] {
            let word = summary.encode().unwrap();
            assert_eq!(Summary::decode(&word).unwrap(), summary);
            assert!(!word.contains(' '));
        }
        assert_eq!(Summary::default().encode(), None);
        for wrong in [
            "",
            "1,2",
            "x",
            "0,0,0,0,0,0,0,0,0,0,0,0,-1",
            "0,0,0,0,0,0,0,0,0,0,0,0;1,2,3",
            "0,0,0,0,0,0,0,0,0,0,0,0;1,2,3,4,5,6,7,8,9,a",
        ] {
            assert_eq!(Summary::decode(wrong), None);
        }
    }
}
