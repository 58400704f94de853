//! Cages that are made about the samples: coarse, closed, and with all samples inside.

use crate::mesh::Cage;
use glam::{DVec3, IVec3};
use simod_plugin_api::{Bounds, PluginResult};
use std::collections::HashMap;

/// Least size of a cage, relative to the diagonal: also flat models get a cage with a volume.
const THINNEST: f64 = 0.05;
/// Number of rounds in which a hull is drawn in.
const ROUNDS: usize = 30;
/// Number of parts along a side of a face: a hull is drawn in by the outermost samples, one for each part
/// of a face.
const PARTS: usize = 8;
/// Least distance of a hull's corner from the centre, in units of the box' half size.
const NEAREST: f64 = 0.05;

/// The box about the model at rest, and about the samples where earlier steps have moved them, with a margin.
#[derive(Debug, Clone, Copy)]
struct ModelBox {
    centre: DVec3,
    half: DVec3,
}

impl ModelBox {
    fn new(bounds: &Bounds, samples: &[[f32; 3]], margin: f64) -> Self {
        let (mut min, mut max) = (DVec3::from(bounds.min), DVec3::from(bounds.max));
        for p in samples.iter().map(|p| DVec3::from(p.map(f64::from))) {
            (min, max) = (min.min(p), max.max(p));
        }
        let thinnest = if max == min { 1.0 } else { THINNEST * max.distance(min) };
        Self {
            centre: 0.5 * (min + max),
            half: (0.5 * (max - min)).max(DVec3::splat(0.5 * thinnest)) + margin,
        }
    }
}

/// Box whose faces are divided into about square cells, so that it has about `detail` vertices.
pub fn divided_box(bounds: &Bounds, samples: &[[f32; 3]], margin: f64, detail: usize) -> PluginResult<Cage> {
    let around = ModelBox::new(bounds, samples, margin);
    let divided = |along: i32| {
        (around.half / around.half.max_element() * f64::from(along)).round().as_ivec3().max(IVec3::ONE)
    };
    let vertices = |n: IVec3| 2 * (n.x * n.y + n.y * n.z + n.z * n.x) + 2;
    // The number of cells along the longest side is that which gives the nearest number of vertices.
    let mut best = divided(1);
    for along in 2..=detail as i32 {
        let next = divided(along);
        if (vertices(next) - detail as i32).abs() < (vertices(best) - detail as i32).abs() {
            best = next;
        }
        if vertices(next) > detail as i32 {
            break;
        }
    }
    let n = best;
    let (mut mesh, mut faces) = (GridTriangles::default(), Vec::new());
    for axis in 0..3 {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [0, n[axis]] {
            for i in 0..n[b] {
                for j in 0..n[c] {
                    let mut at = |i: i32, j: i32| {
                        let mut corner = IVec3::ZERO;
                        (corner[axis], corner[b], corner[c]) = (side, i, j);
                        mesh.vertex(corner)
                    };
                    let mut quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                    // Diagonals mirror each other in the face's middle lines, so that a symmetric cage
                    // stays so.
                    if (2 * i < n[b]) == (2 * j < n[c]) {
                        quad.rotate_left(1);
                    }
                    faces.push(quad.map(|v| v as u32).to_vec());
                    let [p, q, r, s] = quad;
                    mesh.triangle([p, q, r], side == 0);
                    mesh.triangle([p, r, s], side == 0);
                }
            }
        }
    }
    let vertex = |g: &IVec3| around.centre + around.half * (2.0 * g.as_dvec3() / n.as_dvec3() - 1.0);
    Ok(Cage::new(mesh.grid.iter().map(vertex).collect(), mesh.triangles)?.with_faces(faces))
}

/// Hull as seen from the centre, with about `detail` vertices in fixed directions: those of an octahedron
/// whose edges are divided. Each vertex is drawn in as far as its triangles leave all samples, and a
/// margin, inside.
///
/// On a triangle with corners `v_k / x_k`, a sample `s Σ β_k v_k` lies inside if `Σ s β_k x_k <= 1`: in the
/// inverse radii `x` these are linear, and a sample has to do with one triangle alone.
pub fn hull(bounds: &Bounds, samples: &[[f32; 3]], margin: f64, detail: usize) -> PluginResult<Cage> {
    let around = ModelBox::new(bounds, samples, 0.0);
    let sphere = Octahedron::with_about(detail);
    let seen = |p: &[f32; 3]| {
        let x = DVec3::from(p.map(f64::from)) - around.centre;
        let pushed = x + margin * x.normalize_or_zero();
        sphere.locate(pushed / around.half)
    };

    // The outermost samples of parts of triangles, to begin with.
    let mut outermost: Vec<Option<CentredPoint>> = vec![None; sphere.mesh.triangles.len() * PARTS * PARTS];
    for seen in samples.iter().filter_map(seen) {
        let [_, b, c] = seen.share.to_array().map(|x| ((x * PARTS as f64) as usize).min(PARTS - 1));
        let part = &mut outermost[(seen.triangle * PARTS + b) * PARTS + c];
        if part.is_none_or(|other| other.size < seen.size) {
            *part = Some(seen);
        }
    }
    let outermost: Vec<CentredPoint> = outermost.into_iter().flatten().collect();
    let unit: Vec<f64> = sphere.mesh.grid.iter().map(|v| v.as_dvec3().length()).collect();
    let mut x: Vec<f64> = unit.iter().map(|length| length / 4.0).collect();
    let mut limits = Vec::new();
    for _ in 0..ROUNDS {
        limits = sphere.limits(&x, outermost.iter().copied());
        for (v, x) in x.iter_mut().enumerate() {
            if limits[v] > 0.0 {
                // The sample stays inside, as all limits of its corners are at least its own sum.
                *x = (*x / limits[v]).min(unit[v] / NEAREST);
            }
        }
    }
    // Vertices that no sample limits, such as below an open base, are as flat as may be.
    let neighbours = sphere.mesh.neighbours();
    for _ in 0..ROUNDS {
        for v in (0..x.len()).filter(|v| limits[*v] == 0.0) {
            x[v] = neighbours[v].iter().map(|n| x[*n]).sum::<f64>() / neighbours[v].len() as f64;
        }
    }
    // At last all samples limit the hull, not the outermost ones alone.
    let limits = sphere.limits(&x, samples.iter().filter_map(seen));
    x.iter_mut().zip(&limits).for_each(|(x, limit)| *x /= limit.max(1.0));
    let vertex = |(v, x): (&IVec3, &f64)| around.centre + around.half * v.as_dvec3() / *x;
    Cage::new(sphere.mesh.grid.iter().zip(&x).map(vertex).collect(), sphere.mesh.triangles)
}

/// Faces of a [`hull`], which do not depend on the samples.
pub fn hull_faces(detail: usize) -> Vec<Vec<u32>> {
    let triangles = Octahedron::with_about(detail).mesh.triangles;
    triangles.iter().map(|corners| corners.map(|v| v as u32).to_vec()).collect()
}

/// Triangles between points of a grid.
#[derive(Debug, Default)]
struct GridTriangles {
    grid: Vec<IVec3>,
    known: HashMap<IVec3, usize>,
    triangles: Vec<[usize; 3]>,
}

impl GridTriangles {
    fn vertex(&mut self, at: IVec3) -> usize {
        *self.known.entry(at).or_insert_with(|| {
            self.grid.push(at);
            self.grid.len() - 1
        })
    }

    fn triangle(&mut self, [a, b, c]: [usize; 3], turned: bool) {
        self.triangles.push(if turned { [a, c, b] } else { [a, b, c] });
    }

    fn neighbours(&self) -> Vec<Vec<usize>> {
        let mut all = vec![Vec::new(); self.grid.len()];
        // Each edge is in two triangles, once in each direction.
        for [a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                all[*from].push(*to);
            }
        }
        all
    }
}

/// The surface `|x| + |y| + |z| = n`, with a vertex at each point of the grid.
struct Octahedron {
    n: i32,
    mesh: GridTriangles,
    /// Index of each triangle by the point of the grid where it begins: see [`Octahedron::place`].
    by_place: Vec<usize>,
}

/// Corners of the triangle that begins at a point of the grid, in two coordinates.
fn corners(i: i32, j: i32, upright: bool) -> [(i32, i32); 3] {
    if upright { [(i, j), (i + 1, j), (i, j + 1)] } else { [(i + 1, j + 1), (i, j + 1), (i + 1, j)] }
}

/// Whether a counter-clockwise triangle of the first octant is clockwise in this one.
fn is_mirrored(octant: u8) -> bool {
    octant.count_ones() % 2 == 1
}

/// A point as seen from the centre.
#[derive(Debug, Clone, Copy)]
struct CentredPoint {
    /// Triangle in front of the point.
    triangle: usize,
    /// Barycentric coordinates of the point in the triangle.
    share: DVec3,
    /// Distance from the centre, in the octahedron's norm: 1 on the octahedron.
    size: f64,
}

impl Octahedron {
    /// Octahedron of about so many vertices.
    fn with_about(vertices: usize) -> Self {
        // An octahedron has 4 n² + 2 vertices.
        Self::new(((vertices.saturating_sub(2) as f64 / 4.0).sqrt().round() as i32).max(1))
    }

    fn new(n: i32) -> Self {
        let mut this = Self { n, mesh: GridTriangles::default(), by_place: Vec::new() };
        this.by_place.resize(16 * (n * n) as usize, usize::MAX);
        for octant in 0..8_u8 {
            let sign = |bit: u8| if octant >> bit & 1 == 0 { 1 } else { -1 };
            let signs = IVec3::new(sign(0), sign(1), sign(2));
            for i in 0..n {
                for j in 0..n - i {
                    for upright in [true, false].into_iter().filter(|upright| *upright || i + j < n - 1) {
                        let corners = corners(i, j, upright)
                            .map(|(i, j)| this.mesh.vertex(signs * IVec3::new(i, j, n - i - j)));
                        let place = this.place(octant, i, j, upright);
                        this.by_place[place] = this.mesh.triangles.len();
                        this.mesh.triangle(corners, is_mirrored(octant));
                    }
                }
            }
        }
        this
    }

    /// Place of a triangle in the table.
    fn place(&self, octant: u8, i: i32, j: i32, upright: bool) -> usize {
        (((i32::from(octant) * self.n + i) * self.n + j) * 2 + i32::from(upright)) as usize
    }

    /// The triangle in front of a point; nothing for the centre.
    fn locate(&self, p: DVec3) -> Option<CentredPoint> {
        let size = p.abs().element_sum() / f64::from(self.n);
        if size == 0.0 {
            return None;
        }
        let octant: u8 = p.to_array().iter().enumerate().map(|(bit, x)| u8::from(*x < 0.0) << bit).sum();
        let at = p.abs() / size;
        let i = (at.x as i32).min(self.n - 1);
        let j = (at.y as i32).min(self.n - 1 - i);
        let (x, y) = (at.x - f64::from(i), at.y - f64::from(j));
        let upright = x + y <= 1.0 || i + j == self.n - 1;
        let [a, b, c] = if upright { [1.0 - x - y, x, y] } else { [x + y - 1.0, 1.0 - x, 1.0 - y] };
        let share = if is_mirrored(octant) { DVec3::new(a, c, b) } else { DVec3::new(a, b, c) };
        Some(CentredPoint { triangle: self.by_place[self.place(octant, i, j, upright)], share, size })
    }

    /// Greatest sum `Σ s β_k x_k` of any sample in each vertex' triangles; 0 where there is none.
    fn limits(&self, x: &[f64], samples: impl Iterator<Item = CentredPoint>) -> Vec<f64> {
        let mut of_triangles = vec![0.0_f64; self.mesh.triangles.len()];
        for CentredPoint { triangle, share, size } in samples {
            let [a, b, c] = self.mesh.triangles[triangle];
            let most = &mut of_triangles[triangle];
            *most = most.max(size * share.dot(DVec3::new(x[a], x[b], x[c])));
        }
        let mut limits = vec![0.0_f64; x.len()];
        for (corners, limit) in self.mesh.triangles.iter().zip(of_triangles) {
            corners.iter().for_each(|v| limits[*v] = limits[*v].max(limit));
        }
        limits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mean_value::SeenCage;
    use proptest::prelude::*;

    fn bounds(samples: &[[f32; 3]]) -> Bounds {
        let fold = |f: fn(f64, f64) -> f64, start: f64| {
            std::array::from_fn(|a| samples.iter().map(|p| f64::from(p[a])).fold(start, f))
        };
        Bounds { min: fold(f64::min, f64::INFINITY), max: fold(f64::max, f64::NEG_INFINITY) }
    }

    /// Whether all samples are inside, by a margin to all triangles' planes that lie in front of them.
    fn holds(cage: &Cage, samples: &[[f32; 3]]) -> bool {
        let mut weights = vec![0.0; cage.vertices.len()];
        let mut view = SeenCage::default();
        samples.iter().all(|p| !cage.coordinates(DVec3::from(p.map(f64::from)), &mut view, &mut weights))
    }

    /// A vase: narrow at the middle, open below.
    fn vase(n: usize) -> Vec<[f32; 3]> {
        let at = |i: usize| {
            let (t, angle) = (i as f32 / n as f32, i as f32 * 2.4);
            let radius = 0.25 + 0.12 * (9.0 * t).sin();
            [radius * angle.cos() + 3.0, 2.0 * t, radius * angle.sin() - 1.0]
        };
        (0..n).map(at).collect()
    }

    #[test]
    fn made_cages_hold_all_samples_and_are_as_large_as_asked() {
        let samples = vase(5000);
        let bounds = bounds(&samples);
        for (detail, of_hull) in [(6, 6), (20, 18), (40, 38), (100, 102), (400, 402)] {
            for margin in [1e-3, 0.1] {
                let cage = hull(&bounds, &samples, margin, detail).unwrap();
                assert_eq!((cage.vertices.len(), &cage.faces), (of_hull, &hull_faces(detail)));
                assert!(holds(&cage, &samples), "{detail} {margin}");
                let cage = divided_box(&bounds, &samples, margin, detail).unwrap();
                let many = cage.vertices.len();
                assert!(many.abs_diff(detail.max(8)) <= 2 + detail / 4, "{detail} {many}");
                assert!(holds(&cage, &samples));
            }
        }
    }

    #[test]
    fn finer_hulls_are_tighter() {
        let samples = vase(20_000);
        let volume = |detail| {
            let cage = hull(&bounds(&samples), &samples, 0.01, detail).unwrap();
            let of = |t: &crate::mesh::CageTriangle| {
                let [a, b, c] = t.corners.map(|v| cage.vertices[v] - cage.centre);
                a.cross(b).dot(c) / 6.0
            };
            cage.triangles.iter().map(of).sum::<f64>()
        };
        let volumes = [6, 38, 146, 402].map(volume);
        assert!(volumes.is_sorted_by(|a, b| a > b), "{volumes:?}");
        // The volume of the surface itself is about 0.4, with the margin 0.47.
        assert!(volumes[3] < 0.7, "{volumes:?}");
    }

    #[test]
    fn cages_are_symmetric_where_the_samples_are() {
        let half = vase(2000).into_iter().map(|p| [p[0] - 3.0, p[1] - 1.0, p[2] + 1.0]);
        let samples: Vec<[f32; 3]> = half.flat_map(|p| [p, [-p[0], p[1], p[2]]]).collect();
        for cage in [
            hull(&bounds(&samples), &samples, 0.05, 66).unwrap(),
            divided_box(&bounds(&samples), &samples, 0.05, 66).unwrap(),
        ] {
            for p in &cage.vertices {
                let mirrored = DVec3::new(-p.x, p.y, p.z);
                assert!(cage.vertices.iter().any(|q| q.distance(mirrored) < 1e-6), "{p}");
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_the_samples_they_are_inside(
            samples in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f32), 1..40),
            flat in prop::array::uniform3(prop::bool::ANY),
            detail in 6..120_usize,
        ) {
            let flatten = |p: &[f32; 3]| std::array::from_fn(|a| if flat[a] { 0.3 } else { p[a] });
            let samples: Vec<[f32; 3]> = samples.iter().map(flatten).collect();
            for cage in [
                hull(&bounds(&samples), &samples, 0.02, detail).unwrap(),
                divided_box(&bounds(&samples), &samples, 0.02, detail).unwrap(),
            ] {
                prop_assert!(holds(&cage, &samples));
            }
        }
    }
}
