//! A coarse likeness of a surface: a few thousand groups of nodes, on which rotations find their way around
//! in a fraction of the time.
//!
//! Rotations vary slowly, so that those of groups do for a start (A. Jacobson et al., *Fast Automatic
//! Skinning Transformations*, SIGGRAPH 2012). Groups grow around nodes in their order, as in P. Vaněk, J.
//! Mandel, M. Brezina, *Algebraic Multigrid by Smoothed Aggregation*, 1996, and again around groups, until
//! there are few enough.

use crate::constraints::{SampleTarget, Soft};
use crate::elements::SurfaceTriangle;
use crate::problem::{Constraint, Problem};
use crate::rotation;
use glam::{DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Most groups: groups are merged while there are more.
const MOST: usize = 4000;
/// Most groups that merging may leave, as a part of those before, to go on.
const WORTH: f64 = 0.7;

/// Weights by which rotations of groups become those of nodes.
#[derive(Debug)]
pub struct Prolongation {
    /// Groups that each node takes part in, and the node's weights, which add up to 1.
    groups: Lists<(u32, f32)>,
    /// Nodes that take part in each group, and their weights.
    members: Lists<(u32, f32)>,
}

/// Lists in one.
#[derive(Debug)]
pub struct Lists<T> {
    starts: Vec<usize>,
    all: Vec<T>,
}

impl<T: Copy + Send> Lists<T> {
    /// The lists of so many, `together` of them by one thread, each as `list` fills it.
    pub fn made(
        count: usize,
        together: usize,
        host: &Host<'_>,
        list: impl Fn(usize, &mut Vec<T>) + Sync,
    ) -> PluginResult<Self> {
        let empty = || Self { starts: Vec::new(), all: Vec::new() };
        let mut blocks: Vec<Self> = (0..count.div_ceil(together)).map(|_| empty()).collect();
        host.parallel_blocks(&mut blocks, 1, |first, blocks| {
            let mut made = Vec::new();
            for (k, block) in (first..).zip(blocks) {
                for i in k * together..count.min((k + 1) * together) {
                    made.clear();
                    list(i, &mut made);
                    block.starts.push(block.all.len());
                    block.all.extend_from_slice(&made);
                }
            }
        })?;
        let mut lists = Self {
            starts: Vec::with_capacity(count + 1),
            all: Vec::with_capacity(blocks.iter().map(|block| block.all.len()).sum()),
        };
        for block in blocks {
            let before = lists.all.len();
            lists.starts.extend(block.starts.iter().map(|start| before + start));
            lists.all.extend(block.all);
        }
        lists.starts.push(lists.all.len());
        Ok(lists)
    }

    /// List number `i`.
    pub fn row(&self, i: usize) -> &[T] {
        &self.all[self.starts[i]..self.starts[i + 1]]
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Lists of numbers with weights.
impl Lists<(u32, f32)> {
    /// The lists the other way round, for numbers below `count`.
    fn transposed(&self, count: usize) -> Self {
        let mut starts = vec![0; count + 1];
        self.all.iter().for_each(|(group, _)| starts[*group as usize + 1] += 1);
        (0..count).for_each(|i| starts[i + 1] += starts[i]);
        let mut next = starts.clone();
        let mut all = vec![(0, 0.0); self.all.len()];
        for i in 0..self.len() {
            for &(group, weight) in self.row(i) {
                all[next[group as usize]] = (i as u32, weight);
                next[group as usize] += 1;
            }
        }
        Self { starts, all }
    }

    /// Weighted sum, for each list, of the matrices that its numbers stand for, and of `more`.
    fn sums(&self, of: &[DMat3], more: DMat3, together: usize, host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        let mut sums = vec![DMat3::ZERO; self.len()];
        host.parallel_blocks(&mut sums, together, |first, sums| {
            for (i, sum) in (first..).zip(sums) {
                for &(k, weight) in self.row(i) {
                    *sum += of[k as usize] * f64::from(weight);
                }
                *sum += more;
            }
        })?;
        Ok(sums)
    }
}

impl Prolongation {
    /// The weighted means of the groups' matrices, for the fine problem's nodes.
    pub fn means(&self, groups: &[DMat3], host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        // Weights of single precision add up to 1 but nearly.
        let changes: Vec<DMat3> = groups.iter().map(|m| *m - DMat3::IDENTITY).collect();
        self.groups.sums(&changes, DMat3::IDENTITY, 4096, host)
    }

    /// The groups that a node of the fine problem takes part in, and its weights.
    pub fn groups_of(&self, node: usize) -> &[(u32, f32)] {
        self.groups.row(node)
    }

    /// The weighted sums of nodes' matrices, for the groups below `count`.
    pub fn sums(&self, nodes: &[DMat3], count: usize, host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        let mut sums = self.members.sums(nodes, DMat3::ZERO, 64, host)?;
        sums.truncate(count);
        Ok(sums)
    }

    /// The groups' rotations at the fine problem's nodes.
    pub fn turns(&self, groups: &[DMat3], host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        let mut turns = self.means(groups, host)?;
        host.parallel_blocks(&mut turns, 1024, |first, turns| {
            for (i, turn) in (first..).zip(turns) {
                let main =
                    self.groups.row(i).first().map_or(DMat3::IDENTITY, |(group, _)| groups[*group as usize]);
                *turn = rotation::nearest(*turn, main);
            }
        })?;
        Ok(turns)
    }
}

/// Nodes and the edges that hold them together.
struct NodeGraph {
    starts: Vec<usize>,
    edges: Vec<(u32, f64)>,
    /// Region that each node follows, if it is held; nodes of one group follow the same.
    targets: Vec<Option<SampleTarget>>,
}

impl NodeGraph {
    fn from_problem(problem: &Problem) -> Self {
        let mut this = Self { starts: vec![0], edges: Vec::new(), targets: Vec::new() };
        for i in 0..problem.len() {
            let others = problem.operators.laplacian(i).filter(|(j, _)| *j != i);
            this.edges.extend(others.map(|(j, l)| (j as u32, -l)));
            this.starts.push(this.edges.len());
            this.targets.push(problem.target(i));
        }
        this
    }

    fn around(&self, i: usize) -> &[(u32, f64)] {
        &self.edges[self.starts[i]..self.starts[i + 1]]
    }

    /// Group of each node, and the number of groups.
    fn groups(&self) -> (Vec<u32>, usize) {
        const NONE: u32 = u32::MAX;
        let count = self.targets.len();
        let mut group = vec![NONE; count];
        let mut groups = 0;
        let alike = |i: usize| {
            self.around(i).iter().filter(move |(j, _)| self.targets[*j as usize] == self.targets[i])
        };
        // Nodes whose surroundings are in no group yet, with these.
        for i in 0..count {
            if group[i] == NONE && alike(i).all(|(j, _)| group[*j as usize] == NONE) {
                group[i] = groups;
                alike(i).for_each(|(j, _)| group[*j as usize] = groups);
                groups += 1;
            }
        }
        // Others join the group that holds them most.
        let first = group.clone();
        for (i, slot) in group.iter_mut().enumerate().filter(|(_, g)| **g == NONE) {
            let taken = alike(i).filter(|(j, _)| first[*j as usize] != NONE);
            let strongest = taken.max_by(|a, b| a.1.total_cmp(&b.1));
            *slot = strongest.map_or(groups, |(j, _)| first[*j as usize]);
            groups += u32::from(strongest.is_none());
        }
        (group, groups as usize)
    }

    /// The graph of the groups.
    fn merged(&self, group: &[u32], groups: usize) -> Self {
        let mut edges: Vec<(u32, u32, f64)> = Vec::new();
        let mut targets = vec![None; groups];
        for (i, &a) in group.iter().enumerate() {
            targets[a as usize] = self.targets[i];
            edges.extend(
                self.around(i).iter().map(|&(j, w)| (a, group[j as usize], w)).filter(|e| e.0 != e.1),
            );
        }
        edges.sort_by_key(|e| (e.0, e.1));
        let mut this = Self { starts: vec![0], edges: Vec::new(), targets };
        let mut rest = edges.into_iter().peekable();
        for a in 0..groups as u32 {
            let start = this.edges.len();
            while let Some((_, b, w)) = rest.next_if(|e| e.0 == a) {
                match this.edges[start..].last_mut() {
                    Some(last) if last.0 == b => last.1 += w,
                    _ => this.edges.push((b, w)),
                }
            }
            this.starts.push(this.edges.len());
        }
        this
    }
}

/// Coarse likeness of a problem; `None` where the problem is small as it is.
pub fn coarsen(fine: &Problem, host: &Host<'_>) -> PluginResult<Option<(Problem, Prolongation)>> {
    let Grouping { graph, group, groups } = Grouping::new(fine, host)?;
    if groups == fine.len() {
        return Ok(None);
    }
    let (coarse, rest) = merged(fine, &graph, &group, groups, host)?;
    let mut node = vec![u32::MAX; groups];
    coarse.samples.iter().enumerate().for_each(|(k, g)| node[*g as usize] = k as u32);
    let mut lists = Lists { starts: vec![0], all: Vec::new() };
    for (p, &g) in fine.rest[..fine.rows].iter().zip(&group) {
        let near = std::iter::once(g).chain(graph.around(g as usize).iter().map(|e| e.0));
        // Rotations of groups far from all free ones are not known, nor needed.
        let near =
            near.map(|g| (node[g as usize], rest[g as usize])).filter(|(g, _)| (*g as usize) < coarse.rows);
        lists.push(near.map(|(g, at)| (g, p.distance(at))).collect());
    }
    let prolongation = Prolongation { members: lists.transposed(coarse.len()), groups: lists };
    Ok(Some((coarse, prolongation)))
}

/// Nodes in groups, until these are few, or merging them is not worth while.
struct Grouping {
    graph: NodeGraph,
    /// Group of each node, and the number of groups.
    group: Vec<u32>,
    groups: usize,
}

impl Grouping {
    fn new(fine: &Problem, host: &Host<'_>) -> PluginResult<Self> {
        let mut graph = NodeGraph::from_problem(fine);
        let mut group: Vec<u32> = (0..fine.len() as u32).collect();
        let mut groups = fine.len();
        while groups > MOST {
            host.progress(0.0)?;
            let (next, count) = graph.groups();
            if count as f64 > WORTH * groups as f64 {
                break;
            }
            graph = graph.merged(&next, count);
            group.iter_mut().for_each(|g| *g = next[*g as usize]);
            groups = count;
        }
        Ok(Self { graph, group, groups })
    }
}

/// The problem of groups of nodes, and the middle of each group.
fn merged(
    fine: &Problem,
    graph: &NodeGraph,
    group: &[u32],
    groups: usize,
    host: &Host<'_>,
) -> PluginResult<(Problem, Vec<DVec3>)> {
    let mut counts = vec![0.0; groups];
    let mut rest = vec![DVec3::ZERO; groups];
    let mut areas = vec![0.0; groups];
    for (i, &g) in group.iter().enumerate() {
        counts[g as usize] += 1.0;
        rest[g as usize] += fine.rest[i];
        areas[g as usize] += fine.operators.areas[i];
    }
    rest.iter_mut().zip(&counts).for_each(|(p, n)| *p /= *n);

    // Sums along the borders of groups grow with their length, and those of the surface itself do not.
    let scale = (groups as f64 / fine.len() as f64).sqrt();
    let mut elements = Vec::new();
    for a in 0..groups {
        for &(b, weight) in graph.around(a).iter().filter(|(b, w)| (a as u32) < *b && *w > 0.0) {
            elements.extend(SurfaceTriangle::link(a as u32, b, scale * weight));
        }
    }
    // Areas alone.
    for (a, area) in areas.into_iter().enumerate() {
        elements.push(SurfaceTriangle { corners: [a as u32; 3], weights: [0.0; 3], areas: [area, 0.0, 0.0] });
    }
    let kinds: Vec<Constraint> =
        graph.targets.iter().map(|t| t.map_or(Constraint::Free, Constraint::Held)).collect();
    let soft: Vec<Soft> = fine
        .soft
        .iter()
        .map(|s| {
            let node = group[s.node as usize];
            // Strengths are per area.
            Soft { node, strength: s.strength / counts[node as usize], ..*s }
        })
        .collect();
    Ok((Problem::new(&rest, &elements, &kinds, &soft, host)?, rest))
}

impl Lists<(u32, f32)> {
    /// Adds a list, given distances instead of weights: these fade out towards the farthest.
    fn push(&mut self, near: Vec<(u32, f64)>) {
        let reach = near.iter().map(|(_, d)| *d).fold(0.0, f64::max) * 1.001;
        let weight = |d: f64| if reach > 0.0 { (1.0 - (d / reach).powi(2)).powi(2) } else { 1.0 };
        let sum: f64 = near.iter().map(|(_, d)| weight(*d)).sum();
        self.all.extend(near.iter().map(|(node, d)| (*node, (weight(*d) / sum) as f32)));
        self.starts.push(self.all.len());
    }
}
