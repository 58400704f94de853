//! The second streaming step: every vertex of P_L passes through the deformation field, and out goes the same file
//! with other positions (and normals) (paper §5, "Streaming Deformation Reconstruction").

use std::path::Path;

use glam::Vec3;
use xxhash_rust::xxh3::Xxh3Default;

use super::{DeformationField, Method};
use crate::model::Model;
use crate::output::OutputFile;
use crate::sampled_model::{SampledModel, fingerprint, same_file};
use crate::{Error, ErrorKind, Progress, Result};

/// What was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reconstructed {
    /// Vertices of the model.
    pub vertices: u64,
    /// Those that have no finite position and were left as they are.
    pub non_finite: u64,
}

/// Transfers the deformation of the samples to their model and writes it to `output`, which appears whole or not
/// at all. `deformed` holds the samples' finite local positions after the deformation.
///
/// Memory: the field (see [`DeformationField`]) and the chunks of [`Model::rewrite`].
///
/// # Errors
/// The model cannot be read or is not what was sampled; the output cannot be written or is the model itself, or a new
/// position does not fit its type; the user cancelled.
pub fn reconstruct(
    sampled: &SampledModel,
    model: &dyn Model,
    deformed: &[Vec3],
    method: Method,
    output: &Path,
    progress: &dyn Progress,
) -> Result<Reconstructed> {
    // Before the work begins: a target that cannot be written, or must not be.
    if same_file(model.path(), output) {
        return Err(Error::new(
            ErrorKind::Argument,
            format!("{} is the model itself", output.display()),
            "write the deformed model to another file; the samples belong to the original",
        ));
    }
    let mut out = OutputFile::create(output, model.info().bytes)?;
    progress.begin("preparing", 0);
    let field = DeformationField::new(&sampled.samples, deformed, method);
    let mut hash = Xxh3Default::new();
    let mut done = Reconstructed { vertices: 0, non_finite: 0 };

    progress.begin("reconstructing", model.info().bytes);
    model.rewrite(
        &mut out,
        &mut |chunk| {
            hash.update(chunk.raw());
            done.vertices += chunk.len() as u64;
            done.non_finite += field.carry(&sampled.frame, &mut chunk.positions, &mut chunk.normals);
            Ok(())
        },
        progress,
    )?;
    if sampled.source.fingerprint != fingerprint(hash.digest128()) {
        return Err(sampled.source_changed(model.path()));
    }
    out.commit()?;
    Ok(done)
}
