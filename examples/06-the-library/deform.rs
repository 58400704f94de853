//! Deforms the samples of a model, by a plugin and by a function of its own: `library-deform DIR
//! DEFORMED.ply`.
#![allow(clippy::print_stdout, reason = "a program that tells what it did")]

use simod_core::reconstruction::deformed_normals;
use simod_core::sampled_model::SampledModel;
use simod_model::progress::Silent;
use simod_session::edit::Refinements;
use simod_session::plugins::standard_folders;
use simod_session::{PluginOptions, PluginRegistry, SessionFile, deform};
use std::error::Error;
use std::path::{Path, PathBuf};

/// Steps as a session file has them. They can be built as values, too: see
/// `simod_session::step::Step`.
const STEPS: &str = r#"
[[step]]
deform = "warp"
params = { operation = "twist", angle = 90 }
"#;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [folder, output] = arguments.as_slice() else { return Err("give a sampled model and a file".into()) };

    let sampled = SampledModel::load(folder)?;
    let plugins = PluginRegistry::discover(&PluginOptions::in_process(standard_folders()));
    let steps = SessionFile::parse(STEPS, Path::new("steps.toml"))?.steps;
    let mut deformed = deform(sampled, &steps, &plugins, Refinements::default(), &Silent)?;
    deformed.messages.iter().for_each(|message| println!("{}: {}", message.plugin, message.text));

    // And whatever else one can do with points: they are in local coordinates, which the sampled model's
    // frame maps to the model's.
    let sampled = &deformed.sampled;
    for p in &mut deformed.positions.local {
        p.x += 0.05 * (12.0 * p.y).sin();
    }
    let normals = deformed_normals(&sampled.samples, &deformed.positions.local);
    sampled.write_deformed(output, &deformed.positions, &normals)?;

    println!("{} samples deformed by {} plugin", deformed.positions.local.len(), steps.len());
    Ok(())
}
