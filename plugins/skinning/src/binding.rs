//! Which joints a place of the model follows, and how much: geodesic voxel binding.
//!
//! O. Dionne, M. de Lasa, *Geodesic voxel binding for production character meshes*, SCA 2013. Weights are of
//! the distances from the bones through the inside of the model. Theirs are `((1 - a) d + a d²)^-2` with `d`
//! in units of the model, which are powers of the distance between the second and the fourth; here the power
//! itself is the parameter, so that a limb bends the same whatever its size. Small ones fade to nothing, so
//! that what is far stays.
//!
//! Distances are of voxels; between these they are interpolated to second order, and so weights are a map of
//! space.

use crate::distance::{March, inside, projected};
use crate::influences::{Influences, limited};
use crate::skeleton::Skeleton;
use crate::voxels::{NONE, Voxels};
use glam::{DVec3, IVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use simod_plugin_api::{Host, PluginError, PluginResult};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A joint's share in a place below which it has none, and above which it has all of it.
const SHARES: [f64; 2] = [0.01, 0.05];
/// Distances are taken for so many cells at least.
const NEAREST: f64 = 0.25;
/// So much further than needed marches go, as a factor and in cells: they are smoothed and interpolated.
const FURTHER: [f32; 2] = [1.1, 2.0];
/// Most distances of voxels and joints.
const MOST: usize = 1 << 26;
/// Bones that a warning names.
const NAMED: usize = 5;

/// What the weights are by.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// The power of the distance by which weights fall.
    pub power: f64,
    /// Over which length creases of the distances are rounded off, local coordinates.
    pub smoothing: f64,
    /// Most joints that a place follows.
    pub limit: usize,
}

/// The distance of a voxel from a joint's bones.
#[derive(Debug, Clone, Copy)]
struct Entry {
    joint: u16,
    /// In cells.
    distance: f32,
    /// By cells.
    gradient: [f32; 3],
}

/// Weights everywhere.
pub struct Binding {
    voxels: Voxels,
    /// Where each voxel's entries begin, by joint, and their number.
    starts: Vec<u32>,
    entries: Vec<Entry>,
    /// The voxels at the surface that are near a bone, and where they are.
    reached: Vec<u32>,
    tree: ImmutableKdTree<f32, 3>,
    rule: Rule,
}

impl Binding {
    /// Binds a model's voxels to a skeleton.
    pub fn new(voxels: Voxels, skeleton: &Skeleton, rule: Rule, host: &Host<'_>) -> PluginResult<Self> {
        let seeds = seeds(&voxels, skeleton, host)?;
        let is_wanted = |at: f64| move || host.progress(at).is_ok();
        // How far the nearest bone is, and how far others may be then.
        let all = seeds.iter().flatten().copied();
        let nearest = March::new(&voxels, all, |_, _| true, is_wanted(0.25));
        host.progress(0.3)?;
        let wide = SHARES[0].powf(-1.0 / rule.power) as f32 * FURTHER[0];
        let needed = |v: u32| wide * nearest.distances[v as usize].max(NEAREST as f32) + FURTHER[1];
        let most = nearest.order.iter().map(|v| needed(*v)).fold(0.0, f32::max);
        // A march goes on while it may come to where it is needed: at u if d(u) + |uv| <= needed(v) for any
        // v.
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
                let distance = march.distances[*v as usize];
                (*v, Entry { joint: joint as u16, distance, gradient: march.gradient(&voxels, *v) })
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
        let (starts, entries) = by_voxel(&fields, voxels.len());
        let is_reached = |v: &u32| starts[*v as usize] < starts[*v as usize + 1] && !voxels.is_inner(*v);
        let reached: Vec<u32> = (0..voxels.len() as u32).filter(is_reached).collect();
        let tree = tree(&voxels, &reached)?;
        Ok(Self { voxels, starts, entries, reached, tree, rule })
    }

    /// What a place follows, with the weights: `room` is for what is in between. Beyond the model, and in
    /// parts of it that no bone reaches, it is what the nearest place follows.
    pub fn at(&self, p: DVec3, room: &mut Vec<(f64, u16)>) -> Influences {
        let grid = &self.voxels.grid;
        let mut voxel = self.voxels.id(grid.cell(p));
        let mut p = p;
        if voxel == NONE || self.of(voxel).is_empty() {
            let at = p.as_vec3().to_array();
            let near = self.tree.query(&at).nearest_one::<SquaredEuclidean<f32>>().execute();
            voxel = self.reached[near.item as usize];
            let (centre, half) = (self.voxels.centre(voxel), DVec3::splat(0.5 * grid.size));
            p = p.clamp(centre - half, centre + half);
        }
        self.distances(p, voxel, room);
        self.weights(room);
        limited(room, self.rule.limit)
    }

    fn of(&self, voxel: u32) -> &[Entry] {
        let voxel = voxel as usize;
        &self.entries[self.starts[voxel] as usize..self.starts[voxel + 1] as usize]
    }

    /// The distances of a place in a voxel from that voxel's joints, in cells: each of the eight voxels
    /// around predicts them to first order, and they are blended linearly.
    fn distances(&self, p: DVec3, voxel: u32, distances: &mut Vec<(f64, u16)>) {
        let grid = &self.voxels.grid;
        let own = self.of(voxel);
        distances.clear();
        distances.extend(own.iter().map(|e| (0.0, e.joint)));
        let place = (p - grid.origin) / grid.size - 0.5;
        let corner = place.floor();
        let part = place - corner;
        // How much of the blend has each joint.
        let mut shares = [0.0; 64];
        let mut many = Vec::new();
        let shares: &mut [f64] = match own.len() {
            n @ ..=64 => &mut shares[..n],
            n => {
                many.resize(n, 0.0);
                &mut many
            }
        };
        for k in 0..8 {
            let by = IVec3::new(k & 1, k >> 1 & 1, k >> 2);
            let near = DVec3::ONE - part;
            let share: f64 = (0..3).map(|a| if by[a] == 1 { part[a] } else { near[a] }).product();
            let other = self.voxels.id(corner.as_ivec3() + by);
            if other == NONE || share == 0.0 {
                continue;
            }
            let off = part - by.as_dvec3();
            let mut entries = self.of(other).iter().peekable();
            for ((sum, joint), total) in distances.iter_mut().zip(shares.iter_mut()) {
                while entries.next_if(|e| e.joint < *joint).is_some() {}
                if let Some(e) = entries.next_if(|e| e.joint == *joint) {
                    let slope = DVec3::from(e.gradient.map(f64::from)).dot(off);
                    *sum += share * (f64::from(e.distance) + slope);
                    *total += share;
                }
            }
        }
        for ((sum, _), total) in distances.iter_mut().zip(shares) {
            *sum = (*sum / *total).max(NEAREST);
        }
    }

    /// Turns distances into shares, of which small ones are faded out.
    fn weights(&self, distances: &mut Vec<(f64, u16)>) {
        let nearest = distances.iter().map(|d| d.0).fold(f64::INFINITY, f64::min);
        distances.iter_mut().for_each(|(d, _)| *d = (nearest / *d).powf(self.rule.power));
        let sum: f64 = distances.iter().map(|d| d.0).sum();
        for (weight, _) in distances.iter_mut() {
            let share = *weight / sum;
            let t = ((share - SHARES[0]) / (SHARES[1] - SHARES[0])).clamp(0.0, 1.0);
            *weight = share * t * t * (3.0 - 2.0 * t);
        }
        distances.retain(|(weight, _)| *weight > 0.0);
    }
}

/// The voxels about each joint's bones, with their distances.
fn seeds(voxels: &Voxels, skeleton: &Skeleton, host: &Host<'_>) -> PluginResult<Vec<Vec<(u32, f32)>>> {
    let surface: Vec<u32> = (0..voxels.len() as u32).filter(|v| !voxels.is_inner(*v)).collect();
    let tree = tree(voxels, &surface)?;
    let nearest = |p: DVec3| {
        let near = tree.query(&p.as_vec3().to_array()).nearest_one::<SquaredEuclidean<f32>>().execute();
        surface.get(near.item as usize).copied()
    };
    if !voxels.encloses {
        host.warn("the model encloses nothing: what is between its surface and the bones counts as inside");
    }
    let mut outside = Vec::new();
    let mut all = Vec::with_capacity(skeleton.joints.len());
    for (number, joint) in skeleton.joints.iter().enumerate() {
        host.progress(0.15 + 0.1 * number as f64 / skeleton.joints.len() as f64)?;
        let mut seeds = Vec::new();
        for (i, bone) in skeleton.bones(number).into_iter().enumerate() {
            let within = inside(voxels, bone);
            if within.is_empty() {
                seeds.extend(projected(voxels, bone, nearest));
                outside.push(match joint.children.get(i) {
                    Some(child) => format!("from `{}` to `{}`", joint.id, skeleton.joints[*child].id),
                    None => format!("at `{}`", joint.id),
                });
            }
            seeds.extend(within);
        }
        all.push(seeds);
    }
    if !outside.is_empty() {
        let more = if outside.len() > NAMED { ", ..." } else { "" };
        let names = outside[..outside.len().min(NAMED)].join(", ");
        host.warn(&format!("bones lie outside of the model, and move what is nearest: {names}{more}"));
    }
    Ok(all)
}

fn tree(voxels: &Voxels, of: &[u32]) -> PluginResult<ImmutableKdTree<f32, 3>> {
    let at: Vec<[f32; 3]> = of.iter().map(|v| voxels.centre(*v).as_vec3().to_array()).collect();
    ImmutableKdTree::new_from_slice(&at).map_err(|_| PluginError::internal("the voxels cannot be searched"))
}

/// The entries of each voxel, by joint, one voxel after the other; and where each begins.
fn by_voxel(fields: &[Vec<(u32, Entry)>], voxels: usize) -> (Vec<u32>, Vec<Entry>) {
    let mut starts = vec![0_u32; voxels + 1];
    fields.iter().flatten().for_each(|(v, _)| starts[*v as usize + 1] += 1);
    (1..starts.len()).for_each(|v| starts[v] += starts[v - 1]);
    let none = Entry { joint: 0, distance: 0.0, gradient: [0.0; 3] };
    let mut entries = vec![none; fields.iter().map(Vec::len).sum()];
    let mut next = starts.clone();
    for (v, entry) in fields.iter().flatten() {
        entries[next[*v as usize] as usize] = *entry;
        next[*v as usize] += 1;
    }
    (starts, entries)
}
