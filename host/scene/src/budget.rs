//! The number of splats that are drawn in a frame, so that motions stay smooth.

use std::time::Duration;

/// Number of splats that a frame draws, learnt from the times of the last frames.
///
/// The number is halved or doubled, and not at once: a surface whose discs change in every frame would
/// flicker.
#[derive(Debug, Clone)]
pub struct Budget {
    goal: Duration,
    splats: usize,
    /// Number of splats that a frame adds at rest.
    step: usize,
    coarse: bool,
    /// Number of last frames in a row that took too long, and of those that took far less than they might.
    slow: u32,
    fast: u32,
    /// Time of the work for the next frame before it is drawn.
    besides: Duration,
}

impl Budget {
    /// Fewest splats of a frame, however long they take.
    const LEAST: usize = 16_000;
    /// Number of splats that are drawn at first.
    const FIRST: usize = 128_000;
    const MOST: usize = 1 << 30;
    /// Factor by which a part of a picture at rest may take longer than the goal: nobody's hand waits for
    /// it, and each part has its own costs.
    const REST: u32 = 4;
    /// Number of frames in a row after which the number of splats changes.
    const FRAMES: u32 = 3;

    /// Budget for frames whose time is to be `goal`.
    pub fn new(goal: Duration) -> Self {
        Self {
            goal,
            splats: Self::FIRST,
            step: Self::FIRST,
            coarse: false,
            slow: 0,
            fast: 0,
            besides: Duration::ZERO,
        }
    }

    /// Greatest number of splats of the next frame.
    pub fn splats(&self) -> usize {
        self.splats
    }

    /// Greatest number of splats that a frame adds while nothing moves.
    pub fn step(&self) -> usize {
        self.step
    }

    /// Counts the time of work for the next frame, which grows with the number of splats that the frame
    /// draws.
    pub fn also(&mut self, took: Duration) {
        self.besides += took;
    }

    /// Learns the time of a frame that added `step` splats.
    pub fn learn_step(&mut self, took: Duration) {
        let ratio = (Self::REST * self.goal).as_secs_f64() / took.as_secs_f64().max(1e-9);
        let step = self.step as f64 * ratio.clamp(0.5, 2.0);
        self.step = (step as usize).clamp(Self::LEAST, Self::MOST);
    }

    /// Whether moving frames are drawn in fewer pixels.
    pub fn is_coarse(&self) -> bool {
        self.coarse
    }

    /// Learns the time of a frame; `all` says whether it showed all splats of its surface.
    pub fn learn(&mut self, took: Duration, all: bool) {
        let took = took + std::mem::take(&mut self.besides);
        let ratio = took.as_secs_f64() / self.goal.as_secs_f64().max(1e-9);
        self.slow = if ratio > 1.0 { self.slow + 1 } else { 0 };
        self.fast = if ratio < 0.4 { self.fast + 1 } else { 0 };
        if self.slow == Self::FRAMES || ratio > 3.0 {
            // The number of splats shrinks, and once it cannot, the number of pixels.
            self.coarse |= self.splats == Self::LEAST;
            self.splats = (self.splats / 2).max(Self::LEAST);
            self.slow = 0;
        } else if self.fast == Self::FRAMES {
            // Four times as many pixels may take four times as long.
            if self.coarse && ratio < 0.2 {
                self.coarse = false;
            } else if !all {
                self.splats = (2 * self.splats).min(Self::MOST);
            }
            self.fast = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Machines that draw `rate` splats in a second, after a fixed time, find a number and keep to it.
    #[test]
    fn the_goal_is_met_and_kept() {
        for (rate, fixed) in [(1e6, 0.01), (1e8, 0.001), (2e6, 0.02), (1e9, 0.002)] {
            let mut budget = Budget::new(Duration::from_millis(40));
            let mut numbers = Vec::new();
            for _ in 0..100 {
                let took = fixed + budget.splats() as f64 / rate;
                numbers.push((budget.splats(), took));
                budget.learn(Duration::from_secs_f64(took), false);
            }
            let (splats, took) = numbers[99];
            assert!((0.014..=0.04).contains(&took), "{took}");
            assert!(numbers[50..].iter().all(|(n, _)| *n == splats));
        }
    }

    /// The time that brings the splats up to date is a part of a frame's, as that of drawing them is.
    #[test]
    fn what_a_frame_takes_besides_counts() {
        let numbers = |drawing: f64, besides: f64| {
            let mut budget = Budget::new(Duration::from_millis(40));
            let mut numbers = Vec::new();
            for _ in 0..40 {
                let splats = budget.splats() as f64;
                budget.also(Duration::from_secs_f64(besides * splats));
                budget.learn(Duration::from_secs_f64(drawing * splats), false);
                numbers.push(budget.splats());
            }
            numbers
        };
        assert_eq!(numbers(4e-8, 6e-8), numbers(1e-7, 0.0));
        assert_ne!(numbers(4e-8, 6e-8), numbers(4e-8, 0.0));
    }

    #[test]
    fn a_machine_that_is_too_slow_gets_fewer_pixels() {
        let mut budget = Budget::new(Duration::from_millis(40));
        for _ in 0..20 {
            budget.learn(Duration::from_millis(90), false);
        }
        assert!(budget.is_coarse());
        for _ in 0..3 {
            budget.learn(Duration::from_millis(2), false);
        }
        assert!(!budget.is_coarse());
    }

    /// Neither a single slow frame, nor quick frames of small surfaces change the number.
    #[test]
    fn it_does_not_jump() {
        let mut budget = Budget::new(Duration::from_millis(40));
        let before = budget.splats();
        for i in 0..100 {
            budget.learn(Duration::from_millis(if i % 10 == 0 { 100 } else { 1 }), true);
            assert_eq!(budget.splats(), before);
        }
    }
}
