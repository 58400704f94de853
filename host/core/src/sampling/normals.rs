//! Normals of P_S where the model has none: principal components of the neighbourhood, consistently oriented
//! along a minimum spanning tree. H. Hoppe, T. DeRose, T. Duchamp, J. McDonald, W. Stuetzle,
//! *Surface Reconstruction from Unorganized Points*, 1992.

use glam::{DVec3, Vec3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::long_list::ListStorage;

use super::neighbour_graph::NeighbourGraph;
pub use super::ways::NEIGHBOURS;
use super::ways::{Ways, scatter};
use crate::double_lanes::DoubleLanes;
use crate::eigen_lanes::symmetric_eigen;

/// Samples whose planes or edges are found by one job.
const TOGETHER: usize = 4096;

/// Neighbours along which the orientation spreads.
const ORIENT_NEIGHBOURS: usize = 8;

/// Normals of all samples, where only some are known (the others are zero, or all if there are none). All are
/// of unit length. `graph` has [`NEIGHBOURS`] of each sample or more, if there are as many.
///
/// Known normals spread their orientation to those filled in. A part without any is oriented so that the
/// normal of its highest sample (along z) points up; whether that is outwards is known for closed surfaces
/// only.
///
/// `storage` is the graph's.
///
/// Memory: 12 bytes for each of at most [`ORIENT_NEIGHBOURS`] edges per sample, about five; and 27 per
/// sample.
pub fn completed(
    positions: &[Vec3],
    known: &[Vec3],
    graph: &NeighbourGraph,
    storage: &ListStorage,
) -> Vec<Vec3> {
    let mut across = vec![Vec3::ZERO; positions.len()];
    across.par_chunks_mut(TOGETHER).enumerate().for_each(|(job, across)| {
        let begin = job * TOGETHER;
        let known = known.get(begin..begin + across.len());
        if known.is_none_or(|known| known.contains(&Vec3::ZERO)) {
            storage.gone_through(graph.bytes_of(across.len()));
            plane_normals(positions, begin, |i| first(graph.nearest_to(i), NEIGHBOURS), across);
        }
    });
    completed_from(positions, known, graph, &across, storage)
}

/// Normals that are complete, of samples whose directions of least variance are known.
pub fn completed_from(
    positions: &[Vec3],
    known: &[Vec3],
    graph: &NeighbourGraph,
    across: &[Vec3],
    storage: &ListStorage,
) -> Vec<Vec3> {
    let mut normals = known.to_vec();
    normals.resize(positions.len(), Vec3::ZERO);
    let missing: Vec<bool> = normals.iter().map(|n| *n == Vec3::ZERO).collect();
    normals
        .iter_mut()
        .zip(across)
        .zip(&missing)
        .filter(|(_, missing)| **missing)
        .for_each(|((n, a), _)| *n = *a);
    let edges = edges(positions, graph, &normals, &missing, storage);
    orient(positions, edges, &mut normals, &missing);
    normals
}

fn first(neighbours: &[u32], count: usize) -> &[u32] {
    &neighbours[..count.min(neighbours.len())]
}

/// The direction of least variance of each of some points, which follow each other from the first, and its
/// neighbours, of which all have as many, [`NEIGHBOURS`] at most.
pub fn plane_normals<'a>(
    positions: &[Vec3],
    begin: usize,
    neighbours: impl Fn(usize) -> &'a [u32],
    normals: &mut [Vec3],
) {
    Arch::new().dispatch(PlaneNormals { positions, begin, neighbours, normals });
}

/// Inputs and result of [`plane_normals`], which are computed in the processor's vectors.
struct PlaneNormals<'a, F> {
    positions: &'a [Vec3],
    begin: usize,
    neighbours: F,
    normals: &'a mut [Vec3],
}

impl<'a, F: Fn(usize) -> &'a [u32]> WithSimd for PlaneNormals<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let mut ways = Ways::new((self.neighbours)(self.begin).len());
        for (packet, normals) in self.normals.chunks_mut(S::F64_LANES).enumerate() {
            let begin = self.begin + packet * S::F64_LANES;
            for lane in 0..normals.len() {
                ways.set(lane, self.positions, begin + lane, (self.neighbours)(begin + lane));
            }
            let mut around = [[DoubleLanes::splat(simd, 0.0); 3]; NEIGHBOURS];
            let (diagonal, off) = scatter(simd, ways.load(simd, &mut around));
            let [x, y, z] = symmetric_eigen(simd, diagonal, off).1[0].map(DoubleLanes::store);
            for (lane, normal) in normals.iter_mut().enumerate() {
                *normal = direction(DVec3::new(x[lane], y[lane], z[lane]));
            }
        }
    }
}

/// Unit vector along an axis; any, if the axis has no direction.
pub fn direction(axis: DVec3) -> Vec3 {
    axis.as_vec3().try_normalize().unwrap_or(Vec3::Z)
}

/// An edge between two samples: the bits of its cost, which order as the cost does, and its ends.
type Edge = (u32, u32, u32);

/// Parts of a list, each of the number of elements in `counts`.
fn rooms<'a, T>(mut list: &'a mut [T], counts: &[usize]) -> Vec<&'a mut [T]> {
    let mut rooms = Vec::with_capacity(counts.len());
    for count in counts {
        let (room, behind) = list.split_at_mut(*count);
        rooms.push(room);
        list = behind;
    }
    rooms
}

/// The edges of each sample to the nearest few, of which either is `open`.
fn edges(
    positions: &[Vec3],
    graph: &NeighbourGraph,
    normals: &[Vec3],
    open: &[bool],
    storage: &ListStorage,
) -> Vec<Edge> {
    let near = |i: usize| first(graph.nearest_to(i), ORIENT_NEIGHBOURS);
    let cost = |i: usize, j: usize| (1.0 - normals[i].dot(normals[j]).abs()).max(0.0).to_bits();
    // Each edge once, though most are known at both ends.
    let once = |i: usize, j: usize| (i < j || !near(j).contains(&(i as u32))) && (open[i] || open[j]);
    let ends = |i: usize| near(i).iter().map(|j| *j as usize).filter(move |j| once(i, *j));
    let samples = |job: usize| {
        let samples = job * TOGETHER..positions.len().min((job + 1) * TOGETHER);
        storage.gone_through(graph.bytes_of(samples.len()));
        samples
    };
    let jobs = (0..positions.len().div_ceil(TOGETHER)).into_par_iter();
    // Counted first: lists that grow would take as much again.
    let counts: Vec<usize> = jobs.map(|job| samples(job).map(|i| ends(i).count()).sum()).collect();
    let mut edges: Vec<Edge> = vec![Edge::default(); counts.iter().sum()];
    let rooms = rooms(&mut edges, &counts);
    rooms.into_par_iter().enumerate().for_each(|(job, room)| {
        let of_sample = |i: usize| ends(i).map(move |j| (i, j));
        let pairs = samples(job).flat_map(of_sample);
        room.iter_mut().zip(pairs).for_each(|(to, (i, j))| *to = (cost(i, j), i as u32, j as u32));
    });
    edges
}

/// Turns the normals that are `open` so that those at the ends of each edge of a minimum spanning forest look
/// the same way. Edges cost 1 − |nᵢ·nⱼ|: orientation spreads where the surface is flattest.
fn orient(positions: &[Vec3], mut edges: Vec<Edge>, normals: &mut [Vec3], open: &[bool]) {
    // Samples whose normals are known are one part from the beginning.
    let mut parts = OrientedParts::new(positions.len());
    let known = open.iter().position(|open| !open);
    if let Some(known) = known {
        (known..open.len()).filter(|i| !open[*i]).for_each(|i| parts.join(known, i, false));
    }
    // Kruskal's algorithm. The cheapest are sorted first: most of the others then have both ends in one part.
    while !edges.is_empty() {
        let cheap = edges.len().div_ceil(4);
        edges.select_nth_unstable(cheap - 1);
        edges[..cheap].par_sort_unstable();
        for (_, i, j) in edges.drain(..cheap) {
            let (i, j) = (i as usize, j as usize);
            parts.join(i, j, normals[i].dot(normals[j]) < 0.0);
        }
        edges.retain(|(_, i, j)| parts.find(*i as usize).0 != parts.find(*j as usize).0);
    }

    // Sample of each part whose normal tells how all of the part looks: a known one, or the highest.
    let mut telling: Vec<Option<u32>> = vec![None; positions.len()];
    for i in 0..positions.len() {
        let slot = &mut telling[parts.find(i).0];
        let above = |j: usize| positions[i].z > positions[j].z;
        if slot.is_none_or(|j| open[j as usize] && (!open[i] || above(j as usize))) {
            *slot = Some(i as u32);
        }
    }
    let mut is_turned = |i: usize| {
        let (part, turned) = parts.find(i);
        let j = telling[part]? as usize;
        Some(turned ^ parts.find(j).1 ^ (open[j] && normals[j].z < 0.0))
    };
    let turned: Vec<_> = (0..positions.len()).map(|i| open[i] && is_turned(i) == Some(true)).collect();
    normals.iter_mut().zip(turned).filter(|(_, turned)| *turned).for_each(|(n, _)| *n = -*n);
}

/// A partition of the samples, with the sides that their normals look to: disjoint sets as trees.
struct OrientedParts {
    /// Sample above each one in the trees, or the sample itself: the root stands for the part.
    above: Vec<u32>,
    /// Whether a sample's normal has to be turned to look the same way as that of the sample above.
    turned: Vec<bool>,
}

impl OrientedParts {
    /// A forest in which each sample is alone.
    fn new(samples: usize) -> Self {
        Self { above: (0..samples as u32).collect(), turned: vec![false; samples] }
    }

    /// The part of a sample, and whether its normal has to be turned to look the same way as that of the
    /// part's root.
    fn find(&mut self, mut i: usize) -> (usize, bool) {
        let mut turned = false;
        while self.above[i] as usize != i {
            // Halves the path for the next time.
            let above = self.above[i] as usize;
            self.turned[i] ^= self.turned[above];
            self.above[i] = self.above[above];
            turned ^= self.turned[i];
            i = self.above[i] as usize;
        }
        (i, turned)
    }

    /// Joins the parts of two samples, unless these are of one. `turned` if they look opposite ways.
    fn join(&mut self, i: usize, j: usize, turned: bool) {
        let ((i, i_turned), (j, j_turned)) = (self.find(i), self.find(j));
        if i != j {
            self.above[j] = i as u32;
            self.turned[j] = turned ^ i_turned ^ j_turned;
        }
    }
}

#[cfg(test)]
mod tests {
    use simod_model::long_list::ListStorage;

    use super::super::SampleSet;
    use super::super::kd_tree::KdTree;
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

    type Near<'a> = &'a dyn Fn(usize) -> &'a [u32];

    /// The bits of all planes' normals.
    fn bits<'a>(
        points: &[Vec3],
        neighbours: Near<'a>,
        by: &dyn Fn(PlaneNormals<'_, Near<'a>>),
    ) -> Vec<[u32; 3]> {
        let mut normals = vec![Vec3::ZERO; points.len()];
        by(PlaneNormals { positions: points, begin: 0, neighbours, normals: &mut normals });
        normals.iter().map(|n| n.to_array().map(f32::to_bits)).collect()
    }

    #[test]
    fn planes_have_the_same_bits_with_any_vectors() {
        let points = sphere(501, Vec3::ZERO);
        let graph = NeighbourGraph::of_points(&KdTree::new(&points), NEIGHBOURS, &ListStorage::Memory);
        let near: Near<'_> = &|i| graph.nearest_to(i);
        let found = |by: &dyn Fn(PlaneNormals<'_, Near<'_>>)| bits(&points, near, by);
        let one_by_one = found(&|planes| planes.with_simd(pulp::Scalar::new()));
        assert!(found(&|planes| Arch::new().dispatch(planes)) == one_by_one);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert!(found(&|planes| Simd::vectorize(simd, planes)) == one_by_one);
        }
        let off = |(n, p): (&[u32; 3], &Vec3)| 1.0 - Vec3::from(n.map(f32::from_bits)).dot(*p).abs();
        assert!(one_by_one.iter().zip(&points).all(|both| off(both) < 0.01));
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
