//! An order of elimination that leaves factors small, and parts of it that have nothing to do with each
//! other.
//!
//! A. George, *Nested Dissection of a Regular Finite Element Mesh*, SIAM J. Numer. Anal. 1973: a set of nodes
//! is halved, and the nodes that part the halves are eliminated after both. As the nodes lie in space, each
//! set is halved across its longest extent (J. Gilbert, G. Miller, S.-H. Teng, *Geometric Mesh Partitioning*,
//! SISC 1998).

use glam::DVec3;
use simod_geometry::jacobi_eigen;
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

/// Sets of so few nodes are not halved.
const LEAF: usize = 24;
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
    // Half that each node is in; other threads look as well, but for halves of theirs.
    let half_of: Vec<AtomicU32> = (0..nodes.len()).map(|_| AtomicU32::new(0)).collect();
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
            tasks.push((set as u32, own, [0; 2]));
        }
        // Few sets are large, and each is a task then.
        let together = tasks.len().div_ceil(4 * SUBTREES);
        host.parallel_blocks(&mut tasks, together, |_, tasks| {
            for (set, nodes, halves) in tasks.iter_mut().filter(|t| t.1.len() > LEAF) {
                *halves = halve(nodes, [2 * *set + 1, 2 * *set + 2], &half_of, pattern, at);
            }
        })?;
        let halved: Vec<(usize, [usize; 2])> = tasks.into_iter().map(|(s, _, h)| (s as usize, h)).collect();
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

/// Sorts nodes by the half that they are in, those between last; gives the halves' sizes. `names` are the
/// halves', of no others.
fn halve(
    nodes: &mut [u32],
    names: [u32; 2],
    half_of: &[AtomicU32],
    pattern: &Pattern,
    at: &[DVec3],
) -> [usize; 2] {
    let axis = longest_axis(nodes, at);
    let mut along: Vec<(f64, u32)> = nodes.iter().map(|i| (at[*i as usize].dot(axis), *i)).collect();
    let middle = along.len() / 2;
    along.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (k, (_, i)) in along.iter().enumerate() {
        half_of[*i as usize].store(names[usize::from(k >= middle)], Ordering::Relaxed);
    }
    // The separator: the nodes next to the other half, of whichever half has fewer.
    let touches = |i: u32, half: u32| {
        pattern.around(i).iter().any(|j| half_of[*j as usize].load(Ordering::Relaxed) == half)
    };
    let border = |side: usize| -> Vec<bool> {
        let half = if side == 0 { &along[..middle] } else { &along[middle..] };
        half.iter().map(|(_, i)| touches(*i, names[1 - side])).collect()
    };
    let borders = [border(0), border(1)];
    let sizes = borders.each_ref().map(|b| b.iter().filter(|b| **b).count());
    let parting = usize::from(sizes[1] < sizes[0]);
    let mut next = [0, middle, nodes.len() - sizes[parting]];
    if parting == 0 {
        next[1] -= sizes[0];
    }
    let starts = next;
    for (k, (_, i)) in along.iter().enumerate() {
        let side = usize::from(k >= middle);
        let is_between = side == parting && borders[side][k - side * middle];
        let to = if is_between { 2 } else { side };
        nodes[next[to]] = *i;
        next[to] += 1;
    }
    [next[0] - starts[0], next[1] - starts[1]]
}

/// The direction in which nodes extend most.
fn longest_axis(nodes: &[u32], at: &[DVec3]) -> DVec3 {
    let mean = nodes.iter().map(|i| at[*i as usize]).sum::<DVec3>() / nodes.len() as f64;
    let mut covariance = [[0.0; 3]; 3];
    for i in nodes {
        let v = at[*i as usize] - mean;
        (0..3).for_each(|r| (0..3).for_each(|c| covariance[r][c] += v[r] * v[c]));
    }
    let (values, vectors) = jacobi_eigen(covariance);
    let longest = (0..3).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap_or(0);
    DVec3::from(vectors[longest])
}
