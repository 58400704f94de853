//! One method from the model to the deformed model, with its times and its memory.

use super::figures::on_samples;
use super::file::{CompareFile, Method, Work};
use super::record::{Figures, MethodRecord, Seconds, StepRecord, words};
use crate::edit::{Refinements, turning_gradients};
use crate::pipeline::{DeformedSamples, deform, sampled};
use crate::plugins::PluginRegistry;
use crate::session_file::{Action, Deformation, Role, Sampling, SessionFile, Step, read_text};
use crate::stack::Stack;
use glam::Vec3;
use simod_core::reconstruction::{Reconstruction, Version, reconstruct, transfer_error};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::Skip;
use simod_model::memory::MemoryWatch;
use simod_model::{Cache, Model, Progress, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Where methods are done, with the samplings that they share.
pub(super) struct Bench<'a> {
    file: &'a CompareFile,
    plugins: &'a PluginRegistry,
    folder: &'a Path,
    cache: Arc<Cache>,
    samplings: Vec<Known>,
    /// A method refines: samplings keep their cells.
    refines: bool,
}

/// A sampling that was done.
struct Known {
    of: Sampling,
    sampled: Arc<SampledModel>,
    seconds: f64,
}

/// What is kept of a method that was done, to be compared.
pub(super) struct Deformed {
    /// What its files begin with.
    pub name: String,
    pub sampled: Arc<SampledModel>,
    /// Local positions.
    pub positions: Vec<Vec3>,
    /// The deformed model.
    pub output: PathBuf,
}

impl<'a> Bench<'a> {
    /// A bench without samplings; files are written to `folder`, and the model is read by `cache`.
    pub fn new(
        file: &'a CompareFile,
        plugins: &'a PluginRegistry,
        (folder, cache): (&'a Path, Arc<Cache>),
    ) -> Self {
        let refines = |method: &Method| match &method.work {
            // What is wrong with a session is told when it is done.
            Work::Session(path) => SessionFile::load(path)
                .is_ok_and(|session| session.steps.iter().any(|step| step.enabled && step.refines())),
            Work::Plugin { .. } => false,
        };
        let refines = file.methods.iter().any(refines);
        Self { file, plugins, folder, cache, samplings: Vec::new(), refines }
    }

    /// Does a method. `record` gets what is known as soon as it is.
    pub fn run(
        &mut self,
        method: &Method,
        name: &str,
        record: &mut MethodRecord,
        progress: &dyn Progress,
    ) -> Result<Deformed> {
        let memory = MemoryWatch::start();
        let steps = self.steps(method, record)?;
        let notices = self.plugins.notices(&steps);
        notices.iter().for_each(|notice| progress.note(notice));
        let stack = Stack::build(&steps, self.plugins)?;
        record.steps = stack.in_effect().map(StepRecord::new).collect();
        let (rest, sample) = self.sampling(method.sampling, progress)?;

        let start = Instant::now();
        let refinements = Refinements {
            model: Some(self.file.model.clone()),
            folder: self.folder.to_owned(),
            ..Refinements::default()
        };
        let deformed = deform(rest, &steps, self.plugins, refinements, progress)?;
        let deform = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let source = deformed.sampled.open_source(Some(&self.file.model), progress)?;
        let output = self.folder.join(file_name(name, source.as_ref()));
        let version = Version { deformed: &deformed.positions, output: &output, diagnostics: None };
        let known = turning_gradients(&deformed.sampled, &deformed.stack, source.as_ref(), progress)?;
        let gradients = known.as_deref();
        let how = Reconstruction { method: method.reconstruction, gradients, ..Reconstruction::default() };
        let done = reconstruct(&deformed.sampled, source.as_ref(), &[version], &how, progress)?;
        let reconstruct = start.elapsed().as_secs_f64();
        let peak_memory_bytes = memory.peak();

        let diagonal = deformed.sampled.bounds.diagonal();
        let transfer_error = if deformed.stack.can_evaluate() {
            let map = |points: &mut [glam::DVec3]| deformed.stack.evaluate_with(points, progress);
            let output = simod_model::open_with_columns(&output, source.columns())?;
            Some(transfer_error::measure(source.as_ref(), output.as_ref(), diagonal, &map, progress)?)
        } else {
            None
        };
        let DeformedSamples { sampled, positions, messages, .. } = deformed;
        record.figures = Some(Figures {
            samples: sampled.samples.len(),
            triangles: sampled.triangles.len(),
            seconds: Seconds { sample, deform, reconstruct },
            peak_memory_bytes,
            transfer_error,
            displacement: None,
            on_samples: on_samples(&sampled, &positions, progress)?,
            folded_samples: done.folding.first().copied().flatten().map(|f| f.samples),
            messages: notices
                .into_iter()
                .map(|notice| format!("warning: {notice}"))
                .chain(words(&messages))
                .collect(),
        });
        Ok(Deformed { name: name.to_owned(), sampled, positions, output })
    }

    /// The steps of a method.
    fn steps(&self, method: &Method, record: &mut MethodRecord) -> Result<Vec<Step>> {
        match &method.work {
            Work::Session(path) => {
                let text = read_text(path, "session", "give a session file (session.toml), not a model")?;
                let session = SessionFile::parse(&text, path)?;
                record.session = Some(text);
                Ok(session.steps)
            }
            Work::Plugin { deform, state_version, params, folder } => {
                let takes = self.plugins.get(deform)?.consumes();
                let regions = self.file.regions.iter().filter(|region| match region.role {
                    Role::Fixed => takes.fixed_regions,
                    Role::Handle => takes.handle_regions,
                    Role::Mask => true,
                });
                let action = Action::Deform(Deformation {
                    state_version: *state_version,
                    params: params.clone(),
                    regions: regions.cloned().collect(),
                    folder: folder.clone(),
                    ..Deformation::of(deform)
                });
                Ok(vec![Step { action, enabled: true, place: method.place.clone() }])
            }
        }
    }

    /// The samples, which are taken once for all methods that want the same, and how long it took.
    fn sampling(&mut self, of: Sampling, progress: &dyn Progress) -> Result<(Arc<SampledModel>, f64)> {
        if let Some(known) = self.samplings.iter().find(|known| known.of == of) {
            return Ok((known.sampled.clone(), known.seconds));
        }
        let start = Instant::now();
        let session = SessionFile {
            model: Some(self.file.model.clone()),
            columns: self.file.columns.clone(),
            fingerprint: self.file.fingerprint.clone(),
            sampling: of,
            ..SessionFile::default()
        };
        let skip = Skip { cells: !self.refines, colors: true, ..Skip::default() };
        let sampled = Arc::new(sampled(&session, skip, (self.folder, &self.cache), progress)?.0);
        let seconds = start.elapsed().as_secs_f64();
        self.samplings.push(Known { of, sampled: sampled.clone(), seconds });
        Ok((sampled, seconds))
    }
}

/// What a method's model is called: with an extension of the model's format, its own if it is one.
fn file_name(method: &str, model: &dyn Model) -> String {
    let all = model.extensions();
    let own = model.path().extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let extension = if all.contains(&own.as_str()) { &own } else { all.first().copied().unwrap_or("ply") };
    format!("{method}.{extension}")
}
