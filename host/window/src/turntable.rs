//! A turntable: frames of a full turn about the model's upright axis, drawn in the background.

use crate::panels;
use crate::screenshot::Shot;
use crate::window::Window;
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

/// So many frames unless told otherwise: four seconds of a film.
pub const FRAMES: u32 = 120;

/// Draws so many frames into a folder, which appears whole or not at all. The first is the picture as it is;
/// the camera goes to the right, round its target.
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
        folder.push(&studio.picture(TAU * f64::from(k) / f64::from(frames))?)?;
        progress.advance(1);
    }
    folder.commit()
}

/// Whether one can be begun.
pub fn can_begin(window: &Window) -> bool {
    window.state().scene().is_some() && window.turning.is_none() && window.stopping.is_none()
}

/// Asks how many frames, and where they go.
pub fn ask(window: &mut Window) {
    let Some(editor) = window.state().editor() else { return };
    let beside = editor.path().or(editor.model()).map(|path| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        path.with_file_name(format!("{stem}-turntable"))
    });
    let folder = beside.unwrap_or_else(|| PathBuf::from("turntable")).display().to_string();
    window.turntable = Some(panels::Turntable { folder, frames: FRAMES });
}

/// Begins one, as the window looks.
pub fn begin(window: &mut Window, folder: &Path, frames: u32) {
    match Shot::of_window(window) {
        Ok(shot) => {
            let ctx = window.ctx().clone();
            let turning = Turning::begin(shot, folder, frames, move || ctx.request_repaint());
            window.turning = Some(turning);
        }
        Err(error) => window.toasts.error(&error),
    }
}

/// One that is being drawn. Dropped, it is stopped, and leaves nothing.
pub struct Turning {
    watch: Arc<Watch>,
    made: Receiver<Result<()>>,
    thread: Option<JoinHandle<()>>,
    folder: PathBuf,
    frames: u32,
    since: Instant,
}

struct Watch {
    done: AtomicU32,
    cancelled: AtomicBool,
    wake: Box<dyn Fn() + Send + Sync>,
}

impl Progress for Watch {
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
    fn begin(shot: Shot, folder: &Path, frames: u32, wake: impl Fn() + Send + Sync + 'static) -> Self {
        let (done, cancelled) = (AtomicU32::new(0), AtomicBool::new(false));
        let watch = Arc::new(Watch { done, cancelled, wake: Box::new(wake) });
        let (sender, made) = channel();
        let (to, progress) = (folder.to_owned(), watch.clone());
        let thread = std::thread::spawn(move || {
            // Nobody waits any more once the window is closed.
            let _ = sender.send(write(&shot, &to, frames, &*progress));
            drop(sender);
            (progress.wake)();
        });
        let folder = folder.to_owned();
        Self { watch, made, thread: Some(thread), folder, frames, since: Instant::now() }
    }

    /// How far it is.
    pub fn activity(&self) -> Activity {
        let (done, frames) = self.progress();
        let seconds = self.since.elapsed().as_secs_f64();
        Activity {
            stage: "drawing frames",
            fraction: Some(done as f32 / frames as f32),
            rate: None,
            seconds,
            memory: memory::anonymous(),
        }
    }

    /// Frames that are drawn, of how many.
    pub fn progress(&self) -> (u32, u32) {
        (self.watch.done.load(Relaxed), self.frames)
    }

    /// Whether its thread is over.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops it: nothing is left.
    pub fn cancel(&self) {
        self.watch.cancelled.store(true, Relaxed);
    }

    /// What it came to, once it is over.
    pub fn made(&self) -> Option<Result<()>> {
        match self.made.try_recv() {
            Ok(made) => Some(made),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                let what = "the turntable ended with a mistake in the program";
                Some(Err(Error::internal(what, "report this")))
            }
        }
    }

    /// What the user reads when it is there.
    pub fn done(&self) -> String {
        format!("{} frames are in {}.", self.frames, self.folder.display())
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
