//! The vertices of a block that keep to the range of the samples around them, told without a search, as many
//! at once as the processor's vector registers take: nearly all do. See [`bound`](super::bound).

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};

use super::DeformationField;
use super::blend::{Grouped, LEAST_WEIGHT};
use super::bound::{BEYOND, MARGIN};
use super::expansion::Expansion;
use super::lanes::{Lanes, Mask, from, length_squared, triple};

/// Samples that are looked at before it is asked whether they are enough: a ring.
const RING: usize = 6;

impl DeformationField<'_> {
    /// Finds those grouped vertices that the supports reach, that need no limiter, and whose displacement is
    /// within the range of those samples of their home's sheet that are surely among the nearest ones.
    /// Nothing is wrong with the others, but that takes a closer look.
    pub(super) fn find_within_range(&self, grouped: &mut Grouped) {
        grouped.is_within_range.resize(grouped.sum.len(), 0.0);
        Arch::new().dispatch(RangeKernel { field: self, grouped });
    }
}

struct RangeKernel<'a> {
    field: &'a DeformationField<'a>,
    grouped: &'a mut Grouped,
}

impl WithSimd for RangeKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { field, grouped } = self;
        let Grouped {
            groups, scattered, scattered_at, positions, displacement, sum, is_within_range, ..
        } = grouped;
        for (i, home) in scattered.iter().enumerate() {
            let (at, home) = (*scattered_at + i, *home as usize);
            let p = Vec3::new(positions[0][at], positions[1][at], positions[2][at]);
            let u = Vec3::new(displacement[0][at], displacement[1][at], displacement[2][at]);
            let is_within = field.active[home]
                && !field.limiter.concerns(home)
                && sum[at] >= LEAST_WEIGHT
                && field.reaches(home, p)
                && field.is_bounded(home, p, u);
            is_within_range[at] = f32::from(u8::from(is_within));
        }
        let positions = positions.each_ref().map(|v| S::as_simd_f32s(v).0);
        let displacement = displacement.each_ref().map(|v| S::as_simd_f32s(v).0);
        let sum = S::as_simd_f32s(sum).0;
        let is_within_range = S::as_mut_simd_f32s(is_within_range).0;
        for (home, range) in groups {
            let home = *home as usize;
            let looked_at = field.active[home] && !field.limiter.concerns(home);
            for at in range.start / S::F32_LANES..range.end.div_ceil(S::F32_LANES) {
                is_within_range[at] = if looked_at {
                    let (p, u) = (triple(simd, &positions, at), triple(simd, &displacement, at));
                    packet(simd, field, home, p, u, Lanes(simd, sum[at])).1
                } else {
                    simd.splat_f32s(0.0)
                };
            }
        }
    }
}

/// 1 for each vertex of a home that is seen to keep to the range, by its position and displacement and the
/// sum of the weights there, and 0 for the others.
#[inline(always)]
fn packet<S: Simd>(
    simd: S,
    field: &DeformationField<'_>,
    home: usize,
    p: [Lanes<S>; 3],
    u: [Lanes<S>; 3],
    sum: Lanes<S>,
) -> Lanes<S> {
    let e = &field.expansions[home];
    let d = length_squared(from(simd, p, e.center));
    let distance = d.sqrt();
    // Samples nearer than this to the vertex are among those of its range, and the home is one of them.
    let reach = Lanes::splat(simd, field.around.supports.ranging[home]) - distance;
    let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
    let is_reached = (Lanes::splat(simd, e.inverse_square) * d).less(one);
    let has_weight = Lanes::splat(simd, LEAST_WEIGHT).less_or_equal(sum);
    let is_possible = distance.less(reach).and(is_reached).and(has_weight);
    let reach = reach * reach;

    // The margin comes last: numbers stay in their order when they are rounded.
    let (mut range, mut is_within) = (PacketBox::around(simd, e, field.bound.step(home)), zero);
    for ring in field.around.sheets.of_sample(home).chunks(RING) {
        for j in ring {
            let j = *j as usize;
            let is_near = length_squared(from(simd, p, field.expansions[j].center)).less(reach);
            range.include(is_near, PacketBox::around(simd, &field.expansions[j], field.bound.step(j)));
        }
        let holds = range.holds(u);
        is_within = is_possible.and(holds).select(one, zero);
        // Further samples only make the range wider.
        let is_left = holds.select(zero, is_possible.select(one, zero));
        if !zero.less(is_left).any() {
            break;
        }
    }
    is_within
}

/// Displacements between the least and the greatest, coordinate by coordinate, and the largest step.
struct PacketBox<S: Simd> {
    low: [Lanes<S>; 3],
    high: [Lanes<S>; 3],
    step: Lanes<S>,
}

impl<S: Simd> PacketBox<S> {
    /// The extent of one sample's displacement.
    #[inline(always)]
    fn around(simd: S, e: &Expansion, step: f32) -> Self {
        let splat = |x: f32| Lanes::splat(simd, x);
        let u = [splat(e.term(0, 0)), splat(e.term(0, 1)), splat(e.term(0, 2))];
        Self { low: u, high: u, step: splat(step) }
    }

    #[inline(always)]
    fn include(&mut self, whether: Mask<S>, other: Self) {
        for i in 0..3 {
            self.low[i] = whether.select(self.low[i].min(other.low[i]), self.low[i]);
            self.high[i] = whether.select(self.high[i].max(other.high[i]), self.high[i]);
        }
        self.step = whether.select(self.step.max(other.step), self.step);
    }

    /// Mask of the lanes in which the range holds a displacement, widened by the rounding error, and by a
    /// part of the step.
    #[inline(always)]
    fn holds(&self, u: [Lanes<S>; 3]) -> Mask<S> {
        let margin = Lanes::splat(self.step.0, MARGIN);
        let slack = Lanes::splat(self.step.0, BEYOND) * self.step;
        let x = u[0].within(self.low[0] - margin - slack, self.high[0] + margin + slack);
        let y = u[1].within(self.low[1] - margin - slack, self.high[1] + margin + slack);
        let z = u[2].within(self.low[2] - margin - slack, self.high[2] + margin + slack);
        x.and(y).and(z)
    }
}
