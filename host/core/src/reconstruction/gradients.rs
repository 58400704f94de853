//! The gradient of the deformation at each sample, from its neighbours before and after.
//!
//! An affine map is fitted to the neighbours by weighted least squares. Across the plane through them it is
//! held by a ridge to a prior, for a flat neighbourhood tells nothing there, and one that rolls gently little
//! but how the map bends, which looks like shear across the plane: the plane's normal goes to the new normal,
//! scaled by the root of the change of area, as a similarity does. Where the surface has relief, its
//! neighbours off the plane tell more than the prior, and outweigh it.

use glam::{DMat3, DQuat, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::Transport;
use super::sheets::Sheets;
use super::stencils::Stencils;
use crate::geometry::{hermite, symmetric_eigen};
use crate::sampling::SampleSet;

/// Neighbours in a fit: two rings.
const FIT_NEIGHBOURS: usize = 16;

/// Neighbours whose extent across their line is below this part of that along it are collinear.
const COLLINEAR: f64 = 1e-3;

/// Weight of the prior for the direction across, relative to the neighbours' whole spread.
const PRIOR: f64 = 3e-3;

/// Its weight where neighbours tell all they can, for each of their own weights: the square of what rounding
/// makes of how far they are off the plane, for a gradient that is off by a third.
const LEAST_PRIOR: f64 = 1e-13;

/// What rounding to single precision may leave over, in local units.
pub const ROUNDING: f64 = 5e-7;

/// Relief of this part of the whole spread tells on which side of the surface things come to lie.
const RELIEF: f64 = 4e-7;

/// What the fits give.
pub struct Gradients {
    /// Gradient of the deformation at each sample, held to the prior across.
    pub gradient: Vec<Mat3>,
    /// Unit normal of the deformed surface at each sample.
    pub normal: Vec<Vec3>,
    /// Whether the neighbours of each sample tell the sign of the gradient's determinant, which is otherwise
    /// positive.
    pub tells_side: Vec<bool>,
    /// Whether the deformation as a whole turns left into right: at most of the samples that tell.
    pub mirrored: bool,
}

impl Gradients {
    /// Fits all samples, to those of their own sheets first, which tell whom each may borrow besides.
    pub fn fit<'a>(samples: &SampleSet, sheets: &'a Sheets, deformed: &[Vec3]) -> (Self, Stencils<'a>) {
        let own = Stencils::own(sheets);
        let fit = |stencils: &Stencils<'_>, i: usize| {
            let (gradient, side) = fit_one(samples, stencils, deformed, i);
            (gradient.as_mat3(), side.map(|side| side as f32))
        };
        let mut fits: Vec<(Mat3, Option<f32>)> =
            (0..samples.len()).into_par_iter().map(|i| fit(&own, i)).collect();
        let stencils = Stencils::borrowing(samples, sheets, deformed, |i| fits[i].0);
        let again = stencils.borrowers().into_par_iter().map(|i| (i, fit(&stencils, i as usize)));
        for (i, fit) in again.collect::<Vec<_>>() {
            fits[i as usize] = fit;
        }
        let (gradient, sides): (Vec<Mat3>, Vec<Option<f32>>) = fits.into_iter().unzip();
        let mirrored = sides.iter().flatten().sum::<f32>() < 0.0;
        let tells_side = sides.iter().map(Option::is_some).collect();
        let turned = |(gradient, n): (&Mat3, &Vec3)| {
            let moved = Transport { displacement: Vec3::ZERO, gradient: *gradient };
            moved.normal(*n, mirrored).normalize_or(*n)
        };
        let normal = gradient.iter().zip(samples.normals()).map(turned).collect();
        (Self { gradient, normal, tells_side, mirrored }, stencils)
    }
}

/// The gradient at a sample, and, where its neighbours tell it, the sign of its determinant.
fn fit_one(
    samples: &SampleSet,
    stencils: &Stencils<'_>,
    deformed: &[Vec3],
    i: usize,
) -> (DMat3, Option<f64>) {
    let (near, radius) = stencils.around(&samples.positions, i, FIT_NEIGHBOURS);
    let (q, q_star) = (samples.positions[i], deformed[i]);
    if near.iter().all(|j| samples.positions[*j as usize] == deformed[*j as usize]) && q == q_star {
        return (DMat3::IDENTITY, Some(1.0));
    }

    let (mut a, mut b, mut weights) = (DMat3::ZERO, DMat3::ZERO, 0.0);
    for j in near {
        let j = *j as usize;
        let d = samples.positions[j] - q;
        let w = f64::from(hermite(d.length() / radius.max(f32::MIN_POSITIVE)));
        let (d, d_star) = (d.as_dvec3(), deformed[j].as_dvec3() - q_star.as_dvec3());
        a += outer(d, d) * w;
        b += outer(d_star, d) * w;
        weights += w;
    }

    let (spread, axes) = symmetric_eigen(a);
    let (across, e2, e1) = (axes.x_axis, axes.y_axis, axes.z_axis);
    if !(spread.z > 0.0 && spread.z.is_finite()) {
        return (DMat3::IDENTITY, None);
    }
    let v1 = b * e1 / spread.z;
    if spread.y > COLLINEAR * COLLINEAR * spread.z {
        let v2 = b * e2 / spread.y;
        let turned = v1.cross(v2);
        if let Some(normal) = turned.try_normalize() {
            // Right-handed, as the image is.
            let across = across * e1.cross(e2).dot(across).signum();
            let prior = normal * turned.length().sqrt();
            let whole = spread.x + spread.y + spread.z;
            let held = |ridge: f64| {
                (b + outer(prior, across) * ridge) * (a + outer(across, across) * ridge).inverse()
            };
            let explains = |f: DMat3| {
                near.iter().all(|j| {
                    let (j, q) = (*j as usize, q.as_dvec3());
                    let d_star = deformed[j].as_dvec3() - q_star.as_dvec3();
                    (f * (samples.positions[j].as_dvec3() - q) - d_star).length() < ROUNDING
                })
            };
            let side_of = |f: DMat3| (spread.x > RELIEF * whole).then(|| f.determinant().signum());
            // Where the prior explains all neighbours to rounding, the little that they tell is rounding;
            // where an affine map does, nearly without the prior, they tell that it is one.
            let by_prior = held(PRIOR * whole);
            if explains(by_prior) {
                return (by_prior, side_of(by_prior));
            }
            let by_neighbours = held(LEAST_PRIOR * weights);
            let f = if explains(by_neighbours) { by_neighbours } else { by_prior };
            if f.is_finite() {
                return (f, side_of(by_neighbours));
            }
        }
    }
    // Samples on a line, before or after: turned and stretched as the line is, by the least rotation.
    let along = match v1.try_normalize() {
        Some(v) => DMat3::from_quat(DQuat::from_rotation_arc(e1, v)) * v1.length(),
        None => DMat3::IDENTITY,
    };
    (along, None)
}

/// a bᵀ
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
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
        set.prepare();
        let sheets = Sheets::of(&set);
        let rotation = Quat::from_euler(glam::EulerRot::XYZ, 1.0, -2.0, 0.5);
        let map =
            Affine3A::from_scale_rotation_translation(Vec3::splat(1.7), rotation, Vec3::new(1.0, 2.0, 3.0));
        let deformed: Vec<Vec3> = set.positions.iter().map(|p| map.transform_point3(*p)).collect();
        let (gradients, _) = Gradients::fit(&set, &sheets, &deformed);
        let expected = Mat3::from_quat(rotation) * 1.7;
        for (i, f) in gradients.gradient.iter().enumerate() {
            // The images are rounded to about 2e-7, and neighbours may lie as little as 1e-3 off the plane.
            assert!(f.abs_diff_eq(expected, 1e-3), "{i}: {f} is not {expected}");
            assert!(gradients.normal[i].distance(rotation * set.normals()[i]) < 1e-3);
        }
    }

    #[test]
    fn degenerate_neighbourhoods_stay_bounded() {
        let line: Vec<Vec3> = (0..50).map(|i| Vec3::X * i as f32 / 50.0).collect();
        let set = SampleSet::new(line, Vec::new()).expect("samples");
        set.prepare();
        let sheets = Sheets::of(&set);
        let turned: Vec<Vec3> = set.positions.iter().map(|p| Vec3::new(0.0, 2.0 * p.x, 0.0)).collect();
        let collapsed = vec![Vec3::ONE; 50];
        for deformed in [turned, collapsed] {
            for f in Gradients::fit(&set, &sheets, &deformed).0.gradient {
                assert!(f.is_finite() && f.to_cols_array().iter().all(|x| x.abs() < 4.0), "{f}");
            }
        }
        let one = SampleSet::new(vec![Vec3::ONE], Vec::new()).expect("a sample");
        one.prepare();
        assert_eq!(Gradients::fit(&one, &Sheets::of(&one), &[Vec3::ZERO]).0.gradient[0], Mat3::IDENTITY);
    }
}
