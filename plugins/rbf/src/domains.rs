//! Approximate inverse of the interpolation's matrix, by domains that overlap and a coarse selection.
//!
//! R. K. Beatson, W. A. Light, S. Billups, *Fast solution of the radial basis function interpolation
//! equations: domain decomposition methods*, SIAM Journal on Scientific Computing 2000. Each domain
//! interpolates for itself, with surroundings that overlap others; only the weights of its own centres
//! count. The residuals at well-spread centres are interpolated by these.

use crate::constraints::spread_order;
use crate::kernel::{BasisFunctions, Point, RadialKernel};
use crate::side::SideConditions;
use crate::sums::sums_at;
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use simod_plugin_api::{ErrorCode, Host, PluginError, PluginResult};

/// Greatest number of a domain's own centres.
const OWN: usize = 160;
/// Number of centres of a domain with its surroundings. Their factors are 8 * ALL^2 bytes a domain: 130 MB
/// for 20 000 centres.
const ALL: usize = 360;
/// Number of centres of which one is a coarse one,
const COARSE_OF: usize = 5;
/// and least and greatest number of coarse ones.
const COARSE: [usize; 2] = [500, 2000];
/// Ridges that keep a factorisation from failing by rounding, as a part of the matrix' mean eigenvalue: the
/// first that does is taken.
const RIDGES: [f64; 4] = [1e-13, 1e-11, 1e-8, 1e-4];

/// The approximate inverse.
pub struct Domains<'a> {
    functions: &'a BasisFunctions,
    domains: Vec<Domain>,
    coarse: Domain,
    side: &'a SideConditions,
}

/// Domain of some centres, which interpolate for themselves.
struct Domain {
    /// Centres that the domain reaches; its own ones come first.
    centers: Vec<usize>,
    own: usize,
    side: SideConditions,
    factor: Llt<f64>,
}

impl Domain {
    fn new(functions: &BasisFunctions, centers: Vec<usize>, own: usize) -> Option<Self> {
        let points: Vec<Point> = centers.iter().map(|&c| functions.centers[c]).collect();
        let kernel = functions.kernel;
        let side = SideConditions::new(kernel, &points);
        let functions = BasisFunctions { kernel, support: functions.support, centers: points };
        let mut matrix = Mat::zeros(centers.len(), centers.len());
        functions.fill(&functions.centers, kernel.affine(), matrix.as_mut());
        if kernel == RadialKernel::Biharmonic {
            matrix *= faer::Scale(-1.0);
        }
        let mean = side.complete(&mut matrix);
        for ridge in RIDGES {
            let mut held = matrix.clone();
            (0..centers.len()).for_each(|i| held[(i, i)] += ridge * mean);
            if let Ok(factor) = held.llt(Side::Lower) {
                return Some(Self { centers, own, side, factor });
            }
        }
        None
    }

    /// Weights that meet the values at the domain's centres, up to an affine function.
    fn solve(&self, mut values: Mat<f64>, kernel: RadialKernel) -> Mat<f64> {
        self.side.take_out(values.as_mut());
        self.factor.solve_in_place(values.as_mut());
        self.side.take_out(values.as_mut());
        if kernel == RadialKernel::Biharmonic { values * faer::Scale(-1.0) } else { values }
    }
}

impl<'a> Domains<'a> {
    /// Divides the centres into domains, and factorises their matrices.
    pub fn new(
        functions: &'a BasisFunctions,
        side: &'a SideConditions,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        // Each factorisation is on one thread: a result that depends on the number of cores would not be
        // the same elsewhere.
        faer::set_global_parallelism(faer::Par::Seq);
        let all = functions.centers.len();
        let mut parts = Vec::new();
        divide(&functions.centers, (0..all).collect(), &mut parts);
        let coarse = (all / COARSE_OF).clamp(COARSE[0], COARSE[1]).min(all);
        let coarse = spread_order(&functions.centers, 0..all, coarse);
        // The coarse domain comes first: it takes longest.
        let mut made: Vec<Option<Domain>> = (0..=parts.len()).map(|_| None).collect();
        host.parallel_blocks(&mut made, 1, |i, made| {
            made[0] = match i.checked_sub(1) {
                None => Domain::new(functions, coarse.clone(), coarse.len()),
                Some(i) => {
                    Domain::new(functions, with_surroundings(&functions.centers, &parts[i]), parts[i].len())
                }
            };
        })?;
        let failed = || {
            PluginError::new(ErrorCode::NOT_CONVERGED, "some of the regions' samples cannot be interpolated")
                .hint("use fewer centres (`max-centers`), or other regions")
        };
        let mut domains = made.into_iter().collect::<Option<Vec<_>>>().ok_or_else(failed)?;
        let coarse = domains.remove(0);
        Ok(Self { functions, domains, coarse, side })
    }

    /// Weights that nearly meet the values at the centres, up to an affine function: centres x sums.
    pub fn solve(&self, values: &Mat<f64>, host: &Host<'_>) -> PluginResult<Mat<f64>> {
        let kernel = self.functions.kernel;
        let at = |domain: &Domain| {
            Mat::from_fn(domain.centers.len(), values.ncols(), |i, j| values[(domain.centers[i], j)])
        };
        let mut parts: Vec<Mat<f64>> = (0..self.domains.len()).map(|_| Mat::new()).collect();
        host.parallel_blocks(&mut parts, 1, |i, part| {
            part[0] = self.domains[i].solve(at(&self.domains[i]), kernel);
        })?;
        let mut weights = Mat::zeros(values.nrows(), values.ncols());
        for (domain, part) in self.domains.iter().zip(&parts) {
            for (i, &center) in domain.centers[..domain.own].iter().enumerate() {
                (0..values.ncols()).for_each(|j| weights[(center, j)] = part[(i, j)]);
            }
        }
        self.side.take_out(weights.as_mut());
        let points: Vec<Point> = self.coarse.centers.iter().map(|&c| self.functions.centers[c]).collect();
        let left = at(&self.coarse) - sums_at(self.functions, &points, weights.as_ref(), host)?;
        let more = self.coarse.solve(left, kernel);
        for (i, &center) in self.coarse.centers.iter().enumerate() {
            (0..values.ncols()).for_each(|j| weights[(center, j)] += more[(i, j)]);
        }
        Ok(weights)
    }
}

/// Halves a part along the longest side of its box, until parts are small.
fn divide(centers: &[Point], mut part: Vec<usize>, parts: &mut Vec<Vec<usize>>) {
    if part.len() <= OWN {
        parts.push(part);
        return;
    }
    let [low, high] = bounds(centers, &part);
    let axis = (0..3).fold(0, |a, b| if high[b] - low[b] > high[a] - low[a] { b } else { a });
    let middle = part.len() / 2;
    part.select_nth_unstable_by(middle, |&a, &b| {
        centers[a][axis].total_cmp(&centers[b][axis]).then(a.cmp(&b))
    });
    let mut second = part.split_off(middle);
    part.sort_unstable();
    second.sort_unstable();
    divide(centers, part, parts);
    divide(centers, second, parts);
}

/// Centres of a part, and those next to its box.
fn with_surroundings(centers: &[Point], part: &[usize]) -> Vec<usize> {
    let [low, high] = bounds(centers, part);
    let mut is_own = vec![false; centers.len()];
    part.iter().for_each(|&i| is_own[i] = true);
    let beside =
        |p: &Point| (0..3).map(|k| (low[k] - p[k]).max(p[k] - high[k]).max(0.0).powi(2)).sum::<f64>();
    let mut others: Vec<(f64, usize)> =
        (0..centers.len()).filter(|&i| !is_own[i]).map(|i| (beside(&centers[i]), i)).collect();
    let wanted = (ALL - part.len()).min(others.len());
    if wanted < others.len() {
        others.select_nth_unstable_by(wanted, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        others.truncate(wanted);
    }
    let mut around: Vec<usize> = others.into_iter().map(|(_, i)| i).collect();
    around.sort_unstable();
    part.iter().copied().chain(around).collect()
}

fn bounds(centers: &[Point], part: &[usize]) -> [Point; 2] {
    let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for &i in part {
        for k in 0..3 {
            bounds[0][k] = bounds[0][k].min(centers[i][k]);
            bounds[1][k] = bounds[1][k].max(centers[i][k]);
        }
    }
    bounds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_centre_is_one_domain_s_own() {
        let centers: Vec<Point> = (0..1000).map(|i| [f64::from(i % 40), f64::from(i / 40), 0.0]).collect();
        let mut parts = Vec::new();
        divide(&centers, (0..1000).collect(), &mut parts);
        let mut all = parts.concat();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..1000) && parts.iter().all(|part| part.len() <= OWN));
        let around = with_surroundings(&centers, &parts[0]);
        assert_eq!(around.len(), ALL);
        assert_eq!(around[..parts[0].len()], parts[0]);
    }
}
