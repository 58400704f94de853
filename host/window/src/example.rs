//! Generated models for users who have none at hand.

use simod_generate::{ModelOptions, Shape};
use simod_model::progress::Silent;
use simod_model::{Error, Result};
use std::path::PathBuf;

/// Number of the example's vertices: enough that it is no toy, and few enough that it is there at once.
const VERTICES: u64 = 400_000;

/// The file of an amphora, which is made if it is not there yet.
///
/// # Errors
/// The file cannot be written.
pub fn file() -> Result<PathBuf> {
    model("amphora.ply", Shape::Amphora, VERTICES)
}

/// The file of a generated model, which is made if it is not there yet.
///
/// # Errors
/// The model cannot be written.
pub fn model(name: &str, shape: Shape, vertices: u64) -> Result<PathBuf> {
    let folders = directories::ProjectDirs::from("", "", "simod");
    let folder = folders.map_or_else(std::env::temp_dir, |f| f.cache_dir().to_owned());
    let file = folder.join(name);
    if !file.exists() {
        std::fs::create_dir_all(&folder).map_err(|e| Error::io("make the folder", &folder, &e))?;
        let options = ModelOptions { shape, vertices, ..ModelOptions::default() };
        simod_generate::write_file(&options, &file, &Silent)?;
    }
    Ok(file)
}
