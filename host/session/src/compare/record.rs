//! All that a comparison found: `compare.json`. Lengths are fractions of the diagonal of the model's bounding
//! box, angles in degrees, times in seconds. Two runs of the same file differ in `seconds` and
//! `peak_memory_bytes` alone.

use super::figures::{OnSamples, Pair};
use super::file::{CompareFile, Method};
use super::folder::FORMAT;
use crate::deformer::{Message, Plugin};
use crate::params::{ParamValue, Params};
use serde::Serialize;
use serde_json::{Map, Value, json};
use simod_core::reconstruction::Method as Reconstruction;
use simod_core::reconstruction::transfer_error::TransferError;
use simod_core::sampled_model::SampledModel;
use simod_measure::Difference;
use simod_model::Error;

/// A finished comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The format of this record.
    pub format: String,
    /// The program's version.
    pub simod: String,
    /// What was deformed.
    pub model: ModelRecord,
    /// The methods, in the file's order.
    pub methods: Vec<MethodRecord>,
    /// Each two methods that were done; those with the first one come first.
    pub pairs: Vec<Pair>,
    /// The distance at the end of the colour scale of the pictures.
    pub color_scale: f64,
    /// The text of `compare.toml`.
    pub compare_file: String,
    /// All files of the folder.
    pub files: Vec<String>,
}

/// What was deformed.
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
    /// Of the bounding box, in the model's unit: the unit of all lengths here.
    pub diagonal: f64,
}

/// A method and what it did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MethodRecord {
    /// What the user calls it.
    pub name: String,
    /// What its files begin with.
    pub file: String,
    /// `samples`, `error`, `grid`, `by` and `place`, as far as they were given.
    pub sampling: Map<String, Value>,
    /// `blended-jets` or `projected-barycentric`.
    pub reconstruction: String,
    /// The deformations that were done; none where they could not even be begun.
    pub steps: Vec<StepRecord>,
    /// The text of its session, if it is one.
    pub session: Option<String>,
    /// What came of it, if it was done.
    pub figures: Option<Figures>,
    /// Why it was not done.
    pub error: Option<Failure>,
}

/// A deformation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepRecord {
    /// The plugin's id.
    pub plugin: String,
    /// The plugin's version.
    pub version: String,
    /// All parameters in effect. Points by default are `{"of_bounding_box": …}`.
    pub params: Map<String, Value>,
}

/// Why a method was not done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Failure {
    /// What is wrong, and where.
    pub what: String,
    /// What to do.
    pub hint: String,
}

/// What came of a method.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Number of samples, with those that steps appended.
    pub samples: usize,
    /// Number of triangles between them.
    pub triangles: usize,
    /// How long it took.
    pub seconds: Seconds,
    /// Peak anonymous memory of the process while the method was at work; nothing where the system does not
    /// tell.
    pub peak_memory_bytes: Option<u64>,
    /// All vertices beside their exact images; nothing where a plugin does not know these.
    pub transfer_error: Option<TransferError>,
    /// The vertices beside those at rest.
    pub displacement: Option<Difference>,
    /// The deformed samples beside those at rest; nothing where there are no triangles.
    pub on_samples: Option<OnSamples>,
    /// Samples around which the deformation folds the surface.
    pub folded_samples: Option<u64>,
    /// What the plugins had to say.
    pub messages: Vec<String>,
}

/// How long a method took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Seconds {
    /// Its sampling, which is done once for all methods that have the same.
    pub sample: f64,
    /// Preparing and deforming, with the normals of the deformed samples.
    pub deform: f64,
    /// From the deformed samples to the finished model.
    pub reconstruct: f64,
}

impl Comparison {
    /// As far as it is known when all methods are done.
    pub(super) fn new(file: &CompareFile, sampled: &SampledModel, methods: Vec<MethodRecord>) -> Self {
        let source = &sampled.source;
        Self {
            format: FORMAT.to_owned(),
            simod: env!("CARGO_PKG_VERSION").to_owned(),
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
            compare_file: file.text.clone(),
            files: Vec::new(),
        }
    }

    /// As `compare.json` has it.
    pub fn to_json(&self) -> String {
        // Maps have text for keys, and numbers that are not finite become null.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Methods that were done.
    pub fn done(&self) -> impl Iterator<Item = (&MethodRecord, &Figures)> {
        self.methods.iter().filter_map(|m| Some((m, m.figures.as_ref()?)))
    }

    /// Methods that could not be done.
    pub fn failed(&self) -> impl Iterator<Item = (&MethodRecord, &Failure)> {
        self.methods.iter().filter_map(|m| Some((m, m.error.as_ref()?)))
    }
}

impl MethodRecord {
    pub(super) fn new(method: &Method, file: &str) -> Self {
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
        Self {
            name: method.name.clone(),
            file: file.to_owned(),
            sampling: numbers.into_iter().filter_map(|(key, n)| Some((key.to_owned(), n?))).collect(),
            reconstruction: reconstruction.to_owned(),
            steps: Vec::new(),
            session: None,
            figures: None,
            error: None,
        }
    }

    pub(super) fn fail(&mut self, e: &Error) {
        self.figures = None;
        self.error = Some(Failure { what: e.to_string(), hint: e.hint().to_owned() });
    }

    pub(super) fn set_displacement(&mut self, displacement: Difference) {
        if let Some(figures) = &mut self.figures {
            figures.displacement = Some(displacement);
        }
    }
}

impl StepRecord {
    pub(super) fn new((plugin, params): (&Plugin, &Params)) -> Self {
        Self {
            plugin: plugin.id().to_owned(),
            version: plugin.version().to_owned(),
            params: params.iter().map(|(id, value)| (id.to_owned(), json(value))).collect(),
        }
    }
}

pub(super) fn words(messages: &[Message]) -> Vec<String> {
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
