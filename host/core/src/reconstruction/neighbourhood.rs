//! The k samples of its sheet that are nearest to a vertex: N_k(p) of the paper's §5.

use glam::Vec3;

use super::rest_geometry::RestGeometry;
use super::sheets::SHEET_NEIGHBOURS;
use crate::geometry::hermite;

/// Largest number of samples in a neighbourhood.
pub const MAX_K: usize = 12;

/// The k nearest samples of a vertex on its own sheet, with their weights.
pub struct Neighbourhood {
    /// Index and kernel weight, the nearest first.
    near: [(u32, f32); MAX_K],
    len: usize,
}

impl Neighbourhood {
    /// Gathers the `k` nearest samples of `p`, at most [`MAX_K`], from the sheet of its home.
    pub fn gather(around: &RestGeometry<'_>, home: usize, k: usize, p: Vec3) -> Self {
        let RestGeometry { samples, sheets, .. } = around;
        let k = k.min(MAX_K);
        let mut found = [(0.0f32, 0u32); SHEET_NEIGHBOURS + 1];
        let mut len = 0;
        let mut take = |i: u32| {
            found[len] = (samples.positions[i as usize].distance_squared(p), i);
            len += 1;
        };
        take(home as u32);
        sheets.of_sample(home).iter().for_each(|i| take(*i));

        let found = &mut found[..len];
        let order = |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if len > k {
            found.select_nth_unstable_by(k, order);
        }
        let count = len.min(k);
        found[..count].sort_unstable_by(order);
        // The kernel vanishes at the first sample that is left out, so that samples come and go smoothly.
        let radius = match found.get(k) {
            Some(beyond) => beyond.0.sqrt(),
            None => 1.5 * found[count - 1].0.sqrt(),
        };
        let mut near = [(0, 0.0); MAX_K];
        for (slot, (squared, i)) in near.iter_mut().zip(&found[..count]) {
            let distance = if radius > 0.0 { squared.sqrt() / radius } else { 0.0 };
            *slot = (*i, hermite(distance));
        }
        // Samples at one distance are all equally near.
        if near[..count].iter().map(|(_, w)| w).sum::<f32>() < 1e-6 {
            near[..count].iter_mut().for_each(|(_, w)| *w = 1.0);
        }
        Self { near, len: count }
    }

    /// Index and weight of each sample, the nearest first. The weights' sum is positive.
    pub fn weighted(&self) -> &[(u32, f32)] {
        &self.near[..self.len]
    }
}
