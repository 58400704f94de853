//! Normals of P_S where the model has none: principal components of the neighbourhood, consistently oriented
//! along a minimum spanning tree. H. Hoppe, T. DeRose, T. Duchamp, J. McDonald, W. Stuetzle,
//! *Surface Reconstruction from Unorganized Points*, 1992.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::sample_set::{NeighbourGraph, kd_tree, nearest};
use crate::geometry::symmetric_eigen;

/// Neighbours that span the tangent plane.
const PLANE_NEIGHBOURS: usize = 12;

/// Neighbours along which the orientation spreads.
const ORIENT_NEIGHBOURS: usize = 8;

/// All normals, where only some are known (the others are zero, or all if there are none). All are of unit length.
///
/// Known normals spread their orientation to those filled in. A part without any is oriented so that the
/// normal of its highest sample (along z) points up; whether that is outwards is known for closed surfaces only.
pub fn completed(positions: &[Vec3], known: &[Vec3]) -> Vec<Vec3> {
    let mut normals = known.to_vec();
    normals.resize(positions.len(), Vec3::ZERO);
    let missing: Vec<bool> = normals.iter().map(|n| *n == Vec3::ZERO).collect();
    let tree = kd_tree(positions);
    normals.par_iter_mut().enumerate().filter(|(i, _)| missing[*i]).for_each_init(
        Vec::new,
        |near, (i, n)| {
            near.clear();
            near.extend(nearest(&tree, positions, i, PLANE_NEIGHBOURS));
            *n = plane_normal(positions, i, near);
        },
    );
    let graph = NeighbourGraph::of_points(positions, &tree, ORIENT_NEIGHBOURS);
    drop(tree);
    orient(positions, &graph, &mut normals, missing);
    normals
}

/// The direction of least variance of a sample and its neighbours.
fn plane_normal(positions: &[Vec3], i: usize, neighbours: &[u32]) -> Vec3 {
    let around = |j: &u32| (positions[*j as usize] - positions[i]).as_dvec3();
    let mean = neighbours.iter().map(around).sum::<DVec3>() / (neighbours.len() + 1) as f64;
    let mut covariance = DMat3::from_cols(mean * mean.x, mean * mean.y, mean * mean.z);
    for d in neighbours.iter().map(around).map(|d| d - mean) {
        covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    symmetric_eigen(covariance).1.x_axis.as_vec3().try_normalize().unwrap_or(Vec3::Z)
}

/// Prim's algorithm with 1 − |nᵢ·nⱼ| as the cost of an edge: orientation spreads where the surface is flattest
/// first. `unknown` says whose sign is open.
fn orient(positions: &[Vec3], neighbours: &NeighbourGraph, normals: &mut [Vec3], mut unknown: Vec<bool>) {
    // Neighbourhood is not symmetric: the reverse edges as well, or a part could fall into pieces.
    let reach = |i: usize| neighbours.of(i).iter().map(|j| *j as usize);
    let mut degree = vec![0u32; positions.len() + 1];
    (0..positions.len()).flat_map(reach).for_each(|j| degree[j + 1] += 1);
    for i in 0..positions.len() {
        degree[i + 1] += degree[i];
    }
    let mut reverse = vec![0u32; degree[positions.len()] as usize];
    let mut next = degree.clone();
    for i in 0..positions.len() {
        for j in reach(i) {
            reverse[next[j] as usize] = i as u32;
            next[j] += 1;
        }
    }

    // Non-negative floats order as their bits do.
    let cost =
        |normals: &[Vec3], i: usize, j: usize| (1.0 - normals[i].dot(normals[j]).abs()).max(0.0).to_bits();
    let mut queue = BinaryHeap::new();
    // The cheapest edge to each sample so far, and from where: only a cheaper one is of use.
    let mut cheapest = vec![(u32::MAX, 0u32); positions.len()];
    let spread = |i: usize,
                  normals: &[Vec3],
                  unknown: &[bool],
                  cheapest: &mut [(u32, u32)],
                  queue: &mut BinaryHeap<_>| {
        let back = &reverse[degree[i] as usize..degree[i + 1] as usize];
        for j in reach(i).chain(back.iter().map(|j| *j as usize)).filter(|j| unknown[*j]) {
            let cost = cost(normals, i, j);
            if cost < cheapest[j].0 {
                cheapest[j] = (cost, i as u32);
                queue.push(Reverse((cost, j as u32)));
            }
        }
    };
    for i in (0..positions.len()).filter(|i| !unknown[*i]) {
        spread(i, normals, &unknown, &mut cheapest, &mut queue);
    }
    let mut highest: Vec<u32> = (0..positions.len() as u32).filter(|i| unknown[*i as usize]).collect();
    highest.sort_by(|i, j| positions[*j as usize].z.total_cmp(&positions[*i as usize].z));
    let mut highest = highest.into_iter();
    loop {
        while let Some(Reverse((_, j))) = queue.pop() {
            let j = j as usize;
            let i = cheapest[j].1 as usize;
            if unknown[j] {
                unknown[j] = false;
                if normals[i].dot(normals[j]) < 0.0 {
                    normals[j] = -normals[j];
                }
                spread(j, normals, &unknown, &mut cheapest, &mut queue);
            }
        }
        let Some(seed) = highest.by_ref().find(|i| unknown[*i as usize]) else { break };
        let seed = seed as usize;
        unknown[seed] = false;
        if normals[seed].z < 0.0 {
            normals[seed] = -normals[seed];
        }
        spread(seed, normals, &unknown, &mut cheapest, &mut queue);
    }
}

#[cfg(test)]
mod tests {
    use super::super::SampleSet;
    use super::*;

    /// Points of a Fibonacci spiral on a unit sphere.
    fn sphere(n: usize, center: Vec3) -> Vec<Vec3> {
        let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
        (0..n)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
                let (s, c) = (golden * i as f32).sin_cos();
                center + Vec3::new(c * (1.0 - z * z).sqrt(), s * (1.0 - z * z).sqrt(), z)
            })
            .collect()
    }

    #[test]
    fn spheres_get_outward_normals() {
        let mut points = sphere(2000, Vec3::ZERO);
        points.extend(sphere(1000, Vec3::new(5.0, 0.0, 0.0)));
        let set = SampleSet::new(points.clone(), Vec::new()).expect("points");
        for (i, (p, n)) in points.iter().zip(set.normals()).enumerate() {
            let center = if i < 2000 { Vec3::ZERO } else { Vec3::new(5.0, 0.0, 0.0) };
            assert!(n.dot(*p - center) > 0.99, "{i}: {n}");
        }
    }

    #[test]
    fn known_normals_spread_and_stay() {
        let points = sphere(2000, Vec3::ZERO);
        let mut known = vec![Vec3::ZERO; points.len()];
        known[700] = -points[700];
        let set = SampleSet::new(points.clone(), known).expect("points");
        assert_eq!(set.normals()[700], -points[700]);
        assert!(points.iter().zip(set.normals()).all(|(p, n)| n.dot(*p) < -0.99));
    }
}
