//! `session.toml`: everything needed to do an edit again, without a window.

use crate::deformer::Plugin;
use crate::key::{Key, Keyed};
use crate::motion::Motion;
use crate::shapes::{Shape, Shapes};
use crate::side_file;
pub use crate::stroke::Stroke;
use crate::strokes_file;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_core::refinement::Finer;
use simod_core::sampling::{By, Placement};
use simod_model::follow::Kind;
use simod_model::target::{canonical_target, folder_of};
use simod_model::{Error, ErrorKind, ModelName, Result, input, object};
use simod_plugin_api::Time;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use toml::Spanned;

/// No session is longer than this; a model that is given in its place may be.
pub(crate) const LARGEST: u64 = 16 << 20;

/// The format's version: raised when what a session says could not be understood any more by former versions.
pub(crate) const VERSION: i64 = 2;

/// The version of those that declare nothing to follow, have no tiles, and whose steps have no titles,
/// amounts or groups: former programs understand them.
pub(crate) const FIRST_VERSION: i64 = 1;

/// A session. Paths are as the program needs them: relative to the current folder, or absolute.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SessionFile {
    /// The huge model; may be missing where a sampled model is given otherwise.
    pub model: Option<PathBuf>,
    /// The files that it is made of, and patterns of such, where it is made of tiles; another `model` that is
    /// given takes their place.
    pub tiles: Vec<PathBuf>,
    /// What its columns are, if it is a text in columns that does not say so, as "x,y,z,_,nx,ny,nz".
    pub columns: Option<String>,
    /// Numbers of the vertices that turn with the surface, by what their names begin with.
    pub follow: BTreeMap<String, Kind>,
    /// The model's [fingerprint](simod_core::sampled_model::Source) when the session was saved.
    pub fingerprint: Option<String>,
    /// How finely to sample it.
    pub sampling: Sampling,
    /// Deformations and refinements, first to last.
    pub steps: Vec<Step>,
    /// When in a sequence the steps are done.
    pub time: SessionTime,
    /// Where the deformed model goes.
    pub output: Option<PathBuf>,
    /// The same as it stands in the file, if this was read from one.
    pub named_output: Option<PathBuf>,
}

/// How finely to sample. At most one of `samples` and `error` is given.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Sampling {
    /// How many samples to take.
    pub samples: Option<u64>,
    /// Largest error, as a fraction of the diagonal of the bounding box.
    pub error: Option<f64>,
    /// Cells of the grid along its longest side.
    pub grid: Option<u32>,
    /// What places the samples; that which tells where the surface is, where not given.
    pub place: Option<Placement>,
    /// What samples are spread by; the error of their clusters, where not given.
    pub by: Option<By>,
    /// Whether the model's faces tell sheets apart that touch; they do, where not given.
    pub sheets: Option<bool>,
    /// Gaussian splats of less opacity are left out of the samples; 0.1 where not given.
    pub min_opacity: Option<f64>,
}

/// When in a sequence steps are done, for plugins that take the time.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct SessionTime {
    /// Which frame it is; 0 where that is not said.
    pub frame: Option<i64>,
    /// Frames in a second; 24 where that is not said.
    pub rate: Option<f64>,
    /// Seconds since the beginning; by frame and rate where they are not said.
    pub seconds: Option<f64>,
}

impl SessionTime {
    /// As plugins get it.
    pub fn time(&self) -> Time {
        let frame = self.frame.unwrap_or(0);
        let seconds = self.seconds.unwrap_or_else(|| frame as f64 / self.rate.unwrap_or(24.0));
        Time { frame, seconds }
    }

    /// What is wrong with it, if anything.
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

/// One step of an edit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Step {
    /// What is done.
    pub action: Action,
    /// Whether it is done; a step that is not stays in the session.
    #[serde(default = "yes")]
    pub enabled: bool,
    /// What the user calls it, if anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub title: Option<String>,
    /// What the group is called that it is in, with those before and behind it that say the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// Where in the file it stands, as `session.toml, line 7`; for errors.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub place: String,
}

/// What a step does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(clippy::large_enum_variant, reason = "nearly all steps are the large one, and a session has a few")]
pub enum Action {
    /// The samples are moved.
    Deform(Deformation),
    /// There are more samples.
    Refine(Refine),
}

/// More samples in a part of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Refine {
    /// Where: on the model as the steps before have deformed it. None is everywhere, for those that find out
    /// by themselves ([`Finer::Auto`]).
    pub shapes: Shapes,
    /// How fine.
    pub finer: Finer,
}

impl Refine {
    /// What is wrong with it, and what to do.
    ///
    /// # Errors
    /// That.
    pub fn check(&self) -> Result<(), (&'static str, &'static str)> {
        self.shapes.check().map_err(|what| (what, "give another shape"))?;
        if self.shapes.shapes.is_empty() && !self.is_auto() {
            return Err(("the refinement has no shape", "give one, such as a sphere, or `auto = true`"));
        }
        if self.finer.makes_sense() {
            Ok(())
        } else {
            Err(("the refinement is to no fineness that makes sense", FINER))
        }
    }

    /// Whether it finds out by itself where samples are needed.
    pub fn is_auto(&self) -> bool {
        matches!(self.finer, Finer::Auto { .. })
    }
}

/// How fine a refinement can be.
const FINER: &str =
    "an error of 0 or more as a fraction of the diagonal, a factor above 1, or at least 1 sample";

/// One deformation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Deformation {
    /// The plugin's id.
    pub deform: String,
    /// Where the plugin came from, as far as that was known when the session was saved.
    pub plugin: Option<Origin>,
    /// The version of what the plugin's parameters mean; where nothing is said, the first.
    #[serde(default)]
    pub state_version: Option<u32>,
    /// The parameters that differ from their defaults.
    #[serde(default)]
    pub params: toml::Table,
    /// Regions, in the file's order.
    #[serde(default)]
    pub regions: Vec<Region>,
    /// Joints that the user placed, in the file's order.
    #[serde(default)]
    pub joints: Vec<Joint>,
    /// How the plugin's own handles move.
    #[serde(default)]
    pub handles: Vec<HandleMove>,
    /// Brush strokes, first to last.
    #[serde(default)]
    pub strokes: Vec<Arc<Stroke>>,
    /// How much of it is done: 0 leaves all at rest, 1 is the whole deformation, and what is between is
    /// blended linearly.
    #[serde(default = "full", skip_serializing_if = "is_full")]
    pub amount: f64,
    /// What paths among the parameters are relative to.
    #[serde(default)]
    pub folder: PathBuf,
    /// Where the parameters stand in the file; for errors.
    #[serde(skip)]
    pub param_places: ParamPlaces,
    /// What was changed when it was brought up to its plugin; for users.
    #[serde(skip)]
    pub notes: Notes,
}

/// What was done to a step, in words. No part of what the step is: all are equal.
#[derive(Debug, Clone, Default)]
pub struct Notes(Arc<[String]>);

impl PartialEq for Notes {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl From<Vec<String>> for Notes {
    fn from(notes: Vec<String>) -> Self {
        Self(notes.into())
    }
}

impl Notes {
    /// One by one.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }
}

/// Where the parameters of a step stand in its file, as `session.toml, line 9`. No part of what the step is:
/// all are equal.
#[derive(Debug, Clone, Default)]
pub struct ParamPlaces(Arc<BTreeMap<String, String>>);

impl PartialEq for ParamPlaces {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl ParamPlaces {
    /// The same where parameters have other names.
    pub(crate) fn renamed(&self, aliases: &[(String, String)]) -> Self {
        let mut places = (*self.0).clone();
        for (former, now) in aliases {
            if let Some(place) = places.get(former).cloned() {
                places.entry(now.clone()).or_insert(place);
            }
        }
        Self(Arc::new(places))
    }

    /// Where an error belongs to that came up in the step at `place`: to the parameter that it names, if the
    /// file gives that one.
    pub(crate) fn of<'a>(&'a self, place: &'a str, error: &Error) -> &'a str {
        let text = error.to_string();
        let named = text.split("parameter `").skip(1).filter_map(|rest| rest.split('`').next());
        named.filter_map(|id| self.0.get(id)).next().map_or(place, String::as_str)
    }
}

/// Where a plugin came from: for those who do not have it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// The version that the step was made with.
    pub version: String,
    /// The author of the plugin.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub author: String,
    /// Where there is more about it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub url: String,
}

impl Origin {
    /// The origin of a plugin that says where it comes from, unlike those that come with the program.
    pub fn from_plugin(plugin: &Plugin) -> Option<Self> {
        let [version, author, url] = [plugin.version(), plugin.author(), plugin.url()].map(str::to_owned);
        (!(author.is_empty() && url.is_empty())).then_some(Self { version, author, url })
    }
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "version {}", self.version)?;
        if !self.author.is_empty() {
            write!(f, " by {}", self.author)?;
        }
        if !self.url.is_empty() {
            write!(f, ", {}", self.url)?;
        }
        Ok(())
    }
}

impl Deformation {
    /// One by a plugin, which is given nothing.
    pub fn by_plugin(plugin: &str) -> Self {
        Self {
            deform: plugin.to_owned(),
            plugin: None,
            state_version: None,
            params: toml::Table::new(),
            regions: Vec::new(),
            joints: Vec::new(),
            handles: Vec::new(),
            strokes: Vec::new(),
            amount: full(),
            folder: PathBuf::new(),
            param_places: ParamPlaces::default(),
            notes: Notes::default(),
        }
    }
}

/// Longest title of a step, or name of a group, in characters.
const LONGEST_NAME: usize = 200;

impl Step {
    /// One that is done, in no file, and that nobody has given a title.
    pub fn new(action: Action) -> Self {
        Self { action, enabled: true, title: None, group: None, place: String::new() }
    }

    /// The plugin's id, or what else the step is.
    pub fn name(&self) -> &str {
        match &self.action {
            Action::Deform(deformation) => &deformation.deform,
            Action::Refine(_) => "refine",
        }
    }

    /// Where an error of the step belongs to: the step, or the parameter that it names.
    pub(crate) fn place_of<'a>(&'a self, error: &Error) -> &'a str {
        self.deformation().map_or(&self.place, |d| d.param_places.of(&self.place, error))
    }

    /// Whether there may be more samples after it.
    pub fn refines(&self) -> bool {
        matches!(self.action, Action::Refine(_))
    }

    /// The deformation, where it is one.
    pub fn deformation(&self) -> Option<&Deformation> {
        match &self.action {
            Action::Deform(deformation) => Some(deformation),
            Action::Refine(_) => None,
        }
    }
}

/// What is wrong with a step's `title`, or the name of its `group`, if anything.
pub(crate) fn name_defect(key: &str, name: &str) -> Option<String> {
    let what = if name.trim().is_empty() {
        "is empty"
    } else if name.chars().count() > LONGEST_NAME {
        "is longer than 200 characters"
    } else if name.chars().any(char::is_control) {
        "has a character that is none to be read, such as the end of a line"
    } else {
        return None;
    };
    Some(format!("a `{key}` {what}"))
}

/// Whether a step can be done by this amount.
pub(crate) fn is_amount(amount: f64) -> bool {
    (0.0..=1.0).contains(&amount)
}

/// A joint of a skeleton.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Joint {
    /// Unique among the step's joints.
    pub id: String,
    /// Where it is at rest, model coordinates.
    #[serde(deserialize_with = "crate::vector::three")]
    pub at: DVec3,
    /// The id of the joint that it hangs on, if any.
    pub parent: Option<String>,
}

/// How a handle that the plugin placed moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct HandleMove {
    /// The handle's id.
    pub id: String,
    /// How it moves; about its place at rest unless the motion says otherwise.
    pub motion: Motion,
}

impl Keyed for Joint {
    fn add_to(&self, key: &mut Key) {
        let Self { id, at, parent } = self;
        ((id, at), parent).add_to(key);
    }
}

impl Keyed for Refine {
    fn add_to(&self, key: &mut Key) {
        let Self { shapes, finer } = self;
        (shapes, finer).add_to(key);
    }
}

fn yes() -> bool {
    true
}

fn full() -> f64 {
    1.0
}

fn is_full(amount: &f64) -> bool {
    *amount == full()
}

/// What a region's samples do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// They stay.
    Fixed,
    /// They follow the region's motion.
    Handle,
    /// The step acts here alone.
    Mask,
}

/// A region of space with a role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Region {
    /// What it is for.
    pub role: Role,
    /// Where it is.
    pub shapes: Shapes,
    /// How a handle moves; nothing for other roles.
    #[serde(default)]
    pub motion: Motion,
}

// As the file has it.

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct RawSession {
    version: Option<Spanned<i64>>,
    model: Option<Spanned<RawSessionModel>>,
    follow: Option<Spanned<BTreeMap<String, Kind>>>,
    #[serde(default)]
    sampling: Option<Spanned<Sampling>>,
    time: Option<Spanned<SessionTime>>,
    #[serde(default)]
    step: Vec<Spanned<RawStep>>,
    output: Option<RawPath>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSessionModel {
    path: Option<PathBuf>,
    tiles: Option<Spanned<RawTiles>>,
    columns: Option<String>,
    fingerprint: Option<String>,
}

/// A file or pattern, or several.
#[derive(Deserialize)]
#[serde(untagged)]
enum RawTiles {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

impl RawTiles {
    fn into_paths(self, folder: &Path) -> Vec<PathBuf> {
        let paths = match self {
            Self::One(path) => vec![path],
            Self::Several(paths) => paths,
        };
        paths.iter().map(|path| named_from(folder, path)).collect()
    }
}

/// The table `[model]` of a comparison, as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawModel {
    /// The model's file, relative to the folder of the file that names it.
    pub path: PathBuf,
    /// What the columns of a model in text are.
    pub columns: Option<String>,
    /// The hash of the model that is meant.
    pub fingerprint: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPath {
    path: PathBuf,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct RawStep {
    deform: Option<String>,
    plugin: Option<Origin>,
    state_version: Option<u32>,
    #[serde(default)]
    params: BTreeMap<Spanned<String>, toml::Value>,
    #[serde(default)]
    region: Vec<Spanned<RawRegion>>,
    #[serde(default)]
    joint: Vec<Spanned<Joint>>,
    #[serde(default)]
    handle: Vec<Spanned<RawHandle>>,
    #[serde(default)]
    stroke: Vec<Spanned<Stroke>>,
    strokes: Option<Spanned<side_file::Reference>>,
    enabled: Option<bool>,
    title: Option<Spanned<String>>,
    group: Option<Spanned<String>>,
    amount: Option<Spanned<f64>>,
    refine: Option<Spanned<RawRefine>>,
}

impl RawStep {
    /// What of it the first version of the format does not know.
    fn of_version_2(&self) -> Option<(&'static str, Range<usize>)> {
        let text = |key, text: &Option<Spanned<String>>| text.as_ref().map(|text| (key, text.span()));
        let amount = || self.amount.as_ref().map(|amount| ("amount", amount.span()));
        text("title", &self.title).or_else(|| text("group", &self.group)).or_else(amount)
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct RawRefine {
    shapes: Option<Vec<Spanned<Shape>>>,
    auto: Option<bool>,
    error: Option<f64>,
    factor: Option<f64>,
    samples: Option<u64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct RawHandle {
    id: String,
    r#move: Spanned<Motion>,
}

/// A table `[[region]]`, as it is written: [`SessionText::region`] makes a [`Region`] of it.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct RawRegion {
    role: Role,
    shapes: Vec<Spanned<Shape>>,
    falloff: Option<Spanned<f64>>,
    r#move: Option<Spanned<Motion>>,
}

impl SessionFile {
    /// Reads a session; its paths are relative to the file's folder.
    pub fn load(path: &Path) -> Result<Self> {
        let text = read_text(path, "session", "give a session file (session.toml), not a model")?;
        Self::parse(&text, path)
    }

    /// What it names as its model, if it does.
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

    /// Where the session itself says that the deformed model goes: beside it, or in a folder beside it.
    /// `path` is the session's. A session may be a stranger's, who has no say about other folders.
    ///
    /// # Errors
    /// It does not say so, or names another place.
    pub fn output_beside(&self, path: &Path) -> Result<&Path> {
        let Some(output) = self.output.as_deref() else {
            return Err(Error::new(
                ErrorKind::Argument,
                format!("{} does not say where the result goes", path.display()),
                "add [output] path = \"…\" to the session, or give -o FILE",
            ));
        };
        let folder = folder_of(path);
        // By what it says and, through links, in fact.
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
        Err(Error::new(
            ErrorKind::Argument,
            format!("{} would have its result written to {}", path.display(), output.display()),
            "a session by itself writes beside itself alone: say with -o FILE where the result goes",
        ))
    }

    /// Reads a session from its text; `path` is where it came from.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let source = SessionText { text, path };
        let raw: RawSession = toml::from_str(text).map_err(|e| source.refused(&e))?;
        if let Some(version) = raw.version.as_ref().filter(|v| !(1..=VERSION).contains(v.get_ref())) {
            let what =
                format!("the session is of version {}, this program knows {VERSION}", version.get_ref());
            return Err(source.error(&version.span(), &what, "open it with a newer version of SIMOD"));
        }
        let version = raw.version.map_or(VERSION, Spanned::into_inner);
        let follow = raw.follow.as_ref().map(|follow| ("follow", follow.span()));
        let newer = follow.or_else(|| raw.step.iter().find_map(|step| step.get_ref().of_version_2()));
        if let Some((key, span)) = newer.filter(|_| version < VERSION) {
            let hint = "write `version = 2` at its beginning: programs that do not know it refuse it then";
            return Err(source.error(&span, &format!("`{key}` is of sessions of version 2"), hint));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let (span, raw_model) = raw.model.map(|model| (model.span(), model.into_inner())).unzip();
        let (mut model, mut tiles, mut columns, mut fingerprint) = (None, Vec::new(), None, None);
        if let (Some(span), Some(raw)) = (span, raw_model) {
            (columns, fingerprint) = (raw.columns, raw.fingerprint);
            model = raw.path.map(|path| named_from(folder, &path));
            if let Some(named) = raw.tiles {
                let span = named.span();
                if version < VERSION {
                    let hint =
                        "write `version = 2` at its beginning: programs that do not know it refuse it then";
                    return Err(source.error(&span, "`tiles` are of sessions of version 2", hint));
                }
                tiles = named.into_inner().into_paths(folder);
                if tiles.is_empty() || model.is_some() {
                    let what = if tiles.is_empty() {
                        "there are no `tiles`"
                    } else {
                        "both `path` and `tiles` are given"
                    };
                    return Err(source.error(&span, what, "name a file in `path`, or files in `tiles`"));
                }
            }
            if model.is_none() && tiles.is_empty() {
                let hint = "name a file in `path`, or files in `tiles`";
                return Err(source.error(&span, "the model has no `path`", hint));
            }
        }
        let sampling = match raw.sampling {
            Some(sampling) => source.sampling(sampling)?,
            None => Sampling::default(),
        };
        Ok(Self {
            columns,
            fingerprint,
            model,
            tiles,
            follow: raw.follow.map(Spanned::into_inner).unwrap_or_default(),
            sampling,
            time: raw.time.map_or(Ok(SessionTime::default()), |time| source.time(&time))?,
            steps: raw.step.into_iter().map(|s| source.step(s)).collect::<Result<_>>()?,
            output: raw.output.as_ref().map(|o| named_from(folder, &o.path)),
            named_output: raw.output.map(|o| o.path),
        })
    }
}

/// A path that a session in a folder names. What is secret in the URL of an object is not remembered in it.
fn named_from(folder: &Path, path: &Path) -> PathBuf {
    input::seen_from(folder, Path::new(&object::admit(path)))
}

/// The text of a small file; `what` it should be, and what to give, for errors.
pub fn read_text(path: &Path, what: &str, hint: &str) -> Result<String> {
    input::read_text(path, LARGEST).map_err(|e| match e.kind() {
        ErrorKind::Format => Error::new(
            ErrorKind::Format,
            format!("{} is no {what}: not UTF-8 text, or too long", path.display()),
            hint,
        ),
        _ => e,
    })
}

/// All files that a session, or a file of methods, names to be read: the model, strokes, selections, files
/// among parameters. What is missing is told when it is needed.
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
    // Which of them name files is known to the plugins alone: those that there are.
    texts(&toml::Value::Table(table), &mut |text| {
        files.extend(Some(folder.join(text)).filter(|path| !text.is_empty() && path.is_file()));
    });
    Ok(files)
}

/// The file, for errors that say where.
pub struct SessionText<'a> {
    /// All that is written in it.
    pub text: &'a str,
    /// Its path, which other paths in it are relative to the folder of.
    pub path: &'a Path,
}

impl SessionText<'_> {
    /// The file's name and the line, counted from 1.
    pub fn place(&self, span: &Range<usize>) -> String {
        let before = self.text.as_bytes().get(..span.start).unwrap_or_default();
        let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
        format!("{}, line {line}", self.path.display())
    }

    /// An error of format, `what`, at a place in the file.
    pub fn error(&self, span: &Range<usize>, what: &str, hint: impl Into<String>) -> Error {
        Error::new(ErrorKind::Format, format!("{}: {what}", self.place(span)), hint)
    }

    /// An error of what is named there.
    fn locate(&self, span: &Range<usize>, e: Error) -> Error {
        let what = format!("{}: {e}", self.place(span));
        e.saying(what)
    }

    /// What paths in the file are relative to.
    fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// The parser's complaint on one line, with the line of the file that it is about.
    pub fn refused(&self, error: &toml::de::Error) -> Error {
        let message = error.message().lines().collect::<Vec<_>>().join("; ");
        let Some(span) = error.span() else {
            let what = format!("{}: {message}", self.path.display());
            return Error::new(ErrorKind::Format, what, "compare it with the examples");
        };
        let start = self.text[..span.start.min(self.text.len())].rfind('\n').map_or(0, |i| i + 1);
        let line = self.text[start..].lines().next().unwrap_or_default().trim();
        let line: String = line.chars().take(80).collect();
        self.error(&span, &message, format!("the line reads: {line}"))
    }

    /// The table `[sampling]`, checked.
    ///
    /// # Errors
    /// Both a number of samples and an error are given, or a value is out of range: with the line.
    pub fn sampling(&self, sampling: Spanned<Sampling>) -> Result<Sampling> {
        let span = sampling.span();
        let sampling = sampling.into_inner();
        let wrong = |what, hint: &str| Err(self.error(&span, what, hint));
        if sampling.samples.is_some() && sampling.error.is_some() {
            return wrong("both `samples` and `error` are given", "keep one of the two");
        }
        if sampling.samples == Some(0) {
            return wrong("`samples` is 0", "give a number such as 50000");
        }
        if sampling.error.is_some_and(|e| !(e > 0.0 && e.is_finite())) {
            return wrong("`error` is not positive", "give a fraction of the diagonal, such as 2e-4");
        }
        if sampling.grid == Some(0) {
            return wrong("`grid` is 0", "leave it out, or give a number such as 128");
        }
        Ok(sampling)
    }

    fn time(&self, time: &Spanned<SessionTime>) -> Result<SessionTime> {
        match time.get_ref().defect() {
            Some(what) => Err(self.error(
                &time.span(),
                what,
                "give a frame, such as 12, and perhaps a rate, such as 24",
            )),
            None => Ok(*time.get_ref()),
        }
    }

    fn step(&self, step: Spanned<RawStep>) -> Result<Step> {
        let (span, mut raw) = (step.span(), step.into_inner());
        let (enabled, place) = (raw.enabled.unwrap_or(true), self.place(&span));
        let title = self.name("title", raw.title.take())?;
        let group = self.name("group", raw.group.take())?;
        let action = if raw.refine.is_some() {
            Action::Refine(self.refine(&span, raw)?)
        } else {
            Action::Deform(self.deformation(&span, raw)?)
        };
        Ok(Step { action, enabled, title, group, place })
    }

    /// What the user calls a step, or a group.
    fn name(&self, key: &str, name: Option<Spanned<String>>) -> Result<Option<String>> {
        match name.as_ref().and_then(|name| Some((name.span(), name_defect(key, name.get_ref())?))) {
            Some((span, what)) => Err(self.error(&span, &what, "give it a few words, or leave it out")),
            None => Ok(name.map(Spanned::into_inner)),
        }
    }

    fn refine(&self, span: &Range<usize>, raw: RawStep) -> Result<Refine> {
        let nothing_else = raw.deform.is_none()
            && raw.plugin.is_none()
            && raw.state_version.is_none()
            && raw.params.is_empty()
            && raw.region.is_empty()
            && raw.joint.is_empty()
            && raw.handle.is_empty()
            && raw.stroke.is_empty()
            && raw.strokes.is_none()
            && raw.amount.is_none();
        let Some(refine) = raw.refine.filter(|_| nothing_else) else {
            let hint = "give each a [[step]] of its own";
            return Err(self.error(span, "a step that refines does nothing else", hint));
        };
        let span = refine.span();
        let RawRefine { shapes, auto, error, factor, samples } = refine.into_inner();
        let auto = auto.unwrap_or(false);
        let shapes = match shapes {
            Some(shapes) => self.shapes(&span, "the refinement has no shape", shapes)?,
            None if auto => Shapes::default(),
            None => {
                let hint = "give `shapes`, such as a sphere, or `auto = true`";
                return Err(self.error(&span, "the refinement has no `shapes`", hint));
            }
        };
        let finer = match (error, factor, samples) {
            (error, None, samples) if auto => Finer::Auto { error: error.unwrap_or(Finer::ALLOWED), samples },
            _ if auto => {
                let hint = "give `error` (a fraction of the diagonal) or `samples` with `auto`, or both";
                return Err(self.error(&span, "`factor` says nothing of what is needed", hint));
            }
            (Some(e), None, None) => Finer::Error(e),
            (None, Some(f), None) => Finer::Factor(f),
            (None, None, Some(n)) => Finer::Samples(n),
            _ => return Err(self.error(&span, "give one of `error`, `factor` and `samples`", FINER)),
        };
        let refine = Refine { shapes, finer };
        match refine.check() {
            Ok(()) => Ok(refine),
            Err((what, hint)) => Err(self.error(&span, what, hint)),
        }
    }

    /// At least one shape, which all make sense.
    fn shapes(&self, span: &Range<usize>, none: &str, raw: Vec<Spanned<Shape>>) -> Result<Shapes> {
        if raw.is_empty() {
            return Err(self.error(span, none, "give one, such as a sphere"));
        }
        let mut shapes = Shapes::default();
        for shape in raw {
            let (span, mut shape) = (shape.span(), shape.into_inner());
            if let Shape::Selection(picked) = shape {
                shape = Shape::Selection(picked.loaded(self.folder()).map_err(|e| self.locate(&span, e))?);
            }
            if let Some(what) = shape.defect() {
                return Err(self.error(&span, what, "correct the shape"));
            }
            shapes.shapes.push(shape);
        }
        Ok(shapes)
    }

    fn deformation(&self, span: &Range<usize>, raw: RawStep) -> Result<Deformation> {
        let deform = raw.deform.ok_or_else(|| {
            self.error(span, "the step has no `deform`", "name a plugin, such as deform = \"warp\"")
        })?;
        let folder = self.folder();
        let mut strokes = match raw.strokes {
            Some(file) => {
                strokes_file::read(file.get_ref(), folder).map_err(|e| self.locate(&file.span(), e))?
            }
            None => Vec::new(),
        };
        for stroke in raw.stroke {
            strokes.push(Arc::new(self.stroke(stroke)?));
        }
        if let Some(amount) = raw.amount.as_ref().filter(|amount| !is_amount(*amount.get_ref())) {
            let what = "the `amount` of a step is not from 0 to 1";
            return Err(self.error(
                &amount.span(),
                what,
                "give 0 for nothing of it, 1 for all, or what is between",
            ));
        }
        let places = raw.params.keys().map(|id| (id.get_ref().clone(), self.place(&id.span())));
        Ok(Deformation {
            deform,
            plugin: raw.plugin,
            state_version: raw.state_version,
            notes: Notes::default(),
            param_places: ParamPlaces(Arc::new(places.collect())),
            params: raw.params.into_iter().map(|(id, value)| (id.into_inner(), value)).collect(),
            regions: raw.region.into_iter().map(|r| self.region(r)).collect::<Result<_>>()?,
            joints: self.joints(raw.joint)?,
            handles: self.handles(raw.handle)?,
            strokes,
            amount: raw.amount.map_or_else(full, Spanned::into_inner),
            folder: folder.to_owned(),
        })
    }

    /// The joints, each after the one that it hangs on: those that hang on none first, and then what hangs on
    /// these.
    fn joints(&self, raw: Vec<Spanned<Joint>>) -> Result<Vec<Joint>> {
        let mut numbers: HashMap<String, usize> = HashMap::with_capacity(raw.len());
        for (number, joint) in raw.iter().enumerate() {
            let (span, joint) = (joint.span(), joint.get_ref());
            self.check_id(&span, &joint.id, numbers.contains_key(&joint.id))?;
            if !joint.at.is_finite() {
                let what = "a joint has a coordinate that is no finite number";
                return Err(self.error(&span, what, "correct the joint"));
            }
            numbers.insert(joint.id.clone(), number);
        }
        // Number of joints that each one hangs on; 0 where that is not known yet.
        let mut depths = vec![0usize; raw.len()];
        for first in 0..raw.len() {
            let (mut above, mut joint) = (Vec::new(), first);
            let depth = loop {
                if depths[joint] > 0 {
                    break depths[joint];
                }
                above.push(joint);
                let Some(parent) = &raw[joint].get_ref().parent else { break 0 };
                // A way that is longer than there are joints goes round.
                match numbers.get(parent).filter(|_| above.len() <= raw.len()) {
                    Some(number) => joint = *number,
                    None => {
                        let Joint { id, parent, .. } = raw[first].get_ref();
                        let parent = parent.as_deref().unwrap_or_default();
                        let what =
                            format!("joint `{id}` hangs on `{parent}`, which is no joint or hangs on it");
                        let hint = "name another joint of the step as its `parent`";
                        return Err(self.error(&raw[first].span(), &what, hint));
                    }
                }
            };
            above.iter().rev().zip(depth + 1..).for_each(|(joint, depth)| depths[*joint] = depth);
        }
        let mut joints: Vec<(usize, Joint)> =
            depths.into_iter().zip(raw.into_iter().map(Spanned::into_inner)).collect();
        joints.sort_by_key(|(depth, _)| *depth);
        Ok(joints.into_iter().map(|(_, joint)| joint).collect())
    }

    fn handles(&self, raw: Vec<Spanned<RawHandle>>) -> Result<Vec<HandleMove>> {
        let mut handles: Vec<HandleMove> = Vec::with_capacity(raw.len());
        let mut known = HashSet::new();
        for handle in raw {
            let span = handle.span();
            let RawHandle { id, r#move } = handle.into_inner();
            self.check_id(&span, &id, !known.insert(id.clone()))?;
            let motion = *r#move.get_ref();
            if let Some(what) = motion.defect() {
                return Err(self.error(&r#move.span(), what, "correct the move"));
            }
            handles.push(HandleMove { id, motion });
        }
        Ok(handles)
    }

    /// Ids are words, each given once.
    fn check_id(&self, span: &Range<usize>, id: &str, is_known: bool) -> Result<()> {
        if id.is_empty() || id.contains(char::is_whitespace) {
            return Err(self.error(span, "an `id` is empty or has white space", "give it one word"));
        }
        if is_known {
            let what = format!("`{id}` is there twice");
            return Err(self.error(span, &what, "remove one of both, or give it another id"));
        }
        Ok(())
    }

    fn stroke(&self, stroke: Spanned<Stroke>) -> Result<Stroke> {
        let span = stroke.span();
        let stroke = stroke.into_inner();
        match stroke.defect() {
            Some((what, hint)) => Err(self.error(&span, what, hint)),
            None => Ok(stroke),
        }
    }

    /// A region, checked.
    ///
    /// # Errors
    /// It has no shapes, or a shape, its falloff or its motion makes no sense: with the line.
    pub fn region(&self, region: Spanned<RawRegion>) -> Result<Region> {
        let span = region.span();
        let raw = region.into_inner();
        let mut shapes = self.shapes(&span, "the region has no shape", raw.shapes)?;
        if let Some(falloff) = raw.falloff {
            shapes.falloff = *falloff.get_ref();
            if !(shapes.falloff >= 0.0 && shapes.falloff.is_finite()) {
                let what = "`falloff` is negative or no finite number";
                return Err(self.error(&falloff.span(), what, "give a distance in the model's unit"));
            }
        }
        let mut motion = Motion::default();
        if let Some(given) = raw.r#move {
            motion = *given.get_ref();
            if raw.role != Role::Handle {
                let what = "only regions with role = \"handle\" have a `move`";
                return Err(self.error(&given.span(), what, "remove the move, or change the role"));
            }
            if let Some(what) = motion.defect() {
                return Err(self.error(&given.span(), what, "correct the move"));
            }
        }
        Ok(Region { role: raw.role, shapes, motion })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn parse(text: &str) -> Result<SessionFile> {
        SessionFile::parse(text, Path::new("edits/session.toml"))
    }

    const GOOD: &str = r#"
[model]
path = "nefertiti.ply"
[sampling]
samples = 50000
[[step]]
deform = "rbf"
params = { kernel = "triharmonic" }
[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0, 0], normal = [0, -1, 0] } }]
[[step.region]]
role = "handle"
shapes = [{ sphere = { center = [0, 300, 0], radius = 40 } }, { box = { min = [0,0,0], max = [1,1,1] } }]
falloff = 2
move = { translate = [10, 0, 0], axis = [0, 1, 0], degrees = 30, pivot = [0, 300, 0], scale = 1 }
[[step]]
deform = "warp"
[output]
path = "/elsewhere/out.ply"
"#;

    #[test]
    fn reads_a_session() {
        let session = parse(GOOD).unwrap();
        assert_eq!(session.model.unwrap(), Path::new("edits/nefertiti.ply"));
        assert_eq!(session.output.unwrap(), Path::new("/elsewhere/out.ply"));
        assert_eq!(session.sampling.samples, Some(50_000));
        let [rbf, warp] = session.steps.as_slice() else { panic!() };
        assert_eq!(rbf.place, "edits/session.toml, line 6");
        let [rbf, warp] = [rbf, warp].map(|step| step.deformation().unwrap());
        assert_eq!((rbf.deform.as_str(), rbf.regions.len()), ("rbf", 2));
        assert_eq!(rbf.regions[1].shapes.shapes[0], Shape::Sphere { center: DVec3::Y * 300.0, radius: 40.0 });
        assert_eq!(rbf.regions[1].shapes.falloff, 2.0);
        assert_eq!(rbf.regions[1].motion.degrees, 30.0);
        assert!(warp.params.is_empty());
        assert_eq!(parse("").unwrap().steps, []);
    }

    #[test]
    fn says_where_and_what() {
        let told = |text: &str, line: u32, what: &str| {
            let error = parse(text).unwrap_err();
            let message = error.to_string();
            assert!(message.starts_with(&format!("edits/session.toml, line {line}: ")), "{message}");
            assert!(message.contains(what), "{message}");
            assert!(!message.contains('\n') && !error.hint().contains('\n') && !error.hint().is_empty());
        };
        told("[model]\nfile = 1", 2, "`file`");
        told("[sampling]\nsamples = \"x\"", 2, "string \"x\"");
        told("[sampling]\nsamples = 1\nerror = 1e-3", 1, "both");
        told("[model\n", 1, "");
        told("[time]\nrate = 0", 1, "`rate` is no number");
        told("[time]\nseconds = nan", 1, "`seconds` is no finite number");
        let region = "[[step]]\ndeform = \"rbf\"\n[[step.region]]\n";
        told(&format!("{region}role = \"free\"\nshapes = []"), 4, "free");
        told(&format!("{region}role = \"fixed\"\nshapes = []"), 3, "no shape");
        let ball = "shapes = [{ sphere = { center = [0,0,0], radius = 1 } }]\n";
        told(&format!("{region}role = \"fixed\"\n{ball}move = {{}}"), 6, "`move`");
        told(&format!("{region}role = \"handle\"\n{ball}move = {{ scale = 0 }}"), 6, "scale");
        told(&format!("{region}role = \"mask\"\n{ball}falloff = -1"), 6, "falloff");
        told(&format!("{region}role = \"mask\"\nshapes = [{{ cone = {{}} }}]"), 5, "cone");
        let extra = "shapes = [{ sphere = { center = [0,0,0], radius = 1, size = 2 } }]";
        told(&format!("{region}role = \"mask\"\n{extra}"), 5, "size");
        told(
            &format!(
                "{region}role = \"mask\"\n{}",
                extra.replace("[0,0,0]", "[0,0]").replace(", size = 2", "")
            ),
            5,
            "found 2",
        );
        told(
            &format!(
                "{region}role = \"mask\"\n{}",
                extra.replace("0,0]", "0,0,7]").replace(", size = 2", "")
            ),
            5,
            "",
        );
        told("[[step]]\nparams = {}", 1, "no `deform`");
        let refine = |text: &str| format!("[[step]]\nrefine = {{ {text} }}");
        let shapes = "shapes = [{ sphere = { center = [0,0,0], radius = 1 } }]";
        told(&refine("error = 1"), 2, "`shapes`");
        told(&refine("shapes = [], error = 1"), 2, "no shape");
        told(&refine(shapes), 2, "give one of `error`");
        told(&refine(&format!("{shapes}, error = 1, factor = 2")), 2, "give one of `error`");
        for bad in ["error = -1", "error = nan", "factor = 1", "samples = 0"] {
            told(&refine(&format!("{shapes}, {bad}")), 2, "no fineness that makes sense");
        }
        told(&refine(&format!("{}, error = 1", shapes.replace("= 1", "= 0"))), 2, "radius");
        told(&refine(&format!("{shapes}, size = 1")), 2, "size");
        for bad in ["error = 0", "error = nan", "samples = 0"] {
            told(&refine(&format!("auto = true, {bad}")), 2, "no fineness that makes sense");
        }
        told(&refine("auto = true, factor = 2"), 2, "`factor` says nothing");
        told(&refine("auto = true, shapes = []"), 2, "no shape");
        told(&refine("auto = false, error = 1"), 2, "`shapes`");
        told(&format!("[[step]]\ndeform = \"x\"\nrefine = {{ {shapes}, error = 1 }}"), 1, "nothing else");
        let step = "[[step]]\ndeform = \"x\"\n";
        told(&format!("{step}[[step.handle]]\nid = \"0\""), 3, "`move`");
        told(&format!("{step}[[step.handle]]\nid = \"a b\"\nmove = {{}}"), 3, "white space");
        told(&format!("{step}[[step.handle]]\nid = \"a\"\nmove = {{ scale = -1 }}"), 5, "scale");
        told(&format!("{step}[[step.stroke]]\nradius = 0\npoints = [[0,0,0]]"), 3, "radius");
        told(&format!("{step}[[step.stroke]]\nradius = 1\npoints = []"), 3, "no point");
        told(&format!("{step}[[step.stroke]]\nradius = 1\npoints = [[0,0]]"), 5, "found 2");
        told(&format!("{step}[[step.stroke]]\nradius = 1\npoints = [[0,0,0]]\npressures = [2]"), 3, "0 to 1");
        for bad in ["-0.1", "1.5", "nan"] {
            told(&format!("{step}amount = {bad}"), 3, "not from 0 to 1");
        }
        told(&format!("version = 1\n{step}amount = 0.5"), 4, "`amount` is of sessions of version 2");
        told(&format!("version = 1\n{step}title = \"a\""), 4, "`title` is of sessions of version 2");
        told(&format!("version = 1\n{step}group = \"a\""), 4, "`group` is of sessions of version 2");
        told(&format!("{step}group = \"\""), 3, "a `group` is empty");
        told(&format!("{step}title = \" \""), 3, "a `title` is empty");
        told(&format!("{step}title = \"a\\nb\""), 3, "none to be read");
        told(&format!("{step}title = \"{}\"", "ab".repeat(101)), 3, "longer");
        told(&format!("{}\namount = 0.5", refine(&format!("{shapes}, error = 1"))), 1, "nothing else");
        let joint = |id: &str, parent: &str| {
            format!("[[step.joint]]\nid = \"{id}\"\nat = [0,0,0]\nparent = \"{parent}\"\n")
        };
        told(&format!("{step}{}{}", joint("a", "b"), joint("b", "a")), 3, "hangs on `b`");
        let twice = "[[step.joint]]\nid = \"a\"\nat = [0,0,0]\n";
        told(&format!("{step}{twice}{twice}"), 6, "twice");
    }

    #[test]
    fn refinements_stand_between_deformations() {
        let refine = |e: f64| {
            format!(
                "[[step]]\nrefine = {{ shapes = [{{ sphere = {{ center = [0,0,0], radius = 1 }} }}], error = {e} }}\n"
            )
        };
        let deform = "[[step]]\ndeform = \"warp\"\n";
        let session = parse(&[&refine(0.0), deform, deform, &refine(0.5), &refine(0.25)].concat()).unwrap();
        let finer = |s: &Step| match &s.action {
            Action::Refine(refine) => Some(refine.finer),
            Action::Deform(_) => None,
        };
        let order: Vec<_> = session.steps.iter().map(finer).collect();
        let error = |e| Some(Finer::Error(e));
        assert_eq!(order, [error(0.0), None, None, error(0.5), error(0.25)]);
        assert!(session.steps[3].place.ends_with("line 7"));
    }

    #[test]
    fn joints_come_after_those_that_they_hang_on() {
        let joint = |id: &str, rest: &str| format!("[[step.joint]]\nid = \"{id}\"\nat = [1,2,3]\n{rest}\n");
        let text =
            ["[[step]]\ndeform = \"x\"\n", &joint("hand", "parent = \"arm\""), &joint("arm", "")].concat();
        let session = parse(&text).unwrap();
        let ids: Vec<&str> =
            session.steps[0].deformation().unwrap().joints.iter().map(|j| j.id.as_str()).collect();
        assert_eq!(ids, ["arm", "hand"]);
    }
}
