//! Folder of a plan of any kind: the files that may be replaced there, and those that are written first.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde::Serialize;
use simod_core::reconstruction::abort_object;
use simod_model::object::is_object;
use simod_model::output_folder::OutputFolder;
use simod_model::{Error, Progress, Result, input, output};

use super::emit::{Emit, emit};
use super::graph::{
    COUNTS, CUT, DEFORMED, FACE_RUNS, GRADIENTS, LONGEST_ID, Plan, REFINED, SAMPLED, SHARED, SHARED_TILES,
    UPLOAD,
};
use super::units::{FINISHED, PLAN, Unit};

/// An error where something else is than a plan, or nothing.
pub fn check_target(folder: &Path) -> Result<()> {
    let refused = |what: String| {
        let hint = "give the name of a new folder, or of a plan to replace";
        Err(Error::argument(format!("{} {what}", folder.display()), hint))
    };
    if folder.symlink_metadata().is_err() {
        return Ok(());
    }
    if !folder.join(PLAN).is_file() {
        return refused("exists and is no plan".to_owned());
    }
    // A former plan is removed: its folder must hold nothing of the user's own.
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("read", folder, &e))?;
    let foreign = |name: &OsString| !name.to_str().is_some_and(is_own);
    match entries.flatten().map(|entry| entry.file_name()).find(foreign) {
        Some(name) => refused(format!("holds {} beside the plan", name.display())),
        None => Ok(()),
    }
}

/// Whether a file in a plan's folder belongs to the plan, its units or its engines.
fn is_own(name: &str) -> bool {
    let fixed = [
        PLAN,
        FINISHED,
        COUNTS,
        FACE_RUNS,
        CUT,
        SAMPLED,
        REFINED,
        DEFORMED,
        SHARED,
        SHARED_TILES,
        UPLOAD,
        GRADIENTS,
    ];
    let numbered = [
        ("count-", ".bin"),
        ("cluster-", ".bin"),
        ("shared-", ".bin"),
        ("group-", ".bin"),
        ("leaves-", ".bin"),
        ("members-", ".bin"),
        ("faces-", ".bin"),
        ("part-", ".bin"),
        ("sampled-", ".simod"),
        ("sampled-", ".json"),
        ("method-", ""),
        ("slurm-", ".out"),
        (".simod-", ""),
    ];
    let is_numbered = |(before, behind)| name.starts_with(before) && name.ends_with(behind);
    fixed.contains(&name) || Emit::FILES.contains(&name) || numbered.into_iter().any(is_numbered)
}

/// Puts a plan, and the scripts of engines for its units, into a folder that was begun, and that folder in
/// its place.
pub fn put<P: Serialize>(
    new: OutputFolder,
    (plan, units): (&P, &[Unit]),
    engines: &[Emit],
    progress: &dyn Progress,
) -> Result<()> {
    let described = toml::to_string(plan).map_err(|e| Error::unwritable("the plan", e))?;
    let named = |e: Error| new.named(e);
    output::write_file(&new.path().join(PLAN), described.as_bytes()).map_err(named)?;
    for how in engines {
        let (name, script) = emit(units, *how, new.target())?;
        output::write_file(&new.path().join(name), script.as_bytes()).map_err(named)?;
    }
    check_target(new.target())?;
    let before = upload(new.target());
    new.commit()?;
    if let Some((output, id)) = before
        && let Err(e) = abort_object(&output, &id)
    {
        progress.note(&format!("what the former plan has sent of {} stays: {e}", output.display()));
    }
    Ok(())
}

/// The object that units of the plan in a folder have begun, and its upload.
fn upload(folder: &Path) -> Option<(PathBuf, String)> {
    let id = input::read_text(&folder.join(UPLOAD), LONGEST_ID).ok()?;
    Some((Plan::load(folder).ok()?.output, id))
}

/// A path that does not depend on where a unit is done.
pub fn absolute(path: &Path) -> Result<PathBuf> {
    if is_object(path) {
        return text(path.to_owned());
    }
    text(path.canonicalize().map_err(|e| Error::io("read", path, &e))?)
}

/// The path, which scripts and plans can hold.
pub fn text(path: PathBuf) -> Result<PathBuf> {
    let plain = |text: &str| !text.chars().any(char::is_control);
    if path.to_str().is_some_and(plain) {
        return Ok(path);
    }
    Err(Error::argument(
        format!("{} is no name that a plan can hold", path.display()),
        "give it a name without control characters, in UTF-8",
    ))
}
