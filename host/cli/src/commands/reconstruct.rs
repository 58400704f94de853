//! `simod reconstruct`: deformed samples back onto the whole model.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use simod_core::Result;
use simod_core::reconstruction::{Method, reconstruct};
use simod_core::sampled_model::SampledModel;

use super::warn_non_finite;
use crate::report::{Report, count, rate};

/// Stream the deformation of the samples onto every vertex of the model
#[derive(Args)]
pub struct Reconstruct {
    /// The sampled model
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// The deformed samples: samples.ply with other positions, from `simod deform` or any other program
    #[arg(long, value_name = "FILE")]
    deformed: PathBuf,
    /// The deformed model to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The model that was sampled, if it was moved since
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// How to transfer the deformation
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
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
        let sampled = SampledModel::load(&self.sampled)?;
        let deformed = sampled.read_deformed(&self.deformed)?;
        let model = sampled.open_source(self.model.as_deref())?;
        let done = reconstruct(
            &sampled,
            model.as_ref(),
            &deformed,
            self.method.into(),
            &self.output,
            report.progress(),
        )?;
        warn_non_finite(&sampled, report);
        report.figure("vertices", done.vertices);
        report.figure("samples", sampled.samples.len());
        report.line(format!(
            "{} vertices in {}, {}",
            count(done.vertices),
            self.output.display(),
            rate(done.vertices, report.seconds())
        ));
        Ok(())
    }
}
