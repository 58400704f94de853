//! Spherical harmonics under a rotation: a colour c(d) of directions becomes c(Qᵀd).
//!
//! The bands are those of 3D Gaussian splatting, with its signs and order. Each band is closed under
//! rotations, so the new coefficients are those for which both sides agree in as many directions as the band
//! has functions; the directions are fixed, and so is the inverse of the matrix of the functions' values
//! there.

use std::sync::LazyLock;

use glam::{DMat3, DVec3};

/// Functions of bands 1 to 3.
const SIZES: [usize; 3] = [3, 5, 7];

/// The most functions of a band.
const MOST: usize = 7;

type Square = [[f64; MOST]; MOST];

/// Functions of a band, from 1 to 3, at a unit direction; entries beyond the band are 0.
pub(super) fn band(band: usize, d: DVec3) -> [f64; MOST] {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    match band {
        1 => {
            const C: f64 = 0.488_602_511_902_919_9;
            [-C * y, C * z, -C * x, 0.0, 0.0, 0.0, 0.0]
        }
        2 => {
            const C: [f64; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
            [
                C[0] * x * y,
                -C[0] * y * z,
                C[1] * (2.0 * zz - xx - yy),
                -C[0] * x * z,
                C[2] * (xx - yy),
                0.0,
                0.0,
            ]
        }
        _ => {
            const C: [f64; 5] = [
                0.590_043_589_926_643_5,
                2.890_611_442_640_554,
                0.457_045_799_464_465_8,
                0.373_176_332_590_115_4,
                1.445_305_721_320_277,
            ];
            [
                -C[0] * y * (3.0 * xx - yy),
                C[1] * x * y * z,
                -C[2] * y * (4.0 * zz - xx - yy),
                C[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                -C[2] * x * (4.0 * zz - xx - yy),
                C[4] * z * (xx - yy),
                -C[0] * x * (xx - 3.0 * yy),
            ]
        }
    }
}

/// Directions that are spread well, none opposite to another.
static DIRECTIONS: LazyLock<[DVec3; MOST]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        // A spiral over the upper half of the sphere, by the golden angle.
        let z = 1.0 - (i as f64 + 0.5) / MOST as f64;
        let (sin, cos) = (2.399_963_229_728_653 * i as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    })
});

/// Matrix for each band that gives coefficients from the values in the first directions: for each direction,
/// the part of its value in all coefficients.
static INVERSES: LazyLock<[Square; 3]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let values = DIRECTIONS.map(|d| band(i + 1, d));
        let rows = inverse(&values, SIZES[i]);
        std::array::from_fn(|k| std::array::from_fn(|row| rows[row][k]))
    })
});

/// The inverse of the upper left part of a matrix, which is known to have one.
fn inverse(m: &Square, size: usize) -> Square {
    let mut left = *m;
    let mut right = [[0.0; MOST]; MOST];
    (0..size).for_each(|i| right[i][i] = 1.0);
    for column in 0..size {
        let rows = column..size;
        let pivot = rows.max_by(|a, b| left[*a][column].abs().total_cmp(&left[*b][column].abs()));
        let pivot = pivot.unwrap_or(column);
        left.swap(column, pivot);
        right.swap(column, pivot);
        let factor = 1.0 / left[column][column];
        for i in 0..size {
            left[column][i] *= factor;
            right[column][i] *= factor;
        }
        for row in (0..size).filter(|row| *row != column) {
            let factor = left[row][column];
            for i in 0..size {
                left[row][i] -= factor * left[column][i];
                right[row][i] -= factor * right[column][i];
            }
        }
    }
    right
}

/// Matrices that rotate the coefficients of bands 1 up to some degree.
pub(super) struct BandRotation {
    /// Matrix of each band: a row for each coefficient before, with its part in all coefficients of the band.
    bands: [Square; 3],
}

impl BandRotation {
    /// The rotation by an orthogonal matrix, which may be a mirror.
    pub(super) fn new(q: &DMat3, degree: usize) -> Self {
        let back = q.transpose();
        let mut bands = [[[0.0; MOST]; MOST]; 3];
        for (i, to) in bands.iter_mut().enumerate().take(degree) {
            for (direction, inverse) in DIRECTIONS.iter().zip(&INVERSES[i]).take(SIZES[i]) {
                let before = band(i + 1, back * *direction);
                // Whole rows are computed at once: entries beyond the band are 0.
                for (column, b) in to.iter_mut().zip(before).take(SIZES[i]) {
                    column.iter_mut().zip(inverse).for_each(|(entry, a)| *entry += a * b);
                }
            }
        }
        Self { bands }
    }

    /// Turns the coefficients of one channel: those of band 1, and of further bands if there are any.
    pub(super) fn apply(&self, coefficients: &mut [f64]) {
        let mut first = 0;
        for (columns, size) in self.bands.iter().zip(SIZES) {
            let Some(band) = coefficients.get_mut(first..first + size) else { return };
            let mut after = [0.0; MOST];
            for (before, column) in band.iter().zip(columns) {
                after.iter_mut().zip(column).for_each(|(to, part)| *to += part * before);
            }
            band.copy_from_slice(&after[..size]);
            first += size;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, EulerRot};

    /// Directions all over the sphere.
    fn directions() -> impl Iterator<Item = DVec3> {
        (0..100).map(|i| {
            let (z, angle) = ((f64::from(i) + 0.5) / 50.0 - 1.0, f64::from(i) * 2.4);
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * angle.cos(), r * angle.sin(), z)
        })
    }

    fn value(coefficients: &[f64], d: DVec3) -> f64 {
        let all = [band(1, d).to_vec(), band(2, d)[..5].to_vec(), band(3, d).to_vec()];
        let all = [&all[0][..3], &all[1], &all[2]].concat();
        coefficients.iter().zip(&all).map(|(c, y)| c * y).sum()
    }

    #[test]
    fn functions_are_orthonormal() {
        // Fine enough a sum for polynomials of degree 6.
        let (rings, around) = (400, 16);
        let mut products = [[0.0; 15]; 15];
        for i in 0..rings {
            for j in 0..around {
                let z = (f64::from(i) + 0.5) / f64::from(rings) * 2.0 - 1.0;
                let angle = f64::from(j) / f64::from(around) * std::f64::consts::TAU;
                let r = (1.0 - z * z).sqrt();
                let d = DVec3::new(r * angle.cos(), r * angle.sin(), z);
                let all = [&band(1, d)[..3], &band(2, d)[..5], &band(3, d)].concat();
                for (a, row) in products.iter_mut().enumerate() {
                    (0..15).for_each(|b| row[b] += all[a] * all[b]);
                }
            }
        }
        let area = 4.0 * std::f64::consts::PI / f64::from(rings * around);
        for (a, row) in products.iter().enumerate() {
            for (b, product) in row.iter().enumerate() {
                let expected = if a == b { 1.0 } else { 0.0 };
                assert!((product * area - expected).abs() < 1e-4, "{a} {b}: {}", product * area);
            }
        }
    }

    #[test]
    fn rotated_functions_are_those_of_rotated_directions() {
        let rotation = DMat3::from_quat(DQuat::from_euler(EulerRot::ZXY, 1.0, -0.6, 2.9));
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        let coefficients: Vec<f64> = (0..15).map(|i| f64::from(i * 7 % 5) - 1.7).collect();
        for q in [rotation, mirror * rotation, DMat3::IDENTITY] {
            for (degree, count) in [(1, 3), (2, 8), (3, 15)] {
                let mut turned = coefficients[..count].to_vec();
                BandRotation::new(&q, degree).apply(&mut turned);
                for d in directions() {
                    let (found, expected) =
                        (value(&turned, d), value(&coefficients[..count], q.transpose() * d));
                    assert!((found - expected).abs() < 1e-12, "degree {degree}, {d}: {found}, {expected}");
                }
            }
        }
    }
}
