//! Regions made of the selection, and the handles that move.

use super::State;
use super::edit::missing;
use super::open::OpenSession;
use crate::appended::{as_found, owner_of};
use crate::body::{Ball, InscribedBalls, largest_balls};
use crate::motion::{PlacedHandle, placed_handles};
use crate::pick::Hit;
use crate::selection::Selection;
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use simod_core::refinement::Finer;
use simod_model::{Error, Result};
use simod_plugin_api::HandleDesc;
use simod_session::edit::{Change, StepId};
use simod_session::step::{Action, HandleMove, Joint, Refine, Region, Role};
use simod_session::{Motion, OwnHandles, PickedPoints, RegionShape, Shapes};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Number of neighbours of a selected sample by which the border of the selection is found.
const RING: usize = 8;

impl OpenSession {
    /// The samples' positions as a step finds them, in local coordinates; the shown ones for a step that
    /// was not reached yet.
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

    /// Geometry of some samples, as a step finds them.
    fn picked(&self, positions: &[Vec3], selection: &Selection) -> Result<PickedPoints> {
        let open = self.open()?;
        let (scene, frame) = (&open.scene, open.scene.frame());
        let positions = &*as_found(scene, positions).positions;
        let count = positions.len().min(scene.len());
        let point = |i: usize| frame.to_model(positions[i]);
        let selected = |i: usize| selection.contains(i as u32);
        let inside: Vec<DVec3> = (0..count).filter(|i| selected(*i)).map(point).collect();
        if inside.is_empty() {
            return Err(Error::argument("nothing is selected", "select some samples first"));
        }
        let neighbours = scene.sampled.samples.neighbours();
        let mut next = vec![false; count];
        for i in (0..count).filter(|i| selected(*i)) {
            let near = neighbours.nearest_to(i).iter().take(RING).chain(open.adjacency.neighbours(i));
            near.map(|j| *j as usize).filter(|j| *j < count && !selected(*j)).for_each(|j| next[j] = true);
        }
        let outside = |next: &[bool]| (0..count).filter(|i| next[*i]).map(point).collect();
        let picked = PickedPoints::new(inside.clone(), outside(&next));
        // Samples that are not selected count as outside, if they are nearer to the selection than to its
        // border, as on the other side of a thin wall.
        let more = |i: usize| !selected(i) && (next[i] || picked.signed_distance(point(i)) <= 0.0);
        let next: Vec<bool> = (0..count).into_par_iter().map(more).collect();
        Ok(PickedPoints::new(inside, outside(&next)))
    }

    pub(super) fn make_handle(&mut self, at: usize, band: f64) -> Result<()> {
        if !(band.is_finite() && band > 0.0) {
            return Err(Error::argument("the band that bends cannot be of that width", "give one above 0"));
        }
        let before = self.before(at)?;
        let handle = self.picked(before, &self.selection)?;
        let fixed = self.beyond(before, band)?;
        let fixed = self.picked(before, &fixed).map_err(|_| {
            Error::argument(
                "nothing is left to be fixed around the handle",
                "have it bend within less, or select less",
            )
        })?;
        let mut regions = self.deformation(at)?.regions.clone();
        let middle = handle.inside().iter().sum::<DVec3>() / handle.inside().len() as f64;
        for (role, picked) in [(Role::Handle, handle), (Role::Fixed, fixed)] {
            let shapes = Shapes { shapes: vec![RegionShape::Selection(picked)], falloff: 0.0 };
            let motion = Motion { pivot: (role == Role::Handle).then_some(middle), ..Motion::default() };
            regions.push(Region { role, shapes, motion });
        }
        self.change(at, Change::SetRegions(regions))
    }

    /// Samples that are farther from the selection than `band`, in the model's unit, along ways from
    /// neighbour to neighbour as a step finds them (E. W. Dijkstra, *A note on two problems in connexion
    /// with graphs*, 1959). Samples that are not connected with the selection are beyond, too.
    fn beyond(&self, before: &[Vec3], band: f64) -> Result<Selection> {
        let open = self.open()?;
        let positions = &*as_found(&open.scene, before).positions;
        let count = positions.len().min(open.scene.len());
        let neighbours = open.scene.sampled.samples.neighbours();
        let band = (band / open.scene.frame().scale) as f32;
        let mut distance = vec![f32::INFINITY; count];
        let mut next = BinaryHeap::new();
        for i in (0..count).filter(|i| self.selection.contains(*i as u32)) {
            distance[i] = 0.0;
            next.push(Reverse((0, i)));
        }
        while let Some(Reverse((reached, i))) = next.pop() {
            // Bits of floats that are not negative are in their order.
            if f32::from_bits(reached) > distance[i] {
                continue;
            }
            let around = neighbours.nearest_to(i).iter().take(RING).chain(open.adjacency.neighbours(i));
            for j in around.map(|j| *j as usize).filter(|j| *j < count) {
                let there = distance[i] + positions[i].distance(positions[j]);
                if there <= band && there < distance[j] {
                    distance[j] = there;
                    next.push(Reverse((there.to_bits(), j)));
                }
            }
        }
        let is_beyond = |i: usize| distance.get(i).is_some_and(|distance| distance.is_infinite());
        Ok(Selection::from_marks((0..self.selection.marks().len()).map(is_beyond).collect()))
    }

    pub(super) fn make_region(
        &mut self,
        at: usize,
        role: Role,
        falloff: f64,
        replaces: Option<usize>,
    ) -> Result<()> {
        let picked = self.picked(self.before(at)?, &self.selection)?;
        let mut regions = self.deformation(at)?.regions.clone();
        let middle = picked.inside().iter().sum::<DVec3>() / picked.inside().len() as f64;
        let shapes = Shapes { shapes: vec![RegionShape::Selection(picked)], falloff };
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
        let picked = self.picked(&open.scene.positions, &self.selection)?;
        let shapes = Shapes { shapes: vec![RegionShape::Selection(picked)], falloff: 0.0 };
        let refine = Refine { shapes, finer };
        refine.check()?;
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

    /// Largest balls inside of the model, as a step finds it, in model coordinates; empty where the model
    /// encloses nothing.
    pub fn body(&self, step: usize) -> Vec<Ball> {
        let (Ok(before), Some(scene)) = (self.before(step), self.scene()) else { return Vec::new() };
        let (samples, frame) = (&scene.sampled.samples, scene.frame());
        // The balls have moved until then about as the samples that are nearest to their middles.
        let moved = |ball: Ball| {
            let nearest = samples.nearest(ball.center.as_vec3()) as usize;
            let way = before.get(nearest).map_or(Vec3::ZERO, |to| *to - samples.positions[nearest]);
            let center = frame.to_model_exact(ball.center + way.as_dvec3());
            Ball { center, radius: ball.radius * frame.scale }
        };
        match self.body.as_ref().filter(|body| body.is_of(&scene.sampled)) {
            Some(body) => body.balls().iter().copied().map(moved).collect(),
            None => largest_balls(samples).into_iter().map(moved).collect(),
        }
    }

    /// Begins to find the middle of the body, where the chosen step takes joints and the middle is not
    /// known yet.
    pub(super) fn look_for_body(&mut self) {
        let (Some(step), Some(scene)) = (self.chosen(), self.scene()) else { return };
        let takes_joints = self
            .deformation(step)
            .ok()
            .and_then(|deformation| self.plugins().get(&deformation.deform).ok())
            .is_some_and(|plugin| plugin.consumes().joints);
        if takes_joints && self.body.as_ref().is_none_or(|body| !body.is_of(&scene.sampled)) {
            self.body = Some(InscribedBalls::find(&scene.sampled));
        }
    }

    /// Place of a point of the shown surface as a step finds the surface, for strokes and joints, in model
    /// coordinates.
    pub fn in_step(&self, step: usize, hit: &Hit) -> Option<DVec3> {
        let open = self.open.as_ref()?;
        let before = self.before(step).ok()?;
        // A sample that the step does not know yet goes along with a known one beside it.
        let sample = owner_of(&open.scene.sampled, hit.sample, before.len())?;
        let (scene, sample) = (&open.scene, sample as usize);
        let (was, is) = (before.get(sample)?, scene.positions.get(sample)?);
        Some(scene.frame().to_model_exact(hit.local - is.as_dvec3() + was.as_dvec3()))
    }

    /// Pivot of a handle region: that of its motion, or the middle of its samples, in model coordinates.
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

    /// Handles that a step's plugin placed, with their places; none where the step was not done yet.
    pub fn handles(&self, step: usize) -> Vec<(HandleDesc, PlacedHandle)> {
        let (Some(open), Ok(deformation)) = (&self.open, self.deformation(step)) else { return Vec::new() };
        let Some(OwnHandles { descs, .. }) = self.own_handles(step) else { return Vec::new() };
        let mut placed = placed_handles(descs, &deformation.handles, &open.scene.frame());
        let is_joint = |id: &str| deformation.joints.iter().any(|joint| joint.id == id);
        let is_moved = |id: &str| deformation.handles.iter().any(|handle| handle.id == id);
        // The handle for which a joint reaches is at the joint, as long as nobody moved it elsewhere.
        for i in (0..descs.len()).filter(|i| !is_joint(&descs[*i].id) && !is_moved(&descs[*i].id)) {
            let is_of = |joint: &HandleDesc| is_joint(&joint.id) && joint.position == descs[i].position;
            if descs[i].parent == HandleDesc::ROOT
                && let Some(joint) = descs.iter().position(is_of)
            {
                let way = self.joint_place(step, joint, &placed) - placed[i].rest;
                placed[i].map = DAffine3::from_translation(way);
            }
        }
        descs.iter().cloned().zip(placed).collect()
    }

    /// Place of a joint, in model coordinates: that of the body, if an end of the skeleton reaches for a
    /// place.
    fn joint_place(&self, step: usize, joint: usize, placed: &[PlacedHandle]) -> DVec3 {
        let frame = self.open.as_ref().map(|open| open.scene.frame());
        match (self.posed(step).and_then(|posed| posed.get(joint)), frame) {
            (Some(place), Some(frame)) => frame.to_model_exact(*place),
            _ => placed[joint].position(),
        }
    }

    /// Posed places of the handles that a step's plugin placed, in local coordinates, if the step has
    /// joints and an end of the skeleton reaches for a place. Nothing where the handles are at the places
    /// of their own motions.
    pub fn posed(&self, step: usize) -> Option<&[DVec3]> {
        let deformation = self.deformation(step).ok()?;
        let is_joint = |id: &str| deformation.joints.iter().any(|joint| joint.id == id);
        let is_above = |id: &str| deformation.joints.iter().any(|joint| joint.parent.as_deref() == Some(id));
        let reaches = |handle: &HandleMove| !is_joint(&handle.id) || !is_above(&handle.id);
        let is_reached_for = deformation.handles.iter().any(reaches);
        let (scene, id) = (&self.open.as_ref()?.scene, self.entry(step).ok()?.id);
        let posed = scene.posed.iter().find(|(of, _)| is_reached_for && *of == id)?;
        let handles = scene.handles.get(&id)?;
        (posed.1.len() == handles.descs.len()).then_some(&*posed.1)
    }

    /// Handles that a step's plugin placed, at rest, with the faces between them; none where the step was
    /// not done yet.
    pub fn own_handles(&self, step: usize) -> Option<&OwnHandles> {
        self.open.as_ref()?.scene.handles.get(&self.entry(step).ok()?.id).map(|handles| &**handles)
    }
}
