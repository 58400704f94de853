//! Ornaments as periodic height tiles, smooth enough for exact normals at any density.

use rayon::prelude::*;

/// A periodic height field on the unit square: texels as the control points of a bicubic B-spline, which is
/// twice continuously differentiable and rounds the edges of what was drawn by about a texel.
pub(super) struct ReliefTile {
    width: usize,
    height: usize,
    texels: Vec<f32>,
}

impl ReliefTile {
    /// Draws a tile: `ornament` gives the height in [0, 1] at a point of the unit square, y up.
    pub fn new(width: usize, height: usize, ornament: impl Fn(f64, f64) -> f64 + Sync) -> Self {
        let texels = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let x = ((i % width) as f64 + 0.5) / width as f64;
                let y = ((i / width) as f64 + 0.5) / height as f64;
                ornament(x, y) as f32
            })
            .collect();
        Self { width, height, texels }
    }

    /// Height at any point of the plane, and its derivatives by `x` and `y`.
    pub fn sample(&self, x: f64, y: f64) -> (f64, f64, f64) {
        let (columns, wx, dx) = taps(x, self.width);
        let (rows, wy, dy) = taps(y, self.height);
        let (mut value, mut by_x, mut by_y) = (0.0, 0.0, 0.0);
        for (j, row) in rows.into_iter().enumerate() {
            let row = &self.texels[row * self.width..][..self.width];
            let texels = columns.map(|c| f64::from(row[c]));
            let dot =
                |w: &[f64; 4]| w[0] * texels[0] + w[1] * texels[1] + w[2] * texels[2] + w[3] * texels[3];
            value += wy[j] * dot(&wx);
            by_x += wy[j] * dot(&dx);
            by_y += dy[j] * dot(&wx);
        }
        (value, by_x, by_y)
    }
}

/// The four texels around a coordinate, with the weights of value and derivative.
fn taps(x: f64, count: usize) -> ([usize; 4], [f64; 4], [f64; 4]) {
    let n = count as f64;
    let x = (x - x.floor()) * n - 0.5;
    let cell = x.floor();
    let t = x - cell;
    let first = cell as isize - 1;
    let indices = [0, 1, 2, 3].map(|i| (first + i).rem_euclid(count as isize) as usize);
    let (u, t2, t3) = (1.0 - t, t * t, t * t * t);
    let weights = [u * u * u, 3.0 * t3 - 6.0 * t2 + 4.0, 3.0 * (t + t2 - t3) + 1.0, t3].map(|w| w / 6.0);
    let slopes = [-u * u, 3.0 * t2 - 4.0 * t, 1.0 + 2.0 * t - 3.0 * t2, t2].map(|w| w * 0.5 * n);
    (indices, weights, slopes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn sampled_wave_has_its_derivatives_and_wraps() {
        let tile = ReliefTile::new(64, 32, |x, y| 0.5 + 0.25 * (TAU * x).sin() + 0.25 * (TAU * y).cos());
        for i in 0..50 {
            let (x, y) = (f64::from(i) * 0.083 - 2.0, f64::from(i) * 0.131);
            let (value, by_x, by_y) = tile.sample(x, y);
            assert!((value - (0.5 + 0.25 * (TAU * x).sin() + 0.25 * (TAU * y).cos())).abs() < 5e-3);
            let h = 1e-6;
            let dx = (tile.sample(x + h, y).0 - tile.sample(x - h, y).0) / (2.0 * h);
            let dy = (tile.sample(x, y + h).0 - tile.sample(x, y - h).0) / (2.0 * h);
            assert!((dx - by_x).abs() < 1e-6 && (dy - by_y).abs() < 1e-6);
            assert!((tile.sample(x + 1.0, y - 3.0).0 - value).abs() < 1e-9);
        }
    }
}
