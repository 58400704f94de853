//! `simod render`: a picture of a model or of its samples, without a window or a graphics card.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use glam::DVec3;
use serde_json::json;
use simod_core::guard::OutputKind;
use simod_core::sampled_model::SampledModel;
use simod_model::bounds::Bounds;
use simod_model::target::folder_of;
use simod_model::{Error, Result, output};
use simod_picture::picture::{self, Crop, Drawn, PictureView, UpAxis};
use simod_picture::{Coloring, FrameFolder, Image, Paint};

use super::overwrite::Overwrite;
use super::tell_cache;
use crate::report::Report;

/// Draw a model, or the samples of a sampled model, as a PNG picture
#[derive(Args)]
pub struct Render {
    /// Model, or folder of a sampled model
    #[arg(value_name = "MODEL|DIR")]
    path: PathBuf,
    /// PNG file to write, or with --turntable the folder of PNG files
    #[arg(short, long, value_name = "FILE|DIR")]
    output: PathBuf,
    /// Number of frames of a full turn to draw, into a folder
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(FrameFolder::MOST)))]
    turntable: Option<u32>,
    /// Angle of the camera about the vertical axis, in degrees
    #[arg(long, default_value_t = 25.0, allow_negative_numbers = true)]
    yaw: f64,
    /// Angle by which the camera looks down, in degrees
    #[arg(long, default_value_t = 12.0, allow_negative_numbers = true)]
    pitch: f64,
    /// Axis of the model that points up
    #[arg(long, value_enum, default_value_t)]
    up: UpName,
    /// Colours: own, clay, or an attribute, as intensity [default: own, where there are colours]
    ///
    /// `own` stands for the vertices' colours, those of splats from all sides; `clay` for one colour.
    #[arg(long, visible_alias = "color-by", value_name = "WHAT")]
    color: Option<String>,
    /// Draw vertices, or samples, without the faces between them
    #[arg(long)]
    points: bool,
    /// Point of the model to look at, as 0.5,1,-2 [default: the model's middle]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    target: Option<DVec3>,
    /// Part of the picture's width and height to show, from 0.001 to 1; 0.1 enlarges it ten times
    ///
    /// The part is around the target.
    #[arg(long, default_value_t = 1.0, value_name = "PART", value_parser = parse_part)]
    crop: f64,
    /// Width and height of the picture, in pixels
    #[arg(long, default_value = "1000x1000", value_name = "WxH", value_parser = parse_size)]
    size: [u32; 2],
    #[command(flatten)]
    overwrite: Overwrite,
}

/// The model's axis that points up.
#[derive(Clone, Copy, Default, ValueEnum)]
enum UpName {
    X,
    #[default]
    Y,
    Z,
}

impl From<UpName> for UpAxis {
    fn from(name: UpName) -> Self {
        match name {
            UpName::X => Self::X,
            UpName::Y => Self::Y,
            UpName::Z => Self::Z,
        }
    }
}

/// Longest side of a picture: 4 times as many pixels are held, of 64 bytes each, which is 3.5 GiB at most.
const MAX_SIDE: u32 = 3840;

fn parse_size(text: &str) -> std::result::Result<[u32; 2], String> {
    let side = |s: &str| s.parse().ok().filter(|n| (1..=MAX_SIDE).contains(n));
    let size = text.split_once('x').and_then(|(w, h)| Some([side(w)?, side(h)?]));
    size.ok_or_else(|| format!("a size is like 1920x1080, each side from 1 to {MAX_SIDE}"))
}

fn parse_point(text: &str) -> std::result::Result<DVec3, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|x| x.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err("a point is like 0.5,1,-2".to_owned()),
    }
}

fn parse_part(text: &str) -> std::result::Result<f64, String> {
    let part = text.parse().ok().filter(|part| (1e-3..=1.0).contains(part));
    part.ok_or_else(|| "a part is from 0.001 to 1".to_owned())
}

impl Render {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        // Obstacles to the output are reported before the model is read.
        let mut guard = self.overwrite.guard();
        guard.reads(&self.path);
        match self.turntable {
            Some(_) => guard.replaces_folder(&self.output)?,
            None => guard.writes(&self.output, OutputKind::Picture)?,
        }
        let mut folder = self.turntable.map(|_| FrameFolder::create(&self.output)).transpose()?;
        let mut take = |image: &Image| match &mut folder {
            Some(folder) => folder.push(image),
            None => output::write_file(&self.output, &image.to_png()?),
        };
        if self.path.is_dir() {
            self.draw_samples(&mut take, report)?;
        } else {
            self.draw_model(&mut take, report)?;
        }
        if let (Some(frames), Some(folder)) = (self.turntable, folder) {
            folder.commit()?;
            report.figure("frames", frames);
            report.line(format!(
                "drew {} as {frames} frames in {}",
                self.path.display(),
                self.output.display()
            ));
        } else {
            report.line(format!("drew {} as {}", self.path.display(), self.output.display()));
        }
        Ok(())
    }

    /// View of the picture.
    fn view(&self, bounds: Bounds) -> PictureView {
        let crop = Crop { around: self.target, part: self.crop };
        let Self { yaw, pitch, size, up, .. } = *self;
        PictureView { bounds, yaw, pitch, size, up: up.into(), crop }
    }

    /// Draws the samples of a folder, from one side or from all around.
    fn draw_samples(&self, take: &mut dyn FnMut(&Image) -> Result<()>, report: &mut Report) -> Result<()> {
        let sampled = SampledModel::load(&self.path)?;
        let (samples, view) = (&sampled.samples, self.view(sampled.bounds));
        report.figure("samples", samples.len());
        let (paint, colors) = self.of_samples(&sampled, report)?;
        let colors = colors.as_deref();
        tell_colors(&paint, colors.is_some(), report);
        let mut take = |image: &Image| take(&paint.with_legend(image));
        match self.turntable {
            Some(n) => {
                let (drawn, frames) = ((colors, !self.points), (n, &mut take as _));
                picture::turn_of_samples(&sampled, &view, drawn, frames, report.untimed())
            }
            None if self.points => take(&picture::of_discs(&sampled, &view, colors)),
            None => {
                let (positions, normals) = (&samples.positions, samples.normals());
                take(&picture::of_samples(&sampled, positions, normals, &view, colors))
            }
        }
    }

    /// Draws a model.
    fn draw_model(&self, take: &mut dyn FnMut(&Image) -> Result<()>, report: &mut Report) -> Result<()> {
        let (cache, progress) = (Arc::default(), report.progress());
        let model = simod_model::open_with(&self.path, None, &cache, progress)?;
        tell_cache(&cache, report);
        let coloring = Coloring::choose(self.color.as_deref(), &model.info().attributes)?;
        let bounds = picture::bounds(model.as_ref(), progress)?;
        if bounds.is_empty() {
            return Err(Error::degenerate(
                format!("{} has no vertex with a finite position", self.path.display()),
                "there is nothing to draw",
            ));
        }
        report.figure("vertices", model.info().vertices);
        let view = self.view(bounds);
        let paint = Paint::of_model(model.as_ref(), coloring, progress)?;
        tell_colors(&paint, paint.is_colored(), report);
        let mut take = |image: &Image| take(&paint.with_legend(image));
        let folder = folder_of(&self.output);
        let how = (&paint, if self.points { Drawn::Points } else { Drawn::Faces(folder) });
        match self.turntable {
            Some(n) => {
                let frames = (n, &mut take as _);
                picture::turn_of_model(model.as_ref(), &bounds, &view, how, frames, progress)
            }
            None => take(&picture::of_model(model.as_ref(), &bounds, &view, how, progress)?),
        }
    }

    /// Attribute by which samples are coloured, and their colours, unless all are alike.
    fn of_samples(
        &self,
        sampled: &SampledModel,
        report: &mut Report,
    ) -> Result<(Paint, Option<Vec<[u8; 3]>>)> {
        let word = self.color.as_deref();
        let own = matches!(word, None | Some("own")) && !sampled.colors.is_empty();
        if own {
            return Ok((Paint::Clay, Some(sampled.colors.clone())));
        }
        if let None | Some("clay") = word {
            return Ok((Paint::Clay, None));
        }
        let all = sampled.attributes(None, report.progress())?.all();
        let coloring = Coloring::choose(word, all.iter().map(|of| &of.attribute))?;
        let values: Vec<&[f32]> = all.iter().map(|of| &*of.values).collect();
        let paint = Paint::of_values(coloring, &values);
        let color = |i| paint.color(|place| f64::from(values[place][i]));
        let colors = (0..sampled.samples.len()).map(color).collect();
        Ok((paint, Some(colors)))
    }
}

/// Reports by what a picture is coloured, and the numbers at the ends of its legend.
fn tell_colors(paint: &Paint, is_colored: bool, report: &mut Report) {
    let (name, range) = match paint.legend() {
        Some((name, range)) => (name, Some(range)),
        None => (if is_colored { "own" } else { "clay" }, None),
    };
    report.figure("color", name);
    report.figure("color_range", json!(range));
}
