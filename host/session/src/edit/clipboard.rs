//! Steps on the clipboard: the text of a session that has nothing but them, so that they can be pasted into
//! another edit, a message, or a file.

use crate::plugins::PluginRegistry;
use crate::session_file::{LARGEST, SessionFile};
use crate::session_writer::text;
use crate::step::{Action, Deformation, Origin, ParamPlaces, Step};
use simod_model::{Error, Result};
use simod_plugin_api::ParamKind;
use std::path::Path;

/// Name of the place of a step that is pasted, for errors.
const CLIPBOARD: &str = "the clipboard";

/// Steps as a text, with all their strokes and selections in it. Files among their parameters are named by
/// whole paths.
///
/// # Errors
/// The text is longer than a session can be; a file's name is no text.
pub fn copied(steps: &[Step], plugins: &PluginRegistry) -> Result<String> {
    let steps = steps.iter().map(|step| with_whole_paths(step, plugins)).collect::<Result<_>>()?;
    let session = SessionFile { steps, ..SessionFile::default() };
    let copied = session.to_toml(Path::new(CLIPBOARD))?;
    if copied.len() as u64 > LARGEST {
        let what = format!("the steps are {} MB of text, more than a session can have", copied.len() >> 20);
        return Err(Error::argument(what, "save the session, and open it where it is needed"));
    }
    Ok(copied)
}

/// Steps of a text: one that was [copied], or that of a session. Paths of files among their parameters are
/// relative to `folder`.
///
/// # Errors
/// The text is no session's, names what makes no sense, or has no steps.
pub fn pasted(text: &str, folder: &Path) -> Result<Vec<Step>> {
    let hint = "copy steps in a window, or the text of a session";
    if text.len() as u64 > LARGEST {
        let what =
            format!("what is on the clipboard is longer than a session can be: {} MB", text.len() >> 20);
        return Err(Error::argument(what, hint));
    }
    let mut steps = SessionFile::parse(text, Path::new(CLIPBOARD))?.steps;
    if steps.is_empty() {
        return Err(Error::argument("there are no steps on the clipboard", hint));
    }
    steps.iter_mut().for_each(|step| seen_from(step, folder));
    Ok(steps)
}

/// Makes a step one that is in no file, with the paths of its files relative to a folder.
pub(crate) fn seen_from(step: &mut Step, folder: &Path) {
    step.place.clear();
    if let Action::Deform(deformation) = &mut step.action {
        folder.clone_into(&mut deformation.folder);
        deformation.param_places = ParamPlaces::default();
    }
}

/// Step whose files are named by whole paths, with the origin of its plugin; as far as the plugin is there.
fn with_whole_paths(step: &Step, plugins: &PluginRegistry) -> Result<Step> {
    let mut step = step.clone();
    if let Action::Deform(Deformation { deform, plugin: origin, params, folder, .. }) = &mut step.action
        && let Ok(plugin) = plugins.get(deform)
    {
        *origin = Origin::from_plugin(plugin);
        for file in plugin.params().iter().filter(|d| d.kind == ParamKind::FILE) {
            if let Some(toml::Value::String(name)) = params.get_mut(file.id.as_str())
                && !name.is_empty()
            {
                let path = folder.join(&*name);
                *name = text(&std::path::absolute(&path).unwrap_or(path))?;
            }
        }
    }
    Ok(step)
}
