//! `simod sample`: a model to a sampled model.

use std::path::PathBuf;

use clap::Args;
use simod_core::sampling::{Sampling, Target, sample};
use simod_core::{Result, model};

use super::warn_non_finite;
use crate::report::{Report, count, rate};

/// Stream a model to a small point set that any tool can deform
#[derive(Args)]
pub struct Sample {
    /// The model to sample
    model: PathBuf,
    /// The folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    sampling: SamplingArguments,
}

/// How fine P_S shall be.
#[derive(Args)]
pub struct SamplingArguments {
    /// Number of samples [default: 100000]
    #[arg(long, value_name = "N", conflicts_with = "error")]
    samples: Option<u64>,
    /// Error bound of a sample's cluster, as a fraction of the bounding box diagonal
    #[arg(long, value_name = "E")]
    error: Option<f64>,
    /// Most cells of the coarse grid along an axis [default: 16 to 512, by the model's size]
    #[arg(long, value_name = "R")]
    grid: Option<u32>,
}

impl SamplingArguments {
    pub fn sampling(&self) -> Sampling {
        let target = match (self.samples, self.error) {
            (Some(n), _) => Target::Samples(n),
            (None, Some(e)) => Target::Error(e),
            (None, None) => Target::default(),
        };
        Sampling { target, grid: self.grid }
    }
}

impl Sample {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let model = model::open(&self.model)?;
        let sampled = sample(model.as_ref(), &self.sampling.sampling(), report.progress())?;
        sampled.save(&self.output)?;
        let vertices = model.info().vertices;
        warn_non_finite(&sampled, report);
        report.figure("vertices", vertices);
        report.figure("samples", sampled.samples.len());
        report.figure("cells", sampled.cells);
        report.line(format!(
            "{} vertices to {} samples in {}, {}",
            count(vertices),
            count(sampled.samples.len() as u64),
            self.output.display(),
            rate(vertices, report.seconds()),
        ));
        Ok(())
    }
}
