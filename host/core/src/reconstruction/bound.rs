//! The bound that no vertex leaves: the range of the samples around it.
//!
//! Fits that are badly determined, as between two sheets that move apart, among samples that jitter, or
//! beyond the last samples, may give an expansion that explains its neighbours well and takes a vertex far
//! away from all of them. Whatever is blended is therefore compared with the displacements of the 28 samples
//! nearest to the vertex: `docs/reconstruction.md` has the definition. This is the maximum principle of
//! scattered data, as limiters of finite volumes hold it (T. Barth, D. Jespersen, *The Design and Application
//! of Upwind Schemes on Unstructured Meshes*, 1989), in space rather than on a sheet, for coordinates one by
//! one.
//!
//! Nearly all vertices are seen to keep to it without a search, as they lie within the range of samples
//! beside their home that are surely among those nearest to them.

use glam::Vec3;
use rayon::prelude::*;

use super::expansion::ROUNDING;
use super::sheets::Sheets;
use crate::sampling::SampleSet;

/// Distance beyond the range that a vertex may go, as a part of the local step: a little less than a tenth,
/// for rounding.
pub const BEYOND: f32 = 0.095;

/// Neighbours of a sample to which its edges lead: a ring.
pub const EDGES: usize = 6;

/// Rounding error of a displacement, local units.
pub const MARGIN: f32 = ROUNDING as f32;

/// Displacements between the least and the greatest, coordinate by coordinate.
#[derive(Debug, Clone, Copy)]
pub struct DisplacementBox {
    pub low: Vec3,
    pub high: Vec3,
}

impl DisplacementBox {
    /// The box that holds no displacement.
    pub const NOTHING: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    /// The extent of one displacement, widened by its rounding.
    pub fn about(u: Vec3) -> Self {
        Self { low: u - MARGIN, high: u + MARGIN }
    }

    /// Copy of this range that includes one displacement more.
    #[inline]
    pub fn with(self, u: Vec3) -> Self {
        Self { low: self.low.min(u - MARGIN), high: self.high.max(u + MARGIN) }
    }

    pub fn widened(&self, by: f32) -> Self {
        Self { low: self.low - by, high: self.high + by }
    }

    #[inline]
    pub fn holds(&self, u: Vec3) -> bool {
        u.cmpge(self.low).all() && u.cmple(self.high).all()
    }
}

/// Largest difference of displacements, and largest slope, over some edges between samples.
#[derive(Debug, Clone, Copy)]
pub struct EdgeStretches {
    /// The largest difference of displacements.
    pub step: f32,
    /// The largest such difference over the edge's length.
    pub steepest: f32,
}

impl EdgeStretches {
    pub const NONE: Self = Self { step: 0.0, steepest: 0.0 };

    /// The edges around one sample.
    pub fn around(samples: &SampleSet, sheets: &Sheets, deformed: &[Vec3], i: usize) -> Self {
        let positions = &samples.positions;
        let displacement = |i: usize| deformed[i] - positions[i];
        let mut edges = Self::NONE;
        let include = |j: usize| {
            let length = positions[i].distance(positions[j]);
            let difference = displacement(i).distance(displacement(j));
            edges.step = edges.step.max(difference);
            if length > 0.0 {
                edges.steepest = edges.steepest.max(difference / length);
            }
        };
        // Beside other sheets the nearest samples may be theirs.
        if sheets.is_crowded(i) {
            let mut found = [0; EDGES + 1];
            let near = samples.nearest_ones(positions[i], &mut found).map(|j| j as usize);
            near.filter(|j| *j != i).take(EDGES).for_each(include);
        } else {
            sheets.of_sample(i).iter().take(EDGES).map(|j| *j as usize).for_each(include);
        }
        edges
    }

    pub fn include(&mut self, other: &Self) {
        (self.step, self.steepest) = (self.step.max(other.step), self.steepest.max(other.steepest));
    }
}

/// Stretches of the edges around each sample.
///
/// Memory: 8 bytes per sample.
pub struct Bound {
    pub edges: Vec<EdgeStretches>,
}

impl Bound {
    /// Bound that all samples set, by their deformed positions.
    pub fn new(samples: &SampleSet, sheets: &Sheets, deformed: &[Vec3]) -> Self {
        let all = samples.storage().counted(deformed.len(), sheets.bytes_of(1));
        Self { edges: all.map(|i| EdgeStretches::around(samples, sheets, deformed, i)).collect() }
    }

    /// The largest difference of displacements along an edge of a sample.
    #[inline]
    pub fn step(&self, sample: usize) -> f32 {
        self.edges[sample].step
    }
}
