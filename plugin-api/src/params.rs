//! Parameters: described by the plugin, owned by the host.
//!
//! The host shows, stores, checks and undoes them, and passes their values by id. Descriptions and values are
//! flat (numbers and a text), so that a later kind is a new code and not a new layout.

use crate::{Curve, PluginError, PluginResult};
use abi_stable::{
    StableAbi,
    std_types::{RSlice, RStr, RString, RVec},
};
use std::path::Path;

/// Kind of a parameter: the sort of value that it holds.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct ParamKind(pub u32);

impl ParamKind {
    /// One number.
    pub const FLOAT: Self = Self(1);
    /// One whole number, exact up to 2^53.
    pub const INT: Self = Self(2);
    /// 0 or 1.
    pub const BOOL: Self = Self(3);
    /// The id of one of the choices, as text.
    pub const CHOICE: Self = Self(4);
    /// Three numbers: a direction in space, of any length.
    pub const DIRECTION: Self = Self(5);
    /// Three numbers: a point in local coordinates; its default is a fraction of the bounding box.
    pub const POINT: Self = Self(6);
    /// Four numbers, 0 to 1: linear red, green, blue, and opacity.
    pub const COLOUR: Self = Self(7);
    /// Pairs of numbers, 0 to 1, of ascending first ones: points that a [`Curve`](crate::Curve) passes
    /// through.
    pub const CURVE: Self = Self(8);
    /// The path of a file that can be read, as text; empty where the user gave none. Its choices are the
    /// extensions that its name may have, without a dot; any if there is none.
    pub const FILE: Self = Self(9);
    /// The path of another model, as text, empty where the user gave none. The host reads it and hands over
    /// its points, [`OtherModels`](crate::OtherModels); the path is for messages. Its number is how many
    /// points the plugin takes at most.
    pub const MODEL: Self = Self(10);
}

/// Unit of a parameter's numbers.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unit(pub u32);

impl Unit {
    /// Nothing.
    pub const NONE: Self = Self(0);
    /// Degrees of an angle.
    pub const DEGREES: Self = Self(1);
    /// The model's unit of length, for the user; the host turns it into local coordinates for the plugin.
    pub const MODEL_LENGTH: Self = Self(2);
    /// Fractions of the diagonal of the bounding box.
    pub const DIAGONAL: Self = Self(3);
    /// A ratio: 1 leaves things as they are.
    pub const RATIO: Self = Self(4);
}

/// One of the alternatives of a [`ParamKind::CHOICE`].
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq, Eq)]
pub struct ChoiceDesc {
    /// Stable id, kebab-case; stored in files.
    pub id: RString,
    /// Label for the user.
    pub label: RString,
}

/// Description of a parameter. Built with [`float`](Self::float) and its like.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq)]
pub struct ParamDesc {
    /// Stable id, kebab-case; stored in files.
    pub id: RString,
    /// Name for the user.
    pub name: RString,
    /// One line on what it does.
    pub hint: RString,
    /// Parameters of one group are shown together; empty for none.
    pub group: RString,
    /// Kind of value.
    pub kind: ParamKind,
    /// Unit of its numbers.
    pub unit: Unit,
    /// Values outside are refused by the host. Infinite where there is no limit.
    pub hard_range: [f64; 2],
    /// Range of a slider; values outside are fine.
    pub soft_range: [f64; 2],
    /// Default numbers, as many as the kind has; of a [`ParamKind::MODEL`] the most points.
    pub default_numbers: RVec<f64>,
    /// Default choice; empty for others.
    pub default_text: RString,
    /// The alternatives of a choice, or a file's extensions; empty for others.
    pub choices: RVec<ChoiceDesc>,
    /// Whether the state must be prepared anew once the value changed.
    pub invalidates_preparation: bool,
}

impl ParamDesc {
    fn new(id: &str, name: &str, kind: ParamKind, numbers: &[f64]) -> Self {
        let any = [f64::NEG_INFINITY, f64::INFINITY];
        Self {
            id: id.into(),
            name: name.into(),
            hint: RString::new(),
            group: RString::new(),
            kind,
            unit: Unit::NONE,
            hard_range: any,
            soft_range: any,
            default_numbers: numbers.iter().copied().collect(),
            default_text: RString::new(),
            choices: RVec::new(),
            invalidates_preparation: false,
        }
    }

    /// A number.
    pub fn float(id: &str, name: &str, default: f64) -> Self {
        Self::new(id, name, ParamKind::FLOAT, &[default])
    }

    /// A whole number (exact up to 2^53).
    pub fn int(id: &str, name: &str, default: i64) -> Self {
        Self::new(id, name, ParamKind::INT, &[default as f64])
    }

    /// Yes or no.
    pub fn bool(id: &str, name: &str, default: bool) -> Self {
        Self::new(id, name, ParamKind::BOOL, &[f64::from(u8::from(default))])
    }

    /// One of several `(id, label)` alternatives; `default` is the id of one of them.
    pub fn choice(id: &str, name: &str, default: &str, choices: &[(&str, &str)]) -> Self {
        let choices = choices.iter().map(|&(id, label)| ChoiceDesc { id: id.into(), label: label.into() });
        Self {
            default_text: default.into(),
            choices: choices.collect(),
            ..Self::new(id, name, ParamKind::CHOICE, &[])
        }
    }

    /// A direction in space; it comes as the user wrote it, not normalised, and may be zero.
    pub fn direction(id: &str, name: &str, default: [f64; 3]) -> Self {
        Self::new(id, name, ParamKind::DIRECTION, &default)
    }

    /// A point in space; the default is given as fractions of the bounding box: `[0.5; 3]` is its centre.
    pub fn point(id: &str, name: &str, default_in_box: [f64; 3]) -> Self {
        Self::new(id, name, ParamKind::POINT, &default_in_box)
    }

    /// A colour: linear red, green, blue, and opacity, 0 to 1.
    pub fn colour(id: &str, name: &str, default: [f64; 4]) -> Self {
        Self::new(id, name, ParamKind::COLOUR, &default)
    }

    /// A curve through points (x, y), 0 to 1, of ascending x; at least two of them.
    pub fn curve(id: &str, name: &str, default: &[[f64; 2]]) -> Self {
        Self::new(id, name, ParamKind::CURVE, default.as_flattened())
    }

    /// A file that the plugin reads, in `prepare` at the latest: the state depends on it. `extensions` are
    /// those that its name may have, without a dot; any if there is none.
    pub fn file(id: &str, name: &str, extensions: &[&str]) -> Self {
        let choices = extensions.iter().map(|&e| ChoiceDesc { id: e.into(), label: e.into() });
        Self {
            choices: choices.collect(),
            invalidates_preparation: true,
            ..Self::new(id, name, ParamKind::FILE, &[])
        }
    }

    /// Another model, which the host reads for the plugin: see [`OtherModels`](crate::OtherModels). One of
    /// more vertices than `points` (1 to 4 194 304) is sampled to at most so many.
    pub fn model(id: &str, name: &str, points: u32) -> Self {
        Self { invalidates_preparation: true, ..Self::new(id, name, ParamKind::MODEL, &[f64::from(points)]) }
    }

    /// Sets the line on what the parameter does.
    #[must_use]
    pub fn hint(mut self, hint: &str) -> Self {
        self.hint = hint.into();
        self
    }

    /// Sets the group, whose parameters are shown together.
    #[must_use]
    pub fn group(mut self, group: &str) -> Self {
        self.group = group.into();
        self
    }

    /// Sets the unit of its numbers.
    #[must_use]
    pub fn unit(mut self, unit: Unit) -> Self {
        self.unit = unit;
        self
    }

    /// Sets the range outside of which the host refuses values.
    #[must_use]
    pub fn hard(mut self, min: f64, max: f64) -> Self {
        self.hard_range = [min, max];
        self
    }

    /// Sets the range of a slider.
    #[must_use]
    pub fn soft(mut self, min: f64, max: f64) -> Self {
        self.soft_range = [min, max];
        self
    }

    /// Says that the state depends on the parameter.
    #[must_use]
    pub fn invalidates_preparation(mut self) -> Self {
        self.invalidates_preparation = true;
        self
    }
}

/// A parameter's value on its way to the plugin. The host has checked it against the description.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Param<'a> {
    id: RStr<'a>,
    kind: ParamKind,
    numbers: RSlice<'a, f64>,
    text: RStr<'a>,
}

impl<'a> Param<'a> {
    /// A value that is numbers: as many as its kind has.
    pub fn numbers(id: &'a str, kind: ParamKind, numbers: &'a [f64]) -> Self {
        Self { id: id.into(), kind, numbers: numbers.into(), text: "".into() }
    }

    /// A value that is a text.
    pub fn text(id: &'a str, kind: ParamKind, text: &'a str) -> Self {
        Self { id: id.into(), kind, numbers: RSlice::EMPTY, text: text.into() }
    }

    /// The parameter of which it is the value.
    pub fn id(&self) -> &'a str {
        self.id.as_str()
    }

    /// Kind of value.
    pub fn kind(&self) -> ParamKind {
        self.kind
    }

    /// The parameter's numbers; none where it is a text.
    pub fn as_numbers(&self) -> &'a [f64] {
        self.numbers.as_slice()
    }

    /// The parameter's text; empty where it is numbers.
    pub fn as_text(&self) -> &'a str {
        self.text.as_str()
    }
}

/// The values of all parameters that the plugin described.
#[derive(Debug, Clone, Copy)]
pub struct Params<'a>(&'a [Param<'a>]);

impl<'a> Params<'a> {
    /// A view of the values.
    pub fn new(entries: &'a [Param<'a>]) -> Self {
        Self(entries)
    }

    /// The values one by one, in the plugin's order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &'a Param<'a>> {
        self.0.iter()
    }

    fn get(&self, id: &str, kinds: &[ParamKind]) -> PluginResult<&'a Param<'a>> {
        let param = self.0.iter().find(|p| p.id.as_str() == id);
        let param =
            param.ok_or_else(|| PluginError::internal(format!("the host gave no parameter `{id}`")))?;
        if !kinds.contains(&param.kind) {
            let message = format!("parameter `{id}` is of kind {}, not {:?}", param.kind.0, kinds);
            return Err(PluginError::internal(message));
        }
        Ok(param)
    }

    fn array<const N: usize>(&self, id: &str, kinds: &[ParamKind]) -> PluginResult<[f64; N]> {
        let numbers = self.get(id, kinds)?.numbers.as_slice();
        numbers.try_into().map_err(|_| {
            PluginError::internal(format!("parameter `{id}` has {} numbers, not {N}", numbers.len()))
        })
    }

    /// The value of a [`ParamKind::FLOAT`], in its unit; a [`Unit::MODEL_LENGTH`] in local units.
    pub fn float(&self, id: &str) -> PluginResult<f64> {
        self.array::<1>(id, &[ParamKind::FLOAT]).map(|[v]| v)
    }

    /// The value of a [`ParamKind::INT`].
    pub fn int(&self, id: &str) -> PluginResult<i64> {
        self.array::<1>(id, &[ParamKind::INT]).map(|[v]| v as i64)
    }

    /// The value of a [`ParamKind::BOOL`].
    pub fn bool(&self, id: &str) -> PluginResult<bool> {
        self.array::<1>(id, &[ParamKind::BOOL]).map(|[v]| v != 0.0)
    }

    /// The id of the choice made in a [`ParamKind::CHOICE`].
    pub fn choice(&self, id: &str) -> PluginResult<&'a str> {
        self.get(id, &[ParamKind::CHOICE]).map(|p| p.text.as_str())
    }

    /// The value of a [`ParamKind::DIRECTION`]: as the user wrote it, or of a [`ParamKind::POINT`]: in local
    /// coordinates.
    pub fn vec3(&self, id: &str) -> PluginResult<[f64; 3]> {
        self.array(id, &[ParamKind::DIRECTION, ParamKind::POINT])
    }

    /// The value of a [`ParamKind::COLOUR`]: linear red, green, blue, and opacity, 0 to 1.
    pub fn colour(&self, id: &str) -> PluginResult<[f64; 4]> {
        self.array(id, &[ParamKind::COLOUR])
    }

    /// The value of a [`ParamKind::CURVE`].
    pub fn curve(&self, id: &str) -> PluginResult<Curve<'a>> {
        let numbers = self.get(id, &[ParamKind::CURVE])?.numbers.as_slice();
        Curve::new(numbers.as_chunks().0).ok_or_else(|| {
            PluginError::internal(format!("parameter `{id}` is a curve of less than two points"))
        })
    }

    /// The value of a [`ParamKind::FILE`]: a path, or nothing where the user gave none.
    pub fn file(&self, id: &str) -> PluginResult<Option<&'a Path>> {
        let text = self.get(id, &[ParamKind::FILE])?.text.as_str();
        Ok((!text.is_empty()).then(|| Path::new(text)))
    }

    /// The path of a [`ParamKind::MODEL`], for messages; nothing where the user gave none.
    pub fn model(&self, id: &str) -> PluginResult<Option<&'a Path>> {
        let text = self.get(id, &[ParamKind::MODEL])?.text.as_str();
        Ok((!text.is_empty()).then(|| Path::new(text)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_typed() {
        let (angle, centre) = ([90.0], [1.0, 2.0, 3.0]);
        let entries = [
            Param::numbers("angle", ParamKind::FLOAT, &angle),
            Param::numbers("center", ParamKind::POINT, &centre),
            Param::text("operation", ParamKind::CHOICE, "bend"),
        ];
        let params = Params::new(&entries);
        assert_eq!(params.float("angle"), Ok(90.0));
        assert_eq!(params.vec3("center"), Ok(centre));
        assert_eq!(params.choice("operation"), Ok("bend"));
        assert!(params.int("angle").is_err());
        assert!(params.float("factor").unwrap_err().message.contains("`factor`"));
    }
}
