//! Point sets: selections of their points, their extent, and the similarity that takes one set to another.

use glam::{DAffine3, DMat3, DVec3};
use simod_geometry::nearest_rotation;

/// Indices of at most `most` of `count` things, spread evenly over their order.
pub fn some(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (0..taken).map(move |i| i * count / taken)
}

/// Indices of at most `count` of the points, as far from each other as can be, the first one first; none
/// twice.
pub fn farthest(points: &[DVec3], count: usize) -> Vec<usize> {
    let mut apart = vec![f64::INFINITY; points.len()];
    let (mut found, mut next) = (Vec::new(), 0);
    while found.len() < count.min(points.len()) && apart[next] > 0.0 {
        found.push(next);
        let from = points[next];
        let mut most = (0, -1.0);
        for (i, (d, p)) in apart.iter_mut().zip(points).enumerate() {
            *d = d.min(p.distance_squared(from));
            if *d > most.1 {
                most = (i, *d);
            }
        }
        next = most.0;
    }
    found
}

/// Extent of points: their middle, spread and box.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    pub middle: DVec3,
    /// The root of the mean square of distances from the middle.
    pub radius: f64,
    pub low: DVec3,
    pub high: DVec3,
}

impl Extent {
    /// Extent of at least one point.
    pub fn measure(points: &[DVec3]) -> Self {
        let count = points.len().max(1) as f64;
        let low = points.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = points.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        // Sums are taken relative to one of the points, so that far points keep their digits.
        let from = points.first().copied().unwrap_or_default();
        let middle = from + points.iter().map(|p| (*p - from) / count).sum::<DVec3>();
        let radius = points.iter().map(|p| p.distance_squared(middle) / count).sum::<f64>().sqrt();
        Self { middle, radius, low, high }
    }

    /// The distance between two boxes; 0 where they overlap.
    pub fn gap(&self, other: &Self) -> f64 {
        (other.low - self.high).max(self.low - other.high).max(DVec3::ZERO).length()
    }

    pub fn diagonal(&self) -> f64 {
        self.low.distance(self.high)
    }
}

/// Pair of points that belong together, with its weight.
#[derive(Debug, Clone, Copy)]
pub struct Pair {
    pub source: DVec3,
    pub target: DVec3,
    pub weight: f64,
}

/// Weighted means of sources and targets, and the sum of weights.
fn means(pairs: &[Pair]) -> (DVec3, DVec3, f64) {
    let whole: f64 = pairs.iter().map(|p| p.weight).sum();
    let mean = |of: &dyn Fn(&Pair) -> DVec3| pairs.iter().map(|p| p.weight / whole * of(p)).sum();
    (mean(&|p| p.source), mean(&|p| p.target), whole)
}

/// The sum of weighted products of `a` by `b`.
fn products(pairs: &[Pair], of: impl Fn(&Pair) -> (DVec3, DVec3)) -> DMat3 {
    pairs.iter().fold(DMat3::ZERO, |sum, p| {
        let (a, b) = of(p);
        sum + DMat3::from_cols(a * (p.weight * b.x), a * (p.weight * b.y), a * (p.weight * b.z))
    })
}

/// Turn that is nearest to a matrix, and the sum of its singular values, that of a mirror taken off (S.
/// Umeyama, PAMI 1991); nothing where the turn is not determined.
pub fn nearest_turn(matrix: DMat3) -> Option<(DMat3, f64)> {
    let (turn, values) = nearest_rotation(matrix);
    (values.y > 1e-12 * values.x && values.x > 0.0).then(|| (turn, values.element_sum()))
}

/// Similarity that takes sources to targets best, or the rigid motion; nothing where the points lie on a
/// line, or nearly.
pub fn similarity(pairs: &[Pair], with_scale: bool) -> Option<DAffine3> {
    let (source, target, whole) = means(pairs);
    if !(whole.is_finite() && whole > 0.0) {
        return None;
    }
    let (turn, sum) = nearest_turn(products(pairs, |p| (p.target - target, p.source - source)))?;
    let spread: f64 = pairs.iter().map(|p| p.weight * p.source.distance_squared(source)).sum();
    let scale = if with_scale { sum / spread } else { 1.0 };
    let matrix = scale * turn;
    let map = DAffine3::from_mat3_translation(matrix, target - matrix * source);
    (map.is_finite() && scale > 0.0).then_some(map)
}
