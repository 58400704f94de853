//! Triangles where there are none: the Delaunay star of a sample among its neighbours, in their plane.
//!
//! M. Belkin, J. Sun, Y. Wang, *Constructing Laplace Operator from Point Clouds in R^d*, SODA 2009, has the
//! idea of triangulations that are local; N. Sharp, K. Crane 2020, §5.7, that of the Delaunay stars of all
//! samples, each found by itself. Their cotangents are summed, a third each, which makes the Laplacian
//! symmetric: the Delaunay triangulation's own where the stars agree. Where they do not, weights may be
//! negative, and the energy of each triangle is not.

use glam::{DVec2, DVec3};
use simod_geometry::jacobi_eigen;

/// Neighbours that are looked at: enough to surround a sample.
const MOST: usize = 20;
/// Largest distance of corners of a sample's Voronoi cell from the sample, in units of the farthest
/// neighbour's distance. A sample with a cell beyond it lies at a border.
const REACH: f64 = 1.0;
/// Distance of two neighbours below which they are one, in the same units.
const COINCIDENT: f64 = 1e-9;
/// A neighbour that cuts off less than this, in units of its distance, does not count: of points on one
/// circle, as in grids, rounding would take some.
const COCIRCULAR: f64 = 1e-5;

/// Triangles around sample `i`, which may be none: its neighbours are few, or on a line. `same_side` tells of
/// which neighbours the sample knows that they are on its side of the surface.
pub fn star(
    positions: &[DVec3],
    i: u32,
    neighbours: &[u32],
    same_side: impl Fn(u32) -> bool,
) -> Vec<[u32; 3]> {
    let centre = positions[i as usize];
    let near: Vec<(u32, DVec3)> = neighbours
        .iter()
        .filter(|j| **j != i && same_side(**j))
        .take(MOST)
        .map(|&j| (j, positions[j as usize] - centre))
        .collect();
    let reach = near.iter().map(|(_, v)| v.length()).fold(0.0, f64::max);
    if reach <= 0.0 || !reach.is_finite() {
        return Vec::new();
    }
    let [x, y] = plane(&near, reach);
    let mut cell = VoronoiCell::square(REACH * reach);
    for (j, v) in near {
        let q = DVec2::new(v.dot(x), v.dot(y));
        if q.length() > COINCIDENT * reach {
            cell.cut(q, j);
        }
    }
    cell.corners().filter(|[a, b]| a != b).map(|[a, b]| [i, a, b]).collect()
}

/// Two directions in which the neighbours extend most.
fn plane(near: &[(u32, DVec3)], reach: f64) -> [DVec3; 2] {
    let mean = near.iter().map(|(_, v)| *v).sum::<DVec3>() / (near.len() + 1) as f64;
    let mut covariance = [[0.0; 3]; 3];
    for v in near.iter().map(|(_, v)| *v).chain([DVec3::ZERO]) {
        let v = (v - mean) / reach;
        (0..3).for_each(|r| (0..3).for_each(|c| covariance[r][c] += v[r] * v[c]));
    }
    let (values, vectors) = jacobi_eigen(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
    [order[0], order[1]].map(|k| DVec3::from(vectors[k]))
}

/// The points of the plane nearer to the origin than to the neighbours so far: a convex polygon,
/// counter-clockwise.
struct VoronoiCell {
    /// Start of each side, and the neighbour beyond the side; `None` for sides of the border.
    sides: Vec<(DVec2, Option<u32>)>,
}

impl VoronoiCell {
    fn square(reach: f64) -> Self {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        Self { sides: corners.map(|c| (reach * DVec2::from(c), None)).to_vec() }
    }

    /// Cuts off the points that are nearer to `q`.
    fn cut(&mut self, q: DVec2, neighbour: u32) {
        let outside = |p: DVec2| p.dot(q) - q.length_squared() / 2.0;
        let tolerance = COCIRCULAR * q.length_squared();
        let mut kept = Vec::with_capacity(self.sides.len() + 1);
        for (k, &(from, beyond)) in self.sides.iter().enumerate() {
            let to = self.sides[(k + 1) % self.sides.len()].0;
            let (a, b) = (outside(from), outside(to));
            if a <= tolerance {
                kept.push((from, beyond));
            }
            if (a <= tolerance) != (b <= tolerance) {
                let at = from + (to - from) * (a / (a - b)).clamp(0.0, 1.0);
                kept.push((at, if a <= tolerance { Some(neighbour) } else { beyond }));
            }
        }
        self.sides = kept;
    }

    /// The neighbours beyond the two sides at each corner.
    fn corners(&self) -> impl Iterator<Item = [u32; 2]> {
        let last = self.sides.len().wrapping_sub(1);
        (0..self.sides.len()).filter_map(move |k| {
            let before = self.sides[if k == 0 { last } else { k - 1 }].1?;
            Some([before, self.sides[k].1?])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hexagon_is_its_own_star() {
        let mut points = vec![DVec3::new(0.1, 0.2, 0.3)];
        for k in 0..12 {
            let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos();
            // The outer ring is beyond the inner one.
            let r = if k < 6 { 1.0 } else { 1.9 };
            points.push(points[0] + r * DVec3::new(c, 0.8 * s, 0.6 * s));
        }
        let all: Vec<u32> = (1..13).collect();
        let star = star(&points, 0, &all, |_| true);
        assert_eq!(star.len(), 6, "{star:?}");
        for [i, a, b] in star {
            assert_eq!(i, 0);
            let step = (b + 6 - a) % 6;
            assert!(a <= 6 && b <= 6 && (step == 1 || step == 5), "{a} {b}");
        }
    }

    #[test]
    fn lines_and_points_have_none() {
        let points: Vec<DVec3> = (0..9).map(|i| DVec3::X * f64::from(i)).collect();
        let all: Vec<u32> = (0..9).collect();
        assert!(star(&points, 4, &all, |_| true).is_empty());
        assert!(star(&[DVec3::ONE; 9], 4, &all, |_| true).is_empty());
        assert!(star(&points, 4, &[], |_| true).is_empty());
    }
}
