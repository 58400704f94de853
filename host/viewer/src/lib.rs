//! simod-viewer: the parts of an editor for models that need no window.
//!
//! ```text
//! window ──Command──▶ State::apply ──steps──▶ Engine (its thread) ──Event──▶ State::poll ──▶ Scene, to be drawn
//! ```
//!
//! The state changes through [`Command`]s alone, so a whole edit can be recorded and replayed without a
//! window; and the events of the thread that does the steps only give the samples' positions. No file that
//! this crate writes differs from the one that `simod run` makes of the saved session.

mod appended;
pub mod body;
pub mod camera;
mod clip;
pub mod command;
pub mod detail;
pub mod engine;
mod gradients;
pub mod held;
pub mod measured;
pub mod motion;
pub mod navigation;
pub mod overlay;
pub mod pick;
pub mod record;
mod replay;
pub mod scene;
pub mod selection;
pub mod shading;
pub mod skeleton;
pub mod state;
mod tint;
pub mod transform;

pub use camera::Camera;
pub use clip::Clip;
pub use command::Command;
pub use detail::{Detail, Previewed};
pub use engine::{Engine, Event};
pub use navigation::Navigation;
pub use overlay::Overlay;
pub use pick::Hit;
pub use replay::replay;
pub use scene::ViewerScene;
pub use selection::Selection;
pub use state::{ComparedVersion, State};
pub use tint::Tint;
