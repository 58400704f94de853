//! Triangles of a mesh in memory.

use glam::DVec3;
use rayon::prelude::*;

/// A corner of a triangle.
pub(crate) type TriangleCorners = [DVec3; 3];

/// The corners of a triangle in one shape; nothing where it has none.
pub(crate) fn corners(positions: &[DVec3], triangle: [u32; 3]) -> Option<TriangleCorners> {
    let [a, b, c] = triangle.map(|i| positions.get(i as usize).copied().filter(|p| p.is_finite()));
    Some([a?, b?, c?])
}

/// Sides of triangles, each in the direction in which the triangle goes round.
pub(crate) fn sides(triangles: impl Iterator<Item = [u32; 3]>) -> impl Iterator<Item = [u32; 2]> {
    triangles.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]])
}

/// Vertices of a side, the lower one first, in whichever direction the side goes.
pub(crate) fn either_way([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// A pair as one number, by which pairs are in the same order: it is sorted in half the time.
pub(crate) fn key([a, b]: [u32; 2]) -> u64 {
    u64::from(a) << 32 | u64::from(b)
}

/// The pair of a key.
pub(crate) fn pair(key: u64) -> [u32; 2] {
    [(key >> 32) as u32, key as u32]
}

/// The keys of pairs, in order.
pub(crate) fn sorted(pairs: impl Iterator<Item = [u32; 2]>) -> Vec<u64> {
    let mut keys: Vec<u64> = pairs.map(key).collect();
    keys.par_sort_unstable();
    keys
}

/// The edges of a mesh at rest, each once, of whichever of its triangles it is a side: found once for all
/// shapes.
///
/// Memory: 8 bytes for each edge, and 24 for each triangle in the making.
pub struct Edges(Vec<[u32; 2]>);

impl Edges {
    /// Edges of triangles between positions; those with a corner that there is not, or at no finite place,
    /// have none.
    pub fn from_triangles(rest: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let valid = triangles.iter().filter(|t| corners(rest, **t).is_some());
        let mut keys = sorted(sides(valid.copied()).map(either_way));
        keys.dedup();
        Self(keys.into_iter().map(pair).collect())
    }

    /// Lengths of each edge that has a length, at rest and in a shape with as many vertices where the edge's
    /// ends have finite positions.
    pub(crate) fn lengths(&self, rest: &[DVec3], deformed: &[DVec3]) -> impl Iterator<Item = [f64; 2]> {
        let both =
            move |[a, b]: &[u32; 2]| [rest, deformed].map(|of| of[*a as usize].distance(of[*b as usize]));
        self.0.iter().map(both).filter(|[rest, deformed]| *rest > 0.0 && deformed.is_finite())
    }
}

/// Twice the area of a triangle, along its normal.
pub(crate) fn cross([a, b, c]: TriangleCorners) -> DVec3 {
    (b - a).cross(c - a)
}
