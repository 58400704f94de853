//! The samples' displacements, kept from one motion to the next: who drags one vertex of many changes one
//! term of many.
//!
//! Terms are rounded to whole multiples of a power of two, of which sums are exact: in whatever order terms
//! came and went, the sums are the same to the last bit.

use crate::TILE;
use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};
use simod_plugin_api::{Host, PluginResult};

/// Sums of so many samples that lie together, axis by axis.
type TileSums = [[f64; TILE]; 3];

/// Quantum of which terms are multiples, in local coordinates, whose unit is about the model's size.
const QUANTUM: f64 = 1.0 / (1_u64 << 34) as f64;
/// Greatest sum of absolute displacements that is exact, with coordinates of up to some hundreds.
const LARGEST: f64 = 1024.0;
/// Number whose addition and subtraction rounds to multiples of the quantum.
const ROUNDER: f64 = 1.5 * (1_u64 << 52) as f64 * QUANTUM;

/// Sums for the displacements that were given last.
#[derive(Default)]
pub struct CageSums {
    state: u64,
    displacements: Vec<DVec3>,
    tiles: Vec<TileSums>,
}

impl CageSums {
    /// Sums of all samples, tile by tile.
    pub fn all(&self) -> &[TileSums] {
        &self.tiles
    }

    /// Brings the sums up to date for a state's table (tile by tile, vertex by vertex, sample by sample)
    /// and the vertices' displacements.
    pub fn update(
        &mut self,
        state: u64,
        table: &[f32],
        displacements: &[DVec3],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let vertices = displacements.len();
        let count = table.len() / (TILE * vertices).max(1);
        // The displacements are taken out, so that a failure leaves nothing half done.
        let known = std::mem::take(&mut self.displacements);
        let is_exact = |d: &[DVec3]| d.iter().map(|d| d.abs().max_element()).sum::<f64>() <= LARGEST;
        let is_known = self.state == state && known.len() == vertices && self.tiles.len() == count;
        let moved = displacements.iter().filter(|d| **d != DVec3::ZERO).count();
        let changed = known.iter().zip(displacements).filter(|(a, b)| a != b).count();
        // Each change takes two terms.
        let goes_on = is_known && is_exact(&known) && is_exact(displacements) && 2 * changed < moved;
        if !goes_on {
            self.tiles.clear();
            self.tiles.resize(count, [[0.0; TILE]; 3]);
        }
        let mut terms: Vec<(usize, DVec3)> = Vec::new();
        for (v, d) in displacements.iter().enumerate() {
            let before = if goes_on { known[v] } else { DVec3::ZERO };
            if before != *d {
                // Both terms are rounded by themselves, as their sum has to be again what it was.
                terms.extend([(v, -before), (v, *d)].into_iter().filter(|(_, d)| *d != DVec3::ZERO));
            }
        }
        host.parallel_blocks(&mut self.tiles, 1, |tile, sums| {
            let table = &table[tile * TILE * vertices..][..TILE * vertices];
            Arch::new().dispatch(Add { table, terms: &terms, sums: &mut sums[0] });
        })?;
        (self.state, self.displacements) = (state, displacements.to_vec());
        Ok(())
    }
}

/// Adds terms to the sums of a tile: vertices and displacements.
struct Add<'a> {
    table: &'a [f32],
    terms: &'a [(usize, DVec3)],
    sums: &'a mut TileSums,
}

impl WithSimd for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Plain loops, which the compiler makes vectors of; the same numbers come out of any.
        let [x, y, z] = self.sums;
        for (v, d) in self.terms {
            let weights = &self.table[v * TILE..][..TILE];
            for i in 0..TILE {
                let w = f64::from(weights[i]);
                x[i] += (d.x * w + ROUNDER) - ROUNDER;
                y[i] += (d.y * w + ROUNDER) - ROUNDER;
                z[i] += (d.z * w + ROUNDER) - ROUNDER;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_do_not_depend_on_what_was_dragged_before() {
        const VERTICES: usize = 20;
        let wave = |i: usize| (i as f64 * 0.7).sin();
        let table: Vec<f32> = (0..3 * TILE * VERTICES).map(|i| wave(i * i % 7919) as f32).collect();
        let host = Host::new(&());
        let mut kept = CageSums::default();
        let mut displacements = vec![DVec3::ZERO; VERTICES];
        for frame in 0..60 {
            // One vertex after the other; some come to rest again, one goes far away, and all jump at last.
            displacements[frame * 7 % VERTICES] = match frame {
                f if f % 11 == 10 => DVec3::ZERO,
                30 => DVec3::splat(1e5),
                f => DVec3::new(wave(f), wave(f + 1), 1e-3 * wave(f + 2)),
            };
            if frame > 55 {
                displacements.iter_mut().for_each(|d| *d += DVec3::X);
            }
            kept.update(1, &table, &displacements, &host).unwrap();
            let mut fresh = CageSums::default();
            fresh.update(1, &table, &displacements, &host).unwrap();
            assert!(kept.all() == fresh.all(), "frame {frame}");
            for i in [0, TILE + 5] {
                let (tile, at) = (i / TILE, i % TILE);
                let weight = |v: usize| f64::from(table[(tile * VERTICES + v) * TILE + at]);
                let exact: f64 = (0..VERTICES).map(|v| weight(v) * displacements[v].x).sum();
                assert!((kept.all()[tile][0][at] - exact).abs() < 1e-8, "frame {frame}");
            }
        }
        // The sums of another state know nothing of this one.
        kept.update(2, &table, &vec![DVec3::ZERO; VERTICES], &host).unwrap();
        assert!(kept.all().iter().flatten().flatten().all(|x| *x == 0.0));
    }
}
