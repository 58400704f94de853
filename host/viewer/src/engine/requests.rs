//! Requests to the engine, and its answers.

use crate::scene::ViewerScene;
use crate::tint::Tint;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use simod_core::detail::{DetailBatch, DetailRequest, Streamed};
use simod_core::reconstruction::{Method, Normals, Reconstructed};
use simod_core::sampled_model::SampledModel;
use simod_model::Error;
use simod_model::follow::Follow;
use simod_plugin_api::Effort;
use simod_session::edit::{Editor, Entry};
use simod_session::session_file::SamplingTable;
use std::path::PathBuf;
use std::sync::Arc;

/// The jobs that there are: at most one of each runs at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Job {
    /// A model is read and sampled.
    Open,
    /// Steps are done.
    Evaluate,
    /// The deformed model is written.
    Write,
    /// Vertices are streamed to be seen.
    Preview,
    /// Another version is made, to be compared with.
    Compare,
}

impl Job {
    /// All jobs, in the order of their numbers.
    pub const ALL: [Self; 5] = [Self::Open, Self::Evaluate, Self::Write, Self::Preview, Self::Compare];
}

/// What is to be opened.
#[derive(Debug, Clone, PartialEq)]
pub struct Opening {
    /// A model, the folder of a sampled one, or a session.
    pub path: PathBuf,
    /// How finely a model is sampled.
    pub sampling: SamplingTable,
    /// Takes what was kept of it against a crash, if there is something.
    pub recover: bool,
    /// Where the model is, if it was moved.
    pub model: Option<PathBuf>,
}

/// How the deformed model is written.
#[derive(Debug, Clone, PartialEq)]
pub struct WriteRequest {
    /// The file.
    pub output: PathBuf,
    /// The model, if it was moved since it was sampled.
    pub model: Option<PathBuf>,
    /// What turns with the surface besides normals.
    pub follow: Follow,
    /// How vertices are carried over.
    pub method: Method,
    /// What becomes of the model's normals.
    pub normals: Normals,
}

/// Steps to be done.
pub(super) struct StepsRequest {
    pub number: u64,
    pub steps: Arc<[Entry]>,
    pub effort: Effort,
    pub extra: Extra,
}

/// A part of a scene that takes its time, and is wanted besides.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Extra {
    /// Nothing.
    #[default]
    Nothing,
    /// The error to be expected between the samples.
    ExpectedError,
    /// The [attributes](simod_core::sampled_model::SampledModel::attributes) of the samples, by the model, if
    /// it was moved since it was sampled.
    Attributes(Option<PathBuf>),
}

/// Vertices to be streamed.
pub(super) struct Streaming {
    pub number: u64,
    pub pose: SamplePose,
    pub chosen: DetailRequest,
    /// What the vertices are coloured by.
    pub tint: Tint,
    /// The model, if it was moved since it was sampled.
    pub model: Option<PathBuf>,
}

/// Samples somewhere: what vertices are carried over by.
#[derive(Clone)]
pub struct SamplePose {
    /// The samples at rest.
    pub sampled: Arc<SampledModel>,
    /// The samples' positions.
    pub positions: Arc<[Vec3]>,
}

impl SamplePose {
    /// Whether it is the very same; others may be equal nevertheless.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.sampled, &other.sampled) && Arc::ptr_eq(&self.positions, &other.positions)
    }
}

/// What is wanted of another version.
#[derive(Clone)]
pub struct ComparisonRequest {
    /// The version's number, which comes back with the result.
    pub number: u64,
    /// The version's steps.
    pub steps: Arc<[Entry]>,
    /// The version's samples, if they are known already.
    pub scene: Option<Arc<ViewerScene>>,
    /// Whether a step that cannot be done makes it worthless.
    pub whole: bool,
    /// Whether the error to be expected is wanted, too.
    pub measure: bool,
    /// Other samples of the model, of which it is wanted where this version has them.
    pub onto: Option<Arc<SampledModel>>,
}

/// The model with another version's samples, and where a version carries them.
#[derive(Clone)]
pub struct CarriedSamples {
    /// The model with these samples.
    pub sampled: Arc<SampledModel>,
    /// Where they are, one for each: local positions.
    pub positions: Arc<[Vec3]>,
}

/// What became of a request.
pub enum Event {
    /// A model is there, with its samples at rest.
    Opened(Box<(Editor, ViewerScene)>),
    /// Steps were done.
    Evaluated {
        /// The number of the request.
        request: u64,
        /// The scene, with the samples' places.
        scene: Box<ViewerScene>,
    },
    /// Another version is there.
    Compared {
        /// The version's number, as it was asked for.
        number: u64,
        /// The version's samples.
        scene: Arc<ViewerScene>,
        /// Where it has the others that were asked for.
        carried: Option<CarriedSamples>,
    },
    /// The deformed model was written.
    Written {
        /// The file.
        output: PathBuf,
        /// The report on the model.
        report: Box<Reconstructed>,
        /// The time that it took.
        seconds: f64,
    },
    /// Some vertices of the model are there to be seen.
    Detail {
        /// The number of the request for them.
        request: u64,
        /// The vertices.
        batch: Box<DetailBatch>,
    },
    /// All vertices are that were asked for.
    Streamed {
        /// The number of the request.
        request: u64,
        /// How many, and what was read.
        report: Streamed,
        /// The time that it took.
        seconds: f64,
    },
    /// Something that the user should know.
    Note(String),
    /// A job came to nothing; what was there before still holds. Of kind
    /// [`Cancelled`](simod_model::ErrorKind::Cancelled) if the user stopped it.
    Failed {
        /// The job that failed.
        job: Job,
        /// Why.
        error: Error,
    },
}

impl Event {
    /// Whether it says what became of a model that was to be opened.
    pub(super) fn ends_opening(&self) -> bool {
        matches!(self, Self::Opened(_) | Self::Failed { job: Job::Open, .. })
    }
}
