//! The cut through all cells' trees that gives P_S: at an error bound, or at a target number of samples.
//!
//! Above the cells' VS-Trees stands an octree of the grid's cells, merged two by two, so that a target below
//! the number of occupied cells, or a large flat region, is met as well.
//!
//! For a target number N no second look at the model is needed: the clusters of all cells seen so far are
//! kept down to a running bound ε, raised whenever they are more than 1.6N beyond one per cell. A node above
//! the cells counts as no better than the nodes below it, so the final cut splits all of them before it
//! splits a cell's tree further, and more cells can only add clusters: the final bound is never below the
//! running one, and clusters that were dropped would not have been in the cut.
//!
//! With *foresight*, the first part of the model does not get all of the N clusters for a while, only to lose
//! most of them again: of a part f of the vertices, √f times as many are kept, more than its share. Should
//! the rest be so plain that this is too few in the end, the cut says so, and pass 2 has to begin again
//! without.

use std::borrow::Cow;
use std::ops::Range;

use glam::Vec3;
use serde::{Deserialize, Serialize};
use simod_model::{Error, Result};

use super::cluster::{Moments, REACH_WEIGHT};
use super::grid::{CellKey, CellMap, Grid};
use super::kept_cells::CutTree;
use super::vs_tree::{Node, VsTree};

/// Clusters are pruned when there are more than this many times the target …
const KEEP_AT_MOST: f64 = 1.6;
/// … down to this many times the target.
const PRUNE_TO: f64 = 1.2;

/// Bytes for each sample of the target: [`KEEP_AT_MOST`] clusters in trees of about 1.4 nodes per cluster, of
/// 40 bytes each; the sample itself; and the rest of trees that are pruned one by one.
pub const BYTES_PER_SAMPLE: u64 = 150;

/// The clusters of one finalized cell.
pub struct ClusteredCell {
    /// The cell's place in the grid's list.
    pub cell: u32,
    /// The cell's VS-Tree.
    pub tree: VsTree,
    /// The moments of all its samples.
    pub moments: Moments,
}

/// The trees of all cells seen so far.
///
/// Memory: 40 bytes for each of about 1.4 nodes per cluster, at most [`KEEP_AT_MOST`] clusters per sample of
/// the target and those of one cell; and the moments of each occupied cell.
pub struct Forest {
    target: Option<usize>,
    /// Number of vertices of P_L, and the foresight; `None` without.
    foresight: Option<(f64, f64)>,
    /// The number of vertices in the trees.
    seen: f64,
    /// Running bound.
    threshold: f32,
    /// Largest number of leaves without a target.
    most: usize,
    leaves: usize,
    /// Cells taken in.
    added: usize,
    cells: Vec<Option<(VsTree, Moments)>>,
}

impl Forest {
    /// Empty forest on a grid, for a target number of samples, or for a fixed bound and at most `most`
    /// leaves. With `foresight`, a part f of the vertices gets this factor times √f of the clusters, and not
    /// more than all.
    pub fn new(
        grid: &Grid,
        target: Option<usize>,
        threshold: f32,
        most: usize,
        foresight: Option<f64>,
    ) -> Self {
        let all = || grid.records.iter().map(|r| r.count as f64).sum();
        let foresight = foresight.map(|times| (all(), times));
        let mut cells = Vec::new();
        cells.resize_with(grid.keys.len(), || None);
        Self { target, foresight, seen: 0.0, threshold, most, leaves: 0, added: 0, cells }
    }

    /// Takes in a clustered cell; the bound down to which further cells need clustering.
    ///
    /// # Errors
    /// The bound takes more clusters than there may be.
    pub fn add(&mut self, ClusteredCell { cell, mut tree, moments }: ClusteredCell) -> Result<f32> {
        tree.prune(self.threshold);
        self.leaves += tree.leaves();
        self.added += 1;
        self.seen += moments.count();
        self.cells[cell as usize] = Some((tree, moments));
        if let Some(target) = self.target {
            let part = self.foresight.map_or(1.0, |(all, times)| (times * (self.seen / all).sqrt()).min(1.0));
            let expected = (target as f64 * part) as usize;
            if self.leaves > self.added + most_kept(expected) {
                let trees = self.cells.iter().flatten().map(|(tree, _)| tree);
                self.threshold = self.threshold.max(running_bound(trees, expected));
                self.leaves = 0;
                for (tree, _) in self.cells.iter_mut().flatten() {
                    tree.prune(self.threshold);
                    self.leaves += tree.leaves();
                }
            }
        }
        if self.target.is_none() && self.leaves > self.most {
            return Err(Error::argument(
                format!(
                    "so small an error takes more than {} samples, which memory does not hold",
                    self.most
                ),
                "give a larger --error, a number of --samples, or more memory with --memory-limit",
            ));
        }
        Ok(self.threshold)
    }

    /// Raises the bound below which clusters are dropped, where trees that are taken in have dropped more.
    pub fn raise(&mut self, bound: f32) {
        self.threshold = self.threshold.max(bound);
    }

    /// The bound below which clusters were dropped, and the trees that were taken in, with the moments of
    /// their cells, by these.
    pub fn into_trees(self) -> (f32, impl Iterator<Item = ClusteredCell>) {
        let cell = |(cell, known): (usize, Option<(VsTree, Moments)>)| {
            known.map(|(tree, moments)| ClusteredCell { cell: cell as u32, tree, moments })
        };
        (self.threshold, self.cells.into_iter().enumerate().filter_map(cell))
    }

    /// The final cut, in the order in which the stream meets the cells; `None` if foresight has failed.
    pub fn cut(self, grid: &Grid) -> Option<Cut> {
        let (trees, moments): (Vec<VsTree>, Vec<Moments>) = self.cells.into_iter().flatten().unzip();
        let upper = Upper::build(&grid.keys, &moments, &trees);
        let threshold = match self.target {
            None => self.threshold,
            Some(target) => {
                threshold_for(upper.splits().chain(trees.iter().flat_map(VsTree::splits)), 1, target)
            }
        };
        // A cut that goes on below dropped clusters cannot be found.
        if threshold < self.threshold {
            return None;
        }
        let mut merged: Vec<Option<u32>> = vec![None; trees.len()];
        let mut above = Vec::new();
        upper.cut(threshold, |cells, node| {
            cells.iter().for_each(|c| merged[*c as usize] = Some(above.len() as u32));
            above.push((node, None));
        });
        drop(upper);

        let mut cut = Cut::default();
        let mut first_leaf = 0u32;
        for ((mut tree, record), merged) in trees.into_iter().zip(&grid.records).zip(merged) {
            match merged {
                None => {
                    tree.prune(threshold);
                    cut.push_tree(&tree, first_leaf);
                }
                Some(piece) => {
                    let (node, sample) = &mut above[piece as usize];
                    let next = cut.samples() as u32;
                    cut.push_merged(node, *sample.get_or_insert(next), first_leaf);
                }
            }
            // Leaves beyond 2^32 vertices are not asked for.
            first_leaf = first_leaf.wrapping_add(record.count as u32);
        }
        Some(cut)
    }
}

/// P_S as it comes from the trees.
#[derive(Default, Serialize, Deserialize)]
pub struct Cut {
    /// Positions in local coordinates.
    pub positions: Vec<Vec3>,
    /// Unit normals; zero where unknown.
    pub normals: Vec<Vec3>,
    /// The samples' [variances](Moments::variance_of_mean).
    pub variances: Vec<f32>,
    /// The tree of each cell.
    pub trees: Vec<CutTree>,
    /// Pairs of a leaf and a sample, ascending: from this leaf on (all cells' leaves are counted in one row,
    /// in which each cell has as many places as samples), up to that of the next entry, leaves belong to this
    /// sample.
    pub starts: Vec<(u32, u32)>,
    /// Position and normal of each node of the trees that has others below it, one tree after the other.
    inner: Vec<(Vec3, Vec3)>,
}

impl Cut {
    /// Whether the parts of the cut fit together: one that was read from a file may be damaged.
    pub fn is_sound(&self) -> bool {
        let samples = self.samples();
        let inner = |tree: &CutTree| tree.children.iter().filter(|children| **children > 0).count();
        self.normals.len() == samples
            && self.variances.len() == samples
            && self.trees.iter().all(|tree| tree.defect(samples).is_none())
            && self.trees.iter().map(inner).sum::<usize>() == self.inner.len()
            && self.starts.is_sorted()
            && self.starts.iter().all(|(_, sample)| (*sample as usize) < samples)
    }

    pub fn samples(&self) -> usize {
        self.positions.len()
    }

    /// The bound of a [coarser](Self::coarser) cut, by the [raised] errors of all trees.
    fn coarser_threshold(&self, errors: &[Cow<'_, [f32]>], target: usize) -> f32 {
        let splits = || {
            let inner =
                |(children, error): (&u8, &f32)| children.checked_sub(1).map(|n| (*error, u32::from(n)));
            let trees = self.trees.iter().zip(errors);
            trees.flat_map(move |(tree, errors)| tree.children.iter().zip(&**errors).filter_map(inner))
        };
        let added = |stays: bool| -> usize {
            let splits = splits().filter(|(error, _)| !stays || error.is_infinite());
            splits.map(|(_, added)| added as usize).sum()
        };
        let roots = self.samples() - added(false);
        // Samples that stay keep those beside them. Of the others, no more than half go for their sake.
        let least = match added(true) {
            0 => 0,
            staying => roots + staying + (self.samples() - roots - staying) / 2,
        };
        threshold_for(splits(), roots, target.max(least)).min(f32::MAX)
    }

    /// Cut through the same trees of at most `target` samples, if there are no fewer trees, and those that
    /// shall `stay`, with half of all others, are not more; and for each sample of this cut the one of the
    /// new cut that has its clusters. The nodes above the cells stay as they are.
    pub fn coarser(&self, target: usize, stay: impl Fn(u32) -> bool) -> (Self, Vec<u32>) {
        let errors: Vec<Cow<'_, [f32]>> = self.trees.iter().map(|tree| raised(tree, &stay)).collect();
        let threshold = self.coarser_threshold(&errors, target);
        let mut coarser = Self::default();
        let mut becomes = vec![u32::MAX; self.samples()];
        let (mut starts, mut inner) = (self.starts.iter(), self.inner.iter());
        for (tree, errors) in self.trees.iter().zip(&errors) {
            let (mut new, ends) = (CutTree::default(), tree.ends());
            let mut samples = tree.samples.iter();
            // The end of the subtree that has become a sample.
            let mut within: Option<usize> = None;
            for (i, children) in tree.children.iter().enumerate() {
                within = within.filter(|end| i < *end);
                let leaf = (*children == 0).then(|| (samples.next(), starts.next()));
                let own = if leaf.is_none() { inner.next() } else { None };
                let splits = within.is_none() && *children > 0 && errors[i] > threshold;
                if within.is_none() {
                    new.children.push(if splits { *children } else { 0 });
                    new.errors.push(tree.errors[i]);
                    if !splits {
                        // A sample of several cells is in the new cut from the first of them on.
                        let sample = leaf.and_then(|(sample, _)| sample).map(|sample| *sample as usize);
                        let known = sample.map(|sample| becomes[sample]).filter(|to| *to != u32::MAX);
                        let to = known.unwrap_or(coarser.samples() as u32);
                        if known.is_none() {
                            let of_leaf = || sample.map(|s| (self.positions[s], self.normals[s]));
                            let (position, normal) = own.copied().or_else(of_leaf).unwrap_or_default();
                            coarser.positions.push(position);
                            coarser.normals.push(normal);
                            // Variances are for clouds, whose sheets no faces tell.
                            coarser.variances.push(f32::INFINITY);
                        }
                        new.samples.push(to);
                        within = (*children > 0).then(|| ends[i]);
                    } else {
                        coarser.inner.extend(own);
                    }
                }
                if let (Some((Some(sample), start)), Some(to)) = (leaf, new.samples.last()) {
                    becomes[*sample as usize] = *to;
                    // A sample's entry is that of the first of its leaves.
                    let goes_on = coarser.starts.last().is_some_and(|last| last.1 == *to);
                    coarser.starts.extend(start.filter(|_| !goes_on).map(|start| (start.0, *to)));
                }
            }
            coarser.trees.push(new);
        }
        (coarser, becomes)
    }

    /// Takes a cell's tree, of which each leaf becomes a sample.
    fn push_tree(&mut self, tree: &VsTree, first_leaf: u32) {
        let next = self.samples() as u32;
        let errors = tree.nodes.iter().map(|n| n.key).collect();
        let is_inner = |i: &usize| tree.nodes[*i].end as usize > i + 1;
        let inner = (0..tree.nodes.len()).filter(is_inner).map(|i| &tree.nodes[i]);
        self.inner.extend(inner.map(|node| (node.position, node.normal)));
        let children: Vec<u8> = (0..tree.nodes.len()).map(|i| tree.children(i) as u8).collect();
        let leaves = tree.nodes.iter().zip(&children).filter(|(_, children)| **children == 0);
        leaves.for_each(|(node, _)| self.push(node, first_leaf));
        let samples = (next..self.samples() as u32).collect();
        self.trees.push(CutTree { children, errors, samples, grown: Vec::new() });
    }

    /// Takes a cell all of whose leaves belong to a sample: a known one, or the next.
    fn push_merged(&mut self, node: &Node, sample: u32, first_leaf: u32) {
        if sample as usize == self.samples() {
            self.push(node, first_leaf);
        } else {
            self.starts.push((first_leaf, sample));
        }
        let (children, errors, samples) = (vec![0], vec![node.key], vec![sample]);
        self.trees.push(CutTree { children, errors, samples, grown: Vec::new() });
    }

    fn push(&mut self, node: &Node, first_leaf: u32) {
        self.starts.push((first_leaf.wrapping_add(node.first), self.samples() as u32));
        self.positions.push(node.position);
        self.normals.push(node.normal);
        self.variances.push(node.variance);
    }
}

/// The errors of a tree, beyond any bound above the samples that shall stay.
fn raised(tree: &CutTree, stay: impl Fn(u32) -> bool) -> Cow<'_, [f32]> {
    if !tree.samples.iter().any(|sample| stay(*sample)) {
        return Cow::Borrowed(&tree.errors);
    }
    let mut samples = tree.samples.iter();
    let stays = tree.children.iter().map(|n| *n == 0 && samples.next().is_some_and(|sample| stay(*sample)));
    // Number of samples that stay before each node, and at last the number of all that stay.
    let mut before = vec![0u32];
    before.extend(stays.scan(0, |sum, stays| {
        *sum += u32::from(stays);
        Some(*sum)
    }));
    let nodes = tree.errors.iter().zip(tree.ends()).enumerate();
    nodes.map(|(i, (error, end))| if before[end] > before[i] { f32::INFINITY } else { *error }).collect()
}

/// Distance that each of the samples from `first` on may move without the error of its cluster exceeding a
/// bound; infinite for samples whose error exceeds the bound already.
pub fn slack<'a>(trees: impl Iterator<Item = &'a CutTree>, samples: Range<usize>, bound: f32) -> Vec<f32> {
    let mut slack = vec![f32::INFINITY; samples.len()];
    for (sample, error) in trees.flat_map(CutTree::errors_of_samples) {
        let slack = (sample as usize).checked_sub(samples.start).and_then(|i| slack.get_mut(i));
        if let Some(slack) = slack.filter(|_| error <= bound) {
            *slack = (bound - error) / REACH_WEIGHT as f32;
        }
    }
    slack
}

/// The error of each sample's clusters, the largest.
pub fn errors<'a>(trees: impl Iterator<Item = &'a CutTree>, samples: usize) -> Vec<f32> {
    let mut errors = vec![0.0f32; samples];
    for (sample, error) in trees.flat_map(CutTree::errors_of_samples) {
        let known = &mut errors[sample as usize];
        *known = known.max(error);
    }
    errors
}

/// Largest number of clusters beyond one per tree that are kept for a target, until they are pruned.
pub fn most_kept(target: usize) -> usize {
    (KEEP_AT_MOST * target.max(1024) as f64) as usize
}

/// Lower bound of the error bound of any cut of `target` samples through these trees, and others.
pub fn running_bound<'a>(trees: impl Iterator<Item = &'a VsTree>, target: usize) -> f32 {
    threshold_for(trees.flat_map(VsTree::splits), 0, (PRUNE_TO * target.max(1024) as f64) as usize)
}

/// Least bound at which a cut has at most `target` clusters, given the clusters that can be split (their key
/// and the number of clusters that the split adds) and the number of roots.
pub fn threshold_for(splits: impl Iterator<Item = (f32, u32)>, roots: usize, target: usize) -> f32 {
    let mut splits: Vec<_> = splits.collect();
    splits.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let mut clusters = roots;
    for (key, added) in splits {
        clusters += added as usize;
        if clusters > target {
            return key;
        }
    }
    0.0
}

/// The octree above the cells.
struct Upper {
    /// Levels from the cells up to the single root.
    levels: Vec<Vec<UpperNode>>,
}

struct UpperNode {
    moments: Moments,
    /// Error of the node or of a node below, whichever is greater.
    error: f32,
    /// The first cell below, in the order of the stream.
    first: u32,
    /// Indices of the children in the level below.
    children: Vec<u32>,
}

impl Upper {
    fn build(keys: &[CellKey], moments: &[Moments], trees: &[VsTree]) -> Self {
        let cells = |i: usize| UpperNode {
            moments: moments[i],
            error: trees[i].nodes.first().map_or(0.0, |root| root.key),
            first: i as u32,
            children: Vec::new(),
        };
        let mut levels = vec![(0..moments.len()).map(cells).collect::<Vec<_>>()];
        let mut keys = keys.to_vec();
        while keys.len() > 1 {
            let shift = levels.len() as i64 & 1;
            let below = levels.last().map_or(&[][..], |level| level);
            let mut index: CellMap<usize> = CellMap::default();
            let (mut level, mut parents): (Vec<UpperNode>, Vec<CellKey>) = Default::default();
            for (i, (node, key)) in below.iter().zip(&keys).enumerate() {
                // Every other level is shifted by a cell, so that neighbours across zero merge in the end
                // too.
                let parent = key.map(|k| (k + shift) >> 1);
                let at = *index.entry(parent).or_insert_with(|| {
                    parents.push(parent);
                    level.push(UpperNode {
                        moments: Moments::default(),
                        error: 0.0,
                        first: node.first,
                        children: Vec::new(),
                    });
                    level.len() - 1
                });
                level[at].moments.add(&node.moments);
                level[at].error = level[at].error.max(node.error);
                level[at].first = level[at].first.min(node.first);
                level[at].children.push(i as u32);
            }
            for node in &mut level {
                node.error = node.error.max(node.moments.representative().2);
            }
            levels.push(level);
            keys = parents;
        }
        Self { levels }
    }

    /// The nodes above the cells that a cut can split.
    fn splits(&self) -> impl Iterator<Item = (f32, u32)> {
        let above = self.levels.iter().skip(1).flatten().filter(|node| node.children.len() > 1);
        above.map(|node| (node.error, node.children.len() as u32 - 1))
    }

    /// Gives `emit` each merged node of the cut at `threshold` above the cells: the cells, and their
    /// representative.
    fn cut(&self, threshold: f32, mut emit: impl FnMut(&[u32], Node)) {
        let top = self.levels.len() - 1;
        let mut stack: Vec<_> = (0..self.levels[top].len()).map(|i| (top, i)).collect();
        while let Some((level, i)) = stack.pop() {
            let node = &self.levels[level][i];
            if level == 0 {
                continue;
            }
            if node.error > threshold {
                stack.extend(node.children.iter().map(|c| (level - 1, *c as usize)));
            } else {
                let covariance = node.moments.covariance();
                let (position, normal, _) = node.moments.representative_by(&covariance);
                let (variance, key) = (node.moments.variance_of_mean(&covariance), node.error);
                emit(&self.cells(level, i), Node { position, normal, variance, key, end: 0, first: 0 });
            }
        }
    }

    /// The cells below a node.
    fn cells(&self, level: usize, i: usize) -> Vec<u32> {
        let mut nodes = vec![i as u32];
        for level in (1..=level).rev() {
            nodes =
                nodes.iter().flat_map(|i| self.levels[level][*i as usize].children.iter().copied()).collect();
        }
        nodes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::cluster::Vertex;
    use crate::sampling::grid::GridCounter;
    use crate::sampling::splitting::Splitting;
    use crate::sampling::vs_tree::TreeWorkspace;

    /// A wavy sheet of 100 × 100 vertices, clustered as it streams, for a target.
    fn sampled(target: Option<usize>, bound: f32, resolution: u32) -> Cut {
        let wavy = |x: f32, _| ((9.0 * x).sin() / 9.0, (9.0 * x).cos());
        cut_through(100, wavy, target, bound, resolution, false).expect("nothing is foreseen")
    }

    /// A sheet of `side`² vertices, of a height, and a slope along x, by which the stream is ordered.
    fn cut_through(
        side: u32,
        height: impl Fn(f32, f32) -> (f32, f32),
        target: Option<usize>,
        bound: f32,
        resolution: u32,
        foresight: bool,
    ) -> Option<Cut> {
        let place = |i: u32| i as f32 / side as f32 - 0.5;
        let vertices: Vec<Vertex> = (0..side * side)
            .map(|i| {
                let (x, z) = (place(i / side), place(i % side));
                let (y, slope) = height(x, z);
                let normal = Vec3::new(-slope, 1.0, 0.0).normalize_or(Vec3::Y);
                Vertex { position: Vec3::new(x, y, z), normal, index: 0 }
            })
            .collect();
        let mut counter = GridCounter::new(resolution);
        vertices.iter().enumerate().for_each(|(i, s)| counter.add(s.position.as_dvec3(), i as u64));
        let grid = counter.finish();
        let mut cells = vec![Vec::new(); grid.keys.len()];
        for s in vertices {
            cells[grid.find(&grid.key_of(s.position.as_dvec3())).expect("a cell") as usize].push(s);
        }
        let mut forest = Forest::new(&grid, target, bound, usize::MAX, foresight.then_some(1.0));
        let mut stop = bound;
        for (cell, mut vertices) in cells.into_iter().enumerate() {
            (0..).zip(&mut vertices).for_each(|(i, s)| s.index = i);
            let workspace = &mut TreeWorkspace::default();
            let (tree, moments) =
                VsTree::build(&mut vertices, workspace, Splitting::VolumeSurface, stop, cell as u64);
            stop = forest.add(ClusteredCell { cell: cell as u32, tree, moments }).expect("room");
        }
        forest.cut(&grid)
    }

    /// Checks that all samples are leaves of the trees, and that each has leaves of its own; returns their
    /// number.
    fn check(cut: &Cut) -> usize {
        let mut seen = vec![0; cut.samples()];
        for tree in &cut.trees {
            let leaves = tree.children.iter().filter(|n| **n == 0).count();
            assert_eq!(tree.samples.len(), leaves);
            tree.samples.iter().for_each(|i| seen[*i as usize] += 1);
            assert_eq!(tree.children.iter().map(|n| *n as usize).sum::<usize>(), tree.children.len() - 1);
        }
        assert!(seen.iter().all(|n| *n > 0));
        assert!(cut.starts.is_sorted_by(|a, b| a.0 < b.0));
        cut.starts.iter().for_each(|(_, sample)| seen[*sample as usize] = 0);
        assert!(seen.iter().all(|n| *n == 0));
        cut.samples()
    }

    #[test]
    fn targets_are_met_from_one_sample_to_all() {
        for target in [1, 7, 50, 333, 1000, 5000, 9900, 10_000, 50_000] {
            for resolution in [2, 32] {
                let n = check(&sampled(Some(target), 0.0, resolution));
                let wanted = target.min(10_000);
                // A split in space adds up to seven clusters at once.
                let slack = 6 + wanted / 50;
                assert!(n <= wanted && n + slack >= wanted, "{n} samples for {target} at {resolution}");
            }
        }
    }

    #[test]
    fn a_coarser_cut_is_that_of_fewer_samples() {
        for resolution in [2, 32] {
            let finer = sampled(Some(3000), 0.0, resolution);
            let (coarser, becomes) = finer.coarser(1700, |_| false);
            assert!(check(&coarser) <= 1700 && coarser.samples() > 1600);
            assert!(coarser.starts.is_sorted());
            let at = |cut: &Cut, leaf: u32| cut.starts[cut.starts.partition_point(|(s, _)| *s <= leaf) - 1].1;
            for (leaf, sample) in &finer.starts {
                assert_eq!(at(&coarser, *leaf), becomes[*sample as usize]);
            }
            // Cuts of which nothing merges above the cells are the very same.
            if resolution == 2 {
                let same = sampled(Some(1700), 0.0, resolution);
                assert!(coarser.positions == same.positions && coarser.trees == same.trees);
            }
            assert!(finer.coarser(5000, |_| false).0.positions == finer.positions);
        }
    }

    #[test]
    fn clusters_that_are_alike_are_split_evenly() {
        let samples = sampled(Some(3000), 0.0, 16);
        let half = samples.positions.iter().filter(|p| p.z < 0.0).count();
        assert!((1350..1650).contains(&half), "{half} of {} in one half", samples.samples());
    }

    #[test]
    fn an_error_bound_is_kept_by_every_cluster() {
        for bound in [0.01, 0.002] {
            let few = sampled(None, bound, 16);
            for tree in &few.trees {
                let leaves = tree.errors.iter().zip(&tree.children).filter(|(_, children)| **children == 0);
                assert!(leaves.map(|(error, _)| *error).all(|error| error <= bound));
            }
            assert!(check(&few) < check(&sampled(None, bound / 2.0, 16)));
        }
    }

    #[test]
    fn foresight_changes_nothing_or_tells_that_it_failed() {
        let wavy = |x: f32, _| ((9.0 * x).sin() / 9.0, (9.0 * x).cos());
        // Rough in its first fifth, and plain after it.
        let rough =
            |x: f32, z: f32| (0.02 * (999.0 * x + 777.0 * z).sin(), 20.0 * (999.0 * x + 777.0 * z).cos());
        let plain = |x: f32, z: f32| if x < -0.3 { rough(x, z) } else { (0.0, 0.0) };
        for (height, expected) in [(&wavy as &dyn Fn(f32, f32) -> (f32, f32), true), (&plain, false)] {
            let cut = |foresight| cut_through(250, height, Some(10_000), 0.0, 32, foresight);
            let foreseen = cut(true);
            assert_eq!(foreseen.is_some(), expected);
            let all = cut(false).expect("nothing is foreseen");
            assert!((9900..=10_000).contains(&all.samples()), "{}", all.samples());
            if let Some(foreseen) = foreseen {
                assert!(foreseen.positions == all.positions && foreseen.trees == all.trees);
            }
        }
    }
}
