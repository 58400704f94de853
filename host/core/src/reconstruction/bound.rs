//! The bound that no vertex leaves: the range of the samples around it.
//!
//! Where fits are badly determined, as between two sheets that move apart, among samples that jitter, or beyond the last
//! samples, an expansion may explain its neighbours well and take a vertex far away from all of them. Whatever
//! is blended is therefore compared with where the 28 samples nearest to the vertex go: `docs/reconstruction.md` has
//! the definition. This is the maximum principle of scattered data, as limiters of finite volumes hold it (T. Barth,
//! D. Jespersen, *The Design and Application of Upwind Schemes on Unstructured Meshes*, 1989), in space rather than on
//! a sheet, for coordinates one by one.
//!
//! Nearly all vertices are seen to keep to it without a search, as they lie within the range of samples beside their
//! home that are surely among those nearest to them.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::blend::Supports;
use super::expansion::Expansion;
use super::local_frames::ROUNDING;
use super::sheets::Sheets;
use super::{DeformationField, Transport};
use crate::sampling::SampleSet;

/// Samples that a range is of.
pub const AROUND: usize = 28;

/// How far beyond the range a vertex may go, as a part of the local step: a little less than a tenth, for rounding.
const BEYOND: f32 = 0.095;

/// Neighbours of a sample among the others of a range, to which its edges lead: a ring.
const EDGES: usize = 6;

/// Of the edges of a range, this part is less steep …
const FLATTER: f32 = 0.3;
/// … than one that may be so many times less steep than what it is continued with. Of a linear map three edges in ten have
/// less than half of its slope, and beside a step most edges lie on one side of it.
const STEEPER: f32 = 4.0;

/// The range of the samples beside a home is looked at for vertices within this part of its support.
const BESIDE: f32 = 0.5;

/// Rounds of the search for the point of the samples' hull that is nearest to a vertex.
const ROUNDS: usize = 32;

/// Displacements between the least and the greatest, coordinate by coordinate.
#[derive(Debug, Clone, Copy)]
struct Extent {
    low: Vec3,
    high: Vec3,
}

impl Extent {
    /// Which holds none.
    const NOTHING: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    /// Of one displacement, but for rounding.
    fn about(u: Vec3) -> Self {
        Self { low: u - ROUNDING as f32, high: u + ROUNDING as f32 }
    }

    fn include(&mut self, u: Vec3) {
        (self.low, self.high) = (self.low.min(u - ROUNDING as f32), self.high.max(u + ROUNDING as f32));
    }

    fn widen(&mut self, by: f32) {
        self.low -= by;
        self.high += by;
    }

    #[inline]
    fn holds(&self, u: Vec3) -> bool {
        u.cmpge(self.low).all() && u.cmple(self.high).all()
    }
}

/// What is known of the homes, so that hardly any vertex needs a search.
///
/// Memory: 24 bytes per sample.
pub struct Bound {
    /// Of samples that are surely among those nearest to any vertex within [`BESIDE`] of the home's support.
    beside: Vec<Extent>,
}

impl Bound {
    /// Of the expansions of all samples.
    pub fn of(samples: &SampleSet, sheets: &Sheets, supports: &Supports, expansions: &[Expansion]) -> Self {
        let positions = &samples.positions;
        let beside = |home: usize| {
            let within = BESIDE * supports.radius[home];
            let reach = supports.ranging[home] - 2.0 * within;
            if reach <= 0.0 {
                return Extent::NOTHING;
            }
            let near = sheets.of_sample(home).iter().map(|j| *j as usize);
            let near = near.take_while(|j| positions[*j].distance(positions[home]) < reach);
            let mut extent = Extent::about(expansions[home].displacement());
            near.for_each(|j| extent.include(expansions[j].displacement()));
            extent
        };
        Self { beside: (0..expansions.len()).into_par_iter().map(beside).collect() }
    }
}

impl DeformationField<'_> {
    /// Whether a displacement of a vertex of this home is seen to keep to the range of the samples around without a search.
    #[inline]
    pub(super) fn is_bounded(&self, home: usize, p: Vec3, u: Vec3) -> bool {
        let e = &self.expansions[home];
        let part = (p - Vec3::from_array(e.center)).length_squared() * e.inverse_square;
        part <= BESIDE * BESIDE && self.bound.beside[home].holds(u) || self.is_among_nearest(home, p, u)
    }

    /// Whether a displacement is within the range of those of the home's sheet that are surely among the nearest samples.
    fn is_among_nearest(&self, home: usize, p: Vec3, u: Vec3) -> bool {
        let positions = &self.around.samples.positions;
        let distance = p.distance(positions[home]);
        let reach = self.around.supports.ranging[home] - distance;
        if reach <= distance {
            return false;
        }
        let mut extent = Extent::about(self.expansions[home].displacement());
        self.around.sheets.of_sample(home).iter().map(|j| *j as usize).any(|j| {
            if positions[j].distance_squared(p) < reach * reach {
                extent.include(self.expansions[j].displacement());
            }
            extent.holds(u)
        })
    }

    /// The nearest place within the range of the samples around, for a vertex whose displacement leaves it; `gradient` is
    /// that of the deformation there.
    pub(super) fn drawn_back(&self, p: Vec3, u: Vec3, gradient: impl FnOnce() -> Mat3) -> Option<Transport> {
        let mut range = Range::around(self, p);
        // Each step takes longer than the one before.
        if range.extent.holds(u) {
            return None;
        }
        let edges = range.edges();
        let slack = BEYOND * edges.step + ROUNDING as f32;
        range.extent.widen(slack);
        if range.extent.holds(u) {
            return None;
        }
        // Little relief does not add to it.
        let way = range.way_from_hull();
        range.extent.widen((edges.steepness * way.length() - 0.5 * slack).max(0.0));
        if range.extent.holds(u) {
            return None;
        }
        let held = u.clamp(range.extent.low, range.extent.high);
        // Along the range's border nothing changes but what it is continued with.
        let further = edges.steepness * way.normalize_or_zero();
        let mut rows = gradient().transpose();
        for axis in (0..3).filter(|axis| held[*axis] != u[*axis]) {
            *rows.col_mut(axis) = Vec3::AXES[axis] + (u[axis] - held[axis]).signum() * further;
        }
        Some(Transport { displacement: held, gradient: rows.transpose() })
    }
}

/// The samples nearest to a vertex, and where they go.
struct Range {
    count: usize,
    /// From the vertex to each sample, the nearest first.
    from: [Vec3; AROUND],
    displacement: [Vec3; AROUND],
    extent: Extent,
}

/// What the edges between the samples of a range show.
struct Edges {
    /// The largest difference of displacements.
    step: f32,
    /// How steep what continues them may be.
    steepness: f32,
}

impl Range {
    fn around(field: &DeformationField<'_>, p: Vec3) -> Self {
        let (mut from, mut displacement) = ([Vec3::ZERO; AROUND], [Vec3::ZERO; AROUND]);
        let (mut found, mut count, mut extent) = ([0; AROUND], 0, Extent::NOTHING);
        for j in field.around.samples.nearest_ones(p, &mut found) {
            let e = &field.expansions[j as usize];
            (from[count], displacement[count]) = (Vec3::from_array(e.center) - p, e.displacement());
            extent.include(displacement[count]);
            count += 1;
        }
        Self { count, from, displacement, extent }
    }

    fn edges(&self) -> Edges {
        let mut slopes = Vec::with_capacity(AROUND * EDGES);
        let (mut step, mut steepest) = (0.0f32, 0.0f32);
        for i in 0..self.count {
            let mut ring = [(f32::INFINITY, i); EDGES];
            for j in (0..self.count).filter(|j| *j != i) {
                let squared = self.from[i].distance_squared(self.from[j]);
                if squared < ring[EDGES - 1].0 {
                    let place = ring.partition_point(|(nearer, _)| *nearer <= squared);
                    ring[place..].rotate_right(1);
                    ring[place] = (squared, j);
                }
            }
            for (squared, j) in ring.iter().filter(|(_, j)| *j != i) {
                let difference = self.displacement[i].distance(self.displacement[*j]);
                step = step.max(difference);
                if *squared > 0.0 {
                    let slope = difference / squared.sqrt();
                    steepest = steepest.max(slope);
                    slopes.push(slope);
                }
            }
        }
        if slopes.is_empty() {
            return Edges { step, steepness: 0.0 };
        }
        let at = (FLATTER * slopes.len() as f32) as usize;
        let (_, flat, _) = slopes.select_nth_unstable_by(at, f32::total_cmp);
        Edges { step, steepness: steepest.min(STEEPER * *flat) }
    }

    /// The way from the samples' convex hull to the vertex, or a little less; nothing within the hull.
    ///
    /// Its nearest point is found from corner to corner (E. Gilbert, *An Iterative Procedure for Computing the Minimum of
    /// a Quadratic Form on a Convex Set*, 1966).
    fn way_from_hull(&self) -> Vec3 {
        let corners = &self.from[..self.count];
        let mut x = corners[0];
        let (mut least, mut way) = (0.0, Vec3::ZERO);
        for _ in 0..ROUNDS {
            let square = x.length_squared();
            if square == 0.0 {
                return Vec3::ZERO;
            }
            let towards = |a: &Vec3| a.dot(x);
            let corner =
                corners.iter().copied().min_by(|a, b| towards(a).total_cmp(&towards(b))).unwrap_or(x);
            // All corners lie beyond this plane.
            let beyond = corner.dot(x) / square.sqrt();
            if beyond > least {
                (least, way) = (beyond, -x * (beyond / square.sqrt()));
            }
            let edge = corner - x;
            let t = -edge.dot(x) / edge.length_squared();
            if t.is_nan() || t <= 1e-5 {
                break;
            }
            x += edge * t.min(1.0);
        }
        way
    }
}
