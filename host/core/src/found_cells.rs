//! The cells of a sampled model whose folder has lost them: found by sampling once more, which gives the
//! same.

use std::path::Path;

use simod_model::claim::Claim;
use simod_model::{Error, Progress, Result, output};

use crate::fingerprint::are_same;
use crate::sampled_model::{CELLS, SAMPLES, SampledModel, file_fingerprint};
use crate::sampling::kept_cells::KeptCells;
use crate::sampling::{Sampling, Skip, sample};

impl SampledModel {
    /// The cells of a sampled model, from its folder; if the file is missing or damaged, the model is sampled
    /// again, which gives the same cells, and the file is made anew. `elsewhere` is the model if it was
    /// moved.
    ///
    /// # Errors
    /// As for [`open_source`](Self::open_source) and [`sample`]; the model is not
    /// what was sampled; the file cannot be written.
    pub fn cells_or_resample(
        &self,
        folder: &Path,
        elsewhere: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<KeptCells> {
        if let Some(kept) = Self::kept_cells(folder).filter(|kept| self.check_cells(kept).is_ok()) {
            return Ok(kept);
        }
        if !self.refinements.is_empty() {
            return Err(Error::format(
                format!("{} was refined, and its {CELLS} is missing or damaged since", folder.display()),
                "sample the model again, and refine it again: `simod info` tells where it was refined",
            ));
        }
        let source = self.open_source(elsewhere, progress)?;
        // The triangles tell where the faces of each cell are.
        let triangles = self.triangles.is_empty();
        // Former versions looked for no sheets unless asked to.
        let sheets = self.samples.contacts().is_none();
        let skip = Skip { triangles, cells: false, normals: true, sheets, colors: true };
        let again = sample(&*source, &Sampling { skip, ..self.sampling }, folder, progress)?;
        if are_same(&again.source.fingerprint, &self.source.fingerprint) == Some(false) {
            return Err(self.source_changed(source.path()));
        }
        let same = again.samples.positions == self.samples.positions;
        let Some(kept) = again.into_cells().filter(|_| same) else {
            return Err(Error::mismatch(
                format!("{} was sampled by another version of SIMOD", folder.display()),
                "sample the model again",
            ));
        };
        self.keep_cells(folder, &kept)?;
        Ok(kept)
    }

    /// Puts the cells into the folder, unless another process is writing it, or has.
    fn keep_cells(&self, folder: &Path, kept: &KeptCells) -> Result<()> {
        let Ok(_claim) = Claim::folder(folder) else { return Ok(()) };
        let samples = file_fingerprint(&folder.join(SAMPLES))?;
        if Self::load(folder)?.samples.positions != self.samples.positions {
            return Ok(());
        }
        output::write_file(&folder.join(CELLS), &kept.encode(&samples)?)
    }
}
