//! The places of samples that a refinement appended, while something before it is dragged: by those around
//! them alone, with weights that are found once. They are nearly where all samples take them, and found in a
//! small part of the time.
//!
//! D. Levin, *The approximation power of moving least-squares*, Math. Comp. 67 (1998): the weights with which
//! the value of the best polynomial follows from the values around. Affine motions are met but for rounding,
//! and those that bend along the surface to second order.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_core::geometry::solve_positive_definite;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::SampleSet;
use std::array::from_fn;
use std::sync::Arc;

/// Samples that have a word.
const NEAR: usize = 20;
/// Number of terms of the polynomial: one, the three coordinates, and three that are quadratic along the
/// surface.
const TERMS: usize = 7;
/// Regularisation of the terms of the polynomial that samples of a plane do not determine: it holds them to
/// zero.
const RIDGE: f64 = 1e-6;
/// Normals that are less alike than this cosine are of two sides of a thin wall.
const AWAY: f32 = -0.5;

/// The samples whose displacements make that of each sample which a refinement appended.
///
/// Memory: 160 bytes for each of these.
pub struct Around(Vec<[Word; NEAR]>);

/// Sample near an appended one, and the weight of its displacement.
#[derive(Debug, Clone, Copy)]
struct Word {
    sample: u32,
    weight: f32,
}

impl Around {
    /// The surroundings of the samples that `after` has more than `before`.
    pub fn new(before: &SampledModel, after: &SampledModel) -> Self {
        let samples = &before.samples;
        samples.prepare();
        let appended = &after.samples.positions[samples.len()..];
        Self(appended.par_iter().map(|p| words(samples, *p)).collect())
    }

    /// Positions of all samples of `after`, approximately, by the deformed positions of those that were there
    /// before.
    pub fn draft(&self, after: &SampledModel, deformed: &[Vec3]) -> Arc<[Vec3]> {
        let (rest, appended) = after.samples.positions.split_at(deformed.len());
        let moved = |word: &Word| {
            let i = word.sample as usize;
            word.weight * (deformed[i] - rest[i])
        };
        let mut all: Arc<[Vec3]> = deformed.iter().chain(appended).copied().collect();
        if let Some(all) = Arc::get_mut(&mut all) {
            let more = all[deformed.len()..].par_iter_mut().zip(&self.0);
            more.for_each(|(p, words)| *p += words.iter().map(moved).sum::<Vec3>());
        }
        all
    }
}

/// Weights of the samples nearest to a place, on its side of the surface.
fn words(samples: &SampleSet, p: Vec3) -> [Word; NEAR] {
    let nearest = samples.nearest(p);
    let normals = samples.normals();
    let normal = normals[nearest as usize];
    let mut words = [Word { sample: nearest, weight: 0.0 }; NEAR];
    let others = samples.neighbours().nearest_to(nearest as usize).iter();
    let others = others.filter(|j| normals[**j as usize].dot(normal) > AWAY);
    let count = 1 + words[1..].iter_mut().zip(others).map(|(word, j)| word.sample = *j).count();
    let to: [DVec3; NEAR] = from_fn(|k| (samples.positions[words[k].sample as usize] - p).as_dvec3());
    let unit = to[..count].iter().map(|d| d.length()).fold(0.0, f64::max);
    let (s, t) = normal.as_dvec3().any_orthonormal_pair();
    let terms = |d: DVec3| {
        let (d, x, y) = (d / unit, d.dot(s) / unit, d.dot(t) / unit);
        let value = [1.0, d.x, d.y, d.z, x * x, x * y, y * y];
        (value, (-4.0 * d.length_squared()).exp())
    };
    let mut matrix = [[0.0; TERMS]; TERMS];
    for (value, weight) in to[..count].iter().map(|d| terms(*d)) {
        for (row, a) in matrix.iter_mut().zip(value) {
            row.iter_mut().zip(value).for_each(|(entry, b)| *entry += weight * a * b);
        }
    }
    for (i, row) in matrix.iter_mut().enumerate().skip(1) {
        row[i] += RIDGE;
    }
    let at_the_place = from_fn(|i| if i == 0 { DVec3::X } else { DVec3::ZERO });
    let polynomial = solve_positive_definite(matrix, at_the_place).map(|all| all.map(|x| x.x));
    let Some(polynomial) = polynomial.filter(|all| unit > 0.0 && all.iter().all(|x| x.is_finite())) else {
        // Without a polynomial, the nearest sample alone has a weight.
        words[0].weight = 1.0;
        return words;
    };
    for (word, d) in words[..count].iter_mut().zip(&to) {
        let (value, weight) = terms(*d);
        word.weight = (weight * value.iter().zip(polynomial).map(|(a, b)| a * b).sum::<f64>()) as f32;
    }
    words
}
