//! Parts of the model in full: asked for, streamed again once the edit rests, and shown in the place of
//! samples.

use super::State;
use super::full::{Preview, StreamedDetail};
use super::open::nothing_open;
use crate::detail::{Detail, Previewed};
use crate::engine::{Job, SamplePose};
use rayon::prelude::*;
use simod_core::detail::{DetailBatch, DetailRequest, ENOUGH, Streamed};
use simod_model::Result;

/// Number of samples around a seen one whose vertices may be seen, too.
const RING: usize = 8;

impl State {
    /// Vertices that are shown in full, if any are.
    pub fn detail(&self) -> Option<&Detail> {
        self.preview.detail.as_ref()
    }

    /// Figures of the last stream of vertices, and its time in seconds.
    pub fn streamed(&self) -> Option<(Streamed, f64)> {
        self.preview.last
    }

    /// Whether vertices are on their way.
    pub fn is_streaming(&self) -> bool {
        self.preview.streaming.is_some()
    }

    pub(super) fn preview(&mut self, what: Previewed) -> Result<()> {
        let open = self.open.as_ref().ok_or_else(nothing_open)?;
        let scene = open.scene.clone();
        let marks = match what {
            Previewed::Nothing => {
                self.end_preview();
                return Ok(());
            }
            Previewed::Selection => self.selection.marks().to_vec(),
            Previewed::Seen => {
                let neighbours = scene.sampled.samples.neighbours();
                let seen = self.depth(&scene).seen(&scene);
                let ring = RING.min(neighbours.k());
                let near =
                    |i: usize| seen[i] || neighbours.nearest_to(i)[..ring].iter().any(|j| seen[*j as usize]);
                (0..seen.len()).into_par_iter().map(near).collect()
            }
        };
        let chosen = DetailRequest::select(&scene.sampled, &marks, ENOUGH)?;
        let pose = SamplePose { sampled: scene.sampled.clone(), positions: scene.positions.clone() };
        let tint = self.tint();
        let preview = &mut self.preview;
        match &mut preview.detail {
            Some(detail) => detail.choose(what, chosen),
            None => preview.detail = Some(Detail::new(what, chosen, pose, tint)),
        }
        preview.stopped = false;
        self.stream_missing();
        Ok(())
    }

    /// Changes the colour values of the vertices in full, which may have to be streamed again for that.
    pub(super) fn tint_detail(&mut self) {
        let tint = self.tint();
        if let Some(detail) = &mut self.preview.detail
            && detail.tint_by(tint)
        {
            self.stream_missing();
        }
    }

    /// Shows samples everywhere.
    pub(super) fn end_preview(&mut self) {
        self.preview = Preview::default();
        self.engine.forget_preview();
    }

    /// Takes the samples' new positions: vertices that were streamed may be stale, and are streamed again
    /// once the edit rests.
    pub(super) fn follow_samples(&mut self) {
        let Some(scene) = self.open.as_ref().map(|open| open.scene.clone()) else { return };
        let pose = SamplePose { sampled: scene.sampled.clone(), positions: scene.positions.clone() };
        if let Some(detail) = &mut self.preview.detail {
            detail.follow(pose);
            self.stream_missing();
        }
    }

    /// Has the vertices streamed that are wanted and missing, if the edit rests.
    pub(super) fn stream_missing(&mut self) {
        let rests = self.is_settled() && self.stroke.is_none() && !self.preview.stopped;
        let (Some(open), Some(detail)) = (&self.open, &self.preview.detail) else { return };
        let missing = detail.missing();
        if !rests || missing.cells.is_empty() {
            if self.preview.streaming.take().is_some() {
                self.engine.pause_preview();
            }
            return;
        }
        let pose =
            SamplePose { sampled: open.scene.sampled.clone(), positions: open.scene.positions.clone() };
        let (stride, tint) = (missing.stride, detail.tint());
        let model = open.editor.model().map(std::path::Path::to_owned);
        let request = self.engine.preview(pose.clone(), missing, tint, model);
        self.preview.streaming = Some(StreamedDetail { request, pose, stride, tint });
    }

    /// Takes vertices that have come.
    pub(super) fn take_detail(&mut self, request: u64, batch: DetailBatch) {
        let Preview { detail, streaming, .. } = &mut self.preview;
        if let (Some(detail), Some(streaming)) = (detail, streaming)
            && streaming.request == request
        {
            detail.take(batch, streaming.stride, streaming.tint, &streaming.pose);
        }
    }

    /// Notes that all vertices that were asked for have come.
    pub(super) fn take_streamed(&mut self, request: u64, report: Streamed, seconds: f64) {
        if self.preview.streaming.take_if(|streaming| streaming.request == request).is_some() {
            self.preview.last = Some((report, seconds));
        }
    }

    /// Notes that the preview failed or was stopped, and is not tried again until somebody asks.
    pub(super) fn stop_preview(&mut self) {
        if !self.engine.wants(Job::Preview) && self.engine.activity(Job::Preview).is_none() {
            self.preview.streaming = None;
            self.preview.stopped = true;
        }
    }

    /// Stops the preview for the user.
    pub(super) fn cancel_preview(&mut self) {
        self.preview.streaming = None;
        self.preview.stopped = true;
    }
}
