//! `simod plugin`: the list of deformation tools, their parameters, checks, and new ones.

use clap::Subcommand;
use serde_json::json;
use simod_model::Result;
use simod_session::{Plugin as Loaded, PluginRegistry, param_data};

use super::plugin_check::{Check, CheckRule};
use super::plugin_migrate::Migrate;
use super::plugin_new::New;
use super::plugin_options::{PluginArgs, Serve};
use crate::report::Report;

/// List the deformation plugins, show one, check one, or begin a new one
///
/// A plugin is a program: it runs with your rights, and can read, change and delete whatever you can. Plugins
/// that did not come with SIMOD run in processes of their own, so that one that crashes, hangs or takes all
/// memory does no harm to your work. That protects from mistakes and not from malice: install plugins only
/// from those whom you would have run any other program.
#[derive(Subcommand)]
pub enum Plugin {
    /// List the plugins that were found
    List {
        #[command(flatten)]
        plugins: PluginArgs,
    },
    /// Show a plugin, its inputs and its parameters
    Info {
        /// Id of the plugin, as `warp`
        id: String,
        #[command(flatten)]
        plugins: PluginArgs,
    },
    Serve(Serve),
    New(New),
    Migrate(Migrate),
    Check(Check),
    CheckRule(CheckRule),
}

impl Plugin {
    /// Whether the command is this program once more, at work for another process of the program.
    pub fn is_worker(&self) -> bool {
        matches!(self, Self::Serve(_))
    }

    pub fn execute(self, report: &mut Report) -> Result<()> {
        match self {
            Self::List { plugins } => list(&plugins.discover(report)?, report),
            Self::Info { id, plugins } => {
                let registry = plugins.discover(report)?;
                let plugin = registry.get(&id)?;
                registry.replaced(plugin).into_iter().for_each(|notice| report.warn(notice));
                info(plugin, report);
            }
            Self::Serve(serve) => serve.execute()?,
            Self::New(new) => new.execute(report)?,
            Self::Migrate(migrate) => migrate.execute(report)?,
            Self::Check(check) => check.execute(report)?,
            Self::CheckRule(rule) => rule.execute(report)?,
        }
        Ok(())
    }
}

fn list(registry: &PluginRegistry, report: &mut Report) {
    let plugins = registry.plugins();
    for plugin in plugins {
        report.line(format!("{:16} {:8} {}", plugin.id(), plugin.version(), plugin.summary()));
    }
    if plugins.is_empty() {
        report.line("no plugins found; folders are looked for in SIMOD_PLUGIN_PATH, the user's data folder, and beside the program");
    }
    for plugin in plugins {
        registry.replaced(plugin).into_iter().for_each(|notice| report.warn(notice));
    }
    for duplicate in registry.duplicates() {
        report.line(format!(
            "{}: {} is used, {} is not",
            duplicate.id,
            duplicate.used.display(),
            duplicate.unused.display()
        ));
    }
    let describe = |p: &std::sync::Arc<Loaded>| {
        json!({
            "id": p.id(), "name": p.name(), "version": p.version(), "summary": p.summary(),
            "path": p.path().display().to_string(), "evaluates": p.capabilities().evaluate,
        })
    };
    report.figure("plugins", plugins.iter().map(describe).collect::<Vec<_>>());
}

fn info(plugin: &Loaded, report: &mut Report) {
    report.line(format!("{} {} ({})", plugin.name(), plugin.version(), plugin.id()));
    report.line(plugin.summary());
    if !plugin.citation().is_empty() {
        report.line(plugin.citation());
    }
    let by = [plugin.author(), plugin.url()].map(str::trim).into_iter().filter(|t| !t.is_empty());
    let by = by.collect::<Vec<_>>().join(", ");
    if !by.is_empty() {
        report.line(format!("by {by}"));
    }
    let place = if plugin.is_isolated() { ", in a process of its own" } else { "" };
    report.line(format!("library {}{place}", plugin.path().display()));
    tell_needs(plugin, report);
    tell_params(plugin, report);
    report.figure("id", plugin.id());
    report.figure("version", plugin.version());
    report.figure("parameters", plugin.params().iter().map(param_data).collect::<Vec<_>>());
}

/// Reports the inputs that a plugin takes, and its capabilities.
fn tell_needs(plugin: &Loaded, report: &mut Report) {
    let consumes = plugin.consumes();
    let mut needs = Vec::new();
    for (used, least, role) in [
        (consumes.fixed_regions, consumes.min_fixed, "fixed"),
        (consumes.handle_regions, consumes.min_handles, "handle"),
    ] {
        if used {
            needs.push(format!("{role} regions, at least {least}"));
        }
        report.figure(&format!("{role}_regions"), used.then_some(least));
    }
    if consumes.normals {
        needs.push("normals".to_owned());
    }
    report.figure("needs_normals", consumes.normals);
    for (used, what, figure) in [
        (consumes.triangles, "triangles, if there are any", "uses_triangles"),
        (consumes.graph, "the samples' neighbours", "uses_graph"),
        (consumes.joints, "joints", "uses_joints"),
        (consumes.strokes, "strokes", "uses_strokes"),
        (consumes.frame, "the model's frame", "uses_frame"),
        (consumes.effort, "drafts while dragging", "makes_drafts"),
        (consumes.time, "the time of a sequence", "uses_time"),
        (consumes.rest_positions, "the samples before all steps", "uses_rest_positions"),
        (consumes.attributes, "colours and other attributes, if there are any", "uses_attributes"),
    ] {
        if used {
            needs.push(what.to_owned());
        }
        report.figure(figure, used);
    }
    let can = plugin.capabilities();
    for (yes, what, figure) in [
        (can.evaluate, "knows its map at any point of space", "evaluates"),
        (can.handles, "places handles of its own", "places_handles"),
        (can.is_identity, "tells when it does nothing", "tells_identity"),
    ] {
        if yes {
            report.line(what);
        }
        report.figure(figure, yes);
    }
    let needs = if needs.is_empty() { "nothing but the samples".to_owned() } else { needs.join("; ") };
    report.line(format!("takes {needs}"));
}

/// Reports the plugin's parameters, group by group, and their former names.
fn tell_params(plugin: &Loaded, report: &mut Report) {
    let mut group = String::new();
    for param in simod_session::describe_params(plugin.params()) {
        if param.group != group {
            // A parameter in no group that comes after a group is set apart as well.
            let title = if param.group.is_empty() { "others" } else { param.group.as_str() };
            report.line(format!("  {title}:"));
            group.clone_from(&param.group);
        }
        let indent = if group.is_empty() { "  " } else { "    " };
        report.line(format!("{indent}{:14} {}", param.id, param.text));
    }
    if let Some(migration) = plugin.migration() {
        report.line(format!("  state version {}, which saved sessions write down", migration.state_version));
        for (former, now) in &migration.aliases {
            report.line(format!("  `{now}` was once called `{former}`"));
        }
    }
    let alias = |(former, now): &(String, String)| json!({"former": former, "now": now});
    let aliases = plugin.migration().map(|m| m.aliases.iter().map(alias).collect::<Vec<_>>());
    report.figure("state_version", plugin.state_version());
    report.figure("aliases", aliases.unwrap_or_default());
    report.figure("migrates", plugin.migration().is_some());
}
