//! The nearest others of every point of a tree, leaf by leaf: the points of a leaf are near the same leaves,
//! which are looked up once for all of them.
//!
//! The distance of the last of the neighbours that are wanted is guessed by the leaf before, whose points are
//! mostly near. Where it is larger, one point is looked up by itself: the neighbours of another point are no
//! farther than that and the way between both. Within a leaf, the distance is guessed by the point before,
//! and counted: so few points are sorted that are not wanted.

use std::sync::atomic::Ordering;

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::long_list::{ListStorage, LongList};
use simod_model::memory;

use super::kd_tree::{Found, KdTree, LEAF, Leaf, PointBox};
use crate::counting_sort;

/// Largest number of leaves that are looked at together. Where a leaf is near more, as one of few points
/// beside a heap, its points are looked up one by one.
const MOST_LEAVES: usize = 128;

/// Number of points more than are wanted up to which a guess is good enough.
const SPARE: usize = 12;

/// Number of guesses, before the sure distance is taken.
const GUESSES: usize = 3;

/// Expected ratio of squared distances to those of the leaf before, at most.
const MORE: f32 = 1.4;

/// Makes up for the rounding of sums of distances.
const SURELY: f32 = 1.0001;

/// Addend that makes up for the rounding of squares so small that they have hardly any digits.
const LEAST: f32 = 1e-36;

impl KdTree {
    /// The `k` nearest others of each point, nearest first, one list behind the other: the same as
    /// [`nearest_others`](Self::nearest_others) finds. There are more points than `k`. Takes jobs of the
    /// thread pool.
    ///
    /// Memory: 4 bytes for each entry, and 9 kilobytes for each thread.
    pub fn nearest_others_of_all(&self, k: usize, storage: &ListStorage) -> LongList<u32> {
        // The system's own zeros: the threads that fill them touch them first.
        let mut all = LongList::zeros(k * self.len(), storage);
        let lists = memory::atomics(&mut all);
        if k > 0 {
            let batch = || Batch {
                tree: self,
                k,
                last: 0.0,
                farthest: 0.0,
                open: Vec::new(),
                near: Vec::new(),
                distances: Vec::new(),
                found: Vec::new(),
            };
            (0..self.leaves.len()).into_par_iter().for_each_init(batch, |batch, leaf| {
                batch.look_up(leaf, |point, found| {
                    let list = &lists[point as usize * k..][..k];
                    storage.gone_through(size_of_val(list));
                    list.iter().zip(found).for_each(|(to, found)| to.store(*found as u32, Ordering::Relaxed));
                });
            });
        }
        all
    }
}

/// Buffers with which a thread looks up the neighbours of leaves.
struct Batch<'a> {
    tree: &'a KdTree,
    k: usize,
    /// Squared distance of the last neighbour of the last point, and the largest of those of the last leaf.
    last: f32,
    farthest: f32,
    /// Nodes that are still to be looked into: each with its first leaf and the number of its leaves.
    open: Vec<(usize, usize, usize)>,
    /// The leaves that are near.
    near: Vec<u32>,
    /// Squared distances of a point to all of their points.
    distances: Vec<[f32; LEAF]>,
    found: Vec<Found>,
}

impl Batch<'_> {
    /// Finds the nearest others of all points of a leaf, and says them.
    fn look_up(&mut self, leaf: usize, mut say: impl FnMut(u32, &[Found])) {
        let tree = self.tree;
        let leaf = &tree.leaves[leaf];
        let whole = PointBox::from_points(leaf.points().map(|(p, _)| p));
        let mut most = MORE * self.farthest;
        let (mut is_gathered, mut is_sure) = (self.gather(&whole, most), false);
        self.farthest = 0.0;
        for (point, index) in leaf.points() {
            if !(is_gathered && self.find(point, index, most)) {
                self.found.resize(self.k, 0);
                tree.nearest_others(point, index, &mut self.found);
                if !is_sure {
                    let reach = distance(self.found[self.k - 1]).sqrt();
                    let surely = |p: Vec3| (SURELY * (reach + p.distance(point))).powi(2) + LEAST;
                    most = leaf.points().map(|(p, _)| surely(p)).fold(0.0, f32::max);
                    (is_gathered, is_sure) = (self.gather(&whole, most), true);
                }
            }
            self.last = distance(self.found[self.k - 1]);
            self.farthest = self.farthest.max(self.last);
            say(index, &self.found);
        }
    }

    /// Finds the nearest others of a point among the leaves that were gathered, which have all points that
    /// are no farther than the root of `most`; `false` if these are too few.
    fn find(&mut self, point: Vec3, index: u32, most: f32) -> bool {
        let k = self.k;
        Arch::new().dispatch(One { point, index, guess: self.last, surely: most, batch: self });
        if self.found.len() < k {
            return false;
        }
        counting_sort::sort(&mut self.found);
        self.found.truncate(k);
        true
    }

    /// Gathers the leaves of which a point may be no farther from a box than the root of `most`; `false` if
    /// they are too many.
    fn gather(&mut self, whole: &PointBox, most: f32) -> bool {
        self.near.clear();
        if !most.is_finite() {
            return false;
        }
        self.open.clear();
        self.open.push((0, 0, self.tree.leaves.len()));
        while let Some((node, first, leaves)) = self.open.pop() {
            if self.tree.boxes[node].gap_squared(whole) > most {
                continue;
            }
            if leaves > 1 {
                let left = leaves / 2;
                let right = (node + 2 * left, first + left, leaves - left);
                self.open.extend([(node + 1, first, left), right]);
            } else if self.near.len() < MOST_LEAVES {
                self.near.push(first as u32);
            } else {
                return false;
            }
        }
        self.distances.resize(self.near.len(), [0.0; LEAF]);
        true
    }
}

fn distance(found: Found) -> f32 {
    f32::from_bits((found >> 32) as u32)
}

/// Finds the points around one, in no order: at least as many as are wanted, if there are.
struct One<'a, 'b> {
    point: Vec3,
    index: u32,
    /// About the squared distance of the last that is wanted ...
    guess: f32,
    /// ... and the most within which all are looked at.
    surely: f32,
    batch: &'a mut Batch<'b>,
}

impl WithSimd for One<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Batch { tree, k, near, distances, found, .. } = self.batch;
        for (to, leaf) in distances.iter_mut().zip(near.iter()) {
            measure(simd, self.point, &tree.leaves[*leaf as usize], to);
        }
        // The point itself is among them.
        let limit = limit(simd, distances, *k + 1, self.guess, self.surely);
        found.clear();
        for (leaf, distances) in near.iter().zip(distances.iter()) {
            if least(simd, distances) > limit {
                continue;
            }
            let room = found.len();
            let Leaf { index, .. } = &tree.leaves[*leaf as usize];
            found.resize(room + LEAF, 0);
            let mut count = 0;
            for (distance, index) in distances.iter().zip(index) {
                found[room + count] = u64::from(distance.to_bits()) << 32 | u64::from(*index);
                count += usize::from(*distance <= limit && *index != self.index);
            }
            found.truncate(room + count);
        }
    }
}

/// The squared distances of a point to those of a leaf: as [`Leaf::distances`].
#[inline(always)]
fn measure<S: Simd>(simd: S, p: Vec3, leaf: &Leaf, to: &mut [f32; LEAF]) {
    let (px, py, pz) = (simd.splat_f32s(p.x), simd.splat_f32s(p.y), simd.splat_f32s(p.z));
    let (x, y, z) = (S::as_simd_f32s(&leaf.x).0, S::as_simd_f32s(&leaf.y).0, S::as_simd_f32s(&leaf.z).0);
    let to = S::as_mut_simd_f32s(to).0;
    for i in 0..to.len() {
        let (x, y, z) = (simd.sub_f32s(x[i], px), simd.sub_f32s(y[i], py), simd.sub_f32s(z[i], pz));
        let sum = simd.add_f32s(simd.mul_f32s(x, x), simd.mul_f32s(y, y));
        to[i] = simd.add_f32s(sum, simd.mul_f32s(z, z));
    }
}

/// The least of distances.
#[inline(always)]
fn least<S: Simd>(simd: S, distances: &[f32; LEAF]) -> f32 {
    let distances = S::as_simd_f32s(distances).0;
    let mut least = distances[0];
    for distances in &distances[1..] {
        least = simd.min_f32s(least, *distances);
    }
    simd.reduce_min_f32s(least)
}

/// Number of distances that are within a limit.
#[inline(always)]
fn count<S: Simd>(simd: S, distances: &[[f32; LEAF]], limit: f32) -> usize {
    let (limit, one, none) = (simd.splat_f32s(limit), simd.splat_f32s(1.0), simd.splat_f32s(0.0));
    let mut count = none;
    for distance in S::as_simd_f32s(distances.as_flattened()).0 {
        let within = simd.less_than_or_equal_f32s(*distance, limit);
        count = simd.add_f32s(count, simd.select_f32s(within, one, none));
    }
    simd.reduce_sum_f32s(count) as usize
}

/// A distance within which there are as many as are wanted, if possible hardly more.
#[inline(always)]
fn limit<S: Simd>(simd: S, distances: &[[f32; LEAF]], wanted: usize, guess: f32, surely: f32) -> f32 {
    let mut limit = guess;
    for _ in 0..GUESSES {
        let count = count(simd, distances, limit);
        if (wanted..=wanted + SPARE).contains(&count) {
            return limit;
        }
        // On a surface their number grows with the square.
        limit *= (wanted + SPARE / 2) as f32 / count.max(wanted / 3).max(1) as f32;
        if limit >= surely {
            return surely;
        }
    }
    if count(simd, distances, limit) >= wanted { limit } else { surely }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Vec3>> {
        // Few distinct values, so that many are equally far; and heaps, far points, some so far that squares
        // overflow, and some so near to each other that they vanish.
        let x = || prop_oneof![4 => (-4..4i32).prop_map(|x| x as f32 / 4.0), 4 => -1.0..1.0f32];
        let size = prop_oneof![6 => Just(1.0f32), 2 => Just(1e-3), 1 => Just(1e2), 1 => Just(1e25)];
        let point = (x(), x(), x(), size).prop_map(|(x, y, z, size)| Vec3::new(x, y, z) * size);
        let whole = prop_oneof![4 => Just(1.0f32), 1 => Just(1e-19), 1 => Just(3e-22), 1 => Just(1e-23)];
        (proptest::collection::vec(point, 1..700), whole)
            .prop_map(|(points, whole)| points.into_iter().map(|p| p * whole).collect())
    }

    proptest! {
        #[test]
        fn those_of_all_are_those_of_each(points in points(), k in 0..40usize) {
            let k = k.min(points.len() - 1);
            let tree = KdTree::new(&points);
            let all = tree.nearest_others_of_all(k, &ListStorage::Memory);
            let mut found = vec![0; k];
            for (i, p) in points.iter().enumerate() {
                tree.nearest_others(*p, i as u32, &mut found);
                let each: Vec<u32> = found.iter().map(|found| *found as u32).collect();
                prop_assert_eq!(&all[i * k..(i + 1) * k], &each, "{}", i);
            }
        }
    }
}
