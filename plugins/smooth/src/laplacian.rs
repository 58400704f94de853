//! The Laplacian of a surface, by its triangles or by neighbours, as rows that sum to zero and have
//! eigenvalues of 0 to 2.
//!
//! Cotangents and areas by M. Meyer, M. Desbrun, P. Schröder, A. Barr, *Discrete differential-geometry
//! operators for triangulated 2-manifolds*, 2002: a flat part stays, however irregular its triangles are.
//! Among points alone, weights fall with the distance, and areas are such that the Laplacian of the squared
//! distance is that of a plane.

use glam::DVec3;
use simod_plugin_api::Graph;

/// Part of the vertices whose surroundings are finer than those that determine the Laplacian's scale: these
/// vertices count as if they were not finer.
const FINEST: f64 = 0.05;

/// Height beside its longest side below which a triangle is a line, which holds nothing.
const SLIVER: f64 = 1e-6;

/// A Laplacian at the vertices, times [`scale`](Self::scale).
pub struct MeshLaplacian {
    starts: Vec<u32>,
    entries: Vec<(u32, f64)>,
    /// Squared length: -Δ is the operator divided by it.
    pub scale: f64,
}

/// Weights of edges between vertices, the lower one first, in ascending order; and the vertices' areas.
struct EdgeWeights {
    edges: Vec<([u32; 2], f64)>,
    areas: Vec<f64>,
}

impl MeshLaplacian {
    /// Laplacian of triangles, and of neighbours at vertices without triangles. `freedom` says for each
    /// vertex how free it is to move, 0 to 1. Vertices on open borders are not: nothing says how these go
    /// on.
    pub fn new(positions: &[DVec3], triangles: &[[u32; 3]], graph: &Graph<'_>, freedom: &[f64]) -> Self {
        let mut freedom = freedom.to_vec();
        let mut has_triangles = vec![false; positions.len()];
        triangles.iter().flatten().for_each(|c| has_triangles[*c as usize] = true);
        borders(triangles).for_each(|c| freedom[c as usize] = 0.0);
        let of_triangles = EdgeWeights::of_triangles(positions, triangles);
        let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); positions.len()];
        for ([i, j], weight) in &of_triangles.edges {
            let (i, j) = (*i, *j);
            rows[i as usize].push((j, *weight));
            rows[j as usize].push((i, *weight));
        }
        let mut areas = of_triangles.areas;
        if has_triangles.contains(&false) {
            let among_points = EdgeWeights::of_neighbours(positions, graph);
            for ([i, j], weight) in &among_points.edges {
                for (i, j) in [(*i, *j), (*j, *i)] {
                    if !has_triangles[i as usize] {
                        rows[i as usize].push((j, *weight));
                    }
                }
            }
            let others = has_triangles.iter().zip(&mut areas).zip(among_points.areas);
            others.filter(|((has, _), _)| !**has).for_each(|((_, area), other)| *area = other);
        }
        let sums: Vec<f64> = rows.iter().map(|row| row.iter().map(|entry| entry.1.abs()).sum()).collect();
        let mut scales: Vec<f64> =
            areas.iter().zip(&sums).filter(|(_, sum)| **sum > 0.0).map(|(area, sum)| area / sum).collect();
        scales.sort_unstable_by(f64::total_cmp);
        let scale = scales.get((FINEST * scales.len() as f64) as usize).copied().unwrap_or(0.0);
        let (mut starts, mut entries) = (vec![0], Vec::new());
        for (i, row) in rows.iter().enumerate() {
            let divisor = sums[i].max(areas[i] / scale);
            let part = if divisor > 0.0 && divisor.is_finite() { freedom[i] / divisor } else { 0.0 };
            entries.extend(row.iter().map(|(j, weight)| (*j, weight * part)).filter(|entry| entry.1 != 0.0));
            starts.push(entries.len() as u32);
        }
        Self { starts, entries, scale }
    }

    /// Whether a vertex stays in its place.
    pub fn holds(&self, i: usize) -> bool {
        self.starts[i] == self.starts[i + 1]
    }

    /// The Laplacian at a vertex.
    pub fn evaluate(&self, i: usize, values: &[DVec3]) -> DVec3 {
        let row = &self.entries[self.starts[i] as usize..self.starts[i + 1] as usize];
        row.iter().fold(DVec3::ZERO, |sum, (j, weight)| sum + *weight * (values[i] - values[*j as usize]))
    }
}

impl EdgeWeights {
    /// Weights of half of the cotangents against an edge, and a third of the triangles' areas.
    fn of_triangles(positions: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let (mut edges, mut areas) = (Vec::with_capacity(3 * triangles.len()), vec![0.0; positions.len()]);
        for triangle in triangles {
            let p = triangle.map(|c| positions[c as usize]);
            let double_area = (p[1] - p[0]).cross(p[2] - p[0]).length();
            let longest = (0..3).map(|i| p[i].distance_squared(p[(i + 1) % 3])).fold(0.0, f64::max);
            for i in 0..3 {
                let [j, k] = [(i + 1) % 3, (i + 2) % 3];
                areas[triangle[i] as usize] += double_area / 6.0;
                if double_area > SLIVER * longest {
                    let cotangent = (p[j] - p[i]).dot(p[k] - p[i]) / double_area;
                    edges.push((edge(triangle[j], triangle[k]), cotangent / 2.0));
                }
            }
        }
        edges.sort_by_key(|(edge, _)| *edge);
        edges.dedup_by(|next, first| {
            let is_same = next.0 == first.0;
            if is_same {
                first.1 += next.1;
            }
            is_same
        });
        Self { edges, areas }
    }

    /// Weights e^(-2 d²/h²) of neighbours at a distance of d, where h is the geometric mean of two widths:
    /// at each end, the root mean square of the distances of all neighbours.
    fn of_neighbours(positions: &[DVec3], graph: &Graph<'_>) -> Self {
        let squared = |i: usize, j: u32| positions[i].distance_squared(positions[j as usize]);
        let width = |i: usize| {
            let all = graph.of(i);
            all.iter().map(|j| squared(i, *j)).sum::<f64>() / all.len().max(1) as f64
        };
        let widths: Vec<f64> = (0..positions.len()).map(width).collect();
        let (mut edges, mut areas) = (Vec::with_capacity(graph.all().len()), vec![0.0; positions.len()]);
        for i in 0..positions.len() {
            for &j in graph.of(i) {
                let width = (widths[i] * widths[j as usize]).sqrt();
                if width > 0.0 {
                    edges.push((edge(i as u32, j), (-2.0 * squared(i, j) / width).exp()));
                }
            }
        }
        edges.sort_by_key(|(edge, _)| *edge);
        edges.dedup_by_key(|(edge, _)| *edge);
        for ([i, j], weight) in &edges {
            let part = weight * squared(*i as usize, *j) / 4.0;
            areas[*i as usize] += part;
            areas[*j as usize] += part;
        }
        Self { edges, areas }
    }
}

fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Vertices of edges with one triangle alone.
fn borders(triangles: &[[u32; 3]]) -> impl Iterator<Item = u32> {
    let of = |t: &[u32; 3]| [edge(t[0], t[1]), edge(t[1], t[2]), edge(t[2], t[0])];
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(of).collect();
    edges.sort_unstable();
    let alone: Vec<[u32; 2]> =
        edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| same[0]).collect();
    alone.into_iter().flatten()
}
