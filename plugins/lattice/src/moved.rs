//! A lattice whose control points were moved: `p + Σ B_i(u) B_j(v) B_k(w) (P*_ijk - P_ijk)`.
//!
//! The sum is of displacements, so that a place that no moved control point reaches stays exactly where it
//! is. As the functions reproduce their parameters, this is the same as the sum over the moved control
//! points.

use crate::ControlLattice;
use crate::basis::{Basis, BasisWeights, MOST};
use glam::{DVec3, DVec4};
use pulp::{Simd, WithSimd};
use simod_plugin_api::{Affine, PluginError, PluginResult};
use std::ops::Range;

/// Number of functions of an axis that reach a point, for cubic B-splines.
const CUBIC: usize = 4;

/// Most numbers that a processor takes at once.
const WIDEST: usize = 16;

/// Displacements of control points.
pub struct MovedPoints<'a> {
    lattice: &'a ControlLattice,
    /// Displacements along the third axis follow each other, then those along the second one. The fourth
    /// number is 0: four fit the processor better.
    displacements: Vec<DVec4>,
    /// Control points from the first to the last moved one along each axis; empty if none was moved.
    spans: [Range<usize>; 3],
    /// Whether one of its control points was moved, for each line along the third axis.
    lines: Vec<bool>,
}

impl<'a> MovedPoints<'a> {
    /// The lattice with its control points moved, each by its own map.
    pub fn new(lattice: &'a ControlLattice, motions: &[Affine]) -> PluginResult<Self> {
        let [_, ny, nz] = lattice.counts();
        if motions.len() != lattice.len() {
            let message = format!("{} motions of {} control points", motions.len(), lattice.len());
            return Err(PluginError::internal(message));
        }
        let displacement = |([i, j, k], motion): ([usize; 3], &Affine)| {
            let at = lattice.control_point([i, j, k]);
            // A control point that does not move shall not move by rounding either.
            let still = *motion == Affine::IDENTITY;
            if still { DVec4::ZERO } else { (DVec3::from(motion.apply(at.into())) - at).extend(0.0) }
        };
        let displacements: Vec<DVec4> = lattice.indices().zip(motions).map(displacement).collect();
        let mut spans = [0..0, 0..0, 0..0];
        let mut lines = vec![false; displacements.len() / nz];
        for (index, _) in lattice.indices().zip(&displacements).filter(|(_, d)| **d != DVec4::ZERO) {
            for (span, i) in spans.iter_mut().zip(index) {
                let from = if span.start == span.end { i } else { span.start.min(i) };
                *span = from..span.end.max(i + 1);
            }
            lines[index[0] * ny + index[1]] = true;
        }
        Ok(Self { lattice, displacements, spans, lines })
    }

    /// Whether no control point was moved.
    pub fn is_empty(&self) -> bool {
        self.spans[0].is_empty()
    }

    /// The image of a point.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        if self.lattice.bases.iter().all(|b| b.width() <= CUBIC) {
            self.apply_within::<CUBIC>(p)
        } else {
            self.apply_within::<MOST>(p)
        }
    }

    /// Image of a point that no more than `N` functions of an axis reach.
    #[inline(always)]
    fn apply_within<const N: usize>(&self, p: DVec3) -> DVec3 {
        let u = self.lattice.frame.coordinates(p);
        let [bx, by, bz] = &self.lattice.bases;
        let mut values = [[0.0; N]; 3];
        let [x, y, z] = &mut values;
        let (x, y, z) = (bx.values_at(u[0], x), by.values_at(u[1], y), bz.values_at(u[2], z));
        let ([ri, rj, rk], [_, ny, nz]) = (&self.spans, self.lattice.counts());
        let ((some_i, wx), (some_j, wy), (some_k, wz)) = (both(&x, ri), both(&y, rj), both(&z, rk));
        if some_k.is_empty() {
            return p;
        }
        let mut sum = DVec4::ZERO;
        if let (&[_, _, _, _], &[_, _, _, _], &[w0, w1, w2, w3]) = (wx, wy, wz) {
            // Cubic functions have all four: these loops have known lengths.
            for (i, wx) in some_i.zip(wx) {
                let mut plane = DVec4::ZERO;
                for (j, wy) in some_j.clone().zip(wy) {
                    let first = (i * ny + j) * nz + some_k.start;
                    let [d0, d1, d2, d3] =
                        *self.displacements[first..].first_chunk().expect("four of a line");
                    plane += *wy * (((w0 * d0 + w1 * d1) + w2 * d2) + w3 * d3);
                }
                sum += *wx * plane;
            }
            return p + sum.truncate();
        }
        for (i, wx) in some_i.zip(wx) {
            let mut plane = DVec4::ZERO;
            for (j, wy) in some_j.clone().zip(wy).filter(|(j, _)| self.lines[i * ny + j]) {
                let line = &self.displacements[(i * ny + j) * nz..][some_k.clone()];
                plane += *wy * line.iter().zip(wz).fold(DVec4::ZERO, |along, (d, w)| along + *w * *d);
            }
            sum += *wx * plane;
        }
        p + sum.truncate()
    }

    /// Writes the images of `rest`, in single precision.
    pub fn apply_all(&self, rest: &[[f32; 3]], out: &mut [[f32; 3]]) {
        if self.lattice.bases.iter().all(Basis::is_global) {
            // All samples go through the same control points: as many samples at once as the processor
            // takes.
            pulp::Arch::new().dispatch(SamplePackets { moved: self, rest, out });
            return;
        }
        for (o, p) in out.iter_mut().zip(rest) {
            *o = self.apply(DVec3::from(p.map(f64::from))).as_vec3().into();
        }
    }
}

/// Control points that count: those that the basis functions reach, and that were moved; with the
/// functions' values.
#[inline(always)]
fn both<'v>(weights: &BasisWeights<'v>, moved: &Range<usize>) -> (Range<usize>, &'v [f64]) {
    let from = weights.first.max(moved.start);
    let to = (weights.first + weights.values.len()).min(moved.end);
    if from < to {
        (from..to, &weights.values[from - weights.first..to - weights.first])
    } else {
        (0..0, &[])
    }
}

/// Samples that are moved in vectors, one number for a sample in each; for basis functions that all reach
/// everywhere.
struct SamplePackets<'a> {
    moved: &'a MovedPoints<'a>,
    rest: &'a [[f32; 3]],
    out: &'a mut [[f32; 3]],
}

impl WithSimd for SamplePackets<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { moved, rest, out } = self;
        let [_, ny, nz] = moved.lattice.counts();
        let [ri, rj, rk] = moved.spans.clone();
        let displacements: Vec<[f32; 3]> =
            moved.displacements.iter().map(|d| d.truncate().as_vec3().into()).collect();
        let zero = simd.splat_f32s(0.0);
        // The values are written anew for each packet, as far as there are functions.
        let mut values = [[zero; MOST]; 3];
        for (out, rest) in out.chunks_mut(S::F32_LANES).zip(rest.chunks(S::F32_LANES)) {
            weights(simd, moved.lattice, rest, &mut values);
            let [wi, wj, wk] = &values;
            let mut sum = [zero; 3];
            for i in ri.clone() {
                let mut plane = [zero; 3];
                for j in rj.clone().filter(|j| moved.lines[i * ny + j]) {
                    let line = &displacements[(i * ny + j) * nz..][rk.clone()];
                    let mut along = [zero; 3];
                    for (d, w) in line.iter().zip(&wk[rk.clone()]) {
                        add(simd, &mut along, d.map(|x| simd.splat_f32s(x)), *w);
                    }
                    add(simd, &mut plane, along, wj[j]);
                }
                add(simd, &mut sum, plane, wi[i]);
            }
            let mut numbers = [[0.0; WIDEST]; 3];
            for (numbers, sum) in numbers.iter_mut().zip(sum) {
                S::as_mut_simd_f32s(numbers).0[0] = sum;
            }
            for (lane, (o, p)) in out.iter_mut().zip(rest).enumerate() {
                *o = std::array::from_fn(|axis| p[axis] + numbers[axis][lane]);
            }
        }
    }
}

/// Adds `b` times `w`. The sum is not fused, so that all processors give the same.
#[inline(always)]
fn add<S: Simd>(simd: S, a: &mut [S::f32s; 3], b: [S::f32s; 3], w: S::f32s) {
    for (a, b) in a.iter_mut().zip(b) {
        *a = simd.add_f32s(*a, simd.mul_f32s(b, w));
    }
}

/// Basis functions along each axis at some samples, as many as the lanes or fewer.
#[inline(always)]
fn weights<S: Simd>(simd: S, lattice: &ControlLattice, rest: &[[f32; 3]], all: &mut [[S::f32s; MOST]; 3]) {
    let mut points = [[0.0; WIDEST]; 3];
    for (lane, p) in rest.iter().enumerate() {
        (0..3).for_each(|axis| points[axis][lane] = f64::from(p[axis]));
    }
    for axis in 0..3 {
        let (mut u, mut all_inside) = ([0.0; WIDEST], true);
        for lane in 0..S::F32_LANES.min(WIDEST) {
            let p = DVec3::new(points[0][lane], points[1][lane], points[2][lane]);
            u[lane] = lattice.frame.coordinate(axis, p);
            all_inside &= (0.0..=1.0).contains(&u[lane]);
        }
        let mut places = [u.map(|u| u as f32), [1.0; WIDEST], [0.0; WIDEST], [0.0; WIDEST]];
        // Divisions take long.
        if !all_inside {
            for lane in 0..S::F32_LANES.min(WIDEST) {
                let place = lattice.bases[axis].place_of_many(u[lane]);
                places[0][lane] = place.inside as f32;
                places[1][lane] = place.fade as f32;
                places[2][lane] = place.below as f32;
                places[3][lane] = place.above as f32;
            }
        }
        let [u, fade, below, above] = places.map(|place| S::as_simd_f32s(&place).0[0]);
        let functions = &mut all[axis][..lattice.bases[axis].count()];
        if let [a, b, c, d] = functions {
            // The same in registers, as nearly all lattices are cubic.
            let mut cubic = cubic(simd, u, fade);
            complete(simd, &mut cubic, [fade, below, above]);
            [*a, *b, *c, *d] = cubic;
        } else {
            bernstein(simd, u, fade, functions);
            complete(simd, functions, [fade, below, above]);
        }
    }
}

/// Bernstein's recurrence, of functions that add up to `fade`: as in `Basis::at`, with 0 for all knots on the
/// left, and 1 for those on the right.
#[inline(always)]
fn bernstein<S: Simd>(simd: S, u: S::f32s, fade: S::f32s, values: &mut [S::f32s]) {
    let rest_of_u = simd.sub_f32s(simd.splat_f32s(1.0), u);
    values[0] = fade;
    for k in 1..values.len() {
        let mut carried = simd.splat_f32s(0.0);
        for value in &mut values[..k] {
            let old = *value;
            *value = simd.add_f32s(carried, simd.mul_f32s(rest_of_u, old));
            carried = simd.mul_f32s(u, old);
        }
        values[k] = carried;
    }
}

/// Bernstein's recurrence of the four functions of a cubic lattice, in registers.
#[inline(always)]
fn cubic<S: Simd>(simd: S, u: S::f32s, fade: S::f32s) -> [S::f32s; CUBIC] {
    let rest_of_u = simd.sub_f32s(simd.splat_f32s(1.0), u);
    let (up, down) = (|x| simd.mul_f32s(u, x), |x| simd.mul_f32s(rest_of_u, x));
    let both = |left, right| simd.add_f32s(up(left), down(right));
    let [a, b] = [down(fade), up(fade)];
    let [a, b, c] = [down(a), both(a, b), up(b)];
    [down(a), both(a, b), both(b, c), up(c)]
}

/// Corrects the functions' sum, of which rounding loses the more, the more functions there are; and
/// continues them beyond either end.
#[inline(always)]
fn complete<S: Simd>(simd: S, values: &mut [S::f32s], [fade, below, above]: [S::f32s; 3]) {
    let total = values.iter().fold(simd.splat_f32s(f32::MIN_POSITIVE), |a, b| simd.add_f32s(a, *b));
    let whole = simd.div_f32s(fade, total);
    values.iter_mut().for_each(|value| *value = simd.mul_f32s(*value, whole));
    let degree = values.len() - 1;
    values[0] = simd.add_f32s(values[0], below);
    values[1] = simd.sub_f32s(values[1], below);
    values[degree] = simd.add_f32s(values[degree], above);
    values[degree - 1] = simd.sub_f32s(values[degree - 1], above);
}
