//! Choosing the centres, and solving for their weights.
//!
//! Incremental least squares, after §4 of Botsch and Kobbelt 2005: few centres at first, the worst served
//! constraints next, until all are met. Unlike there, each round adds half as many centres as there are, so that
//! all rounds together cost little more than the last, and the fit is taken anew by a QR factorisation.

use crate::TOGETHER;
use crate::constraints::Constraints;
use crate::kernel::{AFFINE, BLOCK, Block, Functions, Kernel, Point};
use faer::Mat;
use faer::linalg::solvers::SolveLstsq;
use simod_plugin_api::{Host, ParamSet, PluginError, PluginResult};

/// Centres of the first round.
const FIRST_CENTERS: usize = 32;
/// Constraints in the least squares, per centre; all others are checked, and become centres where they fail.
const ROWS_PER_CENTER: usize = 4;
/// Least constraints in the least squares.
const FEWEST_ROWS: usize = 512;
/// Weight of the side conditions Σ w_j = 0, Σ w_j c_j = 0, which keep the far field affine.
const SIDE_WEIGHT: f64 = 1e2;
/// Ridge on all unknowns, relative to kernels of about 1: holds what coplanar or coincident constraints leave open.
const RIDGE: f64 = 1e-9;
/// Two centres nearer than this in the unit box are one: single-precision positions do not tell them apart.
const COINCIDENT: f64 = 1e-7;

/// What to reach, and at what expense: the plugin's parameters.
#[derive(ParamSet, Debug, Clone, Copy)]
pub struct Goal {
    /// How smooth the deformation is, and how far it reaches
    #[param(default = Kernel::Triharmonic, invalidates_preparation)]
    pub kernel: Kernel,
    /// How far regions may stray, relative to the handles' motion
    #[param(default = 1e-3, hard = 1e-9..=1.0, soft = 1e-5..=1e-2, group = "Accuracy", invalidates_preparation)]
    pub tolerance: f64,
    /// Limits the time of the preparation
    #[param(name = "Most centres", default = 1000, hard = 8..=5000, soft = 100..=2000)]
    #[param(group = "Accuracy", invalidates_preparation)]
    pub max_centers: i64,
}

/// A solution for all right-hand sides.
#[derive(Debug)]
pub struct Fit {
    /// Centres and kernel.
    pub functions: Functions,
    /// functions x right-hand sides
    pub weights: Mat<f64>,
    /// Largest residual over all constraints and right-hand sides.
    pub residual: f64,
}

/// Fits all right-hand sides; falls short of the tolerance where the centres run out, which `residual` tells.
/// Progress runs from 0 to `until`.
pub fn fit(constraints: &Constraints, goal: Goal, host: &Host<'_>, until: f64) -> PluginResult<Fit> {
    let count = constraints.points.len();
    let most = usize::try_from(goal.max_centers).unwrap_or(0).clamp(1, count);
    let mut centers = Vec::new();
    let mut is_center = vec![false; count];
    let mut spread = 0.2;
    add(constraints.spread.iter().copied(), constraints, FIRST_CENTERS.min(most), spread, &mut centers);
    loop {
        centers.iter().for_each(|&i| is_center[i] = true);
        let rows = rows(constraints, &centers, &is_center);
        let functions = Functions {
            kernel: goal.kernel,
            centers: centers.iter().map(|&i| constraints.points[i]).collect(),
        };
        let weights = solve(constraints, &functions, &rows)?;
        let residuals = residuals(constraints, &functions, &weights, host)?;
        let residual = residuals.iter().copied().fold(0.0, f64::max);
        // A solve costs the cube of the centres.
        host.progress(until * (centers.len() as f64 / most as f64).powi(3).min(1.0))?;
        let done = Fit { functions, weights, residual };
        if residual <= goal.tolerance || centers.len() >= most {
            return Ok(done);
        }
        let mut worst: Vec<usize> = (0..count).filter(|&i| !is_center[i]).collect();
        worst.sort_unstable_by(|&a, &b| residuals[b].total_cmp(&residuals[a]).then(a.cmp(&b)));
        let wanted = (centers.len() + (centers.len() / 2).max(8)).min(most);
        spread = 0.3 / (wanted as f64).sqrt();
        let before = centers.len();
        add(worst.iter().copied(), constraints, wanted, spread, &mut centers);
        if centers.len() == before {
            add(worst.iter().copied(), constraints, wanted, COINCIDENT, &mut centers);
        }
        if centers.len() == before {
            // Every place is a centre: constraints in one place shall move differently.
            return Ok(done);
        }
    }
}

/// Takes candidates, in their order, that keep a distance from all centres so far, until there are `wanted`.
fn add(
    candidates: impl Iterator<Item = usize>,
    constraints: &Constraints,
    wanted: usize,
    distance: f64,
    centers: &mut Vec<usize>,
) {
    let far =
        |a: &Point, b: &Point| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>() >= distance * distance;
    for candidate in candidates {
        if centers.len() >= wanted {
            break;
        }
        let p = &constraints.points[candidate];
        if centers.iter().all(|&c| far(p, &constraints.points[c])) {
            centers.push(candidate);
        }
    }
}

/// The constraints that the least squares see: the centres, and others well spread.
fn rows(constraints: &Constraints, centers: &[usize], is_center: &[bool]) -> Vec<usize> {
    let wanted = (ROWS_PER_CENTER * centers.len()).max(FEWEST_ROWS);
    let others = constraints.spread.iter().copied().filter(|&i| !is_center[i]);
    centers.iter().copied().chain(others).take(wanted).collect()
}

fn solve(constraints: &Constraints, functions: &Functions, rows: &[usize]) -> PluginResult<Mat<f64>> {
    let (unknowns, centers) = (functions.count(), functions.centers.len());
    // The heavy rows first, which the QR factorisation likes.
    let height = AFFINE + rows.len() + unknowns;
    let mut matrix = Mat::<f64>::zeros(height, unknowns);
    for (j, c) in functions.centers.iter().enumerate() {
        matrix[(0, j)] = SIDE_WEIGHT;
        for k in 0..3 {
            matrix[(1 + k, j)] = SIDE_WEIGHT * c[k];
        }
    }
    let points: Vec<Point> = rows.iter().map(|&i| constraints.points[i]).collect();
    functions.fill(&points, matrix.as_mut().subrows_mut(AFFINE, rows.len()));
    for j in 0..unknowns {
        matrix[(AFFINE + rows.len() + j, j)] = RIDGE;
    }
    let mut right = Mat::<f64>::zeros(height, constraints.functions());
    for (i, &row) in rows.iter().enumerate() {
        for f in 0..constraints.functions() {
            right[(AFFINE + i, f)] = constraints.target(row, f);
        }
    }
    // On one thread: a result that depends on the number of cores would not be the same elsewhere.
    faer::set_global_parallelism(faer::Par::Seq);
    let solution = matrix.qr().solve_lstsq(&right);
    let weights = solution.subrows(0, unknowns).to_owned();
    if weights.col_iter().any(|c| c.iter().any(|x| !x.is_finite())) {
        let error = PluginError::new(
            simod_plugin_api::ErrorCode::NOT_CONVERGED,
            format!("the fit over {centers} centres has no finite solution"),
        );
        return Err(error.hint("use fewer centres (`max-centers`), or other regions"));
    }
    Ok(weights)
}

/// Largest residual of the right-hand sides at each constraint.
fn residuals(
    constraints: &Constraints,
    functions: &Functions,
    weights: &Mat<f64>,
    host: &Host<'_>,
) -> PluginResult<Vec<f64>> {
    let mut residuals = vec![0.0; constraints.points.len()];
    host.parallel_blocks(&mut residuals, TOGETHER * BLOCK, |first, residuals| {
        let mut scratch = Block::default();
        for (block, residuals) in residuals.chunks_mut(BLOCK).enumerate() {
            let first = first + block * BLOCK;
            let points = &constraints.points[first..first + residuals.len()];
            let sums = functions.sums(points, weights.as_ref(), &mut scratch);
            for (i, residual) in residuals.iter_mut().enumerate() {
                let off = |f: usize| (sums[(i, f)] - constraints.target(first + i, f)).abs();
                *residual = (0..constraints.functions()).map(off).fold(0.0, f64::max);
            }
        }
    })?;
    Ok(residuals)
}
