//! A brush stroke while it is drawn: shown, but not yet one of the steps'.

use super::State;
use super::open_stroke::OpenStroke;
use glam::DVec3;
use simod_model::{Error, Result};
use simod_plugin_api::Effort;
use simod_session::edit::Change;
use simod_session::step::Stroke;
use std::sync::Arc;

fn none() -> simod_model::Error {
    Error::argument("no stroke was begun", "put the brush on the surface first")
}

impl State {
    pub(super) fn begin_stroke(
        &mut self,
        step: usize,
        radius: f64,
        strength: f64,
        params: toml::Table,
    ) -> Result<()> {
        self.deformation(step)?;
        let stroke = Stroke { radius, strength, points: Vec::new(), pressures: Vec::new(), params };
        // The stroke is checked as with one point, which it does not have yet.
        let some = Stroke { points: vec![DVec3::ZERO], ..stroke.clone() };
        if let Some((what, hint)) = some.defect() {
            return Err(Error::argument(what, hint));
        }
        self.stroke = Some(OpenStroke { step: self.entry(step)?.id, stroke });
        Ok(())
    }

    pub(super) fn stroke_point(&mut self, at: DVec3, pressure: Option<f32>) -> Result<()> {
        let OpenStroke { stroke, .. } = self.stroke.as_mut().ok_or_else(none)?;
        if !at.is_finite() || pressure.is_some_and(|p| !(0.0..=1.0).contains(&p)) {
            return Err(Error::argument("a point of a stroke makes no sense", "give finite numbers"));
        }
        // Pressures are for all points or none: those without are at full pressure.
        if pressure.is_some() || !stroke.pressures.is_empty() {
            stroke.pressures.resize(stroke.points.len(), 1.0);
            stroke.pressures.push(pressure.unwrap_or(1.0));
        }
        stroke.points.push(at);
        self.request(Effort::DRAFT);
        Ok(())
    }

    pub(super) fn end_stroke(&mut self) -> Result<()> {
        let OpenStroke { step, stroke } = self.stroke.take().ok_or_else(none)?;
        let at = self.open()?.steps().iter().position(|entry| entry.id == step);
        let gone = || Error::argument("the step of the stroke is gone", "undo its removal, and draw again");
        let result = at.ok_or_else(gone).and_then(|at| self.change(at, Change::AddStroke(Arc::new(stroke))));
        if result.is_err() {
            self.request(Effort::FULL);
        }
        result
    }

    pub(super) fn drop_stroke(&mut self) -> Result<()> {
        self.stroke.take().ok_or_else(none)?;
        self.request(Effort::FULL);
        Ok(())
    }

    /// Whether a stroke is being drawn.
    pub fn is_drawing(&self) -> bool {
        self.stroke.is_some()
    }
}
