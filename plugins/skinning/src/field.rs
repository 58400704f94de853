//! Numbers of joints at voxels, and between these to second order: a map of space.

use crate::distance::{far, on_bone, projected};
use crate::grid::Grid;
use crate::skeleton::Skeleton;
use crate::voxels::{NONE, Voxels};
use glam::{DVec3, IVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use simod_plugin_api::{Host, PluginError, PluginResult};
use std::collections::HashSet;

/// Largest number of entries of voxels and joints.
pub const MOST: usize = 1 << 26;
/// Bones that a warning names.
const NAMED: usize = 5;

/// Value of a joint at a voxel.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    pub joint: u16,
    pub value: f32,
    /// Change from cell to cell, along each axis.
    pub gradient: [f32; 3],
}

/// Value of a joint where a voxel has none for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Elsewhere {
    /// Value that the voxels around predict.
    Unknown,
    /// 0.
    Nothing,
}

/// Values of joints everywhere in space.
pub struct Field {
    pub voxels: Voxels,
    elsewhere: Elsewhere,
    /// Start of each voxel's entries, which are ordered by joint, and the number of all.
    starts: Vec<u32>,
    entries: Vec<Entry>,
    /// Voxels at the surface that have entries, and a tree of their middles.
    reached: Vec<u32>,
    tree: ImmutableKdTree<f32, 3>,
}

impl Field {
    /// Field of the entries of each joint, with their voxels; at least one is of a voxel at the surface.
    pub fn new(voxels: Voxels, fields: &[Vec<(u32, Entry)>], elsewhere: Elsewhere) -> PluginResult<Self> {
        let (starts, entries) = by_voxel(fields, voxels.len());
        let of = |v: u32| &entries[starts[v as usize] as usize..starts[v as usize + 1] as usize];
        let is_reached = |v: &u32| !voxels.is_inner(*v) && says(elsewhere, of(*v));
        let reached: Vec<u32> = (0..voxels.len() as u32).filter(is_reached).collect();
        let tree = tree(&voxels, &reached)?;
        Ok(Self { voxels, elsewhere, starts, entries, reached, tree })
    }

    /// Finds the values of the joints at a place. Beyond the model, and in parts of it that have none, they
    /// are those of the nearest place that has.
    pub fn numbers_at(&self, p: DVec3, values: &mut Vec<(f64, u16)>) {
        let grid = &self.voxels.grid;
        let mut voxel = self.voxels.id(grid.cell(p));
        let mut p = p;
        if voxel == NONE || !says(self.elsewhere, self.entries_of(voxel)) {
            let at = p.as_vec3().to_array();
            let near = self.tree.query(&at).nearest_one::<SquaredEuclidean<f32>>().execute();
            voxel = self.reached[near.item as usize];
            let (centre, half) = (self.voxels.centre(voxel), DVec3::splat(0.5 * grid.size));
            p = p.clamp(centre - half, centre + half);
        }
        self.between(p, voxel, values);
    }

    fn entries_of(&self, voxel: u32) -> &[Entry] {
        let voxel = voxel as usize;
        &self.entries[self.starts[voxel] as usize..self.starts[voxel + 1] as usize]
    }

    /// Finds the values of a place in a voxel for that voxel's joints: each of the eight voxels around
    /// predicts them to first order, and they are blended linearly.
    fn between(&self, p: DVec3, voxel: u32, values: &mut Vec<(f64, u16)>) {
        let own = self.entries_of(voxel);
        values.clear();
        values.extend(own.iter().map(|e| (0.0, e.joint)));
        let (corner, part) = split(&self.voxels.grid, p);
        // Sum of the weights by which the blend has each joint.
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
            let other = self.voxels.id(corner + by);
            if other == NONE || share == 0.0 {
                continue;
            }
            let entries = self.entries_of(other);
            if !says(self.elsewhere, entries) {
                continue;
            }
            let off = part - by.as_dvec3();
            let mut entries = entries.iter().peekable();
            for ((sum, joint), total) in values.iter_mut().zip(shares.iter_mut()) {
                while entries.next_if(|e| e.joint < *joint).is_some() {}
                if let Some(e) = entries.next_if(|e| e.joint == *joint) {
                    let slope = DVec3::from(e.gradient.map(f64::from)).dot(off);
                    *sum += share * (f64::from(e.value) + slope);
                    *total += share;
                } else if self.elsewhere == Elsewhere::Nothing {
                    *total += share;
                }
            }
        }
        values.iter_mut().zip(shares).for_each(|((sum, _), total)| *sum /= *total);
    }
}

/// Whether the entries of a voxel give any joint a value.
fn says(elsewhere: Elsewhere, entries: &[Entry]) -> bool {
    entries.iter().any(|e| elsewhere == Elsewhere::Unknown || e.value > 0.0)
}

/// First of the eight cells whose middles are around a place, and the position of the place between these.
fn split(grid: &Grid, p: DVec3) -> (IVec3, DVec3) {
    let place = (p - grid.origin) / grid.size - 0.5;
    let corner = place.floor();
    (corner.as_ivec3(), place - corner)
}

/// Changes of a voxel's value from cell to cell, along each axis; values that are not finite are not known.
pub fn gradient(voxels: &Voxels, voxel: u32, value: impl Fn(u32) -> f32) -> [f32; 3] {
    let here = value(voxel);
    let at = |v: u32| if v == NONE { f32::INFINITY } else { value(v) };
    let around = voxels.neighbours[voxel as usize];
    [0, 2, 4].map(|axis| {
        let [a, b] = [at(around[axis]), at(around[axis + 1])];
        match (a.is_finite(), b.is_finite()) {
            (true, true) => 0.5 * (b - a),
            (true, false) => here - a,
            (false, true) => b - here,
            (false, false) => 0.0,
        }
    })
}

/// Voxels that a bone passes through; or, where it is outside, those that are nearest to it.
#[derive(Debug)]
pub struct Passage {
    pub voxels: Vec<u32>,
    pub bone: [DVec3; 2],
    pub is_outside: bool,
}

impl Passage {
    /// Voxels of the passage and those about them, up to `most` cells from the bone, with their distances
    /// from it in cells; of a bone outside, those of the passage alone.
    pub fn about(&self, voxels: &Voxels, most: f64) -> Vec<(u32, f32)> {
        let far = |voxel: u32| far(voxels, voxel, self.bone);
        let mut found = self.voxels.clone();
        // Without leaving the model: beyond a gap there may be another limb.
        let mut is_known: HashSet<u32> = found.iter().copied().collect();
        let mut next = 0;
        while let Some(voxel) = found.get(next).copied().filter(|_| !self.is_outside) {
            for to in voxels.neighbours[voxel as usize] {
                if to != NONE && far(to) <= most && is_known.insert(to) {
                    found.push(to);
                }
            }
            next += 1;
        }
        found.into_iter().map(|v| (v, far(v) as f32)).collect()
    }
}

/// Passages of the bones of each joint; the host is told of bones outside of the model.
pub fn passages(voxels: &Voxels, skeleton: &Skeleton, host: &Host<'_>) -> PluginResult<Vec<Vec<Passage>>> {
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
        let mut passages = Vec::new();
        for (i, bone) in skeleton.bones(number).into_iter().enumerate() {
            let mut passed = on_bone(voxels, bone);
            let is_outside = passed.is_empty();
            if is_outside {
                passed = projected(voxels, bone, nearest);
                outside.push(match joint.children.get(i) {
                    Some(child) => format!("from `{}` to `{}`", joint.id, skeleton.joints[*child].id),
                    None => format!("at `{}`", joint.id),
                });
            }
            passages.push(Passage { voxels: passed, bone, is_outside });
        }
        all.push(passages);
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
    let none = Entry { joint: 0, value: 0.0, gradient: [0.0; 3] };
    let mut entries = vec![none; fields.iter().map(Vec::len).sum()];
    let mut next = starts.clone();
    for (v, entry) in fields.iter().flatten() {
        entries[next[*v as usize] as usize] = *entry;
        next[*v as usize] += 1;
    }
    (starts, entries)
}
