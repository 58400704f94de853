//! The joints that a place follows, with their weights.

use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};

/// Samples at once on one thread.
const TOGETHER: usize = 512;

/// Joints with weights.
pub type Influences = Vec<(f64, u16)>;

/// Keeps the largest of some weights, which sum to more than 0, largest first and as parts of 1; returns the
/// part of them that is left out. The first weight that is left out is taken off all others, so that none
/// jumps where another takes its place.
pub fn limited(weights: &mut Influences, limit: usize) -> f64 {
    weights.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let all: f64 = weights.iter().map(|w| w.0).sum();
    let left_out = weights.get(limit).map_or(0.0, |w| w.0);
    let lost = weights.iter().skip(limit).map(|w| w.0).sum::<f64>() / all;
    // All may be alike.
    let off = if weights.first().is_some_and(|w| w.0 > left_out) { left_out } else { 0.0 };
    weights.truncate(limit);
    weights.retain(|w| w.0 > off);
    let sum: f64 = weights.iter().map(|w| w.0 - off).sum();
    weights.iter_mut().for_each(|w| w.0 = (w.0 - off) / sum);
    lost
}

/// Turns weights that are not negative into parts of their sum, of which small ones are faded out: those
/// below the first of two shares are nothing, and those above the second are whole.
pub fn faded(weights: &mut Influences, shares: [f64; 2]) {
    let sum: f64 = weights.iter().map(|w| w.0).sum();
    for (weight, _) in weights.iter_mut() {
        let share = *weight / sum;
        let t = ((share - shares[0]) / (shares[1] - shares[0])).clamp(0.0, 1.0);
        *weight = share * t * t * (3.0 - 2.0 * t);
    }
    weights.retain(|(weight, _)| *weight > 0.0);
}

/// Number of joints that each sample of a block follows, and the weights and joints, one sample after the
/// other.
type InfluenceBlock = (Vec<usize>, Vec<(f32, u16)>);

/// The influences of all samples, one after the other.
pub struct InfluenceTable {
    starts: Vec<usize>,
    influences: Vec<(f32, u16)>,
}

impl InfluenceTable {
    /// Finds the influences of each sample, on all threads.
    pub fn new(
        samples: &[[f32; 3]],
        find: impl Fn(DVec3, &mut Influences) + Sync,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let blocks = samples.len().div_ceil(TOGETHER);
        let mut all: Vec<InfluenceBlock> = vec![InfluenceBlock::default(); blocks];
        host.parallel_blocks(&mut all, 1, |block, all| {
            // Cancellation is looked after by whoever hands out the blocks.
            let _ = host.progress(0.92 + 0.08 * block as f64 / blocks as f64);
            let mut room = Vec::new();
            let (counts, influences) = &mut all[0];
            for p in samples.iter().skip(block * TOGETHER).take(TOGETHER) {
                find(DVec3::from(p.map(f64::from)), &mut room);
                counts.push(room.len());
                influences.extend(room.iter().map(|(w, joint)| (*w as f32, *joint)));
            }
        })?;
        let mut starts = vec![0];
        let mut influences = Vec::with_capacity(all.iter().map(|(_, i)| i.len()).sum());
        for (counts, own) in all {
            counts.iter().for_each(|count| starts.push(starts[starts.len() - 1] + count));
            influences.extend(own);
        }
        Ok(Self { starts, influences })
    }

    /// The number of samples.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// The joints that a sample follows, and their weights, the largest first.
    pub fn of_sample(&self, sample: usize) -> impl Iterator<Item = (usize, f64)> + Clone + '_ {
        let range = self.starts[sample]..self.starts[sample + 1];
        self.influences[range].iter().map(|(w, j)| (usize::from(*j), f64::from(*w)))
    }
}
