//! Steps: added, changed, undone; saved and written.

use super::State;
use super::open::{OpenSession, nothing_open};
use crate::command::Command;
use crate::engine::{Extra, WriteRequest};
use crate::overlay::Overlay;
use crate::scene::ViewerScene;
use crate::selection::Selection;
use simod_core::reconstruction::Reconstruction;
use simod_model::target::folder_of;
use simod_model::{Error, Result};
use simod_plugin_api::Effort;
use simod_session::edit::{self, Change, Document, Editor, StepId};
use simod_session::step::{Action, Deformation, Step};
use std::path::{Path, PathBuf};

impl State {
    pub(super) fn open(&self) -> Result<&OpenSession> {
        self.open.as_ref().ok_or_else(nothing_open)
    }

    pub(super) fn document_mut(&mut self) -> Result<&mut Document> {
        self.open.as_mut().map(|open| open.editor.document_mut()).ok_or_else(nothing_open)
    }

    /// Takes a model that was opened in the place of the former one, whose edit is kept against a crash if
    /// it was not saved.
    pub(super) fn opened(&mut self, editor: Editor, scene: ViewerScene) {
        if let Err(error) = self.autosave() {
            self.tell(super::Notice::Note(format!("the former edit was not kept: {error}")));
        }
        self.end_preview();
        (self.selection, self.selections) = (Selection::none(scene.len()), Default::default());
        (self.chosen, self.stroke, self.named, self.body) = (None, None, None, None);
        (self.fields, self.depth) = Default::default();
        (self.clip, self.measured) = (None, Vec::new());
        self.unpin();
        (self.shown, self.floor) = (self.requested, self.requested);
        let bounds = scene.bounds().map(|corner| corner.as_dvec3());
        self.camera.frame(bounds, self.size);
        let open = OpenSession::new(editor, scene);
        let has_steps = !open.steps().is_empty();
        self.open = Some(open);
        if has_steps {
            self.request(Effort::FULL);
        }
    }

    /// Has the steps done, with the stroke that is being drawn.
    pub(super) fn request(&mut self, effort: Effort) {
        let Some(open) = &self.open else { return };
        let steps = self.stroke.as_ref().and_then(|stroke| stroke.preview(open.steps()));
        let steps = steps.unwrap_or_else(|| open.steps().clone());
        let extra = match self.overlay {
            Overlay::TransferError if effort == Effort::FULL => Extra::ExpectedError,
            Overlay::Attribute(_) if effort == Effort::FULL => {
                Extra::Attributes(open.editor.model().map(Path::to_owned))
            }
            _ => Extra::Nothing,
        };
        self.requested = self.engine.evaluate(steps, effort, extra);
    }

    pub(super) fn edit(&mut self, command: edit::EditCommand, dragging: bool) -> Result<()> {
        let former = self.open()?.steps().clone();
        let document = self.document_mut()?;
        if !dragging {
            document.rest();
        }
        document.apply(command)?;
        self.choose_near(&former, false);
        self.leave_selection();
        let document = self.document_mut()?;
        if !dragging {
            document.rest();
        }
        self.request(if dragging { Effort::DRAFT } else { Effort::FULL });
        Ok(())
    }

    pub(super) fn change(&mut self, at: usize, change: Change) -> Result<()> {
        self.edit(edit::EditCommand::Change { at, change }, false)
    }

    pub(super) fn rest(&mut self) -> Result<()> {
        self.document_mut()?.rest();
        self.request(Effort::FULL);
        Ok(())
    }

    pub(super) fn choose(&mut self, step: Option<usize>) -> Result<()> {
        self.chosen = match step {
            None => None,
            Some(at) => Some(self.entry(at)?.id),
        };
        self.look_for_body();
        Ok(())
    }

    /// Chooses a step after a change of the steps: where the chosen one is gone, the one before it that is
    /// left, or else the one behind it; where `takes_new`, a step that was added.
    pub(super) fn choose_near(&mut self, former: &[edit::Entry], takes_new: bool) {
        let Some(open) = &self.open else { return };
        let steps = open.steps();
        let is_there = |id: StepId| steps.iter().any(|entry| entry.id == id);
        let mut new = steps.iter().filter(|entry| former.iter().all(|known| known.id != entry.id));
        if let (true, Some(entry), None) = (takes_new, new.next(), new.next()) {
            self.chosen = Some(entry.id);
        } else if let Some(id) = self.chosen.filter(|id| !is_there(*id)) {
            let at = former.iter().position(|entry| entry.id == id).unwrap_or(former.len());
            let (before, behind) = former.split_at(at);
            let nearest = before.iter().rev().chain(behind).find(|entry| is_there(entry.id));
            self.chosen = nearest.map(|entry| entry.id);
        }
    }

    /// The step at a place.
    pub(super) fn entry(&self, at: usize) -> Result<&edit::Entry> {
        let steps = self.open()?.steps();
        let none =
            || Error::argument(format!("there is no step {at} among {}", steps.len()), "places begin at 0");
        steps.get(at).ok_or_else(none)
    }

    /// The deformation at a place.
    pub(super) fn deformation(&self, at: usize) -> Result<&Deformation> {
        let none = || Error::argument(format!("step {at} deforms nothing"), "choose another step");
        self.entry(at)?.step.deformation().ok_or_else(none)
    }

    /// Folder to which the paths of files among the parameters of new steps are relative.
    fn folder(&self) -> Result<PathBuf> {
        let editor = &self.open()?.editor;
        Ok(folder_of(editor.path().or(editor.model()).unwrap_or(Path::new(""))).to_owned())
    }

    /// Text of a step, to be [pasted](Command::Paste) into another edit, where the step joins the group
    /// that it comes into.
    ///
    /// # Errors
    /// There is no such step, or it is too long for a text.
    pub fn copied(&self, at: usize) -> Result<String> {
        let step = Step { group: None, ..(*self.entry(at)?.step).clone() };
        edit::copied(&[step], &self.plugins)
    }

    /// The text of all steps of the group that one is in.
    ///
    /// # Errors
    /// The step is in no group; the steps are too long for a text.
    pub fn copied_group(&self, at: usize) -> Result<String> {
        let steps = self.open()?.steps();
        let none = || Error::argument(format!("step {at} is in no group"), "choose one that is");
        let group = edit::group_at(steps, at).ok_or_else(none)?;
        let steps: Vec<Step> = steps[group].iter().map(|entry| (*entry.step).clone()).collect();
        edit::copied(&steps, &self.plugins)
    }

    pub(super) fn paste(&mut self, text: &str, at: Option<usize>) -> Result<()> {
        let mut steps = edit::pasted(text, &self.folder()?)?;
        // Steps that cannot be brought up to their plugins' versions say so when they are done.
        for step in &mut steps {
            let _ = self.plugins.migrate(std::slice::from_mut(step));
        }
        let behind = self.chosen().map_or(self.open()?.steps().len(), |chosen| chosen + 1);
        let (at, count) = (at.unwrap_or(behind), steps.len());
        self.edit(edit::EditCommand::Insert { at, steps }, false)?;
        self.choose(Some(at + count - 1))
    }

    pub(super) fn add_step(&mut self, plugin: &str, at: Option<usize>) -> Result<()> {
        let (open, folder) = (self.open()?, self.folder()?);
        let state_version = self.plugins.get(plugin)?.migration().map(|m| m.state_version);
        let deformation = Deformation { state_version, folder, ..Deformation::by_plugin(plugin) };
        let at = at.unwrap_or(open.steps().len());
        self.add(at, Action::Deform(deformation))?;
        self.choose(Some(at))
    }

    pub(super) fn add(&mut self, at: usize, action: Action) -> Result<()> {
        self.edit(edit::EditCommand::Add { at, step: Box::new(Step::new(action)) }, false)
    }

    pub(super) fn save(&mut self, path: Option<PathBuf>) -> Result<()> {
        let open = self.open.as_mut().ok_or_else(nothing_open)?;
        let none = || Error::argument("the session has no file yet", "say where to save it");
        let path = path.or_else(|| open.editor.path().map(Path::to_owned)).ok_or_else(none)?;
        open.editor.save(&path)
    }

    pub(super) fn write(&mut self, output: PathBuf) -> Result<()> {
        if self.engine.is_opening() {
            return Err(Error::argument("another model is being opened", "wait for it"));
        }
        let open = self.open.as_mut().ok_or_else(nothing_open)?;
        open.editor.set_output(output.clone());
        // The output is made as by `simod run` without options.
        let how = Reconstruction::default();
        let model = open.editor.model().map(Path::to_owned);
        let follow = open.editor.follow();
        let writing = WriteRequest { output, model, follow, method: how.method, normals: how.normals };
        self.engine.write(open.steps().clone(), writing);
        Ok(())
    }

    /// A command whose effect depends on the samples' present positions, as one that does the same
    /// anywhere.
    pub(super) fn resolved(&self, command: Command) -> Command {
        let same = |change: Option<edit::EditCommand>, command| change.map_or(command, Command::Edit);
        let steps = self.open.as_ref().map(|open| open.steps().clone()).unwrap_or_default();
        match command {
            Command::Select { goes_on, .. } => self.resolved_selection(goes_on),
            Command::Camera(_) => Command::Camera(crate::command::CameraMove::Set(self.camera)),
            Command::MakeRegion { step: at, .. } | Command::MakeHandle { step: at, .. } => {
                let regions = steps.get(at).and_then(|e| Some(e.step.deformation()?.regions.clone()));
                let change = regions.map(Change::SetRegions);
                same(change.map(|change| edit::EditCommand::Change { at, change }), command)
            }
            Command::RefineSelection { .. } => {
                let last = steps.last().map(|e| Box::new((*e.step).clone()));
                same(last.map(|step| edit::EditCommand::Add { at: steps.len() - 1, step }), command)
            }
            other => other,
        }
    }
}

/// An error of something that is not there, for commands that name it.
pub(super) fn missing(what: &str, which: impl std::fmt::Display) -> Error {
    Error::argument(format!("there is no {what} {which}"), "choose another one")
}
