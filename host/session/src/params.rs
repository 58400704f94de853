//! Parameters: checked against the plugin's descriptions, completed by defaults, made local.

use crate::deformer::{Migration, limits};
use crate::key::{Key, Keyed};
use glam::DVec3;
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::{Error, Result, input};
use simod_plugin_api::{ChoiceDesc, Curve, Descriptor, Param, ParamDesc, ParamKind, Unit};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Longest file in bytes that a plugin is given: the plugin may read all of it.
const LONGEST_FILE: u64 = 1 << 30;

/// Most points that a plugin takes of another model.
const MOST_POINTS: f64 = 4_194_304.0;

/// A parameter's value, of the kind that its description asks for.
#[derive(Debug, Clone, PartialEq)]
pub enum ParamValue {
    /// A number, in the parameter's unit.
    Float(f64),
    /// A length in the model's unit.
    Length(f64),
    /// A whole number.
    Int(i64),
    /// Yes or no.
    Bool(bool),
    /// The id of a choice.
    Choice(String),
    /// A direction, of any length.
    Direction(DVec3),
    /// A point in model coordinates.
    Point(DVec3),
    /// A point as fractions of the model's bounding box, as defaults are given.
    PointInBox(DVec3),
    /// Linear red, green, blue, and opacity.
    Colour([f64; 4]),
    /// Points that a curve passes through.
    Curve(Vec<[f64; 2]>),
    /// A file that can be read, or another model; nothing where none was given.
    File(Option<PathBuf>),
}

/// Parameters of a plugin, in its order: those that the user gave, and defaults.
#[derive(Debug, Clone, PartialEq)]
pub struct Params {
    values: Vec<(String, ParamKind, ParamValue)>,
}

impl Params {
    /// Checks the parameters that the user gave (`plugin` names the plugin in errors) against the
    /// descriptions. Paths are relative to `folder`.
    pub fn check(
        plugin: &str,
        descriptions: &[ParamDesc],
        given: &toml::Table,
        folder: &Path,
    ) -> Result<Self> {
        for id in given.keys() {
            if !descriptions.iter().any(|d| d.id == id.as_str()) {
                let ids = descriptions.iter().map(|d| d.id.as_str());
                let hint = match nearest(id, ids.clone()) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None if descriptions.is_empty() => format!("{plugin} has no parameters"),
                    None => format!("{plugin} has {}", ids.collect::<Vec<_>>().join(", ")),
                };
                return Err(Error::argument(format!("{plugin} has no parameter `{id}`"), hint));
            }
        }
        let value = |d: &ParamDesc| {
            let value = match given.get(d.id.as_str()) {
                Some(value) => checked(plugin, d, value, folder)?,
                // Descriptions were checked when the plugin was loaded.
                None => default(d).map_err(|what| Error::argument(format!("{plugin}: {what}"), ""))?,
            };
            Ok((d.id.to_string(), d.kind, value))
        };
        Ok(Self { values: descriptions.iter().map(value).collect::<Result<_>>()? })
    }

    /// The value of a parameter.
    pub fn get(&self, id: &str) -> Option<&ParamValue> {
        self.values.iter().find(|v| v.0 == id).map(|v| &v.2)
    }

    /// All ids and values, in the plugin's order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &ParamValue)> {
        self.values.iter().map(|(id, _, value)| (id.as_str(), value))
    }

    /// Parameters as plugins get them: points and lengths in local coordinates, defaults placed in the
    /// model's box.
    pub fn to_local(&self, frame: &Frame, bounds: &Bounds) -> LocalParams {
        let local = |(id, kind, value): &(String, ParamKind, ParamValue)| {
            let mut text = String::new();
            let numbers = match value {
                ParamValue::Float(x) => vec![*x],
                ParamValue::Length(x) => vec![*x / frame.scale],
                ParamValue::Int(i) => vec![*i as f64],
                ParamValue::Bool(b) => vec![f64::from(u8::from(*b))],
                ParamValue::Choice(id) => {
                    text.clone_from(id);
                    Vec::new()
                }
                ParamValue::Direction(v) => v.to_array().to_vec(),
                ParamValue::Point(p) => frame.to_local_exact(*p).to_array().to_vec(),
                ParamValue::PointInBox(t) => {
                    let p = bounds.min + *t * (bounds.max - bounds.min);
                    frame.to_local_exact(p).to_array().to_vec()
                }
                ParamValue::Colour(colour) => colour.to_vec(),
                ParamValue::Curve(points) => points.as_flattened().to_vec(),
                ParamValue::File(path) => {
                    // Checked to be text.
                    text = path.as_ref().and_then(|p| p.to_str()).unwrap_or_default().to_owned();
                    Vec::new()
                }
            };
            (id.clone(), *kind, numbers, text)
        };
        LocalParams(self.values.iter().map(local).collect())
    }
}

/// Values in the form that crosses the border.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalParams(Vec<(String, ParamKind, Vec<f64>, String)>);

impl Keyed for LocalParams {
    fn add_to(&self, key: &mut Key) {
        self.0.len().add_to(key);
        for (id, kind, numbers, text) in &self.0 {
            ((id, kind.0), (numbers, text)).add_to(key);
        }
    }
}

impl Keyed for ParamValue {
    fn add_to(&self, key: &mut Key) {
        match self {
            Self::Float(x) => (0u8, x).add_to(key),
            Self::Length(x) => (1u8, x).add_to(key),
            Self::Int(i) => (2u8, i).add_to(key),
            Self::Bool(b) => (3u8, b).add_to(key),
            Self::Choice(id) => (4u8, id).add_to(key),
            Self::Direction(v) => (5u8, v).add_to(key),
            Self::Point(p) => (6u8, p).add_to(key),
            Self::PointInBox(t) => (7u8, t).add_to(key),
            Self::Colour(colour) => (8u8, colour).add_to(key),
            Self::Curve(points) => (9u8, points).add_to(key),
            Self::File(path) => (10u8, path.as_deref()).add_to(key),
        }
    }
}

impl Keyed for Params {
    fn add_to(&self, key: &mut Key) {
        self.values.len().add_to(key);
        for (id, kind, value) in &self.values {
            ((id, kind.0), value).add_to(key);
        }
    }
}

impl LocalParams {
    /// Ids of the parameters that name other models.
    pub fn models(&self) -> impl Iterator<Item = &str> {
        self.0.iter().filter(|(_, kind, ..)| *kind == ParamKind::MODEL).map(|(id, ..)| id.as_str())
    }

    /// Gives all parameters that name other models a path.
    pub fn name_models(&mut self, path: &str) {
        let models = self.0.iter_mut().filter(|(_, kind, ..)| *kind == ParamKind::MODEL);
        models.for_each(|(.., text)| path.clone_into(text));
    }

    /// The parameters of some ids.
    pub fn some(&self, chosen: impl Fn(&str) -> bool) -> Self {
        Self(self.0.iter().filter(|(id, ..)| chosen(id)).cloned().collect())
    }

    /// Views of the parameters, as plugins take them.
    pub fn views(&self) -> Vec<Param<'_>> {
        self.0
            .iter()
            .map(|(id, kind, numbers, text)| {
                if is_text(*kind) { Param::text(id, *kind, text) } else { Param::numbers(id, *kind, numbers) }
            })
            .collect()
    }
}

/// Whether values of a kind are texts.
pub(crate) fn is_text(kind: ParamKind) -> bool {
    [ParamKind::CHOICE, ParamKind::FILE, ParamKind::MODEL].contains(&kind)
}

/// Whether values of a kind are paths.
pub(crate) fn is_path(kind: ParamKind) -> bool {
    [ParamKind::FILE, ParamKind::MODEL].contains(&kind)
}

/// The candidate that was probably meant, if any is near.
pub fn nearest<'a>(given: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .map(|c| (strsim::damerau_levenshtein(given, c), c))
        .filter(|(distance, c)| *distance <= 1 + given.len().max(c.len()) / 4)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, c)| c)
}

/// A parameter's value, of its kind and in its range.
fn checked(plugin: &str, d: &ParamDesc, value: &toml::Value, folder: &Path) -> Result<ParamValue> {
    let parsed = parsed(plugin, d, value, folder)?;
    in_range(d, &parsed).map_err(|what| Error::argument(format!("{plugin}: {what}"), range_hint(d)))?;
    Ok(parsed)
}

/// A parameter's value, of its kind.
fn parsed(plugin: &str, d: &ParamDesc, value: &toml::Value, folder: &Path) -> Result<ParamValue> {
    let id = &d.id;
    let wrong = |wanted: &str, example: &str| {
        let given: String = value.to_string().chars().take(40).collect();
        Error::argument(
            format!("parameter `{id}` of {plugin} is {given}, not {wanted}"),
            format!("write it as {id} = {example}"),
        )
    };
    let refused = |(what, hint): (String, String)| Error::argument(format!("{plugin}: {what}"), hint);
    Ok(match d.kind {
        ParamKind::FLOAT => float(d, number(value).ok_or_else(|| wrong("a number", &default_number(d)))?),
        ParamKind::INT => value
            .as_integer()
            .map(ParamValue::Int)
            .ok_or_else(|| wrong("a whole number", &nearest_whole(d, value)))?,
        ParamKind::BOOL => {
            value.as_bool().map(ParamValue::Bool).ok_or_else(|| wrong("true or false", "true"))?
        }
        ParamKind::CHOICE => {
            let text = value.as_str().ok_or_else(|| wrong("a text", &format!("\"{}\"", d.default_text)))?;
            choice(plugin, d, text)?
        }
        ParamKind::DIRECTION => {
            vector(value).map(ParamValue::Direction).ok_or_else(|| wrong("three numbers", "[0, 1, 0]"))?
        }
        ParamKind::POINT => {
            vector(value).map(ParamValue::Point).ok_or_else(|| wrong("three numbers", "[0, 0, 0]"))?
        }
        ParamKind::COLOUR => colour(value)
            .map(ParamValue::Colour)
            .ok_or_else(|| wrong("three or four numbers", "[0.8, 0.2, 0.1]"))?,
        ParamKind::CURVE => ParamValue::Curve(
            numbers(value).ok_or_else(|| wrong("a list of points", "[[0, 1], [0.5, 0.2], [1, 0]]"))?,
        ),
        ParamKind::FILE => {
            let path = value.as_str().ok_or_else(|| wrong("a text", "\"file\""))?;
            file(d, folder, path).map_err(refused)?
        }
        ParamKind::MODEL => {
            let path = value.as_str().ok_or_else(|| wrong("a text", "\"model.ply\""))?;
            other_model(d, folder, path).map_err(refused)?
        }
        _ => {
            return Err(Error::argument(
                format!("{plugin} has a parameter of a kind unknown here: `{id}`"),
                "",
            ));
        }
    })
}

/// A text that is one of the parameter's choices.
fn choice(plugin: &str, d: &ParamDesc, choice: &str) -> Result<ParamValue> {
    let ids = d.choices.iter().map(|c| c.id.as_str());
    if ids.clone().any(|c| c == choice) {
        return Ok(ParamValue::Choice(choice.to_owned()));
    }
    let hint = nearest(choice, ids.clone()).map_or_else(
        || format!("use one of {}", ids.collect::<Vec<_>>().join(", ")),
        |near| format!("did you mean `{near}`?"),
    );
    Err(Error::argument(format!("parameter `{}` of {plugin} cannot be `{choice}`", d.id), hint))
}

/// Advice about a value that is out of range.
fn range_hint(d: &ParamDesc) -> String {
    let id = &d.id;
    match d.kind {
        ParamKind::COLOUR => format!("give numbers from 0 to 1, as {id} = [0.8, 0.2, 0.1]"),
        ParamKind::CURVE => format!(
            "give at least two points [x, y] whose numbers are from 0 to 1 and whose x ascend, as {id} = [[0, 1], [0.5, 0.2], [1, 0]]"
        ),
        ParamKind::DIRECTION | ParamKind::POINT => "give three finite numbers".to_owned(),
        _ => format!("give a value {}", range_text(d.hard_range)),
    }
}

/// A parameter's default, as a user would write it.
fn default_number(d: &ParamDesc) -> String {
    d.default_numbers.first().copied().unwrap_or_default().to_string()
}

/// Whole number in range that is nearest to the given number, or the default where that is no number.
fn nearest_whole(d: &ParamDesc, value: &toml::Value) -> String {
    let [min, max] = d.hard_range;
    match number(value).filter(|x| x.is_finite()) {
        Some(x) if min.ceil() <= max.floor() => x.round().max(min.ceil()).min(max.floor()).to_string(),
        _ => default_number(d),
    }
}

/// A range in words.
fn range_text([min, max]: [f64; 2]) -> String {
    match (min.is_finite(), max.is_finite()) {
        // Some parameters are positive, with the least positive number as their bound.
        (true, true) if min == f64::MIN_POSITIVE => format!("above 0, {max} at most"),
        (true, true) => format!("from {min} to {max}"),
        (true, false) if min == f64::MIN_POSITIVE => "above 0".to_owned(),
        (true, false) => format!("of at least {min}"),
        (false, true) => format!("of at most {max}"),
        (false, false) => "that is finite".to_owned(),
    }
}

fn in_range(d: &ParamDesc, value: &ParamValue) -> std::result::Result<(), String> {
    let components: &[f64] = match value {
        ParamValue::Float(x) | ParamValue::Length(x) => &[*x],
        ParamValue::Int(i) => &[*i as f64],
        ParamValue::Direction(v) | ParamValue::Point(v) | ParamValue::PointInBox(v) => v.as_ref(),
        ParamValue::Colour(c) => c,
        ParamValue::Curve(points) => points.as_flattened(),
        ParamValue::Bool(_) | ParamValue::Choice(_) | ParamValue::File(_) => &[],
    };
    if components.iter().any(|x| !x.is_finite()) {
        return Err(format!("parameter `{}` is not a finite number", d.id));
    }
    let [min, max] = d.hard_range;
    match value {
        ParamValue::Float(_) | ParamValue::Length(_) | ParamValue::Int(_)
            if components[0] < min || components[0] > max =>
        {
            Err(format!("parameter `{}` is {}, out of its range", d.id, components[0]))
        }
        ParamValue::Colour(_) | ParamValue::Curve(_)
            if components.iter().any(|x| !(0.0..=1.0).contains(x)) =>
        {
            Err(format!("parameter `{}` has a number that is not from 0 to 1", d.id))
        }
        ParamValue::Curve(points) if Curve::new(points).is_none() => Err(format!(
            "the points of parameter `{}` are less than two, or do not go from left to right",
            d.id
        )),
        _ => Ok(()),
    }
}

fn float(d: &ParamDesc, x: f64) -> ParamValue {
    if d.unit == Unit::MODEL_LENGTH { ParamValue::Length(x) } else { ParamValue::Float(x) }
}

/// Whole numbers are numbers too: users write 90 for 90.0.
fn number(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}

/// A list of so many numbers.
fn array<const N: usize>(value: &toml::Value) -> Option<[f64; N]> {
    let numbers: Vec<f64> = value.as_array()?.iter().map(number).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

fn vector(value: &toml::Value) -> Option<DVec3> {
    array(value).map(DVec3::from_array)
}

/// Opaque, unless the opacity is given.
fn colour(value: &toml::Value) -> Option<[f64; 4]> {
    array(value).or_else(|| array(value).map(|[r, g, b]| [r, g, b, 1.0]))
}

/// A list of points.
fn numbers(value: &toml::Value) -> Option<Vec<[f64; 2]>> {
    value.as_array()?.iter().map(array).collect()
}

/// File that is there, of a name that the plugin takes; or the fault and the advice.
fn file(d: &ParamDesc, folder: &Path, path: &str) -> std::result::Result<ParamValue, (String, String)> {
    let id = &d.id;
    if path.is_empty() {
        return Ok(ParamValue::File(None));
    }
    let full = folder.join(path);
    let extension = full.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    if !d.choices.is_empty() && !d.choices.iter().any(|c| c.id == extension) {
        let taken: Vec<&str> = d.choices.iter().map(|c| c.id.as_str()).collect();
        let what = format!("parameter `{id}` is `{path}`, not a file of a type that it takes");
        return Err((what, format!("give a file whose name ends in .{}", taken.join(", ."))));
    }
    let here = |e: std::io::Error| {
        (format!("parameter `{id}`: cannot read {}: {e}", full.display()), "check the path".to_owned())
    };
    let told = |e: Error| (format!("parameter `{id}`: {e}"), e.hint().to_owned());
    let opened = input::open(&full).map_err(told)?;
    if opened.metadata().map_err(here)?.len() > LONGEST_FILE {
        let what = format!("parameter `{id}`: {} has more than 1 GiB", full.display());
        return Err((what, "give a smaller file".to_owned()));
    }
    absolute(d, &full)
}

/// Another model that is there, or the folder of a sampled one; its content is checked when it is read.
fn other_model(
    d: &ParamDesc,
    folder: &Path,
    path: &str,
) -> std::result::Result<ParamValue, (String, String)> {
    if path.is_empty() {
        return Ok(ParamValue::File(None));
    }
    let full = folder.join(path);
    if !full.is_dir() {
        input::open(&full).map_err(|e| (format!("parameter `{}`: {e}", d.id), e.hint().to_owned()))?;
    }
    absolute(d, &full)
}

/// Absolute path of a file that is there, independent of the current folder.
fn absolute(d: &ParamDesc, path: &Path) -> std::result::Result<ParamValue, (String, String)> {
    let id = &d.id;
    let full = path.canonicalize().map_err(|e| {
        (format!("parameter `{id}`: cannot read {}: {e}", path.display()), "check the path".to_owned())
    })?;
    if full.to_str().is_none() {
        let what = format!("parameter `{id}`: the path {} is not UTF-8", full.display());
        return Err((what, "rename the file or its folder".to_owned()));
    }
    Ok(ParamValue::File(Some(full)))
}

fn default(d: &ParamDesc) -> std::result::Result<ParamValue, String> {
    let value = match (d.kind, d.default_numbers.as_slice()) {
        (ParamKind::FLOAT, &[x]) => float(d, x),
        (ParamKind::INT, &[x]) if x.fract() == 0.0 => ParamValue::Int(x as i64),
        (ParamKind::BOOL, &[x]) => ParamValue::Bool(x != 0.0),
        (ParamKind::CHOICE, &[]) if d.choices.iter().any(|c| c.id == d.default_text) => {
            ParamValue::Choice(d.default_text.to_string())
        }
        (ParamKind::DIRECTION, &[x, y, z]) => ParamValue::Direction(DVec3::new(x, y, z)),
        (ParamKind::POINT, &[x, y, z]) => ParamValue::PointInBox(DVec3::new(x, y, z)),
        (ParamKind::COLOUR, &[r, g, b, a]) => ParamValue::Colour([r, g, b, a]),
        (ParamKind::CURVE, numbers) if numbers.len() % 2 == 0 => {
            ParamValue::Curve(numbers.as_chunks().0.to_vec())
        }
        (ParamKind::FILE, &[]) => ParamValue::File(None),
        (ParamKind::MODEL, &[points]) => {
            if !((1.0..=MOST_POINTS).contains(&points) && points.fract() == 0.0) {
                let what = format!("parameter `{}` takes {points} points, not 1 to {MOST_POINTS}", d.id);
                return Err(what);
            }
            ParamValue::File(None)
        }
        (kind, _) if kind.0 == 0 || kind.0 > ParamKind::MODEL.0 => {
            return Err(format!("parameter `{}` is of a kind that this version does not know", d.id));
        }
        _ => return Err(format!("parameter `{}` has a default that is not of its kind", d.id)),
    };
    in_range(d, &value)?;
    Ok(value)
}

/// A parameter in words, for a listing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParamText {
    /// The parameter's id.
    pub id: String,
    /// Group with which the parameter is shown; empty for none.
    pub group: String,
    /// The parameter's kind, default, range and hint.
    pub text: String,
}

/// Parameters in words.
pub fn describe_params(params: &[ParamDesc]) -> Vec<ParamText> {
    let text =
        |d: &ParamDesc| ParamText { id: d.id.to_string(), group: d.group.to_string(), text: describe(d) };
    params.iter().map(text).collect()
}

fn describe(d: &ParamDesc) -> String {
    let numbers: Vec<String> = d.default_numbers.iter().map(f64::to_string).collect();
    let default = match d.kind {
        ParamKind::CHOICE => format!("\"{}\"", d.default_text),
        ParamKind::BOOL => (d.default_numbers.first() != Some(&0.0)).to_string(),
        ParamKind::DIRECTION => format!("[{}]", numbers.join(", ")),
        ParamKind::POINT => format!("[{}] of the model's bounding box", numbers.join(", ")),
        ParamKind::COLOUR => format!("[{}]", numbers.join(", ")),
        ParamKind::CURVE => {
            let points: Vec<String> = numbers.chunks(2).map(|p| format!("[{}]", p.join(", "))).collect();
            format!("[{}]", points.join(", "))
        }
        ParamKind::FILE | ParamKind::MODEL => "none".to_owned(),
        _ => numbers.join(""),
    };
    let unit = match d.unit {
        Unit::DEGREES => " degrees",
        Unit::MODEL_LENGTH if d.kind != ParamKind::POINT => " in the model's unit",
        Unit::DIAGONAL => " of the diagonal",
        _ => "",
    };
    let kind = match d.kind {
        ParamKind::CHOICE => {
            d.choices.iter().map(|c| format!("\"{}\"", c.id)).collect::<Vec<_>>().join(" | ")
        }
        ParamKind::POINT => "a point [x, y, z]".to_owned(),
        ParamKind::DIRECTION => "a direction [x, y, z]".to_owned(),
        ParamKind::BOOL => "true | false".to_owned(),
        ParamKind::COLOUR => "a colour [red, green, blue, opacity]".to_owned(),
        ParamKind::CURVE => "a curve [[x, y], ...] from 0 to 1".to_owned(),
        ParamKind::MODEL => "a model, a sampled model, or a file of samples".to_owned(),
        ParamKind::FILE if d.choices.is_empty() => "a file".to_owned(),
        ParamKind::FILE => {
            let extensions: Vec<String> = d.choices.iter().map(|c| format!(".{}", c.id)).collect();
            format!("a file {}", extensions.join(" | "))
        }
        ParamKind::INT => format!("a whole number {}", range_text(d.hard_range)),
        _ => format!("a number {}", range_text(d.hard_range)),
    };
    let hint = if d.hint.is_empty() { &d.name } else { &d.hint };
    format!("{hint}: {kind}; default {default}{unit}")
}

/// Name of a kind, for programs.
fn kind_name(kind: ParamKind) -> &'static str {
    match kind {
        ParamKind::FLOAT => "float",
        ParamKind::INT => "int",
        ParamKind::BOOL => "bool",
        ParamKind::CHOICE => "choice",
        ParamKind::DIRECTION => "direction",
        ParamKind::POINT => "point",
        ParamKind::COLOUR => "colour",
        ParamKind::CURVE => "curve",
        ParamKind::FILE => "file",
        ParamKind::MODEL => "model",
        _ => "unknown",
    }
}

/// A parameter's description as data: `id`, `name`, `kind`, `unit`, `default` (a number, a text, a truth
/// value, a list, or null where there is none), `hard_range` and `soft_range` (each end a number, or null for
/// none), `choices` or a file's `extensions`, `group`, `hint`, `invalidates_preparation`, and all of it in
/// words as `text`.
pub fn param_data(d: &ParamDesc) -> serde_json::Value {
    use serde_json::{Value, json};
    let numbers = d.default_numbers.as_slice();
    let default = match (d.kind, numbers) {
        (ParamKind::BOOL, [x, ..]) => json!(*x != 0.0),
        (ParamKind::INT, [x, ..]) => json!(*x as i64),
        (ParamKind::FLOAT, [x, ..]) => json!(x),
        (ParamKind::CHOICE, _) => json!(d.default_text.as_str()),
        (ParamKind::CURVE, _) => json!(numbers.chunks(2).collect::<Vec<_>>()),
        (ParamKind::FILE | ParamKind::MODEL, _) => Value::Null,
        _ => json!(numbers),
    };
    let unit = match d.unit {
        Unit::NONE => None,
        Unit::DEGREES => Some("degrees"),
        Unit::MODEL_LENGTH => Some("model-length"),
        Unit::DIAGONAL => Some("diagonal"),
        Unit::RATIO => Some("ratio"),
        _ => Some("unknown"),
    };
    let range = |range: [f64; 2]| json!(range.map(|x| if x.is_finite() { json!(x) } else { Value::Null }));
    let mut data = json!({
        "id": d.id.as_str(), "name": d.name.as_str(), "kind": kind_name(d.kind), "unit": unit, "default": default,
        "group": Some(d.group.as_str()).filter(|group| !group.is_empty()), "hint": d.hint.as_str(),
        "hard_range": range(d.hard_range), "soft_range": range(d.soft_range),
        "invalidates_preparation": d.invalidates_preparation, "text": describe(d),
    });
    if d.kind == ParamKind::POINT {
        data["default_is_fraction_of_box"] = json!(true);
    }
    if d.kind == ParamKind::CHOICE {
        let choice = |c: &ChoiceDesc| json!({"id": c.id.as_str(), "label": c.label.as_str()});
        data["choices"] = d.choices.iter().map(choice).collect();
    }
    if d.kind == ParamKind::MODEL {
        data["points"] = json!(numbers.first().map(|points| *points as u64));
    }
    if d.kind == ParamKind::FILE {
        data["extensions"] = d.choices.iter().map(|c| json!(c.id.as_str())).collect();
    }
    data
}

/// Whether a text is kebab-case.
pub fn is_id(id: &str) -> bool {
    !id.is_empty() && id.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-')
}

/// Checks a plugin's description of itself; the error names the first defect.
pub fn check_description(descriptor: &Descriptor) -> std::result::Result<(), String> {
    limits::check(descriptor)?;
    if !is_id(&descriptor.id) {
        return Err(format!("the plugin's id `{}` is not kebab-case", descriptor.id));
    }
    for (i, d) in descriptor.params.iter().enumerate() {
        if !is_id(&d.id) {
            return Err(format!("the parameter's id `{}` is not kebab-case", d.id));
        }
        if descriptor.params[..i].iter().any(|other| other.id == d.id) {
            return Err(format!("there are two parameters `{}`", d.id));
        }
        let fine = |[min, max]: [f64; 2]| min <= max;
        if !(fine(d.hard_range) && fine(d.soft_range)) {
            return Err(format!("parameter `{}` has an empty range", d.id));
        }
        if d.unit.0 > Unit::RATIO.0 {
            return Err(format!("parameter `{}` has a unit that this version does not know", d.id));
        }
        if d.unit == Unit::MODEL_LENGTH && ![ParamKind::FLOAT, ParamKind::POINT].contains(&d.kind) {
            return Err(format!("parameter `{}` is a length, but no float", d.id));
        }
        if d.kind == ParamKind::MODEL && !d.invalidates_preparation {
            return Err(format!("parameter `{}` is a model, and does not invalidate the preparation", d.id));
        }
        let bounded = d.hard_range.iter().any(|x| x.is_finite());
        if bounded && [ParamKind::DIRECTION, ParamKind::POINT].contains(&d.kind) {
            return Err(format!("parameter `{}` is a vector, which has no range", d.id));
        }
        default(d)?;
    }
    Ok(())
}

/// Checks a plugin's description of its older sessions; the error names the first defect.
pub fn check_migration(descriptor: &Descriptor, migration: &Migration) -> std::result::Result<(), String> {
    let Migration { state_version, aliases } = migration;
    if *state_version == 0 {
        return Err("its state version is 0, and the first one is 1".to_owned());
    }
    if aliases.len() > limits::LONGEST_LIST {
        return Err(format!("the aliases are {}, more than {}", aliases.len(), limits::LONGEST_LIST));
    }
    let is_now = |id: &str| descriptor.params.iter().any(|d| d.id == id);
    let mut known = HashSet::new();
    for (former, now) in aliases {
        let short: String = former.chars().take(40).collect();
        if former.len() >= limits::LONGEST_TEXT || !is_id(former) {
            return Err(format!("the alias `{short}` is not kebab-case, or too long"));
        }
        if is_now(former) || !known.insert(former) {
            return Err(format!("the alias `{short}` is a parameter's id, or there twice"));
        }
        if !is_now(now) {
            return Err(format!("the alias `{short}` is of no parameter that there is"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn descriptions() -> Vec<ParamDesc> {
        vec![
            ParamDesc::float("angle", "Angle", 90.0).hard(-720.0, 720.0),
            ParamDesc::int("count", "Count", 3).hard(1.0, f64::INFINITY),
            ParamDesc::bool("keep", "Keep", true),
            ParamDesc::choice("operation", "Operation", "bend", &[("bend", "Bend"), ("twist", "Twist")]),
            ParamDesc::direction("axis", "Axis", [0.0, 1.0, 0.0]),
            ParamDesc::point("center", "Centre", [0.5; 3]),
            ParamDesc::colour("tint", "Tint", [1.0, 0.5, 0.0, 1.0]),
            ParamDesc::curve("falloff", "Falloff", &[[0.0, 1.0], [1.0, 0.0]]),
            ParamDesc::file("weights", "Weights", &["rs", "toml"]),
            ParamDesc::model("target", "Target", 1000),
        ]
    }

    fn check(given: &str) -> Result<Params> {
        Params::check("warp", &descriptions(), &given.parse().unwrap(), Path::new(""))
    }

    #[test]
    fn defaults_and_given_values() {
        let params = check("angle = 30\ncenter = [101, 2.5, 3]").unwrap();
        assert_eq!(params.get("angle"), Some(&ParamValue::Float(30.0)));
        assert_eq!(params.get("operation"), Some(&ParamValue::Choice("bend".to_owned())));
        let bounds = Bounds { min: DVec3::new(100.0, 0.0, 0.0), max: DVec3::new(102.0, 4.0, 0.0) };
        let frame = Frame { origin: DVec3::new(100.0, 0.0, 0.0), scale: 1.0 };
        assert_eq!(params.to_local(&frame, &bounds).0[5].2, [1.0, 2.5, 3.0]);
        let defaults = check("").unwrap();
        assert_eq!(defaults.to_local(&frame, &bounds).0[5].2, [1.0, 2.0, 0.0]);
        assert_eq!(defaults.get("weights"), Some(&ParamValue::File(None)));
        let params = check("tint = [0, 0.5, 1]\nfalloff = [[0, 0], [0.5, 1], [1, 0]]").unwrap();
        assert_eq!(params.get("tint"), Some(&ParamValue::Colour([0.0, 0.5, 1.0, 1.0])));
        assert_eq!(params.to_local(&frame, &bounds).0[7].2, [0.0, 0.0, 0.5, 1.0, 1.0, 0.0]);
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
        let given = toml::Table::from_iter([("weights".to_owned(), "Cargo.toml".into())]);
        let params = Params::check("warp", &descriptions(), &given, file.parent().unwrap()).unwrap();
        let ParamValue::File(Some(found)) = params.get("weights").unwrap() else { panic!() };
        assert_eq!(*found, file.canonicalize().unwrap());
    }

    #[test]
    fn what_is_wrong_is_told() {
        let told = |given, what: &str, hint: &str| {
            let error = check(given).unwrap_err();
            assert!(error.to_string().contains(what), "{error}");
            assert!(error.hint().contains(hint), "{}", error.hint());
        };
        told("angel = 30", "no parameter `angel`", "did you mean `angle`?");
        told("zzzzzz = 30", "no parameter `zzzzzz`", "angle, count");
        told("angle = \"x\"", "`angle` of warp is \"x\", not a number", "angle = 90");
        told("angle = 1000", "`angle` is 1000, out of its range", "from -720 to 720");
        told("angle = nan", "`angle` is not a finite number", "");
        told("count = 0", "out of its range", "at least 1");
        told("count = 2.5", "not a whole number", "count = 3");
        told("count = -7.5", "not a whole number", "count = 1");
        told("count = \"many\"", "not a whole number", "count = 3");
        told("keep = 1", "not true or false", "true");
        told("operation = \"twits\"", "cannot be `twits`", "did you mean `twist`?");
        told("axis = [1, 2]", "not three numbers", "[0, 1, 0]");
        told("tint = [1, 2]", "not three or four numbers", "[0.8");
        told("tint = [1, 2, 0]", "not from 0 to 1", "from 0 to 1");
        told("falloff = [[0, 1]]", "less than two", "at least two points");
        told("falloff = [[0.5, 1], [0.2, 0]]", "left to right", "whose x ascend");
        told("weights = \"nowhere.toml\"", "cannot open nowhere.toml", "check the path");
        told("target = \"nowhere.ply\"", "`target`: cannot open nowhere.ply", "check the path");
        told("target = 3", "`target` of warp is 3, not a text", "target = \"model.ply\"");
        told("weights = \"x.png\"", "not a file of a type", ".rs, .toml");
    }

    #[test]
    fn aliases_are_checked() {
        let x = Descriptor::new("x", "X", "1.0.0").param(ParamDesc::float("a", "A", 0.0));
        let with = |state_version, aliases: &[(&str, &str)]| {
            let aliases = aliases.iter().map(|(f, n)| ((*f).to_owned(), (*n).to_owned())).collect();
            check_migration(&x, &Migration { state_version, aliases })
        };
        assert_eq!(with(1, &[("b", "a"), ("c", "a")]), Ok(()));
        for (aliases, what) in [
            (&[("b", "c")][..], "of no parameter"),
            (&[("a", "a")], "a parameter's id"),
            (&[("b", "a"), ("b", "a")], "there twice"),
            (&[("B", "a")], "not kebab-case"),
        ] {
            assert!(with(1, aliases).unwrap_err().contains(what));
        }
        assert!(with(0, &[]).unwrap_err().contains("version is 0"));
        let many: Vec<(String, String)> = (0..10_001).map(|i| (format!("b{i}"), "a".to_owned())).collect();
        let many = Migration { state_version: 1, aliases: many };
        assert!(check_migration(&x, &many).unwrap_err().contains("10001"));
    }

    #[test]
    fn descriptions_are_checked() {
        let with = |param| check_description(&Descriptor::new("x", "X", "1.0.0").param(param));
        assert!(descriptions().into_iter().all(|d| with(d).is_ok()));
        assert!(check_description(&Descriptor::new("X y", "X", "1.0.0")).is_err());
        assert!(with(ParamDesc::float("a", "A", 2.0).hard(0.0, 1.0)).is_err());
        assert!(with(ParamDesc::float("a", "A", f64::NAN)).is_err());
        assert!(with(ParamDesc::choice("a", "A", "no", &[("yes", "Yes")])).is_err());
        let mut unknown = ParamDesc::float("a", "A", 1.0);
        unknown.kind = ParamKind(99);
        assert!(with(unknown).unwrap_err().contains("does not know"));
    }
}
