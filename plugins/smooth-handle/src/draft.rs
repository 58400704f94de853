//! Drafts of one handle that moves, in single precision: a hand mostly drags one handle, and wants one
//! picture after the other.

use crate::influence::{HandleShares, Profile};
use crate::motion::{HandleMotion, blend};
use glam::{DVec3, Vec3, Vec3A};
use simod_plugin_api::{Host, PluginResult};

/// Number of samples that are looked after at once on one thread.
const BLOCK: usize = 4096;

/// Part of a handle's motion that each sample makes: kept from draft to draft, as it does not depend on the
/// motion.
///
/// Memory: 4 bytes for each sample.
#[derive(Default)]
pub struct Amounts {
    of: Option<Of>,
    values: Vec<f32>,
}

/// Key of amounts: a preparation, by its number, one of its handles, and a profile.
#[derive(PartialEq)]
struct Of {
    state: u64,
    handle: usize,
    profile: (u8, Vec<[f64; 2]>),
}

impl Amounts {
    /// Amounts of a handle, computed from `shares`, the samples' shares of the preparation of this number.
    pub fn of_handle(
        &mut self,
        (shares, state): (&HandleShares, u64),
        handle: usize,
        profile: &Profile<'_>,
        host: &Host<'_>,
    ) -> PluginResult<&[f32]> {
        let of = Some(Of { state, handle, profile: profile.key() });
        if self.of != of {
            // Amounts that are not finished must have no key.
            self.of = None;
            self.values.clear();
            self.values.resize(shares.samples(), 0.0);
            host.parallel_blocks(&mut self.values, BLOCK, |first, values| {
                let mut amounts = vec![0.0; shares.handles()];
                for (i, value) in (first..).zip(values) {
                    profile.amounts(shares.row(i), &mut amounts);
                    *value = amounts[handle] as f32;
                }
            })?;
            self.of = of;
        }
        Ok(&self.values)
    }
}

/// Table of parts of one motion: parts between two of them are interpolated on a straight line.
pub struct PartsTable<'a> {
    motion: &'a HandleMotion,
    /// Displacement by each part, as an affine map: three columns, and the origin's displacement.
    parts: Vec<[Vec3A; 4]>,
}

impl<'a> PartsTable<'a> {
    /// Number of parts: within a half turn, the line between two leaves the screw by about a millionth of
    /// the distance from its axis.
    const STEPS: usize = 1024;

    /// The table of a motion.
    pub fn new(motion: &'a HandleMotion) -> Self {
        let part = |k: usize| {
            let t = k as f64 / Self::STEPS as f64;
            let moved = |p: DVec3| blend(p, std::iter::once((motion, t))) - p;
            let origin = moved(DVec3::ZERO);
            let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| moved(axis) - origin);
            [axes[0], axes[1], axes[2], origin].map(|v| v.as_vec3a())
        };
        Self { motion, parts: (0..=Self::STEPS).map(part).collect() }
    }

    /// Moves the samples by such parts of the motion.
    pub fn apply(&self, amounts: &[f32], rest: &[[f32; 3]], out: &mut [[f32; 3]]) {
        for ((out, p), t) in out.iter_mut().zip(rest).zip(amounts) {
            *out = self.image(*t, *p);
        }
    }

    #[inline]
    fn image(&self, t: f32, p: [f32; 3]) -> [f32; 3] {
        if t == 0.0 {
            // A sample that makes none of the motion stays exactly in its place.
            return p;
        }
        if t > 0.0 && t < 1.0 {
            let place = t * Self::STEPS as f32;
            let below = (place as usize).min(Self::STEPS - 1);
            let [from, to] = [below, below + 1].map(|k| {
                let [x, y, z, origin] = self.parts[k];
                origin + x * p[0] + y * p[1] + z * p[2]
            });
            return (Vec3A::from(p) + from + (to - from) * (place - below as f32)).to_array();
        }
        let p = Vec3::from(p).as_dvec3();
        let image = if t == 1.0 {
            self.motion.all(p)
        } else {
            blend(p, std::iter::once((self.motion, f64::from(t))))
        };
        image.as_vec3().to_array()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::affine;
    use glam::DMat3;

    #[test]
    fn parts_of_a_table_are_those_of_the_motion() {
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize_or(DVec3::Y), 3.0);
        let stretch = DMat3::from_diagonal(DVec3::new(1.5, 0.8, 1.0));
        let center = DVec3::new(0.1, 0.3, -0.2);
        for matrix in [turn, 1.3 * turn * stretch, DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))] {
            let motion = HandleMotion::new(&affine(matrix, DVec3::new(0.2, -0.1, 0.4)), center);
            let table = PartsTable::new(&motion);
            // Drawn profiles may leave 0 to 1.
            for k in -20..=797 {
                let (t, p) = (k as f32 / 777.0, Vec3::new(0.3, -0.4, 0.01 * (k % 50) as f32));
                let part = Vec3::from(table.image(t, p.to_array())).as_dvec3();
                let exact = blend(p.as_dvec3(), std::iter::once((&motion, f64::from(t))));
                assert!(part.distance(exact) < 5e-6, "{t}: {part} {exact}");
            }
            let p = [-0.0, 0.2, 0.3];
            assert_eq!(table.image(0.0, p).map(f32::to_bits), p.map(f32::to_bits));
        }
    }
}
