//! One layer of a stack: a plugin with its parameters, regions, joints, handles and strokes.

use super::rest::{LayerRest, Moment, RestShape, neighbour_lists, not_one_per_sample, rows};
use crate::deformer::{Fingerprint, Message, OwnHandles, Plugin, PluginWatch, SampleChecks};
use crate::key::Key;
use crate::migration::{in_its_words, migrated};
use crate::motion::to_local;
use crate::other_model::{OtherModel, stamps};
use crate::params::{LocalParams, ParamValue, Params, nearest};
use crate::plugins::PluginRegistry;
use crate::shapes::Shapes;
use crate::step::{Deformation, HandleMove, Joint, Notes, Role, Stroke};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use simod_core::attributes::SampleAttributes;
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::{Error, ErrorKind, Progress, Result, Type};
use simod_plugin_api as api;
use std::collections::HashMap;
use std::iter::repeat_n;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

#[derive(Debug)]
pub(crate) struct Layer {
    /// Place of the step in the session, for errors.
    pub place: String,
    pub plugin: Arc<Plugin>,
    /// Changes that were made when the step was brought up to the plugin.
    notes: Notes,
    /// Parameters as the session gives them, and (`params`) as they were checked.
    given: toml::Table,
    params: Arc<Params>,
    /// Fixed and handle regions.
    regions: Vec<(api::Role, Shapes)>,
    /// The handle regions' motions, model coordinates.
    transforms: Vec<DAffine3>,
    share: Share,
    /// Joints, each after the one that it hangs on.
    joints: Vec<Joint>,
    /// Motions of handles that the plugin places.
    handles: Vec<HandleMove>,
    /// The strokes, each with all parameters.
    strokes: Vec<(Arc<Stroke>, Arc<Params>)>,
}

/// The result of a layer on its rest shape.
#[derive(Debug)]
pub(crate) struct LayerResult {
    /// Deformed positions, local coordinates.
    pub positions: Arc<[Vec3]>,
    /// Messages of the plugin.
    pub messages: Vec<Message>,
    plugin: Arc<Plugin>,
    /// State that the plugin prepared; none where the plugin said that it would not move anything.
    preparation: Option<Arc<Preparation>>,
    rest: Arc<LayerRest>,
    motions: Motions,
    share: Share,
}

/// Share of the plugin's displacement that each point takes.
#[derive(Debug, Clone)]
struct Share {
    /// The amount of the step that is done, from 0 to 1.
    amount: f64,
    /// Regions in which the layer acts; it acts everywhere if there are none.
    masks: Vec<Shapes>,
}

impl Share {
    /// Whether the share is the whole displacement, everywhere.
    fn is_whole(&self) -> bool {
        self.amount == 1.0 && self.masks.is_empty()
    }

    /// The image of `p`, of which the plugin makes `q`; `at` is `p` in model coordinates.
    fn image(&self, at: DVec3, p: DVec3, q: DVec3) -> DVec3 {
        let masked = || self.masks.iter().map(|m| m.weight(at)).fold(0.0, f64::max);
        let weight = self.amount * if self.masks.is_empty() { 1.0 } else { masked() };
        // Exactly one of both where there is nothing to blend.
        if weight >= 1.0 { q } else { p + weight * (q - p) }
    }
}

/// The state that a plugin prepared.
#[derive(Debug)]
struct Preparation {
    state: api::State,
    rest: Arc<LayerRest>,
    /// Attributes of the samples, where the plugin asks for them.
    attributes: Option<Arc<SampleAttributes>>,
    /// Scratch of the plugin between deformations, which may go on where the last one stopped.
    scratch: Mutex<Option<api::Scratch>>,
    /// Fingerprint of the samples that the plugin finds and has to leave as they are; and (`unchecked`) the
    /// number of calls since all of them were compared.
    fingerprint: Option<Fingerprint>,
    unchecked: AtomicUsize,
    messages: Vec<Message>,
}

/// Most samples of which all are compared each time: that takes less than a tenth of a millisecond.
const FEW_SAMPLES: usize = 20_000;

impl Preparation {
    /// Checks that the plugin has not changed the samples that it was called with: later layers work on them,
    /// too. After a draft a part of them is compared, each in its turn, as comparing all takes as long as a
    /// quick deformation; and all with the result.
    ///
    /// # Errors
    /// The plugin has changed the samples.
    fn check_unchanged(&self, plugin: &Plugin, effort: api::Effort) -> Result<()> {
        let calls = self.unchecked.load(Ordering::Relaxed);
        let is_long = self.rest.positions.len() > FEW_SAMPLES;
        let of = match effort {
            _ if calls == 0 => return Ok(()),
            api::Effort::DRAFT if is_long => SampleChecks::Part(calls - 1),
            _ => SampleChecks::All,
        };
        plugin.check_unchanged(self.fingerprint.as_ref(), &self.rest.samples(), of)?;
        if effort != api::Effort::DRAFT {
            self.unchecked.store(0, Ordering::Relaxed);
        }
        Ok(())
    }
}

/// A layer's results, kept from one time to the next, each with a hash of all that it depends on.
#[derive(Debug, Default)]
pub(crate) struct LayerCache {
    placed: Option<(u64, Arc<OwnHandles>)>,
    others: Vec<(u64, Arc<OtherModel>)>,
    preparation: Option<(u64, Arc<Preparation>)>,
    strokes: Vec<(Arc<Stroke>, Arc<Params>, Arc<LocalStroke>)>,
    done: Option<(u64, Arc<LayerResult>)>,
    /// Result before the last one while something is dragged: the next one is written there, as it is not
    /// read any more. New memory takes the system as long as a quick deformation.
    spare: Option<Arc<[Vec3]>>,
}

impl LayerCache {
    /// The handles that the plugin placed the last time.
    pub fn handles(&self) -> Option<&Arc<OwnHandles>> {
        self.placed.as_ref().map(|(_, placed)| placed)
    }
}

/// Everything that moves without a new preparation, as plugins take it.
#[derive(Debug)]
struct Motions {
    params: LocalParams,
    /// Transforms, one for each handle region.
    transforms: Vec<api::Affine>,
    /// Motions, one for each handle that the plugin placed.
    handles: Vec<api::Affine>,
    strokes: Vec<Arc<LocalStroke>>,
    /// The effort, where the plugin asks for it.
    effort: Option<api::Effort>,
    /// The time, where the plugin asks for it.
    time: Option<api::Time>,
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

impl Layer {
    /// Checks a step at this place of the session. `before` is the layer of the step before it was edited:
    /// the parts that both share are not checked again.
    pub fn build(
        step: &Deformation,
        place: &str,
        registry: &PluginRegistry,
        before: Option<&Self>,
    ) -> Result<Self> {
        let plugin = registry.get(&step.deform).map_err(|e| match &step.plugin {
            Some(origin) => {
                let hint = format!("it was {origin}; install it and try again: {}", e.hint());
                e.hinting(hint)
            }
            None => e,
        })?;
        let now = migrated(step, plugin).map_err(|e| in_its_words(e, step, plugin))?;
        let layer = Self::for_step(now.as_ref().unwrap_or(step), place, plugin.clone(), before);
        layer.map_err(|e| in_its_words(e, step, plugin))
    }

    /// Layer of a step that is up to the plugin of now.
    fn for_step(step: &Deformation, place: &str, plugin: Arc<Plugin>, before: Option<&Self>) -> Result<Self> {
        let check = |given: &toml::Table| {
            Params::check(plugin.id(), plugin.params(), given, &step.folder).map(Arc::new)
        };
        let params = check(&step.params)?;
        let known = before.filter(|b| Arc::ptr_eq(&b.plugin, &plugin) && b.given == step.params);
        let known = known.map_or(&[][..], |b| &b.strokes);
        let stroke = |(i, stroke): (usize, &Arc<Stroke>)| match known.get(i) {
            Some((same, params)) if Arc::ptr_eq(same, stroke) => Ok((stroke.clone(), params.clone())),
            _ if stroke.params.is_empty() => Ok((stroke.clone(), params.clone())),
            _ => {
                let given = step.params.clone().into_iter().chain(stroke.params.clone()).collect();
                Ok((stroke.clone(), check(&given)?))
            }
        };
        let strokes = step.strokes.iter().enumerate().map(stroke).collect::<Result<_>>()?;
        let mut layer = Self {
            place: place.to_owned(),
            plugin,
            notes: step.notes.clone(),
            given: step.params.clone(),
            params,
            regions: Vec::new(),
            transforms: Vec::new(),
            share: Share { amount: step.amount, masks: Vec::new() },
            joints: step.joints.clone(),
            handles: step.handles.clone(),
            strokes,
        };
        for region in &step.regions {
            match region.role {
                Role::Mask => layer.share.masks.push(region.shapes.clone()),
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

    /// Parameters of the session, and defaults.
    pub fn params(&self) -> &Params {
        &self.params
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
                return Err(Error::argument(format!("plugin {id} uses no {name} regions"), hint));
            }
            if count < least as usize {
                let what = format!("plugin {id} needs {least} {name} region(s), not {count}");
                return Err(Error::argument(what, format!("add a [[step.region]] with role = \"{name}\"")));
            }
        }
        Ok(())
    }

    /// Checks that the session gives only what the plugin uses.
    fn check_used(&self) -> Result<()> {
        let consumes = self.plugin.consumes();
        let given = [
            (!self.joints.is_empty() && !consumes.joints, "joints", "joint"),
            (!self.handles.is_empty() && !self.plugin.capabilities().handles, "handles of its own", "handle"),
            (!self.strokes.is_empty() && !consumes.strokes, "strokes", "stroke"),
        ];
        match given.into_iter().find(|(unused, ..)| *unused) {
            None => Ok(()),
            Some((_, what, table)) => Err(Error::argument(
                format!("plugin {} has no {what}", self.plugin.id()),
                format!("remove the [[step.{table}]]"),
            )),
        }
    }

    /// Deforms a rest shape, as far as that has not been done before. Gives the next layer's rest shape, too.
    pub fn update(
        &self,
        rest: &Arc<LayerRest>,
        shape: &RestShape<'_>,
        kept: &mut LayerCache,
        moment: Moment,
        progress: &dyn Progress,
    ) -> Result<(Arc<LayerRest>, Arc<LayerResult>)> {
        let plugin = &self.plugin;
        if moment.effort != api::Effort::DRAFT {
            kept.spare = None;
        }
        let watch = PluginWatch::new(progress, plugin.id(), size_of_val(&*rest.positions) as u64);
        let motions = self.motions(rest, shape, kept, moment, &watch)?;
        let nothing = api::Samples::new(&[], &[], &[]);
        let is_identity = self.share.amount == 0.0
            || motions.call(nothing, rest.bounds, None, |input| plugin.is_identity(input, &watch))?;
        if is_identity {
            // Steps after this one need not be done again.
            let positions = rest.positions.clone();
            return Ok((rest.clone(), self.done(None, rest, positions, watch.into_messages(), motions)));
        }
        let preparation_key = self.preparation_key(rest.key);
        let key = motions.key(preparation_key).and(&self.share.masks).and(&self.share.amount).end();
        let done = match &kept.done {
            Some((known, done)) if *known == key => {
                if let Some(preparation) =
                    done.preparation.as_ref().filter(|_| moment.effort != api::Effort::DRAFT)
                {
                    preparation.check_unchanged(plugin, moment.effort)?;
                }
                done.clone()
            }
            _ => {
                let preparation = self.preparation(preparation_key, rest, shape, kept, progress)?;
                let done = self.deformed(preparation, motions, shape, kept, moment, watch)?;
                let former = kept.done.replace((key, done.clone()));
                let is_draft = moment.effort == api::Effort::DRAFT;
                kept.spare = former.filter(|_| is_draft).map(|(_, former)| former.positions.clone());
                done
            }
        };
        let positions = done.positions.clone();
        Ok((Arc::new(LayerRest { positions, normals_fit: false, key, ..(**rest).clone() }), done))
    }

    /// Calls the plugin to deform what it has prepared.
    fn deformed(
        &self,
        preparation: Arc<Preparation>,
        motions: Motions,
        shape: &RestShape<'_>,
        kept: &mut LayerCache,
        moment: Moment,
        watch: PluginWatch<'_>,
    ) -> Result<Arc<LayerResult>> {
        let images = unwritten(kept.spare.take(), preparation.rest.positions.len());
        let deformed = self.deform(&preparation, &motions, images, &shape.frame, moment, &watch);
        if deformed.as_ref().is_err_and(|e| e.kind() != ErrorKind::Cancelled) {
            // The process that it was in may have ended.
            kept.preparation = None;
        }
        let messages = preparation.messages.iter().cloned().chain(watch.into_messages()).collect();
        let rest = preparation.rest.clone();
        Ok(self.done(Some(preparation), &rest, deformed?, messages, motions))
    }

    /// Result of the layer, with the notes on the step before the messages of its plugin.
    fn done(
        &self,
        preparation: Option<Arc<Preparation>>,
        rest: &Arc<LayerRest>,
        positions: Arc<[Vec3]>,
        messages: Vec<Message>,
        motions: Motions,
    ) -> Arc<LayerResult> {
        let (plugin, share, rest) = (self.plugin.clone(), self.share.clone(), rest.clone());
        let notes = self.notes.iter().map(|note| self.told(note));
        let messages = notes.chain(messages).collect();
        Arc::new(LayerResult { positions, messages, plugin, preparation, rest, motions, share })
    }

    /// A note on the step, for users.
    fn told(&self, note: &str) -> Message {
        let place = if self.place.is_empty() { String::new() } else { format!("{}: ", self.place) };
        Message::warning(self.plugin.id(), format!("{place}{note}"))
    }

    /// State that the plugin prepared for this rest shape, or prepares now.
    fn preparation(
        &self,
        key: u64,
        rest: &Arc<LayerRest>,
        shape: &RestShape<'_>,
        kept: &mut LayerCache,
        progress: &dyn Progress,
    ) -> Result<Arc<Preparation>> {
        if let Some((_, preparation)) = kept.preparation.as_ref().filter(|(known, _)| *known == key) {
            return Ok(preparation.clone());
        }
        // Not two at a time, which may be large.
        (kept.preparation, kept.done, kept.spare) = (None, None, None);
        let others = self.other_models(shape, kept, progress)?;
        let rest = self.with_normals(rest, shape)?;
        let preparation = Arc::new(self.prepare(&rest, shape, &others, progress)?);
        kept.preparation = Some((key, preparation.clone()));
        Ok(preparation)
    }

    /// Other models that the user gave, by the parameters that name them: as read before, as long as their
    /// files are unchanged.
    fn other_models(
        &self,
        shape: &RestShape<'_>,
        kept: &mut LayerCache,
        progress: &dyn Progress,
    ) -> Result<Vec<(&str, Arc<OtherModel>)>> {
        let mut others = Vec::new();
        for d in self.plugin.params().iter().filter(|d| d.kind == api::ParamKind::MODEL) {
            let (Some(ParamValue::File(Some(path))), &[points]) =
                (self.params.get(&d.id), d.default_numbers.as_slice())
            else {
                continue;
            };
            let Frame { origin, scale } = shape.frame;
            let key = Key::from_key(0).and(path.as_path()).and(&stamps(path)).and(&points);
            let key = key.and(&origin).and(&scale).end();
            let model = match kept.others.iter().find(|(known, _)| *known == key) {
                Some((_, model)) => model.clone(),
                None => {
                    let read = OtherModel::read(path, points as u64, &shape.frame, shape.folder, progress);
                    Arc::new(read.map_err(|e| of_model(self.plugin.id(), &d.id, path, e))?)
                }
            };
            others.push((key, d.id.as_str(), model));
        }
        kept.others = others.iter().map(|(key, _, model)| (*key, model.clone())).collect();
        Ok(others.into_iter().map(|(_, id, model)| (id, model)).collect())
    }

    /// Rest shape with normals that fit, if the plugin needs them.
    fn with_normals(&self, rest: &Arc<LayerRest>, shape: &RestShape<'_>) -> Result<Arc<LayerRest>> {
        if !self.plugin.consumes().normals {
            return Ok(rest.clone());
        }
        if rest.normals.is_empty() {
            let what = format!("plugin {} needs normals, and the samples have none", self.plugin.id());
            return Err(Error::mismatch(what, "sample the model with normals"));
        }
        let Some(renormal) = shape.renormal.filter(|_| !rest.normals_fit) else { return Ok(rest.clone()) };
        let normals: Arc<[Vec3]> = renormal(&rest.positions).into();
        if normals.len() != rest.positions.len() {
            return Err(not_one_per_sample("normal"));
        }
        Ok(Arc::new(LayerRest { normals, normals_fit: true, ..(**rest).clone() }))
    }

    /// Key of all that a preparation depends on.
    fn preparation_key(&self, rest_key: u64) -> u64 {
        let prepares =
            |id: &str| self.plugin.params().iter().any(|d| d.id == id && d.invalidates_preparation);
        let params: Vec<_> = self.params.iter().filter(|(id, _)| prepares(id)).collect();
        let regions: Vec<_> = self.regions.iter().map(|(role, shapes)| (role.0, shapes)).collect();
        self.key(rest_key).and(&params).and(&regions).end()
    }

    /// Key of the rest shape and of all else that each call of the plugin may depend on: the plugin itself,
    /// the joints, and the content of files.
    fn key(&self, rest_key: u64) -> Key {
        let file = |value: &ParamValue| match value {
            ParamValue::File(Some(path)) => Some(stamps(path)),
            _ => None,
        };
        let files: Vec<_> = self.params.iter().filter_map(|(_, value)| file(value)).collect();
        // A plugin whose key is in use is alive, so that no other plugin has its address.
        Key::from_key(rest_key).and(&Arc::as_ptr(&self.plugin).addr()).and(&self.joints).and(&files)
    }

    /// Calls with the input of a preparation, in which nothing moves yet.
    fn prepare_input<T>(
        &self,
        rest: &LayerRest,
        shape: &RestShape<'_>,
        (regions, others): (&[api::Region<'_>], &[api::OtherModel<'_>]),
        call: impl FnOnce(&api::PrepareInput<'_>) -> T,
    ) -> T {
        let (frame, consumes) = (shape.frame, self.plugin.consumes());
        let params = self.params.to_local(&frame, &shape.bounds);
        let values = params.views();
        let joints = local_joints(&self.joints, &frame);
        let joints = api::Joints::new(&joints);
        let triangles = api::Triangles::new(shape.triangles);
        let lists = shape
            .neighbours
            .filter(|_| consumes.graph)
            .map(|neighbours| neighbour_lists(neighbours, rest.positions.len()));
        let graph = lists.as_ref().map(|(starts, neighbours)| api::Graph::new(starts, neighbours));
        let model_frame = api::ModelFrame { origin: frame.origin.to_array(), scale: frame.scale };
        let mut parts: Vec<api::Part<'_>> = graph.iter().map(api::Part::new).collect();
        if consumes.triangles && !shape.triangles.is_empty() {
            parts.push(api::Part::new(&triangles));
        }
        if consumes.joints {
            parts.push(api::Part::new(&joints));
        }
        if consumes.frame {
            parts.push(api::Part::new(&model_frame));
        }
        let at_rest = api::RestPositions::new(bytemuck::cast_slice(shape.positions));
        let attributes = consumes.attributes.then(|| attributes_of(shape.attributes));
        let attributes = attributes.as_deref().map(api::Attributes::new);
        parts.extend(attributes.iter().map(api::Part::new));
        if consumes.rest_positions && shape.positions.len() == rest.positions.len() {
            parts.push(api::Part::new(&at_rest));
        }
        let others = api::OtherModels::new(others);
        if !others.all().is_empty() {
            parts.push(api::Part::new(&others));
        }
        call(&api::PrepareInput::new(rest.samples(), rest.bounds, regions, &values).with_parts(&parts))
    }

    /// Everything that moves; the plugin is asked for the places of its handles.
    fn motions(
        &self,
        rest: &LayerRest,
        shape: &RestShape<'_>,
        kept: &mut LayerCache,
        moment: Moment,
        watch: &PluginWatch<'_>,
    ) -> Result<Motions> {
        let (frame, bounds) = (&shape.frame, &shape.bounds);
        let key = self.key(rest.key).and(&self.params).end();
        if kept.placed.as_ref().is_none_or(|(known, _)| *known != key) {
            let placed =
                self.prepare_input(rest, shape, (&[], &[]), |input| self.plugin.handles(input, watch))?;
            kept.placed = Some((key, Arc::new(placed)));
        }
        let local = |(i, (stroke, params)): (usize, &(Arc<Stroke>, Arc<Params>))| match kept.strokes.get(i) {
            Some(known) if Arc::ptr_eq(&known.0, stroke) && known.1 == *params => known.clone(),
            _ => {
                let local = Arc::new(LocalStroke::new(stroke, params, frame, bounds));
                (stroke.clone(), params.clone(), local)
            }
        };
        kept.strokes = self.strokes.iter().enumerate().map(local).collect();
        Ok(Motions {
            params: self.params.to_local(frame, bounds),
            transforms: self.transforms.iter().map(|&t| rows(to_local(t, frame))).collect(),
            handles: self.handle_motions(kept.handles().map_or(&[], |placed| &placed.descs), frame)?,
            strokes: kept.strokes.iter().map(|(.., local)| local.clone()).collect(),
            effort: self.plugin.consumes().effort.then_some(moment.effort),
            time: self.plugin.consumes().time.then_some(moment.time),
        })
    }

    fn prepare(
        &self,
        rest: &Arc<LayerRest>,
        shape: &RestShape<'_>,
        others: &[(&str, Arc<OtherModel>)],
        progress: &dyn Progress,
    ) -> Result<Preparation> {
        let watch = PluginWatch::new(progress, self.plugin.id(), size_of_val(&*rest.positions) as u64);
        let weigh = |shapes: &Shapes| -> Vec<f32> {
            rest.positions.par_iter().map(|p| shapes.weight(shape.frame.to_model(*p)) as f32).collect()
        };
        let weights: Vec<Vec<f32>> = self.regions.iter().map(|(_, shapes)| weigh(shapes)).collect();
        let regions: Vec<api::Region<'_>> =
            self.regions.iter().zip(&weights).map(|((role, _), w)| api::Region::new(*role, w)).collect();
        let others: Vec<api::OtherModel<'_>> =
            others.iter().map(|(param, model)| model.view(param)).collect();
        let given = (&regions[..], &others[..]);
        let state = self.prepare_input(rest, shape, given, |input| self.plugin.prepare(input, &watch))?;
        Ok(Preparation {
            state,
            rest: rest.clone(),
            attributes: shape.attributes.filter(|_| self.plugin.consumes().attributes).cloned(),
            scratch: Mutex::default(),
            fingerprint: self.plugin.fingerprint(&rest.samples()),
            unchecked: AtomicUsize::new(0),
            messages: watch.into_messages(),
        })
    }

    fn deform(
        &self,
        preparation: &Preparation,
        motions: &Motions,
        mut images: Arc<[Vec3]>,
        frame: &Frame,
        moment: Moment,
        watch: &PluginWatch<'_>,
    ) -> Result<Arc<[Vec3]>> {
        let rest = &preparation.rest;
        let shared = || Error::internal("what was just made has another owner");
        let out = Arc::get_mut(&mut images).ok_or_else(shared)?;
        let mut slot = preparation.scratch.lock().unwrap_or_else(PoisonError::into_inner);
        // The scratch is taken out of its place, to which it does not come back after a failure.
        let mut scratch = slot.take().map_or_else(|| self.plugin.new_scratch(), Ok)?;
        preparation.unchecked.fetch_add(1, Ordering::Relaxed);
        let done = motions.call(rest.samples(), rest.bounds, preparation.attributes.as_ref(), |input| {
            self.plugin.deform(&preparation.state, input, &mut scratch, bytemuck::cast_slice_mut(out), watch)
        });
        preparation.check_unchanged(&self.plugin, moment.effort)?;
        done?;
        *slot = Some(scratch);
        if !self.share.is_whole() {
            out.par_iter_mut().zip(&*rest.positions).for_each(|(q, p)| {
                let p = p.as_dvec3();
                *q = self.share.image(frame.to_model_exact(p), p, q.as_dvec3()).as_vec3();
            });
        }
        Ok(images)
    }

    /// Motions of the handles that the plugin placed, including those of the handles that they hang on; local
    /// coordinates.
    fn handle_motions(&self, placed: &[api::HandleDesc], frame: &Frame) -> Result<Vec<api::Affine>> {
        let known = |id: &str| placed.iter().any(|h| h.id == id);
        if let Some(unknown) = self.handles.iter().find(|h| !known(&h.id)) {
            let ids = placed.iter().map(|h| h.id.as_str());
            let hint = match nearest(&unknown.id, ids.clone()) {
                Some(near) => format!("did you mean `{near}`?"),
                None if placed.is_empty() => format!("with these parameters, {} has none", self.plugin.id()),
                None => format!("there are {}", listed(ids)),
            };
            return Err(Error::argument(
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

/// Positions of NaN, `count` of them, since none is written yet: in the memory of `spare`, if nobody else has
/// it.
fn unwritten(spare: Option<Arc<[Vec3]>>, count: usize) -> Arc<[Vec3]> {
    let mut spare = spare.filter(|spare| spare.len() == count);
    match spare.as_mut().and_then(Arc::get_mut) {
        Some(positions) => bytemuck::cast_slice_mut::<_, f32>(positions).fill(f32::NAN),
        None => return repeat_n(Vec3::NAN, count).collect(),
    }
    spare.unwrap_or_default()
}

/// Error of another model, with the plugin, the parameter that names the model, and its file.
fn of_model(plugin: &str, param: &str, path: &Path, e: Error) -> Error {
    if e.kind() == ErrorKind::Cancelled {
        return e;
    }
    let text = e.to_string();
    let name = path.display().to_string();
    let file = if text.contains(&name) { String::new() } else { format!("{name}: ") };
    e.saying(format!("{plugin}: parameter `{param}`: {file}{text}"))
}

/// Text of the first ids of a list that may be long, for messages.
fn listed<'a>(ids: impl Iterator<Item = &'a str> + Clone) -> String {
    const MOST: usize = 12;
    let mut text = ids.clone().take(MOST).collect::<Vec<_>>().join(", ");
    if ids.count() > MOST {
        text.push_str(", ...");
    }
    text
}

/// Attributes of the samples, as plugins have them.
fn attributes_of(all: Option<&Arc<SampleAttributes>>) -> Vec<api::Attribute<'_>> {
    let kind = |kind| match kind {
        Type::I8 => api::AttributeKind::I8,
        Type::U8 => api::AttributeKind::U8,
        Type::I16 => api::AttributeKind::I16,
        Type::U16 => api::AttributeKind::U16,
        Type::I32 => api::AttributeKind::I32,
        Type::U32 => api::AttributeKind::U32,
        Type::F32 => api::AttributeKind::F32,
        Type::F64 => api::AttributeKind::F64,
    };
    let all = all.map_or(&[][..], |all| all.all());
    all.iter()
        .map(|of| api::Attribute::new(&of.attribute.name, kind(of.attribute.kind), &of.values))
        .collect()
}

fn local_joints<'a>(joints: &'a [Joint], frame: &Frame) -> Vec<api::Joint<'a>> {
    let index: HashMap<&str, u32> = joints.iter().map(|j| j.id.as_str()).zip(0..).collect();
    let local = |j: &'a Joint| {
        let parent = j.parent.as_ref().and_then(|id| index.get(id.as_str()).copied());
        let parent = parent.unwrap_or(api::Joint::ROOT);
        api::Joint::new(&j.id, frame.to_local_exact(j.at).to_array(), parent)
    };
    joints.iter().map(local).collect()
}

impl LocalStroke {
    fn new(stroke: &Stroke, params: &Params, frame: &Frame, bounds: &Bounds) -> Self {
        let mut this = Self {
            key: 0,
            radius: stroke.radius / frame.scale,
            strength: stroke.strength,
            points: stroke.points.iter().map(|p| frame.to_local_exact(*p).to_array()).collect(),
            pressures: stroke.pressures.clone(),
            params: params.to_local(frame, bounds),
        };
        let LocalStroke { radius, strength, points, pressures, params, .. } = &this;
        let key = Key::from_key(0).and(&[*radius, *strength]).and(points).and(pressures).and(params);
        this.key = key.end();
        this
    }
}

impl Motions {
    /// Key of all motions.
    fn key(&self, former: u64) -> Key {
        let strokes: Vec<u64> = self.strokes.iter().map(|s| s.key).collect();
        let Self { params, transforms, handles, effort, time, .. } = self;
        Key::from_key(former).and(params).and(transforms).and(handles).and(&strokes).and(effort).and(time)
    }

    /// Calls with the input of a deformation.
    fn call<T>(
        &self,
        samples: api::Samples<'_>,
        bounds: api::Bounds,
        attributes: Option<&Arc<SampleAttributes>>,
        call: impl FnOnce(&api::DeformInput<'_>) -> T,
    ) -> T {
        let values = self.params.views();
        let params: Vec<_> = self.strokes.iter().map(|s| s.params.views()).collect();
        let stroke = |(s, params)| {
            let s: &Arc<LocalStroke> = s;
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
        parts.extend(self.effort.iter().map(api::Part::new));
        parts.extend(self.time.iter().map(api::Part::new));
        let attributes = attributes.map(|all| attributes_of(Some(all)));
        let attributes = attributes.as_deref().map(api::Attributes::new);
        parts.extend(attributes.iter().map(api::Part::new));
        call(&api::DeformInput::new(samples, bounds, &self.transforms, &values).with_parts(&parts))
    }
}

impl LayerResult {
    /// Whether the layer's map is known at any point of space.
    pub fn can_evaluate(&self) -> bool {
        self.preparation.is_none() || self.plugin.capabilities().evaluate
    }

    /// The plugin's id.
    pub fn id(&self) -> &str {
        self.plugin.id()
    }

    /// Replaces local points by their images.
    pub fn evaluate(&self, frame: &Frame, points: &mut [DVec3], watch: &PluginWatch<'_>) -> Result<()> {
        let Some(preparation) = &self.preparation else { return Ok(()) };
        let rest: Vec<DVec3> = if self.share.is_whole() { Vec::new() } else { points.to_vec() };
        let buffer = bytemuck::cast_slice_mut(points);
        let attributes = preparation.attributes.as_ref();
        self.motions.call(self.rest.samples(), self.rest.bounds, attributes, |input| {
            self.plugin.evaluate(&preparation.state, input, buffer, watch)
        })?;
        for (q, p) in points.iter_mut().zip(rest) {
            *q = self.share.image(frame.to_model_exact(p), p, *q);
        }
        Ok(())
    }
}
