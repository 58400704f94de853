//! A comparison as units of work, for more machines than one: each sampling, then each method, then the page.
//!
//! ```text
//! sampled-0 ─┬─▶ method-0 ─┐
//!            └─▶ method-1 ─┼─▶ page: what is found of all of them, pictures, tables
//! sampled-1 ───▶ method-2 ─┘
//! ```

use crate::file::{CompareFile, MethodWork};
use crate::{Comparing, check_commands, checked};
use serde::{Deserialize, Serialize};
use simod_model::object::is_object;
use simod_model::output_folder::OutputFolder;
use simod_model::target::canonical_folder;
use simod_model::{Error, Progress, Result};
use simod_session::plan::{
    Emit, FINISHED, PLAN, Planned, Stage, Unit, absolute, check_target, check_units, hash_of, put, read, text,
};
use simod_session::session_file::SamplingTable;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Format of the plan, which is written on the first line of `plan.toml`.
const FORMAT: &str = "simod-comparison-plan/1";

/// File of a method's record in its folder, with the figures that are known once the method is done. The
/// record comes with the folder, whole.
pub(crate) const METHOD_RECORD: &str = "record.json";

/// A folder of the units of a comparison: the content of `plan.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct ComparisonPlan {
    format: String,
    /// Version of the program: other versions may give other bytes.
    program: String,
    /// The file of the comparison.
    file: PathBuf,
    /// Path of the model; a pattern if the model has several tiles.
    model: PathBuf,
    /// Folder of the comparison, which is written in the end.
    output: PathBuf,
    /// Whether the deformed models stay in the comparison's folder.
    keep_models: bool,
    /// Whether the user allowed that programs are run which the file names; units run no others, as its
    /// text may not change.
    allow_commands: bool,
    /// Libraries of plugins that the user chose.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    plugins: Vec<PathBuf>,
    /// The file, and the sessions that it names.
    text: Vec<PlannedText>,
    #[serde(rename = "unit")]
    units: Vec<Unit>,
}

/// Text that determines the work, and may not change until all is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct PlannedText {
    file: PathBuf,
    hash: String,
}

/// Options of the plan of a comparison.
#[derive(Debug, Clone, Copy)]
pub struct ComparisonPlanOptions<'a> {
    /// Permissions of the comparison.
    pub how: Comparing,
    /// Libraries of plugins that the user chose.
    pub plugins: &'a [PathBuf],
    /// The engines that files are written for.
    pub emit: &'a [Emit],
}

/// Makes the plan of a comparison, which is in the file `path` and will write the folder `output`, and
/// writes the plan to a folder, which appears whole or not at all. A former plan there is replaced. The
/// model is not read.
///
/// # Errors
/// The errors of [`compare`](crate::compare) before it begins; the folder cannot be written, or holds other
/// things than a plan; the folder lies in the output, or the other way round; a path is no text.
pub fn make(
    file: &CompareFile,
    path: &Path,
    output: &Path,
    options: &ComparisonPlanOptions<'_>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ComparisonPlan> {
    check_target(folder)?;
    checked(file, options.how, output)?;
    let output = canonical_folder(output)?;
    let place = canonical_folder(folder)?;
    if output.starts_with(&place) || place.starts_with(&output) {
        let what = format!("{} and {} lie in each other", output.display(), folder.display());
        return Err(Error::argument(what, "have the plan and the comparison in folders of their own"));
    }
    let new = OutputFolder::create(folder)?;
    let sessions = file.methods.iter().filter_map(|method| match &method.work {
        MethodWork::Session(path) if path.is_file() => Some(path.as_path()),
        _ => None,
    });
    let of_text = |path: &Path| Ok(PlannedText { file: placed(path)?, hash: hash_of(path)? });
    let plan = ComparisonPlan {
        format: FORMAT.to_owned(),
        program: env!("CARGO_PKG_VERSION").to_owned(),
        file: placed(path)?,
        model: placed(&file.model)?,
        output: text(output)?,
        keep_models: options.how.keep_models,
        allow_commands: options.how.allow_commands,
        plugins: options.plugins.iter().map(|file| absolute(file)).collect::<Result<_>>()?,
        text: std::iter::once(path).chain(sessions).map(of_text).collect::<Result<_>>()?,
        units: units(file),
    };
    put(new, (&plan, &plan.units), options.emit, progress)?;
    Ok(plan)
}

/// Path that does not depend on the current folder; links in it are kept, so that files beside it stay
/// beside it.
fn placed(path: &Path) -> Result<PathBuf> {
    if is_object(path) {
        return text(path.to_owned());
    }
    text(std::path::absolute(path).map_err(|e| Error::io("read", path, &e))?)
}

/// The samplings of all methods, each once.
pub(crate) fn samplings(file: &CompareFile) -> Vec<SamplingTable> {
    let mut samplings = Vec::new();
    for method in &file.methods {
        if !samplings.contains(&method.sampling) {
            samplings.push(method.sampling);
        }
    }
    samplings
}

/// Units of the comparison.
fn units(file: &CompareFile) -> Vec<Unit> {
    let samplings = samplings(file);
    let sample = |part| {
        let writes = PathBuf::from(format!("sampled-{part}.json"));
        Unit::undivided(part, Stage::Sample, Vec::new(), part, writes)
    };
    let mut units: Vec<Unit> = (0..samplings.len()).map(sample).collect();
    for (part, method) in file.methods.iter().enumerate() {
        let after = samplings.iter().position(|of| *of == method.sampling);
        let writes = method_folder(part).join(METHOD_RECORD);
        units.push(Unit::undivided(units.len(), Stage::Method, after.into_iter().collect(), part, writes));
    }
    let methods = (samplings.len()..units.len()).collect();
    units.push(Unit::undivided(units.len(), Stage::Page, methods, 0, FINISHED.into()));
    units
}

/// The folder of a sampling in that of the plan.
pub(crate) fn sampled_folder(part: usize) -> PathBuf {
    format!("sampled-{part}.simod").into()
}

/// The folder of a method.
pub(crate) fn method_folder(part: usize) -> PathBuf {
    format!("method-{part}").into()
}

impl ComparisonPlan {
    /// Whether the plan in a folder is that of a comparison.
    pub fn is_at(folder: &Path) -> bool {
        let Ok(file) = std::fs::File::open(folder.join(PLAN)) else { return false };
        let mut line = String::new();
        let first = format!("format = {FORMAT:?}");
        let read = BufReader::new(file).take(2 * first.len() as u64).read_line(&mut line);
        read.is_ok() && line.trim_end() == first
    }

    /// Reads the plan in a folder.
    ///
    /// # Errors
    /// There is no plan, or it is of another version of the program, or it makes no sense.
    pub fn load(folder: &Path) -> Result<Self> {
        read(folder)
    }

    /// The units, in an order in which they can be done.
    pub fn units(&self) -> &[Unit] {
        &self.units
    }

    /// The folder that is written in the end.
    pub fn output(&self) -> &Path {
        &self.output
    }

    /// The file of the comparison.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The model, or a pattern of its tiles.
    pub fn model(&self) -> &Path {
        &self.model
    }

    /// The libraries of plugins that were chosen.
    pub fn plugins(&self) -> &[PathBuf] {
        &self.plugins
    }

    /// Permissions of the comparison.
    pub(crate) fn how(&self) -> Comparing {
        Comparing { keep_models: self.keep_models, allow_commands: self.allow_commands }
    }

    /// The comparison, whose file and sessions have not changed since the plan was made.
    pub(crate) fn comparison(&self) -> Result<CompareFile> {
        for PlannedText { file, hash } in &self.text {
            if hash_of(file)? != *hash {
                return Err(self.changed(file));
            }
        }
        let file = CompareFile { model: self.model.clone(), ..CompareFile::load(&self.file)? };
        if units(&file) != self.units {
            return Err(self.changed(&self.file));
        }
        check_commands(&file, self.how())?;
        Ok(file)
    }

    fn changed(&self, path: &Path) -> Error {
        Error::mismatch(
            format!("{} changed since the plan was made", path.display()),
            format!("make the plan again: `{}`", Self::COMMAND),
        )
    }
}

impl Planned for ComparisonPlan {
    const FORMAT: &str = FORMAT;
    const COMMAND: &str = "simod compare COMPARE.toml -o DIR --plan PLAN";

    fn head(&self) -> [&str; 2] {
        [&self.format, &self.program]
    }

    fn check(&self) -> Result<(), String> {
        check_units(&self.units)
    }
}
