//! Rows of vertices, which generated surfaces are made of.

use glam::{DVec3, Vec3};

/// A vertex of a generated surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceVertex {
    /// Position.
    pub position: DVec3,
    /// Unit normal, to the outside.
    pub normal: Vec3,
    /// Red, green and blue.
    pub color: [u8; 3],
}

/// A body of a model, row by row.
pub(crate) trait BodyRows: Send + Sync {
    fn rows(&self) -> usize;

    /// Number of vertices in a row.
    fn row_len(&self, row: usize) -> u64;

    /// Appends the vertices of a row.
    fn row(&self, row: usize, vertices: &mut Vec<SurfaceVertex>);

    /// Number of triangles between a row and the next one; 0 for the last.
    fn strip_len(&self, row: usize) -> u64;

    /// Appends the triangles between a row and the next one, counter-clockwise seen from outside.
    fn strip(&self, row: usize, triangles: &mut Vec<[u64; 3]>);
}
