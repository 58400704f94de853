//! A cluster of vertices as its moments, from which its error and its representative follow.
//!
//! The error is the product of the L² metric (distance to the mean plane) and the L²·¹ metric (deviation of
//! the normals), D. Cohen-Steiner, P. Alliez, M. Desbrun, *Variational Shape Approximation*, 2004, as paper
//! §4 proposes. The representative minimises the quadric of the vertices' tangent planes (M. Garland, P.
//! Heckbert 1997; P. Lindstrom 2000), held to the mean by a small ridge.

use std::cell::OnceCell;

use glam::{DMat3, DVec3, Vec3, Vec3A, Vec3Swizzles};
use serde::{Deserialize, Serialize};

use crate::geometry::least_eigenvalue;

/// Element of a VS-Tree: a vertex of P_L, or a small group of vertices.
pub trait Element: bytemuck::Pod + Send + Sync {
    /// Mean position, in local coordinates.
    fn position(&self) -> Vec3;
    /// Unit mean normal; zero where there is none.
    fn normal(&self) -> Vec3;
    /// The element's place in its cell, in the order of the stream.
    fn index(&self) -> u32;
    /// Number of its vertices.
    fn vertices(&self) -> u32;
    /// Adds the vertices of some elements to the moments of a cluster.
    fn add_to(elements: &[Self], moments: &mut Moments);
}

/// A vertex of P_L inside a cell: position relative to the model's origin, and unit normal.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Position in local coordinates.
    pub position: Vec3,
    /// Unit normal, or zero where the model has none (or none that is finite) at this vertex.
    pub normal: Vec3,
    /// Place in the cell, in the order of the stream.
    pub index: u32,
}

impl Element for Vertex {
    #[inline]
    fn position(&self) -> Vec3 {
        self.position
    }

    #[inline]
    fn normal(&self) -> Vec3 {
        self.normal
    }

    #[inline]
    fn index(&self) -> u32 {
        self.index
    }

    #[inline]
    fn vertices(&self) -> u32 {
        1
    }

    fn add_to(vertices: &[Self], moments: &mut Moments) {
        // Sums are in single precision about one of the vertices, which is exact enough for so many, and much
        // faster.
        for vertices in vertices.chunks(VERTICES_AT_ONCE) {
            let mut sums = VertexSums::about(vertices[0].position);
            let (mut min, mut max) = (Vec3A::from(moments.min), Vec3A::from(moments.max));
            for s in vertices {
                let position = Vec3A::from(s.position);
                (min, max) = (min.min(position), max.max(position));
                sums.add(position, Vec3A::from(s.normal));
            }
            (moments.min, moments.max) = (min.into(), max.into());
            moments.add_sums(&sums, vertices.len() as f64);
        }
    }
}

/// Vertices that are summed up in single precision.
const VERTICES_AT_ONCE: usize = 256;

/// Sums over vertices, in single precision, with their positions relative to a point. Products of two
/// different coordinates are in the order xy, yz, zx.
#[derive(Debug, Clone, Copy)]
struct VertexSums {
    center: Vec3A,
    position: Vec3A,
    outer: [Vec3A; 2],
    normal: Vec3A,
    quadric: [Vec3A; 2],
    /// Σ n (n·p).
    quadric_b: Vec3A,
}

impl VertexSums {
    fn about(center: Vec3) -> Self {
        let (zero, center) = (Vec3A::ZERO, center.into());
        Self { center, position: zero, outer: [zero; 2], normal: zero, quadric: [zero; 2], quadric_b: zero }
    }

    #[inline(always)]
    fn add(&mut self, position: Vec3A, n: Vec3A) {
        let p = position - self.center;
        self.position += p;
        self.outer[0] += p * p;
        self.outer[1] += p * p.yzx();
        self.normal += n;
        self.quadric[0] += n * n;
        self.quadric[1] += n * n.yzx();
        self.quadric_b += n * n.dot(p);
    }
}

/// Sums over a few vertices that lie close together, which an open cell keeps of a model with very many
/// vertices for each sample of P_S. A VS-Tree over these differs from one over the vertices in that no group
/// is parted.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Group {
    /// Origin of the positions: the middle of a cube that holds them all.
    center: Vec3,
    /// Half of that cube's edge.
    half: f32,
    index: u32,
    count: u32,
    position: Vec3,
    outer: [Vec3; 2],
    normal: Vec3,
    quadric: [Vec3; 2],
    quadric_b: Vec3,
}

impl Group {
    /// Largest number of vertices in a group: the sums are in single precision.
    const MAX: u32 = 1 << 16;

    /// A group of none yet, in a cube, of this place in its cell.
    pub fn new(center: Vec3, half: f32, index: u32) -> Self {
        Self { center, half, index, ..bytemuck::Zeroable::zeroed() }
    }

    /// The middle of its cube.
    #[inline]
    pub fn center(&self) -> Vec3 {
        self.center
    }

    /// The sums so far, in the form that takes in vertices.
    #[inline(always)]
    pub fn sums(&self) -> GroupSums {
        GroupSums { count: self.count, sums: self.about_center() }
    }

    /// Puts its sums back, with more vertices.
    #[inline(always)]
    pub fn set(&mut self, GroupSums { count, sums }: &GroupSums) {
        self.count = *count;
        self.position = sums.position.into();
        self.outer = sums.outer.map(Vec3::from);
        self.normal = sums.normal.into();
        self.quadric = sums.quadric.map(Vec3::from);
        self.quadric_b = sums.quadric_b.into();
    }

    /// Whether the vertices of another group of the same cube belong to this group: they are not of an
    /// opposite sheet.
    #[inline]
    pub fn takes(&self, other: &Self) -> bool {
        self.count + other.count <= Self::MAX && self.normal.dot(other.normal) >= 0.0
    }

    /// Takes in the vertices of another group of the same cube.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.position += other.position;
        self.normal += other.normal;
        self.quadric_b += other.quadric_b;
        for i in 0..2 {
            self.outer[i] += other.outer[i];
            self.quadric[i] += other.quadric[i];
        }
    }

    /// Copy of this group at another place in its cell.
    pub fn with_index(&self, index: u32) -> Self {
        Self { index, ..*self }
    }

    #[inline(always)]
    fn about_center(&self) -> VertexSums {
        VertexSums {
            center: self.center.into(),
            position: self.position.into(),
            outer: self.outer.map(Vec3A::from),
            normal: self.normal.into(),
            quadric: self.quadric.map(Vec3A::from),
            quadric_b: self.quadric_b.into(),
        }
    }
}

/// A group that is taking in vertices.
#[derive(Debug, Clone, Copy)]
pub struct GroupSums {
    count: u32,
    sums: VertexSums,
}

impl GroupSums {
    /// Whether a vertex with this normal belongs to this group, if its position does: it is not of an
    /// opposite sheet.
    #[inline(always)]
    pub fn takes(&self, normal: Vec3) -> bool {
        self.count < Group::MAX && self.sums.normal.dot(normal.into()) >= 0.0
    }

    /// Takes in a vertex.
    #[inline(always)]
    pub fn add(&mut self, position: Vec3, normal: Vec3) {
        self.count += 1;
        self.sums.add(position.into(), normal.into());
    }
}

impl Element for Group {
    #[inline]
    fn position(&self) -> Vec3 {
        self.center + self.position / self.count as f32
    }

    #[inline]
    fn normal(&self) -> Vec3 {
        self.normal.normalize_or_zero()
    }

    #[inline]
    fn index(&self) -> u32 {
        self.index
    }

    #[inline]
    fn vertices(&self) -> u32 {
        self.count
    }

    fn add_to(groups: &[Self], moments: &mut Moments) {
        for group in groups {
            moments.min = moments.min.min(group.center - group.half);
            moments.max = moments.max.max(group.center + group.half);
            moments.add_sums(&group.about_center(), f64::from(group.count));
        }
    }
}

/// Part of a cluster's extent that counts as error, whatever the cluster's shape: it bounds the spacing where
/// the surface is flat and any geometric error is zero, for a deformation need not be flat there.
///
/// So a sample is within error / `REACH_WEIGHT` of every vertex that it stands for, but for the little by
/// which it moves to the surface in the end.
pub const REACH_WEIGHT: f64 = 0.08;

/// Strength of the ridge towards the mean, relative to the trace of the quadric: weaker ones follow smooth
/// surfaces more closely, but throw samples off surfaces with steep relief.
const QUADRIC_RIDGE: f64 = 1e-3;

/// Variance of the normals below which a surface is flat, due to the digits that normals are stored to.
const FLAT: f64 = 1e-6;

/// Additive moments of a cluster, about the model's origin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// Corner of least coordinates.
    pub min: Vec3,
    /// Corner of greatest coordinates.
    pub max: Vec3,
    count: f64,
    position: DVec3,
    /// Σ p pᵀ: xx, yy, zz and xy, yz, zx.
    outer: [DVec3; 2],
    normal: DVec3,
    /// Σ n nᵀ, likewise.
    quadric: [DVec3; 2],
    /// Σ n (n·p).
    quadric_b: DVec3,
    /// Number of vertices with a normal.
    with_normal: f64,
}

/// The covariance of a cluster's positions.
pub struct Covariance {
    /// The matrix.
    pub matrix: DMat3,
    /// Least eigenvalue, once it was asked for.
    least: OnceCell<f64>,
}

impl Covariance {
    /// The variance of the positions across their plane of least squares.
    pub fn least(&self) -> f64 {
        *self.least.get_or_init(|| least_eigenvalue(self.matrix))
    }
}

impl Default for Moments {
    fn default() -> Self {
        Self {
            min: Vec3::INFINITY,
            max: Vec3::NEG_INFINITY,
            count: 0.0,
            position: DVec3::ZERO,
            outer: [DVec3::ZERO; 2],
            normal: DVec3::ZERO,
            quadric: [DVec3::ZERO; 2],
            quadric_b: DVec3::ZERO,
            with_normal: 0.0,
        }
    }
}

impl Moments {
    /// The moments of a set of vertices.
    pub fn from_elements<E: Element>(elements: &[E]) -> Self {
        let mut m = Self::default();
        E::add_to(elements, &mut m);
        m
    }

    /// Adds the sums over `count` vertices; not the box.
    fn add_sums(&mut self, sums: &VertexSums, count: f64) {
        let (c, p) = (sums.center.as_dvec3(), sums.position.as_dvec3());
        let quadric = sums.quadric.map(|q| q.as_dvec3());
        self.count += count;
        self.position += p + c * count;
        self.outer[0] += sums.outer[0].as_dvec3() + c * p * 2.0 + c * c * count;
        self.outer[1] += sums.outer[1].as_dvec3() + c * p.yzx() + p * c.yzx() + c * c.yzx() * count;
        self.normal += sums.normal.as_dvec3();
        self.quadric[0] += quadric[0];
        self.quadric[1] += quadric[1];
        self.quadric_b += sums.quadric_b.as_dvec3() + symmetric(quadric[0], quadric[1]) * c;
        // Normals are of unit length, or none.
        self.with_normal += quadric[0].element_sum();
    }

    /// Adds the moments of another, disjoint set.
    pub fn add(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.count += other.count;
        self.position += other.position;
        self.normal += other.normal;
        self.quadric_b += other.quadric_b;
        self.with_normal += other.with_normal;
        for i in 0..2 {
            self.outer[i] += other.outer[i];
            self.quadric[i] += other.quadric[i];
        }
    }

    /// Number of vertices.
    pub fn count(&self) -> f64 {
        self.count
    }

    /// Mean position.
    pub fn mean(&self) -> DVec3 {
        self.position / self.count
    }

    /// Covariance of the positions.
    pub fn covariance(&self) -> Covariance {
        let mean = self.mean();
        let diagonal = self.outer[0] / self.count - mean * mean;
        let off = self.outer[1] / self.count - mean * mean.yzx();
        Covariance { matrix: symmetric(diagonal, off), least: OnceCell::new() }
    }

    /// Root mean square distance to the mean.
    pub fn spread(&self) -> f64 {
        let variance = self.outer[0] / self.count - self.mean() * self.mean();
        variance.element_sum().max(0.0).sqrt()
    }

    /// Σ n nᵀ, whose largest eigenvector is the mean normal up to sign.
    pub fn normal_scatter(&self) -> DMat3 {
        symmetric(self.quadric[0], self.quadric[1])
    }

    /// Bending of the surface along each of two directions across the mean normal, as a part of the greater
    /// of both: the root of the ratio of the normals' standard deviations, which is the factor by which a
    /// cluster has to be longer to deviate as much from its plane. 1 where it is flat.
    pub fn bending(&self, directions: [Vec3; 2]) -> [f32; 2] {
        let count = self.with_normal.max(1.0);
        let (mean, scatter) = (self.normal / count, self.normal_scatter() * (1.0 / count));
        let variance = directions.map(|t| {
            let t = t.as_dvec3();
            (t.dot(scatter * t) - mean.dot(t) * mean.dot(t)).max(0.0) + FLAT
        });
        let most = variance[0].max(variance[1]);
        variance.map(|v| (v / most).sqrt().sqrt() as f32)
    }

    /// Whether most vertices have a normal.
    pub fn has_normals(&self) -> bool {
        self.with_normal > 0.5 * self.count
    }

    /// Direction of the sum of the normals; zero where they cancel or there are none.
    pub fn mean_normal(&self) -> DVec3 {
        self.normal.try_normalize().unwrap_or(DVec3::ZERO)
    }

    /// Representative of the cluster: position, unit normal (zero where unknown), and the error of standing
    /// for the cluster.
    pub fn representative(&self) -> (Vec3, Vec3, f32) {
        self.representative_by(&self.covariance())
    }

    /// The cluster's representative, by a covariance that is known already.
    pub fn representative_by(&self, covariance: &Covariance) -> (Vec3, Vec3, f32) {
        let position = self.position();
        (position, self.mean_normal().as_vec3(), self.error(position, covariance) as f32)
    }

    /// Variance of the mean across the plane of least squares, as far as the vertices' distances from it
    /// tell; infinite where they do not, as of three vertices or fewer, or where the representative is not
    /// the mean, but placed by normals.
    pub fn variance_of_mean(&self, covariance: &Covariance) -> f32 {
        // A plane goes through three vertices.
        let free = self.count - 3.0;
        if free > 0.0 && self.with_normal == 0.0 {
            (covariance.least().max(0.0) / free) as f32
        } else {
            f32::INFINITY
        }
    }

    /// Error of standing for the cluster by one sample, a length in the model's unit.
    ///
    /// With normals √(d·ν·s), where d is the rms distance to the mean plane (L²), ν the rms deviation of the
    /// normals (L²·¹) and s the rms distance to the mean: the product of both metrics, as a length. For a
    /// patch of size h and curvature κ it behaves as κh², the height of the surface over its chord. Without
    /// normals d alone, which does so too. A part of the distance to the farthest corner of the box is added
    /// (see [`REACH_WEIGHT`]).
    fn error(&self, representative: Vec3, covariance: &Covariance) -> f64 {
        if self.count <= 1.0 {
            return 0.0;
        }
        let normal = self.mean_normal();
        let shape = if self.has_normals() {
            let spread = self.spread();
            let distance = normal.dot(covariance.matrix * normal).max(0.0).sqrt();
            let deviation = self.deviation();
            // Normals that cancel give no plane: then the extent itself is the distance.
            let distance = if normal == DVec3::ZERO { spread } else { distance };
            (distance * deviation * spread).sqrt()
        } else {
            covariance.least().sqrt()
        };
        shape + REACH_WEIGHT * self.reach(representative)
    }

    /// Error of the cluster if its vertices were of two sheets with opposite normals.
    pub fn error_of_two_sheets(&self, representative: Vec3) -> f64 {
        std::f64::consts::SQRT_2.sqrt() * self.spread() + REACH_WEIGHT * self.reach(representative)
    }

    /// Distance of a point in the box to its farthest corner.
    pub fn reach(&self, from: Vec3) -> f64 {
        (from - self.min).max(self.max - from).as_dvec3().length()
    }

    /// Root mean square deviation of the normals from their mean (L²·¹).
    pub fn deviation(&self) -> f64 {
        (2.0 * (1.0 - self.normal.length() / self.with_normal)).clamp(0.0, 2.0).sqrt()
    }

    /// The minimum of the quadric, inside the box of the vertices.
    fn position(&self) -> Vec3 {
        let mean = self.mean();
        let point = if self.with_normal > 0.0 {
            let a = self.normal_scatter();
            let ridge = DMat3::from_diagonal(DVec3::splat(QUADRIC_RIDGE * self.with_normal));
            let offset = (a + ridge).inverse() * (self.quadric_b - a * mean);
            mean + offset.clamp_length_max(self.spread())
        } else {
            mean
        };
        let point = if point.is_finite() { point } else { mean };
        point.as_vec3().clamp(self.min, self.max)
    }
}

/// The matrix of xx, yy, zz and xy, yz, zx.
pub(crate) fn symmetric(diagonal: DVec3, off: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(diagonal.x, off.x, off.z),
        DVec3::new(off.x, diagonal.y, off.y),
        DVec3::new(off.z, off.y, diagonal.z),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertices(f: impl Fn(f32, f32) -> (Vec3, Vec3)) -> Vec<Vertex> {
        let grid = |i: i32| i as f32 / 20.0 - 0.5;
        (0..21 * 21)
            .map(|i| f(grid(i % 21), grid(i / 21)))
            .map(|(position, normal)| Vertex { position, normal, index: 0 })
            .collect()
    }

    #[test]
    fn a_flat_cluster_has_the_error_of_its_reach_alone() {
        let m = Moments::from_elements(&vertices(|u, v| (Vec3::new(u, 3.0, v), Vec3::Y)));
        let (position, normal, error) = m.representative();
        assert!(position.distance(Vec3::Y * 3.0) < 1e-6 && normal == Vec3::Y);
        assert!((f64::from(error) - REACH_WEIGHT * 0.5f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn error_grows_with_the_square_of_the_size() {
        let bowl = |h: f32| {
            let m = Moments::from_elements(&vertices(|u, v| {
                let (x, z) = (u * h, v * h);
                (Vec3::new(x, 0.5 * (x * x + z * z), z), Vec3::new(-x, 1.0, -z).normalize_or(Vec3::Y))
            }));
            let (position, _, error) = m.representative();
            let reach = (position - m.min).max(m.max - position).length();
            f64::from(error) - REACH_WEIGHT * f64::from(reach)
        };
        let ratio = bowl(0.2) / bowl(0.1);
        assert!((3.0..5.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn groups_have_the_moments_of_their_vertices() {
        let all = vertices(|u, v| (Vec3::new(u, u * v, v), Vec3::new(v, 1.0, u).normalize_or(Vec3::Y)));
        let groups: Vec<Group> = all
            .chunks(21)
            .map(|row| {
                let mut group = Group::new(row[10].position, 0.8, 0);
                let mut sums = group.sums();
                row.iter().for_each(|s| sums.add(s.position, s.normal));
                group.set(&sums);
                group
            })
            .collect();
        let (of_vertices, of_groups) = (Moments::from_elements(&all), Moments::from_elements(&groups));
        let ((p, n, _), (q, m, _)) = (of_vertices.representative(), of_groups.representative());
        assert!(p.distance(q) < 1e-5 && n.distance(m) < 1e-5, "{p} {q}");
        assert!((of_vertices.covariance().matrix - of_groups.covariance().matrix).x_axis.length() < 1e-6);
        assert!(of_groups.min.cmple(of_vertices.min).all() && of_groups.max.cmpge(of_vertices.max).all());
        // A group of one sheet leaves the other to another.
        assert!(groups[0].sums().takes(Vec3::Y) && !groups[0].sums().takes(-Vec3::Y));
    }

    #[test]
    fn the_representative_of_a_corner_is_the_corner() {
        // Three faces of a cube that meet at (1, 1, 1): the mean is far inside.
        let corner: Vec<_> = [Vec3::X, Vec3::Y, Vec3::Z]
            .into_iter()
            .flat_map(|n| {
                vertices(move |u, v| {
                    let (a, b) = n.any_orthonormal_pair();
                    let p = Vec3::ONE - (a.abs() * (u + 0.5) + b.abs() * (v + 0.5));
                    (p, n)
                })
            })
            .collect();
        let m = Moments::from_elements(&corner);
        let (r, _, _) = m.representative();
        // The way is all of that from the mean but for the part that the ridge holds back, which is about its
        // own strength.
        let way = m.mean().distance(DVec3::ONE);
        assert!(way > 0.5 && f64::from(r.distance(Vec3::ONE)) < 4.0 * QUADRIC_RIDGE * way, "{r}");
    }

    #[test]
    fn merged_moments_are_those_of_the_union() {
        let all = vertices(|u, v| (Vec3::new(u, u * v, v), Vec3::new(v, 1.0, u).normalize_or(Vec3::Y)));
        let mut sum = Moments::from_elements(&all[..100]);
        sum.add(&Moments::from_elements(&all[100..]));
        let whole = Moments::from_elements(&all);
        assert!((sum.representative().2 - whole.representative().2).abs() < 1e-6);
        assert!(sum.mean().distance(whole.mean()) < 1e-6);
    }
}
