//! Brush strokes, as sessions have them.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A brush stroke.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Stroke {
    /// The radius of the brush, in the model's unit; above 0.
    pub radius: f64,
    /// 1 is full strength, negative ones do the opposite.
    #[serde(default = "full_strength")]
    pub strength: f64,
    /// The stroke's path, model coordinates.
    #[serde(deserialize_with = "crate::vector::threes")]
    pub points: Vec<DVec3>,
    /// The pen's pressure at each point, 0 to 1; none where there was no pen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pressures: Vec<f32>,
    /// The parameters that differ from the step's.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub params: toml::Table,
}

impl Stroke {
    /// Defect of the stroke and advice, if it has a defect.
    pub fn defect(&self) -> Option<(&'static str, &'static str)> {
        if !(self.radius > 0.0 && self.radius.is_finite()) {
            Some(("the radius of a stroke is not positive", "give a length in the model's unit"))
        } else if !(self.strength.is_finite() && self.points.iter().all(|p| p.is_finite())) {
            Some(("a stroke has a number that is not finite", "correct the stroke"))
        } else if self.points.is_empty() {
            Some(("the stroke has no point", "give at least one in `points`"))
        } else if ![0, self.points.len()].contains(&self.pressures.len()) {
            Some(("there is not one pressure for each point of a stroke", "give as many, or none"))
        } else if !self.pressures.iter().all(|p| (0.0..=1.0).contains(p)) {
            Some(("a pressure of a stroke is not from 0 to 1", "correct the stroke"))
        } else {
            None
        }
    }
}

fn full_strength() -> f64 {
    1.0
}
