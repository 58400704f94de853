//! The command line.

use crate::screenshot::LARGEST;
use crate::turntable::FRAMES;
use clap::Parser;
use simod_picture::FrameFolder;
use std::path::PathBuf;

/// Edit a model of any size in a window
#[derive(Parser)]
#[command(name = "simod-viewer", version, max_term_width = 100)]
pub struct WindowArguments {
    /// Model, folder of a sampled model, or session (session.toml)
    pub path: Option<PathBuf>,
    /// Number of samples to take of a model, approximately
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// File to write all commands to, one a line
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// File of recorded commands to do
    #[arg(long, value_name = "FILE", conflicts_with = "path")]
    pub replay: Option<PathBuf>,
    /// Do the recorded commands without a window
    #[arg(long, requires = "replay")]
    pub no_window: bool,
    /// PNG file to draw the scene to, without a window
    ///
    /// The scene is that after the recorded commands. The program ends then.
    #[arg(long, value_name = "PNG")]
    pub screenshot: Option<PathBuf>,
    /// Width and height of the picture, or of the turntable's frames, in pixels
    #[arg(long, value_name = "WxH", default_value = "1600x1000", value_parser = size)]
    pub size: [u32; 2],
    /// Leave the background transparent
    #[arg(long)]
    pub transparent: bool,
    /// Folder to draw the frames of a full turn of the scene to, without a window
    ///
    /// The program ends then.
    #[arg(long, value_name = "DIR")]
    pub turntable: Option<PathBuf>,
    /// Number of frames of the turntable
    #[arg(long, value_name = "N", default_value_t = FRAMES, requires = "turntable",
        value_parser = clap::value_parser!(u32).range(1..=i64::from(FrameFolder::MOST)))]
    pub frames: u32,
}

/// Width and height, as `1920x1080`.
fn size(text: &str) -> std::result::Result<[u32; 2], String> {
    let sides =
        text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    let sides = sides.filter(|sides: &[u32; 2]| sides.iter().all(|side| (1..=LARGEST).contains(side)));
    sides.ok_or_else(|| format!("give width and height, as 1920x1080, of at most {LARGEST} pixels each"))
}
