//! The gradient of the deformation at each sample, from its neighbours before and after.
//!
//! An affine map is fitted to the neighbours by weighted least squares. Across the plane through them it is
//! held by a ridge to a prior, for a flat neighbourhood tells nothing there, and one that rolls gently little
//! but how the map bends, which looks like shear across the plane: the plane's normal goes to the new normal,
//! scaled by the root of the change of area, as a similarity does. Where the surface has relief, its
//! neighbours off the plane tell more than the prior, and outweigh it.
//!
//! As many samples are fitted at once as the processor's vector registers take, each by the same operations
//! in the same order on any processor.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use glam::{DMat3, DQuat, DVec3, Mat3, Vec3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::long_list::LongList;

use super::expansion::ROUNDING;
use super::packets::{NeighbourPacket, Neighbours, triple};
use super::sheets::Sheets;
use super::stencils::Stencils;
use super::transport::Transport;
use crate::double_lanes::{DoubleLanes, DoubleMask, MOST_LANES, Triple, kernel, square};
use crate::eigen_lanes::{cross, dot, symmetric_eigen};
use crate::sampling::SampleSet;

/// Neighbours in a fit: two rings.
const FIT_NEIGHBOURS: usize = 16;

/// Samples that are fitted by one job.
const TOGETHER: usize = 64;

/// Neighbours whose extent across their line is below this part of that along it are collinear.
const COLLINEAR: f64 = 1e-3;

/// Weight of the prior for the direction across, relative to the neighbours' whole spread.
const PRIOR: f64 = 3e-3;

/// Weight of the prior where neighbours tell all they can, for each of their own weights: the square of the
/// rounding of their distances from the plane, for a gradient that is off by a third.
const LEAST_PRIOR: f64 = 1e-13;

/// Relief, as a part of the whole spread, that tells on which side of the surface the deformed neighbours
/// lie.
const RELIEF: f64 = 4e-7;

/// Gradients and normals of the fits at all samples.
#[derive(Default)]
pub struct Gradients {
    /// Gradient of the deformation at each sample, held to the prior across.
    pub gradient: LongList<Mat3>,
    /// Unit normal of the deformed surface at each sample.
    pub normal: Vec<Vec3>,
    /// Whether the neighbours of each sample tell the sign of the gradient's determinant, which is otherwise
    /// positive.
    pub tells_side: Vec<bool>,
    /// Whether the deformation as a whole turns left into right: at most of the samples whose neighbours tell
    /// the sign.
    pub mirrored: bool,
}

impl Gradients {
    /// Fits all samples, to those of their own sheets first; these fits tell the samples that each may borrow
    /// besides.
    pub fn fit<'a>(samples: &SampleSet, sheets: &'a Sheets, deformed: &[Vec3]) -> (Self, Stencils<'a>) {
        let own = Stencils::own(sheets);
        // The system's own zeros: the threads that fit touch them first.
        let mut gradient = LongList::<Mat3>::zeros(samples.len(), samples.storage());
        let mut sides = vec![None; samples.len()];
        let jobs = gradient.par_chunks_mut(TOGETHER).zip(sides.par_chunks_mut(TOGETHER)).enumerate();
        jobs.for_each(|(chunk, (gradient, sides))| {
            samples.storage().gone_through(size_of_val(gradient) + own.bytes_of(gradient.len()));
            let mut fits = [(Mat3::IDENTITY, None); TOGETHER];
            let fits = &mut fits[..gradient.len()];
            let all: [u32; TOGETHER] = std::array::from_fn(|at| (chunk * TOGETHER + at) as u32);
            let all = &all[..gradient.len()];
            Arch::new().dispatch(Fits { samples, stencils: &own, deformed, all, fits });
            for (at, fit) in fits.iter().enumerate() {
                (gradient[at], sides[at]) = *fit;
            }
        });
        let stencils = Stencils::borrowing(samples, sheets, deformed, |i| gradient[i]);
        let borrowers = stencils.borrowers();
        let mut again = vec![(Mat3::IDENTITY, None); borrowers.len()];
        again.par_chunks_mut(TOGETHER).zip(borrowers.par_chunks(TOGETHER)).for_each(|(fits, all)| {
            Arch::new().dispatch(Fits { samples, stencils: &stencils, deformed, all, fits });
        });
        for (i, fit) in borrowers.into_iter().zip(again) {
            (gradient[i as usize], sides[i as usize]) = fit;
        }
        let mirrored = sides.iter().flatten().sum::<f32>() < 0.0;
        let tells_side = sides.iter().map(Option::is_some).collect();
        let turned = |(gradient, n): (&Mat3, &Vec3)| {
            let moved = Transport { displacement: Vec3::ZERO, gradient: *gradient };
            moved.normal(*n, mirrored).normalize_or(*n)
        };
        let normal = gradient.par_iter().zip(samples.normals()).map(turned).collect();
        (Self { gradient, normal, tells_side, mirrored }, stencils)
    }
}

/// The gradient at a sample, and, where its neighbours tell it, the sign of its determinant.
type Fit = (Mat3, Option<f32>);

/// Fits samples, one fit for each.
struct Fits<'a> {
    samples: &'a SampleSet,
    stencils: &'a Stencils<'a>,
    deformed: &'a [Vec3],
    all: &'a [u32],
    fits: &'a mut [Fit],
}

impl WithSimd for Fits<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { samples, stencils, deformed, all, fits } = self;
        let (mut neighbours, positions) = (Neighbours::default(), &samples.positions[..]);
        for at in (0..all.len()).step_by(S::F64_LANES) {
            let count = S::F64_LANES.min(all.len() - at);
            let mut packet = [all[at] as usize; MOST_LANES];
            for lane in 0..count {
                packet[lane] = all[at + lane] as usize;
            }
            let around = |i: usize| stencils.around(positions, i, FIT_NEIGHBOURS);
            neighbours.gather::<S>(positions, deformed, &packet, around);
            fit(simd, &neighbours, &mut fits[at..at + count]);
        }
    }
}

/// Weighted sums over the neighbours of each sample.
struct Sums<S: Simd> {
    /// The sums of products of the neighbours' offsets: xx, yy, zz, and xy, xz, yz.
    diagonal: Triple<S>,
    off: Triple<S>,
    /// The sums of products of the deformed offsets with those at rest, column by column.
    images: [Triple<S>; 3],
    weights: DoubleLanes<S>,
}

impl<S: Simd> Sums<S> {
    #[inline(always)]
    fn accumulate(simd: S, neighbours: &Neighbours) -> Self {
        let zero = DoubleLanes::splat(simd, 0.0);
        let mut sums = Self { diagonal: [zero; 3], off: [zero; 3], images: [[zero; 3]; 3], weights: zero };
        let scale = DoubleLanes::load(simd, &neighbours.scale);
        for place in 0..neighbours.longest {
            let NeighbourPacket { is_there, way, moved } = &neighbours.places[place];
            let (d, moved) = (triple(simd, way), triple(simd, moved));
            let t = square(d).sqrt() * scale;
            let w = DoubleLanes::load(simd, is_there) * kernel(simd, t);
            let weighted = [w * d[0], w * d[1], w * d[2]];
            for (at, [a, b]) in [[0, 1], [0, 2], [1, 2]].into_iter().enumerate() {
                sums.diagonal[at] = weighted[at].mul_add(d[at], sums.diagonal[at]);
                sums.off[at] = weighted[a].mul_add(d[b], sums.off[at]);
            }
            for column in 0..3 {
                for axis in 0..3 {
                    sums.images[column][axis] =
                        weighted[column].mul_add(moved[axis], sums.images[column][axis]);
                }
            }
            sums.weights += w;
        }
        sums
    }

    /// The sum of the moved ways, by their products with the ways and a direction.
    #[inline(always)]
    fn along(&self, direction: Triple<S>) -> Triple<S> {
        let [x, y, z] = direction;
        let mut sum = [x; 3];
        for axis in 0..3 {
            let [a, b, c] = [self.images[0][axis], self.images[1][axis], self.images[2][axis]];
            sum[axis] = a * x + b * y + c * z;
        }
        sum
    }
}

/// Fits the samples of a packet.
#[inline(always)]
fn fit<S: Simd>(simd: S, neighbours: &Neighbours, fits: &mut [Fit]) {
    if neighbours.is_still == [true; MOST_LANES] {
        fits.fill((Mat3::IDENTITY, Some(1.0)));
        return;
    }
    let splat = |x| DoubleLanes::splat(simd, x);
    let zero = splat(0.0);
    let sums = Sums::accumulate(simd, neighbours);
    let (spread, [across, e2, e1]) = symmetric_eigen(simd, sums.diagonal, sums.off);
    let is_spread = zero.less(spread[2]).and(spread[2].less(splat(f64::INFINITY)));
    let is_planar = (splat(COLLINEAR * COLLINEAR) * spread[2]).less(spread[1]);
    let v1 = divided(sums.along(e1), spread[2]);
    let v2 = divided(sums.along(e2), spread[1]);
    let turned = cross(v1, v2);
    let area = square(turned).sqrt();
    let is_turned = zero.less(area).and(area.less(splat(f64::INFINITY)));
    // Right-handed, as the image is.
    let is_left = dot(cross(e1, e2), across).less(zero);
    let mut prior = turned;
    let mut normal = across;
    for axis in 0..3 {
        normal[axis] = is_left.select(zero - across[axis], across[axis]);
        prior[axis] = turned[axis] / area.sqrt();
    }
    // The axes are those of the fit with a ridge as well, which changes the direction across alone.
    let whole = spread[0] + spread[1] + spread[2];
    let image = sums.along(normal);
    let by_prior = held(image, prior, spread[0], splat(PRIOR) * whole);
    let by_neighbours = held(image, prior, spread[0], splat(LEAST_PRIOR) * sums.weights);
    // A prior that explains all neighbours to rounding stands, as the little that they tell is rounding; an
    // affine map that explains them nearly without the prior tells that the deformation is affine.
    let [prior_explains, neighbours_explain] =
        explained(simd, neighbours, [(e1, v1), (e2, v2)], normal, [by_prior, by_neighbours]);
    let mut third = by_prior;
    for axis in 0..3 {
        let other = neighbours_explain.select(by_neighbours[axis], by_prior[axis]);
        third[axis] = prior_explains.select(by_prior[axis], other);
    }
    let side = prior_explains.select(dot(turned, by_prior), dot(turned, by_neighbours));
    let tells_side = (splat(RELIEF) * whole).less(spread[0]);

    let mut columns = [[zero; 3]; 3];
    for column in 0..3 {
        for axis in 0..3 {
            let along = v1[axis] * e1[column] + v2[axis] * e2[column];
            columns[column][axis] = third[axis].mul_add(normal[column], along);
        }
    }
    let columns = [stored(columns[0]), stored(columns[1]), stored(columns[2])];
    let is_plane = is_spread.and(is_planar).and(is_turned).store();
    let (is_spread, tells_side, side) = (is_spread.store(), tells_side.store(), side.store());
    let (e1, v1) = (stored(e1), stored(v1));
    for (lane, fit) in fits.iter_mut().enumerate() {
        let of_lane = |numbers: &[[f64; MOST_LANES]; 3]| DVec3::from_array(numbers.map(|n| n[lane]));
        let f = DMat3::from_cols(of_lane(&columns[0]), of_lane(&columns[1]), of_lane(&columns[2]));
        *fit = if neighbours.is_still[lane] {
            (Mat3::IDENTITY, Some(1.0))
        } else if !is_spread[lane] {
            (Mat3::IDENTITY, None)
        } else if is_plane[lane] && f.is_finite() {
            (f.as_mat3(), tells_side[lane].then_some(side[lane].signum() as f32))
        } else {
            (on_a_line(of_lane(&e1), of_lane(&v1)).as_mat3(), None)
        };
    }
}

/// The image of the direction across, of which the neighbours' spread tells one, with a ridge to a prior.
#[inline(always)]
fn held<S: Simd>(
    image: Triple<S>,
    prior: Triple<S>,
    spread: DoubleLanes<S>,
    ridge: DoubleLanes<S>,
) -> Triple<S> {
    let mut held = image;
    for axis in 0..3 {
        held[axis] = prior[axis].mul_add(ridge, image[axis]) / (spread + ridge);
    }
    held
}

/// Samples on a line, before or after: turned and stretched as the line is, by the least rotation.
fn on_a_line(e1: DVec3, v1: DVec3) -> DMat3 {
    match v1.try_normalize() {
        Some(v) => DMat3::from_quat(DQuat::from_rotation_arc(e1, v)) * v1.length(),
        None => DMat3::IDENTITY,
    }
}

/// Masks of the samples whose neighbours all are explained to rounding, by each of two maps: these have the
/// images of the axes along the plane in common, and each its own image of the normal.
#[inline(always)]
fn explained<S: Simd>(
    simd: S,
    neighbours: &Neighbours,
    axes: [(Triple<S>, Triple<S>); 2],
    normal: Triple<S>,
    images: [Triple<S>; 2],
) -> [DoubleMask<S>; 2] {
    let splat = |x| DoubleLanes::splat(simd, x);
    let limit = splat(ROUNDING * ROUNDING);
    let mut explained = [splat(0.0).less(limit); 2];
    for place in 0..neighbours.longest {
        let NeighbourPacket { way, moved, .. } = &neighbours.places[place];
        let (d, mut left) = (triple(simd, way), triple(simd, moved));
        for at in 0..2 {
            let (axis, image) = axes[at];
            let along = dot(d, axis);
            for i in 0..3 {
                left[i] = image[i].negate_mul_add(along, left[i]);
            }
        }
        let along = dot(d, normal);
        for map in 0..2 {
            let mut left = left;
            for i in 0..3 {
                left[i] = images[map][i].negate_mul_add(along, left[i]);
            }
            explained[map] = explained[map].and(square(left).less(limit));
        }
    }
    explained
}

/// Vectors over numbers.
#[inline(always)]
fn divided<S: Simd>(v: Triple<S>, by: DoubleLanes<S>) -> Triple<S> {
    [v[0] / by, v[1] / by, v[2] / by]
}

#[inline(always)]
fn stored<S: Simd>(v: Triple<S>) -> [[f64; MOST_LANES]; 3] {
    [v[0].store(), v[1].store(), v[2].store()]
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
        let sheets = Sheets::find(&set);
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
    fn fits_have_the_same_bits_with_any_vectors() {
        // Samples of which some stay, and some come to lie on a line.
        let samples = SampleSet::new(patch(), Vec::new()).expect("samples");
        samples.prepare();
        let bend = |p: Vec3| match p.z {
            z if z < 0.3 => p,
            z if z > 0.8 => Vec3::X * p.x,
            _ => Vec3::new(p.x, p.y + p.x * p.z, p.z * 1.2 - p.y * p.y),
        };
        let deformed: Vec<Vec3> = samples.positions.iter().map(|p| bend(*p)).collect();
        let sheets = Sheets::find(&samples);
        let stencils = Stencils::own(&sheets);
        let all: Vec<u32> = (0..samples.len() as u32).collect();
        let fit = |by: &dyn Fn(Fits<'_>)| {
            let mut fits = vec![(Mat3::IDENTITY, None); samples.len()];
            let (samples, stencils, deformed) = (&samples, &stencils, &deformed[..]);
            by(Fits { samples, stencils, deformed, all: &all, fits: &mut fits });
            let bits = |(f, side): &Fit| (f.to_cols_array().map(f32::to_bits), side.map(f32::to_bits));
            fits.iter().map(bits).collect::<Vec<_>>()
        };
        let one_by_one = fit(&|fits| fits.with_simd(pulp::Scalar::new()));
        assert!(fit(&|fits| Arch::new().dispatch(fits)) == one_by_one);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert!(fit(&|fits| Simd::vectorize(simd, fits)) == one_by_one);
        }
        let still = Mat3::IDENTITY.to_cols_array().map(f32::to_bits);
        let moving = one_by_one.iter().filter(|(f, _)| *f != still).count();
        assert!((300..800).contains(&moving), "{moving}");
    }

    #[test]
    fn degenerate_neighbourhoods_stay_bounded() {
        let line: Vec<Vec3> = (0..50).map(|i| Vec3::X * i as f32 / 50.0).collect();
        let set = SampleSet::new(line, Vec::new()).expect("samples");
        set.prepare();
        let sheets = Sheets::find(&set);
        let turned: Vec<Vec3> = set.positions.iter().map(|p| Vec3::new(0.0, 2.0 * p.x, 0.0)).collect();
        let collapsed = vec![Vec3::ONE; 50];
        for deformed in [turned, collapsed] {
            for f in Gradients::fit(&set, &sheets, &deformed).0.gradient.iter() {
                assert!(f.is_finite() && f.to_cols_array().iter().all(|x| x.abs() < 4.0), "{f}");
            }
        }
        let one = SampleSet::new(vec![Vec3::ONE], Vec::new()).expect("a sample");
        one.prepare();
        assert_eq!(Gradients::fit(&one, &Sheets::find(&one), &[Vec3::ZERO]).0.gradient[0], Mat3::IDENTITY);
    }
}
