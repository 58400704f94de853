//! Coherent point drift (A. Myronenko, X. Song, *Point set registration: coherent point drift*, PAMI 2010):
//! the model's points are the centres of a mixture of Gaussians that all have one variance, which shrinks
//! while the mixture is fitted to the target's points by expectation maximisation; noise and points without
//! a counterpart are left to a uniform part.

use crate::gaussian::{Field, Kernel};
use crate::points::Pair;
use crate::tree::Tree;
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use glam::DVec3;
use simod_plugin_api::{Host, PluginError, PluginResult};

/// Number of points that one thread looks at in one go.
const BLOCK: usize = 32;
/// Exponent from which on a Gaussian counts as zero.
const NOTHING: f64 = 40.0;
/// Relative change of the variance below which it has settled, and number of times that this has to be so.
const SETTLED: (f64, usize) = (3e-3, 3);
/// Least standard deviation, as a part of the points' spread: points that are met so well need not be met
/// better.
const LEAST: f64 = 1e-4;
/// First variance of [`Start::Near`], in middle squares of distances to the nearest points.
const FIRST: f64 = 4.0;
/// Standard deviation of landmarks, as a part of the points' spread.
const LANDMARKS: f64 = 1e-3;

/// The variance that the drift begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// Variance of all pairs of points, as in the paper: parts that lie far apart find each other, but
    /// missing parts draw the rest along.
    Wide,
    /// Variance of the nearest points: for points that lie on each other already but for a deformation,
    /// also if parts are missing.
    Near,
}

/// Parameters of the drift. Lengths are those of points about 0 and of unit spread, as in the paper.
#[derive(Debug, Clone, Copy)]
pub struct Drift {
    /// Width of the Gaussians of which displacements are made (β).
    pub width: f64,
    /// Weight of the displacement's norm (λ).
    pub stiffness: f64,
    /// Greatest number of centres of the displacement.
    pub centers: usize,
    /// Part of the target's points that belong to nothing (w).
    pub outliers: f64,
    pub most_iterations: usize,
}

/// Points that belong together, by probabilities.
struct Expected {
    /// For each point of the model: the number of the target's points that belong to it (P 1), and their
    /// weighted sum (P X).
    own: Vec<(f64, DVec3)>,
    /// Sum of the squares of the target's points, weighted by their belonging to anything.
    squares: f64,
}

impl Drift {
    /// Displacement that takes `source` to `target`, and the number of iterations. Landmarks belong
    /// together for sure.
    ///
    /// # Errors
    /// The points determine nothing; the user cancelled.
    pub fn run(
        &self,
        (source, target): (&[DVec3], &[DVec3]),
        landmarks: &[Pair],
        start: Start,
        host: &Host<'_>,
        progress: &dyn Fn(f64) -> PluginResult<()>,
    ) -> PluginResult<(Field, usize)> {
        let from: Vec<DVec3> = source.iter().copied().chain(landmarks.iter().map(|l| l.source)).collect();
        let kernel = Kernel::new(&from, self.width, self.centers);
        let mut found = Field::default();
        let mut moved = source.to_vec();
        let mut variance = match start {
            Start::Wide => variance_of_all(source, target),
            Start::Near => variance_of_nearest(source, target),
        };
        let mut settled = 0;
        for iteration in 0..self.most_iterations {
            progress(iteration as f64 / self.most_iterations as f64)?;
            if variance <= LEAST * LEAST {
                return Ok((found, iteration));
            }
            let mut expected = self.expect(&moved, target, variance, host)?;
            let sum: f64 = expected.own.iter().map(|(p, _)| p).sum();
            if sum.is_nan() || sum <= 1e-9 {
                return Err(nothing_in_common());
            }
            let sure = variance / (LANDMARKS * LANDMARKS);
            expected.own.extend(landmarks.iter().map(|l| (sure * l.weight, sure * l.weight * l.target)));
            found = maximized(&from, &expected.own, &kernel, self.stiffness * variance)?;
            moved = source.iter().map(|p| found.apply(*p)).collect();
            let terms = moved.iter().zip(&expected.own);
            let apart: f64 = terms.map(|(q, (p, x))| p * q.length_squared() - 2.0 * x.dot(*q)).sum();
            let next = ((expected.squares + apart) / (3.0 * sum)).max(LEAST * LEAST);
            settled = if (next - variance).abs() < SETTLED.0 * variance { settled + 1 } else { 0 };
            variance = next;
            if settled == SETTLED.1 {
                return Ok((found, iteration + 1));
            }
        }
        Ok((found, self.most_iterations))
    }

    /// Probabilities that points of the two clouds belong together (equation 6 of the paper, for all
    /// points).
    fn expect(
        &self,
        moved: &[DVec3],
        target: &[DVec3],
        variance: f64,
        host: &Host<'_>,
    ) -> PluginResult<Expected> {
        let by = 1.0 / (2.0 * variance);
        let uniform = (std::f64::consts::TAU * variance).powf(1.5) * self.outliers / (1.0 - self.outliers)
            * moved.len() as f64
            / target.len() as f64;
        let gaussian = |a: DVec3, b: DVec3| match a.distance_squared(b) * by {
            x if x < NOTHING => (-x).exp(),
            _ => 0.0,
        };
        // The sums have, for each point of the target, the sum over the model's points, and the whole with
        // the uniform part.
        let mut sums = vec![[0.0; 2]; target.len()];
        host.parallel_blocks(&mut sums, BLOCK, |first, sums| {
            for (sum, x) in sums.iter_mut().zip(&target[first..]) {
                let own: f64 = moved.iter().map(|y| gaussian(*x, *y)).sum();
                *sum = [own, own + uniform];
            }
        })?;
        let weights: Vec<f64> =
            sums.iter().map(|[_, whole]| if *whole > 0.0 { 1.0 / whole } else { 0.0 }).collect();
        let mut own = vec![(0.0, DVec3::ZERO); moved.len()];
        host.parallel_blocks(&mut own, BLOCK, |first, own| {
            for (own, y) in own.iter_mut().zip(&moved[first..]) {
                for (x, weight) in target.iter().zip(&weights) {
                    let p = gaussian(*x, *y) * weight;
                    own.0 += p;
                    own.1 += p * *x;
                }
            }
        })?;
        let belongs = sums.iter().zip(&weights).map(|([own, _], weight)| own * weight);
        let squares = belongs.zip(target).map(|(belongs, x)| belongs * x.length_squared()).sum();
        Ok(Expected { own, squares })
    }
}

/// (d(P1) G + λ σ² I) W = P X − d(P1) Y, where G = L Lᵀ: c = Lᵀ W solves (Lᵀ d(P1) L + λ σ² I) c = Lᵀ (P X −
/// d(P1) Y).
fn maximized(from: &[DVec3], own: &[(f64, DVec3)], kernel: &Kernel, ridge: f64) -> PluginResult<Field> {
    let factor = &kernel.factor;
    let count = factor.ncols();
    let weighted = Mat::from_fn(from.len(), count, |i, k| own[i].0.sqrt() * factor[(i, k)]);
    let right = Mat::from_fn(from.len(), 3, |i, k| (own[i].1 - own[i].0 * from[i])[k]);
    faer::set_global_parallelism(faer::Par::Seq);
    let mut normal = weighted.transpose() * &weighted;
    for k in 0..count {
        normal[(k, k)] += ridge;
    }
    let mut solution = factor.transpose() * &right;
    let llt = Llt::new(normal.as_ref(), Side::Lower).map_err(|_| {
        PluginError::internal("the equations of the drift are not positive")
            .hint("take a larger `smoothness`")
    })?;
    llt.solve_in_place(solution.as_mut());
    Ok(kernel.field(from, &solution))
}

/// The mean of the squares of all distances, in one coordinate (the paper's).
fn variance_of_all(source: &[DVec3], target: &[DVec3]) -> f64 {
    let mean = |points: &[DVec3]| points.iter().sum::<DVec3>() / points.len() as f64;
    let squares = |points: &[DVec3], about: DVec3| {
        points.iter().map(|p| p.distance_squared(about)).sum::<f64>() / points.len() as f64
    };
    let [a, b] = [mean(source), mean(target)];
    (squares(source, a) + squares(target, b) + a.distance_squared(b)) / 3.0
}

/// Four times the square that half of the distances to the nearest points are below, on the side where
/// these distances are longer.
fn variance_of_nearest(source: &[DVec3], target: &[DVec3]) -> f64 {
    let nearest = |from: &[DVec3], to: &[DVec3]| {
        let tree = Tree::new(to);
        let mut all: Vec<f64> =
            from.iter().filter_map(|p| tree.nearest(*p, &|_| true)).map(|(_, squared)| squared).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(0.0)
    };
    (FIRST * nearest(source, target).max(nearest(target, source))).clamp(LEAST * LEAST, 1.0)
}

fn nothing_in_common() -> PluginError {
    PluginError::input("the model and the target have too little in common: the points determine no map")
        .hint("give `align = \"similarity\"`, `any-turn = true`, landmarks, or a smaller `outliers`")
}
