//! The new samples take their places behind those that were there, whose indices and positions stay.
//!
//! Of the clusters that a sample's cluster is split into, the one whose representative is nearest goes on being
//! represented by the sample itself: another one beside it would say the same twice.

use std::collections::BTreeMap;
use std::ops::Range;

use glam::Vec3;

use super::regrowing::{Grown, Regrown};
use crate::sampling::kept_cells::{CutTree, KeptCells};

/// What a refinement comes to.
#[derive(Default)]
pub(super) struct Appended {
    /// Positions and normals of the new samples; a normal is zero where unknown.
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    /// The sample whose cluster each was part of.
    pub origins: Vec<u32>,
    /// The new tree of each cell that was looked at.
    pub trees: Vec<(u32, CutTree)>,
    /// Ascending: from this built leaf on, up to that of the next entry, leaves belong to this sample.
    pub starts: Vec<(u32, u32)>,
    /// Whether the cluster of each sample that was there is split.
    pub split: Vec<bool>,
}

/// A leaf below a split sample.
struct Part {
    position: Vec3,
    normal: Vec3,
    reach: f32,
    distance: f32,
    /// The tree, and the place among its samples.
    tree: usize,
    place: usize,
    /// First of the built leaves.
    first: u32,
}

/// What becomes of the samples that are split.
#[derive(Default)]
struct Pieces {
    parts: Vec<Part>,
    /// The parts of each split sample, cell by cell.
    split: BTreeMap<u32, Vec<Range<usize>>>,
    /// As [`Appended::starts`], of the samples that are not split.
    starts: Vec<(u32, u32)>,
}

/// Numbers the leaves of all cells, cut at a bound.
pub(super) fn append(kept: &KeptCells, positions: &[Vec3], cells: &[Regrown], bound: f32) -> Appended {
    let mut of_sample = vec![0u32; positions.len()];
    kept.cells.iter().flat_map(|c| &c.tree.samples).for_each(|s| of_sample[*s as usize] += 1);

    let mut out = Appended { split: vec![false; positions.len()], ..Appended::default() };
    let mut pieces = Pieces::default();
    for cell in cells {
        let old = &kept.cells[cell.cell as usize].tree;
        let mut new = Renewed { old, tree: CutTree::default(), samples: old.samples.iter().copied() };
        let ends = old.ends();
        let (mut at, mut next) = (0, cell.grown.iter().peekable());
        while at < ends.len() {
            if let Some(grown) = next.next_if(|grown| grown.root as usize == at) {
                let place = out.trees.len();
                new.take(grown, &grown.cut(bound, old), positions, place, &mut pieces);
                at = ends[at];
            } else {
                if old.grown.binary_search(&(at as u32)).is_ok() {
                    new.tree.grown.push(new.tree.children.len() as u32);
                }
                new.copy(at);
                at += 1;
            }
        }
        out.trees.push((cell.cell, new.tree));
    }

    let Pieces { parts, split, starts } = pieces;
    out.starts = starts;
    let mut sample_of: Vec<Option<u32>> = vec![None; parts.len()];
    let mut origins = vec![0; parts.len()];
    for (sample, cells) in &split {
        cells.iter().cloned().for_each(|parts| origins[parts].fill(*sample));
        out.split[*sample as usize] = true;
        // It may stand for whole cells besides, which are not split.
        let stays = of_sample[*sample as usize] as usize > cells.len();
        let nearest = |range: &Range<usize>| {
            range.clone().min_by(|a, b| parts[*a].distance.total_cmp(&parts[*b].distance))
        };
        let near: Vec<usize> = cells.iter().filter_map(nearest).collect();
        let within = |i: &&usize| parts[**i].distance <= parts[**i].reach;
        let mut heirs: Vec<usize> = near.iter().filter(within).copied().collect();
        if heirs.is_empty() && !stays {
            let first = near.iter().min_by(|a, b| parts[**a].distance.total_cmp(&parts[**b].distance));
            heirs.extend(first);
        }
        heirs.iter().for_each(|i| sample_of[*i] = Some(*sample));
    }
    for ((part, sample), origin) in parts.iter().zip(sample_of).zip(origins) {
        let sample = sample.unwrap_or_else(|| {
            out.positions.push(part.position);
            out.normals.push(part.normal);
            out.origins.push(origin);
            (positions.len() + out.positions.len() - 1) as u32
        });
        out.trees[part.tree].1.samples[part.place] = sample;
        out.starts.push((part.first, sample));
    }
    out.starts.sort_unstable();
    out
}

impl Pieces {
    /// All parts of a sample in a cell are there.
    fn close(&mut self, open: Option<(u32, u32, usize)>) {
        if let Some((sample, _, first)) = open {
            self.split.entry(sample).or_default().push(first..self.parts.len());
        }
    }
}

/// A cell's tree in the making.
struct Renewed<'a, S> {
    old: &'a CutTree,
    tree: CutTree,
    /// The samples of the old leaves, in turn.
    samples: S,
}

impl<S: Iterator<Item = u32>> Renewed<'_, S> {
    /// A node as it was.
    fn copy(&mut self, at: usize) {
        let children = self.old.children[at];
        self.tree.children.push(children);
        self.tree.errors.push(self.old.errors[at]);
        if children == 0 {
            self.tree.samples.extend(self.samples.next());
        }
    }

    /// The cut of a tree that has grown; `place` is its cell's among those that are looked at.
    fn take(
        &mut self,
        grown: &Grown,
        cut: &[(usize, bool)],
        positions: &[Vec3],
        place: usize,
        pieces: &mut Pieces,
    ) {
        let root = self.tree.children.len() as u32;
        // The sample that is split, the end of its subtree, and where its parts begin.
        let mut open: Option<(u32, u32, usize)> = None;
        for &(i, is_leaf) in cut {
            let node = &grown.nodes[i];
            if open.is_some_and(|(_, end, _)| end as usize <= i) {
                pieces.close(open.take());
            }
            self.tree.children.push(if is_leaf { 0 } else { grown.children(i) as u8 });
            self.tree.errors.push(node.error);
            let was_leaf = node.known.is_some_and(|k| self.old.children[k as usize] == 0);
            let sample = if was_leaf { self.samples.next() } else { None };
            let first = grown.first_leaf + node.first;
            match (is_leaf, sample, open) {
                (true, Some(sample), _) => {
                    self.tree.samples.push(sample);
                    pieces.starts.push((first, sample));
                }
                (false, Some(sample), _) => open = Some((sample, node.end, pieces.parts.len())),
                (true, None, Some((sample, ..))) => {
                    pieces.parts.push(Part {
                        position: node.position,
                        normal: node.normal,
                        reach: node.reach,
                        distance: positions[sample as usize].distance(node.position),
                        tree: place,
                        place: self.tree.samples.len(),
                        first,
                    });
                    // Known once all parts of all cells are.
                    self.tree.samples.push(sample);
                }
                _ => {}
            }
        }
        pieces.close(open);
        if self.tree.children[root as usize] > 0 {
            self.tree.grown.push(root);
        }
    }
}
