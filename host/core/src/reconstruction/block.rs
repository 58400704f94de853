//! Blocks of consecutive vertices: each finds its home, vertices of one home are put side by side, and the blend
//! goes over them.

use std::sync::{Mutex, PoisonError};

use glam::{DVec3, Mat3, Vec3};

use super::blend::{Grouped, LEAST_WEIGHT, PACKET, blend};
use crate::frame::Frame;

use super::{DeformationField, Method, Transport, projected_barycentric};

/// Vertices of a block: many, so that there are several of each home. A fixed number, so that the result does not
/// depend on the number of threads.
pub const BLOCK: usize = 1 << 13;

/// Memory that is used again from block to block.
///
/// About 150 bytes per vertex of a block and 8 per sample.
#[derive(Debug, Default)]
pub struct Workspace {
    /// Local positions.
    local: Vec<Vec3>,
    homes: Vec<u32>,
    /// For each sample, the group of which it is the home, if that group is of this block.
    group_of: Vec<u32>,
    /// Number of vertices of each group, and then where the next one goes.
    next: Vec<usize>,
    /// Where each vertex is among the grouped ones, if its home moves.
    place: Vec<u32>,
    grouped: Grouped,
}

/// Workspaces that are not in use: as many as there were ever blocks at a time.
#[derive(Debug, Default)]
pub struct Workspaces(Mutex<Vec<Workspace>>);

impl Workspaces {
    /// Lends one to `work`.
    pub fn with<R>(&self, work: impl FnOnce(&mut Workspace) -> R) -> R {
        let free = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut workspace = free().pop().unwrap_or_default();
        let result = work(&mut workspace);
        free().push(workspace);
        result
    }
}

impl Workspace {
    /// Carries a block over, as [`DeformationField::carry`].
    pub fn carry_block(
        &mut self,
        field: &DeformationField,
        frame: &Frame,
        positions: &mut [DVec3],
        normals: &mut [Vec3],
    ) -> u64 {
        let mut local = std::mem::take(&mut self.local);
        local.clear();
        local.extend(positions.iter().map(|p| frame.to_local(*p)));
        let mut non_finite = 0;
        for (p, local) in positions.iter().zip(&mut local) {
            if !p.is_finite() {
                non_finite += 1;
                // Anywhere: what comes of it is not used.
                *local = Vec3::ZERO;
            }
        }
        self.transports(field, &local, normals);
        for (i, p) in positions.iter_mut().enumerate() {
            if let Some(moved) = self.transport(field, i, local[i], !normals.is_empty())
                && p.is_finite()
            {
                // Only the displacement is in single precision.
                *p += moved.displacement.as_dvec3() * frame.scale;
                if let Some(n) = normals.get_mut(i) {
                    *n = moved.normal(*n);
                }
            }
        }
        self.local = local;
        non_finite
    }

    /// Finds out what happens to the vertices of a block at these finite local positions, with normals or none.
    fn transports(&mut self, field: &DeformationField, positions: &[Vec3], normals: &[Vec3]) {
        field.homes().of(positions, normals, &mut self.homes);
        if field.method == Method::BlendedJets {
            let gradient = !normals.is_empty();
            self.group(field, positions, gradient);
            blend(&field.supports, &field.expansions, gradient, &mut self.grouped);
        }
    }

    /// What happens to vertex `i` of the block; `None` if it stays. Without `gradient` that of the result is not known.
    fn transport(&self, field: &DeformationField, i: usize, p: Vec3, gradient: bool) -> Option<Transport> {
        let home = self.homes[i] as usize;
        if !field.active[home] {
            return None;
        }
        if field.method == Method::ProjectedBarycentric {
            return Some(projected_barycentric::carry(field, home, p));
        }
        let (at, g) = (self.place[i] as usize, &self.grouped);
        if g.sum[at] < LEAST_WEIGHT {
            return Some(field.beyond(home, p));
        }
        let mut displacement = Vec3::from_array(g.displacement.each_ref().map(|v| v[at]));
        if field.limiter.concerns(home) {
            displacement = field.limiter.limited(&field.supports, &field.expansions, home, p, displacement);
        }
        let gradient = if gradient {
            Mat3::IDENTITY + Mat3::from_cols_array(&g.gradient.each_ref().map(|v| v[at]))
        } else {
            Mat3::IDENTITY
        };
        Some(Transport { displacement, gradient })
    }

    /// Puts the vertices of each home that moves side by side.
    fn group(&mut self, field: &DeformationField, positions: &[Vec3], gradient: bool) {
        let Self { homes, group_of, next, place, grouped, .. } = self;
        group_of.resize(field.active.len(), u32::MAX);
        next.clear();
        grouped.groups.clear();
        for home in homes.iter() {
            let h = *home as usize;
            if !field.active[h] {
                continue;
            }
            // What an earlier block left is no group of this one, unless that group is of the same home.
            let group = group_of[h] as usize;
            if grouped.groups.get(group).is_some_and(|(of, _)| of == home) {
                next[group] += 1;
            } else {
                group_of[h] = grouped.groups.len() as u32;
                grouped.groups.push((*home, 0..0));
                next.push(1);
            }
        }
        let mut end = 0;
        for ((_, range), next) in grouped.groups.iter_mut().zip(next.iter_mut()) {
            *range = end..end + *next;
            *next = end;
            end = range.end.next_multiple_of(PACKET);
        }
        let arrays = grouped.positions.iter_mut().chain(&mut grouped.displacement).chain([&mut grouped.sum]);
        let gradient = grouped.gradient.iter_mut().take(if gradient { 9 } else { 0 });
        arrays.chain(gradient).for_each(|v| v.resize(end, 0.0));
        for (home, range) in &grouped.groups {
            // Lanes that are left over are at the home, where they disturb nobody.
            let center = field.samples.positions[*home as usize];
            let rest = range.end..range.end.next_multiple_of(PACKET);
            (0..3).for_each(|i| grouped.positions[i][rest.clone()].fill(center[i]));
        }
        place.clear();
        place.extend(positions.iter().zip(homes).map(|(p, home)| {
            if !field.active[*home as usize] {
                return u32::MAX;
            }
            let next = &mut next[group_of[*home as usize] as usize];
            let at = *next;
            *next += 1;
            (0..3).for_each(|i| grouped.positions[i][at] = p[i]);
            at as u32
        }));
    }
}
