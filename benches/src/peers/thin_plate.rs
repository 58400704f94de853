//! Local thin-plate splines: r² log r and an affine polynomial through the nearest samples, as in
//! `RBFInterpolator` of SciPy (after G. Fasshauer, *Meshfree approximation methods with MATLAB*, 2007).

use std::num::NonZeroUsize;

use glam::DVec3;

use super::{Cloud, Field, Sample};

const NEIGHBOURS: NonZeroUsize = NonZeroUsize::new(16).expect("more than 0");

/// Unknowns: a coefficient per sample, and those of the polynomial.
const SIZE: usize = NEIGHBOURS.get() + 4;

/// Keeps the system solvable where samples lie in a plane; the coordinates in it are of about 1. SciPy gives
/// up there.
const RIDGE: f64 = 1e-12;

pub struct ThinPlate(pub Cloud);

impl Field for ThinPlate {
    fn displacement(&self, p: DVec3) -> DVec3 {
        let near: Vec<Sample> = self.0.nearest(p, NEIGHBOURS).collect();
        // In coordinates about the point, at unit size: the spline does not depend on it.
        let scale = near.last().map_or(1.0, |last| last.position.distance(p)).max(f64::MIN_POSITIVE).recip();
        let x: Vec<DVec3> = near.iter().map(|sample| (sample.position - p) * scale).collect();

        // The system is symmetric: solved for its values at the point, it gives the weight of each sample
        // there.
        let mut system = [[0.0; SIZE + 1]; SIZE];
        for (i, a) in x.iter().enumerate() {
            for (j, b) in x.iter().enumerate() {
                system[i][j] = kernel(a.distance_squared(*b));
            }
            for (j, term) in (NEIGHBOURS.get()..).zip([1.0, a.x, a.y, a.z]) {
                (system[i][j], system[j][i]) = (term, term);
            }
            system[i][SIZE] = kernel(a.length_squared());
        }
        (NEIGHBOURS.get()..SIZE).for_each(|i| system[i][i] = -RIDGE);
        system[NEIGHBOURS.get()][SIZE] = 1.0;
        match solve(&mut system) {
            Some(weights) => near.iter().zip(weights).map(|(sample, w)| sample.displacement * w).sum(),
            // Coincident samples, or fewer than there have to be.
            None => near[0].displacement,
        }
    }
}

/// r² log r of a squared distance.
fn kernel(square: f64) -> f64 {
    if square > 0.0 { 0.5 * square * square.ln() } else { 0.0 }
}

/// Solves a system whose last column is the right-hand side, by elimination with partial pivoting.
fn solve(system: &mut [[f64; SIZE + 1]; SIZE]) -> Option<[f64; SIZE]> {
    for column in 0..SIZE {
        let size = |row: &usize| system[*row][column].abs();
        let pivot = (column..SIZE).max_by(|a, b| size(a).total_cmp(&size(b)))?;
        system.swap(column, pivot);
        let (above, below) = system.split_at_mut(column + 1);
        let pivot = &above[column];
        if pivot[column] == 0.0 {
            return None;
        }
        for row in below {
            let factor = row[column] / pivot[column];
            for (x, y) in row[column..].iter_mut().zip(&pivot[column..]) {
                *x -= factor * y;
            }
        }
    }
    let mut solution = [0.0; SIZE];
    for row in (0..SIZE).rev() {
        let known: f64 = (row + 1..SIZE).map(|i| system[row][i] * solution[i]).sum();
        solution[row] = (system[row][SIZE] - known) / system[row][row];
    }
    Some(solution)
}
