//! A cell's tree goes on where it stopped (paper §6).
//!
//! The kept tree tells which clusters were split, and splits follow from the vertices alone. So the tree is
//! built again along the kept one, which gives the vertices of each leaf; and where a leaf's error is above
//! the bound, a VS-Tree of these vertices goes on below it. The result does not depend on how many
//! refinements led there.

use crate::sampling::cluster::{Element, Moments, Vertex};
use crate::sampling::density::SplitRule;
use crate::sampling::finalization::seed_of;
use crate::sampling::kept_cells::{CutTree, KeptCell, KeptCells};
use crate::sampling::random::mix;
use crate::sampling::vs_tree::{TreeWorkspace, VsTree, children};
use crate::touching::Guides;
use std::collections::BTreeMap;
use std::ops::Range;

use glam::Vec3;

use super::gathering::{GatheredCell, VERTICES_OF_A_PART};
use super::sizing::Sizing;
use crate::lists::lists;

/// A cluster below a sample of the first sampling.
#[derive(Debug, Clone, Copy)]
pub(super) struct GrownNode {
    pub position: Vec3,
    pub normal: Vec3,
    /// Half of its box's diagonal.
    pub reach: f32,
    /// Error of the node, or that of a node above if that is less.
    pub error: f32,
    /// Error less the slack, or that of an ancestor which is not kept; a bound inside the selection is
    /// compared with this.
    pub graded: f32,
    /// Index behind its subtree.
    pub end: u32,
    /// The node's first leaf, counted in the tree as it was built.
    pub first: u32,
    /// Kept node that this node is.
    pub known: Option<u32>,
}

/// The tree below a sample of the first sampling.
#[derive(Debug)]
pub(super) struct Grown {
    /// The node of the cell's tree that it begins with.
    pub root: u32,
    pub nodes: Vec<GrownNode>,
    /// Number of leaves, of all cells, before its first one.
    pub first_leaf: u32,
    /// Number of leaves that were built. Each sheet has as many, one sheet after the other.
    pub built: u32,
    /// The sheets that its vertices are on, if there are several.
    pub sheets: Vec<Sheet>,
}

/// The vertices below a sample of the first sampling that are on one sheet of several that touch there.
#[derive(Debug)]
pub(super) struct Sheet {
    /// A sample on the sheet.
    pub guide: u32,
    /// Leaves with such vertices, ascending, and the moments of these.
    leaves: Vec<(u32, Moments)>,
}

impl Sheet {
    /// Moments of the sheet's vertices in a range of leaves; zero, if it has no vertices there.
    pub fn moments(&self, leaves: Range<u32>) -> Moments {
        let start = self.leaves.partition_point(|(leaf, _)| *leaf < leaves.start);
        let inside = self.leaves[start..].iter().take_while(|(leaf, _)| *leaf < leaves.end);
        inside.fold(Moments::default(), |mut sum, (_, moments)| {
            sum.add(moments);
            sum
        })
    }
}

/// New nodes of a kept cell's tree.
#[derive(Debug)]
pub(super) struct Regrown {
    /// The cell's place among the kept cells.
    pub cell: u32,
    /// Grown nodes below each root, in the order of the roots.
    pub grown: Vec<Grown>,
    /// Index in the model of each vertex, and its leaf: a sample from before, or a number from `leaves_from`
    /// on. Empty, if they are not asked for.
    pub members: Vec<(u32, u32)>,
    /// Number of leaves that were built.
    pub built: u32,
}

impl Regrown {
    /// Number of samples that sheets take at a cut beside those of the tree, at most.
    pub fn beside(&self, bound: f32, kept: &KeptCells) -> usize {
        let tree = &kept.cells[self.cell as usize].tree;
        let of_leaf = |grown: &Grown, i: usize| {
            let there = |sheet: &&Sheet| sheet.moments(grown.leaves(i)).count() > 0.0;
            grown.sheets.iter().filter(there).count().saturating_sub(1)
        };
        let of_grown = |grown: &Grown| -> usize {
            let is_new = |i: usize| grown.nodes[i].known.is_none();
            let leaves = grown.cut(bound, tree).into_iter().filter(|(i, is_leaf)| *is_leaf && is_new(*i));
            leaves.map(|(i, _)| of_leaf(grown, i)).sum()
        };
        self.grown.iter().filter(|grown| !grown.sheets.is_empty()).map(of_grown).sum()
    }

    /// Counts the leaves on from `before`, the number of leaves of other cells that come before those of this
    /// one.
    pub fn count_from(&mut self, before: u32, leaves_from: u32) {
        self.grown.iter_mut().for_each(|grown| grown.first_leaf += before);
        let built = self.members.iter_mut().filter(|(_, leaf)| *leaf >= leaves_from);
        built.for_each(|(_, leaf)| *leaf += before);
    }
}

/// The vertices are not those that the tree was built of.
#[derive(Debug)]
pub(super) struct ChangedModel;

/// The way in which cells are regrown.
pub(super) struct Regrowing<'a, 'g> {
    pub rule: SplitRule,
    pub sizing: &'a Sizing<'a>,
    /// Bound inside the selection; local units.
    pub bound: f32,
    /// Number of the first leaf that is built: those before are samples.
    pub leaves_from: u32,
    /// Contacts where the model touches itself, with the sheet of each vertex there.
    pub guides: Option<&'a Guides<'g>>,
}

impl Grown {
    /// Number of a node's first leaf on a sheet, among those of all cells.
    pub fn first_leaf(&self, i: usize, sheet: usize) -> u32 {
        self.first_leaf + sheet as u32 * self.built + self.nodes[i].first
    }

    /// The leaves below a node, of those that were built.
    pub fn leaves(&self, i: usize) -> Range<u32> {
        let node = &self.nodes[i];
        node.first..self.nodes.get(node.end as usize).map_or(self.built, |next| next.first)
    }

    /// Nodes down to a cut inside the selection, and whether each is a leaf of the cut.
    pub fn cut(&self, bound: f32, tree: &CutTree) -> Vec<(usize, bool)> {
        let (mut found, mut i) = (Vec::new(), 0);
        while let Some(node) = self.nodes.get(i) {
            let is_kept = node.known.is_some_and(|k| tree.children[k as usize] > 0);
            let leaf = node.end as usize == i + 1 || !(is_kept || node.graded > bound);
            found.push((i, leaf));
            i = if leaf { node.end as usize } else { i + 1 };
        }
        found
    }

    /// Clusters that a cut can split beyond the kept tree: the error that the bound is compared with, and the
    /// number of clusters that the split adds.
    pub fn splits<'a>(&'a self, tree: &'a CutTree) -> impl Iterator<Item = (f32, u32)> + 'a {
        let can = |i: &usize| {
            let node = &self.nodes[*i];
            node.end as usize > i + 1 && node.known.is_none_or(|k| tree.children[k as usize] == 0)
        };
        (0..self.nodes.len()).filter(can).map(|i| (self.nodes[i].graded, self.children(i) - 1))
    }

    /// Number of clusters that a node is split into.
    pub fn children(&self, i: usize) -> u32 {
        children(i, |node| self.nodes[node].end)
    }

    /// Drops all nodes below a cut.
    pub fn prune(&mut self, bound: f32, tree: &CutTree) {
        let kept = self.cut(bound, tree);
        // Number of nodes before a node that are kept, which is the node's new place.
        let place = |end: u32| kept.partition_point(|(i, _)| *i < end as usize) as u32;
        self.nodes = kept
            .iter()
            .map(|(i, _)| GrownNode { end: place(self.nodes[*i].end), ..self.nodes[*i] })
            .collect();
    }
}

impl Regrowing<'_, '_> {
    /// Regrows the tree of a cell. `wanted` says of each leaf whether it may be refined; all trees that went
    /// on below a leaf before are built again where it is, or if the members are asked for.
    pub fn regrow(
        &self,
        mut gathered: GatheredCell,
        kept: &KeptCell,
        wanted: &[bool],
    ) -> Result<Regrown, ChangedModel> {
        let tree = &kept.tree;
        let seed = seed_of(&kept.key);
        let top = Top::from_tree(tree);
        let leaf_of = self.follow(&mut gathered, tree, &top, seed)?;

        // The vertices of each leaf, side by side.
        let (starts, order) = lists(top.leaves.len(), leaf_of.iter().copied().zip(0u32..));

        let mut found = Regrown { cell: gathered.cell, grown: Vec::new(), members: Vec::new(), built: 0 };
        let mut workspace = TreeWorkspace::<Vertex>::default();
        for (ordinal, leaf) in top.leaves.iter().enumerate() {
            let of_leaf = &order[starts[ordinal] as usize..starts[ordinal + 1] as usize];
            let refined = wanted[leaf.samples.clone()].contains(&true);
            let has_grown = leaf.samples.len() > 1;
            let is_asked_for = has_grown && !gathered.ids.is_empty();
            let samples = &tree.samples[leaf.samples.clone()];
            // Where no sheets meet, no guides of the vertices are needed.
            let guides = self.guides.filter(|all| !gathered.guides.is_empty() && all.concern(samples));
            if !refined && !is_asked_for {
                for v in of_leaf.iter().map(|v| *v as usize).filter(|v| *v < gathered.ids.len()) {
                    let own = guides.map(|all| all.of_cluster(samples[0], gathered.guides[v]));
                    found.members.push((gathered.ids[v], own.unwrap_or(samples[0])));
                }
                continue;
            }
            let mut vertices: Vec<Vertex> = of_leaf
                .iter()
                .zip(0..)
                .map(|(v, index)| Vertex { index, ..gathered.vertices[*v as usize] })
                .collect();
            let below = mix(seed, ordinal as u64 + 1);
            let (grown, built) = self.grow(&mut vertices, tree, leaf, below, refined, &mut workspace)?;
            let grown = Grown { first_leaf: found.built, built, ..grown };
            self.take_leaf((grown, &workspace.leaves), of_leaf, (&gathered, guides), &mut found);
        }
        Ok(found)
    }

    /// Takes the tree of a leaf's vertices, whose new leaves are known, with the sheets that the vertices are
    /// on and the vertices as members.
    fn take_leaf(
        &self,
        (grown, leaves): (Grown, &[u32]),
        vertices: &[u32],
        (gathered, guides): (&GatheredCell, Option<&Guides<'_>>),
        found: &mut Regrown,
    ) {
        let Grown { first_leaf, built, .. } = grown;
        let (mut sheets, sheet_of) = guides.map_or_else(Default::default, |all| {
            all.sheets(vertices.iter().map(|v| gathered.guides[*v as usize]))
        });
        if sheets.len() < 2 {
            sheets.clear();
        }
        let mut on_sheet = vec![BTreeMap::<u32, Moments>::new(); sheets.len()];
        for (i, (v, leaf)) in vertices.iter().zip(leaves).enumerate() {
            let sheet = if sheets.is_empty() { 0 } else { sheet_of[i] };
            if let Some(on_sheet) = on_sheet.get_mut(sheet as usize) {
                let vertex = Moments::from_elements(&[gathered.vertices[*v as usize]]);
                on_sheet.entry(*leaf).or_default().add(&vertex);
            }
            if let Some(id) = gathered.ids.get(*v as usize) {
                found.members.push((*id, self.leaves_from + first_leaf + sheet * built + leaf));
            }
        }
        found.built += built * sheets.len().max(1) as u32;
        let sheets = sheets.into_iter().zip(on_sheet);
        let sheets = sheets.map(|(guide, leaves)| Sheet { guide, leaves: leaves.into_iter().collect() });
        found.grown.push(Grown { sheets: sheets.collect(), ..grown });
    }

    /// The leaf of the first sampling that each vertex belongs to.
    fn follow(
        &self,
        gathered: &mut GatheredCell,
        tree: &CutTree,
        top: &Top,
        seed: u64,
    ) -> Result<Vec<u32>, ChangedModel> {
        let mut leaf_of_item = vec![0u32; gathered.items()];
        if top.nodes.len() > 1 {
            let starts = top.parts(gathered.parts()).ok_or(ChangedModel)?;
            let along = KeptBranch { rule: self.rule, tree, top, seed };
            match &mut gathered.groups {
                Some((parts, _)) => {
                    let mut parts = parts.iter_mut().zip(starts);
                    parts.try_for_each(|(part, start)| along.build(part, start, &mut leaf_of_item))?;
                }
                None => {
                    let mut copy = gathered.vertices.clone();
                    let mut parts = copy.chunks_mut(VERTICES_OF_A_PART).zip(starts);
                    parts.try_for_each(|(part, start)| along.build(part, start, &mut leaf_of_item))?;
                }
            }
        }
        Ok((0..gathered.vertices.len()).map(|v| leaf_of_item[gathered.item_of(v)]).collect())
    }

    /// Tree of the vertices of a leaf: as far as it is kept, and on from there if it is `refined`. Also its
    /// number of leaves; the leaf of each vertex is in the workspace.
    fn grow(
        &self,
        vertices: &mut [Vertex],
        tree: &CutTree,
        leaf: &TopLeaf,
        seed: u64,
        refined: bool,
        workspace: &mut TreeWorkspace<Vertex>,
    ) -> Result<(Grown, u32), ChangedModel> {
        // Half diagonal and slack of each built node in turn, and the kept node that it is, if any.
        let mut told: Vec<(f32, f32, Option<u32>)> = Vec::new();
        let mut next = leaf.nodes.start;
        // The depth of the kept leaf below which new nodes come.
        let mut beyond: Option<u32> = None;
        let goes_on = |m: &Moments, key: f32, depth: u32| {
            if beyond.is_some_and(|leaf| depth <= leaf) {
                beyond = None;
            }
            let known = beyond.is_none().then(|| {
                next += 1;
                next - 1
            });
            let is_kept = known.is_some_and(|k| tree.children.get(k).is_some_and(|n| *n > 0));
            let reach = 0.5 * (m.max - m.min).length();
            let slack =
                if is_kept || !refined { 0.0 } else { self.sizing.slack(0.5 * (m.min + m.max), reach) };
            told.push((reach, slack, known.map(|k| k as u32)));
            if is_kept {
                return true;
            }
            let goes_on = refined && key - slack > self.bound;
            if goes_on && known.is_some() {
                beyond = Some(depth);
            }
            goes_on
        };
        let root = (tree.errors[leaf.nodes.start], seed);
        let (built, _) = VsTree::build_where(vertices, workspace, self.rule, root, goes_on);
        if next != leaf.nodes.end {
            return Err(ChangedModel);
        }
        let nodes = graded_nodes(&built, told, tree)?;
        let root = leaf.nodes.start as u32;
        Ok((Grown { root, nodes, first_leaf: 0, built: 0, sheets: Vec::new() }, built.built()))
    }
}

/// Nodes of a tree that was built along a kept one, with the errors that bounds are compared with. `told`
/// has, of each node in turn, half its diagonal, its slack, and the kept node that it is.
fn graded_nodes(
    built: &VsTree,
    told: Vec<(f32, f32, Option<u32>)>,
    tree: &CutTree,
) -> Result<Vec<GrownNode>, ChangedModel> {
    let mut nodes: Vec<GrownNode> = Vec::with_capacity(built.nodes.len());
    // Ancestors of the node: the end of each one's subtree, and its graded error.
    let mut above: Vec<(u32, f32)> = Vec::new();
    for (i, (node, (reach, slack, known))) in built.nodes.iter().zip(told).enumerate() {
        while above.pop_if(|(end, _)| *end as usize <= i).is_some() {}
        let kept = known.map(|k| k as usize).filter(|k| tree.children[*k] > 0);
        if let Some(k) = kept
            && (built.children(i) != u32::from(tree.children[k]) || node.key != tree.errors[k])
        {
            return Err(ChangedModel);
        }
        // A kept node that is split stays split, whatever the bound.
        let graded = match kept {
            Some(_) => f32::INFINITY,
            None => (node.key - slack).min(above.last().map_or(f32::INFINITY, |(_, graded)| *graded)),
        };
        above.push((node.end, graded));
        nodes.push(GrownNode {
            position: node.position,
            normal: node.normal,
            reach,
            error: node.key,
            graded,
            end: node.end,
            first: node.first,
            known,
        });
    }
    Ok(nodes)
}

/// Part of a cell's tree as it is kept.
struct KeptBranch<'a> {
    rule: SplitRule,
    tree: &'a CutTree,
    top: &'a Top,
    seed: u64,
}

impl KeptBranch<'_> {
    /// Builds the tree of a part of the cell's items again, of which the kept one begins at this node, and
    /// notes the leaf of each item.
    fn build<E: Element>(
        &self,
        part: &mut [E],
        start: usize,
        leaf_of: &mut [u32],
    ) -> Result<(), ChangedModel> {
        let first = part.first().map_or(0, E::index) as usize;
        let kept = &self.top.nodes[start..self.top.nodes[start].end];
        let before = kept[0].leaf;
        let slots = &mut leaf_of[first..first + part.len()];
        if kept.len() == 1 {
            slots.fill(before);
            return Ok(());
        }
        let (mut workspace, mut at) = (TreeWorkspace::default(), 0);
        let goes_on = |_: &Moments, _: f32, _: u32| {
            at += 1;
            kept.get(at - 1).is_some_and(|node| node.children > 0)
        };
        let root = (f32::INFINITY, self.seed);
        let (built, _) = VsTree::build_where(part, &mut workspace, self.rule, root, goes_on);
        slots.iter_mut().zip(&workspace.leaves).for_each(|(slot, leaf)| *slot = before + leaf);
        let same = |(i, known): (usize, &TopNode)| {
            built.children(i) == u32::from(known.children)
                && (known.children == 0 || built.nodes[i].key == self.tree.errors[known.kept])
        };
        (built.nodes.len() == kept.len() && kept.iter().enumerate().all(same))
            .then_some(())
            .ok_or(ChangedModel)
    }
}

/// The tree down to the samples of the first sampling.
struct Top {
    nodes: Vec<TopNode>,
    leaves: Vec<TopLeaf>,
}

struct TopNode {
    children: u8,
    /// Index behind its subtree.
    end: usize,
    /// Number of leaves before it.
    leaf: u32,
    /// Kept node that this leaf is.
    kept: usize,
}

/// Sample of the first sampling, and the nodes that have grown below it since.
struct TopLeaf {
    /// The kept nodes of its tree.
    nodes: std::ops::Range<usize>,
    /// Leaves of the sample's tree among those of the kept tree.
    samples: std::ops::Range<usize>,
}

impl Top {
    fn from_tree(tree: &CutTree) -> Self {
        let ends = tree.ends();
        let (mut nodes, mut leaves) = (Vec::<TopNode>::new(), Vec::new());
        let (mut kept, mut samples) = (0, 0);
        while kept < ends.len() {
            let is_leaf = tree.children[kept] == 0 || tree.grown.binary_search(&(kept as u32)).is_ok();
            let children = if is_leaf { 0 } else { tree.children[kept] };
            nodes.push(TopNode { children, end: 0, leaf: leaves.len() as u32, kept });
            if is_leaf {
                let below = tree.children[kept..ends[kept]].iter().filter(|n| **n == 0).count();
                leaves.push(TopLeaf { nodes: kept..ends[kept], samples: samples..samples + below });
                samples += below;
                kept = ends[kept];
            } else {
                kept += 1;
            }
        }
        for i in (0..nodes.len()).rev() {
            let end = (0..nodes[i].children).fold(i + 1, |at, _| nodes.get(at).map_or(at, |n| n.end));
            nodes[i].end = end;
        }
        Self { nodes, leaves }
    }

    /// The node with which the tree of each part begins: parts were joined one after the other. `None` if
    /// they cannot have been.
    fn parts(&self, parts: usize) -> Option<Vec<usize>> {
        let (mut starts, mut at, mut left) = (vec![0; parts], 0, parts);
        while left > 1 {
            let node = self.nodes.get(at)?;
            if node.children == 0 {
                break;
            }
            let second = self.nodes.get(at + 1)?.end;
            if node.children != 2 || second >= self.nodes.len() {
                return None;
            }
            left -= 1;
            starts[left] = second;
            at += 1;
        }
        starts[..left].fill(at);
        Some(starts)
    }
}
