//! `simod demo`: the main job on a generated model, from nothing to a picture.

use std::path::PathBuf;

use clap::Args;
use simod_core::guard::OutputKind;
use simod_core::reconstruction::Reconstruction;
use simod_generate::{ModelOptions, write_file};
use simod_model::{Error, Progress, Result, output};
use simod_picture::picture::{self, Crop, Drawn, PictureView, UpAxis};
use simod_picture::{Image, Paint};
use simod_session::{Run, SessionFile};

use super::overwrite::Overwrite;
use super::plugin_options::PluginArgs;
use super::run::{describe, describe_error};
use crate::report::{Report, count};

/// Do the main job on a generated model, and draw it before and after
///
/// The model is sampled, its samples are deformed with two plugins, and the deformed model is written. The
/// session that does it is written as well, to be changed and run again.
#[derive(Args)]
pub struct Demo {
    /// Folder to write to
    #[arg(short, long, default_value = "simod-demo", value_name = "DIR")]
    output: PathBuf,
    /// Number of vertices of the generated model
    #[arg(long, default_value_t = 2_000_000, value_name = "N")]
    vertices: u64,
    /// Number of samples
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    samples: u64,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// The session that the demo does; its number of samples is filled in.
const SESSION: &str = include_str!("demo.toml");

impl Demo {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        std::fs::create_dir_all(&self.output).map_err(|e| Error::io("create", &self.output, &e))?;
        let file = |name: &str| self.output.join(name);
        let mut guard = self.overwrite.guard();
        for (name, kind) in [
            ("amphora.ply", OutputKind::Model),
            ("session.toml", OutputKind::Session),
            ("amphora-edited.ply", OutputKind::Model),
            ("before-after.png", OutputKind::Picture),
        ] {
            guard.writes(&file(name), kind)?;
        }
        let plugins = PluginArgs::default().discover(report)?;
        let progress = report.progress();

        let options = ModelOptions { vertices: self.vertices, ..ModelOptions::default() };
        write_file(&options, &file("amphora.ply"), progress)?;
        let text = SESSION.replace("samples = 100000", &format!("samples = {}", self.samples));
        output::write_file(&file("session.toml"), text.as_bytes())?;

        let session = SessionFile::load(&file("session.toml"))?;
        let edited = file("amphora-edited.ply");
        let run = Run::execute(&session, &plugins, &Reconstruction::default(), true, &edited, progress)?;
        describe(&run, report);
        describe_error(&run.transfer_error(progress)?, run.deformed.sampled.bounds.diagonal(), report);
        self.picture_stages(&run, progress)?;

        for (name, what) in [
            ("amphora.ply", "the generated model"),
            ("session.toml", "what was done to it; change it, then `simod run` it"),
            ("amphora-edited.ply", "the deformed model"),
            ("before-after.png", "pictures of all stages"),
        ] {
            report.line(format!("  {:40} {what}", file(name).display().to_string()));
        }
        Ok(())
    }

    /// Draws the model and its samples beside each other, before and after.
    fn picture_stages(&self, run: &Run, progress: &dyn Progress) -> Result<()> {
        let sampled = &*run.deformed.sampled;
        let (before, after) =
            (simod_model::open(&self.output.join("amphora.ply"))?, simod_model::open(&run.output)?);
        let after_bounds = picture::bounds(after.as_ref(), progress)?;
        let mut all = sampled.bounds;
        all.include(after_bounds.min);
        all.include(after_bounds.max);
        let view = PictureView {
            bounds: all,
            yaw: 20.0,
            pitch: 10.0,
            size: [560, 700],
            up: UpAxis::Y,
            crop: Crop::default(),
        };
        let samples = &sampled.samples;
        // The faces of so many vertices are smaller than a picture's pixels.
        let how = (&Paint::Clay, Drawn::Points);
        let pictures = [
            picture::of_model(before.as_ref(), &sampled.bounds, &view, how, progress)?,
            picture::of_samples(sampled, &samples.positions, samples.normals(), &view, None),
            picture::of_samples(sampled, &run.deformed.positions.local, &run.deformed.normals, &view, None),
            picture::of_model(after.as_ref(), &after_bounds, &view, how, progress)?,
        ];
        let captions = [
            format!("{} vertices", count(sampled.source.vertices)),
            format!("{} samples", count(samples.len() as u64)),
            "samples, deformed".to_owned(),
            "all vertices, deformed".to_owned(),
        ];
        let panels: Vec<(&Image, &str)> = pictures.iter().zip(captions.iter().map(String::as_str)).collect();
        output::write_file(&self.output.join("before-after.png"), &Image::side_by_side(&panels).to_png()?)
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_session_is_one() {
        let session = simod_session::SessionFile::parse(super::SESSION, "demo.toml".as_ref());
        let session = session.expect("a session");
        assert_eq!(session.steps.len(), 2);
        assert_eq!(session.sampling.samples, Some(100_000));
    }
}
