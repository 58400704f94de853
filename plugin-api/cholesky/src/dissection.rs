//! An order of elimination that leaves factors small, and parts of it that have nothing to do with each
//! other.
//!
//! A. George, *Nested Dissection of a Regular Finite Element Mesh*, SIAM J. Numer. Anal. 1973: a set of nodes
//! is halved, and the nodes that part the halves are eliminated after both. As the nodes lie in space, each
//! set is halved across one of its principal axes (J. Gilbert, G. Miller, S.-H. Teng, *Geometric Mesh
//! Partitioning*, SISC 1998), at the place where the fewest nodes are next to those beyond. Of these nodes on
//! both sides the fewest are taken that part the halves (`separator`).

use crate::separator::least_cover;
use glam::DVec3;
use simod_geometry::jacobi_eigen;
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

/// Sets of so few nodes are not halved.
const LEAF: usize = 16;
/// Sets of fewer nodes are cut across their longest axis: the others gain next to nothing there.
const LARGE: usize = 2048;
/// Least part of a set's nodes on either side of a cut.
const LEAST_SIDE: f64 = 0.3;
/// Increase of a cut's cost, as a part of it, for each of the set's nodes by which the cut is off the middle,
/// as a part of all.
const UNEVEN: f64 = 2.0;
/// Nodes that are eliminated at once, at most.
const MOST_AT_ONCE: usize = 256;
/// Into about so many subtrees the tree is cut, whatever the number of threads.
const SUBTREES: usize = 32;
/// But they have so many nodes, at most, without being cut further.
const LEAST_SUBTREE: usize = 1024;

/// Graph of the matrix: pairs of nodes that share an entry off its diagonal.
#[derive(Debug)]
pub struct Pattern {
    starts: Vec<usize>,
    all: Vec<u32>,
}

/// The order of elimination, and the supernodes, each eliminated at once.
#[derive(Debug, Default)]
pub struct EliminationTree {
    /// Nodes as they are eliminated.
    pub order: Vec<u32>,
    /// Supernodes, children before parents.
    pub parts: Vec<Supernode>,
    /// Ranges of supernodes that share no entry with those of other ranges; the remaining ones come last.
    pub subtrees: Vec<Range<usize>>,
}

/// Nodes that are eliminated at once.
#[derive(Debug)]
pub struct Supernode {
    /// Places of the nodes in the order.
    pub columns: Range<usize>,
    /// Indices of the earlier supernodes that this one separates from each other.
    pub children: Vec<usize>,
}

/// A set of nodes.
#[derive(Debug, Default)]
struct Set {
    /// Places of the set's nodes: those of its halves, then those between.
    nodes: Range<usize>,
    /// Number of nodes between the halves: all of the set if it is not halved.
    between: usize,
    halves: Vec<usize>,
    /// The set's supernode, by its place among them, once there is one.
    part: usize,
}

impl Pattern {
    /// Of the rows of a matrix' lower triangle, where they start and their columns.
    pub fn new(starts: &[usize], columns: &[u32]) -> Self {
        let rows = starts.windows(2).map(|w| &columns[w[0]..w[1]]).enumerate();
        let pairs =
            rows.flat_map(|(i, row)| row.iter().map(move |j| (i, *j as usize))).filter(|(i, j)| i != j);
        let mut this = Self { starts: vec![0; starts.len()], all: Vec::new() };
        for (i, j) in pairs.clone() {
            this.starts[i + 1] += 1;
            this.starts[j + 1] += 1;
        }
        (1..starts.len()).for_each(|i| this.starts[i] += this.starts[i - 1]);
        this.all.resize(this.starts[starts.len() - 1], 0);
        let mut next = this.starts.clone();
        for (i, j) in pairs {
            for (from, to) in [(i, j), (j, i)] {
                this.all[next[from]] = to as u32;
                next[from] += 1;
            }
        }
        this
    }

    fn around(&self, i: u32) -> &[u32] {
        &self.all[self.starts[i as usize]..self.starts[i as usize + 1]]
    }
}

impl EliminationTree {
    /// The order of elimination of nodes that are `at` these places.
    pub fn new(pattern: &Pattern, at: &[DVec3], host: &Host<'_>) -> PluginResult<Self> {
        let mut nodes: Vec<u32> = (0..at.len() as u32).collect();
        let mut sets = dissect(&mut nodes, pattern, at, host)?;
        let limit = (at.len() / SUBTREES).max(LEAST_SUBTREE);
        let mut this = Self::default();
        this.take_subtrees(&mut sets, 0, &nodes, limit);
        this.take(&mut sets, 0, &nodes, limit);
        Ok(this)
    }

    /// Takes the subtrees of at most `limit` nodes.
    fn take_subtrees(&mut self, sets: &mut [Set], set: usize, nodes: &[u32], limit: usize) {
        if sets[set].nodes.len() > limit {
            for half in sets[set].halves.clone() {
                self.take_subtrees(sets, half, nodes, limit);
            }
        } else {
            let first = self.parts.len();
            self.take(sets, set, nodes, 0);
            self.subtrees.push(first..self.parts.len());
        }
    }

    /// Takes a set but for its subtrees of at most `limit` nodes.
    fn take(&mut self, sets: &mut [Set], set: usize, nodes: &[u32], limit: usize) {
        if sets[set].nodes.len() <= limit {
            return;
        }
        for half in sets[set].halves.clone() {
            self.take(sets, half, nodes, limit);
        }
        let mut children: Vec<usize> = sets[set].halves.iter().map(|half| sets[*half].part).collect();
        let own = &nodes[sets[set].nodes.end - sets[set].between..sets[set].nodes.end];
        for own in own.chunks(MOST_AT_ONCE) {
            let first = self.order.len();
            self.order.extend_from_slice(own);
            self.parts.push(Supernode { columns: first..self.order.len(), children });
            children = vec![self.parts.len() - 1];
        }
        if own.is_empty() {
            self.parts.push(Supernode { columns: self.order.len()..self.order.len(), children });
        }
        sets[set].part = self.parts.len() - 1;
    }
}

/// Halves sets again and again, and puts `nodes` in the sets' order. The first set is that of all.
fn dissect(nodes: &mut [u32], pattern: &Pattern, at: &[DVec3], host: &Host<'_>) -> PluginResult<Vec<Set>> {
    let places = Places((0..nodes.len()).map(|_| AtomicU32::new(0)).collect());
    let mut sets = vec![Set { nodes: 0..nodes.len(), ..Set::default() }];
    let mut level = 0..1;
    while !level.is_empty() {
        host.progress(0.0)?;
        let mut rest = &mut *nodes;
        let mut passed = 0;
        let mut tasks = Vec::with_capacity(level.len());
        for set in level.clone() {
            let range = sets[set].nodes.clone();
            let (own, after) = rest.split_at_mut(range.start - passed).1.split_at_mut(range.len());
            (rest, passed) = (after, range.end);
            tasks.push((set, own, [0; 2]));
        }
        // Few sets are large, and each is a task then.
        let together = tasks.len().div_ceil(4 * SUBTREES);
        host.parallel_blocks(&mut tasks, together, |_, tasks| {
            for (_, nodes, halves) in tasks.iter_mut().filter(|t| t.1.len() > LEAF) {
                *halves = halve(nodes, &places, pattern, at);
            }
        })?;
        let halved: Vec<(usize, [usize; 2])> = tasks.into_iter().map(|(s, _, h)| (s, h)).collect();
        for (set, halves) in halved {
            let mut start = sets[set].nodes.start;
            for count in halves.into_iter().filter(|count| *count > 0) {
                let half = sets.len();
                sets[set].halves.push(half);
                sets.push(Set { nodes: start..start + count, ..Set::default() });
                start += count;
            }
            sets[set].between = sets[set].nodes.end - start;
        }
        level = level.end..sets.len();
    }
    Ok(sets)
}

/// Place of each node in the order of the set that is being halved; other threads look as well, but for
/// places in sets of theirs.
struct Places(Vec<AtomicU32>);

impl Places {
    /// Notes the places of a set's nodes.
    fn note(&self, along: &[u32]) {
        (0..).zip(along).for_each(|(place, i)| self.0[*i as usize].store(place, Ordering::Relaxed));
    }

    /// Places of those nodes of a set, in its order, that share an entry with the one at a place.
    fn around<'a>(
        &'a self,
        along: &'a [u32],
        place: usize,
        pattern: &'a Pattern,
    ) -> impl Iterator<Item = usize> + 'a {
        let others = pattern.around(along[place]).iter();
        let place_of = |i: &u32| (self.0[*i as usize].load(Ordering::Relaxed) as usize, *i);
        others.map(place_of).filter(|(place, i)| along.get(*place) == Some(i)).map(|(place, _)| place)
    }
}

/// A set's nodes, halved.
struct Cut {
    /// The nodes along an axis.
    along: Vec<u32>,
    /// Number of those in the first half.
    first: usize,
    /// Nodes that part the halves, about, and more where these are uneven.
    cost: f64,
}

/// Sorts nodes by the half that they are in, those between last; gives the halves' sizes.
fn halve(nodes: &mut [u32], places: &Places, pattern: &Pattern, at: &[DVec3]) -> [usize; 2] {
    let axes = principal_axes(nodes, at).into_iter().take(if nodes.len() < LARGE { 1 } else { 3 });
    let cuts = axes.map(|axis| cut_along(axis, nodes, places, pattern, at));
    let cheaper = |a: Cut, b: Cut| if b.cost < a.cost { b } else { a };
    let Some(Cut { along, first, .. }) = cuts.reduce(cheaper) else { return [0; 2] };
    places.note(&along);
    let beyond = |k: usize| places.around(&along, k, pattern).filter_map(|place| place.checked_sub(first));
    let is_between = least_cover([first, along.len() - first], beyond).concat();
    let half = |k: usize| if is_between[k] { 2 } else { usize::from(k >= first) };
    let mut sizes = [0; 3];
    (0..along.len()).for_each(|k| sizes[half(k)] += 1);
    let mut next = [0, sizes[0], sizes[0] + sizes[1]];
    for (k, i) in along.iter().enumerate() {
        nodes[next[half(k)]] = *i;
        next[half(k)] += 1;
    }
    [sizes[0], sizes[1]]
}

/// The cut across an axis whose cost is least.
fn cut_along(axis: DVec3, nodes: &[u32], places: &Places, pattern: &Pattern, at: &[DVec3]) -> Cut {
    let mut along: Vec<(f64, u32)> = nodes.iter().map(|i| (at[*i as usize].dot(axis), *i)).collect();
    along.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let along: Vec<u32> = along.into_iter().map(|(_, i)| i).collect();
    places.note(&along);
    let count = along.len();
    // Changes, from the cut before, of the numbers of nodes on either side that are next to the other one.
    let mut changes = vec![[0_i32; 2]; count + 1];
    for k in 0..count {
        let (mut least, mut most) = (k, k);
        for place in places.around(&along, k, pattern) {
            (least, most) = (least.min(place), most.max(place));
        }
        changes[k + 1][0] += 1;
        changes[most + 1][0] -= 1;
        changes[least + 1][1] += 1;
        changes[k + 1][1] -= 1;
    }
    let least = ((LEAST_SIDE * count as f64) as usize).max(1);
    let (mut borders, mut first, mut cost) = ([0; 2], count / 2, f64::INFINITY);
    for (cut, [one, other]) in changes.into_iter().enumerate().take(count - least + 1).skip(1) {
        borders = [borders[0] + one, borders[1] + other];
        let off = (cut as f64 / count as f64 - 0.5).abs();
        let costs = f64::from(borders[0].min(borders[1]) + 1) * (1.0 + UNEVEN * off);
        if cut >= least && costs < cost {
            (first, cost) = (cut, costs);
        }
    }
    Cut { along, first, cost }
}

/// The directions in which nodes extend, the longest first.
fn principal_axes(nodes: &[u32], at: &[DVec3]) -> [DVec3; 3] {
    let mean = nodes.iter().map(|i| at[*i as usize]).sum::<DVec3>() / nodes.len() as f64;
    let mut covariance = [[0.0; 3]; 3];
    for i in nodes {
        let v = at[*i as usize] - mean;
        (0..3).for_each(|r| (0..3).for_each(|c| covariance[r][c] += v[r] * v[c]));
    }
    let (values, vectors) = jacobi_eigen(covariance);
    let mut axes = [0, 1, 2];
    axes.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
    axes.map(|axis| DVec3::from(vectors[axis]))
}
