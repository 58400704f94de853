//! `simod bind`: the part of every reconstruction of a model that depends on no deformation, done once for
//! all.

use std::path::PathBuf;

use clap::Args;
use simod_core::guard::OutputKind;
use simod_core::reconstruction::{bind, keep_geometry};
use simod_core::sampled_model::{BINDING, SampledModel};
use simod_model::claim::Claim;
use simod_model::{ErrorKind, Result};

use super::overwrite::Overwrite;
use super::tell_cache;
use crate::report::{Report, count};

/// Write the part of a reconstruction that is the same for every deformation
///
/// The home of each vertex is kept as `binding.bin` in the folder of the sampled model, and what follows from
/// the samples alone as `rest.bin`. `simod reconstruct` uses both by itself, and takes less time with them:
/// for models that are reconstructed again and again.
#[derive(Args)]
pub struct Bind {
    /// Folder of the sampled model, to which `binding.bin` is added
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// Model that was sampled, if its file has moved since
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
}

impl Bind {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        // The samples stay the same as long as the model is being bound.
        let claim = match Claim::folder(&self.sampled) {
            // A folder beside which nothing can be written is replaced by nobody, so no claim is needed.
            Err(e) if e.kind() == ErrorKind::Io => None,
            claim => Some(claim?),
        };
        let sampled = SampledModel::load(&self.sampled)?;
        let model = sampled.open_source(self.model.as_deref(), report.progress())?;
        let path = self.sampled.join(BINDING);
        let mut guard = self.overwrite.guard();
        guard.reads_all([model.path()].into_iter().chain(model.other_files()));
        guard.reads_all(sampled.source.files());
        guard.writes(&path, OutputKind::Binding)?;
        let bytes = bind(&sampled, model.as_ref(), &path, report.progress())?;
        // Keeping the geometry claims the folder by itself.
        drop(claim);
        keep_geometry(&sampled);
        report.figure("vertices", model.info().vertices);
        report.figure("samples", sampled.samples.len());
        report.figure("bytes", bytes);
        tell_cache(sampled.cache(), report);
        report.line(format!(
            "{} vertices bound to {} samples in {}, {} bytes",
            count(model.info().vertices),
            count(sampled.samples.len() as u64),
            path.display(),
            count(bytes)
        ));
        Ok(())
    }
}
