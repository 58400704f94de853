//! The steps of an edit, which a session has and an edit changes, and the checks of steps. All code that
//! reads, changes or records steps uses the checks of this module. The derived reading is that of former
//! programs' recordings.

use crate::deformer::Plugin;
use crate::key::{Key, Keyed};
use crate::motion::Motion;
use crate::shapes::{RegionShape, Shapes};
pub use crate::stroke::Stroke;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_core::refinement::Finer;
use simod_model::{Error, ErrorKind};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

/// One step of an edit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(remote = "Self", rename_all = "kebab-case", deny_unknown_fields)]
pub struct Step {
    /// The step's action.
    pub action: Action,
    /// Whether the step is done; a step that is not stays in the session.
    #[serde(default = "yes")]
    pub enabled: bool,
    /// The user's name of the step, if it has one.
    #[serde(default)]
    pub title: Option<String>,
    /// Name of the group that the step is in, with the steps before and behind it that have the same.
    #[serde(default)]
    pub group: Option<String>,
    /// Place of the step in its file, as `session.toml, line 7`; for errors.
    #[serde(default)]
    pub place: String,
}

/// The action of a step.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(clippy::large_enum_variant, reason = "nearly all steps are the large one, and a session has a few")]
pub enum Action {
    /// The samples are moved.
    Deform(Deformation),
    /// Samples are added.
    Refine(Refine),
}

/// More samples in a part of the model.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(remote = "Self", rename_all = "kebab-case", deny_unknown_fields)]
pub struct Refine {
    /// Region to refine, on the model as the steps before have deformed it. No shape is everywhere, for a
    /// refinement that finds out by itself ([`Finer::Auto`]).
    pub shapes: Shapes,
    /// The fineness that is wanted.
    pub finer: Finer,
}

impl Refine {
    /// Checks that the refinement makes sense.
    ///
    /// # Errors
    /// A shape is no part of space, there is none though somebody has to say where, or the fineness is out of
    /// range.
    pub fn check(&self) -> Result<(), Defect> {
        self.shapes.check().map_err(|what| Defect::new(what, "give another shape"))?;
        if self.shapes.shapes.is_empty() && !self.is_auto() {
            let hint = "give one, such as a sphere, or `auto = true`";
            return Err(Defect::new("the refinement has no shape", hint));
        }
        if self.finer.makes_sense() {
            Ok(())
        } else {
            Err(Defect::new("the refinement is to no fineness that makes sense", FINER))
        }
    }

    /// Whether the refinement finds out by itself where samples are needed.
    pub fn is_auto(&self) -> bool {
        matches!(self.finer, Finer::Auto { .. })
    }
}

/// Fineness that a refinement can have, for errors.
pub(crate) const FINER: &str =
    "an error of 0 or more as a fraction of the diagonal, a factor above 1, or at least 1 sample";

/// A deformation by a plugin.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Deformation {
    /// The plugin's id.
    pub deform: String,
    /// Origin of the plugin, as far as that was known when the session was saved.
    pub plugin: Option<Origin>,
    /// Version of the plugin's parameters and their meaning; where not given, the first.
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
    /// Motions of the plugin's own handles.
    #[serde(default)]
    pub handles: Vec<HandleMove>,
    /// Brush strokes, first to last.
    #[serde(default)]
    pub strokes: Vec<Arc<Stroke>>,
    /// Amount of the deformation that is done: 0 leaves all at rest, 1 is the whole deformation, and
    /// displacements between are blended linearly.
    #[serde(default = "full")]
    pub amount: f64,
    /// Folder to which paths among the parameters are relative.
    #[serde(default)]
    pub folder: PathBuf,
    /// Places of the parameters in the file; for errors.
    #[serde(skip)]
    pub param_places: ParamPlaces,
    /// Changes that were made when the step was brought up to its plugin; for users.
    #[serde(skip)]
    pub notes: Notes,
}

/// Notes on changes of a step, in words. They are no part of what the step is: all compare as equal.
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
    /// The notes, one by one.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }
}

/// Places of a step's parameters in its file, as `session.toml, line 9`. They are no part of what the step
/// is: all compare as equal.
#[derive(Debug, Clone, Default)]
pub struct ParamPlaces(Arc<BTreeMap<String, String>>);

impl PartialEq for ParamPlaces {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl ParamPlaces {
    /// Places of parameters by their ids.
    pub(crate) fn new(places: impl IntoIterator<Item = (String, String)>) -> Self {
        Self(Arc::new(places.into_iter().collect()))
    }

    /// Places of parameters under further names, too: pairs of the former name and the one now.
    pub(crate) fn renamed(&self, aliases: &[(String, String)]) -> Self {
        let mut places = (*self.0).clone();
        for (former, now) in aliases {
            if let Some(place) = places.get(former).cloned() {
                places.entry(now.clone()).or_insert(place);
            }
        }
        Self(Arc::new(places))
    }

    /// Place to which an error belongs that came up in the step at `place`: that of the parameter that the
    /// error names, if the file gives the parameter.
    pub(crate) fn place_of<'a>(&'a self, place: &'a str, error: &Error) -> &'a str {
        let text = error.to_string();
        let named = text.split("parameter `").skip(1).filter_map(|rest| rest.split('`').next());
        named.filter_map(|id| self.0.get(id)).next().map_or(place, String::as_str)
    }
}

/// The origin of a plugin: for those who do not have it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// The version that the step was made with.
    pub version: String,
    /// The author of the plugin.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub author: String,
    /// Address of more information on the plugin.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub url: String,
}

impl Origin {
    /// Origin of a plugin that names its author or an address, unlike those that come with the program.
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
    /// Deformation by a plugin, without parameters, regions or anything else.
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

impl Deformation {
    /// Checks the deformation of a step: see [`Step::check`].
    fn check(&self) -> Result<(), Defect> {
        check_amount(self.amount)?;
        self.regions.iter().try_for_each(Region::check)?;
        check_joints(&self.joints).map_err(|(_, defect)| defect)?;
        check_handles(&self.handles).map_err(|(_, defect)| defect)?;
        let defect = self.strokes.iter().find_map(|stroke| stroke.defect());
        defect.map_or(Ok(()), |(what, hint)| Err(Defect::new(what, hint)))
    }
}

/// Longest title of a step, or name of a group, in characters.
const LONGEST_NAME: usize = 200;

impl Step {
    /// Step that is switched on, in no file, and without a title.
    pub fn new(action: Action) -> Self {
        Self { action, enabled: true, title: None, group: None, place: String::new() }
    }

    /// Id of the plugin, or the kind of the step.
    pub fn name(&self) -> &str {
        match &self.action {
            Action::Deform(deformation) => &deformation.deform,
            Action::Refine(_) => "refine",
        }
    }

    /// Checks that the step makes sense, as far as that can be told without its plugin.
    ///
    /// # Errors
    /// The defect of the step: a session with such a step is not read.
    pub fn check(&self) -> Result<(), Defect> {
        self.title.as_deref().map_or(Ok(()), |title| check_name("title", title))?;
        self.group.as_deref().map_or(Ok(()), |group| check_name("group", group))?;
        match &self.action {
            Action::Refine(refine) => refine.check(),
            Action::Deform(deformation) => deformation.check(),
        }
    }

    /// Place to which an error of the step belongs: the step, or the parameter that the error names.
    pub(crate) fn place_of<'a>(&'a self, error: &Error) -> &'a str {
        self.deformation().map_or(&self.place, |d| d.param_places.place_of(&self.place, error))
    }

    /// Whether there may be more samples after the step.
    pub fn refines(&self) -> bool {
        matches!(self.action, Action::Refine(_))
    }

    /// Deformation of the step, if it is one.
    pub fn deformation(&self) -> Option<&Deformation> {
        match &self.action {
            Action::Deform(deformation) => Some(deformation),
            Action::Refine(_) => None,
        }
    }
}

/// Checks a step's `title`, or the name of its `group`.
///
/// # Errors
/// The name is empty, too long, or has characters that nobody sees.
pub(crate) fn check_name(key: &str, name: &str) -> Result<(), Defect> {
    let what = if name.trim().is_empty() {
        "is empty"
    } else if name.chars().count() > LONGEST_NAME {
        "is longer than 200 characters"
    } else if name.chars().any(char::is_control) {
        "has a character that is none to be read, such as the end of a line"
    } else {
        return Ok(());
    };
    Err(Defect::new(format!("a `{key}` {what}"), "give it a few words, or leave it out"))
}

/// Checks by how much a step is done.
///
/// # Errors
/// The amount is not from 0 to 1.
pub(crate) fn check_amount(amount: f64) -> Result<(), Defect> {
    if (0.0..=1.0).contains(&amount) {
        return Ok(());
    }
    let hint = "give 0 for nothing of it, 1 for all, or what is between";
    Err(Defect::new("the `amount` of a step is not from 0 to 1", hint))
}

/// Checks an id of a joint or a handle; `is_known` says that another one has it.
///
/// # Errors
/// The id is no word, or is there twice.
pub(crate) fn check_id(id: &str, is_known: bool) -> Result<(), Defect> {
    if id.is_empty() || id.contains(char::is_whitespace) {
        return Err(Defect::new("an `id` is empty or has white space", "give it one word"));
    }
    if is_known {
        let hint = "remove one of both, or give it another id";
        return Err(Defect::new(format!("`{id}` is there twice"), hint));
    }
    Ok(())
}

/// Checks joints, of which each has to come after the one that it hangs on.
///
/// # Errors
/// The number of the first joint that makes no sense, and why.
pub(crate) fn check_joints(joints: &[Joint]) -> Result<(), (usize, Defect)> {
    let mut known = HashSet::new();
    for (number, Joint { id, at, parent }) in joints.iter().enumerate() {
        let wrong = |defect| Err((number, defect));
        check_id(id, known.contains(id)).or_else(wrong)?;
        if !at.is_finite() {
            let what = "a joint has a coordinate that is no finite number";
            return wrong(Defect::new(what, "correct the joint"));
        }
        if let Some(parent) = parent.as_ref().filter(|parent| !known.contains(parent)) {
            let what = format!("joint `{id}` hangs on `{parent}`, which is no joint before it");
            return wrong(Defect::new(what, "name another joint of the step as its `parent`"));
        }
        known.insert(id);
    }
    Ok(())
}

/// The numbers of joints in an order in which each comes after the one that it hangs on: those that hang on
/// none first, and then those that hang on these. Where there is no such order, [`check_joints`] says so.
pub(crate) fn joint_order(joints: &[Joint]) -> Vec<usize> {
    let numbers: HashMap<&str, usize> = joints.iter().map(|joint| &*joint.id).zip(0..).collect();
    // Number of joints that hang on each other down to each one, itself included; 0 where that is not known
    // yet.
    let mut depths = vec![0usize; joints.len()];
    for first in 0..joints.len() {
        let (mut above, mut joint) = (Vec::new(), first);
        let depth = loop {
            if depths[joint] > 0 {
                break depths[joint];
            }
            above.push(joint);
            let parent = joints[joint].parent.as_ref().and_then(|parent| numbers.get(&**parent));
            // A way that is longer than there are joints goes round.
            match parent {
                Some(_) if above.len() > joints.len() => break usize::MAX,
                Some(parent) => joint = *parent,
                None => break 0,
            }
        };
        for (joint, above) in above.iter().rev().zip(1..) {
            depths[*joint] = depth.saturating_add(above);
        }
    }
    let mut order: Vec<usize> = (0..joints.len()).collect();
    order.sort_by_key(|joint| depths[*joint]);
    order
}

/// Checks how handles move.
///
/// # Errors
/// The number of the first that makes no sense, and why.
pub(crate) fn check_handles(handles: &[HandleMove]) -> Result<(), (usize, Defect)> {
    let mut known = HashSet::new();
    for (number, HandleMove { id, motion }) in handles.iter().enumerate() {
        let checked = check_id(id, !known.insert(id)).and_then(|()| check_motion(motion));
        checked.map_err(|defect| (number, defect))?;
    }
    Ok(())
}

/// Checks a motion.
///
/// # Errors
/// The motion is no similarity of space.
pub(crate) fn check_motion(motion: &Motion) -> Result<(), Defect> {
    match motion.defect() {
        Some(what) => Err(Defect { part: RegionPart::Move, ..Defect::new(what, "correct the move") }),
        None => Ok(()),
    }
}

/// A defect of a step or of a part of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Defect {
    /// Part of the step that the defect is about.
    pub part: RegionPart,
    /// The defect in words, as the beginning of a sentence.
    pub what: Cow<'static, str>,
    /// Advice on the defect.
    pub hint: &'static str,
}

/// The part of a region or a handle that makes no sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegionPart {
    /// The region or handle as a whole.
    Whole,
    /// The distance beyond its border at which a region has faded out.
    Falloff,
    /// The region's motion.
    Move,
}

impl From<Defect> for Error {
    /// The defect as an error of a command that was given.
    fn from(defect: Defect) -> Self {
        Self::new(ErrorKind::Argument, defect.what, defect.hint)
    }
}

impl Defect {
    /// A defect of the whole.
    pub(crate) fn new(what: impl Into<Cow<'static, str>>, hint: &'static str) -> Self {
        Self { part: RegionPart::Whole, what: what.into(), hint }
    }
}

/// A joint of a skeleton.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Joint {
    /// Id of the joint, unique among the step's joints.
    pub id: String,
    /// Position of the joint at rest, model coordinates.
    #[serde(deserialize_with = "crate::vector::three")]
    pub at: DVec3,
    /// Id of the joint that this one hangs on, if any.
    pub parent: Option<String>,
}

/// The motion of a handle that the plugin placed.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(remote = "Self", rename_all = "kebab-case", deny_unknown_fields)]
pub struct HandleMove {
    /// The handle's id.
    pub id: String,
    /// Motion of the handle; about its place at rest unless the motion says otherwise.
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

/// Role of a region's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// Samples stay.
    Fixed,
    /// Samples follow the region's motion.
    Handle,
    /// The step acts here alone.
    Mask,
}

/// A region of space with a role.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(remote = "Self", rename_all = "kebab-case", deny_unknown_fields)]
pub struct Region {
    /// The region's purpose.
    pub role: Role,
    /// The region's place.
    pub shapes: Shapes,
    /// Motion of a handle region; none for other roles.
    #[serde(default)]
    pub motion: Motion,
}

impl Region {
    /// Checks that the region makes sense.
    ///
    /// # Errors
    /// The region has no shape or one that is no part of space, fades out by no distance, or moves without
    /// being a handle or by no similarity.
    pub fn check(&self) -> Result<(), Defect> {
        if self.shapes.shapes.is_empty() {
            return Err(Defect::new("the region has no shape", "give one, such as a sphere"));
        }
        if let Some(what) = self.shapes.shapes.iter().find_map(RegionShape::defect) {
            return Err(Defect::new(what, "correct the shape"));
        }
        if let Err(what) = self.shapes.check() {
            let hint = "give a distance in the model's unit";
            return Err(Defect { part: RegionPart::Falloff, ..Defect::new(what, hint) });
        }
        if self.role != Role::Handle && self.motion != Motion::default() {
            return Err(Self::moves());
        }
        check_motion(&self.motion)
    }

    /// The defect of a region that is said to move, and is no handle.
    pub(crate) fn moves() -> Defect {
        let what = "only regions with role = \"handle\" have a `move`";
        Defect { part: RegionPart::Move, ..Defect::new(what, "remove the move, or change the role") }
    }
}
