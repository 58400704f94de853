//! A tree of triangles, of which each node has up to four parts side by side, told apart four at a time in
//! single precision: each with the box of its triangles, and where these are few with a disc around them as
//! well, as a point above a surface is nearly as far from the boxes of many. Parts are halves of halves,
//! along the longest side of what their triangles' middles span.

use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::triangle::{TriangleCorners, cross};

/// Parts of a node, and most triangles of one without nodes below.
const PARTS: usize = 4;
/// More triangles than these are worth another thread.
const APART: usize = 1 << 12;
/// Most triangles that have a disc around them: more seldom lie in a plane.
const FLAT: usize = 64;

/// Triangle with an area, and its index.
pub(crate) struct TreeTriangle(pub TriangleCorners, pub u32);

/// Tree of triangles by their positions.
///
/// Memory: 256 bytes for each node, of which there is one for two or three triangles.
pub(crate) struct TriangleTree {
    /// The nodes: the root first, and below each one its parts, one after the other.
    nodes: Vec<TreeNode>,
    unit: UnitCube,
}

/// A part that is still to be searched.
pub(crate) struct QueuedPart {
    node: u32,
    /// Square of the least distance that the part may have, in the tree's unit.
    least: f32,
}

/// Parts side by side.
#[derive(Clone)]
struct TreeNode {
    low: [Vec4; 3],
    high: [Vec4; 3],
    discs: Discs,
    parts: [Child; PARTS],
}

#[derive(Clone, Copy)]
enum Child {
    None,
    /// A node, by its index among the nodes.
    Node(u32),
    /// A triangle, by its place in the tree's order.
    Triangle(u32),
}

impl TriangleTree {
    /// Builds the tree of some triangles, and returns the order in which the tree has them.
    pub fn from_facets(facets: &[TreeTriangle]) -> (Self, Vec<u32>) {
        let middle =
            |f: &TreeTriangle| 0.5 * (f.0[0].min(f.0[1]).min(f.0[2]) + f.0[0].max(f.0[1]).max(f.0[2]));
        let middles: Vec<DVec3> = facets.par_iter().map(middle).collect();
        let mut order: Vec<u32> = (0..facets.len() as u32).collect();
        let unit = UnitCube::around(facets);
        let mut nodes = vec![TreeNode::EMPTY; nodes_of(facets.len())];
        grow(&mut nodes, &mut order, [0, 0], (facets, &middles, &unit));
        (Self { nodes, unit }, order)
    }

    /// Visits all triangles that may be nearer to a point than a distance, of which the square is given;
    /// `look` returns the square for the nearest so far. `waiting` is room for the search.
    pub fn nearest(
        &self,
        p: DVec3,
        square: f64,
        waiting: &mut Vec<QueuedPart>,
        mut look: impl FnMut(usize) -> f64,
    ) {
        let (p, mut reach) = (self.unit.point(p), self.unit.reach(square));
        // No more than three for each step down.
        waiting.push(QueuedPart { node: 0, least: 0.0 });
        while let Some(QueuedPart { node, least }) = waiting.pop() {
            if least > reach {
                continue;
            }
            let node = &self.nodes[node as usize];
            let squares = node.least(p).to_array();
            let first = waiting.len();
            for lane in nearest_first(squares) {
                match node.parts[lane] {
                    _ if squares[lane] > reach => break,
                    Child::None => {}
                    Child::Node(node) => waiting.push(QueuedPart { node, least: squares[lane] }),
                    Child::Triangle(place) => reach = self.unit.reach(look(place as usize)),
                }
            }
            // The nearest one comes first, which is put there last.
            waiting[first..].reverse();
        }
    }

    /// Visits all triangles that a ray may meet.
    pub fn on_ray(&self, origin: DVec3, direction: DVec3, mut look: impl FnMut(usize)) {
        let inverse = (direction * self.unit.scale).recip();
        let along = RayBoxes { origin: self.unit.exactly(origin), inverse };
        let mut waiting = vec![0];
        while let Some(node) = waiting.pop() {
            let node = &self.nodes[node as usize];
            for (lane, part) in node.parts.iter().enumerate() {
                match part {
                    Child::Node(place) if along.meets(node, lane) => waiting.push(*place),
                    Child::Triangle(place) if along.meets(node, lane) => look(*place as usize),
                    _ => {}
                }
            }
        }
    }
}

/// The places of squares, the least first; of equal ones the first. Squares are no less than 0, so that their
/// bits are in the order of their values.
#[inline]
fn nearest_first(squares: [f32; PARTS]) -> [usize; PARTS] {
    let key = |lane: usize| u64::from(squares[lane].to_bits()) << 2 | lane as u64;
    let mut keys: [u64; PARTS] = std::array::from_fn(key);
    for [a, b] in [[0, 1], [2, 3], [0, 2], [1, 3], [1, 2]] {
        (keys[a], keys[b]) = (keys[a].min(keys[b]), keys[a].max(keys[b]));
    }
    keys.map(|key| (key & 3) as usize)
}

/// Coordinates in which all triangles reach from -1 to 1, so that single precision can compare distances.
struct UnitCube {
    middle: DVec3,
    scale: f64,
}

impl UnitCube {
    /// Bound of rounding errors: of those of lengths in the cube, and as a part of longer lengths.
    const ROUNDING: f32 = 1e-5;
    /// Farther points are taken for some that are nearer.
    const FARTHEST: DVec3 = DVec3::splat(1e15);

    fn around(facets: &[TreeTriangle]) -> Self {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in facets.iter().flat_map(|facet| facet.0) {
            (low, high) = (low.min(corner), high.max(corner));
        }
        Self { middle: 0.5 * (low + high), scale: 2.0 / (high - low).max_element() }
    }

    fn exactly(&self, p: DVec3) -> DVec3 {
        (p - self.middle) * self.scale
    }

    /// Point in the cube, in single precision, that is no farther from any of the triangles than the given
    /// point.
    fn point(&self, p: DVec3) -> Vec3 {
        self.exactly(p).clamp(-Self::FARTHEST, Self::FARTHEST).as_vec3()
    }

    /// The square of no less than a length, of which the square is told.
    fn reach(&self, square: f64) -> f32 {
        let reach = (square.sqrt() * self.scale) as f32 * (1.0 + Self::ROUNDING) + Self::ROUNDING;
        reach * reach
    }
}

/// Discs around the triangles of each part: as thick as the triangles are high above the disc's plane.
#[derive(Clone)]
struct Discs {
    middle: [Vec4; 3],
    normal: [Vec4; 3],
    radius: Vec4,
    /// Half the disc's thickness.
    thickness: Vec4,
}

impl Discs {
    /// Discs around everything.
    const ENDLESS: Self = Self {
        middle: [Vec4::ZERO; 3],
        normal: [Vec4::X, Vec4::Y, Vec4::Z],
        radius: Vec4::INFINITY,
        thickness: Vec4::INFINITY,
    };

    /// Puts the disc of some triangles at a place: about the mean of their corners, across the sum of their
    /// normals.
    fn put(&mut self, lane: usize, facets: impl Iterator<Item = TriangleCorners> + Clone, unit: &UnitCube) {
        let facets = facets.map(|corners| corners.map(|p| unit.exactly(p)));
        let corners = facets.clone().flatten();
        let (sum, count) = corners.clone().fold((DVec3::ZERO, 0.0), |(sum, n), p| (sum + p, n + 1.0));
        let (middle, normal) =
            ((sum / count).as_vec3(), facets.map(cross).sum::<DVec3>().normalize_or(DVec3::Z).as_vec3());
        for axis in 0..3 {
            self.middle[axis][lane] = middle[axis];
            self.normal[axis][lane] = normal[axis];
        }
        let (mut thickness, mut radius) = (0.0f32, 0.0f32);
        for p in corners {
            let [up, aside] = self.place(p.as_vec3()).map(|of| of[lane]);
            (thickness, radius) = (thickness.max(up), radius.max(aside));
        }
        (self.thickness[lane], self.radius[lane]) = (thickness, radius);
    }

    /// Distances of a point from the discs' planes, and from their axes.
    #[inline]
    fn place(&self, p: Vec3) -> [Vec4; 2] {
        let way: [Vec4; 3] = std::array::from_fn(|axis| Vec4::splat(p[axis]) - self.middle[axis]);
        let height = (0..3).map(|axis| way[axis] * self.normal[axis]).sum::<Vec4>();
        let aside = (0..3).map(|axis| way[axis] - height * self.normal[axis]);
        [height.abs(), aside.map(|x| x * x).sum::<Vec4>().sqrt()]
    }
}

impl TreeNode {
    /// A node without parts.
    const EMPTY: Self = Self {
        low: [Vec4::ZERO; 3],
        high: [Vec4::ZERO; 3],
        discs: Discs::ENDLESS,
        parts: [Child::None; PARTS],
    };

    /// The squares of how far the parts are at least from a point; 0 inside.
    #[inline]
    fn least(&self, p: Vec3) -> Vec4 {
        let beside = |axis: usize| {
            let p = Vec4::splat(p[axis]);
            (self.low[axis] - p).max(p - self.high[axis]).max(Vec4::ZERO)
        };
        let of_boxes = (0..3).map(beside).map(|x| x * x).sum::<Vec4>();
        let [up, aside] = self.discs.place(p);
        let up = (up - self.discs.thickness).max(Vec4::ZERO);
        let aside = (aside - self.discs.radius).max(Vec4::ZERO);
        of_boxes.max(up * up + aside * aside)
    }
}

/// The boxes that a ray meets, in the tree's unit.
struct RayBoxes {
    origin: DVec3,
    /// Inverses of the direction's components; infinite for those that are 0.
    inverse: DVec3,
}

impl RayBoxes {
    fn meets(&self, node: &TreeNode, lane: usize) -> bool {
        let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            let at = |x: f32| (f64::from(x) - self.origin[axis]) * self.inverse[axis];
            let low = at(node.low[axis][lane] - UnitCube::ROUNDING);
            let high = at(node.high[axis][lane] + UnitCube::ROUNDING);
            // A ray that lies in the plane of a side gives NaN, and that side bounds nothing.
            if !(low.is_nan() || high.is_nan()) {
                (enter, leave) = (enter.max(low.min(high)), leave.min(low.max(high)));
            }
        }
        // A little more than that, so that nothing is lost by rounding.
        enter <= leave * (1.0 + 1e-12)
    }
}

/// Number of triangles of each part of so many: all parts but the last are full, or have full ones below.
fn sizes(triangles: usize) -> [usize; PARTS] {
    if triangles <= PARTS {
        return std::array::from_fn(|i| usize::from(i < triangles));
    }
    let halves = |all: usize| {
        let half = if all > PARTS { (all / 2).next_multiple_of(PARTS) } else { all };
        [half, all - half]
    };
    let [[a, b], [c, d]] = halves(triangles).map(halves);
    [a, b, c, d]
}

/// Number of nodes of the tree of so many triangles.
fn nodes_of(triangles: usize) -> usize {
    let below = sizes(triangles).into_iter().filter(|size| *size > 1);
    1 + below.map(nodes_of).sum::<usize>()
}

/// Writes the tree of some triangles, by their boxes' middles, to `nodes`; `this` is the place of the first
/// node among those of the whole tree, and `place` that of the first triangle in the order. Large parts grow
/// in parallel.
fn grow(
    nodes: &mut [TreeNode],
    order: &mut [u32],
    [this, mut place]: [u32; 2],
    of @ (facets, middles, unit): (&[TreeTriangle], &[DVec3], &UnitCube),
) {
    let Some((node, mut below)) = nodes.split_first_mut() else { return };
    let sizes = sizes(order.len());
    if order.len() > PARTS {
        let half = sizes[0] + sizes[1];
        halve(order, half, middles);
        let (first, second) = order.split_at_mut(half);
        halve(first, sizes[0], middles);
        halve(second, sizes[2], middles);
    }
    let is_large = order.len() > APART;
    let (mut rest, mut next, mut parts) = (order, this + 1, Vec::new());
    for (lane, size) in sizes.into_iter().enumerate().filter(|(_, size)| *size > 0) {
        let (own, others) = rest.split_at_mut(size);
        rest = others;
        let corners = own.iter().map(|i| facets[*i as usize].0);
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in corners.clone().flatten() {
            (low, high) = (low.min(corner), high.max(corner));
        }
        let [low, high] = [low, high].map(|p| unit.exactly(p).as_vec3());
        for axis in 0..3 {
            (node.low[axis][lane], node.high[axis][lane]) = (low[axis], high[axis]);
        }
        if size <= FLAT {
            node.discs.put(lane, corners, unit);
        }
        if size == 1 {
            node.parts[lane] = Child::Triangle(place);
        } else {
            node.parts[lane] = Child::Node(next);
            let (own_nodes, other_nodes) = below.split_at_mut(nodes_of(size));
            below = other_nodes;
            parts.push((own_nodes, own, [next, place]));
            next += nodes_of(size) as u32;
        }
        place += size as u32;
    }
    if is_large {
        parts.into_par_iter().for_each(|(nodes, order, at)| grow(nodes, order, at, of));
    } else {
        parts.into_iter().for_each(|(nodes, order, at)| grow(nodes, order, at, of));
    }
}

/// Moves so many triangles to the front: those that lie farther back along the longest side of the box of the
/// middles.
fn halve(order: &mut [u32], count: usize, middles: &[DVec3]) {
    if count == 0 || count >= order.len() {
        return;
    }
    let (mut least, mut most) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for middle in order.iter().map(|i| middles[*i as usize]) {
        (least, most) = (least.min(middle), most.max(middle));
    }
    let longest = (most - least).to_array();
    let axis = (0..3).max_by(|a, b| longest[*a].total_cmp(&longest[*b])).unwrap_or(0);
    order.select_nth_unstable_by(count, |a, b| {
        let [x, y] = [a, b].map(|i| middles[*i as usize][axis]);
        x.total_cmp(&y).then(a.cmp(b))
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Many small triangles along a wound line.
    fn some(count: usize) -> Vec<TreeTriangle> {
        let at = |i: f64| DVec3::new(i.sin(), 0.1 * i, (0.7 * i).cos());
        let of = |i: u32| {
            let t = f64::from(i);
            TreeTriangle([at(t), at(t + 0.2), at(t) + DVec3::splat(0.1)], i)
        };
        (0..count as u32).map(of).collect()
    }

    #[test]
    fn the_least_comes_first_and_of_equal_ones_the_first() {
        let values = [0.0, 1e-30, 0.25, 0.25, 3.0, f32::INFINITY];
        for n in 0..values.len().pow(4) {
            let squares: [f32; 4] = std::array::from_fn(|k| values[n / values.len().pow(k as u32) % 6]);
            let mut expected = [0, 1, 2, 3];
            expected.sort_by(|a: &usize, b| squares[*a].total_cmp(&squares[*b]));
            assert_eq!(nearest_first(squares), expected, "{squares:?}");
        }
    }

    #[test]
    fn each_triangle_has_one_place() {
        for count in (1..70).chain([255, 256, 257, 1000, 5 * APART + 3]) {
            let facets = some(count);
            let (tree, mut order) = TriangleTree::from_facets(&facets);
            let mut found = Vec::new();
            let look = |place: usize| {
                found.push(place as u32);
                f64::INFINITY
            };
            tree.nearest(DVec3::ONE, f64::INFINITY, &mut Vec::new(), look);
            found.sort_unstable();
            order.sort_unstable();
            let all: Vec<u32> = (0..count as u32).collect();
            assert!(found == all && order == all, "{count}");
        }
    }

    #[test]
    fn what_is_far_is_not_looked_at() {
        let facets = some(5000);
        let (tree, order) = TriangleTree::from_facets(&facets);
        for i in (0..5000).step_by(7) {
            let p = facets[i].0[0];
            let mut looked_at = Vec::new();
            let look = |place: usize| {
                looked_at.push(order[place] as usize);
                1e-12
            };
            tree.nearest(p, 1e-12, &mut Vec::new(), look);
            assert!(looked_at.contains(&i) && looked_at.len() < 20, "{looked_at:?} at {i}");
        }
    }
}
