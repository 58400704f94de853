//! One layer of a stack: a plugin with its parameters, regions, joints, handles and strokes.

use super::{Rest, RestShape, neighbour_lists, rows};
use crate::deformer::{Plugin, Watch};
use crate::motion::to_local;
use crate::params::{LocalParams, Params, nearest};
use crate::plugins::PluginRegistry;
use crate::session_file::{HandleMove, Joint, Role, Step, Stroke};
use crate::shapes::Shapes;
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use simod_core::frame::Frame;
use simod_core::geometry::Bounds;
use simod_core::{Error, ErrorKind, Result};
use simod_plugin_api as api;
use std::sync::Arc;
use xxhash_rust::xxh3::Xxh3Default;

#[derive(Debug)]
pub(super) struct Layer {
    /// Where in the session it stands; for errors.
    pub place: String,
    pub plugin: Arc<Plugin>,
    params: Params,
    /// Fixed and handle regions.
    regions: Vec<(api::Role, Shapes)>,
    /// The handle regions' motions, model coordinates.
    transforms: Vec<DAffine3>,
    /// Where the layer acts; everywhere if there is none.
    masks: Vec<Shapes>,
    /// Each after the one that it hangs on.
    joints: Vec<Joint>,
    /// Motions of handles that the plugin places.
    handles: Vec<HandleMove>,
    /// Each with all parameters.
    strokes: Vec<(Arc<Stroke>, Params)>,
}

/// One layer, prepared on its rest shape.
#[derive(Debug)]
pub(super) struct PreparedLayer {
    plugin: Arc<Plugin>,
    /// Nothing where the plugin said that it would not move anything.
    state: Option<api::State>,
    rest: Rest,
    motions: Motions,
    masks: Vec<Shapes>,
}

/// All that moves, without a new preparation, as plugins take it.
#[derive(Debug)]
struct Motions {
    params: LocalParams,
    /// One for each handle region.
    transforms: Vec<api::Affine>,
    /// One for each handle that the plugin placed.
    handles: Vec<api::Affine>,
    strokes: Vec<LocalStroke>,
}

/// A stroke in local coordinates.
#[derive(Debug)]
struct LocalStroke {
    key: u64,
    radius: f64,
    strength: f64,
    points: Vec<[f64; 3]>,
    pressures: Vec<f32>,
    params: LocalParams,
}

fn argument(what: String, hint: impl Into<String>) -> Error {
    Error::new(ErrorKind::Argument, what, hint)
}

impl Layer {
    pub fn build(step: &Step, registry: &PluginRegistry) -> Result<Self> {
        let plugin = registry.get(&step.deform)?.clone();
        let check = |given: &toml::Table| Params::check(plugin.id(), plugin.params(), given, &step.folder);
        let params = check(&step.params)?;
        let stroke = |stroke: &Arc<Stroke>| {
            let given = step.params.clone().into_iter().chain(stroke.params.clone()).collect();
            Ok((stroke.clone(), check(&given)?))
        };
        let strokes = step.strokes.iter().map(stroke).collect::<Result<_>>()?;
        let mut layer = Self {
            place: step.place.clone(),
            plugin,
            params,
            regions: Vec::new(),
            transforms: Vec::new(),
            masks: Vec::new(),
            joints: step.joints.clone(),
            handles: step.handles.clone(),
            strokes,
        };
        for region in &step.regions {
            match region.role {
                Role::Mask => layer.masks.push(region.shapes.clone()),
                Role::Fixed => layer.regions.push((api::Role::FIXED, region.shapes.clone())),
                Role::Handle => {
                    layer.regions.push((api::Role::HANDLE, region.shapes.clone()));
                    layer.transforms.push(region.motion.to_affine(DVec3::ZERO));
                }
            }
        }
        layer.check_regions()?;
        layer.check_used()?;
        Ok(layer)
    }

    fn check_regions(&self) -> Result<()> {
        let (id, consumes) = (self.plugin.id(), self.plugin.consumes());
        let roles = [
            (api::Role::FIXED, "fixed", consumes.fixed_regions, consumes.min_fixed),
            (api::Role::HANDLE, "handle", consumes.handle_regions, consumes.min_handles),
        ];
        for (role, name, used, least) in roles {
            let count = self.regions.iter().filter(|r| r.0 == role).count();
            if count > 0 && !used {
                let hint = "remove the region; to limit where the step acts, use role = \"mask\"";
                return Err(argument(format!("plugin {id} uses no {name} regions"), hint));
            }
            if count < least as usize {
                let what = format!("plugin {id} needs {least} {name} region(s), not {count}");
                return Err(argument(what, format!("add a [[step.region]] with role = \"{name}\"")));
            }
        }
        Ok(())
    }

    /// What the plugin does not use is not given to it.
    fn check_used(&self) -> Result<()> {
        let consumes = self.plugin.consumes();
        let given = [
            (!self.joints.is_empty() && !consumes.joints, "joints", "joint"),
            (!self.handles.is_empty() && !self.plugin.capabilities().handles, "handles of its own", "handle"),
            (!self.strokes.is_empty() && !consumes.strokes, "strokes", "stroke"),
        ];
        match given.into_iter().find(|(unused, ..)| *unused) {
            None => Ok(()),
            Some((_, what, table)) => Err(argument(
                format!("plugin {} has no {what}", self.plugin.id()),
                format!("remove the [[step.{table}]]"),
            )),
        }
    }

    pub fn apply(
        &self,
        rest: Rest,
        shape: &RestShape<'_>,
        watch: &Watch<'_>,
    ) -> Result<(PreparedLayer, Vec<Vec3>)> {
        if self.plugin.consumes().normals && rest.normals.is_empty() {
            let what = format!("plugin {} needs normals, and the samples have none", self.plugin.id());
            return Err(Error::new(ErrorKind::Mismatch, what, "sample the model with normals"));
        }
        let frame = shape.frame;
        let params = self.params.to_local(&frame, &shape.bounds);
        let values = params.views();
        let joints = local_joints(&self.joints, &frame);
        let joints = api::Joints::new(&joints);
        let triangles = api::Triangles::new(shape.triangles);
        let lists = shape
            .neighbours
            .filter(|_| self.plugin.consumes().graph)
            .map(|n| neighbour_lists(n, rest.positions.len()));
        let graph = lists.as_ref().map(|(starts, neighbours)| api::Graph::new(starts, neighbours));
        let mut parts: Vec<api::Part<'_>> = graph.iter().map(api::Part::new).collect();
        if self.plugin.consumes().triangles && !shape.triangles.is_empty() {
            parts.push(api::Part::new(&triangles));
        }
        if self.plugin.consumes().joints {
            parts.push(api::Part::new(&joints));
        }
        let model_frame = api::ModelFrame { origin: frame.origin.to_array(), scale: frame.scale };
        if self.plugin.consumes().frame {
            parts.push(api::Part::new(&model_frame));
        }
        let input = api::PrepareInput::new(rest.samples(), rest.bounds, &[], &values).with_parts(&parts);
        let motions = Motions {
            transforms: self.transforms.iter().map(|&t| rows(to_local(t, &frame))).collect(),
            handles: self.handle_motions(&self.plugin.handles(&input, watch)?, &frame)?,
            strokes: self.strokes.iter().map(|s| LocalStroke::new(s, &frame, &shape.bounds)).collect(),
            params: params.clone(),
        };
        let plugin = self.plugin.clone();
        let nothing = api::Samples::new(&[], &[], &[]);
        let is_identity = motions.call(nothing, rest.bounds, |input| plugin.is_identity(input))?;
        let state = if is_identity {
            None
        } else {
            let weigh = |shapes: &Shapes| -> Vec<f32> {
                rest.positions.par_iter().map(|p| shapes.weight(frame.to_model(*p)) as f32).collect()
            };
            let weights: Vec<Vec<f32>> = self.regions.iter().map(|(_, shapes)| weigh(shapes)).collect();
            let regions: Vec<api::Region<'_>> =
                self.regions.iter().zip(&weights).map(|((role, _), w)| api::Region::new(*role, w)).collect();
            let input =
                api::PrepareInput::new(rest.samples(), rest.bounds, &regions, &values).with_parts(&parts);
            Some(plugin.prepare(&input, watch)?)
        };
        let prepared = PreparedLayer { plugin, state, rest, motions, masks: self.masks.clone() };
        let deformed = prepared.deform(&frame, watch)?;
        Ok((prepared, deformed))
    }

    /// The motions of the handles that the plugin placed, those of what they hang on included; local coordinates.
    fn handle_motions(&self, placed: &[api::HandleDesc], frame: &Frame) -> Result<Vec<api::Affine>> {
        let known = |id: &str| placed.iter().any(|h| h.id == id);
        if let Some(unknown) = self.handles.iter().find(|h| !known(&h.id)) {
            let ids = placed.iter().map(|h| h.id.as_str());
            let hint = match nearest(&unknown.id, ids.clone()) {
                Some(near) => format!("did you mean `{near}`?"),
                None if placed.is_empty() => format!("with these parameters, {} has none", self.plugin.id()),
                None => format!("there are {}", listed(ids)),
            };
            return Err(argument(
                format!("plugin {} has no handle `{}`", self.plugin.id(), unknown.id),
                hint,
            ));
        }
        let mut totals: Vec<DAffine3> = Vec::with_capacity(placed.len());
        for handle in placed {
            let own = self.handles.iter().find(|h| handle.id == h.id.as_str()).map(|h| {
                to_local(h.motion.to_affine(frame.to_model_exact(DVec3::from(handle.position))), frame)
            });
            let parent = totals.get(handle.parent as usize);
            totals.push(match (parent, own) {
                (Some(parent), Some(own)) => *parent * own,
                (Some(one), None) => *one,
                (None, own) => own.unwrap_or(DAffine3::IDENTITY),
            });
        }
        Ok(totals.into_iter().map(rows).collect())
    }
}

/// Some ids of a list that may be long.
fn listed<'a>(ids: impl Iterator<Item = &'a str> + Clone) -> String {
    const MOST: usize = 12;
    let mut text = ids.clone().take(MOST).collect::<Vec<_>>().join(", ");
    if ids.count() > MOST {
        text.push_str(", ...");
    }
    text
}

fn local_joints<'a>(joints: &'a [Joint], frame: &Frame) -> Vec<api::Joint<'a>> {
    let index = |id: &String| joints.iter().position(|j| j.id == *id).map(|i| i as u32);
    let local = |j: &'a Joint| {
        let parent = j.parent.as_ref().and_then(index).unwrap_or(api::Joint::ROOT);
        api::Joint::new(&j.id, frame.to_local_exact(j.at).to_array(), parent)
    };
    joints.iter().map(local).collect()
}

impl LocalStroke {
    fn new((stroke, params): &(Arc<Stroke>, Params), frame: &Frame, bounds: &Bounds) -> Self {
        let mut this = Self {
            key: 0,
            radius: stroke.radius / frame.scale,
            strength: stroke.strength,
            points: stroke.points.iter().map(|p| frame.to_local_exact(*p).to_array()).collect(),
            pressures: stroke.pressures.clone(),
            params: params.to_local(frame, bounds),
        };
        let mut hash = Xxh3Default::new();
        hash.update(bytemuck::bytes_of(&[this.radius, this.strength]));
        hash.update(bytemuck::cast_slice(&this.points));
        hash.update(bytemuck::cast_slice(&this.pressures));
        std::hash::Hash::hash(&this.params, &mut hash);
        this.key = hash.digest();
        this
    }
}

impl Motions {
    /// Calls with what a deformation gets.
    fn call<T>(
        &self,
        samples: api::Samples<'_>,
        bounds: api::Bounds,
        call: impl FnOnce(&api::DeformInput<'_>) -> T,
    ) -> T {
        let values = self.params.views();
        let params: Vec<_> = self.strokes.iter().map(|s| s.params.views()).collect();
        let stroke = |(s, params)| {
            let s: &LocalStroke = s;
            api::Stroke::new(s.key, s.radius, s.strength, &s.points, &s.pressures, params)
        };
        let strokes: Vec<api::Stroke<'_>> =
            self.strokes.iter().zip(params.iter().map(Vec::as_slice)).map(stroke).collect();
        let strokes = api::Strokes::new(&strokes);
        let handles = api::HandleMotions::new(&self.handles);
        let mut parts = Vec::new();
        if !self.handles.is_empty() {
            parts.push(api::Part::new(&handles));
        }
        if !self.strokes.is_empty() {
            parts.push(api::Part::new(&strokes));
        }
        call(&api::DeformInput::new(samples, bounds, &self.transforms, &values).with_parts(&parts))
    }
}

impl PreparedLayer {
    /// Whether its map is known at any point of space.
    pub fn can_evaluate(&self) -> bool {
        self.state.is_none() || self.plugin.capabilities().evaluate
    }

    /// The plugin's id.
    pub fn id(&self) -> &str {
        self.plugin.id()
    }

    fn deform(&self, frame: &Frame, watch: &Watch<'_>) -> Result<Vec<Vec3>> {
        let rest = &self.rest.positions;
        let Some(state) = &self.state else { return Ok(rest.clone()) };
        let mut out = vec![Vec3::NAN; rest.len()];
        let mut scratch = self.plugin.new_scratch()?;
        let buffer = bytemuck::cast_slice_mut(&mut out);
        self.motions.call(self.rest.samples(), self.rest.bounds, |input| {
            self.plugin.deform(state, input, &mut scratch, buffer, watch)
        })?;
        if !self.masks.is_empty() {
            out.par_iter_mut().zip(rest).for_each(|(q, p)| {
                let p = p.as_dvec3();
                *q = self.masked(frame.to_model_exact(p), p, q.as_dvec3()).as_vec3();
            });
        }
        Ok(out)
    }

    /// Replaces local points by their images.
    pub fn evaluate(&self, frame: &Frame, points: &mut [DVec3], watch: &Watch<'_>) -> Result<()> {
        let Some(state) = &self.state else { return Ok(()) };
        let rest: Vec<DVec3> = if self.masks.is_empty() { Vec::new() } else { points.to_vec() };
        let buffer = bytemuck::cast_slice_mut(points);
        self.motions.call(self.rest.samples(), self.rest.bounds, |input| {
            self.plugin.evaluate(state, input, buffer, watch)
        })?;
        for (q, p) in points.iter_mut().zip(rest) {
            *q = self.masked(frame.to_model_exact(p), p, *q);
        }
        Ok(())
    }

    /// The image `q` of `p` as far as the masks let it; `at` is `p` in model coordinates.
    fn masked(&self, at: DVec3, p: DVec3, q: DVec3) -> DVec3 {
        let weight = self.masks.iter().map(|m| m.weight(at)).fold(0.0, f64::max);
        // Exactly one of both where there is nothing to blend.
        if weight >= 1.0 { q } else { p + weight * (q - p) }
    }
}
