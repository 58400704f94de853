//! The Volume-Surface Tree of one cell: T. Boubekeur, W. Heidrich, X. Granier, C. Schlick,
//! *Volume-Surface Trees*, Eurographics 2006, as used for clustering in the paper's §4.
//!
//! A cluster is split in space (octree) until it projects on its mean plane without folding, and from there
//! on in that plane (quadtree, 1 for 4). Splits are at the middle of the cluster's tight box, or at its mean
//! in the plane, and leave out axes that are much shorter than the longest, so that clusters stay about as
//! wide as long; where the surface bends along one axis alone, somewhat longer along the other. Two sheets
//! with opposite normals are parted at once, by the sign of their normals, instead of splitting down to their
//! distance.
//!
//! A node's *key* is its error, as weighted by `density`, or its parent's if that is less: the clusters of a
//! cut at ε are those reached from the root by going on while the key exceeds ε and there is something below,
//! and their number falls as ε grows.

use glam::{DMat3, DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::cluster::{Element, Moments};
use super::density::{By, SplitRule};
use super::layers::Layers;
use super::random::mix;
use super::splitting::Splitting;
use crate::geometry::symmetric_eigen;

/// A cluster projects on its mean plane without folding if its normals lie within this cosine of the plane's.
const FOLD_COSINE: f32 = 0.3;

/// Without normals, a cluster counts as flat if its thickness is below this part of its lesser width.
const FLATNESS: f64 = 0.1;

/// Axes shorter than this part of the longest are not split.
const SPLIT_ASPECT: f32 = 0.75;

/// An axis in the plane along which the surface does not bend counts as being of this part of its length.
const LEAST_BENDING: f32 = 0.4;

/// Part of a box's extent by which the mean of its vertices is off its middle where they are denser at one
/// end.
const LOPSIDED: f32 = 0.25;

/// Part of a cluster's error that its place in the tree adds: it orders clusters that are alike (a flat grid
/// of points has thousands) so that a cut through them is spread evenly instead of sweeping from one end.
const DITHER: f64 = 0.02;

/// Splits below this depth are coincident points in all but name.
const MAX_DEPTH: u32 = 96;

/// A cluster in a [`VsTree`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// The sample that stands for the cluster, in local coordinates.
    pub position: Vec3,
    /// The sample's unit normal; zero where unknown.
    pub normal: Vec3,
    /// [Variance](Moments::variance_of_mean) of the sample.
    pub variance: f32,
    /// The least error of this cluster and those above it.
    pub key: f32,
    /// Index of the first node behind this one's subtree; the children follow their parent.
    pub end: u32,
    /// First of the leaves below the node, counted in the tree as it was built.
    pub first: u32,
}

/// The clusters of a cell in preorder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct VsTree {
    /// All clusters, a parent before its children.
    pub nodes: Vec<Node>,
    /// Number of leaves that the tree was built with.
    built: u32,
}

impl VsTree {
    /// Builds the tree down to clusters of key `stop` or less. Reorders `elements`, which must not be empty.
    ///
    /// `workspace.leaves` then has the leaf of each element, at the element's index less that of the first
    /// one.
    ///
    /// Memory: `workspace` grows to the number of elements; the recursion is at most `MAX_DEPTH` deep.
    pub fn build<E: Element>(
        elements: &mut [E],
        workspace: &mut TreeWorkspace<E>,
        rule: impl Into<SplitRule>,
        stop: f32,
        seed: u64,
    ) -> (Self, Moments) {
        let goes_on = |_: &Moments, key: f32, _: u32| key > stop;
        Self::build_where(elements, workspace, rule, (f32::INFINITY, seed), goes_on)
    }

    /// Tree like that of [`build`](Self::build), where `goes_on` decides which clusters are split, if they
    /// can be: it is asked for each one, in preorder, with its moments, its key, and its depth. `root` is the
    /// least error above the tree, and the tree's seed.
    pub fn build_where<E: Element>(
        elements: &mut [E],
        workspace: &mut TreeWorkspace<E>,
        rule: impl Into<SplitRule>,
        root: (f32, u64),
        goes_on: impl FnMut(&Moments, f32, u32) -> bool,
    ) -> (Self, Moments) {
        let TreeWorkspace { spare, codes, leaves, nodes } = workspace;
        let moments = Moments::from_elements(elements);
        spare.clear();
        spare.extend_from_slice(elements);
        leaves.clear();
        leaves.resize(elements.len(), 0);
        nodes.clear();
        codes.resize(elements.len(), 0);
        let first_index = elements.first().map_or(0, E::index);
        let mut builder =
            TreeBuilder { rule: rule.into(), goes_on, nodes, built: 0, codes, leaves, first_index };
        let (above, seed) = root;
        let root = TreePosition { above, stage: SplitStage::Volume, depth: 0, seed };
        builder.node(elements, spare, moments, root);
        let built = builder.built;
        // Nodes are copied to a list that is just as long as it has to be.
        (Self { nodes: nodes.clone(), built }, moments)
    }

    /// Joins two trees over disjoint sets of vertices to one, below a cluster with the moments of both.
    pub fn join(first: Self, second: Self, both: &Moments) -> Self {
        let key = |tree: &Self| tree.nodes.first().map_or(0.0, |root| root.key);
        let covariance = both.covariance();
        let (position, normal, error) = both.representative_by(&covariance);
        let root = Node {
            position,
            normal,
            variance: both.variance_of_mean(&covariance),
            // The key is no less than those below.
            key: error.max(key(&first)).max(key(&second)),
            end: (1 + first.nodes.len() + second.nodes.len()) as u32,
            first: 0,
        };
        let behind = 1 + first.nodes.len() as u32;
        let mut nodes = vec![root];
        nodes.extend(first.nodes.into_iter().map(|n| Node { end: n.end + 1, ..n }));
        nodes.extend(second.nodes.into_iter().map(|n| Node {
            end: n.end + behind,
            first: n.first.wrapping_add(first.built),
            ..n
        }));
        Self { nodes, built: first.built.wrapping_add(second.built) }
    }

    /// Calls `visit` with each cluster of the cut at `threshold`, in order.
    pub fn cut(&self, threshold: f32, mut visit: impl FnMut(&Node)) {
        let mut i = 0;
        while let Some(node) = self.nodes.get(i) {
            if self.goes_on(i, threshold) {
                i += 1;
            } else {
                visit(node);
                i = node.end as usize;
            }
        }
    }

    /// Whether the nodes are a tree: one that was read from a file may be damaged.
    pub fn is_sound(&self) -> bool {
        let count = self.nodes.len();
        // The ends of the subtrees around the node at hand.
        let mut open: Vec<usize> = vec![count];
        let nests = |(i, node): (usize, &Node)| {
            while open.pop_if(|end| *end <= i).is_some() {}
            let end = node.end as usize;
            let fits = end > i && open.last().is_some_and(|around| end <= *around);
            open.push(end);
            let is_known = node.key >= 0.0 && node.variance >= 0.0;
            fits && is_known && node.position.is_finite() && node.normal.is_finite()
        };
        let is_whole = self.nodes.first().is_some_and(|root| root.end as usize == count);
        is_whole && self.nodes.iter().enumerate().all(nests)
    }

    /// Number of leaves that the tree was built with: more than it has, if it was pruned since.
    pub fn built(&self) -> u32 {
        self.built
    }

    /// Whether a cut at `threshold` goes on below node `i`.
    fn goes_on(&self, i: usize, threshold: f32) -> bool {
        self.nodes[i].key > threshold && self.nodes[i].end as usize > i + 1
    }

    /// Number of clusters that have nothing below them.
    pub fn leaves(&self) -> usize {
        self.nodes.iter().enumerate().filter(|(i, node)| node.end as usize == i + 1).count()
    }

    /// Drops everything below the cut at `threshold`.
    pub fn prune(&mut self, threshold: f32) {
        // Kept ancestors of the node at hand: their new places, and the former ends of their subtrees.
        let mut open: Vec<(usize, u32)> = Vec::new();
        let (mut i, mut kept) = (0, 0);
        while let Some(node) = self.nodes.get(i).copied() {
            while let Some((at, _)) = open.pop_if(|(_, end)| *end as usize <= i) {
                self.nodes[at].end = kept as u32;
            }
            let goes_on = self.goes_on(i, threshold);
            self.nodes[kept] = Node { end: kept as u32 + 1, ..node };
            if goes_on {
                open.push((kept, node.end));
            }
            kept += 1;
            i = if goes_on { i + 1 } else { node.end as usize };
        }
        for (at, _) in open {
            self.nodes[at].end = kept as u32;
        }
        self.nodes.truncate(kept);
        self.nodes.shrink_to_fit();
    }

    /// Clusters that a cut can split: their key, and the number of clusters that the split adds.
    pub fn splits(&self) -> impl Iterator<Item = (f32, u32)> + '_ {
        let inner = (0..self.nodes.len()).filter(|i| self.goes_on(*i, f32::NEG_INFINITY));
        inner.map(|i| (self.nodes[i].key, self.children(i) - 1))
    }

    /// Number of clusters that node `i` is split into.
    pub fn children(&self, i: usize) -> u32 {
        children(i, |node| self.nodes[node].end)
    }
}

/// Number of children of a node of a tree that is listed parent first; `end` is the index behind a node's
/// subtree.
pub fn children(node: usize, end: impl Fn(usize) -> u32) -> u32 {
    let (behind, mut child, mut children) = (end(node), node as u32 + 1, 0);
    while child < behind {
        children += 1;
        child = end(child as usize);
    }
    children
}

/// Memory that is used again from cell to cell.
pub struct TreeWorkspace<E> {
    spare: Vec<E>,
    codes: Vec<u8>,
    nodes: Vec<Node>,
    /// The leaf of each element.
    pub leaves: Vec<u32>,
}

impl<E> Default for TreeWorkspace<E> {
    fn default() -> Self {
        Self { spare: Vec::new(), codes: Vec::new(), nodes: Vec::new(), leaves: Vec::new() }
    }
}

/// Space in which a cluster is split.
#[derive(Debug, Clone, Copy)]
enum SplitStage {
    /// Splitting in space, along the coordinate axes.
    Volume,
    /// Splitting in the plane of these two unit vectors.
    Surface([Vec3; 2]),
}

/// Position of a cluster in the tree.
#[derive(Debug, Clone, Copy)]
struct TreePosition {
    /// Key of the cluster above.
    above: f32,
    stage: SplitStage,
    depth: u32,
    /// Seed, different for each position.
    seed: u64,
}

impl TreePosition {
    /// Position of a part of the cluster here, which has this key.
    fn below(self, key: f32, stage: SplitStage, part: usize) -> Self {
        Self { above: key, stage, depth: self.depth + 1, seed: mix(self.seed, part as u64 + 1) }
    }
}

struct TreeBuilder<'a, F> {
    rule: SplitRule,
    goes_on: F,
    nodes: &'a mut Vec<Node>,
    built: u32,
    /// Code of each element of the cluster at hand: the part that it goes to.
    codes: &'a mut [u8],
    leaves: &'a mut [u32],
    first_index: u32,
}

impl<F: FnMut(&Moments, f32, u32) -> bool> TreeBuilder<'_, F> {
    /// Adds the cluster of some elements, and those below. `spare` is as long as `elements`, and of any
    /// content.
    fn node<E: Element>(&mut self, elements: &mut [E], spare: &mut [E], m: Moments, place: TreePosition) {
        let dither = 1.0 + DITHER * (place.seed >> 40) as f64 / (1u64 << 24) as f64;
        let covariance = m.covariance();
        let (position, normal, error) = m.representative_by(&covariance);
        let layers = (self.rule.splitting == Splitting::Layered)
            .then(|| Layers::find(elements, &m, &covariance, place.seed))
            .flatten();
        let mut error = self.rule.key(&m, position, error);
        if layers.is_some() {
            // Samples go there before they go elsewhere.
            error = error.max(m.error_of_two_sheets(position));
        }
        let key = place.above.min((error * dither) as f32);
        let (variance, at) = (m.variance_of_mean(&covariance), self.nodes.len());
        self.nodes.push(Node { position, normal, variance, key, end: 0, first: self.built });
        let whole = !(self.goes_on)(&m, key, place.depth)
            || elements.len() == 1
            || m.min == m.max
            || place.depth == MAX_DEPTH;
        let split = match layers {
            _ if whole => false,
            Some(layers) => {
                let below = |part| place.below(key, place.stage, part);
                self.part(elements, spare, |e| usize::from(layers.is_upper(e)), below)
            }
            None => self.split(elements, spare, (&m, &covariance.matrix), key, place),
        };
        if !split {
            for e in elements.iter() {
                self.leaves[e.index().wrapping_sub(self.first_index) as usize] = self.built;
            }
            self.built += 1;
        }
        self.nodes[at].end = self.nodes.len() as u32;
    }

    /// Splits a cluster and goes on with its parts; `false` if nothing tells its elements apart.
    fn split<E: Element>(
        &mut self,
        elements: &mut [E],
        spare: &mut [E],
        (m, covariance): (&Moments, &DMat3),
        key: f32,
        place: TreePosition,
    ) -> bool {
        let stage = match place.stage {
            SplitStage::Surface(_) if m.mean_normal() != DVec3::ZERO => place.stage,
            _ if self.rule.splitting == Splitting::Octree => SplitStage::Volume,
            _ => match examine(elements, m, *covariance) {
                ClusterShape::Sheet(tangents) => SplitStage::Surface(tangents),
                ClusterShape::TwoSheets(axis) => {
                    let side = |e: &E| usize::from(e.normal().dot(axis) < 0.0);
                    let below = |part| place.below(key, SplitStage::Volume, part);
                    return self.part(elements, spare, side, below);
                }
                ClusterShape::Folded => SplitStage::Volume,
            },
        };
        if let SplitStage::Surface(tangents) = stage {
            let below = |part| place.below(key, stage, part);
            // Few vertices beside many: at the mean of all these would be parted, and the few never from
            // them.
            if self.rule.by == By::Vertices && is_lopsided(m) && self.part(elements, spare, octant(m), below)
            {
                return true;
            }
            if self.part(elements, spare, quadrant(m, *covariance, tangents), below) {
                return true;
            }
            // The elements are all on one line along the normal, or too close to tell apart in the plane.
        }
        self.part(elements, spare, octant(m), |part| place.below(key, SplitStage::Volume, part))
    }

    /// Parts the elements by `code` < 8, and goes on with each part; `false` if they all have the same code.
    fn part<E: Element>(
        &mut self,
        elements: &mut [E],
        spare: &mut [E],
        code: impl Fn(&E) -> usize,
        below: impl Fn(usize) -> TreePosition,
    ) -> bool {
        let mut counts = [0usize; 8];
        let codes = &mut self.codes[..elements.len()];
        for (slot, e) in codes.iter_mut().zip(elements.iter()) {
            let c = code(e) & 7;
            counts[c] += 1;
            *slot = c as u8;
        }
        if counts.contains(&elements.len()) {
            return false;
        }
        let mut starts = [0usize; 9];
        for i in 0..8 {
            starts[i + 1] = starts[i] + counts[i];
        }
        // The parts are in the other half of the memory, and theirs again in this one.
        let mut next = starts;
        for (c, e) in codes.iter().zip(elements.iter()) {
            let next = &mut next[*c as usize & 7];
            spare[*next] = *e;
            *next += 1;
        }
        for c in 0..8 {
            let range = starts[c]..starts[c + 1];
            if !range.is_empty() {
                let moments = Moments::from_elements(&spare[range.clone()]);
                let (part, rest) = (&mut spare[range.clone()], &mut elements[range]);
                self.node(part, rest, moments, below(c));
            }
        }
        true
    }
}

/// Arrangement of the vertices of a cluster.
enum ClusterShape {
    /// Vertices project on the plane of these vectors without folding.
    Sheet([Vec3; 2]),
    /// Vertices are on two sheets across this direction, with opposite normals.
    TwoSheets(Vec3),
    /// Vertices that are neither.
    Folded,
}

/// The transition predicate of the VS-Tree: normals within a cone, or without normals a strict flatness test.
fn examine<E: Element>(vertices: &[E], m: &Moments, covariance: DMat3) -> ClusterShape {
    let normal = m.mean_normal();
    if !m.has_normals() {
        let (values, vectors) = symmetric_eigen(covariance);
        return if values.x <= FLATNESS * FLATNESS * values.y {
            ClusterShape::Sheet([vectors.z_axis.as_vec3(), vectors.y_axis.as_vec3()])
        } else {
            ClusterShape::Folded
        };
    }
    // A few vertices without a normal do not hide the sheets that the others show.
    let known = || vertices.iter().map(E::normal).filter(|n| *n != Vec3::ZERO);
    let n = normal.as_vec3();
    if normal != DVec3::ZERO && known().all(|s| s.dot(n) > FOLD_COSINE) {
        return ClusterShape::Sheet(principal_tangents(covariance, normal));
    }
    let axis = symmetric_eigen(m.normal_scatter()).1.z_axis.as_vec3();
    let mut sides = [false; 2];
    for s in known() {
        let cosine = s.dot(axis);
        if cosine.abs() <= FOLD_COSINE {
            return ClusterShape::Folded;
        }
        sides[usize::from(cosine < 0.0)] = true;
    }
    if sides == [true, true] { ClusterShape::TwoSheets(axis) } else { ClusterShape::Folded }
}

/// Unit vectors across `normal`, along the longest and the shortest extent of the cluster there.
fn principal_tangents(covariance: DMat3, normal: DVec3) -> [Vec3; 2] {
    let (u, v) = normal.any_orthonormal_pair();
    let (a, b, c) = (u.dot(covariance * u), u.dot(covariance * v), v.dot(covariance * v));
    let angle = 0.5 * (2.0 * b).atan2(a - c);
    let t = u * angle.cos() + v * angle.sin();
    [t.as_vec3(), normal.cross(t).as_vec3()]
}

/// Whether the mean is far from the middle of the box, along any of its longer axes.
fn is_lopsided(m: &Moments) -> bool {
    let extent = m.max - m.min;
    let off = (m.mean().as_vec3() - (m.min * 0.5 + m.max * 0.5)).abs();
    let long = extent.cmpgt(Vec3::splat(extent.max_element() * SPLIT_ASPECT));
    (off.cmpgt(extent * LOPSIDED) & long).any()
}

/// The code of an element's place in the cluster's box: one bit per axis that is split, at the middle.
fn octant<E: Element>(m: &Moments) -> impl Fn(&E) -> usize + use<E> {
    let extent = m.max - m.min;
    let split = extent.cmpgt(Vec3::splat(extent.max_element() * SPLIT_ASPECT)).bitmask() as usize;
    let middle = m.min * 0.5 + m.max * 0.5;
    move |e| e.position().cmpgt(middle).bitmask() as usize & split
}

/// The quadrant of an element in the plane of two unit vectors, about the mean.
fn quadrant<E: Element>(
    m: &Moments,
    covariance: DMat3,
    tangents: [Vec3; 2],
) -> impl Fn(&E) -> usize + use<E> {
    let mean = m.mean().as_vec3();
    let deviation = |t: Vec3| t.as_dvec3().dot(covariance * t.as_dvec3()).max(0.0).sqrt() as f32;
    let [bend1, bend2] = m.bending(tangents).map(|bending| bending.max(LEAST_BENDING));
    let [t1, t2] = tangents;
    let (a, b) = (bend1 * deviation(t1), bend2 * deviation(t2));
    let split = usize::from(a > b * SPLIT_ASPECT) | usize::from(b > a * SPLIT_ASPECT) << 1;
    move |e| {
        let p = e.position() - mean;
        (usize::from(p.dot(t1) > 0.0) | usize::from(p.dot(t2) > 0.0) << 1) & split
    }
}

#[cfg(test)]
mod tests {
    use super::super::cluster::Vertex;
    use super::*;
    use proptest::prelude::*;

    fn vertex(position: Vec3, normal: Vec3) -> Vertex {
        Vertex { position, normal, index: 0 }
    }

    fn full(vertices: &[Vertex]) -> VsTree {
        let mut elements = vertices.to_vec();
        (0..).zip(&mut elements).for_each(|(i, e)| e.index = i);
        let mut workspace = TreeWorkspace::default();
        let (tree, _) = VsTree::build(&mut elements, &mut workspace, Splitting::VolumeSurface, 0.0, 7);
        // Every element is in the leaf that it is told to be in.
        assert_eq!(tree.leaves(), tree.built() as usize);
        let mut found = Vec::new();
        tree.cut(0.0, |node| found.push(node.position));
        for (s, leaf) in vertices.iter().zip(&workspace.leaves) {
            // Vertices in one leaf are the same point, or nearly.
            assert!(found[*leaf as usize].distance(s.position) < 1e-20);
        }
        tree
    }

    fn clusters(tree: &VsTree, threshold: f32) -> Vec<Node> {
        let mut nodes = Vec::new();
        tree.cut(threshold, |node| nodes.push(*node));
        nodes
    }

    fn any_vertices() -> impl Strategy<Value = Vec<Vertex>> {
        let x = || prop_oneof![-1.0..1.0f32, (-2..2i32).prop_map(|x| x as f32)];
        let normal = prop_oneof![
            Just(Vec3::ZERO),
            Just(Vec3::X),
            (x(), x(), x()).prop_map(|(x, y, z)| Vec3::new(x, y, z).normalize_or_zero()),
        ];
        let one = ((x(), x(), x()), normal).prop_map(|((x, y, z), n)| vertex(Vec3::new(x, y, z), n));
        proptest::collection::vec(one, 1..150)
    }

    proptest! {
        #[test]
        fn a_full_tree_has_a_leaf_for_each_distinct_vertex(vertices in any_vertices()) {
            let tree = full(&vertices);
            let mut distinct: Vec<_> = vertices.iter().map(|s| s.position.to_array().map(|x| (x + 0.0).to_bits())).collect();
            distinct.sort_unstable();
            distinct.dedup();
            // Coincident vertices with opposite normals are two.
            prop_assert!(tree.leaves() >= distinct.len());
            for s in &vertices {
                let nearest = clusters(&tree, 0.0).iter().map(|c| c.position.distance(s.position)).fold(f32::MAX, f32::min);
                prop_assert_eq!(nearest, 0.0);
            }
        }

        #[test]
        fn representatives_stay_inside_and_cuts_nest(vertices in any_vertices(), t in 0.0..0.5f32, u in 0.0..0.5f32) {
            let tree = full(&vertices);
            let (low, high) = (t.min(u), t.max(u));
            prop_assert!(clusters(&tree, low).len() >= clusters(&tree, high).len());
            let m = Moments::from_elements(&vertices);
            let (min, max) = (m.min, m.max);
            for node in &tree.nodes {
                prop_assert!(node.position.cmpge(min).all() && node.position.cmple(max).all());
            }
            // Pruned at the lower bound, the tree still gives the cut at the higher one.
            let mut pruned = tree.clone();
            pruned.prune(low);
            let places = |tree: &VsTree| clusters(tree, high).iter().map(|c| c.position).collect::<Vec<_>>();
            prop_assert_eq!(places(&pruned), places(&tree));
            prop_assert_eq!(pruned.leaves(), clusters(&tree, low).len());
        }

        #[test]
        fn splits_count_what_a_cut_adds(vertices in any_vertices(), threshold in 0.0..0.5f32) {
            let tree = full(&vertices);
            let added: u32 = tree.splits().filter(|(key, _)| *key > threshold).map(|(_, n)| n).sum();
            prop_assert_eq!(1 + added as usize, clusters(&tree, threshold).len());
        }
    }

    #[test]
    fn a_joined_tree_cuts_as_both() {
        let set = |z: f32| -> Vec<Vertex> {
            (0..400)
                .map(|i| {
                    vertex(Vec3::new((i % 20) as f32, (i as f32 * 0.7).sin(), z + (i / 20) as f32), Vec3::Y)
                })
                .collect()
        };
        let (a, b) = (set(0.0), set(20.0));
        let mut both = Moments::from_elements(&a);
        both.add(&Moments::from_elements(&b));
        let joined = VsTree::join(full(&a), full(&b), &both);
        for threshold in [0.0, 0.1, 0.5, 1.0] {
            let mut apart = clusters(&full(&a), threshold);
            apart.extend(clusters(&full(&b), threshold));
            let places = |nodes: &[Node]| nodes.iter().map(|n| n.position).collect::<Vec<_>>();
            assert_eq!(places(&clusters(&joined, threshold)), places(&apart));
        }
        assert_eq!(clusters(&joined, f32::INFINITY).len(), 1);
        let added: u32 = joined.splits().map(|(_, n)| n).sum();
        assert_eq!(1 + added as usize, joined.leaves());
    }

    #[test]
    fn opposite_sides_of_a_thin_plate_are_never_merged() {
        let side = |y: f32, n: Vec3| {
            (0..400).map(move |i| vertex(Vec3::new((i % 20) as f32, y, (i / 20) as f32) / 20.0, n))
        };
        let plate: Vec<_> = side(0.0, -Vec3::Y).chain(side(0.001, Vec3::Y)).collect();
        let tree = full(&plate);
        // The root is split into the two sides, and each cluster below has the normal of one of them.
        for node in &tree.nodes[1..] {
            assert!(node.normal.y.abs() > 0.99, "{node:?}");
        }
        assert_eq!(tree.splits().next().map(|(_, added)| added), Some(1));
    }

    #[test]
    fn a_vertex_without_a_normal_does_not_merge_sheets() {
        let side = |y: f32| (0..400).map(move |i| Vec3::new((i % 20) as f32, y, (i / 20) as f32) / 20.0);
        let mut plate: Vec<_> = side(0.0).map(|p| vertex(p, -Vec3::Y)).collect();
        plate.extend(side(0.001).map(|p| vertex(p, Vec3::Y)));
        plate[123].normal = Vec3::ZERO;
        let full = full(&plate);
        assert!(full.nodes[1..].iter().all(|n| n.normal.y.abs() > 0.99 || n.normal == Vec3::ZERO));
    }

    #[test]
    fn a_flat_patch_is_split_in_its_plane() {
        // Tilted: an octree would cut it into slivers along the axes.
        let n = Vec3::new(0.4, 0.7, 0.3).normalize_or(Vec3::Y);
        let (u, v) = n.any_orthonormal_pair();
        let patch: Vec<_> = (0..1024).map(|i| vertex(u * (i % 32) as f32 + v * (i / 32) as f32, n)).collect();
        let tree = full(&patch);
        let (_, added) = tree.splits().next().expect("a split");
        assert_eq!(added, 3, "one for four");
        assert_eq!(tree.leaves(), 1024);
        // 1 + 4 + 16 + … + 1024 = 1365 clusters if each split is in four; small ones of 2 × 3 vertices are
        // not.
        assert!(tree.nodes.len() < 2000, "{} clusters", tree.nodes.len());
    }

    #[test]
    fn coincident_and_collinear_vertices_end() {
        assert_eq!(full(&[vertex(Vec3::ONE, Vec3::X); 100]).nodes.len(), 1);
        let line: Vec<_> = (0..100).map(|i| vertex(Vec3::X * i as f32, Vec3::Y)).collect();
        assert_eq!(full(&line).leaves(), 100);
        let across: Vec<_> = (0..100).map(|i| vertex(Vec3::Y * i as f32, Vec3::Y)).collect();
        assert_eq!(full(&across).leaves(), 100);
        let halving: Vec<_> = (0..140).map(|i| vertex(Vec3::X * 0.5f32.powi(i), Vec3::ZERO)).collect();
        assert!(full(&halving).leaves() > 90);
    }
}
