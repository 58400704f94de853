//! Lessons: edits of generated models, done by the user with the window beside. The text of each part says
//! what to do. The lesson goes on as soon as the part is done, by whatever way; or does the part itself, by
//! the commands that the user would give.

mod doing;
mod lesson;
mod texts;

use crate::example;
use crate::tools::Tool;
use crate::window::{Commands, RunningLesson, Window};
pub use lesson::{Exercise, Lesson};
use simod_model::Result;
use simod_session::session_file::SamplingTable;
use simod_viewer::{Command, Overlay, state};
use std::path::PathBuf;
pub use texts::ALL;

/// Vertices of a lesson's model: enough for smooth surfaces, and few enough that all answers come at once.
const VERTICES: u64 = 60_000;
const SAMPLES: u64 = 20_000;

/// The lesson that is being done.
pub fn lesson_of(running: &RunningLesson) -> &'static Lesson {
    &ALL[running.lesson]
}

/// Exercise that is to be done now; nothing once all are done.
pub fn part_of(running: &RunningLesson) -> Option<&'static Exercise> {
    lesson_of(running).parts.get(running.part)
}

/// Whether the lesson's model is open.
pub fn is_open(running: &RunningLesson, window: &Window) -> bool {
    let is_it = window.opened() == Some(&*running.model);
    is_it && window.state().scene().is_some() && !window.state().is_opening()
}

/// Opens a lesson's model, and begins.
pub fn begin(commands: &mut Commands, lesson: usize) {
    match open(commands, lesson) {
        Ok(model) => {
            // An overlay or a version that the lesson before showed has nothing to do with this one.
            commands.apply(Command::Show(Overlay::None));
            commands.then(move |window| {
                (window.looks.side_by_side, window.looks.pinned_in_place) = (false, false);
                window.tools.take(Tool::Orbit);
                window.lesson = Some(RunningLesson { lesson, part: 0, model, began: None });
            });
        }
        Err(error) => commands.then(move |window| window.toasts.error(&error)),
    }
}

fn open(commands: &mut Commands, lesson: usize) -> Result<PathBuf> {
    let Lesson { shape, file, .. } = &ALL[lesson];
    let model = example::model(file, *shape, VERTICES)?;
    // An edit that was kept from the lesson before is not the beginning of this one.
    state::forget(&model)?;
    let opened = model.clone();
    let sampling = SamplingTable { samples: Some(SAMPLES), ..SamplingTable::default() };
    commands.then(move |window| window.ask_to_open_sampled(opened, sampling));
    Ok(model)
}

/// Goes on to the next exercise where the present one is done. To be called before each picture.
pub fn update(window: &mut Window) {
    let Some(mut running) = window.lesson.take() else { return };
    if is_open(&running, window) {
        let began = *running.began.get_or_insert(*window.state().camera());
        // A part counts as done only once the hand rests.
        let rests = !window.tools.gesture.is_dragging() && !window.state().is_drawing();
        if rests && part_of(&running).is_some_and(|part| (part.done)(window, &began)) {
            (running.part, running.began) = (running.part + 1, None);
            window.ctx().request_repaint();
        }
    }
    window.lesson = Some(running);
}

/// Commands for the part that is to be done.
pub fn do_it(window: &Window, commands: &mut Commands) {
    let part = window.lesson.as_ref().filter(|running| is_open(running, window)).and_then(part_of);
    if let Some(part) = part {
        (part.run)(window, commands);
    }
}
