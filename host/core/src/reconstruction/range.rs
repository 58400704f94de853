//! Range of the samples around a vertex, and the way in which a vertex that leaves it is drawn back: see
//! [`bound`](super::bound).

use glam::{Mat3, Vec3};

use super::blend::AROUND;
use super::bound::{BEYOND, DisplacementBox, EDGES, EdgeStretches, MARGIN};
use super::field::DeformationField;
use super::hull::way_from_hull;
use super::transport::Transport;

/// The ridge of the linear map that explains a range, as a part of the samples' mean squared distance from
/// their middle: across the little that separates two sheets nothing is explained.
const RIDGE: f32 = 0.02;

/// Largest slope of the continuation, as a multiple of the norm of the linear map, of which the ridge takes a
/// part.
const FLATTENED: f32 = 1.5;

/// Residual of a linear map, as a part of the displacements, up to which the map fully continues the range …
const EXPLAINED: f32 = 0.4;
/// … and up to which it does less and less: a linear map leaves about half of a step.
const UNEXPLAINED: f32 = 0.55;

impl DeformationField<'_> {
    /// Whether places are all so near to a home that it is surely among the samples nearest to each of them.
    #[inline]
    pub(super) fn keep_home_nearest(&self, home: usize, places: impl Iterator<Item = Vec3>) -> bool {
        let center = self.around.samples.positions[home];
        let farthest = places.map(|p| p.distance_squared(center)).fold(0.0, f32::max);
        2.0 * farthest.sqrt() < self.around.supports.ranging[home]
    }

    /// Nearest place within the range, as [`drawn_back`](Self::drawn_back) gives it, for a vertex whose home
    /// does not move, nor any support that reaches there.
    #[inline]
    pub(super) fn still_drawn_back(&self, home: usize, p: Vec3) -> Option<Transport> {
        // Then the home is among the nearest.
        if 2.0 * p.distance(self.around.samples.positions[home]) < self.around.supports.ranging[home] {
            return None;
        }
        self.drawn_back(p, Vec3::ZERO, || Mat3::IDENTITY)
    }

    /// Whether a displacement of a vertex of this home is within the range of those samples of the home's
    /// sheet that are surely among the nearest ones: then the vertex keeps to the range without a search.
    pub(super) fn is_bounded(&self, home: usize, p: Vec3, u: Vec3) -> bool {
        let center = |j: usize| Vec3::from_array(self.expansions[j].center);
        let distance = p.distance(center(home));
        let reach = self.around.supports.ranging[home] - distance;
        if reach <= distance {
            return false;
        }
        let (mut extent, mut largest) =
            (DisplacementBox::about(self.expansions[home].displacement()), self.bound.step(home));
        self.around.sheets.of_sample(home).chunks(EDGES).any(|ring| {
            for j in ring.iter().map(|j| *j as usize) {
                // Neighbours are included without a branch, which could not be foretold.
                let is_near = center(j).distance_squared(p) < reach * reach;
                let with = extent.with(self.expansions[j].displacement());
                extent = if is_near { with } else { extent };
                largest = largest.max(if is_near { self.bound.step(j) } else { 0.0 });
            }
            extent.widened(BEYOND * largest).holds(u)
        })
    }

    /// The nearest place within the range of the samples around, for a vertex whose displacement leaves it;
    /// `gradient` is that of the deformation there.
    pub(super) fn drawn_back(&self, p: Vec3, u: Vec3, gradient: impl FnOnce() -> Mat3) -> Option<Transport> {
        let range = NearbyRange::around(self, p);
        let slack = BEYOND * range.edges.step + MARGIN;
        // The continuation of the range takes longer to find, so it is left out where the range itself
        // suffices.
        if range.extent.widened(slack).holds(u) {
            return None;
        }
        let (steepness, way) = (range.steepness(), way_from_hull(&range.from[..range.count]));
        // Little relief does not add to it.
        let DisplacementBox { low, high } =
            range.extent.widened(slack.max(steepness * way.length() + 0.5 * slack));
        let held = u.clamp(low, high);
        if held == u {
            return None;
        }
        // A move along the range's border changes only the continuation.
        let further = steepness * way.normalize_or_zero();
        let mut rows = gradient().transpose();
        for axis in (0..3).filter(|axis| held[*axis] != u[*axis]) {
            *rows.col_mut(axis) = Vec3::AXES[axis] + (u[axis] - held[axis]).signum() * further;
        }
        Some(Transport { displacement: held, gradient: rows.transpose() })
    }
}

/// The samples nearest to a vertex, and where they go.
struct NearbyRange {
    count: usize,
    /// Ways from the vertex to each sample, the nearest first.
    from: [Vec3; AROUND],
    displacement: [Vec3; AROUND],
    extent: DisplacementBox,
    /// The edges of all samples in the range.
    edges: EdgeStretches,
}

impl NearbyRange {
    fn around(field: &DeformationField<'_>, p: Vec3) -> Self {
        let mut found = [0; AROUND];
        let mut range = Self {
            count: 0,
            from: [Vec3::ZERO; AROUND],
            displacement: [Vec3::ZERO; AROUND],
            extent: DisplacementBox::NOTHING,
            edges: EdgeStretches::NONE,
        };
        for j in field.around.samples.nearest_ones(p, &mut found) {
            let e = &field.expansions[j as usize];
            range.from[range.count] = Vec3::from_array(e.center) - p;
            range.displacement[range.count] = e.displacement();
            range.extent = range.extent.with(e.displacement());
            range.edges.include(&field.bound.edges[j as usize]);
            range.count += 1;
        }
        range
    }

    /// Largest slope with which the range may be continued: that of the linear map that explains it, so far
    /// as one does.
    fn steepness(&self) -> f32 {
        let count = self.count as f32;
        let (from, displacement) = (&self.from[..self.count], &self.displacement[..self.count]);
        let middle = from.iter().sum::<Vec3>() / count;
        let mean = displacement.iter().sum::<Vec3>() / count;
        let pairs = || from.iter().zip(displacement).map(|(x, u)| (*x - middle, *u - mean));
        let outer = |u: Vec3, x: Vec3| Mat3::from_cols(u * x.x, u * x.y, u * x.z);
        let (mut squares, mut products) = (Mat3::ZERO, Mat3::ZERO);
        for (x, u) in pairs() {
            squares += outer(x, x);
            products += outer(u, x);
        }
        let spread: f32 = pairs().map(|(x, _)| x.length_squared()).sum();
        let slope = products * (squares + Mat3::from_diagonal(Vec3::splat(RIDGE * spread))).inverse();
        let all: f32 = pairs().map(|(_, u)| u.length_squared()).sum();
        let left: f32 = pairs().map(|(x, u)| (u - slope * x).length_squared()).sum();
        let part = (left / all).sqrt();
        let trust = ((UNEXPLAINED - part) / (UNEXPLAINED - EXPLAINED)).clamp(0.0, 1.0);
        let norm = slope.to_cols_array().iter().map(|x| x * x).sum::<f32>().sqrt();
        let steepness = trust * self.edges.steepest.min(FLATTENED * norm);
        // Samples in one place, or that all go alike, show nothing.
        if steepness.is_finite() { steepness } else { 0.0 }
    }
}
