//! Smooth transitions from 0 to 1.

use simod_geometry::smoothstep;

/// Transition over a `width` from an edge, at a `distance` from the edge; and its slope.
pub fn fade(distance: f64, width: f64) -> (f64, f64) {
    let t = (distance / width).clamp(0.0, 1.0);
    (smoothstep(t), 6.0 * t * (1.0 - t) / width)
}
