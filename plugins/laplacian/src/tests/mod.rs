//! The whole plugin, on generated models.

mod cost;
mod interactive;
mod meaning;
mod reference;
pub mod scene;
mod surfaces;
