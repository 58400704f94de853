//! The gradient of the deformation at each sample, from its neighbours before and after.
//!
//! Along the surface the images of the two tangents are fitted by weighted least squares. Across it nothing is
//! known but the surface's own turning and stretch: the normal goes to the new normal, scaled by the root of
//! the change of area. Rigid motions and similarities are reproduced exactly, because the same fit is made at
//! rest, which gives the plane to which the neighbours' offsets off the tangent plane tilt it.

use glam::{DMat2, DMat3, DQuat, DVec2, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use crate::geometry::{hermite, tangents};
use crate::sampling::SampleSet;

/// Neighbours in a fit: two rings.
const FIT_NEIGHBOURS: usize = 16;

/// Neighbours whose extent across their line is below this part of that along it are collinear.
const COLLINEAR: f64 = 1e-3;

/// What the fits give.
pub struct LocalFrames {
    /// Gradient of the deformation at each sample.
    pub gradient: Vec<Mat3>,
    /// Unit normal of the deformed surface at each sample.
    pub normal: Vec<Vec3>,
}

impl LocalFrames {
    /// Fits all samples.
    pub fn fit(samples: &SampleSet, deformed: &[Vec3]) -> Self {
        let (gradient, normal) = (0..samples.len())
            .into_par_iter()
            .map(|i| {
                let gradient = fit_one(samples, deformed, i).as_mat3();
                let at_rest = samples.normals[i];
                let moved = super::Transport { displacement: Vec3::ZERO, gradient };
                (gradient, moved.normal(at_rest).normalize_or(at_rest))
            })
            .unzip();
        Self { gradient, normal }
    }
}

fn fit_one(samples: &SampleSet, deformed: &[Vec3], i: usize) -> DMat3 {
    let normal = samples.normals[i];
    let near = samples.neighbours.of(i);
    let near = &near[..near.len().min(FIT_NEIGHBOURS)];
    let (q, q_star) = (samples.positions[i], deformed[i]);
    if near.iter().all(|j| samples.positions[*j as usize] == deformed[*j as usize]) && q == q_star {
        return DMat3::IDENTITY;
    }

    // One beyond the last neighbour used is where the kernel vanishes.
    let radius = samples.neighbours.of(i).get(near.len()).or(near.last()).map_or(0.0, |j| {
        samples.positions[*j as usize].distance(q) * if near.len() < FIT_NEIGHBOURS { 1.5 } else { 1.0 }
    });
    let (t1, t2) = tangents(normal);
    let mut a = DMat2::ZERO;
    let mut at_rest = [DVec3::ZERO; 2];
    let mut after = [DVec3::ZERO; 2];
    for j in near {
        let j = *j as usize;
        // Another sheet does not tell how this one is stretched.
        if samples.normals[j].dot(normal) <= 0.0 {
            continue;
        }
        let d = samples.positions[j] - q;
        let w = f64::from(hermite(d.length() / radius.max(f32::MIN_POSITIVE)));
        let x = DVec2::new(f64::from(d.dot(t1)), f64::from(d.dot(t2)));
        let (d, d_star) = (d.as_dvec3(), deformed[j].as_dvec3() - q_star.as_dvec3());
        a += DMat2::from_cols(x * x.x, x * x.y) * w;
        for (axis, x) in [x.x, x.y].into_iter().enumerate() {
            at_rest[axis] += d * (w * x);
            after[axis] += d_star * (w * x);
        }
    }
    // Principal directions of the neighbourhood in the tangent plane.
    let angle = 0.5 * (2.0 * a.x_axis.y).atan2(a.x_axis.x - a.y_axis.y);
    let (s, c) = angle.sin_cos();
    let along = |e: DVec2, m: [DVec3; 2]| m[0] * e.x + m[1] * e.y;
    let (e1, e2) = (DVec2::new(c, s), DVec2::new(-s, c));
    let (l1, l2) = (e1.dot(a * e1), e2.dot(a * e2));
    if l1 <= 0.0 || !l1.is_finite() {
        return DMat3::IDENTITY;
    }
    let (u1, v1) = (along(e1, at_rest) / l1, along(e1, after) / l1);
    if l2 > COLLINEAR * COLLINEAR * l1 {
        let (u2, v2) = (along(e2, at_rest) / l2, along(e2, after) / l2);
        let (m, m_star) = (u1.cross(u2), v1.cross(v2));
        let stretch = (m_star.length() / m.length()).sqrt();
        if let (Some(m), Some(m_star)) = (m.try_normalize(), m_star.try_normalize()) {
            let f = DMat3::from_cols(v1, v2, m_star * stretch) * DMat3::from_cols(u1, u2, m).inverse();
            if f.is_finite() {
                return f;
            }
        }
    }
    // Samples on a line, before or after: turned and stretched as the line is, by the least rotation.
    match (u1.try_normalize(), v1.try_normalize()) {
        (Some(u), Some(v)) => DMat3::from_quat(DQuat::from_rotation_arc(u, v)) * (v1.length() / u1.length()),
        _ => DMat3::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Quat};

    /// A curved patch with irregular samples.
    fn patch() -> Vec<Vec3> {
        (0..900)
            .map(|i| {
                let jitter = |k: u32| ((i as u32 * 7919 + k * 104729) % 1000) as f32 / 4000.0;
                let (x, y) = ((i % 30) as f32 + jitter(1), (i / 30) as f32 + jitter(2));
                Vec3::new(x / 30.0, 0.3 * (x / 10.0).sin() + 0.01 * y, y / 30.0)
            })
            .collect()
    }

    #[test]
    fn similarities_are_exact() {
        let set = SampleSet::new(patch(), Vec::new()).expect("samples");
        let rotation = Quat::from_euler(glam::EulerRot::XYZ, 1.0, -2.0, 0.5);
        let map =
            Affine3A::from_scale_rotation_translation(Vec3::splat(1.7), rotation, Vec3::new(1.0, 2.0, 3.0));
        let deformed: Vec<Vec3> = set.positions.iter().map(|p| map.transform_point3(*p)).collect();
        let frames = LocalFrames::fit(&set, &deformed);
        let expected = Mat3::from_quat(rotation) * 1.7;
        for (i, f) in frames.gradient.iter().enumerate() {
            assert!(f.abs_diff_eq(expected, 2e-4), "{i}: {f} is not {expected}");
            assert!(frames.normal[i].distance(rotation * set.normals[i]) < 1e-4);
        }
    }

    #[test]
    fn degenerate_neighbourhoods_stay_bounded() {
        let line: Vec<Vec3> = (0..50).map(|i| Vec3::X * i as f32 / 50.0).collect();
        let set = SampleSet::new(line, Vec::new()).expect("samples");
        let turned: Vec<Vec3> = set.positions.iter().map(|p| Vec3::new(0.0, 2.0 * p.x, 0.0)).collect();
        let collapsed = vec![Vec3::ONE; 50];
        for deformed in [turned, collapsed] {
            for f in LocalFrames::fit(&set, &deformed).gradient {
                assert!(f.is_finite() && f.to_cols_array().iter().all(|x| x.abs() < 4.0), "{f}");
            }
        }
        let one = SampleSet::new(vec![Vec3::ONE], Vec::new()).expect("a sample");
        assert_eq!(LocalFrames::fit(&one, &[Vec3::ZERO]).gradient[0], Mat3::IDENTITY);
    }
}
