//! `session.toml`: everything needed to do an edit again, without a window.

use crate::step::Step;
use serde::{Deserialize, Serialize};
use simod_core::sampling::{By, Placement};
use simod_model::follow::TensorKind;
use simod_model::target::{canonical_target, folder_of};
use simod_model::{Error, ErrorKind, ModelName, Result, input};
use simod_plugin_api::Time;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// Most bytes of a session; a model that is given in its place may be longer.
pub(crate) const LARGEST: u64 = 16 << 20;

/// Version of the format: raised when sessions could not be understood any more by former programs.
pub(crate) const VERSION: i64 = 2;

/// Version of sessions that declare nothing to follow, have no tiles, and whose steps have no titles, amounts
/// or groups: former programs understand these sessions.
pub(crate) const FIRST_VERSION: i64 = 1;

/// A session. Paths are as the program needs them: relative to the current folder, or absolute.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SessionFile {
    /// The huge model; may be missing where a sampled model is given otherwise.
    pub model: Option<PathBuf>,
    /// Files that the model is made of, and patterns of such, where it is made of tiles; another `model` that
    /// is given takes their place.
    pub tiles: Vec<PathBuf>,
    /// Columns of the model, if it is a text in columns that does not name them, as "x,y,z,_,nx,ny,nz".
    pub columns: Option<String>,
    /// Numbers of the vertices that turn with the surface, by the beginning of their names.
    pub follow: BTreeMap<String, TensorKind>,
    /// The model's [fingerprint](simod_core::sampled_model::SourceRecord) when the session was saved.
    pub fingerprint: Option<String>,
    /// Options of sampling the model.
    pub sampling: SamplingTable,
    /// Deformations and refinements, first to last.
    pub steps: Vec<Step>,
    /// Time in a sequence at which the steps are done.
    pub time: SessionTime,
    /// Path of the deformed model.
    pub output: Option<PathBuf>,
    /// Path of the output as it stands in the file, if the session was read from one.
    pub named_output: Option<PathBuf>,
}

/// Options of sampling. At most one of `samples` and `error` is given.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct SamplingTable {
    /// Number of samples to take.
    pub samples: Option<u64>,
    /// Largest error, as a fraction of the diagonal of the bounding box.
    pub error: Option<f64>,
    /// Cells of the grid along the grid's longest side.
    pub grid: Option<u32>,
    /// Amount by which samples are spread; the error of their clusters, where not given.
    pub by: Option<By>,
    /// Rule by which samples are placed; the one that tells where the surface is, where not given.
    pub place: Option<Placement>,
    /// Whether the model's faces tell sheets apart that touch; they do, where not given.
    pub sheets: Option<bool>,
    /// Gaussian splats of less opacity are left out of the samples; 0.1 where not given.
    pub min_opacity: Option<f64>,
}

/// The time in a sequence at which steps are done, for plugins that take it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct SessionTime {
    /// The number of the frame; 0 where that is not said.
    pub frame: Option<i64>,
    /// Frames in a second; 24 where that is not said.
    pub rate: Option<f64>,
    /// Seconds since the beginning; by frame and rate where not given.
    pub seconds: Option<f64>,
}

impl SessionTime {
    /// The time as plugins get it.
    pub fn time(&self) -> Time {
        let frame = self.frame.unwrap_or(0);
        let seconds = self.seconds.unwrap_or_else(|| frame as f64 / self.rate.unwrap_or(24.0));
        Time { frame, seconds }
    }

    /// Defect of the time, if it has one.
    pub fn defect(&self) -> Option<&'static str> {
        if self.rate.is_some_and(|rate| !(rate > 0.0 && rate.is_finite())) {
            Some("`rate` is no number of frames in a second")
        } else if !self.time().seconds.is_finite() {
            Some("`seconds` is no finite number")
        } else {
            None
        }
    }
}

impl SessionFile {
    /// Model that the session names, if it does.
    ///
    /// # Errors
    /// A pattern matches no file.
    pub fn named_model(&self) -> Result<Option<ModelName>> {
        match &self.model {
            Some(model) => ModelName::from_path(model).map(Some),
            None if self.tiles.is_empty() => Ok(None),
            // A list is of tiles, even if there is but one.
            None => Ok(Some(ModelName::Tiles(ModelName::of_all(&self.tiles)?.files().to_vec()))),
        }
    }

    /// Path of the deformed model that the session itself names, which has to be beside the session, or in a
    /// folder beside it. `path` is the session's. A session may be a stranger's, who has no say about other
    /// folders.
    ///
    /// # Errors
    /// The session does not say so, or names another place.
    pub fn output_beside(&self, path: &Path) -> Result<&Path> {
        let Some(output) = self.output.as_deref() else {
            return Err(Error::argument(
                format!("{} does not say where the result goes", path.display()),
                "add [output] path = \"…\" to the session, or give -o FILE",
            ));
        };
        let folder = folder_of(path);
        // The output is beside the session by its name and, through links, in fact.
        let is_plain = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        if self.named_output.as_deref().is_some_and(|named| named.components().all(is_plain)) {
            let target = match output.canonicalize() {
                Ok(folder) if folder.is_dir() => folder,
                _ => canonical_target(output)?,
            };
            if folder.canonicalize().is_ok_and(|folder| target.starts_with(folder)) {
                return Ok(output);
            }
        }
        Err(Error::argument(
            format!("{} would have its result written to {}", path.display(), output.display()),
            "a session by itself writes beside itself alone: say with -o FILE where the result goes",
        ))
    }
}

/// Text of a small file; `what` names the kind of file, and `hint` the file to give, for errors.
pub fn read_text(path: &Path, what: &str, hint: &str) -> Result<String> {
    input::read_text(path, LARGEST).map_err(|e| match e.kind() {
        ErrorKind::Format => {
            Error::format(format!("{} is no {what}: not UTF-8 text, or too long", path.display()), hint)
        }
        _ => e,
    })
}

/// Files that a session, or a file of methods, names to be read: the model, strokes, selections, files among
/// parameters. Missing ones are reported when they are needed.
///
/// # Errors
/// The file itself cannot be read.
pub fn inputs(path: &Path) -> Result<Vec<PathBuf>> {
    fn texts(value: &toml::Value, found: &mut dyn FnMut(&str)) {
        match value {
            toml::Value::String(text) => found(text),
            toml::Value::Array(all) => all.iter().for_each(|value| texts(value, found)),
            toml::Value::Table(all) => all.values().for_each(|value| texts(value, found)),
            _ => {}
        }
    }
    let text = read_text(path, "session", "give a session file (session.toml), not a model")?;
    let Ok(mut table) = text.parse::<toml::Table>() else { return Ok(Vec::new()) };
    table.remove("output");
    let (folder, mut files) = (path.parent().unwrap_or(Path::new("")), Vec::new());
    // Only plugins know which texts name files: all texts that name a file that is there count.
    texts(&toml::Value::Table(table), &mut |text| {
        files.extend(Some(folder.join(text)).filter(|path| !text.is_empty() && path.is_file()));
    });
    Ok(files)
}
