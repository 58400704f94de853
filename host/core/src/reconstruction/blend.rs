//! The blend of expansions over whole blocks of vertices: a partition of unity whose parts are known
//! beforehand.
//!
//! u(p) = Σ wᵢ(p)·uᵢ(p) / Σ wᵢ(p), where wᵢ vanishes at a fixed distance from sample i. So no vertex has to
//! search and sort its neighbours: around each sample, its *home*, all supports that reach there are listed
//! once, and a vertex goes through the list of its home. As nothing depends on which sample is nearest, the
//! blend is as smooth as its weights, and the gradient (for normals) is the exact one of the vertices'
//! deformation.
//!
//! Vertices of a block are grouped by their homes and processed as many at once as the processor's vector
//! registers take, which is found out at run time. Every vertex' numbers are computed by the same operations
//! in the same order on any processor, multiplications and additions fused where they are here, if need be by
//! software: the result has the same bytes everywhere.

use std::ops::Range;

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::long_list::{ListStorage, LongList};

use super::expansion::{Expansion, ReachingSupport};
use super::lanes::{Lanes, PACKET, from, length_squared, triple};
use super::overlaps::{Balls, HomeLists};
use super::scattered;
use super::sheets::Sheets;
use crate::sampling::SampleSet;

/// Samples that a [range](super::bound) is of.
pub const AROUND: usize = 28;

/// Homes whose lists are made by one job.
const HOMES_OF_JOB: usize = 256;

/// Supports that are looked at before their displacements are added.
const TOGETHER: usize = 32;

/// The support of a sample ends at this one of its neighbours.
const SUPPORT_NEIGHBOURS: usize = 7;

/// Least sum of weights at which the blend is that of the supports. A smaller sum is found at the margin of
/// the last support.
pub const LEAST_WEIGHT: f32 = 1e-6;

/// For each sample, the supports that reach the vertices of which it is the home.
///
/// Memory: about 30 supports of 8 bytes per sample, and room for a few more.
#[derive(Debug)]
pub struct Supports {
    /// Radius of each sample's support.
    pub radius: Vec<f32>,
    /// Distance from each sample within which there are no more samples, on whatever sheet and with the
    /// sample itself, than a [range](super::bound) is of.
    pub ranging: Vec<f32>,
    /// Start and end of each home's entries in `reaching`; entries between an end and the next start have no
    /// meaning.
    starts: Vec<u32>,
    ends: Vec<u32>,
    reaching: LongList<ReachingSupport>,
}

impl Supports {
    /// The supports of samples, whose neighbours are those on their sheets.
    pub fn new(samples: &SampleSet, sheets: &Sheets) -> Self {
        let positions = &samples.positions;
        let (radius, ranging) = reaches(positions, sheets, samples.storage());
        let HomeLists { starts, ends, reaching } =
            HomeLists::find(positions, &radius, sheets, samples.storage());
        Self { radius, ranging, starts, ends, reaching }
    }

    /// Supports of samples whose lists of homes were found before: the end of each list, from the first home
    /// on, and the entries of all lists, which have to be samples.
    pub fn known(
        samples: &SampleSet,
        sheets: &Sheets,
        ends: Vec<u32>,
        mut reaching: LongList<ReachingSupport>,
    ) -> Self {
        let (positions, storage) = (&samples.positions, samples.storage());
        let (radius, ranging) = reaches(positions, sheets, storage);
        let balls = Balls::new(positions, &radius);
        let starts: Vec<u32> = [0].into_iter().chain(ends.iter().copied()).take(ends.len()).collect();
        let mut rest = &mut reaching[..];
        let mut jobs = Vec::with_capacity(ends.len().div_ceil(HOMES_OF_JOB));
        for (starts, ends) in starts.chunks(HOMES_OF_JOB).zip(ends.chunks(HOMES_OF_JOB)) {
            let all = ends.last().zip(starts.first()).map_or(0, |(end, start)| end - start);
            let (part, behind) = rest.split_at_mut(all as usize);
            jobs.push((part, starts, ends));
            rest = behind;
        }
        jobs.into_par_iter().enumerate().for_each(|(job, (part, starts, ends))| {
            storage.gone_through(size_of_val(part));
            for (at, (start, end)) in starts.iter().zip(ends).enumerate() {
                let list = &mut part[(start - starts[0]) as usize..(end - starts[0]) as usize];
                list.iter_mut().for_each(|r| *r = balls.reaching(job * HOMES_OF_JOB + at, r.sample as usize));
            }
        });
        Self { radius, ranging, starts, ends, reaching }
    }

    /// Bytes of the lists of so many homes, about.
    pub fn bytes_of(&self, homes: usize) -> usize {
        size_of_val(&self.reaching[..]) / self.radius.len().max(1) * homes
    }

    /// The supports that reach where `home` is the home.
    pub fn of_home(&self, home: usize) -> &[ReachingSupport] {
        &self.reaching[self.starts[home] as usize..self.ends[home] as usize]
    }
}

/// Radii of the samples' supports, and the distances within which [ranges](super::bound) are known.
fn reaches(positions: &[Vec3], sheets: &Sheets, storage: &ListStorage) -> (Vec<f32>, Vec<f32>) {
    let all = || storage.counted(positions.len(), sheets.bytes_of(1));
    let radius = all().map(|i| sheets.around(positions, i, SUPPORT_NEIGHBOURS - 1).1);
    let ranging = all().map(|i| match sheets.graph().nearest_to(i).get(AROUND - 2) {
        // A little less, as distances are rounded.
        Some(last) => 0.9999 * positions[i].distance(positions[*last as usize]),
        None => f32::MAX,
    });
    (radius.collect(), ranging.collect())
}

/// Vertices of a block, grouped by their homes, in separate arrays by coordinate.
///
/// Memory: 44 bytes per vertex with a normal, 32 without, 36 more for the gradient, 36 for that by which
/// numbers turn, and 4 for an expected error; and as much for up to [`PACKET`] more vertices of each group.
#[derive(Debug, Default)]
pub struct Grouped {
    /// Home and places of each group of vertices. A group begins at a multiple of [`PACKET`]; entries between
    /// groups have no meaning, but are finite.
    pub groups: Vec<(u32, Range<usize>)>,
    /// The homes of the vertices behind the groups, which are nearly alone around them.
    pub scattered: Vec<u32>,
    /// Place of the first vertex behind the groups: a multiple of [`PACKET`].
    pub scattered_at: usize,
    /// Local coordinates.
    pub positions: [Vec<f32>; 3],
    /// The displacement.
    pub displacement: [Vec<f32>; 3],
    /// The sum of weights: at less than [`LEAST_WEIGHT`] the displacement means nothing.
    pub sum: Vec<f32>,
    /// 1 where the displacement is seen (by `within_range`) to keep to the range of the
    /// samples around, 0 elsewhere.
    pub is_within_range: Vec<f32>,
    /// Expected errors, local units, where they were asked for; those of vertices that are not within their
    /// range have no meaning.
    pub expected: Vec<f32>,
    /// Normals, which are turned; empty if there are none.
    pub normals: [Vec<f32>; 3],
    /// The gradient of the deformation, column by column; empty unless it is asked for.
    pub gradient: [Vec<f32>; 9],
    /// The gradient by which numbers turn; likewise.
    pub turning: [Vec<f32>; 9],
}

impl Grouped {
    /// Makes room for the results.
    fn make_room(&mut self, gradient: bool, turning: bool) {
        let length = self.positions[0].len();
        self.displacement.iter_mut().chain([&mut self.sum]).for_each(|v| v.resize(length, 0.0));
        self.gradient.iter_mut().for_each(|v| v.resize(if gradient { length } else { 0 }, 0.0));
        self.turning.iter_mut().for_each(|v| v.resize(if turning { length } else { 0 }, 0.0));
    }
}

/// Inputs of a blend.
pub struct Blending<'a> {
    pub supports: &'a Supports,
    pub expansions: &'a [Expansion],
    /// Expansions by whose gradients numbers turn, with the same supports; none if nothing turns.
    ///
    /// Their gradients are blended: that is smoother than the gradient of the blend, in which the weights'
    /// slopes make more of rounding.
    pub turning: &'a [Expansion],
    /// As for `Transport::normal`.
    pub mirrored: bool,
    /// Whether the gradient of the blend is wanted.
    pub gradient: bool,
}

impl Blending<'_> {
    /// Blends the expansions for all groups, and turns their normals.
    pub fn blend(&self, grouped: &mut Grouped) {
        let gradient = self.gradient || !grouped.normals[0].is_empty();
        let turning = !self.turning.is_empty();
        grouped.make_room(self.gradient, turning);
        let arch = Arch::new();
        match (gradient, turning) {
            (false, false) => arch.dispatch(PacketBlend::<false, false> { what: self, grouped }),
            (false, true) => arch.dispatch(PacketBlend::<false, true> { what: self, grouped }),
            (true, false) => arch.dispatch(PacketBlend::<true, false> { what: self, grouped }),
            (true, true) => arch.dispatch(PacketBlend::<true, true> { what: self, grouped }),
        }
    }
}

struct PacketBlend<'a, const GRADIENT: bool, const TURNING: bool> {
    what: &'a Blending<'a>,
    grouped: &'a mut Grouped,
}

impl<const GRADIENT: bool, const TURNING: bool> WithSimd for PacketBlend<'_, GRADIENT, TURNING> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { what, grouped } = self;
        let Blending { supports, expansions, turning: told, mirrored, .. } = *what;
        let side = Lanes::splat(simd, if mirrored { -1.0 } else { 1.0 });
        let Grouped {
            groups,
            scattered,
            scattered_at,
            positions,
            displacement,
            sum,
            normals,
            gradient,
            turning,
            ..
        } = grouped;
        // All lengths are multiples of the packet: nothing is left over.
        let scalars = &*positions;
        let positions = positions.each_ref().map(|v| S::as_simd_f32s(v).0);
        let mut results = Results {
            displacement: displacement.each_mut().map(|v| S::as_mut_simd_f32s(v).0),
            sum: S::as_mut_simd_f32s(sum).0,
            normals: normals.each_mut().map(|v| S::as_mut_simd_f32s(v).0),
            gradient: gradient.each_mut().map(|v| S::as_mut_simd_f32s(v).0),
            turning: turning.each_mut().map(|v| S::as_mut_simd_f32s(v).0),
        };
        for (home, range) in groups {
            let list = supports.of_home(*home as usize);
            let home = &expansions[*home as usize];
            for at in range.start / S::F32_LANES..range.end.div_ceil(S::F32_LANES) {
                let p = triple(simd, &positions, at);
                let blended = packet::<S, GRADIENT>(simd, p, home, list, expansions);
                results.put::<GRADIENT>(simd, at, &blended, side);
                if TURNING {
                    results.put_turning(at, &packet_turning(simd, p, home, list, told, blended.sum));
                }
            }
        }
        for (packet, homes) in scattered.chunks(S::F32_LANES).enumerate() {
            let first = *scattered_at + packet * S::F32_LANES;
            let mut values = [[0.0; PACKET]; scattered::VALUES];
            let mut turning = [[0.0; PACKET]; scattered::TURNING_VALUES];
            for (lane, home) in homes.iter().enumerate() {
                let p = [scalars[0][first + lane], scalars[1][first + lane], scalars[2][first + lane]];
                let list = supports.of_home(*home as usize);
                let home = &expansions[*home as usize];
                let one = scattered::one::<GRADIENT, TURNING>(p, home, list, expansions, told);
                for (to, value) in values.iter_mut().zip(one.values()) {
                    to[lane] = value;
                }
                if TURNING {
                    for (to, value) in turning.iter_mut().zip(one.turning_values()) {
                        to[lane] = value;
                    }
                }
            }
            let zero = Lanes::splat(simd, 0.0);
            let mut blended = Blended { displacement: [zero; 3], sum: zero, gradient: [zero; 9] };
            let Blended { displacement, sum, gradient } = &mut blended;
            let all = displacement.iter_mut().chain([sum]).chain(gradient);
            for (to, of_lanes) in all.zip(&values) {
                *to = Lanes(simd, S::as_simd_f32s(of_lanes).0[0]);
            }
            results.put::<GRADIENT>(simd, first / S::F32_LANES, &blended, side);
            if TURNING {
                let mut turned = [zero; scattered::TURNING_VALUES];
                for (to, of_lanes) in turned.iter_mut().zip(&turning) {
                    *to = Lanes(simd, S::as_simd_f32s(of_lanes).0[0]);
                }
                results.put_turning(first / S::F32_LANES, &turned);
            }
        }
    }
}

/// Slices that take the results of packets.
struct Results<'a, S: Simd> {
    displacement: [&'a mut [S::f32s]; 3],
    sum: &'a mut [S::f32s],
    normals: [&'a mut [S::f32s]; 3],
    gradient: [&'a mut [S::f32s]; 9],
    turning: [&'a mut [S::f32s]; 9],
}

impl<S: Simd> Results<'_, S> {
    /// Stores the gradients by which numbers of a packet turn at their places.
    #[inline(always)]
    fn put_turning(&mut self, at: usize, gradient: &[Lanes<S>; 9]) {
        for (to, g) in self.turning.iter_mut().zip(gradient) {
            to[at] = g.1;
        }
    }

    /// Stores the results of a packet at their places, and turns its normals.
    #[inline(always)]
    fn put<const GRADIENT: bool>(&mut self, simd: S, at: usize, blended: &Blended<S>, side: Lanes<S>) {
        for (to, u) in self.displacement.iter_mut().zip(&blended.displacement) {
            to[at] = u.1;
        }
        self.sum[at] = blended.sum.1;
        if GRADIENT && !self.normals[0].is_empty() {
            let [x, y, z] = &self.normals;
            let n = [Lanes(simd, x[at]), Lanes(simd, y[at]), Lanes(simd, z[at])];
            let turned = turn(n, &blended.gradient, side);
            for (to, n) in self.normals.iter_mut().zip(&turned) {
                to[at] = n.1;
            }
        }
        if GRADIENT && !self.gradient[0].is_empty() {
            for (to, g) in self.gradient.iter_mut().zip(&blended.gradient) {
                to[at] = g.1;
            }
        }
    }
}

/// Normals after a deformation of this gradient, of the same length as before: as `Transport::normal`.
#[inline(always)]
fn turn<S: Simd>(n: [Lanes<S>; 3], gradient: &[Lanes<S>; 9], side: Lanes<S>) -> [Lanes<S>; 3] {
    let [ax, ay, az, bx, by, bz, cx, cy, cz] = *gradient;
    let [x, y, z] = n;
    // The columns' cross products, b × c, c × a and a × b.
    let (ux, uy, uz) = (by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx);
    let (vx, vy, vz) = (cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax);
    let (wx, wy, wz) = (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx);
    let turned = [
        ux.mul_add(x, vx.mul_add(y, wx * z)),
        uy.mul_add(x, vy.mul_add(y, wy * z)),
        uz.mul_add(x, vz.mul_add(y, wz * z)),
    ];
    let square = length_squared(turned);
    let factor = side * length_squared(n).sqrt() * square.sqrt().inverse_or_one();
    // A normal of which nothing is left stays as it was, and so does one that is no number.
    [
        square.where_positive(turned[0] * factor, n[0]),
        square.where_positive(turned[1] * factor, n[1]),
        square.where_positive(turned[2] * factor, n[2]),
    ]
}

/// Results of a blend for a packet of vertices.
struct Blended<S: Simd> {
    displacement: [Lanes<S>; 3],
    sum: Lanes<S>,
    gradient: [Lanes<S>; 9],
}

/// Term `k` of coordinate `o` of an expansion, for all lanes.
#[inline(always)]
pub fn term<S: Simd>(simd: S, e: &Expansion, k: usize, o: usize) -> Lanes<S> {
    Lanes::splat(simd, e.term(k, o))
}

/// Factors of dx, dy and dz in the Horner form of coordinate `o` of an expansion, at `d` from its sample.
#[inline(always)]
fn inner<S: Simd>(simd: S, e: &Expansion, o: usize, [dx, dy, dz]: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    let (sx, sy, sz) = (term(simd, e, 1, o), term(simd, e, 2, o), term(simd, e, 3, o));
    let (xx, xy, xz) = (term(simd, e, 4, o), term(simd, e, 5, o), term(simd, e, 6, o));
    let (yy, yz, zz) = (term(simd, e, 7, o), term(simd, e, 8, o), term(simd, e, 9, o));
    [
        xx.mul_add(dx, xy.mul_add(dy, xz.mul_add(dz, sx))),
        yy.mul_add(dy, yz.mul_add(dz, sy)),
        zz.mul_add(dz, sz),
    ]
}

/// The gradient of coordinate `o` there.
#[inline(always)]
fn slopes<S: Simd>(
    simd: S,
    e: &Expansion,
    o: usize,
    [dx, dy, dz]: [Lanes<S>; 3],
    [a, b, c]: [Lanes<S>; 3],
) -> [Lanes<S>; 3] {
    let (xx, xy, xz) = (term(simd, e, 4, o), term(simd, e, 5, o), term(simd, e, 6, o));
    let (yy, yz, zz) = (term(simd, e, 7, o), term(simd, e, 8, o), term(simd, e, 9, o));
    [xx.mul_add(dx, a), xy.mul_add(dx, yy.mul_add(dy, b)), xz.mul_add(dx, yz.mul_add(dy, zz.mul_add(dz, c)))]
}

/// The ways from the centre of a support to the vertices of a packet, and 1 - t² of each, which is above zero
/// where the support reaches it: the kernel is its cube.
#[inline(always)]
fn within<S: Simd>(simd: S, e: &Expansion, p: [Lanes<S>; 3]) -> ([Lanes<S>; 3], Lanes<S>) {
    let d = from(simd, p, e.center);
    (d, length_squared(d).mul_add(Lanes::splat(simd, -e.inverse_square), Lanes::splat(simd, 1.0)))
}

/// Finds the supports that reach any vertex of a packet: without a branch that the processor would have to
/// foretell. No vertex is farther from its home than `furthest`. Returns the number of supports.
#[inline(always)]
fn reaching<S: Simd>(
    simd: S,
    p: [Lanes<S>; 3],
    furthest: f32,
    supports: &[ReachingSupport],
    expansions: &[Expansion],
    near: &mut [u32; TOGETHER],
) -> usize {
    let zero = Lanes::splat(simd, 0.0);
    let mut count = 0;
    for support in supports {
        if support.from > furthest {
            break;
        }
        let (_, s) = within(simd, &expansions[support.sample as usize], p);
        near[count] = support.sample;
        count += usize::from(zero.less(s).any());
    }
    count
}

/// Blends the gradients of expansions for as many vertices as there are lanes; `sum` is that of their
/// weights.
#[inline(always)]
fn packet_turning<S: Simd>(
    simd: S,
    p: [Lanes<S>; 3],
    home: &Expansion,
    list: &[ReachingSupport],
    told: &[Expansion],
    sum: Lanes<S>,
) -> [Lanes<S>; 9] {
    let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
    let mut gradient = [zero; 9];
    let mut near = [0; TOGETHER];
    let furthest = length_squared(from(simd, p, home.center)).largest().sqrt();
    for supports in list.chunks(TOGETHER) {
        let count = reaching(simd, p, furthest, supports, told, &mut near);
        for sample in &near[..count] {
            let e = &told[*sample as usize];
            let (d, s) = within(simd, e, p);
            let s = s.max(zero);
            let w = s * s * s;
            for o in 0..3 {
                let slopes = slopes(simd, e, o, d, inner(simd, e, o, d));
                for column in 0..3 {
                    let g = &mut gradient[3 * column + o];
                    *g = w.mul_add(slopes[column], *g);
                }
            }
        }
    }
    let inverse = sum.inverse_or_one();
    for column in 0..3 {
        for o in 0..3 {
            let g = &mut gradient[3 * column + o];
            *g = g.mul_add(inverse, if column == o { one } else { zero });
        }
    }
    gradient
}

/// Goes through the supports for as many vertices as there are lanes.
#[inline(always)]
fn packet<S: Simd, const GRADIENT: bool>(
    simd: S,
    p: [Lanes<S>; 3],
    home: &Expansion,
    list: &[ReachingSupport],
    expansions: &[Expansion],
) -> Blended<S> {
    let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
    let mut blended = Blended { displacement: [zero; 3], sum: zero, gradient: [zero; 9] };
    let mut sum_slope = [zero; 3];

    let mut near = [0; TOGETHER];
    let furthest = length_squared(from(simd, p, home.center)).largest().sqrt();
    for supports in list.chunks(TOGETHER) {
        let count = reaching(simd, p, furthest, supports, expansions, &mut near);
        for sample in &near[..count] {
            let e = &expansions[*sample as usize];
            let (d, s) = within(simd, e, p);
            // The kernel (1 - t²)³ and, but for d, its gradient -6 (1 - t²)² d / r²
            let s = s.max(zero);
            let w = s * s * s;
            let w_slope = s * s * Lanes::splat(simd, -6.0 * e.inverse_square);
            blended.sum += w;
            if GRADIENT {
                for i in 0..3 {
                    sum_slope[i] = w_slope.mul_add(d[i], sum_slope[i]);
                }
            }
            let [dx, dy, dz] = d;
            for o in 0..3 {
                // As in `Expansion::evaluate`.
                // Beyond the home's, for precision: weights that vanish have steep logarithms.
                let u = Lanes::splat(simd, e.term(0, o) - home.term(0, o));
                let inner = inner(simd, e, o, d);
                let [a, b, c] = inner;
                let u = a.mul_add(dx, b.mul_add(dy, c.mul_add(dz, u)));
                blended.displacement[o] = w.mul_add(u, blended.displacement[o]);
                if GRADIENT {
                    let pull = w_slope * u;
                    let slopes = slopes(simd, e, o, d, inner);
                    for column in 0..3 {
                        let g = &mut blended.gradient[3 * column + o];
                        *g = w.mul_add(slopes[column], pull.mul_add(d[column], *g));
                    }
                }
            }
        }
    }
    // A vertex without a support divides by one; its sum tells.
    let inverse = blended.sum.inverse_or_one();
    for o in 0..3 {
        let u = blended.displacement[o] * inverse;
        blended.displacement[o] = u + term(simd, home, 0, o);
        if GRADIENT {
            for (column, slope) in sum_slope.iter().enumerate() {
                // Of the deformation, not of the displacement.
                let g = &mut blended.gradient[3 * column + o];
                let itself = if column == o { one } else { zero };
                *g = itself + (*g - u * *slope) * inverse;
            }
        }
    }
    blended
}
