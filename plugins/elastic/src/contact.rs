//! Contact of the body with itself: some of the samples, spread evenly, keep a gap to parts that come towards
//! them.

use crate::body::Body;
use crate::lattice::{CellPoint, HexMesh, weights};
use crate::material;
use crate::occupancy::Occupancy;
use glam::{DVec3, I64Vec3};
use simod_plugin_api::{Host, PluginResult};
use std::collections::HashSet;
use std::f64::consts::PI;
use std::ops::Range;

/// Points in contact are so far apart, as a part of a cell's size.
const APART: f64 = 0.4;
/// The gap that is kept, as a part of a cell's size.
const GAP: f64 = 0.4;
/// Distance at which other parts are looked for, and depth to which parts that went in are found, in cells.
const REACH: f64 = 1.5;
/// Distance at rest, in cells, below which two points are left to the material.
const NEAR: f64 = 4.0;
/// Distance beside a point at which another one still counts as in front of it, in cells.
const BESIDE: f64 = 0.6;
/// Stiffness of contact beside that of the material, for a piece of the surface as large as a cell's side.
const STIFFNESS: f64 = 40.0;
/// Points at once on one thread.
const TOGETHER: usize = 256;

/// Points of the surface that may touch others.
#[derive(Debug)]
pub struct ContactSurface {
    points: Vec<ContactPoint>,
    /// The size of a cell of the finest lattice.
    size: f64,
}

#[derive(Debug, Clone, Copy)]
struct ContactPoint {
    sample: u32,
    rest: DVec3,
    normal: DVec3,
}

/// Two points that are too near, each by its corners' weights.
#[derive(Debug, Clone)]
pub struct Touch {
    places: [CellPoint; 2],
    /// Normal from the second point out to the first.
    normal: DVec3,
    gap: f64,
    /// Stiffness by which the points resist.
    pub stiffness: f64,
}

impl Touch {
    fn corners<'a>(&'a self, lattice: &'a HexMesh) -> impl Iterator<Item = (u32, f64)> + 'a {
        [1.0, -1.0].into_iter().zip(self.places).flat_map(move |(sign, place)| {
            let corners = lattice.cells[place.cell as usize];
            weights(place.at).into_iter().zip(corners).map(move |(w, c)| (c, sign * w))
        })
    }

    /// Distance by which the first point is in front of the second, from positions of corners; or by which it
    /// moves so, from displacements.
    pub fn along(&self, lattice: &HexMesh, x: &[DVec3]) -> f64 {
        let sum: DVec3 = self.corners(lattice).map(|(c, w)| w * x[c as usize]).sum();
        sum.dot(self.normal)
    }

    /// Distance by which the points are nearer than the gap.
    pub fn depth(&self, lattice: &HexMesh, x: &[DVec3]) -> f64 {
        self.gap - self.along(lattice, x)
    }

    /// Adds a force along the normal to the corners.
    pub fn spread(&self, lattice: &HexMesh, force: f64, forces: &mut [DVec3]) {
        self.corners(lattice).for_each(|(c, w)| forces[c as usize] += force * w * self.normal);
    }

    /// Adds the stiffness by which the contact ties each corner.
    pub fn tie(&self, lattice: &HexMesh, ties: &mut [f64]) {
        self.corners(lattice).for_each(|(c, w)| ties[c as usize] += self.stiffness * w.abs());
    }
}

/// A point in a state of the body: its place in the lattice, where that is, and its normal.
type PointNow = (CellPoint, DVec3, DVec3);

impl ContactSurface {
    /// Samples of a body with an inside, one of several that lie together; normals are turned outward. `size`
    /// is that of a cell.
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
                points.push(ContactPoint { sample, rest, normal });
            }
        }
        Self { points, size }
    }

    /// Largest length of a step for any of the surface, so that nothing passes through unseen.
    pub fn step(&self) -> f64 {
        self.size
    }

    /// The nearest point in front of one, of those in some slots of the cells around it: its place, and its
    /// normal.
    fn opposite(
        &self,
        cells: &ContactCells,
        now: &[Option<PointNow>],
        i: usize,
        around: impl Iterator<Item = usize>,
    ) -> Option<(CellPoint, DVec3)> {
        let (near, beside) = (NEAR * self.size, BESIDE * self.size);
        let (_, at, normal) = now[i]?;
        let (mut best, mut nearest) = (None, REACH * self.size);
        for slot in around {
            if normal.dot(cells.normals[slot]) >= 0.0 {
                continue;
            }
            let j = cells.points[slot] as usize;
            let Some((other, to, out)) = now[j] else { continue };
            let far = at.distance(to);
            // Points beside each other are in front of others.
            let aside = far * far - (at - to).dot(out).powi(2);
            if aside < beside * beside
                && far < nearest
                && self.points[i].rest.distance(self.points[j].rest) > near
            {
                (best, nearest) = (Some((other, out)), far);
            }
        }
        best
    }

    /// Pairs of points that are too near to each other, in a state of the body.
    pub fn touches(
        &self,
        body: &Body,
        places: &[Option<CellPoint>],
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
        let (reach, gap) = (REACH * self.size, GAP * self.size);
        let places = |(_, at, out): PointNow| ((at / reach).floor().as_i64vec3(), out);
        let cells = ContactCells::new(now.iter().map(|n| n.map(places)));
        let stiffness = STIFFNESS * self.size * APART * APART;
        // Cell by cell, as those around it are the same for all its points.
        let mut found = vec![None; cells.points.len()];
        host.parallel_blocks(&mut found, TOGETHER, |first, found| {
            let (mut around, mut last) = (Vec::new(), None);
            for (at, found) in (first..).zip(found) {
                if last != Some(cells.keys[at]) {
                    last = Some(cells.keys[at]);
                    cells.around(cells.keys[at], &mut around);
                }
                let i = cells.points[at] as usize;
                let Some((place, ..)) = now[i] else { continue };
                let opposite = self.opposite(&cells, &now, i, around.iter().cloned().flatten());
                *found = opposite
                    .map(|(other, normal)| (i, Touch { places: [place, other], normal, gap, stiffness }));
            }
        })?;
        let mut touches = vec![None; now.len()];
        found.into_iter().flatten().for_each(|(i, touch)| touches[i] = Some(touch));
        let mut touches: Vec<Touch> = touches.into_iter().flatten().collect();
        touches.retain(|touch| touch.depth(lattice, x) > -gap);
        Ok(touches)
    }
}

/// Points by the cells of space that they are in, in a hash table with as many places.
struct ContactCells {
    starts: Vec<u32>,
    points: Vec<u32>,
    keys: Vec<I64Vec3>,
    normals: Vec<DVec3>,
    /// For each place the mean direction of its normals, and the widest angle with it.
    cones: Vec<(DVec3, f64)>,
}

impl ContactCells {
    /// Table of points with their cells and normals.
    fn new(cells: impl Iterator<Item = Option<(I64Vec3, DVec3)>>) -> Self {
        let known: Vec<(u32, (I64Vec3, DVec3))> =
            (0..).zip(cells).filter_map(|(i, c)| Some((i, c?))).collect();
        let places = known.len().next_power_of_two();
        let mut starts = vec![0_u32; places + 1];
        known.iter().for_each(|(_, (c, _))| starts[hash(*c, places) + 1] += 1);
        (0..places).for_each(|i| starts[i + 1] += starts[i]);
        let mut next = starts.clone();
        let (mut points, mut keys) = (vec![0; known.len()], vec![I64Vec3::ZERO; known.len()]);
        let mut normals = vec![DVec3::ZERO; known.len()];
        for (i, (c, normal)) in known {
            let at = next[hash(c, places)] as usize;
            (points[at], keys[at], normals[at]) = (i, c, normal);
            next[hash(c, places)] += 1;
        }
        let cone = |ends: &[u32]| {
            let normals = &normals[ends[0] as usize..ends[1] as usize];
            let mean = normals.iter().sum::<DVec3>().normalize_or_zero();
            (mean, normals.iter().map(|n| angle(mean, *n)).fold(0.0, f64::max))
        };
        let cones = starts.windows(2).map(cone).collect();
        Self { starts, points, keys, normals, cones }
    }

    /// Ranges of the points of a cell and of those around it that may look against some of its own: points
    /// that lie beside these on the same side of the body do not, and they are most. A few points of other
    /// cells are among them.
    fn around(&self, cell: I64Vec3, out: &mut Vec<Range<usize>>) {
        let places = self.starts.len() - 1;
        let (own, width) = self.cones[hash(cell, places)];
        let of = |n: i64| {
            let place = hash(cell + I64Vec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1), places);
            let (mean, other) = self.cones[place];
            // With room for rounding.
            if angle(own, mean) + width + other < 0.499 * PI {
                return (0, 0);
            }
            (self.starts[place] as usize, self.starts[place + 1] as usize)
        };
        let mut all = [(0, 0); 27];
        (0..27).for_each(|n| all[n as usize] = of(n));
        // In one place of the table may be more than one of these cells.
        all.sort_unstable();
        out.clear();
        let mut end = 0;
        for (first, last) in all {
            if first.max(end) < last {
                out.push(first..last);
                end = last;
            }
        }
    }
}

/// Angle between unit vectors; a half turn if one has no direction.
fn angle(a: DVec3, b: DVec3) -> f64 {
    if a == DVec3::ZERO || b == DVec3::ZERO { PI } else { a.dot(b).clamp(-1.0, 1.0).acos() }
}

fn hash(cell: I64Vec3, places: usize) -> usize {
    let mixed = (cell.x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (cell.y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (cell.z as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    (mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & (places - 1)
}
