//! Questions, texts being typed, and reports, which hold something up until they are answered, done or read.

use simod_core::reconstruction::Reconstructed;
use simod_session::edit::StepId;
use simod_session::session_file::SamplingTable;
use simod_viewer::Camera;
use std::path::PathBuf;
use std::time::SystemTime;

/// A question that has to be answered before something goes on.
pub enum Question {
    /// The edit is not saved, and leaving it would lose it.
    Unsaved(Leaving),
    /// An edit of this path was kept against a crash.
    Recover(KeptEdit),
    /// The model of the opened session or folder is not at its place.
    Moved {
        /// The path that was opened.
        path: PathBuf,
        /// The place where the model was.
        model: PathBuf,
        /// Whether the model is open nevertheless, by its samples.
        is_open: bool,
    },
}

/// An edit that was kept against a crash.
#[derive(Clone)]
pub struct KeptEdit {
    /// Path of the session or model that was edited.
    pub path: PathBuf,
    /// Sampling of the model.
    pub sampling: SamplingTable,
    /// Time when the edit was kept, and its number of steps.
    pub made: SystemTime,
    pub steps: usize,
}

/// Action that waits until the user has said whether to save.
#[derive(Clone)]
pub enum Leaving {
    /// The window is closed.
    Close,
    /// Something else is opened.
    Open(PathBuf, SamplingTable),
}

/// A step, or a group, whose name is being typed.
#[derive(Clone)]
pub struct Renaming {
    /// The step, or the first one of the group.
    pub id: StepId,
    /// Whether the name is of the group that begins with the step.
    pub of_group: bool,
    /// The name so far.
    pub text: String,
    /// Whether typing is yet to begin.
    pub begins: bool,
}

/// The search for commands by name.
#[derive(Clone, Default)]
pub struct CommandPalette {
    /// The text that was typed.
    pub text: String,
    /// The place of the chosen action among those that are found.
    pub at: usize,
}

/// The report on a model that was written.
pub struct WriteReport {
    /// The file.
    pub output: PathBuf,
    /// Figures of the reconstruction.
    pub report: Reconstructed,
    /// Seconds that the writing took.
    pub seconds: f64,
}

/// The lesson that is being done.
pub struct RunningLesson {
    /// The lesson's place among [all](crate::lessons::ALL).
    pub lesson: usize,
    /// The part that is to be done; as many as there are parts once all are.
    pub part: usize,
    /// The lesson's model.
    pub model: PathBuf,
    /// Camera at the time when the part began.
    pub began: Option<Camera>,
}
