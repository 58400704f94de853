//! Linear maps of the surface around samples by the steps: for the eye, and for points that are carried
//! over between samples.

use crate::scene::ViewerScene;
use glam::{Mat3, Vec3};

/// Number of neighbours to which the map around a sample is fitted.
const RING: usize = 12;

/// Linear map of the surface around a sample; nothing where the neighbours do not determine it.
pub fn around(scene: &ViewerScene, i: usize) -> Option<Mat3> {
    let samples = &scene.sampled.samples;
    let neighbours = samples.neighbours();
    let near = &neighbours.nearest_to(i)[..RING.min(neighbours.k())];
    tangent_map(&samples.positions, &scene.positions, i, near, samples.normals()[i])
}

/// Linear map that carries the vectors to the neighbours over best, in the least squares along the tangent
/// plane; neighbours without a position in `now` are left out. The map is fitted to displacements, so that
/// nothing is stretched where nothing moves. Nothing where the neighbours lie on a line.
pub fn tangent_map(rest: &[Vec3], now: &[Vec3], i: usize, near: &[u32], n: Vec3) -> Option<Mat3> {
    let (s, t) = n.try_normalize()?.any_orthonormal_pair();
    let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
    let (mut u, mut v) = (Vec3::ZERO, Vec3::ZERO);
    for j in near.iter().filter(|j| (**j as usize) < now.len()) {
        let (r, d) = (rest[*j as usize] - rest[i], now[*j as usize] - now[i]);
        let (x, y) = (r.dot(s), r.dot(t));
        (a, b, c) = (a + x * x, b + x * y, c + y * y);
        (u, v) = (u + (d - r) * x, v + (d - r) * y);
    }
    let determinant = a * c - b * b;
    if determinant <= 1e-5 * a * c {
        return None;
    }
    let (along_s, along_t) = ((u * c - v * b) / determinant, (v * a - u * b) / determinant);
    let slope = Mat3::from_cols(along_s, along_t, Vec3::ZERO) * Mat3::from_cols(s, t, n).transpose();
    Some(Mat3::IDENTITY + slope)
}
