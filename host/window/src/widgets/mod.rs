//! Widgets that egui does not have.

pub mod curve;
pub mod icons;
pub mod parameter;
pub mod values;
