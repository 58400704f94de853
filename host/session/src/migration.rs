//! Steps of sessions that are older than their plugin: parameters that have other names now, and those whose
//! meaning changed, which the plugin brings up to date.

use crate::deformer::{Plugin, limits};
use crate::plugins::PluginRegistry;
use crate::stack::located;
use crate::step::{Action, Deformation, Step, Stroke};
use simod_model::{Error, Result};
use simod_plugin_api::{ParamDesc, ParamKind, Setting};
use std::sync::Arc;

/// Whole numbers up to this are exact.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// Brings a step up to the plugin of now; none where the step is so already. The changes are in its notes.
///
/// # Errors
/// The step is of a later version than the plugin, gives a parameter by both of its names, or the plugin
/// cannot make anything of it; or what the plugin makes of it is of no use.
pub fn migrated(step: &Deformation, plugin: &Plugin) -> Result<Option<Deformation>> {
    let now = plugin.state_version();
    let from = step.state_version.unwrap_or(1);
    if from == 0 || from > now {
        let what =
            format!("the step is of state version {from} of plugin {}, which knows 1 to {now}", plugin.id());
        return Err(Error::plugin(what, "use a later version of the plugin"));
    }
    let Some(migration) = plugin.migration() else { return Ok(None) };
    let mut to = step.clone();
    let mut notes = Vec::new();
    for (former, now) in &migration.aliases {
        let mut found = rename(&mut to.params, former, now, plugin)?;
        for stroke in &mut to.strokes {
            if stroke.params.contains_key(former) {
                found |= rename(&mut Arc::make_mut(stroke).params, former, now, plugin)?;
            }
        }
        if found {
            notes.push(format!("its parameter `{former}` is called `{now}` now"));
        }
    }
    to.param_places = step.param_places.renamed(&migration.aliases);
    if from < now {
        let call = |params: &toml::Table| brought(plugin, from, now, params);
        let (before, params) = (to.params.clone(), call(&to.params)?);
        let mut last: Option<(toml::Table, toml::Table)> = None;
        for stroke in to.strokes.iter_mut().filter(|stroke| !stroke.params.is_empty()) {
            if last.as_ref().is_none_or(|(given, _)| *given != stroke.params) {
                // All that is in effect for the stroke; of that, what differs from the step is the stroke's.
                let all = before.clone().into_iter().chain(stroke.params.clone()).collect();
                let mut own = call(&all)?;
                own.retain(|id, value| params.get(id) != Some(&*value));
                last = Some((stroke.params.clone(), own));
            }
            let own = last.as_ref().map(|(_, own)| own.clone()).unwrap_or_default();
            if own != stroke.params {
                *stroke = Arc::new(Stroke { params: own, ..(**stroke).clone() });
            }
        }
        if params != before || to.strokes != step.strokes {
            let changed = changes(&before, &params);
            notes.push(format!("its parameters were brought from state version {from} to {now}{changed}"));
        }
        to.params = params;
    }
    to.state_version = Some(now);
    to.notes = notes.into();
    Ok((to != *step).then_some(to))
}

/// An error on a step, which names parameters as the session does, too.
pub(crate) fn in_its_words(error: Error, step: &Deformation, plugin: &Plugin) -> Error {
    let text = error.to_string();
    let is_meant = |(former, now): &&(String, String)| {
        step.params.contains_key(former)
            && text.contains(&format!("parameter `{now}`"))
            && !text.contains(&format!("`{former}`"))
    };
    match plugin.migration().and_then(|m| m.aliases.iter().find(is_meant)) {
        Some((former, _)) => error.saying(format!("{text}; here it is the parameter `{former}`")),
        None => error,
    }
}

/// Renames a parameter to its present name; returns whether it had the former one.
fn rename(params: &mut toml::Table, former: &str, now: &str, plugin: &Plugin) -> Result<bool> {
    let Some(value) = params.remove(former) else { return Ok(false) };
    if params.insert(now.to_owned(), value).is_some() {
        let what =
            format!("plugin {}: parameter `{former}` is called `{now}` now, and both are given", plugin.id());
        return Err(Error::argument(what, format!("keep `{now}`")));
    }
    Ok(true)
}

/// Some of the differences, in words.
fn changes(before: &toml::Table, after: &toml::Table) -> String {
    const MOST: usize = 4;
    let text = |(id, value): (&String, &toml::Value)| {
        let value: String = value.to_string().chars().take(40).collect();
        format!("{id} = {value}")
    };
    let differs = |other: &toml::Table, id: &String, value: &toml::Value| other.get(id) != Some(value);
    let list = |of: &toml::Table, other: &toml::Table| {
        let mut all: Vec<String> = of.iter().filter(|(id, v)| differs(other, id, v)).map(text).collect();
        if all.len() > MOST {
            all.truncate(MOST);
            all.push("...".to_owned());
        }
        if all.is_empty() { "nothing".to_owned() } else { all.join(", ") }
    };
    let (gone, new) = (list(before, after), list(after, before));
    match (before == after, before.iter().any(|(id, value)| differs(after, id, value))) {
        (true, _) => String::new(),
        (_, true) => format!(": {gone} became {new}"),
        (_, false) => format!(": {new} was added, as they mean something else now"),
    }
}

/// Returns the plugin's parameters of now for those of an older state version.
fn brought(plugin: &Plugin, from: u32, now: u32, params: &toml::Table) -> Result<toml::Table> {
    let call = format!("plugin {}: state version {from} to {now}", plugin.id());
    let settings = params.iter().map(|(id, value)| {
        setting(id, value).ok_or_else(|| {
            let what = format!("{call}: parameter `{id}` is nothing that a parameter could be");
            Error::argument(what, "give a number, a text, or a list of numbers")
        })
    });
    let settings = settings.collect::<Result<Vec<_>>>()?;
    let given = plugin.migrate(from, settings.clone())?;
    let refused = |what: String| {
        let what = format!("{call}: {}", crate::deformer::line(&what));
        crate::deformer::plugins_bug(what)
    };
    check(&given).map_err(refused)?;
    let mut table = toml::Table::new();
    for new in given {
        let d = plugin.params().iter().find(|d| d.id == new.id);
        let value = match settings.iter().find(|old| **old == new) {
            // The value stays as the user wrote it.
            Some(_) => params.get(new.id.as_str()).cloned(),
            None => d.and_then(|d| value(d, &new)),
        };
        let Some(value) = value.filter(|_| d.is_some()) else {
            return Err(refused(format!(
                "it gives `{}`, which is none of its parameters, or not of its kind",
                new.id
            )));
        };
        if table.insert(new.id.to_string(), value).is_some() {
            return Err(refused(format!("it gives the parameter `{}` twice", new.id)));
        }
    }
    Ok(table)
}

/// Whether the number and lengths of the settings that a plugin gives are within the limits.
fn check(settings: &[Setting]) -> std::result::Result<(), String> {
    if settings.len() > limits::LONGEST_LIST {
        return Err(format!("it gives {} parameters", settings.len()));
    }
    let is_long = |s: &&Setting| {
        s.id.len() >= limits::LONGEST_TEXT
            || s.text.len() >= limits::LONGEST_TEXT
            || s.numbers.len() > 2 * limits::LONGEST_LIST
    };
    match settings.iter().find(is_long) {
        Some(s) => Err(format!("it gives too much for `{}`", s.id.chars().take(40).collect::<String>())),
        None => Ok(()),
    }
}

/// Setting of a session's value, as plugins take it; none for a value that no parameter can have.
fn setting(id: &str, value: &toml::Value) -> Option<Setting> {
    let number = |value: &toml::Value| match value {
        toml::Value::Float(x) => Some(*x),
        toml::Value::Integer(i) => Some(*i as f64),
        _ => None,
    };
    let numbers = |kind, numbers: &[f64]| Some(Setting::numbers(id, kind, numbers));
    match value {
        toml::Value::Float(x) => numbers(ParamKind::FLOAT, &[*x]),
        toml::Value::Integer(i) => numbers(ParamKind::INT, &[*i as f64]),
        toml::Value::Boolean(b) => numbers(ParamKind::BOOL, &[f64::from(u8::from(*b))]),
        toml::Value::String(text) => Some(Setting::text(id, text)),
        toml::Value::Array(all) => match all.iter().map(number).collect::<Option<Vec<f64>>>() {
            Some(all) if all.len() == 3 => numbers(ParamKind::DIRECTION, &all),
            Some(all) if all.len() == 4 => numbers(ParamKind::COLOUR, &all),
            _ => {
                let pair = |value: &toml::Value| match value.as_array()?.as_slice() {
                    [x, y] => Some([number(x)?, number(y)?]),
                    _ => None,
                };
                let pairs = all.iter().map(pair).collect::<Option<Vec<_>>>()?;
                numbers(ParamKind::CURVE, pairs.as_flattened())
            }
        },
        _ => None,
    }
}

/// Value of a session, of the kind that the parameter has now, for a setting of the plugin.
fn value(d: &ParamDesc, setting: &Setting) -> Option<toml::Value> {
    let list = |numbers: &[f64]| toml::Value::Array(numbers.iter().map(|x| toml::Value::Float(*x)).collect());
    Some(match (d.kind, setting.numbers.as_slice()) {
        (ParamKind::FLOAT, [x]) => toml::Value::Float(*x),
        (ParamKind::INT, [x]) if x.fract() == 0.0 && x.abs() <= EXACT => toml::Value::Integer(*x as i64),
        (ParamKind::BOOL, [x]) => toml::Value::Boolean(*x != 0.0),
        (ParamKind::CHOICE | ParamKind::FILE | ParamKind::MODEL, []) => {
            toml::Value::String(setting.text.to_string())
        }
        (ParamKind::DIRECTION | ParamKind::POINT, numbers @ [_, _, _]) => list(numbers),
        (ParamKind::COLOUR, numbers @ ([_, _, _] | [_, _, _, _])) => list(numbers),
        (ParamKind::CURVE, numbers) if numbers.len() % 2 == 0 => {
            toml::Value::Array(numbers.chunks(2).map(list).collect())
        }
        _ => return None,
    })
}

impl PluginRegistry {
    /// Brings steps up to the plugins that do them, as they are saved; returns the changes in words, each
    /// with the step's place. Steps whose plugin is not there stay as they are.
    ///
    /// # Errors
    /// A step cannot be brought up to its plugin; the error names it.
    pub fn migrate(&self, steps: &mut [Step]) -> Result<Vec<String>> {
        let mut notes = Vec::new();
        for step in steps {
            let Action::Deform(deformation) = &mut step.action else { continue };
            let Ok(plugin) = self.get(&deformation.deform) else { continue };
            let migrated = migrated(deformation, plugin).map_err(|e| {
                let e = in_its_words(e, deformation, plugin);
                located(deformation.param_places.place_of(&step.place, &e), e)
            })?;
            if let Some(migrated) = migrated {
                *deformation = migrated;
                let told = deformation.notes.iter();
                notes.extend(told.map(|note| format!("{}: plugin {}: {note}", step.place, plugin.id())));
            }
        }
        Ok(notes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_plugin_api::__private::{abi_stable, capability, find_extension, root_module};
    use simod_plugin_api::{
        DeformInput, Deformer, Descriptor, Host, Migrate, MigrationDesc, PluginError, PluginResult,
        PrepareInput, Settings,
    };
    use std::path::Path;

    /// Plugin that once had `size`, which is `radius` now, and `angle` in degrees, which is `turns` now.
    struct Grown;

    impl Deformer for Grown {
        type State = ();
        type Scratch = ();
        fn descriptor() -> Descriptor {
            Descriptor::new("grown", "Grown", "3.0.0")
                .summary("Grows")
                .param(ParamDesc::float("radius", "Radius", 1.0))
                .param(ParamDesc::float("turns", "Turns", 0.0))
                .param(ParamDesc::int("count", "Count", 1))
                .param(ParamDesc::curve("profile", "Profile", &[[0.0, 0.0], [1.0, 1.0]]))
        }
        fn prepare(_: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
            Ok(())
        }
        fn deform(
            _: &(),
            _: &DeformInput<'_>,
            _: &mut (),
            _: &mut [[f32; 3]],
            _: &Host<'_>,
        ) -> PluginResult<()> {
            Ok(())
        }
    }

    impl Migrate for Grown {
        fn migration() -> MigrationDesc {
            MigrationDesc::new(3).alias("size", "radius")
        }
        fn migrate(from: u32, settings: &mut Settings) -> PluginResult<()> {
            if settings.number("radius") == Some(13.0) {
                return Err(PluginError::parameter("radius", "brings bad luck"));
            }
            if settings.number("radius") == Some(14.0) {
                settings.set_number("nothing", 1.0);
            }
            if settings.number("radius") == Some(15.0) {
                settings.set_text("turns", &"long".repeat(100_000));
            }
            if from < 2
                && let Some(angle) = settings.number("angle")
            {
                settings.remove("angle");
                settings.set_number("turns", angle / 360.0);
            }
            if from < 3
                && let Some(count) = settings.number("count")
            {
                settings.set_number("count", count + 1.0);
            }
            Ok(())
        }
    }

    extern "C" fn extension(
        id: abi_stable::std_types::RStr<'_>,
    ) -> abi_stable::std_types::ROption<simod_plugin_api::Extension> {
        find_extension(id.as_str(), &[capability::migrate::<Grown>])
    }

    fn registry() -> PluginRegistry {
        PluginRegistry::from_plugins([Plugin::in_process(
            root_module::<Grown>(extension),
            Path::new("grown"),
        )
        .unwrap()])
    }

    fn steps(text: &str) -> Vec<Step> {
        let text = format!("[[step]]\ndeform = \"grown\"\n{text}");
        crate::SessionFile::parse(&text, Path::new("s.toml")).unwrap().steps
    }

    fn becomes(text: &str) -> (Deformation, Vec<String>) {
        let mut steps = steps(text);
        let notes = registry().migrate(&mut steps).unwrap();
        let again = registry().migrate(&mut steps.clone()).unwrap();
        assert!(again.is_empty(), "what is up to date stays: {again:?}");
        (steps[0].deformation().unwrap().clone(), notes)
    }

    #[test]
    fn names_and_meanings_are_brought_up_to_date() {
        let (step, notes) = becomes("params = { size = 2, angle = 90, profile = [[0, 1], [1, 0]] }");
        assert_eq!(step.params, "radius = 2\nturns = 0.25\nprofile = [[0, 1], [1, 0]]".parse().unwrap());
        assert_eq!(step.state_version, Some(3));
        assert_eq!(
            notes,
            [
                "s.toml, line 1: plugin grown: its parameter `size` is called `radius` now",
                "s.toml, line 1: plugin grown: its parameters were brought from state version 1 to 3: angle = 90 became turns = 0.25",
            ]
        );
        let (step, notes) = becomes("state-version = 2\nparams = { count = 4 }");
        assert_eq!(step.params, "count = 5".parse().unwrap(), "whole numbers stay whole");
        assert_eq!(notes.len(), 1);
        // A step that is up to date is not changed, but for an alias that is still used.
        let (step, notes) = becomes("state-version = 3\nparams = { size = 4, count = 1 }");
        assert_eq!(step.params, "radius = 4\ncount = 1".parse().unwrap());
        assert_eq!(notes.len(), 1);
        let (_, notes) = becomes("params = { radius = 4 }");
        assert!(notes.is_empty(), "{notes:?}");
    }

    #[test]
    fn strokes_are_brought_up_to_date_with_their_step() {
        let stroke = |params: &str| {
            format!("[[step.stroke]]\nradius = 1\npoints = [[0, 0, 0]]\nparams = {{ {params} }}\n")
        };
        let text =
            ["params = { angle = 90, count = 2 }\n", &stroke("angle = 180"), &stroke("size = 3")].concat();
        let (step, _) = becomes(&text);
        assert_eq!(step.params, "turns = 0.25\ncount = 3".parse().unwrap());
        assert_eq!(step.strokes[0].params, "turns = 0.5".parse().unwrap());
        assert_eq!(step.strokes[1].params, "radius = 3".parse().unwrap());
    }

    #[test]
    fn what_goes_wrong_is_told_with_its_place() {
        let told = |text: &str, what: &str| {
            let error = registry().migrate(&mut steps(text)).unwrap_err();
            assert!(error.to_string().contains(what), "{error}");
            assert!(
                error.to_string().starts_with("s.toml, line ") && error.to_string().len() < 400,
                "{error}"
            );
            assert!(!error.hint().is_empty());
        };
        told(
            "params = { size = 2, radius = 3 }",
            "line 3: plugin grown: parameter `size` is called `radius` now, and both",
        );
        told(
            "state-version = 4",
            "line 1: the step is of state version 4 of plugin grown, which knows 1 to 3",
        );
        told("state-version = 0", "of state version 0");
        told(
            "params.count = 1\nparams.size = 13",
            "line 4: plugin grown: parameter `radius` brings bad luck; here it is the parameter `size`",
        );
        told("params = { radius = 14 }", "it gives `nothing`, which is none of its parameters");
        told("params = { radius = 15 }", "it gives too much for `turns`");
        told("params = { radius = [1, 2] }", "parameter `radius` is nothing that a parameter could be");
    }
}
