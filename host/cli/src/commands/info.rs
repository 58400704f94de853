//! `simod info`: the content of a model or a sampled model.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use serde_json::json;
use simod_core::refinement::Refinement;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{By, Placement, Target};
use simod_model::bounds::Bounds;
use simod_model::follow::Follow;
use simod_model::{Model, ModelName, Result, Scalar, ScaledIntegers, tells_when_opened};
use simod_picture::picture;
use simod_session::sidecar;

use super::reconstruct::tell_following;
use super::sample::asked_error;
use super::tell_cache;
use crate::report::{Report, count, length, with_lengths};

/// Show the content of a model, or of a sampled model
#[derive(Args)]
pub struct Info {
    /// Model, as a file, several files or a pattern, or folder of a sampled model
    ///
    /// Formats: PLY, OBJ, STL, GLB, OFF, PCD, LAS, LAZ, E57, .splat, SPZ, and text in columns. Several files,
    /// or all that match a pattern such as 'tiles/*.laz', are the tiles of one model.
    #[arg(value_name = "MODEL|DIR", required = true)]
    path: Vec<PathBuf>,
    /// Columns of a text file, as x,y,z,_,nx,ny,nz [default: names in its first line, or x,y,z]
    ///
    /// `_` stands for a column that is neither a position nor a normal.
    #[arg(long, value_name = "NAMES")]
    columns: Option<String>,
}

impl Info {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        match &self.path[..] {
            [folder] if folder.is_dir() => Self::sampled(folder, report),
            _ => self.model(report),
        }
    }

    fn model(&self, report: &mut Report) -> Result<()> {
        let cache = Arc::default();
        let columns = self.columns.as_deref();
        let mut model = ModelName::of_all(&self.path)?.open(columns, &cache, report.progress())?;
        tell_cache(&cache, report);
        model.check_complete(report.progress())?;
        if let Err(why) = sidecar::follow(&mut *model, &Follow::default()) {
            report.warn(why.to_string());
        }
        let bounds = picture::bounds(model.as_ref(), report.progress())?;
        let info = model.info();
        let shown = match &self.path[..] {
            [path] => path.as_path(),
            _ => model.path(),
        };
        report.line(format!("{}: {}, {} bytes", shown.display(), info.format, count(info.bytes)));
        tell_content(&*model, report);
        tell_following(&*model, report);
        if bounds.is_empty() {
            report.line("no vertex has a finite position");
        } else {
            tell_bounds(&bounds, report);
        }
        report.figure("format", info.format.as_str());
        report.figure("vertices", info.vertices);
        report.figure("faces", info.faces);
        report.figure("normals", info.has_normals);
        report.figure("position_type", scalar_name(info.position_type));
        report.figure("other_properties", info.other_properties.clone());
        report.figure("bytes", info.bytes);
        if !model.tiles().is_empty() {
            report.figure("tiles", model.tiles().len());
        }
        Ok(())
    }

    fn sampled(folder: &Path, report: &mut Report) -> Result<()> {
        let sampled = SampledModel::load(folder)?;
        let source = &sampled.source;
        report.line(format!(
            "{}: {} samples of the {} vertices of {}",
            folder.display(),
            count(sampled.samples.len() as u64),
            count(source.vertices),
            source.path.display()
        ));
        tell_sampling(&sampled, report);
        let kept = SampledModel::kept_cells(folder).is_some();
        let cells = if kept { "kept" } else { "not kept, or damaged" };
        report.line(format!("{} triangles; cells and trees {cells}", count(sampled.triangles.len() as u64)));
        for refinement in &sampled.refinements {
            report.line(format!(
                "refined to an error of {}, {} samples more: {}",
                length(refinement.error, sampled.bounds.diagonal()),
                count(refinement.added),
                refinement.places()
            ));
        }
        tell_bounds(&sampled.bounds, report);
        // Only a model whose files are there and tell their content without a whole reading is described.
        if source.files().iter().all(|path| tells_when_opened(path))
            && let Ok(model) = sampled.open_source(None, report.progress())
        {
            tell_details(&*model, report);
        }
        report.figure("vertices", source.vertices);
        report.figure("jumps", source.jumps);
        report.figure("samples", sampled.samples.len());
        report.figure("cells", sampled.cells);
        report.figure("triangles", sampled.triangles.len());
        report.figure("cells_kept", kept);
        let refinement = |r: &Refinement| {
            let figures = json!({
                "shapes": r.shapes, "error": r.error, "added": r.added, "transfer_error": r.transfer_error
            });
            with_lengths(figures, &["error", "transfer_error"], sampled.bounds.diagonal())
        };
        report.figure("refinements", sampled.refinements.iter().map(refinement).collect::<Vec<_>>());
        report.figure("source", source.path.display().to_string());
        if !source.tiles.is_empty() {
            report.line(format!("the model is made of {} tiles", count(source.tiles.len() as u64)));
            report.figure("tiles", source.tiles.len());
        }
        Ok(())
    }
}

fn tell_bounds(bounds: &Bounds, report: &mut Report) {
    let (min, max) = (bounds.min, bounds.max);
    report.line(format!("bounding box {min} to {max}, diagonal {:.6}", bounds.diagonal()));
    report.figure("bounds", json!([min.to_array(), max.to_array()]));
    report.figure("diagonal", bounds.diagonal());
}

/// The name that PLY has for a type of numbers.
fn scalar_name(scalar: Scalar) -> &'static str {
    match scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    }
}

/// Tells what a model's vertices have, and what else its file holds.
fn tell_content(model: &dyn Model, report: &mut Report) {
    let info = model.info();
    let normals = if info.has_normals { "with" } else { "without" };
    report.line(format!(
        "{} vertices, positions in {}, {normals} normals",
        count(info.vertices),
        scalar_name(info.position_type)
    ));
    report.line(format!("{} faces", count(info.faces)));
    if let Some(ScaledIntegers { scale, offset }) = info.integers {
        report.line(format!("positions are integers, with scale {scale} and offset {offset}"));
        report.figure("scale", scale.to_array());
        report.figure("offset", offset.to_array());
    }
    tell_details(model, report);
    if !info.other_properties.is_empty() {
        report.line(format!("further properties: {}", info.other_properties.join(", ")));
    }
}

/// Tells what a model's file says about itself, and its place on earth.
fn tell_details(model: &dyn Model, report: &mut Report) {
    let details = model.details();
    if !details.is_empty() {
        details.iter().for_each(|line| report.line(line.as_str()));
        report.figure("details", details);
    }
    if let Some(crs) = &model.info().crs {
        report.line(format!("coordinate reference system: {crs}"));
        report.figure("crs", crs.as_str());
    }
}

/// Tells how a model was sampled.
fn tell_sampling(sampled: &SampledModel, report: &mut Report) {
    let target = match sampled.sampling.target {
        Target::Samples(n) => format!("{} samples", count(n)),
        Target::Error(_) => asked_error(sampled, report).unwrap_or_default(),
    };
    let diagonal = sampled.bounds.diagonal();
    let cell = sampled.cell_size / diagonal;
    // All vertices of a model may be at one place.
    let size = if diagonal > 0.0 {
        length(cell, diagonal)
    } else {
        format!("{:.1e} in the model's unit", sampled.cell_size)
    };
    report.line(format!("asked for {target}; {} cells of {size}", count(sampled.cells)));
    report.figure("cell_size", with_lengths(json!({ "fraction": cell }), &["fraction"], diagonal));
    if sampled.sampling.by != By::Error {
        report.line(format!("spread by {}", sampled.sampling.by.name()));
    }
    if sampled.sampling.placement == Placement::Faces {
        report.line("placed by the planes of the faces around them");
    }
    sampled.source.cost_of_order().into_iter().for_each(|cost| report.line(cost));
}
