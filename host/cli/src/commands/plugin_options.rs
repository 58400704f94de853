//! Options on the look-up and the running of plugins.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use simod_model::Result;
use simod_session::worker::{self, MEMORY, PATIENCE, WorkerOptions};
use simod_session::{Isolation, PluginOptions as Options, PluginRegistry};

use super::sample::parse_bytes;
use crate::report::Report;

/// Options on plugins
#[derive(Args)]
#[command(next_help_heading = "Plugins")]
pub struct PluginArgs {
    /// Library of a plugin to use instead of others of its id (may be given several times)
    #[arg(long, value_name = "FILE")]
    r#use: Vec<PathBuf>,
    /// Plugins that run in processes of their own, where a crash does no harm
    ///
    /// It is no protection from a plugin that means harm: wherever it runs, it has your rights.
    #[arg(long, value_enum, default_value_t)]
    isolate: Isolate,
    /// Time that a plugin in a process of its own may give no sign of life, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = parse_seconds)]
    plugin_patience: Duration,
    /// Memory that a plugin in a process of its own may take, as 4G (on Linux)
    #[arg(long, value_name = "SIZE", default_value = "4G", value_parser = parse_bytes)]
    plugin_memory: u64,
}

#[derive(Clone, Copy, Default, ValueEnum)]
enum Isolate {
    /// Plugins that did not come with the program
    #[default]
    Others,
    /// All plugins
    Always,
    /// No plugin
    Never,
}

/// The values that the command line has by default.
impl Default for PluginArgs {
    fn default() -> Self {
        Self {
            r#use: Vec::new(),
            isolate: Isolate::default(),
            plugin_patience: PATIENCE,
            plugin_memory: MEMORY,
        }
    }
}

impl PluginArgs {
    /// The libraries that were chosen.
    pub fn chosen(&self) -> &[PathBuf] {
        &self.r#use
    }

    /// The same options, with libraries to use where none were chosen.
    pub fn or_chosen(mut self, files: &[PathBuf]) -> Self {
        if self.r#use.is_empty() {
            self.r#use = files.to_owned();
        }
        self
    }

    /// Finds the plugins in the standard folders, and reports those that cannot be used, that take long to
    /// load, and that anybody may change.
    pub fn discover(self, report: &mut Report) -> Result<PluginRegistry> {
        let isolation = match self.isolate {
            Isolate::Others => Isolation::Others,
            Isolate::Always => Isolation::Always,
            Isolate::Never => Isolation::Never,
        };
        // Workers are this program once more, whatever its present name is.
        let program = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("simod"));
        let (silence, memory) = (self.plugin_patience, self.plugin_memory);
        let worker = WorkerOptions { silence, memory, ..WorkerOptions::for_program(&program) };
        let options = Options { chosen: self.r#use, ..Options::standard(isolation, worker) };
        let registry = PluginRegistry::discover_with(&options, report.untimed())?;
        if let Some(error) = registry.refused_choice() {
            return Err(error.clone());
        }
        for rejected in registry.rejected() {
            report.warn(rejected.error.to_string());
        }
        for slow in registry.slow() {
            let (file, seconds) = (slow.path.display(), slow.time.as_secs_f64());
            report.warn(format!("{file} took {seconds:.1} s to say what it is"));
        }
        for folder in registry.open_folders() {
            report.warn(format!(
                "anybody on this machine may write to the plugin folder {}, and so have code run as you: take that right away, with `chmod o-w`",
                folder.display()
            ));
        }
        Ok(registry)
    }
}

/// Answer the program's requests on a plugin
#[derive(Args)]
#[command(hide = true)]
pub struct Serve {
    /// Library of the plugin
    file: PathBuf,
    /// Memory that this process may take, in bytes
    memory: u64,
    /// Number of the process that started this one
    parent: u32,
}

impl Serve {
    pub fn execute(self) -> Result<()> {
        worker::serve(&self.file, self.memory, self.parent)
    }
}

/// A time on the command line, in seconds.
pub(super) fn parse_seconds(text: &str) -> std::result::Result<Duration, String> {
    let seconds = text.parse::<f64>().ok().filter(|s| *s > 0.0);
    let time = seconds.and_then(|s| Duration::try_from_secs_f64(s).ok());
    time.ok_or_else(|| "a time is a number of seconds, above 0".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn defaults_are_those_of_the_command_line() {
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            plugins: PluginArgs,
        }
        let parsed = Line::parse_from(["simod"]).plugins;
        let default = PluginArgs::default();
        assert_eq!(
            (parsed.plugin_patience, parsed.plugin_memory),
            (default.plugin_patience, default.plugin_memory)
        );
    }
}
