//! The whole plugin, as the host calls it.

mod meaning;
mod reference;
mod refused;
mod scene;
mod solids;
