//! All figures of a comparison: `compare.json`. Lengths are fractions of the diagonal of the model's
//! bounding box, and by the same names under `lengths` in the model's unit; angles are in degrees, times in
//! seconds. Two runs of the same file on one machine differ in `seconds` and `peak_memory_bytes` alone,
//! except for results of programs of the user's.

use crate::file::{CompareFile, ComparedMethod, MethodWork};
use crate::folder::FORMAT;
use crate::lengths::{Lengths, WithLengths};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use simod_core::reconstruction::transfer_error::TransferError;
use simod_core::reconstruction::{ExpectedError, Method as Reconstruction};
use simod_core::sampled_model::SampledModel;
use simod_measure::{DetailRotation, Difference, Distances, Energies, Spread, median};
use simod_model::Error;
use simod_session::deformer::{Message, Plugin};
use simod_session::params::{ParamValue, Params};
use std::path::Path;

/// A finished comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The format of this record.
    pub format: String,
    /// The program's version.
    pub simod: String,
    /// Machine on which the comparison was done.
    pub machine: MachineRecord,
    /// The model that was deformed.
    pub model: ModelRecord,
    /// The methods, in the file's order.
    pub methods: Vec<MethodRecord>,
    /// Figures of each pair of methods that were done; pairs with the first method come first.
    pub pairs: Vec<Pair>,
    /// The distance at the end of the colour scale of the pictures.
    pub color_scale: f64,
    /// The end of the colour scale in the model's unit.
    pub lengths: Lengths,
    /// The text of `compare.toml`.
    pub compare_file: String,
    /// All files of the folder.
    pub files: Vec<String>,
}

/// Figures of a method on the samples and the triangles between them; see [`simod_measure`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OnSamples {
    /// Relative change of the volume; nothing where the triangles are not closed.
    pub volume_change: Option<f64>,
    /// The volumes between the triangles and the plane of their border at rest, at rest and deformed, in
    /// cubes of the diagonal; nothing where they are closed.
    pub volume_over_border: Option<[f64; 2]>,
    /// Relative changes of the edges' lengths.
    pub edges: Spread,
    /// Relative changes of the triangles' areas.
    pub areas: Spread,
    /// Rotations of details against the smooth surface beneath, and number of folded triangles.
    pub details: DetailRotation,
    /// Energies as papers tell them, and the distribution of lengths, areas and distortions.
    pub energies: Energies,
}

/// Figures of two methods beside each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pair {
    /// Name of the method that comes first in the file.
    pub first: String,
    /// The name of the other one.
    pub second: String,
    /// The differences between the vertices of both.
    pub vertices: WithLengths<Difference>,
    /// Distances from the samples of the first method to the triangles between those of the second, and
    /// back; nothing where there are no triangles. The Hausdorff distance is the larger of the two `max`.
    pub surfaces: Option<[WithLengths<Distances>; 2]>,
}

/// Machine on which a comparison was done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MachineRecord {
    /// Name of the processor; nothing where the system does not tell.
    pub processor: Option<String>,
    /// Number of threads that worked.
    pub threads: usize,
}

/// The model that was deformed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelRecord {
    /// The file's name.
    pub name: String,
    /// The file's size.
    pub bytes: u64,
    /// Number of vertices.
    pub vertices: u64,
    /// Hash of the bytes of all vertices.
    pub fingerprint: String,
    /// Diagonal of the bounding box, in the model's unit, of which all lengths here are fractions, except
    /// those under `lengths`.
    pub diagonal: f64,
}

/// Record of a method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodRecord {
    /// Name that the user gives to the method.
    pub name: String,
    /// Beginning of the names of the method's files.
    pub file: String,
    /// `samples`, `error`, `grid`, `by` and `place`, as far as they were given.
    pub sampling: Map<String, Value>,
    /// `blended-jets` or `projected-barycentric`, or `none` where the method gives a deformed model.
    pub reconstruction: String,
    /// Source of a result that was not made by steps, as the file names it: `deformed`, `model` or `command`,
    /// and the path or the command.
    pub from: Option<(String, String)>,
    /// Deformations that were done; none where they could not even be begun.
    pub steps: Vec<DeformationRecord>,
    /// Text of the method's session, if the method is one.
    pub session: Option<String>,
    /// Figures of the method, if it was done.
    pub figures: Option<Figures>,
    /// Reason why the method was not done.
    pub error: Option<MethodFailure>,
}

/// A deformation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DeformationRecord {
    /// The plugin's id.
    pub plugin: String,
    /// The plugin's version.
    pub version: String,
    /// All parameters in effect. Points by default are `{"of_bounding_box": …}`.
    pub params: Map<String, Value>,
}

/// Reason why a method was not done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MethodFailure {
    /// Message: the fault and its place.
    pub what: String,
    /// The advice on the failure.
    pub hint: String,
}

/// Figures of a method. Figures beside other models are computed when all methods are done, and read from
/// no record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Number of samples, with those that steps appended.
    pub samples: usize,
    /// Number of triangles between the samples.
    pub triangles: usize,
    /// Times that the method took.
    pub seconds: Seconds,
    /// Peak anonymous memory of the process while the method was at work, and of the program that is the
    /// method; nothing where the system does not tell. Of several runs the largest.
    pub peak_memory_bytes: Option<u64>,
    /// Errors of the vertices against their exact images, of all vertices or some of very many; nothing
    /// where a plugin does not know the exact images.
    pub transfer_error: Option<WithLengths<TransferError>>,
    /// Expected errors of the vertices by the transfer, where samples were deformed and the transfer tells.
    pub expected_error: Option<WithLengths<ExpectedError>>,
    /// Differences of the vertices from those at rest.
    #[serde(skip_deserializing)]
    pub displacement: Option<WithLengths<Difference>>,
    /// Differences of the vertices from those of the first method that was done; nothing of that method
    /// itself.
    #[serde(skip_deserializing)]
    pub to_first: Option<WithLengths<Difference>>,
    /// Figures of the deformed samples beside those at rest; nothing where there are no triangles.
    #[serde(skip_deserializing)]
    pub on_samples: Option<OnSamples>,
    /// Figures of the model's deformed faces beside those at rest, where the model is small enough to be
    /// held.
    #[serde(skip_deserializing)]
    pub on_model: Option<OnSamples>,
    /// Number of samples around which the deformation folds the surface.
    pub folded_samples: Option<u64>,
    /// The deformed model, whatever the name of its file.
    pub result: ResultFile,
    /// Messages of the plugins.
    pub messages: Vec<String>,
}

/// A deformed model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResultFile {
    /// Size of the file.
    pub bytes: u64,
    /// The XXH3 hash of 128 bits of all its bytes.
    pub hash: String,
    /// Whether all runs gave the same bytes; nothing of a single run.
    pub repeats: Option<bool>,
}

/// Times of a method: of several runs the median of each. Work that was not done has no time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// The method's sampling, which is done once for all methods that have the same.
    pub sample: Option<f64>,
    /// Time for preparing and deforming, with the normals of the deformed samples; of a program all of its
    /// time.
    pub deform: Option<f64>,
    /// Part of that time which prepared the deformation, before the motions are known.
    pub prepare: Option<f64>,
    /// Rest of that time: deforming, once the motions are known.
    pub motion: Option<f64>,
    /// Time from the deformed samples to the finished model, with the rest geometry of the samples, which
    /// is computed once for all methods that have the same sampling. Of a single run, an equal part of the
    /// time of all methods that were transferred by the same reading of the model.
    pub reconstruct: Option<f64>,
    /// The processor's time for deforming and reconstructing, of all threads and of programs.
    pub processor: Option<f64>,
    /// The times of each run.
    pub runs: Vec<RunSeconds>,
}

/// Times of a run: see [`Seconds`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct RunSeconds {
    /// As in [`Seconds::deform`].
    pub deform: Option<f64>,
    /// As in [`Seconds::prepare`].
    pub prepare: Option<f64>,
    /// As in [`Seconds::motion`].
    pub motion: Option<f64>,
    /// As in [`Seconds::reconstruct`].
    pub reconstruct: Option<f64>,
    /// As in [`Seconds::processor`].
    pub processor: Option<f64>,
}

/// One of the times of a run.
pub(crate) type TimeOf = fn(&RunSeconds) -> Option<f64>;

impl Seconds {
    /// Times of a method, as medians of those of its runs.
    pub(crate) fn from_runs(sample: Option<f64>, runs: Vec<RunSeconds>) -> Self {
        let median = |of: TimeOf| median(runs.iter().filter_map(of).collect());
        Self {
            sample,
            deform: median(|r| r.deform),
            prepare: median(|r| r.prepare),
            motion: median(|r| r.motion),
            reconstruct: median(|r| r.reconstruct),
            processor: median(|r| r.processor),
            runs,
        }
    }

    /// Half of the difference between the slowest and the fastest run; nothing of a single run.
    pub(crate) fn spread(&self, of: TimeOf) -> Option<f64> {
        let all: Vec<f64> = self.runs.iter().filter_map(of).collect();
        let (least, most) = all.iter().fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(*t), b.max(*t)));
        (all.len() > 1).then_some(0.5 * (most - least))
    }
}

impl Comparison {
    /// Record of the methods, with the figures that are known when all methods are done.
    pub(crate) fn new(file: &CompareFile, sampled: &SampledModel, methods: Vec<MethodRecord>) -> Self {
        let source = &sampled.source;
        Self {
            format: FORMAT.to_owned(),
            simod: env!("CARGO_PKG_VERSION").to_owned(),
            machine: MachineRecord { processor: processor_name(), threads: rayon::current_num_threads() },
            model: ModelRecord {
                name: file.model.file_name().unwrap_or_default().to_string_lossy().into_owned(),
                bytes: source.bytes,
                vertices: source.vertices,
                fingerprint: source.fingerprint.clone(),
                diagonal: sampled.bounds.diagonal(),
            },
            methods,
            pairs: Vec::new(),
            color_scale: 0.0,
            lengths: Lengths::default(),
            compare_file: file.text.clone(),
            files: Vec::new(),
        }
    }

    /// The text of `compare.json`.
    pub fn to_json(&self) -> String {
        // Maps have text for keys, and numbers that are not finite become null.
        let text = serde_json::to_string_pretty(self).unwrap_or_default();
        format!("{text}\n")
    }

    /// Sets the end of the colour scale, as a fraction of the diagonal.
    pub(crate) fn set_color_scale(&mut self, end: f64) {
        self.color_scale = end;
        self.lengths = Lengths { color_scale: Some(end), ..Lengths::default() }.scaled(self.model.diagonal);
    }

    /// Methods that were done.
    pub fn done(&self) -> impl Iterator<Item = (&MethodRecord, &Figures)> {
        self.methods.iter().filter_map(|m| Some((m, m.figures.as_ref()?)))
    }

    /// Methods that could not be done.
    pub fn failed(&self) -> impl Iterator<Item = (&MethodRecord, &MethodFailure)> {
        self.methods.iter().filter_map(|m| Some((m, m.error.as_ref()?)))
    }
}

/// Name of the processor, as Linux tells it.
fn processor_name() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let mut named = text.lines().filter_map(|line| line.split_once(':'));
    let (_, name) = named.find(|(key, _)| key.trim() == "model name")?;
    Some(name.trim().to_owned()).filter(|name| !name.is_empty())
}

impl MachineRecord {
    /// Number of threads and name of the processor, in words.
    pub(crate) fn in_words(&self) -> String {
        let threads = if self.threads == 1 { "thread" } else { "threads" };
        let of = self.processor.as_ref().map_or(String::new(), |name| format!(" of {name}"));
        format!("{} {threads}{of}", self.threads)
    }
}

impl MethodRecord {
    pub(crate) fn new(method: &ComparedMethod, file: &str) -> Self {
        let given = method.sampling;
        let numbers = [
            ("samples", given.samples.map(Value::from)),
            ("error", given.error.map(Value::from)),
            ("grid", given.grid.map(Value::from)),
            ("by", given.by.map(|by| Value::from(by.name()))),
            ("place", given.place.map(|place| Value::from(place.name()))),
        ];
        let reconstruction = match method.reconstruction {
            Reconstruction::BlendedJets => "blended-jets",
            Reconstruction::ProjectedBarycentric => "projected-barycentric",
        };
        let shown = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (from, is_model) = match &method.work {
            MethodWork::Plugin { .. } | MethodWork::Session(_) => (None, false),
            MethodWork::Deformed(path) => (Some(("deformed".to_owned(), shown(path))), false),
            MethodWork::Model(path) => (Some(("model".to_owned(), shown(path))), true),
            MethodWork::Command(command) => {
                (Some(("command".to_owned(), command.line.clone())), command.makes_model())
            }
        };
        let reconstruction = if is_model { "none" } else { reconstruction };
        Self {
            name: method.name.clone(),
            file: file.to_owned(),
            from,
            sampling: numbers.into_iter().filter_map(|(key, n)| Some((key.to_owned(), n?))).collect(),
            reconstruction: reconstruction.to_owned(),
            steps: Vec::new(),
            session: None,
            figures: None,
            error: None,
        }
    }

    pub(crate) fn fail(&mut self, e: &Error) {
        self.figures = None;
        self.error = Some(MethodFailure { what: e.to_string(), hint: e.hint().to_owned() });
    }

    /// Sets the figures that are known only when all methods are done, of a model whose bounding box has
    /// the `diagonal`.
    pub(crate) fn set_shape(
        &mut self,
        (displacement, to_first): (Difference, Option<Difference>),
        diagonal: f64,
        on_samples: Option<OnSamples>,
        on_model: Option<OnSamples>,
    ) {
        if let Some(figures) = &mut self.figures {
            figures.displacement = Some(WithLengths::new(displacement, diagonal));
            figures.to_first = to_first.map(|difference| WithLengths::new(difference, diagonal));
            (figures.on_samples, figures.on_model) = (on_samples, on_model);
        }
    }
}

impl DeformationRecord {
    pub(crate) fn new((plugin, params): (&Plugin, &Params)) -> Self {
        Self {
            plugin: plugin.id().to_owned(),
            version: plugin.version().to_owned(),
            params: params.iter().map(|(id, value)| (id.to_owned(), json(value))).collect(),
        }
    }
}

pub(crate) fn words(messages: &[Message]) -> Vec<String> {
    let told = messages.iter().filter(|m| !m.is_debug());
    told.map(|m| format!("{}{}: {}", if m.is_warning() { "warning: " } else { "" }, m.plugin, m.text))
        .collect()
}

fn json(value: &ParamValue) -> Value {
    match value {
        ParamValue::Float(x) | ParamValue::Length(x) => json!(x),
        ParamValue::Int(i) => json!(i),
        ParamValue::Bool(b) => json!(b),
        ParamValue::Choice(id) => json!(id),
        ParamValue::Direction(v) | ParamValue::Point(v) => json!(v.to_array()),
        ParamValue::PointInBox(v) => json!({ "of_bounding_box": v.to_array() }),
        ParamValue::Colour(c) => json!(c),
        ParamValue::Curve(points) => json!(points),
        ParamValue::File(path) => json!(path.as_ref().map(|p| p.display().to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_several_runs_the_middle_counts() {
        let run = |deform: f64| RunSeconds { deform: Some(deform), ..RunSeconds::default() };
        let seconds = Seconds::from_runs(Some(2.0), [5.0, 1.0, 3.0].map(run).to_vec());
        assert_eq!((seconds.sample, seconds.deform, seconds.reconstruct), (Some(2.0), Some(3.0), None));
        assert_eq!(seconds.spread(|r| r.deform), Some(2.0));
        assert_eq!(Seconds::from_runs(None, [1.0, 2.0].map(run).to_vec()).deform, Some(1.5));
        assert_eq!(Seconds::from_runs(None, vec![run(1.0)]).spread(|r| r.deform), None);
    }
}
