//! Sums of radial kernels at many points: most of the time is spent here, once there are many centres.

use crate::TOGETHER;
use crate::kernel::{BLOCK, BasisFunctions, Point, RadialKernel};
use faer::{Mat, MatRef};
use pulp::{Arch, Simd, WithSimd};
use simod_plugin_api::{Host, PluginResult};

/// The sums without an affine part: points x sums, of weights centres x sums.
pub fn sums_at(
    functions: &BasisFunctions,
    points: &[Point],
    weights: MatRef<'_, f64>,
    host: &Host<'_>,
) -> PluginResult<Mat<f64>> {
    let sums = weights.ncols();
    let mut rows = vec![0.0; points.len() * sums];
    // Blocks are whole, and few at a time, so that all threads have some.
    let together = (TOGETHER / 16).max(1) * BLOCK;
    host.parallel_blocks(&mut rows, (together * sums).max(1), |first, rows| {
        let points = &points[first / sums..];
        for (points, rows) in points.chunks(BLOCK).zip(rows.chunks_mut(BLOCK * sums)) {
            let block = block(functions, points, weights);
            for (i, row) in rows.chunks_exact_mut(sums).enumerate() {
                row.iter_mut().zip(&block).for_each(|(value, sum)| *value = sum[i]);
            }
        }
    })?;
    Ok(Mat::from_fn(points.len(), sums, |i, j| rows[i * sums + j]))
}

/// The sums at up to [`BLOCK`] points, sum by sum.
pub fn block(functions: &BasisFunctions, points: &[Point], weights: MatRef<'_, f64>) -> Vec<[f64; BLOCK]> {
    let mut sums = vec![[0.0; BLOCK]; weights.ncols()];
    let mut at = [[0.0; BLOCK]; 3];
    for (i, p) in points.iter().take(BLOCK).enumerate() {
        (0..3).for_each(|k| at[k][i] = p[k]);
    }
    let per_support = functions.support.recip();
    let BasisFunctions { kernel, centers, .. } = functions;
    let arch = Arch::new();
    let (at, to) = (&at, &mut sums[..]);
    match kernel {
        RadialKernel::Triharmonic => {
            arch.dispatch(Summing { at, centers, weights, sums: to, phi: |r2: f64| r2 * r2.sqrt() })
        }
        RadialKernel::Biharmonic => arch.dispatch(Summing { at, centers, weights, sums: to, phi: f64::sqrt }),
        RadialKernel::CompactC2 => {
            let phi = |r2| RadialKernel::compact_c2(r2, per_support);
            arch.dispatch(Summing { at, centers, weights, sums: to, phi });
        }
        RadialKernel::CompactC4 => {
            let phi = |r2| RadialKernel::compact_c4(r2, per_support);
            arch.dispatch(Summing { at, centers, weights, sums: to, phi });
        }
    }
    sums
}

/// Loops over vectors of the processor's width. Nothing is fused, so that all widths give the same bits.
struct Summing<'a, F> {
    at: &'a [[f64; BLOCK]; 3],
    centers: &'a [Point],
    weights: MatRef<'a, f64>,
    sums: &'a mut [[f64; BLOCK]],
    phi: F,
}

impl<F: Fn(f64) -> f64> WithSimd for Summing<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { at: [x, y, z], centers, weights, sums, phi } = self;
        let mut values = [0.0; BLOCK];
        for (j, c) in centers.iter().enumerate() {
            for i in 0..BLOCK {
                let [dx, dy, dz] = [x[i] - c[0], y[i] - c[1], z[i] - c[2]];
                values[i] = phi(dx * dx + dy * dy + dz * dz);
            }
            for (f, sum) in sums.iter_mut().enumerate() {
                let weight = weights[(j, f)];
                for i in 0..BLOCK {
                    sum[i] += weight * values[i];
                }
            }
        }
    }
}
