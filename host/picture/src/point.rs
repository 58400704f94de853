//! The points that are drawn.

use glam::{DVec3, Vec3};

/// A point of a surface, drawn as a disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceDisc {
    /// Position; points that are not finite are skipped.
    pub position: DVec3,
    /// Normal of any length and sign; zero (or not finite) where it is not known: then the picture's depth
    /// tells the orientation.
    pub normal: Vec3,
    /// Red, green and blue; see [`Style::own_colors`](crate::Style::own_colors).
    pub color: [u8; 3],
    /// Radius of the disc, in the units of the position; see [`Spacing`](crate::Spacing).
    pub radius: f32,
}
