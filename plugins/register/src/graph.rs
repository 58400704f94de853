//! Graph of nodes that carry space along (R. W. Sumner, J. Schmid, M. Pauly, *Embedded deformation for
//! shape manipulation*, SIGGRAPH 2007), each turned as its neighbours' places tell (O. Sorkine, M. Alexa,
//! *As-rigid-as-possible surface modeling*, SGP 2007): the energy of the graph's edges is the cost of
//! bending.

use crate::points::{farthest, nearest_turn};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::cholesky::llt::solve::solve_in_place;
use faer::{Mat, MatRef, Par, Spec};
use glam::{DMat3, DVec3};
use simod_plugin_api::{PluginError, PluginResult};
use std::collections::BTreeSet;

/// Number of nodes that a place goes along with.
const NEAR: usize = 6;
/// Weight from which on two nodes that carry a point together are neighbours.
const TOGETHER: f64 = 1e-3;

/// Node: its place at rest, its present place, and its turn.
#[derive(Debug, Clone, Copy)]
struct Node {
    rest: DVec3,
    now: DVec3,
    turn: DMat3,
}

/// A map of space that nodes carry.
#[derive(Debug, Clone)]
pub struct Graph {
    nodes: Vec<Node>,
    /// Edges: each two neighbours once.
    edges: Vec<(usize, usize)>,
}

/// Nodes that a place goes along with, and their weights.
pub type Carried = [(usize, f64); NEAR];

/// Place that shall be at another one, more in some directions than in others.
pub struct Term {
    pub source: DVec3,
    pub carried: Carried,
    pub target: DVec3,
    pub metric: DMat3,
}

impl Graph {
    /// Graph of at most `count` nodes, which are some of the points, as far from each other as can be; all
    /// of them at rest.
    pub fn new(points: &[DVec3], count: usize) -> Self {
        let node = |i: usize| Node { rest: points[i], now: points[i], turn: DMat3::IDENTITY };
        let mut graph =
            Self { nodes: farthest(points, count).into_iter().map(node).collect(), edges: Vec::new() };
        graph.edges = edges(points.iter().map(|p| graph.carried(*p)));
        graph
    }

    /// Graph whose nodes are moved by a map; turns follow.
    pub fn moved(&self, map: impl Fn(DVec3) -> DVec3) -> Self {
        let mut graph = self.clone();
        graph.nodes.iter_mut().for_each(|node| node.now = map(node.rest));
        graph.turn();
        graph
    }

    /// Nearest nodes with their weights: those at the end of the list have none, so that the map has no
    /// steps.
    pub fn carried(&self, p: DVec3) -> Carried {
        let mut near = [(0, f64::INFINITY); NEAR + 1];
        for (i, node) in self.nodes.iter().enumerate() {
            let squared = node.rest.distance_squared(p);
            if squared < near[NEAR].1 {
                let at = near.partition_point(|(_, other)| *other <= squared);
                near[at..].rotate_right(1);
                near[at] = (i, squared);
            }
        }
        let reach = if near[NEAR].1.is_finite() {
            near[NEAR].1.sqrt()
        } else {
            // The reach covers all nodes, as all are near.
            2.0 * near.iter().filter(|n| n.1.is_finite()).map(|n| n.1.sqrt()).fold(1e-9, f64::max)
        };
        let weight = |squared: f64| {
            if squared.is_finite() { (1.0 - squared.sqrt() / reach).max(0.0).powi(2) + 1e-12 } else { 0.0 }
        };
        let whole: f64 = near[..NEAR].iter().map(|n| weight(n.1)).sum();
        std::array::from_fn(|k| (near[k].0, weight(near[k].1) / whole))
    }

    /// Image of a place with these weights, without the nodes' shifts.
    fn turned(&self, p: DVec3, carried: &Carried) -> DVec3 {
        carried.iter().map(|(i, w)| *w * (self.nodes[*i].turn * (p - self.nodes[*i].rest))).sum()
    }

    /// Image of a place with these weights.
    pub fn image(&self, p: DVec3, carried: &Carried) -> DVec3 {
        self.turned(p, carried) + carried.iter().map(|(i, w)| *w * self.nodes[*i].now).sum::<DVec3>()
    }

    /// Direction turned by the nodes with these weights; of any length.
    pub fn direction(&self, n: DVec3, carried: &Carried) -> DVec3 {
        carried.iter().map(|(i, w)| *w * (self.nodes[*i].turn * n)).sum()
    }

    /// The image of a place.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.image(p, &self.carried(p))
    }

    /// Distance between the nodes of two graphs: the root of the mean square.
    pub fn apart(&self, other: &Self) -> f64 {
        let squares: f64 =
            self.nodes.iter().zip(&other.nodes).map(|(a, b)| a.now.distance_squared(b.now)).sum();
        (squares / self.nodes.len().max(1) as f64).sqrt()
    }

    /// Difference of edges from those that the turns of their nodes give, as a part of their lengths: the
    /// root of the mean square.
    pub fn strain(&self) -> f64 {
        let part = |(a, b): &(usize, usize)| {
            let [na, nb] = [self.nodes[*a], self.nodes[*b]];
            let (rest, now) = (na.rest - nb.rest, na.now - nb.now);
            0.5 * (now.distance_squared(na.turn * rest) + now.distance_squared(nb.turn * rest))
                / rest.length_squared()
        };
        (self.edges.iter().map(part).sum::<f64>() / self.edges.len().max(1) as f64).sqrt()
    }

    /// Room for the matrix of the equations, which [`settle`](Self::settle) fills each time: 72 bytes for
    /// each pair of nodes.
    pub fn room(&self) -> Mat<f64> {
        Mat::zeros(3 * self.nodes.len(), 3 * self.nodes.len())
    }

    /// Moves the nodes to the least energy of terms and edges, then turns them, and that `times` times. The
    /// matrix of the equations takes the room.
    ///
    /// # Errors
    /// The equations have no solution.
    pub fn settle(
        &mut self,
        terms: &[Term],
        stiffness: f64,
        times: usize,
        room: &mut Mat<f64>,
    ) -> PluginResult<()> {
        // The turns change the right side alone.
        self.normal(terms, stiffness, room);
        let factor = factorised(room)?;
        for _ in 0..times {
            let mut places = self.wanted(terms, stiffness);
            solve_in_place(factor, places.as_mut(), Par::Seq, MemStack::new(&mut []));
            for (i, node) in self.nodes.iter_mut().enumerate() {
                node.now = DVec3::new(places[(3 * i, 0)], places[(3 * i + 1, 0)], places[(3 * i + 2, 0)]);
            }
            self.turn();
        }
        Ok(())
    }

    /// Weight of an edge, and weight by which nodes stay that nothing else holds.
    fn weights(&self, stiffness: f64) -> (f64, f64) {
        (stiffness / self.edges.len().max(1) as f64, 1e-9 * (1.0 + stiffness))
    }

    /// The lower half of the equations' matrix.
    fn normal(&self, terms: &[Term], stiffness: f64, normal: &mut Mat<f64>) {
        normal.fill(0.0);
        let mut add = |a: usize, b: usize, block: DMat3| {
            for (i, j) in (0..9).map(|k| (k % 3, k / 3)) {
                normal[(3 * a + i, 3 * b + j)] += block.col(j)[i];
            }
        };
        for term in terms {
            for (a, wa) in &term.carried {
                for (b, wb) in term.carried.iter().filter(|(b, _)| b <= a) {
                    add(*a, *b, *wa * *wb * term.metric);
                }
            }
        }
        let (each, hold) = self.weights(stiffness);
        for (a, b) in &self.edges {
            add(*a, *a, 2.0 * each * DMat3::IDENTITY);
            add(*b, *b, 2.0 * each * DMat3::IDENTITY);
            add(*a.max(b), *a.min(b), -2.0 * each * DMat3::IDENTITY);
        }
        (0..self.nodes.len()).for_each(|i| add(i, i, hold * DMat3::IDENTITY));
    }

    /// The right side of the terms, as the nodes are turned.
    fn wanted(&self, terms: &[Term], stiffness: f64) -> Mat<f64> {
        let mut right = Mat::<f64>::zeros(3 * self.nodes.len(), 1);
        let mut wants = |a: usize, v: DVec3| (0..3).for_each(|i| right[(3 * a + i, 0)] += v[i]);
        for term in terms {
            let to = term.metric * (term.target - self.turned(term.source, &term.carried));
            term.carried.iter().for_each(|(a, wa)| wants(*a, *wa * to));
        }
        let (each, hold) = self.weights(stiffness);
        for (a, b) in &self.edges {
            let [na, nb] = [self.nodes[*a], self.nodes[*b]];
            let apart = each * ((na.turn + nb.turn) * (na.rest - nb.rest));
            wants(*a, apart);
            wants(*b, -apart);
        }
        self.nodes.iter().enumerate().for_each(|(i, node)| wants(i, hold * node.now));
        right
    }

    /// Turns each node by its neighbours' places.
    fn turn(&mut self) {
        let mut products = vec![DMat3::ZERO; self.nodes.len()];
        for (a, b) in &self.edges {
            let [na, nb] = [self.nodes[*a], self.nodes[*b]];
            let (now, rest) = (nb.now - na.now, nb.rest - na.rest);
            let product = DMat3::from_cols(now * rest.x, now * rest.y, now * rest.z);
            products[*a] += product;
            products[*b] += product;
        }
        for (node, product) in self.nodes.iter_mut().zip(products) {
            if let Some((turn, _)) = nearest_turn(product) {
                node.turn = turn;
            }
        }
    }
}

/// Factor of a matrix, which takes the place of the matrix' lower half.
fn factorised(matrix: &mut Mat<f64>) -> PluginResult<MatRef<'_, f64>> {
    let mut memory =
        MemBuffer::new(cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, Spec::default()));
    let done = cholesky_in_place(
        matrix.as_mut(),
        LltRegularization::default(),
        Par::Seq,
        MemStack::new(&mut memory),
        Spec::default(),
    );
    done.map_err(|_| {
        PluginError::internal("the equations of the nodes are not positive").hint("take a larger `stiffness`")
    })?;
    Ok(matrix.as_ref())
}

/// Edges between nodes that carry the same points, each two once.
fn edges(carried: impl Iterator<Item = Carried>) -> Vec<(usize, usize)> {
    let mut edges = BTreeSet::new();
    for nodes in carried {
        for (k, (a, wa)) in nodes.iter().enumerate() {
            for (b, wb) in &nodes[k + 1..] {
                if a != b && *wa > TOGETHER && *wb > TOGETHER {
                    edges.insert((*a.min(b), *a.max(b)));
                }
            }
        }
    }
    edges.into_iter().collect()
}
