//! The spot under a dab, and the weight of the brush for each sample.
//!
//! A sample's weight follows from its distance in space, as long as the way along the surface is not much
//! longer: paths on the samples' links are, by nature, somewhat longer than the surface's own, and these
//! somewhat longer than the chord. Their excess beyond that is added to the distance. So the brush fades
//! where the surface turns away, and does not reach the next finger, without any step as it moves.

use crate::canvas::Canvas;
use crate::surface::LinkedSurface;
use glam::{DVec3, Vec3};
use simod_geometry::{sheet_distance, smoothstep};
use simod_plugin_api::{Host, PluginResult};
use std::collections::VecDeque;

/// Ratio of the way along the links to the distance in space up to which nothing is added: about 1.1 for
/// paths on links, times that of an arc of a third of a circle to its chord.
const DETOUR: f64 = 1.3;

/// Cosine between the normals of a sample and the dab below which the sample feels nothing: the back of a
/// thin wall.
const AWAY: f64 = -0.5;

/// Cosine from which on the sample feels all of the brush.
const TOWARDS: f64 = 0.0;

/// Exponent by which samples count less with their distance, for the brush's plane.
const WIDE: i32 = 2;

/// Exponent by which samples count less with their distance, for the height of the brush's middle: over
/// details, but without cutting through a round surface.
const NARROW: i32 = 6;

/// Number of samples that are looked at at once on one thread.
const BLOCK: usize = 512;

/// Factor by which sums are taken in whole numbers, so that they do not depend on the order of the samples.
const WHOLE: f64 = (1_u64 << 36) as f64;

/// Ways along the surface from one sample, and memory for finding them.
#[derive(Default)]
pub struct SurfaceWays {
    length: Vec<f32>,
    found: Vec<(u32, f64)>,
    /// Samples by way of which their neighbours may be nearer.
    open: VecDeque<u32>,
    is_open: Vec<bool>,
}

impl SurfaceWays {
    /// Samples that are no farther than `limit` from `seed` along the surface, with their distances.
    ///
    /// Labels are corrected first in, first out, until none improves (E. F. Moore, The shortest path
    /// through a maze, 1959): as all links are about as long, hardly any label is corrected twice, and a
    /// queue costs less than a heap.
    fn from(
        &mut self,
        seed: usize,
        limit: f64,
        surface: &LinkedSurface,
        positions: &[Vec3],
    ) -> &[(u32, f64)] {
        self.reset(positions.len());
        let limit = limit as f32;
        self.length[seed] = 0.0;
        self.found.push((seed as u32, 0.0));
        self.open.push_back(seed as u32);
        while let Some(i) = self.open.pop_front() {
            let i = i as usize;
            self.is_open[i] = false;
            let (here, length) = (positions[i], self.length[i]);
            for &j in surface.beside(i) {
                let there = length + here.distance(positions[j as usize]);
                let known = &mut self.length[j as usize];
                if there < *known && there <= limit {
                    if *known == f32::INFINITY {
                        self.found.push((j, 0.0));
                    }
                    *known = there;
                    if !std::mem::replace(&mut self.is_open[j as usize], true) {
                        self.open.push_back(j);
                    }
                }
            }
        }
        for (i, length) in &mut self.found {
            *length = f64::from(self.length[*i as usize]);
        }
        &self.found
    }

    /// The samples of a ball that are connected with `seed` inside it, and their distances from its centre.
    fn inside(
        &mut self,
        seed: usize,
        center: DVec3,
        radius: f64,
        surface: &LinkedSurface,
        positions: &[Vec3],
    ) -> &[(u32, f64)] {
        self.reset(positions.len());
        let mut look = |i: usize, found: &mut Vec<(u32, f64)>| {
            if self.length[i] == f32::INFINITY {
                let distance = positions[i].as_dvec3().distance(center);
                if distance < radius {
                    self.length[i] = 0.0;
                    found.push((i as u32, distance));
                }
            }
        };
        look(seed, &mut self.found);
        let mut next = 0;
        while let Some(&(i, _)) = self.found.get(next) {
            surface.beside(i as usize).iter().for_each(|&j| look(j as usize, &mut self.found));
            next += 1;
        }
        &self.found
    }

    fn reset(&mut self, count: usize) {
        self.found.iter().for_each(|(i, _)| self.length[*i as usize] = f32::INFINITY);
        self.found.clear();
        self.length.resize(count, f32::INFINITY);
        self.is_open.resize(count, false);
    }
}

/// A round place on the surface.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// Middle of the spot, with normal and pressure.
    pub node: WayPoint,
    /// A point of the mean plane under the brush.
    pub origin: DVec3,
    seed: usize,
}

/// A point of the brush's way.
#[derive(Debug, Clone, Copy)]
pub struct WayPoint {
    /// Place on the surface.
    pub at: DVec3,
    /// The mean normal under the brush.
    pub normal: DVec3,
    /// The pen's pressure.
    pub pressure: f64,
}

impl WayPoint {
    fn mix(nodes: [&Self; 3], by: [f64; 3]) -> Self {
        let mix = |of: &dyn Fn(&Self) -> DVec3| (0..3).fold(DVec3::ZERO, |sum, k| sum + by[k] * of(nodes[k]));
        Self {
            at: mix(&|n| n.at),
            normal: mix(&|n| n.normal),
            pressure: (0..3).map(|k| by[k] * nodes[k].pressure).sum(),
        }
    }
}

/// Way of the brush that a dab stands for: a part of the quadratic B-spline of the dabs, from half way
/// since the one before to half way to the next. A path of straight pieces would show at each of its
/// corners.
#[derive(Debug, Clone, Copy)]
pub struct DabSweep {
    start: WayPoint,
    middle: WayPoint,
    end: WayPoint,
    seed: usize,
}

impl DabSweep {
    /// Sweep without a way: a round dab.
    pub fn round(spot: &Spot) -> Self {
        Self::between(None, spot, None)
    }

    /// The sweep of a dab between those before and after it, if there are any.
    pub fn between(before: Option<&Spot>, spot: &Spot, after: Option<&Spot>) -> Self {
        let middle = spot.node;
        let half_way = |other: Option<&Spot>| match other {
            Some(other) => WayPoint::mix([&middle, &other.node, &middle], [0.5, 0.5, 0.0]),
            None => middle,
        };
        Self { start: half_way(before), middle, end: half_way(after), seed: spot.seed }
    }

    fn node(&self, t: f64) -> WayPoint {
        let s = 1.0 - t;
        WayPoint::mix([&self.start, &self.middle, &self.end], [s * s, 2.0 * s * t, t * t])
    }

    /// Point of the sweep that is nearest to `p`.
    fn nearest(&self, p: DVec3) -> WayPoint {
        const STEPS: u32 = 4;
        const NEWTON: u32 = 3;
        let (a, b, c) = (self.start.at, self.middle.at, self.end.at);
        if a == b && b == c {
            return self.middle;
        }
        let (first, second) = (b - a, a - 2.0 * b + c);
        let point = |t: f64| a + 2.0 * t * first + t * t * second;
        let distance = |t: &f64| point(*t).distance_squared(p);
        let steps = (0..=STEPS).map(|i| f64::from(i) / f64::from(STEPS));
        let start = steps.min_by(|x, y| distance(x).total_cmp(&distance(y))).unwrap_or(0.0);
        let mut best = start;
        for _ in 0..NEWTON {
            let (off, slope) = (point(best) - p, 2.0 * (first + best * second));
            let bend = slope.length_squared() + 2.0 * off.dot(second);
            if bend <= 0.0 {
                break;
            }
            best = (best - off.dot(slope) / bend).clamp(0.0, 1.0);
        }
        // Newton's steps may lead astray where the path turns back.
        self.node(if distance(&best) <= distance(&start) { best } else { start })
    }

    /// Greatest distance of the sweep's ends from its middle.
    fn extent(&self) -> f64 {
        self.middle.at.distance(self.start.at).max(self.middle.at.distance(self.end.at))
    }
}

/// A sample under the brush.
#[derive(Debug, Clone, Copy)]
pub struct Felt {
    /// The sample's index.
    pub sample: u32,
    /// Weight of the brush for the sample, 0 to 1.
    pub weight: f64,
    /// Vector from the sample to the nearest point of the brush's way.
    pub to_path: DVec3,
    /// Mean normal at that point.
    pub normal: DVec3,
}

/// A brush's shape.
pub struct BrushShape<'a> {
    /// Radius in local coordinates.
    pub radius: f64,
    /// Weight at a distance of 0 to 1 radii.
    pub falloff: &'a (dyn Fn(f64) -> f64 + Sync),
    /// Whether samples that face away feel the brush as well.
    pub both_sides: bool,
}

/// Weighted mean of samples' places and normals, the same in whatever order they come.
#[derive(Default)]
struct Mean {
    place: [i64; 3],
    normal: [i64; 3],
    weight: i64,
}

impl Mean {
    /// Adds a sample, whose numbers are all at most about 1.
    fn add(&mut self, place: DVec3, normal: DVec3, weight: f64) {
        // Numbers are cut off towards zero, which is the same for mirror images.
        let whole = |x: f64| (WHOLE * x) as i64;
        for k in 0..3 {
            self.place[k] += whole(weight * place[k]);
            self.normal[k] += whole(weight * normal[k]);
        }
        self.weight += whole(weight);
    }

    fn place(&self) -> Option<DVec3> {
        (self.weight > 0).then(|| DVec3::from(self.place.map(|x| x as f64)) / self.weight as f64)
    }

    fn normal(&self) -> Option<DVec3> {
        DVec3::from(self.normal.map(|x| x as f64)).try_normalize()
    }
}

/// Finder of the samples under dabs.
pub struct Finder<'a> {
    /// The links.
    pub surface: &'a LinkedSurface,
    /// Area for which each sample stands, relative to the others.
    pub areas: &'a [f32],
}

impl Finder<'_> {
    /// Spot on the surface near `p`; nothing if there is none within the radius.
    pub fn spot(
        &self,
        canvas: &Canvas,
        reach: &mut SurfaceWays,
        p: DVec3,
        pressure: f64,
        radius: f64,
    ) -> Option<Spot> {
        let seed = self.seed(canvas, p, radius)?;
        let near = reach.inside(seed, p, radius, self.surface, &canvas.positions);
        // A single sample's normal may be that of a groove's wall: first the samples around it say which
        // side this is.
        let mean = |facing: DVec3, cosine: f64, sharpness: i32| {
            let mut mean = Mean::default();
            for &(i, distance) in near {
                let (at, n) =
                    (canvas.positions[i as usize].as_dvec3(), canvas.normals[i as usize].as_dvec3());
                if n.dot(facing) > cosine {
                    let area = self.areas.get(i as usize).map_or(1.0, |&a| f64::from(a));
                    let inside = 1.0 - (distance / radius).powi(2);
                    mean.add((at - p) / radius, n, area * inside.powi(sharpness));
                }
            }
            mean
        };
        let own = canvas.normals[seed].as_dvec3().try_normalize()?;
        let facing = mean(own, AWAY, NARROW).normal().unwrap_or(own);
        let (narrow, wide) = (mean(facing, 0.0, NARROW), mean(facing, 0.0, WIDE));
        let normal = wide.normal().unwrap_or(facing);
        let nearest = (canvas.positions[seed].as_dvec3() - p) / radius;
        let at = p + normal * radius * narrow.place().unwrap_or(nearest).dot(normal);
        let origin = p + radius * wide.place().unwrap_or(nearest);
        Some(Spot { node: WayPoint { at, normal, pressure }, origin, seed })
    }

    /// Nearest sample to `p`; where several are about as near, as at thin walls, the one near whose tangent
    /// plane `p` lies.
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

    /// The samples that feel the brush on its way.
    pub fn felt(
        &self,
        canvas: &Canvas,
        reach: &mut SurfaceWays,
        sweep: &DabSweep,
        shape: &BrushShape<'_>,
        felt: &mut Vec<Felt>,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let radius = shape.radius;
        let middle = sweep.middle.at;
        // The seed is not the middle itself.
        let off = middle.distance(canvas.positions[sweep.seed].as_dvec3());
        let limit = DETOUR * (radius + sweep.extent() + off) + off;
        let feels = |&(sample, length): &(u32, f64)| {
            let p = canvas.positions[sample as usize].as_dvec3();
            let near = sweep.nearest(p);
            let to_path = near.at - p;
            let detour = ((length - off) / DETOUR - p.distance(middle)).max(0.0);
            let distance = (to_path.length() + detour) / radius;
            let normal = near.normal.try_normalize().unwrap_or(sweep.middle.normal);
            let mut weight = 0.0;
            if distance < 1.0 {
                let cosine = canvas.normals[sample as usize].as_dvec3().dot(normal);
                let facing = if shape.both_sides { 1.0 } else { step(AWAY, TOWARDS, cosine) };
                weight = facing * near.pressure * (shape.falloff)(distance);
            }
            Felt { sample, weight, to_path, normal }
        };
        let reached = reach.from(sweep.seed, limit, self.surface, &canvas.positions);
        let nothing = Felt { sample: 0, weight: 0.0, to_path: DVec3::ZERO, normal: DVec3::ZERO };
        felt.clear();
        felt.resize(reached.len(), nothing);
        host.parallel_blocks(felt, BLOCK, |first, felt| {
            felt.iter_mut().zip(&reached[first..]).for_each(|(felt, reached)| *felt = feels(reached));
        })?;
        felt.retain(|felt| felt.weight > 0.0);
        Ok(())
    }
}

/// Smooth step: 0 below the first number, 1 above the second.
fn step(from: f64, to: f64, x: f64) -> f64 {
    smoothstep((x - from) / (to - from))
}
