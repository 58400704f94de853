//! Goals of the samples by the regions, and the springs by which regions hold the lattice.

use crate::lattice::{CellPoint, HexMesh, weights};
use glam::{DAffine3, DVec3};
use simod_plugin_api::{PluginError, PluginResult, PrepareInput, Role};
use std::collections::BTreeMap;

/// Weight from which on a sample does exactly what its region does, and one below which the region does not
/// reach it.
const HARD: f32 = 1.0 - 1e-6;
const NONE: f32 = 1e-4;
/// Stiffness of springs where regions hold, as a multiple of the material's, by a cell's size.
const STIFFEST: f64 = 200.0;

/// Regions that hold samples or draw at them.
#[derive(Debug)]
pub struct SampleGoals {
    /// Target that holds each sample exactly, if any: 0 for the fixed regions, then the handles.
    pub hard: Vec<Option<u32>>,
    /// Draws at samples: the sample, the target, and the strength beside the material.
    draws: Vec<(u32, u32, f64)>,
    /// The number of handles.
    pub handles: usize,
    /// Middle of the fixed samples, if there are any, and of each handle's, with the distance of the farthest
    /// from there.
    pub middles: Vec<Option<(DVec3, f64)>>,
}

/// Springs between the corners of a cell and where these would be if they did as a region does.
#[derive(Debug)]
pub struct Spring {
    /// The cell.
    pub cell: u32,
    /// Target: 0 for the fixed regions, then the handles.
    pub target: u32,
    /// The products of weights, summed over the samples.
    pub form: [[f64; 8]; 8],
}

impl SampleGoals {
    /// Gathers the regions. Of several that hold a sample exactly, the first one does.
    pub fn gather(input: &PrepareInput<'_>, points: &[DVec3]) -> PluginResult<Self> {
        let regions = input.regions();
        let mut targets = Vec::new();
        let mut handles = 0;
        for (i, region) in regions.iter().enumerate() {
            let is_handle = region.role == Role::HANDLE;
            if region.weights().len() != points.len() {
                return Err(PluginError::internal(format!("region {} has not one weight per sample", i + 1)));
            }
            if !region.weights().iter().any(|w| *w >= NONE) {
                let what = if is_handle { "handle" } else { "fixed" };
                return Err(PluginError::input(format!("region {} ({what}) holds no sample", i + 1))
                    .hint("enlarge or move its shapes, or take more samples"));
            }
            handles += u32::from(is_handle);
            targets.push(if is_handle { handles } else { 0 });
        }
        let (mut hard, mut draws) = (vec![None; points.len()], Vec::new());
        for (i, hard) in hard.iter_mut().enumerate() {
            let all = || regions.iter().map(|r| r.weights()[i]).zip(&targets).filter(|(w, _)| *w >= NONE);
            if let Some((_, target)) = all().find(|(w, _)| *w >= HARD) {
                *hard = Some(*target);
                draws.push((i as u32, *target, STIFFEST));
                continue;
            }
            let strength = |w: f32| (f64::from(w) / f64::from(1.0 - w)).min(STIFFEST);
            draws.extend(all().map(|(w, target)| (i as u32, *target, strength(w))));
        }
        let middles = (0..=handles).map(|target| middle(target, &draws, points)).collect();
        Ok(Self { hard, draws, handles: handles as usize, middles })
    }

    /// The samples that springs draw at.
    pub fn drawn(&self) -> impl Iterator<Item = u32> {
        self.draws.iter().map(|(sample, _, _)| *sample)
    }

    /// The springs of a lattice, by where in it each sample lies.
    pub fn springs(&self, lattice: &HexMesh, places: &[Option<CellPoint>]) -> Vec<Spring> {
        let mut counts = vec![0_u32; lattice.cells.len()];
        places.iter().flatten().for_each(|p| counts[p.cell as usize] += 1);
        let mut forms: BTreeMap<(u32, u32), [[f64; 8]; 8]> = BTreeMap::new();
        let size = lattice.size.element_product().cbrt();
        for (sample, target, strength) in &self.draws {
            let Some(place) = places[*sample as usize] else { continue };
            let form = forms.entry((place.cell, *target)).or_default();
            let stiffness = strength * size / f64::from(counts[place.cell as usize]);
            let weights = weights(place.at);
            for (row, w) in form.iter_mut().zip(weights) {
                row.iter_mut().zip(weights).for_each(|(x, v)| *x += stiffness * w * v);
            }
        }
        forms.into_iter().map(|((cell, target), form)| Spring { cell, target, form }).collect()
    }
}

fn middle(target: u32, draws: &[(u32, u32, f64)], points: &[DVec3]) -> Option<(DVec3, f64)> {
    let own = || draws.iter().filter(|(_, t, _)| *t == target).map(|(i, _, _)| points[*i as usize]);
    let count = own().count();
    (count > 0).then(|| {
        let middle = own().sum::<DVec3>() / count as f64;
        (middle, own().map(|p| p.distance(middle)).fold(0.0, f64::max))
    })
}

/// Map of each target, at some time of a motion.
#[derive(Debug, Clone)]
pub struct Goals(pub Vec<DAffine3>);

impl Goals {
    /// The image of a place at rest under a target's map.
    pub fn image(&self, target: u32, at: DVec3) -> DVec3 {
        self.0[target as usize].transform_point3(at)
    }
}
