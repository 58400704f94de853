//! Sidecar: the file beside a model's file that declares which of its numbers turn with the surface.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use simod_core::tables;
use simod_model::follow::{Follow, TensorKind};
use simod_model::{Model, Result};

use crate::session_file::read_text;
use crate::session_text::SessionText;

/// Suffix of the model's file name that gives the name of its sidecar.
const SUFFIX: &str = ".follow.toml";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sidecar {
    follow: BTreeMap<String, TensorKind>,
}

/// Path of the sidecar of a model, whether there is one or not.
pub fn path_beside(model: &Path) -> PathBuf {
    let mut path = model.as_os_str().to_owned();
    path.push(SUFFIX);
    path.into()
}

/// Sets the attributes of a model that turn with the surface: by the rules that are asked for or, where these
/// declare nothing, by those of the sidecar. Returns these rules.
///
/// # Errors
/// The sidecar is there, and is no such file; as of [`Model::follow`].
pub fn follow(model: &mut dyn Model, asked: &Follow) -> Result<Follow> {
    let path = path_beside(model.path());
    // Nothing is read that has no say.
    if !(asked.declared.is_empty() && asked.splats && path.exists()) {
        return model.follow(asked).map(|()| asked.clone());
    }
    let hint = "write follow = { tangent = \"direction\" } there, or remove it";
    let text = read_text(&path, "declaration of what follows", hint)?;
    let source = SessionText { text: &text, path: &path };
    let declared: Sidecar = tables::read(&text).map_err(|e| source.refused(&e))?;
    let follow = asked.clone().or_declared(&declared.follow);
    match model.follow(&follow) {
        Ok(()) => Ok(follow),
        Err(e) => {
            let what = format!("{e}, as {} declares", path.display());
            Err(e.saying(what))
        }
    }
}
