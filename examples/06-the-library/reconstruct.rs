//! Carries a deformation of the samples over to the whole model: `library-reconstruct DIR DEFORMED.ply OUT`.
#![allow(clippy::print_stdout, reason = "a program that tells what it did")]

use simod_core::reconstruction::{Reconstruction, Version, reconstruct};
use simod_core::sampled_model::SampledModel;
use simod_model::progress::Silent;
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [folder, deformed, output] = arguments.as_slice() else {
        return Err("give a sampled model, its deformed samples, and a file for the model".into());
    };

    let sampled = SampledModel::load(folder)?;
    let model = sampled.open_source(None, &Silent)?;
    // Up to four versions share one reading of the model.
    let deformed = &sampled.read_deformed(deformed, &Silent)?;
    let version = Version { deformed, output, diagnostics: None };
    reconstruct(&sampled, model.as_ref(), &[version], &Reconstruction::default(), &Silent)?;

    println!("{} vertices in {}", sampled.source.vertices, output.display());
    Ok(())
}
