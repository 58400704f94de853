//! P_S: the samples, with what a deformation tool and the reconstruction need of them.

use std::num::NonZeroUsize;

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use super::normals;
use crate::{Error, ErrorKind, Result};

/// Neighbours that are known of each sample: enough for a second-order fit, and for the neighbourhoods of all
/// points around the sample.
pub const NEIGHBOURS: usize = 32;

/// Neighbours over which the spacing is measured: as many as in a hexagonal packing.
const SPACING_NEIGHBOURS: usize = 6;

/// The k nearest neighbours of each sample, nearest first, without the sample itself.
#[derive(Debug, Clone, Default)]
pub struct NeighbourGraph {
    k: usize,
    flat: Vec<u32>,
}

impl NeighbourGraph {
    /// The neighbours of sample `i`, nearest first.
    #[inline]
    pub fn of(&self, i: usize) -> &[u32] {
        &self.flat[i * self.k..(i + 1) * self.k]
    }

    /// How many neighbours each sample has: [`NEIGHBOURS`], or fewer in a set of fewer samples.
    pub fn k(&self) -> usize {
        self.k
    }
}

/// The small point set P_S, in local coordinates (see [`Frame`](crate::frame::Frame)).
///
/// Memory: about 170 bytes per sample. The index of a sample never changes.
pub struct SampleSet {
    /// Positions.
    pub positions: Vec<Vec3>,
    /// Unit normals, consistently oriented.
    pub normals: Vec<Vec3>,
    /// Mean distance to the nearest neighbours; 0 for a single sample.
    pub spacing: Vec<f32>,
    /// The k-nearest-neighbour graph.
    pub neighbours: NeighbourGraph,
    tree: ImmutableKdTree<f32, 3>,
}

impl SampleSet {
    /// Completes a set of samples: the neighbour graph and spacing, and normals where they are zero.
    ///
    /// # Errors
    /// There is no sample, or one that is not finite.
    pub fn new(positions: Vec<Vec3>, mut normals: Vec<Vec3>) -> Result<Self> {
        if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::new(
                ErrorKind::Degenerate,
                format!("sample {i} has no finite position"),
                "the samples are damaged: sample the model again",
            ));
        }
        let tree = index(&positions)?;
        let k = NEIGHBOURS.min(positions.len() - 1);
        // One more, as a sample is its own nearest neighbour.
        let wanted = NonZeroUsize::MIN.saturating_add(k);
        let mut flat = vec![0; positions.len() * k];
        if k > 0 {
            flat.par_chunks_mut(k).enumerate().for_each(|(i, neighbours)| {
                let found =
                    tree.query(&positions[i].to_array()).nearest_n::<SquaredEuclidean<f32>>(wanted).execute();
                let others = found.iter().map(|f| f.item).filter(|j| *j != i as u32);
                // Among more coincident samples than k, the sample itself may be missing from what was found.
                neighbours.iter_mut().zip(others).for_each(|(slot, j)| *slot = j);
            });
        }
        let neighbours = NeighbourGraph { k, flat };
        let near = SPACING_NEIGHBOURS.min(k);
        let spacing = (0..positions.len())
            .into_par_iter()
            .map(|i| {
                let distance = |j: &u32| positions[*j as usize].distance(positions[i]);
                neighbours.of(i)[..near].iter().map(distance).sum::<f32>() / near.max(1) as f32
            })
            .collect();
        normals.resize(positions.len(), Vec3::ZERO);
        normals::complete(&positions, &neighbours, &mut normals);
        Ok(Self { positions, normals, spacing, neighbours, tree })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Never: a set has at least one sample.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The sample nearest to a finite point. Costs about a microsecond: not for every vertex of P_L.
    pub fn nearest(&self, p: Vec3) -> u32 {
        self.tree.query(&p.to_array()).nearest_one::<SquaredEuclidean<f32>>().execute().item
    }
}

fn index(positions: &[Vec3]) -> Result<ImmutableKdTree<f32, 3>> {
    let points: Vec<[f32; 3]> = positions.iter().map(Vec3::to_array).collect();
    if points.is_empty() {
        return Err(Error::new(
            ErrorKind::Degenerate,
            "there are no samples",
            "a sampled model has at least one: sample the model again",
        ));
    }
    ImmutableKdTree::new_from_slice(&points).map_err(|e| {
        Error::new(
            ErrorKind::Degenerate,
            format!("cannot index {} samples: {e:?}", points.len()),
            "ask for fewer samples",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vec3> {
        // Few distinct values: coincident and collinear samples are common.
        let x = || (-4..4i32).prop_map(|x| x as f32 / 4.0);
        (x(), x(), x()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn neighbours_are_the_nearest(points in proptest::collection::vec(point(), 1..120)) {
            let set = SampleSet::new(points.clone(), Vec::new()).expect("finite points");
            for (i, p) in points.iter().enumerate() {
                let mut all: Vec<f32> =
                    points.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, q)| p.distance(*q)).collect();
                all.sort_by(f32::total_cmp);
                let found = set.neighbours.of(i);
                prop_assert!(!found.contains(&(i as u32)));
                let found: Vec<f32> = found.iter().map(|j| points[*j as usize].distance(*p)).collect();
                prop_assert_eq!(&found[..], &all[..set.neighbours.k()]);
                prop_assert!(set.normals[i].is_normalized());
            }
        }
    }

    #[test]
    fn no_samples_and_non_finite_samples_are_refused() {
        assert!(SampleSet::new(Vec::new(), Vec::new()).is_err());
        assert!(SampleSet::new(vec![Vec3::NAN], Vec::new()).is_err());
    }
}
