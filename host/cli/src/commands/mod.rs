//! The subcommands, a file each.

pub mod bind;
pub mod compare;
pub mod convert;
pub mod deform;
pub mod demo;
mod engines;
mod follow_options;
pub mod generate;
pub mod info;
mod overwrite;
pub mod plan;
pub mod plugin;
mod plugin_check;
mod plugin_migrate;
mod plugin_new;
mod plugin_options;
pub mod reconstruct;
pub mod refine;
pub mod render;
pub mod run;
pub mod sample;
pub mod shell;
mod time_options;
pub mod view;

use simod_core::sampled_model::SampledModel;
use simod_model::{Cache, Error, Result};

use simod_session::step::Step;
use simod_session::{Message, PluginRegistry};

use crate::report::{Report, count};

/// Sets the number of threads of everything that follows.
pub fn set_threads(n: usize) -> Result<()> {
    rayon::ThreadPoolBuilder::new().num_threads(n).build_global().map_err(|e| {
        Error::argument(format!("cannot use {n} threads: {e}"), "leave --threads out to use all cores")
    })
}

/// Reports the notices on the plugins that do these steps, before they do.
fn notices(plugins: &PluginRegistry, steps: &[Step], report: &mut Report) {
    plugins.notices(steps).into_iter().for_each(|notice| report.warn(notice));
}

/// Reports the messages of plugins.
fn tell(messages: &[Message], report: &mut Report) {
    for message in messages.iter().filter(|m| !m.is_debug()) {
        let text = format!("{}: {}", message.plugin, message.text);
        if message.is_warning() { report.warn(text) } else { report.note(text) }
    }
}

/// Reports the size of the cache that had to be made of the model.
fn tell_cache(cache: &Cache, report: &mut Report) {
    if let Some(bytes) = cache.bytes() {
        report.figure("cache_bytes", bytes);
    }
}

/// Reports the number of splats that were not sampled.
fn tell_transparent(sampled: &SampledModel, report: &mut Report) {
    if let (n @ 1.., Some(least)) = (sampled.source.transparent, sampled.sampling.min_opacity) {
        report.figure("transparent", n);
        report.line(format!(
            "{} splats of less opacity than {least}, or than their size and distance ask for, take no samples, and \
             are deformed all the same",
            count(n)
        ));
    }
}

/// Reports the vertices that will stay as they are.
fn warn_non_finite(sampled: &SampledModel, report: &mut Report) {
    if let (n @ 1.., Some(first)) = (sampled.source.non_finite, sampled.source.first_non_finite) {
        report.figure("non_finite", n);
        report.warn(format!(
            "{} of the vertices have no finite position, the first is vertex {first}; they take no samples, and \
             no deformation moves them",
            count(n)
        ));
    }
}
