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

/// The edges of triangles, each once, in order.
pub(crate) fn edges(triangles: impl Iterator<Item = [u32; 3]>) -> Vec<[u32; 2]> {
    let sides = triangles.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
    // As one number, which is sorted in half the time.
    let mut keys: Vec<u64> = sides.map(|[a, b]| u64::from(a.min(b)) << 32 | u64::from(a.max(b))).collect();
    keys.par_sort_unstable();
    keys.dedup();
    keys.into_iter().map(|key| [(key >> 32) as u32, key as u32]).collect()
}

/// Twice the area of a triangle, along its normal.
pub(crate) fn cross([a, b, c]: Corners) -> DVec3 {
    (b - a).cross(c - a)
}
