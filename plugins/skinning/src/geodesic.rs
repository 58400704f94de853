//! Joints that a place of the model follows, and their weights: geodesic voxel binding.
//!
//! O. Dionne, M. de Lasa, *Geodesic voxel binding for production character meshes*, SCA 2013. Weights are of
//! the distances from the bones through the inside of the model. Theirs are `((1 - a) d + a d²)^-2` with `d`
//! in units of the model, which are powers of the distance between the second and the fourth; here the power
//! itself is the parameter, so that a limb bends the same whatever its size. Small weights fade to nothing,
//! so that places far away stay.

use crate::distance::March;
use crate::field::{Elsewhere, Entry, Field, MOST, Passage, gradient, passages};
use crate::influences::{Influences, faded, limited};
use crate::skeleton::Skeleton;
use crate::voxels::Voxels;
use glam::DVec3;
use simod_plugin_api::{Host, PluginError, PluginResult};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Shares of a joint in a place below which the joint has none of the place, and above which it has all of
/// its share.
const SHARES: [f64; 2] = [0.01, 0.05];
/// Least distance that counts, in cells.
const NEAREST: f64 = 0.25;
/// Distance from a bone, in cells, within which distances are exact.
const EXACT: f64 = 4.0;
/// Factor, and number of cells, by which marches go further than needed: they are smoothed and interpolated.
const FURTHER: [f32; 2] = [1.1, 2.0];

/// Parameters of the weights.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// Power of the distance by which weights fall.
    pub power: f64,
    /// Length over which creases of the distances are rounded off, local coordinates.
    pub smoothing: f64,
    /// Largest number of joints that a place follows.
    pub limit: usize,
}

/// Weights everywhere.
pub struct Geodesic {
    distances: Field,
    rule: Rule,
}

impl Geodesic {
    /// Binds a model's voxels to a skeleton.
    pub fn new(voxels: Voxels, skeleton: &Skeleton, rule: Rule, host: &Host<'_>) -> PluginResult<Self> {
        let passages = passages(&voxels, skeleton, host)?;
        let about = |p: &Vec<Passage>| p.iter().flat_map(|p| p.about(&voxels, EXACT)).collect();
        let seeds: Vec<Vec<(u32, f32)>> = passages.iter().map(about).collect();
        let is_wanted = |at: f64| move || host.progress(at).is_ok();
        // Distances of the nearest bones, and the largest that those of others may have then.
        let all = seeds.iter().flatten().copied();
        let nearest = March::new(&voxels, all, |_, _| true, is_wanted(0.25));
        host.progress(0.3)?;
        let wide = SHARES[0].powf(-1.0 / rule.power) as f32 * FURTHER[0];
        let needed = |v: u32| wide * nearest.distances[v as usize].max(NEAREST as f32) + FURTHER[1];
        let most = nearest.order.iter().map(|v| needed(*v)).fold(0.0, f32::max);
        // Reach of a march: it goes on while it may come to a place where it is needed: at u if d(u) + |uv|
        // <= needed(v) for any v.
        let rest = nearest.order.iter().map(|v| (*v, most - needed(*v)));
        let useless = March::new(&voxels, rest, |_, _| true, is_wanted(0.35)).distances;
        host.progress(0.4)?;
        let times = (3.0 * (rule.smoothing / voxels.grid.size).powi(2)).round() as usize;
        let mut fields: Vec<Vec<(u32, Entry)>> = vec![Vec::new(); skeleton.joints.len()];
        let joints = fields.len() as f64;
        let (done, total) = (AtomicUsize::new(0), AtomicUsize::new(0));
        host.parallel_blocks(&mut fields, 1, |joint, field| {
            if total.load(Ordering::Relaxed) > MOST {
                return;
            }
            let seeds = seeds[joint].iter().copied();
            let at = 0.4 + 0.5 * done.load(Ordering::Relaxed) as f64 / joints;
            let is_needed = |v: u32, d: f32| d <= most - useless[v as usize];
            let mut march = March::new(&voxels, seeds, is_needed, is_wanted(at));
            // Too many are refused below, and not kept until then.
            let count = march.order.len();
            if total.fetch_add(count, Ordering::Relaxed) + count > MOST {
                return;
            }
            march.smooth(&voxels, times, is_wanted(at));
            let entry = |v: &u32| {
                let gradient = gradient(&voxels, *v, |v| march.distances[v as usize]);
                (*v, Entry { joint: joint as u16, value: march.distances[*v as usize], gradient })
            };
            field[0] = march.order.iter().map(entry).collect();
            done.fetch_add(1, Ordering::Relaxed);
        })?;
        host.progress(0.9)?;
        let total = total.into_inner();
        if total > MOST {
            let what = format!("is too fine for this skeleton and falloff: more than {MOST} distances");
            return Err(PluginError::parameter("resolution", &what).hint("lower it, or raise `falloff`"));
        }
        Ok(Self { distances: Field::new(voxels, &fields, Elsewhere::Unknown)?, rule })
    }

    /// The joints that a place follows.
    pub fn influences_at(&self, p: DVec3, room: &mut Influences) {
        self.distances.numbers_at(p, room);
        self.weights(room);
        limited(room, self.rule.limit);
    }

    /// Turns distances into shares, of which small ones are faded out.
    fn weights(&self, distances: &mut Influences) {
        distances.iter_mut().for_each(|(d, _)| *d = d.max(NEAREST));
        let nearest = distances.iter().map(|d| d.0).fold(f64::INFINITY, f64::min);
        distances.iter_mut().for_each(|(d, _)| *d = (nearest / *d).powf(self.rule.power));
        faded(distances, SHARES);
    }
}
