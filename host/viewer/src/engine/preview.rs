//! Thread that streams vertices of the model to be seen, so that the edit goes on meanwhile.

use super::requests::{Event, Job, SamplePose, Streaming};
use super::shared::SharedState;
use super::thread::{Teller, guarded};
use super::watch::JobWatch;
use crate::tint::Tint;
use simod_core::colors;
use simod_core::detail::{self, DetailAttributes};
use simod_core::reconstruction::{DeformationField, Method, RestGeometry};
use simod_model::{Progress, Result};
use std::cell::OnceCell;
use std::sync::{Arc, PoisonError};
use std::time::Instant;

/// The task that comes next.
enum PreviewTask {
    Stream(Streaming, Arc<JobWatch>),
    /// Lets go of the rest geometry and colours of the samples, which are not needed any more.
    Forget,
}

/// The thread.
pub(super) struct PreviewThread {
    pub shared: Arc<SharedState>,
    pub tell: Teller,
}

impl PreviewThread {
    pub fn run(self) {
        let mut next = self.next();
        while let Some(task) = next {
            next = match task {
                PreviewTask::Stream(streaming, watch) => self.stream_all(streaming, watch),
                PreviewTask::Forget => self.next(),
            };
        }
    }

    /// Waits for a task; nothing once the window is closed.
    fn next(&self) -> Option<PreviewTask> {
        let mut inner = self.shared.lock();
        loop {
            let (wanted, running) = &mut *inner;
            if wanted.end {
                return None;
            }
            if std::mem::take(&mut wanted.forget) {
                return Some(PreviewTask::Forget);
            }
            if let Some(streaming) = wanted.preview.take() {
                let watch = Arc::new(JobWatch::new(self.tell.wake()));
                running.begin(Job::Preview, &watch);
                return Some(PreviewTask::Stream(streaming, watch));
            }
            inner = self.shared.changed.wait(inner).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Streams for all poses of the same samples, whose rest geometry is computed once. Returns the next
    /// task.
    fn stream_all(&self, mut streaming: Streaming, mut watch: Arc<JobWatch>) -> Option<PreviewTask> {
        let sampled = streaming.pose.sampled.clone();
        let (around, colors) = (OnceCell::new(), OnceCell::new());
        loop {
            let done = guarded(|| {
                let around = || around.get_or_init(|| RestGeometry::new(&sampled.samples));
                self.stream(streaming, around, &colors, &*watch)
            });
            let event = done.unwrap_or_else(|error| Event::Failed { job: Job::Preview, error });
            self.tell.end(Job::Preview, &watch, Some(event));
            (streaming, watch) = match self.next()? {
                PreviewTask::Stream(next, watch) if Arc::ptr_eq(&next.pose.sampled, &sampled) => {
                    (next, watch)
                }
                other => return Some(other),
            };
        }
    }

    fn stream<'a>(
        &self,
        streaming: Streaming,
        around: impl FnOnce() -> &'a RestGeometry<'a>,
        colors: &OnceCell<DetailAttributes>,
        progress: &dyn Progress,
    ) -> Result<Event> {
        let Streaming { number, pose: SamplePose { sampled, positions }, chosen, tint, model } = streaming;
        let start = Instant::now();
        let model = sampled.open_source(model.as_deref(), progress)?;
        let chosen = chosen.showing(match tint {
            Tint::Samples => DetailAttributes::Nothing,
            Tint::Attribute(place) => DetailAttributes::Attribute(place),
            Tint::Own => match colors.get() {
                Some(known) => *known,
                None => {
                    let found = colors::ColorBytes::for_model(model.as_ref())?.map(|bytes| bytes.meaning());
                    let shown = found.map_or(DetailAttributes::Nothing, |(colors, scale)| {
                        DetailAttributes::Colors(colors, scale)
                    });
                    *colors.get_or_init(|| shown)
                }
            },
        });
        let each = |batch| {
            self.tell.send(Event::Detail { request: number, batch: Box::new(batch) });
            progress.check()
        };
        progress.begin("preparing", 0);
        // Positions are rounded as when the model is written.
        let deformed = sampled.rounded(&positions);
        let report = if *positions == *sampled.samples.positions {
            detail::stream(&sampled, model.as_ref(), &chosen, None, progress, each)?
        } else {
            let field = DeformationField::from_deformed(around(), &deformed, Method::default());
            progress.check()?;
            detail::stream(&sampled, model.as_ref(), &chosen, Some(&field), progress, each)?
        };
        Ok(Event::Streamed { request: number, report, seconds: start.elapsed().as_secs_f64() })
    }
}
