//! The joints that a place follows, with their weights.

use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};

/// Most joints that a place follows.
pub const MOST: usize = 8;
/// Samples at once on one thread.
const TOGETHER: usize = 512;

/// Some joints with weights that sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Influences {
    count: usize,
    joints: [u16; MOST],
    weights: [f64; MOST],
}

impl Influences {
    /// The joints and their weights, largest first.
    pub fn iter(&self) -> impl Iterator<Item = (usize, f64)> + Clone + '_ {
        self.joints[..self.count].iter().zip(&self.weights).map(|(j, w)| (usize::from(*j), *w))
    }
}

/// The largest of some weights, which sum to more than 0, as parts of 1. What the first one has that is left
/// out is taken off all others, so that none jumps where another takes its place.
pub fn limited(weights: &mut [(f64, u16)], limit: usize) -> Influences {
    weights.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let kept = weights.len().min(limit).min(MOST);
    let left_out = weights.get(kept).map_or(0.0, |w| w.0);
    let mut this = Influences { count: 0, joints: [0; MOST], weights: [0.0; MOST] };
    // All may be alike.
    let off = if weights[0].0 > left_out { left_out } else { 0.0 };
    let sum: f64 = weights[..kept].iter().map(|w| w.0 - off).sum();
    for (weight, joint) in weights[..kept].iter().filter(|w| w.0 > off) {
        this.joints[this.count] = *joint;
        this.weights[this.count] = (weight - off) / sum;
        this.count += 1;
    }
    this
}

/// Turns weights that are not negative into parts of their sum, of which small ones are faded out: those below
/// the first of two shares are nothing, and those above the second are whole.
pub fn faded(weights: &mut Vec<(f64, u16)>, shares: [f64; 2]) {
    let sum: f64 = weights.iter().map(|w| w.0).sum();
    for (weight, _) in weights.iter_mut() {
        let share = *weight / sum;
        let t = ((share - shares[0]) / (shares[1] - shares[0])).clamp(0.0, 1.0);
        *weight = share * t * t * (3.0 - 2.0 * t);
    }
    weights.retain(|(weight, _)| *weight > 0.0);
}

/// The influences of all samples: so many of each as the one with the most has.
pub struct Table {
    width: usize,
    joints: Vec<u16>,
    weights: Vec<f32>,
}

impl Table {
    /// Finds those of each sample, on all threads.
    pub fn new(
        samples: &[[f32; 3]],
        find: impl Fn(DVec3, &mut Vec<(f64, u16)>) -> Influences + Sync,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let none = Influences { count: 0, joints: [0; MOST], weights: [0.0; MOST] };
        let mut all = vec![none; samples.len()];
        host.parallel_blocks(&mut all, TOGETHER, |first, all| {
            // Whether to go on is looked after by whoever hands out the blocks.
            let _ = host.progress(0.92 + 0.08 * first as f64 / samples.len() as f64);
            let mut room = Vec::new();
            for (influences, p) in all.iter_mut().zip(&samples[first..]) {
                *influences = find(DVec3::from(p.map(f64::from)), &mut room);
            }
        })?;
        let width = all.iter().map(|i| i.count).max().unwrap_or(0);
        let joints = all.iter().flat_map(|i| &i.joints[..width]).copied().collect();
        let weights = all.iter().flat_map(|i| &i.weights[..width]).map(|w| *w as f32).collect();
        Ok(Self { width, joints, weights })
    }

    /// The number of samples.
    pub fn len(&self) -> usize {
        self.weights.len().checked_div(self.width).unwrap_or(0)
    }

    /// The joints that a sample follows, and their weights.
    pub fn of(&self, sample: usize) -> impl Iterator<Item = (usize, f64)> + Clone + '_ {
        let range = sample * self.width..(sample + 1) * self.width;
        let weights = self.weights[range.clone()].iter().take_while(|w| **w > 0.0);
        self.joints[range].iter().zip(weights).map(|(j, w)| (usize::from(*j), f64::from(*w)))
    }
}
