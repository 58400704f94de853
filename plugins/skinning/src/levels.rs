//! Voxels, joined to fewer and fewer nodes, level by level.
//!
//! A node of a coarser level is a part that hangs together within a block of 2 × 2 × 2 cells of the finer
//! one: limbs beside each other stay apart however coarse the cells are (M. Nesme and others, *Preserving
//! topology and elasticity for embedded deformable models*, SIGGRAPH 2009).

use crate::voxels::{NONE, Voxels};
use glam::IVec3;
use std::collections::HashMap;

/// Largest number of nodes of the coarsest level, if it can be met.
const COARSEST: usize = 1200;
/// Weight of a link over an edge of two cells, as a part of one over a face.
const OVER_EDGE: f32 = 0.25;

/// Nodes with their finite volumes: links are faces by distances, in cells of the level.
#[derive(Debug)]
pub struct Level {
    starts: Vec<u32>,
    links: Vec<(u32, f32)>,
    /// The volume of each node, in voxels.
    pub masses: Vec<f64>,
    /// The node of the next coarser level that each is part of; nothing in the coarsest.
    pub parents: Vec<u32>,
    cells: Vec<IVec3>,
}

impl Level {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.masses.len()
    }

    /// Nodes that a node is linked to, with the links' weights.
    pub fn links(&self, node: u32) -> &[(u32, f32)] {
        let node = node as usize;
        &self.links[self.starts[node] as usize..self.starts[node + 1] as usize]
    }

    /// Level of links from node to node, both ways; those between the same two are summed up.
    pub fn new(mut links: Vec<(u32, u32, f32)>, masses: Vec<f64>, cells: Vec<IVec3>) -> Self {
        links.sort_unstable_by_key(|l| (l.0, l.1));
        links.dedup_by(|b, a| {
            let is_same = (a.0, a.1) == (b.0, b.1);
            if is_same {
                a.2 += b.2;
            }
            is_same
        });
        let mut starts = vec![0_u32; masses.len() + 1];
        links.iter().for_each(|l| starts[l.0 as usize + 1] += 1);
        (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
        let links = links.into_iter().map(|(_, to, by)| (to, by)).collect();
        Self { starts, links, masses, parents: Vec::new(), cells }
    }

    /// Finest level, whose nodes are the voxels.
    fn finest(voxels: &Voxels) -> Self {
        let mut links = Vec::new();
        for v in 0..voxels.len() as u32 {
            let around = voxels.neighbours[v as usize];
            links.extend(around.iter().filter(|n| **n != NONE).map(|n| (v, *n, 1.0)));
            if !voxels.is_inner(v) {
                links.extend(voxels.over_edges(v).map(|n| (v, n, OVER_EDGE)));
            }
        }
        let cells = voxels.cells.iter().map(|c| voxels.grid.cell_of(*c as usize)).collect();
        Self::new(links, vec![1.0; voxels.len()], cells)
    }

    /// The next coarser one, of blocks of cells.
    fn coarser(&mut self) -> Self {
        let block = |node: usize| self.cells[node] >> 1;
        let mut roots: Vec<u32> = (0..self.len() as u32).collect();
        for node in 0..self.len() as u32 {
            for (other, _) in self.links(node).iter().filter(|(o, _)| *o < node) {
                if block(*other as usize) == block(node as usize) {
                    let (a, b) = (root(&mut roots, node), root(&mut roots, *other));
                    roots[a.max(b) as usize] = a.min(b);
                }
            }
        }
        let (mut masses, mut cells) = (Vec::new(), Vec::new());
        let mut parents = vec![NONE; self.len()];
        for node in 0..self.len() {
            // Roots are the least of theirs, and so come first.
            let root = root(&mut roots, node as u32) as usize;
            if root == node {
                parents[node] = masses.len() as u32;
                masses.push(0.0);
                cells.push(block(node));
            }
            parents[node] = parents[root];
            masses[parents[node] as usize] += self.masses[node];
        }
        let mut links = Vec::new();
        for node in 0..self.len() as u32 {
            for (other, by) in self.links(node) {
                let (a, b) = (parents[node as usize], parents[*other as usize]);
                if a != b {
                    // Nodes are twice as far from each other.
                    links.push((a, b, 0.5 * by));
                }
            }
        }
        self.parents = parents;
        Self::new(links, masses, cells)
    }
}

/// The least node of those that hang together with one.
fn root(roots: &mut [u32], mut node: u32) -> u32 {
    while roots[node as usize] != node {
        roots[node as usize] = roots[roots[node as usize] as usize];
        node = roots[node as usize];
    }
    node
}

/// All levels of some voxels, the finest first.
pub fn levels(voxels: &Voxels) -> Vec<Level> {
    coarsened(Level::finest(voxels))
}

/// All levels from one on.
pub fn coarsened(finest: Level) -> Vec<Level> {
    let mut levels = vec![finest];
    while let Some(last) = levels.last_mut().filter(|l| l.len() > COARSEST) {
        let next = last.coarser();
        if next.len() == last.len() {
            last.parents.clear();
            break;
        }
        levels.push(next);
    }
    levels
}

/// Held nodes of a level: for each of them the joints whose bones pass through, and the part of the node that
/// each has; ascending.
pub type Held = Vec<(u32, Vec<(u16, f64)>)>;

/// Held nodes of the next coarser level.
pub fn coarser_held(held: &Held, level: &Level) -> Held {
    let mut sums: HashMap<u32, HashMap<u16, f64>> = HashMap::new();
    for (node, shares) in held {
        let sum = sums.entry(level.parents[*node as usize]).or_default();
        shares.iter().for_each(|(joint, share)| *sum.entry(*joint).or_default() += share);
    }
    let mut held: Held = sums.into_iter().map(|(node, sum)| (node, parts(sum))).collect();
    held.sort_unstable_by_key(|h| h.0);
    held
}

/// Shares as parts of one, by joint.
pub fn parts(sums: HashMap<u16, f64>) -> Vec<(u16, f64)> {
    let mut sums: Vec<(u16, f64)> = sums.into_iter().collect();
    sums.sort_unstable_by_key(|s| s.0);
    let all: f64 = sums.iter().map(|s| s.1).sum();
    sums.iter_mut().for_each(|s| s.1 /= all);
    sums
}
