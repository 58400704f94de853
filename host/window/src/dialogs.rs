//! Dialogs for files. Each waits on a thread of its own, as the window goes on.

use rfd::FileDialog;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// What a file is chosen for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Purpose {
    /// A model or a session to be opened.
    Open,
    /// The folder of a sampled model to be opened.
    OpenFolder,
    /// A place for the session.
    Save,
    /// Where the deformed model goes.
    Write,
    /// A session to compare with.
    Pin,
    /// The folder for the frames of a turntable.
    Turntable,
    /// A place for a picture.
    Picture,
    /// Where a model is that something remembers at another place.
    Locate {
        /// What was to be opened.
        path: PathBuf,
        /// The model's path as it is remembered.
        model: PathBuf,
    },
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
    /// The dialog's title.
    pub fn title(&self) -> &'static str {
        match self {
            Self::Open => "Open a model or a session",
            Self::OpenFolder => "Open the folder of a sampled model",
            Self::Save => "Save the session",
            Self::Write => "Write the deformed model",
            Self::Pin => "Pin a session",
            Self::Picture => "Save the picture",
            Self::Turntable => "A new folder for the frames",
            Self::Locate { .. } => "Locate the model",
            Self::Parameter { .. } => "Choose a file",
        }
    }

    /// Whether the path is of something that will be made.
    pub fn makes(&self) -> bool {
        matches!(self, Self::Save | Self::Write | Self::Turntable | Self::Picture)
    }

    /// Extensions of files that are of use; all are where there is none.
    pub fn extensions(&self) -> Vec<&str> {
        match self {
            Self::Open => simod_model::extensions().chain(["toml"]).collect(),
            Self::Locate { .. } => simod_model::extensions().collect(),
            Self::Pin | Self::Save => vec!["toml"],
            Self::Picture => vec!["png"],
            Self::Parameter { extensions, .. } => extensions.iter().map(String::as_str).collect(),
            Self::OpenFolder | Self::Write | Self::Turntable => Vec::new(),
        }
    }
}

/// What came of a dialog.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DialogAnswer {
    /// The user chose this.
    Chosen(PathBuf),
    /// The user closed it.
    Closed,
    /// The system has no dialogs; why.
    Absent(String),
}

/// A function that shows a dialog: called on a thread of its own, with its purpose and where it begins. It
/// asks [`DialogTurn::take`] right before the user sees it.
pub type Chooser = Arc<dyn Fn(&Purpose, Option<&Path>, &DialogTurn) -> DialogAnswer + Send + Sync>;

/// The side that may answer: the system's dialog, or the window, which went on without it.
#[derive(Default)]
pub struct DialogTurn(AtomicU8);

const SHOWN: u8 = 1;
const LEFT: u8 = 2;

impl DialogTurn {
    /// The dialog is shown now; `false` if the window went on without it, and it must not be.
    pub fn take(&self) -> bool {
        self.0.compare_exchange(0, SHOWN, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }

    /// The window goes on without it; `false` if it is shown already.
    fn leave(&self) -> bool {
        self.0.compare_exchange(0, LEFT, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }
}

/// So long a system may take to say whether it has dialogs, before the window goes on with its own.
const PATIENCE: Duration = Duration::from_secs(2);

/// A dialog that is open, or about to be.
pub struct Dialog {
    /// The dialog's purpose.
    pub purpose: Purpose,
    /// The path that it began with.
    pub at: Option<PathBuf>,
    turn: Arc<DialogTurn>,
    since: Instant,
    answer: Receiver<DialogAnswer>,
}

impl Dialog {
    /// Opens it; it begins at this path. `wake` is called once there is an answer.
    pub fn open(
        chooser: Chooser,
        purpose: Purpose,
        at: Option<PathBuf>,
        wake: impl FnOnce() + Send + 'static,
    ) -> Self {
        let (sender, answer) = channel();
        let turn = Arc::new(DialogTurn::default());
        let (what, begin, turns) = (purpose.clone(), at.clone(), turn.clone());
        std::thread::spawn(move || {
            let answer = chooser(&what, begin.as_deref(), &turns);
            // Nobody waits any more once the window is closed, or went on without it.
            let _ = sender.send(answer);
            wake();
        });
        Self { purpose, at, turn, since: Instant::now(), answer }
    }

    /// What came of it, once. A system that says nothing has no dialogs.
    pub fn answer(&self) -> Option<DialogAnswer> {
        match self.answer.try_recv() {
            Ok(answer) => Some(answer),
            Err(TryRecvError::Disconnected) => Some(DialogAnswer::Absent("it went away".to_owned())),
            Err(TryRecvError::Empty) if self.since.elapsed() > PATIENCE && self.turn.leave() => {
                Some(DialogAnswer::Absent("it does not answer".to_owned()))
            }
            Err(TryRecvError::Empty) => None,
        }
    }

    /// When to look for an answer again, if nothing wakes the window before.
    pub fn patience(&self) -> Duration {
        PATIENCE.saturating_sub(self.since.elapsed()) + Duration::from_millis(10)
    }
}

/// The system's dialogs.
pub fn system() -> Chooser {
    Arc::new(|purpose: &Purpose, at: Option<&Path>, turn: &DialogTurn| {
        if let Err(why) = available() {
            return DialogAnswer::Absent(why);
        }
        if !turn.take() {
            return DialogAnswer::Closed;
        }
        chosen(purpose, at).map_or(DialogAnswer::Closed, DialogAnswer::Chosen)
    })
}

/// Whether the system has dialogs.
///
/// # Errors
/// Why there is none.
#[cfg(not(all(unix, not(target_os = "macos"))))]
fn available() -> Result<(), String> {
    Ok(())
}

/// Whether the system has dialogs: a desktop portal answers, or zenity is there.
///
/// # Errors
/// Why there is none.
#[cfg(all(unix, not(target_os = "macos")))]
fn available() -> Result<(), String> {
    let Err(error) = pollster::block_on(portal()) else { return Ok(()) };
    let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let has_screen = is_set("DISPLAY") || is_set("WAYLAND_DISPLAY");
    let paths = std::env::var_os("PATH").unwrap_or_default();
    if has_screen && std::env::split_paths(&paths).any(|folder| folder.join("zenity").is_file()) {
        return Ok(());
    }
    Err(format!("no desktop portal answers ({error}), and zenity is not installed"))
}

/// The version of the desktop portal's dialogs for files.
#[cfg(all(unix, not(target_os = "macos")))]
async fn portal() -> zbus::Result<()> {
    let bus = zbus::Connection::session().await?;
    let which = ("org.freedesktop.portal.FileChooser", "version");
    let (at, properties) = ("/org/freedesktop/portal/desktop", Some("org.freedesktop.DBus.Properties"));
    bus.call_method(Some("org.freedesktop.portal.Desktop"), at, properties, "Get", &which).await.map(drop)
}

fn chosen(purpose: &Purpose, at: Option<&Path>) -> Option<PathBuf> {
    let mut dialog = FileDialog::new().set_title(purpose.title());
    if let Some(folder) = at.and_then(Path::parent).filter(|f| f.is_dir()) {
        dialog = dialog.set_directory(folder);
    }
    let name = |fallback: &str| {
        at.and_then(Path::file_name).map_or(fallback.to_owned(), |n| n.to_string_lossy().into_owned())
    };
    let extensions = purpose.extensions();
    let filter = match purpose {
        Purpose::Open => "Models, sessions",
        Purpose::Locate { .. } => "Models",
        Purpose::Save | Purpose::Pin => "Sessions",
        _ => "Files that it takes",
    };
    if !extensions.is_empty() {
        dialog = dialog.add_filter(filter, &extensions);
    }
    match purpose {
        Purpose::Open | Purpose::Locate { .. } => dialog.add_filter("All files", &["*"]).pick_file(),
        Purpose::OpenFolder => dialog.pick_folder(),
        Purpose::Save => dialog.set_file_name(name("session.toml")).save_file(),
        Purpose::Write => dialog.set_file_name(name("deformed.ply")).save_file(),
        Purpose::Turntable => dialog.set_file_name(name("turntable")).save_file(),
        Purpose::Picture => dialog.set_file_name(name("picture.png")).save_file(),
        Purpose::Pin | Purpose::Parameter { .. } => dialog.pick_file(),
    }
}
