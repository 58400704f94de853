//! Mean value coordinates of a closed triangle mesh.
//!
//! T. Ju, S. Schaefer, J. Warren, *Mean value coordinates for closed triangular meshes*, SIGGRAPH 2005. The
//! share of each triangle is the integral of its corners' hat functions over its picture on the unit sphere
//! about the point, by the *mean vector* of that picture (section 3.1 there). In double precision.

use crate::mesh::Cage;
use glam::DVec3;
use pulp::{Simd, WithSimd};
use std::f64::consts::PI;

/// Distance to a vertex below which a point is that vertex, in radii of the cage.
const AT_VERTEX: f64 = 1e-12;
/// Sine of the angle at which an edge is seen below which, if the angle is wide, the point lies on the
/// edge.
const ON_EDGE: f64 = 1e-7;
/// Factor of the least volume of a triangle's picture with the point: where the volume is smaller than this
/// factor times the square root of the shortest edge (as a sine) of the picture, the point lies on the
/// triangle, or in its plane beside it. The share of such a triangle is in proportion to the volume by the
/// edge, and its rounding to 1e-16 by the volume: here both are alike.
const IN_PLANE: f64 = 1e-8;
/// Distance from the centre, in radii of the cage, from which on points have the coordinates of those at
/// that distance: farther away, triangles that face each other cancel, until nothing is left but rounding.
const FAR: f64 = 100.0;

/// Distance, in radii of the cage, within which coordinates have to give a point back, to be left as they
/// are.
const GIVEN_BACK: f64 = 1e-11;

/// Vertices and edges as seen from a point; memory to keep from point to point.
#[derive(Debug, Default)]
pub struct SeenCage {
    /// Unit vectors to the vertices.
    directions: Vec<DVec3>,
    /// One over the distances of the vertices.
    near: Vec<f64>,
    /// The cross product, for each edge, of the directions of both ends.
    normals: Vec<DVec3>,
    /// Ratio of each edge's angle to the angle's sine; infinite for a half turn.
    ratios: Vec<f64>,
}

impl Cage {
    /// Writes the coordinates of a point, one for each vertex: they sum to 1, and `Σ λ_i p_i` is the point,
    /// inside and outside. Returns whether the point lies outside.
    pub fn coordinates(&self, x: DVec3, view: &mut SeenCage, out: &mut [f64]) -> bool {
        let from_centre = x - self.centre;
        let shorter = FAR * self.radius / from_centre.length();
        let x = if shorter < 1.0 { self.centre + shorter * from_centre } else { x };

        view.directions.clear();
        view.near.clear();
        for (v, p) in self.vertices.iter().enumerate() {
            let distance = p.distance(x);
            if distance <= AT_VERTEX * self.radius {
                out.fill(0.0);
                out[v] = 1.0;
                return false;
            }
            view.directions.push((*p - x) / distance);
            view.near.push(distance.recip());
        }
        view.see_edges(&self.edges);

        out.fill(0.0);
        for triangle in &self.triangles {
            // The picture's edges, inward if the triangle is seen from inside.
            let normals = triangle.edges.map(|(e, sign)| sign * view.normals[e]);
            let ratios = triangle.edges.map(|(e, _)| view.ratios[e]);
            let volume = view.directions[triangle.corners[0]].dot(normals[0]);
            let shortest = normals.iter().fold(1.0, |shortest: f64, n| shortest.min(n.length_squared()));
            let is_in_plane = (volume * volume) * (volume * volume) < IN_PLANE.powi(4) * shortest;
            if ratios.contains(&f64::INFINITY) || (is_in_plane && is_over(normals, ratios)) {
                Self::on_face(triangle.corners, view, normals, out);
                return false;
            }
            if is_in_plane {
                continue;
            }
            let mean = ratios[0] * normals[0] + ratios[1] * normals[1] + ratios[2] * normals[2];
            let scale = 0.5 / volume;
            for (v, normal) in triangle.corners.into_iter().zip(normals) {
                out[v] += scale * view.near[v] * normal.dot(mean);
            }
        }
        let total: f64 = out.iter().sum();
        out.iter_mut().for_each(|w| *w /= total);
        self.give_back(x, out);
        total < 0.0
    }

    /// Corrects coordinates that sum to 1 by the least change (in the sum of squares) by which `Σ λ_i p_i`
    /// is the point. A correction is needed close to the plane of a triangle, above all far away, where the
    /// triangles' shares cancel.
    fn give_back(&self, x: DVec3, out: &mut [f64]) {
        let mean: DVec3 = out.iter().zip(&self.vertices).map(|(w, p)| *w * (*p - self.mean)).sum();
        let off = x - self.mean - mean;
        if off.length() > GIVEN_BACK * self.radius {
            let along = self.scatter_inverse * off;
            out.iter_mut().zip(&self.vertices).for_each(|(w, p)| *w += along.dot(*p - self.mean));
        }
    }

    /// The barycentric coordinates of a point on a triangle: each vertex' is the area of the triangle of the
    /// point and the edge opposite to it.
    fn on_face(corners: [usize; 3], view: &SeenCage, normals: [DVec3; 3], out: &mut [f64]) {
        out.fill(0.0);
        // Areas are divided by the product of the three distances.
        let areas: [f64; 3] = std::array::from_fn(|i| normals[i].length() * view.near[corners[i]]);
        let total: f64 = areas.iter().sum();
        corners.into_iter().zip(areas).for_each(|(v, area)| out[v] = area / total);
    }
}

/// Whether a point in a triangle's plane lies on the triangle: then the angles of the edges sum to a full
/// turn, and else one is the sum of the others.
fn is_over(normals: [DVec3; 3], ratios: [f64; 3]) -> bool {
    let [a, b, c] = std::array::from_fn(|i| ratios[i] * normals[i].length());
    let (widest, half) = (a.max(b).max(c), 0.5 * (a + b + c));
    PI - half < half - widest
}

impl SeenCage {
    /// Computes the cross products and ratios of the edges between the directions. This takes most of the
    /// time: an arctangent for each edge would take three times as long as [`RATIO`].
    fn see_edges(&mut self, edges: &[[usize; 2]]) {
        let Self { directions, normals, ratios, .. } = self;
        normals.clear();
        ratios.clear();
        for [a, b] in edges {
            let (a, b) = (directions[*a], directions[*b]);
            normals.push(a.cross(b));
            ratios.push(a.dot(b));
        }
        pulp::Arch::new().dispatch(Ratios(ratios));
        for ([a, b], (ratio, normal)) in edges.iter().zip(ratios.iter_mut().zip(&*normals)) {
            if directions[*a].dot(directions[*b]) < 0.0 {
                // The edge's supplement to a half turn was looked up.
                let sine = normal.length();
                *ratio = if sine < ON_EDGE { f64::INFINITY } else { PI / sine - *ratio };
            }
        }
    }
}

/// Ratios of angles to their sines, for cosines from 0 to 1: coefficients of powers of twice the cosine
/// less 1, interpolated in Chebyshev's points, to 2e-16.
const RATIO: [f64; 21] = [
    1.2091995761561452,
    -0.2636001412812842,
    0.06973319205204817,
    -0.0198371469225361,
    0.005861628974916285,
    -0.0017729284598670242,
    0.000544773988660799,
    -0.0001693099597410185,
    5.307369977099968e-05,
    -1.6749075819869722e-05,
    5.314300137765282e-06,
    -1.693860323878943e-06,
    5.418287002530394e-07,
    -1.7343078169085141e-07,
    5.579896370054702e-08,
    -1.8554844983920357e-08,
    5.99775844099466e-09,
    -1.497309269587466e-09,
    4.847870212537191e-10,
    -3.5494026622357296e-10,
    1.155596335517553e-10,
];

/// Turns cosines into ratios, those below 0 as if they were above.
struct Ratios<'a>(&'a mut [f64]);

impl WithSimd for Ratios<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (whole, rest) = S::as_mut_simd_f64s(self.0);
        for lanes in whole {
            *lanes = ratio(simd, *lanes);
        }
        if !rest.is_empty() {
            simd.partial_store_f64s(rest, ratio(simd, simd.partial_load_f64s(rest)));
        }
    }
}

/// Value of a polynomial, by Horner's rule.
#[inline(always)]
fn ratio<S: Simd>(simd: S, cosines: S::f64s) -> S::f64s {
    let x = simd.mul_add_f64s(simd.splat_f64s(2.0), simd.abs_f64s(cosines), simd.splat_f64s(-1.0));
    let mut sum = simd.splat_f64s(0.0);
    for coefficient in RATIO.into_iter().rev() {
        sum = simd.mul_add_f64s(sum, x, simd.splat_f64s(coefficient));
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::path::Path;

    fn reference(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference").join(name)
    }

    /// A cage with dents.
    fn dented() -> Cage {
        Cage::read(&reference("cage.obj"), |p| p).unwrap()
    }

    fn octahedron() -> Cage {
        let vertices = [DVec3::X, DVec3::Y, DVec3::Z].iter().flat_map(|a| [*a, -*a]).collect();
        let triangles =
            [0, 1].iter().flat_map(|x| [2, 3].iter().flat_map(move |y| [4, 5].map(|z| (*x, *y, z))));
        let out = |(x, y, z)| if (x + y + z) % 2 == 0 { [x, y, z] } else { [y, x, z] };
        Cage::new(vertices, triangles.map(out).collect()).unwrap()
    }

    fn coordinates_at(cage: &Cage, x: DVec3) -> (Vec<f64>, bool) {
        let mut out = vec![f64::NAN; cage.vertices.len()];
        let outside = cage.coordinates(x, &mut SeenCage::default(), &mut out);
        (out, outside)
    }

    /// Distance of a point from the one that its coordinates give back, or their sum's from 1.
    fn miss(cage: &Cage, x: DVec3) -> f64 {
        let (weights, _) = coordinates_at(cage, x);
        let sum: f64 = weights.iter().sum();
        let mean: DVec3 = weights.iter().zip(&cage.vertices).map(|(w, p)| *w * *p).sum();
        (sum - 1.0).abs().max(mean.distance(x))
    }

    /// The expected numbers are explained in `tests/reference/cage.py`.
    #[test]
    fn coordinates_are_those_of_the_reference() {
        let cage = dented();
        let text = std::fs::read_to_string(reference("cage.csv")).unwrap();
        let (mut points, mut outside) = (0, 0);
        for line in text.lines().filter(|l| !l.starts_with('#')) {
            let numbers: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
            let (x, expected) = numbers.split_at(3);
            let (weights, is_outside) = coordinates_at(&cage, DVec3::from_slice(x));
            let worst = weights.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(weights.len() == expected.len() && worst < 1e-9, "{x:?}: {worst}");
            points += 1;
            outside += usize::from(is_outside);
        }
        assert!(points == 60 && (5..55).contains(&outside), "{points} {outside}");
    }

    proptest! {
        #[test]
        fn points_come_back(x in prop::array::uniform3(-2.0..2.0_f64)) {
            for cage in [dented(), octahedron()] {
                prop_assert!(miss(&cage, x.into()) < 1e-10);
            }
        }

        #[test]
        fn inside_of_a_convex_cage_all_are_positive(x in prop::array::uniform3(-1.0..1.0_f64)) {
            let x = DVec3::from(x);
            let size = x.abs().element_sum();
            let (weights, outside) = coordinates_at(&octahedron(), x);
            prop_assert_eq!(outside, size > 1.0);
            prop_assert!(size > 1.0 || weights.iter().all(|w| *w > 0.0));
        }

        /// Points as near to a vertex, an edge, a face or the plane of one as can be have the right
        /// coordinates, without a step but for rounding, which is most where triangles are seen as lines.
        #[test]
        fn the_surface_is_no_exception(
            triangle in 0..72_usize, u in 0.0..1.0_f64, v in 0.0..1.0_f64, kind in 0..4,
            nearness in 1.0..17.0_f64, toward in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let cage = dented();
            let [a, b, c] = cage.triangles[triangle].corners.map(|v| cage.vertices[v]);
            let on = match kind {
                0 => a,
                1 => a.lerp(b, u),
                2 => a.lerp(b, u).lerp(c, v),
                // In its plane, beside it.
                _ => a + (1.0 + u) * (b - a) + v * (c - a),
            };
            let x = on + 10_f64.powf(-nearness) * DVec3::from(toward);
            prop_assert!(miss(&cage, x) < 1e-6, "{x} {}", miss(&cage, x));
            let (near, _) = coordinates_at(&cage, on);
            let (weights, _) = coordinates_at(&cage, x);
            let worst = near.iter().zip(&weights).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let rounding = IN_PLANE / ON_EDGE.sqrt();
            prop_assert!(worst < rounding + 30.0 * 10_f64.powf(-nearness), "{worst} at 1e-{nearness}");
        }

        #[test]
        fn far_away_they_still_are_good(x in prop::array::uniform3(-1.0..1.0_f64), far in 0.0..2.0_f64) {
            let cage = dented();
            let x = cage.centre + 0.999 * 10_f64.powf(far) * cage.radius * DVec3::from(x).clamp_length_max(1.0);
            prop_assert!(miss(&cage, x) < 1e-6, "{}", miss(&cage, x));
        }
    }

    #[test]
    fn vertices_edges_and_faces_have_their_own() {
        let cage = dented();
        for triangle in &cage.triangles {
            let [a, b, c] = triangle.corners;
            for (x, y, z) in [(1.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.0, 0.3, 0.7), (0.2, 0.3, 0.5)] {
                let p = x * cage.vertices[a] + y * cage.vertices[b] + z * cage.vertices[c];
                let (weights, _) = coordinates_at(&cage, p);
                assert!([(a, x), (b, y), (c, z)].iter().all(|(v, w)| (weights[*v] - w).abs() < 1e-7));
                assert!((weights.iter().map(|w| w.abs()).sum::<f64>() - 1.0).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn ratios_are_those_of_angles_and_their_sines() {
        let angles =
            (1..3000).map(|i| f64::from(i) * 1e-3).chain([1e-9, 1e-300]).map(|a| a.min(PI - 2.0 * ON_EDGE));
        for angle in angles.chain([PI - 1e-4, PI - 1e-6]) {
            let directions = vec![DVec3::X, DVec3::new(angle.cos(), angle.sin(), 0.0)];
            let mut view = SeenCage { directions, ..SeenCage::default() };
            view.see_edges(&[[0, 1]]);
            let exact = angle / angle.sin();
            assert!(
                (view.ratios[0] / exact - 1.0).abs() < 1e-6_f64.min(1e-15 + 1e-15 / (PI - angle)),
                "{angle}"
            );
        }
    }

    #[test]
    fn endlessly_far_they_are_finite() {
        for x in [DVec3::X * 1e6, DVec3::splat(-1e300), DVec3::Y * 3e38] {
            assert!(coordinates_at(&dented(), x).0.iter().all(|w| w.is_finite() && w.abs() < 1e4));
        }
    }
}
