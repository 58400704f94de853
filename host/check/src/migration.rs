//! The rule on sessions that are older than the plugin.

use crate::answer::answer;
use crate::finding::{Checked, Finding};
use crate::subject::Subject;
use simod_model::ErrorMark;
use simod_plugin_api::ParamKind;
use simod_session::migration::migrated;
use simod_session::params::check_migration;
use simod_session::step::Deformation;
use simod_session::{Migration, Plugin};

/// Sessions of all versions that give no parameter, or every one by its default and by each former name,
/// become sessions of today; always the same, and today's sessions are not changed once more.
pub(crate) fn migration(subject: &Subject) -> Checked<Finding> {
    let plugin = &subject.plugin;
    if let Some(what) = plugin.migration().and_then(|m| check_migration(plugin.descriptor(), m).err()) {
        return Err(Finding::fail(what, HINT));
    }
    let Some(migration) = plugin.migration() else {
        return Ok(Finding::skip("it says nothing of older sessions"));
    };
    match answer("migration", plugin.code().migration())? {
        Ok(Some(again)) if again == *migration => {}
        _ => {
            let hint = "have `Migrate::migration` give the same each time";
            return Err(Finding::fail("it says something else of older sessions when asked twice", hint));
        }
    }
    let tables = tables(plugin, migration);
    let (mut refused, mut done) = (None, 0);
    for from in (1..=migration.state_version).rev().take(VERSIONS).chain([1]) {
        for params in &tables {
            let step = Deformation {
                state_version: Some(from),
                params: params.clone(),
                ..Deformation::by_plugin(plugin.id())
            };
            let fail = |what: String| Finding::fail(format!("from state version {from}: {what}"), HINT);
            match brought(&step, plugin).map_err(fail)? {
                Brought::Same => done += 1,
                Brought::Refused(what) => _ = refused.get_or_insert(what),
            }
        }
    }
    Ok(match refused {
        Some(what) if done == 0 => Finding::warn(format!("it refuses all older sessions: {what}"), HINT),
        _ => Finding::pass(format!(
            "state version {}, {} aliases",
            migration.state_version,
            migration.aliases.len()
        )),
    })
}

/// Parameters as older sessions may give them: none, all by their defaults, and each by each former name.
fn tables(plugin: &Plugin, migration: &Migration) -> Vec<toml::Table> {
    let numbers = |x: &[f64]| toml::Value::Array(x.iter().map(|x| toml::Value::Float(*x)).collect());
    let given = plugin.params().iter().filter_map(|d| {
        let value = match (d.kind, d.default_numbers.as_slice()) {
            (ParamKind::FLOAT, [x]) => toml::Value::Float(*x),
            (ParamKind::INT, [x]) => toml::Value::Integer(*x as i64),
            (ParamKind::BOOL, [x]) => toml::Value::Boolean(*x != 0.0),
            (ParamKind::CHOICE, _) => toml::Value::String(d.default_text.to_string()),
            (ParamKind::DIRECTION | ParamKind::COLOUR, x) => numbers(x),
            (ParamKind::CURVE, x) => toml::Value::Array(x.chunks(2).map(numbers).collect()),
            _ => return None,
        };
        Some((d.id.to_string(), value))
    });
    let defaults: toml::Table = given.collect();
    let mut tables = vec![toml::Table::new(), defaults.clone()];
    for (former, now) in &migration.aliases {
        let mut table = defaults.clone();
        if let Some(value) = table.remove(now) {
            table.insert(former.clone(), value);
            tables.push(table);
        }
    }
    tables
}

/// The result of bringing a step up to its plugin.
enum Brought {
    /// The step becomes the same each time, and that is not changed once more.
    Same,
    /// The plugin refuses it, for this reason.
    Refused(String),
}

/// Brings a step up to its plugin, more than once.
///
/// # Errors
/// The plugin fails by a mistake of its own; the migrated step differs from time to time, or is migrated once
/// more.
fn brought(step: &Deformation, plugin: &Plugin) -> Result<Brought, String> {
    let brought = |step: &Deformation| migrated(step, plugin).map(|new| new.unwrap_or_else(|| step.clone()));
    let first = match brought(step) {
        Ok(first) => first,
        // The values of old defaults are unknown here: the plugin may refuse a setting that it cannot
        // understand.
        Err(e) if !e.is_marked(ErrorMark::PluginBug) => return Ok(Brought::Refused(e.to_string())),
        Err(e) => return Err(e.to_string()),
    };
    if brought(step).ok().as_ref() != Some(&first) {
        return Err("the same settings become others each time".to_owned());
    }
    if brought(&first).ok().as_ref() != Some(&first) {
        return Err("what became of it is changed once more".to_owned());
    }
    Ok(Brought::Same)
}

/// Number of versions that are tried, besides the first.
const VERSIONS: usize = 50;

const HINT: &str = "see `Migrate` in simod-plugin-api";
