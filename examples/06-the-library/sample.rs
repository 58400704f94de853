//! Samples a model: `library-sample MODEL DIR`.
#![allow(clippy::print_stdout, reason = "a program that tells what it did")]

use simod_core::sampling::{Sampling, Target, sample};
use simod_model::progress::Silent;
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [path, folder] = arguments.as_slice() else { return Err("give a model and a new folder".into()) };

    let model = simod_model::open(path)?;
    let sampling = Sampling { target: Target::Samples(20_000), ..Sampling::default() };
    // A program with a window would show its progress, and offer to stop; this one is silent.
    let sampled = sample(model.as_ref(), &sampling, &std::env::temp_dir(), &Silent)?;
    sampled.save(folder)?;

    println!("{} samples of {} vertices", sampled.samples.len(), sampled.source.vertices);
    Ok(())
}
