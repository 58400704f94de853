//! Several methods on one model, beside each other: a page, the figures as JSON, and pictures.
//!
//! ```text
//! compare.toml ──CompareFile::load──▶ methods ──sample, deform, reconstruct, each──▶ models ──┐
//!                                                                                             ▼
//!                     DIR/index.html, compare.json, *.png ◀──page, record, pictures── figures of each and of pairs
//! ```
//!
//! What is told of all vertices (displacements, differences vertex by vertex, the transfer error, the
//! pictures) is found by streaming the models. What needs a surface in memory (volume, edges, areas, folds,
//! distances from surface to surface) is told of the samples and the triangles between them.
//!
//! Memory: a run of each method, one after the other; of each distinct sampling its samples and triangles,
//! and of each method 12 bytes a sample, to the end; then a tree of one method's triangles (300 bytes a
//! sample), or a small chunk (about 1 MB) of each model, or a picture in the making (256 bytes a pixel). On
//! the disk, the deformed models of all methods at once.

mod figures;
mod file;
mod folder;
mod html;
mod method;
mod page;
mod pictures;
mod record;

pub use figures::{OnSamples, Pair};
pub use file::{CameraPlace, CompareFile, MAX_METHODS, Method, Work};
pub use record::{Comparison, Failure, Figures, MethodRecord, ModelRecord, Seconds, StepRecord};

use crate::plugins::PluginRegistry;
use folder::{INDEX, RECORD, Target};
use method::{Bench, Deformed};
use simod_model::output::write_file;
use simod_model::output_folder::OutputFolder;
use simod_model::{Cache, Error, ErrorKind, Model, Progress, Result};
use std::path::Path;
use std::sync::Arc;

/// Does all methods of a file and writes the folder `output`, whole or not at all: `index.html`,
/// `compare.json`, pictures, and with `keep_models` the deformed models. A method that fails is told so in
/// the result, and the others go on.
///
/// # Errors
/// The folder is there and no former comparison, or cannot be written; the model cannot be read; no method
/// could be done; the user cancelled.
pub fn compare(
    file: &CompareFile,
    plugins: &PluginRegistry,
    keep_models: bool,
    output: &Path,
    progress: &dyn Progress,
) -> Result<Comparison> {
    let target = Target::check(output, &file.model)?;
    let folder = OutputFolder::create(output)?;
    let cache = Arc::new(Cache::nameless(folder.path()));
    let rest = simod_model::open_with(&file.model, file.columns.as_deref(), &cache, progress)?;
    let bench = Bench::new(file, plugins, (folder.path(), cache));
    let made = in_folder(file, bench, keep_models, &folder, rest.as_ref(), &target, progress);
    let comparison = made.map_err(|e| folder.named(e))?;
    folder.commit()?;
    Ok(comparison)
}

fn in_folder(
    file: &CompareFile,
    mut bench: Bench<'_>,
    keep_models: bool,
    folder: &OutputFolder,
    rest: &dyn Model,
    target: &Target,
    progress: &dyn Progress,
) -> Result<Comparison> {
    let (mut records, mut done) = (Vec::new(), Vec::new());
    for (i, (method, name)) in file.methods.iter().zip(folder::names(&file.methods)).enumerate() {
        progress.check()?;
        progress.note(&format!("method {} of {}: {}", i + 1, file.methods.len(), method.name));
        let mut record = MethodRecord::new(method, &name);
        match bench.run(method, &name, &mut record, progress) {
            Ok(deformed) => done.push((i, deformed)),
            Err(e) if e.kind() == ErrorKind::Cancelled => return Err(e),
            Err(e) => record.fail(&folder.named(e)),
        }
        records.push(record);
    }
    let Some((_, first)) = done.first() else { return Err(none_done(&records)) };
    let mut comparison = Comparison::new(file, &first.sampled, records);
    let deformed: Vec<&Deformed> = done.iter().map(|(_, deformed)| deformed).collect();
    let open = |d: &&Deformed| simod_model::open_with_columns(&d.output, rest.columns());
    let models = deformed.iter().map(open).collect::<Result<Vec<_>>>()?;
    let models: Vec<&dyn Model> = [rest].into_iter().chain(models.iter().map(|m| &**m)).collect();

    let beside = figures::beside(&models, comparison.model.diagonal, progress)?;
    for ((i, _), displacement) in done.iter().zip(&beside.displacements) {
        comparison.methods[*i].set_displacement(*displacement);
    }
    let names: Vec<String> = done.iter().map(|(i, _)| file.methods[*i].name.clone()).collect();
    comparison.pairs = figures::pairs(&names, &deformed, &beside, progress)?;
    comparison.color_scale = figures::color_scale(&comparison.pairs, &names[0]);

    let files: Vec<(usize, String)> = done.iter().map(|(i, d)| (*i, d.name.clone())).collect();
    let drawn = pictures::draw(file, &models, &beside.bounds, &files, &mut comparison, progress)?;
    drop(models);
    for (name, bytes) in &drawn {
        write_file(&folder.path().join(name), bytes)?;
    }
    for deformed in &deformed {
        if keep_models {
            let name = deformed.output.file_name().unwrap_or_default();
            comparison.files.push(name.to_string_lossy().into_owned());
        } else {
            std::fs::remove_file(&deformed.output).map_err(|e| Error::io("remove", &deformed.output, &e))?;
        }
    }
    comparison.files.extend([INDEX.to_owned(), RECORD.to_owned()]);
    comparison.files.sort();
    write_file(&folder.path().join(RECORD), comparison.to_json().as_bytes())?;
    write_file(&folder.path().join(INDEX), page::page(&comparison, &drawn).as_bytes())?;
    progress.check()?;
    target.check_again()?;
    Ok(comparison)
}

/// The first failure, told as that of all.
fn none_done(records: &[MethodRecord]) -> Error {
    let failure = records.iter().find_map(|r| r.error.as_ref());
    let (what, hint) = failure.map_or(("", ""), |f| (&*f.what, &*f.hint));
    Error::new(ErrorKind::Argument, format!("no method could be done, the first because: {what}"), hint)
}
