//! Regions of what is selected, and the handles that move.

use super::edit::missing;
use super::{Open, State, refused};
use crate::appended::{as_found, owner_of};
use crate::motion::{PlacedHandle, placed_handles};
use crate::pick::Hit;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_core::refinement::Finer;
use simod_model::Result;
use simod_plugin_api::HandleDesc;
use simod_session::edit::{Change, StepId};
use simod_session::session_file::{Action, Joint, Refine, Region, Role};
use simod_session::{Motion, PickedPoints, Shape, Shapes};

/// Neighbours of a selected sample that tell where the selection ends.
const RING: usize = 8;

impl Open {
    /// The samples as a step finds them, local coordinates. Of one that was not reached yet, as they are
    /// shown.
    fn before(&self, id: StepId) -> &[Vec3] {
        let steps = self.steps();
        let from = steps.iter().position(|e| e.id == id).unwrap_or(steps.len());
        let known = steps[from..].iter().find_map(|entry| {
            let at = self.scene.statuses.iter().position(|(known, _)| *known == entry.id)?;
            self.scene.before.get(at)
        });
        known.unwrap_or(&self.scene.positions)
    }
}

impl State {
    /// The samples as the step at a place finds them.
    pub(super) fn before(&self, at: usize) -> Result<&[Vec3]> {
        Ok(self.open()?.before(self.entry(at)?.id))
    }

    /// The shapes of a region.
    pub(super) fn shapes(&self, at: usize, region: usize) -> Result<&Shapes> {
        let region = self.deformation(at)?.regions.get(region).ok_or_else(|| missing("region", region))?;
        Ok(&region.shapes)
    }

    /// What is selected, as a step finds it, as geometry.
    fn picked(&self, positions: &[Vec3]) -> Result<PickedPoints> {
        let open = self.open()?;
        let (scene, selection, frame) = (&open.scene, &self.selection, open.scene.frame());
        let positions = &*as_found(scene, positions).positions;
        let count = positions.len().min(scene.len());
        let point = |i: usize| frame.to_model(positions[i]);
        let selected = |i: usize| selection.contains(i as u32);
        let inside: Vec<DVec3> = (0..count).filter(|i| selected(*i)).map(point).collect();
        if inside.is_empty() {
            return Err(refused("nothing is selected", "select some samples first"));
        }
        let neighbours = scene.sampled.samples.neighbours();
        let mut next = vec![false; count];
        for i in (0..count).filter(|i| selected(*i)) {
            let near = neighbours.nearest_to(i).iter().take(RING).chain(open.adjacency.of(i));
            near.map(|j| *j as usize).filter(|j| *j < count && !selected(*j)).for_each(|j| next[j] = true);
        }
        let outside = |next: &[bool]| (0..count).filter(|i| next[*i]).map(point).collect();
        let picked = PickedPoints::new(inside.clone(), outside(&next));
        // Those that are nearer to the selection than to its border, as on the other side of a thin wall,
        // have to be told.
        let more = |i: usize| !selected(i) && (next[i] || picked.signed_distance(point(i)) <= 0.0);
        let next: Vec<bool> = (0..count).into_par_iter().map(more).collect();
        Ok(PickedPoints::new(inside, outside(&next)))
    }

    pub(super) fn make_region(
        &mut self,
        at: usize,
        role: Role,
        falloff: f64,
        replaces: Option<usize>,
    ) -> Result<()> {
        let picked = self.picked(self.before(at)?)?;
        let mut regions = self.deformation(at)?.regions.clone();
        let middle = picked.inside().iter().sum::<DVec3>() / picked.inside().len() as f64;
        let shapes = Shapes { shapes: vec![Shape::Selection(picked)], falloff };
        let pivot = (role == Role::Handle).then_some(middle);
        let mut region = Region { role, shapes, motion: Motion { pivot, ..Motion::default() } };
        match replaces {
            None => regions.push(region),
            Some(i) => {
                let former = regions.get_mut(i).ok_or_else(|| missing("region", i))?;
                if former.role == role {
                    region.motion = former.motion;
                }
                *former = region;
            }
        }
        self.change(at, Change::SetRegions(regions))
    }

    pub(super) fn refine_selection(&mut self, finer: Finer) -> Result<()> {
        let open = self.open()?;
        let picked = self.picked(&open.scene.positions)?;
        let shapes = Shapes { shapes: vec![Shape::Selection(picked)], falloff: 0.0 };
        let refine = Refine { shapes, finer };
        refine.check().map_err(|(what, hint)| refused(what, hint))?;
        self.add(self.open()?.steps().len(), Action::Refine(refine))
    }

    pub(super) fn place_joint(
        &mut self,
        step: usize,
        id: String,
        at: DVec3,
        parent: Option<String>,
    ) -> Result<()> {
        let mut joints = self.deformation(step)?.joints.clone();
        match joints.iter_mut().find(|joint| joint.id == id) {
            Some(joint) => (joint.at, joint.parent) = (at, parent),
            None => joints.push(Joint { id, at, parent }),
        }
        self.change(step, Change::SetJoints(joints))
    }

    /// A point of the surface that is shown, where a step finds it: for strokes and joints. Model
    /// coordinates.
    pub fn in_step(&self, step: usize, hit: &Hit) -> Option<DVec3> {
        let open = self.open.as_ref()?;
        let before = self.before(step).ok()?;
        // What the step does not know yet goes along with what is around it.
        let sample = owner_of(&open.scene.sampled, hit.sample, before.len())?;
        let (scene, sample) = (&open.scene, sample as usize);
        let (was, is) = (before.get(sample)?, scene.positions.get(sample)?);
        Some(scene.frame().to_model_exact(hit.local - is.as_dvec3() + was.as_dvec3()))
    }

    /// The point that a handle region turns about: its motion's own, or the middle of what it holds. Model
    /// coordinates.
    pub fn handle_pivot(&self, step: usize, region: usize) -> Option<DVec3> {
        let Region { shapes, motion, .. } = self.deformation(step).ok()?.regions.get(region)?;
        if let Some(pivot) = motion.pivot {
            return Some(pivot);
        }
        let open = self.open.as_ref()?;
        let frame = open.scene.frame();
        let weighed = |p: &Vec3| {
            let p = frame.to_model(*p);
            let weight = shapes.weight(p);
            (p * weight, weight)
        };
        let all: Vec<(DVec3, f64)> = self.before(step).ok()?.par_iter().map(weighed).collect();
        let (sum, weight) = all.iter().fold((DVec3::ZERO, 0.0), |(p, w), (q, v)| (p + q, w + v));
        (weight > 0.0).then(|| sum / weight)
    }

    /// The handles that a step's plugin placed, and where they are; none where it was not done yet.
    pub fn handles(&self, step: usize) -> Vec<(HandleDesc, PlacedHandle)> {
        let (Some(open), Ok(deformation)) = (&self.open, self.deformation(step)) else { return Vec::new() };
        let placed = self.entry(step).ok().and_then(|entry| open.scene.handles.get(&entry.id));
        let Some(handles) = placed else { return Vec::new() };
        let moved = placed_handles(handles, &deformation.handles, &open.scene.frame());
        handles.iter().cloned().zip(moved).collect()
    }
}
