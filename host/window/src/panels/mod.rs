//! The panels around the picture, and over it.

pub mod clip;
mod detail;
mod film;
pub mod floating;
mod frames;
mod groups;
mod keys;
pub mod legend;
pub mod lesson;
pub mod menu;
pub mod over;
mod palette;
mod parameters;
mod parts;
mod picture;
mod pinned;
pub mod progress;
mod prompt;
mod questions;
mod refinement;
mod regions;
mod render;
mod report;
mod rows;
pub mod side;
pub mod status;
mod steps;
mod strokes;
mod toasts;
pub mod tools;
mod turntable;
pub mod welcome;

pub use crate::numbers::{ago, count, duration, number};
pub use frames::card;

use crate::window::Window;

/// The diagonal of the model's bounding box, in the model's unit; nothing without a model.
fn diagonal(window: &Window) -> Option<f64> {
    window.state().scene().map(|scene| scene.sampled.bounds.diagonal())
}
