//! Elements of the samples: of their triangles where there are any, of their neighbours elsewhere; and the
//! parts that elements connect.

use crate::elements::SurfaceTriangle;
use crate::{intrinsic, stars};
use glam::DVec3;
use simod_plugin_api::{Choice, Host, PluginResult, PrepareInput};

/// Samples at once on one thread.
const TOGETHER: usize = 1024;
/// Neighbours that hold a sample around which there are no triangles, as on a line.
const LINKS: usize = 4;
/// Cotangent weight of each of these links: about that of an edge of a regular triangulation.
const LINK: f64 = 0.577;

/// Weights of the triangles.
#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
pub enum TriangleWeights {
    /// Cotangents of the intrinsic Delaunay triangulation.
    #[choice(label = "Robust (intrinsic Delaunay)")]
    Robust,
    /// Cotangents of the triangles as they are.
    #[choice(label = "Cotangents as they are")]
    Cotangent,
}

/// Elements of all samples that have triangles or neighbours.
pub fn elements(
    input: &PrepareInput<'_>,
    positions: &[DVec3],
    weights: TriangleWeights,
    host: &Host<'_>,
) -> PluginResult<Vec<SurfaceTriangle>> {
    let count = positions.len() as u32;
    let triangles: Vec<[u32; 3]> = input.triangles().map_or(Vec::new(), |t| {
        let is_right =
            |t: &&[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0] && t.iter().all(|c| *c < count);
        t.indices().iter().filter(is_right).copied().collect()
    });
    let mut is_in_one = vec![false; positions.len()];
    triangles.iter().flatten().for_each(|c| is_in_one[*c as usize] = true);
    let mut elements = match weights {
        TriangleWeights::Robust => intrinsic::delaunay(positions, &triangles, host)?,
        TriangleWeights::Cotangent => intrinsic::plain(positions, &triangles),
    };
    let alone: Vec<u32> = (0..count).filter(|i| !is_in_one[*i as usize]).collect();
    elements.extend(of_neighbours(input, positions, &alone, host)?);
    Ok(elements)
}

/// Elements around samples that are in no triangle.
fn of_neighbours(
    input: &PrepareInput<'_>,
    positions: &[DVec3],
    alone: &[u32],
    host: &Host<'_>,
) -> PluginResult<Vec<SurfaceTriangle>> {
    let Some(graph) = input.graph().filter(|g| g.len() == positions.len()) else { return Ok(Vec::new()) };
    // Normals may be stale after other deformations; neighbours' are so alike.
    let normals = input.samples.normals();
    let same_side = |i: u32, j: u32| match (normals.get(i as usize), normals.get(j as usize)) {
        (Some(a), Some(b)) => a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>() >= 0.0,
        _ => true,
    };
    let mut stars = vec![Vec::new(); alone.len()];
    host.parallel_blocks(&mut stars, TOGETHER, |first, stars| {
        for (star, &i) in stars.iter_mut().zip(&alone[first..]) {
            *star = stars::star(positions, i, graph.of(i as usize), |j| same_side(i, j));
        }
    })?;
    let mut elements = Vec::new();
    for (_, &i) in stars.iter().zip(alone).filter(|(star, _)| star.is_empty()) {
        let near = graph.of(i as usize).iter().filter(|j| **j != i).take(LINKS);
        elements.extend(near.flat_map(|&j| SurfaceTriangle::link(i, j, LINK)));
    }
    // Each triangle of a regular neighbourhood is in the stars of all its corners.
    let triangles = intrinsic::plain(positions, &stars.concat());
    elements.extend(triangles.into_iter().map(|e| e.scaled(1.0 / 3.0)));
    Ok(elements)
}

/// Lowest sample that elements connect each sample to.
pub fn components(count: usize, elements: &[SurfaceTriangle]) -> Vec<u32> {
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    let mut parent: Vec<u32> = (0..count as u32).collect();
    for e in elements {
        for [a, b] in [[e.corners[0], e.corners[1]], [e.corners[1], e.corners[2]]] {
            let (a, b) = (root(&mut parent, a), root(&mut parent, b));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    (0..count as u32).map(|i| root(&mut parent, i)).collect()
}
