//! The window: the viewer's state, and the parts that are the window's own.

mod asked;
mod commands;
mod looks;
mod prompt;
mod toasts;

use crate::dialogs::{self, Chooser, Dialog, DialogAnswer, Purpose};
use crate::settings::{self, WindowSettings};
use crate::tools::Tools;
use crate::turntable::{AskedPicture, AskedTurntable, Film, Turning};
use crate::viewport::seen::mode_of;
use crate::{example, in_turn, plugins, theme};
pub use asked::{CommandPalette, KeptEdit, Leaving, Question, Renaming, RunningLesson, WriteReport};
pub use commands::Commands;
use eframe::egui;
pub use looks::Looks;
pub use prompt::{Prompt, common};
use simod_model::target::folder_of;
use simod_model::{Error, ErrorKind};
use simod_scene::{SurfaceMode, SurfaceShare};
use simod_session::edit::{self, Change, Entry, StepId};
use simod_session::session_file::SamplingTable;
use simod_session::step::Deformation;
use simod_session::{Plugin, PluginRegistry, SessionFile};
use simod_viewer::engine::Job;
use simod_viewer::record::Recorder;
use simod_viewer::state::{self, Notice};
use simod_viewer::{Command, ComparedVersion, State};
use std::collections::{BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
pub use toasts::{Cause, Toast, Toasts};

/// Time between two savings of an edit against a crash.
const KEEP: Duration = Duration::from_secs(20);

/// A path that is being opened.
struct Awaited {
    path: PathBuf,
    recover: bool,
    /// The path that was open before.
    former: Option<PathBuf>,
}

/// A window, but for its picture.
pub struct Window {
    state: State,
    ctx: egui::Context,
    /// Whether the hand was quicker than the pictures, and events wait for their frame.
    waits: Arc<AtomicBool>,
    /// The user's settings.
    pub settings: WindowSettings,
    /// The tools, and the one in the hand.
    pub tools: Tools,
    /// The things that are shown.
    pub looks: Looks,
    /// Whether a button is held that shows the pinned version.
    pub holds_pinned: bool,
    /// Question before a turntable is drawn, while it is asked.
    pub turntable: Option<AskedTurntable>,
    /// Question before a picture is drawn, while it is asked.
    pub picture: Option<AskedPicture>,
    /// Frames of the last turntable, while the user reads how to make a film of them.
    pub film: Option<Film>,
    /// The turntable or picture that is being drawn.
    pub turning: Option<Turning>,
    /// Turntable that was stopped, until the frame in progress is drawn.
    pub stopping: Option<Turning>,
    /// The lesson that is being done.
    pub lesson: Option<RunningLesson>,
    /// Messages that go away.
    pub toasts: Toasts,
    /// Commands by name, while they are looked for.
    pub palette: Option<CommandPalette>,
    /// Report on the model that was written last, while the user reads it.
    pub report: Option<WriteReport>,
    /// The list of keys, while it is read.
    pub shows_keys: bool,
    /// A step, or a group of them, whose name is being typed.
    pub renaming: Option<Renaming>,
    /// Names of the groups whose steps are not shown.
    pub folded: BTreeSet<String>,
    /// A path that is typed, where the system has no dialogs.
    pub prompt: Option<Prompt>,
    /// The question to be answered first.
    pub question: Option<Question>,
    /// Function that shows dialogs for files.
    pub chooser: Chooser,
    dialog: Option<Dialog>,
    leaving: bool,
    /// Action that goes on once the edit is saved.
    after: Option<Leaving>,
    title: String,
    opened: Option<PathBuf>,
    /// Path that was opened and whose model is still to come.
    awaited: Option<Awaited>,
    /// The revision of the scene that was looked at last.
    seen: u64,
    recorded: VecDeque<Command>,
    kept: Instant,
    /// Duration of the last picture, for the status line.
    pub frame_time: Duration,
    /// Share of the surface that the picture shows.
    pub drawn: SurfaceShare,
}

impl Window {
    /// A window with nothing open.
    pub fn new(ctx: &egui::Context, plugins: Arc<PluginRegistry>, settings: WindowSettings) -> Self {
        theme::apply(ctx, settings.theme);
        let waits = Arc::new(AtomicBool::new(false));
        in_turn::install(ctx, waits.clone());
        let waker = ctx.clone();
        let mut toasts = Toasts::default();
        for rejected in plugins.rejected() {
            toasts.error(&rejected.error);
        }
        Self {
            state: State::new(plugins, Arc::new(move || waker.request_repaint())),
            ctx: ctx.clone(),
            waits,
            settings,
            tools: Tools::default(),
            looks: Looks::default(),
            holds_pinned: false,
            turning: None,
            lesson: None,
            stopping: None,
            turntable: None,
            picture: None,
            film: None,
            toasts,
            palette: None,
            report: None,
            shows_keys: false,
            renaming: None,
            folded: BTreeSet::new(),
            prompt: None,
            question: None,
            chooser: dialogs::system(),
            dialog: None,
            leaving: false,
            after: None,
            title: String::new(),
            opened: None,
            awaited: None,
            seen: 0,
            recorded: VecDeque::new(),
            kept: Instant::now(),
            frame_time: Duration::ZERO,
            drawn: SurfaceShare::default(),
        }
    }

    /// The state, to be read; it changes by [`apply`](Self::apply) alone.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Context of egui.
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
        let asks = self.question.is_some() || self.turntable.is_some() || self.picture.is_some();
        let asks = asks || self.film.is_some();
        asks || self.palette.is_some() || self.prompt.is_some() || self.shows_keys
    }

    /// Whether more events wait for a frame: a picture can wait for them.
    pub fn is_catching_up(&self) -> bool {
        self.waits.load(Ordering::Relaxed)
    }

    /// Surface's mode: as the user said, or as is best for the open model.
    pub fn mode(&self) -> SurfaceMode {
        match (self.looks.triangles, self.state.scene()) {
            (Some(true), _) => SurfaceMode::Triangles,
            (None, Some(scene)) => mode_of(scene),
            _ => SurfaceMode::Splats,
        }
    }

    /// Does a command; an error is shown to the user. Returns whether the command was done.
    pub fn apply(&mut self, command: Command) -> bool {
        // Looking around mends nothing.
        let mends = !matches!(command, Command::Camera(_) | Command::Resize { .. } | Command::Cancel { .. });
        let done = self.state.apply(command);
        match &done {
            Err(error) => self.toasts.error_of(Cause::Command, error),
            Ok(()) if mends => self.toasts.leave(Cause::Command),
            Ok(()) => {}
        }
        self.ctx.request_repaint();
        done.is_ok()
    }

    /// Changes a step, or drags something of it.
    pub fn change(&mut self, at: usize, change: Change, dragging: bool) -> bool {
        let change = edit::EditCommand::Change { at, change };
        self.apply(if dragging { Command::Drag(change) } else { Command::Edit(change) })
    }

    /// The steps; none if nothing is open.
    pub fn steps(&self) -> Arc<[Entry]> {
        self.state.document().map(|document| document.steps().clone()).unwrap_or_default()
    }

    /// The chosen step, if it deforms: its place, its id, its deformation, and its plugin, if that is
    /// there.
    pub fn chosen(&self) -> Option<(usize, StepId, Deformation, Option<Arc<Plugin>>)> {
        let at = self.state.chosen()?;
        let steps = self.steps();
        let entry = steps.get(at)?;
        let deformation = entry.step.deformation()?.clone();
        let plugin = self.state.plugins().get(&deformation.deform).ok().cloned();
        Some((at, entry.id, deformation, plugin))
    }

    /// Takes the news of the viewer's state. To be called before each picture.
    pub fn update(&mut self) {
        self.toasts.leave_old();
        self.state.poll();
        let notices = self.state.take_notices();
        // A new scene removes the errors of jobs that had failed to make one.
        let revision = self.state.scene().map_or(0, |scene| scene.revision);
        if std::mem::replace(&mut self.seen, revision) != revision {
            self.toasts.leave(Cause::Job(Job::Evaluate));
            self.toasts.leave(Cause::Job(Job::Open));
        }
        for notice in notices {
            match notice {
                Notice::Note(text) => self.toasts.note(text),
                Notice::Failed(job, error) => self.failed(job, &error),
                Notice::Written(output, report, seconds) => {
                    self.toasts.leave(Cause::Job(Job::Write));
                    self.report = Some(WriteReport { output, report: *report, seconds });
                }
            }
        }
        if self.state.is_settled()
            && let Some(awaited) = self.awaited.take()
        {
            self.is_there(awaited);
        }
        if let Some(made) = self.turning.as_ref().and_then(Turning::made) {
            let turning = self.turning.take();
            match (made, turning) {
                (Ok(()), Some(turning)) => {
                    self.toasts.note(turning.done());
                    self.film = turning.film();
                }
                (Err(error), _) if error.kind() == ErrorKind::Cancelled => self.toasts.note("Stopped."),
                (Err(error), _) => self.toasts.error(&error),
                _ => {}
            }
        }
        if self.stopping.as_ref().is_some_and(Turning::is_over) {
            self.stopping = None;
        }
        self.name();
        self.take_answer();
        self.go_on_replaying();
        if self.kept.elapsed() > KEEP {
            self.keep();
        }
        self.ctx.request_repaint_after(KEEP);
    }

    /// Tells the user of a job that failed.
    fn failed(&mut self, job: Job, error: &Error) {
        let cancelled = error.kind() == ErrorKind::Cancelled;
        if job == Job::Open
            && let Some(Awaited { path, former, .. }) = self.awaited.take()
        {
            self.opened = former;
            if !cancelled {
                self.settings.forget(&path);
                self.keep_settings();
                if let Some(model) = missing_model(&path) {
                    self.question = Some(Question::Moved { path, model, is_open: false });
                    return;
                }
            }
        }
        if cancelled {
            self.toasts.note("Stopped.");
        } else {
            self.toasts.error_of(Cause::Job(job), error);
        }
    }

    /// Takes note of a model that was opened and is there now: remembers its path, and chooses a step.
    fn is_there(&mut self, Awaited { path, recover, .. }: Awaited) {
        self.settings.remember(&path);
        self.keep_settings();
        self.looks.triangles = None;
        self.choose_last();
        if recover {
            let text = "The edit is recovered. It is in no file yet: save it.";
            self.toasts.note(text);
        }
        let model = self.state.editor().and_then(|editor| editor.model());
        if let Some(model) = model.filter(|model| !model.exists()).map(Path::to_owned) {
            self.question = Some(Question::Moved { path, model, is_open: true });
        }
    }

    /// Notes the share of the surface that a picture shows, and the picture's duration, where these are
    /// known.
    pub fn tell_drawn(&mut self, drawn: Option<SurfaceShare>, took: Option<Duration>) {
        self.drawn = drawn.unwrap_or(self.drawn);
        self.frame_time = took.unwrap_or(self.frame_time);
    }

    /// Stops the turntable that is drawn.
    pub fn stop_turning(&mut self) {
        if let Some(turning) = self.turning.take() {
            turning.cancel();
            self.stopping = Some(turning);
            self.toasts.note("Stopped: nothing is left of it.");
        }
    }

    /// Gives the window the name of the open session or model.
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
        let plugins = plugins::discover();
        self.toasts.note(format!("{} plugins are there.", plugins.plugins().len()));
        plugins.rejected().iter().for_each(|rejected| self.toasts.error(&rejected.error));
        self.state.set_plugins(Arc::new(plugins));
    }

    /// Chooses the last step that deforms: with it, somebody goes on who opens a session.
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
        let pins =
            |state: &State| state.pinned().is_some() && state.scene_of(ComparedVersion::Pinned).is_none();
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
        let sampling = settings::sampling(Some(self.settings.samples));
        self.ask_to_open_sampled(path, sampling);
    }

    /// Opens something, with this sampling if it is a model, after questions that have to be asked before.
    pub fn ask_to_open_sampled(&mut self, path: PathBuf, sampling: SamplingTable) {
        self.after = None;
        if self.is_unsaved() {
            self.question = Some(Question::Unsaved(Leaving::Open(path, sampling)));
        } else {
            self.open(path, sampling, false);
        }
    }

    /// Opens something; an edit of it that was kept against a crash is offered.
    pub fn open(&mut self, path: PathBuf, sampling: SamplingTable, recover: bool) {
        let made = state::kept_at(&path).filter(|_| !recover);
        match made.map(|made| (made, state::recoverable(&path))) {
            Some((made, Ok(Some(kept)))) => {
                let steps = kept.steps.len();
                self.question = Some(Question::Recover(KeptEdit { path, sampling, made, steps }));
            }
            // The kept edit is left alone, for whoever wants to look at it.
            Some((_, Err(error))) => {
                self.toasts.error(&error);
                self.open_now(path, sampling, recover);
            }
            _ => self.open_now(path, sampling, recover),
        }
    }

    /// Opens something without its kept edit, which goes away.
    pub fn open_without(&mut self, kept: &KeptEdit) {
        if let Err(error) = state::forget(&kept.path) {
            self.toasts.error(&error);
        }
        self.open_now(kept.path.clone(), kept.sampling, false);
    }

    /// Opens something, whatever was kept.
    pub fn open_now(&mut self, path: PathBuf, sampling: SamplingTable, recover: bool) {
        if !path.exists() {
            let what = format!("there is no file {}", path.display());
            self.toasts.error(&Error::system(what, "check the path, or choose another file"));
            self.settings.forget(&path);
            self.keep_settings();
            return;
        }
        // A session says itself how its model is sampled.
        let is_session = settings::is_sampled(&path);
        let samples = sampling.samples.or((!is_session).then_some(self.settings.samples));
        let sampling =
            if is_session { SamplingTable::default() } else { SamplingTable { samples, ..sampling } };
        self.begin_opening(Command::Open { path: path.clone(), sampling, recover }, path, recover);
    }

    fn begin_opening(&mut self, command: Command, path: PathBuf, recover: bool) {
        if self.apply(command) {
            self.tools.reset();
            let former = self.opened.replace(path.clone());
            self.awaited = Some(Awaited { path, recover, former });
        }
    }

    /// Path that was asked for last to be opened.
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

    /// Writes the user's settings.
    pub fn keep_settings(&mut self) {
        if let Err(error) = self.settings.save() {
            self.toasts.error(&error);
        }
    }

    /// Whether the window may be closed now; if not, the user is asked about the edit that is not saved.
    pub fn may_close(&mut self) -> bool {
        if self.leaving || !self.is_unsaved() {
            return true;
        }
        self.question = Some(Question::Unsaved(Leaving::Close));
        false
    }

    /// Does what waited for the user's answer, without saving.
    pub fn leave(&mut self, leaving: Leaving) {
        match leaving {
            Leaving::Close => {
                self.leaving = true;
                self.ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            }
            Leaving::Open(path, sampling) => self.open(path, sampling, false),
        }
    }

    /// Does what waited for the user's answer, and lets go of the edit, with the copy that was kept against
    /// a crash.
    pub fn discard(&mut self, leaving: Leaving) {
        if let Err(error) = self.state.discard() {
            self.toasts.error(&error);
        }
        self.leave(leaving);
    }

    /// Saves the session, or asks for its path if that is not known. Returns whether it was saved at once.
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

    /// Saves, and goes on with the action that waited; where the session's path is not known, the dialog
    /// comes first.
    pub fn save_and_leave(&mut self, leaving: Leaving) {
        if self.save() {
            self.leave(leaving);
        } else {
            self.after = Some(leaving);
        }
    }

    /// Shows a dialog for a file.
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
            Purpose::Picture => beside("*.png"),
            Purpose::Pin => beside("*.toml"),
            Purpose::Locate { path, model } => {
                Some(folder_of(path).join(model.file_name().unwrap_or_default()))
            }
            Purpose::Write => editor.and_then(|e| e.output().map(Path::to_owned)).or_else(|| {
                let extension = editor?.model()?.extension()?.to_string_lossy().into_owned();
                beside(&format!("*-deformed.{extension}"))
            }),
            _ => self.settings.recent.first().cloned(),
        };
        let ctx = self.ctx.clone();
        let wake = move || ctx.request_repaint();
        let dialog = Dialog::open(self.chooser.clone(), purpose, at, wake);
        self.ctx.request_repaint_after(dialog.patience());
        self.dialog = Some(dialog);
    }

    fn take_answer(&mut self) {
        let Some(dialog) = &self.dialog else { return };
        let Some(answer) = dialog.answer() else {
            return self.ctx.request_repaint_after(dialog.patience());
        };
        let Some(dialog) = self.dialog.take() else { return };
        match answer {
            DialogAnswer::Chosen(path) => self.answered(dialog.purpose, path),
            DialogAnswer::Closed => self.not_answered(),
            DialogAnswer::Absent(why) => {
                self.prompt = Some(Prompt::new(dialog.purpose, dialog.at.as_deref(), &why));
            }
        }
    }

    /// Shows the steps of a group, or its heading alone.
    pub fn fold(&mut self, group: &str, folded: bool) {
        if folded {
            self.folded.insert(group.to_owned());
        } else {
            self.folded.remove(group);
        }
    }

    /// Lets go of the action that waited for a file, as none was chosen.
    pub fn not_answered(&mut self) {
        self.after = None;
    }

    /// Goes on with the file that was chosen.
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
            Purpose::Locate { path: opened, .. } => {
                let recover = state::kept_at(&opened).is_some();
                let command = Command::Locate { path: opened.clone(), model: path, recover };
                self.begin_opening(command, opened, recover);
            }
            Purpose::Turntable => {
                if let Some(turntable) = &mut self.turntable {
                    turntable.folder = path.display().to_string();
                }
            }
            Purpose::Picture => {
                if let Some(picture) = &mut self.picture {
                    picture.file = path.display().to_string();
                }
            }
            Purpose::Parameter { step, id, .. } => {
                let value = Some(path.display().to_string().into());
                self.change(step, Change::SetParam { id, value }, false);
            }
        }
    }
}

/// The model of a session, if it is not where the session says.
fn missing_model(path: &Path) -> Option<PathBuf> {
    let is_session = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let session = is_session.then(|| SessionFile::load(path).ok()).flatten()?;
    session.model.filter(|model| !model.exists())
}
