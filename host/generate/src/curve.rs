//! Planar curves travelled at unit speed: the profiles and the axes of swept surfaces.

use glam::DVec2;

/// Table entries per spline segment; between them the arc length is integrated to rounding.
const STEPS: usize = 16;

/// A uniform cubic B-spline: twice continuously differentiable, so that swept normals have no creases.
pub(super) struct BSpline {
    points: Vec<DVec2>,
    /// Arc length from the start to each table entry.
    lengths: Vec<f64>,
}

/// Point of a curve, and the direction in which the curve goes on, by arc length.
#[derive(Clone, Copy)]
pub(super) struct CurvePoint {
    pub position: DVec2,
    /// First derivative, of unit length.
    pub tangent: DVec2,
    /// Second derivative: perpendicular to the tangent, as long as the curvature.
    pub bend: DVec2,
}

impl BSpline {
    /// The spline of at least four control points. It starts near the second and ends near the last but one.
    pub fn new(points: Vec<DVec2>) -> Self {
        debug_assert!(points.len() >= 4);
        let mut curve = Self { lengths: vec![0.0], points };
        let mut length = 0.0;
        for i in 0..(curve.points.len() - 3) * STEPS {
            let t = i as f64 / STEPS as f64;
            length += curve.length_between(t, t + 1.0 / STEPS as f64);
            curve.lengths.push(length);
        }
        curve
    }

    pub fn length(&self) -> f64 {
        self.lengths[self.lengths.len() - 1]
    }

    /// The curve after arc length `s`, clipped to its ends.
    pub fn point(&self, s: f64) -> CurvePoint {
        let s = s.clamp(0.0, self.length());
        let entry = self.lengths.partition_point(|&l| l <= s).clamp(1, self.lengths.len() - 1) - 1;
        let start = entry as f64 / STEPS as f64;
        let rest = s - self.lengths[entry];
        let mut t = start + rest / (self.lengths[entry + 1] - self.lengths[entry]) / STEPS as f64;
        for _ in 0..2 {
            t -= (self.length_between(start, t) - rest) / self.derivatives(t)[1].length();
        }
        let [position, velocity, acceleration] = self.derivatives(t);
        let speed = velocity.length();
        let tangent = velocity / speed;
        let bend = (acceleration - tangent * acceleration.dot(tangent)) / (speed * speed);
        CurvePoint { position, tangent, bend }
    }

    /// Arc length between two near parameters of one segment (Gauss-Legendre, three nodes).
    fn length_between(&self, a: f64, b: f64) -> f64 {
        let node = 0.6f64.sqrt();
        let (middle, half) = (0.5 * (a + b), 0.5 * (b - a));
        let speed = |x: f64| self.derivatives(middle + half * x)[1].length();
        half / 9.0 * (5.0 * speed(-node) + 8.0 * speed(0.0) + 5.0 * speed(node))
    }

    /// Position and its first two derivatives by the spline's parameter.
    fn derivatives(&self, t: f64) -> [DVec2; 3] {
        let segment = (t.max(0.0) as usize).min(self.points.len() - 4);
        let t = t - segment as f64;
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| self.points[segment + i]);
        let [u, t2, t3] = [1.0 - t, t * t, t * t * t];
        [
            (a * (u * u * u) + b * (3.0 * t3 - 6.0 * t2 + 4.0) + c * (3.0 * (t + t2 - t3) + 1.0) + d * t3)
                / 6.0,
            (a * (-u * u) + b * (3.0 * t2 - 4.0 * t) + c * (1.0 + 2.0 * t - 3.0 * t2) + d * t2) / 2.0,
            a * u + b * (3.0 * t - 2.0) + c * (1.0 - 3.0 * t) + d * t,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn travels_at_unit_speed() {
        let points = [(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0), (1.2, 0.7), (0.4, 2.0), (0.0, 2.1), (-0.4, 2.0)];
        let curve = BSpline::new(points.map(DVec2::from).to_vec());
        let h = 1e-4;
        for i in 1..100 {
            let s = curve.length() * f64::from(i) / 100.0;
            let [before, here, after] = [s - h, s, s + h].map(|s| curve.point(s));
            let tangent = (after.position - before.position) / (2.0 * h);
            assert!((tangent - here.tangent).length() < 1e-6, "tangent at {s}");
            let bend = (after.tangent - before.tangent) / (2.0 * h);
            assert!((bend - here.bend).length() < 1e-2 * (1.0 + bend.length()), "bend at {s}");
        }
        assert!(curve.point(0.0).position.length() < 1e-12);
    }
}
