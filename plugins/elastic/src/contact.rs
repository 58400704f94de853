//! Contact of the body with itself: some of the samples, spread evenly, keep a gap to what comes towards them.

use crate::body::Body;
use crate::lattice::{Lattice, Place, weights};
use crate::material;
use crate::occupancy::Occupancy;
use glam::{DVec3, I64Vec3};
use simod_plugin_api::{Host, PluginResult};
use std::collections::HashSet;

/// Points in contact are so far apart, as a part of a cell's size.
const APART: f64 = 0.4;
/// The gap that is kept, as a part of a cell's size.
const GAP: f64 = 0.4;
/// How far one looks for what comes near, and how deep what went in is found, in cells.
const REACH: f64 = 1.5;
/// What is nearer than this at rest is left to the material, in cells.
const NEAR: f64 = 4.0;
/// How far beside a point another one may be to be in front of it, in cells.
const BESIDE: f64 = 0.6;
/// How stiff contact is beside the material, for a piece of the surface as large as a cell's side.
const STIFFNESS: f64 = 40.0;
/// Points at once on one thread.
const TOGETHER: usize = 256;

/// Points of the surface that may touch others.
#[derive(Debug)]
pub struct Surface {
    points: Vec<Point>,
    /// The size of a cell of the finest lattice.
    size: f64,
}

#[derive(Debug, Clone, Copy)]
struct Point {
    sample: u32,
    rest: DVec3,
    normal: DVec3,
}

/// Two points that are too near, each by its corners' weights.
#[derive(Debug, Clone)]
pub struct Touch {
    places: [Place; 2],
    /// From the second out to the first.
    normal: DVec3,
    gap: f64,
    /// By how much they resist.
    pub stiffness: f64,
}

impl Touch {
    fn corners<'a>(&'a self, lattice: &'a Lattice) -> impl Iterator<Item = (u32, f64)> + 'a {
        [1.0, -1.0].into_iter().zip(self.places).flat_map(move |(sign, place)| {
            let corners = lattice.cells[place.cell as usize];
            weights(place.at).into_iter().zip(corners).map(move |(w, c)| (c, sign * w))
        })
    }

    /// How far the first is in front of the second, by where corners are or how they move.
    pub fn along(&self, lattice: &Lattice, x: &[DVec3]) -> f64 {
        let sum: DVec3 = self.corners(lattice).map(|(c, w)| w * x[c as usize]).sum();
        sum.dot(self.normal)
    }

    /// By how much they are nearer than the gap.
    pub fn depth(&self, lattice: &Lattice, x: &[DVec3]) -> f64 {
        self.gap - self.along(lattice, x)
    }

    /// Adds a force along the normal to the corners.
    pub fn spread(&self, lattice: &Lattice, force: f64, forces: &mut [DVec3]) {
        self.corners(lattice).for_each(|(c, w)| forces[c as usize] += force * w * self.normal);
    }

    /// What it ties each corner by.
    pub fn tie(&self, lattice: &Lattice, ties: &mut [f64]) {
        self.corners(lattice).for_each(|(c, w)| ties[c as usize] += self.stiffness * w.abs());
    }
}

impl Surface {
    /// Samples of a body with an inside, one of several that lie together; normals are turned outward. `size` is that
    /// of a
    /// cell.
    pub fn new(body: &Occupancy, samples: impl Iterator<Item = (u32, DVec3, DVec3)>, size: f64) -> Self {
        let mut taken = HashSet::new();
        let mut points = Vec::new();
        for (sample, rest, normal) in samples {
            if !taken.insert((rest / (APART * size)).floor().as_i64vec3()) {
                continue;
            }
            let normal = normal.normalize_or_zero();
            let look = |by: f64| body.part(body.cell(rest + by * body.step.min_element() * normal));
            let within = |sign: f64| [1.5, 2.5, 3.5].map(|by| look(sign * by)).into_iter().sum::<f64>();
            let (out, back) = (within(1.0), within(-1.0));
            if normal != DVec3::ZERO && out != back {
                let normal = if out < back { normal } else { -normal };
                points.push(Point { sample, rest, normal });
            }
        }
        Self { points, size }
    }

    /// How far a step may take any of it, so that nothing passes through unseen.
    pub fn step(&self) -> f64 {
        self.size
    }

    /// What is too near to what, in a state of the body.
    pub fn touches(
        &self,
        body: &Body,
        places: &[Option<Place>],
        x: &[DVec3],
        host: &Host<'_>,
    ) -> PluginResult<Vec<Touch>> {
        let lattice = &body.lattice;
        let mut now = vec![None; self.points.len()];
        host.parallel_blocks(&mut now, TOGETHER, |first, now| {
            for (now, point) in now.iter_mut().zip(&self.points[first..]) {
                let Some(place) = places[point.sample as usize] else { continue };
                let normal = material::cofactors(&body.gradient(place, x)) * point.normal;
                *now = Some((place, lattice.interpolate(place, x), normal.normalize_or_zero()));
            }
        })?;
        let reach = REACH * self.size;
        let cells = Cells::new(now.iter().map(|n| n.map(|(_, at, _)| (at / reach).floor().as_i64vec3())));
        let (near, gap) = (NEAR * self.size, GAP * self.size);
        let beside = BESIDE * self.size;
        let stiffness = STIFFNESS * self.size * APART * APART;
        let mut touches = vec![None; now.len()];
        host.parallel_blocks(&mut touches, TOGETHER, |first, touches| {
            for (i, touch) in (first..).zip(touches) {
                let Some((place, at, normal)) = now[i] else { continue };
                let mut best: Option<(f64, Place, DVec3)> = None;
                cells.around((at / reach).floor().as_i64vec3(), |j| {
                    let Some((other, to, out)) = now[j] else { return };
                    let far = at.distance(to);
                    // Points beside each other are in front of others.
                    let aside = far * far - (at - to).dot(out).powi(2);
                    if aside < beside * beside
                        && far < best.map_or(reach, |b| b.0)
                        && normal.dot(out) < 0.0
                        && self.points[i].rest.distance(self.points[j].rest) > near
                    {
                        best = Some((far, other, out));
                    }
                });
                *touch =
                    best.map(|(_, other, normal)| Touch { places: [place, other], normal, gap, stiffness });
            }
        })?;
        let mut touches: Vec<Touch> = touches.into_iter().flatten().collect();
        touches.retain(|touch| touch.depth(lattice, x) > -gap);
        Ok(touches)
    }
}

/// Points by the cells of space that they are in, in a table of as many places.
struct Cells {
    starts: Vec<u32>,
    points: Vec<u32>,
    keys: Vec<I64Vec3>,
}

impl Cells {
    fn new(cells: impl Iterator<Item = Option<I64Vec3>>) -> Self {
        let known: Vec<(u32, I64Vec3)> = (0..).zip(cells).filter_map(|(i, c)| Some((i, c?))).collect();
        let places = known.len().next_power_of_two();
        let mut starts = vec![0_u32; places + 1];
        known.iter().for_each(|(_, c)| starts[hash(*c, places) + 1] += 1);
        (0..places).for_each(|i| starts[i + 1] += starts[i]);
        let mut next = starts.clone();
        let (mut points, mut keys) = (vec![0; known.len()], vec![I64Vec3::ZERO; known.len()]);
        for (i, c) in known {
            let at = &mut next[hash(c, places)];
            (points[*at as usize], keys[*at as usize]) = (i, c);
            *at += 1;
        }
        Self { starts, points, keys }
    }

    /// Calls with each point of a cell and those around it.
    fn around(&self, cell: I64Vec3, mut call: impl FnMut(usize)) {
        let places = self.starts.len() - 1;
        for n in 0..27 {
            let cell = cell + I64Vec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
            let place = hash(cell, places);
            for at in self.starts[place] as usize..self.starts[place + 1] as usize {
                if self.keys[at] == cell {
                    call(self.points[at] as usize);
                }
            }
        }
    }
}

fn hash(cell: I64Vec3, places: usize) -> usize {
    let mixed = (cell.x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (cell.y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (cell.z as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    (mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & (places - 1)
}
