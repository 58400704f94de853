//! The home of a vertex: the sample around which its neighbourhood is looked up.
//!
//! Consecutive vertices of a stream are near each other, so the nearest sample is found by walking on P_S's neighbour
//! graph from the last one. Where several sheets of the surface are near, the nearest sample may be on the wrong
//! one: there a vertex' home is the sample whose tangent plane it lies near, on the side to which its normal points.

use glam::Vec3;

use super::Surroundings;
use super::sheets::{Sheets, faces_away, sheet_distance};
use crate::sampling::SampleSet;

/// A vertex keeps the home of the last one if it lies within this part of its support: the home need not be the nearest
/// sample, as every sample knows all supports that meet its own.
const STAYS: f32 = 0.5;

/// A vertex further from the last home than this many of its supports is not walked to: vertices in no order.
const LOST: f32 = 4.0;

/// What homes are found with.
#[derive(Clone, Copy)]
pub struct Homes<'a> {
    positions: &'a [Vec3],
    normals: &'a [Vec3],
    radius: &'a [f32],
    samples: &'a SampleSet,
    sheets: &'a Sheets,
}

impl<'a> Homes<'a> {
    /// Of samples that are prepared.
    pub fn new(around: &'a Surroundings<'a>) -> Self {
        let Surroundings { samples, sheets, supports, .. } = around;
        Self {
            positions: &samples.positions,
            normals: samples.normals(),
            radius: &supports.radius,
            samples,
            sheets,
        }
    }

    /// The homes of finite positions that follow each other, with their normals or none.
    pub fn of(&self, positions: &[Vec3], normals: &[Vec3], homes: &mut Vec<u32>) {
        homes.clear();
        let mut last = None;
        homes.extend(positions.iter().enumerate().map(|(i, p)| {
            let nearest =
                last.and_then(|from| self.walk(from, *p)).unwrap_or_else(|| self.samples.nearest(*p));
            last = Some(nearest);
            if self.sheets.is_crowded(nearest as usize) {
                self.on_its_sheet(nearest, *p, normals.get(i).copied())
            } else {
                nearest
            }
        }));
    }

    /// Steps to ever nearer samples, unless the vertex is near enough to the first one; `None` where it is too far away,
    /// or beyond the support of the last one, which does not know all supports there.
    #[inline]
    fn walk(&self, from: u32, p: Vec3) -> Option<u32> {
        let squared = |i: u32| self.positions[i as usize].distance_squared(p);
        let (mut at, mut distance) = (from, squared(from));
        let stays = STAYS * self.radius[from as usize];
        if distance < stays * stays {
            return Some(from);
        }
        let lost = LOST * self.radius[from as usize];
        if distance > lost * lost {
            return None;
        }
        loop {
            let here = self.positions[at as usize];
            let reach = 4.0 * distance;
            let (mut best, mut best_distance) = (at, distance);
            let near = self.samples.neighbours().of(at as usize);
            for j in near {
                let q = self.positions[*j as usize];
                // No sample further than twice the distance is nearer than this one.
                if q.distance_squared(here) > reach {
                    break;
                }
                let d = q.distance_squared(p);
                if d < best_distance {
                    (best, best_distance) = (*j, d);
                }
            }
            if best == at {
                break;
            }
            (at, distance) = (best, best_distance);
        }
        let radius = self.radius[at as usize];
        (distance < radius * radius).then_some(at)
    }

    /// Of the samples around the nearest one, that on whose sheet the vertex lies.
    fn on_its_sheet(&self, nearest: u32, p: Vec3, n: Option<Vec3>) -> u32 {
        let n = n.filter(|n| n.is_finite() && *n != Vec3::ZERO).map(|n| n.normalize_or_zero());
        let around = self.samples.neighbours().of(nearest as usize);
        // Samples that face the other way come last, those that face aside are as good as others.
        let key = |i: u32| {
            let i = i as usize;
            let away = n.is_some_and(|n| faces_away(self.normals[i], n));
            (away, sheet_distance(p - self.positions[i], self.normals[i]))
        };
        let mut best = (key(nearest), nearest);
        for j in around {
            let entry = (key(*j), *j);
            if entry.0 < best.0 {
                best = entry;
            }
        }
        best.1
    }
}
