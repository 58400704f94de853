//! The constraints of the samples in the regions.
//!
//! Each handle moves affinely, so its samples' displacements are combinations of four functions: 1 and the
//! coordinates relative to the handle's centroid, in units of its radius; in other regions the four
//! functions are 0. The displacements of all motions are spanned by these `4 x handles` right-hand sides.
//!
//! A sample is in a region where its weight is above one half, and then has the region's full motion.

use crate::fit::Goal;
use crate::kernel::{Point, UnitBoxMap};
use faer::{Mat, Side};
use simod_plugin_api::{Host, PluginError, PluginResult, PrepareInput, Region, Role};
use std::collections::HashSet;

/// Weight from which on a sample belongs to a region.
const INSIDE: f32 = 0.5;

/// Extent of constraints in a direction below which they are flat there, relative to the largest extent.
const FLAT: f64 = 1e-3;
/// Distance at which constraints are added beside flat ones, in the unit box.
const THICKNESS: f64 = 0.05;
/// Number of constraints of each region to which others are added, for each flat direction.
const THICKENED: usize = 16;

/// Number of constraints of each region that may take part in the least squares; all others are checked.
const MOST_ROWS: usize = 20_000;

/// Number of samples of each handle whose distances to the others are looked at.
const ASKED: usize = 64;

/// Number of functions for each handle.
pub const PER_HANDLE: usize = 4;

/// Place of a handle, in local coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandleFrame {
    /// Mean of the handle's samples.
    pub centroid: Point,
    /// Largest distance of one of its samples from the centroid; 1 for a single point.
    pub radius: f64,
}

/// The samples in the regions, and their targets.
#[derive(Debug)]
pub struct RegionSamples {
    /// Map from local coordinates to the unit box.
    pub frame: UnitBoxMap,
    /// Positions of the samples, in the unit box; after them those of constraints that are no samples.
    pub points: Vec<Point>,
    /// The samples' numbers.
    pub samples: Vec<u32>,
    /// Handle that each constraint follows, or nothing where the constraint is fixed.
    pub handle: Vec<Option<usize>>,
    /// Functions 1, 2 and 3 of the constraint's handle, at each constraint.
    relative: Vec<Point>,
    /// The handles' frames, in the regions' order.
    pub handles: Vec<HandleFrame>,
    /// Whether any sample is fixed.
    pub has_fixed: bool,
    /// Constraints in an order of which every beginning is well spread over all regions.
    pub spread: Vec<usize>,
}

/// Samples of each region. A sample in several regions belongs to the one where its weight is largest, the
/// first of them where that is a draw.
fn members_of(regions: &[Region<'_>], samples: usize) -> PluginResult<Vec<Vec<u32>>> {
    let owner = |sample: usize| {
        let mut best = None;
        for (i, region) in regions.iter().enumerate() {
            let weight = region.weights()[sample];
            if weight > INSIDE && best.is_none_or(|(_, w)| weight > w) {
                best = Some((i, weight));
            }
        }
        best.map(|(i, _)| i)
    };
    let mut members = vec![Vec::new(); regions.len()];
    for sample in 0..samples {
        if let Some(region) = owner(sample) {
            members[region].push(sample as u32);
        }
    }
    if let Some(i) = members.iter().position(Vec::is_empty) {
        let what = if regions[i].role == Role::HANDLE { "handle" } else { "fixed" };
        return Err(PluginError::input(format!("region {} ({what}) holds no sample of its own", i + 1))
            .hint("enlarge or move its shapes, take more samples, or let it overlap others less"));
    }
    Ok(members)
}

impl RegionSamples {
    /// Gathers the samples in the regions. A sample in several regions belongs to the one where its weight
    /// is largest, the first of them where that is a draw.
    pub fn gather(input: &PrepareInput<'_>, goal: &Goal, host: &Host<'_>) -> PluginResult<Self> {
        let positions = input.samples.positions();
        let regions = input.regions();
        if let Some(i) = regions.iter().position(|r| r.weights().len() != positions.len()) {
            return Err(PluginError::internal(format!("region {} has not one weight per sample", i + 1)));
        }
        if !regions.iter().any(|r| r.role == Role::HANDLE) {
            return Err(PluginError::input("there is no handle region")
                .hint("add a region with role = \"handle\" and a move"));
        }
        let members = members_of(regions, positions.len())?;
        let samples = members.concat();
        let all: Vec<Point> = samples.iter().map(|&i| positions[i as usize].map(f64::from)).collect();
        if let Some(i) = all.iter().flatten().position(|x| !x.is_finite()) {
            return Err(PluginError::input(format!("sample {} is at no finite place", samples[i / 3])));
        }
        // A compact kernel has a length of its own.
        let is_compact = goal.kernel.is_compact();
        let least = if is_compact { goal.support * input.bounds.diagonal() } else { 0.0 };
        let frame = UnitBoxMap::from_points(&all, least).ok_or_else(|| {
            PluginError::input("all samples in the regions lie in one point")
                .hint("enlarge the regions, or add a fixed one elsewhere")
        })?;

        let mut constraints = Self {
            frame,
            points: all.iter().map(|&p| frame.to_unit(p)).collect(),
            handle: Vec::with_capacity(all.len()),
            relative: Vec::with_capacity(all.len()),
            handles: Vec::new(),
            has_fixed: false,
            samples,
            spread: Vec::new(),
        };
        let mut orders = Vec::new();
        for (region, members) in regions.iter().zip(&members) {
            host.progress(0.0)?;
            let first = constraints.handle.len();
            constraints.add_region(region.role, &all[first..first + members.len()]);
            orders.push(spread_order(&constraints.points, first..constraints.handle.len(), MOST_ROWS));
        }
        if !is_compact {
            constraints.thicken(&mut orders)?;
        }
        constraints.spread = interleave(&orders);
        Ok(constraints)
    }

    /// Adds the samples of a region, each by its place in the frame of the region.
    fn add_region(&mut self, role: Role, members: &[Point]) {
        let handle = (role == Role::HANDLE).then_some(self.handles.len());
        self.has_fixed |= handle.is_none();
        let HandleFrame { centroid, radius } = frame_of(members);
        if handle.is_some() {
            self.handles.push(HandleFrame { centroid, radius });
        }
        for p in members {
            self.handle.push(handle);
            self.relative.push(std::array::from_fn(|i| (p[i] - centroid[i]) / radius));
        }
    }

    /// Gives constraints on one plane or line, which do not determine the deformation beside it, some
    /// thickness: a few more constraints on both sides that move along with their region. Without them a
    /// handle that turns would shear the space beside the plane instead. Not for compact kernels, which
    /// would reach farther by the added constraints.
    fn thicken(&mut self, orders: &mut Vec<Vec<usize>>) -> PluginResult<()> {
        let mut added = Vec::new();
        for normal in flat_directions(&self.points)? {
            for order in orders.iter() {
                for &i in order.iter().take(THICKENED) {
                    for side in [-THICKNESS, THICKNESS] {
                        let p = self.points[i];
                        added.push(self.points.len());
                        self.points.push(std::array::from_fn(|k| p[k] + side * normal[k]));
                        self.handle.push(self.handle[i]);
                        let unit = self.handle[i]
                            .map_or(1.0, |h| self.frame.to_unit_length(self.handles[h].radius).recip());
                        let at = self.relative[i];
                        self.relative.push(std::array::from_fn(|k| at[k] + side * unit * normal[k]));
                    }
                }
            }
        }
        orders.push(added);
        Ok(())
    }

    /// Whether the samples of some handle are, for the most part, farther than `distance` from its other
    /// samples.
    pub fn is_sparse(&self, distance: f64) -> bool {
        (0..self.handles.len()).any(|handle| {
            let members: Vec<usize> =
                (0..self.samples.len()).filter(|&i| self.handle[i] == Some(handle)).collect();
            let is_near = |i: usize, j: usize| {
                let (p, q) = (self.points[i], self.points[j]);
                i != j && (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>() <= distance * distance
            };
            let asked = members.iter().step_by(members.len().div_ceil(ASKED).max(1));
            let alone = asked.clone().filter(|&&i| !members.iter().any(|&j| is_near(i, j))).count();
            members.len() > 1 && 2 * alone > asked.len()
        })
    }

    /// Number of right-hand sides.
    pub fn functions(&self) -> usize {
        PER_HANDLE * self.handles.len()
    }

    /// Value of right-hand side `function` at a constraint.
    pub fn target(&self, constraint: usize, function: usize) -> f64 {
        if self.handle[constraint] != Some(function / PER_HANDLE) {
            return 0.0;
        }
        match function % PER_HANDLE {
            0 => 1.0,
            i => self.relative[constraint][i - 1],
        }
    }
}

/// Unit directions in which the points have next to no extent.
fn flat_directions(points: &[Point]) -> PluginResult<Vec<Point>> {
    let count = points.len() as f64;
    let mean = points.iter().fold([0.0; 3], |s, p| std::array::from_fn(|i| s[i] + p[i] / count));
    let covariance = Mat::<f64>::from_fn(3, 3, |i, j| {
        points.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j])).sum::<f64>() / count
    });
    let eigen = covariance
        .self_adjoint_eigen(Side::Lower)
        .map_err(|_| PluginError::internal("the principal axes of the regions were not found"))?;
    // Extents are in ascending order.
    let (extents, axes) = (eigen.S().column_vector(), eigen.U());
    let flat = (0..3).filter(|&i| extents[i] <= FLAT * FLAT * extents[2]);
    Ok(flat.map(|i| [axes[(0, i)], axes[(1, i)], axes[(2, i)]]).collect())
}

fn frame_of(points: &[Point]) -> HandleFrame {
    let sum = points.iter().fold([0.0; 3], |s, p| std::array::from_fn(|i| s[i] + p[i]));
    let centroid = sum.map(|s| s / points.len() as f64);
    let distance2 = |p: &Point| (0..3).map(|i| (p[i] - centroid[i]).powi(2)).sum::<f64>();
    let radius = points.iter().map(distance2).fold(0.0, f64::max).sqrt();
    HandleFrame { centroid, radius: if radius > 0.0 { radius } else { 1.0 } }
}

/// At most `limit` of the points with the given indices, in an order of which every beginning is well
/// spread: one point per cell of ever finer grids over the unit box, and then the rest in their own order.
pub fn spread_order(points: &[Point], indices: impl Iterator<Item = usize>, limit: usize) -> Vec<usize> {
    const LEVELS: u32 = 10;
    let mut order = Vec::new();
    let mut left: Vec<usize> = indices.collect();
    for level in 0..=LEVELS {
        let cells = f64::from(1 << level);
        let cell = |i: usize| points[i].map(|x| ((x + 0.5) * cells) as u16);
        let mut taken: HashSet<[u16; 3]> = order.iter().map(|&i| cell(i)).collect();
        left.retain(|&i| {
            let take = level < LEVELS && taken.insert(cell(i));
            if take || level == LEVELS {
                order.push(i);
            }
            !take
        });
        if order.len() >= limit || left.is_empty() {
            break;
        }
    }
    order.truncate(limit);
    order
}

/// Takes one of each list in turn; regions with fewer run out earlier.
fn interleave(orders: &[Vec<usize>]) -> Vec<usize> {
    let longest = orders.iter().map(Vec::len).max().unwrap_or(0);
    (0..longest).flat_map(|i| orders.iter().filter_map(move |o| o.get(i).copied())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_order_has_every_point_once_and_starts_wide() {
        let points: Vec<Point> = (0..1000).map(|i| [f64::from(i) / 999.0 - 0.5, 0.0, 0.0]).collect();
        let mut order = spread_order(&points, 0..1000, usize::MAX);
        let start: Vec<f64> = order[..8].iter().map(|&i| points[i][0]).collect();
        let gap = start.iter().flat_map(|a| start.iter().map(move |b| (a - b).abs()));
        assert!(gap.filter(|&d| d > 0.0).fold(1.0, f64::min) > 0.1, "{start:?}");
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..1000));
        // Points that coincide are not lost.
        assert_eq!(spread_order(&[[0.1; 3]; 50], 0..50, usize::MAX).len(), 50);
        assert_eq!(spread_order(&points, 0..1000, 20).len(), 20);
    }
}
