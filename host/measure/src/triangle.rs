//! Triangles of a mesh in memory.

use glam::DVec3;

/// A corner of a triangle.
pub(crate) type Corners = [DVec3; 3];

/// The corners of a triangle in one shape; nothing where it has none.
pub(crate) fn corners(positions: &[DVec3], triangle: [u32; 3]) -> Option<Corners> {
    let [a, b, c] = triangle.map(|i| positions.get(i as usize).copied().filter(|p| p.is_finite()));
    Some([a?, b?, c?])
}

/// Twice the area of a triangle, along its normal.
pub(crate) fn cross([a, b, c]: Corners) -> DVec3 {
    (b - a).cross(c - a)
}
