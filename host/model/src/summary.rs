//! What places elsewhere in a file have to know of its vertices: their box, which its header has, and the
//! lengths of its compressed blocks, which a table lists.

use std::collections::BTreeMap;

use glam::DVec3;

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
    /// For each part of the model that has boxes of its own, by its number: those of the vertices as they
    /// were, and as they are in the new version.
    pub(crate) boxes: BTreeMap<u32, [Bounds; 2]>,
    /// The checksums of those pages of the new version of which a part is known only in the end.
    pub(crate) checksums: BTreeMap<u64, u32>,
}

impl Summary {
    /// Adds what comes behind it.
    pub(crate) fn absorb(&mut self, behind: &Self) {
        self.before.absorb(&behind.before);
        self.after.absorb(&behind.after);
        self.lengths.extend_from_slice(&behind.lengths);
        for (number, boxes) in &behind.boxes {
            let there = self.boxes.entry(*number).or_default();
            there.iter_mut().zip(boxes).for_each(|(there, more)| there.absorb(more));
        }
        self.checksums.extend(&behind.checksums);
    }

    /// A word without spaces; none if there is nothing to be told.
    pub(crate) fn encode(&self) -> Option<String> {
        if *self == Self::default() {
            return None;
        }
        let mut words = corners(&[self.before, self.after]);
        words.extend(self.lengths.iter().map(|length| format!("{length:x}")));
        let mut parts = vec![words.join(",")];
        parts.extend(
            self.boxes.iter().map(|(number, boxes)| format!("b{number:x},{}", corners(boxes).join(","))),
        );
        parts.extend(self.checksums.iter().map(|(page, checksum)| format!("c{page:x},{checksum:x}")));
        Some(parts.join(";"))
    }

    /// What such a word says.
    pub(crate) fn decode(word: &str) -> Option<Self> {
        let mut parts = word.split(';');
        let mut words = parts.next()?.split(',');
        let [before, after] = boxes(&mut words)?;
        let lengths = words.map(|word| u32::from_str_radix(word, 16).ok()).collect::<Option<_>>()?;
        let mut this = Self { before, after, lengths, ..Self::default() };
        for part in parts {
            let (kind, rest) = (part.get(..1)?, part.get(1..)?);
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
        let after = Bounds::of([DVec3::new(-1.0, 0.1, 3.0), DVec3::ONE]);
        let boxes = BTreeMap::from([(0, [after, Bounds::default()]), (20, [after, after])]);
        let checksums = BTreeMap::from([(0, u32::MAX), (1 << 40, 7)]);
        let second = Summary { after, before: Bounds::of([DVec3::X]), lengths: vec![0], boxes, checksums };
        let mut both = first.clone();
        both.absorb(&second);
        assert_eq!(both, Summary { lengths: vec![7, u32::MAX, 0], ..second.clone() });
        let mut thrice = both.clone();
        thrice.absorb(&Summary {
            boxes: BTreeMap::from([(20, [Bounds::of([DVec3::NEG_Y]), Bounds::default()])]),
            ..Summary::default()
        });
        assert_eq!(thrice.boxes[&20], [Bounds::of([DVec3::NEG_Y, after.min, after.max]), after]);
        for summary in [first, second, both, thrice] {
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
        ] {
            assert_eq!(Summary::decode(wrong), None);
        }
    }
}
