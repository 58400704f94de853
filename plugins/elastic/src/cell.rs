//! Gradients of a cell's deformation at eight points and in its middle, and the forces at its corners that
//! stresses at these points make. The points lie beside each other, so that the compiler makes vectors of
//! them; the same numbers come out of any.

use glam::{DMat3, DVec3};
use std::array::from_fn;
use std::ops::{Add, Mul, Sub};

/// A number for each of the eight points, or corners.
#[derive(Debug, Clone, Copy)]
pub struct Eight(pub [f64; 8]);

/// Forces on a cell's corners, along each axis.
pub type Forces = [Eight; 3];
/// A matrix at each point, column by column.
pub type Matrices = [[Eight; 3]; 3];

/// The slopes of a cell's weights at its points and in its middle.
#[derive(Debug)]
pub struct Slopes {
    /// The slope of each corner's weight along each axis, point by point.
    points: [[Eight; 3]; 8],
    /// Slopes at each point along each axis, corner by corner; the middle is the last.
    corners: [[Eight; 3]; 9],
}

/// The gradients of a cell's deformation, or its stresses.
#[derive(Debug, Clone)]
pub struct CellGradients {
    pub points: Matrices,
    pub middle: DMat3,
}

impl Eight {
    pub const ZERO: Self = Self([0.0; 8]);

    #[inline(always)]
    pub fn all(x: f64) -> Self {
        Self([x; 8])
    }
}

impl Add for Eight {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(from_fn(|i| self.0[i] + other.0[i]))
    }
}

impl Sub for Eight {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(from_fn(|i| self.0[i] - other.0[i]))
    }
}

impl Mul for Eight {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(from_fn(|i| self.0[i] * other.0[i]))
    }
}

#[inline(always)]
pub fn dot(a: [Eight; 3], b: [Eight; 3]) -> Eight {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub fn cross(a: [Eight; 3], b: [Eight; 3]) -> [Eight; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

impl CellGradients {
    pub const NONE: Self = Self { points: [[Eight::ZERO; 3]; 3], middle: DMat3::ZERO };
}

impl Slopes {
    /// A table of the slopes of the corners' weights at the points, and in the middle.
    pub fn new(points: &[[DVec3; 8]; 8], middle: &[DVec3; 8]) -> Self {
        let at = |point: usize, corner: usize, axis: usize| points.get(point).unwrap_or(middle)[corner][axis];
        Self {
            points: from_fn(|corner| from_fn(|axis| Eight(from_fn(|point| at(point, corner, axis))))),
            corners: from_fn(|point| from_fn(|axis| Eight(from_fn(|corner| at(point, corner, axis))))),
        }
    }

    /// Gradients of the deformation of a cell whose corners are here.
    #[inline(always)]
    pub fn deform(&self, corners: &[DVec3; 8]) -> CellGradients {
        let mut all = CellGradients::NONE;
        for (corner, x) in corners.iter().enumerate() {
            for axis in 0..3 {
                let slopes = self.points[corner][axis];
                for row in 0..3 {
                    all.points[axis][row] = all.points[axis][row] + Eight::all(x[row]) * slopes;
                }
                *all.middle.col_mut(axis) += *x * self.corners[8][axis].0[corner];
            }
        }
        all
    }

    /// Adds the forces at the corners that stresses make, which are weighted by their points' volumes.
    #[inline(always)]
    pub fn add(&self, stresses: &CellGradients, forces: &mut Forces) {
        let mut sums = *forces;
        for (point, slopes) in self.corners.iter().enumerate() {
            for (axis, slopes) in slopes.iter().enumerate() {
                for (row, sum) in sums.iter_mut().enumerate() {
                    let stress = match stresses.points[axis][row].0.get(point) {
                        Some(stress) => *stress,
                        None => stresses.middle.col(axis)[row],
                    };
                    *sum = *sum + Eight::all(stress) * *slopes;
                }
            }
        }
        *forces = sums;
    }
}
