//! simod-session: plugins, the stack of deformations, and session files.
//!
//! ```text
//! session.toml ──SessionFile::load──▶ steps ──deform(P_S)──▶ DeformedSamples: P_S*, and the
//!            plugin folders ──PluginRegistry::discover──┘    PreparedStack for any point
//! ```
//!
//! Model coordinates are double precision and in the model's unit; plugins see *local* ones (see
//! [`Frame`](simod_model::frame::Frame)). The translation between both happens in [`stack`] alone; foreign
//! code is called in [`deformer`] alone.

pub mod child;
pub mod deformed_samples;
pub mod deformer;
pub mod edit;
pub mod key;
pub mod migration;
pub mod motion;
mod other_model;
pub mod params;
mod picked;
pub mod pipeline;
pub mod plan;
pub mod plugins;
mod recorded;
pub mod refining;
pub mod session_file;
mod session_layout;
mod session_tables;
pub mod session_text;
pub mod session_writer;
pub mod shapes;
mod side_file;
pub mod sidecar;
pub mod stack;
pub mod step;
mod stroke;
mod strokes_file;
pub mod tolerance;
pub mod vector;
#[cfg(unix)]
pub mod worker;

pub use deformed_samples::{DeformedSamples, deform};
pub use deformer::{Capabilities, Code, Message, Migration, OwnHandles, Plugin, is_raw};
pub use motion::Motion;
pub use params::{ParamValue, Params, describe_params, param_data};
pub use picked::PickedPoints;
pub use pipeline::{ExactCost, Run, Running};
pub use plugins::{Isolation, PluginOptions, PluginRegistry, Rejected};
pub use session_file::SessionFile;
pub use shapes::{RegionShape, Shapes};
pub use stack::{PreparedStack, Stack};
pub use tolerance::{Certificate, Tolerance};
