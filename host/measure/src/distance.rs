//! Distances between surfaces: the Hausdorff distance and the root mean square, one way and both (P. Cignoni,
//! C. Rocchini, R. Scopigno, *Metro: measuring error on simplified surfaces*, Computer Graphics Forum 1998),
//! from the vertices of one mesh to the triangles of the other.
//!
//! As vertices alone are looked at, the Hausdorff distance is a lower bound: between its vertices a surface
//! can be farther away, by no more than its longest edges.

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;
use simod_model::{Progress, Result};

use super::tree::{QueuedPart, TreeTriangle, TriangleTree};
use super::triangle::{corners, cross};

/// Points that are looked up before the user is asked whether to go on.
const BLOCK: usize = 1 << 14;
/// Points that one thread looks up one after the other.
const ROW: usize = 1 << 9;

/// Distances of the points of a surface from another one, in the positions' unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distances {
    /// Root of the mean square over the surface: each vertex stands for a third of its triangles' area.
    pub rms: f64,
    /// The greatest: the Hausdorff distance one way.
    pub max: f64,
}

/// Triangles among which the nearest, and the first on a ray, is found, in a tree of nodes with four parts
/// each.
///
/// Memory: about 180 bytes for each triangle, and 30 more in the making.
pub struct DistanceSurface {
    /// Triangles in the order of the tree's leaves.
    facets: Vec<TreeTriangle>,
    tree: TriangleTree,
}

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnSurface {
    /// Index of the triangle that the point is on.
    pub triangle: u32,
    /// Weights of the triangle's corners, at least 0, which add up to 1.
    pub weights: DVec3,
    /// The nearest point itself.
    pub position: DVec3,
}

impl DistanceSurface {
    /// Surface of the triangles between these positions, without those that have no area: their sides belong
    /// to others. None if no triangle is left.
    pub fn new(positions: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let facets =
            triangles.iter().zip(0..).filter_map(|(t, i)| Some(TreeTriangle(corners(positions, *t)?, i)));
        let facets: Vec<TreeTriangle> = facets.filter(|f| cross(f.0).length_squared() > 0.0).collect();
        if facets.is_empty() {
            return None;
        }
        let (tree, order) = TriangleTree::from_facets(&facets);
        let sorted = |i: &u32| TreeTriangle(facets[*i as usize].0, facets[*i as usize].1);
        let facets: Vec<TreeTriangle> = order.par_iter().map(sorted).collect();
        Some(Self { facets, tree })
    }

    /// Triangle nearest to a point, by its place in the order, and the nearest point of the triangle. Quick
    /// where `near` is the place of a triangle that is about as near; `waiting` is room for the search.
    fn nearest(&self, p: DVec3, near: usize, waiting: &mut Vec<QueuedPart>) -> (usize, DVec3) {
        let point = nearest_on(self.facets[near].0, p);
        let (mut best, mut square) = ((near, point), p.distance_squared(point));
        self.tree.nearest(p, square, waiting, |place| {
            let point = nearest_on(self.facets[place].0, p);
            let distance = p.distance_squared(point);
            if distance < square {
                (best, square) = ((place, point), distance);
            }
            square
        });
        best
    }

    /// The distance of a point, which has to be finite.
    pub fn distance(&self, p: DVec3) -> f64 {
        self.nearest(p, 0, &mut Vec::new()).1.distance(p)
    }

    /// The point of the surface that is nearest to a point, which has to be finite.
    pub fn closest(&self, p: DVec3) -> Option<OnSurface> {
        let (facet, point) = self.nearest(p, 0, &mut Vec::new());
        Some(self.facets[facet].on_surface(point))
    }

    /// First point at which a ray of a finite origin and direction, which is not zero, meets the surface,
    /// from either side; on the first one of several triangles there.
    pub fn first_on_ray(&self, origin: DVec3, direction: DVec3) -> Option<OnSurface> {
        let mut first = None::<(f64, &TreeTriangle)>;
        self.tree.on_ray(origin, direction, |place| {
            let facet = &self.facets[place];
            let Some(t) = meets(facet.0, origin, direction) else { return };
            if first.is_none_or(|(s, other)| t.total_cmp(&s).then(facet.1.cmp(&other.1)).is_lt()) {
                first = Some((t, facet));
            }
        });
        first.map(|(t, facet)| facet.on_surface(origin + t * direction))
    }

    /// Distances of another surface, taken at the corners of its triangles, from this one. All 0 for a
    /// surface without triangles. Begins no stage of the progress, and advances it by the positions.
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
        // Each point is next to the one before it, more often than not.
        let row = |(points, areas): (&[DVec3], &[f64])| {
            let (mut near, mut waiting) = (0, Vec::new());
            let of = |(p, area): (&DVec3, &f64)| {
                if *area <= 0.0 {
                    return 0.0;
                }
                let (facet, point) = self.nearest(*p, near, &mut waiting);
                near = facet;
                point.distance(*p)
            };
            points.iter().zip(areas).map(of).collect::<Vec<f64>>()
        };
        for (points, areas) in positions.chunks(BLOCK).zip(areas.chunks(BLOCK)) {
            progress.check()?;
            progress.advance(points.len() as u64);
            // Summed up in the points' order, so that the sum does not depend on the threads.
            let found: Vec<Vec<f64>> = points.par_chunks(ROW).zip(areas.par_chunks(ROW)).map(row).collect();
            for (distance, area) in found.into_iter().flatten().zip(areas) {
                sum += area * distance * distance;
                weights += area;
                max = max.max(distance);
            }
        }
        Ok(Distances { rms: if weights > 0.0 { (sum / weights).sqrt() } else { 0.0 }, max })
    }
}

impl TreeTriangle {
    /// Point of the triangle, which `position` is but for rounding.
    fn on_surface(&self, position: DVec3) -> OnSurface {
        let [a, b, c] = self.0;
        let normal = cross(self.0);
        let part = |from: DVec3, to: DVec3| (to - from).cross(position - from).dot(normal).max(0.0);
        let parts = DVec3::new(part(b, c), part(c, a), part(a, b));
        OnSurface { triangle: self.1, weights: parts / parts.element_sum(), position }
    }
}

/// Distance along a ray to a triangle, in lengths of the direction: by the volumes that the ray spans with
/// the sides (T. Möller, B. Trumbore, *Fast, Minimum Storage Ray-Triangle Intersection*, 1997).
fn meets([a, b, c]: [DVec3; 3], origin: DVec3, direction: DVec3) -> Option<f64> {
    let (u, v) = (b - a, c - a);
    let across = direction.cross(v);
    let volume = u.dot(across);
    if volume == 0.0 {
        return None;
    }
    let from = origin - a;
    let by_u = from.dot(across) / volume;
    let around = from.cross(u);
    let by_v = direction.dot(around) / volume;
    let t = v.dot(around) / volume;
    // Sides belong to both of their triangles, so that no ray slips through between.
    let slack = 1e-12;
    (by_u >= -slack && by_v >= -slack && by_u + by_v <= 1.0 + slack && t >= 0.0 && t.is_finite()).then_some(t)
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

/// The point of a triangle, which has an area, that is nearest to `p`: its projection on the plane if that is
/// inside, or the nearest point of a side.
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
    use simod_model::progress::Silent;

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
        DistanceSurface::new(&to.0, &to.1).unwrap().distances(&from.0, &from.1, &Silent).unwrap()
    }

    #[test]
    fn concentric_spheres_are_as_far_apart_as_their_radii() {
        let (inner, outer) = (sphere(1.0, 24), sphere(1.25, 30));
        // The triangles of the outer one lie within its sphere, by what an arc of an edge rises above its
        // chord.
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
    fn points_of_a_surface_and_rays_know_their_triangles() {
        let (points, triangles) = sphere(1.0, 12);
        let surface = DistanceSurface::new(&points, &triangles).unwrap();
        let mut met = 0;
        for i in 0..200 {
            let t = f64::from(i);
            let to = DVec3::new((t * 0.7).sin(), (t * 1.3).cos(), (t * 0.37).sin()).normalize_or_zero();
            let found = surface.closest(to * 1.5).unwrap();
            let corners = triangles[found.triangle as usize].map(|i| points[i as usize]);
            let mixed =
                corners[0] * found.weights.x + corners[1] * found.weights.y + corners[2] * found.weights.z;
            assert!(found.weights.min_element() >= 0.0 && mixed.distance(found.position) < 1e-12);
            assert!((found.position.distance(to * 1.5) - surface.distance(to * 1.5)).abs() < 1e-12);
            // From inside by any length of the direction, the wall is met once; from outside the near side is
            // first.
            let inner = surface.first_on_ray(DVec3::ZERO, to * 7.0).unwrap();
            assert!(
                inner.position.normalize_or_zero().distance(to) < 1e-12 && inner.position.length() > 0.98
            );
            let outer = surface.first_on_ray(to * 3.0, -to).unwrap();
            assert!(outer.position.distance(inner.position) < 1e-9, "{outer:?} is not {inner:?}");
            met += usize::from(surface.first_on_ray(to * 3.0, to).is_none());
        }
        assert_eq!(met, 200, "away from it nothing is met");
        // Along an axis, and in the plane of a box.
        let flat = square(1.0, 4);
        let flat = DistanceSurface::new(&flat.0, &flat.1).unwrap();
        let down = flat.first_on_ray(DVec3::new(0.25, 2.0, 0.25), DVec3::NEG_Y).unwrap();
        assert_eq!(down.position, DVec3::new(0.25, 0.0, 0.25));
        assert_eq!(flat.first_on_ray(DVec3::new(-1.0, 0.0, 0.3), DVec3::X), None);
    }

    #[test]
    fn no_triangle_that_is_nearer_is_passed_over() {
        let (sphere, triangles) = sphere(1.0, 9);
        // Large coordinates, and a surface that is small beside its place.
        for (middle, size) in [(DVec3::ZERO, 1.0), (DVec3::new(4e6, -1e5, 3.0), 2.5), (DVec3::X, 1e-9)] {
            let bumpy = |p: &DVec3| middle + *p * size * (1.0 + 0.2 * (9.0 * p.x).sin() * (7.0 * p.y).cos());
            let points: Vec<DVec3> = sphere.iter().map(bumpy).collect();
            let surface = DistanceSurface::new(&points, &triangles).unwrap();
            // Points of the surface, near it, and so far from it that single precision does not tell how far.
            for i in 0..900 {
                let t = f64::from(i);
                let to = DVec3::new((t * 0.7).sin(), (t * 1.3).cos(), (t * 0.37).sin()).normalize_or_zero();
                let far = [0.0, 1e-7, 0.3, 1.0, 1.0 + 1e-6, 1.4, 50.0, 1e18, 1e150][i as usize % 9];
                let p = if i < 300 { points[i as usize] } else { middle + to * far * size };
                let each = triangles.iter().map(|t| nearest_on(t.map(|i| points[i as usize]), p).distance(p));
                let least = each.fold(f64::INFINITY, f64::min);
                for near in [0, i as usize % 50] {
                    let found = surface.nearest(p, near, &mut Vec::new()).1.distance(p);
                    assert!(found <= least * (1.0 + 1e-12), "{found}, not {least}, of {p} about {middle}");
                }
            }
        }
    }

    #[test]
    fn beyond_a_triangle_its_sides_and_corners_are_nearest() {
        let triangle =
            DistanceSurface::new(&[DVec3::ZERO, DVec3::X, DVec3::Y], &[[0, 1, 2], [0, 1, 1]]).unwrap();
        assert!((triangle.distance(DVec3::new(-3.0, -4.0, 0.0)) - 5.0).abs() < 1e-12);
        assert!((triangle.distance(DVec3::new(1.0, 1.0, 0.0)) - 0.5f64.sqrt()).abs() < 1e-12);
        assert!((triangle.distance(DVec3::new(0.2, 0.2, -0.7)) - 0.7).abs() < 1e-12);
        assert!(DistanceSurface::new(&[DVec3::ZERO, DVec3::X], &[[0, 1, 1], [0, 1, 7]]).is_none());
    }
}
