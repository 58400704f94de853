//! Evaluation of the steps of an edit on a sampled model: each step is done again only where it, or a step
//! before it, has changed.

use super::around::Around;
use super::entry::{Entry, StepId};
use crate::deformer::{Message, OwnHandles, PluginWatch};
use crate::key::Key;
use crate::plugins::PluginRegistry;
use crate::refining::{Room, ShapePose};
use crate::sidecar;
use crate::stack::{Layer, LayerCache, LayerRest, LayerResult, Moment, PreparedStack, RestShape, located};
use crate::step::{Action, Deformation, Refine, Step};
use glam::{DVec3, Mat3, Vec3};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::{
    DeformationField, Method, Reconstructed, Reconstruction, RestGeometry, Version, deformed_normals,
    known_gradients, reconstruct,
};
use simod_core::refinement::{Finer, SamplesNeed, appended_deformed};
use simod_core::sampled_model::SampledModel;
use simod_model::follow::Follow;
use simod_model::{Error, ErrorKind, Model, Progress, Result};
use simod_plugin_api::{Effort, Time};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The state of a step after an evaluation.
#[derive(Debug)]
pub enum Status {
    /// The step is switched off.
    Off,
    /// The step was done, with the messages of the plugin.
    Done(Vec<Message>),
    /// The step could not be done. The samples are those after the steps before it.
    Failed(Error),
    /// A step before this one could not be done.
    Waiting,
}

impl Status {
    /// Status of a step that was done, or tried.
    ///
    /// # Errors
    /// The user cancelled.
    fn from_run(step: &Step, run: Result<Vec<Message>>) -> Result<Self> {
        match run {
            Ok(messages) => Ok(Self::Done(messages)),
            Err(e) if e.kind() == ErrorKind::Cancelled => Err(e),
            Err(e) => Ok(Self::Failed(located(step.place_of(&e), e))),
        }
    }
}

/// Result of the steps on the samples.
pub struct Evaluated {
    /// The model with its samples at rest, those of refinements among them.
    pub sampled: Arc<SampledModel>,
    /// Local positions after the last step that was done, one for each sample.
    pub positions: Arc<[Vec3]>,
    /// Status of each step, in their order.
    pub statuses: Vec<(StepId, Status)>,
    /// Positions to which the steps of plugins that take joints move the handles that they placed: local
    /// coordinates, one for each handle. None of steps whose map is not known.
    pub posed: Vec<(StepId, Arc<[DVec3]>)>,
    /// Positions that each step began with, up to the one that failed, in their order: local positions, of
    /// fewer samples if refinements follow. The step's regions, strokes and joints are in that space.
    pub before: Vec<Arc<[Vec3]>>,
    /// The exact map of the steps that were done, where all plugins know it.
    pub stack: PreparedStack,
}

impl Evaluated {
    /// The first step that could not be done, if any.
    pub fn failure(&self) -> Option<(StepId, &Error)> {
        self.statuses.iter().find_map(|(id, status)| match status {
            Status::Failed(error) => Some((*id, error)),
            _ => None,
        })
    }

    /// Returns the result with notices that users should know of the plugins that did the steps: see
    /// [`PluginRegistry::notices`].
    #[must_use]
    pub fn with_notices(mut self, steps: &[Entry], registry: &PluginRegistry) -> Self {
        for (id, status) in &mut self.statuses {
            let (Status::Done(messages), Some(Entry { step, .. })) =
                (status, steps.iter().find(|entry| entry.id == *id))
            else {
                continue;
            };
            let notices = registry.notices(std::slice::from_ref(&**step));
            messages.splice(..0, notices.into_iter().map(|text| Message::warning(step.name(), text)));
        }
        self
    }

    /// Deformed samples, rounded as a file holds them. Where all of them go far, positions that plugins give
    /// in single precision are coarse: where all plugins know their map, it is evaluated in double precision
    /// instead.
    ///
    /// # Errors
    /// A plugin fails; the user cancelled.
    pub fn rounded(&self, progress: &dyn Progress) -> Result<DeformedPositions> {
        let Self { sampled, positions, stack, .. } = self;
        let deformed = sampled.rounded(positions);
        if deformed.is_unshifted() || !stack.can_evaluate() {
            return Ok(deformed);
        }
        let rest = sampled.samples.positions.iter().map(|p| sampled.frame.to_model(*p));
        let mut places: Vec<DVec3> = rest.collect();
        stack.evaluate_with(&mut places, progress)?;
        Ok(sampled.rounded_places(places))
    }

    /// Writes the deformed model, whole or not at all. `model` is the model's path, if it was moved since it
    /// was sampled, and `follow` has the rules for attributes that turn with the surface.
    ///
    /// # Errors
    /// A step could not be done; the model or the file cannot be read or written; the user cancelled.
    pub fn write(
        mut self,
        model: Option<&Path>,
        follow: &Follow,
        output: &Path,
        how: &Reconstruction<'_>,
        progress: &dyn Progress,
    ) -> Result<Reconstructed> {
        messages(std::mem::take(&mut self.statuses))?;
        let mut model = self.sampled.open_source(model, progress)?;
        sidecar::follow(&mut *model, follow)?;
        let deformed = self.rounded(progress)?;
        let version = Version { deformed: &deformed, output, diagnostics: None };
        let known = turning_gradients(&self.sampled, &self.stack, model.as_ref(), progress)?;
        let how = Reconstruction { gradients: known.as_deref(), ..*how };
        reconstruct(&self.sampled, model.as_ref(), &[version], &how, progress)
    }
}

/// Gradients at the samples, where any attribute of the model turns by them and all plugins know their map.
///
/// # Errors
/// A plugin fails; the user cancelled.
pub fn turning_gradients(
    sampled: &SampledModel,
    stack: &PreparedStack,
    model: &dyn Model,
    progress: &dyn Progress,
) -> Result<Option<Vec<Mat3>>> {
    if model.following().is_none() || !stack.can_evaluate() {
        return Ok(None);
    }
    let map = |points: &mut [DVec3]| stack.evaluate_with(points, progress);
    known_gradients(sampled, &map).map(Some)
}

/// Messages of the plugins.
///
/// # Errors
/// The first step that could not be done.
pub(crate) fn messages(statuses: Vec<(StepId, Status)>) -> Result<Vec<Message>> {
    let mut messages = Vec::new();
    for (_, status) in statuses {
        match status {
            Status::Done(said) => messages.extend(said),
            Status::Failed(error) => return Err(error),
            Status::Off | Status::Waiting => {}
        }
    }
    Ok(messages)
}

/// Evaluation that does steps again and again, and keeps of each step the data that the next time may need:
/// the state that the plugin prepared, and the positions.
///
/// Memory: that of the plugins, 28 bytes a sample, and 12 a sample and step, twice as many for steps that a
/// drag moves; a copy of the samples for each refinement. Memory of steps that are gone, or switched off, is
/// freed.
pub struct Evaluation {
    sampled: Arc<SampledModel>,
    /// Positions of the samples before the first step, local coordinates, if not at rest.
    start: Option<Arc<[Vec3]>>,
    /// Rest shape of the first step, from the first time on.
    beginning: Option<Arc<LayerRest>>,
    how: Refinements,
    known: HashMap<StepId, StepState>,
    at: Arc<AtomicUsize>,
}

/// Options of refinement steps: the model that they read again, memory and temporary files, and the time.
#[derive(Debug, Clone, Default)]
pub struct Refinements {
    /// Path of the model, if it was moved since it was sampled.
    pub model: Option<PathBuf>,
    /// Folder in which temporary files without a name are made.
    pub folder: PathBuf,
    /// Bytes of memory to stay below; as for sampling where not given.
    pub memory_limit: Option<u64>,
    /// Time for plugins that take it.
    pub time: Time,
}

/// State of a step as it was done last.
enum StepState {
    Deform {
        step: Arc<Step>,
        layer: Box<Layer>,
        kept: LayerCache,
    },
    Refine {
        key: u64,
        before: Arc<SampledModel>,
        after: Arc<SampledModel>,
        rest: Arc<LayerRest>,
        /// Weights for drafts, from the first draft on.
        around: Option<Arc<Around>>,
    },
}

/// The samples between two steps.
#[derive(Clone)]
struct Between {
    sampled: Arc<SampledModel>,
    rest: Arc<LayerRest>,
}

impl Evaluation {
    /// Evaluation that has done nothing yet. If there are steps that refine, the model has to [hold its
    /// cells](SampledModel::hold_cells).
    pub fn new(sampled: Arc<SampledModel>, how: Refinements) -> Self {
        Self { sampled, start: None, beginning: None, how, known: HashMap::new(), at: Arc::default() }
    }

    /// An evaluation of samples that something else has moved before the first step: finite local positions,
    /// one for each.
    ///
    /// # Errors
    /// There are more positions than samples, or less.
    pub fn starting_at(self, positions: Arc<[Vec3]>) -> Result<Self> {
        let (there, samples) = (positions.len(), self.sampled.samples.len());
        if there != samples {
            let what = format!("there are {there} positions of {samples} samples");
            return Err(Error::mismatch(what, "give one for each sample"));
        }
        Ok(Self { start: Some(positions), beginning: None, ..self })
    }

    /// Evaluation of other steps on the same samples, which has done nothing yet.
    pub fn another(&self) -> Self {
        Self::new(self.sampled.clone(), self.how.clone())
    }

    /// Goes to another time of a sequence: steps of plugins that take the time are done anew.
    pub fn set_time(&mut self, time: Time) {
        self.how.time = time;
    }

    /// The place of the step that is being done, to be looked at from other threads.
    pub fn place(&self) -> &Arc<AtomicUsize> {
        &self.at
    }

    /// The samples at rest, without those of refinements.
    pub fn sampled(&self) -> &Arc<SampledModel> {
        &self.sampled
    }

    /// Does the steps. With [`Effort::DRAFT`], plugins that know a quicker way take it, and refinements that
    /// were done before take the same samples again, though others may be selected by now.
    ///
    /// # Errors
    /// The user cancelled, or the samples cannot be deformed at all. What fails in a step is in its status.
    pub fn update(
        &mut self,
        steps: &[Entry],
        registry: &PluginRegistry,
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<Evaluated> {
        let mut between = Between { sampled: self.sampled.clone(), rest: self.beginning()? };
        let (mut layers, mut posed) = (Vec::new(), Vec::new());
        let (mut statuses, mut before) = (Vec::with_capacity(steps.len()), Vec::with_capacity(steps.len()));
        let mut failed = false;
        self.known.retain(|id, _| steps.iter().any(|e| e.id == *id && e.step.enabled));
        for (place, Entry { id, step }) in steps.iter().enumerate() {
            self.at.store(place, Ordering::Relaxed);
            if !failed {
                before.push(between.rest.positions.clone());
            }
            let mut run = || -> Result<Vec<Message>> {
                match &step.action {
                    Action::Deform(_) => {
                        let (rest, done) = self.deform(*id, step, &between, registry, effort, progress)?;
                        between.rest = rest;
                        posed.extend(self.posed(*id, &done, progress).map(|places| (*id, places)));
                        layers.push(done.clone());
                        Ok(done.messages.clone())
                    }
                    Action::Refine(refine) => {
                        between = self.refine(*id, refine, &between, effort, progress)?;
                        Ok(Vec::new())
                    }
                }
            };
            let status = match step.enabled {
                false => Status::Off,
                true if failed => Status::Waiting,
                true => Status::from_run(step, run())?,
            };
            failed |= matches!(status, Status::Failed(_));
            statuses.push((*id, status));
        }
        let stack = PreparedStack { layers, frame: self.sampled.frame };
        let Between { sampled, rest } = between;
        Ok(Evaluated { sampled, positions: rest.positions.clone(), statuses, posed, before, stack })
    }

    /// Rest shape of the first step: made once, as a drag asks for it in each picture.
    ///
    /// # Errors
    /// The samples cannot be deformed at all.
    fn beginning(&mut self) -> Result<Arc<LayerRest>> {
        if let Some(rest) = &self.beginning {
            return Ok(rest.clone());
        }
        let start = self.start.clone();
        let rest = with_shape(&self.sampled, |shape| match start {
            // Key of the start, which is the same each time.
            Some(positions) => shape.rest_at(positions, 1),
            None => shape.rest(0),
        })?;
        Ok(self.beginning.insert(Arc::new(rest)).clone())
    }

    /// The handles that a step's plugin placed the last time, local coordinates; none where it was not done
    /// yet.
    pub fn handles(&self, id: StepId) -> Option<&Arc<OwnHandles>> {
        match self.known.get(&id) {
            Some(StepState::Deform { kept, .. }) => kept.handles(),
            _ => None,
        }
    }

    /// Positions of the handles that a step's plugin placed, after the step, if the plugin takes joints: an
    /// end that reaches for a place bends the bones above it, whose handles have not moved.
    fn posed(&self, id: StepId, done: &LayerResult, progress: &dyn Progress) -> Option<Arc<[DVec3]>> {
        let handles = self.handles(id).filter(|handles| !handles.descs.is_empty())?;
        let Some(StepState::Deform { layer, .. }) = self.known.get(&id) else { return None };
        if !layer.plugin.consumes().joints || !done.can_evaluate() {
            return None;
        }
        let mut places: Vec<DVec3> = handles.descs.iter().map(|desc| DVec3::from(desc.position)).collect();
        let watch = PluginWatch::new(progress, done.id(), size_of_val(&*places) as u64);
        done.evaluate(&self.sampled.frame, &mut places, &watch).ok()?;
        Some(places.into())
    }

    /// Moves the samples; gives the next step's rest shape.
    fn deform(
        &mut self,
        id: StepId,
        step: &Arc<Step>,
        between: &Between,
        registry: &PluginRegistry,
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<(Arc<LayerRest>, Arc<LayerResult>)> {
        let Some(deformation) = step.deformation() else { return Err(no_deformation()) };
        let (layer, mut kept) = self.layer(id, step, deformation, registry)?;
        let moment = Moment { effort, time: self.how.time };
        let sampled = &between.sampled;
        // Attributes are of the samples, which the rest shape's key stands for.
        let attributes = layer.plugin.consumes().attributes;
        let attributes = attributes.then(|| sampled.attributes(self.how.model.as_deref(), progress));
        let done = attributes.transpose().and_then(|attributes| {
            with_shape(sampled, |shape| {
                let shape = RestShape { attributes, folder: &self.how.folder, ..*shape };
                layer.update(&between.rest, &shape, &mut kept, moment, progress)
            })
        });
        self.known.insert(id, StepState::Deform { step: step.clone(), layer, kept });
        done
    }

    /// Layer of a step, and its cache; both are taken out of the evaluation.
    fn layer(
        &mut self,
        id: StepId,
        step: &Arc<Step>,
        deformation: &Deformation,
        registry: &PluginRegistry,
    ) -> Result<(Box<Layer>, LayerCache)> {
        let (before, kept) = match self.known.remove(&id) {
            // A plugin that was loaded anew is another one.
            Some(StepState::Deform { step: same, layer, kept })
                if Arc::ptr_eq(&same, step)
                    && registry.get(&deformation.deform).is_ok_and(|p| Arc::ptr_eq(p, &layer.plugin)) =>
            {
                return Ok((layer, kept));
            }
            Some(StepState::Deform { step, layer, kept }) => (Some((step, layer)), kept),
            _ => (None, LayerCache::default()),
        };
        match Layer::build(deformation, &step.place, registry, before.as_ref().map(|(_, layer)| &**layer)) {
            Ok(layer) => Ok((Box::new(layer), kept)),
            Err(e) => {
                // The step may be corrected: its former layer is kept.
                if let Some((step, layer)) = before {
                    self.known.insert(id, StepState::Deform { step, layer, kept });
                }
                Err(e)
            }
        }
    }

    /// Takes more samples, whose deformed positions come from the reconstruction so far.
    fn refine(
        &mut self,
        id: StepId,
        step: &Refine,
        between: &Between,
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<Between> {
        let Between { sampled, rest } = between;
        let positions = &rest.positions;
        let mut key = Key::from_key(rest.key).and(step).end();
        let (after, rest, around) = match self.known.remove(&id) {
            Some(StepState::Refine { key: known, after, rest, around, .. }) if known == key => {
                (after, rest, around)
            }
            Some(StepState::Refine { before, after, rest, around, .. })
                if effort == Effort::DRAFT
                    && Arc::ptr_eq(&before, sampled)
                    && !Arc::ptr_eq(&before, &after) =>
            {
                let around = around.unwrap_or_else(|| Arc::new(Around::new(&before, &after)));
                let positions = around.draft(&after, positions);
                // The result may be another one, whether the steps before it know drafts or not.
                key = Key::from_key(key).and(&effort).end();
                let rest = with_shape(&after, |shape| shape.rest_again(&rest, positions, key))?;
                (after, Arc::new(rest), Some(around))
            }
            _ => {
                let (after, positions) = self.refined(step, sampled, positions, progress)?;
                let rest = with_shape(&after, |shape| shape.rest_at(positions, key))?;
                (after, Arc::new(rest), None)
            }
        };
        let (before, between) = (sampled.clone(), Between { sampled: after.clone(), rest: rest.clone() });
        self.known.insert(id, StepState::Refine { key, before, after, rest, around });
        Ok(between)
    }

    /// Refines the samples by reading the model again where it is selected.
    fn refined(
        &self,
        step: &Refine,
        sampled: &Arc<SampledModel>,
        positions: &[Vec3],
        progress: &dyn Progress,
    ) -> Result<(Arc<SampledModel>, Arc<[Vec3]>)> {
        let model = sampled.open_source(self.how.model.as_deref(), progress)?;
        with_field(sampled, positions, |field| {
            let room = Room { memory_limit: self.how.memory_limit, folder: &self.how.folder };
            let refined = step.refine(sampled, model.as_ref(), ShapePose::Deformed(field), room, progress)?;
            if let Some(need) = refined.need.filter(|need| need.samples == 0) {
                progress.note(&no_more_samples(&need));
            }
            let Some(after) = refined.sampled else {
                match refined.need {
                    None => progress.note(nothing_to_refine(step.finer)),
                    Some(need) if need.samples > 0 => progress.note(&no_cluster_divided(&need)),
                    // Told above.
                    Some(_) => {}
                }
                return Ok((sampled.clone(), positions.into()));
            };
            let positions = with_appended(&after, positions, field);
            Ok((Arc::new(after), positions))
        })
    }
}

/// Reason for which a deformation gets no more samples.
fn no_more_samples(need: &SamplesNeed) -> String {
    if need.is_met {
        return "the deformation needs no more samples".to_owned();
    }
    let SamplesNeed { expected, allowed, .. } = need;
    let more = format!("more than {allowed:.1e} of the diagonal is expected, up to {expected:.1e}");
    format!("nothing is refined: {more}, but {}", SamplesNeed::NONE_LEFT)
}

/// Reason for which a deformation gets no more samples where it needs them.
fn no_cluster_divided(need: &SamplesNeed) -> String {
    let SamplesNeed { expected, allowed, .. } = need;
    format!(
        "nothing is refined: more than {allowed:.1e} of the diagonal is expected, up to {expected:.1e}, but that divides \
         no cluster any further; shapes and a factor refine whatever is expected"
    )
}

/// Reason for which a refinement adds nothing.
fn nothing_to_refine(finer: Finer) -> &'static str {
    match finer {
        Finer::Error(error) if error > 0.0 => "nothing is refined: no cluster there has a larger error",
        _ => "nothing is refined: all vertices there are samples already",
    }
}

/// Calls with the field of the deformation so far; with none where no sample has moved yet.
fn with_field<T>(
    sampled: &SampledModel,
    positions: &[Vec3],
    call: impl FnOnce(Option<&DeformationField<'_>>) -> T,
) -> T {
    if *positions == *sampled.samples.positions {
        return call(None);
    }
    let around = RestGeometry::kept(sampled);
    call(Some(&DeformationField::new(&around, positions, Method::default())))
}

/// Deformed positions of all samples of a refined model: those that it had before, and where the others go.
fn with_appended(
    after: &SampledModel,
    deformed: &[Vec3],
    field: Option<&DeformationField<'_>>,
) -> Arc<[Vec3]> {
    let Some(field) = field else { return after.samples.positions.as_slice().into() };
    let more = appended_deformed(after, deformed.len(), field);
    let more = more.iter().map(|p| after.frame.to_local(*p));
    deformed.iter().copied().chain(more).collect()
}

/// Calls with the samples in the form in which deformations take them.
fn with_shape<T>(sampled: &SampledModel, call: impl FnOnce(&RestShape<'_>) -> T) -> T {
    let samples = &sampled.samples;
    call(&RestShape {
        positions: &samples.positions,
        normals: samples.normals(),
        spacing: samples.spacing(),
        frame: sampled.frame,
        bounds: sampled.bounds,
        triangles: &sampled.triangles,
        neighbours: Some(samples.neighbours()),
        attributes: None,
        folder: Path::new(""),
        renormal: Some(&|positions| deformed_normals(samples, positions)),
    })
}

fn no_deformation() -> Error {
    Error::internal("the step deforms nothing")
}
