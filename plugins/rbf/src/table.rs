//! The solutions' values at all samples, and the images of the samples by a motion, many samples at a time.

use crate::constraints::RegionSamples;
use crate::fit::SplineFit;
use crate::held::RegionResiduals;
use crate::kernel::{BLOCK, Point};
use crate::{HandleCombination, TOGETHER};
use pulp::Arch;
use simod_plugin_api::{Host, PluginResult};

/// Number of samples side by side: compilers make vectors of loops over so many. Nothing is fused, so that
/// all widths of vectors give the same bits.
const LANES: usize = 8;
/// Number of samples that are deformed at once on one thread.
const DEFORM_BLOCK: usize = 8192;

type SampleLanes = [f64; LANES];

/// Values of all right-hand sides' solutions at each sample: within a group of as many samples as there are
/// lanes, the values of one solution follow each other.
pub struct SolutionTable {
    values: Vec<[f32; LANES]>,
    functions: usize,
    samples: usize,
}

impl SolutionTable {
    /// Table of all samples: the values of the samples in regions are the targets. The rest of the
    /// preparation's progress begins at `done`.
    pub fn new(
        fit: &SplineFit,
        held: &RegionResiduals,
        constraints: &RegionSamples,
        positions: &[[f32; 3]],
        host: &Host<'_>,
        done: f64,
    ) -> PluginResult<Self> {
        let (functions, samples) = (fit.weights.ncols(), positions.len());
        let mut values = vec![[0.0; LANES]; samples.div_ceil(LANES) * functions];
        let mut constraint_of = vec![u32::MAX; samples];
        constraints.samples.iter().zip(0..).for_each(|(&i, c)| constraint_of[i as usize] = c);
        let entries = BLOCK / LANES * functions;
        host.parallel_blocks(&mut values, TOGETHER * entries, |first, values| {
            let first = first / functions * LANES;
            // The wish to stop is looked after by the code that hands out the blocks.
            let _ = host.progress(done + (1.0 - done) * first as f64 / samples.max(1) as f64);
            let (mut free, mut sum) = (Vec::new(), vec![0.0; functions]);
            for (values, first) in values.chunks_mut(entries).zip((first..).step_by(BLOCK)) {
                let mut set = |i: usize, f: usize, x: f64| {
                    values[i / LANES * functions + f][i % LANES] = x as f32;
                };
                free.clear();
                for i in 0..BLOCK.min(samples - first) {
                    match constraint_of[first + i] {
                        u32::MAX => free.push(i),
                        c => (0..functions).for_each(|f| set(i, f, constraints.target(c as usize, f))),
                    }
                }
                let at = |i: &usize| constraints.frame.to_unit(positions[first + i].map(f64::from));
                let points: Vec<Point> = free.iter().map(at).collect();
                let sums = fit.functions.sums(&points, fit.weights.as_ref());
                for (row, (i, p)) in free.iter().zip(&points).enumerate() {
                    sum.iter_mut().enumerate().for_each(|(f, sum)| *sum = sums[f][row]);
                    held.add(p, &mut sum);
                    sum.iter().enumerate().for_each(|(f, sum)| set(*i, f, *sum));
                }
            }
        })?;
        Ok(Self { values, functions, samples })
    }

    /// Whether the table is of so many solutions at so many samples.
    pub fn is_of(&self, functions: usize, samples: usize) -> bool {
        (self.functions, self.samples) == (functions, samples)
    }

    /// Moves the samples, which are at `rest`, by a motion.
    pub fn deform(
        &self,
        motion: &HandleCombination,
        rest: &[[f32; 3]],
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        host.parallel_blocks(out, DEFORM_BLOCK, |first, out| {
            let (values, rest) = (&self.values[first / LANES * self.functions..], &rest[first..]);
            Arch::new().dispatch(|| deform(motion, values, rest, out));
        })
    }
}

/// Moves the first samples of values, rest positions and results.
#[inline(always)]
fn deform(motion: &HandleCombination, values: &[[f32; LANES]], rest: &[[f32; 3]], out: &mut [[f32; 3]]) {
    let values = values.chunks_exact(motion.coefficients.len());
    for ((out, rest), values) in out.chunks_mut(LANES).zip(rest.chunks(LANES)).zip(values) {
        let mut p = [[0.0_f32; LANES]; 3];
        for (lane, point) in rest.iter().enumerate() {
            (0..3).for_each(|axis| p[axis][lane] = point[axis]);
        }
        let q = images(motion, values, &p);
        for (lane, o) in out.iter_mut().enumerate() {
            *o = [q[0][lane], q[1][lane], q[2][lane]];
        }
    }
}

/// Images of as many points as there are lanes.
#[inline(always)]
fn images(motion: &HandleCombination, values: &[[f32; LANES]], p: &[[f32; LANES]; 3]) -> [[f32; LANES]; 3] {
    let at = p.map(|axis| axis.map(f64::from));
    let mut q: [SampleLanes; 3] = motion.common.rows.map(|r| {
        std::array::from_fn(|lane| r[0] * at[0][lane] + r[1] * at[1][lane] + r[2] * at[2][lane] + r[3])
    });
    for (value, k) in values.iter().zip(&motion.coefficients) {
        for (q, k) in q.iter_mut().zip(k) {
            (0..LANES).for_each(|lane| q[lane] += f64::from(value[lane]) * k);
        }
    }
    let mut images = *p;
    for lane in 0..LANES {
        // A sample that does not move stays bit for bit, also a zero with a sign.
        let moves = (0..3).fold(false, |any, axis| any | (q[axis][lane] != at[axis][lane]));
        for axis in 0..3 {
            images[axis][lane] = if moves { q[axis][lane] as f32 } else { images[axis][lane] };
        }
    }
    images
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_plugin_api::Affine;

    /// Many samples at a time have to the bit the images of each by itself, and a sample that nothing moves
    /// stays, also a zero with a sign.
    #[test]
    fn many_at_a_time_move_as_each_does() {
        let (samples, functions) = (8 * DEFORM_BLOCK / 5 + 3, 4);
        let wave = |i: usize, k: usize| (0.37 * i as f64 + 1.9 * k as f64).sin();
        let value = |i: usize, f: usize| if i.is_multiple_of(7) { 0.0 } else { wave(i, f) as f32 };
        let mut values = vec![[0.0; LANES]; samples.div_ceil(LANES) * functions];
        for (i, f) in (0..samples).flat_map(|i| (0..functions).map(move |f| (i, f))) {
            values[i / LANES * functions + f][i % LANES] = value(i, f);
        }
        let table = SolutionTable { values, functions, samples };
        assert!(table.is_of(functions, samples) && !table.is_of(functions, samples - 1));
        let rest: Vec<[f32; 3]> =
            (0..samples).map(|i| [wave(i, 7) as f32, -0.0, wave(i, 9) as f32]).collect();
        let turned = Affine { rows: [[0.6, -0.8, 0.0, 0.1], [0.8, 0.6, 0.0, -0.2], [0.0, 0.0, 1.0, 0.3]] };
        for common in [Affine::IDENTITY, turned] {
            let coefficients =
                (0..functions).map(|f| std::array::from_fn(|axis| wave(f, 11 + axis))).collect();
            let motion = HandleCombination { common, coefficients };
            let mut out = vec![[f32::NAN; 3]; samples];
            table.deform(&motion, &rest, &mut out, &Host::new(&())).unwrap();
            for (i, (p, image)) in rest.iter().zip(&out).enumerate() {
                let at = p.map(f64::from);
                let mut q = common.apply(at);
                for (f, k) in motion.coefficients.iter().enumerate() {
                    (0..3).for_each(|axis| q[axis] += f64::from(value(i, f)) * k[axis]);
                }
                let expected = if q == at { *p } else { q.map(|x| x as f32) };
                assert_eq!(image.map(f32::to_bits), expected.map(f32::to_bits), "{i}");
            }
        }
    }
}
