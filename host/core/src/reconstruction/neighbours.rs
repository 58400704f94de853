//! The samples around a vertex of P_L: N_k(p) of the paper's §5, without a search from scratch for each vertex.
//!
//! Consecutive vertices of a stream are near each other. The nearest sample is found by walking on P_S's neighbour
//! graph from the last one, and its own neighbours are the candidates for all vertices around it.

use glam::Vec3;

use crate::geometry::hermite;
use crate::sampling::{NEIGHBOURS, SampleSet};

/// Most samples in a neighbourhood.
pub const MAX_K: usize = 12;

/// Neighbours looked at in a step of the walk.
const STEP_NEIGHBOURS: usize = 12;

/// A walk that ends further from the vertex than this many spacings of its sample has lost the surface.
const LOST: f32 = 3.0;

/// Where the last vertex was. A new walk starts with a search in the whole of P_S.
#[derive(Debug, Clone, Copy, Default)]
pub struct Walk {
    last: Option<u32>,
}

impl Walk {
    /// The sample nearest to `p`, or as near as the walk gets.
    pub fn nearest(&mut self, samples: &SampleSet, p: Vec3) -> u32 {
        let found = match self.last {
            Some(from) => walk(samples, from, p).unwrap_or_else(|| samples.nearest(p)),
            None => samples.nearest(p),
        };
        self.last = Some(found);
        found
    }
}

/// Steps to ever nearer samples; `None` where that ends far away.
fn walk(samples: &SampleSet, from: u32, p: Vec3) -> Option<u32> {
    let squared = |i: u32| samples.positions[i as usize].distance_squared(p);
    let (mut at, mut distance) = (from, squared(from));
    loop {
        let near = samples.neighbours().of(at as usize);
        let near = &near[..near.len().min(STEP_NEIGHBOURS)];
        let best = near.iter().map(|j| (squared(*j), *j)).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((d, j)) if d < distance => (at, distance) = (j, d),
            _ => break,
        }
    }
    let far = LOST * samples.spacing()[at as usize];
    (distance <= far * far).then_some(at)
}

/// The k nearest samples of a vertex on its own side of the surface, with their weights.
pub struct Neighbourhood {
    /// Index and kernel weight, the nearest first.
    near: [(u32, f32); MAX_K],
    len: usize,
}

impl Neighbourhood {
    /// Gathers the `k` nearest samples of `p`, at most [`MAX_K`], from the candidates of its nearest one.
    ///
    /// Samples that face away from the vertex (or from the nearest sample) belong to another sheet of the surface
    /// and are left out.
    pub fn gather(samples: &SampleSet, nearest: usize, k: usize, p: Vec3, n: Option<Vec3>) -> Self {
        let k = k.min(MAX_K);
        let candidates = samples.neighbours().of(nearest);
        let mut found = [(0.0f32, 0u32); NEIGHBOURS + 1];
        let side = side_of(samples, nearest, p, n);
        let mut len = 0;
        let mut take = |i: u32| {
            if same_sheet(samples.normals()[i as usize], side) {
                found[len] = (samples.positions[i as usize].distance_squared(p), i);
                len += 1;
            }
        };
        take(nearest as u32);
        candidates.iter().for_each(|i| take(*i));
        if len == 0 {
            // The vertex has a normal like no sample around: the nearest sample is all there is.
            found[0] = (samples.positions[nearest].distance_squared(p), nearest as u32);
            len = 1;
        }

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
            *slot = (*i, hermite(distance) * facing(samples.normals()[*i as usize], side));
        }
        // All at one distance: no one is nearer than another.
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

/// How much a sample of normal `n` belongs to a sheet of normal `side`: wholly up to a right angle, which the walls
/// of a groove make, and not at all beyond 120°, as the far side of a thin plate. The change is gradual.
fn facing(n: Vec3, side: Vec3) -> f32 {
    (2.0 * n.dot(side) + 1.0).clamp(0.0, 1.0)
}

/// Whether a sample belongs to the sheet at all.
pub fn same_sheet(n: Vec3, side: Vec3) -> bool {
    facing(n, side) > 0.0
}

/// The normal of the sheet that the vertex is on: that of the nearest sample that agrees with the vertex' own.
fn side_of(samples: &SampleSet, nearest: usize, p: Vec3, n: Option<Vec3>) -> Vec3 {
    let own = samples.normals()[nearest];
    let Some(n) = n.filter(|n| n.is_finite() && *n != Vec3::ZERO) else { return own };
    if own.dot(n) > 0.0 {
        return own;
    }
    let agreeing = samples.neighbours().of(nearest).iter().map(|j| *j as usize);
    let agreeing = agreeing.filter(|j| samples.normals()[*j].dot(n) > 0.0);
    let distance = |j: &usize| samples.positions[*j].distance_squared(p);
    agreeing.min_by(|a, b| distance(a).total_cmp(&distance(b))).map_or(own, |j| samples.normals()[j])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::SampleSet;

    fn wavy(n: usize) -> SampleSet {
        let points = (0..n * n).map(|i| {
            let (x, z) = ((i % n) as f32 / n as f32, (i / n) as f32 / n as f32);
            Vec3::new(x, 0.1 * (9.0 * x).sin() * (7.0 * z).cos(), z)
        });
        SampleSet::new(points.collect(), Vec::new()).expect("samples")
    }

    #[test]
    fn walking_finds_what_searching_finds() {
        let set = wavy(60);
        let mut walk = Walk::default();
        for i in 0..20_000 {
            // A scan line that jumps back at its end.
            let (x, z) = ((i % 500) as f32 / 500.0, (i / 500) as f32 / 40.0);
            let p = Vec3::new(x, 0.1 * (9.0 * x).sin() * (7.0 * z).cos() + 0.003, z);
            let (walked, searched) = (walk.nearest(&set, p), set.nearest(p));
            let distance = |i: u32| set.positions[i as usize].distance(p);
            assert!(distance(walked) <= distance(searched) * 1.0001, "vertex {i}");
        }
    }

    #[test]
    fn two_sheets_do_not_mix_where_vertices_have_normals() {
        // Two plates closer than the spacing, facing away from each other.
        let plate = |y: f32| (0..400).map(move |i| Vec3::new((i % 20) as f32, y, (i / 20) as f32) * 0.1);
        let positions: Vec<Vec3> = plate(0.0).chain(plate(0.3)).collect();
        let normals = (0..800).map(|i| if i < 400 { -Vec3::Y } else { Vec3::Y }).collect();
        let set = SampleSet::new(positions, normals).expect("samples");
        for (y, normal, range) in [(0.012, Vec3::Y, 400..800), (0.018, -Vec3::Y, 0..400)] {
            // Nearer to the other plate, but facing its own.
            let p = Vec3::new(0.93, y, 0.97);
            let nearest = set.nearest(p) as usize;
            let around = Neighbourhood::gather(&set, nearest, MAX_K, p, Some(normal));
            assert!(around.weighted().iter().all(|(i, _)| range.contains(&(*i as usize))));
            assert!(around.weighted().len() > 3);
        }
    }

    #[test]
    fn weights_fall_with_distance_and_coincident_samples_are_fine() {
        let set = wavy(30);
        let p = Vec3::new(0.51, 0.0, 0.49);
        let around = Neighbourhood::gather(&set, set.nearest(p) as usize, MAX_K, p, None);
        assert_eq!(around.weighted().len(), MAX_K);
        assert!(around.weighted().windows(2).all(|w| w[0].1 >= w[1].1 - 0.05));
        let same = SampleSet::new(vec![Vec3::ONE; 40], Vec::new()).expect("samples");
        let around = Neighbourhood::gather(&same, 7, MAX_K, Vec3::ONE, None);
        assert!(around.weighted().iter().map(|(_, w)| w).sum::<f32>() > 0.0);
    }
}
