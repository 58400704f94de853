//! The whole plugin, on generated models.

mod cost;
mod reference;
mod scene;
