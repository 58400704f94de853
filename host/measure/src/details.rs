//! Rotation of the small details of a surface against the smooth surface beneath them.
//!
//! M. Botsch, O. Sorkine, *On linear variational surface deformation methods*, IEEE TVCG 2008, judge methods
//! by whether details turn along with the surface. As a figure: the mesh is smoothed by weights that are
//! those of its rest pose, before and after: p becomes S p. The detail of a vertex is d = (1 − S)² p, its way
//! from the smooth surface without that which smoothing moves a surface just for being curved; and d′ after.
//! Where the smooth surface turns by R, the detail turns by the angle between R d and d′. That is 0 for each
//! rigid motion and each scale; a detail that keeps its direction while the surface beneath tilts turns by
//! the tilt.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::Serialize;
use simod_geometry::{outer, polar_rotation};

use super::triangle::{corners, cross, key, pair, sides, sorted};

/// A mesh at rest with its smooth surface, to compare deformed ones with.
pub struct Details<'a> {
    rest: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    /// Index of each vertex' first neighbour, and (`neighbours`) the neighbours of all vertices.
    first: Vec<u32>,
    neighbours: Vec<u32>,
    /// Walks of the steps that smooth once, and of twice as many.
    walks: [SmoothingSteps; 2],
    smooth: Vec<DVec3>,
    /// Normals of the smooth surface.
    normals: Vec<DVec3>,
    details: Vec<DVec3>,
}

/// A smooth surface, and the details on it, vertex by vertex.
type Split = (Vec<DVec3>, Vec<DVec3>);

/// The turning of details.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DetailRotation {
    /// Degrees: root of the mean square over all vertices, weighted by the squared lengths of the details at
    /// rest.
    pub rms: f64,
    /// Triangles that turn by more than a right angle against the smooth surface beneath: folded over, or
    /// inside out.
    pub folded: usize,
}

impl<'a> Details<'a> {
    /// Details are the parts of a surface that are smaller than `radius`, the standard deviation of the
    /// smoothing, in the positions' unit: at 0 there are none. It takes about 17 radius / edge steps over the
    /// mesh.
    pub fn new(rest: &'a [DVec3], triangles: &'a [[u32; 3]], radius: f64) -> Self {
        let valid = triangles.iter().filter(|t| corners(rest, **t).is_some());
        let mut sides = sorted(sides(valid.copied()));
        sides.dedup();
        // A border is smoothed along itself, so that it does not shrink.
        let is_border = |[a, b]: &[u32; 2]| sides.binary_search(&key([*b, *a])).is_err();
        let sides = || sides.iter().map(|side| pair(*side));
        let mut on_border = vec![false; rest.len()];
        sides().filter(is_border).flatten().for_each(|i| on_border[i as usize] = true);
        let (on_border, is_border) = (&on_border, &is_border);
        let both_ways = |side: [u32; 2]| {
            let ([a, b], along) = (side, is_border(&side));
            [[a, b], [b, a]].into_iter().filter(move |[from, _]| along || !on_border[*from as usize])
        };
        let mut edges = sorted(sides().flat_map(both_ways).filter(|[a, b]| a != b));
        edges.dedup();
        // Index of each vertex' first neighbour: the numbers of neighbours, added up.
        let mut first = vec![0; rest.len() + 1];
        edges.iter().for_each(|edge| first[pair(*edge)[0] as usize + 1] += 1);
        (1..first.len()).for_each(|i| first[i] += first[i - 1]);
        let length_2 = |[a, b]: [u32; 2]| rest[a as usize].distance_squared(rest[b as usize]);
        let squares: f64 = edges.iter().map(|edge| length_2(pair(*edge))).sum();
        // Each step is a walk along an edge or none, with the same chance: a variance of a quarter of its
        // length's square in each direction of the surface.
        let variance = 0.25 * squares / edges.len().max(1) as f64;
        let steps = if variance > 0.0 { (radius * radius / variance).ceil().min(1e5) as u32 } else { 0 };
        let neighbours = edges.into_iter().map(|edge| pair(edge)[1]).collect();
        let walks = [steps, 2 * steps].map(SmoothingSteps::new);
        let (smooth, normals, details) = (Vec::new(), Vec::new(), Vec::new());
        let mut own = Self { rest, triangles, first, neighbours, walks, smooth, normals, details };
        let [split] = own.split([rest]);
        (own.smooth, own.details) = split;
        own.normals = own.vertex_normals(&own.smooth);
        own
    }

    /// Compares with the same vertices elsewhere.
    ///
    /// # Panics
    /// There are not as many.
    pub fn rotation(&self, deformed: &[DVec3]) -> DetailRotation {
        let [split] = self.split([deformed]);
        self.compare(deformed, &split)
    }

    /// Compares with the same vertices in several shapes: quicker than one after the other.
    ///
    /// Memory: 220 bytes for each vertex and each of up to four shapes at a time.
    ///
    /// # Panics
    /// There are not as many vertices in one of them.
    pub fn rotations(&self, deformed: &[&[DVec3]]) -> Vec<DetailRotation> {
        let mut all = Vec::with_capacity(deformed.len());
        let mut add = |some: &[&[DVec3]], splits: &[Split]| {
            let each = some.par_iter().zip(splits).map(|(deformed, split)| self.compare(deformed, split));
            all.extend(each.collect::<Vec<_>>());
        };
        for some in deformed.chunks(4) {
            match *some {
                [a, b, c, d] => add(some, &self.split([a, b, c, d])),
                [a, b, c] => add(some, &self.split([a, b, c])),
                [a, b] => add(some, &self.split([a, b])),
                _ => some.iter().for_each(|a| add(&[a], &self.split([*a]))),
            }
        }
        all
    }

    fn compare(&self, deformed: &[DVec3], (smooth, details): &Split) -> DetailRotation {
        let normals = self.vertex_normals(smooth);
        let turns: Vec<Option<DMat3>> = (0..self.rest.len())
            .into_par_iter()
            .map(|i| self.turn(i, smooth, self.normals[i], normals[i]))
            .collect();
        let (mut sum, mut weights) = (0.0, 0.0);
        for (i, turn) in turns.iter().enumerate() {
            let Some(turn) = turn else { continue };
            let (rest, detail) = (self.details[i], details[i]);
            let turned = *turn * rest;
            let angle = turned.cross(detail).length().atan2(turned.dot(detail)).to_degrees();
            sum += rest.length_squared() * angle * angle;
            weights += rest.length_squared();
        }
        let is_folded = |t: &&[u32; 3]| {
            let (Some(rest), Some(after)) = (corners(self.rest, **t), corners(deformed, **t)) else {
                return false;
            };
            let turned = t
                .iter()
                .filter_map(|i| turns[*i as usize])
                .fold(DVec3::ZERO, |sum, turn| sum + turn * cross(rest));
            turned.dot(cross(after)) < 0.0
        };
        DetailRotation {
            rms: if weights > 0.0 { (sum / weights).sqrt() } else { 0.0 },
            folded: self.triangles.iter().filter(is_folded).count(),
        }
    }

    fn around(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.first[vertex] as usize..self.first[vertex + 1] as usize]
    }

    /// The smooth surfaces of some shapes, and the details.
    fn split<const N: usize>(&self, shapes: [&[DVec3]; N]) -> [Split; N] {
        for shape in shapes {
            assert_eq!(self.rest.len(), shape.len(), "one position for each vertex");
        }
        let all = (0..self.rest.len()).map(|i| shapes.map(|shape| shape[i])).collect();
        let [smooth, smoother] = self.smoothed(all);
        std::array::from_fn(|n| {
            let detail = |i: usize| shapes[n][i] - 2.0 * smooth[i][n] + smoother[i][n];
            (smooth.iter().map(|p| p[n]).collect(), (0..smooth.len()).map(detail).collect())
        })
    }

    /// Several shapes at once after the steps of both walks, of which each takes a vertex half way to the
    /// mean of its neighbours: their places are side by side, so that neighbours are looked up once for all.
    fn smoothed<const N: usize>(&self, shapes: Vec<[DVec3; N]>) -> [Vec<[DVec3; N]>; 2] {
        let [once, twice] = &self.walks;
        // T₀ p and T₁ p, where T are Chebyshev's polynomials of the means; then each two that follow each
        // other.
        let (mut before, mut now) = (shapes.clone(), shapes);
        let mut sums = [once, twice].map(|walk| before.iter().map(|p| scaled(p, walk.shares[0])).collect());
        for k in 1..twice.shares.len() {
            let shares = [once, twice].map(|walk| walk.shares.get(k).copied().unwrap_or(0.0));
            let by = if k == 1 { 1.0 } else { 2.0 };
            let [smooth, smoother]: &mut [Vec<[DVec3; N]>; 2] = &mut sums;
            let rows = before.par_iter_mut().zip(smooth).zip(smoother).enumerate().with_min_len(1 << 10);
            rows.for_each(|(i, ((next, smooth), smoother))| {
                let mean = self.mean(i, &now);
                for n in 0..N {
                    next[n] = by * mean[n] - (by - 1.0) * next[n];
                    smooth[n] += shares[0] * next[n];
                    smoother[n] += shares[1] * next[n];
                }
            });
            std::mem::swap(&mut before, &mut now);
        }
        sums
    }

    /// The mean of a vertex' neighbours; itself where there are none.
    #[inline]
    fn mean<const N: usize>(&self, vertex: usize, shapes: &[[DVec3; N]]) -> [DVec3; N] {
        let around = self.around(vertex);
        if around.is_empty() {
            return shapes[vertex];
        }
        let mut sum = [DVec3::ZERO; N];
        for j in around {
            let other = &shapes[*j as usize];
            (0..N).for_each(|n| sum[n] += other[n]);
        }
        scaled(&sum, 1.0 / around.len() as f64)
    }

    /// Unit normals of vertices: of the sum of their triangles'. Zero where there is none, or nothing is left
    /// of the sum but rounding, as where triangles lie on each other, back to back.
    fn vertex_normals(&self, positions: &[DVec3]) -> Vec<DVec3> {
        const ROUNDING: f64 = 1e-9;
        let mut sums = vec![(DVec3::ZERO, 0.0); positions.len()];
        for triangle in self.triangles {
            if let Some(corners) = corners(positions, *triangle) {
                let normal = cross(corners);
                let length = normal.length();
                for i in triangle {
                    let (sum, all) = &mut sums[*i as usize];
                    (*sum, *all) = (*sum + normal, *all + length);
                }
            }
        }
        let unit = |(sum, all): (DVec3, f64)| {
            if sum.length() > ROUNDING * all { sum.normalize_or_zero() } else { DVec3::ZERO }
        };
        sums.into_iter().map(unit).collect()
    }

    /// The rotation of the smooth surface about a vertex: that which takes the edges and the normal at rest
    /// nearest to those deformed, by least squares.
    fn turn(&self, vertex: usize, smooth: &[DVec3], rest_normal: DVec3, normal: DVec3) -> Option<DMat3> {
        let (mut covariance, mut size) = (DMat3::ZERO, 0.0);
        for j in self.around(vertex) {
            let rest = self.smooth[*j as usize] - self.smooth[vertex];
            let edge = smooth[*j as usize] - smooth[vertex];
            covariance += outer(edge, rest);
            size += edge.length() * rest.length();
        }
        covariance += outer(normal, rest_normal) * (0.5 * size);
        rotation_of(covariance * (1.0 / size))
    }
}

/// n steps of smoothing, each of them half way to the mean W of the neighbours, as a sum of Chebyshev's
/// polynomials: ((1 + W) / 2)ⁿ = Σ cₖ Tₖ(W). With W = cos t that is cos²ⁿ(t / 2), whose shares cₖ are those
/// of the paths of a walk with 2 n halves of a step that end k steps off. Nearly all paths end within a few
/// √n steps, so that as many polynomials are as good as n steps, and the rest is less than rounding.
struct SmoothingSteps {
    shares: Vec<f64>,
}

impl SmoothingSteps {
    /// Share of the whole below which a polynomial is left out.
    const LEAST: f64 = 1e-19;

    fn new(steps: u32) -> Self {
        let n = f64::from(steps);
        // The share of the middle, 2 n over n paths of 2²ⁿ; those of the places further off follow from the
        // ones before them.
        let mut share = (1..=steps).map(|i| 1.0 - 0.5 / f64::from(i)).product::<f64>();
        let mut shares = vec![share];
        for k in (1..=steps).map(f64::from) {
            share *= (n - k + 1.0) / (n + k);
            if share < Self::LEAST {
                break;
            }
            // To either side.
            shares.push(2.0 * share);
        }
        let all: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= all);
        Self { shares }
    }
}

fn scaled<const N: usize>(places: &[DVec3; N], by: f64) -> [DVec3; N] {
    places.map(|p| p * by)
}

/// The rotation of a polar decomposition. None where the matrix has no rotation of its own: singular, or a
/// mirror image.
fn rotation_of(matrix: DMat3) -> Option<DMat3> {
    const STEPS: usize = 40;
    (matrix.is_finite() && matrix.determinant() > 1e-9).then(|| polar_rotation(matrix, STEPS, 1e-14))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A square of side 2 with bumps, in so many steps.
    fn bumpy(steps: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let on = |i: u32| 2.0 * f64::from(i) / f64::from(steps) - 1.0;
        let height = |x: f64, z: f64| 0.02 * (30.0 * x).sin() * (30.0 * z).sin();
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for (i, k) in (0..=steps).flat_map(|i| (0..=steps).map(move |k| (i, k))) {
            vertices.push(DVec3::new(on(i), height(on(i), on(k)), on(k)));
            if i < steps && k < steps {
                let a = i * (steps + 1) + k;
                let (b, c, d) = (a + 1, a + steps + 1, a + steps + 2);
                triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
        (vertices, triangles)
    }

    #[test]
    fn a_similarity_turns_no_detail() {
        let (rest, triangles) = bumpy(40);
        let details = Details::new(&rest, &triangles, 0.1);
        for (angle, scale) in [(0.0, 1.0), (3.0, 1.0), (1.0, 0.4), (2.0, 5.0)] {
            let turn = DQuat::from_axis_angle(DVec3::new(0.48, 0.6, 0.64), angle);
            let moved: Vec<_> = rest.iter().map(|p| turn * *p * scale + DVec3::Y).collect();
            let DetailRotation { rms, folded } = details.rotation(&moved);
            assert!(rms < 1e-5 && folded == 0, "{rms}, {folded} folded");
        }
    }

    #[test]
    fn details_that_keep_their_direction_turn_by_the_tilt() {
        let (rest, triangles) = bumpy(100);
        let details = Details::new(&rest, &triangles, 0.1);
        for degrees in [10f64, 30.0, 60.0] {
            let tilt = DQuat::from_rotation_z(degrees.to_radians());
            // The plane is turned, and the bumps stay upright and as they are.
            let upright: Vec<_> = rest.iter().map(|p| tilt * p.with_y(0.0) + DVec3::Y * p.y).collect();
            let rms = details.rotation(&upright).rms;
            assert!((rms / degrees - 1.0).abs() < 0.03, "{rms} instead of {degrees}");
        }
    }

    #[test]
    fn polynomials_smooth_as_step_after_step_does() {
        let (rest, triangles) = bumpy(20);
        // The mesh gets a vertex that no triangle has.
        let rest: Vec<DVec3> = rest.into_iter().chain([DVec3::splat(5.0)]).collect();
        for (radius, about) in [(0.0, 0), (0.04, 1), (0.3, 20), (1.5, 500)] {
            let details = Details::new(&rest, &triangles, radius);
            let edges: Vec<f64> = (0..rest.len())
                .flat_map(|i| details.around(i).iter().map(move |j| (i, *j as usize)))
                .map(|(i, j)| rest[i].distance_squared(rest[j]))
                .collect();
            let mean = edges.iter().sum::<f64>() / edges.len() as f64;
            let steps = (radius * radius / (0.25 * mean)).ceil() as usize;
            assert!(steps >= about, "{steps}");
            let mut smooth: Vec<[DVec3; 1]> = rest.iter().map(|p| [*p]).collect();
            for found in details.smoothed(smooth.clone()) {
                for _ in 0..steps {
                    let mean = |i: usize| [0.5 * (smooth[i][0] + details.mean(i, &smooth)[0])];
                    smooth = (0..smooth.len()).map(mean).collect();
                }
                let worst = smooth.iter().zip(&found).map(|(a, b)| a[0].distance(b[0])).fold(0.0, f64::max);
                assert!(worst < 1e-12, "{steps} steps: {worst}");
            }
        }
    }

    #[test]
    fn several_shapes_at_once_are_as_one_by_one() {
        let (rest, triangles) = bumpy(30);
        let details = Details::new(&rest, &triangles, 0.1);
        let bent =
            |k: i32| rest.iter().map(move |p| *p + DVec3::Y * f64::from(k) * (p.x * p.x + 0.2 * p.z * p.x));
        let shapes: Vec<Vec<DVec3>> = (0..11).map(|k| bent(k).collect()).collect();
        for count in 0..shapes.len() {
            let some: Vec<&[DVec3]> = shapes[..count].iter().map(Vec::as_slice).collect();
            let one_by_one: Vec<DetailRotation> = some.iter().map(|shape| details.rotation(shape)).collect();
            assert_eq!(details.rotations(&some), one_by_one);
        }
    }

    #[test]
    fn a_surface_folded_over_is_told() {
        let (mut rest, triangles) = bumpy(50);
        rest.iter_mut().for_each(|p| p.y = 0.0);
        // A strip of the square is passed backwards: x = 0.1 comes to lie left of x = -0.1.
        let folded: Vec<_> =
            rest.iter().map(|p| if p.x.abs() < 0.12 { p.with_x(-p.x) } else { *p }).collect();
        let rotation = Details::new(&rest, &triangles, 0.3).rotation(&folded);
        // Six columns of quads, of which the two at the strip's borders are folded as well or torn.
        assert!((400..=800).contains(&rotation.folded), "{}", rotation.folded);
    }

    #[test]
    fn triangles_back_to_back_have_no_normal() {
        // Each corner of its own: what is left of the sum of both is rounding.
        let place = |i: u32| [0.7, 1.3, 2.1].map(|f| 3.0 + (f * f64::from(i)).sin());
        let rest: Vec<DVec3> = (0..600).map(|i| DVec3::from_array(place(i))).collect();
        let both = |i: u32| [[i, i + 1, i + 2], [i + 1, i, i + 2]];
        let flaps: Vec<[u32; 3]> = (0..600).step_by(3).flat_map(both).collect();
        let details = Details::new(&rest, &flaps, 0.1);
        assert!(details.vertex_normals(&rest).iter().all(|normal| *normal == DVec3::ZERO));
        let single: Vec<[u32; 3]> = flaps.iter().step_by(2).copied().collect();
        assert!(
            Details::new(&rest, &single, 0.1)
                .vertex_normals(&rest)
                .iter()
                .all(|normal| normal.is_normalized())
        );
    }

    #[test]
    fn rotations_are_those_of_the_polar_decomposition() {
        let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 2.5));
        let stretch = DMat3::from_cols_array(&[2.0, 0.1, 0.2, 0.1, 0.5, 0.0, 0.2, 0.0, 1.0]);
        assert!(rotation_of(turn * stretch).is_some_and(|r| r.abs_diff_eq(turn, 1e-12)));
        assert!(rotation_of(DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))).is_none());
        assert!(rotation_of(DMat3::ZERO).is_none() && rotation_of(DMat3::NAN).is_none());
    }
}
