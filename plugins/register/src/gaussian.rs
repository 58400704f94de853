//! The low-rank Gaussian kernel of coherent point drift, and its field.
//!
//! A pivoted Cholesky decomposition takes the place of the largest eigenvalues (Myronenko and Song 2010,
//! §7). It leaves a kernel of a few centres, so that the displacement is a sum of Gaussians about these,
//! known anywhere.

use faer::Mat;
use glam::DVec3;

/// Greatest rest of the kernel's diagonal of ones.
const LEFT: f64 = 1e-6;

/// `G = L Lᵀ`, where `G` is the Gaussian of each two points' distance.
pub struct Kernel {
    /// Points that are centres.
    pivots: Vec<usize>,
    /// Factor L: a row for each point, a column for each centre.
    pub factor: Mat<f64>,
    width: f64,
}

impl Kernel {
    /// Kernel of points that a Gaussian of this width couples, by at most so many centres.
    pub fn new(points: &[DVec3], width: f64, most: usize) -> Self {
        let mut left = vec![1.0_f64; points.len()];
        let (mut pivots, mut columns): (Vec<usize>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        while pivots.len() < most.min(points.len()) {
            let Some((pivot, rest)) =
                left.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|l| l.1 > LEFT)
            else {
                break;
            };
            let mut column: Vec<f64> = points.iter().map(|p| gaussian(*p, points[pivot], width)).collect();
            for former in &columns {
                let by = former[pivot];
                column.iter_mut().zip(former).for_each(|(c, f)| *c -= by * f);
            }
            let root = rest.sqrt();
            for (c, l) in column.iter_mut().zip(&mut left) {
                *c /= root;
                *l -= *c * *c;
            }
            left[pivot] = 0.0;
            pivots.push(pivot);
            columns.push(column);
        }
        let factor = Mat::from_fn(points.len(), pivots.len(), |i, k| columns[k][i]);
        Self { pivots, factor, width }
    }

    /// The field whose displacements at the points are `L c`.
    pub fn field(&self, points: &[DVec3], coefficients: &Mat<f64>) -> Field {
        // The rows of the pivots are a triangle: its transpose is solved backwards.
        let count = self.pivots.len();
        let mut weights = vec![DVec3::ZERO; count];
        for k in (0..count).rev() {
            let own = DVec3::new(coefficients[(k, 0)], coefficients[(k, 1)], coefficients[(k, 2)]);
            let after = (k + 1..count).map(|j| self.factor[(self.pivots[j], k)] * weights[j]).sum::<DVec3>();
            weights[k] = (own - after) / self.factor[(self.pivots[k], k)];
        }
        Field { centers: self.pivots.iter().map(|i| points[*i]).zip(weights).collect(), width: self.width }
    }
}

fn gaussian(a: DVec3, b: DVec3, width: f64) -> f64 {
    (-a.distance_squared(b) / (2.0 * width * width)).exp()
}

/// A sum of Gaussians, as a displacement.
#[derive(Debug, Clone, Default)]
pub struct Field {
    centers: Vec<(DVec3, DVec3)>,
    width: f64,
}

impl Field {
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.centers.iter().fold(p, |q, (center, weight)| q + *weight * gaussian(p, *center, self.width))
    }
}
