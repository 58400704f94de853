//! Doing a unit of a comparison: a sampling, a method, or the page.

use crate::file::{CompareFile, ComparedMethod, MethodWork};
use crate::folder;
use crate::method::{Bench, Deformed, file_name, refines};
use crate::planned::{ComparisonPlan, METHOD_RECORD, method_folder, sampled_folder, samplings};
use crate::record::{Comparison, MethodRecord};
use crate::{beside_each_other, checked};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use simod_core::sampled_model::SampledModel;
use simod_model::claim::Claim;
use simod_model::output::write_file;
use simod_model::output_folder::OutputFolder;
use simod_model::{Cache, Error, ErrorKind, Model, Progress, Result, input};
use simod_session::plan::{FINISHED, Stage, Unit, check_before, unit_of};
use simod_session::plugins::PluginRegistry;
use std::error::Error as _;
use std::path::Path;
use std::sync::Arc;

/// File of the deformed samples in a method's folder; there is none where the method deforms no samples.
const DEFORMED: &str = "deformed.ply";

/// Folder of the samples with those that the method appended, if it appended some.
const REFINED: &str = "refined.simod";

/// Greatest length of a record of a sampling or a method, in bytes: it may have the text of a session.
const LONGEST: u64 = 64 << 20;

/// The report of a unit.
#[derive(Default)]
pub struct ComparisonUnitDone {
    /// Whether the unit was done before.
    pub was_done: bool,
    /// Record of the unit's method.
    pub method: Option<MethodRecord>,
    /// Record of the comparison, by the last unit.
    pub comparison: Option<Comparison>,
}

/// Records of all methods, and the results of those that were done, with their numbers.
type Methods = (Vec<MethodRecord>, Vec<(usize, Deformed)>);

/// Note on a sampling.
#[derive(Serialize, Deserialize)]
struct SamplingNote {
    seconds: f64,
}

/// Does a unit of the plan in a folder. A unit that was done is not done again.
///
/// The failure of a method is told in its record, as in a comparison by one process; a method that failed
/// by the disk or the machine has no record, and may be done again by another machine.
///
/// # Errors
/// There is no such unit, or one that has to be done before was not; the comparison has changed since the
/// plan was made; files of other units are damaged; the model cannot be sampled; and the errors of
/// [`compare`](crate::compare).
pub fn do_unit(
    plan: &ComparisonPlan,
    (folder, number): (&Path, usize),
    plugins: &PluginRegistry,
    progress: &dyn Progress,
) -> Result<ComparisonUnitDone> {
    let unit = unit_of(plan.units(), (folder, number))?;
    let is_finished = folder.join(FINISHED).is_file();
    if is_finished && unit.stage == Stage::Page {
        // The process that did the unit may have been killed before it had tidied.
        tidy(plan, folder);
    }
    if is_finished || folder.join(&unit.writes).is_file() {
        return Ok(ComparisonUnitDone { was_done: true, ..ComparisonUnitDone::default() });
    }
    check_before(plan.units(), unit, folder)?;
    let file = plan.comparison()?;
    let work = ComparisonUnitRun { plan, unit, folder, file: &file, plugins, progress };
    match unit.stage {
        Stage::Sample => work.sample(),
        Stage::Method => work.method(),
        Stage::Page => work.page(),
        _ => Err(Error::internal("no comparison has such a unit")),
    }
}

struct ComparisonUnitRun<'a> {
    plan: &'a ComparisonPlan,
    unit: &'a Unit,
    folder: &'a Path,
    file: &'a CompareFile,
    plugins: &'a PluginRegistry,
    progress: &'a dyn Progress,
}

impl ComparisonUnitRun<'_> {
    fn sample(&self) -> Result<ComparisonUnitDone> {
        let of = samplings(self.file)[self.unit.part()];
        let begun = SampledModel::begin(&self.folder.join(sampled_folder(self.unit.part())))?;
        let cache = SampledModel::cache_in(&begun);
        let mut bench = Bench::new(self.file, self.plugins, (self.folder, cache));
        let (sampled, seconds) = bench.sampling(of, self.progress)?;
        sampled.save_in(begun)?;
        // The note is written in the end, as it tells that the samples are there.
        write_json(&self.folder.join(&self.unit.writes), &SamplingNote { seconds })?;
        Ok(ComparisonUnitDone::default())
    }

    fn method(&self) -> Result<ComparisonUnitDone> {
        let number = self.unit.part();
        let (method, name) = (&self.file.methods[number], &folder::names(&self.file.methods)[number]);
        let new = OutputFolder::create(&self.folder.join(method_folder(number)))?;
        let (rest, seconds) = self.sampled(self.sampling_of(number), refines(method))?;
        let mut bench =
            Bench::new(self.file, self.plugins, (new.path(), Arc::new(Cache::nameless(new.path()))));
        bench.take(method.sampling, rest.clone(), seconds);
        let mut record = MethodRecord::new(method, name);
        match bench.run(method, name, &mut record, self.progress) {
            Ok(deformed) => keep(&deformed, &rest, new.path()).map_err(|e| new.named(e))?,
            Err(e) if e.kind() == ErrorKind::Cancelled || is_of_the_disk(&e) => return Err(new.named(e)),
            Err(e) => record.fail(&new.named(e)),
        }
        write_json(&new.path().join(METHOD_RECORD), &record).map_err(|e| new.named(e))?;
        self.progress.check()?;
        new.commit()?;
        Ok(ComparisonUnitDone { method: Some(record), ..ComparisonUnitDone::default() })
    }

    fn page(&self) -> Result<ComparisonUnitDone> {
        let how = self.plan.how();
        let output = self.plan.output();
        let (named, target) = checked(self.file, how, output)?;
        let new = OutputFolder::create(output)?;
        let cache = Arc::new(Cache::nameless(new.path()));
        let rest = named.open(self.file.columns.as_deref(), &cache, self.progress)?;
        let rest = rest.as_ref();
        let (records, done) = self.methods(how.keep_models.then(|| new.path()), rest)?;
        let found = (records, &done[..]);
        let made = beside_each_other(self.file, found, how.keep_models, &new, rest, &target, self.progress);
        let comparison = made.map_err(|e| new.named(e))?;
        new.commit()?;
        let text = format!("output = {:?}\n", output.display().to_string());
        write_file(&self.folder.join(FINISHED), text.as_bytes())?;
        tidy(self.plan, self.folder);
        Ok(ComparisonUnitDone { comparison: Some(comparison), ..ComparisonUnitDone::default() })
    }

    /// Records and results of all methods. Deformed models are taken over to a folder, if there is one; the
    /// originals stay in their places all the same, as this unit may have to be done again.
    fn methods(&self, kept: Option<&Path>, rest: &dyn Model) -> Result<Methods> {
        let samplings = (0..samplings(self.file).len()).map(|part| self.sampled(part, false));
        let samplings = samplings.collect::<Result<Vec<_>>>()?;
        let (mut records, mut done) = (Vec::new(), Vec::new());
        for (number, method) in self.file.methods.iter().enumerate() {
            let from = self.folder.join(method_folder(number));
            let record: MethodRecord = read_json(&from.join(METHOD_RECORD))?;
            if record.figures.is_some() {
                let (refined, deformed) = (from.join(REFINED), from.join(DEFORMED));
                let sampled = if refined.is_dir() {
                    Arc::new(SampledModel::load(&refined)?)
                } else {
                    samplings[self.sampling_of(number)].0.clone()
                };
                let read = || sampled.read_deformed(&deformed, self.progress);
                let positions = deformed.is_file().then(read).transpose()?;
                let file = file_name(&record.file, rest);
                let (output, is_ours) = match (given_model(method), kept) {
                    (Some(given), _) => (given.to_owned(), false),
                    (None, Some(kept)) => (kept.join(&file), true),
                    (None, None) => (from.join(&file), false),
                };
                if is_ours {
                    link(&from.join(&file), &output)?;
                }
                done.push((
                    number,
                    Deformed { name: record.file.clone(), sampled, positions, output, is_ours },
                ));
            }
            records.push(record);
        }
        Ok((records, done))
    }

    /// The number of a method's sampling.
    fn sampling_of(&self, method: usize) -> usize {
        let own = self.file.methods[method].sampling;
        samplings(self.file).iter().position(|of| *of == own).unwrap_or_default()
    }

    /// Samples that a unit has taken, with the seconds that this took; with the cells, if they are asked
    /// for.
    fn sampled(&self, part: usize, cells: bool) -> Result<(Arc<SampledModel>, f64)> {
        let folder = self.folder.join(sampled_folder(part));
        let mut sampled = SampledModel::load(&folder)?;
        if cells {
            sampled.hold_cells(sampled.cells_or_resample(&folder, Some(&self.file.model), self.progress)?);
        }
        let SamplingNote { seconds } = read_json(&self.folder.join(format!("sampled-{part}.json")))?;
        Ok((Arc::new(sampled), seconds))
    }
}

/// Removes files that are not needed any more, and those that killed processes have left beside folders; a
/// file that cannot be removed does no harm.
fn tidy(plan: &ComparisonPlan, folder: &Path) {
    for unit in plan.units() {
        match unit.stage {
            Stage::Sample => Claim::tidy(&folder.join(sampled_folder(unit.part()))),
            Stage::Method => {
                let method = folder.join(method_folder(unit.part()));
                let _ = std::fs::remove_dir_all(&method);
                Claim::tidy(&method);
            }
            _ => {}
        }
    }
}

/// Writes the parts of a method's result that the page needs beside the deformed model: `rest` are the
/// samples that the method was given.
fn keep(deformed: &Deformed, rest: &Arc<SampledModel>, folder: &Path) -> Result<()> {
    let sampled = &deformed.sampled;
    if !Arc::ptr_eq(sampled, rest) {
        sampled.save(&folder.join(REFINED))?;
    }
    let Some(positions) = &deformed.positions else { return Ok(()) };
    sampled.write_deformed(&folder.join(DEFORMED), positions, sampled.samples.normals())
}

/// Path of the deformed model that a method names, if the method is one.
fn given_model(method: &ComparedMethod) -> Option<&Path> {
    match &method.work {
        MethodWork::Model(path) => Some(path),
        _ => None,
    }
}

/// Whether a failure is one of the machine or the disk, and not of the method's input.
fn is_of_the_disk(e: &Error) -> bool {
    use std::io::ErrorKind as K;
    let source = e.source().and_then(|source| source.downcast_ref::<std::io::Error>());
    let given = [
        K::NotFound,
        K::PermissionDenied,
        K::IsADirectory,
        K::NotADirectory,
        K::InvalidData,
        K::UnexpectedEof,
    ];
    source.is_some_and(|source| !given.contains(&source.kind()))
}

/// Gives a file, or the files of a folder, a second name; where the file system has none, they are copied.
fn link(from: &Path, to: &Path) -> Result<()> {
    let failed = |e: std::io::Error| Error::io("write", to, &e);
    if !from.is_dir() {
        return std::fs::hard_link(from, to)
            .or_else(|_| std::fs::copy(from, to).and_then(|_| std::fs::File::open(to)?.sync_all()))
            .map_err(failed);
    }
    std::fs::create_dir(to).map_err(failed)?;
    for entry in std::fs::read_dir(from).map_err(|e| Error::io("read", from, &e))? {
        let name = entry.map_err(|e| Error::io("read", from, &e))?.file_name();
        link(&from.join(&name), &to.join(&name))?;
    }
    Ok(())
}

fn write_json<T: Serialize>(path: &Path, of: &T) -> Result<()> {
    let bytes = serde_json::to_vec_pretty(of).map_err(|e| Error::unwritable("a record", e))?;
    write_file(path, &bytes)
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let bytes = input::read(path, LONGEST)?;
    serde_json::from_slice(&bytes).map_err(|e| {
        let what = format!("{} is damaged: {e}", path.display());
        Error::format(what, "remove it, and do the unit again that wrote it")
    })
}
