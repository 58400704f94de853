//! An edit as a user works on it: a model, the steps on it, and the files that keep them.

use super::document::Document;
use super::entry::Entry;
use super::evaluation::{Evaluation, Refinements};
use crate::params::is_path;
use crate::pipeline::sampled;
use crate::plugins::PluginRegistry;
use crate::session_file::SessionFile;
use crate::session_writer::text;
use crate::side_file;
use crate::step::{Action, Deformation, Origin, Step};
use simod_core::sampled_model::{SampledModel, relative};
use simod_core::sampling::Skip;
use simod_model::follow::Follow;
use simod_model::target::folder_of;
use simod_model::{Error, Progress, Result};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// Edit with its files. Its calls are quick: the model itself is in the [`Evaluation`] that comes with it,
/// which may be on another thread.
pub struct Editor {
    /// The session with its name and all but the steps.
    session: SessionFile,
    path: Option<PathBuf>,
    /// Path beside which the edit is kept against a crash while it has no file.
    opened: PathBuf,
    document: Document,
    plugins: Arc<PluginRegistry>,
    /// Steps as they were saved last, or as they were at first; none where those that were at first are in no
    /// file.
    saved: Option<Arc<[Entry]>>,
    /// Steps as they were kept last against a crash, or that are not to be kept.
    kept: Arc<[Entry]>,
}

impl Editor {
    /// Samples a session's model, to edit it, and returns the editor with the evaluation that does its steps.
    /// `path` is the session's file, if it has one.
    ///
    /// # Errors
    /// The session names no model, it cannot be sampled, or the user cancelled. Steps that cannot be done, as
    /// those of plugins that are missing, stay in the session, and say so when they are
    /// [evaluated](Evaluation::update).
    pub fn open(
        session: SessionFile,
        path: Option<PathBuf>,
        plugins: Arc<PluginRegistry>,
        progress: &dyn Progress,
    ) -> Result<(Self, Evaluation)> {
        let folder = path.as_deref().map_or_else(std::env::temp_dir, |path| folder_of(path).to_owned());
        let (sampled, _) = sampled(&session, Skip::default(), (&folder, &Arc::default()), progress)?;
        Ok(Self::for_sampled(sampled, session, path, plugins, folder))
    }

    /// Edits a model that was sampled before. It has to [hold its cells](SampledModel::hold_cells) to be
    /// refined; temporary files are made in `folder`.
    pub fn for_sampled(
        sampled: SampledModel,
        session: SessionFile,
        path: Option<PathBuf>,
        plugins: Arc<PluginRegistry>,
        folder: PathBuf,
    ) -> (Self, Evaluation) {
        // Steps that cannot be brought up to their plugins say so when they are done.
        let up_to_date = |step: &Step| {
            let mut step = [step.clone()];
            let _ = plugins.migrate(&mut step);
            let [step] = step;
            step
        };
        let document = Document::new(session.steps.iter().map(up_to_date));
        let session = SessionFile {
            // The files that were sampled: a pattern may match others as well by now.
            tiles: sampled.source.tiles.iter().map(|tile| tile.path.clone()).collect(),
            model: session
                .model
                .or_else(|| sampled.source.tiles.is_empty().then(|| sampled.source.path.clone())),
            columns: session.columns.or_else(|| sampled.source.columns.clone()),
            fingerprint: Some(sampled.source.fingerprint.clone()),
            steps: Vec::new(),
            ..session
        };
        let model = session.model.clone();
        let how = Refinements { model, folder, memory_limit: None, time: session.time.time() };
        let (saved, kept) = (Some(document.steps().clone()), document.steps().clone());
        let opened = session.model.clone().unwrap_or_else(|| sampled.source.path.clone());
        let evaluation = Evaluation::new(Arc::new(sampled), how);
        (Self { session, path, opened, document, plugins, saved, kept }, evaluation)
    }

    /// Returns this editor, of an edit that is in no saved file, such as one that was [kept against a
    /// crash](recover).
    #[must_use]
    pub fn unsaved(self) -> Self {
        Self { saved: None, ..self }
    }

    /// Returns this editor, opened by another path than its model's, as by the folder of its samples: beside
    /// that path the edit is kept until it has a file.
    #[must_use]
    pub fn opened_by(self, path: &Path) -> Self {
        Self { opened: path.to_owned(), ..self }
    }

    /// Attributes that turn with the surface besides normals, when the model is written.
    pub fn follow(&self) -> Follow {
        Follow::default().or_declared(&self.session.follow)
    }

    /// The steps.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// The steps, to be changed.
    pub fn document_mut(&mut self) -> &mut Document {
        &mut self.document
    }

    /// Plugins of the edit's steps.
    pub fn plugins(&self) -> &Arc<PluginRegistry> {
        &self.plugins
    }

    /// Takes other plugins, as after looking for them again.
    pub fn set_plugins(&mut self, plugins: Arc<PluginRegistry>) {
        self.plugins = plugins;
    }

    /// Path of the model that is edited, as far as the session names it.
    pub fn model(&self) -> Option<&Path> {
        self.session.model.as_deref()
    }

    /// Path of the deformed model, if the session names it.
    pub fn output(&self) -> Option<&Path> {
        self.session.output.as_deref()
    }

    /// The session's file, if it has one.
    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// Sets the path of the deformed model, which the session names when it is saved the next time.
    pub fn set_output(&mut self, output: PathBuf) {
        self.session.output = Some(output);
    }

    /// Whether the session's file has all changes.
    pub fn is_saved(&self) -> bool {
        self.path.is_some() && self.is_as_saved()
    }

    fn is_as_saved(&self) -> bool {
        self.saved.as_ref().is_some_and(|saved| Arc::ptr_eq(saved, self.document.steps()))
    }

    /// Saves the session, whole or not at all; comments of the file that it was opened from stay. The copy
    /// that was kept against a crash is not needed any more, and removed.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&mut self, path: &Path) -> Result<()> {
        let session = self.session_at(path)?;
        match &self.path {
            Some(former) => session.save_over(path, former)?,
            None => session.save(path)?,
        };
        let former = self.path.replace(path.to_owned()).unwrap_or_else(|| path.to_owned());
        self.saved = Some(self.document.steps().clone());
        self.kept = self.document.steps().clone();
        [&former, path, &self.opened].into_iter().try_for_each(forget)
    }

    /// Removes the copy that was kept against a crash: the user does not want these steps. They are kept
    /// again once they change.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn discard(&mut self) -> Result<()> {
        self.kept = self.document.steps().clone();
        forget(self.kept_beside())
    }

    fn kept_beside(&self) -> &Path {
        self.path.as_deref().unwrap_or(&self.opened)
    }

    /// Keeps the steps against a crash, in a hidden file beside the session's, or beside the file that was
    /// opened if the session has none yet; if there is anything new to keep. [`recover`] returns them. Where
    /// the steps are again as they were saved, or as they were at first, there is nothing to be kept.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn autosave(&mut self) -> Result<()> {
        let steps = self.document.steps();
        if Arc::ptr_eq(&self.kept, steps) {
            return Ok(());
        }
        let steps = steps.clone();
        if self.is_as_saved() {
            forget(self.kept_beside())?;
            self.kept = steps;
            return Ok(());
        }
        let path = autosave_path(self.kept_beside());
        let used = self.session_at(&path)?.save(&path)?;
        // Former files beside the kept session are removed, as no other session uses them.
        remove(side_file::beside(&path)?.into_iter().filter(|path| !used.contains(path)))?;
        self.kept = steps;
        Ok(())
    }

    /// Session as it would be saved at a path.
    fn session_at(&self, path: &Path) -> Result<SessionFile> {
        let steps = self.document.steps().iter().map(|entry| (*entry.step).clone()).collect();
        saved_at(&SessionFile { steps, ..self.session.clone() }, path, &self.plugins)
    }
}

/// Deformation whose files are named relative to another folder, with the origin of its plugin.
fn moved(from: &Deformation, folder: &Path, plugins: &PluginRegistry) -> Result<Deformation> {
    let mut to = Deformation { folder: folder.to_owned(), ..from.clone() };
    let Ok(plugin) = plugins.get(&from.deform) else { return Ok(to) };
    to.plugin = Origin::from_plugin(plugin);
    if from.folder != folder {
        for file in plugin.params().iter().filter(|d| is_path(d.kind)) {
            if let Some(toml::Value::String(name)) = to.params.get_mut(file.id.as_str()) {
                *name = text(&relative(&from.folder.join(&*name), folder))?;
            }
        }
    }
    Ok(to)
}

/// Session as it is saved at a path: its steps name files relative to there, and the origins of their
/// plugins.
///
/// # Errors
/// A file cannot be named in a text.
pub fn saved_at(session: &SessionFile, path: &Path, plugins: &PluginRegistry) -> Result<SessionFile> {
    let folder = folder_of(path);
    let step = |step: &Step| match &step.action {
        Action::Deform(d) => Ok(Step { action: Action::Deform(moved(d, folder, plugins)?), ..step.clone() }),
        Action::Refine(_) => Ok(step.clone()),
    };
    let steps = session.steps.iter().map(step).collect::<Result<_>>()?;
    Ok(SessionFile { steps, ..session.clone() })
}

/// The file that keeps a session against a crash.
fn autosave_path(session: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(session.file_name().unwrap_or_default());
    name.push(".autosave");
    folder_of(session).join(name)
}

/// Session that was kept of an edit of `path` (a session or, where the edit had no file yet, a model) that
/// was not saved before the program ended; none where all was saved.
///
/// # Errors
/// A session was kept, but it cannot be read.
pub fn recover(path: &Path) -> Result<Option<SessionFile>> {
    let kept = autosave_path(path);
    if !kept.exists() { Ok(None) } else { SessionFile::load(&kept).map(Some) }
}

/// Time at which an unsaved edit of a session or a model was kept before the program ended, if one was.
pub fn kept_at(path: &Path) -> Option<SystemTime> {
    std::fs::metadata(autosave_path(path)).and_then(|kept| kept.modified()).ok()
}

/// Removes the kept copy of a session: the user does not want it.
///
/// # Errors
/// The file cannot be removed.
pub fn forget(path: &Path) -> Result<()> {
    let kept = autosave_path(path);
    match std::fs::remove_file(&kept) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("remove", &kept, &e)),
        _ => remove(side_file::beside(&kept)?),
    }
}

fn remove(files: impl IntoIterator<Item = PathBuf>) -> Result<()> {
    files
        .into_iter()
        .try_for_each(|path| std::fs::remove_file(&path).map_err(|e| Error::io("remove", &path, &e)))
}
