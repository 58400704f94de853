//! The [blend](super::blend) at vertices that are nearly alone around their homes, as those of a model in no
//! order: vertex by vertex, the coordinates side by side. Each takes the same steps as in a packet, in the
//! same order, so that its bytes do not tell how it was done.

use super::expansion::{Expansion, ReachingSupport};

/// Supports that are looked at before their displacements are added.
const TOGETHER: usize = 32;

/// Results of the blend at a vertex: displacement, sum of weights, the gradient's columns, and those of the
/// gradient by which numbers turn. The last number of each four has no meaning.
pub struct ScatteredVertex {
    pub displacement: Four,
    pub sum: f32,
    pub gradient: [Four; 3],
    pub turning: [Four; 3],
}

/// Numbers of a vertex but for those of the gradient by which numbers turn.
pub const VALUES: usize = 13;

/// Numbers of that gradient.
pub const TURNING_VALUES: usize = 9;

impl ScatteredVertex {
    /// The displacement, the sum of weights, and the gradient column by column.
    #[inline(always)]
    pub fn values(&self) -> [f32; VALUES] {
        let ([x, y, z, _], [a, b, c]) = (self.displacement.0, self.gradient.map(|column| column.0));
        [x, y, z, self.sum, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]
    }

    /// The gradient by which numbers turn, column by column.
    #[inline(always)]
    pub fn turning_values(&self) -> [f32; TURNING_VALUES] {
        let [a, b, c] = self.turning.map(|column| column.0);
        [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]
    }
}

/// Sums over the supports for the vertex at `p`, as `packet` does for many. `GRADIENT` says whether the
/// gradient is asked for, `TURNING` whether that by which numbers turn is, of the expansions `told`.
#[inline(always)]
pub fn one<const GRADIENT: bool, const TURNING: bool>(
    p: [f32; 3],
    home: &Expansion,
    list: &[ReachingSupport],
    expansions: &[Expansion],
    told: &[Expansion],
) -> ScatteredVertex {
    let nothing = [Four::ZERO; 3];
    let mut blended =
        ScatteredVertex { displacement: Four::ZERO, sum: 0.0, gradient: nothing, turning: nothing };
    let mut sum_slope = [0.0; 3];
    let furthest = length_squared(from(p, home.center)).sqrt();
    let reaching = &list[..list.iter().take_while(|support| support.from <= furthest).count()];
    // Supports that reach the vertex are found first, without a branch: entries far off in memory are fetched
    // side by side.
    let mut near = [(0, 0.0); TOGETHER];
    for supports in reaching.chunks(TOGETHER) {
        let mut count = 0;
        for support in supports {
            let e = &expansions[support.sample as usize];
            let s = length_squared(from(p, e.center)).mul_add(-e.inverse_square, 1.0);
            near[count] = (support.sample, s);
            count += usize::from(s > 0.0);
        }
        for (sample, s) in &near[..count] {
            add::<GRADIENT>(&expansions[*sample as usize], *s, p, home, &mut blended, &mut sum_slope);
        }
        if TURNING {
            for (sample, s) in &near[..count] {
                add_turning(&told[*sample as usize], *s, p, &mut blended.turning);
            }
        }
    }
    let inverse = 1.0 / if blended.sum > 0.0 { blended.sum } else { 1.0 };
    let u = blended.displacement.times(inverse);
    blended.displacement = u.plus(Four(home.four(0)));
    if GRADIENT {
        for (column, slope) in sum_slope.iter().enumerate() {
            let mut itself = Four::ZERO;
            itself.0[column] = 1.0;
            let g = &mut blended.gradient[column];
            *g = itself.plus(g.minus(u.times(*slope)).times(inverse));
        }
    }
    if TURNING {
        for (column, g) in blended.turning.iter_mut().enumerate() {
            let mut itself = Four::ZERO;
            itself.0[column] = 1.0;
            *g = g.mul_add(inverse, itself);
        }
    }
    blended
}

/// Adds the gradient that an expansion has at `p`, which is by `s` within its support.
#[inline(always)]
fn add_turning(e: &Expansion, s: f32, p: [f32; 3], gradient: &mut [Four; 3]) {
    let d = from(p, e.center);
    let w = s * s * s;
    let slopes = slopes(e, d, inner(e, d));
    for column in 0..3 {
        gradient[column] = slopes[column].mul_add(w, gradient[column]);
    }
}

/// Factors of dx, dy and dz in the Horner form of an expansion, at `d` from its sample.
#[inline(always)]
fn inner(e: &Expansion, [dx, dy, dz]: [f32; 3]) -> [Four; 3] {
    let (xx, xy, xz) = (Four(e.four(4)), Four(e.four(5)), Four(e.four(6)));
    let (yy, yz, zz) = (Four(e.four(7)), Four(e.four(8)), Four(e.four(9)));
    [
        xx.mul_add(dx, xy.mul_add(dy, xz.mul_add(dz, Four(e.four(1))))),
        yy.mul_add(dy, yz.mul_add(dz, Four(e.four(2)))),
        zz.mul_add(dz, Four(e.four(3))),
    ]
}

/// The columns of its gradient there.
#[inline(always)]
fn slopes(e: &Expansion, [dx, dy, dz]: [f32; 3], [a, b, c]: [Four; 3]) -> [Four; 3] {
    let (xx, xy, xz) = (Four(e.four(4)), Four(e.four(5)), Four(e.four(6)));
    let (yy, yz, zz) = (Four(e.four(7)), Four(e.four(8)), Four(e.four(9)));
    [xx.mul_add(dx, a), xy.mul_add(dx, yy.mul_add(dy, b)), xz.mul_add(dx, yz.mul_add(dy, zz.mul_add(dz, c)))]
}

/// Adds the displacement of an expansion at the vertex at `p`, which is by `s` within the support.
#[inline(always)]
fn add<const GRADIENT: bool>(
    e: &Expansion,
    s: f32,
    p: [f32; 3],
    home: &Expansion,
    blended: &mut ScatteredVertex,
    sum_slope: &mut [f32; 3],
) {
    let d = from(p, e.center);
    let w = s * s * s;
    let w_slope = s * s * (-6.0 * e.inverse_square);
    blended.sum += w;
    let [dx, dy, dz] = d;
    let u = Four(e.four(0)).minus(Four(home.four(0)));
    let inner = inner(e, d);
    let [a, b, c] = inner;
    let u = a.mul_add(dx, b.mul_add(dy, c.mul_add(dz, u)));
    blended.displacement = u.mul_add(w, blended.displacement);
    if GRADIENT {
        let pull = u.times(w_slope);
        let slopes = slopes(e, d, inner);
        for column in 0..3 {
            sum_slope[column] = w_slope.mul_add(d[column], sum_slope[column]);
            let g = &mut blended.gradient[column];
            *g = slopes[column].mul_add(w, pull.mul_add(d[column], *g));
        }
    }
}

/// Four numbers, which the processor takes at once.
#[derive(Clone, Copy)]
pub struct Four(pub [f32; 4]);

impl Four {
    const ZERO: Self = Self([0.0; 4]);

    /// self · by + to, rounded once.
    #[inline(always)]
    fn mul_add(self, by: f32, to: Self) -> Self {
        let ([a, b, c, d], [x, y, z, w]) = (self.0, to.0);
        Self([a.mul_add(by, x), b.mul_add(by, y), c.mul_add(by, z), d.mul_add(by, w)])
    }

    #[inline(always)]
    fn times(self, by: f32) -> Self {
        let [a, b, c, d] = self.0;
        Self([a * by, b * by, c * by, d * by])
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        let ([a, b, c, d], [x, y, z, w]) = (self.0, other.0);
        Self([a + x, b + y, c + z, d + w])
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        let ([a, b, c, d], [x, y, z, w]) = (self.0, other.0);
        Self([a - x, b - y, c - z, d - w])
    }
}

#[inline(always)]
fn from(p: [f32; 3], q: [f32; 3]) -> [f32; 3] {
    [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
}

#[inline(always)]
fn length_squared(d: [f32; 3]) -> f32 {
    d[0].mul_add(d[0], d[1].mul_add(d[1], d[2] * d[2]))
}
