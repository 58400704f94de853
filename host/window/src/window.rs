//! The state, and what is the window's own.

use crate::dialogs::{Dialog, Purpose};
use crate::panels::{Palette, Prompt, Report, Toasts};
use crate::settings::Settings;
use crate::tools::Tools;
use crate::turntable::Turning;
use crate::{example, theme};
use eframe::egui;
use simod_model::{Error, ErrorKind};
use simod_session::edit::{self, Change, Entry, StepId};
use simod_session::session_file::{Deformation, Sampling};
use simod_session::{Plugin, PluginRegistry};
use simod_viewer::record::Recorder;
use simod_viewer::state::{self, Notice};
use simod_viewer::{Command, State, Version};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often an edit is kept against a crash.
const KEEP: Duration = Duration::from_secs(20);

/// What is shown besides the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Looks {
    /// Triangles instead of discs.
    pub triangles: bool,
    /// The shape at rest.
    pub ghost: bool,
    /// Dots for samples in whose place vertices are shown.
    pub samples: bool,
    /// The regions of the chosen step, in colours.
    pub regions: bool,
    /// The handles that the chosen step's plugin placed.
    pub handles: bool,
    /// The pinned version beside the one that is worked on.
    pub side_by_side: bool,
    /// The pinned version in its place.
    pub pinned_in_place: bool,
}

impl Default for Looks {
    fn default() -> Self {
        Self {
            triangles: false,
            ghost: false,
            samples: false,
            regions: true,
            handles: true,
            side_by_side: false,
            pinned_in_place: false,
        }
    }
}

/// A question that has to be answered before something goes on.
pub enum Question {
    /// The edit is not saved, and this would lose it.
    Unsaved(Leaving),
    /// An edit of this path was kept against a crash.
    Recover(PathBuf, Sampling),
}

/// What was about to be done when there was something to be saved.
#[derive(Clone)]
pub enum Leaving {
    /// The window is closed.
    Close,
    /// Something else is opened.
    Open(PathBuf, Sampling),
}

/// A window, but for its picture.
pub struct Window {
    state: State,
    ctx: egui::Context,
    /// What the user likes.
    pub settings: Settings,
    /// The tools, and which one is in the hand.
    pub tools: Tools,
    /// What is shown.
    pub looks: Looks,
    /// Whether a button is held that shows the pinned version.
    pub holds_pinned: bool,
    /// What is asked before a turntable is drawn, while it is.
    pub turntable: Option<crate::panels::Turntable>,
    /// The turntable that is being drawn.
    pub turning: Option<Turning>,
    /// Messages that go away.
    pub toasts: Toasts,
    /// Commands by name, while they are looked for.
    pub palette: Option<Palette>,
    /// What became of the model that was written last, while it is read.
    pub report: Option<Report>,
    /// The list of keys, while it is read.
    pub shows_keys: bool,
    /// A path that is typed, where the system has no dialogs.
    pub prompt: Option<Prompt>,
    /// To be answered first.
    pub question: Option<Question>,
    dialog: Option<Dialog>,
    /// Where the dialog began.
    typed: String,
    leaving: bool,
    /// What goes on once the edit is saved.
    after: Option<Leaving>,
    title: String,
    opened: Option<PathBuf>,
    /// Whether what was opened is still to come.
    awaited: bool,
    recorded: VecDeque<Command>,
    kept: Instant,
    /// How long the last picture took, for the status line.
    pub frame_time: Duration,
}

impl Window {
    /// With nothing open.
    pub fn new(ctx: &egui::Context, plugins: Arc<PluginRegistry>, settings: Settings) -> Self {
        theme::apply(ctx, settings.theme);
        let waker = ctx.clone();
        let mut toasts = Toasts::default();
        for rejected in plugins.rejected() {
            toasts.error(&rejected.error);
        }
        Self {
            state: State::new(plugins, Arc::new(move || waker.request_repaint())),
            ctx: ctx.clone(),
            settings,
            tools: Tools::default(),
            looks: Looks::default(),
            holds_pinned: false,
            turning: None,
            turntable: None,
            toasts,
            palette: None,
            report: None,
            shows_keys: false,
            prompt: None,
            question: None,
            dialog: None,
            typed: String::new(),
            leaving: false,
            after: None,
            title: String::new(),
            opened: None,
            awaited: false,
            recorded: VecDeque::new(),
            kept: Instant::now(),
            frame_time: Duration::ZERO,
        }
    }

    /// The state, to be read; it changes by [`apply`](Self::apply) alone.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The state where reading it takes a cache.
    pub fn state_mut(&mut self) -> &mut State {
        &mut self.state
    }

    /// egui's.
    pub fn ctx(&self) -> &egui::Context {
        &self.ctx
    }

    /// Records all commands.
    pub fn record(&mut self, recorder: Option<Recorder>) {
        self.state.record(recorder);
    }

    /// Does these commands, each when the one before is done.
    pub fn replay(&mut self, commands: Vec<Command>) {
        self.recorded.extend(commands);
    }

    /// Whether something has to be answered before anything else.
    pub fn is_asking(&self) -> bool {
        let asks = self.question.is_some() || self.turntable.is_some();
        asks || self.palette.is_some() || self.prompt.is_some()
    }

    /// Does a command; an error is shown to the user. Whether it was done.
    pub fn apply(&mut self, command: Command) -> bool {
        let done = self.state.apply(command);
        if let Err(error) = &done {
            self.toasts.error(error);
        }
        self.ctx.request_repaint();
        done.is_ok()
    }

    /// Changes a step, or drags something of it.
    pub fn change(&mut self, at: usize, change: Change, dragging: bool) -> bool {
        let change = edit::Command::Change { at, change };
        self.apply(if dragging { Command::Drag(change) } else { Command::Edit(change) })
    }

    /// The steps; none if nothing is open.
    pub fn steps(&self) -> Arc<[Entry]> {
        self.state.document().map(|document| document.steps().clone()).unwrap_or_default()
    }

    /// The chosen step, if it deforms: its place, which it is, what it does, and its plugin, if it is there.
    pub fn chosen(&self) -> Option<(usize, StepId, Deformation, Option<Arc<Plugin>>)> {
        let at = self.state.chosen()?;
        let steps = self.steps();
        let entry = steps.get(at)?;
        let deformation = entry.step.deformation()?.clone();
        let plugin = self.state.plugins().get(&deformation.deform).ok().cloned();
        Some((at, entry.id, deformation, plugin))
    }

    /// Takes what is new. To be called before each picture.
    pub fn update(&mut self) {
        self.state.poll();
        for notice in self.state.take_notices() {
            match notice {
                Notice::Note(text) => self.toasts.note(text),
                Notice::Failed(_, error) if error.kind() == ErrorKind::Cancelled => {
                    self.toasts.note("Stopped.");
                }
                Notice::Failed(_, error) => self.toasts.error(&error),
                Notice::Written(output, report, seconds) => {
                    self.report = Some(Report::new(output, *report, seconds));
                }
            }
        }
        if self.awaited && self.state.is_settled() {
            self.awaited = false;
            self.choose_last();
        }
        if let Some(made) = self.turning.as_ref().and_then(Turning::made) {
            let turning = self.turning.take();
            match (made, turning) {
                (Ok(()), Some(turning)) => self.toasts.note(turning.done()),
                (Err(error), _) if error.kind() == ErrorKind::Cancelled => self.toasts.note("Stopped."),
                (Err(error), _) => self.toasts.error(&error),
                _ => {}
            }
        }
        self.name();
        self.take_answer();
        self.go_on_replaying();
        if self.kept.elapsed() > KEEP {
            self.keep();
        }
        self.ctx.request_repaint_after(KEEP);
    }

    /// The window is called as what is open.
    fn name(&mut self) {
        let path = self.state.editor().and_then(|editor| editor.path().or(editor.model()));
        let name =
            path.and_then(Path::file_name).map(|name| format!("{} \u{2013} SIMOD", name.to_string_lossy()));
        let name = name.unwrap_or_else(|| "SIMOD".to_owned());
        if name != self.title {
            self.ctx.send_viewport_cmd(egui::ViewportCommand::Title(name.clone()));
            self.title = name;
        }
    }

    /// Looks for plugins once more.
    pub fn look_for_plugins(&mut self) {
        let plugins = crate::arguments::discover();
        self.toasts.note(format!("{} plugins are there.", plugins.plugins().len()));
        plugins.rejected().iter().for_each(|rejected| self.toasts.error(&rejected.error));
        self.state.set_plugins(Arc::new(plugins));
    }

    /// The last step that deforms is what somebody goes on with who opens a session.
    fn choose_last(&mut self) {
        let step = self.steps().iter().rposition(|entry| entry.step.deformation().is_some());
        if step.is_some() && self.state.chosen().is_none() {
            self.apply(Command::Choose { step });
        }
    }

    /// Keeps the edit against a crash.
    pub fn keep(&mut self) {
        self.kept = Instant::now();
        if let Err(error) = self.state.autosave() {
            self.toasts.error(&error);
        }
    }

    fn go_on_replaying(&mut self) {
        let pins = |state: &State| state.pinned().is_some() && state.scene_of(Version::Pinned).is_none();
        while self.state.is_settled()
            && !pins(&self.state)
            && let Some(command) = self.recorded.pop_front()
        {
            if !self.apply(command) {
                self.recorded.clear();
            }
        }
    }

    /// Whether there is an edit that is in no file.
    fn is_unsaved(&self) -> bool {
        self.state.editor().is_some_and(|editor| {
            !editor.is_saved() && (editor.path().is_some() || !editor.document().steps().is_empty())
        })
    }

    /// Opens something, after questions that have to be asked before.
    pub fn ask_to_open(&mut self, path: PathBuf) {
        self.after = None;
        let sampling = crate::arguments::sampling(Some(self.settings.samples));
        if self.is_unsaved() {
            self.question = Some(Question::Unsaved(Leaving::Open(path, sampling)));
        } else {
            self.open(path, sampling, false);
        }
    }

    /// Opens something; what was kept of it against a crash is offered.
    pub fn open(&mut self, path: PathBuf, sampling: Sampling, recover: bool) {
        if !recover && matches!(state::recoverable(&path), Ok(Some(_))) {
            self.question = Some(Question::Recover(path, sampling));
            return;
        }
        self.open_now(path, sampling, recover);
    }

    /// Opens it, whatever was kept.
    pub fn open_now(&mut self, path: PathBuf, sampling: Sampling, recover: bool) {
        if !path.exists() {
            let what = format!("there is no file {}", path.display());
            self.toasts.error(&Error::new(ErrorKind::Io, what, "check the path, or choose another file"));
            return;
        }
        // A session says itself how its model is sampled.
        let is_session = crate::arguments::is_sampled(&path);
        let samples = sampling.samples.or((!is_session).then_some(self.settings.samples));
        let sampling = if is_session { Sampling::default() } else { Sampling { samples, ..sampling } };
        if self.apply(Command::Open { path: path.clone(), sampling, recover }) {
            self.tools.reset();
            self.settings.remember(&path);
            self.keep_settings();
            (self.opened, self.awaited) = (Some(path), true);
        }
    }

    /// What was asked for last to be opened.
    pub fn opened(&self) -> Option<&Path> {
        self.opened.as_deref()
    }

    /// Opens a generated model.
    pub fn open_example(&mut self) {
        match example::file() {
            Ok(path) => self.ask_to_open(path),
            Err(error) => self.toasts.error(&error),
        }
    }

    /// Keeps what the user likes.
    pub fn keep_settings(&mut self) {
        if let Err(error) = self.settings.save() {
            self.toasts.error(&error);
        }
    }

    /// The window is to be closed: whether it may be now.
    pub fn may_close(&mut self) -> bool {
        if self.leaving || !self.is_unsaved() {
            return true;
        }
        self.question = Some(Question::Unsaved(Leaving::Close));
        false
    }

    /// What was about to be done goes on, without saving.
    pub fn leave(&mut self, leaving: Leaving) {
        match leaving {
            Leaving::Close => {
                self.leaving = true;
                self.ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            }
            Leaving::Open(path, sampling) => self.open(path, sampling, false),
        }
    }

    /// Saves; asks where to if that is not known. Whether it was saved at once.
    pub fn save(&mut self) -> bool {
        if self.state.editor().is_some_and(|editor| editor.path().is_some()) {
            let saved = self.apply(Command::Save { path: None });
            if saved {
                self.toasts.note("Saved.");
            }
            return saved;
        }
        self.ask(Purpose::Save);
        false
    }

    /// Saves, and goes on with what was about to be done; where it is not known where to, the dialog comes
    /// first.
    pub fn save_and_leave(&mut self, leaving: Leaving) {
        if self.save() {
            self.leave(leaving);
        } else {
            self.after = Some(leaving);
        }
    }

    /// Asks for a file.
    pub fn ask(&mut self, purpose: Purpose) {
        let editor = self.state.editor();
        let beside = |name: &str| {
            let path = editor?.path().or(editor?.model())?;
            let stem = path.file_stem()?.to_string_lossy().into_owned();
            Some(path.with_file_name(name.replace('*', &stem)))
        };
        let at = match &purpose {
            Purpose::Save => {
                editor.and_then(|e| e.path().map(Path::to_owned)).or_else(|| beside("*-session.toml"))
            }
            Purpose::Turntable => beside("*-turntable"),
            Purpose::Pin => beside("*.toml"),
            Purpose::Write => editor.and_then(|e| e.output().map(Path::to_owned)).or_else(|| {
                let extension = editor?.model()?.extension()?.to_string_lossy().into_owned();
                beside(&format!("*-deformed.{extension}"))
            }),
            _ => self.settings.recent.first().cloned(),
        };
        let text = at.as_ref().map_or_else(String::new, |path| path.display().to_string());
        self.typed = text;
        let ctx = self.ctx.clone();
        self.dialog = Some(Dialog::open(purpose, at.as_deref(), move || ctx.request_repaint()));
    }

    fn take_answer(&mut self) {
        let Some(answer) = self.dialog.as_ref().and_then(Dialog::answer) else { return };
        let Some(dialog) = self.dialog.take() else { return };
        let never = dialog.was_never_there();
        match answer {
            Some(path) => self.answered(dialog.purpose, path),
            None if never => {
                self.prompt = Some(Prompt { purpose: dialog.purpose, text: std::mem::take(&mut self.typed) });
            }
            None => {}
        }
    }

    /// A file was chosen.
    pub fn answered(&mut self, purpose: Purpose, path: PathBuf) {
        match purpose {
            Purpose::Open | Purpose::OpenFolder => self.ask_to_open(path),
            Purpose::Save => {
                let path = if path.extension().is_some() { path } else { path.with_extension("toml") };
                if self.apply(Command::Save { path: Some(path.clone()) }) {
                    self.settings.remember(&path);
                    self.keep_settings();
                    self.toasts.note(format!("Saved as {}.", path.display()));
                    if let Some(leaving) = self.after.take() {
                        self.leave(leaving);
                    }
                }
            }
            Purpose::Write => {
                self.apply(Command::Write { output: path });
            }
            Purpose::Pin => {
                self.apply(Command::PinSession { path });
            }
            Purpose::Turntable => {
                if let Some(turntable) = &mut self.turntable {
                    turntable.folder = path.display().to_string();
                }
            }
            Purpose::Parameter { step, id, .. } => {
                let value = Some(path.display().to_string().into());
                self.change(step, Change::SetParam { id, value }, false);
            }
        }
    }
}
