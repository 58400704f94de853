//! Sessions that are older than the plugin: parameters that were renamed, and those whose meaning changed.

use crate::{ParamKind, PluginResult};
use abi_stable::{
    StableAbi,
    std_types::{RString, RVec},
};

/// A parameter's former name.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq, Eq)]
pub struct AliasDesc {
    /// The id that older sessions give; no parameter has it now.
    pub former: RString,
    /// The id that the parameter has now.
    pub now: RString,
}

/// A plugin's description of its older sessions: the version of now, and former names of parameters.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq, Eq)]
pub struct MigrationDesc {
    /// Counts up, from 1, whenever the meaning of a parameter changes; saved sessions write it down. One that
    /// says no version is of the first.
    pub state_version: u32,
    /// Former names of parameters.
    pub aliases: RVec<AliasDesc>,
}

impl MigrationDesc {
    /// A plugin whose sessions are of this version now.
    pub fn new(state_version: u32) -> Self {
        Self { state_version, aliases: RVec::new() }
    }

    /// The parameter `now` was once called `former`.
    #[must_use]
    pub fn alias(mut self, former: &str, now: &str) -> Self {
        self.aliases.push(AliasDesc { former: former.into(), now: now.into() });
        self
    }
}

/// A parameter as a session gives it: in model coordinates and the user's units, and checked by nobody.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq)]
pub struct Setting {
    /// The parameter's id.
    pub id: RString,
    /// Kind that the value looks like: [`FLOAT`](ParamKind::FLOAT) or [`INT`](ParamKind::INT) for a number,
    /// [`BOOL`](ParamKind::BOOL), [`CHOICE`](ParamKind::CHOICE) for any text,
    /// [`DIRECTION`](ParamKind::DIRECTION) for three numbers, [`COLOUR`](ParamKind::COLOUR) for four,
    /// [`CURVE`](ParamKind::CURVE) for pairs of them.
    pub kind: ParamKind,
    /// The parameter's numbers; none where it is a text.
    pub numbers: RVec<f64>,
    /// The parameter's text; empty where it is numbers.
    pub text: RString,
}

impl Setting {
    /// A setting that is numbers.
    pub fn numbers(id: &str, kind: ParamKind, numbers: &[f64]) -> Self {
        Self { id: id.into(), kind, numbers: numbers.to_vec().into(), text: RString::new() }
    }

    /// A setting that is a text: a choice, or the name of a file.
    pub fn text(id: &str, text: &str) -> Self {
        Self { id: id.into(), kind: ParamKind::CHOICE, numbers: RVec::new(), text: text.into() }
    }
}

/// The parameters that a step of an older session gives; those that it does not give have their defaults.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settings(Vec<Setting>);

impl Settings {
    /// Wraps settings in the order in which they are given.
    pub fn new(settings: Vec<Setting>) -> Self {
        Self(settings)
    }

    /// Returns all settings.
    pub fn into_inner(self) -> Vec<Setting> {
        self.0
    }

    /// All settings.
    pub fn all(&self) -> &[Setting] {
        &self.0
    }

    /// A parameter, if it is given.
    pub fn get(&self, id: &str) -> Option<&Setting> {
        self.0.iter().find(|s| s.id == id)
    }

    /// A parameter that is one number (true is 1), if it is given.
    pub fn number(&self, id: &str) -> Option<f64> {
        match self.get(id)?.numbers.as_slice() {
            [x] => Some(*x),
            _ => None,
        }
    }

    /// A parameter that is a text, if it is given.
    pub fn text(&self, id: &str) -> Option<&str> {
        self.get(id).filter(|s| s.kind == ParamKind::CHOICE).map(|s| s.text.as_str())
    }

    /// Gives a parameter, whatever it was.
    pub fn set(&mut self, setting: Setting) {
        self.remove(&setting.id.clone());
        self.0.push(setting);
    }

    /// Gives a parameter that is one number.
    pub fn set_number(&mut self, id: &str, number: f64) {
        self.set(Setting::numbers(id, ParamKind::FLOAT, &[number]));
    }

    /// Gives a parameter that is a choice, or the name of a file.
    pub fn set_text(&mut self, id: &str, text: &str) {
        self.set(Setting::text(id, text));
    }

    /// Leaves a parameter to its default; what it was.
    pub fn remove(&mut self, id: &str) -> Option<Setting> {
        let at = self.0.iter().position(|s| s.id == id)?;
        Some(self.0.remove(at))
    }
}

/// A deformation whose older sessions keep working.
pub trait Migrate: crate::Deformer {
    /// The version of its sessions, and former names of parameters. Always the same; called once, at load.
    fn migration() -> MigrationDesc;

    /// Makes of what a session of version `from`, which is less than that of now, gives what it has to give
    /// now, under the ids of now: aliases have been applied before. Takes microseconds; the same settings
    /// always become the same.
    ///
    /// # Errors
    /// The settings cannot be understood any more.
    fn migrate(from: u32, settings: &mut Settings) -> PluginResult<()> {
        let _ = (from, settings);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_and_replaced() {
        let mut settings = Settings::new(vec![
            Setting::numbers("angle", ParamKind::INT, &[90.0]),
            Setting::numbers("axis", ParamKind::DIRECTION, &[0.0, 1.0, 0.0]),
            Setting::text("mode", "bend"),
        ]);
        assert_eq!((settings.number("angle"), settings.number("axis")), (Some(90.0), None));
        assert_eq!((settings.text("mode"), settings.text("angle")), (Some("bend"), None));
        settings.set_number("angle", 0.25);
        settings.set_text("mode", "twist");
        assert_eq!((settings.number("angle"), settings.text("mode")), (Some(0.25), Some("twist")));
        assert!(settings.remove("axis").is_some() && settings.remove("axis").is_none());
        assert_eq!(settings.all().len(), 2);
    }
}
