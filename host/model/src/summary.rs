//! What places elsewhere in a file have to know of its vertices: their box, which its header has, and the
//! lengths of its compressed blocks, which a table lists.

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
}

impl Summary {
    /// Adds what comes behind it.
    pub(crate) fn absorb(&mut self, behind: &Self) {
        for (all, more) in [(&mut self.before, behind.before), (&mut self.after, behind.after)] {
            all.min = all.min.min(more.min);
            all.max = all.max.max(more.max);
        }
        self.lengths.extend_from_slice(&behind.lengths);
    }

    /// A word without spaces; none if there is nothing to be told.
    pub(crate) fn encode(&self) -> Option<String> {
        if *self == Self::default() {
            return None;
        }
        let corners = [self.before.min, self.before.max, self.after.min, self.after.max];
        let corners = corners.iter().flat_map(|p| p.to_array()).map(|x| format!("{:x}", x.to_bits()));
        let lengths = self.lengths.iter().map(|length| format!("{length:x}"));
        Some(corners.chain(lengths).collect::<Vec<_>>().join(","))
    }

    /// What such a word says.
    pub(crate) fn decode(word: &str) -> Option<Self> {
        let mut words = word.split(',');
        let mut corner = || {
            let mut next = || u64::from_str_radix(words.next()?, 16).ok().map(f64::from_bits);
            Some(DVec3::new(next()?, next()?, next()?))
        };
        let before = Bounds { min: corner()?, max: corner()? };
        let after = Bounds { min: corner()?, max: corner()? };
        let lengths = words.map(|word| u32::from_str_radix(word, 16).ok()).collect::<Option<_>>()?;
        Some(Self { before, after, lengths })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_comes_back_and_adds_up() {
        let first = Summary { lengths: vec![7, u32::MAX], ..Summary::default() };
        let after = Bounds::of([DVec3::new(-1.0, 0.1, 3.0), DVec3::ONE]);
        let second = Summary { after, before: Bounds::of([DVec3::X]), lengths: vec![0] };
        let mut both = first.clone();
        both.absorb(&second);
        assert_eq!(both, Summary { lengths: vec![7, u32::MAX, 0], ..second.clone() });
        for summary in [first, second, both] {
            let word = summary.encode().unwrap();
            assert_eq!(Summary::decode(&word).unwrap(), summary);
            assert!(!word.contains(' '));
        }
        assert_eq!(Summary::default().encode(), None);
        for wrong in ["", "1,2", "x", "0,0,0,0,0,0,0,0,0,0,0,0,-1"] {
            assert_eq!(Summary::decode(wrong), None);
        }
    }
}
