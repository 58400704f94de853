//! The new samples take their places behind those that were there, whose indices and positions stay.
//!
//! Of the clusters that a sample's cluster is split into, the one whose representative is nearest goes on
//! being represented by the sample itself: another one beside it would say the same twice.
//!
//! Where sheets of the model touch, a cluster holds vertices of several of them, and has a sample for each.
//! So has each of the clusters that it is split into: the vertices of a sheet there go on from the sample
//! that stood for that sheet.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use glam::Vec3;

use super::regrowing::{Grown, Regrown, Sheet};
use crate::sampling::kept_cells::{CutTree, KeptCells};
use crate::touching::Guides;

/// New samples of a refinement, and the trees and sheets that change with them.
#[derive(Default)]
pub(super) struct Appended {
    /// Positions and normals of the new samples; a normal is zero where unknown.
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    /// Sample from which each new one comes: the one whose cluster was split, or where several sheets meet in
    /// the cluster, the one on the new sample's sheet.
    pub origins: Vec<u32>,
    /// Samples that no tree has, as their cluster holds several sheets, and one that a tree has for it.
    pub parted: Vec<[u32; 2]>,
    /// The new tree of each cell that was looked at.
    pub trees: Vec<(u32, CutTree)>,
    /// Pairs of a built leaf and a sample, ascending: from this leaf on, up to that of the next entry, leaves
    /// belong to this sample.
    pub starts: Vec<(u32, u32)>,
    /// Whether the cluster of each sample is split, for the samples before the refinement.
    pub split: Vec<bool>,
}

/// Leaf below a split sample, or the part of one that is on one of several sheets there.
struct NewLeaf {
    position: Vec3,
    normal: Vec3,
    reach: f32,
    /// Sample from before the refinement that stood for the leaf, and the distance to it.
    origin: u32,
    distance: f32,
    /// The tree, and the place among its samples.
    tree: usize,
    place: usize,
    /// Whether this leaf's sample takes `place` in the tree: of several sheets, the one with most vertices
    /// does.
    is_first: bool,
    /// First of the built leaves.
    first: u32,
}

/// Samples that are split, and the new leaves of each.
#[derive(Default)]
struct SplitSamples {
    parts: Vec<NewLeaf>,
    /// The parts of each split sample, cell by cell.
    split: BTreeMap<u32, Vec<Range<usize>>>,
    /// Pairs as in [`Appended::starts`], of the samples that are not split.
    starts: Vec<(u32, u32)>,
}

/// A sheet with fewer than this part of its cluster's vertices gets no sample of its own.
const LEAST_PART: f64 = 0.125;

/// Numbers the leaves of all cells, cut at a bound.
pub(super) fn append(
    kept: &KeptCells,
    positions: &[Vec3],
    cells: &[Regrown],
    bound: f32,
    guides: Option<&Guides<'_>>,
) -> Appended {
    let (trees, pieces) = renew(kept, positions, cells, bound, guides);
    let mut out = Appended { trees, split: vec![false; positions.len()], ..Appended::default() };
    let heirs = out.heirs(kept, &pieces, guides);
    let mut beside = out.number(&pieces.parts, heirs);
    out.starts.extend(pieces.starts);
    out.starts.sort_unstable();
    if let Some(guides) = guides {
        // A sample of which no vertices are left goes beside the first leaf that came of its cluster.
        for (sample, cells) in &pieces.split {
            let part = cells.first().map(|range| &pieces.parts[range.start]);
            beside.extend(part.map(|part| (*sample, part.tree, part.place)));
        }
        out.parted = out.parted(kept, guides, &beside);
    }
    out
}

/// New trees of all cells, and the leaves of the samples whose clusters are split there.
fn renew(
    kept: &KeptCells,
    positions: &[Vec3],
    cells: &[Regrown],
    bound: f32,
    guides: Option<&Guides<'_>>,
) -> (Vec<(u32, CutTree)>, SplitSamples) {
    let (mut trees, mut pieces) = (Vec::with_capacity(cells.len()), SplitSamples::default());
    for cell in cells {
        let old = &kept.cells[cell.cell as usize].tree;
        let mut new = Renewed { old, tree: CutTree::default(), samples: old.samples.iter().copied() };
        let ends = old.ends();
        let (mut at, mut next) = (0, cell.grown.iter().peekable());
        while at < ends.len() {
            if let Some(grown) = next.next_if(|grown| grown.root as usize == at) {
                let how = Taking { positions, guides, place: trees.len() };
                new.take(grown, &grown.cut(bound, old), how, &mut pieces);
                at = ends[at];
            } else {
                if old.grown.binary_search(&(at as u32)).is_ok() {
                    new.tree.grown.push(new.tree.children.len() as u32);
                }
                new.copy(at);
                at += 1;
            }
        }
        trees.push((cell.cell, new.tree));
    }
    (trees, pieces)
}

impl Appended {
    /// Sample that goes on to stand for each part of its former cluster, if one does. The samples of all
    /// these clusters are noted as split.
    fn heirs(
        &mut self,
        kept: &KeptCells,
        pieces: &SplitSamples,
        guides: Option<&Guides<'_>>,
    ) -> Vec<Option<u32>> {
        let SplitSamples { parts, split, .. } = pieces;
        let mut of_sample = vec![0u32; self.split.len()];
        kept.cells.iter().flat_map(|c| &c.tree.samples).for_each(|s| of_sample[*s as usize] += 1);
        let mut sample_of: Vec<Option<u32>> = vec![None; parts.len()];
        for (sample, cells) in split {
            let parted = guides.map_or(&[][..], |guides| guides.parted_from(*sample));
            for own in [sample].into_iter().chain(parted) {
                self.split[*own as usize] = true;
                // The sample may stand for whole cells besides, which are not split.
                let stays = own == sample && of_sample[*own as usize] as usize > cells.len();
                let nearest = |range: &Range<usize>| {
                    let own = range.clone().filter(|i| parts[*i].origin == *own);
                    own.min_by(|a, b| parts[*a].distance.total_cmp(&parts[*b].distance))
                };
                let near: Vec<usize> = cells.iter().filter_map(nearest).collect();
                let within = |i: &&usize| parts[**i].distance <= parts[**i].reach;
                let mut heirs: Vec<usize> = near.iter().filter(within).copied().collect();
                if heirs.is_empty() && !stays {
                    let first =
                        near.iter().min_by(|a, b| parts[**a].distance.total_cmp(&parts[**b].distance));
                    heirs.extend(first);
                }
                heirs.iter().for_each(|i| sample_of[*i] = Some(*own));
            }
        }
        sample_of
    }

    /// Gives every part its sample, a new one where there is no heir. Those that are beside another one in
    /// their tree are given back: the sample, the tree and the place there.
    fn number(&mut self, parts: &[NewLeaf], heirs: Vec<Option<u32>>) -> Vec<(u32, usize, usize)> {
        let before = self.split.len();
        let mut beside = Vec::new();
        for (part, heir) in parts.iter().zip(heirs) {
            let sample = heir.unwrap_or_else(|| {
                self.positions.push(part.position);
                self.normals.push(part.normal);
                self.origins.push(part.origin);
                (before + self.positions.len() - 1) as u32
            });
            if part.is_first {
                self.trees[part.tree].1.samples[part.place] = sample;
            } else {
                beside.push((sample, part.tree, part.place));
            }
            self.starts.push((part.first, sample));
        }
        beside
    }

    /// The samples that no tree has: those that none had, and those that stand beside a place in a tree.
    fn parted(&self, kept: &KeptCells, guides: &Guides<'_>, beside: &[(u32, usize, usize)]) -> Vec<[u32; 2]> {
        let mut in_tree = vec![false; self.split.len() + self.positions.len()];
        let anew: BTreeSet<u32> = self.trees.iter().map(|(cell, _)| *cell).collect();
        let as_they_were = (0..).zip(&kept.cells).filter(|(cell, _)| !anew.contains(cell));
        let trees = as_they_were.map(|(_, cell)| &cell.tree).chain(self.trees.iter().map(|(_, tree)| tree));
        trees.flat_map(|tree| &tree.samples).for_each(|sample| in_tree[*sample as usize] = true);
        let mut found: BTreeMap<u32, u32> = BTreeMap::new();
        for (sample, tree, place) in beside.iter().filter(|(sample, ..)| !in_tree[*sample as usize]) {
            found.entry(*sample).or_insert(self.trees[*tree].1.samples[*place]);
        }
        for [sample, of] in guides.parted().iter().filter(|[sample, _]| !in_tree[*sample as usize]) {
            let of = found.get(of).copied().unwrap_or(*of);
            found.entry(*sample).or_insert(of);
        }
        found.into_iter().map(|(sample, of)| [sample, of]).collect()
    }
}

impl SplitSamples {
    /// Ends the list of a sample's parts in a cell.
    fn close(&mut self, open: Option<(u32, u32, usize)>) {
        if let Some((sample, _, first)) = open {
            self.split.entry(sample).or_default().push(first..self.parts.len());
        }
    }
}

/// Inputs from which new leaves become samples, for one cell.
struct Taking<'a, 'g> {
    /// Positions of the samples before the refinement, local.
    positions: &'a [Vec3],
    guides: Option<&'a Guides<'g>>,
    /// The place of the cell's tree among those that are looked at.
    place: usize,
}

impl Taking<'_, '_> {
    /// Sample that the vertices of a sheet had before, among those that share a sample's cluster.
    fn own(&self, sample: u32, guide: u32) -> u32 {
        self.guides.map_or(sample, |all| all.of_cluster(sample, guide))
    }

    /// Leaves that come of a grown leaf below a split sample, one for each sheet, that with most vertices
    /// first; and the built leaves from which on the vertices of a sheet belong to a sample that was there.
    /// `place` is that of the leaf's sample in the tree.
    fn parts(&self, grown: &Grown, i: usize, sample: u32, place: usize) -> (Vec<NewLeaf>, Vec<(u32, u32)>) {
        let node = &grown.nodes[i];
        let whole = (node.position, node.normal, node.reach);
        let part = |origin: u32, (position, normal, reach): (Vec3, Vec3, f32), sheet: usize| NewLeaf {
            position,
            normal,
            reach,
            origin,
            distance: self.positions[origin as usize].distance(position),
            tree: self.place,
            place,
            is_first: false,
            first: grown.first_leaf(i, sheet),
        };
        let (mut parts, mut starts) = (Vec::new(), Vec::new());
        if grown.sheets.is_empty() {
            parts.push(part(sample, whole, 0));
        }
        let on_sheet = |(at, sheet): (usize, &Sheet)| {
            let moments = sheet.moments(grown.leaves(i));
            (moments.count() > 0.0).then(|| (at, self.own(sample, sheet.guide), moments))
        };
        let mut there: Vec<_> = grown.sheets.iter().enumerate().filter_map(on_sheet).collect();
        there.sort_by(|(.., a), (.., b)| b.count().total_cmp(&a.count()));
        let all: f64 = there.iter().map(|(.., moments)| moments.count()).sum();
        for (at, own, moments) in &there {
            if moments.count() == all {
                parts.push(part(*own, whole, *at));
            } else if parts.is_empty() || moments.count() >= LEAST_PART * all {
                let (position, normal, _) = moments.representative();
                let reach = 0.5 * (moments.max - moments.min).length();
                parts.push(part(*own, (position, normal, reach), *at));
            } else {
                starts.push((grown.first_leaf(i, *at), *own));
            }
        }
        if let Some(first) = parts.first_mut() {
            first.is_first = true;
        }
        (parts, starts)
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
    /// Copies a node of the former tree.
    fn copy(&mut self, at: usize) {
        let children = self.old.children[at];
        self.tree.children.push(children);
        self.tree.errors.push(self.old.errors[at]);
        if children == 0 {
            self.tree.samples.extend(self.samples.next());
        }
    }

    /// The cut of a tree that has grown.
    fn take(&mut self, grown: &Grown, cut: &[(usize, bool)], how: Taking<'_, '_>, pieces: &mut SplitSamples) {
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
            match (is_leaf, sample, open) {
                (true, Some(sample), _) => {
                    self.tree.samples.push(sample);
                    if grown.sheets.is_empty() {
                        pieces.starts.push((grown.first_leaf(i, 0), sample));
                    }
                    for (at, sheet) in grown.sheets.iter().enumerate() {
                        pieces.starts.push((grown.first_leaf(i, at), how.own(sample, sheet.guide)));
                    }
                }
                (false, Some(sample), _) => open = Some((sample, node.end, pieces.parts.len())),
                (true, None, Some((sample, ..))) => {
                    let (parts, starts) = how.parts(grown, i, sample, self.tree.samples.len());
                    pieces.parts.extend(parts);
                    pieces.starts.extend(starts);
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
