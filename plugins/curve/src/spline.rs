//! Curve through a wire's points: the cubic spline of E. Catmull and R. Rom, with the centripetal knots of
//! C. Yuksel, S. Schaefer, J. Keyser, *On the parameterization of Catmull-Rom curves*, SPM 2009, by which
//! the curve has no loops. A point moves the two spans on either side alone.

use glam::DVec3;

/// A curve through points; before the first and behind the last it goes straight on.
#[derive(Debug, Clone)]
pub struct Spline {
    knots: Vec<f64>,
    points: Vec<DVec3>,
    /// Derivatives at the knots.
    slopes: Vec<DVec3>,
}

/// A point of the curve, and the direction in which it goes on.
#[derive(Debug, Clone, Copy)]
pub struct WirePoint {
    pub position: DVec3,
    pub first: DVec3,
    pub second: DVec3,
}

/// Centripetal knots of points, of which no two in succession coincide: the knots lie apart by the roots of
/// the distances.
pub fn knots(points: &[DVec3]) -> Vec<f64> {
    let mut knots = vec![0.0];
    for pair in points.windows(2) {
        knots.push(knots[knots.len() - 1] + pair[0].distance(pair[1]).sqrt());
    }
    knots
}

impl Spline {
    /// The curve through `points`, two at least, at ascending `knots`.
    pub fn new(knots: Vec<f64>, points: Vec<DVec3>) -> Self {
        let chord = |i: usize| (points[i + 1] - points[i]) / (knots[i + 1] - knots[i]);
        let last = points.len() - 1;
        let slope = |i: usize| match i {
            0 => chord(0),
            _ if i == last => chord(last - 1),
            // The slope is that of the parabola through the point and its neighbours.
            _ => {
                let [before, behind] = [knots[i] - knots[i - 1], knots[i + 1] - knots[i]];
                (chord(i - 1) * behind + chord(i) * before) / (before + behind)
            }
        };
        let slopes = (0..=last).map(slope).collect();
        Self { knots, points, slopes }
    }

    /// Number of spans between the curve's points.
    pub fn spans(&self) -> usize {
        self.points.len() - 1
    }

    /// The parameter at which a part of a span, 0 to 1, has been passed.
    pub fn parameter(&self, span: usize, part: f64) -> f64 {
        self.knots[span] + part * (self.knots[span + 1] - self.knots[span])
    }

    /// Least and greatest parameter of the curve's points; beyond, the curve is straight.
    pub fn range(&self) -> [f64; 2] {
        [self.knots[0], self.knots[self.spans()]]
    }

    /// Point and derivatives of the curve at `t`; `span` is the span of `t`, the first or last one for
    /// parameters beyond.
    pub fn evaluate(&self, span: usize, t: f64) -> WirePoint {
        let [start, end] = self.range();
        let straight = |i: usize| WirePoint {
            position: self.points[i] + (t - self.knots[i]) * self.slopes[i],
            first: self.slopes[i],
            second: DVec3::ZERO,
        };
        if t < start {
            return straight(0);
        }
        if t > end {
            return straight(self.spans());
        }
        let [p, q] = [self.points[span], self.points[span + 1]];
        let [m, n] = [self.slopes[span], self.slopes[span + 1]];
        let h = self.knots[span + 1] - self.knots[span];
        let u = (t - self.knots[span]) / h;
        // Hermite's form, as powers of u.
        let (a, b, c) = (2.0 * (p - q) + h * (m + n), 3.0 * (q - p) - h * (2.0 * m + n), h * m);
        WirePoint {
            position: ((a * u + b) * u + c) * u + p,
            first: ((3.0 * a * u + 2.0 * b) * u + c) / h,
            second: (6.0 * a * u + 2.0 * b) / (h * h),
        }
    }
}
