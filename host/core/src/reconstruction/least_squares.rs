//! The least squares of second-order expansions: how a sample's neighbours tell its terms, and what they
//! leave open.
//!
//! What the affine map of [`gradients`](super::gradients) leaves over at the neighbours is explained by nine
//! terms for each coordinate, with a ridge that follows from what they leave over in their turn (N. Wiener,
//! *Extrapolation, Interpolation, and Smoothing of Stationary Time Series*, 1949).

use glam::{DMat3, DVec3, Vec3};

use super::blended_jets::FIT_NEIGHBOURS;
use super::gradients::ROUNDING;
use super::stencils::Stencils;
use crate::geometry::{hermite, solve_positive_definite};
use crate::sampling::SampleSet;

/// The largest ridge, relative to terms of the size of the neighbourhood ...
const RIDGE: f64 = 1e-7;

/// ... and the least one, which keeps rounding from being followed.
const LEAST_RIDGE: f64 = 1e-11;

/// How large the terms of a fit are expected to be, as squares: so many times those of the strain and of what
/// the affine map leaves over.
const EXPECTED: f64 = 4.0;

/// Terms of a second-order expansion without its constant.
pub const TERMS: usize = 9;

/// A fit that leaves over more than this part of the displacement's variation is in doubt …
const DOUBTFUL: f64 = 0.1;

/// … and one that leaves over more than this is not to be believed.
const USELESS: f64 = 0.3;

/// How far an expansion is off around its sample, if the gradient across the surface is another one than the
/// prior says: local units, for a gradient that differs by about what the deformation strains.
///
/// The fit takes such a difference for what it can explain along the samples' surface, and leaves
/// (A + λ W)⁻¹ λ W e of it, e across, A of the fit's squares: next to nothing where neighbours tell about
/// the direction across, and nothing at the neighbours themselves.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unresolved([f32; TERMS]);

impl Unresolved {
    /// The length of what is left at `d` from the sample.
    pub fn at(&self, d: Vec3) -> f32 {
        let Vec3 { x, y, z } = d;
        let [a, b, c, xx, xy, xz, yy, yz, zz] = self.0;
        ((a + xx * x + xy * y + xz * z) * x + (b + yy * y + yz * z) * y + (c + zz * z) * z).abs()
    }
}

/// The squares of what the affine map leaves over at the neighbours of a sample, to be explained by the terms
/// x, y, z, xx, xy, xz, yy, yz, zz in units of the neighbourhood's radius.
pub(super) struct LeastSquares {
    /// One over the radius.
    pub scale: f64,
    /// Lower triangle of the products of terms, and the products with what is to be explained.
    matrix: [[f64; TERMS]; TERMS],
    right: [DVec3; TERMS],
    /// Of the weights, and of their squares.
    weights: f64,
    squared_weights: f64,
    /// Of what is to be explained.
    squares: f64,
    /// The largest of that, as a length.
    pub largest: f64,
    /// Of the displacements, beside the sample's own.
    variation: f64,
}

impl LeastSquares {
    /// Gathers the neighbours of sample `i`; `None` where they all lie at one place.
    pub fn gather(
        samples: &SampleSet,
        stencils: &Stencils<'_>,
        deformed: &[Vec3],
        prior: DMat3,
        i: usize,
    ) -> Option<Self> {
        let (near, radius) = stencils.around(&samples.positions, i, FIT_NEIGHBOURS);
        let (q, q_star) = (samples.positions[i], deformed[i]);
        let scale = 1.0 / f64::from(radius);
        let mut sums = Self {
            scale,
            matrix: [[0.0; TERMS]; TERMS],
            right: [DVec3::ZERO; TERMS],
            weights: 0.0,
            squared_weights: 0.0,
            squares: 0.0,
            largest: 0.0,
            variation: 0.0,
        };
        for j in near {
            let j = *j as usize;
            let d = (samples.positions[j] - q).as_dvec3();
            let moved = deformed[j].as_dvec3() - q_star.as_dvec3();
            let left_over = moved - prior * d;
            let w = f64::from(hermite((d.length() * scale) as f32));
            let DVec3 { x, y, z } = d * scale;
            let terms = [x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
            for (a, term) in terms.iter().enumerate() {
                let weighted = w * term;
                for (b, other) in terms[..=a].iter().enumerate() {
                    sums.matrix[a][b] += weighted * other;
                }
                sums.right[a] += left_over * weighted;
            }
            sums.weights += w;
            sums.squared_weights += w * w;
            sums.variation += w * (moved - d).length_squared();
            sums.squares += w * left_over.length_squared();
            sums.largest = sums.largest.max(left_over.length());
        }
        scale.is_finite().then_some(sums)
    }

    fn with_ridge(&self, ridge: f64) -> [[f64; TERMS]; TERMS] {
        let mut matrix = self.matrix;
        matrix.iter_mut().enumerate().for_each(|(a, row)| row[a] += ridge * self.weights);
        matrix
    }

    /// The terms that explain most with this ridge, and the part of the squares that they leave over.
    pub fn ridged(&self, ridge: f64) -> Option<([DVec3; TERMS], f64)> {
        let c = solve_positive_definite(self.with_ridge(ridge), self.right)?;
        // For the least squares c, what is left over is Σ w|r|² − c·b, up to the ridge.
        let explained: f64 = c.iter().zip(&self.right).map(|(c, b)| c.dot(*b)).sum();
        Some((c, (1.0 - explained / self.squares).max(0.0)))
    }

    /// The same with the ridge of a Wiener filter, which is given as well, where the map strains so much:
    /// what is left over almost without a ridge is noise, beside what terms may amount to.
    pub fn solve(&self, strain: f64) -> Option<([DVec3; TERMS], f64, f64)> {
        let (_, left) = self.ridged(LEAST_RIDGE)?;
        // What nine terms leave over of few neighbours is less than they are off by.
        let free = (1.0 - TERMS as f64 * self.squared_weights / (self.weights * self.weights)).max(0.0);
        let signal = self.squares + self.weights * (strain / self.scale).powi(2);
        let ridge = (LEAST_RIDGE + left * self.squares / (EXPECTED * free * signal)).min(RIDGE);
        self.ridged(ridge).map(|(terms, left)| (terms, left, ridge))
    }

    /// How little a fit is to be believed that leaves this part of the squares over, from 0 to 1.
    pub fn doubt(&self, part: f64) -> f64 {
        let left = part * self.squares;
        if (left / self.weights).sqrt() < ROUNDING {
            return 0.0;
        }
        // Beside how much the displacement varies, little matters that is left over of little.
        let part = (left / self.squares.max(self.variation)).sqrt();
        let t = ((part - DOUBTFUL) / (USELESS - DOUBTFUL)).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }

    /// What the fit leaves of a gradient that is off by so much `across` the surface.
    pub fn unresolved(&self, across: DVec3) -> Unresolved {
        let mut right = [DVec3::ZERO; TERMS];
        right.iter_mut().zip(across.to_array()).for_each(|(right, n)| right.x = RIDGE * self.weights * n);
        let left = solve_positive_definite(self.with_ridge(RIDGE), right).unwrap_or_default();
        let unit = |a: usize| if a < 3 { 1.0 } else { self.scale };
        Unresolved(std::array::from_fn(|a| (left[a].x * unit(a)) as f32))
    }
}
