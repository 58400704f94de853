//! The whole way of an edit, which reads as the design's picture: sample, deform, reconstruct.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use simod_core::model::{self, Model};
use simod_core::output::folder_of;
use simod_core::reconstruction::transfer_error::{self, TransferError};
use simod_core::reconstruction::{Reconstruction, Version, deformed_normals, reconstruct};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Skip, Target, sample};
use simod_core::{Error, ErrorKind, Progress, Result};
use simod_plugin_api::Effort;

use crate::deformer::Message;
use crate::edit::{Document, Evaluated, Evaluation, Refinements, messages};
use crate::plugins::PluginRegistry;
use crate::session_file::{self, SessionFile, Step};
use crate::stack::{PreparedStack, Stack};

/// Samples a session's model, which comes with it. Temporary files without a name are made in `folder`.
///
/// # Errors
/// The session names no model; it is gone, or cannot be sampled; the user cancelled.
pub fn sampled(
    session: &SessionFile,
    skip: Skip,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<(SampledModel, Box<dyn Model>)> {
    let path = session.model.as_deref().ok_or_else(|| {
        Error::new(
            ErrorKind::Argument,
            "the session does not name a model",
            "add [model] path = \"…\" to it; the path is relative to the session's folder",
        )
    })?;
    if !path.exists() {
        return Err(Error::new(
            ErrorKind::Io,
            format!("the session's model {} is gone", path.display()),
            "put it back, correct [model] path in the session, or say where it is with --model",
        ));
    }
    let model = model::open(path)?;
    let sampling = Sampling { skip, ..session.sampling.into() };
    let sampled = sample(model.as_ref(), &sampling, folder, progress)?;
    if session.fingerprint.as_ref().is_some_and(|known| *known != sampled.source.fingerprint) {
        progress.note(&format!("{} is not what it was when the session was saved", path.display()));
    }
    Ok((sampled, model))
}

/// P_S*: the samples of a model after the steps of a session.
pub struct DeformedSamples {
    /// The model with its samples at rest, with those that steps appended.
    pub sampled: Arc<SampledModel>,
    /// Local positions, one per sample, rounded to what a file of them holds.
    pub positions: Vec<Vec3>,
    /// Unit normals, derived from the positions.
    pub normals: Vec<Vec3>,
    /// The exact map, where all plugins know it.
    pub stack: PreparedStack,
    /// What the plugins had to say.
    pub messages: Vec<Message>,
}

/// Does steps on a sampled model, which [holds its cells](SampledModel::hold_cells) if any of them refines.
///
/// # Errors
/// A step cannot be done, or the user cancelled.
pub fn deform(
    sampled: impl Into<Arc<SampledModel>>,
    steps: &[Step],
    plugins: &PluginRegistry,
    how: Refinements,
    progress: &dyn Progress,
) -> Result<DeformedSamples> {
    let document = Document::new(steps.iter().cloned());
    let mut evaluation = Evaluation::new(sampled.into(), how);
    let Evaluated { sampled, positions, statuses, stack, .. } =
        evaluation.update(document.steps(), plugins, Effort::FULL, progress)?;
    let messages = messages(statuses)?;
    let positions = sampled.rounded(&positions);
    let normals = deformed_normals(&sampled.samples, &positions);
    Ok(DeformedSamples { sampled, positions, normals, stack, messages })
}

/// A finished run of a session.
pub struct Run {
    /// The samples after the deformation, with those at rest.
    pub deformed: DeformedSamples,
    /// The deformed model.
    pub output: PathBuf,
    /// Seconds from opening the model to the finished output.
    pub seconds: f64,
}

impl Run {
    /// Samples the session's model, deforms the samples and writes the deformed model, whole or not at all.
    /// `measure` says that [`transfer_error`](Self::transfer_error) will be asked for.
    ///
    /// # Errors
    /// Any step fails; what is wrong in the session is noticed before the model is read.
    pub fn execute(
        session: &SessionFile,
        plugins: &PluginRegistry,
        how: &Reconstruction,
        measure: bool,
        output: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let start = Instant::now();
        let stack = Stack::build(&session.steps, plugins)?;
        if measure && !stack.plugins().all(|p| p.capabilities().evaluate) {
            return Err(not_evaluable());
        }
        let folder = folder_of(output);
        let triangles = stack.plugins().any(|p| p.consumes().triangles);
        let cells = session.steps.iter().any(|step| step.enabled && step.refines());
        let skip = Skip { triangles: !triangles, cells: !cells, ..Skip::default() };
        let (sampled, model) = sampled(session, skip, folder, progress)?;
        let refinements = Refinements { folder: folder.to_owned(), ..Refinements::default() };
        let deformed = deform(sampled, &session.steps, plugins, refinements, progress)?;
        let version = Version { deformed: &deformed.positions, output, diagnostics: None };
        reconstruct(&deformed.sampled, model.as_ref(), &[version], how, progress)?;
        Ok(Self { deformed, output: output.to_owned(), seconds: start.elapsed().as_secs_f64() })
    }

    /// Compares the output with the exact image of every vertex of the model.
    ///
    /// # Errors
    /// A plugin of the stack does not know its map between the samples; a file cannot be read; cancelled.
    pub fn transfer_error(&self, progress: &dyn Progress) -> Result<TransferError> {
        let exact = &self.deformed.stack;
        if !exact.can_evaluate() {
            return Err(not_evaluable());
        }
        let model = self.deformed.sampled.open_source(None)?;
        let output = model::open(&self.output)?;
        let diagonal = self.deformed.sampled.bounds.diagonal();
        let map = |points: &mut [glam::DVec3]| exact.evaluate_with(points, progress);
        transfer_error::measure(model.as_ref(), output.as_ref(), diagonal, &map, progress)
    }
}

fn not_evaluable() -> Error {
    Error::new(
        ErrorKind::Plugin,
        "a plugin of the session deforms samples only, so the exact deformation is not known",
        "measure sessions of space deformations, as warp and rbf",
    )
}

impl From<session_file::Sampling> for Sampling {
    fn from(from: session_file::Sampling) -> Self {
        let target = match (from.samples, from.error) {
            (Some(n), _) => Target::Samples(n),
            (None, Some(e)) => Target::Error(e),
            (None, None) => Target::default(),
        };
        Self { target, grid: from.grid, ..Self::default() }
    }
}
