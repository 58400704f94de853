//! The nearest of a set of points: a k-d tree (J. Friedman, J. Bentley, R. Finkel, *An Algorithm for Finding
//! Best Matches in Logarithmic Expected Time*, 1977) of tight boxes.
//!
//! Points at the same distance are told apart by their index, so the results depend on the points alone.
//!
//! Kiddo's tree, on which other crates stand, is not used, as the neighbours of all points at once are what
//! P_S waits for. 200 000 points of a surface, two cores, kiddo 6.3: 32 neighbours of all in 0.04 s, and 0.18
//! s by kiddo, which looks each up by itself and leaves ties open; 0.01 s both to build; a nearest point in
//! 0.3 and 0.2 µs of a core.

use glam::Vec3;

/// Points of a leaf.
pub(super) const LEAF: usize = 16;

/// A k-d tree.
///
/// Memory: 20 bytes per point, and 16 more while it is built.
pub struct KdTree {
    pub(super) leaves: Vec<Leaf>,
    /// Box of each node, then those of its left half, then those of its right half. A node of n leaves has ⌊n
    /// / 2⌋ of them on its left, and 2n − 1 boxes in all.
    pub(super) boxes: Vec<PointBox>,
    len: usize,
}

/// Points by coordinates, so that all are looked at together. The last leaf is filled up with points
/// infinitely far away.
pub(super) struct Leaf {
    pub(super) x: [f32; LEAF],
    pub(super) y: [f32; LEAF],
    pub(super) z: [f32; LEAF],
    pub(super) index: [u32; LEAF],
}

#[derive(Clone, Copy)]
pub(super) struct PointBox {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
}

/// A point that was found: the bits of its squared distance, which order as the distance does, and its index.
pub(super) type Found = u64;

/// Farther than any point.
const NOTHING: Found = u64::MAX;

impl KdTree {
    /// The tree over finite points, of which there is at least one. Takes jobs of the thread pool.
    pub fn new(points: &[Vec3]) -> Self {
        Self::build(points, true)
    }

    /// Tree of points, built by the calling thread alone: for callers that jobs of a thread pool wait for.
    pub fn in_one_job(points: &[Vec3]) -> Self {
        Self::build(points, false)
    }

    fn build(points: &[Vec3], in_parallel: bool) -> Self {
        let mut points: Vec<(Vec3, u32)> = points.iter().copied().zip(0..).collect();
        let len = points.len();
        let leaves = len.div_ceil(LEAF);
        let mut boxes = vec![PointBox { min: Vec3::ZERO, max: Vec3::ZERO }; 2 * leaves - 1];
        halve(&mut points, &mut boxes, in_parallel);
        Self { leaves: points.chunks(LEAF).map(Leaf::from_points).collect(), boxes, len }
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// The point nearest to `p`.
    pub fn nearest(&self, p: Vec3) -> u32 {
        let mut search = TreeSearch { tree: self, point: p, but: u32::MAX, found: &mut [NOTHING] };
        search.visit(0, 0, self.leaves.len());
        search.found[0] as u32
    }

    /// Largest radius of balls about the points of each node, which [`deepest`](Self::deepest) takes.
    ///
    /// Memory: half a byte per point.
    pub fn largest_below(&self, radius: &[f32]) -> Vec<f32> {
        let mut largest = vec![0.0; self.boxes.len()];
        self.largest_of(0, 0, self.leaves.len(), radius, &mut largest);
        largest
    }

    fn largest_of(
        &self,
        node: usize,
        first: usize,
        leaves: usize,
        radius: &[f32],
        largest: &mut [f32],
    ) -> f32 {
        largest[node] = if leaves == 1 {
            let indices = self.leaves[first].index.iter().filter(|i| **i != u32::MAX);
            indices.map(|i| radius[*i as usize]).fold(0.0, f32::max)
        } else {
            let left = leaves / 2;
            let a = self.largest_of(node + 1, first, left, radius, largest);
            a.max(self.largest_of(node + 2 * left, first + left, leaves - left, radius, largest))
        };
        largest[node]
    }

    /// Ball, among those about the points that hold `p`, in which `p` is nearest to the middle, as a part of
    /// the radius.
    pub fn deepest(&self, p: Vec3, radius: &[f32], largest: &[f32]) -> Option<u32> {
        let mut least = (1.0, u32::MAX);
        let mut open = vec![(0, 0, self.leaves.len())];
        while let Some((node, first, leaves)) = open.pop() {
            let reach = largest[node];
            // Written so that nothing is lost by rounding.
            if self.boxes[node].distance_squared(p) > 1.0001 * reach * reach {
                continue;
            }
            if leaves > 1 {
                let left = leaves / 2;
                open.extend([(node + 1, first, left), (node + 2 * left, first + left, leaves - left)]);
                continue;
            }
            let leaf = &self.leaves[first];
            for (at, i) in leaf.index.iter().enumerate().filter(|(_, i)| **i != u32::MAX) {
                let d = Vec3::new(leaf.x[at], leaf.y[at], leaf.z[at]) - p;
                let r = radius[*i as usize];
                let depth = d.length_squared() / (r * r);
                if depth < 1.0 && (depth, *i) < least {
                    least = (depth, *i);
                }
            }
        }
        (least.1 != u32::MAX).then_some(least.1)
    }

    /// All points that are not farther from `p` than `radius`, in no order. The numbers' lower halves are the
    /// points' indices; they are in the order of the distances.
    pub fn within(&self, p: Vec3, radius: f32) -> Vec<Found> {
        let most = radius * radius;
        let (mut found, mut open) = (Vec::new(), vec![(0, 0, self.leaves.len())]);
        while let Some((node, first, leaves)) = open.pop() {
            if self.boxes[node].distance_squared(p) > most {
                continue;
            }
            if leaves > 1 {
                let left = leaves / 2;
                open.extend([(node + 1, first, left), (node + 2 * left, first + left, leaves - left)]);
                continue;
            }
            self.leaves[first].gather(p, most, &mut found);
        }
        found
    }

    /// The points nearest to `p`, nearest first: as many as `found` is long, which is no longer than there
    /// are. The numbers' lower halves are the points' indices.
    pub fn nearest_ones(&self, p: Vec3, found: &mut [Found]) {
        self.nearest_others(p, u32::MAX, found);
    }

    /// The points nearest to `p` without one of them, nearest first: as many as `found` is long, which is no
    /// longer than there are. The numbers' lower halves are the points' indices.
    pub fn nearest_others(&self, p: Vec3, but: u32, found: &mut [Found]) {
        found.fill(NOTHING);
        if !found.is_empty() {
            TreeSearch { tree: self, point: p, but, found }.visit(0, 0, self.leaves.len());
        }
    }
}

/// Values of all points, of which some are known: the others get that of the nearest known one. `None` if
/// none is known.
pub(crate) fn completed<T: Copy>(values: &[Option<T>], positions: &[Vec3]) -> Option<Vec<T>> {
    let known: Vec<usize> = (0..values.len()).filter(|i| values[*i].is_some()).collect();
    if known.is_empty() {
        return None;
    }
    if known.len() == values.len() {
        return values.iter().copied().collect();
    }
    let tree = KdTree::new(&known.iter().map(|i| positions[*i]).collect::<Vec<_>>());
    let value = |(value, p): (&Option<T>, &Vec3)| value.or_else(|| values[known[tree.nearest(*p) as usize]]);
    values.iter().zip(positions).map(value).collect()
}

/// Parts the points at the median along their box's longest side, so that leaves are full, and so on.
fn halve(points: &mut [(Vec3, u32)], boxes: &mut [PointBox], in_parallel: bool) {
    let Some((whole, halves)) = boxes.split_first_mut() else { return };
    *whole = PointBox::from_points(points.iter().map(|(p, _)| *p));
    let PointBox { min, max } = *whole;
    if points.len() > LEAF {
        let left = points.len().div_ceil(LEAF) / 2;
        let axis = (max - min).max_position();
        points.select_nth_unstable_by(left * LEAF, |(p, _), (q, _)| p[axis].total_cmp(&q[axis]));
        let (points, halves) = (points.split_at_mut(left * LEAF), halves.split_at_mut(2 * left - 1));
        if in_parallel {
            rayon::join(|| halve(points.0, halves.0, true), || halve(points.1, halves.1, true));
        } else {
            halve(points.0, halves.0, false);
            halve(points.1, halves.1, false);
        }
    }
}

impl Leaf {
    fn from_points(points: &[(Vec3, u32)]) -> Self {
        let far = [f32::INFINITY; LEAF];
        let mut leaf = Self { x: far, y: far, z: far, index: [u32::MAX; LEAF] };
        for (i, (p, index)) in points.iter().enumerate() {
            (leaf.x[i], leaf.y[i], leaf.z[i], leaf.index[i]) = (p.x, p.y, p.z, *index);
        }
        leaf
    }

    /// The leaf's points and their indices.
    pub(super) fn points(&self) -> impl Iterator<Item = (Vec3, u32)> {
        let point = |i| (Vec3::new(self.x[i], self.y[i], self.z[i]), self.index[i]);
        (0..LEAF).map(point).filter(|(_, index)| *index != u32::MAX)
    }

    /// Appends those points of the leaf that are no farther than a squared distance from a point.
    #[inline(always)]
    fn gather(&self, p: Vec3, most: f32, found: &mut Vec<Found>) {
        // Points are chosen without a branch for each, as which ones they are cannot be foretold.
        let (room, mut count) = (found.len(), 0);
        found.resize(room + LEAF, NOTHING);
        for (distance, index) in self.distances(p).into_iter().zip(self.index) {
            found[room + count] = u64::from(distance.to_bits()) << 32 | u64::from(index);
            count += usize::from(distance <= most && index != u32::MAX);
        }
        found.truncate(room + count);
    }

    /// Squared distances of a point.
    #[inline(always)]
    pub(super) fn distances(&self, p: Vec3) -> [f32; LEAF] {
        std::array::from_fn(|i| {
            let (x, y, z) = (self.x[i] - p.x, self.y[i] - p.y, self.z[i] - p.z);
            x * x + y * y + z * z
        })
    }
}

impl PointBox {
    pub(super) fn from_points(points: impl Iterator<Item = Vec3>) -> Self {
        let nothing = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };
        points.fold(nothing, |all, p| Self { min: all.min.min(p), max: all.max.max(p) })
    }

    /// Squared distance of another box: rounded as those of the points in both are, so that it is never
    /// greater.
    pub(super) fn gap_squared(&self, other: &Self) -> f32 {
        let d = (self.min - other.max).max(other.min - self.max).max(Vec3::ZERO);
        d.x * d.x + d.y * d.y + d.z * d.z
    }

    /// Squared distance of a point: rounded as those of the points in the box are, so that it is never
    /// greater.
    #[inline]
    fn distance_squared(&self, p: Vec3) -> f32 {
        let d = (self.min - p).max(p - self.max).max(Vec3::ZERO);
        d.x * d.x + d.y * d.y + d.z * d.z
    }
}

struct TreeSearch<'a> {
    tree: &'a KdTree,
    point: Vec3,
    /// Index of the point that is left out.
    but: u32,
    /// The nearest so far, ascending.
    found: &'a mut [Found],
}

impl TreeSearch<'_> {
    /// Looks for nearer points below a node of `leaves` leaves, of which `first` is the first.
    fn visit(&mut self, node: usize, first: usize, leaves: usize) {
        if leaves == 1 {
            return self.look_at(&self.tree.leaves[first]);
        }
        let left = leaves / 2;
        let half = |node: usize, first, leaves| {
            (self.tree.boxes[node].distance_squared(self.point), node, first, leaves)
        };
        let (a, b) = (half(node + 1, first, left), half(node + 2 * left, first + left, leaves - left));
        let (near, far) = if b.0 < a.0 { (b, a) } else { (a, b) };
        for (distance, node, first, leaves) in [near, far] {
            if u64::from(distance.to_bits()) <= self.farthest() >> 32 {
                self.visit(node, first, leaves);
            }
        }
    }

    fn look_at(&mut self, leaf: &Leaf) {
        for (distance, index) in leaf.distances(self.point).iter().zip(leaf.index) {
            let found = u64::from(distance.to_bits()) << 32 | u64::from(index);
            if found < self.farthest() && index != self.but {
                self.insert(found);
            }
        }
    }

    #[inline]
    fn insert(&mut self, found: Found) {
        let mut at = self.found.len() - 1;
        while at > 0 && self.found[at - 1] > found {
            self.found[at] = self.found[at - 1];
            at -= 1;
        }
        self.found[at] = found;
    }

    #[inline]
    fn farthest(&self) -> Found {
        self.found[self.found.len() - 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vec3> {
        // Few distinct values: coincident and equally distant points are common. And some so far that squares
        // overflow.
        let x = || prop_oneof![8 => (-4..4i32).prop_map(|x| x as f32 / 4.0), 1 => -1e30..1e30f32];
        (x(), x(), x()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn what_is_found_is_the_nearest_by_distance_and_index(
            points in proptest::collection::vec(point(), 1..300), p in point(), k in 0..40usize,
        ) {
            let tree = KdTree::new(&points);
            let mut sorted: Vec<u32> = (0..points.len() as u32).collect();
            sorted.sort_by(|i, j| {
                let distance = |i: u32| points[i as usize].distance_squared(p);
                distance(*i).total_cmp(&distance(*j)).then(i.cmp(j))
            });
            prop_assert_eq!(tree.nearest(p), sorted[0]);
            let but = sorted.remove(sorted.len() / 2);
            sorted.truncate(k);
            let mut found = vec![0; sorted.len()];
            tree.nearest_others(p, but, &mut found);
            prop_assert_eq!(found.iter().map(|f| *f as u32).collect::<Vec<_>>(), sorted);
        }

        #[test]
        fn within_a_radius_all_are_found(
            points in proptest::collection::vec(point(), 1..300), p in point(), radius in 0.0..3.0f32,
        ) {
            let tree = KdTree::new(&points);
            let distance = |i: u32| points[i as usize].distance_squared(p);
            let mut near: Vec<u32> =
                (0..points.len() as u32).filter(|i| distance(*i) <= radius * radius).collect();
            near.sort_by(|i, j| distance(*i).total_cmp(&distance(*j)).then(i.cmp(j)));
            let mut found = tree.within(p, radius);
            found.sort_unstable();
            let found: Vec<u32> = found.iter().map(|f| *f as u32).collect();
            prop_assert_eq!(found, near);
            prop_assert_eq!(tree.within(p, f32::INFINITY).len(), points.len());
        }

        #[test]
        fn the_deepest_ball_is_that_in_which_a_point_is_nearest_to_the_middle(
            balls in proptest::collection::vec((point(), 0.0..2.0f32), 1..300), p in point(),
        ) {
            let (points, radius): (Vec<Vec3>, Vec<f32>) = balls.into_iter().unzip();
            let tree = KdTree::new(&points);
            let depth = |i: usize| points[i].distance_squared(p) / (radius[i] * radius[i]);
            let held = (0..points.len()).filter(|i| depth(*i) < 1.0);
            let deepest = held.min_by(|i, j| depth(*i).total_cmp(&depth(*j)));
            prop_assert_eq!(tree.deepest(p, &radius, &tree.largest_below(&radius)), deepest.map(|i| i as u32));
        }
    }
}
