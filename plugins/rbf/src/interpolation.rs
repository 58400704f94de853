//! Interpolation of given values at very many centres.
//!
//! The equations are solved by GMRES (Y. Saad, M. Schultz, SIAM Journal on Scientific and Statistical
//! Computing 1986), for all right-hand sides side by side, with `domains` as an approximate inverse: some ten
//! steps, each of which sums all kernels at all centres once.

use crate::domains::Domains;
use crate::kernel::BasisFunctions;
use crate::side::SideConditions;
use crate::sums::sums_at;
use faer::Mat;
use simod_plugin_api::{Host, PluginResult};

/// Number of steps until the residual is computed anew, against rounding.
const STEPS: usize = 24;
/// Greatest number of times that the residual is computed anew.
const CYCLES: usize = 3;
/// Part of the residual: a cycle that leaves more has come to where rounding ends it.
const WORTH: f64 = 0.3;

/// Weights by which the functions are `targets` at their centres, to the tolerance or as near as rounding
/// lets them: functions x sums, of `targets` centres x sums. They are found from those of `start`, centres x
/// sums, that meet the side conditions; the nearer these come, the fewer steps it takes.
pub fn interpolate(
    functions: &BasisFunctions,
    targets: &Mat<f64>,
    start: Mat<f64>,
    tolerance: f64,
    host: &Host<'_>,
) -> PluginResult<Mat<f64>> {
    let side = SideConditions::new(functions.kernel, &functions.centers);
    let domains = Domains::new(functions, &side, host)?;
    let system = System { functions, side: &side, domains: &domains };
    let mut weights = start;
    let mut left = targets - sums_at(functions, &functions.centers, weights.as_ref(), host)?;
    let mut before = f64::INFINITY;
    for _ in 0..CYCLES {
        let mut off = left.clone();
        side.take_out(off.as_mut());
        let most = off.norm_max();
        if most <= tolerance || most > WORTH * before {
            break;
        }
        before = most;
        weights += system.descend(&off, tolerance, host)?;
        left = targets - sums_at(functions, &functions.centers, weights.as_ref(), host)?;
    }
    let affine = side.nearest(left.as_ref());
    let rows = functions.kernel.affine();
    Ok(Mat::from_fn(rows + weights.nrows(), weights.ncols(), |i, j| {
        if i < rows { affine[(i, j)] } else { weights[(i - rows, j)] }
    }))
}

/// The equations, without the affine part.
struct System<'a> {
    functions: &'a BasisFunctions,
    side: &'a SideConditions,
    domains: &'a Domains<'a>,
}

impl System<'_> {
    /// A cycle: weights that meet `right` to about the tolerance.
    fn descend(&self, right: &Mat<f64>, tolerance: f64, host: &Host<'_>) -> PluginResult<Mat<f64>> {
        let sums = right.ncols();
        let mut small: Vec<Hessenberg> = Vec::new();
        let mut first = right.clone();
        for j in 0..sums {
            let length = right.col(j).norm_l2();
            small.push(Hessenberg::new(length));
            scale(&mut first, j, length);
        }
        let mut basis = vec![first];
        for step in 0..STEPS {
            host.progress(0.0)?;
            let weights = self.domains.solve(&basis[step], host)?;
            let mut next = sums_at(self.functions, &self.functions.centers, weights.as_ref(), host)?;
            self.side.take_out(next.as_mut());
            for (j, small) in small.iter_mut().enumerate() {
                let mut column = Vec::with_capacity(step + 2);
                for vector in &basis {
                    let share = vector.col(j).transpose() * next.col(j);
                    column.push(share);
                    (0..next.nrows()).for_each(|i| next[(i, j)] -= share * vector[(i, j)]);
                }
                let length = next.col(j).norm_l2();
                column.push(length);
                small.push(column);
                scale(&mut next, j, length);
            }
            basis.push(next);
            if small.iter().all(|s| s.left() <= tolerance) {
                break;
            }
        }
        let mut combined = Mat::zeros(right.nrows(), sums);
        for (j, small) in small.iter().enumerate() {
            for (share, vector) in small.solve().into_iter().zip(&basis) {
                (0..combined.nrows()).for_each(|i| combined[(i, j)] += share * vector[(i, j)]);
            }
        }
        self.domains.solve(&combined, host)
    }
}

/// Divides a column by its length, if it has one.
fn scale(matrix: &mut Mat<f64>, column: usize, length: f64) {
    let by = if length > 0.0 { length.recip() } else { 0.0 };
    (0..matrix.nrows()).for_each(|i| matrix[(i, column)] *= by);
}

/// Least squares of one right-hand side, kept triangular by rotations.
struct Hessenberg {
    columns: Vec<Vec<f64>>,
    rotations: Vec<[f64; 2]>,
    right: Vec<f64>,
}

impl Hessenberg {
    fn new(length: f64) -> Self {
        Self { columns: Vec::new(), rotations: Vec::new(), right: vec![length] }
    }

    /// Takes a column, of one entry more than the last.
    fn push(&mut self, mut column: Vec<f64>) {
        for (i, [c, s]) in self.rotations.iter().enumerate() {
            let [a, b] = [column[i], column[i + 1]];
            (column[i], column[i + 1]) = (c * a + s * b, c * b - s * a);
        }
        let last = column.len() - 2;
        let [a, b] = [column[last], column[last + 1]];
        let length = a.hypot(b);
        let [c, s] = if length > 0.0 { [a / length, b / length] } else { [1.0, 0.0] };
        self.rotations.push([c, s]);
        column[last] = length;
        column.pop();
        let left = self.right[last];
        self.right[last] = c * left;
        self.right.push(-s * left);
        self.columns.push(column);
    }

    /// Length of the residual.
    fn left(&self) -> f64 {
        self.right.last().map_or(0.0, |x| x.abs())
    }

    fn solve(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.columns.len()];
        for i in (0..x.len()).rev() {
            let known: f64 = (i + 1..x.len()).map(|k| self.columns[k][i] * x[k]).sum();
            let own = self.columns[i][i];
            x[i] = if own == 0.0 { 0.0 } else { (self.right[i] - known) / own };
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{Point, RadialKernel};

    #[test]
    fn what_is_met_already_takes_no_step() {
        let point = |i: usize| [0.37, 0.61, 0.83].map(|by| (i as f64 * by).fract() - 0.5);
        let centers: Vec<Point> = (0..700).map(point).collect();
        for kernel in [RadialKernel::Triharmonic, RadialKernel::Biharmonic, RadialKernel::CompactC2] {
            let targets = Mat::from_fn(700, 2, |i, f| (5.0 * centers[i][f]).sin() + f as f64);
            let functions = BasisFunctions { kernel, support: 0.3, centers: centers.clone() };
            let solve =
                |start: Mat<f64>| interpolate(&functions, &targets, start, 1e-8, &Host::new(&())).unwrap();
            let first = solve(Mat::zeros(700, 2));
            let found = first.subrows(kernel.affine(), 700).to_owned();
            let again = solve(found.clone());
            assert_eq!(again.subrows(kernel.affine(), 700), found, "{kernel:?}");
            // A start that is far off leads to the same values, at the centres and between them.
            let other = solve(Mat::from_fn(700, 2, |i, f| found[(i, f)] * 1.5));
            let values = |weights: &Mat<f64>, points: &[Point]| functions.sums(points, weights.as_ref());
            for (points, first) in centers.chunks(100).zip((0..).step_by(100)) {
                let between: Vec<Point> = points.iter().map(|p| p.map(|x| 0.9 * x)).collect();
                let here = values(&other, points);
                let [a, b] = [&again, &other].map(|weights| values(weights, &between));
                for (i, f) in (0..100).flat_map(|i| [(i, 0), (i, 1)]) {
                    assert!((here[f][i] - targets[(first + i, f)]).abs() < 2e-8, "{kernel:?}");
                    assert!((a[f][i] - b[f][i]).abs() < 1e-6, "{kernel:?}: {:.1e}", a[f][i] - b[f][i]);
                }
            }
        }
    }
}
