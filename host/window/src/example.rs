//! A model for those who have none at hand.

use simod_generate::{ModelOptions, Shape};
use simod_model::progress::Silent;
use simod_model::{Error, Result};
use std::path::PathBuf;

/// Enough that it is no toy, and few enough that it is there at once.
const VERTICES: u64 = 400_000;

/// The file of an amphora, which is made if it is not there yet.
///
/// # Errors
/// It cannot be written.
pub fn file() -> Result<PathBuf> {
    let folders = directories::ProjectDirs::from("", "", "simod");
    let folder = folders.map_or_else(std::env::temp_dir, |f| f.cache_dir().to_owned());
    let file = folder.join("amphora.ply");
    if !file.exists() {
        std::fs::create_dir_all(&folder).map_err(|e| Error::io("make the folder", &folder, &e))?;
        let options = ModelOptions { shape: Shape::Amphora, vertices: VERTICES, ..ModelOptions::default() };
        simod_generate::write_file(&options, &file, &Silent)?;
    }
    Ok(file)
}
