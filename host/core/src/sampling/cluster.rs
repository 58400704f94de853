//! What is known of a cluster of samples: its moments, from which its error and its representative follow.
//!
//! The error is the product of the L² metric (distance to the mean plane) and the L²·¹ metric (deviation of the
//! normals), D. Cohen-Steiner, P. Alliez, M. Desbrun, *Variational Shape Approximation*, 2004, as paper §4
//! proposes. The representative minimises the quadric of the samples' tangent planes (M. Garland,
//! P. Heckbert 1997; P. Lindstrom 2000), held to the mean by a small ridge.

use glam::{DMat3, DVec3, Vec3};

use crate::geometry::symmetric_eigen;

/// A sample of P_L inside a cell: position relative to the model's origin, and unit normal.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Sample {
    /// Position in local coordinates.
    pub position: Vec3,
    /// Unit normal, or zero where the model has none (or none that is finite) at this vertex.
    pub normal: Vec3,
}

/// How much of a cluster's extent counts as error, whatever its shape: it bounds the spacing where the surface
/// is flat and any geometric error is zero, for a deformation need not be flat there.
const SPREAD_WEIGHT: f64 = 0.1;

/// Strength of the ridge towards the mean, relative to the trace of the quadric: weaker ones follow smooth surfaces
/// more closely, but throw samples off surfaces with steep relief.
const QUADRIC_RIDGE: f64 = 1e-2;

/// Additive moments of a cluster, about the model's origin.
#[derive(Debug, Clone, Copy)]
pub struct Moments {
    /// Corner of least coordinates.
    pub min: Vec3,
    /// Corner of greatest coordinates.
    pub max: Vec3,
    count: f64,
    position: DVec3,
    /// Σ p pᵀ: xx, yy, zz and xy, xz, yz.
    outer: [DVec3; 2],
    normal: DVec3,
    /// Σ n nᵀ, likewise.
    quadric: [DVec3; 2],
    /// Σ n (n·p).
    quadric_b: DVec3,
    /// Number of samples with a normal.
    with_normal: f64,
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
    /// The moments of a set of samples.
    pub fn of(samples: &[Sample]) -> Self {
        let mut m = Self::default();
        for s in samples {
            m.min = m.min.min(s.position);
            m.max = m.max.max(s.position);
            let (p, n) = (s.position.as_dvec3(), s.normal.as_dvec3());
            m.position += p;
            m.outer[0] += p * p;
            m.outer[1] += DVec3::new(p.x * p.y, p.x * p.z, p.y * p.z);
            m.normal += n;
            m.quadric[0] += n * n;
            m.quadric[1] += DVec3::new(n.x * n.y, n.x * n.z, n.y * n.z);
            m.quadric_b += n * n.dot(p);
            m.with_normal += n.length_squared();
        }
        m.count = samples.len() as f64;
        m
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

    /// Mean position.
    pub fn mean(&self) -> DVec3 {
        self.position / self.count
    }

    /// Covariance of the positions.
    pub fn covariance(&self) -> DMat3 {
        let mean = self.mean();
        let cross = DVec3::new(mean.x * mean.y, mean.x * mean.z, mean.y * mean.z);
        symmetric(self.outer[0] / self.count - mean * mean, self.outer[1] / self.count - cross)
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

    /// Whether most samples have a normal.
    pub fn has_normals(&self) -> bool {
        self.with_normal > 0.5 * self.count
    }

    /// Direction of the sum of the normals; zero where they cancel or there are none.
    pub fn mean_normal(&self) -> DVec3 {
        self.normal.try_normalize().unwrap_or(DVec3::ZERO)
    }

    /// Error of standing for the cluster by one sample, a length in the model's unit.
    ///
    /// With normals √(d·ν·s), where d is the rms distance to the mean plane (L²), ν the rms deviation of the
    /// normals (L²·¹) and s the rms distance to the mean: the product of both metrics, as a length. For a patch of
    /// size h and curvature κ it behaves as κh², the height of the surface over its chord. Without normals
    /// d alone, which does so too. A part of s is added (see `SPREAD_WEIGHT`).
    pub fn error(&self) -> f64 {
        if self.count <= 1.0 {
            return 0.0;
        }
        let covariance = self.covariance();
        let spread = self.spread();
        let normal = self.mean_normal();
        let shape = if self.has_normals() {
            let distance = normal.dot(covariance * normal).max(0.0).sqrt();
            let deviation = (2.0 * (1.0 - self.normal.length() / self.with_normal)).clamp(0.0, 2.0).sqrt();
            // Normals that cancel give no plane: then the extent itself is the distance.
            let distance = if normal == DVec3::ZERO { spread } else { distance };
            (distance * deviation * spread).sqrt()
        } else {
            symmetric_eigen(covariance).0.x.max(0.0).sqrt()
        };
        shape + SPREAD_WEIGHT * spread
    }

    /// The point that stands for the cluster, inside the box of its samples.
    pub fn representative(&self) -> Vec3 {
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

fn symmetric(diagonal: DVec3, off: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(diagonal.x, off.x, off.y),
        DVec3::new(off.x, diagonal.y, off.z),
        DVec3::new(off.y, off.z, diagonal.z),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(f: impl Fn(f32, f32) -> (Vec3, Vec3)) -> Vec<Sample> {
        let grid = |i: i32| i as f32 / 20.0 - 0.5;
        (0..21 * 21)
            .map(|i| f(grid(i % 21), grid(i / 21)))
            .map(|(position, normal)| Sample { position, normal })
            .collect()
    }

    #[test]
    fn a_flat_cluster_has_the_error_of_its_spread_alone() {
        let m = Moments::of(&samples(|u, v| (Vec3::new(u, 3.0, v), Vec3::Y)));
        let spread = m.covariance().x_axis.x * 2.0;
        assert!((m.error() - SPREAD_WEIGHT * spread.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn error_grows_with_the_square_of_the_size() {
        let bowl = |h: f32| {
            let m = Moments::of(&samples(|u, v| {
                let (x, z) = (u * h, v * h);
                (Vec3::new(x, 0.5 * (x * x + z * z), z), Vec3::new(-x, 1.0, -z).normalize_or(Vec3::Y))
            }));
            let covariance = m.covariance();
            m.error() - SPREAD_WEIGHT * (covariance * DVec3::ONE).dot(DVec3::ONE).sqrt()
        };
        let ratio = bowl(0.2) / bowl(0.1);
        assert!((3.0..5.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn the_representative_of_a_corner_is_the_corner() {
        // Three faces of a cube that meet at (1, 1, 1): the mean is far inside.
        let corner: Vec<_> = [Vec3::X, Vec3::Y, Vec3::Z]
            .into_iter()
            .flat_map(|n| {
                samples(move |u, v| {
                    let (a, b) = n.any_orthonormal_pair();
                    let p = Vec3::ONE - (a.abs() * (u + 0.5) + b.abs() * (v + 0.5));
                    (p, n)
                })
            })
            .collect();
        let m = Moments::of(&corner);
        let r = m.representative();
        // All the way from the mean but for what the ridge holds back, which is about its own strength.
        let way = m.mean().distance(DVec3::ONE);
        assert!(way > 0.5 && f64::from(r.distance(Vec3::ONE)) < 4.0 * QUADRIC_RIDGE * way, "{r}");
    }

    #[test]
    fn merged_moments_are_those_of_the_union() {
        let all = samples(|u, v| (Vec3::new(u, u * v, v), Vec3::new(v, 1.0, u).normalize_or(Vec3::Y)));
        let mut sum = Moments::of(&all[..100]);
        sum.add(&Moments::of(&all[100..]));
        let whole = Moments::of(&all);
        assert!((sum.error() - whole.error()).abs() < 1e-12);
        assert!(sum.mean().distance(whole.mean()) < 1e-12);
    }
}
