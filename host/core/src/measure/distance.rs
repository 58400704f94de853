//! How far surfaces are from each other: the Hausdorff distance and the root mean square, one way and both (P. Cignoni,
//! C. Rocchini, R. Scopigno, *Metro: measuring error on simplified surfaces*, Computer Graphics Forum 1998), from the
//! vertices of one mesh to the triangles of the other.
//!
//! As vertices alone are looked at, the Hausdorff distance is a lower bound: between its vertices a surface can be farther
//! away, by no more than its longest edges.

use glam::DVec3;
use rayon::prelude::*;
use rstar::{AABB, PointDistance, RTree, RTreeObject};
use serde::Serialize;

use super::{corners, cross};
use crate::{Progress, Result};

/// Points that are looked up before the user is asked whether to go on.
const BLOCK: usize = 1 << 14;

/// How far the points of a surface are from another one, in the positions' unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distances {
    /// Root of the mean square over the surface: each vertex stands for a third of its triangles' area.
    pub rms: f64,
    /// The greatest: the Hausdorff distance one way.
    pub max: f64,
}

/// Triangles among which the nearest is found, in an R*-tree.
///
/// Memory: about 150 bytes for each triangle.
pub struct Surface {
    facets: RTree<Facet>,
}

/// A triangle with an area.
struct Facet([DVec3; 3]);

impl RTreeObject for Facet {
    type Envelope = AABB<[f64; 3]>;

    fn envelope(&self) -> Self::Envelope {
        AABB::from_points(&self.0.map(|p| p.to_array()))
    }
}

impl PointDistance for Facet {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let p = DVec3::from_array(*point);
        p.distance_squared(nearest_on(self.0, p))
    }
}

impl Surface {
    /// The triangles between these positions, but for those without an area: their sides belong to others. Nothing if
    /// none is left.
    pub fn new(positions: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let facets = triangles.iter().filter_map(|t| corners(positions, *t));
        let facets: Vec<Facet> = facets.filter(|c| cross(*c).length_squared() > 0.0).map(Facet).collect();
        (!facets.is_empty()).then(|| Self { facets: RTree::bulk_load(facets) })
    }

    /// The distance of a point, which has to be finite.
    pub fn distance(&self, p: DVec3) -> f64 {
        let nearest = self.facets.nearest_neighbor(p.to_array());
        nearest.map_or(f64::INFINITY, |facet| facet.distance_2(&p.to_array()).sqrt())
    }

    /// How far another surface is from this one: the corners of its triangles. All 0 for one without any.
    ///
    /// # Errors
    /// The user cancelled.
    pub fn distances(
        &self,
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        progress: &dyn Progress,
    ) -> Result<Distances> {
        let areas = areas(positions, triangles);
        let (mut sum, mut weights, mut max) = (0.0, 0.0, 0.0f64);
        for (points, areas) in positions.chunks(BLOCK).zip(areas.chunks(BLOCK)) {
            progress.check()?;
            let of = |(p, area): (&DVec3, &f64)| if *area > 0.0 { self.distance(*p) } else { 0.0 };
            // Summed up in the points' order, so that the sum does not depend on the threads.
            let found: Vec<f64> = points.par_iter().zip(areas).map(of).collect();
            for (distance, area) in found.into_iter().zip(areas) {
                sum += area * distance * distance;
                weights += area;
                max = max.max(distance);
            }
        }
        Ok(Distances { rms: if weights > 0.0 { (sum / weights).sqrt() } else { 0.0 }, max })
    }
}

/// A third of the area of the triangles at each vertex.
fn areas(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut areas = vec![0.0; positions.len()];
    for triangle in triangles {
        if let Some(corners) = corners(positions, *triangle) {
            let area = cross(corners).length() / 6.0;
            triangle.iter().for_each(|i| areas[*i as usize] += area);
        }
    }
    areas
}

/// The point of a triangle, which has an area, that is nearest to `p`: its projection on the plane if that is inside, or
/// the nearest point of a side.
fn nearest_on([a, b, c]: [DVec3; 3], p: DVec3) -> DVec3 {
    if [a, b, c].contains(&p) {
        // Not rounded: a surface is at no distance from itself.
        return p;
    }
    let normal = (b - a).cross(c - a);
    let is_inside = |from: DVec3, to: DVec3| (to - from).cross(p - from).dot(normal) >= 0.0;
    if is_inside(a, b) && is_inside(b, c) && is_inside(c, a) {
        return p - normal * ((p - a).dot(normal) / normal.length_squared());
    }
    let on_side = |from: DVec3, to: DVec3| {
        let side = to - from;
        from + side * ((p - from).dot(side) / side.length_squared()).clamp(0.0, 1.0)
    };
    let mut nearest = on_side(a, b);
    for other in [on_side(b, c), on_side(c, a)] {
        if p.distance_squared(other) < p.distance_squared(nearest) {
            nearest = other;
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    /// A square in the plane y = 0, from corner to corner, in so many steps.
    fn square(side: f64, steps: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let on = |i: u32| side * f64::from(i) / f64::from(steps);
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        for (i, k) in (0..=steps).flat_map(|i| (0..=steps).map(move |k| (i, k))) {
            points.push(DVec3::new(on(i), 0.0, on(k)));
            if i < steps && k < steps {
                let a = i * (steps + 1) + k;
                let (b, c, d) = (a + 1, a + steps + 1, a + steps + 2);
                triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
        (points, triangles)
    }

    /// A sphere, as an octahedron of which each triangle is split into so many steps.
    fn sphere(radius: f64, steps: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        for octant in 0..8 {
            let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let first = points.len() as u32;
            let at = |i: u32, k: u32| first + i * (steps + 1) - i * i.saturating_sub(1) / 2 + k;
            for (i, k) in (0..=steps).flat_map(|i| (0..=steps - i).map(move |k| (i, k))) {
                let p = DVec3::new(f64::from(i), f64::from(k), f64::from(steps - i - k));
                points.push(p.normalize_or_zero() * DVec3::new(sign(0), sign(1), sign(2)) * radius);
                if i + k < steps {
                    triangles.push([at(i, k), at(i, k + 1), at(i + 1, k)]);
                }
                if i + k + 1 < steps {
                    triangles.push([at(i + 1, k), at(i, k + 1), at(i + 1, k + 1)]);
                }
            }
        }
        (points, triangles)
    }

    fn between(from: &(Vec<DVec3>, Vec<[u32; 3]>), to: &(Vec<DVec3>, Vec<[u32; 3]>)) -> Distances {
        Surface::new(&to.0, &to.1).unwrap().distances(&from.0, &from.1, &Silent).unwrap()
    }

    #[test]
    fn concentric_spheres_are_as_far_apart_as_their_radii() {
        let (inner, outer) = (sphere(1.0, 24), sphere(1.25, 30));
        // The triangles of the outer one lie within its sphere, by what an arc of an edge rises above its chord.
        let rise = 0.005;
        for (from, to) in [(&inner, &outer), (&outer, &inner)] {
            let found = between(from, to);
            assert!((found.max - 0.25).abs() < rise && (found.rms - 0.25).abs() < rise, "{found:?}");
        }
    }

    #[test]
    fn a_translated_plane_is_as_far_as_it_was_moved() {
        let plane = square(1.0, 10);
        let moved = (plane.0.iter().map(|p| *p + DVec3::Y * 0.3).collect(), plane.1.clone());
        for found in [between(&plane, &moved), between(&moved, &plane)] {
            assert!((found.max - 0.3).abs() < 1e-15 && (found.rms - 0.3).abs() < 1e-15, "{found:?}");
        }
        // Along itself, what overlaps is at no distance, and the border as far as it was moved.
        let along = (plane.0.iter().map(|p| *p + DVec3::X * 0.25).collect(), plane.1.clone());
        let found = between(&along, &plane);
        assert!((found.max - 0.25).abs() < 1e-12 && found.rms < 0.1, "{found:?}");
    }

    #[test]
    fn a_part_is_near_the_whole_and_the_whole_far_from_the_part() {
        let (part, whole) = (square(1.0, 4), square(3.0, 9));
        assert!(between(&part, &whole).max < 1e-12);
        let back = between(&whole, &part);
        assert!((back.max - 8f64.sqrt()).abs() < 1e-12, "{back:?}");
    }

    #[test]
    fn the_mean_is_that_of_the_surface_and_not_of_its_vertices() {
        // A wall 0 ≤ x, z ≤ 1 that rises from the plane; one half of it has many times the vertices.
        let plane = square(1.0, 1);
        let tilted = |steps, from: f64| {
            let (points, triangles) = square(0.5, steps);
            let lift = |p: &DVec3| DVec3::new(p.x + from, if from > 0.0 { 0.2 } else { 0.0 }, 2.0 * p.z);
            (points.iter().map(lift).collect::<Vec<_>>(), triangles)
        };
        let (mut points, mut triangles) = tilted(2, 0.0);
        let (more, dense) = tilted(40, 0.5);
        let first = points.len() as u32;
        points.extend(more);
        triangles.extend(dense.iter().map(|t| t.map(|i| i + first)));
        let found = between(&(points, triangles), &plane);
        assert!((found.rms - 0.02f64.sqrt()).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn beyond_a_triangle_its_sides_and_corners_are_nearest() {
        let triangle = Surface::new(&[DVec3::ZERO, DVec3::X, DVec3::Y], &[[0, 1, 2], [0, 1, 1]]).unwrap();
        assert!((triangle.distance(DVec3::new(-3.0, -4.0, 0.0)) - 5.0).abs() < 1e-12);
        assert!((triangle.distance(DVec3::new(1.0, 1.0, 0.0)) - 0.5f64.sqrt()).abs() < 1e-12);
        assert!((triangle.distance(DVec3::new(0.2, 0.2, -0.7)) - 0.7).abs() < 1e-12);
        assert!(Surface::new(&[DVec3::ZERO, DVec3::X], &[[0, 1, 1], [0, 1, 7]]).is_none());
    }
}
