//! Dialogs for files. Each waits on a thread of its own, as the window goes on.

use rfd::FileDialog;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// What a file is chosen for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Purpose {
    /// A model or a session to be opened.
    Open,
    /// The folder of a sampled model to be opened.
    OpenFolder,
    /// Where the session goes.
    Save,
    /// Where the deformed model goes.
    Write,
    /// A session to compare with.
    Pin,
    /// The folder for the frames of a turntable.
    Turntable,
    /// The value of a parameter of a step.
    Parameter {
        /// The step's place.
        step: usize,
        /// The parameter's id.
        id: String,
        /// The extensions that its name may have; any if there is none.
        extensions: Vec<String>,
    },
}

impl Purpose {
    /// What the user reads.
    pub fn title(&self) -> &'static str {
        match self {
            Self::Open => "Open a model or a session",
            Self::OpenFolder => "Open the folder of a sampled model",
            Self::Save => "Save the session",
            Self::Write => "Write the deformed model",
            Self::Pin => "Pin a session",
            Self::Turntable => "A new folder for the frames",
            Self::Parameter { .. } => "Choose a file",
        }
    }
}

/// A dialog that is open.
pub struct Dialog {
    /// What for.
    pub purpose: Purpose,
    since: Instant,
    chosen: Receiver<Option<PathBuf>>,
}

/// No hand is quicker.
const QUICKEST: Duration = Duration::from_millis(300);

impl Dialog {
    /// Opens it; it begins at this path. `wake` is called once the user has chosen.
    pub fn open(purpose: Purpose, at: Option<&Path>, wake: impl FnOnce() + Send + 'static) -> Self {
        let (sender, chosen) = channel();
        let mut dialog = FileDialog::new().set_title(purpose.title());
        if let Some(folder) = at.and_then(Path::parent).filter(|f| f.is_dir()) {
            dialog = dialog.set_directory(folder);
        }
        let name = |fallback: &str| {
            at.and_then(Path::file_name).map_or(fallback.to_owned(), |n| n.to_string_lossy().into_owned())
        };
        let ask: Box<dyn FnOnce() -> Option<PathBuf> + Send> = match &purpose {
            Purpose::Open => {
                let all: Vec<&str> = simod_model::extensions().chain(["toml"]).collect();
                let dialog = dialog.add_filter("Models, sessions", &all);
                let dialog = dialog.add_filter("All files", &["*"]);
                Box::new(move || dialog.pick_file())
            }
            Purpose::OpenFolder => Box::new(move || dialog.pick_folder()),
            Purpose::Save => {
                let dialog = dialog.add_filter("Session", &["toml"]);
                let dialog = dialog.set_file_name(name("session.toml"));
                Box::new(move || dialog.save_file())
            }
            Purpose::Write => {
                let dialog = dialog.set_file_name(name("deformed.ply"));
                Box::new(move || dialog.save_file())
            }
            Purpose::Pin => {
                let dialog = dialog.add_filter("Sessions", &["toml"]);
                Box::new(move || dialog.pick_file())
            }
            Purpose::Turntable => {
                let dialog = dialog.set_file_name(name("turntable"));
                Box::new(move || dialog.save_file())
            }
            Purpose::Parameter { extensions, .. } => {
                let dialog = match extensions.as_slice() {
                    [] => dialog,
                    some => dialog.add_filter("Files that it takes", some),
                };
                Box::new(move || dialog.pick_file())
            }
        };
        std::thread::spawn(move || {
            // Nobody waits any more once the window is closed.
            let _ = sender.send(ask());
            wake();
        });
        Self { purpose, since: Instant::now(), chosen }
    }

    /// Whether nobody could have closed it as quickly as that: the system has no dialogs.
    pub fn was_never_there(&self) -> bool {
        self.since.elapsed() < QUICKEST
    }

    /// What the user chose, once; nothing inside if the dialog was closed.
    pub fn answer(&self) -> Option<Option<PathBuf>> {
        match self.chosen.try_recv() {
            Ok(answer) => Some(answer),
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Err(std::sync::mpsc::TryRecvError::Disconnected) => Some(None),
        }
    }
}
