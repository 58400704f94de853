//! Content of `plan.toml`: units, and the units that each comes after.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use simod_core::reconstruction::Method;
use simod_model::follow::{Follow, Opacity, TensorKind};
use simod_model::{ModelName, Normals, Result};

use super::units::{Planned, Stage, Unit, check_units, read};
use crate::session_file::SessionTime;

/// Format that the first line of `plan.toml` names.
pub(super) const FORMAT: &str = "simod-plan/1";

/// The counts of all vertices.
pub(super) const COUNTS: &str = "counts.bin";

/// Starts of runs of faces, where these have to be found.
pub(super) const FACE_RUNS: &str = "face-runs.bin";

/// The cut through all trees, where faces have a say in the samples.
pub(super) const CUT: &str = "cut.bin";

/// P_S.
pub(super) const SAMPLED: &str = "sampled.simod";

/// P_S with the samples that the steps appended, if any refine.
pub(super) const REFINED: &str = "refined.simod";

/// P_S*.
pub(super) const DEFORMED: &str = "deformed.ply";

/// The output in the making, where the place of each part in it is known beforehand.
pub(super) const SHARED: &str = "output.bin";

/// The folder of the tiles in the making, likewise.
pub(super) const SHARED_TILES: &str = "output.tiles";

/// The id of the upload by which all units send their parts, where the output is an object and the place of
/// each part in it is known beforehand.
pub(super) const UPLOAD: &str = "upload.txt";

/// Longest id of an upload.
pub(super) const LONGEST_ID: u64 = 1 << 16;

/// The deformation's gradients at the samples, where any attribute turns by them.
pub(super) const GRADIENTS: &str = "gradients.bin";

/// A folder of units: the content of `plan.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Plan {
    pub(super) format: String,
    /// The program's version: others may give other bytes.
    pub(super) program: String,
    /// The session's file, and the hash of its content.
    pub(super) session: PathBuf,
    pub(super) session_hash: String,
    /// Path of the deformed model.
    pub(super) output: PathBuf,
    /// The model's path; for a model of several tiles, a pattern that they have in common.
    pub(super) model: PathBuf,
    /// The model's tiles, if it has any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) tiles: Vec<PathBuf>,
    /// The model's size in bytes.
    pub(super) model_bytes: u64,
    /// Number of the model's vertices.
    pub(super) vertices: u64,
    /// Reason for which the model is not divided, if it is not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) undivided: Option<String>,
    /// Files that units write for each other.
    pub(super) exchange: Exchange,
    pub(super) options: Recorded,
    #[serde(rename = "unit")]
    pub(super) units: Vec<Unit>,
}

/// Files in which ranges of the vertices write down what other ranges need of the cells that they share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Exchange {
    /// Most bytes of these files, which is reached where vertices come in no order.
    pub at_most_bytes: u64,
    /// Reason for which one unit samples the model, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub undivided: Option<String>,
}

/// The options of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct Recorded {
    pub(super) method: String,
    pub(super) normals: String,
    /// The offset of integers may change.
    pub(super) choose_offset: bool,
    pub(super) lossy: bool,
    /// Files of other kinds may be replaced.
    pub(super) force: bool,
    /// Samples have more than the steps need.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) whole_samples: bool,
    /// Whether splats turn with the surface.
    pub(super) splats: bool,
    pub(super) opacity: Opacity,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) max_anisotropy: Option<f64>,
    /// Libraries of plugins that were chosen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) plugins: Vec<PathBuf>,
    #[serde(default)]
    pub(super) time: SessionTime,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) follow: BTreeMap<String, TensorKind>,
}

impl Planned for Plan {
    const FORMAT: &str = FORMAT;
    const COMMAND: &str = "simod plan SESSION.toml -o DIR";

    fn head(&self) -> [&str; 2] {
        [&self.format, &self.program]
    }

    fn check(&self) -> Result<(), String> {
        check_units(&self.units)?;
        // The bytes before the vertices belong to no unit that applies the deformation.
        let (mut vertices, mut pieces) = (Some(0), None);
        let mut parts = [0; 4];
        for (number, unit) in self.units.iter().enumerate() {
            let wrong = |what: &str| Err(format!("unit {number} {what}"));
            if matches!(unit.stage, Stage::Method | Stage::Page) {
                return wrong("is of a comparison");
            }
            let stages = [Stage::Cluster, Stage::ClusterShared, Stage::Members, Stage::Faces];
            let mut of_parts = stages.into_iter().zip(&mut parts);
            if let Some((_, next)) = of_parts.find(|(stage, _)| *stage == unit.stage) {
                if unit.part != Some(*next) {
                    return wrong("is not of the part that comes next");
                }
                *next += 1;
            }
            let range = match unit.stage {
                Stage::Count => Some((&unit.vertices, &mut vertices)),
                Stage::Apply => Some((&unit.pieces, &mut pieces)),
                _ => None,
            };
            match range {
                Some((Some(range), next))
                    if next.is_none_or(|next| next == range.start) && range.end >= range.start =>
                {
                    *next = Some(range.end);
                }
                Some(_) => return wrong("is not of the range that comes next"),
                None => {}
            }
        }
        let [ranges, groups, members, faces] = parts;
        if ranges != groups {
            return Err("has other ranges than groups of cells to cluster".to_owned());
        }
        if (faces > 0 && members != ranges) || (faces == 0 && members > 0) {
            return Err("has other ranges of vertices to cluster than to look up".to_owned());
        }
        let is_last = |unit: &Unit| matches!(unit.stage, Stage::Finish | Stage::Write);
        match self.units.iter().filter(|unit| is_last(unit)).count() {
            1 if self.units.last().is_some_and(is_last) => self.recorded().map(|_| ()),
            _ => Err("does not end with the unit that writes the output".to_owned()),
        }
    }
}

/// Names of the methods, and (the next list) of the treatments of normals, in plans.
pub(super) const METHODS: [(&str, Method); 2] =
    [("blended-jets", Method::BlendedJets), ("projected-barycentric", Method::ProjectedBarycentric)];
pub(super) const NORMALS: [(&str, Normals); 3] =
    [("keep", Normals::Keep), ("transform", Normals::Transform), ("drop", Normals::Drop)];

pub(super) fn name_of<T: PartialEq>(names: &[(&str, T)], of: &T) -> String {
    names.iter().find(|(_, known)| known == of).map_or("", |(name, _)| name).to_owned()
}

fn named<T: Copy>(names: &[(&str, T)], name: &str) -> Option<T> {
    names.iter().find(|(known, _)| *known == name).map(|(_, of)| *of)
}

impl Plan {
    /// Reads the plan in a folder.
    ///
    /// # Errors
    /// There is none, it is of another version of the program, or makes no sense.
    pub fn load(folder: &Path) -> Result<Self> {
        read(folder)
    }

    /// The units, in an order in which they can be done.
    pub fn units(&self) -> &[Unit] {
        &self.units
    }

    /// Path of the deformed model.
    pub fn output(&self) -> &Path {
        &self.output
    }

    /// Path of the session that the plan is of.
    pub fn session(&self) -> &Path {
        &self.session
    }

    /// The model.
    pub fn model(&self) -> ModelName {
        if self.tiles.is_empty() {
            ModelName::File(self.model.clone())
        } else {
            ModelName::Tiles(self.tiles.clone())
        }
    }

    /// Number of the model's vertices.
    pub fn vertices(&self) -> u64 {
        self.vertices
    }

    /// Reason for which the model is not divided, if it is not.
    pub fn undivided(&self) -> Option<&str> {
        self.undivided.as_deref()
    }

    /// Size of the files that units write for each other, and the reason for which one unit samples the model
    /// alone, if it does.
    pub fn exchange(&self) -> &Exchange {
        &self.exchange
    }

    /// The libraries of plugins that were chosen.
    pub fn plugins(&self) -> &[PathBuf] {
        &self.options.plugins
    }

    /// Whether the output may replace a file of another kind.
    pub fn force(&self) -> bool {
        self.options.force
    }

    /// Method and normals, or the error in their names.
    pub(super) fn recorded(&self) -> Result<(Method, Normals), String> {
        let Recorded { method, normals, .. } = &self.options;
        let known = named(&METHODS, method).zip(named(&NORMALS, normals));
        known.ok_or_else(|| format!("there is no method {method:?} or no way {normals:?} for normals"))
    }

    pub(super) fn follow(&self) -> Follow {
        let Recorded { splats, opacity, max_anisotropy, follow, .. } = &self.options;
        Follow {
            declared: follow.clone(),
            splats: *splats,
            opacity: *opacity,
            max_anisotropy: *max_anisotropy,
        }
    }

    /// Whether faces have a say in the samples, and are read by units.
    pub(super) fn divides_faces(&self) -> bool {
        self.units.iter().any(|unit| unit.stage == Stage::Faces)
    }

    /// The files of a stage, in the order of its units.
    pub(super) fn files_of(&self, folder: &Path, stage: Stage) -> Vec<PathBuf> {
        let units = self.units.iter().filter(|unit| unit.stage == stage);
        units.map(|unit| folder.join(&unit.writes)).collect()
    }
}
