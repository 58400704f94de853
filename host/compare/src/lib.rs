//! Several methods on one model, beside each other: a page, the figures as JSON, and pictures.
//!
//! ```text
//! compare.toml ──CompareFile::load──▶ methods ──sample, deform, reconstruct, each──▶ models ──┐
//!                                                                                             ▼
//!                     DIR/index.html, compare.json, *.png ◀──page, record, pictures── figures of each and of pairs
//! ```
//!
//! Figures of all vertices (displacements, differences vertex by vertex) are found by one reading of all
//! models, and pictures of models with very many vertices are made of some that are chosen by the way.
//! Figures that need a surface in memory (volume, edges, areas, folds, energies, distances from surface to
//! surface) are those of the samples and the triangles between them, and of models that are small enough to
//! be held.
//!
//! Up to four methods in a row that are run once, and have the same samples, are transferred by one reading
//! of the model.
//!
//! Memory: a run of each method, one after the other, or of those that are transferred together the memory
//! of their exact maps, and then a field of each; of each distinct sampling its samples and triangles, and
//! of each method 12 bytes a sample, to the end; the rest geometry of the samples (420 bytes a sample)
//! until all methods are done; then up to four methods' smooth surfaces (220 bytes a sample each), or a
//! tree of one method's triangles (400 bytes a sample), or for each thread a chunk (about 300 kB) of each
//! model, or a picture in the making, or two of up to a million pixels (380 bytes a pixel). On the disk,
//! the deformed models of all methods at once, and the chosen vertices (three for each pixel, 24 bytes for
//! each version).

mod chosen;
mod clock;
mod external;
mod figures;
mod file;
mod folder;
mod html;
mod lengths;
mod method;
mod page;
mod pictures;
mod planned;
mod record;
mod tables;
mod unit;

pub use file::{
    CameraPlace, CompareFile, ComparedMethod, CropPlace, MAX_METHODS, MethodWork, ProgramFile, ProgramMethod,
};
pub use lengths::{Fractions, Lengths, WithLengths};
pub use planned::{ComparisonPlan, ComparisonPlanOptions, make};
pub use record::{
    Comparison, DeformationRecord, Figures, MachineRecord, MethodFailure, MethodRecord, ModelRecord,
    OnSamples, Pair, ResultFile, RunSeconds, Seconds,
};
pub use unit::{ComparisonUnitDone, do_unit};

use chosen::Choosing;
use figures::HeldMesh;
use folder::{CSV, ComparisonFolder, INDEX, LATEX, RECORD};
use method::{BegunMethod, Bench, Deformed, UntransferredMethod};
use pictures::Easel;
use simod_model::output::write_file;
use simod_model::output_folder::OutputFolder;
use simod_model::{Cache, Error, ErrorKind, MAX_VERSIONS, Model, ModelName, Progress, Result, Vertices};
use simod_session::plugins::PluginRegistry;
use std::path::Path;
use std::sync::Arc;

/// Permissions of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Comparing {
    /// Whether the deformed models stay in the folder.
    pub keep_models: bool,
    /// Whether programs that the file names are run.
    pub allow_commands: bool,
}

/// Does all methods of a file and writes the folder `output`, whole or not at all: `index.html`,
/// `compare.json`, tables, pictures, and if they are kept the deformed models. The failure of a method is
/// told in the result, and the others go on.
///
/// # Errors
/// The file names programs, and these are not allowed; the folder is there and no former comparison, or
/// cannot be written; the model cannot be read; no method could be done; the user cancelled.
pub fn compare(
    file: &CompareFile,
    plugins: &PluginRegistry,
    how: Comparing,
    output: &Path,
    progress: &dyn Progress,
) -> Result<Comparison> {
    let (named, target) = checked(file, how, output)?;
    let folder = OutputFolder::create(output)?;
    let cache = Arc::new(Cache::nameless(folder.path()));
    let rest = named.open(file.columns.as_deref(), &cache, progress)?;
    let mut bench = Bench::new(file, plugins, (folder.path(), cache));
    if !how.keep_models {
        bench.make_scratch();
    }
    let made = in_folder(file, bench, how.keep_models, &folder, rest.as_ref(), &target, progress);
    let comparison = made.map_err(|e| folder.named(e))?;
    folder.commit()?;
    Ok(comparison)
}

/// An error if a file names programs that may not be run.
fn check_commands(file: &CompareFile, how: Comparing) -> Result<()> {
    match file.commands().next().filter(|_| !how.allow_commands) {
        Some((method, command)) => Err(Error::argument(
            format!("{}: the method `{}` runs a program: {}", method.place, method.name, command.line),
            "if you know it, allow it with --allow-commands (from Python allow_commands=True)",
        )),
        None => Ok(()),
    }
}

/// Model and folder, if the comparison may be made as it is asked for.
fn checked(file: &CompareFile, how: Comparing, output: &Path) -> Result<(ModelName, ComparisonFolder)> {
    check_commands(file, how)?;
    let named = ModelName::from_path(&file.model)?;
    if let Some((method, _)) = file.commands().find(|(_, command)| command.makes_model())
        && matches!(named, ModelName::Tiles(_))
    {
        return Err(Error::argument(
            format!(
                "{}: the method `{}` takes a model of several tiles as one file",
                method.place, method.name
            ),
            "have it deform {samples}, or name the folder of tiles that it made with `model`",
        ));
    }
    let target = ComparisonFolder::check(output, named.files())?;
    Ok((named, target))
}

fn in_folder<'a>(
    file: &'a CompareFile,
    mut bench: Bench<'a>,
    keep_models: bool,
    folder: &OutputFolder,
    rest: &dyn Model,
    target: &ComparisonFolder,
    progress: &dyn Progress,
) -> Result<Comparison> {
    let names = folder::names(&file.methods);
    let new = |(method, name): (&ComparedMethod, &String)| MethodRecord::new(method, name);
    let mut records: Vec<MethodRecord> = file.methods.iter().zip(&names).map(new).collect();
    let (mut done, mut waiting) = (Vec::new(), Vec::new());
    for (i, (method, name)) in file.methods.iter().zip(&names).enumerate() {
        progress.check()?;
        progress.note(&format!("method {} of {}: {}", i + 1, file.methods.len(), method.name));
        let begun = bench.begin(method, name, &mut records[i], progress);
        match begun {
            Ok(BegunMethod::Finished(deformed)) => done.push((i, *deformed)),
            Ok(BegunMethod::Untransferred(one)) => {
                let goes_with = |(_, first): &(usize, UntransferredMethod<'_>)| one.goes_with(first);
                if waiting.len() == MAX_VERSIONS || !waiting.first().is_none_or(goes_with) {
                    let together = std::mem::take(&mut waiting);
                    done.extend(transfer(&bench, together, &mut records, folder, progress)?);
                }
                waiting.push((i, *one));
            }
            Err(e) if e.kind() == ErrorKind::Cancelled => return Err(e),
            Err(e) => records[i].fail(&folder.named(e)),
        }
    }
    done.extend(transfer(&bench, waiting, &mut records, folder, progress)?);
    done.sort_by_key(|(i, _)| *i);
    drop(bench);
    beside_each_other(file, (records, &done), keep_models, folder, rest, target, progress)
}

/// Transfers methods, by their numbers in the file, in one reading of the model; returns those that could
/// be done.
fn transfer(
    bench: &Bench<'_>,
    waiting: Vec<(usize, UntransferredMethod<'_>)>,
    records: &mut [MethodRecord],
    folder: &OutputFolder,
    progress: &dyn Progress,
) -> Result<Vec<(usize, Deformed)>> {
    let (numbers, waiting): (Vec<usize>, Vec<UntransferredMethod<'_>>) = waiting.into_iter().unzip();
    if numbers.len() > 1 {
        let names: Vec<&str> = numbers.iter().map(|i| records[*i].name.as_str()).collect();
        progress.note(&format!("transferring together: {}", names.join(", ")));
    }
    let mut done = Vec::new();
    for (i, of) in numbers.iter().zip(bench.transfer(waiting, progress)) {
        match of.and_then(|once| bench.finish(once, &mut records[*i], progress)) {
            Ok(deformed) => done.push((*i, deformed)),
            Err(e) if e.kind() == ErrorKind::Cancelled => return Err(e),
            Err(e) => records[*i].fail(&folder.named(e)),
        }
    }
    Ok(done)
}

/// Compares the methods' results: `done` are the methods that could be done, with their numbers in the
/// file.
fn beside_each_other(
    file: &CompareFile,
    (records, done): (Vec<MethodRecord>, &[(usize, Deformed)]),
    keep_models: bool,
    folder: &OutputFolder,
    rest: &dyn Model,
    target: &ComparisonFolder,
    progress: &dyn Progress,
) -> Result<Comparison> {
    let Some((_, first)) = done.first() else { return Err(none_done(&records)) };
    let mut comparison = Comparison::new(file, &first.sampled, records);
    let deformed: Vec<&Deformed> = done.iter().map(|(_, deformed)| deformed).collect();
    let open = |d: &&Deformed| simod_model::open_version(rest, &d.output, rest.columns());
    let models = deformed.iter().map(open).collect::<Result<Vec<_>>>()?;
    let models: Vec<&dyn Model> = [rest].into_iter().chain(models.iter().map(|m| &**m)).collect();

    let diagonal = comparison.model.diagonal;
    let easel = Easel::new(file, rest, folder.path(), progress)?;
    let vertices = rest.info().vertices;
    let choosing = easel.chosen(vertices).map(|most| {
        Choosing::begin((vertices, most), models.len(), first.sampled.frame.origin, folder.path())
    });
    let choosing = choosing.transpose()?;
    let color = |parts: &[Vertices<'_>], i: usize| easel.color(parts, 0, i);
    let also = |first: u64, parts: &[Vertices<'_>]| {
        choosing.as_ref().map_or(Ok(()), |choosing| choosing.take(first, parts, &color))
    };
    let attributes = if choosing.is_some() { easel.attributes() } else { 0 };
    let beside = figures::beside(&models, diagonal, (attributes, &also), progress)?;
    let chosen = choosing.map(Choosing::finish).transpose()?;
    let on_samples = figures::on_samples(&deformed, progress)?;
    let on_model = HeldMesh::read(rest, diagonal, progress)?.map(|held| held.measure(&models[1..], progress));
    let mut on_model = on_model.transpose()?.unwrap_or_default().into_iter();
    for (k, ((i, _), on_samples)) in done.iter().zip(on_samples).enumerate() {
        let found = (beside.displacements[k], beside.to_first(k));
        comparison.methods[*i].set_shape(found, diagonal, on_samples, on_model.next());
    }
    let names: Vec<String> = done.iter().map(|(i, _)| file.methods[*i].name.clone()).collect();
    comparison.pairs = figures::pairs(&names, &deformed, (&beside, diagonal), progress)?;
    comparison.set_color_scale(figures::color_scale(&comparison.pairs, &names[0]));
    let files: Vec<(usize, String)> = done.iter().map(|(i, d)| (*i, d.name.clone())).collect();
    let shown = (&models[..], chosen.as_ref());
    let drawn = easel.draw(shown, &beside.bounds, &files, &mut comparison, progress)?;
    drop(models);
    comparison.files.extend(kept_models(&deformed, keep_models)?);
    write(&mut comparison, file, &drawn, folder.path())?;
    progress.check()?;
    target.check_again()?;
    Ok(comparison)
}

/// Names of the deformed models that were made here, which are removed unless they are kept.
fn kept_models(deformed: &[&Deformed], keep_models: bool) -> Result<Vec<String>> {
    let mut kept = Vec::new();
    for Deformed { output, .. } in deformed.iter().filter(|deformed| deformed.is_ours) {
        if keep_models {
            kept.push(output.file_name().unwrap_or_default().to_string_lossy().into_owned());
        } else {
            let remove = if output.is_dir() { std::fs::remove_dir_all } else { std::fs::remove_file };
            remove(output).map_err(|e| Error::io("remove", output, &e))?;
        }
    }
    Ok(kept)
}

/// Writes the pictures that were drawn, the record, the tables and the page to a folder.
fn write(
    comparison: &mut Comparison,
    file: &CompareFile,
    drawn: &[(String, Vec<u8>)],
    folder: &Path,
) -> Result<()> {
    for (name, bytes) in drawn {
        write_file(&folder.join(name), bytes)?;
    }
    comparison.files.extend([INDEX, RECORD, CSV, LATEX].map(str::to_owned));
    comparison.files.sort();
    write_file(&folder.join(RECORD), comparison.to_json().as_bytes())?;
    write_file(&folder.join(CSV), tables::csv(comparison).as_bytes())?;
    write_file(&folder.join(LATEX), tables::latex(comparison).as_bytes())?;
    write_file(&folder.join(INDEX), page::page(comparison, &file.crops, drawn).as_bytes())
}

/// Error that tells the first failure as that of all methods.
fn none_done(records: &[MethodRecord]) -> Error {
    let failure = records.iter().find_map(|r| r.error.as_ref());
    let (what, hint) = failure.map_or(("", ""), |f| (&*f.what, &*f.hint));
    Error::argument(format!("no method could be done, the first because: {what}"), hint)
}
