//! The tables of `session.toml`, as they stand in the file: its keys and their order, once for those who read
//! sessions and those who write them. A place in the file goes along with what may be wrong.

use crate::motion::Motion;
use crate::session_file::{SamplingTable, SessionTime};
use crate::shapes::RegionShape;
use crate::side_file;
use crate::step::{Joint, Origin, Role, Stroke};
use serde::{Deserialize, Serialize};
use simod_core::tables::Spanned;
use simod_model::follow::TensorKind;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

/// Value that is written, and has no place in a file yet.
pub(crate) fn placeless<T>(value: T) -> Spanned<T> {
    Spanned::new(0..0, value)
}

#[derive(Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct SessionTable {
    pub version: Option<Spanned<i64>>,
    pub model: Option<Spanned<ModelTable>>,
    pub follow: Option<Spanned<BTreeMap<String, TensorKind>>>,
    pub sampling: Option<Spanned<SamplingTable>>,
    pub time: Option<Spanned<SessionTime>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub step: Vec<Spanned<StepTable>>,
    pub output: Option<PathTable>,
}

impl SessionTable {
    /// Content of the table that the first version of the format does not know: a key in words, and its
    /// place.
    pub fn of_version_2(&self) -> Option<(&'static str, Range<usize>)> {
        let follow = self.follow.as_ref().map(|follow| ("`follow` is", follow.span()));
        let tiles = || {
            let tiles = self.model.as_ref()?.get_ref().tiles.as_ref()?;
            Some(("`tiles` are", tiles.span()))
        };
        let steps = || self.step.iter().find_map(|step| step.get_ref().of_version_2());
        follow.or_else(steps).or_else(tiles)
    }
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ModelTable {
    pub path: Option<PathBuf>,
    pub tiles: Option<Spanned<TileNames>>,
    pub columns: Option<String>,
    pub fingerprint: Option<String>,
}

/// A file or pattern, or several.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum TileNames {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PathTable {
    pub path: PathBuf,
}

/// A deformation, or a refinement if it has `refine`.
#[derive(Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct StepTable {
    pub title: Option<Spanned<String>>,
    pub group: Option<Spanned<String>>,
    pub enabled: Option<bool>,
    pub refine: Option<Spanned<RefineTable>>,
    pub deform: Option<String>,
    pub plugin: Option<Origin>,
    pub state_version: Option<u32>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub params: BTreeMap<Spanned<String>, toml::Value>,
    pub amount: Option<Spanned<f64>>,
    pub strokes: Option<Spanned<side_file::Reference>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub region: Vec<Spanned<RegionTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint: Vec<Spanned<Joint>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub handle: Vec<Spanned<HandleTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stroke: Vec<Spanned<Arc<Stroke>>>,
}

impl StepTable {
    fn of_version_2(&self) -> Option<(&'static str, Range<usize>)> {
        let title = self.title.as_ref().map(|title| ("`title` is", title.span()));
        let group = || self.group.as_ref().map(|group| ("`group` is", group.span()));
        let amount = || self.amount.as_ref().map(|amount| ("`amount` is", amount.span()));
        title.or_else(group).or_else(amount)
    }

    /// Whether the table has a key that only deformations have.
    pub fn deforms(&self) -> bool {
        let Self { title: _, group: _, enabled: _, refine: _, .. } = self;
        let Self { deform, plugin, state_version, params, amount, strokes, .. } = self;
        let Self { region, joint, handle, stroke, .. } = self;
        deform.is_some()
            || plugin.is_some()
            || state_version.is_some()
            || !params.is_empty()
            || amount.is_some()
            || strokes.is_some()
            || !(region.is_empty() && joint.is_empty() && handle.is_empty() && stroke.is_empty())
    }
}

#[derive(Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct RefineTable {
    pub shapes: Option<Vec<Spanned<RegionShape>>>,
    pub auto: Option<bool>,
    pub error: Option<f64>,
    pub factor: Option<f64>,
    pub samples: Option<u64>,
}

/// A table `[[region]]`: [`SessionText::region`](crate::session_text::SessionText::region) makes a
/// [`Region`](crate::step::Region) of it.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct RegionTable {
    pub(crate) role: Role,
    pub(crate) shapes: Vec<Spanned<RegionShape>>,
    pub(crate) falloff: Option<Spanned<f64>>,
    pub(crate) r#move: Option<Spanned<Motion>>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct HandleTable {
    pub id: String,
    pub r#move: Spanned<Motion>,
}
