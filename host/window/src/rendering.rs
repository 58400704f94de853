//! Pictures and turntables of the model as the window shows it: the questions before, and their beginning.

use crate::screenshot::{ScreenshotFormat, Shot};
use crate::turntable::{AskedPicture, AskedTurntable, FRAMES, Turning, TurntableWork, of_film};
use crate::viewport::detail::sample_dots;
use crate::window::{Commands, Window};
use simod_model::Result;
use simod_scene::SceneStyle;
use std::path::{Path, PathBuf};

/// The size of a window's picture, even as films have to be.
pub fn shown_size(window: &Window) -> [u32; 2] {
    window.state().size().map(|pixels| 2 * (0.5 * pixels).clamp(1.0, 4096.0) as u32)
}

/// Whether a picture or a turntable can be begun.
pub fn can_begin(window: &Window) -> bool {
    window.state().scene().is_some() && window.turning.is_none() && window.stopping.is_none()
}

/// Asks for the frames and the folder of a turntable.
pub fn ask(window: &Window, commands: &mut Commands) {
    let Some(editor) = window.state().editor() else { return };
    let beside = editor.path().or(editor.model()).map(|path| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        path.with_file_name(format!("{stem}-turntable"))
    });
    let folder = beside.unwrap_or_else(|| PathBuf::from("turntable")).display().to_string();
    let format = ScreenshotFormat { size: shown_size(window), transparent: false };
    commands.then(move |window| window.turntable = Some(AskedTurntable { folder, frames: FRAMES, format }));
}

/// Asks for the size and the file of a picture.
pub fn ask_for_picture(window: &Window, commands: &mut Commands) {
    let Some(editor) = window.state().editor() else { return };
    let beside = editor.path().or(editor.model()).map(|path| path.with_extension("png"));
    let file = beside.unwrap_or_else(|| PathBuf::from("picture.png")).display().to_string();
    let format = ScreenshotFormat { size: shown_size(window), transparent: false };
    commands.then(move |window| window.picture = Some(AskedPicture { file, format }));
}

/// Begins a turntable, as the window looks.
pub fn begin(window: &Window, commands: &mut Commands, folder: &Path, frames: u32, format: ScreenshotFormat) {
    begin_work(window, commands, TurntableWork::Turntable(frames), folder, of_film(format));
}

/// Begins a picture, as the window looks.
pub fn begin_picture(window: &Window, commands: &mut Commands, file: &Path, format: ScreenshotFormat) {
    begin_work(window, commands, TurntableWork::Picture, file, format);
}

fn begin_work(
    window: &Window,
    commands: &mut Commands,
    work: TurntableWork,
    target: &Path,
    format: ScreenshotFormat,
) {
    match shot_of(window) {
        Ok(shot) => {
            let ctx = window.ctx().clone();
            let shot = shot.formatted(format);
            let turning = Turning::begin(shot, work, target, move || ctx.request_repaint());
            commands.then(move |window| window.turning = Some(turning));
        }
        Err(error) => commands.then(move |window| window.toasts.error(&error)),
    }
}

/// The picture that a window shows, as it looks there, but without the marks for the work on the model:
/// selection and regions. Width and height are even, as films have to be.
///
/// # Errors
/// Nothing is open.
fn shot_of(window: &Window) -> Result<Shot> {
    let (looks, settings) = (window.looks, &window.settings);
    let (theme, occlusion, mode) = (settings.theme, settings.occlusion, window.mode());
    let light = settings.light.light();
    let mut shot = Shot::take(window.state())?;
    let detail = window.state().detail().filter(|_| looks.samples);
    shot.dots = sample_dots(shot.positions(), detail);
    shot.format = ScreenshotFormat { size: shown_size(window), transparent: false };
    shot.style = SceneStyle { mode, background: theme.background(), light, occlusion, ..shot.style };
    shot.ghost = looks.ghost;
    Ok(shot)
}
