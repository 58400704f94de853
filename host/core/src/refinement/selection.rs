//! Selection of the part of space in which a model is refined, and the sizes that clusters may grow to away
//! from it.
//!
//! Inside the selection no cluster keeps a larger error than the bound. Outside, the bound rises with the
//! distance, so that sizes of neighbours differ little, as in the sizing fields of mesh generation (P.-O.
//! Persson, *Mesh size functions for implicit geometries and PDE-based gradient limiting*, 2006): a sudden
//! change of density would spoil the fits of the reconstruction.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_model::frame::Frame;

use crate::reconstruction::{DeformationField, carry_positions};
use crate::sampled_model::SampledModel;
use crate::sampling::cluster::REACH_WEIGHT;
use crate::sampling::grid::cell_box;
use crate::sampling::kept_cells::{KeptCell, KeptCells};

/// Ratio of a cluster's largest reach to its distance from the selection.
pub(super) const GRADING: f64 = 1.0;

/// A part of space, and the pose of the model in which it is meant.
#[derive(Clone, Copy)]
pub struct SpaceSelection<'a> {
    /// Signed distance of a point (model coordinates) to the part's surface, in the model's unit; negative
    /// inside.
    pub distance: &'a (dyn Fn(DVec3) -> f64 + Sync),
    /// The deformation so far, if there is one.
    pub so_far: Option<&'a DeformationField<'a>>,
    /// Whether the part is one of the model at rest even so; otherwise it is one of the deformed model.
    pub at_rest: bool,
}

impl<'a> SpaceSelection<'a> {
    /// The deformation to the pose in which the part is meant.
    fn pose(&self) -> Option<&'a DeformationField<'a>> {
        self.so_far.filter(|_| !self.at_rest)
    }

    /// Whether each sample is inside the selection.
    pub(super) fn samples(&self, sampled: &SampledModel) -> Vec<bool> {
        let place = |i: usize| match self.pose() {
            Some(field) => field.place(&sampled.frame, i),
            None => sampled.frame.to_model(sampled.samples.positions[i]),
        };
        let all = (0..sampled.samples.len()).into_par_iter();
        all.map(|i| (self.distance)(place(i)) <= 0.0).collect()
    }
}

/// The selection in the local coordinates of a model at rest.
pub(super) struct Selected<'a> {
    selection: SpaceSelection<'a>,
    frame: Frame,
}

impl<'a> Selected<'a> {
    pub fn new(selection: SpaceSelection<'a>, frame: Frame) -> Self {
        Self { selection, frame }
    }

    /// Distance of a place in the model at rest to the selection, in local units.
    fn distance(&self, p: Vec3) -> f64 {
        let p = self.frame.to_model(p);
        let p = match self.selection.pose() {
            Some(field) => carry_positions(field, &self.frame, &[p]).first().copied().unwrap_or(p),
            None => p,
        };
        (self.selection.distance)(p) / self.frame.scale
    }

    /// Amount by which the bound of a cluster inside this ball is above that inside the selection; local
    /// units.
    pub fn slack(&self, center: Vec3, radius: f32) -> f32 {
        slack(self.distance(center) - f64::from(radius))
    }

    pub fn leaves(&self, sampled: &SampledModel, kept: &KeptCells) -> Vec<Vec<LeafEstimate>> {
        let positions = &sampled.samples.positions;
        let of_sample: Vec<f64> = match self.selection.pose() {
            Some(field) => {
                let distance = |p: DVec3| (self.selection.distance)(p) / self.frame.scale;
                let all = (0..positions.len()).into_par_iter();
                all.map(|i| distance(field.place(&self.frame, i))).collect()
            }
            None => positions.par_iter().map(|p| self.distance(*p)).collect(),
        };
        let contacts = sampled.samples.contacts();
        let of_cell = |cell: &KeptCell| {
            let to_cell = match self.selection.pose() {
                // The place of a deformed cell is known by its samples alone.
                Some(_) => f64::NEG_INFINITY,
                None => {
                    let bounds = cell_box(cell.key, kept.level);
                    let center = (self.selection.distance)(bounds.center());
                    (center - 0.5 * bounds.diagonal()) / self.frame.scale
                }
            };
            let tree = &cell.tree;
            let grown = tree.is_grown();
            let is_leaf = |i: &usize| tree.children[*i] == 0;
            let leaves = (0..tree.children.len()).filter(is_leaf).map(|i| (tree.errors[i], grown[i]));
            let parted = |sample: u32| contacts.is_some_and(|all| all.same_sheet(sample as usize).is_some());
            let nearest = |((error, below), sample): ((f32, bool), &u32)| {
                // The error holds the reach; a sample that stayed where it was may stand at its cluster's
                // rim, and so may that of one of several sheets.
                let below = below || parted(*sample);
                let reach = f64::from(error) / REACH_WEIGHT * if below { 2.0 } else { 1.0 };
                let distance = (of_sample[*sample as usize] - reach).max(to_cell);
                LeafEstimate { error, slack: slack(distance), inside: distance <= 0.0 }
            };
            leaves.zip(&tree.samples).map(nearest).collect()
        };
        kept.cells.par_iter().map(of_cell).collect()
    }
}

/// Error and slack of a leaf, estimated before the model is read.
#[derive(Debug, Clone, Copy)]
pub(super) struct LeafEstimate {
    /// The leaf's error.
    pub error: f32,
    /// The slack, at most.
    pub slack: f32,
    /// Whether the leaf's cluster may reach into the selection.
    pub inside: bool,
}

/// Rise of the bound at a distance from the selection, local units. A distance that is no number gives no
/// number, and no cluster is refined for it.
fn slack(distance: f64) -> f32 {
    (if distance <= 0.0 { 0.0 } else { REACH_WEIGHT * GRADING * distance }) as f32
}
