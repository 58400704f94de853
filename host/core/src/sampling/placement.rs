//! Samples placed by the faces of P_L: each at the minimum of the quadric of the planes around it, weighted by area (M. Garland,
//! P. Heckbert 1997; P. Lindstrom, *Out-of-Core Simplification of Large Polygonal Models*, 2000), held by a small ridge to where
//! its vertices alone have placed it.
//!
//! Faces tell where the surface is when normals do not: where there are none, or those of a smoother surface.

use glam::{DMat3, DVec3, Vec3, Vec3A, Vec3Swizzles, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cluster::symmetric;

/// Strength of the ridge, relative to the trace of the quadric.
const RIDGE: f64 = 3e-4;

/// What tells where in its cluster a sample lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// The planes of the faces, where the model has any: they take a pass, and temporary files of at most 20 bytes per vertex.
    Faces,
    /// The tangent planes of the vertices that have normals; without, their mean.
    #[default]
    Vertices,
}

impl Placement {
    /// As it is called in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Faces => "faces",
            Self::Vertices => "vertices",
        }
    }
}

/// The planes of the faces around each sample's cluster, summed up.
///
/// Memory: 48 bytes per sample.
pub struct Planes<'a> {
    /// Where the vertices of P_L are, local coordinates.
    vertices: &'a [Vec3],
    /// Where the samples are by their vertices.
    samples: &'a [Vec3],
    /// The number of the first of these: those before it stay where they are.
    first: u32,
    quadrics: Vec<Quadric>,
}

/// Σ w (n·(x − p))² as a function of x, about a sample: sums in single precision over the faces around it.
#[derive(Clone, Copy, Default)]
struct Quadric {
    /// Σ w n nᵀ: xx, yy, zz, and Σ w |p|² for corners p in the sample's cluster.
    squares: Vec4,
    /// Σ w n nᵀ: xy, yz, zx.
    products: Vec4,
    /// Σ w n (n·p).
    toward: Vec4,
}

impl<'a> Planes<'a> {
    /// Of no face yet, around the samples from number `first` on.
    pub fn new(vertices: &'a [Vec3], samples: &'a [Vec3], first: u32) -> Self {
        Self { vertices, samples, first, quadrics: vec![Quadric::default(); samples.len()] }
    }

    /// Adds a face across the border of clusters, once, to each sample that one of its corners belongs to. The triangles of P_S
    /// reach from sample to sample, and so a surface fits them best that is known where clusters meet: faces inside of them
    /// add nothing to that, and would take most of the time.
    #[inline]
    pub fn take(&mut self, corners: [u32; 3], of: [u32; 3]) {
        if of[0] == of[1] && of[1] == of[2] {
            return;
        }
        let [a, b, c] = corners.map(|vertex| Vec3A::from(self.vertices[vertex as usize]));
        // Its length is twice the area.
        let across = (b - a).cross(c - a);
        let normal = across * across.length_recip();
        // Neither are corners without a finite position.
        if !normal.is_finite() {
            return;
        }
        let plane = Quadric {
            squares: (across * normal).extend(0.0),
            products: (across * normal.yzx()).extend(0.0),
            toward: across.extend(0.0),
        };
        self.add(of[0], &plane, normal, a);
        if of[1] != of[0] {
            self.add(of[1], &plane, normal, b);
        }
        if of[2] != of[0] && of[2] != of[1] {
            self.add(of[2], &plane, normal, c);
        }
    }

    #[inline(always)]
    fn add(&mut self, sample: u32, plane: &Quadric, normal: Vec3A, corner: Vec3A) {
        let place = sample.wrapping_sub(self.first) as usize;
        let Some((sample, quadric)) = self.samples.get(place).zip(self.quadrics.get_mut(place)) else {
            return;
        };
        let p = corner - Vec3A::from(*sample);
        let weight = plane.squares.x + plane.squares.y + plane.squares.z;
        quadric.squares += plane.squares + Vec4::new(0.0, 0.0, 0.0, weight * p.length_squared());
        quadric.products += plane.products;
        quadric.toward += plane.toward * normal.dot(p);
    }

    /// Where the samples are by the faces: as far from where they were as the corners in their clusters are (rms), and as
    /// `most` allows, at most.
    pub fn place(self, most: impl Fn(usize) -> f32 + Sync) -> Vec<Vec3> {
        let moved = |(i, (quadric, sample)): (usize, (&Quadric, &Vec3))| {
            let way = quadric.least();
            let most = quadric.radius().min(f64::from(most(i)));
            // Around some there are no planes.
            if way.is_finite() && most > 0.0 {
                (sample.as_dvec3() + way.clamp_length_max(most)).as_vec3()
            } else {
                *sample
            }
        };
        self.quadrics.par_iter().zip(self.samples).enumerate().map(moved).collect()
    }
}

impl Quadric {
    /// Σ w: normals are of unit length.
    fn weight(&self) -> f64 {
        self.squares.as_dvec4().truncate().element_sum()
    }

    fn radius(&self) -> f64 {
        (f64::from(self.squares.w) / self.weight()).max(0.0).sqrt()
    }

    /// Its minimum, with the ridge.
    fn least(&self) -> DVec3 {
        let scale = self.weight().recip();
        let [squares, products, toward] =
            [self.squares, self.products, self.toward].map(|sum| sum.as_dvec4().truncate() * scale);
        let ridge = DMat3::from_diagonal(DVec3::splat(RIDGE));
        (symmetric(squares, products) + ridge).inverse() * toward
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The faces of a fan about the first vertex, all corners of one sample.
    fn placed(vertices: &[Vec3], faces: &[[u32; 3]], sample: Vec3, most: f32) -> Vec3 {
        let samples = [sample];
        let mut planes = Planes::new(vertices, &samples, 7);
        for corners in faces {
            // With samples before and behind, which are none of these.
            planes.take(*corners, [7, 7, 6]);
            planes.take(*corners, [6, 8, u32::MAX]);
            // Inside, it is for no triangle of P_S.
            planes.take([1, 2, 3], [7; 3]);
        }
        planes.place(|_| most)[0]
    }

    /// Three sides of a cube meet at (1, 1, 1).
    const CORNER: [Vec3; 4] =
        [Vec3::ONE, Vec3::new(0.0, 1.0, 1.0), Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 1.0, 0.0)];
    const SIDES: [[u32; 3]; 3] = [[0, 1, 2], [0, 2, 3], [0, 3, 1]];

    #[test]
    fn a_corner_is_found_as_far_as_may_be_gone() {
        let mean = Vec3::splat(0.75);
        let found = placed(&CORNER, &SIDES, mean, f32::INFINITY);
        assert!(found.distance(Vec3::ONE) < 2e-3, "{found}");
        let found = placed(&CORNER, &SIDES, mean, 0.1);
        assert!((found.distance(mean) - 0.1).abs() < 1e-6 && found.distance(Vec3::ONE) < 0.34, "{found}");
        // Not beyond the corners' own distance.
        let away = Vec3::splat(-9.0);
        let radius = CORNER.iter().map(|p| p.distance(away)).fold(0.0, f32::max);
        assert!(placed(&CORNER, &SIDES, away, f32::INFINITY).distance(away) <= radius);
    }

    #[test]
    fn across_a_plane_it_is_the_plane_and_along_it_nothing_moves() {
        let found = placed(&CORNER, &SIDES[..1], Vec3::new(0.5, 0.6, 0.7), f32::INFINITY);
        assert!(found.distance(Vec3::new(0.5, 0.6, 1.0)) < 2e-4, "{found}");
    }

    #[test]
    fn what_is_no_face_tells_nothing() {
        let mut vertices = CORNER.to_vec();
        vertices.extend([Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e30), Vec3::splat(1e-30)]);
        let sample = Vec3::splat(0.75);
        let none = [[0, 0, 1], [2, 2, 2], [0, 1, 4], [5, 1, 2], [0, 6, 0], [7, 7, 7]];
        assert_eq!(placed(&vertices, &none, sample, f32::INFINITY), sample);
        let all = [&SIDES[..], &none[..]].concat();
        assert_eq!(
            placed(&vertices, &all, sample, f32::INFINITY),
            placed(&vertices, &SIDES, sample, f32::INFINITY)
        );
        // Sums beyond what a number holds.
        let far = placed(&vertices, &[[0, 1, 6], [2, 6, 3]], sample, f32::INFINITY);
        assert!(far.is_finite(), "{far}");
    }
}
