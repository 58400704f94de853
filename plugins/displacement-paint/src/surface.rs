//! The surface before anything is painted: the links between samples that are beside each other on it.
//!
//! The nearest samples in space may be those of the other side of a thin wall, or of the next finger: they
//! are told apart by the [sheet metric](simod_geometry::chord_length).

use crate::grid::HashGrid;
use glam::Vec3;
use simod_geometry::chord_length;
use simod_plugin_api::{Graph, Host, PluginResult};

/// Number of links of each sample, before links are made to go both ways.
const LINKS: usize = 10;

/// Greatest number of these where several samples are equally far: left and right of a mirror, all or none
/// are linked.
const MOST_LINKS: usize = 16;

/// Number of samples whose links are found at once on one thread.
const BLOCK: usize = 4096;

/// Width of the grid's cells, in spacings of the samples.
const CELL: f64 = 2.0;

/// The samples' links on the surface, and their grid at rest.
pub struct LinkedSurface {
    starts: Vec<u32>,
    links: Vec<u32>,
    /// Grid of all samples at rest.
    pub grid: HashGrid,
    /// Number that tells the surface from others of this process.
    pub id: u64,
}

impl LinkedSurface {
    /// The surface of samples at rest.
    pub fn new(
        positions: &[Vec3],
        normals: &[Vec3],
        graph: &Graph<'_>,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        static SURFACES: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
        let count = positions.len();
        let mut nearest = vec![[u32::MAX; MOST_LINKS]; count];
        host.parallel_blocks(&mut nearest, BLOCK, |first, block| {
            for (links, i) in block.iter_mut().zip(first..) {
                *links = nearest_on_sheet(positions, normals, graph.of(i), i);
            }
        })?;
        host.progress(0.5)?;
        let (starts, links) = both_ways(&nearest);
        let link_lengths = nearest.iter().enumerate().filter(|(_, l)| l[0] != u32::MAX);
        let mut lengths: Vec<f32> =
            link_lengths.map(|(i, l)| positions[i].distance(positions[l[0] as usize])).collect();
        lengths.sort_unstable_by(f32::total_cmp);
        let spacing = lengths.get(lengths.len() / 2).map_or(0.0, |&l| f64::from(l));
        // With all samples in one place, any width will do.
        let grid = HashGrid::new(positions, if spacing > 0.0 { CELL * spacing } else { 1.0 });
        let id = SURFACES.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        Ok(Self { starts, links, grid, id })
    }

    /// The samples beside sample `i` on the surface; links go both ways.
    #[inline]
    pub fn beside(&self, i: usize) -> &[u32] {
        &self.links[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// The number of samples.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Nearest of sample `i`'s neighbours that lie on its sheet; `u32::MAX` in unused places.
fn nearest_on_sheet(positions: &[Vec3], normals: &[Vec3], near: &[u32], i: usize) -> [u32; MOST_LINKS] {
    let mut best = [(f32::INFINITY, u32::MAX); MOST_LINKS];
    for &j in near {
        let d = positions[j as usize] - positions[i];
        let Some(length) = chord_length(d, normals[i], normals[j as usize]) else { continue };
        let entry = (length, j);
        if length < best[MOST_LINKS - 1].0 {
            best[MOST_LINKS - 1] = entry;
            best.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
    }
    let last = best[LINKS - 1].0;
    best.map(|(distance, j)| if distance <= last { j } else { u32::MAX })
}

/// Links of all samples with their reverses: the beginning of each sample's links, and the list of all. A
/// sample's own links come first.
fn both_ways(nearest: &[[u32; MOST_LINKS]]) -> (Vec<u32>, Vec<u32>) {
    let own = |i: usize| nearest[i].iter().copied().filter(|&j| j != u32::MAX);
    let reverses = || {
        (0..nearest.len())
            .flat_map(|i| own(i).map(move |j| (j as usize, i as u32)))
            .filter(|&(j, i)| !nearest[j].contains(&i))
    };
    let mut starts = vec![0_u32; nearest.len() + 1];
    (0..nearest.len()).for_each(|i| starts[i + 1] = own(i).count() as u32);
    reverses().for_each(|(j, _)| starts[j + 1] += 1);
    (0..nearest.len()).for_each(|i| starts[i + 1] += starts[i]);
    let mut links = vec![0; starts[nearest.len()] as usize];
    let mut next = starts.clone();
    let mut add = |i: usize, j: u32| {
        links[next[i] as usize] = j;
        next[i] += 1;
    };
    for i in 0..nearest.len() {
        own(i).for_each(|j| add(i, j));
    }
    reverses().for_each(|(j, i)| add(j, i));
    (starts, links)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_go_both_ways() {
        let mut nearest = vec![[u32::MAX; MOST_LINKS]; 3];
        nearest[0][0] = 1;
        nearest[2][..2].copy_from_slice(&[1, 0]);
        let (starts, links) = both_ways(&nearest);
        assert_eq!((starts, links), (vec![0, 2, 4, 6], vec![1, 2, 0, 2, 1, 0]));
    }
}
