//! The intrinsic Delaunay triangulation of any heap of triangles.
//!
//! N. Sharp, K. Crane, *A Laplacian for Nonmanifold Triangle Meshes*, Symposium on Geometry Processing 2020.
//! Each triangle is taken twice, as its front and its back, and glued to those around each of its edges (the
//! *tufted cover*): a surface without borders whose edges have two sides each, whatever the input. Lengths
//! are stretched a little where triangles have no area (*mollified*), and edges are flipped within the
//! surface until none has a negative weight. The surface stays what it was: only its triangulation is better.
//! Half of the Laplacian is the input's own.

use crate::elements::{SurfaceTriangle, half_cotangents};
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};
use std::collections::VecDeque;

/// Slack of the triangle inequality, in units of the median edge.
const SLACK: f64 = 1e-5;
/// An edge's weight may be so far below 0: rounding must not flip edges for ever.
const DELAUNAY: f64 = 1e-9;
/// Flips per edge after which the triangulation is good enough. Few meshes need more than one.
const MOST_FLIPS: usize = 20;
/// Edges between two looks at whether to go on.
const TOGETHER: usize = 1 << 14;

/// Elements of the triangles as they are. Triangles with a corner twice are left out.
pub fn plain(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<SurfaceTriangle> {
    let (triangles, lengths) = mollified(positions, triangles);
    triangles.into_iter().zip(lengths).map(|(t, l)| SurfaceTriangle::new(t, l)).collect()
}

/// Elements of the intrinsic Delaunay triangulation of the triangles' surface, each twice and by half.
pub fn delaunay(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    host: &Host<'_>,
) -> PluginResult<Vec<SurfaceTriangle>> {
    let (triangles, lengths) = mollified(positions, triangles);
    let mut cover = Cover::tufted(positions, &triangles, &lengths);
    cover.flip_to_delaunay(host)?;
    Ok(cover.elements().map(|e| e.scaled(0.5)).collect())
}

/// The triangles with three corners, and the lengths of the edges opposite to each corner, which fulfil the
/// triangle inequality with some slack.
fn mollified(positions: &[DVec3], triangles: &[[u32; 3]]) -> (Vec<[u32; 3]>, Vec<[f64; 3]>) {
    let has_three = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    let triangles: Vec<[u32; 3]> = triangles.iter().copied().filter(has_three).collect();
    let distance = |a: u32, b: u32| positions[a as usize].distance(positions[b as usize]);
    let mut lengths: Vec<[f64; 3]> =
        triangles.iter().map(|&[a, b, c]| [distance(b, c), distance(c, a), distance(a, b)]).collect();
    let mut all: Vec<f64> = lengths.as_flattened().iter().copied().filter(|l| *l > 0.0).collect();
    let middle = all.len() / 2;
    // Samples that all lie in one point may have any length.
    let median = if all.is_empty() { 1.0 } else { *all.select_nth_unstable_by(middle, f64::total_cmp).1 };
    let lacking = |l: &[f64; 3]| {
        let sum: f64 = l.iter().sum();
        l.iter().map(|x| SLACK * median - (sum - 2.0 * x)).fold(0.0, f64::max)
    };
    let more = lengths.iter().map(lacking).fold(0.0, f64::max);
    lengths.iter_mut().flatten().for_each(|l| *l += more);
    (triangles, lengths)
}

/// Triangles glued to each other. Half-edge `h` goes from its tail around face `h / 3`.
struct Cover {
    tail: Vec<u32>,
    length: Vec<f64>,
    twin: Vec<u32>,
}

/// Sorts triangles at an edge by the angle at which they leave it; those of one angle stay in order.
fn sort_around(positions: &[DVec3], triangles: &[[u32; 3]], around: &mut [([u32; 2], u32, u32)]) {
    let at = |i: u32| positions[i as usize];
    let Some(&([from, to], ..)) = around.first() else { return };
    let (x, y) = (at(to) - at(from)).normalize_or(DVec3::X).any_orthonormal_pair();
    around.sort_by_cached_key(|(_, half_edge, _)| {
        let corners = triangles[*half_edge as usize / 6];
        let apex = corners.into_iter().find(|c| *c != from && *c != to).unwrap_or(from);
        let v = at(apex) - at(from);
        // As a whole number, so that rounding does not part copies.
        (v.dot(y).atan2(v.dot(x)) * 1e6).round() as i64
    });
}

fn next(h: usize) -> usize {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

impl Cover {
    /// Front and back of each triangle, glued to those next to it around each edge.
    fn tufted(positions: &[DVec3], triangles: &[[u32; 3]], lengths: &[[f64; 3]]) -> Self {
        let mut this = Self {
            tail: Vec::with_capacity(6 * triangles.len()),
            length: Vec::with_capacity(6 * triangles.len()),
            twin: vec![u32::MAX; 6 * triangles.len()],
        };
        // Samples of each edge in order, and the half-edges that go up and down, on the front and on the
        // back.
        let mut edges: Vec<([u32; 2], u32, u32)> = Vec::with_capacity(3 * triangles.len());
        for (t, (&[a, b, c], &[bc, ca, ab])) in triangles.iter().zip(lengths).enumerate() {
            this.tail.extend([a, b, c, a, c, b]);
            this.length.extend([ab, bc, ca, ca, bc, ab]);
            for (k, (from, to)) in [(a, b), (b, c), (c, a)].into_iter().enumerate() {
                let (front, back) = ((6 * t + k) as u32, (6 * t + 5 - k) as u32);
                edges.push(if from < to { ([from, to], front, back) } else { ([to, from], back, front) });
            }
        }
        // Stable, so that the order of the triangles is kept.
        edges.sort_by_key(|e| e.0);
        for around in edges.chunk_by_mut(|a, b| a.0 == b.0) {
            if around.len() > 2 {
                sort_around(positions, triangles, around);
            }
            for (i, &(_, up, _)) in around.iter().enumerate() {
                let (_, _, down) = around[(i + 1) % around.len()];
                this.twin[up as usize] = down;
                this.twin[down as usize] = up;
            }
        }
        this
    }

    fn lengths(&self, h: usize) -> [f64; 3] {
        [self.length[h], self.length[next(h)], self.length[next(next(h))]]
    }

    /// Half the cotangent of the angle opposite to a half-edge.
    fn weight(&self, h: usize) -> f64 {
        half_cotangents(self.lengths(h))[0]
    }

    fn flip_to_delaunay(&mut self, host: &Host<'_>) -> PluginResult<()> {
        let is_first = |h: &usize| *h < self.twin[*h] as usize;
        let mut open: VecDeque<usize> = (0..self.tail.len()).filter(is_first).collect();
        let mut is_open = vec![false; self.tail.len()];
        open.iter().for_each(|h| is_open[*h] = true);
        let most = MOST_FLIPS * open.len();
        let (mut flips, mut looks) = (0, 0_usize);
        while let Some(h) = open.pop_front() {
            looks += 1;
            if looks.is_multiple_of(TOGETHER) {
                host.progress(0.0)?;
            }
            is_open[h] = false;
            let g = self.twin[h] as usize;
            // An edge with one face on both sides is the only one that could be there.
            if h / 3 == g / 3 || self.weight(h) + self.weight(g) >= -DELAUNAY || flips == most {
                continue;
            }
            let Some(around) = self.flip(h) else { continue };
            flips += 1;
            for edge in around {
                let edge = edge.min(self.twin[edge] as usize);
                if !std::mem::replace(&mut is_open[edge], true) {
                    open.push_back(edge);
                }
            }
        }
        Ok(())
    }

    /// Replaces an edge of two triangles by the other diagonal; gives the half-edges around, or nothing where
    /// rounding would make a triangle without area.
    fn flip(&mut self, h: usize) -> Option<[usize; 4]> {
        let g = self.twin[h] as usize;
        let (h1, g1) = (next(h), next(g));
        let (h2, g2) = (next(h1), next(g1));
        // Vertices around an edge from i to j: k is left of it, l right.
        let (k, l) = (self.tail[h2], self.tail[g2]);
        let length = self.other_diagonal(h, g);
        let fits = |[a, b, c]: [f64; 3]| a < b + c && b < c + a && c < a + b;
        let [jk, ki, il, lj] = [h1, h2, g1, g2].map(|e| self.length[e]);
        if !fits([length, ki, il]) || !fits([length, lj, jk]) {
            return None;
        }
        // The faces become l, k, i and k, l, j.
        let old = [h1, h2, g1, g2];
        let new = [g2, h1, h2, g1];
        let moved = old.map(|e| (self.tail[e], self.length[e], self.twin[e]));
        for (slot, (tail, length, twin)) in new.into_iter().zip(moved) {
            let twin = old.iter().position(|e| *e == twin as usize).map_or(twin as usize, |e| new[e]);
            (self.tail[slot], self.length[slot], self.twin[slot]) = (tail, length, twin as u32);
            self.twin[twin] = slot as u32;
        }
        (self.tail[h], self.length[h]) = (l, length);
        (self.tail[g], self.length[g]) = (k, length);
        Some(new)
    }

    /// Length of the other diagonal of the two triangles at an edge, laid out in a plane.
    fn other_diagonal(&self, h: usize, g: usize) -> f64 {
        let [ij, jk, ki] = self.lengths(h);
        let [_, il, lj] = self.lengths(g);
        // The far corner's place along the edge, and its distance from it.
        let corner = |from_i: f64, from_j: f64| {
            let x = (ij * ij + from_i * from_i - from_j * from_j) / (2.0 * ij);
            (x, (from_i * from_i - x * x).max(0.0).sqrt())
        };
        let ((kx, ky), (lx, ly)) = (corner(ki, jk), corner(il, lj));
        (kx - lx).hypot(ky + ly)
    }

    fn elements(&self) -> impl Iterator<Item = SurfaceTriangle> {
        self.tail
            .as_chunks::<3>()
            .0
            .iter()
            .zip(self.length.as_chunks::<3>().0)
            .map(|(&corners, &[ab, bc, ca])| SurfaceTriangle::new(corners, [bc, ca, ab]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The Laplacian as a dense matrix.
    fn laplacian(samples: usize, elements: &[SurfaceTriangle]) -> Vec<Vec<f64>> {
        let mut l = vec![vec![0.0; samples]; samples];
        for e in elements {
            for k in 0..3 {
                let [a, b] = [e.corners[(k + 1) % 3] as usize, e.corners[(k + 2) % 3] as usize];
                l[a][a] += e.weights[k];
                l[b][b] += e.weights[k];
                l[a][b] -= e.weights[k];
                l[b][a] -= e.weights[k];
            }
        }
        l
    }

    #[test]
    fn the_short_diagonal_of_a_flat_rhombus_is_found() {
        // The long one has a negative weight.
        let points = [[-2.0, 0.0, 0.0], [0.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(DVec3::from);
        let given = [[0, 1, 2], [0, 2, 3]];
        let expected = laplacian(4, &plain(&points, &[[0, 1, 3], [1, 2, 3]]));
        let found = laplacian(4, &delaunay(&points, &given, &Host::new(&())).unwrap());
        for (a, b) in found.as_flattened_rows().zip(expected.as_flattened_rows()) {
            assert!((a - b).abs() < 1e-12, "{found:?}");
        }
        assert!(laplacian(4, &plain(&points, &given))[0][2] > 0.1);
    }

    trait Rows {
        fn as_flattened_rows(&self) -> impl Iterator<Item = f64>;
    }
    impl Rows for Vec<Vec<f64>> {
        fn as_flattened_rows(&self) -> impl Iterator<Item = f64> {
            self.iter().flatten().copied()
        }
    }

    proptest! {
        /// Any triangles, also without area, with common edges and coincident corners: weights are finite and
        /// not negative, and areas those of the input.
        #[test]
        fn any_heap_of_triangles_has_a_laplacian(
            points in proptest::collection::vec(proptest::array::uniform3(0_u8..6), 4..12),
            triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..12), 1..40),
        ) {
            let points: Vec<DVec3> = points.into_iter().map(|p| DVec3::from(p.map(f64::from))).collect();
            let n = points.len() as u32;
            let triangles: Vec<[u32; 3]> = triangles.into_iter().map(|t| t.map(|i| i % n)).collect();
            let elements = delaunay(&points, &triangles, &Host::new(&())).unwrap();
            let area = |e: &[SurfaceTriangle]| e.iter().flat_map(|e| e.areas).sum::<f64>();
            let (before, after) = (area(&plain(&points, &triangles)), area(&elements));
            prop_assert!((before - after).abs() <= 1e-6 * (1.0 + before), "{before} {after}");
            let l = laplacian(points.len(), &elements);
            for (i, row) in l.iter().enumerate() {
                for (j, x) in row.iter().enumerate() {
                    prop_assert!(x.is_finite() && (i == j || *x <= 1e-6), "{i} {j}: {x}");
                }
            }
        }
    }
}
