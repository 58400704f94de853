//! Units of a plan of any kind: their stages, and the units that each comes after.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use simod_core::tables;
use simod_model::{Error, Result, input};

/// The plan itself.
pub const PLAN: &str = "plan.toml";

/// File that the last unit leaves.
pub const FINISHED: &str = "finished.toml";

/// Most bytes of a plan: of a million units.
const LONGEST: u64 = 256 << 20;

/// A piece of work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Unit {
    /// The unit's place in the list.
    pub number: usize,
    /// The stage that the unit is of.
    pub stage: Stage,
    /// The units that have to be done before.
    pub after: Vec<usize>,
    /// Vertices that the unit counts, if it counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) vertices: Option<Range<u64>>,
    /// The number of the range of the vertices or of the faces, or of the group of cells that ranges share,
    /// if the unit samples; of a comparison, that of its sampling or method.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) part: Option<u64>,
    /// Pieces of the file that the unit writes, or the tiles, if it applies the deformation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) pieces: Option<Range<u64>>,
    /// File in the plan's folder that is there once the unit is done.
    pub writes: PathBuf,
}

impl Unit {
    /// Unit that does one part of its stage, and no range of vertices or pieces.
    pub fn undivided(number: usize, stage: Stage, after: Vec<usize>, part: usize, writes: PathBuf) -> Self {
        let part = Some(part as u64);
        Self { number, stage, after, vertices: None, part, pieces: None, writes }
    }

    /// Index of the unit's part in its stage.
    pub fn part(&self) -> usize {
        self.part.unwrap_or_default() as usize
    }
}

/// The stages of units, in the order of a run; then those of comparisons, which sample first, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stage {
    /// Vertices of a range are counted per cell.
    Count,
    /// The starts of the runs of faces in the file are found, where faces have a say, and are not all
    /// triangles.
    FaceRuns,
    /// The counts are added up, where clustering is divided.
    Merge,
    /// The cells that lie wholly within a range are clustered, and the range's vertices of other cells are
    /// written down.
    Cluster,
    /// A group of the cells that ranges share is clustered.
    ClusterShared,
    /// The samples are those of a cut through all clusters.
    Cut,
    /// The sample of each vertex of a range is looked up, where faces have a say.
    Members,
    /// A range of the faces is read for what it contributes to the samples.
    Faces,
    /// The samples are completed with what faces tell.
    Complete,
    /// The counts are added up, and the model is sampled, where clustering is not divided.
    Sample,
    /// The samples are deformed, and refined where the steps say so.
    Deform,
    /// A range of the file is written, or some of the tiles.
    Apply,
    /// The ranges or tiles that were written are put together.
    Finish,
    /// The whole file is written, where it cannot be divided.
    Write,
    /// A method of a comparison is done.
    Method,
    /// The results of the methods are compared.
    Page,
}

impl Stage {
    /// The stage's name in files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Count => "count",
            Self::FaceRuns => "face-runs",
            Self::Merge => "merge",
            Self::Cluster => "cluster",
            Self::ClusterShared => "cluster-shared",
            Self::Cut => "cut",
            Self::Members => "members",
            Self::Faces => "faces",
            Self::Complete => "complete",
            Self::Sample => "sample",
            Self::Deform => "deform",
            Self::Apply => "apply",
            Self::Finish => "finish",
            Self::Write => "write",
            Self::Method => "method",
            Self::Page => "page",
        }
    }
}

/// Content of a `plan.toml` of any kind of plan.
pub trait Planned: DeserializeOwned {
    /// Format that the file's first line names.
    const FORMAT: &str;
    /// The command that makes the plan again.
    const COMMAND: &str;

    /// Format that the file names, and the version of the program that made it.
    fn head(&self) -> [&str; 2];

    /// Checks the plan; the error names what makes no sense.
    fn check(&self) -> Result<(), String>;
}

/// Reads the plan in a folder.
pub fn read<P: Planned>(folder: &Path) -> Result<P> {
    let file = folder.join(PLAN);
    let wrong = |what: String| {
        let hint = format!("make it again: `{}`", P::COMMAND);
        Error::format(format!("{}: {what}", file.display()), hint)
    };
    if !file.exists() {
        return Err(Error::argument(
            format!("{} is no plan: it has no {PLAN}", folder.display()),
            "give the folder that `simod plan` wrote",
        ));
    }
    let text = input::read_text(&file, LONGEST)?;
    let plan: P = tables::read(&text).map_err(|e| wrong(e.message().replace('\n', " ")))?;
    let [format, program] = plan.head();
    if format != P::FORMAT {
        return Err(wrong(format!("format is {format:?}, not {:?}", P::FORMAT)));
    }
    if program != env!("CARGO_PKG_VERSION") {
        return Err(Error::mismatch(
            format!(
                "{} was made by version {program} of the program, and this is {}",
                file.display(),
                env!("CARGO_PKG_VERSION")
            ),
            "use one version for all units, as others may give other bytes; or make the plan again",
        ));
    }
    plan.check().map_err(wrong)?;
    Ok(plan)
}

/// The unit of a number.
pub fn unit_of<'a>(units: &'a [Unit], (folder, number): (&Path, usize)) -> Result<&'a Unit> {
    units.get(number).ok_or_else(|| {
        let last = units.len().saturating_sub(1);
        Error::argument(
            format!("{} has no unit {number}", folder.display()),
            format!("its units are 0 to {last}: see plan.toml there"),
        )
    })
}

/// An error if a unit cannot be done yet.
pub fn check_before(units: &[Unit], unit: &Unit, folder: &Path) -> Result<()> {
    match unit
        .after
        .iter()
        .map(|before| &units[*before])
        .find(|before| !folder.join(&before.writes).is_file())
    {
        Some(Unit { number, stage, .. }) => Err(Error::argument(
            format!("unit {number} ({}) has to be done before unit {}", stage.name(), unit.number),
            format!("do it first: `simod unit {} {number}`", folder.display()),
        )),
        None => Ok(()),
    }
}

/// Checks the units of any plan: each one's number, the units that it comes after, and the path that it
/// writes.
pub fn check_units(units: &[Unit]) -> Result<(), String> {
    for (number, unit) in units.iter().enumerate() {
        let wrong = |what: &str| Err(format!("unit {number} {what}"));
        if unit.number != number {
            return wrong("has another number");
        }
        if unit.after.iter().any(|before| *before >= number) {
            return wrong("comes after one that is not before it");
        }
        if !unit.writes.components().all(|part| matches!(part, std::path::Component::Normal(_))) {
            return wrong("writes outside the plan's folder");
        }
    }
    Ok(())
}

/// Hash of a session's content, as it stands in plans.
pub fn hash_of(session: &Path) -> Result<String> {
    let text = input::read(session, LONGEST)?;
    Ok(format!("xxh3-128:{:032x}", xxhash_rust::xxh3::xxh3_128(&text)))
}
