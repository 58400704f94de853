//! Constraints of the samples by the regions.

use glam::{DAffine3, DMat3, DVec3};
use simod_geometry::affine_map;
use simod_plugin_api::{Affine, PluginError, PluginResult, PrepareInput, Role};

use crate::rotation;

/// A weight from which on a sample does exactly what its region does.
const HARD: f32 = 1.0 - 1e-6;
/// A weight below which a region does not reach a sample.
const NONE: f32 = 1e-4;

/// Region that a sample follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleTarget {
    /// A fixed region: the sample stays.
    Fixed,
    /// The handle of this number.
    Handle(u32),
}

/// A region that draws at a sample, and lets it go where others draw more.
#[derive(Debug, Clone, Copy)]
pub struct Soft {
    /// The sample.
    pub node: u32,
    /// Region to which the sample is drawn.
    pub target: SampleTarget,
    /// Strength of the draw, from 0 (not at all) to infinity (where a weight would be 1).
    pub strength: f64,
}

/// The regions, sample by sample.
#[derive(Debug)]
pub struct SampleConstraints {
    /// Region of each sample that does exactly what the region does; `None` for other samples.
    pub hard: Vec<Option<SampleTarget>>,
    /// Draws at other samples, by sample; where regions overlap, at one sample several.
    pub soft: Vec<Soft>,
    /// Number of handles.
    pub handles: usize,
    /// Whether any sample is fixed.
    pub has_fixed: bool,
}

impl SampleConstraints {
    /// Gathers the regions. Of several that hold a sample exactly, the first one does.
    pub fn gather(input: &PrepareInput<'_>) -> PluginResult<Self> {
        let count = input.samples.positions().len();
        let regions = input.regions();
        let mut this = Self { hard: vec![None; count], soft: Vec::new(), handles: 0, has_fixed: false };
        let mut targets = Vec::new();
        for (i, region) in regions.iter().enumerate() {
            if region.weights().len() != count {
                return Err(PluginError::internal(format!("region {} has not one weight per sample", i + 1)));
            }
            let is_handle = region.role == Role::HANDLE;
            if !region.weights().iter().any(|w| *w >= NONE) {
                let what = if is_handle { "handle" } else { "fixed" };
                return Err(PluginError::input(format!("region {} ({what}) holds no sample", i + 1))
                    .hint("enlarge or move its shapes, or take more samples"));
            }
            targets.push(if is_handle {
                SampleTarget::Handle(this.handles as u32)
            } else {
                SampleTarget::Fixed
            });
            this.handles += usize::from(is_handle);
            this.has_fixed |= !is_handle;
        }
        if this.handles == 0 {
            return Err(PluginError::input("there is no handle region")
                .hint("add a region with role = \"handle\" and a move"));
        }
        for node in 0..count {
            let weights = || regions.iter().map(|r| r.weights()[node]).zip(&targets);
            if let Some((_, target)) = weights().find(|(w, _)| *w >= HARD) {
                this.hard[node] = Some(*target);
                continue;
            }
            for (weight, &target) in weights().filter(|(w, _)| *w >= NONE) {
                let strength = f64::from(weight) / f64::from(1.0 - weight);
                this.soft.push(Soft { node: node as u32, target, strength });
            }
        }
        Ok(this)
    }
}

/// Motions of the handles, beside one that all share.
#[derive(Debug)]
pub struct OwnMotions {
    /// Motion that all handles share, to be applied last; the identity where samples are fixed.
    pub common: DAffine3,
    /// Displacement that each handle gives a point, before the common motion. Of linear methods: relative to
    /// the point's image under the common motion, after it.
    displacements: Vec<DAffine3>,
}

impl OwnMotions {
    /// Motions for methods that know rotations: the common motion is rigid.
    pub fn rigid(transforms: &[Affine], has_fixed: bool) -> Self {
        let maps: Vec<DAffine3> = transforms.iter().map(|map| affine_map(&map.rows)).collect();
        let mut common = DAffine3::IDENTITY;
        if !has_fixed && let Some(first) = maps.first() {
            let turn = rotation::nearest(first.matrix3, DMat3::IDENTITY);
            // The turn is the handle's own, rounding apart, which then is met to the last bit.
            let is_rigid = turn.abs_diff_eq(first.matrix3, 1e-12);
            common.matrix3 = if is_rigid { first.matrix3 } else { turn };
            common.translation = first.translation;
        }
        let back = common.matrix3.transpose();
        // Exactly nothing for the common motion itself.
        let displacement = |map: &DAffine3| DAffine3 {
            matrix3: back * (map.matrix3 - common.matrix3),
            translation: back * (map.translation - common.translation),
        };
        Self { displacements: maps.iter().map(displacement).collect(), common }
    }

    /// Motions for linear methods: the common motion is the handles' mean.
    pub fn affine(transforms: &[Affine], has_fixed: bool) -> Self {
        let maps: Vec<DAffine3> = transforms.iter().map(|map| affine_map(&map.rows)).collect();
        let mut common = DAffine3::IDENTITY;
        if !has_fixed && let Some(first) = maps.first() {
            let share = 1.0 / maps.len() as f64;
            common = *first;
            for map in &maps {
                // Exactly the map where all are the same.
                common.matrix3 += (map.matrix3 - first.matrix3) * share;
                common.translation += (map.translation - first.translation) * share;
            }
        }
        let displacement = |map: &DAffine3| DAffine3 {
            matrix3: map.matrix3 - common.matrix3,
            translation: map.translation - common.translation,
        };
        Self { displacements: maps.iter().map(displacement).collect(), common }
    }

    /// Whether the common motion is the only one.
    pub fn is_common(&self) -> bool {
        self.displacements.iter().all(|d| d.matrix3 == DMat3::ZERO && d.translation == DVec3::ZERO)
    }

    /// The displacement of a point that follows a target.
    pub fn displacement(&self, target: SampleTarget, at: DVec3) -> DVec3 {
        match target {
            SampleTarget::Fixed => DVec3::ZERO,
            SampleTarget::Handle(h) => self.displacements[h as usize].transform_point3(at),
        }
    }

    /// The map to the displacements of a handle.
    pub fn of_handle(&self, handle: usize) -> DAffine3 {
        self.displacements[handle]
    }

    /// Rotation of a target, before the common motion; for methods that know rotations.
    pub fn turn(&self, target: SampleTarget) -> DMat3 {
        match target {
            SampleTarget::Fixed => DMat3::IDENTITY,
            SampleTarget::Handle(h) => {
                rotation::nearest(DMat3::IDENTITY + self.displacements[h as usize].matrix3, DMat3::IDENTITY)
            }
        }
    }
}
