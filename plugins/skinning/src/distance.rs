//! Distances from bones through the inside of a model.
//!
//! Distances are found by fast marching (J. A. Sethian, *A fast marching level set method for monotonically
//! advancing fronts*, PNAS 93, 1996), so that they are nearly the same in all directions, and do not show the
//! voxels' axes as paths over these do. At the surface, where voxels have few neighbours over their faces,
//! steps over edges and corners count too.

use crate::skeleton::on_segment;
use crate::voxels::{NONE, Voxels};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Points of a bone outside of the model that are looked at.
const PROJECTED: usize = 256;
/// Steps between two looks at the wish to stop.
const PATIENCE: usize = 1 << 12;

/// Distances of all voxels, in cells; infinite where the march did not reach.
pub struct March {
    pub distances: Vec<f32>,
    /// Voxels that the march reached, nearest first.
    pub order: Vec<u32>,
    is_done: Vec<bool>,
}

/// Voxels that the march has reached and that are not done, by their distances: distances that are not
/// negative have the order of their bits.
#[derive(Default)]
struct Front(BinaryHeap<Reverse<u64>>);

impl Front {
    fn add(&mut self, voxel: u32, distance: f32) {
        self.0.push(Reverse(u64::from(distance.to_bits()) << 32 | u64::from(voxel)));
    }

    /// Takes out the nearest voxel, with its distance.
    fn nearest(&mut self) -> Option<(u32, f32)> {
        self.0.pop().map(|Reverse(next)| (next as u32, f32::from_bits((next >> 32) as u32)))
    }
}

impl March {
    /// From `seeds`, voxels with their distances. It goes no further from a voxel where `goes_on` says so,
    /// and that is no longer among those it came to. Stopped half-way if `is_wanted` says so.
    pub fn new(
        voxels: &Voxels,
        seeds: impl Iterator<Item = (u32, f32)>,
        goes_on: impl Fn(u32, f32) -> bool,
        is_wanted: impl Fn() -> bool,
    ) -> Self {
        let mut this = Self {
            distances: vec![f32::INFINITY; voxels.len()],
            order: Vec::new(),
            is_done: vec![false; voxels.len()],
        };
        let mut front = Front::default();
        for (voxel, distance) in seeds {
            this.relax(voxel, distance, &mut front);
        }
        while let Some((voxel, distance)) = front.nearest() {
            if this.is_done[voxel as usize] || distance > this.distances[voxel as usize] {
                continue;
            }
            if !goes_on(voxel, distance) {
                continue;
            }
            this.is_done[voxel as usize] = true;
            this.order.push(voxel);
            if this.order.len().is_multiple_of(PATIENCE) && !is_wanted() {
                break;
            }
            this.relax_around(voxels, voxel, distance, &mut front);
        }
        for (distance, is_done) in this.distances.iter_mut().zip(&this.is_done) {
            if !is_done {
                *distance = f32::INFINITY;
            }
        }
        this
    }

    /// Sets a voxel's distance if it is less than the known one.
    #[inline]
    fn relax(&mut self, voxel: u32, distance: f32, front: &mut Front) {
        if distance < self.distances[voxel as usize] {
            self.distances[voxel as usize] = distance;
            front.add(voxel, distance);
        }
    }

    /// Goes on from a voxel that is done to those around it: along the axes, and at the surface across.
    #[inline]
    fn relax_around(&mut self, voxels: &Voxels, voxel: u32, distance: f32, front: &mut Front) {
        for to in voxels.neighbours[voxel as usize] {
            if to != NONE && !self.is_done[to as usize] {
                let found = self.arrival(&voxels.neighbours[to as usize]);
                self.relax(to, found.max(distance), front);
            }
        }
        if !voxels.is_inner(voxel) {
            for (to, far) in voxels.diagonal(voxel) {
                if !self.is_done[to as usize] {
                    self.relax(to, distance + far, front);
                }
            }
        }
    }

    /// Distance at which a front arrives at a voxel, by its neighbours: the gradient has length 1.
    fn arrival(&self, neighbours: &[u32; 6]) -> f32 {
        let at = |voxel: u32| {
            let is_known = voxel != NONE && self.is_done[voxel as usize];
            if is_known { self.distances[voxel as usize] } else { f32::INFINITY }
        };
        let mut along = [0, 2, 4].map(|axis| at(neighbours[axis]).min(at(neighbours[axis + 1])));
        along.sort_unstable_by(f32::total_cmp);
        let [a, b, c] = along;
        if a + 1.0 <= b {
            return a + 1.0;
        }
        // Differences, so that nothing cancels far away.
        let b = b - a;
        let two = 0.5 * (b + (2.0 - b * b).sqrt());
        if a + two <= c {
            return a + two;
        }
        let c = c - a;
        let (sum, squares) = (b + c, b * b + c * c);
        a + (sum + (sum * sum - 3.0 * (squares - 1.0)).max(0.0).sqrt()) / 3.0
    }

    /// Rounds off creases: in each of `times` rounds a value goes to the mean of its neighbours. An axis
    /// along which one of the two is missing does not count, so that linear functions stay as they are.
    pub fn smooth(&mut self, voxels: &Voxels, times: usize, is_wanted: impl Fn() -> bool) {
        let mut next = self.distances.clone();
        for _ in 0..times {
            for (i, voxel) in self.order.iter().enumerate() {
                if i.is_multiple_of(PATIENCE) && !is_wanted() {
                    return;
                }
                let here = self.distances[*voxel as usize];
                let second: f32 = self.sides(voxels, *voxel).map(|[a, b]| curvature(a, here, b)).iter().sum();
                next[*voxel as usize] = here + second / 6.0;
            }
            std::mem::swap(&mut self.distances, &mut next);
        }
    }

    /// The values before and after a voxel along each axis.
    fn sides(&self, voxels: &Voxels, voxel: u32) -> [[f32; 2]; 3] {
        let at = |voxel: u32| if voxel == NONE { f32::INFINITY } else { self.distances[voxel as usize] };
        let around = voxels.neighbours[voxel as usize];
        [0, 2, 4].map(|axis| [at(around[axis]), at(around[axis + 1])])
    }
}

fn curvature(a: f32, here: f32, b: f32) -> f32 {
    if a.is_finite() && b.is_finite() { a + b - 2.0 * here } else { 0.0 }
}

/// The voxels that a bone passes through.
pub fn on_bone(voxels: &Voxels, bone: [DVec3; 2]) -> Vec<u32> {
    let grid = &voxels.grid;
    let Some([from, to]) = grid.clip(bone) else { return Vec::new() };
    let steps = (2.0 * from.distance(to) / grid.size).ceil().max(1.0);
    let on = (0..=steps as usize).map(|i| voxels.id(grid.cell(from.lerp(to, i as f64 / steps))));
    let mut found: Vec<u32> = on.filter(|v| *v != NONE).collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// Distance of a voxel from a bone, in cells.
pub fn far(voxels: &Voxels, voxel: u32, bone: [DVec3; 2]) -> f64 {
    let centre = voxels.centre(voxel);
    centre.distance(on_segment(centre, bone)) / voxels.grid.size
}

/// The voxels that are nearest to points of a bone outside.
pub fn projected(voxels: &Voxels, bone: [DVec3; 2], nearest: impl Fn(DVec3) -> Option<u32>) -> Vec<u32> {
    let steps = (2.0 * bone[0].distance(bone[1]) / voxels.grid.size).ceil().clamp(1.0, PROJECTED as f64);
    let points = (0..=steps as usize).map(|i| bone[0].lerp(bone[1], i as f64 / steps));
    let mut found: Vec<u32> = points.filter_map(nearest).collect();
    found.sort_unstable();
    found.dedup();
    found
}
