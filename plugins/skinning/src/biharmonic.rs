//! Joints that a place of the model follows, and their weights: bounded biharmonic weights on the model's
//! voxels.
//!
//! See `bounded`. Weights of a thousandth are nothing, so that places far away stay.

use crate::bounded::{LANES, Lanes, solve};
use crate::field::{Elsewhere, Entry, Field, MOST, gradient, passages};
use crate::influences::{Influences, faded, limited};
use crate::levels::{Held, coarser_held, levels, parts};
use crate::skeleton::Skeleton;
use crate::voxels::Voxels;
use glam::DVec3;
use simod_plugin_api::{Host, PluginError, PluginResult};
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Shares of a joint in a place below which the joint has none of the place, and above which it has all of
/// its share.
const SHARES: [f64; 2] = [0.001, 0.005];
/// Distance from a bone, in cells, within which voxels are on it: so a bone between two rows of them is on
/// both.
const BESIDE: f64 = 0.75;
/// Weights of voxels below are not kept.
const LEAST: f64 = 1e-4;

/// Weights everywhere.
pub struct Biharmonic {
    weights: Field,
    /// Largest number of joints that a place follows.
    limit: usize,
}

impl Biharmonic {
    /// Binds a model's voxels to a skeleton.
    pub fn new(voxels: Voxels, skeleton: &Skeleton, limit: usize, host: &Host<'_>) -> PluginResult<Self> {
        let passages = passages(&voxels, skeleton, host)?;
        let mut sums: HashMap<u32, HashMap<u16, f64>> = HashMap::new();
        let mut bound = Vec::new();
        for (joint, passages) in (0..).zip(&passages) {
            if !passages.is_empty() {
                bound.push(joint);
            }
            for (voxel, _) in passages.iter().flat_map(|p| p.about(&voxels, BESIDE)) {
                *sums.entry(voxel).or_default().entry(joint).or_default() += 1.0;
            }
        }
        let mut own: Held = sums.into_iter().map(|(voxel, sum)| (voxel, parts(sum))).collect();
        own.sort_unstable_by_key(|h| h.0);
        let mut held = vec![own];
        let levels = levels(&voxels);
        host.progress(0.3)?;
        for (level, depth) in levels[..levels.len() - 1].iter().zip(0..) {
            let next = coarser_held(&held[depth], level);
            held.push(next);
        }
        let groups: Vec<&[u16]> = bound.chunks(LANES).collect();
        let mut fields: Vec<Vec<Vec<(u32, Entry)>>> = vec![Vec::new(); groups.len()];
        let (done, total) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let count = groups.len() as f64;
        host.parallel_blocks(&mut fields, 1, |group, fields| {
            let at = 0.3 + 0.6 * done.load(Ordering::Relaxed) as f64 / count;
            if total.load(Ordering::Relaxed) <= MOST {
                let weights = solve(&levels, &held, groups[group], || host.progress(at).is_ok());
                fields[0] = entries(&voxels, &weights, groups[group]);
            }
            total.fetch_add(fields[0].iter().map(Vec::len).sum(), Ordering::Relaxed);
            done.fetch_add(1, Ordering::Relaxed);
        })?;
        host.progress(0.9)?;
        if total.into_inner() > MOST {
            let what = format!("is too fine for this skeleton: more than {MOST} weights");
            return Err(PluginError::parameter("resolution", &what).hint("lower it"));
        }
        let fields: Vec<_> = fields.into_iter().flatten().collect();
        Ok(Self { weights: Field::new(voxels, &fields, Elsewhere::Nothing)?, limit })
    }

    /// The joints that a place follows.
    pub fn influences_at(&self, p: DVec3, room: &mut Influences) {
        self.weights.numbers_at(p, room);
        let largest = room.iter().map(|w| w.0).fold(f64::NEG_INFINITY, f64::max);
        // Weights that are continued from the voxels may all be zero.
        let part =
            |w: f64| if largest > 0.0 { (w / largest).max(0.0) } else { f64::from(u8::from(w == largest)) };
        room.iter_mut().for_each(|(w, _)| *w = part(*w));
        faded(room, SHARES);
        limited(room, self.limit);
    }
}

/// The weights of some joints that are not nothing, and those beside them.
fn entries(voxels: &Voxels, weights: &[Lanes], joints: &[u16]) -> Vec<Vec<(u32, Entry)>> {
    let of = |lane: usize| {
        let mut is_kept: Vec<bool> = weights.iter().map(|w| w[lane] > LEAST).collect();
        let kept: Vec<u32> = (0..voxels.len() as u32).filter(|v| is_kept[*v as usize]).collect();
        for voxel in kept {
            voxels.all_around(voxel).for_each(|v| is_kept[v as usize] = true);
        }
        let entry = |voxel: u32| Entry {
            joint: joints[lane],
            value: weights[voxel as usize][lane] as f32,
            gradient: gradient(voxels, voxel, |v| weights[v as usize][lane] as f32),
        };
        (0..voxels.len() as u32).filter(|v| is_kept[*v as usize]).map(|v| (v, entry(v))).collect()
    };
    (0..joints.len()).map(of).collect()
}
