//! `simod reconstruct`: deformed samples back onto the whole model.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use simod_core::Result;
use simod_core::guard::Kind;
use simod_core::reconstruction::{
    Folding, Method, Normals, PART_BYTES, Reconstruction, Version, reconstruct,
};
use simod_core::sampled_model::{BINDING, SampledModel};

use super::overwrite::Overwrite;
use super::sample::parse_bytes;
use super::warn_non_finite;
use crate::report::{Report, count, rate};
use crate::versions::{VersionPaths, versions};

/// Stream the deformation of the samples onto every vertex of the model, or several deformations at once
#[derive(Args)]
pub struct Reconstruct {
    /// The sampled model
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// The deformed samples: samples.ply with other positions, from `simod deform` or any other program. Several files,
    /// or a pattern as 'frame-*.ply', give a model each
    #[arg(long, value_name = "FILE", required = true, num_args = 1..)]
    deformed: Vec<PathBuf>,
    /// The deformed model to write. {} in it stands for what the * of --deformed matched, or for a file's name without
    /// its ending
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// A PLY file to write beside it, for viewers of scalar fields: each vertex' new position, its displacement, the largest
    /// and the smallest stretch of the surface, and whether it is folded (turned inside out). {} as in -o; not with
    /// --resume
    #[arg(long, value_name = "FILE")]
    diagnostics: Option<PathBuf>,
    /// The model that was sampled, if it was moved since
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// How to transfer the deformation
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    /// What becomes of the model's normals
    #[arg(long, value_enum, default_value_t)]
    normals: NormalsName,
    /// Go on with what an interrupted run of this command left; with it, Ctrl-C and a full disk keep what is done
    #[arg(long)]
    resume: bool,
    /// How much of the model is lost at most when a run is killed; for tests
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes, default_value_t = PART_BYTES, hide = true)]
    part_size: u64,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// What becomes of normals.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum NormalsName {
    /// They keep their bytes
    Keep,
    /// They turn with the surface
    #[default]
    Transform,
    /// They are left out
    Drop,
}

impl From<NormalsName> for Normals {
    fn from(name: NormalsName) -> Self {
        match name {
            NormalsName::Keep => Self::Keep,
            NormalsName::Transform => Self::Transform,
            NormalsName::Drop => Self::Drop,
        }
    }
}

/// The methods of the reconstruction.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    /// The paper's: an offset along the normal over a projected triangle of samples
    ProjectedBarycentric,
    /// A blend of second-order expansions around the nearest samples
    #[default]
    BlendedJets,
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::ProjectedBarycentric => Self::ProjectedBarycentric,
            MethodName::BlendedJets => Self::BlendedJets,
        }
    }
}

impl Reconstruct {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let paths = versions(&self.deformed, &self.output, self.diagnostics.as_deref())?;
        let sampled = SampledModel::load(&self.sampled)?;
        let mut guard = self.overwrite.guard();
        guard.reads(&self.sampled);
        // That the model itself is kept is seen to where it is streamed.
        guard.reads_all(self.model.is_some().then_some(&sampled.source.path));
        guard.reads_all(paths.iter().map(|v| &v.deformed));
        for path in paths.iter().flat_map(|v| [&v.output].into_iter().chain(&v.diagnostics)) {
            guard.writes(path, Kind::Model)?;
        }
        let deformed =
            paths.iter().map(|v| sampled.read_deformed(&v.deformed)).collect::<Result<Vec<_>>>()?;
        let model = sampled.open_source(self.model.as_deref())?;
        let versions: Vec<Version<'_>> = paths
            .iter()
            .zip(&deformed)
            .map(|(v, deformed)| Version {
                deformed,
                output: &v.output,
                diagnostics: v.diagnostics.as_deref(),
            })
            .collect();
        let binding = self.sampled.join(BINDING);
        let how = Reconstruction {
            method: self.method.into(),
            normals: self.normals.into(),
            resume: self.resume,
            part_bytes: self.part_size,
            binding: Some(&binding),
        };
        let done = reconstruct(&sampled, model.as_ref(), &versions, &how, report.progress())?;
        warn_non_finite(&sampled, report);
        describe_folding(&paths, &done.folding, report);
        report.figure("vertices", done.vertices);
        report.figure("versions", versions.len());
        report.figure("samples", sampled.samples.len());
        let into = match &paths[..] {
            [one] => one.output.display().to_string(),
            several => format!("each of {} versions", several.len()),
        };
        if self.resume {
            report.figure("resumed_bytes", done.taken_over);
            report.line(format!("{} bytes were there from an earlier run", count(done.taken_over)));
        }
        report.line(format!(
            "{} vertices in {into}, {}",
            count(done.vertices),
            rate(done.vertices * versions.len() as u64, report.seconds())
        ));
        Ok(())
    }
}

/// Says where the versions fold the surface.
fn describe_folding(paths: &[VersionPaths], folding: &[Option<Folding>], report: &mut Report) {
    let known = || paths.iter().zip(folding).filter_map(|(paths, folding)| Some((paths, (*folding)?)));
    report.figure("folded_samples", known().map(|(_, f)| f.samples).sum::<u64>());
    let vertices = || known().filter_map(|(_, f)| f.vertices);
    if vertices().next().is_some() {
        report.figure("folded_vertices", vertices().sum::<u64>());
    }
    for (paths, folding) in known() {
        let Some(first) = folding.first else { continue };
        let which = if known().count() > 1 { format!("{}: ", paths.output.display()) } else { String::new() };
        report.warn(format!(
            "{which}the deformation folds the surface at {} samples, first near ({:.6}, {:.6}, {:.6}); deform it less \
             there, or look at it with --diagnostics",
            count(folding.samples),
            first.x,
            first.y,
            first.z
        ));
    }
}
