//! Sums of radial kernels: `Σ w_j φ(|x - c_j|) + affine(x)`, many functions over the same centres at once.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use simod_plugin_api::Choice;

/// A point or vector, in whichever space.
pub type Point = [f64; 3];

/// Points evaluated together: their kernels to all centres are one matrix, of `BLOCK` x centres.
pub const BLOCK: usize = 128;

/// Columns of the affine part.
pub const AFFINE: usize = 4;

/// The radial function φ.
#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// `r³`: least third-order energy in space, C² at the centres.
    #[choice(label = "Triharmonic (smooth)")]
    Triharmonic,
    /// `r`: least second-order energy, C⁰ at the centres, more local.
    #[choice(label = "Biharmonic (local)")]
    Biharmonic,
}

/// Moves the constraints' box to the unit box about 0, for the sake of conditioning.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    origin: Point,
    scale: f64,
}

impl Frame {
    /// The frame of a box; nothing where it has no extent.
    pub fn of(points: &[Point]) -> Option<Self> {
        let mut min = [f64::INFINITY; 3];
        let mut max = [f64::NEG_INFINITY; 3];
        for p in points {
            for i in 0..3 {
                min[i] = min[i].min(p[i]);
                max[i] = max[i].max(p[i]);
            }
        }
        let extent = (0..3).map(|i| max[i] - min[i]).fold(0.0, f64::max);
        let scale = 1.0 / extent;
        (extent > 0.0 && scale.is_finite())
            .then(|| Self { origin: std::array::from_fn(|i| 0.5 * (min[i] + max[i])), scale })
    }

    /// From local coordinates to the unit box.
    pub fn to_unit(self, p: Point) -> Point {
        std::array::from_fn(|i| (p[i] - self.origin[i]) * self.scale)
    }

    /// From a length in the unit box to the model's unit.
    pub fn to_local_length(self, length: f64) -> f64 {
        length / self.scale
    }
}

/// The functions φ(|x - c_j|) for all centres, and 1, x, y, z. Everything in the unit box.
#[derive(Debug, Clone)]
pub struct Functions {
    /// The radial function.
    pub kernel: Kernel,
    /// The centres c_j.
    pub centers: Vec<Point>,
}

impl Functions {
    /// How many functions there are.
    pub fn count(&self) -> usize {
        self.centers.len() + AFFINE
    }

    /// Row `i` of `matrix` gets the functions' values at point `i`.
    pub fn fill(&self, points: &[Point], mut matrix: MatMut<'_, f64>) {
        for (j, c) in self.centers.iter().enumerate() {
            let column = matrix.as_mut().col_mut(j).try_as_col_major_mut();
            let column = column.expect("the matrices made here are column-major").as_slice_mut();
            for (value, p) in column.iter_mut().zip(points) {
                let d = [p[0] - c[0], p[1] - c[1], p[2] - c[2]];
                let r2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                *value = match self.kernel {
                    Kernel::Triharmonic => r2 * r2.sqrt(),
                    Kernel::Biharmonic => r2.sqrt(),
                };
            }
        }
        for (i, p) in points.iter().enumerate() {
            matrix[(i, self.centers.len())] = 1.0;
            for k in 0..3 {
                matrix[(i, self.centers.len() + 1 + k)] = p[k];
            }
        }
    }

    /// Sums with `weights` (functions x sums): row `i` of the result belongs to point `i`. At most [`BLOCK`]
    /// points; `scratch` is reused from call to call.
    pub fn sums<'s>(
        &self,
        points: &[Point],
        weights: MatRef<'_, f64>,
        scratch: &'s mut Block,
    ) -> MatRef<'s, f64> {
        scratch.fit(self.count(), weights.ncols());
        self.fill(points, scratch.values.as_mut());
        let values = scratch.values.as_ref().subrows(0, points.len());
        let mut sums = scratch.sums.as_mut().subrows_mut(0, points.len());
        matmul(sums.as_mut(), Accum::Replace, values, weights, 1.0, Par::Seq);
        scratch.sums.as_ref().subrows(0, points.len())
    }
}

/// Working memory for one block of points.
#[derive(Debug)]
pub struct Block {
    values: Mat<f64>,
    sums: Mat<f64>,
}

impl Default for Block {
    fn default() -> Self {
        Self { values: Mat::new(), sums: Mat::new() }
    }
}

impl Block {
    fn fit(&mut self, functions: usize, sums: usize) {
        if self.values.ncols() != functions {
            self.values = Mat::zeros(BLOCK, functions);
        }
        if self.sums.ncols() != sums {
            self.sums = Mat::zeros(BLOCK, sums);
        }
    }
}
