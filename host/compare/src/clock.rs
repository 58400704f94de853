//! The time for which deformations are prepared, told by the stages of their progress.

use simod_model::progress::Emerging;
use simod_model::{Progress, Result};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Passes progress on, and counts the time of stages that prepare.
pub(crate) struct Clock<'a> {
    progress: &'a dyn Progress,
    state: Mutex<ClockState>,
}

#[derive(Default)]
struct ClockState {
    /// Time since when something is being prepared.
    since: Option<Instant>,
    before: Duration,
}

impl ClockState {
    fn stop(&mut self) {
        self.before += self.since.take().map_or(Duration::ZERO, |since| since.elapsed());
    }
}

impl<'a> Clock<'a> {
    /// A clock that stands at zero.
    pub fn new(progress: &'a dyn Progress) -> Self {
        Self { progress, state: Mutex::default() }
    }

    /// Seconds of all stages that prepare.
    pub fn preparing(&self) -> f64 {
        let mut state = self.state();
        state.stop();
        state.before.as_secs_f64()
    }

    fn state(&self) -> MutexGuard<'_, ClockState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Clock<'_> {
    fn begin(&self, stage: &'static str, total_bytes: u64) {
        self.state().stop();
        self.progress.begin(stage, total_bytes);
    }

    fn begin_preparation(&self, stage: &'static str, total_bytes: u64) {
        let mut state = self.state();
        state.since.get_or_insert_with(Instant::now);
        drop(state);
        self.progress.begin_preparation(stage, total_bytes);
    }

    fn advance(&self, bytes: u64) {
        self.progress.advance(bytes);
    }

    fn is_cancelled(&self) -> bool {
        self.progress.is_cancelled()
    }

    fn note(&self, text: &str) {
        self.progress.note(text);
    }

    fn emerge(&self, samples: &Emerging<'_>) {
        self.progress.emerge(samples);
    }

    fn check(&self) -> Result<()> {
        self.progress.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::progress::Silent;

    #[test]
    fn stages_that_prepare_count() {
        let (clock, start) = (Clock::new(&Silent), Instant::now());
        let wait = || std::thread::sleep(Duration::from_millis(30));
        clock.begin("a", 0);
        wait();
        clock.begin_preparation("b", 0);
        wait();
        clock.begin_preparation("c", 0);
        wait();
        clock.begin("d", 0);
        wait();
        let found = clock.preparing();
        assert!(found >= 0.06 && start.elapsed().as_secs_f64() - found >= 0.06, "{found}");
        assert_eq!(clock.preparing(), found);
    }
}
