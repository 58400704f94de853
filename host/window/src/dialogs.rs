//! Dialogs for files. Each dialog waits on a thread of its own, as the window goes on.

use rfd::FileDialog;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// Purpose for which a file is chosen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Purpose {
    /// A model or a session to be opened.
    Open,
    /// The folder of a sampled model to be opened.
    OpenFolder,
    /// A place for the session.
    Save,
    /// A place for the deformed model.
    Write,
    /// A session to compare with.
    Pin,
    /// The folder for the frames of a turntable.
    Turntable,
    /// A place for a picture.
    Picture,
    /// The present place of a model that a session, or the folder of a sampled model, remembers at another
    /// place.
    Locate {
        /// Path of the session or folder that was to be opened.
        path: PathBuf,
        /// Path of the model as the session or folder remembers it.
        model: PathBuf,
    },
    /// The value of a parameter of a step.
    Parameter {
        /// The step's place.
        step: usize,
        /// The parameter's id.
        id: String,
        /// Extensions that the file's name may have; any if there is none.
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

    /// Whether the chosen path is of a file or folder that will be made.
    pub fn makes(&self) -> bool {
        matches!(self, Self::Save | Self::Write | Self::Turntable | Self::Picture)
    }

    /// Extensions of the files that are of use for the purpose; all files are where the list is empty.
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

/// Outcome of a dialog.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DialogAnswer {
    /// The path that the user chose.
    Chosen(PathBuf),
    /// The user closed the dialog.
    Closed,
    /// The system has no dialogs, for this reason.
    Absent(String),
}

/// Function that shows a dialog: called on a thread of its own, with the dialog's purpose and the path at
/// which the dialog begins. The function asks [`DialogTurn::take`] right before the user sees the dialog.
pub type Chooser = Arc<dyn Fn(&Purpose, Option<&Path>, &DialogTurn) -> DialogAnswer + Send + Sync>;

/// Side that may answer: the system's dialog, or the window, which went on without the dialog.
#[derive(Default)]
pub struct DialogTurn(AtomicU8);

const SHOWN: u8 = 1;
const LEFT: u8 = 2;

impl DialogTurn {
    /// Marks the dialog as shown; `false` if the window went on without the dialog, which must not be shown
    /// then.
    pub fn take(&self) -> bool {
        self.0.compare_exchange(0, SHOWN, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }

    /// Marks that the window goes on without the dialog; `false` if the dialog is shown already.
    fn leave(&self) -> bool {
        self.0.compare_exchange(0, LEFT, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }
}

/// Time that a system may take to say whether it has dialogs, before the window goes on with its own.
const PATIENCE: Duration = Duration::from_secs(2);

/// A dialog that is open, or about to be.
pub struct Dialog {
    /// The dialog's purpose.
    pub purpose: Purpose,
    /// Path at which the dialog began.
    pub at: Option<PathBuf>,
    turn: Arc<DialogTurn>,
    since: Instant,
    answer: Receiver<DialogAnswer>,
}

impl Dialog {
    /// Opens a dialog that begins at this path. `wake` is called once there is an answer.
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
            // The answer has no receiver once the window is closed, or went on without the dialog.
            let _ = sender.send(answer);
            wake();
        });
        Self { purpose, at, turn, since: Instant::now(), answer }
    }

    /// Outcome of the dialog, given once. A system that is silent for too long counts as one without
    /// dialogs.
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

    /// Time until an answer has to be looked for again, if nothing wakes the window before.
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

/// Checks that the system has dialogs, which it always has.
///
/// # Errors
/// Reason why the system has none; never here.
#[cfg(not(all(unix, not(target_os = "macos"))))]
fn available() -> Result<(), String> {
    Ok(())
}

/// Checks that the system has dialogs: a desktop portal answers, or zenity is there.
///
/// # Errors
/// Reason why the system has no dialogs.
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
