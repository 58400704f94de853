//! Smooth transitions from 0 to 1.

/// Smooth step: 0 below 0, 1 above 1, and between them a cubic polynomial that is flat at both ends.
pub fn smoothstep(x: f64) -> f64 {
    let t = x.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Transition over a `width` from an edge, at a `distance` from the edge; and its slope.
pub fn fade(distance: f64, width: f64) -> (f64, f64) {
    let t = (distance / width).clamp(0.0, 1.0);
    (smoothstep(t), 6.0 * t * (1.0 - t) / width)
}
