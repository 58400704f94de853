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

/// Kinds of jobs: at most one of each kind runs at a time.
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

/// Model or session that is to be opened.
#[derive(Debug, Clone, PartialEq)]
pub struct Opening {
    /// A model, the folder of a sampled one, or a session.
    pub path: PathBuf,
    /// Fineness with which a model is sampled.
    pub sampling: SamplingTable,
    /// Whether the edit that was kept against a crash is taken, if there is one.
    pub recover: bool,
    /// Path of the model, if it was moved.
    pub model: Option<PathBuf>,
}

/// Output of the deformed model.
#[derive(Debug, Clone, PartialEq)]
pub struct WriteRequest {
    /// The file.
    pub output: PathBuf,
    /// Path of the model, if it was moved since it was sampled.
    pub model: Option<PathBuf>,
    /// Attributes that turn with the surface besides normals.
    pub follow: Follow,
    /// Method of the reconstruction.
    pub method: Method,
    /// Treatment of the model's normals.
    pub normals: Normals,
}

/// Steps to be done.
pub(super) struct StepsRequest {
    pub number: u64,
    pub steps: Arc<[Entry]>,
    pub effort: Effort,
    pub extra: Extra,
}

/// Part of a scene that takes its time to compute, and is wanted in addition.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Extra {
    /// Nothing.
    #[default]
    Nothing,
    /// The error to be expected between the samples.
    ExpectedError,
    /// The [attributes](simod_core::sampled_model::SampledModel::attributes) of the samples, with the
    /// model's path if it was moved since it was sampled.
    Attributes(Option<PathBuf>),
}

/// Vertices to be streamed.
pub(super) struct Streaming {
    pub number: u64,
    pub pose: SamplePose,
    pub chosen: DetailRequest,
    /// Colour values that come with the vertices.
    pub tint: Tint,
    /// Path of the model, if it was moved since it was sampled.
    pub model: Option<PathBuf>,
}

/// Samples at rest and at other positions, by which vertices are carried over.
#[derive(Clone)]
pub struct SamplePose {
    /// The samples at rest.
    pub sampled: Arc<SampledModel>,
    /// The samples' positions.
    pub positions: Arc<[Vec3]>,
}

impl SamplePose {
    /// Whether the pose is the very same one in memory; other poses may be equal nevertheless.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.sampled, &other.sampled) && Arc::ptr_eq(&self.positions, &other.positions)
    }
}

/// Request for another version.
#[derive(Clone)]
pub struct ComparisonRequest {
    /// The version's number, which comes back with the result.
    pub number: u64,
    /// The version's steps.
    pub steps: Arc<[Entry]>,
    /// The version's samples, if they are known already.
    pub scene: Option<Arc<ViewerScene>>,
    /// Whether a step that cannot be done makes the version worthless.
    pub whole: bool,
    /// Whether the error to be expected is wanted, too.
    pub measure: bool,
    /// Other samples of the model, whose positions in this version are wanted.
    pub onto: Option<Arc<SampledModel>>,
}

/// Model with another version's samples, and the positions to which a version carries them.
#[derive(Clone)]
pub struct CarriedSamples {
    /// The model with these samples.
    pub sampled: Arc<SampledModel>,
    /// Positions of the samples, one for each, in local coordinates.
    pub positions: Arc<[Vec3]>,
}

/// Outcome of a request.
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
        /// Positions of the other version's samples, if they were asked for.
        carried: Option<CarriedSamples>,
    },
    /// The deformed model was written.
    Written {
        /// The file.
        output: PathBuf,
        /// The report on the model.
        report: Box<Reconstructed>,
        /// Seconds that the writing took.
        seconds: f64,
    },
    /// Some vertices of the model are there to be seen.
    Detail {
        /// The number of the request for them.
        request: u64,
        /// The vertices.
        batch: Box<DetailBatch>,
    },
    /// All vertices that were asked for are there.
    Streamed {
        /// The number of the request.
        request: u64,
        /// Number of vertices, and of bytes that were read.
        report: Streamed,
        /// Seconds that the stream took.
        seconds: f64,
    },
    /// Something that the user should know.
    Note(String),
    /// A job failed; the state before still holds. Of kind [`Cancelled`](simod_model::ErrorKind::Cancelled)
    /// if the user stopped the job.
    Failed {
        /// The job that failed.
        job: Job,
        /// Reason of the failure.
        error: Error,
    },
}

impl Event {
    /// Whether the event is the outcome of a model that was to be opened.
    pub(super) fn ends_opening(&self) -> bool {
        matches!(self, Self::Opened(_) | Self::Failed { job: Job::Open, .. })
    }
}
