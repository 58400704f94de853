//! Numbers for each sample, to be shown as colours.

use crate::appended::{StepSamples, as_found};
use crate::gradients;
use crate::scene::{ViewerScene, common};
use crate::selection::Selection;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_core::reconstruction::principal_stretches;
pub use simod_picture::{class_color, class_name, scale_color};
use simod_session::{RegionShape, Shapes};

/// Numbers or colours that are shown on the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overlay {
    /// Nothing but the surface.
    #[default]
    None,
    /// The samples that are selected, as 0 or 1.
    Selection,
    /// The weight of a region of the chosen step: 0 to 1.
    Region(usize),
    /// Distance by which samples have moved, in the model's unit.
    Displacement,
    /// The largest factor by which lengths have changed, or its inverse if that is larger: from 1.
    Stretch,
    /// Mean distance to the nearest samples at rest, in the model's unit.
    Density,
    /// The error that the model is expected to have between the samples, in the model's unit. The error
    /// takes a while to compute, so the overlay is shown when the steps were done with it, and not while
    /// something is dragged.
    TransferError,
    /// Distance of samples from their positions in the pinned version, in the model's unit. Samples that
    /// only one version has, as refinements appended them, are compared with the positions to which the
    /// other version's reconstruction carries them. Until these are known, and in the pinned version, such
    /// samples take the mean of their neighbours.
    Difference,
    /// Attribute of the vertices at this place in the [model's list](crate::State::attributes), in its own
    /// unit: of a sample, the mean over its vertices. The model is read once for the attribute.
    Attribute(usize),
}

/// Numbers, one for each sample, with their scale.
#[derive(Debug, Clone, PartialEq)]
pub struct ScalarField {
    /// The numbers; none is not finite.
    pub values: Vec<f32>,
    /// Numbers of the scale's first colour and of its last.
    pub range: [f32; 2],
    /// Whether the numbers are classes of points, each of a colour of its own.
    pub are_classes: bool,
}

/// The colours of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OverlayScale {
    range: [f32; 2],
    are_classes: bool,
}

impl OverlayScale {
    /// The colour of a number, 8-bit sRGB.
    pub fn color(&self, number: f32) -> [u8; 3] {
        if self.are_classes {
            return class_color(number.round() as u8);
        }
        let [from, to] = self.range;
        scale_color((number - from) / (to - from))
    }
}

impl ScalarField {
    /// Numbers with a range that holds most of them: a few of the largest are beyond it.
    fn ranged(values: Vec<f32>, from: f32) -> Self {
        let values: Vec<f32> = values.into_iter().map(|x| if x.is_finite() { x } else { from }).collect();
        let mut sorted = values.clone();
        let last = sorted.len().saturating_sub(1);
        let at = last - last / 200;
        let (_, most, _) = sorted.select_nth_unstable_by(at, f32::total_cmp);
        let most = *most;
        let range = [from, if most > from { most } else { from + 1.0 }];
        Self { values, range, are_classes: false }
    }

    /// Weights, 0 to 1.
    fn weights(values: Vec<f32>) -> Self {
        Self { values, range: [0.0, 1.0], are_classes: false }
    }

    /// The colour of a sample, 8-bit sRGB.
    pub fn color(&self, sample: usize) -> [u8; 3] {
        self.scale().color(self.values[sample])
    }

    /// Scale of the numbers' colours.
    pub fn scale(&self) -> OverlayScale {
        OverlayScale { range: self.range, are_classes: self.are_classes }
    }
}

/// The selection as a field: 1 at samples that are selected.
pub fn selection(selection: &Selection) -> ScalarField {
    ScalarField::weights(selection.marks().iter().map(|m| f32::from(u8::from(*m))).collect())
}

/// Weight of shapes on the positions with which a step began, in local coordinates; samples that the step
/// does not know belong to the known ones around them.
pub fn region(scene: &ViewerScene, before: &[Vec3], shapes: &Shapes) -> ScalarField {
    let frame = scene.frame();
    let StepSamples { positions, owners } = as_found(scene, before);
    let weight = |p: &Vec3| shapes.weight(frame.to_model(*p)) as f32;
    let mut values: Vec<f32> = positions.par_iter().take(scene.len()).map(weight).collect();
    values.resize(scene.len(), 0.0);
    // The border of a selection by hand is halfway between samples, along the surface: samples behind a
    // thin wall do not matter.
    let is_picked = |shape: &RegionShape| matches!(shape, RegionShape::Selection(_));
    if let Some(owners) = owners.filter(|_| shapes.shapes.iter().all(is_picked)) {
        for i in before.len()..scene.len() {
            let owner = values[owners[i] as usize];
            if owner == 1.0 || values[i] == 1.0 {
                values[i] = owner;
            }
        }
    }
    ScalarField::weights(values)
}

/// Distances of samples in two versions. `carried` has the other version's positions for all samples of the
/// scene, in local coordinates; without it only samples of both versions are compared, and the rest take
/// the mean of their neighbours.
pub fn difference(scene: &ViewerScene, other: &ViewerScene, carried: Option<&[Vec3]>) -> ScalarField {
    let scale = scene.frame().scale as f32;
    let to = carried.unwrap_or(&other.positions);
    let known = if carried.is_some() { scene.len() } else { common(&scene.sampled, &other.sampled) };
    let pairs = scene.positions.par_iter().zip(to).take(known);
    let mut values: Vec<f32> = pairs.map(|(p, q)| p.distance(*q) * scale).collect();
    spread(&mut values, scene);
    ScalarField::ranged(values, 0.0)
}

/// Gives numbers to the samples behind those that have one: the mean of the neighbours that have one, from
/// these outwards.
fn spread(values: &mut Vec<f32>, scene: &ViewerScene) {
    let known = values.len();
    values.resize(scene.len(), f32::NAN);
    let neighbours = scene.sampled.samples.neighbours();
    let mut pending: Vec<usize> = (known..scene.len()).collect();
    while !pending.is_empty() {
        let mean = |i: &usize| {
            let near =
                neighbours.nearest_to(*i).iter().map(|j| values[*j as usize]).filter(|x| x.is_finite());
            let (sum, count) = near.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
            (*i, if count > 0.0 { sum / count } else { f32::NAN })
        };
        let found: Vec<(usize, f32)> = pending.par_iter().map(mean).collect();
        let before = pending.len();
        found.into_iter().for_each(|(i, x)| values[i] = x);
        pending.retain(|i| values[*i].is_nan());
        // Parts of the surface that are connected with no known sample.
        if pending.len() == before {
            break;
        }
    }
}

/// Distances by which samples have moved.
pub fn displacement(scene: &ViewerScene) -> ScalarField {
    let scale = scene.frame().scale as f32;
    let pairs = scene.positions.par_iter().zip(&scene.sampled.samples.positions);
    ScalarField::ranged(pairs.map(|(p, q)| p.distance(*q) * scale).collect(), 0.0)
}

/// Factors by which the surface is stretched or squeezed.
pub fn stretch(scene: &ViewerScene) -> ScalarField {
    scene.sampled.samples.prepare();
    let normals = scene.sampled.samples.normals();
    let of = |i: usize| {
        let Some(map) = gradients::around(scene, i) else { return 1.0 };
        let [most, least] = principal_stretches(&map, normals[i]);
        most.max(1.0 / least)
    };
    ScalarField::ranged((0..scene.len()).into_par_iter().map(of).collect(), 1.0)
}

/// Distances between samples at rest.
pub fn density(scene: &ViewerScene) -> ScalarField {
    let scale = scene.frame().scale as f32;
    let values: Vec<f32> = scene.sampled.samples.spacing().iter().map(|s| s * scale).collect();
    let least = values.iter().copied().fold(f32::INFINITY, f32::min);
    ScalarField::ranged(values, if least.is_finite() { least } else { 0.0 })
}

/// The error to be expected between the samples; nothing where the scene does not have it yet.
pub fn transfer_error(scene: &ViewerScene) -> Option<ScalarField> {
    let scale = scene.frame().scale as f32;
    let expected = scene.expected_error.as_ref()?;
    Some(ScalarField::ranged(expected.iter().map(|e| e * scale).collect(), 0.0))
}

/// An attribute of the vertices, as a number of each sample; nothing where it is not known yet, or no
/// sample has a number. The range holds most of the numbers.
pub fn attribute(scene: &ViewerScene, place: usize) -> Option<ScalarField> {
    let attribute = scene.sampled.source.attributes.get(place)?;
    let values = scene.sampled.held_attributes()?.get(&attribute.name)?.to_vec();
    if attribute.is_of_classes() {
        return Some(ScalarField { values, range: [0.0, 1.0], are_classes: true });
    }
    let mut sorted = values.clone();
    let few = sorted.len() / 100;
    let (_, least, _) = sorted.select_nth_unstable_by(few, f32::total_cmp);
    let least = *least;
    Some(ScalarField::ranged(values, least))
}
