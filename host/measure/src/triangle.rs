//! Triangles of a mesh in memory.

use glam::DVec3;
use rayon::prelude::*;

/// A corner of a triangle.
pub(crate) type Corners = [DVec3; 3];

/// The corners of a triangle in one shape; nothing where it has none.
pub(crate) fn corners(positions: &[DVec3], triangle: [u32; 3]) -> Option<Corners> {
    let [a, b, c] = triangle.map(|i| positions.get(i as usize).copied().filter(|p| p.is_finite()));
    Some([a?, b?, c?])
}

/// The sides of triangles, each the way it goes round.
pub(crate) fn sides(triangles: impl Iterator<Item = [u32; 3]>) -> impl Iterator<Item = [u32; 2]> {
    triangles.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]])
}

/// The same side, whichever way it goes.
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

/// The edges of triangles, each once, in order.
pub(crate) fn edges(triangles: impl Iterator<Item = [u32; 3]>) -> Vec<[u32; 2]> {
    let mut keys = sorted(sides(triangles).map(either_way));
    keys.dedup();
    keys.into_iter().map(pair).collect()
}

/// Twice the area of a triangle, along its normal.
pub(crate) fn cross([a, b, c]: Corners) -> DVec3 {
    (b - a).cross(c - a)
}
