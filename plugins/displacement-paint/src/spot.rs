//! What lies under a dab, and how much of the brush each sample feels.
//!
//! A sample feels as much as its distance in space tells, as long as the way along the surface is not much longer: paths
//! on the samples' links are, by nature, somewhat longer than the surface's own, and these somewhat longer than the chord.
//! What they are longer beyond that is added to the distance. So the brush fades where the surface turns away, and does
//! not reach the next finger, without any step as it moves.

use crate::canvas::Canvas;
use crate::surface::{Surface, sheet_distance};
use glam::{DVec3, Vec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// How much longer than the distance in space a way along the links may be for nothing: about 1.1 for paths on links,
/// and that of an arc of a third of a circle to its chord.
const DETOUR: f64 = 1.3;

/// Samples whose normals are farther from the dab's than this cosine feel nothing: the back of a thin wall.
const AWAY: f64 = -0.5;

/// Within this cosine they feel all of it.
const TOWARDS: f64 = 0.0;

/// Sums are taken in whole multiples of one over this, so that they do not depend on the order of the samples.
const WHOLE: f64 = (1_u64 << 36) as f64;

/// Ways along the surface from one sample, and memory for finding them.
#[derive(Default)]
pub struct Reach {
    length: Vec<f32>,
    found: Vec<(u32, f64)>,
    open: BinaryHeap<Reverse<u64>>,
}

impl Reach {
    /// The samples that are no farther than `limit` from `seed` along the surface, and how far they are.
    ///
    /// E. W. Dijkstra, A note on two problems in connexion with graphs, 1959.
    fn from(&mut self, seed: usize, limit: f64, surface: &Surface, positions: &[Vec3]) -> &[(u32, f64)] {
        self.found.iter().for_each(|(i, _)| self.length[*i as usize] = f32::INFINITY);
        self.open.clear();
        self.length.resize(positions.len(), f32::INFINITY);
        self.found.clear();
        // Lengths of no sign order as their bits do.
        let entry = |length: f32, i: u32| Reverse(u64::from(length.to_bits()) << 32 | u64::from(i));
        self.length[seed] = 0.0;
        self.found.push((seed as u32, 0.0));
        self.open.push(entry(0.0, seed as u32));
        while let Some(Reverse(next)) = self.open.pop() {
            let (length, i) = (f32::from_bits((next >> 32) as u32), next as u32 as usize);
            if length > self.length[i] {
                continue;
            }
            for &j in surface.beside(i) {
                let there = length + positions[i].distance(positions[j as usize]);
                let known = &mut self.length[j as usize];
                if there < *known && f64::from(there) <= limit {
                    if *known == f32::INFINITY {
                        self.found.push((j, 0.0));
                    }
                    *known = there;
                    self.open.push(entry(there, j));
                }
            }
        }
        for (i, length) in &mut self.found {
            *length = f64::from(self.length[*i as usize]);
        }
        &self.found
    }
}

/// A round place on the surface.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// Its middle, on the surface.
    pub at: DVec3,
    /// The mean normal under the brush.
    pub normal: DVec3,
    /// A point of the mean plane under the brush.
    pub origin: DVec3,
    /// The pen's pressure.
    pub pressure: f64,
    seed: usize,
}

/// A sample under the brush.
#[derive(Debug, Clone, Copy)]
pub struct Felt {
    /// Which one.
    pub sample: u32,
    /// How much of the brush it feels, 0 to 1.
    pub weight: f64,
    /// From it to the nearest point of the path since the last dab.
    pub to_path: DVec3,
}

/// A brush's shape.
pub struct Shape<'a> {
    /// Local coordinates.
    pub radius: f64,
    /// How much is felt at a distance of 0 to 1 radii.
    pub falloff: &'a dyn Fn(f64) -> f64,
    /// Whether what faces away feels it as well.
    pub both_sides: bool,
}

/// Finds what is under dabs.
pub struct Finder<'a> {
    /// The links.
    pub surface: &'a Surface,
    /// What each sample stands for, relative to the others.
    pub areas: &'a [f32],
}

impl Finder<'_> {
    /// The place on the surface near `p`; nothing if there is none within the radius.
    pub fn spot(
        &self,
        canvas: &Canvas,
        reach: &mut Reach,
        p: DVec3,
        pressure: f64,
        radius: f64,
    ) -> Option<Spot> {
        let seed = self.seed(canvas, p, radius)?;
        let facing = canvas.normals[seed].as_dvec3();
        let (mut origin, mut normal, mut weight) = ([0_i64; 3], [0_i64; 3], 0_i64);
        let add = |sum: &mut [i64; 3], v: DVec3| {
            (0..3).for_each(|k| sum[k] += (WHOLE * v[k]).round() as i64);
        };
        for &(i, _) in reach.from(seed, radius, self.surface, &canvas.positions) {
            let i = i as usize;
            let (offset, n) = ((canvas.positions[i].as_dvec3() - p) / radius, canvas.normals[i].as_dvec3());
            let inside = 1.0 - offset.length_squared();
            if inside <= 0.0 || n.dot(facing) <= 0.0 {
                continue;
            }
            let w = inside * inside * self.areas.get(i).map_or(1.0, |&a| f64::from(a));
            add(&mut origin, w * offset);
            add(&mut normal, w * n);
            weight += (WHOLE * w).round() as i64;
        }
        let real = |v: [i64; 3]| DVec3::from(v.map(|x| x as f64));
        let mean = if weight > 0 { radius * real(origin) / weight as f64 } else { DVec3::ZERO };
        let nearest = canvas.positions[seed].as_dvec3();
        let origin = if weight > 0 { p + mean } else { nearest };
        let normal = real(normal).try_normalize().or_else(|| facing.try_normalize())?;
        let at = p + normal * (nearest - p).dot(normal);
        Some(Spot { at, normal, origin, pressure, seed })
    }

    /// The nearest sample; where several are about as near, as at thin walls, the one near whose tangent plane the point
    /// lies.
    fn seed(&self, canvas: &Canvas, p: DVec3, radius: f64) -> Option<usize> {
        let nearest = canvas.grid.nearest(&canvas.positions, p, radius)?;
        let distance = |i: usize| canvas.positions[i].as_dvec3().distance(p);
        // Samples within a cell's width are all in the cells around.
        let as_near = (distance(nearest) + 0.5 * canvas.grid.cell()).min(radius);
        if as_near > canvas.grid.cell() {
            return Some(nearest);
        }
        let near = canvas.grid.around(p).filter(|&i| distance(i) <= as_near);
        let near = near
            .map(|i| (sheet_distance((p - canvas.positions[i].as_dvec3()).as_vec3(), canvas.normals[i]), i));
        let best = near.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Some(best.map_or(nearest, |(_, i)| i))
    }

    /// The samples that feel the brush on its way from one spot to the next.
    pub fn felt(
        &self,
        canvas: &Canvas,
        reach: &mut Reach,
        [from, to]: [&Spot; 2],
        shape: &Shape<'_>,
        felt: &mut Vec<Felt>,
    ) {
        let radius = shape.radius;
        let way = to.at - from.at;
        let seed = canvas.positions[to.seed];
        // The seed is not the spot itself.
        let off = to.at.distance(seed.as_dvec3());
        let limit = DETOUR * (radius.hypot(way.length()) + off) + off;
        felt.clear();
        for &(sample, length) in reach.from(to.seed, limit, self.surface, &canvas.positions) {
            let p = canvas.positions[sample as usize].as_dvec3();
            let t = if way == DVec3::ZERO { 1.0 } else { (p - from.at).dot(way) / way.length_squared() };
            let t = t.clamp(0.0, 1.0);
            let to_path = from.at + t * way - p;
            let detour = ((length - off) / DETOUR - p.distance(to.at)).max(0.0);
            let distance = (to_path.length() + detour) / radius;
            if distance >= 1.0 {
                continue;
            }
            let cosine = canvas.normals[sample as usize].as_dvec3().dot(to.normal);
            let facing = if shape.both_sides { 1.0 } else { step(AWAY, TOWARDS, cosine) };
            let pressure = from.pressure + t * (to.pressure - from.pressure);
            let weight = facing * pressure * (shape.falloff)(distance);
            if weight > 0.0 {
                felt.push(Felt { sample, weight, to_path });
            }
        }
    }
}

/// 0 below the first number, 1 above the second, smooth in between.
fn step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
