//! Samples fitted to the vertices of P_L: where faces have placed them, they are moved so that the triangles
//! between them come nearer to all vertices, in the sense of least squares (H. Hoppe et al., *Mesh
//! Optimization*, 1993, section 4.1, who do so for a set of points).
//!
//! For each vertex the nearest point of the triangles around its own sample is found, and the vertex' height
//! over that triangle. With the barycentric coordinates b of that point, the normal n of the triangle and
//! ways w of its corners, the sum of (h − Σ b n·w)² over all vertices shall become small: [`STEPS`] steps of
//! Jacobi's method. As only triangles around a vertex' own sample are looked at, no sheet is drawn to
//! another.

use std::cmp::Ordering;

use glam::{DMat3, DVec3, Mat3, Vec3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::mapped::looked_at;
use simod_model::{Progress, Result};

use super::cluster::symmetric;
use super::kd_tree::PointBox;
use super::placement::Placed;
use crate::lists::lists;

/// Steps of Jacobi's method: more come nearer to the vertices, and move samples farther along the surface.
const STEPS: usize = 5;

/// Factor by which steps are longer: lumped weights are greater than the blocks that they stand for, by less
/// than twice this.
const OVER: f32 = 1.6;

/// Strength of the ridge, relative to the trace of a sample's block: it keeps samples from going along the
/// surface where little tells them where to.
const RIDGE: f64 = 0.1;

/// Number of places of vertices that are looked at for each sample, about, if it has as many: more tell
/// little more.
const ENOUGH: u32 = 24;

/// Largest number of triangles around a sample whose vertices are looked at: each vertex would have to be
/// compared with all of them.
const MOST_AROUND: usize = 32;

/// Vertices whose nearest points are added up at a time, while the next ones are looked at.
const BLOCK: usize = 1 << 15;

/// Vertices that a thread looks at in one go.
const PIECE: usize = 1 << 10;

/// Triangles that are looked at side by side.
const LANES: usize = 8;

/// Samples whose triangles a thread has at hand: vertices that follow each other are of a few.
const FANS: usize = 64;

/// No sample, and no triangle.
const NONE: u32 = u32::MAX;

/// Vertices of P_L, and the sample of each.
#[derive(Clone, Copy)]
pub struct VertexMembers<'a> {
    /// Positions of the vertices, local coordinates.
    pub vertices: &'a [Vec3],
    /// Sample of each vertex; `u32::MAX` if it has none.
    pub sample_of: &'a [u32],
    /// About the number of vertices at one place.
    pub at_one_place: u32,
}

/// Moves the samples nearer to the vertices, but for those that are `held`; `first` says where the vertices
/// have placed them. Depends neither on the number of threads, nor on the width of vectors, nor on the order
/// of the vertices.
///
/// Memory: 84 bytes for each triangle, and 68 per sample; 1.3 MiB, and at most 150 KiB for each thread.
///
/// # Errors
/// The user cancelled.
pub fn fit(
    placed: &mut [Placed],
    first: &[Vec3],
    triangles: &[[u32; 3]],
    members: VertexMembers<'_>,
    held: &[u32],
    progress: &dyn Progress,
) -> Result<()> {
    let samples: Vec<Vec3> = placed.iter().map(|placed| placed.at).collect();
    let surface = TriangleSurface::new(&samples, triangles);
    let moments = surface.moments(members, progress)?;
    let ways = surface.ways(&moments, held);
    placed.par_iter_mut().zip(first).zip(ways).for_each(|((placed, first), way)| {
        if way != Vec3::ZERO {
            placed.at = *first + (placed.at + way - *first).clamp_length_max(placed.most);
        }
    });
    Ok(())
}

/// Orders places: any order that follows from the places alone.
fn by_place(p: &Vec3, q: &Vec3) -> Ordering {
    p.to_array().map(f32::to_bits).cmp(&q.to_array().map(f32::to_bits))
}

/// The triangles of P_S.
struct TriangleSurface<'a> {
    samples: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    /// The triangles' normals; zero where they have no area.
    normals: Vec<Vec3>,
    /// Start of each sample's triangles in `around`.
    starts: Vec<u32>,
    around: Vec<u32>,
    /// The longest side of the samples' box.
    extent: f32,
}

impl<'a> TriangleSurface<'a> {
    fn new(samples: &'a [Vec3], triangles: &'a [[u32; 3]]) -> Self {
        let corners = triangles.iter().zip(0..).flat_map(|(of, number)| of.map(|sample| (sample, number)));
        let (starts, around) = lists(samples.len(), corners);
        let normals =
            triangles.par_iter().map(|corners| normal(corners.map(|sample| samples[sample as usize])));
        let PointBox { min, max } = PointBox::from_points(samples.iter().copied());
        let extent = (max - min).max_element().max(f32::MIN_POSITIVE);
        let normals = normals.collect();
        let mut surface = Self { samples, triangles, normals, starts, around, extent };
        surface.sort();
        surface
    }

    /// Sorts the triangles around each sample by the places of their corners, so that sums over them do not
    /// depend on how samples are numbered.
    fn sort(&mut self) {
        let mut around = std::mem::take(&mut self.around);
        let (mut lists, mut rest) = (Vec::new(), &mut around[..]);
        for run in self.starts.windows(2) {
            let (list, others) = rest.split_at_mut((run[1] - run[0]) as usize);
            lists.push(list);
            rest = others;
        }
        lists.into_par_iter().enumerate().for_each(|(sample, list)| {
            let others = |triangle: &u32| self.others(*triangle, self.corner(*triangle, sample as u32));
            list.sort_by(|a, b| {
                let ([a, b], [c, d]) = (others(a), others(b));
                by_place(&a, &c).then_with(|| by_place(&b, &d))
            });
        });
        self.around = around;
    }

    /// Triangles of which a sample is a corner.
    fn around(&self, sample: u32) -> &[u32] {
        let all = sample as usize;
        &self.around[self.starts[all] as usize..self.starts[all + 1] as usize]
    }

    /// The number of the triangle's corner that a sample is.
    #[inline(always)]
    fn corner(&self, triangle: u32, sample: u32) -> usize {
        let corners = self.triangles[triangle as usize];
        corners.iter().position(|corner| *corner == sample).unwrap_or(0)
    }

    /// Positions of the two corners of a triangle after one.
    #[inline(always)]
    fn others(&self, triangle: u32, corner: usize) -> [Vec3; 2] {
        let corners = self.triangles[triangle as usize];
        [1, 2].map(|next| self.samples[corners[(corner + next) % 3] as usize])
    }

    /// The moments of all triangles.
    fn moments(&self, members: VertexMembers<'_>, progress: &dyn Progress) -> Result<Vec<TriangleSums>> {
        let per = self.extent.recip();
        let mut moments = vec![TriangleSums::default(); self.triangles.len()];
        let chosen = self.chosen(members);
        let (mut last, mut next) = (Vec::new(), Vec::new());
        progress.begin_parts("fitting the samples", members.vertices.len() as u64);
        for begin in (0..members.vertices.len()).step_by(BLOCK) {
            progress.check()?;
            let end = members.vertices.len().min(begin + BLOCK);
            let some = (&members.vertices[begin..end], &members.sample_of[begin..end]);
            rayon::join(|| add(&mut moments, &last, per), || self.find(some, &chosen, &mut next));
            std::mem::swap(&mut last, &mut next);
            looked_at(size_of_val(some.0) + size_of_val(some.1));
            progress.advance((end - begin) as u64);
        }
        add(&mut moments, &last, per);
        Ok(moments)
    }

    /// Bound for each sample below which the hashes of those of its vertices are that are looked at: as if by
    /// chance, so that about as many are chosen as is enough.
    fn chosen(&self, members: VertexMembers<'_>) -> Vec<u32> {
        let mut chosen = vec![0u32; self.samples.len()];
        for some in members.sample_of.chunks(BLOCK) {
            for sample in some {
                if let Some(count) = chosen.get_mut(*sample as usize) {
                    *count = count.saturating_add(1);
                }
            }
            looked_at(size_of_val(some));
        }
        let enough = ENOUGH * members.at_one_place;
        for (count, sample) in chosen.iter_mut().zip(0..) {
            *count =
                if self.around(sample).len() > MOST_AROUND { 0 } else { u32::MAX / (*count / enough).max(1) };
        }
        chosen
    }

    /// Finds the nearest points of those of some vertices, with their samples, that are chosen.
    fn find(&self, (vertices, sample_of): (&[Vec3], &[u32]), chosen: &[u32], found: &mut Vec<NearestPoint>) {
        found.resize(vertices.len(), NearestPoint::NONE);
        let fans = || [(); FANS].map(|()| SampleFan::default());
        let members = vertices.par_chunks(PIECE).zip(sample_of.par_chunks(PIECE));
        found.par_chunks_mut(PIECE).zip(members).for_each_init(
            fans,
            |fans, (found, (vertices, sample_of))| {
                Arch::new().dispatch(NearestSearch {
                    surface: self,
                    vertices,
                    sample_of,
                    chosen,
                    fans,
                    found,
                });
            },
        );
    }

    /// The ways of all samples after all steps.
    fn ways(&self, moments: &[TriangleSums], held: &[u32]) -> Vec<Vec3> {
        let samples = 0..self.samples.len() as u32;
        let mut lumped: Vec<Mat3> =
            samples.into_par_iter().map(|sample| self.lumped(sample, moments)).collect();
        held.iter().for_each(|sample| lumped[*sample as usize] = Mat3::ZERO);
        let mut ways = vec![Vec3::ZERO; self.samples.len()];
        for _ in 0..STEPS {
            let left = self.triangles.par_iter().zip(&self.normals).zip(moments);
            let left: Vec<[f32; 3]> = left
                .map(|((corners, normal), moments)| {
                    moments.left(corners.map(|sample| normal.dot(ways[sample as usize])), self.extent)
                })
                .collect();
            ways.par_iter_mut().zip(&lumped).enumerate().for_each(|(sample, (way, lumped))| {
                let sample = sample as u32;
                let parts = self.around(sample).iter().map(|triangle| {
                    let corner = self.corner(*triangle, sample);
                    self.normals[*triangle as usize] * left[*triangle as usize][corner]
                });
                let step = *lumped * parts.sum::<Vec3>();
                if step.is_finite() {
                    *way += step;
                }
            });
        }
        ways
    }

    /// Matrix that takes a sample's part of the residual to its step: the inverse of the sample's block,
    /// lumped, with a ridge.
    fn lumped(&self, sample: u32, moments: &[TriangleSums]) -> Mat3 {
        // A sample at a corner of a triangle of too many vertices stays, as the others would move it alone.
        if self.around(sample).iter().any(|triangle| moments[*triangle as usize].is_full()) {
            return Mat3::ZERO;
        }
        let (mut diagonal, mut off, mut weight) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        for triangle in self.around(sample) {
            let corner = self.corner(*triangle, sample);
            let lumped = f64::from(moments[*triangle as usize].weights(corner).iter().sum::<f32>());
            if lumped > 0.0 {
                let normal = self.normals[*triangle as usize].as_dvec3();
                diagonal += lumped * normal * normal;
                off += lumped * normal * DVec3::new(normal.y, normal.z, normal.x);
                weight += lumped;
            }
        }
        let ridge = DMat3::from_diagonal(DVec3::splat(RIDGE * weight));
        (f64::from(OVER) * (symmetric(diagonal, off) + ridge).inverse()).as_mat3()
    }
}

/// Normal of a triangle, zero if it has no area: the same whichever corner is called the first.
fn normal(mut corners: [Vec3; 3]) -> Vec3 {
    let least = (0..3).min_by(|i, j| by_place(&corners[*i], &corners[*j]));
    corners.rotate_left(least.unwrap_or(0));
    let [a, b, c] = corners;
    let across = (b - a).cross(c - a);
    let normal = across * across.length_recip();
    if normal.is_finite() { normal } else { Vec3::ZERO }
}

/// Weight that stands for 1 in sums of products of coordinates.
const WEIGHT: f32 = (1 << 16) as f32;

/// The samples' extent, in sums of heights.
const HEIGHT: f32 = (1 << 30) as f32;

/// Sums over the vertices that are nearest to a triangle: whole numbers, so that they do not depend on the
/// vertices' order.
#[derive(Clone, Copy, Default)]
struct TriangleSums {
    /// Σ b² for each corner, in 1 / [`WEIGHT`].
    squares: [u32; 3],
    /// Σ b b of the two corners that are not this one, in 1 / [`WEIGHT`].
    products: [u32; 3],
    /// Σ b h for each corner, in 1 / [`HEIGHT`] of the samples' extent.
    heights: [i64; 3],
}

impl TriangleSums {
    /// Adds a vertex' coordinates, and its height in the samples' extent.
    fn add(&mut self, b: [f32; 3], height: f32) {
        for corner in 0..3 {
            let [square, product] = [b[corner] * b[corner], b[(corner + 1) % 3] * b[(corner + 2) % 3]];
            let add = |sum: &mut u32, x: f32| *sum = sum.saturating_add((x * WEIGHT) as u32);
            add(&mut self.squares[corner], square);
            add(&mut self.products[corner], product);
            let height = (b[corner] * height * HEIGHT) as i64;
            self.heights[corner] = self.heights[corner].saturating_add(height);
        }
    }

    /// Whether there are more vertices than can be summed up.
    fn is_full(&self) -> bool {
        self.squares.contains(&u32::MAX)
    }

    /// Σ b b of a corner with itself and the two after it.
    fn weights(&self, corner: usize) -> [f32; 3] {
        let product = |next: usize| self.products[(corner + next) % 3];
        [self.squares[corner], product(2), product(1)].map(|sum| sum as f32 / WEIGHT)
    }

    /// Σ b h of each corner, less the part due to `gone`: the distance that corners have gone along the
    /// normal.
    fn left(&self, gone: [f32; 3], extent: f32) -> [f32; 3] {
        std::array::from_fn(|corner| {
            let weights = self.weights(corner);
            let gone = [0, 1, 2].map(|next| weights[next] * gone[(corner + next) % 3]);
            if weights[0] > 0.0 {
                self.heights[corner] as f32 / HEIGHT * extent - (gone[0] + gone[1] + gone[2])
            } else {
                0.0
            }
        })
    }
}

/// Finds the nearest points of those of some vertices that are chosen.
struct NearestSearch<'a, 'b> {
    surface: &'a TriangleSurface<'b>,
    vertices: &'a [Vec3],
    sample_of: &'a [u32],
    chosen: &'a [u32],
    fans: &'a mut [SampleFan; FANS],
    found: &'a mut [NearestPoint],
}

impl WithSimd for NearestSearch<'_, '_> {
    type Output = ();

    // Inlined into a function for the processor's widest vectors, as all that it calls.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { surface, vertices, sample_of, chosen, fans, found } = self;
        for ((vertex, sample), found) in vertices.iter().zip(sample_of).zip(found) {
            *found = NearestPoint::NONE;
            if chosen.get(*sample as usize).is_some_and(|below| hash(*vertex) < *below) {
                let fan = &mut fans[*sample as usize % FANS];
                fan.turn_to(surface, *sample);
                *found = fan.nearest(*vertex);
            }
        }
    }
}

/// A number that follows from a place as if by chance.
#[inline(always)]
fn hash(place: Vec3) -> u32 {
    let mix = |hash: u32, x: f32| (hash.rotate_left(13) ^ x.to_bits()).wrapping_mul(0x9e37_79b1);
    let hash = place.to_array().into_iter().fold(0, mix);
    (hash ^ hash >> 15).wrapping_mul(0x85eb_ca6b)
}

/// Adds nearest points to the moments; heights `per` local unit.
fn add(moments: &mut [TriangleSums], found: &[NearestPoint], per: f32) {
    for NearestPoint { triangle, weights, height } in found {
        if let Some(moments) = moments.get_mut(*triangle as usize) {
            moments.add(*weights, height * per);
        }
    }
}

/// The point of the triangles around a sample that is nearest to a vertex.
#[derive(Clone, Copy)]
struct NearestPoint {
    triangle: u32,
    /// The point's barycentric coordinates.
    weights: [f32; 3],
    /// Signed height of the vertex over the triangle.
    height: f32,
}

impl NearestPoint {
    const NONE: Self = Self { triangle: NONE, weights: [0.0; 3], height: 0.0 };
}

/// The triangles around one sample.
struct SampleFan {
    sample: u32,
    /// The sample's position.
    apex: Vec3,
    blades: Vec<Blades>,
}

impl Default for SampleFan {
    fn default() -> Self {
        Self { sample: NONE, apex: Vec3::ZERO, blades: Vec::new() }
    }
}

/// Some triangles around a sample: those behind the last are never the nearest. The two other corners are b
/// and c, from the sample.
struct Blades {
    triangles: [u32; LANES],
    /// The number of the corner, in each triangle, that the sample is.
    apexes: [u8; LANES],
    b: [[f32; LANES]; 3],
    c: [[f32; LANES]; 3],
    normals: [[f32; LANES]; 3],
    bb: [f32; LANES],
    bc: [f32; LANES],
    cc: [f32; LANES],
    /// One over the squares of b, c and c − b, and over (b × c)²; 0 where that square is zero.
    per_bb: [f32; LANES],
    per_cc: [f32; LANES],
    per_ee: [f32; LANES],
    per_area: [f32; LANES],
    /// Added to squared distances: infinite where there is no triangle, or one without area.
    none: [f32; LANES],
}

impl SampleFan {
    /// Takes the triangles around a sample, if those at hand are not.
    #[inline(always)]
    fn turn_to(&mut self, surface: &TriangleSurface<'_>, sample: u32) {
        if self.sample != sample {
            self.sample = sample;
            self.apex = surface.samples[sample as usize];
            self.blades.clear();
            for some in surface.around(sample).chunks(LANES) {
                self.blades.push(Blades::new(surface, sample, some));
            }
        }
    }

    /// Point of the fan's triangles that is nearest to `p`.
    #[inline(always)]
    fn nearest(&self, p: Vec3) -> NearestPoint {
        let p = p - self.apex;
        let (mut square, mut nearest) = (f32::INFINITY, NearestPoint::NONE);
        for blades in &self.blades {
            let best = blades.nearest(p);
            if best.square < square {
                square = best.square;
                let lane = best.lane;
                let mut weights = [1.0 - best.v - best.w, best.v, best.w];
                weights.rotate_right(usize::from(blades.apexes[lane]));
                nearest = NearestPoint {
                    triangle: blades.triangles[lane],
                    weights,
                    height: blades.along(&blades.normals, lane, p),
                };
            }
        }
        nearest
    }
}

#[inline(always)]
fn dot(a: &[[f32; LANES]; 3], b: &[[f32; LANES]; 3]) -> [f32; LANES] {
    std::array::from_fn(|i| a[0][i] * b[0][i] + a[1][i] * b[1][i] + a[2][i] * b[2][i])
}

impl Blades {
    #[inline(always)]
    fn new(surface: &TriangleSurface<'_>, sample: u32, some: &[u32]) -> Self {
        let apex = surface.samples[sample as usize];
        let (mut triangles, mut apexes, mut none) = ([NONE; LANES], [0; LANES], [f32::INFINITY; LANES]);
        let [mut b, mut c, mut normals] = [[[0.0; LANES]; 3]; 3];
        for (i, triangle) in some.iter().enumerate() {
            let corner = surface.corner(*triangle, sample);
            (triangles[i], apexes[i]) = (*triangle, corner as u8);
            let [toward_b, toward_c] = surface.others(*triangle, corner).map(|other| other - apex);
            let normal = surface.normals[*triangle as usize];
            for axis in 0..3 {
                b[axis][i] = toward_b[axis];
                c[axis][i] = toward_c[axis];
                normals[axis][i] = normal[axis];
            }
            none[i] = if normal == Vec3::ZERO { f32::INFINITY } else { 0.0 };
        }
        let (bb, bc, cc) = (dot(&b, &b), dot(&b, &c), dot(&c, &c));
        let per = |x: f32| if x >= f32::MIN_POSITIVE { 1.0 / x } else { 0.0 };
        Self {
            triangles,
            apexes,
            b,
            c,
            normals,
            bb,
            bc,
            cc,
            per_bb: bb.map(per),
            per_cc: cc.map(per),
            per_ee: std::array::from_fn(|i| per(bb[i] + cc[i] - 2.0 * bc[i])),
            per_area: std::array::from_fn(|i| per(bb[i] * cc[i] - bc[i] * bc[i])),
            none,
        }
    }

    /// Dot product of a vector with one of each triangle's, for the triangle in a lane.
    #[inline(always)]
    fn along(&self, a: &[[f32; LANES]; 3], lane: usize, p: Vec3) -> f32 {
        a[0][lane] * p.x + a[1][lane] * p.y + a[2][lane] * p.z
    }

    /// The point of all triangles that is nearest to one from the sample.
    #[inline(always)]
    fn nearest(&self, p: Vec3) -> Best {
        let (mut squares, mut vs, mut ws) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let (bb, bc, cc) = (self.bb[i], self.bc[i], self.cc[i]);
            let (bp, cp) = (self.along(&self.b, i, p), self.along(&self.c, i, p));
            let square = |v: f32, w: f32| v * (v * bb + 2.0 * (w * bc - bp)) + w * (w * cc - 2.0 * cp);
            let within = |t: f32| t.clamp(0.0, 1.0);
            let nearer = |a: (f32, f32, f32), b: (f32, f32, f32)| if b.0 < a.0 { b } else { a };
            // The three sides, …
            let v = within(bp * self.per_bb[i]);
            let w = within(cp * self.per_cc[i]);
            let t = within((bb - bc + cp - bp) * self.per_ee[i]);
            let sides = nearer((square(v, 0.0), v, 0.0), (square(0.0, w), 0.0, w));
            let sides = nearer(sides, (square(1.0 - t, t), 1.0 - t, t));
            // … and the point between them.
            let (v, w) = ((cc * bp - bc * cp) * self.per_area[i], (bb * cp - bc * bp) * self.per_area[i]);
            let inside = v >= 0.0 && w >= 0.0 && v + w <= 1.0;
            let best = if inside { nearer(sides, (square(v, w), v, w)) } else { sides };
            (squares[i], vs[i], ws[i]) = (best.0 + self.none[i], best.1, best.2);
        }
        let mut lane = 0;
        for i in 1..LANES {
            if squares[i] < squares[lane] {
                lane = i;
            }
        }
        Best { square: squares[lane], lane, v: vs[lane], w: ws[lane] }
    }
}

/// A point v b + w c of a triangle, v, w ≥ 0, v + w ≤ 1: its squared distance less that of the sample, and
/// the triangle's lane.
struct Best {
    square: f32,
    lane: usize,
    v: f32,
    w: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use simod_model::progress::Silent;

    /// The nearest point of a triangle, one feature after the other: its corners, sides and inside.
    fn nearest_on([a, b, c]: [Vec3; 3], p: Vec3) -> f32 {
        let on_side = |a: Vec3, b: Vec3| {
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            if t.is_nan() { p.distance(a) } else { p.distance(a + t * (b - a)) }
        };
        let sides = on_side(a, b).min(on_side(b, c)).min(on_side(c, a));
        let normal = (b - a).cross(c - a);
        let is_left = |a: Vec3, b: Vec3| normal.dot((b - a).cross(p - a)) >= 0.0;
        let above = normal.dot(p - a).abs() / normal.length();
        if is_left(a, b) && is_left(b, c) && is_left(c, a) && above.is_finite() {
            sides.min(above)
        } else {
            sides
        }
    }

    fn point() -> impl Strategy<Value = Vec3> {
        // Few distinct values: triangles without area, and points on corners and sides, are common.
        let x = || (-4..5i32).prop_map(|x| x as f32 / 4.0);
        (x(), x(), x()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn the_nearest_point_of_all_triangles_around_a_sample_is_found(
            samples in proptest::collection::vec(point(), 3..30), p in point(),
        ) {
            // All with the last sample as a corner, in turn the first, the second and the third.
            let last = samples.len() as u32 - 1;
            let turned = |i: u32| {
                let mut triangle = [last, i, i + 1];
                triangle.rotate_left(i as usize % 3);
                triangle
            };
            let triangles: Vec<[u32; 3]> = (0..last - 1).map(turned).collect();
            let surface = TriangleSurface::new(&samples, &triangles);
            let mut fan = SampleFan::default();
            fan.turn_to(&surface, last);
            let found = fan.nearest(p);

            let corners = |triangle: [u32; 3]| triangle.map(|sample| samples[sample as usize]);
            let has_area = |[a, b, c]: &[Vec3; 3]| (*b - *a).cross(*c - *a) != Vec3::ZERO;
            let all = triangles.iter().map(|triangle| corners(*triangle)).filter(has_area);
            let expected = all.map(|corners| nearest_on(corners, p)).fold(f32::INFINITY, f32::min);
            if expected.is_infinite() {
                prop_assert_eq!(found.triangle, NONE);
            } else {
                let [a, b, c] = corners(triangles[found.triangle as usize]);
                let [u, v, w] = found.weights;
                prop_assert!((u + v + w - 1.0).abs() < 1e-5 && u.min(v).min(w) > -1e-5);
                let distance = p.distance(u * a + v * b + w * c);
                prop_assert!((distance - expected).abs() < 1e-3, "{} and {}", distance, expected);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                prop_assert!((found.height - normal.dot(p - a)).abs() < 1e-4);
            }
        }
    }

    /// Samples of a square of side 1, `side` along a side, with these heights, and their triangles.
    fn square(side: u32, height: impl Fn(f32, f32) -> f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let at = |i: u32| i as f32 / (side - 1) as f32;
        let sample = |i: u32| {
            let (x, z) = (at(i % side), at(i / side));
            Vec3::new(x, height(x, z), z)
        };
        let two = |i: u32| {
            let a = i / (side - 1) * side + i % (side - 1);
            [[a, a + side, a + 1], [a + 1, a + side, a + side + 1]]
        };
        let triangles = (0..(side - 1) * (side - 1)).flat_map(two).collect();
        ((0..side * side).map(sample).collect(), triangles)
    }

    /// Samples of a square of height 0.01, fitted to a wave, as far as they may go, by this number of
    /// threads.
    fn fitted(most: f32, threads: usize) -> (Vec<Placed>, Vec<Vec3>) {
        fitted_to(|_| (), most, threads)
    }

    /// Samples fitted likewise to the wave's vertices in another order.
    fn fitted_to(order: impl Fn(&mut [Vec3]), most: f32, threads: usize) -> (Vec<Placed>, Vec<Vec3>) {
        let wave = |x: f32, z: f32| 0.02 * (7.0 * x).sin() * (5.0 * z).cos();
        let (first, triangles) = square(11, |_, _| 0.01);
        let (mut vertices, _) = square(171, wave);
        order(&mut vertices);
        let nearest = |p: &Vec3| {
            let at = |x: f32| (10.0 * x).round() as u32;
            at(p.z) * 11 + at(p.x)
        };
        let mut sample_of: Vec<u32> = vertices.iter().map(nearest).collect();
        // One vertex has no sample.
        sample_of[vertices.iter().position(|p| *p == Vec3::new(0.0, wave(0.0, 0.0), 0.0)).unwrap()] = NONE;
        let mut placed: Vec<Placed> = first.iter().map(|at| Placed { at: *at, most }).collect();
        placed[60].most = 0.0;
        let members = VertexMembers { vertices: &vertices, sample_of: &sample_of, at_one_place: 1 };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fit(&mut placed, &first, &triangles, members, &[61], &Silent)).unwrap();
        (placed, first)
    }

    #[test]
    fn samples_come_nearer_to_the_vertices() {
        let (placed, first) = fitted(f32::INFINITY, 1);
        let off = |p: Vec3| (p.y - 0.02 * (7.0 * p.x).sin() * (5.0 * p.z).cos()).powi(2);
        let before: f32 = first.iter().map(|p| off(*p)).sum();
        let after: f32 = placed.iter().map(|placed| off(placed.at)).sum();
        assert!(after < 0.2 * before, "{after} and {before}");
        // No sample goes where it may not, …
        assert!(placed[60].at == first[60] && placed[61].at == first[61]);
        // … nor along a flat surface.
        let along = placed.iter().zip(&first).map(|(p, q)| (p.at - *q).with_y(0.0).length());
        assert!(along.fold(0.0, f32::max) < 1e-6);
    }

    #[test]
    fn samples_go_as_far_as_they_may_whatever_the_number_of_threads() {
        let (placed, first) = fitted(0.004, 1);
        let far: Vec<f32> = placed.iter().zip(&first).map(|(p, q)| p.at.distance(*q)).collect();
        assert!(
            far.iter().all(|way| *way < 0.00401) && far.iter().filter(|way| **way > 0.00399).count() > 50
        );
        assert!(placed == fitted(0.004, 3).0);
    }

    #[test]
    fn what_the_vertices_order_is_changes_nothing() {
        let (placed, _) = fitted(f32::INFINITY, 1);
        let mirrored = |vertices: &mut [Vec3]| vertices.reverse();
        let mixed = |vertices: &mut [Vec3]| vertices.sort_by_key(|p| hash(*p));
        assert!(placed == fitted_to(mirrored, f32::INFINITY, 1).0);
        assert!(placed == fitted_to(mixed, f32::INFINITY, 3).0);
    }

    #[test]
    fn vertices_are_chosen_as_if_by_chance() {
        let few = (0..1 << 20).filter(|i| hash(Vec3::new(*i as f32, 1.0, -2.5)) <= u32::MAX / 64).count();
        assert!((15_900..16_900).contains(&few), "{few}");
    }

    #[test]
    fn where_there_are_no_triangles_samples_stay() {
        let (first, _) = square(3, |_, _| 0.0);
        let mut placed: Vec<Placed> = first.iter().map(|at| Placed { at: *at, most: 1.0 }).collect();
        let members = VertexMembers { vertices: &[Vec3::ONE], sample_of: &[4], at_one_place: 1 };
        for triangles in [&[][..], &[[4, 5, 4], [4, 5, 5]]] {
            fit(&mut placed, &first, triangles, members, &[], &Silent).unwrap();
            assert!(placed.iter().zip(&first).all(|(placed, first)| placed.at == *first));
        }
    }
}
