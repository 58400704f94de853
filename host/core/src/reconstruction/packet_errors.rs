//! Expected errors of the vertices of a block, as many at once as the processor's vector registers take: see
//! [`expected_error`](super::expected_error).
//!
//! Each vertex' sums are taken by the same operations in the same order as for a single vertex, so that its
//! expected error has the same bits in whatever way it was found.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};

use super::DeformationField;
use super::blend::{Grouped, LEAST_WEIGHT, term};
use super::expansion::Expansion;
use super::expected_error::{Heard, HeardAround, WIDER, WIDEST, WideBlend};
use super::lanes::{Lanes, PACKET, from, triple};
use super::stencils::RING;
use super::unresolved::Unresolved;

impl DeformationField<'_> {
    /// Finds the expected errors of those grouped vertices that are [seen](Self::find_within_range) to keep
    /// to the range around them, and so go where the blend takes them; those of others have no meaning. The
    /// field has to be [expecting of vertices](Self::expecting_of_vertices).
    pub(super) fn find_expected(&self, grouped: &mut Grouped) {
        grouped.expected.resize(grouped.sum.len(), 0.0);
        Arch::new().dispatch(ErrorKernel { field: self, grouped });
    }
}

struct ErrorKernel<'a> {
    field: &'a DeformationField<'a>,
    grouped: &'a mut Grouped,
}

impl WithSimd for ErrorKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { field, grouped } = self;
        let Grouped {
            groups,
            scattered,
            scattered_at,
            positions,
            displacement,
            is_within_range,
            expected,
            ..
        } = grouped;
        let vector = |of: &[Vec<f32>; 3], at: usize| Vec3::new(of[0][at], of[1][at], of[2][at]);
        let in_packets = positions.each_ref().map(|v| S::as_simd_f32s(v).0);
        let moves_in_packets = displacement.each_ref().map(|v| S::as_simd_f32s(v).0);
        for (i, home) in scattered.iter().enumerate() {
            let at = *scattered_at + i;
            if is_within_range[at] > 0.0 {
                let (p, u) = (vector(positions, at), vector(displacement, at));
                expected[at] = field.expected_at(*home as usize, p, u);
            }
        }
        for (home, range) in groups {
            let home = *home as usize;
            let are_two = field.are_two(home);
            for at in range.clone().step_by(S::F32_LANES) {
                let lanes = range.end.min(at + S::F32_LANES) - at;
                let is_within = &is_within_range[at..at + lanes];
                if is_within.iter().all(|is| *is == 0.0) {
                    continue;
                }
                let packet = at / S::F32_LANES;
                let (p, u) = (triple(simd, &in_packets, packet), triple(simd, &moves_in_packets, packet));
                let heard = heard(simd, field, home, p, u).store();
                let around = heard_around(simd, field, home, p, u).store();
                for lane in 0..lanes {
                    let (p, u) = (vector(positions, at + lane), vector(displacement, at + lane));
                    let heard = heard.of_lane(lane);
                    // Where no support reaches, others have a say.
                    expected[at + lane] = if heard.sum < LEAST_WEIGHT {
                        field.expected_at(home, p, u)
                    } else {
                        field.expected_by(home, p, u, &heard, &around.of_lane(lane, are_two))
                    };
                }
            }
        }
    }
}

/// Sums over the supports that reach the vertices of a packet: those of [`Heard`].
struct HeardPacket<S: Simd> {
    sum: Lanes<S>,
    spread: Lanes<S>,
    furthest: Lanes<S>,
    left_out: Lanes<S>,
    largest: Lanes<S>,
    unresolved: Lanes<S>,
    places: [Lanes<S>; 3],
    products: [[Lanes<S>; 3]; 3],
}

/// Adds up what the samples whose supports reach vertices of this home, at `p`, tell of their errors, where
/// they go by `u`.
#[inline(always)]
fn heard<S: Simd>(
    simd: S,
    field: &DeformationField<'_>,
    home: usize,
    p: [Lanes<S>; 3],
    u: [Lanes<S>; 3],
) -> HeardPacket<S> {
    let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
    let mut all = HeardPacket {
        sum: zero,
        spread: zero,
        furthest: zero,
        left_out: zero,
        largest: zero,
        unresolved: zero,
        places: [zero; 3],
        products: [[zero; 3]; 3],
    };
    for support in field.around.supports.of_home(home) {
        let i = support.sample as usize;
        let e = &field.expansions[i];
        let d = from(simd, p, e.center);
        let s = one - square(d) * Lanes::splat(simd, e.inverse_square);
        let is_reached = zero.less(s);
        if !is_reached.any() {
            continue;
        }
        let w = is_reached.select(s * s * s, zero);
        // Nothing is added where a sample has no say, whatever the sample tells.
        let told = |x: Lanes<S>| is_reached.select(x, zero);
        let said = says(simd, e, d);
        let off = told(square([said[0] - u[0], said[1] - u[1], said[2] - u[2]]));
        all.spread += w * off;
        all.furthest = all.furthest.max(off.sqrt());
        let expected = &field.expected[i];
        all.left_out += w * told(Lanes::splat(simd, expected.left_out));
        all.largest = all.largest.max(told(Lanes::splat(simd, expected.largest)));
        all.unresolved += w * told(open_length(simd, &field.unresolved[i], d));
        let back = [zero - d[0], zero - d[1], zero - d[2]];
        for axis in 0..3 {
            let weighted = w * back[axis];
            all.places[axis] += weighted;
            for other in 0..3 {
                all.products[axis][other] += back[other] * weighted;
            }
        }
        all.sum += w;
    }
    all
}

/// Sums of what the expansions around the vertices of a packet say: those of [`HeardAround`].
struct PacketAround<S: Simd> {
    furthest: Lanes<S>,
    /// Second largest distance of an expansion of the ring.
    differs: Lanes<S>,
    wider: WidePacket<S>,
    widest: WidePacket<S>,
}

/// Gathers what the expansions of a home and its neighbours say of vertices at `p` that go by `u`.
#[inline(always)]
fn heard_around<S: Simd>(
    simd: S,
    field: &DeformationField<'_>,
    home: usize,
    p: [Lanes<S>; 3],
    u: [Lanes<S>; 3],
) -> PacketAround<S> {
    let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
    let nothing = WidePacket { apart: [zero; 3], sum: zero };
    let mut around = PacketAround { furthest: zero, differs: zero, wider: nothing, widest: nothing };
    let neighbours = field.stencils.of_sample(home);
    for place in 0..=neighbours.len() {
        let i = if place == 0 { home } else { neighbours[place - 1] as usize };
        let e = &field.expansions[i];
        let d = from(simd, p, e.center);
        let said = says(simd, e, d);
        let apart = [said[0] - u[0], said[1] - u[1], said[2] - u[2]];
        if place <= RING {
            let length = square(apart).sqrt();
            around.differs = around.differs.max(length.min(around.furthest));
            around.furthest = around.furthest.max(length);
        }
        let beyond = one - (one - square(d) * Lanes::splat(simd, e.inverse_square));
        around.wider.add(simd, WIDER, beyond, apart);
        around.widest.add(simd, WIDEST, beyond, apart);
    }
    around
}

/// Blend with wider supports for the vertices of a packet: see [`WideBlend`].
#[derive(Clone, Copy)]
struct WidePacket<S: Simd> {
    apart: [Lanes<S>; 3],
    sum: Lanes<S>,
}

impl<S: Simd> WidePacket<S> {
    /// Adds an expansion: as [`WideBlend::add`] does.
    #[inline(always)]
    fn add(&mut self, simd: S, times: f32, beyond: Lanes<S>, apart: [Lanes<S>; 3]) {
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let s = (one - beyond / Lanes::splat(simd, times * times)).max(zero);
        let w = s * s * s;
        for axis in 0..3 {
            self.apart[axis] += w * apart[axis];
        }
        self.sum += w;
    }
}

/// Displacement of an expansion at `d` from its sample: as [`Expansion::displacement_at`] has it, to the bit.
#[inline(always)]
fn says<S: Simd>(simd: S, e: &Expansion, [dx, dy, dz]: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    let mut said = [dx, dy, dz];
    for o in 0..3 {
        let a = term(simd, e, 1, o)
            + term(simd, e, 4, o) * dx
            + term(simd, e, 5, o) * dy
            + term(simd, e, 6, o) * dz;
        let b = term(simd, e, 2, o) + term(simd, e, 7, o) * dy + term(simd, e, 8, o) * dz;
        let c = term(simd, e, 3, o) + term(simd, e, 9, o) * dz;
        said[o] = term(simd, e, 0, o) + a * dx + b * dy + c * dz;
    }
    said
}

/// Length of the error that is open at `d` from a sample: as [`Unresolved::length`] has it.
#[inline(always)]
fn open_length<S: Simd>(simd: S, open: &Unresolved, [x, y, z]: [Lanes<S>; 3]) -> Lanes<S> {
    let term = |at: usize| Lanes::splat(simd, open.term(at));
    let a = term(0) + term(3) * x + term(4) * y + term(5) * z;
    let b = term(1) + term(6) * y + term(7) * z;
    let c = term(2) + term(8) * z;
    let signed = a * x + b * y + c * z;
    signed.max(Lanes::splat(simd, 0.0) - signed)
}

/// Squares of lengths, each product rounded by itself as for a single vertex.
#[inline(always)]
fn square<S: Simd>(d: [Lanes<S>; 3]) -> Lanes<S> {
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

/// Sums of a [`HeardPacket`], lane by lane.
struct StoredHeard {
    numbers: [[f32; PACKET]; 6],
    places: [[f32; PACKET]; 3],
    products: [[[f32; PACKET]; 3]; 3],
}

impl<S: Simd> HeardPacket<S> {
    #[inline(always)]
    fn store(self) -> StoredHeard {
        let Self { sum, spread, furthest, left_out, largest, unresolved, places, products } = self;
        let numbers = [
            sum.store(),
            spread.store(),
            furthest.store(),
            left_out.store(),
            largest.store(),
            unresolved.store(),
        ];
        let mut stored =
            StoredHeard { numbers, places: [[0.0; PACKET]; 3], products: [[[0.0; PACKET]; 3]; 3] };
        for axis in 0..3 {
            stored.places[axis] = places[axis].store();
            for other in 0..3 {
                stored.products[axis][other] = products[axis][other].store();
            }
        }
        stored
    }
}

impl StoredHeard {
    #[inline(always)]
    fn of_lane(&self, lane: usize) -> Heard {
        let vector = |of: &[[f32; PACKET]; 3]| Vec3::new(of[0][lane], of[1][lane], of[2][lane]);
        let [sum, spread, furthest, left_out, largest, unresolved] =
            self.numbers.each_ref().map(|of| of[lane]);
        let (places, products) = (vector(&self.places), self.products.each_ref().map(vector));
        Heard { sum, spread, furthest, left_out, largest, unresolved, places, products }
    }
}

/// Numbers of a [`PacketAround`], lane by lane.
struct StoredAround {
    furthest: [f32; PACKET],
    differs: [f32; PACKET],
    apart: [[[f32; PACKET]; 3]; 2],
    sums: [[f32; PACKET]; 2],
}

impl<S: Simd> PacketAround<S> {
    #[inline(always)]
    fn store(self) -> StoredAround {
        let Self { furthest, differs, wider, widest } = self;
        let mut apart = [[[0.0; PACKET]; 3]; 2];
        for axis in 0..3 {
            apart[0][axis] = wider.apart[axis].store();
            apart[1][axis] = widest.apart[axis].store();
        }
        let sums = [wider.sum.store(), widest.sum.store()];
        StoredAround { furthest: furthest.store(), differs: differs.store(), apart, sums }
    }
}

impl StoredAround {
    /// Numbers of one vertex, which has two samples around it in all if `are_two`.
    #[inline(always)]
    fn of_lane(&self, lane: usize, are_two: bool) -> HeardAround {
        let blend = |at: usize, times: f32| {
            let [x, y, z] = self.apart[at].each_ref().map(|of| of[lane]);
            WideBlend { times, apart: Vec3::new(x, y, z), sum: self.sums[at][lane] }
        };
        let differs = if are_two { self.furthest[lane] } else { self.differs[lane] };
        HeardAround { differs, wider: blend(0, WIDER), widest: blend(1, WIDEST) }
    }
}
