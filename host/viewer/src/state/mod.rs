//! The viewer's state: all that the window shows, and the one way to change it: [`State::apply`].

mod edit;
mod fields;
mod full;
mod history;
mod known;
mod open;
mod open_stroke;
mod pinned;
mod preview;
mod region;
mod select;
mod selections;
mod slowest;
mod stroke;
mod version;
mod view;

use crate::appended::{former, owners};
use crate::body::InscribedBalls;
use crate::camera::Camera;
use crate::clip::Clip;
use crate::command::Command;
use crate::engine::{Activity, Emerged, Engine, Event, Job, Opening, Wake};
use crate::overlay::Overlay;
use crate::pick::DepthBuffer;
use crate::record::Recorder;
use crate::scene::ViewerScene;
use crate::selection::{Adjacency, Selection};
use full::Preview;
use glam::DVec3;
use known::VersionNumbers;
use open::OpenSession;
use open_stroke::OpenStroke;
use selections::Selections;
use simod_core::reconstruction::Reconstructed;
use simod_model::{Error, Result};
use simod_plugin_api::Effort;
use simod_session::edit::{Document, Editor, Entry, StepId};
use simod_session::{PluginRegistry, SessionFile};
pub use slowest::Slowest;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
pub use version::ComparedVersion;
use version::Pinned;

/// Notices that are kept until the window takes them.
const MOST_NOTICES: usize = 100;

/// Something for the user to read.
#[derive(Debug)]
pub enum Notice {
    /// Good to know.
    Note(String),
    /// A job failed; the error says what to do.
    Failed(Job, Error),
    /// The deformed model was written: its path, the figures, and the seconds that it took.
    Written(PathBuf, Box<Reconstructed>, f64),
}

/// A window's state, without the window.
pub struct State {
    engine: Engine,
    plugins: Arc<PluginRegistry>,
    open: Option<OpenSession>,
    selection: Selection,
    /// The former selections.
    selections: Selections,
    camera: Camera,
    /// Size of the picture, in pixels.
    size: [f64; 2],
    chosen: Option<StepId>,
    stroke: Option<OpenStroke>,
    overlay: Overlay,
    clip: Option<Clip>,
    /// Points along which is measured, before all steps, in model coordinates.
    measured: Vec<DVec3>,
    /// Whether the model's own colours are shown where no numbers are.
    own_colors: bool,
    /// The last request for steps to be done, and the last one whose result is shown.
    requested: u64,
    shown: u64,
    /// Number of the last request for the model that was open before.
    floor: u64,
    notices: Vec<Notice>,
    recorder: Option<Recorder>,
    /// The depth buffer of a scene, as it was asked for last.
    depth: RefCell<Option<(u64, Arc<DepthBuffer>)>>,
    preview: Preview,
    /// Balls within the samples at rest, once a step with joints was chosen.
    body: Option<InscribedBalls>,
    /// The numbers of both versions, as they were asked for last.
    fields: RefCell<[Option<VersionNumbers>; 2]>,
    /// The version to compare with.
    pinned: Option<Pinned>,
    /// Number of versions that were pinned so far.
    pins: u64,
    /// Name of steps that were pinned before, and these steps.
    named: Option<(String, Arc<[Entry]>)>,
    slowest: Slowest,
}

impl State {
    /// State with nothing open. `wake` is called from any thread when [`poll`](Self::poll) has something to
    /// do.
    pub fn new(plugins: Arc<PluginRegistry>, wake: Wake) -> Self {
        Self {
            engine: Engine::new(plugins.clone(), wake),
            plugins,
            open: None,
            selection: Selection::default(),
            selections: Default::default(),
            camera: Camera::default(),
            size: [1280.0, 800.0],
            chosen: None,
            stroke: None,
            overlay: Overlay::default(),
            clip: None,
            measured: Vec::new(),
            own_colors: true,
            requested: 0,
            shown: 0,
            floor: 0,
            notices: Vec::new(),
            recorder: None,
            depth: RefCell::default(),
            preview: Preview::default(),
            body: None,
            fields: RefCell::default(),
            pinned: None,
            pins: 0,
            named: None,
            slowest: Slowest::default(),
        }
    }

    /// Records all commands from now on, or no more.
    pub fn record(&mut self, recorder: Option<Recorder>) {
        self.recorder = recorder;
    }

    /// Does a command.
    ///
    /// # Errors
    /// The command makes no sense, or a file cannot be written; nothing has changed then. Work that takes
    /// its time fails later, with a [`Notice`].
    pub fn apply(&mut self, command: Command) -> Result<()> {
        let (settled, begun) = (self.is_settled(), Instant::now());
        let done = self.perform(command.clone());
        self.slowest.note(&command, begun.elapsed());
        done?;
        if self.recorder.is_some() {
            let command = if settled { command } else { self.resolved(command) };
            if let Some(Err(error)) = self.recorder.as_mut().map(|recorder| recorder.push(&command)) {
                self.recorder = None;
                self.notices.push(Notice::Note(format!("the recording ended: {error}")));
            }
        }
        Ok(())
    }

    /// The commands that took longest so far.
    pub fn slowest(&self) -> &Slowest {
        &self.slowest
    }

    fn perform(&mut self, command: Command) -> Result<()> {
        match command {
            Command::Open { path, sampling, recover } => {
                self.begin_opening(Opening { path, sampling, recover, model: None })
            }
            Command::Locate { path, model, recover } => {
                let sampling = Default::default();
                self.begin_opening(Opening { path, sampling, recover, model: Some(model) })
            }
            Command::Edit(command) => self.edit(command, false),
            Command::Drag(command) => self.edit(command, true),
            Command::Rest => self.rest(),
            Command::Undo => self.undo(),
            Command::Redo => self.redo(),
            Command::Choose { step } => self.choose(step),
            Command::AddStep { plugin, at } => self.add_step(&plugin, at),
            Command::Paste { text, at } => self.paste(&text, at),
            Command::Select { area, combine, visible, goes_on } => {
                self.select(&area, combine, visible, goes_on)
            }
            Command::MakeRegion { step, role, falloff, replaces } => {
                self.make_region(step, role, falloff, replaces)
            }
            Command::MakeHandle { step, band } => self.make_handle(step, band),
            Command::RefineSelection { finer } => self.refine_selection(finer),
            Command::PlaceJoint { step, id, at, parent } => self.place_joint(step, id, at, parent),
            Command::BeginStroke { step, radius, strength, params } => {
                self.begin_stroke(step, radius, strength, params)
            }
            Command::StrokePoint { at, pressure } => self.stroke_point(at, pressure),
            Command::EndStroke => self.end_stroke(),
            Command::DropStroke => self.drop_stroke(),
            Command::Save { path } => self.save(path),
            Command::Write { output } => self.write(output),
            Command::Cancel { job } => {
                self.engine.cancel(job);
                if job == Job::Preview {
                    self.cancel_preview();
                }
                Ok(())
            }
            Command::Resize { size } => self.resize(size),
            Command::Camera(step) => self.move_camera(step),
            Command::Show(overlay) => self.show(overlay),
            Command::ShowOwnColors(own) => self.show_own_colors(own),
            Command::Clip(clip) => self.clip(clip),
            Command::Measure { points } => self.measure(points),
            Command::Preview { what } => self.preview(what),
            Command::Pin => self.pin(),
            Command::PinSession { path } => self.pin_session(&path),
            Command::Unpin => {
                self.unpin();
                Ok(())
            }
            Command::SwapPinned => self.swap_pinned(),
        }
    }

    fn begin_opening(&mut self, opening: Opening) -> Result<()> {
        if self.engine.wants(Job::Write) {
            let what = "a model that was to be written waits for another one: wait for it, or cancel it";
            return Err(Error::argument(what, "open the other model afterwards"));
        }
        self.engine.open(opening);
        Ok(())
    }

    /// Takes the events of the engine. Returns whether anything changed.
    pub fn poll(&mut self) -> bool {
        let mut changed = false;
        while let Some(event) = self.engine.poll() {
            self.take(event);
            changed = true;
        }
        changed
    }

    /// Waits until all work that was asked for is done.
    ///
    /// # Errors
    /// The work takes longer than this.
    pub fn settle(&mut self, longest: Duration) -> Result<()> {
        while let Some(event) = self.engine.wait(longest)? {
            self.take(event);
        }
        Ok(())
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Opened(opened) => {
                let (editor, scene) = *opened;
                self.opened(editor, scene);
            }
            // Results of the model that was open before are of no use.
            Event::Evaluated { request, scene } => {
                if self.open.is_some() && request > self.floor {
                    self.show_scene(Arc::new(*scene));
                    self.shown = request;
                    self.follow_samples();
                    self.compare();
                }
            }
            Event::Compared { number, scene, carried } => self.compared(number, scene, carried),
            Event::Written { output, report, seconds } => self.tell(Notice::Written(output, report, seconds)),
            Event::Detail { request, batch } => self.take_detail(request, *batch),
            Event::Streamed { request, report, seconds } => self.take_streamed(request, report, seconds),
            Event::Note(text) => self.tell(Notice::Note(text)),
            Event::Failed { job, error } => {
                self.tell(Notice::Failed(job, error));
                match job {
                    Job::Preview => self.stop_preview(),
                    Job::Compare => self.not_compared(),
                    // Comparison and stream were interrupted for the model that could not be opened.
                    Job::Open => {
                        self.compare_again();
                        self.stream_missing();
                    }
                    _ => {}
                }
                // Evaluations that were given up for a model that could not be opened.
                if job == Job::Open && self.shown != self.requested {
                    self.request(Effort::FULL);
                }
            }
        }
    }

    fn show_scene(&mut self, scene: Arc<ViewerScene>) {
        let Some(open) = &mut self.open else { return };
        let before = std::mem::replace(&mut open.scene, scene).sampled.clone();
        let after = &open.scene.sampled;
        if Arc::ptr_eq(&before, after) {
            return self.look_for_body();
        }
        let adjacency = Adjacency::of_model(after);
        // Samples that were appended belong to the former ones around them.
        if before.samples.positions != after.samples.positions {
            let former = former(&before, after);
            let owners = owners(&after.samples, |i| former[i].is_some(), |i| adjacency.neighbours(i));
            self.selection = self.selection.carried(&former, &owners);
        }
        open.adjacency = Arc::new(adjacency);
        self.look_for_body();
    }

    fn tell(&mut self, notice: Notice) {
        if self.notices.len() < MOST_NOTICES {
            self.notices.push(notice);
        }
    }

    /// Whether the samples are at their final positions, and not those of a draft.
    pub fn is_settled(&self) -> bool {
        let full = self.open.as_ref().is_none_or(|open| open.scene.effort == Effort::FULL);
        full && self.shown == self.requested && !self.engine.is_opening()
    }

    /// Whether any work is still going on: a model, steps, or a file.
    pub fn is_busy(&self) -> bool {
        !self.engine.is_idle()
    }

    /// Messages for the user since the last call.
    pub fn take_notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.notices)
    }

    /// Progress of a job, if it is running.
    pub fn activity(&self, job: Job) -> Option<Activity> {
        self.engine.activity(job)
    }

    /// Whether another model may be there before long.
    pub fn is_opening(&self) -> bool {
        self.engine.is_opening()
    }

    /// Calls `look` with the samples of the model that is being opened, as far as they are there.
    pub fn emerged<T>(&self, look: impl FnOnce(&Emerged) -> T) -> Option<T> {
        self.engine.emerged(look)
    }

    /// The place of the step that is being done, if any is.
    pub fn busy_step(&self) -> Option<usize> {
        self.engine.step()
    }

    /// The plugins that there are.
    pub fn plugins(&self) -> &Arc<PluginRegistry> {
        &self.plugins
    }

    /// Takes other plugins, as after looking for them again, and does the steps with them.
    pub fn set_plugins(&mut self, plugins: Arc<PluginRegistry>) {
        self.plugins = plugins.clone();
        self.engine.set_plugins(plugins.clone());
        if let Some(open) = &mut self.open {
            open.editor.set_plugins(plugins);
            self.request(Effort::FULL);
        }
    }

    /// The edit with its files, if something is open.
    pub fn editor(&self) -> Option<&Editor> {
        self.open.as_ref().map(|open| &open.editor)
    }

    /// The steps, if something is open.
    pub fn document(&self) -> Option<&Document> {
        self.editor().map(Editor::document)
    }

    /// Scene that is drawn, if something is open.
    pub fn scene(&self) -> Option<&Arc<ViewerScene>> {
        self.open.as_ref().map(|open| &open.scene)
    }

    /// The samples that are selected.
    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// The place of the step that is worked on, if any.
    pub fn chosen(&self) -> Option<usize> {
        let id = self.chosen?;
        self.document()?.steps().iter().position(|entry| entry.id == id)
    }

    /// Keeps the steps against a crash, if there is anything new to keep: to be called every now and then.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn autosave(&mut self) -> Result<()> {
        self.open.as_mut().map_or(Ok(()), |open| open.editor.autosave())
    }

    /// Drops the copy of the steps that is kept against a crash, as the user does not want the steps.
    ///
    /// # Errors
    /// The copy cannot be removed.
    pub fn discard(&mut self) -> Result<()> {
        self.open.as_mut().map_or(Ok(()), |open| open.editor.discard())
    }
}

/// Time when an edit of a session or model was kept against a crash, if one was.
pub fn kept_at(path: &Path) -> Option<SystemTime> {
    simod_session::edit::kept_at(path)
}

/// Removes the edit of a session or model that was kept against a crash.
///
/// # Errors
/// The file cannot be removed.
pub fn forget(path: &Path) -> Result<()> {
    simod_session::edit::forget(path)
}

/// Edit of a session or model that was kept against a crash, if there is one; see [`Command::Open`].
///
/// # Errors
/// There is such an edit, but it cannot be read.
pub fn recoverable(path: &Path) -> Result<Option<SessionFile>> {
    simod_session::edit::recover(path)
}
