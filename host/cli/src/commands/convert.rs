//! `simod convert`: a model in another format, as it is.

use std::fmt::Display;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use glam::DVec3;
use serde_json::json;
use simod_core::guard::OutputKind;
use simod_model::object::{self, is_object};
use simod_model::target::scratch_folder;
use simod_model::{
    Cache, Conversion, Converted, Error, Model, ModelName, Progress, Result, Rounding, convert_tiles,
    converted_names, note_on_name,
};

use super::overwrite::Overwrite;
use super::tell_cache;
use crate::report::{Report, count, rate, with_lengths};

/// Write a model in another format, without any deformation
#[derive(Args)]
pub struct Convert {
    /// Model, as a file of any format that is read, or as a pattern of tiles, 'tiles/*.laz'
    model: PathBuf,
    /// File to write, whose extension says the format; for tiles, the folder to write them to
    ///
    /// Formats: ply, las, laz, obj, stl, off, pcd, csv, tsv, txt, xyz, xyzn, xyzrgb.
    output: PathBuf,
    /// Extension of the format that each tile is written in, as laz; for tiles alone
    ///
    /// Tiles keep their names but for it.
    #[arg(long, value_name = "EXTENSION")]
    to: Option<String>,
    /// Columns of a text file, as x,y,z,_,nx,ny,nz [default: names in its first line, or x,y,z]
    ///
    /// `_` stands for a column that is neither a position nor a normal.
    #[arg(long, value_name = "NAMES")]
    columns: Option<String>,
    /// Write a format that cannot hold all that the model has
    ///
    /// Without it, that is an error, which lists what would be lost.
    #[arg(long)]
    lossy: bool,
    /// Step from one integer to the next, in the model's unit; for LAS and LAZ
    ///
    /// [default: the model's own, or as fine as its extent allows]
    #[arg(long, value_name = "L")]
    step: Option<f64>,
    /// Position of the integers' zero, as 500000,5400000,0; for LAS and LAZ
    ///
    /// [default: the model's own, or near its middle]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    origin: Option<DVec3>,
    #[command(flatten)]
    overwrite: Overwrite,
}

fn point(text: &str) -> std::result::Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    numbers.map(DVec3::from).ok_or_else(|| "give three numbers with commas between them".to_owned())
}

impl Convert {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let named = ModelName::from_path(&self.model)?;
        match (&self.to, &named) {
            (Some(to), ModelName::Tiles(_)) => self.tiles(&named, to, report),
            (Some(to), ModelName::File(_)) => Err(Error::argument(
                format!("--to {to} is for tiles, and {} is one file", self.model.display()),
                "leave it out: the extension of the file to write says the format",
            )),
            (None, _) => self.file(report),
        }
    }

    /// Converts each tile to a file of its own.
    fn tiles(&self, named: &ModelName, to: &str, report: &mut Report) -> Result<()> {
        let mut guard = self.overwrite.guard();
        guard.reads_all(named.files());
        guard.writes_model(&self.output, &converted_names(named, to)?)?;
        let how = (self.columns.as_deref(), self.how());
        if !matches!(&*to.to_ascii_lowercase(), "las" | "laz") {
            self.tell_of_floats(&self.output.display(), report.progress());
        }
        let done = convert_tiles(named, to, how, &self.output, report.progress())?;
        tell_losses(&done.losses, done.rounding, report);
        let tiles = named.files().len();
        report.figure("tiles", tiles);
        self.tell(
            (done.vertices, done.triangles, done.bytes),
            &format!("{} tiles in ", count(tiles as u64)),
            report,
        );
        Ok(())
    }

    fn how(&self) -> Conversion {
        Conversion { lossy: self.lossy, step: self.step, offset: self.origin, drops_normals: false }
    }

    fn file(&self, report: &mut Report) -> Result<()> {
        let mut guard = self.overwrite.guard();
        guard.reads(&self.model);
        let progress = report.progress();
        let cache = Arc::new(Cache::nameless(&scratch_folder(&self.output)));
        let model = simod_model::open_with(&self.model, self.columns.as_deref(), &cache, progress)?;
        guard.reads_all(model.other_files());
        guard.writes(&self.output, OutputKind::Model)?;
        let converted = Converted::new(model, &self.output, self.how(), progress)?;
        note_on_name(&self.output).into_iter().for_each(|note| progress.note(&note));
        if converted.info().written.is_none() {
            self.tell_of_floats(&self.output.display(), progress);
        }
        converted.write(&self.output, progress)?;
        tell_losses(converted.losses(), converted.rounding(), report);
        tell_cache(&cache, report);
        let bytes = if is_object(&self.output) {
            object::open(&self.output)?.bytes()
        } else {
            std::fs::metadata(&self.output).map_or(0, |meta| meta.len())
        };
        self.tell((converted.vertices(), converted.triangles(), bytes), "", report);
        Ok(())
    }

    /// Says that --step and --origin are for other formats, where they are given in vain.
    fn tell_of_floats(&self, target: &dyn Display, progress: &dyn Progress) {
        if self.step.is_some() || self.origin.is_some() {
            progress
                .note(&format!("{target}: --step and --origin are of no use here: they are for LAS and LAZ"));
        }
    }

    /// Says what was written.
    fn tell(&self, (vertices, triangles, bytes): (u64, u64, u64), tiles: &str, report: &mut Report) {
        report.figure("vertices", vertices);
        report.figure("triangles", triangles);
        report.figure("bytes", bytes);
        report.line(format!(
            "{} vertices and {} triangles in {tiles}{}, {}",
            count(vertices),
            count(triangles),
            self.output.display(),
            rate(vertices, report.seconds())
        ));
    }
}

/// Says what a converted model lacks, and to what its positions are rounded.
pub fn tell_losses(losses: &[String], rounding: Option<Rounding>, report: &mut Report) {
    report.figure("lost", json!(losses));
    if let Some(rounding) = rounding {
        let figures = json!({ "step": rounding.fraction() });
        report.figure("rounding", with_lengths(figures, &["step"], rounding.diagonal));
    }
    if !losses.is_empty() {
        report.warn(format!("what was lost: {}", losses.join("; ")));
    }
}
