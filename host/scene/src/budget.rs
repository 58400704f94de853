//! How much is drawn in a frame, so that what moves stays smooth.

use std::time::Duration;

/// The number of splats that a frame takes, by how long the last ones took.
#[derive(Debug, Clone)]
pub struct Budget {
    goal: Duration,
    splats: f64,
    coarse: bool,
}

impl Budget {
    /// Fewest splats of a frame, however long they take.
    const LEAST: f64 = 10_000.0;
    /// So many at first.
    const FIRST: f64 = 100_000.0;
    const MOST: f64 = 1e9;

    /// A budget for frames that take so long.
    pub fn new(goal: Duration) -> Self {
        Self { goal, splats: Self::FIRST, coarse: false }
    }

    /// How many splats the next frame takes.
    pub fn splats(&self) -> usize {
        self.splats as usize
    }

    /// Whether moving frames are drawn in fewer pixels.
    pub fn is_coarse(&self) -> bool {
        self.coarse
    }

    /// Learns how long a frame of so many splats took.
    pub fn learn(&mut self, splats: usize, took: Duration) {
        let ratio = self.goal.as_secs_f64() / took.as_secs_f64().max(1e-6);
        // A part of the time does not depend on the splats, so steps are half of what the ratio says.
        let step = ratio.powf(0.5).clamp(0.5, 1.5);
        // A frame that had fewer than it might tells nothing about more.
        if step < 1.0 || splats >= self.splats() {
            self.splats = (splats as f64 * step).clamp(Self::LEAST, Self::MOST);
        }
        // Fewer pixels, once fewer splats do not help; more, once there is plenty of time.
        if self.splats <= 2.0 * Self::LEAST && ratio < 0.8 {
            self.coarse = true;
        } else if ratio > 4.0 {
            self.coarse = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A machine that draws so many splats in a second, after a fixed time, finds its number.
    #[test]
    fn the_goal_is_met() {
        for (rate, fixed) in [(1e6, 0.01), (1e8, 0.001), (2e6, 0.02)] {
            let mut budget = Budget::new(Duration::from_millis(40));
            let mut took = 0.0;
            for _ in 0..60 {
                took = fixed + budget.splats() as f64 / rate;
                budget.learn(budget.splats(), Duration::from_secs_f64(took));
            }
            assert!((0.03..0.05).contains(&took), "{took}");
        }
    }

    #[test]
    fn a_machine_that_is_too_slow_gets_fewer_pixels() {
        let mut budget = Budget::new(Duration::from_millis(40));
        for _ in 0..20 {
            budget.learn(budget.splats(), Duration::from_millis(90));
        }
        assert!(budget.is_coarse());
        for _ in 0..3 {
            budget.learn(budget.splats(), Duration::from_millis(2));
        }
        assert!(!budget.is_coarse());
    }

    #[test]
    fn a_small_surface_tells_nothing_about_large_ones() {
        let mut budget = Budget::new(Duration::from_millis(40));
        let before = budget.splats();
        budget.learn(100, Duration::from_millis(1));
        assert_eq!(budget.splats(), before);
    }
}
