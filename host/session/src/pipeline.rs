//! The whole way of an edit, which reads as the design's picture: sample, deform, reconstruct.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::Vec3;
use simod_core::model::{self, Model};
use simod_core::output::folder_of;
use simod_core::reconstruction::transfer_error::{self, TransferError};
use simod_core::reconstruction::{
    DeformationField, Method, Reconstruction, Surroundings, Version, deformed_normals, reconstruct,
};
use simod_core::refinement::{Refining, Selection, appended_deformed, refine};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Skip, Target, sample};
use simod_core::{Error, ErrorKind, Progress, Result};

use crate::deformer::Message;
use crate::plugins::PluginRegistry;
use crate::session_file::{self, Refine, SessionFile};
use crate::stack::{Deformed, PreparedStack, RestShape, Stack, at};

/// P_S*: the samples of a model after a stack of deformations.
#[derive(Debug)]
pub struct DeformedSamples {
    /// Local positions, one per sample, rounded to what a file of them holds.
    pub positions: Vec<Vec3>,
    /// Unit normals, derived from the positions.
    pub normals: Vec<Vec3>,
    /// The exact map, where all plugins know it.
    pub stack: PreparedStack,
    /// What the plugins had to say.
    pub messages: Vec<Message>,
}

/// Deforms the samples of a model.
///
/// # Errors
/// A plugin fails, the samples and the layers do not fit, or the user cancelled.
pub fn deform(sampled: &SampledModel, stack: &Stack, progress: &dyn Progress) -> Result<DeformedSamples> {
    let deformed =
        deform_further(sampled, stack, 0..stack.len(), sampled.samples.positions.clone(), progress)?;
    Ok(finished(sampled, deformed))
}

/// Deforms the samples of a model, whose cells are held, and refines it in between; the samples are those that there are
/// in the end. Shapes of refinements are of the model as it is deformed then; the new samples go where the reconstruction
/// of the layers before takes them.
///
/// Temporary files without a name are made in `folder`.
///
/// # Errors
/// As for [`deform`] and [`refine`].
pub fn deform_and_refine(
    mut sampled: SampledModel,
    model: &dyn Model,
    stack: &Stack,
    refinements: &[Refine],
    folder: &Path,
    progress: &dyn Progress,
) -> Result<(SampledModel, DeformedSamples)> {
    let first = refinements.first().map_or(stack.len(), |r| r.after);
    let mut deformed =
        deform_further(&sampled, stack, 0..first, sampled.samples.positions.clone(), progress)?;
    for (i, refinement) in refinements.iter().enumerate() {
        let (refined, positions) =
            refine_deformed(&sampled, model, refinement, &deformed.positions, folder, progress)
                .map_err(|e| at(&refinement.place, e))?;
        sampled = refined.unwrap_or(sampled);
        let next = refinements.get(i + 1).map_or(stack.len(), |r| r.after);
        let further = deform_further(&sampled, stack, refinement.after..next, positions, progress)?;
        deformed.positions = further.positions;
        deformed.stack.append(further.stack);
        deformed.messages.extend(further.messages);
    }
    let deformed = finished(&sampled, deformed);
    Ok((sampled, deformed))
}

/// Refines a model whose samples are deformed; the refined model, if there was anything to refine, and the positions of
/// its samples.
fn refine_deformed(
    sampled: &SampledModel,
    model: &dyn Model,
    refinement: &Refine,
    deformed: &[Vec3],
    folder: &Path,
    progress: &dyn Progress,
) -> Result<(Option<SampledModel>, Vec<Vec3>)> {
    let around = Surroundings::of(&sampled.samples);
    let field = DeformationField::new(&around, deformed, Method::default());
    let distance = |p| refinement.shapes.signed_distance(p);
    let is_still = deformed == sampled.samples.positions;
    let selection = Selection { distance: &distance, so_far: (!is_still).then_some(&field) };
    let how = Refining { finer: refinement.finer, memory_limit: None, shapes: refinement.shapes.tables() };
    let refined = refine(sampled, model, selection, &how, folder, progress)?.sampled;
    let more = refined.as_ref().map(|refined| appended_deformed(refined, &field)).unwrap_or_default();
    let more = more.iter().map(|p| sampled.frame.to_local(*p));
    let positions = deformed.iter().copied().chain(more).collect();
    Ok((refined, positions))
}

/// Some layers of a stack on the samples, which are at `positions` by those before.
fn deform_further(
    sampled: &SampledModel,
    stack: &Stack,
    layers: Range<usize>,
    positions: Vec<Vec3>,
    progress: &dyn Progress,
) -> Result<Deformed> {
    let samples = &sampled.samples;
    let shape = RestShape {
        positions: &samples.positions,
        normals: samples.normals(),
        spacing: samples.spacing(),
        frame: sampled.frame,
        bounds: sampled.bounds,
        triangles: &sampled.triangles,
        neighbours: Some(samples.neighbours()),
        renormal: Some(&|positions| deformed_normals(samples, positions)),
    };
    stack.apply_layers(layers, &shape, positions, progress)
}

fn finished(sampled: &SampledModel, deformed: Deformed) -> DeformedSamples {
    let positions = sampled.rounded(&deformed.positions);
    let normals = deformed_normals(&sampled.samples, &positions);
    DeformedSamples { positions, normals, stack: deformed.stack, messages: deformed.messages }
}

/// A finished run of a session.
pub struct Run {
    /// The model's samples.
    pub sampled: SampledModel,
    /// The samples after the deformation.
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
        let path = session.model.as_deref().ok_or_else(|| {
            Error::new(
                ErrorKind::Argument,
                "the session does not name a model",
                "add [model] path = \"…\" to it; the path is relative to the session's folder",
            )
        })?;
        if measure && !stack.plugins().all(|p| p.capabilities().evaluate) {
            return Err(not_evaluable());
        }
        let model = model::open(path)?;
        let folder = folder_of(output);
        let mut sampling: Sampling = session.sampling.into();
        sampling.skip.cells = session.refinements.is_empty();
        sampling.skip.triangles = !stack.plugins().any(|p| p.consumes().triangles);
        let sampled = sample(model.as_ref(), &sampling, folder, progress)?;
        let (sampled, deformed) =
            deform_and_refine(sampled, model.as_ref(), &stack, &session.refinements, folder, progress)?;
        let version = Version { deformed: &deformed.positions, output, diagnostics: None };
        reconstruct(&sampled, model.as_ref(), &[version], how, progress)?;
        Ok(Self { sampled, deformed, output: output.to_owned(), seconds: start.elapsed().as_secs_f64() })
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
        let model = self.sampled.open_source(None)?;
        let output = model::open(&self.output)?;
        let diagonal = self.sampled.bounds.diagonal();
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
        // Refinements alone ask for the cells.
        let skip = Skip { cells: true, ..Skip::default() };
        Self { target, grid: from.grid, skip, ..Self::default() }
    }
}
