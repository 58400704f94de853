//! Distances of points from a set of points or of triangles, measured at every one of them.

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;

/// Statistics of many distances, in the unit of the points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distances {
    /// The mean.
    pub mean: f64,
    /// The root of the mean square.
    pub rms: f64,
    /// The largest.
    pub worst: f64,
}

impl Distances {
    /// Of all `points`, which are not empty.
    fn measure(points: &[DVec3], distance: impl Fn(DVec3) -> f64 + Sync) -> Self {
        let (sum, squares, worst) = points
            .par_iter()
            .map(|p| distance(*p))
            .fold(|| (0.0, 0.0, 0.0f64), |(sum, squares, worst), d| (sum + d, squares + d * d, worst.max(d)))
            .reduce(|| (0.0, 0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1, a.2.max(b.2)));
        let n = points.len() as f64;
        Self { mean: sum / n, rms: (squares / n).sqrt(), worst }
    }

    /// The same as fractions of a length.
    pub fn over(self, length: f64) -> Self {
        Self { mean: self.mean / length, rms: self.rms / length, worst: self.worst / length }
    }
}

/// Distances of points from the nearest of `set`; `None` where one of both is empty.
pub fn to_points(points: &[DVec3], set: &[DVec3]) -> Option<Distances> {
    let set: Vec<[f64; 3]> = set.iter().map(DVec3::to_array).collect();
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&set).ok().filter(|_| !set.is_empty())?;
    let nearest = |p: DVec3| {
        let query = p.to_array();
        let nearest = tree.query(&query).nearest_one::<SquaredEuclidean<f64>>().execute();
        p.distance(DVec3::from_array(set[nearest.item as usize]))
    };
    (!points.is_empty()).then(|| Distances::measure(points, nearest))
}

/// Distances of points from the nearest of the triangles between `vertices`; `None` where there is no point
/// or no triangle. Triangles without an area are left out: their corners belong to others.
///
/// # Panics
/// A triangle has a vertex that does not exist.
pub fn to_triangles(points: &[DVec3], vertices: &[DVec3], triangles: &[[u32; 3]]) -> Option<Distances> {
    let mesh = triangle_mesh(vertices, triangles).filter(|_| !points.is_empty())?;
    Some(Distances::measure(points, |p| mesh.distance_to_local_point(vector(p), false)))
}

/// Triangles among which the closest point can be found (a tree of boxes), without those that have no area;
/// `None` if none is left.
///
/// # Panics
/// A triangle has a vertex that does not exist.
pub fn triangle_mesh(vertices: &[DVec3], triangles: &[[u32; 3]]) -> Option<TriMesh> {
    let area = |[a, b, c]: [u32; 3]| {
        let [a, b, c] = [a, b, c].map(|i| vertices[i as usize]);
        (b - a).cross(c - a).length_squared()
    };
    let triangles: Vec<[u32; 3]> = triangles.iter().copied().filter(|t| area(*t) > 0.0).collect();
    TriMesh::new(vertices.iter().copied().map(vector).collect(), triangles).ok()
}

/// A point as the tree takes it.
pub fn vector(p: DVec3) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a square of side 1, at a height that is 0.1 on one half and −0.3 on the other.
    fn points() -> Vec<DVec3> {
        let height = |i: i32| if i < 50 { 0.1 } else { -0.3 };
        let at = |i: i32, j: i32| DVec3::new(f64::from(i) / 99.0, height(i), f64::from(j) / 99.0);
        (0..100).flat_map(|i| (0..100).map(move |j| at(i, j))).collect()
    }

    #[test]
    fn distances_to_two_triangles_are_the_heights() {
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, z)| DVec3::new(x, 0.0, z));
        // With one that has no area, and would swallow all with NaN.
        let found = to_triangles(&points(), &corners, &[[0, 1, 2], [0, 2, 3], [1, 1, 2]]).expect("distances");
        assert!((found.mean - 0.2).abs() < 1e-12, "{found:?}");
        assert!((found.rms - 0.05f64.sqrt()).abs() < 1e-12, "{found:?}");
        assert!((found.worst - 0.3).abs() < 1e-12, "{found:?}");
        assert!((found.over(2.0).worst - 0.15).abs() < 1e-12);
    }

    #[test]
    fn the_program_s_own_distances_are_the_same() {
        let at = |i: u32| DVec3::new(f64::from(i * 37 % 101), f64::from(i * 53 % 97), f64::from(i * 71 % 89));
        let corners: Vec<DVec3> = (0..300).map(at).collect();
        let triangles: Vec<[u32; 3]> = (0..100).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let surface = simod_measure::DistanceSurface::new(&corners, &triangles).expect("triangles");
        for p in (1000..2000).map(at).map(|p| 1.3 * p + 0.1) {
            let expected = to_triangles(&[p], &corners, &triangles).expect("a distance").worst;
            assert!((surface.distance(p) - expected).abs() < 1e-9, "{p}: {} {expected}", surface.distance(p));
        }
    }

    #[test]
    fn beyond_a_triangle_its_edges_and_corners_are_nearest() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let distance = |p: DVec3| to_triangles(&[p], &triangle, &[[0, 1, 2]]).expect("a distance").worst;
        assert!((distance(DVec3::new(-3.0, -4.0, 0.0)) - 5.0).abs() < 1e-12);
        assert!((distance(DVec3::new(1.0, 1.0, 0.0)) - 0.5f64.sqrt()).abs() < 1e-12);
        assert!((distance(DVec3::new(0.2, 0.2, -0.7)) - 0.7).abs() < 1e-12);
    }

    #[test]
    fn distances_to_points_are_those_to_the_nearest() {
        // Many with one coordinate in common, as models have.
        let (points, set) = (points(), points().into_iter().step_by(7).collect::<Vec<_>>());
        let found = to_points(&points, &set).expect("distances");
        let nearest = |p: &DVec3| set.iter().map(|q| p.distance(*q)).fold(f64::INFINITY, f64::min);
        let worst = points.iter().map(nearest).fold(0.0, f64::max);
        let mean = points.iter().map(nearest).sum::<f64>() / points.len() as f64;
        assert!((found.worst - worst).abs() < 1e-12 && (found.mean - mean).abs() < 1e-12, "{found:?}");
        assert_eq!(to_points(&set, &points).expect("distances").worst, 0.0);
    }

    #[test]
    fn nothing_is_no_distance() {
        assert_eq!(to_points(&points(), &[]), None);
        assert_eq!(to_points(&[], &points()), None);
        assert_eq!(to_triangles(&points(), &points(), &[]), None);
        assert_eq!(to_triangles(&points(), &points(), &[[3, 3, 3]]), None);
        assert_eq!(to_triangles(&[], &points(), &[[0, 1, 100]]), None);
    }
}
