//! Transfer by a partition of unity of local Taylor expansions ("jets").
//!
//! Around each sample the deformation is expanded to second order in all three directions, by least squares over
//! the sample's neighbours at rest and deformed. A vertex goes where the blend of the nearest expansions
//! takes it: p* = Σ wᵢ(p)·Jᵢ(p) / Σ wᵢ(p). The first-order case is the form of embedded deformation
//! (R. Sumner, J. Schmid, M. Pauly, *Embedded Deformation for Shape Manipulation*, 2007).
//!
//! The fit is of what the affine maps of [`local_frames`](super::local_frames) leave over, with a small ridge towards
//! nothing: where the neighbours do not tell, as across a flat neighbourhood, those maps stand. They reproduce
//! similarities exactly, and so does this.

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::local_frames::LocalFrames;
use super::neighbours::{Neighbourhood, same_sheet};
use super::{DeformationField, Transport};
use crate::geometry::{hermite, solve_positive_definite};
use crate::sampling::SampleSet;

/// Samples that are blended at a vertex.
pub const BLENDED: usize = 6;

/// Neighbours in a fit: three times its terms.
const FIT_NEIGHBOURS: usize = 28;

/// Ridge relative to terms of the size of the neighbourhood.
const RIDGE: f64 = 1e-7;

/// What rounding to single precision may leave over of an affine map, in local units: nothing to expand.
const ROUNDING: f64 = 5e-7;

/// Terms of a second-order expansion without its constant.
const TERMS: usize = 9;

/// The expansion at a sample: J(p) = q* + F·d + Σ Hₐᵦ dₐ dᵦ with d = p − q.
///
/// Memory: 112 bytes.
#[derive(Debug, Clone, Copy)]
pub struct Jet {
    /// F.
    gradient: Mat3,
    /// H: xx, yy, zz and the sums of both mixed terms xy, xz, yz.
    second: [Vec3; 6],
    /// Square of the neighbourhood's radius, up to which the second order is known.
    reach: f32,
}

impl Jet {
    /// From the sample's displacement to that of a point at `d` from it, and the gradient there.
    fn at(&self, d: Vec3) -> (Vec3, Mat3) {
        let [xx, yy, zz, xy, xz, yz] = self.second;
        // Beyond its reach, where no neighbour told, the second order stays what it is there; its slope with it, which
        // only normals see.
        let damped = (self.reach / d.length_squared()).min(1.0);
        let h = Mat3::from_cols(
            2.0 * xx * d.x + xy * d.y + xz * d.z,
            xy * d.x + 2.0 * yy * d.y + yz * d.z,
            xz * d.x + yz * d.y + 2.0 * zz * d.z,
        ) * damped;
        (self.gradient * d - d + 0.5 * (h * d), self.gradient + h)
    }
}

/// Expands the deformation at all samples.
pub fn expand(samples: &SampleSet, deformed: &[Vec3], frames: &LocalFrames) -> Vec<Jet> {
    (0..samples.len()).into_par_iter().map(|i| fit(samples, deformed, frames.gradient[i], i)).collect()
}

fn fit(samples: &SampleSet, deformed: &[Vec3], gradient: Mat3, i: usize) -> Jet {
    let (near, radius) = samples.around(i, FIT_NEIGHBOURS);
    let (q, q_star) = (samples.positions[i], deformed[i]);
    let affine = Jet { gradient, second: [Vec3::ZERO; 6], reach: radius * radius };
    let scale = 1.0 / f64::from(radius);
    if !scale.is_finite() {
        return affine;
    }

    let prior = gradient.as_dmat3();
    let mut matrix = [[0.0; TERMS]; TERMS];
    let mut right = [DVec3::ZERO; TERMS];
    let (mut weights, mut largest) = (0.0, 0.0f64);
    for j in near {
        let j = *j as usize;
        if !same_sheet(samples.normals()[j], samples.normals()[i]) {
            continue;
        }
        let d = (samples.positions[j] - q).as_dvec3();
        let left_over = deformed[j].as_dvec3() - q_star.as_dvec3() - prior * d;
        let w = f64::from(hermite((d.length() * scale) as f32));
        let DVec3 { x, y, z } = d * scale;
        let terms = [x, y, z, x * x, y * y, z * z, x * y, x * z, y * z];
        for (a, term) in terms.iter().enumerate() {
            for (b, other) in terms[..=a].iter().enumerate() {
                matrix[a][b] += w * term * other;
            }
            right[a] += left_over * (w * term);
        }
        weights += w;
        largest = largest.max(left_over.length());
    }
    if largest < ROUNDING {
        return affine;
    }
    for (a, row) in matrix.iter_mut().enumerate() {
        row[a] += RIDGE * weights;
    }
    let Some(c) = solve_positive_definite(matrix, right) else { return affine };
    let first = |a: usize| (c[a] * scale).as_vec3();
    let second = |a: usize| (c[a] * scale * scale).as_vec3();
    let jet = Jet {
        gradient: gradient + Mat3::from_cols(first(0), first(1), first(2)),
        second: [second(3), second(4), second(5), second(6), second(7), second(8)],
        ..affine
    };
    if jet.gradient.is_finite() && jet.second.iter().all(|h| h.is_finite()) { jet } else { affine }
}

/// Carries a vertex over.
pub fn transport(field: &DeformationField, around: &Neighbourhood, p: Vec3) -> Transport {
    let (mut displacement, mut gradient, mut sum) = (Vec3::ZERO, Mat3::ZERO, 0.0);
    for &(i, w) in around.weighted() {
        let i = i as usize;
        let q = field.samples.positions[i];
        let (beyond, slope) = field.jets[i].at(p - q);
        displacement += w * (field.deformed[i] - q + beyond);
        gradient += w * slope;
        sum += w;
    }
    Transport { displacement: displacement / sum, gradient: gradient * (1.0 / sum) }
}

#[cfg(test)]
mod tests {
    use super::super::{Method, Walk};
    use super::*;
    use glam::Mat3;

    /// A curved patch with irregular samples, and points on it between them.
    fn patch(n: usize) -> impl Iterator<Item = Vec3> {
        (0..n * n).map(move |i| {
            let jitter = |k: u32| ((i as u32 * 7919 + k * 104_729) % 1000) as f32 / 1500.0;
            let (x, y) = ((i % n) as f32 + jitter(1), (i / n) as f32 + jitter(2));
            let (x, y) = (x / n as f32, y / n as f32);
            Vec3::new(x, 0.1 * (6.0 * x).sin() + 0.07 * (9.0 * y).cos(), y)
        })
    }

    fn worst(map: impl Fn(Vec3) -> Vec3) -> f32 {
        let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
        let deformed: Vec<Vec3> = set.positions.iter().map(|p| map(*p)).collect();
        let field = DeformationField::new(&set, &deformed, Method::BlendedJets);
        let mut walk = Walk::default();
        let inner = patch(97).filter(|p| p.x.min(p.z) > 0.05 && p.x.max(p.z) < 0.95);
        inner
            .map(|p| (p + field.transport(p, None, &mut walk).displacement).distance(map(p)))
            .fold(0.0, f32::max)
    }

    #[test]
    fn affine_and_quadratic_maps_are_reproduced() {
        let m = Mat3::from_cols_array(&[1.2, 0.3, -0.1, 0.2, 0.8, 0.4, -0.3, 0.1, 1.1]);
        let affine = worst(|p| m * p + Vec3::ONE);
        assert!(affine < 1e-6, "{affine}");
        assert!(worst(|p| p + Vec3::new(p.z * p.z, p.x * p.y, 0.5 * p.x * p.z)) < 2e-5);
    }

    #[test]
    fn a_smooth_map_is_followed_to_third_order() {
        let twist = |p: Vec3| glam::Quat::from_rotation_z(2.0 * p.z) * p;
        assert!(worst(twist) < 1e-4, "{}", worst(twist));
    }

    #[test]
    fn nothing_leaves_the_range_of_the_samples_by_much() {
        // A step: half of the samples jump by one.
        let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
        let step = |p: Vec3| if p.x > 0.5 { Vec3::Y } else { Vec3::ZERO };
        let deformed: Vec<Vec3> = set.positions.iter().map(|p| *p + step(*p)).collect();
        let field = DeformationField::new(&set, &deformed, Method::BlendedJets);
        let mut walk = Walk::default();
        for p in patch(97) {
            let y = field.transport(p, None, &mut walk).displacement.y;
            assert!((-0.5..1.5).contains(&y), "{p}: {y}");
        }
    }
}
