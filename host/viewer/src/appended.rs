//! Samples that a refinement appended, and the former samples around them, to which they belong.

use crate::gradients::tangent_map;
use crate::scene::{ViewerScene, common};
use glam::Vec3;
use rayon::prelude::*;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::SampleSet;
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};

/// Neighbours of a sample along which ways over the surface go.
const RING: usize = 12;
/// Number of former samples that tell how the surface around one of them moved.
const TELLING: usize = 32;

/// The former sample at the very position of each sample of a later sampling of the same model, if there is
/// one.
pub fn former(before: &SampledModel, after: &SampledModel) -> Vec<Option<u32>> {
    let same = common(before, after);
    let bits = |p: &Vec3| p.to_array().map(f32::to_bits);
    // Samples that another refinement appended may be appended again, in another order.
    let others: HashMap<[u32; 3], u32> =
        before.samples.positions[same..].iter().map(bits).zip(same as u32..).collect();
    let of = |(i, p): (usize, &Vec3)| if i < same { Some(i as u32) } else { others.get(&bits(p)).copied() };
    after.samples.positions.iter().enumerate().map(of).collect()
}

/// Nearest known sample of each sample, by ways over the surface from sample to sample; the sample itself
/// where it is known. `near` gives the samples next to one; those whose normals point the other way, as
/// behind a thin wall, are not ways on. Parts of the surface without a known sample belong to the known
/// sample that is nearest in space. At least one sample has to be known.
pub fn owners<'a>(
    samples: &SampleSet,
    is_known: impl Fn(usize) -> bool,
    near: impl Fn(usize) -> &'a [u32],
) -> Vec<u32> {
    let (positions, normals) = (&samples.positions, samples.normals());
    let mut owners: Vec<Option<u32>> =
        (0..positions.len()).map(|i| is_known(i).then_some(i as u32)).collect();
    let mut lengths: Vec<f32> =
        owners.iter().map(|o| if o.is_some() { 0.0 } else { f32::INFINITY }).collect();
    let is_border =
        |i: &usize| owners[*i].is_some() && near(*i).iter().any(|j| owners[*j as usize].is_none());
    // Lengths are not negative, so their bits are in their order.
    let mut open: BinaryHeap<_> =
        (0..positions.len()).filter(is_border).map(|i| Reverse((0u32, i))).collect();
    while let Some(Reverse((bits, i))) = open.pop() {
        let length = f32::from_bits(bits);
        if length > lengths[i] {
            continue;
        }
        for j in near(i).iter().map(|j| *j as usize) {
            let way = length + positions[i].distance(positions[j]);
            if way < lengths[j] && normals[i].dot(normals[j]) >= 0.0 {
                (lengths[j], owners[j]) = (way, owners[i]);
                open.push(Reverse((way.to_bits(), j)));
            }
        }
    }
    if owners.contains(&None) {
        let known: Vec<u32> = (0..positions.len()).filter(|i| is_known(*i)).map(|i| i as u32).collect();
        let alone = known.iter().map(|i| positions[*i as usize]).collect();
        // There is one known sample at least, and all positions are finite.
        let alone = SampleSet::new(alone, Vec::new()).ok();
        let nearest = |p: Vec3| alone.as_ref().map_or(0, |alone| known[alone.nearest(p) as usize]);
        let found = |(i, owner): (usize, &Option<u32>)| owner.unwrap_or_else(|| nearest(positions[i]));
        return owners.par_iter().enumerate().map(found).collect();
    }
    owners.into_iter().flatten().collect()
}

/// All samples of a scene as a step finds them: the samples that the step knows, and the others, which
/// refinements appended by the step or later, and which go along with the known ones around them.
pub struct StepSamples<'a> {
    /// Positions in local coordinates.
    pub positions: Cow<'a, [Vec3]>,
    /// The known sample to which each sample belongs; nothing where the step knows all samples.
    pub owners: Option<Vec<u32>>,
}

/// All samples as a step finds them; `before` has the positions of those that the step knows, in local
/// coordinates.
pub fn as_found<'a>(scene: &'a ViewerScene, before: &'a [Vec3]) -> StepSamples<'a> {
    let samples = &scene.sampled.samples;
    if before.len() >= samples.len() || before.is_empty() {
        return StepSamples { positions: Cow::Borrowed(before), owners: None };
    }
    let (rest, known) = (&samples.positions, before.len());
    samples.prepare();
    let neighbours = samples.neighbours();
    let ring = RING.min(neighbours.k());
    let owners = owners(samples, |i| i < known, |i| &neighbours.nearest_to(i)[..ring]);
    // Known samples are the neighbours of each other here; among the neighbours in the whole set, most may
    // be appended ones.
    let mut of_owner: Vec<u32> = owners[known..].to_vec();
    of_owner.sort_unstable();
    of_owner.dedup();
    let normals = samples.normals();
    let map = |owner: &u32| {
        let i = *owner as usize;
        tangent_map(rest, before, i, &known_around(scene, *owner, known), normals[i])
    };
    let maps: Vec<_> = of_owner.par_iter().map(map).collect();
    let appended = |i: usize| {
        let owner = owners[i];
        let way = rest[i] - rest[owner as usize];
        let map = of_owner.binary_search(&owner).ok().and_then(|at| maps[at]);
        before[owner as usize] + map.map_or(way, |map| map * way)
    };
    let more = (known..samples.len()).into_par_iter().map(appended);
    let positions = Cow::Owned(before.par_iter().copied().chain(more).collect());
    StepSamples { positions, owners: Some(owners) }
}

/// Some known samples around one of them, from it outwards; the first `known` samples of the scene are the
/// known ones.
fn known_around(scene: &ViewerScene, of: u32, known: usize) -> Vec<u32> {
    let neighbours = scene.sampled.samples.neighbours();
    let mut found = Vec::new();
    let mut seen = HashSet::from([of]);
    let mut ring = vec![of];
    // Three rings are enough; without a bound, refinements that are far finer would be searched as a whole.
    for _ in 0..3 {
        let next: Vec<u32> = ring.iter().flat_map(|i| neighbours.nearest_to(*i as usize)).copied().collect();
        ring = next.into_iter().filter(|j| seen.insert(*j)).collect();
        found.extend(ring.iter().copied().filter(|j| (*j as usize) < known));
        if found.len() >= TELLING {
            break;
        }
    }
    found.truncate(TELLING);
    found
}

/// The sample itself if it is one of the first `known` samples, or else one of these that is near it: from
/// ring to ring of neighbours.
pub fn owner_of(sampled: &SampledModel, sample: u32, known: usize) -> Option<u32> {
    let (neighbours, positions) = (sampled.samples.neighbours(), &sampled.samples.positions);
    let at = positions.get(sample as usize)?;
    let mut seen = HashSet::from([sample]);
    let mut ring = vec![sample];
    while !ring.is_empty() {
        let there = ring.iter().filter(|i| (**i as usize) < known);
        let length = |i: &u32| at.distance_squared(positions[*i as usize]);
        if let Some(found) = there.copied().min_by(|i, j| length(i).total_cmp(&length(j))) {
            return Some(found);
        }
        let next: Vec<u32> = ring.iter().flat_map(|i| neighbours.nearest_to(*i as usize)).copied().collect();
        ring = next.into_iter().filter(|j| seen.insert(*j)).collect();
    }
    None
}
