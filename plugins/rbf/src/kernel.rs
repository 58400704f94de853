//! Sums of radial kernels: `Σ w_j φ(|x - c_j|) + affine(x)`, many functions over the same centres at once.
//!
//! The compact kernels are those of H. Wendland, *Piecewise polynomial, positive definite and compactly
//! supported radial functions of minimal degree*, Advances in Computational Mathematics 1995.

use crate::sums;
use faer::{MatMut, MatRef};
use simod_plugin_api::Choice;

/// A point or vector, in whichever space.
pub type Point = [f64; 3];

/// Points evaluated together, so that sums at them stay near the processor.
pub const BLOCK: usize = 128;

/// Weight of the side conditions among the equations.
const SIDE_WEIGHT: f64 = 1e2;

/// The radial function φ.
#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
pub enum RadialKernel {
    /// `r³`: least third-order energy in space, C² at the centres.
    #[choice(label = "Triharmonic (smooth)")]
    Triharmonic,
    /// `r`: least second-order energy, C⁰ at the centres, more local.
    #[choice(label = "Biharmonic (local)")]
    Biharmonic,
    /// `(1 - t)⁴ (4t + 1)` for `t = r / support < 1`: nothing beyond.
    #[choice(id = "compact-c2", label = "Compact, C²")]
    CompactC2,
    /// `(1 - t)⁶ (35t² + 18t + 3) / 3` for `t = r / support < 1`: nothing beyond.
    #[choice(id = "compact-c4", label = "Compact, C⁴")]
    CompactC4,
}

impl RadialKernel {
    /// Whether the kernel is zero beyond the support.
    pub fn is_compact(self) -> bool {
        matches!(self, Self::CompactC2 | Self::CompactC4)
    }

    /// Number of columns of the kernel's affine part: 1, x, y, z, or none. A compact kernel has none: it
    /// would reach everywhere.
    pub fn affine(self) -> usize {
        if self.is_compact() { 0 } else { 4 }
    }

    /// Value of the C² compact kernel at the squared distance `r2`; `per_support` is one over the support.
    #[inline(always)]
    pub fn compact_c2(r2: f64, per_support: f64) -> f64 {
        let t = (r2.sqrt() * per_support).min(1.0);
        let left2 = (1.0 - t) * (1.0 - t);
        left2 * left2 * (4.0 * t + 1.0)
    }

    /// Value of the C⁴ compact kernel, likewise.
    #[inline(always)]
    pub fn compact_c4(r2: f64, per_support: f64) -> f64 {
        let t = (r2.sqrt() * per_support).min(1.0);
        let left2 = (1.0 - t) * (1.0 - t);
        left2 * left2 * left2 * ((35.0 / 3.0 * t + 6.0) * t + 1.0)
    }
}

/// Moves the constraints' box to the unit box about 0, for the sake of conditioning.
#[derive(Debug, Clone, Copy)]
pub struct UnitBoxMap {
    origin: Point,
    scale: f64,
}

impl UnitBoxMap {
    /// Map of the points' box, whose longest side is taken to be `least` at least; `None` where it is nothing
    /// even so.
    pub fn from_points(points: &[Point], least: f64) -> Option<Self> {
        let mut min = [f64::INFINITY; 3];
        let mut max = [f64::NEG_INFINITY; 3];
        for p in points {
            for i in 0..3 {
                min[i] = min[i].min(p[i]);
                max[i] = max[i].max(p[i]);
            }
        }
        let extent = (0..3).map(|i| max[i] - min[i]).fold(least, f64::max);
        let scale = 1.0 / extent;
        (extent > 0.0 && scale.is_finite())
            .then(|| Self { origin: std::array::from_fn(|i| 0.5 * (min[i] + max[i])), scale })
    }

    /// Point of local coordinates in the unit box.
    pub fn to_unit(self, p: Point) -> Point {
        std::array::from_fn(|i| (p[i] - self.origin[i]) * self.scale)
    }

    /// Length in local coordinates as one in the unit box.
    pub fn to_unit_length(self, length: f64) -> f64 {
        length * self.scale
    }
}

/// Functions φ(|x - c_j|) for all centres, and 1, x, y, z where the kernel has an affine part, all in the
/// unit box.
#[derive(Debug, Clone)]
pub struct BasisFunctions {
    /// The radial function.
    pub kernel: RadialKernel,
    /// Radius of a compact kernel.
    pub support: f64,
    /// The centres c_j.
    pub centers: Vec<Point>,
}

impl BasisFunctions {
    /// Number of functions.
    pub fn count(&self) -> usize {
        self.centers.len() + self.kernel.affine()
    }

    /// Fills row `i` of `matrix` with the values at point `i` of the functions from `first` on, as many as
    /// there are columns: the functions of the affine part come first, then those of the centres.
    pub fn fill(&self, points: &[Point], first: usize, mut matrix: MatMut<'_, f64>) {
        let per_support = self.support.recip();
        for column in 0..matrix.ncols() {
            let values = matrix.as_mut().col_mut(column).try_as_col_major_mut();
            let values = values.expect("the matrices made here are column-major").as_slice_mut();
            let Some(center) = (first + column).checked_sub(self.kernel.affine()) else {
                let affine = |p: &Point| if first + column == 0 { 1.0 } else { p[first + column - 1] };
                values.iter_mut().zip(points).for_each(|(value, p)| *value = affine(p));
                continue;
            };
            let c = &self.centers[center];
            match self.kernel {
                RadialKernel::Triharmonic => radial(points, c, values, |r2| r2 * r2.sqrt()),
                RadialKernel::Biharmonic => radial(points, c, values, f64::sqrt),
                RadialKernel::CompactC2 => {
                    radial(points, c, values, |r2| RadialKernel::compact_c2(r2, per_support))
                }
                RadialKernel::CompactC4 => {
                    radial(points, c, values, |r2| RadialKernel::compact_c4(r2, per_support))
                }
            }
        }
    }

    /// Fills a matrix with the side conditions Σ w_j = 0, Σ w_j c_j = 0, a row each, which keep the far
    /// field affine: the coefficients of the functions from `first` on. Nothing where there is no affine
    /// part.
    pub fn side_conditions(&self, first: usize, mut matrix: MatMut<'_, f64>) {
        let affine = self.kernel.affine();
        for column in affine.saturating_sub(first)..matrix.ncols() {
            let c = &self.centers[first + column - affine];
            for row in 0..affine {
                matrix[(row, column)] = SIDE_WEIGHT * if row == 0 { 1.0 } else { c[row - 1] };
            }
        }
    }

    /// Sums with `weights` (functions x sums) at up to [`BLOCK`] points, sum by sum.
    pub fn sums(&self, points: &[Point], weights: MatRef<'_, f64>) -> Vec<[f64; BLOCK]> {
        let affine = self.kernel.affine();
        let (own, radial) = weights.split_at_row(affine);
        let mut sums = sums::block(self, points, radial);
        if affine > 0 {
            for (f, sum) in sums.iter_mut().enumerate() {
                for (value, p) in sum.iter_mut().zip(points) {
                    *value += own[(0, f)] + (0..3).map(|k| own[(k + 1, f)] * p[k]).sum::<f64>();
                }
            }
        }
        sums
    }
}

/// Fills the values of a function of the squared distance from `c`.
fn radial(points: &[Point], c: &Point, values: &mut [f64], phi: impl Fn(f64) -> f64) {
    for (value, p) in values.iter_mut().zip(points) {
        let d = [p[0] - c[0], p[1] - c[1], p[2] - c[2]];
        *value = phi(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    }
}
