//! A turntable: frames of a full turn about the model's upright axis, drawn in the background; and single
//! pictures.

use crate::screenshot::{self, ScreenshotFormat, Shot};
use simod_model::progress::Progress;
use simod_model::{Error, Result, memory};
use simod_picture::FrameFolder;
use simod_viewer::engine::Activity;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Instant;

/// Number of frames unless told otherwise: four seconds of a film.
pub const FRAMES: u32 = 120;
/// Frames a second of a film unless told otherwise.
pub const RATE: u32 = 30;

/// Draws so many frames into a folder, which appears whole or not at all. The first frame is the picture as
/// it is; the camera goes to the right, round its target.
///
/// # Errors
/// There is nothing to draw with, the folder cannot be written or holds something else, or the user
/// cancelled.
pub fn write(shot: &Shot, folder: &Path, frames: u32, progress: &dyn Progress) -> Result<()> {
    let mut folder = FrameFolder::create(folder)?;
    progress.begin("drawing", frames.into());
    let mut studio = shot.studio()?;
    for k in 0..frames {
        progress.check()?;
        folder.push_png(&studio.png(TAU * f64::from(k) / f64::from(frames))?)?;
        progress.advance(1);
    }
    folder.commit()
}

/// Fields of the question before a turntable is drawn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AskedTurntable {
    /// The folder, which is to be made.
    pub folder: String,
    /// Frames of the turn.
    pub frames: u32,
    /// Size of the frames, and their background.
    pub format: ScreenshotFormat,
}

/// Fields of the question before a picture is drawn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AskedPicture {
    /// The file, which is to be made.
    pub file: String,
    /// Size of the picture, and its background.
    pub format: ScreenshotFormat,
}

/// Frames of a turntable, of which a film can be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Film {
    /// The folder of the frames.
    pub folder: PathBuf,
    /// The number of frames.
    pub frames: u32,
    /// Whether the background of the pictures is transparent.
    pub transparent: bool,
    /// Frames a second of the film.
    pub rate: u32,
}

/// Command line by which FFmpeg makes a film of the frames in a folder, beside the folder: H.264, which is
/// played everywhere, or ProRes where the background is transparent.
pub fn film(folder: &Path, rate: u32, transparent: bool) -> String {
    let quoted = |text: &str| format!("'{}'", text.replace('\'', "'\\''"));
    let folder = folder.display().to_string();
    let folder = folder.trim_end_matches(['/', '\\']);
    // A number of digits is told by a percent sign.
    let frames = quoted(&format!("{}/frame-%04d.png", folder.replace('%', "%%")));
    let (codec, extension) = match transparent {
        true => ("-c:v prores_ks -profile:v 4444 -pix_fmt yuva444p10le", "mov"),
        false => ("-c:v libx264 -crf 16 -pix_fmt yuv420p", "mp4"),
    };
    format!("ffmpeg -framerate {rate} -i {frames} {codec} {}", quoted(&format!("{folder}.{extension}")))
}

/// The format with even sides, as films take no others.
pub fn of_film(format: ScreenshotFormat) -> ScreenshotFormat {
    ScreenshotFormat { size: format.size.map(|side| side.next_multiple_of(2)), ..format }
}

/// The pictures that are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TurntableWork {
    /// A turntable of so many frames, into a folder.
    Turntable(u32),
    /// A picture, to a file.
    Picture,
}

/// Turntable or picture that is being drawn. When dropped, it is stopped, and leaves nothing.
pub struct Turning {
    watch: Arc<TurntableWatch>,
    made: Receiver<Result<()>>,
    thread: Option<JoinHandle<()>>,
    work: TurntableWork,
    target: PathBuf,
    transparent: bool,
    since: Instant,
}

struct TurntableWatch {
    done: AtomicU32,
    cancelled: AtomicBool,
    wake: Box<dyn Fn() + Send + Sync>,
}

impl Progress for TurntableWatch {
    fn begin(&self, _: &'static str, _: u64) {}

    fn advance(&self, frames: u64) {
        self.done.fetch_add(frames as u32, Relaxed);
        (self.wake)();
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Relaxed)
    }
}

impl Turning {
    /// Begins to draw, in a thread of its own, which calls `wake` after each frame.
    pub fn begin(
        shot: Shot,
        work: TurntableWork,
        target: &Path,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Self {
        let (done, cancelled) = (AtomicU32::new(0), AtomicBool::new(false));
        let watch = Arc::new(TurntableWatch { done, cancelled, wake: Box::new(wake) });
        let (sender, made) = channel();
        let (to, progress, transparent) = (target.to_owned(), watch.clone(), shot.is_transparent());
        let thread = std::thread::spawn(move || {
            // The result has no receiver once the window is closed.
            let _ = sender.send(match work {
                TurntableWork::Turntable(frames) => write(&shot, &to, frames, &*progress),
                TurntableWork::Picture => screenshot::write_shot(&shot, &to),
            });
            drop(sender);
            (progress.wake)();
        });
        let target = target.to_owned();
        Self { watch, made, thread: Some(thread), work, target, transparent, since: Instant::now() }
    }

    /// The progress so far.
    pub fn activity(&self) -> Activity {
        let (done, frames) = self.progress();
        let seconds = self.since.elapsed().as_secs_f64();
        Activity {
            stage: if frames > 1 { "drawing frames" } else { "drawing" },
            fraction: (frames > 1).then_some(done as f32 / frames as f32),
            rate: None,
            seconds,
            memory: memory::anonymous(),
        }
    }

    /// Number of frames that are drawn, and of all.
    pub fn progress(&self) -> (u32, u32) {
        let frames = match self.work {
            TurntableWork::Turntable(frames) => frames,
            TurntableWork::Picture => 1,
        };
        (self.watch.done.load(Relaxed), frames)
    }

    /// Whether the thread that draws is over.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops the drawing: nothing is left of it.
    pub fn cancel(&self) {
        self.watch.cancelled.store(true, Relaxed);
    }

    /// Result of the drawing, once it is over.
    pub fn made(&self) -> Option<Result<()>> {
        match self.made.try_recv() {
            Ok(made) => Some(made),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                let what = "the turntable ended with a mistake in the program";
                Some(Err(Error::internal(what)))
            }
        }
    }

    /// Message to the user once the frames or the picture are there.
    pub fn done(&self) -> String {
        match self.work {
            TurntableWork::Turntable(frames) => format!("{frames} frames are in {}.", self.target.display()),
            TurntableWork::Picture => format!("The picture is in {}.", self.target.display()),
        }
    }

    /// The name for the user.
    pub fn name(&self) -> &'static str {
        match self.work {
            TurntableWork::Turntable(_) => "Turntable",
            TurntableWork::Picture => "Picture",
        }
    }

    /// Frames of which a film can be made; none of a single picture.
    pub fn film(&self) -> Option<Film> {
        let TurntableWork::Turntable(frames) = self.work else { return None };
        let (folder, transparent) = (self.target.clone(), self.transparent);
        Some(Film { folder, frames, transparent, rate: RATE })
    }
}

impl Drop for Turning {
    fn drop(&mut self) {
        self.cancel();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::film;
    use std::path::Path;

    #[test]
    fn a_film_is_made_of_any_folder() {
        let text = film(Path::new("/a b/it's 5%/turn/"), 25, false);
        let frames = "'/a b/it'\\''s 5%%/turn/frame-%04d.png'";
        assert!(text.starts_with(&format!("ffmpeg -framerate 25 -i {frames} ")), "{text}");
        assert!(text.ends_with("'/a b/it'\\''s 5%/turn.mp4'"), "{text}");
        assert!(film(Path::new("turn"), 30, true).ends_with("yuva444p10le 'turn.mov'"));
    }
}
