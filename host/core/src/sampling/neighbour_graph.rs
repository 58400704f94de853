//! The graph of samples and their nearest neighbours.

use std::sync::Arc;

use simod_model::long_list::{ListStorage, LongList};

use super::kd_tree::KdTree;

/// The k nearest neighbours of each sample, nearest first, without the sample itself.
///
/// Memory: 4 bytes for each neighbour, which clones have in common.
#[derive(Debug, Clone, Default)]
pub struct NeighbourGraph {
    k: usize,
    flat: Arc<LongList<u32>>,
}

impl NeighbourGraph {
    /// The graph of points to `k` neighbours, if there are as many.
    pub(super) fn of_points(tree: &KdTree, k: usize, storage: &ListStorage) -> Self {
        let k = k.min(tree.len() - 1);
        Self { k, flat: Arc::new(tree.nearest_others_of_all(k, storage)) }
    }

    /// A graph that was found out before: `k` neighbours of each sample, one after the other.
    pub(crate) fn known(k: usize, flat: LongList<u32>) -> Self {
        Self { k, flat: Arc::new(flat) }
    }

    /// Whether the graph is of so many samples: one that was read from a file may be damaged.
    pub(crate) fn is_valid(&self, samples: usize) -> bool {
        self.k < samples
            && self.flat.len() == self.k * samples
            && self.flat.pass().all(|j| (*j as usize) < samples)
    }

    /// Bytes of the lists of so many samples.
    pub fn bytes_of(&self, samples: usize) -> usize {
        size_of::<u32>() * self.k * samples
    }

    /// The neighbours of sample `i`, nearest first.
    #[inline]
    pub fn nearest_to(&self, i: usize) -> &[u32] {
        &self.flat[i * self.k..(i + 1) * self.k]
    }

    /// The neighbours of all samples, [`k`](Self::k) of each.
    pub fn all(&self) -> &[u32] {
        &self.flat
    }

    /// Number of neighbours of each sample: [`NEIGHBOURS`](super::NEIGHBOURS), or fewer in a set of fewer
    /// samples.
    pub fn k(&self) -> usize {
        self.k
    }
}
