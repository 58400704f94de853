//! Curves that users draw: falloffs, profiles.
//!
//! F. N. Fritsch, R. E. Carlson, *Monotone piecewise cubic interpolation*, SIAM J. Numer. Anal. 17 (1980),
//! with the harmonic means of Fritsch and Butland (1984) for slopes: smooth, and nowhere beyond the points.

/// A smooth function through given points, of [`ParamKind::CURVE`](crate::ParamKind::CURVE).
///
/// Between two points it stays between their values; before the first and after the last it is constant.
#[derive(Debug, Clone, Copy)]
pub struct Curve<'a>(&'a [[f64; 2]]);

impl<'a> Curve<'a> {
    /// A curve through points (x, y) of ascending x; nothing if they are less than two, or do not ascend.
    pub fn new(points: &'a [[f64; 2]]) -> Option<Self> {
        (points.len() >= 2 && points.is_sorted_by(|a, b| a[0] < b[0])).then_some(Self(points))
    }

    /// The points.
    pub fn points(&self) -> &'a [[f64; 2]] {
        self.0
    }

    /// The value at `x`. Costs a binary search and some ten operations.
    pub fn at(&self, x: f64) -> f64 {
        let points = self.0;
        let next = points.partition_point(|p| p[0] <= x);
        if next == 0 || next == points.len() {
            return points[next.saturating_sub(1)][1];
        }
        let ([x0, y0], [x1, y1]) = (points[next - 1], points[next]);
        let width = x1 - x0;
        let (t, m0, m1) = ((x - x0) / width, self.slope(next - 1) * width, self.slope(next) * width);
        let s = 1.0 - t;
        // Cubic Hermite polynomials.
        y0 * (1.0 + 2.0 * t) * s * s + m0 * t * s * s + y1 * t * t * (3.0 - 2.0 * t) - m1 * t * t * s
    }

    /// The slope at a point: 0 at the ends and where the curve turns, else the weighted harmonic mean.
    fn slope(&self, i: usize) -> f64 {
        let points = self.0;
        if i == 0 || i + 1 == points.len() {
            return 0.0;
        }
        let [before, after] = [i - 1, i].map(|j| {
            let ([x0, y0], [x1, y1]) = (points[j], points[j + 1]);
            (x1 - x0, (y1 - y0) / (x1 - x0))
        });
        if before.1 * after.1 <= 0.0 {
            return 0.0;
        }
        let (w0, w1) = (2.0 * after.0 + before.0, after.0 + 2.0 * before.0);
        (w0 + w1) / (w0 / before.1 + w1 / after.1)
    }
}
