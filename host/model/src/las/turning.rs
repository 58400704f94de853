//! Extra bytes that turn with the surface: put into records, and how far they reach, which their description
//! may say (LAS 1.4 R15, table 24).

use std::ops::Range;

use glam::{DVec3, Mat3};

use super::file::LasModel;
use super::vlrs::VlrKind;
use crate::bounds::Bounds;
use crate::{Edited, Summary};

/// Numbers whose reach is in one box.
const OF_A_BOX: usize = 3;

impl LasModel {
    /// Turns the attributes that follow in `records`, which are those of some of a chunk's vertices at
    /// `positions`; returns whether any bytes changed.
    pub(super) fn turn(
        &self,
        (edited, vertices): (&Edited, Range<usize>),
        positions: &[DVec3],
        records: &mut [u8],
        summary: &mut Summary,
    ) -> bool {
        let attributes = self.following.places();
        if attributes.is_empty() {
            return false;
        }
        let says_reach = attributes.iter().any(|place| self.places.limits(*place).is_some());
        let (mut changed, mut reach) = (false, StoredReach::new(attributes.len()));
        let (mut old, mut new) = (Vec::new(), Vec::new());
        for (vertex, record) in vertices.zip(records.chunks_exact_mut(self.header.record)) {
            let gradient = edited.gradients.get(vertex);
            let gradient = gradient.filter(|g| **g != Mat3::IDENTITY && positions[vertex].is_finite());
            if says_reach {
                reach.include(0, attributes.iter().map(|place| self.places.stored(*place, record)));
            }
            if let Some(gradient) = gradient {
                old.clear();
                old.extend(attributes.iter().map(|place| self.places.number(*place, record)));
                new.clone_from(&old);
                self.following.turn(gradient, edited.mirrored, &mut new);
                for ((place, old), new) in attributes.iter().zip(&old).zip(&new) {
                    changed |= new.to_bits() != old.to_bits() && self.places.put(*place, record, *new);
                }
            }
            if says_reach {
                reach.include(1, attributes.iter().map(|place| self.places.stored(*place, record)));
            }
        }
        if says_reach {
            summary.absorb(&Summary { boxes: reach.boxes(), ..Summary::default() });
        }
        changed
    }

    /// Byte of the file at which the descriptions of extra bytes begin, if it has them.
    pub(super) fn descriptions(&self) -> Option<u64> {
        self.records.find(VlrKind::ExtraBytes).map(|record| record.content.start)
    }

    /// Replacements for those limits of attributes that change, in the descriptions of extra bytes, which are
    /// at `content` in the new file.
    pub(super) fn limits(&self, all: &Summary, content: u64) -> Vec<(u64, Vec<u8>)> {
        let mut patches = Vec::new();
        for (number, place) in self.following.places().iter().enumerate() {
            let boxes = all.boxes.get(&((number / OF_A_BOX) as u32));
            let (Some(limits), Some([before, after])) = (self.places.limits(*place), boxes) else { continue };
            let axis = number % OF_A_BOX;
            let sides = [(limits.least, before.min, after.min), (limits.most, before.max, after.max)];
            for (at, before, after) in sides {
                if let Some(at) = at.filter(|_| before[axis] != after[axis]) {
                    patches.push((content + at as u64, self.places.limit(*place, after[axis])));
                }
            }
        }
        patches
    }
}

/// Reach of the stored numbers, before and after the motion.
struct StoredReach {
    /// The least and the largest of each.
    of: [Vec<[f64; 2]>; 2],
}

impl StoredReach {
    fn new(numbers: usize) -> Self {
        Self { of: [(); 2].map(|()| vec![[f64::INFINITY, f64::NEG_INFINITY]; numbers]) }
    }

    fn include(&mut self, when: usize, numbers: impl Iterator<Item = f64>) {
        for ([least, most], number) in self.of[when].iter_mut().zip(numbers) {
            (*least, *most) = (least.min(number), most.max(number));
        }
    }

    /// The ranges of the numbers as boxes of several numbers each.
    fn boxes(&self) -> std::collections::BTreeMap<u32, [Bounds; 2]> {
        let corner = |of: &[[f64; 2]], side: usize| {
            DVec3::from_array(std::array::from_fn(|axis| of.get(axis).map_or(0.0, |limits| limits[side])))
        };
        let bounds = |of: &[[f64; 2]]| Bounds { min: corner(of, 0), max: corner(of, 1) };
        let [before, after] = self.of.each_ref().map(|of| of.chunks(OF_A_BOX).map(bounds));
        (0..).zip(before.zip(after)).map(|(number, (before, after))| (number, [before, after])).collect()
    }
}
