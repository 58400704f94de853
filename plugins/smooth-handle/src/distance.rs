//! Distances of samples from a region: through space, or along the surface.

use glam::Vec3;
use rstar::RTree;
use simod_plugin_api::{Graph, Host, PluginResult};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Number of samples that are looked after at once on one thread.
const BLOCK: usize = 4096;

/// Cosine between normals of neighbours below which they are on two sides of a thin wall.
const AWAY: f32 = -0.5;

/// The distance of each sample to the nearest of `core`, in space.
pub fn in_space(positions: &[Vec3], core: &[u32], host: &Host<'_>) -> PluginResult<Vec<f32>> {
    let points: Vec<[f32; 3]> = core.iter().map(|&i| positions[i as usize].to_array()).collect();
    // Boxes fit tightly: most samples are far from a region, where a search in a k-d tree would visit most
    // of the tree.
    let tree = RTree::bulk_load(points);
    let mut distances = vec![0.0; positions.len()];
    host.parallel_blocks(&mut distances, BLOCK, |first, block| {
        for (distance, p) in block.iter_mut().zip(&positions[first..]) {
            let nearest = tree.nearest_neighbor(p.to_array());
            *distance = nearest.map_or(f32::INFINITY, |q| p.distance(Vec3::from(*q)));
        }
    })?;
    Ok(distances)
}

/// The distance of each sample to the nearest of `core` along the surface; infinite where none is reached.
///
/// E. W. Dijkstra, A note on two problems in connexion with graphs, 1959, on the graph of the samples'
/// neighbours, without those of the other side of a thin wall. With as many neighbours as the graph has,
/// ways are a few per cent too long.
pub fn on_surface(
    positions: &[Vec3],
    normals: &[Vec3],
    graph: &Graph<'_>,
    core: &[u32],
    host: &Host<'_>,
) -> PluginResult<Vec<f32>> {
    const BETWEEN_LOOKS: usize = 1024;
    let mut distances = vec![f32::INFINITY; positions.len()];
    // Lengths are not negative, so they are in the order of their bits.
    let entry = |length: f32, i: u32| Reverse(u64::from(length.to_bits()) << 32 | u64::from(i));
    let mut open: BinaryHeap<_> = core.iter().map(|&i| entry(0.0, i)).collect();
    core.iter().for_each(|&i| distances[i as usize] = 0.0);
    let mut done = 0;
    while let Some(Reverse(next)) = open.pop() {
        let (length, i) = (f32::from_bits((next >> 32) as u32), next as u32 as usize);
        if length > distances[i] {
            continue;
        }
        done += 1;
        if done % BETWEEN_LOOKS == 0 {
            host.progress(0.5 * done as f64 / positions.len() as f64)?;
        }
        for &j in graph.of(i) {
            let to = j as usize;
            let there = length + positions[i].distance(positions[to]);
            if there < distances[to] && normals[i].dot(normals[to]) > AWAY {
                distances[to] = there;
                open.push(entry(there, j));
            }
        }
    }
    Ok(distances)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn along_a_bent_strip_the_surface_is_longer_than_space() {
        // Half a circle of radius 1, and its graph of two neighbours on each side.
        let count = 400_u32;
        let angle = |i: u32| std::f32::consts::PI * i as f32 / (count - 1) as f32;
        let normals: Vec<Vec3> = (0..count).map(|i| Vec3::new(angle(i).cos(), angle(i).sin(), 0.0)).collect();
        let (mut starts, mut neighbours) = (vec![0], Vec::new());
        for i in 0..count {
            let near = [i.wrapping_sub(1), i + 1, i.wrapping_sub(2), i + 2];
            neighbours.extend(near.into_iter().filter(|&j| j < count));
            starts.push(neighbours.len() as u32);
        }
        let graph = Graph::new(&starts, &neighbours);
        let host = Host::new(&());
        let surface = on_surface(&normals, &normals, &graph, &[0], &host).unwrap();
        let space = in_space(&normals, &[0], &host).unwrap();
        for i in 0..count {
            assert!((surface[i as usize] - angle(i)).abs() < 1e-3, "{i}");
            assert!((space[i as usize] - 2.0 * (0.5 * angle(i)).sin()).abs() < 1e-6, "{i}");
        }
    }
}
