//! Choosing the centres, and solving for their weights.
//!
//! Incremental least squares, after §4 of Botsch and Kobbelt 2005: few centres at first, the constraints
//! with the largest residuals next, until all are met. Unlike there, each round adds a quarter as many
//! centres as there are, and of very many constraints only some take part, which are well spread. Whenever
//! there are twice as many centres, all constraints are checked, and more of those that are not met take
//! part.
//!
//! If [`CHOSEN`] centres do not meet the constraints and there may be more, the targets are interpolated at
//! the centres, which costs the square of their number and not its cube (`interpolation`).

use crate::TOGETHER;
use crate::constraints::{RegionSamples, spread_order};
use crate::interpolation::interpolate;
use crate::kernel::{BLOCK, BasisFunctions, Point, RadialKernel};
use crate::least_squares::RidgeRegression;
use faer::Mat;
use simod_plugin_api::{ErrorCode, Host, ParamSet, PluginError, PluginResult};
use std::collections::HashSet;

/// Number of centres of the first round.
const FIRST_CENTERS: usize = 32;
/// Number of constraints in the least squares for each centre that there may be; all others are checked.
const ROWS_PER_CENTER: usize = 4;
/// Least number of constraints in the least squares, however few centres there may be.
const FEWEST_ROWS: usize = 512;
/// Ridge on all unknowns, relative to kernels of about 1: it determines unknowns that coplanar or
/// coincident constraints leave open.
const RIDGE: f64 = 1e-9;
/// Greatest number of centres that are chosen one by one.
const CHOSEN: usize = 1000;
/// Greatest factor by which the centres get more after each round of interpolation.
const MORE: usize = 6;
/// Part of the constraints that are left, of which more have to be unmet for all to become centres: the
/// others would follow in a round of their own, which costs as much again.
const NEARLY_ALL: f64 = 0.75;
/// Size of a cell, in the unit box, in which centres of an interpolation are one.
const CELL: f64 = 1e-5;
/// Residual of the interpolation at the centres, as a part of the tolerance.
const LEFT: f64 = 0.5;
/// Distance of two centres, in the unit box, below which they are one: single-precision positions do not
/// tell them apart.
const COINCIDENT: f64 = 1e-7;

/// Greatest number of centres: no preparation of more would end.
pub const MOST_CENTERS: i64 = 50_000;

/// Parameters: the accuracy, and the expense.
#[derive(ParamSet, Debug, Clone, Copy)]
pub struct Goal {
    /// Radial function, by which the deformation is smooth or local; compact ones reach as far as the support
    #[param(default = RadialKernel::Triharmonic, invalidates_preparation)]
    pub kernel: RadialKernel,
    /// Distance from the regions up to which a compact kernel reaches; what is farther stays where it is
    #[param(default = 0.25, unit = "diagonal", hard = 1e-3..=10.0, soft = 0.02..=1.0, invalidates_preparation)]
    pub support: f64,
    /// Distance by which regions may stray, relative to the handles' motion
    #[param(default = 1e-3, hard = 1e-9..=1.0, soft = 1e-5..=1e-2, group = "Accuracy", invalidates_preparation)]
    pub tolerance: f64,
    /// Largest number of centres, which limits the time of the preparation
    #[param(name = "Most centres", default = 1000, hard = 8..=MOST_CENTERS, soft = 100..=20_000)]
    #[param(group = "Accuracy", invalidates_preparation)]
    pub max_centers: i64,
}

/// A solution for all right-hand sides.
#[derive(Debug)]
pub struct SplineFit {
    /// Centres and kernel.
    pub functions: BasisFunctions,
    /// functions x right-hand sides
    pub weights: Mat<f64>,
    /// Largest residual over all constraints and right-hand sides.
    pub residual: f64,
}

/// Fits all right-hand sides; falls short of the tolerance where the centres run out, as `residual` shows.
/// `support` is that of compact kernels, in the unit box. Progress runs from 0 to `until`.
pub fn fit(
    constraints: &RegionSamples,
    goal: &Goal,
    support: f64,
    host: &Host<'_>,
    until: f64,
) -> PluginResult<SplineFit> {
    let most = usize::try_from(goal.max_centers).unwrap_or(0).clamp(1, constraints.points.len());
    let fitter = Fitter { constraints, goal, support, most: most.min(CHOSEN), host, until };
    let first = constraints.spread.iter().copied();
    let mut rows: Vec<usize> = first.take(fitter.most_rows() / 2).collect();
    let mut centers = fitter.first_centers();
    loop {
        let before = (rows.len(), centers.len());
        let (functions, weights) = fitter.greedy(&rows, &mut centers)?;
        let residuals = fitter.residuals(None, &functions, &weights)?;
        let is_met = residuals.iter().all(|r| *r <= goal.tolerance);
        if !is_met && centers.len() < fitter.most {
            fitter.take_failing(&mut rows, &residuals);
        }
        if is_met || centers.len() >= fitter.most || before == (rows.len(), centers.len()) {
            let fit = SplineFit { functions, weights, residual: largest(&residuals) };
            return if is_met { Ok(fit) } else { fitter.interpolate(fit, centers, residuals, most) };
        }
    }
}

fn largest(residuals: &[f64]) -> f64 {
    residuals.iter().copied().fold(0.0, f64::max)
}

/// Constraints and goal of a fit.
struct Fitter<'a> {
    constraints: &'a RegionSamples,
    goal: &'a Goal,
    support: f64,
    /// Greatest number of centres.
    most: usize,
    host: &'a Host<'a>,
    until: f64,
}

impl Fitter<'_> {
    /// Centres of the first round, well spread. Fixed constraints matter to compact kernels only where
    /// handles reach them, and become centres when that shows.
    fn first_centers(&self) -> Vec<usize> {
        let matters = |i: &usize| !self.goal.kernel.is_compact() || self.constraints.handle[*i].is_some();
        let spread = self.constraints.spread.iter().copied().filter(matters);
        let mut centers = Vec::new();
        self.add(spread, FIRST_CENTERS.min(self.most), 0.2, &mut centers);
        centers
    }

    /// Greatest number of constraints in the least squares.
    fn most_rows(&self) -> usize {
        (ROWS_PER_CENTER * self.most).max(FEWEST_ROWS)
    }

    /// Takes more constraints into the least squares, well spread among those that are not met, the one of
    /// largest residual at each place.
    fn take_failing(&self, rows: &mut Vec<usize>, residuals: &[f64]) {
        let mut is_row = vec![false; residuals.len()];
        rows.iter().for_each(|&i| is_row[i] = true);
        let fails = |i: &usize| residuals[*i] > self.goal.tolerance && !is_row[*i];
        let failing = worst_first((0..residuals.len()).filter(fails).collect(), residuals);
        let room = (self.most_rows() / 8).min(self.most_rows().saturating_sub(rows.len()));
        rows.extend(spread_order(&self.constraints.points, failing.into_iter(), room));
    }

    /// Adds centres from among `rows` until these constraints are met, there are twice as many, or none is
    /// left to add.
    fn greedy(&self, rows: &[usize], centers: &mut Vec<usize>) -> PluginResult<(BasisFunctions, Mat<f64>)> {
        let points: Vec<Point> = rows.iter().map(|&i| self.constraints.points[i]).collect();
        let side = self.goal.kernel.affine();
        let mut right = Mat::zeros(side + rows.len(), self.constraints.functions());
        for (i, &row) in rows.iter().enumerate() {
            for f in 0..right.ncols() {
                right[(side + i, f)] = self.constraints.target(row, f);
            }
        }
        let mut squares = RidgeRegression::new(&right, side + self.most, RIDGE);
        let mut is_center = vec![false; self.constraints.points.len()];
        let mut functions =
            BasisFunctions { kernel: self.goal.kernel, support: self.support, centers: Vec::new() };
        let (mut known, enough) = (0, (2 * centers.len()).min(self.most));
        loop {
            functions.centers = centers.iter().map(|&i| self.constraints.points[i]).collect();
            centers.iter().for_each(|&i| is_center[i] = true);
            let mut columns = Mat::zeros(side + rows.len(), functions.count() - known);
            functions.side_conditions(known, columns.as_mut().subrows_mut(0, side));
            functions.fill(&points, known, columns.as_mut().subrows_mut(side, rows.len()));
            squares.append(&columns, self.host)?;
            known = functions.count();
            let weights = squares.solve();
            self.check_finite(&weights)?;
            let residuals = self.residuals(Some(rows), &functions, &weights)?;
            // The cost of the rounds to come is about the square of the centres.
            self.host.progress(self.until * (centers.len() as f64 / self.most as f64).powi(2).min(1.0))?;
            let met = residuals.iter().all(|r| *r <= self.goal.tolerance);
            if met || centers.len() >= enough || !self.add_worst(rows, &residuals, &is_center, centers) {
                return Ok((functions, weights));
            }
        }
    }

    /// Makes unmet constraints centres, up to `most`, until all are met; where rounding ends that, the best
    /// fit is kept.
    fn interpolate(
        &self,
        mut fit: SplineFit,
        mut centers: Vec<usize>,
        mut residuals: Vec<f64>,
        most: usize,
    ) -> PluginResult<SplineFit> {
        // The next round goes on from the weights that the last round found at its centres.
        let mut found = Mat::zeros(0, self.constraints.functions());
        while fit.residual > self.goal.tolerance && centers.len() < most {
            let wanted = most.min(MORE * centers.len());
            let before = centers.len();
            self.add_failing(&residuals, wanted, &mut centers);
            if centers.len() == before {
                break;
            }
            let points = centers.iter().map(|&i| self.constraints.points[i]).collect();
            let functions =
                BasisFunctions { kernel: self.goal.kernel, support: self.support, centers: points };
            let targets = Mat::from_fn(centers.len(), self.constraints.functions(), |i, f| {
                self.constraints.target(centers[i], f)
            });
            let start = Mat::from_fn(centers.len(), targets.ncols(), |i, f| {
                if i < found.nrows() { found[(i, f)] } else { 0.0 }
            });
            let weights = interpolate(&functions, &targets, start, LEFT * self.goal.tolerance, self.host)?;
            self.check_finite(&weights)?;
            found = weights.subrows(functions.kernel.affine(), centers.len()).to_owned();
            residuals = self.residuals(None, &functions, &weights)?;
            let residual = largest(&residuals);
            // Between few centres the residual may be larger than before; and in the end by rounding.
            if residual < fit.residual {
                fit = SplineFit { functions, weights, residual };
            }
        }
        Ok(fit)
    }

    /// Makes unmet constraints centres, well spread, the one of largest residual at each place, until there
    /// are `wanted`. Where few are unmet, others that nearly are join them, and where nearly all are, all
    /// constraints become centres, so that rounds stay few.
    fn add_failing(&self, residuals: &[f64], wanted: usize, centers: &mut Vec<usize>) {
        let points = &self.constraints.points;
        let cell = |i: usize| points[i].map(|x| (x / CELL) as i32);
        let mut taken: HashSet<[i32; 3]> = centers.iter().map(|&i| cell(i)).collect();
        let mut worst = worst_first((0..residuals.len()).collect(), residuals);
        worst.retain(|&i| taken.insert(cell(i)));
        let failing = worst.partition_point(|&i| residuals[i] > self.goal.tolerance);
        if failing > 0 {
            let room = wanted.saturating_sub(centers.len());
            if worst.len() > room || failing as f64 <= NEARLY_ALL * worst.len() as f64 {
                worst.truncate(failing.max(centers.len() / 4));
            }
            centers.extend(spread_order(points, worst.into_iter(), room));
        }
    }

    /// Makes the constraints with the largest residuals centres. Returns whether there are any.
    fn add_worst(
        &self,
        rows: &[usize],
        residuals: &[f64],
        is_center: &[bool],
        centers: &mut Vec<usize>,
    ) -> bool {
        let candidates = (0..rows.len()).filter(|&i| !is_center[rows[i]] && residuals[i] > 0.0);
        let worst = worst_first(candidates.collect(), residuals);
        let before = centers.len();
        let wanted = (before + (before / 4).max(8)).min(self.most);
        // Where even the least distance is too large, every place is a centre: constraints in one place
        // shall move differently.
        for distance in [0.3 / (wanted as f64).sqrt(), COINCIDENT] {
            if centers.len() == before {
                self.add(worst.iter().map(|&i| rows[i]), wanted, distance, centers);
            }
        }
        centers.len() > before
    }

    /// Takes candidates, in their order, that keep a distance from all centres so far, until there are
    /// `wanted`.
    fn add(
        &self,
        candidates: impl Iterator<Item = usize>,
        wanted: usize,
        distance: f64,
        centers: &mut Vec<usize>,
    ) {
        let points = &self.constraints.points;
        let far =
            |a: &Point, b: &Point| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>() >= distance * distance;
        for candidate in candidates {
            if centers.len() >= wanted {
                break;
            }
            if centers.iter().all(|&c| far(&points[candidate], &points[c])) {
                centers.push(candidate);
            }
        }
    }

    fn check_finite(&self, weights: &Mat<f64>) -> PluginResult<()> {
        if weights.col_iter().all(|c| c.iter().all(|x| x.is_finite())) {
            return Ok(());
        }
        let what = format!("the fit over {} centres has no finite solution", weights.nrows());
        let error = PluginError::new(ErrorCode::NOT_CONVERGED, what);
        Err(error.hint("use fewer centres (`max-centers`), or other regions"))
    }

    /// Largest residual of the right-hand sides at each of the given constraints, or at all.
    fn residuals(
        &self,
        of: Option<&[usize]>,
        functions: &BasisFunctions,
        weights: &Mat<f64>,
    ) -> PluginResult<Vec<f64>> {
        let constraints = self.constraints;
        let mut residuals = vec![0.0; of.map_or(constraints.points.len(), <[usize]>::len)];
        let which = |i: usize| of.map_or(i, |of| of[i]);
        self.host.parallel_blocks(&mut residuals, TOGETHER * BLOCK, |first, residuals| {
            for (block, residuals) in residuals.chunks_mut(BLOCK).enumerate() {
                let first = first + block * BLOCK;
                let points: Vec<Point> =
                    (first..first + residuals.len()).map(|i| constraints.points[which(i)]).collect();
                let sums = functions.sums(&points, weights.as_ref());
                for (i, residual) in residuals.iter_mut().enumerate() {
                    let off = |f: usize| (sums[f][i] - constraints.target(which(first + i), f)).abs();
                    *residual = (0..constraints.functions()).map(off).fold(0.0, f64::max);
                }
            }
        })?;
        Ok(residuals)
    }
}

/// Sorts constraints by their residuals, largest first.
fn worst_first(mut indices: Vec<usize>, residuals: &[f64]) -> Vec<usize> {
    indices.sort_unstable_by(|&a, &b| residuals[b].total_cmp(&residuals[a]).then(a.cmp(&b)));
    indices
}
