//! Evaluation of an exact map at every vertex, where it is known as a map of space: the truth that a
//! reconstruction is measured by, and the result itself where its cost does not matter.

use std::path::Path;
use std::sync::Mutex;

use glam::{DMat3, DVec3, Mat3};
use rayon::prelude::*;
use simod_model::frame::Frame;
use simod_model::resumable_output::{OpenedOutput, OutputPaths, ResumableOutput};
use simod_model::{
    Edit, Edited, Error, Model, Normals, Output, Progress, RawChunk, Result, Rewriting, VertexChunk,
};

use super::diagnostics::{DiagnosticsFile, has_splats};
use super::reach::check_reach;
use super::stream::{Folding, check_targets};
use super::transfer::{Surveys, VertexFindings, locked};
use super::{DeformationField, Reconstructed, Reconstruction, Transport, Version, VertexDiagnostics};
use crate::fingerprint::VertexHash;
use crate::sampled_model::SampledModel;

/// Step of the central differences that give the gradient, in local units: a power of two near the third root
/// of the rounding of doubles.
const STEP: f64 = 1.0 / (1 << 17) as f64;

/// A gradient this near to that of the identity is the identity: differences do not tell them apart.
const STILL: f64 = 1e-8;

/// Number of evaluations of the map for each vertex, if normals or diagnostics need its gradient.
pub const EVALUATIONS_WITH_GRADIENT: u64 = 7;

/// Replaces points, in the model's coordinates, by their images; those that are not finite stay. From any
/// thread.
pub type ExactMap<'a> = dyn Fn(&mut [DVec3]) -> Result<()> + Sync + 'a;

/// Whether the map's gradient is needed besides the images.
pub fn needs_gradient(model: &dyn Model, normals: Normals, diagnostics: Option<&Path>) -> bool {
    let turns_normals = model.info().has_normals && normals == Normals::Transform;
    diagnostics.is_some() || turns_normals || model.following().is_some()
}

/// Writes the model with the exact image of each vertex; all else of the file is as it is. Normals turn by
/// the map's gradient, from differences in double precision. `field` is the deformation of the samples: it
/// tells whether the whole is mirrored, and where it folds.
///
/// Memory: the chunks of [`Model::rewrite`], and 170 bytes for each vertex that is worked on with its
/// gradient, 24 without; 48 for each vertex of the chunks in flight with diagnostics.
///
/// # Errors
/// As of [`reconstruct`](super::reconstruct), or `map` fails.
pub fn write_exact(
    sampled: &SampledModel,
    model: &dyn Model,
    field: &DeformationField<'_>,
    map: &ExactMap<'_>,
    version: &Version<'_>,
    how: &Reconstruction<'_>,
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    check_targets(model, &[*version], how, None)?;
    check_reach(sampled, model, [version.deformed])?;
    let info = model.info();
    // Nothing is gone on with: the key is of no use to anybody.
    let place = OutputPaths::for_model(model, version.output);
    let opened = ResumableOutput::open(&place, "exact".to_owned(), false, u64::MAX, progress)?;
    let OpenedOutput::Unfinished(mut file) = opened else {
        return Err(Error::internal("an output is there that was not written"));
    };
    let create = |path| DiagnosticsFile::create(path, model, sampled.bounds.diagonal());
    let mut diagnostics = version.diagnostics.map(create).transpose()?;
    let gradients = needs_gradient(model, how.normals, version.diagnostics);
    let surveys = Surveys::new([diagnostics.as_mut()], sampled.bounds.diagonal(), None);
    let hash = Mutex::new(VertexHash::like(&sampled.source.fingerprint));
    let is_of_splats = has_splats(model);
    let mut exact =
        ExactEdit { sampled, field, map, gradients, is_still: false, is_of_splats, hash, surveys };
    exact.is_still = field.is_still() && exact.moves_nothing(model, progress)?;
    progress.begin("evaluating every vertex", info.bytes);
    let outputs: &mut [&mut dyn Output] = &mut [file.as_output()];
    let rewriting = Rewriting { normals: how.normals, ..Rewriting::default() };
    model.rewrite(outputs, rewriting, &exact, progress)?;
    if sampled.source.fingerprint != locked(&exact.hash).fingerprint() {
        return Err(sampled.source_changed(model.path()));
    }
    let mut folding = Folding::of_samples(field, sampled);
    let expected = exact.surveys.finish().pop().flatten().map(|vertices| vertices.expected);
    if let Some(diagnostics) = diagnostics {
        folding.vertices = Some(diagnostics.folded);
        diagnostics.commit()?;
    }
    file.complete(false)?;
    progress.check()?;
    let file = file.commit()?;
    Ok(Reconstructed {
        vertices: info.vertices,
        non_finite: sampled.source.non_finite,
        taken_over: 0,
        folding: vec![Some(folding)],
        expected: vec![expected],
        around_samples: 0.0,
        hashes: vec![file.hash()],
    })
}

/// Gradients of a map at points of the model, from differences; the identity where differences do not tell
/// them.
///
/// # Errors
/// The map fails.
pub(super) fn gradients(map: &ExactMap<'_>, frame: &Frame, positions: &[DVec3]) -> Result<Vec<DMat3>> {
    let step = STEP * frame.scale;
    let mut columns = Vec::with_capacity(3);
    for axis in DVec3::AXES {
        let beside = |by: f64| -> Result<Vec<DVec3>> {
            let mut points: Vec<DVec3> = positions.iter().map(|p| *p + by * axis).collect();
            map(&mut points)?;
            Ok(points)
        };
        columns.push((beside(step)?, beside(-step)?));
    }
    let gradient = |(i, p): (usize, &DVec3)| {
        // The distance that there really is, where coordinates are large.
        let column = |axis: usize| {
            let (after, before) = (&columns[axis].0, &columns[axis].1);
            (after[i] - before[i]) / ((p[axis] + step) - (p[axis] - step))
        };
        let gradient = DMat3::from_cols(column(0), column(1), column(2));
        let tells = gradient.is_finite() && !gradient.abs_diff_eq(DMat3::IDENTITY, STILL);
        if tells { gradient } else { DMat3::IDENTITY }
    };
    Ok(positions.iter().enumerate().map(gradient).collect())
}

/// Gradient of a map at each sample: samples on a surface tell nothing of the map across it, which positions
/// do not need, but vectors and splats that turn with the surface do.
///
/// Memory: about 200 bytes per sample while it runs.
///
/// # Errors
/// The map fails.
pub fn known_gradients(sampled: &SampledModel, map: &ExactMap<'_>) -> Result<Vec<Mat3>> {
    let frame = &sampled.frame;
    let positions: Vec<_> = sampled.samples.positions.iter().map(|p| frame.to_model(*p)).collect();
    Ok(gradients(map, frame, &positions)?.iter().map(|gradient| gradient.as_mat3()).collect())
}

struct ExactEdit<'a> {
    sampled: &'a SampledModel,
    field: &'a DeformationField<'a>,
    map: &'a ExactMap<'a>,
    /// Whether the gradient of the map is needed.
    gradients: bool,
    /// Whether it is known that no vertex moves.
    is_still: bool,
    /// Whether vertices are splats, whose anisotropy is told.
    is_of_splats: bool,
    /// The hash of all vertices' bytes.
    hash: Mutex<VertexHash>,
    surveys: Surveys<'a>,
}

impl Edit for ExactEdit<'_> {
    fn begin(&self, chunk: &RawChunk<'_>) -> Result<()> {
        locked(&self.hash).update(chunk.bytes);
        Ok(())
    }

    fn edit(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        let moved = self.moved(chunk, versions)?;
        let mut findings = self.surveys.findings(chunk.len());
        for findings in findings.iter_mut().filter(|findings| !findings.figures.is_empty()) {
            self.find(&chunk.positions, &moved, findings);
        }
        self.surveys.keep(chunk.first, versions, findings);
        Ok(())
    }

    fn edit_normals(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        self.moved(chunk, versions).map(|_| ())
    }

    fn end(&self, first: u64) -> Result<()> {
        self.surveys.write(first)
    }

    fn is_still(&self, _version: usize) -> bool {
        self.is_still
    }
}

impl ExactEdit<'_> {
    /// Whether the map leaves all vertices where they are. It is evaluated at each of them, so this is asked
    /// only where it leaves the samples at rest, as formats make room for what may change.
    fn moves_nothing(&self, model: &dyn Model, progress: &dyn Progress) -> Result<bool> {
        progress.begin("looking for what moves", model.info().vertex_bytes);
        let mut reader = model.vertices(0..model.info().vertices)?;
        let mut chunk = VertexChunk::default();
        while reader.read(&mut chunk)? {
            progress.check()?;
            let carried = self.carry(&chunk.positions, self.gradients)?;
            let is_still = |c: &ExactImage| c.way == DVec3::ZERO && c.gradient == DMat3::IDENTITY;
            if !carried.iter().all(is_still) {
                return Ok(false);
            }
            progress.advance(chunk.raw().len() as u64);
        }
        Ok(true)
    }

    /// Moves the vertices of each version; returns their exact images.
    fn moved(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<Vec<ExactImage>> {
        let turns = |edited: &Edited| !edited.normals.is_empty() || !edited.gradients.is_empty();
        let moved = self.carry(&chunk.positions, self.gradients || versions.iter().any(turns))?;
        for edited in versions {
            for (position, moved) in edited.positions.iter_mut().zip(&moved) {
                // A zero keeps its sign.
                let moves = moved.way.cmpne(DVec3::ZERO);
                *position = DVec3::select(moves, *position + moved.way, *position);
            }
            for (normal, moved) in edited.normals.iter_mut().zip(&moved) {
                let transport = moved.transport(self.sampled.frame.scale, DVec3::ZERO);
                *normal = transport.normal(*normal, self.field.gradients.mirrored);
            }
            edited.mirrored = self.field.is_mirrored();
            for (gradient, moved) in edited.gradients.iter_mut().zip(&moved) {
                *gradient = moved.gradient.as_mat3();
            }
        }
        Ok(moved)
    }
}

/// Image of a vertex under the map: its displacement, and the gradient there.
#[derive(Clone, Copy)]
struct ExactImage {
    /// Displacement in the model's unit; zero where the vertex is not finite.
    way: DVec3,
    gradient: DMat3,
}

impl ExactImage {
    /// The displacement, less a shift, and gradient in local units of this length.
    fn transport(&self, scale: f64, shift: DVec3) -> Transport {
        let displacement = ((self.way - shift) / scale).as_vec3();
        Transport { displacement, gradient: self.gradient.as_mat3() }
    }
}

impl ExactEdit<'_> {
    /// Evaluates the map at vertices, and around them if the gradient is asked for.
    fn carry(&self, positions: &[DVec3], gradient: bool) -> Result<Vec<ExactImage>> {
        let frame = &self.sampled.frame;
        let mut images = positions.to_vec();
        (self.map)(&mut images)?;
        let way = |(p, image): (&DVec3, &DVec3)| {
            // The rest position is rounded to local coordinates and back, as the image of a vertex that stays
            // is.
            let still = frame.to_model_exact(frame.to_local_exact(*p));
            let way = if p.is_finite() { *image - still } else { DVec3::ZERO };
            ExactImage { way, gradient: DMat3::IDENTITY }
        };
        let mut carried: Vec<ExactImage> = positions.iter().zip(&images).map(way).collect();
        if !gradient {
            return Ok(carried);
        }
        for (carried, gradient) in carried.iter_mut().zip(gradients(self.map, frame, positions)?) {
            carried.gradient = gradient;
        }
        Ok(carried)
    }

    /// Finds the diagnostics of vertices that the map has carried over.
    fn find(&self, positions: &[DVec3], carried: &[ExactImage], findings: &mut VertexFindings) {
        let Self { sampled, field, .. } = self;
        let frame = &sampled.frame;
        let find = |(p, carried): (&DVec3, &ExactImage)| {
            if !p.is_finite() {
                return (VertexDiagnostics::UNKNOWN, f32::NAN);
            }
            let local = frame.to_local(*p);
            let home = sampled.samples.nearest(local) as usize;
            let moved = carried.transport(frame.scale, field.shift);
            let rounding = field.written_rounding(local, moved.displacement);
            (
                field.figures(home, &moved, frame.scale, self.is_of_splats),
                (f64::from(rounding) * frame.scale) as f32,
            )
        };
        let found = positions.par_iter().zip(carried).map(find);
        found.unzip_into_vecs(&mut findings.figures, &mut findings.expected);
    }
}
