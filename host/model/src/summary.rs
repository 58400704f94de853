//! Summary of a file's vertices for other places of the file: their box, which the header has, and the
//! lengths of compressed blocks, which a table lists.

use std::collections::BTreeMap;

use glam::{DVec3, Vec4};

use crate::bounds::Bounds;

/// Summary of some pieces of a new version of a model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Summary {
    /// Box of the vertices as they were, in the unit that the format counts in.
    pub(crate) before: Bounds,
    /// The box of the vertices in the new version.
    pub(crate) after: Bounds,
    /// Bytes of each compressed block of the new version, in the file's order.
    pub(crate) lengths: Vec<u32>,
    /// Boxes of those parts of the file whose boxes are of numbers as the file stores them: ascending, no
    /// part twice.
    pub(crate) parts: Vec<PartBox>,
    /// Boxes of each part of the model that has its own, by the part's number: that of the vertices as they
    /// were, and that of the vertices in the new version.
    pub(crate) boxes: BTreeMap<u32, [Bounds; 2]>,
    /// The checksums of those pages of the new version of which a part is known only in the end.
    pub(crate) checksums: BTreeMap<u64, u32>,
}

/// The box of a part of the new version, of up to four numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PartBox {
    /// The number of the part.
    pub(crate) part: u32,
    /// Whether any number of the part has changed.
    pub(crate) has_moved: bool,
    pub(crate) min: Vec4,
    pub(crate) max: Vec4,
}

impl PartBox {
    /// Count of the numbers in the text of a part's box.
    const NUMBERS: usize = 10;

    /// Box of a part without anything in it.
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
    /// Adds the summary of the pieces behind these.
    pub fn absorb(&mut self, behind: &Self) {
        self.before.absorb(&behind.before);
        self.after.absorb(&behind.after);
        self.lengths.extend_from_slice(&behind.lengths);
        for part in &behind.parts {
            match self.parts.binary_search_by_key(&part.part, |known| known.part) {
                Ok(known) => self.parts[known].absorb(part),
                Err(at) => self.parts.insert(at, *part),
            }
        }
        for (number, boxes) in &behind.boxes {
            let there = self.boxes.entry(*number).or_default();
            there.iter_mut().zip(boxes).for_each(|(there, more)| there.absorb(more));
        }
        self.checksums.extend(&behind.checksums);
    }

    /// A word without spaces; none if there is nothing to be told.
    pub fn encode(&self) -> Option<String> {
        if *self == Self::default() {
            return None;
        }
        let mut words = corners(&[self.before, self.after]);
        words.extend(self.lengths.iter().map(|length| format!("{length:x}")));
        let mut parts = vec![words.join(",")];
        let hex = |part: &PartBox| part.to_numbers().map(|number| format!("{number:x}")).join(",");
        parts.extend(self.parts.iter().map(|part| format!("p{}", hex(part))));
        parts.extend(
            self.boxes.iter().map(|(number, boxes)| format!("b{number:x},{}", corners(boxes).join(","))),
        );
        parts.extend(self.checksums.iter().map(|(page, checksum)| format!("c{page:x},{checksum:x}")));
        Some(parts.join(";"))
    }

    /// Reads a summary from such a word.
    pub fn decode(word: &str) -> Option<Self> {
        let mut parts = word.split(';');
        let mut words = parts.next()?.split(',');
        let [before, after] = boxes(&mut words)?;
        let lengths = words.map(|word| u32::from_str_radix(word, 16).ok()).collect::<Option<_>>()?;
        let mut this = Self { before, after, lengths, ..Self::default() };
        for part in parts {
            let (kind, rest) = (part.get(..1)?, part.get(1..)?);
            if kind == "p" {
                let numbers = rest.split(',').map(|word| u32::from_str_radix(word, 16).ok());
                let numbers = numbers.collect::<Option<Vec<_>>>()?;
                this.parts.push(PartBox::of_numbers(numbers.try_into().ok()?)?);
                continue;
            }
            let mut words = rest.split(',');
            let number = u64::from_str_radix(words.next()?, 16).ok()?;
            match kind {
                "b" => drop(this.boxes.insert(u32::try_from(number).ok()?, boxes(&mut words)?)),
                "c" => {
                    let checksum = u32::from_str_radix(words.next()?, 16).ok()?;
                    this.checksums.insert(number, checksum);
                }
                _ => return None,
            }
            if words.next().is_some() {
                return None;
            }
        }
        Some(this)
    }
}

/// The numbers of boxes, to the bit.
fn corners(boxes: &[Bounds]) -> Vec<String> {
    let corners = boxes.iter().flat_map(|all| [all.min, all.max]).flat_map(|p| p.to_array());
    corners.map(|x| format!("{:x}", x.to_bits())).collect()
}

/// Boxes of such numbers.
fn boxes<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<[Bounds; 2]> {
    let mut corner = || {
        let mut next = || u64::from_str_radix(words.next()?, 16).ok().map(f64::from_bits);
        Some(DVec3::new(next()?, next()?, next()?))
    };
    let mut next = || Some(Bounds { min: corner()?, max: corner()? });
    Some([next()?, next()?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_comes_back_and_adds_up() {
        let first = Summary { lengths: vec![7, u32::MAX], ..Summary::default() };
        let after = Bounds::from_points([DVec3::new(-1.0, 0.1, 3.0), DVec3::ONE]);
        let boxes = BTreeMap::from([(0, [after, Bounds::default()]), (20, [after, after])]);
        let checksums = BTreeMap::from([(0, u32::MAX), (1 << 40, 7)]);
        let part = PartBox { part: 3, has_moved: true, min: Vec4::NEG_ONE, max: Vec4::splat(0.1) };
        let parts = vec![part, PartBox::empty(7)];
        let second = Summary {
            after,
            before: Bounds::from_points([DVec3::X]),
            lengths: vec![0],
            boxes,
            checksums,
            parts,
        };
        let mut both = first.clone();
        both.absorb(&second);
        assert_eq!(both, Summary { lengths: vec![7, u32::MAX, 0], ..second.clone() });
        let mut thrice = both.clone();
        thrice.absorb(&Summary {
            boxes: BTreeMap::from([(20, [Bounds::from_points([DVec3::NEG_Y]), Bounds::default()])]),
            ..Summary::default()
        });
        assert_eq!(thrice.boxes[&20], [Bounds::from_points([DVec3::NEG_Y, after.min, after.max]), after]);
        let more = PartBox { min: Vec4::splat(-2.0), has_moved: false, ..PartBox::empty(7) };
        let mut all = both.clone();
        all.absorb(&Summary { parts: vec![more], ..Summary::default() });
        assert_eq!(all.parts, [part, more]);
        for summary in [first, second, both, thrice, all] {
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
            "0,0,0,0,0,0,0,0,0,0,0,0;b1",
            "0,0,0,0,0,0,0,0,0,0,0,0;d1,1",
            "0,0,0,0,0,0,0,0,0,0,0,0;p1,2,3",
            "0,0,0,0,0,0,0,0,0,0,0,0;p1,2,3,4,5,6,7,8,9,a",
        ] {
            assert_eq!(Summary::decode(wrong), None);
        }
    }
}
