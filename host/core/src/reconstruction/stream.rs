//! The second streaming step: every vertex of P_L passes through the deformation field, and out goes the same file
//! with other positions (and normals) (paper §5, "Streaming Deformation Reconstruction").

use std::path::Path;

use glam::Vec3;
use rayon::prelude::*;
use xxhash_rust::xxh3::Xxh3Default;

use super::{DeformationField, Method, Walk};
use crate::model::Model;
use crate::output::OutputFile;
use crate::sampled_model::{SampledModel, fingerprint, same_file};
use crate::{Error, ErrorKind, Progress, Result};

/// Vertices that share a walk. A fixed number, so that the result does not depend on the number of threads.
const WALK_VERTICES: usize = 1024;

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
    let frame = sampled.frame;
    let mut hash = Xxh3Default::new();
    let mut done = Reconstructed { vertices: 0, non_finite: 0 };

    progress.begin("reconstructing", model.info().bytes);
    model.rewrite(
        &mut out,
        &mut |chunk| {
            hash.update(chunk.raw());
            done.vertices += chunk.len() as u64;
            let (positions, normals) = (&mut chunk.positions, &mut chunk.normals);
            let with_normals = !normals.is_empty();
            // Blocks of normals beside those of positions: empty ones where the model has none.
            normals.resize(positions.len(), Vec3::ZERO);
            done.non_finite += positions
                .par_chunks_mut(WALK_VERTICES)
                .zip(normals.par_chunks_mut(WALK_VERTICES))
                .map(|(positions, normals)| {
                    let mut walk = Walk::default();
                    let mut non_finite = 0;
                    for (p, n) in positions.iter_mut().zip(normals) {
                        if !p.is_finite() {
                            non_finite += 1;
                            continue;
                        }
                        let moved =
                            field.transport(frame.to_local(*p), with_normals.then_some(*n), &mut walk);
                        // Only the displacement is in single precision.
                        *p += moved.displacement.as_dvec3() * frame.scale;
                        *n = moved.normal(*n);
                    }
                    non_finite
                })
                .sum::<u64>();
            if !with_normals {
                normals.clear();
            }
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
