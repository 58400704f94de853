//! Twists and bends in single precision, many points at a time: for drafts, of which a hand that drags
//! wants one after the other.

use crate::map::{Warp, WarpKind};
use pulp::{Arch, Simd, WithSimd};

/// Number of points side by side: compilers make vectors of loops over so many.
const LANES: usize = 16;

type DraftLanes = [f32; LANES];

/// A warp whose sines take most of the time.
#[derive(Debug, Clone, Copy)]
pub struct Draft {
    centre: [f32; 3],
    axis: [f32; 3],
    from: f32,
    to: f32,
    kind: DraftMap,
}

/// See [`WarpKind`].
#[derive(Debug, Clone, Copy)]
enum DraftMap {
    /// Turn for each length along the axis.
    Twist { turn: f32 },
    /// Turn for each length along the axis, towards a direction across it; one place of the axis stays.
    Bend { turn: f32, across: [f32; 3], still: f32 },
}

impl Draft {
    /// Draft of a warp; none where the warp itself is as quick.
    pub fn new(warp: &Warp) -> Option<Self> {
        let [from, to] = warp.range;
        let per_length = |angle: f64| Some((angle / (to - from)) as f32).filter(|turn| turn.is_normal());
        let kind = match warp.deformation {
            WarpKind::Twist { angle } => DraftMap::Twist { turn: per_length(angle)? },
            WarpKind::Bend { angle, direction } => DraftMap::Bend {
                turn: per_length(angle)?,
                across: direction.map(|x| x as f32),
                still: 0.0_f64.clamp(from, to) as f32,
            },
            _ => return None,
        };
        let single = |v: [f64; 3]| v.map(|x| x as f32);
        let (centre, axis) = (single(warp.centre), single(warp.axis));
        Some(Self { centre, axis, from: from as f32, to: to as f32, kind })
    }

    /// Writes the images of points, of which there are as many. Nothing is fused, so that all processors
    /// give the same.
    pub fn apply(&self, points: &[[f32; 3]], images: &mut [[f32; 3]]) {
        Arch::new().dispatch(PointPackets { draft: self, points, images });
    }
}

/// Points that are moved in vectors of the processor's width.
struct PointPackets<'a> {
    draft: &'a Draft,
    points: &'a [[f32; 3]],
    images: &'a mut [[f32; 3]],
}

impl WithSimd for PointPackets<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { draft, points, images } = self;
        for (points, images) in points.chunks(LANES).zip(images.chunks_mut(LANES)) {
            let mut p = [[0.0; LANES]; 3];
            for (lane, point) in points.iter().enumerate() {
                (0..3).for_each(|k| p[k][lane] = point[k]);
            }
            match draft.kind {
                DraftMap::Twist { turn } => draft.twist(&mut p, turn),
                DraftMap::Bend { turn, across, still } => draft.bend(&mut p, turn, across, still),
            }
            for (lane, image) in images.iter_mut().enumerate() {
                *image = [p[0][lane], p[1][lane], p[2][lane]];
            }
        }
    }
}

impl Draft {
    /// The turn is added as a displacement, so that places that it does not reach stay exactly.
    #[inline(always)]
    fn twist(&self, p: &mut [DraftLanes; 3], turn: f32) {
        let (a, c) = (self.axis, self.centre);
        let mut angle = [0.0; LANES];
        for i in 0..LANES {
            let s = a[0] * (p[0][i] - c[0]) + a[1] * (p[1][i] - c[1]) + a[2] * (p[2][i] - c[2]);
            angle[i] = turn * (s.max(self.from).min(self.to) - self.from);
        }
        let (half_sin, half_cos) = sines(&angle.map(|angle| 0.5 * angle));
        for i in 0..LANES {
            let d = [p[0][i] - c[0], p[1][i] - c[1], p[2][i] - c[2]];
            let s = a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
            let (sin, less) = (2.0 * half_sin[i] * half_cos[i], 2.0 * half_sin[i] * half_sin[i]);
            for k in 0..3 {
                let (k1, k2) = ((k + 1) % 3, (k + 2) % 3);
                p[k][i] += sin * (a[k1] * d[k2] - a[k2] * d[k1]) - less * (d[k] - a[k] * s);
            }
        }
    }

    #[inline(always)]
    fn bend(&self, p: &mut [DraftLanes; 3], turn: f32, across: [f32; 3], still: f32) {
        let (a, c) = (self.axis, self.centre);
        let mut angle = [0.0; LANES];
        for i in 0..LANES {
            let s = a[0] * (p[0][i] - c[0]) + a[1] * (p[1][i] - c[1]) + a[2] * (p[2][i] - c[2]);
            angle[i] = turn * (s.max(self.from).min(self.to) - still);
        }
        let (half_sin, half_cos) = sines(&angle.map(|angle| 0.5 * angle));
        for i in 0..LANES {
            let d = [p[0][i] - c[0], p[1][i] - c[1], p[2][i] - c[2]];
            let s = a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
            let u = across[0] * d[0] + across[1] * d[1] + across[2] * d[2];
            let (sin, less) = (2.0 * half_sin[i] * half_cos[i], 2.0 * half_sin[i] * half_sin[i]);
            let beyond = s - s.max(self.from).min(self.to);
            // The point moves along the arc, and from its end along its normal and its tangent.
            let along = still + sin / turn - u * sin + beyond * (1.0 - less) - s;
            let aside = less / turn - u * less + beyond * sin;
            for k in 0..3 {
                p[k][i] += a[k] * along + across[k] * aside;
            }
        }
    }
}

/// Sines and cosines, to some 1e-7, by the polynomials of S. L. Moshier's Cephes, of angles up to some
/// thousand turns.
#[inline(always)]
fn sines(angles: &DraftLanes) -> (DraftLanes, DraftLanes) {
    /// Number whose addition leaves the nearest whole number in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    /// A quarter turn in three parts, whose multiples are exact.
    const QUARTER: [f32; 3] = [1.570_312_5, 4.837_513e-4, 7.549_79e-8];
    let (mut sin, mut cos) = ([0.0; LANES], [0.0; LANES]);
    for i in 0..LANES {
        let rounded = angles[i] * std::f32::consts::FRAC_2_PI + ROUND;
        let (quarter, turns) = (rounded.to_bits(), rounded - ROUND);
        let x = angles[i] - turns * QUARTER[0] - turns * QUARTER[1] - turns * QUARTER[2];
        let xx = x * x;
        let s = x + x * xx * (-1.666_665_5e-1 + xx * (8.332_161e-3 - xx * 1.951_529_6e-4));
        let c = 1.0 - 0.5 * xx + xx * xx * (4.166_664_6e-2 + xx * (-1.388_731_6e-3 + xx * 2.443_315_7e-5));
        // Every second quarter exchanges sine and cosine, and two of four change a sign.
        let swapped = (quarter & 1).wrapping_neg();
        let (s, c) = (s.to_bits(), c.to_bits());
        let both = (s ^ c) & swapped;
        sin[i] = f32::from_bits(s ^ both ^ (quarter & 2) << 30);
        cos[i] = f32::from_bits(c ^ both ^ (quarter.wrapping_add(1) & 2) << 30);
    }
    (sin, cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_those_of_the_library() {
        for first in (-40_000..40_000).step_by(LANES) {
            let angles: DraftLanes = std::array::from_fn(|i| 0.001 * (first + i as i32) as f32);
            let (sin, cos) = sines(&angles);
            for i in 0..LANES {
                let (s, c) = angles[i].sin_cos();
                let worst = (sin[i] - s).abs().max((cos[i] - c).abs());
                assert!(worst < 4e-7, "{}: {worst}", angles[i]);
            }
        }
    }

    #[test]
    fn drafts_are_like_results() {
        let direction = [1.0, 0.3, 0.0];
        let (twist, bend) = (|angle| WarpKind::Twist { angle }, |angle| WarpKind::Bend { angle, direction });
        for deformation in [twist(2.0), bend(1.2), twist(-7.0), bend(-1e-3), twist(1e-4), bend(3.0)] {
            for range in [[-0.5, 0.5], [0.1, 0.6], [-0.7, -0.2]] {
                let warp = Warp::new(deformation, [0.05, 0.1, -0.1], [0.2, 1.0, 0.1], range).unwrap();
                let draft = Draft::new(&warp).unwrap();
                let point = |i: usize| {
                    let t = i as f32 / 1000.0;
                    [0.3 * (7.0 * t).sin(), t - 0.5, 0.3 * (11.0 * t).cos()]
                };
                let points: Vec<[f32; 3]> = (0..1003).map(point).collect();
                let mut images = vec![[f32::NAN; 3]; points.len()];
                draft.apply(&points, &mut images);
                for (p, q) in points.iter().zip(&images) {
                    let exact = warp.apply(p.map(f64::from));
                    let worst = (0..3).map(|k| (exact[k] - f64::from(q[k])).abs()).fold(0.0, f64::max);
                    assert!(worst < 3e-6, "{deformation:?}, {range:?}: {worst} at {p:?}");
                }
            }
        }
        let taper =
            Warp::new(WarpKind::Taper { factor: 0.5 }, [0.0; 3], [0.0, 1.0, 0.0], [-1.0, 1.0]).unwrap();
        assert!(Draft::new(&taper).is_none(), "it is as quick itself");
    }
}
