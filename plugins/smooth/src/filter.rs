//! Filters of a surface's waves: polynomials of its Laplacian.
//!
//! G. Taubin, *A signal processing approach to fair surface design*, SIGGRAPH 1995; G. Taubin, T. Zhang, G.
//! Golub, *Optimal surface smoothing as filter design*, ECCV 1996, §4: Chebyshev polynomials, so that a
//! filter takes as many products with the Laplacian as its degree, and needs nothing but these.

use crate::laplacian::MeshLaplacian;
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};
use std::f64::consts::PI;

/// Number of vertices at once on one thread.
const BLOCK: usize = 4096;
/// Highest degree of a filter.
pub const MOST: usize = 4000;

/// Coefficients of Chebyshev polynomials in 1 - k, where k is an eigenvalue of the Laplacian, 0 to 2.
pub struct Filter(Vec<f64>);

impl Filter {
    /// Filter that keeps waves of `k` below a cut-off and leaves none above: half of the waves at the
    /// cut-off, all from half of its frequency down, none from one and a half up. An ideal filter, faded
    /// out by Hamming's window.
    pub fn low_pass(cut_off: f64) -> Self {
        let angle = (1.0 - cut_off).acos();
        // The width of the transition is 3.3 whole turns by twice the degree.
        let degree = ((3.3 * PI / angle).ceil() as usize).clamp(2, MOST);
        let coefficient = |n: usize| {
            let window = 0.54 + 0.46 * (PI * n as f64 / (degree + 1) as f64).cos();
            let ideal = if n == 0 { angle / PI } else { 2.0 * (n as f64 * angle).sin() / (n as f64 * PI) };
            window * ideal
        };
        Self::normalized((0..=degree).map(coefficient).collect())
    }

    /// Filter that leaves e^(-time k) of a wave, as a flow by the Laplacian does.
    pub fn flow(time: f64) -> Self {
        // Coefficients beyond this degree are below rounding (Taubin and others: like the root of the
        // time).
        let degree = ((12.0 * time.sqrt()).ceil() as usize + 12).min(MOST);
        let nodes = 2 * degree + 2;
        let at = |j: usize| PI * (j as f64 + 0.5) / nodes as f64;
        let values: Vec<f64> = (0..nodes).map(|j| (-time * (1.0 - at(j).cos())).exp()).collect();
        let coefficient = |n: usize| {
            let sum: f64 = values.iter().enumerate().map(|(j, value)| value * (n as f64 * at(j)).cos()).sum();
            sum * if n == 0 { 1.0 } else { 2.0 } / nodes as f64
        };
        Self::normalized((0..=degree).map(coefficient).collect())
    }

    /// Scales the coefficients so that constants stay: at k = 0 all polynomials are 1.
    fn normalized(coefficients: Vec<f64>) -> Self {
        let sum: f64 = coefficients.iter().sum();
        Self(coefficients.into_iter().map(|c| c / sum).collect())
    }

    /// Number of products with the Laplacian that the filter takes.
    pub fn degree(&self) -> usize {
        self.0.len() - 1
    }

    /// The part of a wave that the filter leaves.
    #[cfg(test)]
    pub fn response(&self, k: f64) -> f64 {
        let angle = (1.0 - k).acos();
        self.0.iter().enumerate().map(|(n, c)| c * (n as f64 * angle).cos()).sum()
    }

    /// Positions without the waves that the filter takes away. `progress` is told of parts of the whole.
    pub fn apply(
        &self,
        laplacian: &MeshLaplacian,
        positions: &[DVec3],
        host: &Host<'_>,
        progress: impl Fn(f64) -> PluginResult<()>,
    ) -> PluginResult<Vec<DVec3>> {
        if laplacian.scale == 0.0 {
            return Ok(positions.to_vec());
        }
        // Positions are relative to the first one, so that little is lost to rounding where coordinates are
        // large.
        let origin = positions.first().copied().unwrap_or_default();
        let mut before: Vec<DVec3> = positions.iter().map(|p| *p - origin).collect();
        let mut sum: Vec<DVec3> = before.iter().map(|p| *p * self.0[0]).collect();
        let mut current = before.clone();
        host.parallel_blocks(&mut current, BLOCK, |first, block| {
            (first..).zip(block).for_each(|(i, new)| *new = before[i] - laplacian.evaluate(i, &before));
        })?;
        for (n, coefficient) in self.0.iter().enumerate().skip(1) {
            host.parallel_blocks(&mut sum, BLOCK, |first, block| {
                (first..).zip(block).for_each(|(i, sum)| *sum += *coefficient * current[i]);
            })?;
            if n < self.degree() {
                // The next polynomial takes the place of the one before.
                host.parallel_blocks(&mut before, BLOCK, |first, block| {
                    for (i, old) in (first..).zip(block) {
                        *old = 2.0 * (current[i] - laplacian.evaluate(i, &current)) - *old;
                    }
                })?;
                std::mem::swap(&mut before, &mut current);
            }
            progress(n as f64 / self.degree() as f64)?;
        }
        let new = |(i, sum): (usize, DVec3)| if laplacian.holds(i) { positions[i] } else { sum + origin };
        Ok(sum.into_iter().enumerate().map(new).collect())
    }
}
